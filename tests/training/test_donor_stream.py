"""Training on several data sets at once, donors and mined negatives among them."""

import copy
import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from farfield.datasets.memory import InMemory
from farfield.detectors import build_detector
from farfield.detectors.pointpillars.network import PointPillarsConfig
from farfield.detectors.runtime import Detector
from farfield.errors import ConfigError, FileFormatError
from farfield.experiments import plan
from farfield.experiments.plan import Plan
from farfield.experiments.schema import dump_experiment, experiment_of, load_experiment
from farfield.frame import Annotation, Boxes, Cloud, Frame
from farfield.training.augmentation import ObjectBank, augment, cut_out, drop_lines, scale_objects
from farfield.training.config import UNCHANGED, AugmentationConfig
from farfield.training.mixed import family_of
from farfield.training.negatives import false_boxes, load_negatives, mine, save_negatives
from farfield.training.samples import TrainingSamples
from farfield.vocabulary.classes import CLUTTER, UNSURE


def boxes_at(*places: tuple[float, float], label: str = "vehicle", score: float | None = None) -> Boxes:
    centre = np.array([[x, y, -1.0] for x, y in places]).reshape(-1, 3)
    size = np.tile([4.4, 1.8, 1.6], (len(places), 1))
    scores = None if score is None else np.full(len(places), score)
    return Boxes(centre_m=centre, size_m=size, yaw_rad=np.zeros(len(places)), label=[label] * len(places), score=scores)


def blob(x: float, y: float, rng: np.random.Generator, count: int = 60) -> np.ndarray:
    return rng.uniform([x - 2, y - 0.8, -1.7], [x + 2, y + 0.8, -0.3], (count, 3)).astype(np.float32)


def frame_of(index: int, rng: np.random.Generator) -> Frame:
    """A car at 20 m, and at 30 m what looks like one."""
    ground = np.column_stack([rng.uniform(2, 60, 400), rng.uniform(-15, 15, 400), rng.normal(-1.8, 0.02, 400)])
    points = np.concatenate([ground.astype(np.float32), blob(20, 0, rng), blob(30, 6, rng)])
    frame = Frame.of(Cloud(points, np.zeros(len(points), dtype=np.float32)), boxes_at((20.0, 0.0)))
    return replace(frame, sequence="a", frame_id=str(index))


def samples_of(data: InMemory, network: torch.nn.Module, **changes: object) -> TrainingSamples:
    settings = {
        "inputs": network.inputs,
        "clouds": ("lidar",),
        "classes": ("vehicle",),
        "assigner": network.assigner,
        "augmentation": UNCHANGED,
        **changes,
    }
    return TrainingSamples(data, **settings)


PILLARS = PointPillarsConfig.model_validate(
    {
        "grid": {"range_m": 64.0, "half_width_m": 16.0, "cell_m": 0.5},
        "anchors": {"vehicle": {"size_m": [4.4, 1.8, 1.6], "z_m": -1.0}},
        "widths": [8, 16, 16],
        "depths": [0, 0, 0],
        "neck_width": 16,
    }
)


def test_false_boxes_are_those_near_no_object_and_in_nothing_unsure() -> None:
    detected = boxes_at((20.5, 0.3), (30.0, 6.0), (40.0, 0.0), (50.0, 0.0), score=0.5)
    detected = detected.replace(score=np.array([0.9, 0.8, 0.7, 0.1]))
    annotated = Boxes.concatenate([boxes_at((20.0, 0.0)), boxes_at((40.0, 1.0), label=UNSURE)])
    assert false_boxes(detected, Annotation(boxes=annotated), 0.2).centre_m[:, 0].tolist() == [30.0]


def test_a_long_body_is_no_false_box_at_its_end() -> None:
    truck = boxes_at((20.0, 0.0)).replace(size_m=np.array([[16.0, 2.5, 3.5]]))
    assert not len(false_boxes(boxes_at((26.0, 0.0), score=0.9), Annotation(boxes=truck), 0.2))


def test_mined_negatives_are_pasted_without_a_box(rng: np.random.Generator, tmp_path: Path) -> None:
    data = InMemory([frame_of(index, rng) for index in range(2)])
    mined = mine(lambda frame: boxes_at((20.0, 0.0), (30.0, 6.0), score=0.6), data)
    save_negatives(tmp_path / "negatives.json", {"labelled": mined})
    negatives = load_negatives(tmp_path / "negatives.json")["labelled"]
    assert set(negatives) == set(data.keys)
    np.testing.assert_allclose(negatives[data.keys[0]].centre_m, [[30.0, 6.0, -1.0]])
    network = build_detector(PILLARS, seed=0)
    config = AugmentationConfig(flip_probability=0, rotation_rad=0, scale=0, pasted={CLUTTER: 4})
    samples = samples_of(data, network, augmentation=config, negatives=negatives)
    bank = samples._bank.at(0)
    assert sorted(bank.objects) == [CLUTTER, "vehicle"]
    points, boxes = bank.paste(np.zeros((0, 6), dtype=np.float32), Boxes.empty(), {CLUTTER: 4}, rng)
    assert not len(boxes)
    assert 0 < len(points) < 200  # two stand at one place: one of them is pasted


def test_another_file_is_no_negatives(tmp_path: Path) -> None:
    path = tmp_path / "negatives.json"
    for text in (
        "{}",
        "[]",
        '{"format": "farfield-negatives-1", "streams": {"a": [["s", "f", [[1, 2]]]]}}',
        "nonsense",
    ):
        path.write_text(text)
        with pytest.raises(FileFormatError, match="mine anew"):
            load_negatives(path)


def test_a_mined_negative_lowers_the_score_at_its_place(rng: np.random.Generator) -> None:
    """What looks like a car and was never shown is taken for one; pasted from another frame, it is not."""
    frames = [frame_of(index, rng) for index in range(4)]
    bare = [replace(f, clouds={"lidar": f.cloud()[f.cloud().points_m[:, 0] < 27]}) for f in frames[1:]]
    clutter = {frames[0].key: boxes_at((30.0, 6.0), label=CLUTTER)}
    table = np.column_stack([frames[0].cloud().points_m, np.zeros((len(frames[0].cloud()), 2))]).astype(np.float32)
    bank, taken = ObjectBank(), cut_out(table, clutter[frames[0].key], min_points=5)
    bank.add(taken)
    network = build_detector(PILLARS, seed=0)
    learn(network, bare, {}, bank, steps=40)
    scores = [score_near(network, frames[0], 30, 6)]
    for count in (0, 1):
        other = copy.deepcopy(network)
        learn(other, bare, {CLUTTER: count}, bank, steps=30)
        scores.append(score_near(other, frames[0], 30, 6))
    assert scores[2] < 0.5 * min(scores[:2])


def learn(
    network: torch.nn.Module, frames: list[Frame], pasted: dict[str, int], bank: ObjectBank, *, steps: int
) -> None:
    """A few steps on some frames, with objects of a bank pasted."""
    config = UNCHANGED.model_copy(update={"pasted": pasted})
    optimizer = torch.optim.AdamW(network.train().parameters(), lr=8e-3)
    for step in range(steps):
        frame = frames[step % len(frames)]
        table = np.column_stack([frame.cloud().points_m, np.zeros((len(frame.cloud()), 2))]).astype(np.float32)
        points, boxes = augment(table, frame.boxes, config, np.random.default_rng(step), bank)
        cloud = torch.from_numpy(points[:, :3].copy())
        targets = [network.assigner(boxes, {"points": cloud.numpy()})]
        loss = sum(network.losses(network({"points": [cloud]}, targets), targets).values())
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()


@torch.no_grad()
def score_near(network: torch.nn.Module, frame: Frame, x: float, y: float) -> float:
    """The best score about a place."""
    logits = network.eval()({"points": [torch.from_numpy(frame.cloud().points_m.copy())]}).logits[0]
    rows = network.head.anchors.rows(np.arange(len(network.head.anchors)))
    return float(torch.sigmoid(logits[torch.from_numpy(np.hypot(rows[:, 0] - x, rows[:, 1] - y) < 2.0)]).max())


def test_unsure_boxes_travel_with_the_frame_and_are_ignored(rng: np.random.Generator) -> None:
    frame = frame_of(0, rng)
    unsure = boxes_at((30.0, 6.0), label=UNSURE)
    data = InMemory([Frame.of(frame.cloud(), Boxes.concatenate([frame.boxes, unsure]))])
    network = build_detector(PILLARS, seed=0)
    plain, ignoring = (samples_of(one, network)[0].targets for one in (InMemory([frame]), data))
    assert ignoring.positive.tolist() == plain.positive.tolist()
    assert len(ignoring.ignored) > len(plain.ignored)
    config = AugmentationConfig(flip_probability=1, rotation_rad=0, scale=0)
    mirrored = samples_of(data, network, augmentation=config)[0].targets
    grid = network.head.anchors
    y = grid.rows(np.setdiff1d(mirrored.ignored, grid.assign(frame.boxes, positive_m=1.0, ignore_m=2.0).ignored))[:, 1]
    assert (y < -4).all()
    assert "unsure" not in samples_of(data, network).names_left_out()


# Changes of another sensor


def test_objects_change_their_size_on_the_spot(rng: np.random.Generator) -> None:
    boxes = Boxes.concatenate(
        [boxes_at((20.0, 0.0)).replace(yaw_rad=np.array([0.5])), boxes_at((40.0, 0.0), label=UNSURE)]
    )
    points = np.column_stack([blob(20, 0, rng), np.zeros(60)]).astype(np.float32)
    moved, scaled = scale_objects(points, boxes, 0.15, rng)
    ratio = scaled.size_m / boxes.size_m
    assert (np.abs(ratio[0] - 1) <= 0.15).all()
    assert (ratio[0] != 1).all()
    assert (ratio[1] == 1).all()
    bottom = scaled.centre_m[:, 2] - scaled.size_m[:, 2] / 2
    np.testing.assert_allclose(bottom, boxes.centre_m[:, 2] - boxes.size_m[:, 2] / 2)
    np.testing.assert_allclose(scaled.centre_m[:, :2], boxes.centre_m[:, :2])
    assert not np.array_equal(moved, points)


def test_whole_lines_are_dropped(rng: np.random.Generator) -> None:
    elevation = np.repeat(np.deg2rad(np.arange(-20, 2, 1.0)), 50)
    azimuth = np.tile(np.linspace(-1, 1, 50), 22)
    points = 20 * np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], 1
    )
    stays = drop_lines(points.astype(np.float32), 0.9, rng).reshape(22, 50)
    assert (stays.all(axis=1) | ~stays.any(axis=1)).mean() > 0.9  # but for lines on a band's edge
    assert 0 < stays.mean() < 1


@pytest.mark.parametrize("key", ["object_scale", "line_dropout", "missing_sectors", "range_noise_m", "intensity_off"])
def test_the_changes_are_off_unless_asked_for(key: str, rng: np.random.Generator) -> None:
    ground = np.column_stack([rng.uniform(-30, 30, (800, 2)), rng.normal(-1.8, 0.02, 800), np.zeros(800)])
    points = np.concatenate([ground, np.column_stack([blob(20, 0, rng), np.zeros(60)])])
    points = np.column_stack([points, rng.uniform(0.1, 1, len(points))]).astype(np.float32)
    boxes = boxes_at((20.0, 0.0))
    plain = augment(points, boxes, UNCHANGED, np.random.default_rng(1), intensity=4)[0]
    np.testing.assert_array_equal(plain, points)
    assert key not in AugmentationConfig().model_dump()
    config = UNCHANGED.model_copy(update={key: 0.9 if key != "range_noise_m" else 0.03})
    assert key in config.model_dump()
    changed = [augment(points, boxes, config, np.random.default_rng(seed), intensity=4)[0] for seed in range(6)]
    assert any(len(one) != len(points) or not np.array_equal(one, points) for one in changed)


# Streams by name


def test_families_are_told_apart() -> None:
    simulated, real = {"simulated": True}, {"simulated": False}
    open_donors, own = ({"donors": {"family": family, "places": ["corner"]}} for family in ("open", "own"))
    assert family_of({"a": simulated}) == "simulation"
    assert family_of({"a": simulated, "b": open_donors}) == "simulation with open donors"
    assert family_of({"a": simulated, "b": open_donors, "c": own}) == "simulation with a user's sweeps"
    assert family_of({"a": real}) == "real sweeps"


MIXED = """
name: tiny
method: {name: mixed, shares: {sim: 1, donors: 1}}
data:
  sim: {path: DATA, clouds: [gaussian]}
  donors: {path: DONORS, clouds: [gaussian], donors: {copies: 2, vehicles: 6, sensor: luminar-h2}}
detector:
  grid: {range_m: 64.0, half_width_m: 16.0, cell_m: 0.5}
  widths: [8, 16, 16]
  depths: [0, 0, 0]
  neck_width: 16
  full_points: 5
augmentation: {pasted: {vehicle: 2, clutter: 2}, line_dropout: 0.3, object_scale: 0.1}
training:
  {steps: 3, batch_size: 2, precision: fp32, threads: 1, workers: 0, checkpoint_every_s: 0.001, log_every_steps: 1}
"""


def recorded(pasted: list[dict[str, int]], *arguments: Any, **settings: Any) -> TrainingSamples:
    pasted.append(dict(settings["augmentation"].pasted))
    return TrainingSamples(*arguments, **settings)


def test_one_detector_learns_from_several_data_sets(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pasted: list[dict[str, int]] = []
    monkeypatch.setattr(plan, "TrainingSamples", partial(recorded, pasted))
    path = tmp_path / "tiny.yaml"
    path.write_text(MIXED.replace("DATA", str(data)).replace("DONORS", str(data)))
    experiment = load_experiment(path)
    assert "donors" in dump_experiment(experiment)
    weights = Plan(experiment, tmp_path / "run").run()
    rows = [json.loads(line) for line in (tmp_path / "run" / "log.jsonl").read_text().splitlines()]
    assert len(rows) == 3
    info = Detector.load(weights, device="cpu").info
    assert info.family == "real sweeps with a user's sweeps"
    assert len(info.places) >= 1
    assert sorted(pasted, key=len) == [{CLUTTER: 2}, {"vehicle": 2, CLUTTER: 2}]  # donors have objects already


def test_donors_need_one_cloud() -> None:
    tree = {"name": "a", "data": {"path": "x", "clouds": ["gaussian", "uniform"], "donors": {}}}
    with pytest.raises(ConfigError, match="expected one cloud"):
        experiment_of(tree)
