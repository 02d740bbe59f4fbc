"""Which cells may be nothing but side lobes of a stronger echo at the same range.

A method of this project, standing where RTNH+ has its unpublished second filter: in every range bin the local maxima
are visited from the strongest down. A cell is marked if its power does not exceed an unmarked maximum's by more than
the antenna's side-lobe level lets through, outside that maximum's main lobe. A cell beside in azimuth gets the level of
azimuth, one above or below that of elevation, one that is both gets both. A marked maximum explains no other cell.
A mark means "not to be told from a side lobe": what an object leaves behind a much stronger one is marked too.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Num

from farfield.radar.axes import KRADAR_AXES, RadarAxes
from farfield.radar.selection import check_shape


@dataclass(frozen=True)
class Antenna:
    """What an antenna lets through beside its main lobe.

    The defaults are those of K-Radar's radar: one published map has azimuth side lobes 10 to 13 dB down over all
    angles and a main lobe of three to four cells; elevation beams ten degrees apart are alike.

    Args:
        azimuth_db: Side lobes lie at least so far below the main lobe along azimuth.
        elevation_db: The same along elevation.
        azimuth_lobe_deg: Half width of the main lobe, to its first zero.
        elevation_lobe_deg: The same along elevation.
    """

    azimuth_db: float | int = 10.0
    elevation_db: float | int = 10.0
    azimuth_lobe_deg: float | int = 3.0
    elevation_lobe_deg: float | int = 12.0


def side_lobes(
    polar: Float32[np.ndarray, "2 r a e"],
    antenna: Antenna | None = None,
    axes: RadarAxes = KRADAR_AXES,
    *,
    doppler_tolerance_m_s: float | int | None = None,
    sources: int = 64,
) -> Bool[np.ndarray, "r a e"]:
    """Mark the cells of a polar map that a stronger echo's side lobes explain.

    Args:
        polar: Power and wrapped mean velocity, as :func:`~farfield.radar.products.polar3d` returns them.
        antenna: Side-lobe levels and main lobe.
        axes: The map's axes.
        doppler_tolerance_m_s: Mark only cells whose velocity, modulo the span, is within this of the echo's: a side
            lobe has the velocity of what causes it. None takes no notice of velocities.
        sources: At most so many maxima of a range bin are visited.
    """
    check_shape(polar.shape[1:], (len(axes.range_m), len(axes.azimuth_deg), len(axes.elevation_deg)), "r, a, e")
    antenna = antenna or Antenna()
    through = 10 ** (-np.array([antenna.azimuth_db, antenna.elevation_db]) / 10)
    marked = np.zeros(polar.shape[1:], dtype=np.bool_)
    peaks = _local_maxima(polar[0])
    for place in range(len(marked)):
        power, velocity = polar[0, place], polar[1, place]
        found = np.flatnonzero(peaks[place])
        strongest = found[np.argsort(-power.ravel()[found], kind="stable")[:sources]]
        weakest = power.min()
        for azimuth, elevation in zip(*np.unravel_index(strongest, power.shape), strict=True):
            peak = float(power[azimuth, elevation])
            if peak * through.max() < weakest:
                break
            if marked[place, azimuth, elevation]:
                continue
            beside = np.abs(axes.azimuth_deg - axes.azimuth_deg[azimuth]) > antenna.azimuth_lobe_deg
            above = np.abs(axes.elevation_deg - axes.elevation_deg[elevation]) > antenna.elevation_lobe_deg
            share = np.where(beside, through[0], 1.0)[:, None] * np.where(above, through[1], 1.0)[None, :]
            explained = (power <= peak * share) & (beside[:, None] | above[None, :])
            if doppler_tolerance_m_s is not None:
                apart = velocity - velocity[azimuth, elevation]
                apart -= np.rint(apart / axes.velocity_span_m_s) * np.float32(axes.velocity_span_m_s)
                explained &= np.abs(apart) <= doppler_tolerance_m_s
            marked[place] |= explained
    return marked


def _local_maxima(power: Float32[np.ndarray, "r a e"]) -> Bool[np.ndarray, "r a e"]:
    """Cells with power that no neighbour in azimuth and elevation exceeds."""
    highest = power
    for axis in (1, 2):
        pad = [(0, 0)] * 3
        pad[axis] = (1, 1)
        wide = np.pad(highest, pad, constant_values=-np.inf)
        size = power.shape[axis]
        shifted = [wide.take(range(first, first + size), axis=axis) for first in range(3)]
        highest = np.maximum(np.maximum(shifted[0], shifted[1]), shifted[2])
    return (power >= highest) & (power > 0)


def marks_of_points(
    points_m: Num[np.ndarray, "n 3"], marked: Bool[np.ndarray, "r a e"], axes: RadarAxes = KRADAR_AXES
) -> Bool[np.ndarray, " n"]:
    """The mark of the polar cell that each point lies in; a point outside the map has none.

    Args:
        points_m: Points in the radar's frame. Points of clouds with half a cell subtracted must be moved back first.
        marked: What :func:`side_lobes` returns.
        axes: The map's axes.
    """
    x, y, z = points_m.astype(np.float64).T
    flat_m = np.hypot(x, y)
    values = (np.hypot(flat_m, z), np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, flat_m)))
    inside, places = np.ones(len(x), dtype=np.bool_), []
    for axis, value in zip((axes.range_m, axes.azimuth_deg, axes.elevation_deg), values, strict=True):
        place = np.rint((value - axis[0]) * ((len(axis) - 1) / (axis[-1] - axis[0])))
        inside &= (place >= 0) & (place < len(axis))
        places.append(np.clip(place, 0, len(axis) - 1).astype(np.int64))
    return marked[places[0], places[1], places[2]] & inside
