"""The cells of a Cartesian cube that lie in a region: what a detector sees, a thousandth of a tensor's size.

A cell keeps its power as a 16-bit logarithm and, if asked for, its Doppler. Beside the cells stand the quantiles of the
whole cube's power, so that any of the usual densities can be chosen when the cells are read as K-Radar's own sparse
clouds choose theirs: by the quantile of the whole cube first and by the region afterwards (the wide clouds of benchmark
v2.0), or by the region first and by its own quantile afterwards (the corridor's clouds of v1.0).
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType
from typing import Literal, get_args

import numpy as np
from jaxtyping import Bool, Float32, Int, Int16, Int32, UInt16

from farfield.errors import ConfigError
from farfield.radar.axes import POWER_UNIT
from farfield.radar.products import CUBE_STEP_M, CUBE_X_M, CUBE_Y_M, CUBE_Z_M, OUTSIDE
from farfield.vocabulary.kradar import REGIONS_M

RATES = (0.0001, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.03, 0.05, 0.1, 0.2, 0.3, 0.5)
"""Shares of a cube's cells whose quantiles are kept; 1.0 is every cell."""

CODE_STEP_DB = 0.0025
CODE_FLOOR_DB = -100.0
DOPPLER_STEP_M_S = 1e-4
_CUBE_SHAPE = (len(CUBE_Z_M), len(CUBE_Y_M), len(CUBE_X_M))
_CODES = 1 << 16
_CHUNK_CELLS = 1 << 17
Over = Literal["all", "valid", "region"]
OVERS: tuple[Over, ...] = get_args(Over)


@dataclass(frozen=True)
class RadarRegion:
    """A box in the radar's frame: x forward, y left, z up.

    A cell belongs to it if its point, half a cell below the grid's node as in the published clouds, lies in the
    half-open bounds.

    Args:
        x_m: From and to.
        y_m: From and to.
        z_m: From and to.
    """

    x_m: tuple[float | int, float | int]
    y_m: tuple[float | int, float | int]
    z_m: tuple[float | int, float | int]

    def __post_init__(self) -> None:
        if any(low >= high for low, high in (self.x_m, self.y_m, self.z_m)):
            raise ConfigError(f"radar region: expected rising bounds along x, y and z; got {self}")

    def slices(self) -> tuple[slice, slice, slice]:
        """The region's part of a cube: slices along z, y and x."""
        axes = ((CUBE_Z_M, self.z_m), (CUBE_Y_M, self.y_m), (CUBE_X_M, self.x_m))
        ranges = []
        for axis, (low, high) in axes:
            rows = np.flatnonzero((axis - CUBE_STEP_M / 2 >= low - 1e-9) & (axis - CUBE_STEP_M / 2 < high - 1e-9))
            if not len(rows):
                raise ConfigError(f"radar region: expected some of the cube's cells, found none within {low} to {high}")
            ranges.append(slice(int(rows[0]), int(rows[-1]) + 1))
        return ranges[0], ranges[1], ranges[2]

    @property
    def cells(self) -> int:
        """How many of the cube's cells lie in it, those outside the field of view included."""
        return math.prod(part.stop - part.start for part in self.slices())


REGIONS = MappingProxyType(
    {name: RadarRegion(bounds[:2], bounds[2:4], bounds[4:]) for name, bounds in REGIONS_M.items()}
    | {"cube": RadarRegion((-0.2, 99.8), (-80.2, 79.8), (-30.2, 29.8))}
)
"""K-Radar's regions (kradar devkit: the driving corridor of benchmark v1.0, and that of v2.0), and all there is."""


def find_region(region: "str | RadarRegion") -> RadarRegion:
    """A region by its name.

    Raises:
        ConfigError: If there is none of this name.
    """
    if isinstance(region, RadarRegion):
        return region
    if region not in REGIONS:
        raise ConfigError(f"radar region: expected one of {', '.join(REGIONS)}; got {region!r}")
    return REGIONS[region]


@dataclass(frozen=True, eq=False)
class RadarCells:
    """Cells of a cube.

    Args:
        index: Place in the flat cube (z slowest, 150 x 400 x 250), rising, shape (n,), int32.
        code: Power as (dB over POWER_UNIT + 100) / 0.0025, shape (n,), uint16.
        doppler: Mean velocity in 0.1 mm/s, shape (n,), int16, or None.
        quantiles: Code at each of ``RATES``' upper quantiles of the whole cube, rows ``all`` and ``valid`` (with and
            without the cells outside the field of view), shape (2, 13), int32; -1 where it lies outside the field of
            view.
    """

    index: Int32[np.ndarray, " n"]
    code: UInt16[np.ndarray, " n"]
    doppler: Int16[np.ndarray, " n"] | None
    quantiles: Int32[np.ndarray, "2 13"]

    def __len__(self) -> int:
        return len(self.index)

    @property
    def power(self) -> Float32[np.ndarray, " n"]:
        """Power over POWER_UNIT; to 0.03 %."""
        return _decoded()[self.code]

    @property
    def doppler_m_s(self) -> Float32[np.ndarray, " n"] | None:
        """Mean velocity, wrapped, in m/s."""
        return None if self.doppler is None else self.doppler * np.float32(DOPPLER_STEP_M_S)

    def points_m(self, *, subtract_half_cell: bool = True) -> Float32[np.ndarray, "n 3"]:
        """x, y, z of the cells, in metres.

        Args:
            subtract_half_cell: Move them by -0.2 m along each axis, as the published clouds are.
        """
        shift_m = CUBE_STEP_M / 2 if subtract_half_cell else 0.0
        z, y, x = np.unravel_index(self.index, _CUBE_SHAPE)
        return np.stack([CUBE_X_M[x] - shift_m, CUBE_Y_M[y] - shift_m, CUBE_Z_M[z] - shift_m], axis=1).astype(
            np.float32
        )

    def select(
        self, region: "str | RadarRegion" = "cube", rate: float | int = 1.0, *, over: Over = "all"
    ) -> "RadarCells":
        """The cells in a region whose power is above a quantile.

        Args:
            region: A region or its name.
            rate: 1 for all cells, or one of ``RATES``.
            over: Whether the quantile is taken over ``"all"`` cells of the cube, over the ``"valid"`` ones in its field
                of view, or over all of the ``"region"``, each of which is here or weaker than all that are.

        Raises:
            ConfigError: If the rate or the region is none of those possible.
        """
        box = find_region(region)
        keep = self._inside(box)
        if rate != 1:
            if rate not in RATES:
                raise ConfigError(f"radar rate: expected 1 or one of {', '.join(map(str, RATES))}; got {rate}")
            if over == "region":
                keep &= self.code > self._level(keep, math.floor(rate * box.cells))
            else:
                keep &= self.code > self.quantiles[0 if over == "all" else 1, RATES.index(rate)]
        doppler = None if self.doppler is None else self.doppler[keep]
        return RadarCells(self.index[keep], self.code[keep], doppler, self.quantiles)

    def _level(self, keep: Bool[np.ndarray, " n"], most: int) -> int:
        """The least code that at most so many of the cells lie above."""
        codes = self.code[keep]
        return -1 if most >= len(codes) else int(np.partition(codes, len(codes) - 1 - most)[len(codes) - 1 - most])

    def _inside(self, region: RadarRegion) -> Bool[np.ndarray, " n"]:
        keep = np.ones(len(self), dtype=np.bool_)
        for coordinate, part in zip(np.unravel_index(self.index, _CUBE_SHAPE), region.slices(), strict=True):
            keep &= (coordinate >= part.start) & (coordinate < part.stop)
        return keep


def cells_of_cube(
    cube: Float32[np.ndarray, "150 400 250"],
    region: "str | RadarRegion" = "wide",
    *,
    doppler_m_s: Float32[np.ndarray, "150 400 250"] | None = None,
) -> RadarCells:
    """Take the cells of a region out of a cube.

    Args:
        cube: Power in file units, -1 outside the field of view, as ``products.zyx_cube`` returns it.
        region: A region or its name.
        doppler_m_s: Mean velocity of each cell, as ``products.doppler_cube`` returns it.

    Raises:
        ConfigError: If power is not finite, or negative inside the field of view.
    """
    least, largest = cube.min(), cube.max()
    negative = (cube < 0) & (cube != OUTSIDE) if least < 0 else np.zeros(1, dtype=np.bool_)
    if not np.isfinite(least) or not np.isfinite(largest) or negative.any():
        raise ConfigError(
            f"radar cube: expected finite power of 0 or more, or {OUTSIDE:g} outside the field of view; got {least:g} "
            f"to {largest:g}. The data are damaged: leave the frame out."
        )
    parts = find_region(region).slices()
    inside = cube[parts]
    position = np.nonzero(inside > OUTSIDE)
    index = np.ravel_multi_index(
        tuple(rows + part.start for rows, part in zip(position, parts, strict=True)), _CUBE_SHAPE
    ).astype(np.int32)
    doppler = None
    if doppler_m_s is not None:
        doppler = np.clip(np.rint(doppler_m_s.ravel()[index] / DOPPLER_STEP_M_S), -32768, 32767).astype(np.int16)
    return RadarCells(index, _coded(inside[position]), doppler, _quantiles(cube))


def _coded(power: Float32[np.ndarray, " n"]) -> UInt16[np.ndarray, " n"]:
    """Logarithm of power in file units."""
    least = POWER_UNIT * 10 ** (CODE_FLOOR_DB / 10)
    decibel = 10 * np.log10(np.maximum(power, np.float32(least)) * np.float32(1 / POWER_UNIT))
    code = np.rint((decibel - np.float32(CODE_FLOOR_DB)) * np.float32(1 / CODE_STEP_DB))
    return np.minimum(code, _CODES - 1).astype(np.uint16)


@lru_cache(maxsize=1)
def _decoded() -> Float32[np.ndarray, "65536"]:
    decibel = np.arange(_CODES) * CODE_STEP_DB + CODE_FLOOR_DB
    return (10 ** (decibel / 10)).astype(np.float32)


def _quantiles(cube: Float32[np.ndarray, "150 400 250"]) -> Int32[np.ndarray, "2 13"]:
    """The codes above which each of ``RATES`` of all cells, and of the valid ones, lie."""
    values, counts = cube.ravel(), np.zeros(_CODES, dtype=np.int64)
    for start in range(0, values.size, _CHUNK_CELLS):  # what fits a cache is coded three times as fast
        part = values[start : start + _CHUNK_CELLS]
        counts += np.bincount(_coded(part[part > OUTSIDE]), minlength=_CODES)
    valid = int(counts.sum())
    above: Int[np.ndarray, " codes"] = valid - np.cumsum(counts)
    rows = []
    for count in (values.size, valid):
        ranks = np.array(RATES) * count
        code = np.searchsorted(-above, -ranks)  # the first code with at most so many cells above it
        rows.append(np.where(ranks >= valid, -1, code))
    return np.stack(rows).astype(np.int32)
