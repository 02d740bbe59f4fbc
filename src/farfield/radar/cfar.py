"""Detectors of constant false-alarm rate on a power grid: cell-averaging and ordered-statistic.

A cell is detected if it exceeds a level taken from the training cells around it, outside a guard zone, times a factor
that the false-alarm probability decides: for power that is exponential (one look) or the mean of several such looks
(gamma), as in a map averaged over Doppler. Rohling, "Radar CFAR Thresholding in Clutter and Multiple Target
Situations", IEEE T-AES 19(4), 1983. At the border a cell has fewer training cells, and a factor of its own.
"""

from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int, Int64, Num

from farfield.radar.axes import KRADAR_AXES, RadarAxes
from farfield.radar.products import check_shape

Kind = Literal["cell-averaging", "ordered-statistic"]
Sides = tuple[int, int, int]
_CHUNK_VALUES = 1 << 23


@dataclass(frozen=True)
class CfarWindow:
    """Half widths around the cell under test, in cells along the grid's three axes (range, azimuth, elevation).

    The defaults leave out a point target's own cells in K-Radar (two in range, three in azimuth) and do not train along
    elevation, where ten neighbouring beams see the same.

    Args:
        guard: Cells on each side that belong to the target.
        training: Cells beyond them on each side that tell the level.

    Raises:
        ValueError: If a width is negative, or there is no training cell.
    """

    guard: Sides = (2, 3, 0)
    training: Sides = (4, 6, 0)

    def __post_init__(self) -> None:
        if min(*self.guard, *self.training) < 0 or not any(self.training):
            raise ValueError(f"CFAR: expected widths of 0 or more and some training cells, got {self}")

    @property
    def outer(self) -> Sides:
        """Half widths of the whole window."""
        r, a, e = (guard + training for guard, training in zip(self.guard, self.training, strict=True))
        return r, a, e

    def offsets(self) -> Int64[np.ndarray, "n 3"]:
        """The training cells as seen from the cell under test."""
        grids = np.meshgrid(*(np.arange(-side, side + 1) for side in self.outer), indexing="ij")
        every = np.stack([grid.ravel() for grid in grids], axis=1)
        return every[(np.abs(every) > np.array(self.guard)).any(axis=1)]


def cfar(
    power: Float[np.ndarray, "r a e"],
    *,
    kind: Kind = "cell-averaging",
    window: CfarWindow | None = None,
    false_alarm: float = 1e-4,
    looks: float | int = 1,
    rank: float = 0.75,
) -> Int[np.ndarray, " n"]:
    """Detect cells.

    Args:
        power: Linear power on a grid, such as channel 0 of ``polar3d``.
        kind: ``"cell-averaging"``, or ``"ordered-statistic"``, which a second target among the training cells does not
            deafen.
        window: Guard and training cells.
        false_alarm: Probability that a cell of noise alone is detected.
        looks: Independent exponential values that each cell is the mean of: 1 for one Doppler bin, 63 for ``polar3d``.
        rank: Which of the sorted training cells counts, as a share (ordered-statistic).

    Returns:
        Flat indices of the detected cells, rising; see :func:`~farfield.radar.products.polar_points`.

    Raises:
        ValueError: If an argument is not one of those possible.
    """
    levels = cfar_threshold(power, kind=kind, window=window, false_alarm=false_alarm, looks=looks, rank=rank)
    return np.flatnonzero(power.ravel() > levels.ravel())


def cfar_threshold(
    power: Float[np.ndarray, "r a e"],
    *,
    kind: Kind = "cell-averaging",
    window: CfarWindow | None = None,
    false_alarm: float = 1e-4,
    looks: float | int = 1,
    rank: float = 0.75,
) -> Float64[np.ndarray, "r a e"]:
    """The power that each cell must exceed; arguments as :func:`cfar`. Infinite where no training cell is in the grid.

    Raises:
        ValueError: If an argument is not one of those possible.
    """
    if kind not in ("cell-averaging", "ordered-statistic"):
        raise ValueError(f"CFAR: expected cell-averaging or ordered-statistic, got {kind!r}")
    if not (0 < false_alarm < 1 and looks > 0 and 0 < rank <= 1):
        actual = f"{false_alarm}, {looks} and {rank}"
        raise ValueError(f"CFAR: expected false_alarm in (0, 1), looks above 0 and rank in (0, 1], got {actual}")
    window = window or CfarWindow()
    wide, inner = (_box_sum(np.ones(power.shape), sides) for sides in (window.outer, window.guard))
    count = np.rint(wide - inner).astype(np.int64)
    kinds, which = np.unique(count, return_inverse=True)
    if kind == "cell-averaging":
        level = np.maximum(_box_sum(power, window.outer) - _box_sum(power, window.guard), 0.0) / np.maximum(count, 1)
        factors = [cell_averaging_factor(false_alarm, int(n), looks) if n else np.inf for n in kinds]
    else:
        level = _ordered(power, window, count, rank)
        factors = [
            ordered_statistic_factor(false_alarm, int(n), rank_of(int(n), rank), looks) if n else np.inf for n in kinds
        ]
    with np.errstate(invalid="ignore"):
        actual = level * np.array(factors)[which].reshape(count.shape)
    return np.where(count > 0, actual, np.inf)


def cell_averaging_factor(false_alarm: float, cells: int, looks: float | int = 1) -> float:
    """Factor on the training cells' mean.

    The share of the cell under test in its sum with n training cells is Beta(L, n L) distributed, so that for one look
    the factor is n (p^(-1/n) - 1).

    Args:
        false_alarm: Probability p.
        cells: Training cells n.
        looks: Looks L.
    """
    from scipy.special import betaincinv

    rest = float(betaincinv(cells * looks, looks, false_alarm))
    return cells * (1.0 - rest) / rest


def rank_of(cells: int, rank: float) -> int:
    """Which of so many sorted cells, 1 the smallest, a share stands for."""
    return max(1, min(cells, round(rank * cells)))


@lru_cache(maxsize=4096)
def ordered_statistic_factor(false_alarm: float, cells: int, order: int, looks: float | int = 1) -> float:
    """Factor on the k-th smallest training cell, found from the false-alarm probability by bisection.

    For one look the probability is the product of (n - i) / (n - i + factor) over i = 0 .. k - 1 (Rohling 1983);
    otherwise it is integrated over the order statistic's density.

    Args:
        false_alarm: Probability.
        cells: Training cells n.
        order: k, from 1 to n.
        looks: Looks L.
    """
    from scipy.optimize import brentq
    from scipy.special import betaincinv, betaln, gammainc, gammaincc, gammaincinv, gammaln

    if looks == 1:
        excess = partial(_excess_of_one_look, cells - np.arange(order), false_alarm)
    else:
        # exponents of the level over the noise's mean; the order statistic's whole density lies between
        ends = np.log(gammaincinv(looks, betaincinv(order, cells - order + 1, [1e-30, 1.0 - 1e-15])) / looks)
        log_level = np.linspace(ends[0], ends[1], 4001)
        scaled = looks * np.exp(log_level)
        with np.errstate(divide="ignore"):
            density = (order - 1) * np.log(gammainc(looks, scaled)) + (cells - order) * np.log(gammaincc(looks, scaled))
        density += looks * np.log(scaled) - scaled - gammaln(looks) - betaln(order, cells - order + 1)
        weight = np.exp(density) * (log_level[1] - log_level[0])
        excess = partial(_excess_of_looks, weight, scaled, looks, false_alarm)
    return float(np.exp(brentq(excess, -10.0, 12.0, xtol=1e-12)))


def _excess_of_one_look(left: Int[np.ndarray, " k"], false_alarm: float, log_factor: float) -> float:
    """Logarithm of the probability at a factor, less that of the wanted one."""
    return float(np.log(left / (left + np.exp(log_factor))).sum() - np.log(false_alarm))


def _excess_of_looks(
    weight: Float[np.ndarray, " m"],
    scaled: Float[np.ndarray, " m"],
    looks: float | int,
    false_alarm: float,
    log_factor: float,
) -> float:
    """The same for several looks; ``weight`` is the level's density, ``scaled`` the level in looks."""
    from scipy.special import gammaincc

    share = weight @ gammaincc(looks, scaled * np.exp(log_factor))
    return float(np.log(max(share, 1e-300)) - np.log(false_alarm))


def _box_sum(values: Float[np.ndarray, "r a e"], sides: Sides) -> Float64[np.ndarray, "r a e"]:
    """Sum over a box around each cell, as far as it lies in the grid."""
    total = values.astype(np.float64)
    for axis, side in enumerate(sides):
        if side:
            size = total.shape[axis]
            position = np.arange(size)
            edge = np.insert(np.cumsum(total, axis=axis), 0, 0.0, axis=axis)
            upper, lower = np.minimum(position + side + 1, size), np.maximum(position - side, 0)
            total = edge.take(upper, axis=axis) - edge.take(lower, axis=axis)
    return total


def _ordered(
    power: Float[np.ndarray, "r a e"], window: CfarWindow, count: Int64[np.ndarray, "r a e"], rank: float
) -> Float64[np.ndarray, "r a e"]:
    """The training cell of the wanted rank around each cell."""
    margins = window.outer
    padded = np.pad(power, [(side, side) for side in margins], constant_values=np.inf)
    strides = np.array([padded.shape[1] * padded.shape[2], padded.shape[2], 1])
    around = window.offsets() @ strides
    positions = np.stack(np.unravel_index(np.arange(power.size), power.shape), axis=1) + np.array(margins)
    centre, values = positions @ strides, padded.ravel()
    level = np.full(power.size, np.inf)
    for number in np.unique(count[count > 0]):
        cells = np.flatnonzero(count.ravel() == number)
        order = rank_of(int(number), rank) - 1  # cells beyond the border are infinite: they sort behind all others
        step = max(_CHUNK_VALUES // len(around), 1)
        for start in range(0, len(cells), step):
            part = cells[start : start + step]
            level[part] = np.partition(values[centre[part, None] + around], order, axis=1)[:, order]
    return level.reshape(power.shape)


# Which cells may be nothing but side lobes of a stronger echo at the same range.
#
# A method of this project, standing where RTNH+ has its unpublished second filter. Powers count from the noise floor of
# their range, which is taken from the bins around. In every range bin the local maxima that stand out of the floor are
# visited from the strongest down; one that is not itself marked marks the cells outside its main lobe whose power does
# not exceed what the antenna's side lobes let through: cells beside it in azimuth by the level of azimuth, those above
# and below by that of elevation, those that are both by both. A mark means "may be nothing but a side lobe": what an
# object leaves behind a much stronger one is marked too.

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
    for row in range(len(marked)):
        power = polar[0, row] - floor[row]
        velocity = _echo_velocity(polar[:, row], power, float(floor[row]), axes)
        source_cells = np.flatnonzero(peaks[row] & (power > floor[row] * (10 ** (source_db / 10) - 1)))
        strongest = source_cells[np.argsort(-power.ravel()[source_cells], kind="stable")[:sources]]
        for azimuth, elevation in zip(*np.unravel_index(strongest, power.shape), strict=True):
            if marked[row, azimuth, elevation]:
                continue
            beside = np.abs(axes.azimuth_deg - axes.azimuth_deg[azimuth]) > antenna.azimuth_lobe_deg
            above = np.abs(axes.elevation_deg - axes.elevation_deg[elevation]) > antenna.elevation_lobe_deg
            share = np.where(beside, through[0], 1.0)[:, None] * np.where(above, through[1], 1.0)[None, :]
            explained = (power <= power[azimuth, elevation] * share) & (beside[:, None] | above[None, :])
            if doppler_tolerance_m_s is not None:
                apart = velocity - velocity[azimuth, elevation]
                apart -= np.rint(apart / axes.velocity_span_m_s) * np.float32(axes.velocity_span_m_s)
                explained &= np.abs(apart) <= doppler_tolerance_m_s
            marked[row] |= explained
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
    inside, indices = np.ones(len(x), dtype=np.bool_), []
    for axis, value in zip((axes.range_m, axes.azimuth_deg, axes.elevation_deg), values, strict=True):
        index = np.rint((value - axis[0]) * ((len(axis) - 1) / (axis[-1] - axis[0])))
        inside &= (index >= 0) & (index < len(axis))
        indices.append(np.clip(index, 0, len(axis) - 1).astype(np.int64))
    return marked[indices[0], indices[1], indices[2]] & inside
