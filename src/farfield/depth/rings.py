"""Rings of a spinning LiDAR: told from the order of the rows, and sampled at common azimuths.

A point travels in homogeneous form: (X, Y, Z, 1) / r in camera axes. What is interpolated linearly between two points
in that form stays on the straight line between them and is linear in 1 / r over small angles, its projection needs no
further thought, and three points span exactly their plane.
"""

from dataclasses import dataclass
from importlib.util import find_spec
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from farfield.geometry.cameras import Camera, undistort
from farfield.geometry.poses import transform_points

_FEWEST, _MOST = 4, 512
_FORWARDS = 0.95  # share of steps from row to row that go the same way round
_APART_RAD = np.radians(0.01)
_SPREAD_RAD = np.radians(0.35)  # KITTI's full turns: 0.10 to 0.29, for lasers do not share one origin


@dataclass(frozen=True, eq=False)
class RingGrid:
    """Rings at common azimuths, from the lowest to the highest.

    Args:
        points: Homogeneous points (X, Y, Z, 1) / r in camera axes, NaN where there is none, shape (rings, columns, 4).
        spread_m: How far the two measured neighbours along the ring disagree there in range, shape (rings, columns).
        elevation_rad: Elevation of each ring as the sensor sees it, shape (rings,).
    """

    points: Float[np.ndarray, "rings columns 4"]
    spread_m: Float[np.ndarray, "rings columns"]
    elevation_rad: Float[np.ndarray, " rings"]


def ring_numbers(points_m: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"] | None:
    """Tell rings by the order of the rows: one ring after the other, each once round, as in KITTI's files.

    Args:
        points_m: Points in the sensor's own axes, in the order of the file.

    Returns:
        The ring of each point, shape (n,); None where the rows are not ordered so.
    """
    if len(points_m) < 100:
        return None
    azimuth = np.arctan2(points_m[:, 1], points_m[:, 0])
    steps = (np.diff(azimuth) + np.pi) % (2 * np.pi) - np.pi
    way = np.sign(np.median(steps))
    if way == 0 or np.mean(steps * way >= 0) < _FORWARDS:
        return None
    elevation = np.arctan2(points_m[:, 2], np.hypot(points_m[:, 0], points_m[:, 1]))
    best: Any = None
    for start_rad in (0.0, np.pi):  # KITTI's turns begin ahead, others' behind
        turned = (azimuth * way - start_rad) % (2 * np.pi)
        ring = np.concatenate([[0], np.cumsum(np.diff(turned) < -np.pi / 6)])
        spread = _spread(elevation, ring)
        if _FEWEST <= ring[-1] + 1 <= _MOST and spread < _SPREAD_RAD and (best is None or spread < best[0]):
            best = (spread, ring)
    return None if best is None else best[1]


def rings_keep_elevation(points_m: Float[np.ndarray, "n 3"], ring: Int[np.ndarray, " n"]) -> bool:
    """Whether each ring keeps an elevation of its own, as seen from its LiDAR, and not where that stands elsewhere.

    Args:
        points_m: Points in what should be the sensor's own axes.
        ring: The ring of each, counted from 0.
    """
    elevation = np.arctan2(points_m[:, 2], np.hypot(points_m[:, 0], points_m[:, 1]))
    good = np.isfinite(elevation)
    elevation, ring = elevation[good], ring[good]
    if len(ring) == 0 or _spread(elevation, ring) >= _SPREAD_RAD:
        return len(ring) == 0
    counts = np.bincount(ring)
    means = np.sort(np.bincount(ring, elevation)[counts > 0] / counts[counts > 0])
    return len(means) < 2 or bool(np.median(np.diff(means)) > _APART_RAD)  # ground from the ground: all at 0


def _spread(elevation: Float[np.ndarray, " n"], ring: Int[np.ndarray, " n"]) -> float:
    """Median over points of how far they lie from their ring's mean elevation."""
    counts = np.bincount(ring)
    mean = np.bincount(ring, elevation) / np.maximum(counts, 1)
    return float(np.median(np.abs(elevation - mean[ring])))


def sample_rings(
    points_m: Float[np.ndarray, "n 3"],
    ring: Int[np.ndarray, " n"],
    camera: Camera,
    *,
    step_px: float,
    max_gap_rad: float,
    compiled: bool | None = None,
) -> RingGrid:
    """Sample the rings where the camera looks.

    Args:
        points_m: Points in the sensor's own axes, which the camera's pose refers to; those that the camera may see.
        ring: The ring of each.
        camera: The camera.
        step_px: Pixels between columns.
        max_gap_rad: Wider gaps between neighbours of a ring stay empty: nothing came back from there.
        compiled: Whether numba does it; where it is installed unless given.
    """
    points = points_m.astype(np.float64)
    in_camera = transform_points(camera.camera_T_lidar, points)
    azimuth = _azimuth(points, camera)
    inverse = 1 / np.maximum(np.linalg.norm(points, axis=1), 1e-3)
    order = np.lexsort((azimuth, ring))
    rings = np.split(order, np.flatnonzero(np.diff(ring[order])) + 1) if len(order) else []
    rings = [rows for rows in rings if len(rows) > 1]
    heights = np.array([np.median(points[rows, 2] * inverse[rows]) for rows in rings])
    upwards = [rings[place] for place in np.argsort(heights, kind="stable")]
    rows = np.concatenate(upwards) if upwards else np.zeros(0, dtype=np.int64)
    starts = np.cumsum([0, *map(len, upwards)])
    homogeneous = np.column_stack([in_camera, np.ones(len(points))])[rows] * inverse[rows, None]
    grid, azimuth = _columns(azimuth, camera, step_px), azimuth[rows]
    found = np.full((len(upwards), len(grid), 4), np.nan)
    spread = np.zeros(found.shape[:2])
    if find_spec("numba") is not None if compiled is None else compiled:
        from farfield.depth.compiled import sample

        sample(azimuth, homogeneous, starts, grid, max_gap_rad, found, spread)
    else:
        for place, (begin, end) in enumerate(pairwise(starts)):
            part = slice(begin, end)
            found[place], spread[place] = _sampled(azimuth[part], homogeneous[part], grid, max_gap_rad)
    return RingGrid(found, spread, np.arcsin(np.clip(np.sort(heights), -1, 1)))


def _azimuth(points_m: Float[np.ndarray, "n 3"], camera: Camera) -> Float[np.ndarray, " n"]:
    """Azimuth from the camera's optical axis as the LiDAR sees it, in [-pi, pi)."""
    axis = camera.camera_T_lidar[2, :3]
    azimuth = np.arctan2(points_m[:, 1], points_m[:, 0]) - np.arctan2(axis[1], axis[0])
    turned: Float[np.ndarray, " n"] = (azimuth + np.pi) % (2 * np.pi) - np.pi
    return turned


def _columns(azimuth: Float[np.ndarray, " n"], camera: Camera, step_px: float) -> Float[np.ndarray, " k"]:
    """Azimuths of the columns: as dense as pixels along the image's middle row, and on to where points are."""
    if not len(azimuth):
        return np.zeros(0)
    u = np.arange(0, camera.width_px - 1 + step_px, step_px)
    seen = np.sort(_azimuth(camera.rays(np.column_stack([u, np.full(len(u), camera.matrix[1, 2])])), camera))
    seen = seen[np.isfinite(seen)]
    if len(seen) < 2:
        return np.arange(azimuth.min(), azimuth.max(), step_px / camera.matrix[0, 0])
    first, last = seen[1] - seen[0], seen[-1] - seen[-2]
    before = np.arange(seen[0] - first, azimuth.min() - first, -first)[::-1]
    after = np.arange(seen[-1] + last, azimuth.max() + last, last)
    return np.concatenate([before, seen, after])


def _sampled(
    azimuth: Float[np.ndarray, " n"], points: Float[np.ndarray, "n 4"], grid: Float[np.ndarray, " k"], max_gap: float
) -> tuple[Float[np.ndarray, "k 4"], Float[np.ndarray, " k"]]:
    after = np.clip(np.searchsorted(azimuth, grid), 1, len(azimuth) - 1)
    gap = azimuth[after] - azimuth[after - 1]
    share = (grid - azimuth[after - 1]) / np.maximum(gap, 1e-9)
    first, second = points[after - 1], points[after]
    found = first + (second - first) * share[:, None]
    found[(gap > max_gap) | (share < 0) | (share > 1)] = np.nan
    spread = 2 * np.minimum(share, 1 - share) * np.abs(1 / first[:, 3] - 1 / second[:, 3])
    return found, spread


def image_span(camera: Camera) -> tuple[Float[np.ndarray, " 2"], Float[np.ndarray, " 2"]]:
    """Least and greatest x / z and y / z that the image's rim sees."""
    u, v = np.arange(camera.width_px), np.arange(camera.height_px)
    columns = [np.column_stack([u, np.full(len(u), row)]) for row in (0, camera.height_px - 1)]
    rows = [np.column_stack([np.full(len(v), column), v]) for column in (0, camera.width_px - 1)]
    rim = np.concatenate([*columns, *rows]).astype(np.float64)
    flat = undistort((rim - camera.matrix[:2, 2]) / [camera.matrix[0, 0], camera.matrix[1, 1]], camera.distortion)
    flat = flat[np.isfinite(flat).all(axis=1)]
    if not len(flat):
        return np.full(2, -10.0), np.full(2, 10.0)
    return flat.min(axis=0), flat.max(axis=0)
