"""What is made of a 4D radar tensor: the polar map, the Cartesian cube, and sparse clouds, as K-Radar defines them.

Sources: K-Radar's repository (the generator ``gen_3`` for the cube, the v2 loader for the polar map, the RTNH
pre-processing for sparse clouds). Conventions of :mod:`farfield.radar.axes`.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Int, Num

from farfield.radar.axes import (
    CUBE_SHAPE,
    CUBE_STEP_M,
    CUBE_X_M,
    CUBE_Y_M,
    CUBE_Z_M,
    KRADAR_AXES,
    OUTSIDE,
    POWER_UNIT,
    RadarAxes,
    onto_cube,
)

__all__ = [
    "CUBE_SHAPE",
    "CUBE_STEP_M",
    "CUBE_X_M",
    "CUBE_Y_M",
    "CUBE_Z_M",
    "OUTSIDE",
    "OUTSIDE_DOPPLER_M_S",
    "Moments",
    "doppler_cube",
    "moments",
    "moments_of_columns",
    "polar3d",
    "polar3d_from_moments",
    "polar_cloud",
    "polar_points",
    "sparse_cloud",
    "sparse_clouds",
    "thresholds",
    "zyx_cube",
]

OUTSIDE_DOPPLER_M_S = -10.0
"""Doppler of the Doppler cube's cells outside the field of view."""
_BLOCK_RANGES = 8
_BLOCK_CELLS = 1024  # so few that the product stays on one thread: others read and inflate meanwhile


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


def moments(tensor: Float[np.ndarray, "d r e a"], axes: RadarAxes = KRADAR_AXES) -> Moments:
    """Reduce a tensor over Doppler in one pass, summing in double precision.

    Args:
        tensor: Linear power in file units; any strides, in place.
        axes: Its axes.
    """
    check_shape(tensor.shape, axes.shape, "Doppler, range, elevation, azimuth")
    count, ranges, *rest = tensor.shape
    weights = _weights(axes)
    out = np.empty((3, ranges, *rest), dtype=np.float32)
    for start in range(0, ranges, _BLOCK_RANGES):
        block = tensor[:, start : start + _BLOCK_RANGES].astype(np.float64, copy=False)
        out[:, start : start + _BLOCK_RANGES] = (weights @ block.reshape(count, -1)).reshape(3, -1, *rest)
    return Moments(out[0], out[1], out[2])


def _weights(axes: RadarAxes) -> Float[np.ndarray, "3 d"]:
    """What a cell's spectrum is multiplied with to give the three moments."""
    count = len(axes.doppler_m_s)
    taper = np.where(np.arange(count) > 0, 1.0 / (count - 1), 0.0)
    return np.stack([np.full(count, 1.0 / count), taper, taper * axes.doppler_m_s])


def moments_of_columns(blocks: Iterable[Num[np.ndarray, "n d"]], axes: RadarAxes = KRADAR_AXES) -> Moments:
    """Reduce a tensor that comes cell by cell, so that it is never in memory whole; sums in double precision.

    Args:
        blocks: Cells one after another, each row one cell's Doppler spectrum in file units: range runs fastest, then
            elevation, then azimuth, each as ``axes`` has it. This is the order of K-Radar's files. A block is not
            looked at again once the next is asked for.
        axes: The tensor's axes.

    Raises:
        ValueError: If there are more or fewer cells than the axes have.
    """
    _, ranges, elevations, azimuths = axes.shape
    weights, cells = _weights(axes), ranges * elevations * azimuths
    out, at = np.empty((3, cells), dtype=np.float32), 0
    for block in blocks:
        end = at + len(block)
        if end > cells or block.shape[1] != weights.shape[1]:
            raise ValueError(f"expected {cells} cells of {weights.shape[1]} bins, got more: {end} of {block.shape[1]}")
        for start in range(0, len(block), _BLOCK_CELLS):
            part = block[start : start + _BLOCK_CELLS].T.astype(np.float64, copy=False)
            out[:, at + start : at + start + part.shape[1]] = weights @ part
        at = end
    if at < cells:
        raise ValueError(f"expected {cells} cells, got {at}")
    turned = out.reshape(3, azimuths, elevations, ranges).transpose(0, 3, 2, 1)
    return Moments(turned[0], turned[1], turned[2])


def polar3d(tensor: Float[np.ndarray, "d r e a"], axes: RadarAxes = KRADAR_AXES) -> Float32[np.ndarray, "2 r a e"]:
    """Power and mean Doppler of every polar cell: K-Radar's ``polar3d`` in our angles.

    Args:
        tensor: Linear power in file units.
        axes: Its axes.

    Returns:
        Mean power over all Doppler bins but the first, over :data:`~farfield.radar.axes.POWER_UNIT`, and the
        power-weighted mean velocity of the same bins in m/s; axes range, azimuth, elevation.
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
    check_shape(mean_power.shape, axes.shape[1:], "range, elevation, azimuth")
    return onto_cube(mean_power, axes, OUTSIDE)


def doppler_cube(
    mean_power_63: Float32[np.ndarray, "r e a"],
    velocity_moment: Float32[np.ndarray, "r e a"],
    axes: RadarAxes = KRADAR_AXES,
) -> Float32[np.ndarray, "150 400 250"]:
    """Power-weighted mean velocity of each of the cube's cells, wrapped, from the two sums over Doppler.

    Both sums are interpolated as :func:`zyx_cube` does and then divided, so that the eight corners count by their
    power, as the Doppler bins of one cell do. (K-Radar's own Doppler cubes hold the strongest bin's velocity instead.)

    Args:
        mean_power_63: Mean power over all Doppler bins but the first, file units.
        velocity_moment: Mean, over the same bins, of power times the bin's velocity.
        axes: Their axes.

    Returns:
        Velocity in m/s; 0 where there is no power, -10 outside the field of view.
    """
    check_shape(mean_power_63.shape, axes.shape[1:], "range, elevation, azimuth")
    power = onto_cube(mean_power_63, axes, OUTSIDE)
    velocity = onto_cube(velocity_moment, axes, OUTSIDE_DOPPLER_M_S)
    np.divide(velocity, power, out=velocity, where=power > 0)
    velocity[power == 0] = 0.0
    return velocity


# Which cells are kept: thresholds of exact quantiles, the strongest share of a cube or of the polar grid.
#
# K-Radar's clouds have densities from 0.01 to 50 % ("Enhanced K-Radar"). A quantile here is numpy's default: linear
# interpolation between the two order statistics beside (n - 1) q. It is found without sorting all cells: a sample tells
# a level that surely lies below the threshold, and only the cells above that level are looked at.

Population = Literal["all", "valid"]
_SAMPLES = 1 << 16
_STRIDE = 7  # set in the step between samples: it then shares no divisor 2 with the cube's sides
_SPARE = 1.1  # the sampled level is lowered until it keeps so many times the cells wanted


def thresholds(
    values: Float32[np.ndarray, "*shape"], rates: Sequence[float], *, over: Population = "all"
) -> list[float]:
    """Levels that shares of the cells lie above, as ``numpy.quantile(cells, 1 - rate)`` gives them.

    Args:
        values: Power; :data:`OUTSIDE` or less stands for a cell outside the field of view.
        rates: Shares, each between 0 and 1.
        over: ``"all"`` counts every cell, those outside the field of view included; ``"valid"`` the others alone.

    Raises:
        ValueError: If a rate is no share, or there is no cell to count.
    """
    for rate in rates:
        check_rate(rate)
    values_1d = values.reshape(-1)
    count = values_1d.size if over == "all" else int(np.count_nonzero(values_1d > OUTSIDE))
    if not count:
        raise ValueError("thresholds: expected cells inside the field of view, got none")
    ranks = [(count - 1) * (1.0 - rate) for rate in rates]
    lower = [min(math.floor(rank), count - 1) for rank in ranks]
    upper = [min(rank + 1, count - 1) for rank in lower]
    largest = _largest(values_1d, sorted({count - rank for rank in (*lower, *upper)}))
    levels = []
    for rank, low, high in zip(ranks, lower, upper, strict=True):
        below, above = largest[count - low], largest[count - high]
        levels.append(below + (above - below) * (rank - low))
    return levels


def _largest(values: Float32[np.ndarray, " n"], ranks: Sequence[int]) -> dict[int, float]:
    """The values of given ranks, 1 the largest."""
    most = ranks[-1]
    candidates = values
    if most < values.size // 4 and values.size > 4 * _SAMPLES:
        sample = np.sort(values[:: max(values.size // _SAMPLES, 1) | _STRIDE])[::-1]
        level = sample[min(math.ceil(_SPARE * most / values.size * sample.size) + 64, sample.size - 1)]
        above = values[values >= level]
        candidates = above if above.size >= most else values
    parted = np.partition(candidates, [candidates.size - rank for rank in ranks])
    return {rank: float(parted[candidates.size - rank]) for rank in ranks}


def cells_above(values: Float32[np.ndarray, "*shape"], threshold: float) -> Int[np.ndarray, " n"]:
    """Flat indices of the cells inside the field of view whose value lies above a threshold, rising."""
    return np.flatnonzero(values.reshape(-1) > rounded_down(max(threshold, OUTSIDE)))


def rounded_down(threshold: float) -> np.float32:
    """The largest single-precision number not above a threshold: what lies above one lies above the other."""
    near = np.float32(threshold)
    return near if float(near) <= threshold else np.nextafter(near, np.float32(-np.inf))


def sparse_cloud(
    cube: Float32[np.ndarray, "150 400 250"],
    rate: float = 0.1,
    *,
    over: Population = "all",
    subtract_half_cell: bool = True,
) -> Float32[np.ndarray, "n 4"]:
    """The strongest cells of a cube as points: x, y, z in metres and power over ``POWER_UNIT``.

    Args:
        cube: Power in file units, -1 outside the field of view, as :func:`~farfield.radar.products.zyx_cube` returns
            it.
        rate: Share of cells above the threshold, between 0 and 1.
        over: ``"all"`` takes the quantile over every cell, those outside the field of view included, as the published
            clouds do (a nominal 0.1 keeps 19.4 % of the valid cells); ``"valid"`` over the field of view alone.
        subtract_half_cell: Move the points by -0.2 m along x, y and z, as the published generators do.

    Returns:
        Points in the cube's order, z slowest.
    """
    return sparse_clouds(cube, (rate,), over=over, subtract_half_cell=subtract_half_cell)[rate]


def sparse_clouds(
    cube: Float32[np.ndarray, "150 400 250"],
    rates: Sequence[float],
    *,
    over: Population = "all",
    subtract_half_cell: bool = True,
) -> Mapping[float, Float32[np.ndarray, "n 4"]]:
    """Clouds of several densities from one look at a cube, by rate; see :func:`sparse_cloud`."""
    levels = dict(zip(rates, thresholds(cube, rates, over=over), strict=True))
    powers = cube.reshape(-1)
    cells = cells_above(cube, min(levels.values()))
    power = powers[cells]
    shift_m = CUBE_STEP_M / 2 if subtract_half_cell else 0.0
    row, x = np.divmod(cells.astype(np.int32), np.int32(len(CUBE_X_M)))
    z, y = np.divmod(row, np.int32(len(CUBE_Y_M)))
    points = np.empty((len(cells), 4), dtype=np.float32)
    for column, (axis_m, index) in enumerate(((CUBE_X_M, x), (CUBE_Y_M, y), (CUBE_Z_M, z))):
        points[:, column] = (axis_m - shift_m).astype(np.float32)[index]
    points[:, 3] = power / POWER_UNIT
    lowest = min(levels, key=lambda rate: levels[rate])
    return {rate: points if rate == lowest else points[power > rounded_down(level)] for rate, level in levels.items()}


def polar_cloud(
    polar: Float32[np.ndarray, "2 r a e"],
    rate: float = 0.1,
    axes: RadarAxes = KRADAR_AXES,
    *,
    with_indices: bool = False,
) -> Float32[np.ndarray, "n c"]:
    """The strongest share of the polar grid's cells as points ("proportional polar").

    Args:
        polar: What :func:`~farfield.radar.products.polar3d` returns.
        rate: Share of cells kept, between 0 and 1: 0.1 of K-Radar's grid is 101,351 points.
        axes: The grid's axes.
        with_indices: Also give range in metres, azimuth and elevation in radians, and the three indices.

    Returns:
        x, y, z in metres, power over ``POWER_UNIT``, mean velocity in m/s; with indices 11 columns.
    """
    check_rate(rate)
    check_shape(polar.shape[1:], (len(axes.range_m), len(axes.azimuth_deg), len(axes.elevation_deg)), "r, a, e")
    return polar_points(polar, cells_above(polar[0], *thresholds(polar[0], (rate,))), axes, with_indices=with_indices)


def polar_points(
    polar: Float32[np.ndarray, "2 r a e"],
    cells: Int[np.ndarray, " n"],
    axes: RadarAxes = KRADAR_AXES,
    *,
    with_indices: bool = False,
) -> Float32[np.ndarray, "n c"]:
    """Cells of the polar grid as points, whatever chose them: a share, or a detector of constant false-alarm rate.

    Args:
        polar: What :func:`~farfield.radar.products.polar3d` returns.
        cells: Flat indices into the grid (range, azimuth, elevation).
        axes: The grid's axes.
        with_indices: As :func:`polar_cloud`.

    Returns:
        As :func:`polar_cloud`.
    """
    indices = np.unravel_index(cells, polar.shape[1:])
    range_m = axes.range_m[indices[0]]
    azimuth_rad, elevation_rad = np.radians(axes.azimuth_deg[indices[1]]), np.radians(axes.elevation_deg[indices[2]])
    flat_m = range_m * np.cos(elevation_rad)
    columns: list[Float[np.ndarray, " n"] | Int[np.ndarray, " n"]] = [
        flat_m * np.cos(azimuth_rad),
        flat_m * np.sin(azimuth_rad),
        range_m * np.sin(elevation_rad),
        polar[0].ravel()[cells],
        polar[1].ravel()[cells],
    ]
    if with_indices:
        columns += [range_m, azimuth_rad, elevation_rad, *indices]
    return np.stack(columns, axis=1).astype(np.float32)


def check_shape(shape: tuple[int, ...], expected: tuple[int, ...], names: str) -> None:
    """Refuse an array of another shape.

    Raises:
        ValueError: If it has one.
    """
    if tuple(shape) != tuple(expected):
        raise ValueError(f"expected an array of shape {tuple(expected)} ({names}), got {tuple(shape)}")


def check_rate(rate: float) -> None:
    """Refuse what is no share.

    Raises:
        ValueError: If it is not between 0 and 1.
    """
    if not 0.0 < rate < 1.0:
        raise ValueError(f"rate: expected a share between 0 and 1, got {rate}")
