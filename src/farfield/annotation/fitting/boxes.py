"""A box from a gesture: a drag, a click, a rectangle, a box to fit again.

All of them take the same steps, in :func:`_search_and_refine` and :func:`refit` one after the other:

1. The ground about the gesture is a plane, and the points over it are what the box may hold.
2. A box of the prior's size is searched at the headings that the gesture leaves open: those about the drawn one, about
   the track's, or, after a click, all, of which the lanes about it are likelier.
3. The likeliest heading of a vehicle by its points is taken (:mod:`farfield.annotation.fitting.heading`). That of
   people and two-wheelers is refined by the closeness, or is that of the L-shape of the points that hang together.
4. The rectangle is placed by its points, by rays that passed beyond them, and by the usual size.
5. It stands on the ground, its top by the points, and the sign of the heading is chosen: by the drag, the track, the
   vehicle ahead or behind in the same lane, or the sensor's own way; the points tell an axis only.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from farfield.annotation.fitting.ends import ends_of, passing_rays, place_rectangle
from farfield.annotation.fitting.ground import Ground, fit_ground, points_above, points_near
from farfield.annotation.fitting.heading import (
    DRAWN_DEG,
    MOVED_DEG,
    along_roads,
    around_heading,
    likeliest_heading,
)
from farfield.annotation.fitting.prior import (
    Box,
    BoxFit,
    FitCandidate,
    HeadingFrom,
    Prior,
    along_length,
    axes,
    boxes_of,
    footprint,
)
from farfield.annotation.fitting.search import best_yaw, cluster_at, link_radius_m, refine_yaw, search
from farfield.geometry.boxes import inside_box, wrap_angle_rad
from farfield.vocabulary.counts import count_of

XY = Sequence[float] | Float[np.ndarray, " 2"]

_SEARCHED_RAD = np.deg2rad(np.array([0.0, -4.0, 4.0]))  # the first is placed, the others are offered
_REFINED_RAD = np.deg2rad(np.arange(-4.0, 4.5, 0.5))
_SNAPPED_RAD = np.deg2rad(np.arange(-6.0, 6.5, 0.5))
_WINDOW_M = 0.2  # points so near a box are taken for the object's
REACH_M = 0.8
"""So far from where it was drawn a box is searched when it is fitted again."""
_POINTS_TO_TURN = 15  # with fewer, the heading stays as it is
_POINTS_TO_REFIT = 8  # with fewer, place and heading stay as they are
_LEAST_DRAG_M = 0.3  # a shorter drag is a click
_TRACK_DEG = 3.0  # how far a track turns from one frame to the next
_HIGHER = 1.3  # as much higher than usual objects may be
_UNDECIDED = "the points leave the heading open: it is the likeliest along the lanes; drag along the object to say it"
_WIDER_M = 2.0  # points so far beyond the object's size are looked at
_BESIDE_M = 1.0  # a click so near to a point means that point
_LONGER, _LINK_M, _SAME_M = 0.25, 0.5, 1e-6  # an object goes on lengthwise by a quarter, without gaps of half a metre
_POINTS_FOR_TOP, _TOP_QUANTILE, _LEAST_HEIGHT_M = 8, 0.98, 0.3


@dataclass(frozen=True, eq=False)
class _Scene:
    """The points over the ground about a gesture."""

    ground: Ground
    points_m: Float[np.ndarray, "n 3"]
    cloud_m: Float[np.ndarray, "m 3"]
    rays_m: Float[np.ndarray, "r 2 2"]
    highest_m: float

    @property
    def xy_m(self) -> Float[np.ndarray, "n 2"]:
        return self.points_m[:, :2]

    @property
    def body_xy_m(self) -> Float[np.ndarray, "k 2"]:
        """Those that are no higher than the object: trees and signs above it say nothing of its heading."""
        return self.xy_m[self.ground.heights_m(self.points_m) < self.highest_m]


def fit_drag(points_m: Float[np.ndarray, "n 3"], start_xy: XY, end_xy: XY, prior: Prior) -> BoxFit:
    """Press at the object and drag along its heading: the main gesture.

    The box of the prior's size is searched about the drag's direction, which is off by 4 degrees (one sigma), where it
    holds the place of the press; then fitted to the points in it and within 0.2 m of it. Boxes 4 degrees beside are
    offered.

    Args:
        points_m: All points of the frame, shape (n, 3), metres.
        start_xy: Where the button went down: on the object, x and y, metres.
        end_xy: Where it went up; its direction from the start is the heading. A drag shorter than 0.3 m is a click.
        prior: What is known of the object.
    """
    start, end = _pair(start_xy), _pair(end_xy)
    if np.hypot(end[0] - start[0], end[1] - start[1]) < _LEAST_DRAG_M:
        return fit_click(points_m, start, prior)
    start_s = time.perf_counter()
    drawn = float(np.arctan2(end[1] - start[1], end[0] - start[0]))
    scene = _scene(points_m, start, prior)
    return _search_and_refine(scene, start, drawn, prior, DRAWN_DEG, criterion="drag", drawn_rad=drawn, start_s=start_s)


def fit_click(points_m: Float[np.ndarray, "n 3"], at_xy: XY, prior: Prior) -> BoxFit:
    """One click on an object: the quick gesture, for near objects and for tracks.

    With a track's yaw the box is searched as after a drag. Without, all headings are tried: on the frames that the
    method was chosen on, the axis is within 10 degrees for nine in ten vehicles whose points decide it (``criterion``
    is ``faces``). Where they do not, it is the likeliest along the lanes, and ``note`` says so. The likeliest box of
    another heading is offered first.

    Args:
        points_m: All points of the frame, shape (n, 3), metres.
        at_xy: The click, x and y, metres.
        prior: What is known of the object.
    """
    start_s, at = time.perf_counter(), _pair(at_xy)
    scene = _scene(points_m, at, prior)
    if prior.yaw_rad is not None:
        return _search_and_refine(
            scene, at, prior.yaw_rad, prior, _TRACK_DEG, criterion="track", drawn_rad=None, start_s=start_s
        )
    link_m = link_radius_m(_range_m(at, prior), small=not prior.anchored)
    object_m = scene.points_m[cluster_at(scene.points_m, at, link_m)]
    lane_rad = 0.0 if prior.lane_rad is None else prior.lane_rad
    if len(object_m) < 2:
        criterion = "drawn" if prior.lane_rad is None else "lane"
        return _search_and_refine(scene, at, lane_rad, prior, 0.0, criterion=criterion, drawn_rad=None, start_s=start_s)
    if prior.anchored and prior.grows:
        return _search_and_refine(scene, at, lane_rad, prior, None, criterion="lane", drawn_rad=None, start_s=start_s)
    yaw, criterion = best_yaw(object_m[:, :2])
    yaw, source = choose_heading(along_length(object_m[:, :2], yaw, prior), prior)
    box = stand_on_ground(_rectangle(scene, object_m, yaw, prior), object_m, scene.ground, prior)
    return _box_fit(scene, box, (), criterion, source, start_s)


def refit(points_m: Float[np.ndarray, "n 3"], box: Sequence[float], prior: Prior, *, keep_size: bool = False) -> BoxFit:
    """Fit a box that was drawn, or moved, to its points.

    With fewer than eight points in or near the box its place and yaw stay, and only its size and height are set. A
    vehicle is turned by up to 18 degrees where its points say so; the drawn yaw is taken to be off by 7 (one sigma).

    Args:
        points_m: All points of the frame, shape (n, 3), metres.
        box: x, y, z, length, width, height, yaw.
        prior: What is known of the object.
        keep_size: Keep the box's size instead of the prior's or the measured one.
    """
    start_s = time.perf_counter()
    old = np.asarray(box, dtype=np.float64)
    if keep_size:
        prior = replace(prior, size_m=(float(old[3]), float(old[4]), float(old[5])), fixed_size=True)
    scene = _scene(points_m, (float(old[0]), float(old[1])), prior, least_m=float(np.hypot(old[3], old[4])) / 2)
    drawn = old[[0, 1, 3, 4, 6]]
    object_m = scene.points_m[inside(scene.xy_m, drawn, _WINDOW_M)]
    if len(object_m) < _POINTS_TO_REFIT:
        size = prior.size_m[:2] if prior.grows else drawn[2:4]
        rectangle = np.array([drawn[0], drawn[1], *size, drawn[4]])
        fitted = stand_on_ground(rectangle, object_m, scene.ground, prior)
        note = f"{count_of(len(object_m), 'point')}: place and yaw are as drawn, size and height are set"
        return _box_fit(scene, fitted, (), "drawn", "drag", start_s, note)
    # Search about the drawn place and heading, with the prior's size, and of a visible part with the drawn one.
    sized = prior if prior.grows else replace(prior, size_m=(float(drawn[2]), float(drawn[3]), prior.size_m[2]))
    at, yaw, criterion = (float(drawn[0]), float(drawn[1])), float(drawn[4]), "faces"
    turns = prior.anchored and prior.grows
    if turns:
        heading = likeliest_heading(
            scene.body_xy_m, at, *around_heading(yaw, MOVED_DEG), prior, scene.rays_m, reach_m=REACH_M
        )
        yaw, best = heading.yaw_rad, heading.rectangle
    else:
        best = search(scene.xy_m, at, drawn[4:], sized, reach_m=REACH_M)[0][0]
    near_best_m = scene.points_m[inside(scene.xy_m, best, _WINDOW_M)]
    object_m = near_best_m if len(near_best_m) >= _POINTS_TO_REFIT else object_m
    # Refine the heading, place the rectangle, stand on the ground.
    if not turns:
        yaw, criterion = _refine_yaw(object_m, yaw, _SNAPPED_RAD)
    fitted = stand_on_ground(_rectangle(scene, object_m, yaw, prior), object_m, scene.ground, prior)
    return _box_fit(scene, fitted, (), criterion, "drag", start_s)


def fit_rectangle(
    points_m: Float[np.ndarray, "n 3"], corners_m: Sequence[Sequence[float]] | Float[np.ndarray, "4 2"], prior: Prior
) -> BoxFit:
    """Draw a rectangle: its longer side is the length, and its box is fitted as by :func:`refit`.

    Args:
        points_m: All points of the frame, shape (n, 3), metres.
        corners_m: Its four corners in order, x and y, metres.
        prior: What is known of the object.

    Raises:
        ValueError: If two corners are one.
    """
    corners = np.asarray(corners_m, dtype=np.float64).reshape(4, 2)
    sides = np.array([corners[1] - corners[0], corners[2] - corners[1]])
    lengths = np.hypot(*sides.T)
    if not lengths.min() > 0:
        raise ValueError(f"fit_rectangle: expected four corners apart from each other, got {corners.tolist()}")
    along = sides[int(np.argmax(lengths))]
    yaw, source = choose_heading(float(np.arctan2(along[1], along[0])), prior)
    x, y = corners.mean(axis=0)
    fit = refit(points_m, [x, y, 0.0, lengths.max(), lengths.min(), prior.size_m[2], yaw], prior)
    return replace(fit, heading=source)


def drop_to_ground(points_m: Float[np.ndarray, "n 3"], box: Sequence[float]) -> BoxFit:
    """Move a box up or down until it stands on the ground; all else stays.

    Args:
        points_m: All points of the frame, shape (n, 3), metres.
        box: x, y, z, length, width, height, yaw.
    """
    start_s = time.perf_counter()
    x, y, z, length, width, height, yaw = (float(value) for value in box)
    ground = fit_ground(points_m, (x, y))
    note = "" if ground.cells else "no points within 60 m tell where the ground is: the height is as it was"
    z = ground.z_m(x, y) + height / 2 if ground.cells else z
    dropped = (x, y, z, length, width, height, yaw)
    around = points_near(points_m, (x, y), float(np.hypot(length, width)))
    scene = _Scene(ground, points_above(around, ground), points_m, np.zeros((0, 2, 2)), height)
    return _box_fit(scene, dropped, (), "drawn", "drag", start_s, note)


def _pair(xy: XY) -> tuple[float, float]:
    return float(xy[0]), float(xy[1])


def _range_m(at: tuple[float, float], prior: Prior) -> float:
    return float(np.hypot(at[0] - prior.ego_m[0], at[1] - prior.ego_m[1]))


def _scene(
    points_m: Float[np.ndarray, "n 3"], at: tuple[float, float], prior: Prior, *, least_m: float = 0.0
) -> _Scene:
    ground = fit_ground(points_m, at)
    reach_m = max(float(np.hypot(*prior.size_m[:2])), least_m) + _WIDER_M
    rays_m = passing_rays(points_m, np.array([*at, *prior.size_m[:2], 0.0]), ground, prior)
    above_m = points_above(points_near(points_m, at, reach_m), ground)
    return _Scene(ground, above_m, points_m, rays_m, _HIGHER * prior.size_m[2])


def _search_and_refine(
    scene: _Scene,
    at: tuple[float, float],
    yaw_rad: float,
    prior: Prior,
    spread_deg: float | None,
    *,
    criterion: str,
    drawn_rad: float | None,
    start_s: float,
) -> BoxFit:
    """A box searched about a heading and fitted to its points, with the boxes of other headings on offer.

    The heading may be off by ``spread_deg``; 0 keeps it, None asks the points, with the lanes as prior.
    """
    # Where nothing is there, look about the nearest point.
    rectangles, score, object_m = _search(scene, at, yaw_rad, prior)
    if len(object_m) == 0:
        at = _nearest(scene, at)
        rectangles, score, object_m = _search(scene, at, yaw_rad, prior)
    # The likeliest heading.
    note, yaw = "", yaw_rad
    offered: tuple[FitCandidate, ...] = ()
    if spread_deg != 0 and prior.anchored and prior.grows and len(scene.body_xy_m):
        roads_rad = prior.roads_rad or (() if prior.lane_rad is None else (prior.lane_rad,))
        hypotheses = along_roads(roads_rad) if spread_deg is None else around_heading(yaw_rad, spread_deg)
        heading = likeliest_heading(scene.body_xy_m, at, *hypotheses, prior, scene.rays_m)
        near_m = scene.points_m[inside(scene.xy_m, heading.rectangle, _WINDOW_M)]
        if len(near_m):
            object_m, yaw = near_m, heading.yaw_rad
            rectangles[0] = heading.rectangle
        if spread_deg is None:
            criterion = "faces" if heading.decided else "lane" if roads_rad else "drawn"
            note = "" if heading.decided else _UNDECIDED
            offered = (FitCandidate(box=stand_on_ground(heading.other, near_m, scene.ground, prior), score=0.0),)
    elif len(object_m):
        yaw, _ = _refine_yaw(object_m, yaw_rad, _REFINED_RAD)
    # Take what goes on lengthwise, and place the rectangle.
    if len(object_m) == 0:
        rectangle = np.array([*at, *prior.size_m[:2], yaw_rad])
        note = "no points over the ground here: the box has its usual size about the pointer"
    else:
        object_m = _extend_lengthwise(scene, object_m, yaw, prior)
        rectangle = _rectangle(scene, object_m, yaw, prior)
    # Choose the sign of the heading, offer the boxes beside, and stand on the ground.
    yaw, source = choose_heading(float(rectangle[4]), prior, drawn_rad)
    rectangle[4] = yaw
    beside = tuple(
        FitCandidate(
            box=stand_on_ground(rectangles[number], scene.points_m[:0], scene.ground, prior), score=float(score[number])
        )
        for number in 1 + np.argsort(-score[1:], kind="stable")
    )
    box = stand_on_ground(rectangle, object_m, scene.ground, prior)
    return _box_fit(scene, box, (*offered, *beside), criterion, source, start_s, note)


def _search(
    scene: _Scene, at: tuple[float, float], yaw_rad: float, prior: Prior
) -> tuple[Float[np.ndarray, "k 5"], Float[np.ndarray, " k"], Float[np.ndarray, "m 3"]]:
    """Boxes that hold a place, at a yaw and beside it, their scores, and the points of the first."""
    rectangles, score = search(scene.xy_m, at, yaw_rad + _SEARCHED_RAD, prior)
    return rectangles, score, scene.points_m[inside(scene.xy_m, rectangles[0], _WINDOW_M)]


def _nearest(scene: _Scene, at: tuple[float, float]) -> tuple[float, float]:
    """The point next to a place that was missed by less than a metre, seen from above; else the place."""
    apart = np.hypot(*(scene.xy_m - at).T)
    if len(apart) == 0 or apart.min() > _BESIDE_M:
        return at
    return _pair(scene.xy_m[int(np.argmin(apart))])


def _extend_lengthwise(
    scene: _Scene, object_m: Float[np.ndarray, "k 3"], yaw_rad: float, prior: Prior
) -> Float[np.ndarray, "m 3"]:
    """The points of an object and those that go on from them lengthwise, for one longer than usual."""
    if not (prior.anchored and prior.grows) or prior.fixed_size:
        return object_m
    about = footprint(object_m[:, :2], yaw_rad, prior)
    turn = axes(yaw_rad)
    own, local = (object_m[:, :2] - about[:2]) @ turn.T, (scene.xy_m - about[:2]) @ turn.T
    low, high = own.min(axis=0), own.max(axis=0)
    beside = np.abs(local[:, 1]) <= about[3] / 2 + _WINDOW_M / 2
    reach_m = _LONGER * prior.size_m[0]
    along = np.sort(local[beside & (local[:, 0] > low[0] - reach_m) & (local[:, 0] < high[0] + reach_m), 0])
    for value in along[along > high[0]]:
        if value - high[0] > _LINK_M:
            break
        high[0] = value
    for value in along[along < low[0]][::-1]:
        if low[0] - value > _LINK_M:
            break
        low[0] = value
    along_object = beside & (local[:, 0] >= low[0] - _SAME_M) & (local[:, 0] <= high[0] + _SAME_M)
    return scene.points_m[along_object]


def _rectangle(
    scene: _Scene, object_m: Float[np.ndarray, "k 3"], yaw_rad: float, prior: Prior
) -> Float[np.ndarray, " 5"]:
    """The rectangle of an object's points at a yaw, by what was seen of its ends."""
    about = footprint(object_m[:, :2], yaw_rad, prior)
    ends = ends_of(scene.cloud_m, object_m, about, scene.ground, prior)
    return place_rectangle(ends, object_m[:, :2], yaw_rad, prior)


def _refine_yaw(
    object_m: Float[np.ndarray, "n 3"], yaw_rad: float, turns_rad: Float[np.ndarray, " k"]
) -> tuple[float, str]:
    """The yaw, turned a little where enough points tell by how much."""
    if len(object_m) < _POINTS_TO_TURN:
        return yaw_rad, "drawn"
    return refine_yaw(object_m[:, :2], yaw_rad, turns_rad), "closeness"


def _box_fit(
    scene: _Scene,
    box: Box,
    candidates: tuple[FitCandidate, ...],
    criterion: str,
    heading: HeadingFrom,
    start_s: float,
    note: str = "",
) -> BoxFit:
    count = int(inside_box(scene.points_m, boxes_of(box), 0).sum())
    ms = 1000 * (time.perf_counter() - start_s)
    return BoxFit(box=box, points=count, candidates=candidates, criterion=criterion, heading=heading, ms=ms, note=note)


# From a rectangle to a box: bottom on the ground, top by the points, and the sign of the heading.


def inside(
    xy_m: Float[np.ndarray, "n 2"], rectangle: Float[np.ndarray, " 5"], margin_m: float = 0.0
) -> Bool[np.ndarray, " n"]:
    """Whether points seen from above lie in a rectangle (x, y, length, width, yaw), shape (n,)."""
    local = (xy_m - rectangle[:2]) @ axes(float(rectangle[4])).T
    return np.asarray((np.abs(local) <= rectangle[2:4] / 2 + margin_m).all(axis=1))


def stand_on_ground(
    rectangle: Float[np.ndarray, " 5"], points_m: Float[np.ndarray, "n 3"], ground: Ground, prior: Prior
) -> Box:
    """A box on the ground under its centre.

    Its top is the 98 % quantile of its points' heights where there are eight or more, and the prior's height otherwise
    or where the size is fixed.

    Args:
        rectangle: x, y, length, width, yaw.
        points_m: The object's points.
        ground: The ground near it.
        prior: What is known of the object.
    """
    x, y, length, width, yaw = rectangle.tolist()
    height = prior.size_m[2]
    if len(points_m) >= _POINTS_FOR_TOP and not prior.fixed_size:
        top = float(np.quantile(ground.heights_m(points_m), _TOP_QUANTILE))
        height = max(top, _LEAST_HEIGHT_M)
    return x, y, ground.z_m(x, y) + height / 2, length, width, height, float(wrap_angle_rad(np.array(yaw)))


def choose_heading(yaw_rad: float, prior: Prior, drawn_rad: float | None = None) -> tuple[float, HeadingFrom]:
    """The yaw or its opposite, by the drag's direction, the track's or the lane's, in this order; else as it is.

    >>> from farfield.annotation.fitting.prior import prior_of
    >>> headed(3.0, prior_of("Sedan"), drawn_rad=0.1)
    (-0.14159265358979312, 'drag')
    """
    directions: tuple[tuple[float | None, HeadingFrom], ...] = (
        (drawn_rad, "drag"),
        (prior.yaw_rad, "track"),
        (prior.lane_rad, "lane"),
    )
    for direction, source in directions:
        if direction is not None:
            return (yaw_rad if np.cos(yaw_rad - direction) >= 0 else yaw_rad - np.pi), source
    return yaw_rad, "ask"
