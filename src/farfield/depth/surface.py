"""The surface between rings, drawn into the picture: the nearest of many interpolated points in each pixel."""

from importlib.util import find_spec
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from farfield.depth.rings import RingGrid
from farfield.geometry.cameras import Camera, distort, fold_radius

_MOST_BETWEEN = 64


class DepthRaster(NamedTuple):
    """Depths by pixel.

    Args:
        depth_m: Depth along the optical axis, inf for none, shape (h, w).
        doubt_m: How far what it was interpolated from disagrees, 0 where it was measured, shape (h, w).
    """

    depth_m: Float[np.ndarray, "h w"]
    doubt_m: Float[np.ndarray, "h w"]


def draw_surface(
    fan: RingGrid, camera: Camera, *, step_rad: float, max_gap_rad: float, compiled: bool | None = None
) -> DepthRaster:
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
    raster = DepthRaster(
        np.full((camera.height_px, camera.width_px), np.inf), np.zeros((camera.height_px, camera.width_px))
    )
    compiled = find_spec("numba") is not None if compiled is None else compiled
    slopes = _slopes(fan, camera, compiled)
    if compiled:
        from farfield.depth.compiled import draw

        focal = np.array([camera.matrix[0, 0], camera.matrix[1, 1], camera.matrix[0, 2], camera.matrix[1, 2]])
        fold = fold_radius(camera.distortion) ** 2
        draw(fan.points, fan.spread_m, slopes, rows, camera.distortion, fold, focal, raster.depth_m, raster.doubt_m)
        return raster
    for lower, count in enumerate(rows):
        _draw_between(fan, lower, (np.arange(count) / count)[:, None], slopes[lower], camera, raster)
    return raster


def steps_between(fan: RingGrid, step_rad: float, max_gap_rad: float) -> np.ndarray:
    """Rows of points from each ring up to the next: 1 is the ring alone, where the next is too far or there is none."""
    apart = np.append(np.diff(fan.elevation_rad), np.inf)
    rows = np.clip(np.ceil(apart / step_rad), 1, _MOST_BETWEEN)
    rows[apart > max_gap_rad] = 1
    return rows.astype(np.int64)


def _slopes(fan: RingGrid, camera: Camera, compiled: bool) -> Float[np.ndarray, "rings columns 4"]:
    """How 1 / z changes per pixel to the right and down on the patch above each point, and its least and most there.

    A drawn point falls beside its pixel's centre; with the patch's slope its depth is carried there. On grazing ground
    40 m away that is up to 0.6 m.
    """
    found = np.zeros((*fan.points.shape[:2], 4))
    found[..., 2], found[..., 3] = -np.inf, np.inf
    if min(fan.points.shape[:2]) < 2:
        return found
    with np.errstate(invalid="ignore", divide="ignore"):
        ahead = np.where(fan.points[..., 2:3] > 0, fan.points, np.nan)
        flat = (ahead[..., :2] / ahead[..., 2:3]).reshape(-1, 2)
        flat = distort(flat, camera.distortion) if camera.distortion.any() else flat
        pixels = (flat * [camera.matrix[0, 0], camera.matrix[1, 1]]).reshape(*found.shape[:2], 2)
        if compiled:
            from farfield.depth.compiled import slopes_of

            slopes_of(ahead, pixels, found)
        else:
            patch = _patches(ahead[..., 3] / ahead[..., 2], pixels)
            good = np.isfinite(patch).all(axis=-1)
            found[:-1, :-1][good] = patch[good]
    found[-1], found[:, -1] = found[-2], found[:, -2]
    return found


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
    fan: RingGrid,
    lower: int,
    share: Float[np.ndarray, "k 1"],
    slopes: Float[np.ndarray, "n 4"],
    camera: Camera,
    raster: DepthRaster,
) -> None:
    first = fan.points[lower]
    points, doubt = first, fan.spread_m[lower]
    if len(share) > 1:
        second = fan.points[lower + 1]
        between = first[None] + (second - first)[None] * share[1:, :, None]
        apart = np.abs(1 / first[:, 3] - 1 / second[:, 3])
        along = fan.spread_m[lower] * (1 - share[1:]) + fan.spread_m[lower + 1] * share[1:]
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
    flat = points[:, :2] / points[:, 2:3]
    keep = (flat**2).sum(axis=1) < fold_radius(camera.distortion) ** 2
    flat, inverse, doubt, slopes = flat[keep], (points[:, 3] / points[:, 2])[keep], doubt[keep], slopes[keep]
    if camera.distortion.any():
        flat = distort(flat, camera.distortion)
    u = flat[:, 0] * camera.matrix[0, 0] + camera.matrix[0, 2]
    v = flat[:, 1] * camera.matrix[1, 1] + camera.matrix[1, 2]
    column, row = np.rint(u), np.rint(v)
    inside = (column >= 0) & (column < camera.width_px) & (row >= 0) & (row < camera.height_px)
    centred = inverse + slopes[:, 0] * (column - u) + slopes[:, 1] * (row - v)
    depth = 1 / np.minimum(np.maximum(centred, slopes[:, 2]), slopes[:, 3])[inside]
    pixel = (row[inside] * camera.width_px + column[inside]).astype(np.int64)
    nearest, doubts = raster.depth_m.reshape(-1), raster.doubt_m.reshape(-1)
    np.minimum.at(nearest, pixel, depth)
    won = nearest[pixel] == depth
    doubts[pixel[won]] = doubt[inside][won]
