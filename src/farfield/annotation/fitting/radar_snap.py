"""The peak of a radar's map that a person meant: the strongest near the pointer, finer than a cell."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from farfield.radar.axes import KRADAR_AXES, RadarAxes

REACH_M = 1.5
_FLOOR = 1e-6  # of the strongest cell, 60 dB below it: logarithms need something


def peak_near(
    power: Float[np.ndarray, "r a"],
    at_xy: Sequence[float] | Float[np.ndarray, " 2"],
    axes: RadarAxes = KRADAR_AXES,
    *,
    reach_m: float = REACH_M,
) -> tuple[float, float] | None:
    """The strongest peak within reach of a place, in the radar's coordinates.

    A peak is a cell that is not weaker than its eight neighbours. Parabolas through its level in dB and that of its
    neighbours in range and in azimuth put it between the cells' centres.

    Args:
        power: Linear power seen from above by range and azimuth, such as the largest over elevation; cells outside
            the field of view are negative.
        at_xy: Where the pointer is, x and y, metres.
        axes: The map's axes.
        reach_m: How far the peak may be from there.

    Returns:
        x and y of the peak, or None where there is none within reach.
    """
    ranges, angles = np.meshgrid(axes.range_m, np.deg2rad(axes.azimuth_deg), indexing="ij")
    apart = np.hypot(ranges * np.cos(angles) - float(at_xy[0]), ranges * np.sin(angles) - float(at_xy[1]))
    padded = np.pad(power, 1, constant_values=-1.0)
    rows, columns = power.shape
    around = [padded[1 + i : 1 + i + rows, 1 + j : 1 + j + columns] for i in (-1, 0, 1) for j in (-1, 0, 1)]
    peaks = (power > 0) & (power >= np.max(around, axis=0)) & (apart <= reach_m)
    if not peaks.any():
        return None
    row, column = np.unravel_index(int(np.argmax(np.where(peaks, power, -1.0))), power.shape)
    level = np.log(np.maximum(power, _FLOOR * power[row, column]))
    range_m = axes.range_m[row] + axes.range_step_m * _vertex(level[:, column], int(row))
    step_rad = np.deg2rad(axes.azimuth_deg[1] - axes.azimuth_deg[0])
    angle = np.deg2rad(axes.azimuth_deg[column]) + step_rad * _vertex(level[row], int(column))
    return float(range_m * np.cos(angle)), float(range_m * np.sin(angle))


def _vertex(level: Float[np.ndarray, " n"], place: int) -> float:
    """Where the parabola through a maximum and its neighbours is highest, in cells from it; 0 at the map's edge."""
    if not 0 < place < len(level) - 1:
        return 0.0
    before, here, after = level[place - 1 : place + 2].tolist()
    curve = before - 2 * here + after
    return 0.0 if curve >= 0 else float(np.clip((before - after) / (2 * curve), -0.5, 0.5))
