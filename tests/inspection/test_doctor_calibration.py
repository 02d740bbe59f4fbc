"""``farfield doctor --calibration``: noise is not accused, and the verdicts read as sentences."""

from pathlib import Path

import pytest
from drive import frame

from farfield.calibration.checking import CalibrationCheck
from farfield.cli.doctor import run
from farfield.datasets import open_dataset
from farfield.datasets.kradar.writer import KRadarWriter
from farfield.inspection.doctor import examine
from farfield.inspection.doctor.calibration import _finding


def test_noise_accuses_nobody(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    writer = KRadarWriter(tmp_path / "set", columns=512)
    for number in (1, 2):
        writer.write(frame(number))
    writer.finish()
    report = examine(open_dataset(writer.root), calibration=2)
    found = {each.topic: each for each in report.findings if each.topic.startswith("calibration of")}
    assert {"calibration of cam-front", "calibration of radar"} <= set(found)
    assert all(each.severity == "ok" for each in found.values()), found
    assert report.facts["calibration"]["cam-front"]["verdict"] == "not told"
    assert not any(each.topic.startswith("calibration of") for each in examine(open_dataset(writer.root)).findings)
    run(writer.root, calibration=2)
    assert "calibration of cam-front" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("verdict", "severity", "words"),
    [
        ("fits", "ok", "fits 12 frames"),
        ("off", "warn", "1.00 degrees, 5 cm, 9.0 px away"),
        ("moved", "warn", "2.00 degrees, 7 cm between"),
        ("not told", "ok", "do not tell"),
    ],
)
def test_each_verdict_is_a_sentence(verdict: str, severity: str, words: str) -> None:
    check = CalibrationCheck(
        verdict=verdict, degrees=1.0, cm=5.0, px=9.0, drift_degrees=2.0, drift_cm=7.0, frames=12, evidence=4.0
    )
    found = _finding("cam-front", check, "farfield calibrate")
    assert found.severity == severity
    assert words in found.what
    assert bool(found.fix) == (severity == "warn")


def test_it_is_said_how_many_frames_would_tell() -> None:
    check = CalibrationCheck(
        verdict="not told",
        degrees=0.0,
        cm=0.0,
        px=0.0,
        drift_degrees=0.0,
        drift_cm=0.0,
        frames=24,
        evidence=1.0,
        needed=130,
    )
    assert "about 130 frames needed to find errors of 40 cm and 1 degree" in _finding("radar", check, "").what
