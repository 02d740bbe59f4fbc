"""Frames that are not trained on: which they are, what is logged of them, and that nothing changes by it."""

import json
from pathlib import Path
from typing import Any

import pytest

torch = pytest.importorskip("torch")

from farfield.datasets import open_dataset
from farfield.errors import ConfigError, DatasetError
from farfield.experiments.frames import held_out
from farfield.training.checkpoints import load_checkpoint

PATTERN = {"labelled": {"clouds": ["gaussian", "uniform"]}}
DEVICES = {"source": {}, "target": {"clouds": ["uniform"]}}
NEAR = {"name": "range", "near_m": [0, 30], "far_m": [30, 64], "local": None}


def rows_of(folder: Path) -> list[dict[str, float]]:
    return [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]


def test_whole_sequences_are_held_out_where_there_are_others(data: Path) -> None:
    frames = open_dataset(data)
    assert len(set(frames.sequences)) == 1
    trained, held = held_out(frames, 1)
    assert held is not None
    assert trained.keys + held.keys == frames.keys  # of a single sequence its end
    assert held_out(frames, 0) == (frames, None)
    with pytest.raises(DatasetError, match="expected more than 3 frames"):
        held_out(frames, 3)


@pytest.mark.parametrize(
    ("method", "streams", "detector"),
    [
        (NEAR, None, "pointpillars"),
        ({"name": "pattern"}, PATTERN, "sparsecentre"),
        ({"name": "device", "norm": "per_domain"}, DEVICES, "pointpillars"),
    ],
    ids=["range", "pattern", "device"],
)
def test_domains_are_told_on_held_out_frames_and_gradients_measured(
    planned: Any, method: dict[str, Any], streams: Any, detector: str
) -> None:
    plan = planned("run", {**method, "held_out": 1}, detector, streams)
    plan.run()
    last = rows_of(plan.folder)[-1]
    assert 0 <= last["held_accuracy"] <= 1
    name = next(name for name in ("global", "unpaired", "device") if name in last)
    assert last["gradient_detection"] > 0
    assert last[f"gradient_{name}"] > 0
    assert last["gradient_ratio"] == pytest.approx(last[f"gradient_{name}"] / last["gradient_detection"])
    assert any(name.startswith("held_loss_") for name in last)


def test_looking_changes_no_bit(planned: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same frames are trained on; only one run looks at those that are held out, and measures gradients."""
    plan = planned("looking", {**NEAR, "held_out": 1})
    plan.run()
    monkeypatch.setattr("farfield.training.loop._LOOKS", 0)
    monkeypatch.setattr("farfield.adaptation.base.Adaptation.measures", lambda *_: False)
    blind = planned("blind", {**NEAR, "held_out": 1})
    blind.run()
    assert "held_accuracy" in rows_of(plan.folder)[-1]
    assert not {"held_accuracy", "gradient_detection"} & rows_of(blind.folder)[-1].keys()
    one, other = (load_checkpoint(each.folder / "checkpoint.pt") for each in (plan, blind))
    assert all(torch.equal(one[name], other[name]) for name in one if name.startswith("modules/"))


def test_a_negative_number_is_refused(planned: Any) -> None:
    with pytest.raises(ConfigError, match="held_out: expected 0 or more"):
        planned("run", {**NEAR, "held_out": -1}).run()
