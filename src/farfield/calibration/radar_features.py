"""What LiDAR and radar each see of a frame, for radar-LiDAR calibration: points and echoes, objects and peaks.

:func:`read_sensor_pairs` reduces frames to standing points and to echoes over what is usual; :func:`find_targets` finds
the LiDAR's objects, with velocities, and :func:`find_peaks` the radar's. Near faces are used on both sides: the centre
of a car would move x by half its length.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage
from scipy.spatial import cKDTree

from farfield.errors import DatasetError
from farfield.frame import Frame
from farfield.geometry.poses import invert, transform_points

# Frames: points that stand above the ground, and the strongest echoes

_GROUND_CELL_M = 2.0
_REACH_M = 72.0
_COLUMN_M = 0.4  # of the radar's cloud


@dataclass(frozen=True, eq=False, kw_only=True)
class SensorPair:
    """One LiDAR sweep and the radar frame that the data set pairs with it.

    Args:
        number: Number of the sweep in its sequence; neighbours differ by one.
        points_m: LiDAR points that stand above the ground, in the LiDAR's frame, shape (n, 3).
        lag_s: When each was measured after the sweep's own time, shape (n,); zero where it is not known.
        echoes_m: Radar echoes in the radar's own frame, the strongest of each column of 0.4 m, shape (m, 3).
        power_db: Their power over what is usual at that range, shape (m,).
    """

    number: int
    points_m: Float[np.ndarray, "n 3"]
    lag_s: Float[np.ndarray, " n"]
    echoes_m: Float[np.ndarray, "m 3"]
    power_db: Float[np.ndarray, " m"]


def read_sensor_pairs(
    frames: Iterable[Frame], *, lidar: str = "os2-64", radar: str = "radar", node_m: float = 0.0
) -> list[SensorPair]:
    """Reduce consecutive frames of one sequence.

    Args:
        frames: Frames in order; runs of consecutive ones, the more the better.
        lidar: Name of the LiDAR's cloud, in the frame's coordinates.
        radar: Name of the radar's cloud; its sensor's ``frame_T_sensor`` is taken back.
        node_m: Added to the echoes along each axis: 0.2 m for K-Radar's clouds, whose points stand half a cell below
            the node that was measured.

    Raises:
        DatasetError: If a frame lacks one of the clouds, or the radar has no pose or no ``power``.
    """
    return [
        _sensor_pair(frame, frame.indices.get(lidar, number), lidar, radar, node_m)
        for number, frame in enumerate(frames)
    ]


def _sensor_pair(frame: Frame, number: int, lidar: str, radar: str, node_m: float) -> SensorPair:
    missing = [name for name in (lidar, radar) if name not in frame.clouds]
    pose = frame.sensors[radar].frame_T_sensor if radar in frame.sensors else None
    if missing or pose is None:
        what = f"the cloud {missing[0]}" if missing else f"frame_T_sensor of {radar}"
        raise DatasetError(f"frame {frame.key}: radar-lidar calibration needs {what}; found {sorted(frame.clouds)}")
    cloud, echoes = frame.clouds[lidar], frame.clouds[radar]
    strength = next((name for name in ("power", "rcs_dbsm") if name in echoes.extra), None)
    if strength is None:
        raise DatasetError(f"frame {frame.key}: expected power or rcs_dbsm in the cloud {radar}, got {echoes.columns}")
    points = cloud.points_m.astype(np.float64)
    inside = (points[:, 0] > 1.0) & (np.abs(points[:, 1]) < 40.0) & (points[:, 0] < _REACH_M + 4.0)
    offsets_s = cloud.offsets_s()
    lag = np.zeros(int(inside.sum())) if offsets_s is None else offsets_s[inside]
    points = points[inside]
    height = above_ground_m(points)
    standing = (height > 0.3) & (height < 3.0)
    echoes_m = transform_points(invert(pose), echoes.points_m.astype(np.float64)) + node_m
    values = echoes.extra[strength].astype(np.float64)
    decibel = 10 * np.log10(np.maximum(values, 1e-30)) if strength == "power" else values
    excess = excess_db(echoes_m, decibel)
    strongest = _strongest_of_columns(echoes_m, excess)
    return SensorPair(
        number=int(number),
        points_m=points[standing],
        lag_s=lag[standing],
        echoes_m=echoes_m[strongest],
        power_db=excess[strongest],
    )


def _strongest_of_columns(
    echoes_m: Float[np.ndarray, "m 3"], decibel: Float[np.ndarray, " m"]
) -> Int[np.ndarray, " k"]:
    """Indices of the strongest echo of each column, seen from above."""
    if not len(echoes_m):
        return np.zeros(0, dtype=int)
    cell = np.rint(echoes_m[:, :2] / _COLUMN_M).astype(int)
    cell -= cell.min(axis=0)
    column = cell @ (cell[:, 1].max() + 1, 1)
    top = np.full(column.max() + 1, -np.inf)
    np.maximum.at(top, column, decibel)
    equal = np.flatnonzero(decibel == top[column])
    return equal[np.unique(column[equal], return_index=True)[1]]


def above_ground_m(points_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """Height of points above the lowest returns around, shape (n,): a low percentile over 10 m of 2 m cells."""
    if not len(points_m):
        return np.zeros(0)
    cell = np.floor(points_m[:, :2] / _GROUND_CELL_M).astype(int)
    cell -= cell.min(axis=0)
    shape = tuple(cell.max(axis=0) + 1)
    low = np.full(shape, np.inf)
    np.minimum.at(low, (cell[:, 0], cell[:, 1]), points_m[:, 2])
    nearest = ndimage.distance_transform_edt(~np.isfinite(low), return_distances=False, return_indices=True)
    ground = ndimage.percentile_filter(low[tuple(nearest)], 20, size=5)
    return np.asarray(points_m[:, 2] - ground[cell[:, 0], cell[:, 1]])


def excess_db(echoes_m: Float[np.ndarray, "m 3"], decibel: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
    """Power over the median of the same 4 m of range, shape (m,)."""
    ring = np.minimum(np.hypot(echoes_m[:, 0], echoes_m[:, 1]) / 4.0, 200).astype(int)
    usual = ndimage.median(decibel, ring, np.arange(ring.max(initial=0) + 1)) if len(ring) else np.zeros(1)
    return decibel - np.asarray(usual)[ring]


# Objects of the LiDAR: near faces of clusters, with their velocity and the object that they are of

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


def find_targets(sensor_pairs: Sequence[SensorPair]) -> list[LidarTargets]:
    """Clusters of each frame with velocities from the frames before and after, and the objects that they are of."""
    # 1. Clusters of each frame.
    clusters = {pair.number: _clusters(pair) for pair in sensor_pairs}
    nothing = np.zeros((0, 3)), np.zeros((0, 2)), np.zeros(0)
    frames: list[LidarTargets] = []
    count, last = 0, None
    for number, (position, size, lag) in clusters.items():
        # 2. Velocities, from the frames beside it.
        before, after = clusters.get(number - 1, nothing)[0], clusters.get(number + 1, nothing)[0]
        velocity = _velocities(before, position, after)

        # 3. Tracks, continued from the frame before.
        track = count + np.arange(len(position))
        if frames and last == number - 1:
            track = _continue_tracks(frames[-1], position, velocity, track)
        count, last = count + len(position), number
        frames.append(LidarTargets(place_m=position, size_m=size, lag_s=lag, velocity=velocity, track=track))

    # 4. One velocity a track; tracks of what stays beside the car joined over the runs of frames.
    return _join_slow_tracks(_median_velocities(frames, count))


def _join_slow_tracks(frames: list[LidarTargets]) -> list[LidarTargets]:
    """What stays beside the car, as leading traffic does, is one object in later runs of frames too."""
    last_position: dict[int, np.ndarray] = {}
    object_of: dict[int, int] = {}
    for targets in frames:
        slow = np.linalg.norm(targets.velocity, axis=1) < _SLOW_M
        present = {object_of[int(track)] for track in targets.track[slow] if int(track) in object_of}
        for track, position in zip(targets.track[slow], targets.place_m[slow, :2], strict=True):
            if int(track) not in object_of:
                near = [
                    number
                    for number, last in last_position.items()
                    if number not in present and (np.abs(last - position) < _NEAR_M).all()
                ]
                object_of[int(track)] = near[-1] if near else int(track)
            present.add(object_of[int(track)])
            last_position[object_of[int(track)]] = position
    return [
        replace(targets, track=np.array([object_of.get(int(t), int(t)) for t in targets.track], dtype=np.int64))
        for targets in frames
    ]


def _median_velocities(frames: list[LidarTargets], count: int) -> list[LidarTargets]:
    """Each object's median velocity; NaN where it was seen less than four times or not evenly: a wrong partner."""
    steps_of: list[list[np.ndarray]] = [[] for _ in range(count)]
    for targets in frames:
        for track, velocity in zip(targets.track, targets.velocity, strict=True):
            if np.isfinite(velocity[0]):
                steps_of[track].append(velocity)
    median = np.full((count, 2), np.nan)
    for track, steps in enumerate(steps_of):
        if len(steps) >= _LEAST_STEPS and np.std(steps, axis=0).max() < _UNEVEN_M:
            median[track] = np.median(steps, axis=0)
    return [replace(targets, velocity=median[targets.track]) for targets in frames]


def _continue_tracks(
    earlier: LidarTargets,
    position_m: Float[np.ndarray, "n 3"],
    velocity: Float[np.ndarray, "n 2"],
    new: Int[np.ndarray, " n"],
) -> Int[np.ndarray, " n"]:
    """Numbers of the tracks that clusters continue; new ones where they come from nowhere."""
    if not len(earlier.place_m) or not len(position_m):
        return new
    usual = np.nan_to_num(np.nanmedian(velocity, axis=0)) if np.isfinite(velocity).any() else np.zeros(2)
    back = position_m[:, :2] - np.where(np.isfinite(velocity), velocity, usual)
    distance, partner = cKDTree(earlier.place_m[:, :2]).query(back)
    return np.where(distance < 2 * _AGREE_M, earlier.track[partner], new)


def _clusters(pair: SensorPair) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
    """Middles of the near faces of all clusters that nothing hides in part, their sizes, and times of the faces."""
    points = pair.points_m
    shadow = _Shadow.of(points)
    positions, sizes, lags = [], [], []
    for members in _components(points):
        cluster = points[members]
        size = np.ptp(cluster[:, :2], axis=0)
        if len(cluster) < _LEAST_POINTS or size.max() > _LARGEST_M or np.ptp(cluster[:, 2]) < 0.3:
            continue
        range_m = np.hypot(cluster[:, 0], cluster[:, 1])
        front = float(np.percentile(range_m, 5))
        face = range_m < front + _FACE_M
        bearing = np.arctan2(cluster[face, 1], cluster[face, 0])
        height = float(cluster[face, 2].mean())
        if shadow.falls_on(bearing.min(), bearing.max(), front, height / front):
            continue
        middle = 0.5 * (bearing.min() + bearing.max())
        near = front + (_DEEPER_M if size.max() > THIN_M else 0.0)
        positions.append([near * np.cos(middle), near * np.sin(middle), height])
        sizes.append(size)
        lags.append(float(pair.lag_s[members][face].mean()))
    return np.reshape(positions, (-1, 3)), np.reshape(sizes, (-1, 2)), np.array(lags)


@dataclass(frozen=True, eq=False)
class _Shadow:
    """Bearings, ranges and slopes of all points by bearing: what is half hidden shows no middle."""

    bearing: Float[np.ndarray, " n"]
    range_m: Float[np.ndarray, " n"]
    slope: Float[np.ndarray, " n"]

    @classmethod
    def of(cls, points_m: Float[np.ndarray, "n 3"]) -> "_Shadow":
        bearing = np.arctan2(points_m[:, 1], points_m[:, 0])
        order = np.argsort(bearing)
        range_m = np.hypot(points_m[:, 0], points_m[:, 1])
        return cls(bearing[order], range_m[order], (points_m[:, 2] / np.maximum(range_m, 1.0))[order])

    def falls_on(self, right_rad: float, left_rad: float, front_m: float, slope: float) -> bool:
        """Whether something nearer stands just beside, on either side, as high as the middle of the face or higher."""
        for begin, end in ((right_rad - _BESIDE_RAD, right_rad), (left_rad, left_rad + _BESIDE_RAD)):
            low, high = np.searchsorted(self.bearing, (begin, end))
            if ((self.range_m[low:high] < front_m - _BEFORE_M) & (self.slope[low:high] > slope)).any():
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
    for position in now[:, :2]:
        step = after[:, :2] - position
        near = (np.abs(step[:, 0]) < _STEP_M) & (np.abs(step[:, 1]) < 1.0)
        steps = step[near]
        distance, partner = tree.query(position - steps)
        agrees, partner = np.asarray(distance) < _AGREE_M, np.asarray(partner)
        candidates.append(0.5 * (steps[agrees] + position - before[partner[agrees], :2]))
    usual = _usual_step(candidates)
    for row, steps in enumerate(candidates):
        if len(steps) == 1:
            velocity[row] = steps[0]
        elif len(steps):  # several explain it: the one that stands still, if there is one
            away = np.linalg.norm(steps - usual, axis=1)
            velocity[row] = steps[np.argmin(away)] if away.min() < _AGREE_M else np.nan
    return velocity


def _usual_step(candidates: list[Float[np.ndarray, "_ 2"]]) -> Float[np.ndarray, " 2"]:
    """The step with most others nearby: that of the standing world."""
    steps = np.concatenate([np.zeros((0, 2)), *candidates])
    if not len(steps):
        return np.zeros(2)
    near = cKDTree(steps).query_ball_point(steps, _AGREE_M / 2)
    best = max(near, key=len)
    return np.asarray(np.median(steps[best], axis=0))


# Peaks of the radar's power from above, placed within the cell

LEAST_DB = 2.0
"""Over what is usual at that range: weaker echoes are no peaks."""
STRONG_DB = 7.0
"""What only an object gives; a weaker peak is one where something thin stands."""
_PEAK_M, _CELL_RAD = 0.9, np.radians(1.2)  # peaks are no nearer to one another
_DEPTH_M = 0.7  # half of what an echo spreads over along the beam
_LOBE_RAD, _LOBE_M = np.radians(2.5), 1.5  # the same across it, for what is as wide as a car
_THIN_RAD, _THIN_M = np.radians(1.0), 0.2  # and for a post
_LEAST_SHARE = 0.05  # of an echo's power: what lies below is noise
_LOBE_SHARE = 0.2  # of a wide echo's: side lobes, 10 to 13 dB down, and two of them together lie below
_SHIFTS, _STILL_RAD = 4, 1e-4


@dataclass(frozen=True, eq=False, kw_only=True)
class Peaks:
    """Radar peaks of one frame, in the radar's frame.

    Args:
        place_m: Means by power over the lobe of something as wide as a car, shape (n, 3).
        thin_m: Means over the beam of a post alone, shape (n, 3).
        power_db: Power of the strongest echo, shape (n,).
    """

    place_m: Float[np.ndarray, "n 3"]
    thin_m: Float[np.ndarray, "n 3"]
    power_db: Float[np.ndarray, " n"]


def find_peaks(pair: SensorPair) -> Peaks:
    """Local maxima of the radar's echoes, placed within the cell: means over the lobe, by power.

    The lobe is taken in range and azimuth, wide enough for its far side to count: a narrower window draws every echo
    to the middle of its cell, by up to 0.3 of one degree. Side lobes fall into it too, more on one side than on the
    other: counted, they draw a point by 0.15 degree (simulated array), so only what is stronger counts. A post's echo
    is as wide as the beam: a window of that width moves with its own mean until it rests, so that it is drawn nowhere
    and side lobes stay outside.
    """
    echoes_m, power = pair.echoes_m, pair.power_db
    top = _local_maxima(echoes_m, power)
    lobes = _Lobes.of(echoes_m, power)
    wide, thin = np.zeros((len(top), 3)), np.zeros((len(top), 3))
    for row, i in enumerate(top):
        bearing, range_m = float(np.arctan2(echoes_m[i, 1], echoes_m[i, 0])), float(np.linalg.norm(echoes_m[i]))
        near = max(range_m, 1.0)
        wide[row] = lobes.mean(bearing, range_m, max(_LOBE_RAD, _LOBE_M / near), _LOBE_SHARE)
        thin[row] = lobes.mean_shift(bearing, range_m, _THIN_RAD + _THIN_M / near)
    return Peaks(place_m=_cartesian(wide), thin_m=_cartesian(thin), power_db=power[top])


def _cartesian(polar: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Positions of bearings, slant ranges and heights."""
    level = np.sqrt(np.maximum(polar[:, 1] ** 2 - polar[:, 2] ** 2, 0.0))
    return np.column_stack([level * np.cos(polar[:, 0]), level * np.sin(polar[:, 0]), polar[:, 2]])


@dataclass(frozen=True, eq=False)
class _Lobes:
    """Echoes by bearing.

    Args:
        polar: Bearing, slant range and height, shape (n, 3), bearings rising. The beam is 9 degrees tall: seen from
            above, an echo reaches nearer to the radar than it stands, by 0.1 m at 30 m; its slant range does not.
        power: Linear, over what is usual, shape (n,).
    """

    polar: Float[np.ndarray, "n 3"]
    power: Float[np.ndarray, " n"]

    @classmethod
    def of(cls, echoes_m: Float[np.ndarray, "n 3"], power_db: Float[np.ndarray, " n"]) -> "_Lobes":
        x, y, z = echoes_m.T
        polar = np.column_stack([np.arctan2(y, x), np.linalg.norm(echoes_m, axis=1), z])
        order = np.argsort(polar[:, 0], kind="stable")
        return cls(polar[order], 10 ** (power_db[order] / 10))

    def mean(self, bearing: float, range_m: float, half_rad: float, lobe: float) -> Float[np.ndarray, " 3"]:
        """Mean bearing, range and height of the echoes in a window, by their power above noise.

        The bearing is that of the echoes above a share ``lobe`` of the strongest.
        """
        low, high = np.searchsorted(self.polar[:, 0], (bearing - half_rad, bearing + half_rad))
        inside = low + np.flatnonzero(np.abs(self.polar[low:high, 1] - range_m) < _DEPTH_M)
        if not len(inside):
            return np.array([bearing, range_m, 0.0])
        share = self.power[inside] / self.power[inside].max()
        weight = np.maximum(share[:, None] - np.array([lobe, _LEAST_SHARE, _LEAST_SHARE]), 0.0)
        return np.asarray((weight * self.polar[inside]).sum(axis=0) / weight.sum(axis=0))

    def mean_shift(self, bearing: float, range_m: float, half_rad: float) -> Float[np.ndarray, " 3"]:
        """The same where the window is centred on its own mean (mean shift, Fukunaga and Hostetler 1975)."""
        mean = self.mean(bearing, range_m, half_rad, _LEAST_SHARE)
        for _ in range(_SHIFTS - 1):
            last = mean
            mean = self.mean(float(last[0]), float(last[1]), half_rad, _LEAST_SHARE)
            if abs(mean[0] - last[0]) < _STILL_RAD:
                break
        return mean


def _local_maxima(echoes_m: Float[np.ndarray, "n 3"], power_db: Float[np.ndarray, " n"]) -> Int[np.ndarray, " k"]:
    """Echoes that are the strongest of those around; of equal ones the first."""
    strong = np.flatnonzero(power_db > LEAST_DB)
    if not len(strong):
        return strong
    range_m = np.hypot(echoes_m[strong, 0], echoes_m[strong, 1])
    radius = np.maximum(_PEAK_M, _CELL_RAD * range_m)  # or each far cell would be its own maximum
    around = cKDTree(echoes_m[strong, :2]).query_ball_point(echoes_m[strong, :2], radius).tolist()
    order = np.lexsort((np.arange(len(strong)), -power_db[strong]))
    rank = np.empty(len(strong), dtype=int)
    rank[order] = np.arange(len(strong))
    first: Bool[np.ndarray, " m"] = np.array([rank[near].min() for near in around]) == rank
    return strong[first]
