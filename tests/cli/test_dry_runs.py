"""``--dry-run`` of every verb that writes much: what, where, how much; no file comes or changes."""

import hashlib
import json
import re
from pathlib import Path

import numpy as np
import pytest
from face_model import has_face_model
from PIL import Image

from farfield.cli import main


def files(folder: Path) -> dict[str, str]:
    found = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in found} | {
        str(path.relative_to(folder)): "folder" for path in folder.rglob("*") if path.is_dir()
    }


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of two sweeps, a CSV of boxes, two pictures and two lists of stamps."""
    monkeypatch.chdir(tmp_path)
    rows = np.random.default_rng(0).uniform([2, -20, -2, 0], [60, 20, 0, 1], (300, 4)).astype(np.float32)
    for folder in ("own", "photos", "stamps"):
        (tmp_path / folder).mkdir()
    for name in "01":
        np.save(tmp_path / "own" / f"{name}.npy", rows)
        Image.fromarray(np.full((40, 60, 3), 90, np.uint8)).save(tmp_path / "photos" / f"{name}.png")
        (tmp_path / "stamps" / f"{name}.txt").write_text("".join(f"{100 + 0.1 * n:.1f}\n" for n in range(30)))
    head = "sequence,frame,label,x,y,z,l,w,h,yaw_rad,score\n"
    boxes = "".join(f"a,{n},vehicle,{20 + n},1,-1,4.4,1.9,1.6,0,0.9\n" for n in range(3))
    (tmp_path / "found.csv").write_text(head + boxes)
    return tmp_path


def said(words: list[str], here: Path, capsys: pytest.CaptureFixture[str]) -> str:
    before = files(here)
    assert main([*words, "--dry-run"]) == 0, capsys.readouterr().err
    assert files(here) == before
    text = capsys.readouterr().out
    assert text.rstrip().endswith("nothing is written now"), text
    return text


def test_light_verbs(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = said(["convert", "own", "as_kitti", "--to", "kitti"], here, capsys)
    assert re.search(r"would write 2 frames of folder as kitti to as_kitti, from [\d.]+ kB of files", text)
    assert "2 sweeps of 1 drive" in said(["odometry", "own"], here, capsys)
    text = said(["track", "found.csv", "--out", "tracks.csv"], here, capsys)
    assert "tracks of 3 boxes in 3 frames to tracks.csv" in text
    text = said(["sync", "stamps"], here, capsys)
    assert re.search(r"60 messages of 2 streams.* to runs/sync-stamps", text)


def test_faults_are_told_as_they_are_without_it(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words in (
        ["convert", "own", "own", "--to", "kitti"],
        ["track", "found.csv", "--out", "found.csv"],
        ["anonymize", "photos", "photos/below"],
        ["sync", "stamps", "--to", "absent"],
    ):
        assert main([*words, "--dry-run"]) == 1, words
        assert "expected" in capsys.readouterr().err


def test_simulate(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("embreex")
    pytest.importorskip("rosbags")
    said(["simulate", "cirrus-sim-mini", "sim", "--frames", "3"], here, capsys)
    words = ["simulate", "cirrus-sim", "raw", "--recording", "--frames", "60", "--sequences", "1"]
    text = said(words, here, capsys)
    assert "6 s of raw streams in 1 bag, 2 of 2 files still to write" in text
    assert re.search(r"at most [\d.]+ [kMG]B", text)


@pytest.mark.skipif(not has_face_model(), reason="no model of faces")
def test_anonymize(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = said(["anonymize", "photos", "covered", "--no-plates"], here, capsys)
    assert re.search(r"would write 2 pictures .* to covered, from [\d.]+ [kM]B of files", text)


def test_detecting_verbs(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("torch")
    text = said(["predict", "pointpillars-cirrus-sim", "own", "--out", "new/found.csv"], here, capsys)
    assert "boxes of 2 frames as boxes-csv to new/found.csv" in text
    text = said(["evaluate", "pointpillars-cirrus-sim", "own"], here, capsys)
    assert re.search(r"2 frames, cloud lidar.* to runs/evaluation-pointpillars-cirrus-sim-own", text)
    text = said(["train", "pointpillars-cirrus-sim", "-o", "training.steps=7"], here, capsys)
    assert re.search(r"7 steps.* to runs/pointpillars-cirrus-sim", text)


def test_adapt(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("torch")
    pytest.importorskip("embreex")
    words = ["adapt", "pointpillars-cirrus-sim", "own", "--source-frames", "4", "--steps", "60"]
    text = said(words, here, capsys)
    assert re.search(r"source: 4 frames .*at most [\d.]+ [kMG]B", text, re.DOTALL)
    assert "2 sweeps searched 3 times, 2 rounds of 30 steps" in text
    assert "to runs/adapted-own" in text
    assert main([*words, "--dry-run", "--clouds", "absent"]) == 1


def test_reproduce_and_demo(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("torch")
    pytest.importorskip("embreex")
    text = said(["reproduce", "cirrus"], here, capsys)
    assert re.search(r"\d+ trainings", text)
    assert re.search(r"\d+ simulated frames, at most [\d.]+ [kMGT]B", text)
    assert "to runs/reproduce-cirrus-laptop" in text
    assert "core minutes" not in text  # these are measured by --plan
    assert "to runs/reproduce-kradar-transfer" in said(["reproduce", "kradar", "--transfer"], here, capsys)
    assert "about 1 minute" in said(["demo"], here, capsys)


def test_the_score_is_json_on_the_output(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As of the other verbs, ``--json -`` is no file of that name."""
    words = ["score", "found.csv", "found.csv", "--label", "vehicle", "--replicates", "0", "--json", "-"]
    main(words)
    assert "dds" in json.loads(capsys.readouterr().out)
    assert not (here / "-").exists()
