"""What a fit takes and gives: the prior of an object, its footprint, the box and the other boxes it may be."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from farfield.geometry.boxes import Boxes
from farfield.vocabulary.classes import SMALL_KINDS, VEHICLE_KINDS

Box = tuple[float, float, float, float, float, float, float]
"""x, y, z of the centre, length, width, height (metres), yaw (radians), as everywhere in Farfield."""

Extent = Literal["whole body", "visible part"]
HeadingFrom = Literal["track", "drag", "lane", "ask"]


@dataclass(frozen=True, kw_only=True)
class Prior:
    """What is known of an object before its points are looked at.

    Args:
        size_m: Length, width, height: of the track, of its class or of its type.
        anchored: Whether the box grows away from the sensor to that size (vehicles), or about its middle (people and
            two-wheelers, which are seen nearly whole).
        extent: What the data set's boxes stand for; boxes of visible parts do not grow to the prior.
        yaw_rad: Heading of the track, with its sign, or None.
        lane_rad: Heading of the lane or of the ego vehicle, whose sign is a guess, or None.
        roads_rad: Headings along which vehicles drive about it, such as those of its neighbours; empty: only the lane.
        fixed_size: Whether the size is the track's and stays as it is.
        ego_m: x and y of the sensor in the points' coordinates.
        ego_z_m: And its z, where all points are of that one sensor: rays that went past the object are followed then.

    Raises:
        ValueError: If a size is not positive and finite.
    """

    size_m: tuple[float, float, float]
    anchored: bool = True
    extent: Extent = "whole body"
    yaw_rad: float | None = None
    lane_rad: float | None = None
    roads_rad: tuple[float, ...] = ()
    fixed_size: bool = False
    ego_m: tuple[float, float] = (0.0, 0.0)
    ego_z_m: float | None = None

    def __post_init__(self) -> None:
        if len(self.size_m) != 3 or not all(np.isfinite(size) and size > 0 for size in self.size_m):
            raise ValueError(f"Prior.size_m: expected three positive lengths in metres, got {self.size_m}")

    @property
    def grows(self) -> bool:
        """Whether a box takes the prior's length and width where its points show less."""
        return self.extent == "whole body" or self.fixed_size


@dataclass(frozen=True, kw_only=True)
class FitCandidate:
    """Another box that the same gesture may mean.

    Args:
        box: The box.
        score: What the search gave it; larger is better, comparable within one fit only.
    """

    box: Box
    score: float


@dataclass(frozen=True, kw_only=True)
class BoxFit:
    """What a gesture gave.

    Args:
        box: The box.
        points: Number of points inside it, the ground's left out.
        candidates: Other boxes, the best first.
        criterion: What decided the yaw: ``faces`` (its points), ``closeness``, ``variance``, ``drag``,
            ``track``, ``lane`` or ``drawn``.
        heading: Where the sign of the heading is from; ``ask`` where nothing tells it: the page offers key G.
        ms: Time that the fit took, milliseconds.
        note: What the person should know, such as that too few points were there; empty where nothing.
    """

    box: Box
    points: int
    candidates: tuple[FitCandidate, ...] = ()
    criterion: str
    heading: HeadingFrom
    ms: float
    note: str = ""


def prior_of(name: str, *, size_m: Sequence[float] | None = None, extent: Extent = "whole body") -> Prior:
    """The prior of a class or of a vehicle's type.

    Args:
        name: Class in K-Radar's or Cirrus's words, or a type below ``Bus or Truck``: ``van``, ``box truck``, ``bus``...
        size_m: The track's size or the data set's median; None takes the preset, and a car's for an unknown class.
        extent: What the data set's boxes stand for.
    """
    small = SMALL_KINDS.get(name)
    preset = small or VEHICLE_KINDS.get(name) or VEHICLE_KINDS["vehicle"]
    length, width, height = preset if size_m is None else size_m
    return Prior(size_m=(float(length), float(width), float(height)), anchored=small is None, extent=extent)


def boxes_of(box: Sequence[float] | Float[np.ndarray, " 7"]) -> Boxes:
    """One box as a set of one."""
    row = np.asarray(box, dtype=np.float64).reshape(1, 7)
    return Boxes(centre_m=row[:, :3], size_m=row[:, 3:6], yaw_rad=row[:, 6])


# From the stretch that points cover along a box's axes to the whole box

_LEAST_M = 0.1
_POINTS_ACROSS, _WHOLE = 100, 0.8


def axes(yaw_rad: float) -> Float[np.ndarray, "2 2"]:
    """Unit vectors along and across a heading, one a row."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array([[cos, sin], [-sin, cos]])


def footprint(xy_m: Float[np.ndarray, "n 2"], yaw_rad: float, prior: Prior) -> Float[np.ndarray, " 5"]:
    """The rectangle of an object at a yaw: x, y, length, width, yaw.

    Its size is the larger of the prior's and the measured one along each axis. Along an axis on which all points lie to
    one side of the sensor, the face towards the sensor stays and the box grows away from it; otherwise, and for all
    that is not anchored, it grows about the middle of the points. So it does across where 100 points cover most of
    the width: both sides were seen then, and only mirrors are missing.

    Args:
        xy_m: The object's points seen from above, at least one.
        yaw_rad: The heading.
        prior: Size, and whether it is anchored.
    """
    turn, ego = axes(yaw_rad), np.array(prior.ego_m)
    along = (xy_m - ego) @ turn.T
    low, high = along.min(axis=0), along.max(axis=0)
    size, centre = _sizes(high - low, prior), (low + high) / 2
    if prior.anchored:
        anchored = np.where(low > 0, low + size / 2, np.where(high < 0, high - size / 2, centre))
        across = len(xy_m) >= _POINTS_ACROSS and high[1] - low[1] >= _WHOLE * prior.size_m[1]
        centre = np.where([False, across], centre, anchored)
    x, y = centre @ turn + ego
    return np.array([x, y, *size, yaw_rad])


def _sizes(measured: Float[np.ndarray, " 2"], prior: Prior) -> Float[np.ndarray, " 2"]:
    usual = np.array(prior.size_m[:2])
    if prior.fixed_size:
        return usual
    return np.maximum(measured, usual if prior.grows else _LEAST_M)


def excess_m(xy_m: Float[np.ndarray, "n 2"], yaw_rad: float, prior: Prior) -> float:
    """By how much the points reach beyond the prior's length and width at a yaw: tells a length from a width."""
    along = xy_m @ axes(yaw_rad).T
    return float(np.maximum(np.ptp(along, axis=0) - np.array(prior.size_m[:2]), 0).sum())


def along_length(xy_m: Float[np.ndarray, "n 2"], yaw_rad: float, prior: Prior) -> float:
    """The yaw or the one a quarter turn from it: where the prior is exceeded less, else along the longer side."""
    turned = yaw_rad + np.pi / 2
    excess = excess_m(xy_m, yaw_rad, prior), excess_m(xy_m, turned, prior)
    if abs(excess[0] - excess[1]) > 1e-9:
        return yaw_rad if excess[0] < excess[1] else turned
    length, width = np.ptp(xy_m @ axes(yaw_rad).T, axis=0)
    return yaw_rad if length >= width else turned
