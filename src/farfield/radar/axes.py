"""Axes of a 4D radar tensor: range, azimuth, elevation and Doppler, and how Doppler folds.

In memory a tensor is float32 (Doppler, range, elevation, azimuth) and holds linear power in the file's units. Azimuth
is positive to the left and elevation positive upwards, both rising, so that with the radar at the origin
x = r cos(el) cos(az), y = r cos(el) sin(az), z = r sin(el).
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Int32

POWER_UNIT = 1e13
"""Linear power that K-Radar's own tools take as one: they divide every power by it."""


@dataclass(frozen=True, eq=False)
class RadarAxes:
    """Centres of a tensor's bins, each axis evenly spaced and rising.

    Args:
        range_m: Range, shape (r,).
        azimuth_deg: Azimuth, positive to the left, shape (a,).
        elevation_deg: Elevation, positive upwards, shape (e,).
        doppler_m_s: Radial velocity, positive when receding, shape (d,).
    """

    range_m: Float[np.ndarray, " r"]
    azimuth_deg: Float[np.ndarray, " a"]
    elevation_deg: Float[np.ndarray, " e"]
    doppler_m_s: Float[np.ndarray, " d"]

    def __post_init__(self) -> None:
        for name in ("range_m", "azimuth_deg", "elevation_deg", "doppler_m_s"):
            steps = np.diff(getattr(self, name))
            if not len(steps) or steps[0] <= 0 or not np.allclose(steps, steps[0], rtol=1e-6, atol=0.0):
                raise ValueError(f"RadarAxes: expected {name} to rise in equal steps, at least two bins")

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Shape of a tensor: Doppler, range, elevation, azimuth."""
        return len(self.doppler_m_s), len(self.range_m), len(self.elevation_deg), len(self.azimuth_deg)

    @property
    def range_step_m(self) -> float:
        """Width of a range bin."""
        return _step(self.range_m)

    @property
    def doppler_step_m_s(self) -> float:
        """Width of a Doppler bin."""
        return _step(self.doppler_m_s)

    @property
    def velocity_span_m_s(self) -> float:
        """Unambiguous span: two radial velocities that differ by it fall into the same Doppler bin."""
        return self.doppler_step_m_s * len(self.doppler_m_s)

    def fold(self, velocity_m_s: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """Fold true radial velocities into the unambiguous span that begins at the first Doppler bin."""
        first = self.doppler_m_s[0]
        return first + np.mod(velocity_m_s - first, self.velocity_span_m_s)

    def doppler_bin(self, velocity_m_s: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """Fractional Doppler bin of true radial velocities, 0 <= bin < number of bins."""
        bins = (velocity_m_s - self.doppler_m_s[0]) / self.doppler_step_m_s
        return np.mod(bins, len(self.doppler_m_s))


def _step(axis: Float[np.ndarray, " n"]) -> float:
    return float((axis[-1] - axis[0]) / (len(axis) - 1))


KRADAR_AXES = RadarAxes(
    range_m=np.arange(256) * 0.462890625,
    azimuth_deg=np.arange(-53.0, 54.0),
    elevation_deg=np.arange(-18.0, 19.0),
    doppler_m_s=np.arange(-32, 32) * 0.060393475572047,
)
"""K-Radar's axes (``resources/info_arr.mat``, ``arr_doppler.mat``); its files count both angles the other way round."""

# The Cartesian grid of K-Radar's cube, and trilinear interpolation of a polar map onto it.
#
# Power spans many decades from one cell to the next, so both shares of every pair of neighbours are kept: a sum of
# terms of one sign loses no digits, which ``low + share * (high - low)`` in single precision does.

CUBE_STEP_M = 0.4
CUBE_Z_M = -30.0 + CUBE_STEP_M * np.arange(150)
CUBE_Y_M = -80.0 + CUBE_STEP_M * np.arange(400)
CUBE_X_M = CUBE_STEP_M * np.arange(250)
CUBE_SHAPE = (len(CUBE_Z_M), len(CUBE_Y_M), len(CUBE_X_M))
CUBE_CELLS = len(CUBE_Z_M) * len(CUBE_Y_M) * len(CUBE_X_M)
OUTSIDE = -1.0
"""Power of the cube's cells outside the field of view."""

_CHUNK_CELLS = 1 << 16


class CubeGather(NamedTuple):
    """Where each of the cube's cells inside the field of view takes its eight corners from.

    Args:
        cell: Index into the flat cube, rising.
        corner: Index of the lowest corner into the flat (range, elevation, azimuth) grid.
        shares: Weights of the lower and the upper neighbour: range, elevation, azimuth; shape (3, 2, n).
    """

    cell: Int32[np.ndarray, " n"]
    corner: Int32[np.ndarray, " n"]
    shares: Float32[np.ndarray, "3 2 n"]


@lru_cache(maxsize=1)
def cube_gather(axes: RadarAxes) -> CubeGather:
    """Look-up table of the cube for one radar's axes: 247 MB for K-Radar, made once in a process."""
    y_m, x_m = (side.ravel() for side in np.meshgrid(CUBE_Y_M, CUBE_X_M, indexing="ij"))
    flat_m = np.hypot(x_m, y_m)
    azimuth, azimuth_share, in_azimuth = _place(axes.azimuth_deg, np.degrees(np.arctan2(y_m, x_m)))
    columns = np.flatnonzero(in_azimuth & (flat_m > 0))  # the radar itself has no direction
    azimuth, azimuth_share, flat_m = azimuth[columns], azimuth_share[columns], flat_m[columns]
    tilt = np.tan(np.radians(np.clip([axes.elevation_deg[0] - 0.01, axes.elevation_deg[-1] + 0.01], -89.0, 89.0)))
    low_m, high_m = flat_m * tilt[0], flat_m * tilt[1]
    near = [np.flatnonzero((low_m <= z_m) & (high_m >= z_m)) for z_m in CUBE_Z_M]  # spares half of the arctangents
    most = sum(map(len, near))
    cell, corner = (np.empty(most, dtype=np.int32) for _ in range(2))
    shares, at = np.empty((3, 2, most), dtype=np.float32), 0
    row, plane = len(axes.azimuth_deg), len(axes.azimuth_deg) * len(axes.elevation_deg)
    for layer, (z_m, here) in enumerate(zip(CUBE_Z_M, near, strict=True)):
        rng, rng_share, in_range = _place(axes.range_m, np.hypot(flat_m[here], z_m))
        tilted = np.degrees(np.arctan2(z_m, flat_m[here]))
        elevation, elevation_share, in_elevation = _place(axes.elevation_deg, tilted)
        inside = np.flatnonzero(in_range & in_elevation)
        azimuth_rows, part = here[inside], slice(at, at + len(inside))
        cell[part] = columns[azimuth_rows] + layer * len(x_m)
        corner[part] = rng[inside] * plane + elevation[inside] * row + azimuth[azimuth_rows]
        for axis, share in enumerate((rng_share[inside], elevation_share[inside], azimuth_share[azimuth_rows])):
            shares[axis, 0, part], shares[axis, 1, part] = 1.0 - share, share
        at += len(inside)
    return CubeGather(cell[:at], corner[:at], shares[:, :, :at])


def _place(axis: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lower neighbour on an even axis, share of the upper one, and whether the value lies on the axis."""
    position = (value - axis[0]) * ((len(axis) - 1) / (axis[-1] - axis[0]))
    inside = (position >= -1e-9) & (position <= len(axis) - 1 + 1e-9)
    lower = np.clip(np.floor(position), 0, len(axis) - 2).astype(np.int32)
    return lower, np.clip(position - lower, 0.0, 1.0), inside


def onto_cube(
    values: Float32[np.ndarray, "r e a"], axes: RadarAxes, outside: float
) -> Float32[np.ndarray, "150 400 250"]:
    """Interpolate values of the polar grid onto the cube, trilinear in range, elevation and azimuth.

    Args:
        values: One number a polar cell.
        axes: The polar grid's axes.
        outside: What the cube's cells outside the field of view get.
    """
    where = cube_gather(axes)
    values_1d = np.ascontiguousarray(values).ravel()
    row = len(axes.azimuth_deg)
    plane = row * len(axes.elevation_deg)
    cube = np.full(CUBE_CELLS, outside, dtype=np.float32)
    # (left, right) neighbours side by side: one gather fetches both
    pairs = np.empty((values_1d.size, 2), dtype=np.float32)
    pairs[:, 0], pairs[:-1, 1], pairs[-1, 1] = values_1d, values_1d[1:], values_1d[-1]
    pairs_at = pairs.view(np.complex64)[:, 0]
    for start in range(0, len(where.cell), _CHUNK_CELLS):
        part = slice(start, start + _CHUNK_CELLS)
        corner = where.corner[part].astype(np.int64)
        shares = where.shares[:, :, part]
        edges = []
        for offset in (0, row, plane, plane + row):
            both = pairs_at[offset:].take(corner)
            edges.append(_mix(both.real, both.imag, shares[2]))
        near, far = _mix(edges[0], edges[1], shares[1]), _mix(edges[2], edges[3], shares[1])
        cube[where.cell[part]] = _mix(near, far, shares[0])
    return cube.reshape(CUBE_SHAPE)


def _mix(low: np.ndarray, high: np.ndarray, shares: np.ndarray) -> np.ndarray:
    mixed = low * shares[0]
    mixed += high * shares[1]
    return mixed
