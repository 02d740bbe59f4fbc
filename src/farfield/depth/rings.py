"""The rings of a spinning LiDAR, told from the order of the rows, sampled, and the surface between them drawn.

A point travels in homogeneous form: (X, Y, Z, 1) / r in camera axes. What is interpolated linearly between two points
in that form stays on the straight line between them and is linear in 1 / r over small angles, its projection needs no
further thought, and three points span exactly their plane. :func:`sample_rings` interpolates along the rings at common
azimuths, :func:`draw_surface` across them: the nearest of many interpolated points is drawn in each pixel.
"""

from dataclasses import dataclass
from importlib.util import find_spec
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from farfield.depth.raster import DepthRaster
from farfield.geometry.cameras import Camera, distort, fold_radius, undistort
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
    sense = np.sign(np.median(steps))
    if sense == 0 or np.mean(steps * sense >= 0) < _FORWARDS:
        return None
    elevation = np.arctan2(points_m[:, 2], np.hypot(points_m[:, 0], points_m[:, 1]))
    best: Int[np.ndarray, " n"] | None = None
    least_rad = _SPREAD_RAD
    for start_rad in (0.0, np.pi):  # KITTI's turns begin ahead, others' behind
        turned = (azimuth * sense - start_rad) % (2 * np.pi)
        ring = np.concatenate([[0], np.cumsum(np.diff(turned) < -np.pi / 6)])
        spread_rad = _spread_rad(elevation, ring)
        if _FEWEST <= ring[-1] + 1 <= _MOST and spread_rad < least_rad:
            best, least_rad = ring, spread_rad
    return best


def rings_keep_elevation(points_m: Float[np.ndarray, "n 3"], ring: Int[np.ndarray, " n"]) -> bool:
    """Whether each ring keeps an elevation of its own, as seen from its LiDAR, and not where that stands elsewhere.

    Args:
        points_m: Points in what should be the sensor's own axes.
        ring: The ring of each, counted from 0.
    """
    elevation = np.arctan2(points_m[:, 2], np.hypot(points_m[:, 0], points_m[:, 1]))
    finite = np.isfinite(elevation)
    elevation, ring = elevation[finite], ring[finite]
    if len(ring) == 0 or _spread_rad(elevation, ring) >= _SPREAD_RAD:
        return len(ring) == 0
    counts = np.bincount(ring)
    means = np.sort(np.bincount(ring, elevation)[counts > 0] / counts[counts > 0])
    return len(means) < 2 or bool(np.median(np.diff(means)) > _APART_RAD)  # ground from the ground: all at 0


def _spread_rad(elevation: Float[np.ndarray, " n"], ring: Int[np.ndarray, " n"]) -> float:
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
        compiled: Whether numba does it (default: where it is installed).
    """
    # 1. Points ring by ring, from the lowest ring to the highest, by azimuth.
    points = points_m.astype(np.float64)
    azimuth = _azimuth(points, camera)
    inverse = 1 / np.maximum(np.linalg.norm(points, axis=1), 1e-3)
    order = np.lexsort((azimuth, ring))
    rings = np.split(order, np.flatnonzero(np.diff(ring[order])) + 1) if len(order) else []
    rings = [rows for rows in rings if len(rows) > 1]
    heights = np.array([np.median(points[rows, 2] * inverse[rows]) for rows in rings])
    upwards = [rings[number] for number in np.argsort(heights, kind="stable")]
    rows = np.concatenate(upwards) if upwards else np.zeros(0, dtype=np.int64)
    starts = np.cumsum([0, *map(len, upwards)])

    # 2. Homogeneous points, and the azimuths of the columns.
    in_camera = transform_points(camera.camera_T_lidar, points)
    homogeneous = np.column_stack([in_camera, np.ones(len(points))])[rows] * inverse[rows, None]
    grid, azimuth = _columns(azimuth, camera, step_px), azimuth[rows]

    # 3. Interpolate each ring.
    sampled = np.full((len(upwards), len(grid), 4), np.nan)
    spread_m = np.zeros(sampled.shape[:2])
    if find_spec("numba") is not None if compiled is None else compiled:
        from farfield.depth.compiled import sample

        sample(azimuth, homogeneous, starts, grid, max_gap_rad, sampled, spread_m)
    else:
        for number, (begin, end) in enumerate(pairwise(starts)):
            part = slice(begin, end)
            sampled[number], spread_m[number] = _sample_ring(azimuth[part], homogeneous[part], grid, max_gap_rad)
    return RingGrid(sampled, spread_m, np.arcsin(np.clip(np.sort(heights), -1, 1)))


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
    inside = np.sort(_azimuth(camera.rays(np.column_stack([u, np.full(len(u), camera.matrix[1, 2])])), camera))
    inside = inside[np.isfinite(inside)]
    if len(inside) < 2:
        return np.arange(azimuth.min(), azimuth.max(), step_px / camera.matrix[0, 0])
    first, last = inside[1] - inside[0], inside[-1] - inside[-2]
    before = np.arange(inside[0] - first, azimuth.min() - first, -first)[::-1]
    after = np.arange(inside[-1] + last, azimuth.max() + last, last)
    return np.concatenate([before, inside, after])


def _sample_ring(
    azimuth: Float[np.ndarray, " n"], points: Float[np.ndarray, "n 4"], grid: Float[np.ndarray, " k"], max_gap: float
) -> tuple[Float[np.ndarray, "k 4"], Float[np.ndarray, " k"]]:
    """A ring's points at the grid's azimuths, and the measured neighbours' disagreement; ``compiled.sample``."""
    after = np.clip(np.searchsorted(azimuth, grid), 1, len(azimuth) - 1)
    gap = azimuth[after] - azimuth[after - 1]
    share = (grid - azimuth[after - 1]) / np.maximum(gap, 1e-9)
    first, second = points[after - 1], points[after]
    sampled = first + (second - first) * share[:, None]
    sampled[(gap > max_gap) | (share < 0) | (share > 1)] = np.nan
    return sampled, 2 * np.minimum(share, 1 - share) * np.abs(1 / first[:, 3] - 1 / second[:, 3])


def image_span(camera: Camera) -> tuple[Float[np.ndarray, " 2"], Float[np.ndarray, " 2"]]:
    """Least and greatest x / z and y / z that the image's rim sees."""
    u, v = np.arange(camera.width_px), np.arange(camera.height_px)
    columns = [np.column_stack([u, np.full(len(u), row)]) for row in (0, camera.height_px - 1)]
    rows = [np.column_stack([np.full(len(v), column), v]) for column in (0, camera.width_px - 1)]
    rim = np.concatenate([*columns, *rows]).astype(np.float64)
    tangent = undistort((rim - camera.matrix[:2, 2]) / [camera.matrix[0, 0], camera.matrix[1, 1]], camera.distortion)
    tangent = tangent[np.isfinite(tangent).all(axis=1)]
    if not len(tangent):
        return np.full(2, -10.0), np.full(2, 10.0)
    return tangent.min(axis=0), tangent.max(axis=0)


# The surface between rings

_MOST_BETWEEN = 64


def draw_surface(
    grid: RingGrid, camera: Camera, *, step_rad: float, max_gap_rad: float, compiled: bool | None = None
) -> DepthRaster:
    """Interpolate between neighbouring rings and draw what comes out.

    The doubt is twice the share of the nearer ring's distance times the rings' disagreement in range (0 on a ring,
    all of it halfway between), plus the same along the ring.

    Args:
        grid: The rings.
        camera: The camera.
        step_rad: Angle between the interpolated points.
        max_gap_rad: Rings further apart than this are not joined.
        compiled: Whether numba does it (default: where it is installed).
    """
    rows = steps_between(grid, step_rad, max_gap_rad)
    raster = DepthRaster(
        np.full((camera.height_px, camera.width_px), np.inf), np.zeros((camera.height_px, camera.width_px))
    )
    compiled = find_spec("numba") is not None if compiled is None else compiled
    slopes = _slopes(grid, camera, compiled)
    if compiled:
        from farfield.depth.compiled import draw

        focal = np.array([camera.matrix[0, 0], camera.matrix[1, 1], camera.matrix[0, 2], camera.matrix[1, 2]])
        fold = fold_radius(camera.distortion) ** 2
        draw(
            grid.points,
            grid.spread_m,
            slopes,
            rows,
            np.array(camera.distortion),
            fold,
            focal,
            raster.depth_m,
            raster.doubt_m,
        )
        return raster
    for lower, count in enumerate(rows):
        _draw_between(grid, lower, (np.arange(count) / count)[:, None], slopes[lower], camera, raster)
    return raster


def steps_between(grid: RingGrid, step_rad: float, max_gap_rad: float) -> np.ndarray:
    """Rows of points from each ring up to the next: 1 is the ring alone, where the next is too far or there is none."""
    apart = np.append(np.diff(grid.elevation_rad), np.inf)
    rows = np.clip(np.ceil(apart / step_rad), 1, _MOST_BETWEEN)
    rows[apart > max_gap_rad] = 1
    return rows.astype(np.int64)


def _slopes(grid: RingGrid, camera: Camera, compiled: bool) -> Float[np.ndarray, "rings columns 4"]:
    """How 1 / z changes per pixel to the right and down on the patch above each point, and its least and most there.

    A drawn point falls beside its pixel's centre; with the patch's slope its depth is carried there. On grazing ground
    40 m away that is up to 0.6 m.
    """
    slopes = np.zeros((*grid.points.shape[:2], 4))
    slopes[..., 2], slopes[..., 3] = -np.inf, np.inf
    if min(grid.points.shape[:2]) < 2:
        return slopes
    with np.errstate(invalid="ignore", divide="ignore"):
        ahead = np.where(grid.points[..., 2:3] > 0, grid.points, np.nan)
        tangent = (ahead[..., :2] / ahead[..., 2:3]).reshape(-1, 2)
        tangent = distort(tangent, camera.distortion) if camera.distortion.any() else tangent
        pixels = (tangent * [camera.matrix[0, 0], camera.matrix[1, 1]]).reshape(*slopes.shape[:2], 2)
        if compiled:
            from farfield.depth.compiled import slopes_of

            slopes_of(ahead, pixels, slopes)
        else:
            patch = _patches(ahead[..., 3] / ahead[..., 2], pixels)
            complete = np.isfinite(patch).all(axis=-1)
            slopes[:-1, :-1][complete] = patch[complete]
    slopes[-1], slopes[:, -1] = slopes[-2], slopes[:, -2]
    return slopes


def _patches(
    inverse: Float[np.ndarray, "rings columns"], pixels: Float[np.ndarray, "rings columns 2"]
) -> Float[np.ndarray, "rings-1 columns-1 4"]:
    """The plane through each point, its right neighbour and the one above, as :func:`_slopes` says."""
    here, right, above = inverse[:-1, :-1], inverse[:-1, 1:], inverse[1:, :-1]
    along, up = pixels[:-1, 1:] - pixels[:-1, :-1], pixels[1:, :-1] - pixels[:-1, :-1]
    area = along[..., 0] * up[..., 1] - along[..., 1] * up[..., 0]
    to_right = ((right - here) * up[..., 1] - (above - here) * along[..., 1]) / area
    down = ((above - here) * along[..., 0] - (right - here) * up[..., 0]) / area
    corners = np.stack([here, right, above])
    patch: Float[np.ndarray, "rings columns 4"] = np.stack(
        [to_right, down, corners.min(axis=0), corners.max(axis=0)], axis=-1
    )
    return patch


def _draw_between(
    grid: RingGrid,
    lower: int,
    share: Float[np.ndarray, "k 1"],
    slopes: Float[np.ndarray, "n 4"],
    camera: Camera,
    raster: DepthRaster,
) -> None:
    """Draw a ring and the points between it and the next one."""
    first = grid.points[lower]
    points, doubt = first, grid.spread_m[lower]
    if len(share) > 1:
        second = grid.points[lower + 1]
        between = first[None] + (second - first)[None] * share[1:, :, None]
        apart = np.abs(1 / first[:, 3] - 1 / second[:, 3])
        along = grid.spread_m[lower] * (1 - share[1:]) + grid.spread_m[lower + 1] * share[1:]
        points = np.concatenate([first, between.reshape(-1, 4)])
        doubt = np.concatenate([doubt, (along + 2 * np.minimum(share[1:], 1 - share[1:]) * apart).reshape(-1)])
        slopes = np.tile(slopes, (len(share), 1))
    ahead = points[:, 2] > 0
    _draw_points(points[ahead], doubt[ahead], slopes[ahead], camera, raster)


def _draw_points(
    points: Float[np.ndarray, "n 4"],
    doubt: Float[np.ndarray, " n"],
    slopes: Float[np.ndarray, "n 4"],
    camera: Camera,
    raster: DepthRaster,
) -> None:
    """Carry each point's depth to its pixel's centre; the nearest of a pixel stays."""
    tangent = points[:, :2] / points[:, 2:3]
    unfolded = (tangent**2).sum(axis=1) < fold_radius(camera.distortion) ** 2
    tangent, inverse = tangent[unfolded], (points[:, 3] / points[:, 2])[unfolded]
    doubt, slopes = doubt[unfolded], slopes[unfolded]
    if camera.distortion.any():
        tangent = distort(tangent, camera.distortion)
    u = tangent[:, 0] * camera.matrix[0, 0] + camera.matrix[0, 2]
    v = tangent[:, 1] * camera.matrix[1, 1] + camera.matrix[1, 2]
    column, row = np.rint(u), np.rint(v)
    inside = (column >= 0) & (column < camera.width_px) & (row >= 0) & (row < camera.height_px)
    centred = inverse + slopes[:, 0] * (column - u) + slopes[:, 1] * (row - v)
    depth = 1 / np.minimum(np.maximum(centred, slopes[:, 2]), slopes[:, 3])[inside]
    pixel = (row[inside] * camera.width_px + column[inside]).astype(np.int64)
    depths, doubts = raster.depth_m.reshape(-1), raster.doubt_m.reshape(-1)
    np.minimum.at(depths, pixel, depth)
    nearest = depths[pixel] == depth
    doubts[pixel[nearest]] = doubt[inside][nearest]
