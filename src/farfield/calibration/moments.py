"""What radar-LiDAR calibration needs of each frame: points with their times, radar echoes with their power."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy import ndimage

from farfield.errors import DatasetError
from farfield.frame import Frame
from farfield.geometry.poses import invert, transform_points

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
    return [_moment(frame, frame.indices.get(lidar, place), lidar, radar, node_m) for place, frame in enumerate(frames)]


def _moment(frame: Frame, number: int, lidar: str, radar: str, node_m: float) -> SensorPair:
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
    lag = cloud.extra["time_ns"][inside] * 1e-9 if "time_ns" in cloud.extra else np.zeros(int(inside.sum()))
    points = points[inside]
    height = above_ground_m(points)
    standing = (height > 0.3) & (height < 3.0)
    own = transform_points(invert(pose), echoes.points_m.astype(np.float64)) + node_m
    values = echoes.extra[strength].astype(np.float64)
    decibel = 10 * np.log10(np.maximum(values, 1e-30)) if strength == "power" else values
    excess = excess_db(own, decibel)
    kept = _strongest_of_columns(own, excess)
    return SensorPair(
        number=int(number),
        points_m=points[standing],
        lag_s=lag[standing],
        echoes_m=own[kept],
        power_db=excess[kept],
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
