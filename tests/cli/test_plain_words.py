"""What a command says where an extra, a cloud, a folder or room on the disk is missing: a sentence, no traceback."""

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from farfield.cli import main
from farfield.errors import EXTRAS, MissingExtraError

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def sweeps(tmp_path: Path) -> Path:
    folder = tmp_path / "sweeps"
    folder.mkdir()
    rng = np.random.default_rng(0)
    np.save(folder / "0.npy", rng.uniform([1, -20, -2, 0], [60, 20, 1, 1], (500, 4)).astype(np.float32))
    (folder / "0.json").write_text(
        '{"boxes": [{"label": "vehicle", "centre_m": [20, 0, -1], "size_m": [4, 2, 1.5], "yaw_rad": 0}]}'
    )
    return folder


def without(tmp_path: Path, *packages: str) -> dict[str, str]:
    """An environment in which these packages are not installed."""
    for name in packages:
        folder = tmp_path / "blocked" / name
        folder.mkdir(parents=True)
        (folder / "__init__.py").write_text(f"raise ModuleNotFoundError('absent', name={name!r})\n")
    return {**os.environ, "PYTHONPATH": f"{tmp_path / 'blocked'}{os.pathsep}{ROOT / 'src'}"}


@pytest.mark.parametrize(
    ("absent", "words"),
    [
        ("numba", ["simulate", "kradar-sim-mini", "out", "--frames", "1", "--sensors", "cells"]),
        ("embreex", ["demo", "--frames", "2", "--sequences", "1", "--out", "out"]),
        ("lightning_fabric", ["train", "pointpillars-cirrus-sim"]),
        ("torch", ["train", "pointpillars-cirrus-sim"]),
        ("torch", ["evaluate", "pointpillars-cirrus-sim", "data"]),
        ("safetensors", ["predict", "pointpillars-cirrus-sim", "data"]),
        ("torch", ["detectors"]),
        ("torch", ["reproduce", "cirrus"]),
    ],
)
def test_a_missing_extra_is_told_with_advice(tmp_path: Path, sweeps: Path, absent: str, words: list[str]) -> None:
    sweeps.rename(tmp_path / "data")
    command = [sys.executable, "-m", "farfield.cli", *words]
    done = subprocess.run(command, cwd=tmp_path, env=without(tmp_path, absent), capture_output=True, text=True)
    assert "Traceback" not in done.stderr, done.stderr
    assert done.returncode == (0 if words == ["detectors"] else 1), done.stdout + done.stderr
    if done.returncode:
        assert "install" in done.stderr
        assert absent.replace("_", "-") in done.stderr.replace("_", "-")


def test_every_extra_s_module_is_known() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    listed = {extra: {word.partition(">")[0] for word in words} for extra, words in extras.items() if extra != "all"}
    assert {extra for extra, _ in EXTRAS.values()} == set(listed)
    assert all(package in listed[extra] for extra, package in EXTRAS.values())
    names = {package for _, package in EXTRAS.values()}
    packages = {package for packages in listed.values() for package in packages}
    assert names == {package for package in packages if not package.startswith("farfield[")}  # another extra of ours


def test_advice_fits_the_way_of_installing(monkeypatch: pytest.MonkeyPatch) -> None:
    from farfield.errors import wording

    asked = ["embreex>=4.4", "numba>=0.61"]
    monkeypatch.setattr(wording, "_installed_from", lambda: ("index", ""))
    assert 'pip install "farfield[simulate]"' in str(MissingExtraError("embreex", "simulate", "It"))
    monkeypatch.setattr(wording, "_installed_from", lambda: ("editable", "checkouts/far field"))
    assert 'pip install -e "checkouts/far field[simulate]"' in str(MissingExtraError("embreex", "simulate", "It"))
    monkeypatch.setattr(wording, "_installed_from", lambda: ("file", ""))
    monkeypatch.setattr(wording, "_requirements", lambda extra: asked)
    assert 'pip install "embreex>=4.4" "numba>=0.61"' in str(MissingExtraError("embreex", "simulate", "It"))


@pytest.mark.parametrize("verb", ["predict", "evaluate", "show"])
def test_an_unknown_cloud_is_told(sweeps: Path, capsys: pytest.CaptureFixture[str], verb: str) -> None:
    flag = "--clouds" if verb == "evaluate" else "--cloud"
    words = [str(sweeps)] if verb == "show" else ["pointpillars-cirrus-sim", str(sweeps)]
    assert main([verb, *words, flag, "foo"]) == 1
    told = capsys.readouterr().err
    assert told.strip().splitlines()[-1].startswith(f"farfield {verb}: ")
    assert "foo" in told


def test_a_picture_s_folder_is_made(sweeps: Path, tmp_path: Path) -> None:
    picture = tmp_path / "new" / "a.png"
    words = ["predict", "pointpillars-cirrus-sim", str(sweeps), "--out", str(tmp_path / "b.csv")]
    assert main([*words, "--picture", str(picture)]) == 0
    assert picture.is_file()


def test_a_folder_without_evaluation_is_told(sweeps: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", str(sweeps)]) == 1
    assert f"{sweeps}: expected evaluation.json" in capsys.readouterr().err


def test_what_the_system_refuses_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert main(["simulate", "cirrus-sim-mini", str(tmp_path / "file" / "out")]) == 1
    told = capsys.readouterr().err
    assert str(tmp_path / "file") in told
    assert "Errno" not in told
    assert main(["simulate", "cirrus-sim-mini", "/dev/full"]) == 1
