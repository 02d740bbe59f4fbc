"""A box for an object that the radar alone sees: the peak that a person meant, and the usual size behind it."""

import time
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from farfield.annotation.fitting.boxes import choose_heading
from farfield.annotation.fitting.ground import ground_ahead
from farfield.annotation.fitting.prior import BoxFit, Prior, boxes_of
from farfield.geometry.boxes import count_points_in_boxes, wrap_angle_rad
from farfield.radar.axes import KRADAR_AXES, RadarAxes


def fit_radar_peak(
    points_m: Float[np.ndarray, "n 3"],
    peak_xy: Sequence[float] | Float[np.ndarray, " 2"],
    prior: Prior,
    *,
    ground_z_m: float | None = None,
) -> BoxFit:
    """A box of the type's size with its near face at a peak of the radar's map.

    The peak is where the line from the sensor to the box's middle enters the box. The yaw is the track's or the lane's,
    and the line of sight where neither is known. The bottom is the ground of the LiDAR's points before it, see
    :func:`~farfield.annotation.fitting.ground.ground_ahead`.

    Args:
        points_m: All points of the LiDAR, shape (n, 3), metres; may be none.
        peak_xy: The peak in the points' coordinates, x and y, metres.
        prior: What is known of the object; ``ego_m`` is the radar's place.
        ground_z_m: Height of the ground where there are no points to tell it.

    Raises:
        ValueError: If the peak lies at the radar's own place.
    """
    start_s = time.perf_counter()
    peak, ego = np.array([float(peak_xy[0]), float(peak_xy[1])]), np.array(prior.ego_m)
    range_m = float(np.hypot(*(peak - ego)))
    if range_m < 1e-6:
        raise ValueError(f"fit_radar_peak: expected a peak away from the radar, got {peak.tolist()}")
    sight = (peak - ego) / range_m
    known_yaw = next((yaw for yaw in (prior.yaw_rad, prior.lane_rad) if yaw is not None), None)
    yaw, heading = choose_heading(float(np.arctan2(sight[1], sight[0])) if known_yaw is None else known_yaw, prior)
    x, y = peak + sight * _depth_m(sight, yaw, prior)
    ground = ground_ahead(points_m, (float(x), float(y)), prior.ego_m)
    note = ""
    if ground.cells:
        bottom = ground.z_m(float(x), float(y))
    else:
        bottom = 0.0 if ground_z_m is None else ground_z_m
        note = "" if ground_z_m is not None else "no points tell where the ground is: the bottom is at z = 0"
    length, width, height = prior.size_m
    box = (float(x), float(y), bottom + height / 2, length, width, height, float(wrap_angle_rad(np.array(yaw))))
    count = int(count_points_in_boxes(points_m, boxes_of(box))[0]) if len(points_m) else 0
    criterion = "track" if prior.yaw_rad is not None else "lane" if prior.lane_rad is not None else "drawn"
    ms = 1000 * (time.perf_counter() - start_s)
    return BoxFit(box=box, points=count, criterion=criterion, heading=heading, ms=ms, note=note)


def _depth_m(sight: Float[np.ndarray, " 2"], yaw_rad: float, prior: Prior) -> float:
    """From where the line of sight enters a box to its middle."""
    along = abs(float(sight @ [np.cos(yaw_rad), np.sin(yaw_rad)]))
    across = abs(float(sight @ [-np.sin(yaw_rad), np.cos(yaw_rad)]))
    distances = [size / 2 / part for size, part in zip(prior.size_m, (along, across), strict=False) if part > 1e-9]
    return min(distances)


REACH_M = 1.5
"""So far from the pointer a peak may be."""
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


def _vertex(level: Float[np.ndarray, " n"], cell: int) -> float:
    """Where the parabola through a maximum and its neighbours is highest, in cells from it; 0 at the map's edge."""
    if not 0 < cell < len(level) - 1:
        return 0.0
    before, here, after = level[cell - 1 : cell + 2].tolist()
    curve = before - 2 * here + after
    return 0.0 if curve >= 0 else float(np.clip((before - after) / (2 * curve), -0.5, 0.5))
