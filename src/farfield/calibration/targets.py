"""Objects that both sensors can place, as the LiDAR sees them: near faces of clusters with their velocity.

Near faces are used on both sides: the centre of a car would move x by half its length.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy import ndimage
from scipy.spatial import cKDTree

from farfield.calibration.moments import SensorPair

_CELL_M = 0.4
THIN_M = 0.8
"""A target narrower than this is a post, or alike: its echo is one lobe of the beam, and may be weak."""
_DEEPER_M = 0.05  # a body's echo comes from deeper than its nearest points
_LEAST_POINTS = 6
_LARGEST_M = 6.5
_FACE_M = 0.6
_STEP_M = 8.0
_AGREE_M = 0.45
_BESIDE_RAD, _BEFORE_M = np.radians(0.6), 1.0
_SLOW_M = 0.25  # a frame
_NEAR_M = (5.0, 1.5)
_LEAST_STEPS = 4
_UNEVEN_M = 0.15  # a frame


@dataclass(frozen=True, eq=False, kw_only=True)
class LidarTargets:
    """LiDAR targets of one frame.

    Args:
        place_m: Middle of the near face, shape (n, 3).
        size_m: Extent of the whole cluster in x and y, shape (n, 2).
        lag_s: When the face was measured, after the sweep's own time, shape (n,).
        velocity: Metres a frame relative to the LiDAR, shape (n, 2); NaN where it was not seen three times.
        track: Number of the object over the frames, shape (n,): what it gets wrong, it gets wrong in each of them.
    """

    place_m: Float[np.ndarray, "n 3"]
    size_m: Float[np.ndarray, "n 2"]
    lag_s: Float[np.ndarray, " n"]
    velocity: Float[np.ndarray, "n 2"]
    track: Int[np.ndarray, " n"]


def find_targets(moments: Sequence[SensorPair]) -> list[LidarTargets]:
    """Clusters of each frame with velocities from the frames before and after, and the objects that they are of."""
    raw = {each.number: _clusters(each) for each in moments}
    nothing = np.zeros((0, 3)), np.zeros((0, 2)), np.zeros(0)
    found: list[LidarTargets] = []
    count, last = 0, None
    for number, (place, size, lag) in raw.items():
        before, after = raw.get(number - 1, nothing)[0], raw.get(number + 1, nothing)[0]
        velocity = _velocities(before, place, after)
        track = count + np.arange(len(place))
        if found and last == number - 1:
            track = _continued(found[-1], place, velocity, track)
        count, last = count + len(place), number
        found.append(LidarTargets(place_m=place, size_m=size, lag_s=lag, velocity=velocity, track=track))
    return _reunited(_steadied(found, count))


def _reunited(found: list[LidarTargets]) -> list[LidarTargets]:
    """What keeps its place beside the car, as leading traffic does, is one object in later runs of frames too."""
    last: dict[int, np.ndarray] = {}  # where each object was seen last
    named: dict[int, int] = {}
    for each in found:
        slow = np.linalg.norm(each.velocity, axis=1) < _SLOW_M
        seen = {named[int(track)] for track in each.track[slow] if int(track) in named}
        for track, place in zip(each.track[slow], each.place_m[slow, :2], strict=True):
            if int(track) not in named:
                near = [one for one, at in last.items() if one not in seen and (np.abs(at - place) < _NEAR_M).all()]
                named[int(track)] = near[-1] if near else int(track)
            seen.add(named[int(track)])
            last[named[int(track)]] = place
    return [
        replace(each, track=np.array([named.get(int(track), int(track)) for track in each.track], dtype=np.int64))
        for each in found
    ]


def _steadied(found: list[LidarTargets], count: int) -> list[LidarTargets]:
    """Each object's median velocity; NaN where it was seen less than four times or not evenly: a wrong partner."""
    seen: list[list[np.ndarray]] = [[] for _ in range(count)]
    for each in found:
        for track, velocity in zip(each.track, each.velocity, strict=True):
            if np.isfinite(velocity[0]):
                seen[track].append(velocity)
    steady = np.full((count, 2), np.nan)
    for track, steps in enumerate(seen):
        if len(steps) >= _LEAST_STEPS and np.std(steps, axis=0).max() < _UNEVEN_M:
            steady[track] = np.median(steps, axis=0)
    return [replace(each, velocity=steady[each.track]) for each in found]


def _continued(
    earlier: LidarTargets,
    place_m: Float[np.ndarray, "n 3"],
    velocity: Float[np.ndarray, "n 2"],
    new: Int[np.ndarray, " n"],
) -> Int[np.ndarray, " n"]:
    """Numbers of the tracks that clusters go on; new ones where they come from nowhere."""
    if not len(earlier.place_m) or not len(place_m):
        return new
    usual = np.nan_to_num(np.nanmedian(velocity, axis=0)) if np.isfinite(velocity).any() else np.zeros(2)
    back = place_m[:, :2] - np.where(np.isfinite(velocity), velocity, usual)
    distance, partner = cKDTree(earlier.place_m[:, :2]).query(back)
    return np.where(distance < 2 * _AGREE_M, earlier.track[partner], new)


def _clusters(moment: SensorPair) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
    points = moment.points_m
    shadow = _Shadow.of(points)
    places, sizes, lags = [], [], []
    for members in _components(points):
        part = points[members]
        size = np.ptp(part[:, :2], axis=0)
        if len(part) < _LEAST_POINTS or size.max() > _LARGEST_M or np.ptp(part[:, 2]) < 0.3:
            continue
        reach = np.hypot(part[:, 0], part[:, 1])
        front = float(np.percentile(reach, 5))
        face = reach < front + _FACE_M
        bearing = np.arctan2(part[face, 1], part[face, 0])
        if shadow.falls_on(bearing.min(), bearing.max(), front, float(part[face, 2].mean()) / front):
            continue
        middle = 0.5 * (bearing.min() + bearing.max())
        near = front + (_DEEPER_M if size.max() > THIN_M else 0.0)
        places.append([near * np.cos(middle), near * np.sin(middle), float(part[face, 2].mean())])
        sizes.append(size)
        lags.append(float(moment.lag_s[members][face].mean()))
    return np.reshape(places, (-1, 3)), np.reshape(sizes, (-1, 2)), np.array(lags)


@dataclass(frozen=True, eq=False)
class _Shadow:
    """Bearings, ranges and slopes of all points by bearing: what is half hidden shows no middle."""

    bearing: Float[np.ndarray, " n"]
    reach_m: Float[np.ndarray, " n"]
    slope: Float[np.ndarray, " n"]

    @classmethod
    def of(cls, points_m: Float[np.ndarray, "n 3"]) -> "_Shadow":
        bearing = np.arctan2(points_m[:, 1], points_m[:, 0])
        order = np.argsort(bearing)
        reach = np.hypot(points_m[:, 0], points_m[:, 1])
        return cls(bearing[order], reach[order], (points_m[:, 2] / np.maximum(reach, 1.0))[order])

    def falls_on(self, right_rad: float, left_rad: float, front_m: float, slope: float) -> bool:
        """Whether something nearer stands just beside, on either side, as high as the middle of the face or higher."""
        for begin, end in ((right_rad - _BESIDE_RAD, right_rad), (left_rad, left_rad + _BESIDE_RAD)):
            low, high = np.searchsorted(self.bearing, (begin, end))
            if ((self.reach_m[low:high] < front_m - _BEFORE_M) & (self.slope[low:high] > slope)).any():
                return True
        return False


def _components(points_m: Float[np.ndarray, "n 3"]) -> list[Int[np.ndarray, " _"]]:
    """Indices of the points of each connected part of the occupied cells."""
    if not len(points_m):
        return []
    cell = np.floor(points_m[:, :2] / _CELL_M).astype(int)
    cell -= cell.min(axis=0)
    grid = np.zeros(cell.max(axis=0) + 1, dtype=bool)
    grid[cell[:, 0], cell[:, 1]] = True
    labels, _ = ndimage.label(grid, structure=np.ones((3, 3)))
    label = labels[cell[:, 0], cell[:, 1]]
    order = np.argsort(label, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)


def _velocities(
    before: Float[np.ndarray, "a 3"], now: Float[np.ndarray, "n 3"], after: Float[np.ndarray, "b 3"]
) -> Float[np.ndarray, "n 2"]:
    """Steps that carry a cluster evenly from the frame before to the frame after; NaN where none or several do."""
    velocity = np.full((len(now), 2), np.nan)
    if not len(before) or not len(after):
        return velocity
    tree = cKDTree(before[:, :2])
    candidates = []
    for place in now[:, :2]:
        step = after[:, :2] - place
        near = (np.abs(step[:, 0]) < _STEP_M) & (np.abs(step[:, 1]) < 1.0)
        steps = step[near]
        distance, partner = (np.asarray(each) for each in tree.query(place - steps))
        good = distance < _AGREE_M
        candidates.append(0.5 * (steps[good] + place - before[partner[good], :2]))
    usual = _usual(candidates)
    for index, steps in enumerate(candidates):
        if len(steps) == 1:
            velocity[index] = steps[0]
        elif len(steps):  # several explain it: the one that stands still, if there is one
            away = np.linalg.norm(steps - usual, axis=1)
            velocity[index] = steps[np.argmin(away)] if away.min() < _AGREE_M else np.nan
    return velocity


def _usual(candidates: list[Float[np.ndarray, "_ 2"]]) -> Float[np.ndarray, " 2"]:
    """The step with most others nearby: that of the standing world."""
    steps = np.concatenate([np.zeros((0, 2)), *candidates])
    if not len(steps):
        return np.zeros(2)
    near = cKDTree(steps).query_ball_point(steps, _AGREE_M / 2)
    best = max(near, key=len)
    return np.asarray(np.median(steps[best], axis=0))
