"""Axes of a 4D radar tensor: range, azimuth, elevation and Doppler, and how Doppler folds.

In memory a tensor is float32 (Doppler, range, elevation, azimuth) and holds linear power in the file's units. Azimuth
is positive to the left and elevation positive upwards, both rising, so that with the radar at the origin
x = r cos(el) cos(az), y = r cos(el) sin(az), z = r sin(el).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

POWER_UNIT = 1e13
"""Linear power that K-Radar's own tools take as one: they divide every power by it."""


@dataclass(frozen=True, eq=False)
class RadarAxes:
    """Centres of a tensor's bins, each axis evenly spaced and rising.

    Args:
        range_m: Range, shape (r,).
        azimuth_deg: Azimuth, positive to the left, shape (a,).
        elevation_deg: Elevation, positive upwards, shape (e,).
        doppler_m_s: Radial velocity, positive when receding, shape (d,).
    """

    range_m: Float[np.ndarray, " r"]
    azimuth_deg: Float[np.ndarray, " a"]
    elevation_deg: Float[np.ndarray, " e"]
    doppler_m_s: Float[np.ndarray, " d"]

    def __post_init__(self) -> None:
        for name in ("range_m", "azimuth_deg", "elevation_deg", "doppler_m_s"):
            steps = np.diff(getattr(self, name))
            if not len(steps) or steps[0] <= 0 or not np.allclose(steps, steps[0], rtol=1e-6, atol=0.0):
                raise ValueError(f"RadarAxes: expected {name} to rise in equal steps, at least two bins")

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Shape of a tensor: Doppler, range, elevation, azimuth."""
        return len(self.doppler_m_s), len(self.range_m), len(self.elevation_deg), len(self.azimuth_deg)

    @property
    def range_step_m(self) -> float:
        """Width of a range bin."""
        return _step(self.range_m)

    @property
    def doppler_step_m_s(self) -> float:
        """Width of a Doppler bin."""
        return _step(self.doppler_m_s)

    @property
    def velocity_span_m_s(self) -> float:
        """Unambiguous span: two radial velocities that differ by it fall into the same Doppler bin."""
        return self.doppler_step_m_s * len(self.doppler_m_s)

    def fold(self, velocity_m_s: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """Fold true radial velocities into the unambiguous span that begins at the first Doppler bin."""
        first = self.doppler_m_s[0]
        return first + np.mod(velocity_m_s - first, self.velocity_span_m_s)

    def doppler_bin(self, velocity_m_s: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """Fractional Doppler bin of true radial velocities, 0 <= bin < number of bins."""
        bins = (velocity_m_s - self.doppler_m_s[0]) / self.doppler_step_m_s
        return np.mod(bins, len(self.doppler_m_s))


def _step(axis: Float[np.ndarray, " n"]) -> float:
    return float((axis[-1] - axis[0]) / (len(axis) - 1))


KRADAR_AXES = RadarAxes(
    range_m=np.arange(256) * 0.462890625,
    azimuth_deg=np.arange(-53.0, 54.0),
    elevation_deg=np.arange(-18.0, 19.0),
    doppler_m_s=np.arange(-32, 32) * 0.060393475572047,
)
"""K-Radar's axes (``resources/info_arr.mat``, ``arr_doppler.mat``); its files count both angles the other way round."""

KRADAR_ORIGIN_M = (2.54, -0.3, -0.7)
"""Where K-Radar's radar stands in the frame of its os2-64, without rotation, in all sequences: x and y are in every
``calib_radar_lidar.txt``, z is in the development kit's configuration."""
