"""Which cells may be nothing but side lobes of a stronger echo at the same range.

A method of this project, standing where RTNH+ has its unpublished second filter. Powers count from the noise floor of
their range, which is taken from the bins around. In every range bin the local maxima that stand out of the floor are
visited from the strongest down; one that is not itself marked marks the cells outside its main lobe whose power does
not exceed what the antenna's side lobes let through: cells beside it in azimuth by the level of azimuth, those above
and below by that of elevation, those that are both by both. A mark means "may be nothing but a side lobe": what an
object leaves behind a much stronger one is marked too.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Num

from farfield.radar.axes import KRADAR_AXES, RadarAxes
from farfield.radar.selection import check_shape

_FLOOR_BINS = 10


@dataclass(frozen=True)
class Antenna:
    """What an antenna lets through beside its main lobe.

    The defaults fit K-Radar's radar as far as one published map tells: azimuth side lobes 10 to 13 dB down in the mean
    over all angles, the highest some 8 dB, a main lobe of three to four cells, and elevation beams ten degrees wide.

    Args:
        azimuth_db: Side lobes lie at least so far below the main lobe along azimuth.
        elevation_db: The same along elevation.
        azimuth_lobe_deg: Half width of the main lobe, to its first zero.
        elevation_lobe_deg: The same along elevation.
    """

    azimuth_db: float | int = 8.0
    elevation_db: float | int = 8.0
    azimuth_lobe_deg: float | int = 3.0
    elevation_lobe_deg: float | int = 12.0


def side_lobes(
    polar: Float32[np.ndarray, "2 r a e"],
    antenna: Antenna | None = None,
    axes: RadarAxes = KRADAR_AXES,
    *,
    doppler_tolerance_m_s: float | int | None = None,
    source_db: float | int = 3.0,
    sources: int = 64,
) -> Bool[np.ndarray, "r a e"]:
    """Mark the cells of a polar map that a stronger echo's side lobes explain.

    Args:
        polar: Power and wrapped mean velocity, as :func:`~farfield.radar.products.polar3d` returns them.
        antenna: Side-lobe levels and main lobe.
        axes: The map's axes.
        doppler_tolerance_m_s: Mark only cells whose velocity, modulo the span, is within this of the echo's: a side
            lobe has the velocity of what causes it. The noise's share in the mean velocity is taken out first. None
            takes no notice of velocities; 0.3 is a sensible tolerance.
        source_db: A maximum is an echo if it exceeds the noise floor by so much; enough for a mean over 63 bins.
        sources: At most so many maxima of a range bin are visited.
    """
    check_shape(polar.shape[1:], (len(axes.range_m), len(axes.azimuth_deg), len(axes.elevation_deg)), "r, a, e")
    antenna = antenna or Antenna()
    through = 10 ** (-np.array([antenna.azimuth_db, antenna.elevation_db]) / 10)
    marked = np.zeros(polar.shape[1:], dtype=np.bool_)
    peaks, floor = _local_maxima(polar[0]), _noise_floor(polar[0])
    for place in range(len(marked)):
        power = polar[0, place] - floor[place]
        velocity = _echo_velocity(polar[:, place], power, float(floor[place]), axes)
        found = np.flatnonzero(peaks[place] & (power > floor[place] * (10 ** (source_db / 10) - 1)))
        strongest = found[np.argsort(-power.ravel()[found], kind="stable")[:sources]]
        for azimuth, elevation in zip(*np.unravel_index(strongest, power.shape), strict=True):
            if marked[place, azimuth, elevation]:
                continue
            beside = np.abs(axes.azimuth_deg - axes.azimuth_deg[azimuth]) > antenna.azimuth_lobe_deg
            above = np.abs(axes.elevation_deg - axes.elevation_deg[elevation]) > antenna.elevation_lobe_deg
            share = np.where(beside, through[0], 1.0)[:, None] * np.where(above, through[1], 1.0)[None, :]
            explained = (power <= power[azimuth, elevation] * share) & (beside[:, None] | above[None, :])
            if doppler_tolerance_m_s is not None:
                apart = velocity - velocity[azimuth, elevation]
                apart -= np.rint(apart / axes.velocity_span_m_s) * np.float32(axes.velocity_span_m_s)
                explained &= np.abs(apart) <= doppler_tolerance_m_s
            marked[place] |= explained
    return marked


def _echo_velocity(
    polar: Float32[np.ndarray, "2 a e"], power: Float32[np.ndarray, "a e"], floor: float, axes: RadarAxes
) -> Float32[np.ndarray, "a e"]:
    """Mean velocity of what stands above the noise, which has power in all bins alike; 0 where nothing does."""
    moment = polar[0] * polar[1] - np.float32(floor * axes.doppler_m_s[1:].mean())
    return np.divide(moment, power, out=np.zeros_like(moment), where=power > 0)


def _noise_floor(power: Float32[np.ndarray, "r a e"]) -> Float32[np.ndarray, " r"]:
    """Noise of each range bin: the lower quartile of the medians of the bins around, few of which hold echoes."""
    medians = np.median(power.reshape(len(power), -1), axis=1)
    padded = np.pad(medians, _FLOOR_BINS, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * _FLOOR_BINS + 1)
    return np.minimum(np.quantile(windows, 0.25, axis=1), medians).astype(np.float32)


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
