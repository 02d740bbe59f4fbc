"""``farfield demo --real``: what it says, what it refuses, and the whole of it where the weights are there."""

from pathlib import Path

import pytest

from farfield.cli import demo, main
from farfield.detectors.weights import bundled_weights
from farfield.evaluation.record import Evaluation


def test_it_says_what_it_would_write_and_writes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--real", "--dry-run", "--out", str(tmp_path / "d")]) == 0
    assert "open-sweeps and street.jpg" in capsys.readouterr().out
    assert not (tmp_path / "d").exists()


@pytest.mark.parametrize("words", [["--radar"], ["--frames", "4"], ["--sequences", "2"]])
def test_what_only_a_simulation_has_is_refused(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["demo", "--real", *words, "--out", str(tmp_path / "d")]) == 1
    assert f"{words[0]}: expected a demo of simulated frames" in capsys.readouterr().err


@pytest.mark.slow
def test_a_real_street_is_scored_and_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("torch")
    if "pointpillars-cirrus-sim" not in bundled_weights():
        pytest.skip("no weights")
    assert main(["demo", "--real", "--out", str(tmp_path)]) == 0
    assert "AP at 2 m on Open Sweeps" in capsys.readouterr().out
    assert (tmp_path / demo.STREET_PICTURE).read_bytes()[:2] == b"\xff\xd8"
    evaluation = Evaluation.load(tmp_path / "real-evaluation")
    (result,) = evaluation.results.values()
    assert 0.1 < result["ap"]["2.0"] <= 1
    assert result["protocol"] == "open-sweeps"
    assert result["subject"]["seen_in_training"].startswith("none of the 12 frames")
