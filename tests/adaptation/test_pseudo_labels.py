"""Pseudo-labels by the scores of a teacher."""

import numpy as np
import pytest

pytest.importorskip("torch")

from farfield.adaptation.pseudo_labels import levels, split_by_score, threshold_text
from farfield.frame import Boxes


def boxes_at(x: np.ndarray, score: np.ndarray | None = None, label: str = "vehicle") -> Boxes:
    n = len(x)
    return Boxes(
        centre_m=np.column_stack([x, np.zeros(n), np.zeros(n)]),
        size_m=np.ones((n, 3)),
        yaw_rad=np.zeros(n),
        label=label,
        score=score,
    )


def test_thresholds_of_each_class_part_its_boxes() -> None:
    boxes = Boxes.concatenate(
        [boxes_at(np.array([1.0, 2.0]), np.array([0.5, 0.3])), boxes_at(np.array([3.0]), np.array([0.5]), "bicycle")]
    )
    positive, negative = {"vehicle": 0.5, "bicycle": 0.6}, {"vehicle": 0.4, "bicycle": 0.2}
    assert levels(positive, boxes.label).tolist() == [0.5, 0.5, 0.6]
    parts = split_by_score(boxes, positive, negative)
    assert parts.confident.centre_m[:, 0].tolist() == [1.0]
    assert parts.ignored.centre_m[:, 0].tolist() == [3.0]
    assert threshold_text(0.6) == "0.6"
