"""Frames of very many boxes: refused where they come in; pairs and matrices in blocks give the same result."""

from pathlib import Path

import numpy as np
import pytest

from farfield.errors import ConfigError
from farfield.frame import Annotation
from farfield.geometry import iou
from farfield.geometry.boxes import Boxes
from farfield.metrics import Detections, box_files, frames
from farfield.metrics.kitti import evaluation
from farfield.metrics.kradar import matching

from . import test_kitti_ap as kitti_scenes


def crowd(count: int, *, seed: int = 0, extent_m: float = 9.0) -> Boxes:
    rng = np.random.default_rng(seed)
    return Boxes(
        centre_m=rng.uniform(-extent_m, extent_m, (count, 3)),
        size_m=np.full((count, 3), [4.0, 2.0, 1.5]),
        yaw_rad=rng.uniform(-3, 3, count),
        label="vehicle",
        score=rng.random(count),
    )


def test_a_file_of_too_many_boxes_a_frame_is_refused(tmp_path: Path) -> None:
    for name in ("predicted.csv", "labels.csv"):
        crowd(frames.MAX_BOXES + 1).to_csv(tmp_path / name)
    with pytest.raises(ConfigError, match=r"labels\.csv, frame .*expected at most 5,000 boxes in a frame, got 5,001"):
        box_files.read(tmp_path / "predicted.csv", tmp_path / "labels.csv")


@pytest.mark.parametrize("protocol", ["dds", "nuscenes", "kradar", "tracking"])
def test_so_are_they_in_python_by_every_protocol(protocol: str) -> None:
    boxes = {("a", "0"): crowd(frames.MAX_BOXES + 1)}
    annotations = {("a", "0"): Annotation(boxes=crowd(3).replace(score=None, track_id=np.arange(3)))}
    with pytest.raises(ConfigError, match=r"frame .*expected at most 5,000 boxes in a frame"):
        Detections(boxes=boxes, annotations=annotations).score(protocol)


def test_pairs_in_blocks_are_all_pairs_in_order(monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator) -> None:
    a, b = rng.integers(0, 9, 60), np.sort(rng.integers(0, 9, 50))
    monkeypatch.setattr(frames, "_PAIRS_AT_ONCE", 7)
    blocks = list(frames.pairs_of_owners(a, b, 9))
    assert len(blocks) > 10
    for side, whole in zip(zip(*blocks, strict=True), frames.same_owner(a, b, 9), strict=True):
        np.testing.assert_array_equal(np.concatenate(side), whole)
    assert [len(part) for part in next(frames.pairs_of_owners(a[:0], b, 9))] == [0, 0]


@pytest.mark.parametrize("kind", ["bev", "3d"])
def test_a_matrix_in_blocks_is_the_same_matrix(monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    a, b = crowd(90, seed=1), crowd(70, seed=2)
    whole = iou.pairwise_iou(a, b, kind=kind)
    monkeypatch.setattr(iou, "_MATRIX_AT_ONCE", 200)
    monkeypatch.setattr(iou, "_PAIRS_AT_ONCE", 64)
    np.testing.assert_array_equal(iou.pairwise_iou(a, b, kind=kind), whole)
    assert (whole > 0).sum() > 100


def test_kitti_in_blocks_of_frames_is_the_same(monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator) -> None:
    predictions, annotations, predicted_details, details = kitti_scenes.scene(rng)
    detections = Detections(
        boxes=predictions,
        annotations={
            key: Annotation(
                boxes=boxes,
                details={name: rows for name, rows in details[key].items() if name != "dontcare_px"},
                unboxed={"dontcare_px": details[key]["dontcare_px"]},
            )
            for key, boxes in annotations.items()
        },
        prediction_details=predicted_details,
    )
    whole = detections.score("kitti", label="Car").to_json()
    monkeypatch.setattr(evaluation, "_PADDED_AT_ONCE", 300)
    assert detections.score("kitti", label="Car").to_json() == whole


def test_a_crowd_is_matched_one_by_one_as_prefix_by_prefix(
    monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    frame = np.sort(rng.integers(0, 3, 60))
    detection_frame = np.sort(rng.integers(0, 3, 70))
    box, detection = np.nonzero((frame[:, None] == detection_frame) & (rng.random((60, 70)) < 0.7))
    arguments = {
        "frame": frame,
        "optional": rng.random(60) < 0.3,
        "score": rng.integers(0, 30, 70) / 30,
        "order": rng.permutation(70),
    }
    overlap = rng.integers(0, 9, len(box)) / 9
    prefixes = matching.gains(box, detection, overlap, **arguments)
    for rows in (100, 7_000):  # all frames, some of them
        monkeypatch.setattr(matching, "_ROWS_AT_ONCE", rows)
        joined = matching.gains(box, detection, overlap, **arguments)
        for name in ("true", "excused", "is_true"):
            np.testing.assert_array_equal(getattr(joined, name), getattr(prefixes, name))


@pytest.mark.parametrize("protocol", ["kradar", "kitti", "tracking", "nuscenes-tracking"])
def test_boxes_that_all_lie_upon_one_another_are_refused(protocol: str) -> None:
    boxes = crowd(501, extent_m=0.2)
    boxes = boxes.replace(track_id=np.arange(501), centre_m=boxes.centre_m + np.array([20.0, 0.0, 0.0]))
    annotations = {("a", "0"): Annotation(boxes=boxes.replace(score=None))}
    with pytest.raises(ConfigError, match=r"frame .*expected at most 250,000 pairs of an annotated and a predicted"):
        Detections(boxes={("a", "0"): boxes}, annotations=annotations).score(protocol, label="vehicle")
