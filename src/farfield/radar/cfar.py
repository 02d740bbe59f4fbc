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
from jaxtyping import Float, Float64, Int, Int64

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
        found = f"{false_alarm}, {looks} and {rank}"
        raise ValueError(f"CFAR: expected false_alarm in (0, 1), looks above 0 and rank in (0, 1], got {found}")
    window = window or CfarWindow()
    wide, inner = (_count(power.shape, sides) for sides in (window.outer, window.guard))
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
        found = level * np.array(factors)[which].reshape(count.shape)
    return np.where(count > 0, found, np.inf)


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
def ordered_statistic_factor(false_alarm: float, cells: int, place: int, looks: float | int = 1) -> float:
    """Factor on the k-th smallest training cell, found from the false-alarm probability by bisection.

    For one look the probability is the product of (n - i) / (n - i + factor) over i = 0 .. k - 1 (Rohling 1983);
    otherwise it is integrated over the order statistic's density.

    Args:
        false_alarm: Probability.
        cells: Training cells n.
        place: k, from 1 to n.
        looks: Looks L.
    """
    from scipy.optimize import brentq
    from scipy.special import betaincinv, betaln, gammainc, gammaincc, gammaincinv, gammaln

    if looks == 1:
        excess = partial(_excess_of_one_look, cells - np.arange(place), false_alarm)
    else:
        # exponents of the level over the noise's mean; the order statistic's whole density lies between
        ends = np.log(gammaincinv(looks, betaincinv(place, cells - place + 1, [1e-30, 1.0 - 1e-15])) / looks)
        log_level = np.linspace(ends[0], ends[1], 4001)
        scaled = looks * np.exp(log_level)
        with np.errstate(divide="ignore"):
            density = (place - 1) * np.log(gammainc(looks, scaled)) + (cells - place) * np.log(gammaincc(looks, scaled))
        density += looks * np.log(scaled) - scaled - gammaln(looks) - betaln(place, cells - place + 1)
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
            place = np.arange(size)
            edge = np.insert(np.cumsum(total, axis=axis), 0, 0.0, axis=axis)
            upper, lower = np.minimum(place + side + 1, size), np.maximum(place - side, 0)
            total = edge.take(upper, axis=axis) - edge.take(lower, axis=axis)
    return total


def _count(shape: tuple[int, ...], sides: Sides) -> Float64[np.ndarray, "r a e"]:
    return _box_sum(np.ones(shape), sides)


def _ordered(
    power: Float[np.ndarray, "r a e"], window: CfarWindow, count: Int64[np.ndarray, "r a e"], rank: float
) -> Float64[np.ndarray, "r a e"]:
    """The training cell of the wanted rank around each cell."""
    margins = window.outer
    padded = np.pad(power, [(side, side) for side in margins], constant_values=np.inf)
    strides = np.array([padded.shape[1] * padded.shape[2], padded.shape[2], 1])
    around = window.offsets() @ strides
    places = np.stack(np.unravel_index(np.arange(power.size), power.shape), axis=1) + np.array(margins)
    centre, flat = places @ strides, padded.ravel()
    level = np.full(power.size, np.inf)
    for number in np.unique(count[count > 0]):
        cells = np.flatnonzero(count.ravel() == number)
        place = rank_of(int(number), rank) - 1  # cells beyond the border are infinite: they sort behind all others
        step = max(_CHUNK_VALUES // len(around), 1)
        for start in range(0, len(cells), step):
            part = cells[start : start + step]
            level[part] = np.partition(flat[centre[part, None] + around], place, axis=1)[:, place]
    return level.reshape(power.shape)
