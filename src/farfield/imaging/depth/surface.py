"""The surface between rings, drawn into the picture: the nearest of many interpolated points in each pixel."""

from importlib.util import find_spec
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from farfield.geometry.cameras import Camera, distort, fold_radius
from farfield.imaging.depth.rings import Fan

_MOST_BETWEEN = 64


class Raster(NamedTuple):
    """Depths by pixel.

    Args:
        depth_m: Depth along the optical axis, inf for none, shape (h, w).
        doubt_m: How far what it was interpolated from disagrees, 0 where it was measured, shape (h, w).
    """

    depth_m: Float[np.ndarray, "h w"]
    doubt_m: Float[np.ndarray, "h w"]


def draw_surface(
    fan: Fan, camera: Camera, *, step_rad: float, max_gap_rad: float, compiled: bool | None = None
) -> Raster:
    """Interpolate between neighbouring rings and draw what comes out.

    The doubt is twice the share of the nearer ring's distance times the rings' disagreement in range (0 on a ring,
    all of it halfway between), plus the same along the ring.

    Args:
        fan: The rings.
        camera: The camera.
        step_rad: Angle between the interpolated points.
        max_gap_rad: Rings further apart than this are not joined.
        compiled: Whether numba does it; where it is installed unless given.
    """
    rows = steps_between(fan, step_rad, max_gap_rad)
    raster = Raster(np.full((camera.height_px, camera.width_px), np.inf), np.zeros((camera.height_px, camera.width_px)))
    if find_spec("numba") is not None if compiled is None else compiled:
        from farfield.imaging.depth.compiled import draw

        focal = np.array([camera.matrix[0, 0], camera.matrix[1, 1], camera.matrix[0, 2], camera.matrix[1, 2]])
        fold = fold_radius(camera.distortion) ** 2
        draw(fan.points, fan.spread_m, rows, camera.distortion, fold, focal, raster.depth_m, raster.doubt_m)
        return raster
    for lower, count in enumerate(rows):
        share = (np.arange(count) / max(count, 1))[:, None]
        _draw_between(fan, lower, share, camera, raster)
    return raster


def steps_between(fan: Fan, step_rad: float, max_gap_rad: float) -> np.ndarray:
    """Rows of points from each ring up to the next: 1 is the ring alone, where the next is too far or there is none."""
    apart = np.append(np.diff(fan.elevation_rad), np.inf)
    rows = np.clip(np.ceil(apart / step_rad), 1, _MOST_BETWEEN)
    rows[apart > max_gap_rad] = 1
    return rows.astype(np.int64)


def _draw_between(fan: Fan, lower: int, share: Float[np.ndarray, "k 1"], camera: Camera, raster: Raster) -> None:
    first = fan.points[lower]
    if len(share) == 1:
        points, doubt = first, fan.spread_m[lower]
    else:
        second = fan.points[lower + 1]
        points = (first[None] + (second - first)[None] * share[..., None]).reshape(-1, 4)
        apart = np.abs(1 / first[:, 3] - 1 / second[:, 3])
        along = fan.spread_m[lower] * (1 - share) + fan.spread_m[lower + 1] * share
        alone = np.where(share == 0, 0.0, apart)  # on the ring itself the other one has no say
        doubt = (along + 2 * np.minimum(share, 1 - share) * alone).reshape(-1)
        points[: len(first)] = first
        doubt[: len(first)] = fan.spread_m[lower]
    ahead = points[:, 2] > 0
    _draw_points(points[ahead], doubt[ahead], camera, raster)


def _draw_points(
    points: Float[np.ndarray, "n 4"], doubt: Float[np.ndarray, " n"], camera: Camera, raster: Raster
) -> None:
    flat = points[:, :2] / points[:, 2:3]
    keep = (flat**2).sum(axis=1) < fold_radius(camera.distortion) ** 2
    flat, points, doubt = flat[keep], points[keep], doubt[keep]
    if camera.distortion.any():
        flat = distort(flat, camera.distortion)
    u = np.rint(flat[:, 0] * camera.matrix[0, 0] + camera.matrix[0, 2])
    v = np.rint(flat[:, 1] * camera.matrix[1, 1] + camera.matrix[1, 2])
    inside = (u >= 0) & (u < camera.width_px) & (v >= 0) & (v < camera.height_px)
    pixel = (v[inside] * camera.width_px + u[inside]).astype(np.int64)
    depth = points[inside, 2] / points[inside, 3]
    nearest, doubts = raster.depth_m.reshape(-1), raster.doubt_m.reshape(-1)
    np.minimum.at(nearest, pixel, depth)
    won = nearest[pixel] == depth
    doubts[pixel[won]] = doubt[inside][won]
