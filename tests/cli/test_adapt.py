"""farfield adapt: arguments and words; the work itself is tested in tests/experiments."""

import inspect
import re
import shlex
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("torch")
pytest.importorskip("embreex")

from farfield.cli import main
from farfield.cli.adapt import run
from farfield.metrics import score_calibration

EXPERIMENT = """
name: tiny
data: {path: data, clouds: [gaussian], simulate: {preset: cirrus-sim-mini, sequences: 1, frames: 2, seed: 3}}
detector:
  {grid: {range_m: 64.0, half_width_m: 16.0, cell_m: 0.5}, widths: [8, 16, 16], depths: [0, 0, 0], neck_width: 16,
   score_threshold: 0.0, max_boxes: 20, candidates: 20}
training: {steps: 2, batch_size: 2, precision: fp32, threads: 1, workers: 0}
"""
QUICK = [word for name in ("workers=0", "precision=fp32", "threads=1") for word in ("-o", f"training.{name}")]


def test_a_trained_detector_is_adapted_by_one_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(score_calibration, "POSITIVE", 0.001)  # what has learnt next to nothing finds something
    monkeypatch.setattr(score_calibration, "NEGATIVE", 0.0)
    Path("tiny.yaml").write_text(EXPERIMENT)
    assert main(["train", "tiny.yaml"]) == 0
    words = ["adapt", "runs/tiny", "data", "--source-frames", "1", "--steps", "2", "--rounds", "2", *QUICK]
    assert main(words) == 0
    shown = capsys.readouterr()
    assert "weights: runs/adapted-data/weights.safetensors" in shown.out
    assert "report:" in shown.out
    assert "round 1 of 2:" in shown.err
    assert "in the end:" in shown.err
    assert Path("runs/adapted-data/report.html").stat().st_size > 20_000
    assert main(["predict", "runs/adapted-data", "data", "--out", "boxes.csv"]) == 0
    assert main([*words[:5], "--rounds", "1"]) == 1
    assert "it differs in overrides, rounds, steps" in capsys.readouterr().err


class StoppedError(Exception):
    """Raised where the work would begin."""


def stop(taken: list[dict[str, Any]], detector: str, data: Any, **given: Any) -> None:
    taken.append({"detector": detector, "data": data, **given})
    raise StoppedError


def opened(path: Path, **_: Any) -> Any:
    reader = SimpleNamespace(notes=(), assumptions=())
    return SimpleNamespace(root=Path(path), unwrapped=reader, remarks=())


def side_by_side(parts: Sequence[Any]) -> Any:
    return parts[0] if len(parts) == 1 else SimpleNamespace(**vars(parts[0]), parts=parts)


def test_its_examples_are_what_it_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[dict[str, Any]] = []
    monkeypatch.setattr("farfield.api.adapt", partial(stop, taken))
    monkeypatch.setattr("farfield.datasets.open_dataset", opened)
    monkeypatch.setattr("farfield.datasets.joined.joined", side_by_side)
    examples = re.findall(r"^ *farfield (adapt .*)$", inspect.getdoc(run) or "", re.MULTILINE)
    assert len(examples) == 10
    for example in examples:
        with pytest.raises(StoppedError):
            main(shlex.split(example))
    assert [each["detector"] for each in taken].count("pointpillars-cirrus-sim") == 9
    assert taken[1]["minutes"] == 60
    assert len(taken[2]["data"].parts) == 3
    assert taken[3]["source"] == Path("/data/kitti")
    assert taken[4]["labels"].root == Path("my-labelled-sweeps")
    assert taken[5]["learn_from"] == Path("my-sweeps")
    assert taken[6]["labels"].root == Path("other-drive")
    assert taken[7]["whole_bodies"]
    assert taken[8]["donors"] == 40
    assert taken[9]["overrides"] == ("method.strong.thinning=0.5",)
