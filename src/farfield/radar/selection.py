"""Which cells are kept: thresholds of exact quantiles, the strongest share of a cube or of the polar grid.

K-Radar's clouds have densities from 0.01 to 50 % ("Enhanced K-Radar"). A quantile here is numpy's default: linear
interpolation between the two order statistics beside (n - 1) q. It is found without sorting all cells: a sample tells
a level that surely lies below the threshold, and only the cells above that level are looked at.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from jaxtyping import Float, Float32, Int

from farfield.radar.axes import KRADAR_AXES, POWER_UNIT, RadarAxes
from farfield.radar.grid import CUBE_STEP_M, CUBE_X_M, CUBE_Y_M, CUBE_Z_M, OUTSIDE

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
    flat = values.reshape(-1)
    count = flat.size if over == "all" else int(np.count_nonzero(flat > OUTSIDE))
    if not count:
        raise ValueError("thresholds: expected cells inside the field of view, got none")
    places = [(count - 1) * (1.0 - rate) for rate in rates]
    lower = [min(math.floor(place), count - 1) for place in places]
    upper = [min(place + 1, count - 1) for place in lower]
    found = _largest(flat, sorted({count - place for place in (*lower, *upper)}))
    levels = []
    for place, low, high in zip(places, lower, upper, strict=True):
        below, above = found[count - low], found[count - high]
        levels.append(below + (above - below) * (place - low))
    return levels


def _largest(flat: Float32[np.ndarray, " n"], ranks: Sequence[int]) -> dict[int, float]:
    """The values of given ranks, 1 the largest."""
    most = ranks[-1]
    kept = flat
    if most < flat.size // 4 and flat.size > 4 * _SAMPLES:
        sample = np.sort(flat[:: max(flat.size // _SAMPLES, 1) | _STRIDE])[::-1]
        level = sample[min(math.ceil(_SPARE * most / flat.size * sample.size) + 64, sample.size - 1)]
        above = flat[flat >= level]
        kept = above if above.size >= most else flat
    parted = np.partition(kept, [kept.size - rank for rank in ranks])
    return {rank: float(parted[kept.size - rank]) for rank in ranks}


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
    flat = cube.reshape(-1)
    cells = cells_above(cube, min(levels.values()))
    power = flat[cells]
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
