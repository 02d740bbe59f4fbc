"""Greedy matching: the rules one by one."""

import numpy as np

from farfield.metrics.centre.matching import DROPPED, NO_MATCH, Limits, found_by, greedy_match, rank_predictions

from .scenes import boxes, car


def match(predicted: list, annotated: list, thresholds: list[float], **options) -> list[list[int]]:
    predicted_m, annotated_m = np.array(predicted, dtype=float), np.array(annotated, dtype=float)
    zeros = np.zeros(len(predicted), dtype=np.int64), np.zeros(len(annotated), dtype=np.int64)
    limits = Limits(threshold_m=np.array(thresholds), **{k: options.pop(k) for k in list(options) if k != "ignored"})
    order = np.arange(len(predicted))
    return greedy_match(predicted_m, zeros[0], order, annotated_m, zeros[1], limits, **options).tolist()


def test_the_nearest_free_box_is_taken_even_if_it_is_too_far() -> None:
    # The second prediction stands 0.4 m from box 0, which is taken, so its nearest free box is box 1 at 0.6 m.
    assert match([[0, 0], [0.4, 0]], [[0, 0], [1, 0]], [0.5, 1.0]) == [[0, NO_MATCH], [0, 1]]


def test_thresholds_are_independent() -> None:
    # Only where the first prediction may reach does it take the box from the second one.
    assert match([[3, 0], [0.2, 0]], [[0, 0]], [0.5, 4.0]) == [[NO_MATCH, 0], [0, NO_MATCH]]


def test_nearest_by_raw_or_by_normalised_distance() -> None:
    omega = np.array([[1.0, 3.0]])
    assert match([[0, 0]], [[1, 0], [-2, 0]], [1.5], omega_annotated=omega) == [[0]]
    assert match([[0, 0]], [[1, 0], [-2, 0]], [1.5], omega_annotated=omega, normalised=True) == [[1]]


def test_ignored_boxes_are_never_taken() -> None:
    found = match([[0, 0], [0.1, 0], [5, 0]], [[0, 0]], [1.0], ignored=np.array([True]))
    assert found == [[DROPPED, DROPPED, NO_MATCH]]


def test_frames_do_not_touch() -> None:
    predicted = np.zeros((3, 2))
    found = greedy_match(
        predicted,
        np.array([0, 1, 2]),
        np.arange(3),
        np.zeros((2, 2)),
        np.array([2, 0]),
        Limits(threshold_m=np.array([1.0])),
    )
    assert found.tolist() == [[1, NO_MATCH, 0]]


def test_nothing_to_match() -> None:
    limits = Limits(threshold_m=np.array([1.0, 2.0]))
    none, some = np.zeros((0, 3)), np.zeros((2, 3))
    empty, two = np.zeros(0, dtype=np.int64), np.zeros(2, dtype=np.int64)
    assert greedy_match(none, empty, empty, some, two, limits).shape == (2, 0)
    assert (greedy_match(some, two, np.arange(2), none, empty, limits) == NO_MATCH).all()


def test_order_of_equal_scores() -> None:
    score, frame = np.array([0.5, 0.9, 0.5, 0.5]), np.array([1, 0, 0, 1])
    assert rank_predictions(score, frame).tolist() == [1, 2, 0, 3]
    assert rank_predictions(score, frame, ties="later_first").tolist() == [1, 3, 2, 0]


def test_one_frame_is_matched_each_object_once_best_first() -> None:
    annotated = boxes([car(10.0), car(20.0)], scored=False)
    predicted = boxes([car(10.5, score=0.9), car(10.1, score=0.5), car(21.9, score=0.4), car(40.0, score=0.3)])
    assert found_by(predicted, annotated).tolist() == [0, 2]
    assert found_by(predicted, annotated, distance_m=1.0).tolist() == [0, -1]
    assert found_by(boxes([]), annotated).tolist() == [-1, -1]
