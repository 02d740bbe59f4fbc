"""Which pinned packages have wheels for which system: a table, an extra a row, for docs/platforms.md.

    python tools/platforms.py             # prints the table
    python tools/platforms.py --write     # and puts it into docs/platforms.md

pip is asked what it would install there, of the versions in constraints.txt and from the index that this machine uses:
nothing is downloaded but metadata. What a package needs on another system only (colorama, pywin32) is not asked for.
"""

import argparse
import re
import subprocess
import sys
import tempfile
import tomllib
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "platforms.md"
PYTHONS = ("3.11", "3.12", "3.13")
_LINUX = [f"manylinux_2_{minor}" for minor in range(5, 40)] + ["manylinux2014", "manylinux2010", "manylinux1", "linux"]
_MACS = {"arm64": range(11, 16), "x86_64": range(11, 16)}
SYSTEMS = {
    "Linux, x86-64": [f"{tag}_x86_64" for tag in _LINUX],
    "Linux, ARM": [f"{tag}_aarch64" for tag in _LINUX],
    "Windows, x86-64": ["win_amd64"],
    "macOS, Apple silicon": [f"macosx_{major}_0_arm64" for major in _MACS["arm64"]],
    "macOS, Intel": [f"macosx_{major}_0_x86_64" for major in _MACS["x86_64"]] + ["macosx_10_15_x86_64"],
}
APART = {"ray"}
"""Extras that are not in "all", since few want them and they are large: no development install has their packages."""
MISSING = re.compile(r"(?:No matching distribution found for|Cannot install) ([\w.-]+)==")
BEGIN, END = "<!-- platforms: begin -->", "<!-- platforms: end -->"


def pins() -> dict[str, str]:
    """The version of each pinned package, by its canonical name."""
    lines = (ROOT / "constraints.txt").read_text("utf-8").splitlines()
    rows = [line.partition(";")[0].strip().partition("==") for line in lines if line and not line.startswith("#")]
    return {canonicalize_name(name): version for name, _, version in rows}


def extras() -> dict[str, list[str]]:
    """What the package itself and each extra ask for."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    return {"": project["dependencies"], **project["optional-dependencies"]}


def needed(texts: list[str]) -> set[str]:
    """Names of all packages that these need on this system, and of those that they need in turn."""
    names: set[str] = set()
    waiting = [Requirement(text) for text in texts]
    while waiting:
        requirement = waiting.pop()
        name = canonicalize_name(requirement.name)
        if name == "farfield":
            waiting += [Requirement(text) for extra in requirement.extras for text in extras()[extra]]
            continue
        if name in names:
            continue
        names.add(name)
        try:
            lines = requires(name) or []
        except PackageNotFoundError as error:
            raise SystemExit(f"{name} is not installed here: make install") from error
        for line in lines:
            following = Requirement(line)
            marks = [{"extra": extra} for extra in (*requirement.extras, "")]
            if following.marker is None or any(following.marker.evaluate(mark) for mark in marks):
                waiting.append(following)
    return names


def without_wheel(names: set[str], tags: list[str], python: str) -> set[str]:
    """Those of the pinned packages of which pip takes no wheel for a system under a Python.

    Raises:
        RuntimeError: If pip fails of another reason.
    """
    versions, missing = pins(), set[str]()
    command = [sys.executable, "-m", "pip", "install", "--dry-run", "--quiet", "--ignore-installed", "--no-deps"]
    command += ["--only-binary", ":all:", "--implementation", "cp", "--python-version", python]
    command += [word for tag in tags for word in ("--platform", tag)]
    with tempfile.TemporaryDirectory() as folder:
        while True:
            pinned = [f"{name}=={versions[name]}" for name in sorted(names - missing)]
            done = subprocess.run([*command, "--target", folder, *pinned], capture_output=True, text=True, check=False)
            if done.returncode == 0:
                return missing
            lacking = {canonicalize_name(name) for name in MISSING.findall(done.stderr)} & names - missing
            if not lacking:
                raise RuntimeError(done.stderr[-1000:])
            missing |= lacking


def table() -> str:
    """The table in Markdown; progress goes to the error stream."""
    groups = {name: needed(texts) & pins().keys() for name, texts in extras().items() if name not in APART}
    every = set().union(*groups.values())
    missing = {}
    for system, tags in SYSTEMS.items():
        for python in PYTHONS:
            missing[system, python] = without_wheel(every, tags, python)
            print(f"{system}, Python {python}: {len(missing[system, python])} missing", file=sys.stderr, flush=True)
    rows = [["", *SYSTEMS], ["---"] * (1 + len(SYSTEMS))]
    for name, group in groups.items():
        row = [f"`[{name}]`" if name else "the package"]
        for system in SYSTEMS:
            lacking = {python: group & missing[system, python] for python in PYTHONS}
            whole = [python for python in PYTHONS if not lacking[python]]
            names = sorted(set().union(*lacking.values()))
            row.append(", ".join(whole) if len(whole) else f"no wheel of {', '.join(names)}")
            if whole and names:
                row[-1] += f" (else no wheel of {', '.join(names)})"
        rows.append(row)
    lines = [f"| {' | '.join(row)} |" for row in rows]
    return f"As of {datetime.now(UTC):%Y-%m-%d}, {len(every)} packages:\n\n" + "\n".join(lines)


def main() -> int:
    """Print the table, and write it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="put it into docs/platforms.md")
    options = parser.parse_args()
    text = table()
    print(text)
    if options.write:
        before, _, rest = PAGE.read_text("utf-8").partition(BEGIN)
        PAGE.write_text(f"{before}{BEGIN}\n{text}\n{END}{rest.partition(END)[2]}", "utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
