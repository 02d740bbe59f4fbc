"""Radial velocity as a radar measures it: wrapped, and with the multiple of its span that a known ego-motion suggests.

Velocities are positive when receding. K-Radar's tensors hold them modulo 3.865 m/s (13.9 km/h), so nearly every value
is wrapped at road speeds; names say ``wrapped`` until :func:`unwrap` has chosen a multiple.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Int, Num

from farfield.radar.axes import KRADAR_AXES, RadarAxes
from farfield.radar.products import Moments, check_shape


def wrapped_mean_velocity(moments: Moments) -> Float32[np.ndarray, "r e a"]:
    """Power-weighted mean velocity of every cell over all bins but the first, as K-Radar's v2 loader defines Doppler.

    Where echoes stand on both sides of the fold their mean lies between them, at no echo's velocity.

    Args:
        moments: The tensor's sums over Doppler.

    Returns:
        Wrapped velocity in m/s; 0 where there is no power.
    """
    velocity = np.zeros_like(moments.mean_power_63)
    return np.divide(moments.velocity_moment, moments.mean_power_63, out=velocity, where=moments.mean_power_63 > 0)


def wrapped_peak_velocity(
    tensor: Float[np.ndarray, "d r e a"], axes: RadarAxes = KRADAR_AXES
) -> Float32[np.ndarray, "r e a"]:
    """Velocity of every cell's strongest Doppler bin, as K-Radar's older MATLAB cubes define Doppler.

    Args:
        tensor: Linear power.
        axes: Its axes.

    Returns:
        Wrapped velocity in m/s: a bin's centre, of the lower bin where two are equal.
    """
    check_shape(tensor.shape, axes.shape, "Doppler, range, elevation, azimuth")
    best, peak = tensor[0].copy(), np.zeros(tensor.shape[1:], dtype=np.int16)
    for number in range(1, len(tensor)):
        higher = tensor[number] > best
        best[higher], peak[higher] = tensor[number][higher], number
    return axes.doppler_m_s.astype(np.float32)[peak]


def radar_velocity(
    vehicle_velocity_m_s: Float[np.ndarray, "3"],
    vehicle_turn_rad_s: Float[np.ndarray, "3"],
    vehicle_T_radar: Float[np.ndarray, "4 4"],
) -> Float[np.ndarray, "3"]:
    """How the radar itself moves, in its own frame, when the vehicle drives and turns.

    Args:
        vehicle_velocity_m_s: Velocity of the vehicle frame's origin, in the vehicle's axes.
        vehicle_turn_rad_s: Rate of turn about the vehicle's axes; yaw rate is the third.
        vehicle_T_radar: Where the radar is mounted.

    Returns:
        R^T (v + w x t) in m/s.
    """
    turning = np.cross(vehicle_turn_rad_s, vehicle_T_radar[:3, 3])
    return vehicle_T_radar[:3, :3].T @ (vehicle_velocity_m_s + turning)


class UnwrappedVelocity(NamedTuple):
    """Velocities with a multiple of the span chosen.

    Args:
        velocity_m_s: Radial velocity relative to the radar.
        compensated_m_s: The same less what a standing object would show: 0 for the static world, within half a span.
        folds: How many spans were added.
    """

    velocity_m_s: Float[np.ndarray, " n"]
    compensated_m_s: Float[np.ndarray, " n"]
    folds: Int[np.ndarray, " n"]


def unwrap(
    wrapped_m_s: Num[np.ndarray, " n"],
    points_m: Num[np.ndarray, "n 3"],
    radar_velocity_m_s: Float[np.ndarray, "3"],
    axes: RadarAxes = KRADAR_AXES,
) -> UnwrappedVelocity:
    """Choose for each point the multiple of the velocity span that brings it nearest to standing still.

    A standing point in direction d shows -v d when the radar moves with v. A point that moves radially by more than
    half a span (1.93 m/s) over the ground gets a wrong multiple: one measurement cannot tell.

    Args:
        wrapped_m_s: Measured velocities.
        points_m: The points in the radar's frame; their directions count.
        radar_velocity_m_s: The radar's own velocity in its frame, as :func:`radar_velocity` gives it.
        axes: The tensor's axes.
    """
    distance_m = np.linalg.norm(points_m.astype(np.float64), axis=1)
    direction = np.divide(points_m, distance_m[:, None], out=np.zeros(points_m.shape), where=distance_m[:, None] > 0)
    standing = -(direction @ radar_velocity_m_s)
    span = axes.velocity_span_m_s
    folds = np.rint((standing - wrapped_m_s) / span).astype(np.int64)
    velocity = wrapped_m_s + folds * span
    return UnwrappedVelocity(velocity, velocity - standing, folds)
