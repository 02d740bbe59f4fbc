"""A radar's power in two dimensions: from above, from the front and from the side.

K-Radar's annotators draw boxes in BEV-2D and read heights off BFS-2D (appendix D.1 of the paper, which spells neither
out): here the bird's-eye, front and side views of the Cartesian cube, or of the polar map.
"""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Float32

from farfield.radar.axes import POWER_UNIT
from farfield.radar.grid import OUTSIDE

How = Literal["max", "mean", "sum"]


class RadarProjections(NamedTuple):
    """Three projections, linear power in the input's units; -1 where a line of sight has no cell in the field of view.

    Args:
        bird: From above: of a cube (y, x), of a polar map (range, azimuth).
        front: From the front: of a cube (z, y), of a polar map (elevation, azimuth).
        side: From the side: of a cube (z, x), of a polar map (elevation, range).
    """

    bird: Float32[np.ndarray, "_ _"]
    front: Float32[np.ndarray, "_ _"]
    side: Float32[np.ndarray, "_ _"]


def bev_2d(cube: Float32[np.ndarray, "z y x"], how: How = "mean") -> Float32[np.ndarray, "y x"]:
    """A cube from above.

    Args:
        cube: Power, -1 outside the field of view.
        how: ``"max"``, ``"mean"`` or ``"sum"`` over the cells in the field of view.
    """
    return _along(cube, 0, how)


def bfs_2d(cube: Float32[np.ndarray, "z y x"], how: How = "max") -> RadarProjections:
    """A cube from above, from the front and from the side; arguments as :func:`bev_2d`."""
    return RadarProjections(_along(cube, 0, how), _along(cube, 2, how), _along(cube, 1, how))


def polar_views(power: Float32[np.ndarray, "r a e"], how: How = "mean") -> RadarProjections:
    """A polar map from above, from the front and from the side.

    Args:
        power: Power of every cell: channel 0 of ``polar3d``.
        how: ``"max"``, ``"mean"`` or ``"sum"``.
    """
    return RadarProjections(_along(power, 2, how), _along(power, 0, how).T, _along(power, 1, how).T)


def _along(values: Float32[np.ndarray, "_ _ _"], axis: int, how: How) -> Float32[np.ndarray, "_ _"]:
    if how not in ("max", "mean", "sum"):
        raise ValueError(f"projection: expected how to be max, mean or sum; got {how!r}")
    if how == "max":
        return values.max(axis=axis)
    inside = values > OUTSIDE
    count = np.count_nonzero(inside, axis=axis)
    total = np.sum(values, axis=axis, where=inside, dtype=np.float64)
    found = total / np.maximum(count, 1) if how == "mean" else total
    return np.where(count > 0, found, OUTSIDE).astype(np.float32)


def decibel(
    power: Float[np.ndarray, "*shape"], *, unit: float = POWER_UNIT, floor_db: float | int = -100.0
) -> Float[np.ndarray, "*shape"]:
    """Power in dB over a unit, at least ``floor_db``; not-a-number outside the field of view (-1)."""
    level = 10 * np.log10(np.maximum(power, unit * 10 ** (floor_db / 10)) / unit)
    return np.where(power > OUTSIDE, level, np.nan).astype(power.dtype)
