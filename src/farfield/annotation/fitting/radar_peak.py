"""A box for an object that the radar alone sees: the usual size of its type behind the peak."""

import time
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from farfield.annotation.fitting.contract import BoxFit, Prior, boxes_of
from farfield.annotation.fitting.finishing import headed
from farfield.annotation.fitting.ground import fit_ground
from farfield.geometry.boxes import count_points_in_boxes, wrap_angle_rad


def fit_radar_peak(
    points_m: Float[np.ndarray, "n 3"],
    peak_xy: Sequence[float] | Float[np.ndarray, " 2"],
    prior: Prior,
    *,
    ground_z_m: float | None = None,
) -> BoxFit:
    """A box of the type's size with its near face at a peak of the radar's map.

    The peak is where the line from the sensor to the box's middle enters the box. The yaw is the track's or the lane's,
    and the line of sight where neither is known. The bottom is the ground of the LiDAR's points about it.

    Args:
        points_m: All points of the LiDAR, shape (n, 3), metres; may be none.
        peak_xy: The peak in the points' coordinates, x and y, metres.
        prior: What is known of the object; ``ego_m`` is the radar's place.
        ground_z_m: Height of the ground where there are no points to tell it.

    Raises:
        ValueError: If the peak lies at the radar's own place.
    """
    begun = time.perf_counter()
    peak, ego = np.array([float(peak_xy[0]), float(peak_xy[1])]), np.array(prior.ego_m)
    range_m = float(np.hypot(*(peak - ego)))
    if range_m < 1e-6:
        raise ValueError(f"fit_radar_peak: expected a peak away from the radar, got {peak.tolist()}")
    sight = (peak - ego) / range_m
    known = next((yaw for yaw in (prior.yaw_rad, prior.lane_rad) if yaw is not None), None)
    yaw, heading = headed(float(np.arctan2(sight[1], sight[0])) if known is None else known, prior)
    x, y = peak + sight * _depth_m(sight, yaw, prior)
    ground = fit_ground(points_m, (float(x), float(y)))
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
    ms = 1000 * (time.perf_counter() - begun)
    return BoxFit(box=box, points=count, criterion=criterion, heading=heading, ms=ms, note=note)


def _depth_m(sight: Float[np.ndarray, " 2"], yaw_rad: float, prior: Prior) -> float:
    """From where the line of sight enters a box to its middle."""
    along = abs(float(sight @ [np.cos(yaw_rad), np.sin(yaw_rad)]))
    across = abs(float(sight @ [-np.sin(yaw_rad), np.cos(yaw_rad)]))
    reach = [size / 2 / part for size, part in zip(prior.size_m, (along, across), strict=False) if part > 1e-9]
    return min(reach)
