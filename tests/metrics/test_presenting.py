"""What counts as found in a picture, and the curves and edges that a page draws."""

import numpy as np
import pytest

from farfield.errors import ConfigError
from farfield.geometry.boxes import Boxes
from farfield.metrics.centre.matching import found_by
from farfield.metrics.presenting import HitRule, edges_m, panels


def boxes(x_m: list[float], score: list[float] | None = None) -> Boxes:
    n = len(x_m)
    return Boxes(
        centre_m=np.column_stack([x_m, np.zeros(n), np.zeros(n)]),
        size_m=np.tile([4.0, 2.0, 1.5], (n, 1)),
        yaw_rad=np.zeros(n),
        label="vehicle",
        score=None if score is None else np.array(score),
    )


def test_centres_are_found_as_the_scores_match_them(rng: np.random.Generator) -> None:
    for _ in range(20):
        predicted = boxes(rng.uniform(0, 30, 12).tolist(), rng.uniform(0, 1, 12).tolist())
        annotated = boxes(rng.uniform(0, 30, 8).tolist())
        assert HitRule().found_by(predicted, annotated).tolist() == found_by(predicted, annotated).tolist()


def test_overlaps_are_found_best_first_and_once() -> None:
    annotated = boxes([10.0, 20.0])
    predicted = boxes([10.5, 10.1, 21.9], [0.5, 0.9, 0.8])
    assert HitRule("3d", 0.3).found_by(predicted, annotated).tolist() == [1, 2]
    assert HitRule("3d", 0.7).found_by(predicted, annotated).tolist() == [1, -1]
    assert HitRule("bev", 0.7).found_by(boxes([]), annotated).tolist() == [-1, -1]
    assert str(HitRule()) == "within 2 m"
    assert str(HitRule("3d", 0.3)) == "by a box that overlaps by more than 0.3"


def test_panels_and_edges() -> None:
    line = {"recall": [0.0, 1.0], "precision": [1.0, 0.5]}
    found = panels({"3d": {"easy": line, "hard": None}, "bev": {"easy": None}})
    assert [(panel.title, [each.name for each in panel.lines]) for panel in found] == [("3d", ["easy"]), ("bev", [])]
    assert panels(None) == []
    with pytest.raises(ConfigError, match="equal length"):
        panels({"3d": {"easy": {"recall": [0.0], "precision": []}}})
    assert edges_m({"settings": {"range_bins_m": [0.0, 20.0, "inf"]}}) == (20.0,)
    assert edges_m({}) == ()
