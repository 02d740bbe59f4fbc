"""Conditions on frames and objects: read by a grammar of ours, refused by name, never evaluated."""

import numpy as np
import pytest

from farfield.errors import ConfigError
from farfield.frame import Annotation, Boxes
from farfield.frame.where import COLUMNS, Where

BOXES = Boxes(
    centre_m=np.array([[30.0, 0, 0], [120.0, 10, 0], [0.0, 200, 0]]),
    size_m=np.tile([4.0, 2.0, 1.5], (3, 1)),
    yaw_rad=np.array([0.0, np.pi / 2, 0.0]),
    label=np.array(["vehicle", "pedestrian", "vehicle"]),
    point_count=np.array([50, 3, -1]),
)
KEY, SLEET = ("drive", "7"), {"weather": "sleet", "road": "urban"}


@pytest.mark.parametrize(
    ("text", "rows"),
    [
        ('range_m > 100 and weather == "sleet"', [1, 2]),
        ('range_m > 100 and weather == "fog"', []),
        ('label in ("pedestrian", "bicycle") or points >= 50', [0, 1]),
        ("points < 10", [1]),
        ("points != 50", [1]),
        ("not (points < 10)", [0, 2]),
        ('frame == "7" and 20 < x_m <= 120', [0, 1]),
        ("bearing_deg > 80", [2]),
        ("yaw_deg == 90.0 and y_m > -1", [1]),
        ('label not in ("vehicle",)', [1]),
        ("speed_m_s > 0", []),
        ('road != "highway"', [0, 1, 2]),
        ('time != "night"', []),
        ("occlusion == 2", [1]),
    ],
)
def test_conditions_hold_where_they_say(text: str, rows: list[int]) -> None:
    annotation = Annotation(boxes=BOXES, details={"occlusion": np.array([0, 2, 1])})
    assert np.flatnonzero(Where(text).of_boxes(BOXES, KEY, SLEET, annotation)).tolist() == rows


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("rnge_m > 100", "Did you mean range_m"),
        ("weather == sleet", "A text stands in quotes"),
        ('range_m > "far"', "a number beside range_m"),
        ('weather > "fog"', "== or != and a text in quotes beside weather"),
        ("range_m", "comparison of range_m"),
        ("1 < 2", "a column on one side"),
        ("range_m >", "expected a condition such as"),
        ("", "expected a condition such as"),
        ('__import__("os").system("x")', "expected a condition such as"),
        ('label.__class__ == "x"', "a column, a number or a text"),
        ("range_m > 9**9**9", "a column, a number or a text"),
        ("range_m > 1e999", "a column, a number or a text"),
        ("[x for x in y] == 1", "a column, a number or a text"),
        ("range_m > (lambda: 1)()", "a column, a number or a text"),
        ("label in label", "a list behind in"),
        ("(" * 400 + "range_m > 1" + ")" * 400, "expected a condition such as"),
        ("range_m > 1 or " * 90 + "range_m > 1", "at most"),
        ("range_m is 3", "another sign"),
    ],
)
def test_what_is_no_condition_is_refused_by_name(text: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        Where(text)


def test_a_frame_is_left_out_where_nothing_in_it_can_count() -> None:
    assert Where('range_m > 100 and weather == "sleet"').of_frame(KEY, SLEET)
    assert not Where('range_m > 100 and weather == "fog"').of_frame(KEY, SLEET)
    assert Where('range_m > 100 or weather == "fog"').of_frame(KEY, SLEET)
    assert Where('weather == "sleet"').of_frames
    assert len(set(COLUMNS)) == len(COLUMNS)
