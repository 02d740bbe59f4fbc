"""Where pseudo boxes begin and background ends: from scores whose right and wrong are known."""

import numpy as np
import pytest

from farfield.frame import Boxes
from farfield.metrics.score_calibration import (
    background_below,
    calibrated,
    confident_from,
    scored_matches,
    thresholds_of,
)


def boxes_at(x: np.ndarray, score: np.ndarray | None = None, label: str = "vehicle") -> Boxes:
    n = len(x)
    return Boxes(
        centre_m=np.column_stack([x, np.zeros(n), np.zeros(n)]),
        size_m=np.ones((n, 3)),
        yaw_rad=np.zeros(n),
        label=label,
        score=score,
    )


def scores_of(shares: dict[float, float], count: int = 20) -> tuple[np.ndarray, np.ndarray]:
    """As many boxes of each score, of which a share is right."""
    score = np.repeat(list(shares), count)
    right = np.concatenate([np.arange(count) < round(share * count) for share in shares.values()])
    return score, right


def test_sure_and_background_are_where_boxes_of_a_score_are() -> None:
    score, right = scores_of({0.1: 0.0, 0.2: 0.2, 0.3: 0.25, 0.5: 0.5, 0.7: 0.75, 0.8: 0.8, 0.9: 1.0})
    assert confident_from(score, right) == 0.8
    assert background_below(score, right) == 0.3
    assert confident_from(score[right][:19], right[right][:19]) is None  # too few objects
    assert background_below(score[:19], right[:19]) is None


def test_shares_that_fall_are_evened_out() -> None:
    score, right = scores_of({0.2: 0.1, 0.4: 0.9, 0.6: 0.3, 0.8: 0.95})
    values, share = calibrated(score, right)
    assert values.tolist() == [0.2, 0.4, 0.6, 0.8]
    assert share == pytest.approx([0.1, 0.6, 0.6, 0.95])
    assert (confident_from(score, right), background_below(score, right)) == (0.8, 0.4)


def test_where_next_to_nothing_is_sure_the_best_tenth_of_the_objects_is() -> None:
    score = np.linspace(1.0, 0.01, 100)
    right = np.arange(100) % 2 == 0
    assert confident_from(score, right) == pytest.approx(np.quantile(score[right], 0.9))
    assert background_below(score, np.ones(100, dtype=bool)) == score.min()  # nothing found is background


def test_a_box_is_an_object_once() -> None:
    found = {
        ("a", "0"): boxes_at(np.array([10.0, 10.5, 40.0]), np.array([0.9, 0.8, 0.7])),
        ("a", "2"): boxes_at(np.array([5.0]), np.array([0.6])),
    }
    truth = {
        ("a", "0"): boxes_at(np.array([10.2])),
        ("a", "1"): boxes_at(np.array([1.0])),
        ("a", "2"): boxes_at(np.array([5.0]), label="bicycle"),
    }
    score, right = scored_matches(found, truth, "vehicle")
    assert score.tolist() == [0.9, 0.8, 0.7, 0.6]
    assert right.tolist() == [True, False, False, False]  # the second finds nothing free, the last is no bicycle


def test_thresholds_by_class_and_the_literatures_where_there_are_few() -> None:
    frames = {("s", str(n)): boxes_at(np.arange(10) * 20.0, np.linspace(0.95, 0.05, 10)) for n in range(10)}
    truth = {key: boxes_at(np.arange(5) * 20.0) for key in frames}  # the better half is right
    found = thresholds_of(frames, truth, ("vehicle", "pedestrian"), lowest=0.05)
    assert found.measured == ("vehicle",)
    assert found.positive == {"vehicle": 0.55, "pedestrian": 0.6}
    assert found.negative == {"vehicle": 0.55, "pedestrian": 0.25}  # scores part right and wrong: nothing is unsure
    assert all(found.negative[name] <= found.positive[name] for name in found.positive)
    raised = thresholds_of(frames, truth, ("vehicle",), lowest=0.7)
    assert raised.positive == raised.negative == {"vehicle": 0.7}
