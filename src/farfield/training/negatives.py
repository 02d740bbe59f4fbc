"""Mined negatives: what a detector took for an object where none is, cut out to be pasted into other frames.

Pasting objects alone teaches that what stands out is an object; false detections pasted beside them, without a box,
teach the difference (false-positive sampling, KaAI-KMU 2021).
"""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from farfield.datasets.base import Dataset
from farfield.errors import FileFormatError, plain
from farfield.files.atomic import read_bytes, write_text
from farfield.files.json_text import plain_json
from farfield.frame import Annotation, Boxes, Frame, Key
from farfield.geometry.boxes import inside_box
from farfield.geometry.iou import pairwise_iou
from farfield.training.augmentation import Progress
from farfield.vocabulary.classes import CLUTTER

Negatives = Mapping[Key, Boxes]
"""Boxes of the class ``clutter`` by the frames that they were mined in."""

APART_M = 2.0
"""A detection this near to an annotated box of any class is no false one."""
_A_FRAME = 8
_MAX_BYTES, _FORMAT = 64_000_000, "farfield-negatives-1"


def mine(
    detect: Callable[[Frame], Boxes], data: Dataset, *, least_score: float | int = 0.2, progress: Progress = iter
) -> dict[Key, Boxes]:
    """Collect the best false boxes of each frame: near no annotated object and in nothing that is unsure.

    Args:
        detect: The detector.
        data: Annotated frames, as they are trained on.
        least_score: Boxes of a lower score are left.
        progress: Wraps the numbers of the frames.
    """
    mined = {}
    for index in progress(range(len(data))):
        frame = data[index]
        if frame.annotation is None:
            continue
        boxes = false_boxes(detect(frame), frame.annotation, least_score)
        if len(boxes):
            mined[frame.key] = boxes.replace(score=None, label=[CLUTTER] * len(boxes))
    return mined


def false_boxes(boxes: Boxes, annotation: Annotation, least_score: float | int) -> Boxes:
    """The best boxes that are near no annotated object and in nothing that is unsure, best first.

    Args:
        boxes: Scored boxes, best first.
        annotation: Of the frame.
        least_score: Boxes of a lower score are left.
    """
    if boxes.score is None or not len(boxes):
        return boxes[:0]
    annotated = annotation.boxes
    away = np.linalg.norm(boxes.centre_m[:, None, :2] - annotated.centre_m[None, :, :2], axis=2)
    near = away.min(axis=1, initial=np.inf) < APART_M
    for row in range(len(annotated)):  # long bodies, and what is unsure, reach farther than their centres
        near |= inside_box(boxes.centre_m.astype(np.float64), annotated, row, margin_m=0.5)
    near |= (pairwise_iou(boxes, annotated, kind="bev") > 0).any(axis=1)  # a car at its side holds its points
    return boxes[np.flatnonzero((boxes.score >= least_score) & ~near)[:_A_FRAME]]


def save_negatives(path: Path, streams: Mapping[str, Negatives]) -> None:
    """Write mined negatives of several streams of a training."""
    named = {
        name: [[*key, _rows(boxes).round(3).tolist()] for key, boxes in negatives.items()]
        for name, negatives in streams.items()
    }
    write_text(path, json.dumps({"format": _FORMAT, "streams": named}) + "\n")


def load_negatives(path: Path) -> dict[str, dict[Key, Boxes]]:
    """Read what :func:`save_negatives` wrote.

    Raises:
        FileFormatError: If the file is another one or damaged.
    """
    try:
        tree: Any = plain_json(read_bytes(path, max_bytes=_MAX_BYTES))
        if tree["format"] != _FORMAT:
            raise ValueError(f"the format {tree['format']}")
        return {
            str(name): {(str(row[0]), str(row[1])): _clutter(np.array(row[2], dtype=np.float64)) for row in rows}
            for name, rows in tree["streams"].items()
        }
    except (OSError, ValueError, KeyError, TypeError, IndexError, AttributeError) as error:
        expected, fix = "mined negatives as a training's mining wrote them", "Remove the file, and mine anew."
        raise FileFormatError(path, where="the file", expected=expected, got=plain(error)[:200], fix=fix) from error


def _rows(boxes: Boxes) -> np.ndarray:
    return np.column_stack([boxes.centre_m, boxes.size_m, boxes.yaw_rad])


def _clutter(rows: np.ndarray) -> Boxes:
    if rows.ndim != 2 or rows.shape[1] != 7 or not np.isfinite(rows).all() or not (rows[:, 3:6] > 0).all():
        raise ValueError("boxes that are no rows of x, y, z, length, width, height and yaw")
    return Boxes(centre_m=rows[:, :3], size_m=rows[:, 3:6], yaw_rad=rows[:, 6], label=[CLUTTER] * len(rows))
