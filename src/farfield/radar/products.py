"""What is made of a 4D radar tensor: the polar map, the Cartesian cube, and sparse clouds, as K-Radar defines them.

Sources: K-Radar's repository (the generator ``gen_3`` for the cube, the v2 loader for the polar map, the RTNH
pre-processing for sparse clouds). Conventions of :mod:`farfield.radar.axes`.
"""

from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float32, Int

from farfield.radar.axes import KRADAR_AXES, POWER_UNIT, RadarAxes

CUBE_STEP_M = 0.4
CUBE_Z_M = -30.0 + CUBE_STEP_M * np.arange(150)
CUBE_Y_M = -80.0 + CUBE_STEP_M * np.arange(400)
CUBE_X_M = CUBE_STEP_M * np.arange(250)
OUTSIDE = -1.0
"""Power of the cube's cells outside the field of view."""

_BLOCK_RANGES = 32
_CHUNK_CELLS = 1 << 16


class Moments(NamedTuple):
    """A tensor reduced over Doppler: all that the products need, a hundredth of its size.

    Args:
        mean_power: Mean power over all Doppler bins, file units, shape (r, e, a): for the cube.
        mean_power_63: Mean power without Doppler bin 0, file units, shape (r, e, a): for the polar map.
        velocity_moment: Mean of power times velocity without bin 0, file units times m/s, shape (r, e, a).
    """

    mean_power: Float32[np.ndarray, "r e a"]
    mean_power_63: Float32[np.ndarray, "r e a"]
    velocity_moment: Float32[np.ndarray, "r e a"]


def moments(tensor: Float32[np.ndarray, "d r e a"], axes: RadarAxes = KRADAR_AXES) -> Moments:
    """Reduce a tensor over Doppler in one pass.

    Args:
        tensor: Linear power in file units; any strides, in place.
        axes: Its axes.
    """
    _check_shape(tensor.shape, axes.shape, "Doppler, range, elevation, azimuth")
    count, ranges, *rest = tensor.shape
    kept = np.where(np.arange(count) > 0, 1.0 / (count - 1), 0.0)
    weights = np.stack([np.full(count, 1.0 / count), kept, kept * axes.doppler_m_s]).astype(np.float32)
    out = np.empty((3, ranges, *rest), dtype=np.float32)
    for start in range(0, ranges, _BLOCK_RANGES):  # a block of a contiguous tensor is a view: nothing is copied
        block = tensor[:, start : start + _BLOCK_RANGES]
        out[:, start : start + _BLOCK_RANGES] = (weights @ block.reshape(count, -1)).reshape(3, -1, *rest)
    return Moments(out[0], out[1], out[2])


def polar3d(tensor: Float32[np.ndarray, "d r e a"], axes: RadarAxes = KRADAR_AXES) -> Float32[np.ndarray, "2 r a e"]:
    """Power and mean Doppler of every polar cell: K-Radar's ``polar3d`` in our angles.

    Args:
        tensor: Linear power in file units.
        axes: Its axes.

    Returns:
        Mean power over all Doppler bins but the first, over :data:`POWER_UNIT`, and the power-weighted mean velocity of
        the same bins in m/s; axes range, azimuth, elevation.
    """
    reduced = moments(tensor, axes)
    return polar3d_from_moments(reduced.mean_power_63, reduced.velocity_moment)


def polar3d_from_moments(
    mean_power_63: Float32[np.ndarray, "r e a"], velocity_moment: Float32[np.ndarray, "r e a"]
) -> Float32[np.ndarray, "2 r a e"]:
    """The polar map from the two sums over Doppler, for those who never hold the whole tensor.

    Args:
        mean_power_63: Mean power over all Doppler bins but the first, file units.
        velocity_moment: Mean, over the same bins, of power times the bin's velocity.

    Returns:
        As :func:`polar3d`; the velocity of a cell without power is 0.
    """
    out = np.zeros((2, *mean_power_63.transpose(0, 2, 1).shape), dtype=np.float32)
    np.multiply(mean_power_63.transpose(0, 2, 1), np.float32(1.0 / POWER_UNIT), out=out[0])
    power = np.ascontiguousarray(mean_power_63.transpose(0, 2, 1))
    np.divide(velocity_moment.transpose(0, 2, 1), power, out=out[1], where=power > 0)
    return out


class _Gather(NamedTuple):
    cell: Int[np.ndarray, " n"]  # of the flat cube
    corner: Int[np.ndarray, " n"]  # of the flat (r, e, a) grid, the lowest of the eight
    range_share: Float32[np.ndarray, " n"]
    elevation_share: Float32[np.ndarray, " n"]
    azimuth_share: Float32[np.ndarray, " n"]


@lru_cache(maxsize=1)
def _gather(axes: RadarAxes) -> _Gather:
    """Where each of the cube's cells inside the field of view takes its eight corners from: 155 MB for K-Radar."""
    y_m, x_m = np.meshgrid(CUBE_Y_M, CUBE_X_M, indexing="ij")
    flat_m = np.hypot(x_m, y_m)
    azimuth, azimuth_share, in_azimuth = _place(axes.azimuth_deg, np.degrees(np.arctan2(y_m, x_m)))
    parts = []
    for layer, z_m in enumerate(CUBE_Z_M):
        rng, rng_share, in_range = _place(axes.range_m, np.hypot(flat_m, z_m))
        elevation, elevation_share, in_elevation = _place(axes.elevation_deg, np.degrees(np.arctan2(z_m, flat_m)))
        inside = np.flatnonzero(
            in_range & in_elevation & in_azimuth & (flat_m > 0)
        )  # the radar itself has no direction
        corner = (rng * len(axes.elevation_deg) + elevation) * len(axes.azimuth_deg) + azimuth
        shares = (share.ravel()[inside].astype(np.float32) for share in (rng_share, elevation_share, azimuth_share))
        cell = (inside + layer * flat_m.size).astype(np.int32)
        parts.append((cell, corner.ravel()[inside].astype(np.int32), *shares))
    return _Gather(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _place(axis: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lower neighbour on an even axis, share of the upper one, and whether the value lies on the axis."""
    position = (value - axis[0]) * ((len(axis) - 1) / (axis[-1] - axis[0]))
    inside = (position >= -1e-9) & (position <= len(axis) - 1 + 1e-9)
    lower = np.clip(np.floor(position), 0, len(axis) - 2).astype(np.int64)
    return lower, np.clip(position - lower, 0.0, 1.0), inside


def zyx_cube(
    mean_power: Float32[np.ndarray, "r e a"], axes: RadarAxes = KRADAR_AXES
) -> Float32[np.ndarray, "150 400 250"]:
    """Interpolate the Doppler-mean power onto K-Radar's Cartesian grid, trilinear in range, elevation and azimuth.

    Args:
        mean_power: Mean power over all Doppler bins, file units.
        axes: Its axes.

    Returns:
        Power on z -30..29.6, y -80..79.6 (left), x 0..99.6 m in steps of 0.4 m, all rising, the radar at the origin;
        -1 outside the field of view.
    """
    _check_shape(mean_power.shape, axes.shape[1:], "range, elevation, azimuth")
    where = _gather(axes)
    flat = np.ascontiguousarray(mean_power).ravel()
    row = len(axes.azimuth_deg)
    plane = row * len(axes.elevation_deg)
    cube = np.full(len(CUBE_Z_M) * len(CUBE_Y_M) * len(CUBE_X_M), OUTSIDE, dtype=np.float32)
    # (left, right) neighbours side by side: one gather fetches both
    pairs = np.empty((flat.size, 2), dtype=np.float32)
    pairs[:, 0], pairs[:-1, 1], pairs[-1, 1] = flat, flat[1:], flat[-1]
    pairs_at = pairs.view(np.complex64)[:, 0]
    for start in range(0, len(where.cell), _CHUNK_CELLS):
        part = slice(start, start + _CHUNK_CELLS)
        corner = where.corner[part].astype(np.int64)
        share = where.azimuth_share[part]
        edges = []
        for offset in (0, row, plane, plane + row):
            both = pairs_at[offset:].take(corner)
            edges.append(_mix(both.real, both.imag, share))
        share = where.elevation_share[part]
        near, far = _mix(edges[0], edges[1], share), _mix(edges[2], edges[3], share)
        cube[where.cell[part]] = _mix(near, far, where.range_share[part])
    return cube.reshape(len(CUBE_Z_M), len(CUBE_Y_M), len(CUBE_X_M))


def _mix(low: np.ndarray, high: np.ndarray, share: np.ndarray) -> np.ndarray:
    mixed = high - low
    mixed *= share
    mixed += low
    return mixed


def sparse_cloud(
    cube: Float32[np.ndarray, "150 400 250"],
    rate: float = 0.1,
    *,
    over: Literal["all", "valid"] = "all",
    subtract_half_cell: bool = True,
) -> Float32[np.ndarray, "n 4"]:
    """The strongest cells of a cube as points: x, y, z in metres and power over :data:`POWER_UNIT`.

    Args:
        cube: Power in file units, -1 outside the field of view, as :func:`zyx_cube` returns it.
        rate: Share of cells above the threshold, between 0 and 1.
        over: ``"all"`` takes the quantile over every cell, those outside the field of view included, as the published
            clouds do (a nominal 0.1 keeps 19.4 % of the valid cells); ``"valid"`` over the field of view alone.
        subtract_half_cell: Move the points by -0.2 m along x, y and z, as the published generators do.

    Returns:
        Points in the cube's order, z slowest.
    """
    _check_rate(rate)
    flat = cube.ravel()
    valid = flat > OUTSIDE
    threshold = np.quantile(flat if over == "all" else flat[valid], 1.0 - rate)
    cells = np.flatnonzero((flat > threshold) & valid)
    z, y, x = np.unravel_index(cells, cube.shape)
    shift_m = CUBE_STEP_M / 2 if subtract_half_cell else 0.0
    columns = (CUBE_X_M[x] - shift_m, CUBE_Y_M[y] - shift_m, CUBE_Z_M[z] - shift_m, flat[cells] / POWER_UNIT)
    return np.stack(columns, axis=1).astype(np.float32)


def polar_cloud(
    polar: Float32[np.ndarray, "2 r a e"],
    rate: float = 0.1,
    axes: RadarAxes = KRADAR_AXES,
    *,
    with_indices: bool = False,
) -> Float32[np.ndarray, "n c"]:
    """The strongest share of the polar grid's cells as points ("proportional polar").

    Args:
        polar: What :func:`polar3d` returns.
        rate: Share of cells kept, between 0 and 1: 0.1 of K-Radar's grid is 101,351 points.
        axes: The grid's axes.
        with_indices: Also give range in metres, azimuth and elevation in radians, and the three indices.

    Returns:
        x, y, z in metres, power over :data:`POWER_UNIT`, mean velocity in m/s; with indices 11 columns.
    """
    _check_rate(rate)
    _check_shape(polar.shape[1:], (len(axes.range_m), len(axes.azimuth_deg), len(axes.elevation_deg)), "r, a, e")
    power = polar[0].ravel()
    cells = np.flatnonzero(power > np.quantile(power, 1.0 - rate))
    indices = np.unravel_index(cells, polar.shape[1:])
    range_m = axes.range_m[indices[0]]
    azimuth_rad, elevation_rad = np.radians(axes.azimuth_deg[indices[1]]), np.radians(axes.elevation_deg[indices[2]])
    flat_m = range_m * np.cos(elevation_rad)
    columns = [
        flat_m * np.cos(azimuth_rad),
        flat_m * np.sin(azimuth_rad),
        range_m * np.sin(elevation_rad),
        power[cells],
        polar[1].ravel()[cells],
    ]
    if with_indices:
        columns += [range_m, azimuth_rad, elevation_rad, *indices]
    return np.stack(columns, axis=1).astype(np.float32)


def _check_shape(shape: tuple[int, ...], expected: tuple[int, ...], names: str) -> None:
    if tuple(shape) != tuple(expected):
        raise ValueError(f"expected an array of shape {tuple(expected)} ({names}), got {tuple(shape)}")


def _check_rate(rate: float) -> None:
    if not 0.0 < rate < 1.0:
        raise ValueError(f"rate: expected a share between 0 and 1, got {rate}")
