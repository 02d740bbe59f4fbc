"""``farfield demo --radar``: what it says, what it refuses, and the whole of it where the weights are there."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("torch")

from farfield.cli import demo, main
from farfield.detectors.weights import bundled_weights
from farfield.evaluation.record import Evaluation

ROOT = Path(__file__).resolve().parents[2]
WEIGHTS = ("rtnh-kradar-sim", "pointpillars-kradar-sim")
CORE_SECONDS = 240


def interrupted(*_: object, **__: object) -> None:
    raise KeyboardInterrupt


def test_it_says_first_how_long_it_takes(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("farfield.api.load_detector", interrupted)
    assert main(["demo", "--radar", "--out", str(tmp_path / "d")]) == 130
    said = capsys.readouterr().out.splitlines()[0]
    assert re.search(r"10 drives .*20 frames in normal weather and the same in sleet: about \d+ minutes? on two", said)
    assert demo.seconds_of(60, radar=True) > demo.seconds_of(40, radar=True) > demo.seconds_of(4, radar=True)


def test_the_demo_without_radar_stays_what_it_was(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("farfield.simulation.recording.record", interrupted)
    assert main(["demo", "--out", str(tmp_path / "d")]) == 130
    assert capsys.readouterr().out.startswith("20 frames of 4 roads: about 1 minute on two cores\n")


@pytest.mark.parametrize("words", [["--frames", "5"], ["--frames", "4", "--sequences", "3"], ["--sequences", "0"]])
def test_frames_that_do_not_go_round_are_refused(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["demo", "--radar", *words, "--out", str(tmp_path / "d")]) == 1
    assert "--frames: with --radar expected an even number" in capsys.readouterr().err
    assert not (tmp_path / "d").exists()


def core_seconds(folder: Path, *words: str) -> tuple[str, float]:
    """What the demo prints with nothing but a processor, and the processor time of all its processes."""
    command = [sys.executable, "-m", "farfield.cli", "demo", "--radar", *words]
    environment = {**os.environ, "CUDA_VISIBLE_DEVICES": "", "PYTHONPATH": str(ROOT / "src")}
    before = os.times()
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    after = os.times()
    assert done.returncode == 0, done.stderr
    taken = after.children_user + after.children_system - before.children_user - before.children_system
    return done.stdout, taken


@pytest.mark.slow
@pytest.mark.whole
def test_the_whole_demo(tmp_path: Path) -> None:
    said, seconds = core_seconds(tmp_path)
    assert seconds < CORE_SECONDS
    out = tmp_path / "farfield-demo" / "radar-evaluation"
    *_, picture, page = said.strip().splitlines()
    assert picture == f"picture: {(out / 'weathers.jpg').resolve()}"
    assert page == f"report: {(out / 'report.html').resolve()}"
    head = next(line for line in said.splitlines() if line.startswith("AP_3d"))
    assert head.split()[-2:] == ["normal", "sleet"]
    for name in WEIGHTS:
        row = next(line for line in said.splitlines() if line.startswith(f"{name} ("))
        assert len(re.findall(r"\d+\.\d \[\d+\.\d, \d+\.\d\]", row)) == 2, row
    subjects = re.sub(r"\s+", " ", said)
    assert subjects.count("seen in training: not known") == 2
    assert "kradar" in subjects
    evaluation = Evaluation.load(out)
    assert set(evaluation.results) == {"radar", "os2-64"}
    by_weather = evaluation.results["radar"]["counts"]["conditions"]["weather"]
    assert [by_weather[weather]["frames"] for weather in ("normal", "sleet")] == [20, 20]
    assert [view.frame.conditions["weather"] for view in evaluation.frames] == ["normal", "sleet"]
    assert (out / "weathers.jpg").stat().st_size < 300_000
    assert "https://" not in re.sub(r'(href|xmlns\S*)="[^"]*"', "", (out / "report.html").read_text("utf-8"))
    again, less = core_seconds(tmp_path)
    assert again.count(", 0 still to write") == 2
    assert less < seconds / 2
    table = slice(said.index("AP_3d at IoU"), said.index("\ndone in"))
    assert said[table] in again


def test_the_weights_load_without_a_network_and_say_where_they_come_from() -> None:
    import farfield as ff

    for name, kind, cloud in zip(WEIGHTS, ("radar", "lidar"), ("radar", "os2-64"), strict=True):
        detector = ff.load_detector(name)
        assert (detector.name, detector.kind, detector.reference) == (name, kind, "radar")
        assert detector.learnt_clouds == (cloud,)
        trained = detector.provenance["experiment"]
        assert trained["training"]["steps"] == 1500
        assert not Path(trained["data"]["path"]).is_absolute()
        assert detector.provenance["frames"] == 928
        assert bundled_weights()[name].stat().st_size < 9_000_000
