"""The studio's verdicts on single boxes add up to what the protocols count."""

import numpy as np
import pytest

from farfield.frame import Annotation, Boxes
from farfield.metrics.centre.matching import found_by
from farfield.metrics.kradar.evaluation import match as kradar_match
from farfield.metrics.kradar.frames import gather_kradar
from farfield.metrics.kradar.settings import KRadarSettings
from farfield.studio.showing.predictions import FALSE, IGNORED, MATCHED, UNSEEN, match_frame

KEY = ("s", "0")


def scene(seed: int, *, near: float = 1.0) -> tuple[Boxes, Boxes]:
    rng = np.random.default_rng(seed)
    truth = Boxes(
        centre_m=np.column_stack([rng.uniform(5, 70, 12), rng.uniform(-15, 15, 12), np.zeros(12)]),
        size_m=np.tile([4.5, 2.0, 1.6], (12, 1)),
        yaw_rad=rng.uniform(-0.3, 0.3, 12),
        label=rng.choice(["vehicle", "large_vehicle", "pedestrian"], 12),
    )
    picked = rng.integers(0, 12, 20)
    found = Boxes(
        centre_m=truth.centre_m[picked] + rng.normal(0, near, (20, 3)) * [1, 1, 0.1],
        size_m=truth.size_m[picked],
        yaw_rad=truth.yaw_rad[picked],
        label=truth.label[picked],
        score=rng.random(20),
    )
    return found, truth


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("protocol", ["dds", "nuscenes", "kradar", "kitti"])
def test_a_truth_is_found_once_or_missed(protocol, seed):
    found, truth = scene(seed)
    result = match_frame(protocol, found, Annotation(boxes=truth), key=KEY, reference="radar")
    assert result.note == ""
    hit = result.truth[result.verdict == MATCHED]
    assert len(set(hit.tolist())) == len(hit)
    assert not set(hit.tolist()) & set(np.flatnonzero(result.missed).tolist())
    must = np.flatnonzero(result.counts)
    assert set(must.tolist()) == set(hit.tolist()) | set(np.flatnonzero(result.missed).tolist())
    assert (result.truth[result.verdict == FALSE] == -1).all()


@pytest.mark.parametrize("protocol", ["dds", "nuscenes", "kradar", "kitti"])
def test_a_class_that_is_not_annotated_has_false_detections(protocol):
    found, truth = scene(0)
    few = truth[truth.label == "vehicle"]
    result = match_frame(protocol, found, Annotation(boxes=few), key=KEY, reference="radar")
    assert result.note == ""
    other = found.label != "vehicle"
    assert other.any()
    assert (result.truth[other] == -1).all()
    assert (result.verdict[other] != MATCHED).all()
    nothing = match_frame(protocol, found, Annotation(boxes=truth[:0]), key=KEY, reference="radar")
    assert (nothing.truth == -1).all()


@pytest.mark.parametrize("seed", range(6))
def test_kradar_counts_as_many_true_positives(seed):
    found, truth = scene(seed, near=0.4)
    result = match_frame("kradar", found, Annotation(boxes=truth), key=KEY, reference="radar")
    settings = KRadarSettings()
    data = gather_kradar({KEY: found}, {KEY: truth}, settings, None)
    counted = sum(int(kradar_match(data, settings, kind).gains["3d", 0.3].true.sum()) for kind in range(2))
    assert int((result.verdict == MATCHED).sum()) == counted
    assert counted > 0
    assert (result.verdict[found.label == "pedestrian"] == UNSEEN).all()  # it does not score them


@pytest.mark.parametrize("seed", range(6))
def test_dds_finds_what_lies_within_two_metres(seed):
    found, truth = scene(seed)
    result = match_frame("dds", found, Annotation(boxes=truth), key=KEY, reference="lidar")
    mine, theirs = (np.isin(boxes.label, ["vehicle", "large_vehicle"]) for boxes in (truth, found))
    flat = truth.replace(centre_m=truth.centre_m * [1, 1, 0])[mine]
    finder = found_by(found.replace(centre_m=found.centre_m * [1, 1, 0])[theirs], flat, distance_m=2.0)
    near = match_frame(
        "dds",
        found.replace(centre_m=found.centre_m * [1, 1, 0]),
        Annotation(boxes=truth.replace(centre_m=truth.centre_m * [1, 1, 0])),
        key=KEY,
        reference="lidar",
    )
    assert (~near.missed[mine]).tolist() == (finder >= 0).tolist()
    assert (finder >= 0).any()
    assert result.counts[mine].all()


def one_box(x: float, label: str) -> Boxes:
    return Boxes(
        centre_m=np.array([[x, 0.0, 0.0]]), size_m=np.array([[4.0, 2.0, 1.5]]), yaw_rad=np.zeros(1), label=label
    )


def test_what_lies_outside_the_region_is_neither_right_nor_wrong():
    boxes = one_box(-20.0, "vehicle").replace(score=np.ones(1))
    result = match_frame("dds", boxes, Annotation(boxes=boxes.replace(score=None)), key=KEY, reference="lidar")
    assert result.verdict.tolist() == [UNSEEN]
    assert not result.missed.any()
    assert not result.counts.any()


def test_ignored_classes_excuse_a_detection():
    truth = one_box(20.0, "unknown")
    found = truth.replace(label=np.array(["vehicle"]), score=np.ones(1))
    result = match_frame("dds", found, Annotation(boxes=truth), key=KEY, reference="lidar")
    assert result.verdict.tolist() == [IGNORED]


def test_a_protocol_that_cannot_match_a_frame_says_so():
    found, truth = scene(0)
    result = match_frame("tracking", found, Annotation(boxes=truth), key=KEY, reference="lidar")
    assert "not matched" in result.note
    assert (result.verdict == UNSEEN).all()
