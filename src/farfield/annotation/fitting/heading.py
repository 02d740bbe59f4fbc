"""The heading of a vehicle by its points: how likely every heading is, whichever gesture needs it.

The log likelihood of a rectangle counts, over cells of 0.1 m in proportion to the root of their points,

- points that lie on the faces towards the sensor (a normal curve of 0.12 m across the face), since a sensor sees no
  others: this is what the closeness of Zhang et al. (see :mod:`farfield.annotation.fitting.search`) rewards;
- less points that stand just outside, which the rectangle would have had to hold;
- less rays that went through it at the height of its body, where the sensor's place is certain.

To it the log prior of the gesture is added: a drag is off by 4 degrees, a box that is fitted again by 7, and a click
knows no more than that most vehicles stand along their lane, the vehicles about them, or across.

All of this is about the *axis*: an outline seen from above is the same turned by 180 degrees. Which of the two ends is
the front is for :func:`~farfield.annotation.fitting.boxes.choose_heading`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from farfield.annotation.fitting.prior import Prior, axes, footprint
from farfield.annotation.fitting.search import cluster_at, search, subsample

_CELL_M, _MOST_CELLS = 0.1, 400
_FACE_M = 0.12  # spread of a face's points across it
_SLACK_M, _RING_M = 0.1, 0.6  # points so far outside still are the object's; from there to the ring they are not
_WINDOW_M = 0.2  # points so near to a searched rectangle are taken for the object's
_INNER_M, _WHOLE_RAY_M = 0.25, 0.5  # rays are looked at so far inside the outline, and count in full from this length
_LINK_M, _LINK_PER_M = 0.25, 0.008  # cells so near to one another hang together: at the sensor, and more per metre
_BARE, _MOST_BARE_M = 1.0, 3.0
_BEND = 0.5  # points of one object are no independent witnesses: so much of the log likelihood counts
_SHIFTS_M = np.stack(np.meshgrid(*[np.arange(-1, 2) * 0.1] * 2), axis=-1).reshape(-1, 2)
_COARSE_RAD, _FINE_RAD = np.deg2rad(np.arange(0.0, 180.0, 6.0)), np.deg2rad(np.arange(-3.0, 4.0))
DRAWN_DEG, MOVED_DEG = 4.0, 7.0
"""Spread of the heading that a person drew by a drag, and of a box that is fitted again, degrees."""
_ROAD_DEG, _ACROSS, _ANY = 6.0, 0.2, 0.02  # vehicles about their lane; those across; and however they like
_APART_RAD, DECIDED = np.deg2rad(12.0), 3.0
"""A heading is decided where it is more likely than all that are so far from it by this much (natural logarithm)."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Heading:
    """The likeliest heading.

    Args:
        yaw_rad: Its axis: that of the hypothesis, not yet the side on which the front is.
        rectangle: Where the object is then: x, y, length, width, yaw.
        other: Where it is at the likeliest heading beyond 12 degrees; none were tried: as ``rectangle``.
        margin: By how much its log likelihood, without any prior, exceeds that of headings beyond 12 degrees.
    """

    yaw_rad: float
    rectangle: Float[np.ndarray, " 5"]
    other: Float[np.ndarray, " 5"]
    margin: float

    @property
    def decided(self) -> bool:
        """Whether the points tell it without the prior."""
        return self.margin >= DECIDED


def around_heading(yaw_rad: float, spread_deg: float) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Headings about one that was drawn, and their log prior, shape (k,) both: within 2.5 spreads, 2 degrees apart."""
    turns_deg = np.arange(-np.ceil(1.25 * spread_deg), np.ceil(1.25 * spread_deg) + 1) * 2.0
    return yaw_rad + np.deg2rad(turns_deg), -0.5 * (turns_deg / spread_deg) ** 2


def along_roads(roads_rad: Sequence[float]) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """All headings of half a turn, and their log prior where vehicles drive along some directions, shape (k,) both."""
    if not roads_rad:
        return _COARSE_RAD, np.zeros(len(_COARSE_RAD))
    off_rad = np.abs(np.mod(_COARSE_RAD[:, None] - np.array(roads_rad) + np.pi / 2, np.pi) - np.pi / 2)
    spread = np.deg2rad(_ROAD_DEG)
    along = np.exp(-0.5 * (off_rad / spread) ** 2).mean(axis=1)
    across = np.exp(-0.5 * ((np.pi / 2 - off_rad) / spread) ** 2).mean(axis=1)
    return _COARSE_RAD, np.log(along + _ACROSS * across + _ANY)


def likeliest_heading(
    xy_m: Float[np.ndarray, "n 2"],
    at_m: tuple[float, float],
    yaws_rad: Float[np.ndarray, " k"],
    log_prior: Float[np.ndarray, " k"],
    prior: Prior,
    rays_m: Float[np.ndarray, "m 2 2"],
    *,
    reach_m: float = np.inf,
) -> Heading:
    """The likeliest of some headings, refined to a degree.

    Args:
        xy_m: Points over the ground, seen from above; at least one.
        at_m: A place that the object holds.
        yaws_rad: Headings to try.
        log_prior: Log prior of each.
        prior: The size, and where the sensor stands.
        rays_m: Stretches that rays passed at the height of bodies, shape (m, 2, 2): start and end, x and y.
        reach_m: How far the object's middle may be from the place along each of its axes.
    """
    cells_m, weight = _cells(xy_m)
    own_weight = weight
    if len(yaws_rad) == len(_COARSE_RAD):  # any heading: one across a row of vehicles would gain by its neighbours
        link_m = _LINK_M + _LINK_PER_M * float(np.hypot(at_m[0] - prior.ego_m[0], at_m[1] - prior.ego_m[1]))
        linked = cluster_at(np.column_stack([cells_m, np.zeros(len(cells_m))]), at_m, link_m)
        own_weight = np.where(linked, weight, 0.0)
    # Each heading at its best place.
    rectangles, score = _best_rectangles(cells_m, weight, own_weight, xy_m, at_m, yaws_rad, prior, rays_m, reach_m)
    best = int(np.argmax(_BEND * score + log_prior))
    apart = np.abs(np.mod(yaws_rad - yaws_rad[best] + np.pi / 2, np.pi) - np.pi / 2) > _APART_RAD
    margin = float(_BEND * (score[best] - score[apart].max())) if apart.any() else 0.0
    other = rectangles[int(np.argmax(np.where(apart, _BEND * score + log_prior, -np.inf))) if apart.any() else best]
    # A degree about the best, where the prior between two tried headings is taken as straight.
    fine_rad = yaws_rad[best] + _FINE_RAD
    period = np.pi if len(yaws_rad) == len(_COARSE_RAD) else None
    fine_prior = np.interp(fine_rad, yaws_rad, log_prior, period=period)
    fine, score = _best_rectangles(cells_m, weight, own_weight, xy_m, at_m, fine_rad, prior, rays_m, reach_m)
    best = int(np.argmax(_BEND * score + fine_prior))
    return Heading(yaw_rad=float(fine_rad[best]), rectangle=fine[best], other=other, margin=margin)


def _best_rectangles(
    cells_m: Float[np.ndarray, "c 2"],
    weight: Float[np.ndarray, " c"],
    own_weight: Float[np.ndarray, " c"],
    xy_m: Float[np.ndarray, "n 2"],
    at_m: tuple[float, float],
    yaws_rad: Float[np.ndarray, " k"],
    prior: Prior,
    rays_m: Float[np.ndarray, "m 2 2"],
    reach_m: float,
) -> tuple[Float[np.ndarray, "k 5"], Float[np.ndarray, " k"]]:
    """Where the object is at each heading, as the search has it or with its faces on the points, and how likely."""
    rectangles, score = search(xy_m, at_m, yaws_rad, prior, reach_m=reach_m)
    sized = replace(prior, fixed_size=True)
    for row, rectangle in enumerate(rectangles):
        turn = axes(float(rectangle[4]))
        near = (np.abs((cells_m - rectangle[:2]) @ turn.T) <= rectangle[2:4] / 2 + _WINDOW_M).all(axis=1)
        anchored = footprint(cells_m[near], float(rectangle[4]), sized) if near.any() else rectangle
        shifts = _SHIFTS_M @ turn
        shifted = np.repeat(np.stack([rectangle, anchored]), len(shifts), axis=0)
        shifted[:, :2] += np.tile(shifts, (2, 1))
        likelihood = log_likelihood(cells_m, weight, own_weight, shifted, prior, rays_m)
        best = int(np.argmax(likelihood))
        rectangles[row], score[row] = (rectangle, anchored)[best // len(shifts)], likelihood[best]
    return rectangles, score


def log_likelihood(
    cells_m: Float[np.ndarray, "c 2"],
    weight: Float[np.ndarray, " c"],
    own_weight: Float[np.ndarray, " c"],
    rectangles: Float[np.ndarray, "k 5"],
    prior: Prior,
    rays_m: Float[np.ndarray, "m 2 2"],
) -> Float[np.ndarray, " k"]:
    """Log likelihood of rectangles of one heading, up to a constant, shape (k,).

    Args:
        cells_m: Cells with points, shape (c, 2).
        weight: How much each counts where it stands outside, shape (c,).
        own_weight: And where it lies on a face, shape (c,).
        rectangles: x, y, length, width, yaw; the yaw of all is that of the first.
        prior: Where the sensor stands.
        rays_m: As of :func:`likeliest_heading`.
    """
    turn, half = axes(float(rectangles[0, 4])), rectangles[:, 2:4] / 2
    centre = rectangles[:, :2] @ turn.T
    local = (cells_m @ turn.T)[None] - centre[:, None]
    outside = (np.abs(local) - half[:, None]).max(axis=2)
    # The faces that look at the sensor: none along an axis where it stands beside the object.
    ego = turn @ np.array(prior.ego_m) - centre
    facing = np.where(np.abs(ego) > half, np.sign(ego), np.nan)
    depth = np.nan_to_num(np.abs(half[:, None] - facing[:, None] * local), nan=np.inf).min(axis=2)
    on_face = np.where(outside <= _SLACK_M, np.exp(-0.5 * (depth / _FACE_M) ** 2), 0.0) @ own_weight
    beyond = ((outside > _SLACK_M) & (outside <= _RING_M)) @ weight
    bare = _bare_width(local, outside <= _SLACK_M, ego, half)
    return np.asarray(on_face - beyond - _rays_through(rays_m @ turn.T, centre, half) - _BARE * bare)


def _bare_width(
    local_m: Float[np.ndarray, "k c 2"],
    inside: Bool[np.ndarray, "k c"],
    ego_m: Float[np.ndarray, "k 2"],
    half_m: Float[np.ndarray, "k 2"],
) -> Float[np.ndarray, " k"]:
    """How much of the rectangles' width, as the sensor sees it, bears no points, metres, shape (k,).

    The stretch of n points drawn evenly from a width is (n - 1) / (n + 1) of it on average.
    """
    across = np.stack([-ego_m[:, 1], ego_m[:, 0]], axis=1) / np.maximum(np.hypot(*ego_m.T), _SLACK_M)[:, None]
    width = 2 * (np.abs(across) * half_m).sum(axis=1)
    beside = np.einsum("kca,ka->kc", local_m, across)
    count = inside.sum(axis=1)
    stretch = np.where(inside, beside, -np.inf).max(axis=1) - np.where(inside, beside, np.inf).min(axis=1)
    covered = np.where(count > 1, stretch * (count + 1) / np.maximum(count - 1, 1), 0.0)
    return np.clip(width - np.where(count > 1, covered, 0.0), 0.0, _MOST_BARE_M)


def _rays_through(
    rays_m: Float[np.ndarray, "m 2 2"], centre_m: Float[np.ndarray, "k 2"], half_m: Float[np.ndarray, "k 2"]
) -> Float[np.ndarray, " k"]:
    """How many rays went through rectangles, shape (k,); all along the rectangles' axes."""
    start, step = rays_m[:, 0], rays_m[:, 1] - rays_m[:, 0]
    safe = np.where(np.abs(step) < 1e-9, 1e-9, step)
    inner = np.maximum(half_m - _INNER_M, _SLACK_M)
    sides = np.stack([centre_m - inner, centre_m + inner])[:, :, None]
    shares = np.sort((sides - start) / safe, axis=0)
    inside = np.minimum(shares[1].min(axis=2), 1.0) - np.maximum(shares[0].max(axis=2), 0.0)
    length_m = np.maximum(inside, 0.0) * np.hypot(step[:, 0], step[:, 1])
    return np.asarray(np.minimum(length_m / _WHOLE_RAY_M, 1.0).sum(axis=1))


def _cells(xy_m: Float[np.ndarray, "n 2"]) -> tuple[Float[np.ndarray, "c 2"], Float[np.ndarray, " c"]]:
    """Mean points of cells, and the root of how many there are."""
    cell = np.floor(xy_m / _CELL_M).astype(np.int64)
    cell -= cell.min(axis=0)
    code = cell[:, 0] * (int(cell[:, 1].max()) + 1) + cell[:, 1]
    _, member, count = np.unique(code, return_inverse=True, return_counts=True)
    mean = np.stack([np.bincount(member.ravel(), xy_m[:, axis]) / count for axis in (0, 1)], axis=1)
    chosen = subsample(np.column_stack([mean, np.sqrt(count)]), _MOST_CELLS)
    return chosen[:, :2], chosen[:, 2]
