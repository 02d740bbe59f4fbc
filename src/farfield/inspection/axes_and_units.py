"""Whether clouds and boxes stand in metres, x forward, y left, z up: the judgement of doctor and all that detects.

It is made from the data alone, for files do not say. What a cloud cannot tell: whether y points left or right where z
points up (a mirrored road is a road), and which way a sensor that sees all round looks where nothing is annotated.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from farfield.datasets.base import Dataset
from farfield.errors import FarfieldError
from farfield.frame import Boxes, Frame
from farfield.vocabulary.classes import UNSURE, unit_of_sizes

_FRAMES = 5
_LEAST_POINTS, _LEAST_BOXES = 1_000, 8
_NEAREST_M, _FARTHEST_M = 1.0, 1_500.0
_MEDIAN_RANGE_M, _HEIGHTS_M = 20.0, 3.0
"""Of a sweep of a road: the median of the points' ranges, and the height between their 5 % and 95 % quantiles."""
_SMALL_UNITS = {"centimetres": 100.0, "millimetres": 1000.0}
_LAYER_M, _BESIDE_M = 0.2, 0.5
_TALL_M, _FLAT = 15.0, 4.0  # heights of a road reach less; the vertical axis is this much flatter than the others
_SECTOR = 0.5  # cosine of 60 degrees
_MOST_OF, _FEW_OF = 0.9, 0.1
_ALONG = 0.8  # sine or cosine of a heading along an axis, and share of boxes that lie and head so
_FAR_M = 10.0
_WIDEST_M = 3.6  # of a road user; in feet a car is 6 wide
_DIRECTIONS = {"y": (0.0, 1.0), "-y": (0.0, -1.0), "-x": (-1.0, 0.0)}
_TURNS = {"y": "-90", "-y": "90", "-x": "180"}


@dataclass(frozen=True, kw_only=True)
class Doubt:
    """One reason to doubt axes or units.

    Args:
        topic: ``"units"`` or ``"axes"``.
        what: What the data show.
        fix: What to do.
        certain: Whether nothing can be detected or learnt so.
    """

    topic: str
    what: str
    fix: str
    certain: bool = True

    def __str__(self) -> str:
        return f"{self.what}. {self.fix}"


def doubts_of(points: Sequence[Float[np.ndarray, "_ 3"]], boxes: Sequence[Boxes] = ()) -> list[Doubt]:
    """Everything that speaks against metres, x forward, z up.

    Args:
        points: Clouds of some frames, of one LiDAR.
        boxes: Annotated boxes of these frames.
    """
    together = np.concatenate([part.astype(np.float64) for part in points]) if points else np.zeros((0, 3))
    together = together[np.isfinite(together).all(axis=1)]
    annotated = Boxes.concatenate([part.plain() for part in boxes]) if boxes else Boxes.empty()
    units = [doubt for doubt in (unit_of_points(together), unit_of_boxes(annotated)) if doubt is not None]
    if units:  # the thresholds of the others are in metres
        return units
    checks = (upright_doubt(together), forward_doubt(together, annotated))
    return [doubt for doubt in checks if doubt is not None]


def first_doubts(data: Dataset, *, cloud: str | None = None, frames: int = _FRAMES) -> list[Doubt]:
    """The doubts about some frames of a data set, spread evenly; frames that cannot be read are left to their reader.

    Boxes that are ``unsure``, round what a donor sweep may hold, have sizes of their own and count as no objects.

    Args:
        data: The data set.
        cloud: Name of the cloud (default: the first of a LiDAR).
        frames: How many to read.
    """
    points, boxes = [], []
    for index in np.unique(np.linspace(0, len(data) - 1, min(frames, len(data))).round().astype(int)).tolist():
        try:
            frame = data[index]
            name = cloud or next((name for name in frame.clouds if _is_lidar(frame, name)), None)
            if name is not None and name in frame.clouds and _is_lidar(frame, name):
                points.append(frame.clouds[name].points_m)
            if frame.boxes is not None:
                boxes.append(frame.boxes[frame.boxes.label != UNSURE])
        except (FarfieldError, OSError, ValueError):
            continue
    return doubts_of(points, boxes)


def _is_lidar(frame: Frame, name: str) -> bool:
    sensor = frame.sensors.get(name)
    return (sensor is None or sensor.kind == "lidar") and (sensor is None or sensor.in_frame)


def unit_of_points(points: Float[np.ndarray, "n 3"]) -> Doubt | None:
    """Points in centimetres, millimetres, or a unit larger than a metre.

    Args:
        points: Points of sweeps.
    """
    if not len(points):
        return None
    reach = float(np.hypot(points[:, 0], points[:, 1]).max())
    unit = "kilometres or another large unit" if reach < _NEAREST_M else ""
    if reach > _FARTHEST_M:  # the farthest point alone cannot tell 250 m from 25 m
        middle = float(np.median(np.hypot(points[:, 0], points[:, 1])))
        low, high = np.quantile(points[:, 2], (0.05, 0.95))
        ratios = np.log([max(middle, 1e-6) / _MEDIAN_RANGE_M, max(float(high - low), 1e-6) / _HEIGHTS_M])
        unit = min(_SMALL_UNITS, key=lambda name: float(np.abs(ratios - np.log(_SMALL_UNITS[name])).sum()))
    if not unit:
        return None
    what = f"the farthest point lies at {reach:.3g}: the cloud seems to be in {unit}"
    return Doubt(topic="units", what=what, fix="Bring the points to metres.")


def unit_of_boxes(boxes: Boxes) -> Doubt | None:
    """Boxes in centimetres, millimetres, a unit larger than a metre, or feet.

    Args:
        boxes: Annotated boxes.
    """
    if not len(boxes):
        return None
    longest = float(np.median(boxes.size_m.max(axis=1)))
    unit = unit_of_sizes(longest)
    width = float(np.median(boxes.size_m[:, :2].min(axis=1)))
    if not unit and len(boxes) >= _LEAST_BOXES and width > _WIDEST_M:
        unit = f"feet (they are {width:.3g} wide, and roads take 2.6 m)"
    if not unit:
        return None
    what = f"the median box is {longest:.3g} long: sizes seem to be in {unit}"
    return Doubt(topic="units", what=what, fix="Bring sizes and positions to metres.")


def upright_doubt(points: Float[np.ndarray, "n 3"]) -> Doubt | None:
    """A cloud whose z points down, or whose vertical axis is another one.

    Args:
        points: Points in metres.
    """
    if len(points) < _LEAST_POINTS:
        return None
    spread = np.subtract(*np.quantile(points, (0.95, 0.05), axis=0))
    flat = int(spread.argmin())
    if flat != 2 and spread[2] > max(_TALL_M, _FLAT * spread[flat]):
        what = (
            f"heights (z) reach over {spread[2]:.0f} m and {'xy'[flat]} over {spread[flat]:.1f} m: "
            f"{'xy'[flat]} seems to be the vertical axis, as y is in a camera's axes (x right, y down, z ahead)"
        )
        fix = "Bring clouds and boxes to x forward, y left, z up: from a camera's axes take z, -x, -y."
        return Doubt(topic="axes", what=what, fix=fix)
    z = points[:, 2]
    low, high = np.percentile(z, [0.1, 99.9])
    counts, edges = np.histogram(z, np.arange(low, high + 2 * _LAYER_M, _LAYER_M))
    ground = float(edges[counts.argmax()] + _LAYER_M / 2)  # the densest layer; the rest of a cloud stands above it
    above, below = float((z > ground + _BESIDE_M).mean()), float((z < ground - _BESIDE_M).mean())
    if not (ground > _BESIDE_M and below > 0.02 and above < 0.2 * below):
        return None
    what = (
        f"the densest layer lies {ground:.1f} m above the sensor, {below:.0%} of the points below it and "
        f"{above:.0%} above: z seems to point down"
    )
    fix = "z points up and y left: from axes x ahead, y right, z down change the sign of y and z, of boxes too."
    return Doubt(topic="axes", what=what, fix=fix)


def forward_doubt(points: Float[np.ndarray, "n 3"], boxes: Boxes) -> Doubt | None:
    """Another axis than x that points along the road: x right and y forward, as many robots have it.

    Args:
        points: Points in metres.
        boxes: Annotated boxes.
    """
    shares_of_points, shares_of_boxes = _shares(points[:, :2]), _shares(boxes.centre_m[:, :2])
    for axis in _DIRECTIONS:
        enough = len(points) >= _LEAST_POINTS
        of_points = enough and shares_of_points[axis] > _MOST_OF and shares_of_points["x"] < _FEW_OF
        of_boxes = len(boxes) >= _LEAST_BOXES and shares_of_boxes[axis] > _MOST_OF and shares_of_boxes["x"] < _FEW_OF
        if of_points or of_boxes:
            what, share = ("points", shares_of_points[axis]) if of_points else ("boxes", shares_of_boxes[axis])
            return _turned(axis, f"{share:.0%} of the {what} lie within 60 degrees of {_signed(axis)}")
    far = boxes[np.hypot(*boxes.centre_m[:, :2].T) > _FAR_M]
    if len(far) < _LEAST_BOXES:
        return None
    along = float((np.abs(far.centre_m[:, 1]) > np.abs(far.centre_m[:, 0])).mean())
    heading = float((np.abs(np.sin(far.yaw_rad)) > _ALONG).mean())
    if along < _ALONG or heading < _ALONG:
        return None
    evidence = f"{along:.0%} of the boxes lie along y and {heading:.0%} head along it, as on a road that leads there"
    return _turned("y", evidence)


def _shares(at_m: Float[np.ndarray, "n 2"]) -> dict[str, float]:
    """Shares of places within 60 degrees of each axis."""
    away = np.hypot(*at_m.T)
    unit = at_m[away > 0] / away[away > 0, None]
    directions = {"x": (1.0, 0.0), **_DIRECTIONS}
    return {name: float((unit @ axis > _SECTOR).mean()) if len(unit) else 0.0 for name, axis in directions.items()}


def _turned(axis: str, evidence: str) -> Doubt:
    kind = " (x right, y forward)" if axis == "y" else ""
    fix = (
        f"Turn clouds and boxes to x forward, y left, or while they are read: --rotate-deg {_TURNS[axis]} in predict "
        f"and evaluate, -o 'data.options={{rotate_deg: {_TURNS[axis]}}}' in train."
    )
    return Doubt(topic="axes", what=f"{evidence}: {_signed(axis)} seems to point forward{kind}", fix=fix, certain=False)


def _signed(axis: str) -> str:
    return axis if axis.startswith("-") else f"+{axis}"
