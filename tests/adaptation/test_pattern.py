"""Adaptation between scan patterns: streams of pairs, runs, controls and the paired loss."""

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from small import small_detector

from farfield.adaptation.cells import Cells
from farfield.adaptation.pattern import PatternAdaptation, pair_distance, shared_cells
from farfield.datasets import open_dataset
from farfield.errors import ConfigError
from farfield.frame import Frame
from farfield.training.checkpoints import load_checkpoint
from farfield.training.config import AugmentationConfig
from farfield.training.method import Stream
from farfield.training.samples import TrainingSample, TrainingSamples, batch_shares, batches

CLOUDS = ("gaussian", "uniform")
BOTH = {"labelled": {"clouds": list(CLOUDS)}}


def samples_of(data: Path, stream: Stream, clouds: Any = CLOUDS, **changes: Any) -> TrainingSamples:
    network = small_detector("pointpillars")
    return TrainingSamples(
        open_dataset(data),
        inputs=network.inputs,
        clouds=clouds,
        classes=("vehicle",),
        assigner=network.assigner,
        augmentation=AugmentationConfig(**changes),
        stream=stream,
    )


@pytest.mark.parametrize("pasted", [{}, {"vehicle": 3}])
def test_both_clouds_of_a_pair_are_changed_alike(data: Path, pasted: dict[str, int]) -> None:
    """An object that both hold lies in one box; without pasting the clouds are the frame's, moved by one motion."""
    changes = {"rotation_rad": 0.5, "scale": 0.1, "pasted": pasted}
    samples = samples_of(data, Stream(members="paired", boxes=True), **changes)
    assert len(samples) == 6
    frames = set()
    for unit in range(6):
        one, other = samples[2 * unit], samples[2 * unit + 1]
        assert one.boxes is not None
        assert other.boxes is not None
        places = [{tuple(np.round(centre, 6)) for centre in each.boxes.centre_m} for each in (one, other)]
        assert places[0] & places[1]  # boxes that one cloud has no point in are its own
        assert one.boxes.point_count.min() >= 1
        assert not torch.equal(one.inputs["points"][:5], other.inputs["points"][:5])
        frames.add(round(float(one.boxes.centre_m.sum()), 3))
    assert len(frames) == 6  # three frames, changed anew each time
    again = samples_of(data, Stream(members="paired", boxes=True), **changes)[5]
    assert torch.equal(again.inputs["points"], samples[5].inputs["points"])  # its pair was not asked for before


STILL = {"flip_probability": 0.0, "rotation_rad": 0.0, "scale": 0.0}


@cache
def frames_of(data: Path) -> list[Frame]:
    return list(open_dataset(data))


def which_frame(sample: TrainingSample, data: Path, cloud: str) -> int:
    """The frame whose cloud an unchanged sample is."""
    points = sample.inputs["points"].numpy()
    clouds = [frame.cloud(cloud).points_m for frame in frames_of(data)]
    return next(i for i, each in enumerate(clouds) if each.shape == points.shape and np.allclose(each, points))


def test_unchanged_pairs_are_the_clouds_of_a_frame(data: Path) -> None:
    samples = samples_of(data, Stream(members="paired"), **STILL)
    first = [which_frame(samples[place], data, "gaussian") for place in (0, 2, 4)]
    assert sorted(first) == [0, 1, 2]
    assert [which_frame(samples[place], data, "uniform") for place in (1, 3, 5)] == first


def test_clouds_apart_take_turns_and_come_from_other_frames(data: Path) -> None:
    samples = samples_of(data, Stream(members="apart"), **STILL)
    drawn = [[which_frame(samples[2 * unit + m], data, name) for unit in range(12)] for m, name in enumerate(CLOUDS)]
    for frames in drawn:
        assert all(sorted(frames[start : start + 3]) == [0, 1, 2] for start in range(0, 12, 3))
    assert drawn[0] != drawn[1]


def test_pairs_stay_together_whatever_the_processes(data: Path) -> None:
    stream = Stream(members="paired")
    samples = {"labelled": samples_of(data, stream)}
    counts = batch_shares(4, {"labelled": stream}, 2, {"labelled": 2})
    whole = next(batches(samples, counts, first_step=0, steps=1, workers=0))["labelled"]
    parts = [next(batches(samples, counts, first_step=0, steps=1, workers=0, rank=r, world=2)) for r in (0, 1)]
    joined = [sample for part in parts for sample in part["labelled"]]
    assert len(whole) == len(joined) == 4
    for one, other in zip(whole, joined, strict=True):
        assert torch.equal(one.inputs["points"], other.inputs["points"])
    with pytest.raises(ConfigError, match="2 samples that stay together"):
        batch_shares(6, {"labelled": stream}, 2, {"labelled": 2})


def test_pairs_need_two_clouds(data: Path) -> None:
    with pytest.raises(ConfigError, match=r"at least two clouds a frame.*paired; got gaussian"):
        samples_of(data, Stream(members="paired"), clouds=("gaussian",))


METHODS = {
    "paired": {"loss": "paired"},
    "cosine": {"loss": "paired", "paired": {"form": "cosine"}},
    "unpaired": {"loss": "unpaired"},
    "unpaired in pairs": {"loss": "unpaired", "batches": "paired", "unpaired": {"labels": "coin", "smoothing": 0.1}},
    "none": {"loss": "none", "batches": "paired"},
}


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("detector", ["pointpillars", "sparsecentre"])
def test_pattern_trains(planned: Any, name: str, detector: str) -> None:
    plan = planned("run", {"name": "pattern", **METHODS[name]}, detector, BOTH, steps=2)
    plan.run()
    rows = [json.loads(line) for line in (plan.folder / "log.jsonl").read_text().splitlines()]
    assert {"variance_first", "variance_second", "rank_first", "rank_second"} <= set(rows[-1])
    loss = METHODS[name]["loss"]
    if loss == "unpaired":
        assert rows[0]["unpaired"] == pytest.approx(np.log(2), abs=0.1)
        assert rows[-1]["lambda"] > 0
    elif loss == "paired":
        assert rows[0]["paired"] == 0 < rows[-1]["paired"]
        assert rows[-1]["pairs"] > 10
    else:
        assert "lambda" not in rows[-1]


def test_without_weight_both_losses_are_none_to_the_bit(planned: Any) -> None:
    found = {}
    for folder, method in (
        ("plain", {"loss": "none", "batches": "paired"}),
        ("paired", {"loss": "paired", "paired": {"weight": 0}}),
        ("unpaired", {"batches": "paired", "unpaired": {"lambda_max": 0}}),
        ("on", {"loss": "paired"}),
    ):
        plan = planned(folder, {"name": "pattern", **method}, "pointpillars", BOTH)
        plan.run()
        state = load_checkpoint(plan.folder / "checkpoint.pt")
        found[folder] = {name: value for name, value in state.items() if name.startswith("modules/detector")}
    for name, value in found["plain"].items():
        assert torch.equal(value, found["paired"][name])
        assert torch.equal(value, found["unpaired"][name])
    assert not all(torch.equal(value, found["on"][name]) for name, value in found["plain"].items())


def test_cells_that_both_hold_come_in_one_order() -> None:
    frame = torch.tensor([0, 0, 0, 1, 1, 2, 3, 3])
    cell = torch.tensor([1, 4, 7, 4, 8, 3, 2, 3])
    row = torch.arange(8)
    one, other = shared_cells(Cells(row, frame, cell, torch.zeros(8, 2), row), 10)
    assert one.row.tolist() == [1, 5]
    assert other.row.tolist() == [3, 7]


def test_distances_of_pairs_by_hand() -> None:
    one = torch.tensor([[1.0, 0.0], [3.0, 4.0]], requires_grad=True)
    other = torch.tensor([[0.0, 2.0], [3.0, 0.0]])
    assert pair_distance(one, other, "plain").tolist() == [2.5, 8.0]
    mean_variance = ((1 + 4) / 2 + (2.25 + 1) / 2) / 2
    free = pair_distance(one, other, "scale_free")
    torch.testing.assert_close(free, torch.tensor([2.5, 8.0]) / mean_variance)
    torch.testing.assert_close(pair_distance(one * 7, other * 7, "scale_free"), free)
    torch.testing.assert_close(pair_distance(one, other, "cosine"), torch.tensor([1.0, 0.4]))
    free.sum().backward()
    torch.testing.assert_close(one.grad, (one - other).detach() / mean_variance)  # none through the variance


def test_pairs_and_shuffled_batches_exclude_each_other() -> None:
    with pytest.raises(ConfigError, match="shuffled ones hold no pairs"):
        PatternAdaptation(small_detector("pointpillars"), loss="paired", batches="shuffled")
    with pytest.raises(ConfigError, match="losses: no such key"):
        PatternAdaptation(small_detector("pointpillars"), losses="paired")
