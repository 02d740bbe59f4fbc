"""What is made of a 4D radar tensor: the polar map, the Cartesian cube, and sparse clouds, as K-Radar defines them.

Sources: K-Radar's repository (the generator ``gen_3`` for the cube, the v2 loader for the polar map, the RTNH
pre-processing for sparse clouds). Conventions of :mod:`farfield.radar.axes`.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Num

from farfield.radar.axes import KRADAR_AXES, POWER_UNIT, RadarAxes
from farfield.radar.grid import CUBE_SHAPE, CUBE_STEP_M, CUBE_X_M, CUBE_Y_M, CUBE_Z_M, OUTSIDE, onto_cube
from farfield.radar.selection import check_shape, polar_cloud, polar_points, sparse_cloud, sparse_clouds, thresholds

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
    kept = np.where(np.arange(count) > 0, 1.0 / (count - 1), 0.0)
    return np.stack([np.full(count, 1.0 / count), kept, kept * axes.doppler_m_s])


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
