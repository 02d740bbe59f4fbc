"""What one radar frame shows: its power from above, front and side, its Doppler, and the cells that a CFAR detects.

Whatever product there is will do, with less to see: a tesseract and a polar map have Doppler and are searched for
echoes, a cube and the store's cells have power alone.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from farfield.radar.axes import CUBE_SHAPE, CUBE_X_M, CUBE_Z_M, KRADAR_AXES, OUTSIDE, POWER_UNIT
from farfield.radar.cells import RadarCells
from farfield.radar.cfar import Kind, cfar, marks_of_points, side_lobes
from farfield.radar.doppler import UnwrappedVelocity, unwrap, wrapped_mean_velocity, wrapped_peak_velocity
from farfield.radar.products import moments, polar_points, zyx_cube
from farfield.vocabulary.kradar import REGIONS_M

Doppler = Literal["mean", "peak"]
PRODUCTS = ("tesseract", "polar3d", "cube", "cells")
"""Products that are looked at; the first that is there counts, a cube beside a polar map too."""

LOOKS = len(KRADAR_AXES.doppler_m_s) - 1
"""Doppler bins that a cell of the polar map is the mean of."""

NEAREST_M = 5.5
"""Nearer cells hold the transmitter's leakage: they are not searched for echoes nor seen from front and side."""


_PEAK = (1, 3)  # bins of range and azimuth


@dataclass(frozen=True, eq=False, kw_only=True)
class PolarPeaks:
    """Cells of the polar map that stand out of what is around them, one for each range and azimuth.

    Args:
        points_m: x, y, z in the radar's frame, shape (n, 3).
        power_db: Power over ``POWER_UNIT``, shape (n,).
        wrapped_m_s: Radial velocity, wrapped, shape (n,).
        side_lobe: Whether a stronger echo's side lobes explain it, shape (n,).
        peak: Whether it is the strongest around, within a main lobe and a bin of range, shape (n,).
    """

    points_m: Float32[np.ndarray, "n 3"]
    power_db: Float32[np.ndarray, " n"]
    wrapped_m_s: Float32[np.ndarray, " n"]
    side_lobe: Bool[np.ndarray, " n"]
    peak: Bool[np.ndarray, " n"]

    def __len__(self) -> int:
        return len(self.points_m)

    def unwrapped(self, radar_velocity_m_s: Float[np.ndarray, "3"]) -> UnwrappedVelocity:
        """Their velocities for a radar that moves so, see :func:`~farfield.radar.doppler.unwrap`."""
        return unwrap(self.wrapped_m_s, self.points_m, radar_velocity_m_s)


@dataclass(frozen=True, eq=False, kw_only=True)
class RadarViews:
    """One frame in two dimensions; levels in dB over ``POWER_UNIT``, not-a-number where there is no cell.

    Args:
        products: What it was made of.
        bird_db: BEV-2D: mean power over the heights of K-Radar's wide region, shape (400, 250), y and x of the cube.
        front_db: BFS-2D from the front: strongest power over x, shape (150, 400), z and y.
        side_db: BFS-2D from the side: strongest power over y, shape (150, 250), z and x.
        polar_db: Mean power over elevation, shape (256, 107), range and azimuth, or None.
        wrapped_m_s: Wrapped velocity of the strongest elevation, shape (256, 107), or None.
        echoes: What the CFAR detects, or None.
    """

    products: tuple[str, ...]
    bird_db: Float32[np.ndarray, "y x"]
    front_db: Float32[np.ndarray, "z y"]
    side_db: Float32[np.ndarray, "z x"]
    polar_db: Float32[np.ndarray, "r a"] | None = None
    wrapped_m_s: Float32[np.ndarray, "r a"] | None = None
    echoes: PolarPeaks | None = None


def radar_views(
    radar: Mapping[str, Any],
    *,
    kind: Kind = "cell-averaging",
    false_alarm: float = 1e-6,
    doppler: Doppler = "mean",
) -> RadarViews | None:
    """Look at the products of one frame.

    Args:
        radar: Products by name, in K-Radar's axes.
        kind: Of the CFAR.
        false_alarm: Probability that a cell of noise alone is detected.
        doppler: Velocity of a cell: the power-weighted ``"mean"`` of its bins, or ``"peak"``, that of the strongest
            bin, which takes the tesseract.

    Returns:
        None if there is none of :data:`PRODUCTS`.

    Raises:
        ValueError: If ``doppler`` is ``"peak"`` and there is no tesseract, or an argument is none of those possible.
    """
    used = _used(radar, doppler)
    if not used:
        return None
    polar = _polar(radar, used, doppler)
    cube = _cube(radar, used, polar)
    low, high = REGIONS_M["wide"][4:]
    bodies = cube[(low <= CUBE_Z_M) & (high > CUBE_Z_M)]
    ahead = cube.copy()
    ahead[:, :, CUBE_X_M < NEAREST_M] = OUTSIDE
    views = bfs_2d(ahead, "max")
    bird, front, side = map(decibel, (bev_2d(bodies, "mean"), views.front, views.side))
    if polar is None:
        return RadarViews(products=used, bird_db=bird, front_db=front, side_db=side)
    strongest = polar[0].argmax(axis=2)[..., None]
    return RadarViews(
        products=used,
        bird_db=bird,
        front_db=front,
        side_db=side,
        polar_db=decibel(polar_views(polar[0], "mean").bird, unit=1.0),
        wrapped_m_s=np.take_along_axis(polar[1], strongest, axis=2)[..., 0],
        echoes=echoes_of(polar, kind=kind, false_alarm=false_alarm),
    )


def bird_db(radar: Mapping[str, Any]) -> Float32[np.ndarray, "y x"] | None:
    """BEV-2D alone, as :class:`RadarViews` has it, without a search for echoes; None if there is no product."""
    used = _used(radar, "mean")
    if not used:
        return None
    low, high = REGIONS_M["wide"][4:]
    cube = _cube(radar, used, _polar(radar, used, "mean"))
    return decibel(bev_2d(cube[(low <= CUBE_Z_M) & (high > CUBE_Z_M)], "mean"))


def echoes_of(
    polar: Float32[np.ndarray, "2 r a e"], *, kind: Kind = "cell-averaging", false_alarm: float = 1e-6
) -> PolarPeaks:
    """Detect the echoes of a polar map; of the elevations of one direction the strongest cell is kept.

    Args:
        polar: Power over ``POWER_UNIT`` and wrapped velocity, as :func:`~farfield.radar.products.polar3d` returns them.
        kind: Of the CFAR.
        false_alarm: Probability that a cell of noise alone is detected.
    """
    cells = cfar(polar[0], kind=kind, false_alarm=false_alarm, looks=LOOKS)
    _, azimuths, elevations = polar[0].shape
    first_cell = int(np.searchsorted(KRADAR_AXES.range_m, NEAREST_M)) * azimuths * elevations
    cells = _strongest(polar[0], cells[cells >= first_cell])
    columns = polar_points(polar, cells)
    marked = side_lobes(polar)
    return PolarPeaks(
        points_m=columns[:, :3].astype(np.float32),
        power_db=decibel(columns[:, 3].astype(np.float32), unit=1.0),
        wrapped_m_s=columns[:, 4].astype(np.float32),
        side_lobe=marks_of_points(columns[:, :3], marked),
        peak=_peaks(polar[0].max(axis=2)).ravel()[cells // polar.shape[3]],
    )


def _used(radar: Mapping[str, Any], doppler: Doppler) -> tuple[str, ...]:
    """The products to read: of several with the same content the smallest."""
    if doppler == "peak":
        if "tesseract" not in radar:
            raise ValueError(f"doppler peak: expected a tesseract, got {', '.join(radar) or 'no product'}")
        return ("tesseract",)
    polar = next((name for name in ("polar3d", "tesseract") if name in radar), None)
    cube = next((name for name in ("cube", "cells") if name in radar), None)
    if polar is None:
        return () if cube is None else (cube,)
    return (polar, "cube") if cube == "cube" else (polar,)


def _polar(
    radar: Mapping[str, Any], used: tuple[str, ...], doppler: Doppler
) -> Float32[np.ndarray, "2 256 107 37"] | None:
    """Power over ``POWER_UNIT`` and wrapped velocity on range, azimuth and elevation."""
    if "polar3d" in used:
        return np.ascontiguousarray(radar["polar3d"], dtype=np.float32)
    if "tesseract" not in used:
        return None
    tensor = np.asarray(radar["tesseract"], dtype=np.float32)
    reduced = moments(tensor)
    velocity = wrapped_mean_velocity(reduced) if doppler == "mean" else wrapped_peak_velocity(tensor)
    both = np.stack([reduced.mean_power_63 / np.float32(POWER_UNIT), velocity])
    return np.ascontiguousarray(both.transpose(0, 1, 3, 2))


def _cube(
    radar: Mapping[str, Any], used: tuple[str, ...], polar: Float32[np.ndarray, "2 256 107 37"] | None
) -> Float32[np.ndarray, "150 400 250"]:
    """Power in file units, -1 where there is no cell: the cube, the store's cells, or the polar map's power on it."""
    if "cube" in used:
        return np.asarray(radar["cube"], dtype=np.float32)
    if polar is not None:
        return zyx_cube(np.ascontiguousarray(polar[0].transpose(0, 2, 1)) * np.float32(POWER_UNIT))
    cells: RadarCells = radar["cells"]
    cube = np.full(CUBE_SHAPE, OUTSIDE, dtype=np.float32)
    cube.ravel()[cells.index] = cells.power * np.float32(POWER_UNIT)
    return cube


def _peaks(power: Float32[np.ndarray, "r a"]) -> Bool[np.ndarray, "r a"]:
    """Cells that no cell within ``_PEAK`` bins exceeds."""
    padded = np.pad(power, [(side, side) for side in _PEAK], constant_values=-np.inf)
    windows = np.lib.stride_tricks.sliding_window_view(padded, tuple(2 * side + 1 for side in _PEAK))
    return power >= windows.max(axis=(2, 3))


def _strongest(power: Float32[np.ndarray, "r a e"], cells: Int[np.ndarray, " n"]) -> Int[np.ndarray, " m"]:
    """Of the cells of each range and azimuth the one with the most power, in rising order."""
    order = cells[np.lexsort((-power.ravel()[cells], cells // power.shape[2]))]
    _, first = np.unique(order // power.shape[2], return_index=True)
    return order[first]


# A radar's power in two dimensions: from above, from the front and from the side.
#
# K-Radar's annotators draw boxes in BEV-2D and read heights off BFS-2D (appendix D.1 of the paper, which spells neither
# out): here the bird's-eye, front and side views of the Cartesian cube, or of the polar map.

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
    projected = total / np.maximum(count, 1) if how == "mean" else total
    return np.where(count > 0, projected, OUTSIDE).astype(np.float32)


def decibel(
    power: Float[np.ndarray, "*shape"], *, unit: float = POWER_UNIT, floor_db: float | int = -100.0
) -> Float[np.ndarray, "*shape"]:
    """Power in dB over a unit, at least ``floor_db``; not-a-number outside the field of view (-1)."""
    level = 10 * np.log10(np.maximum(power, unit * 10 ** (floor_db / 10)) / unit)
    return np.where(power > OUTSIDE, level, np.nan).astype(power.dtype)
