"""A LiDAR's beam as far as fog and particles in it are concerned."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class Beam:
    """What the echo of a scatterer in the air depends on.

    Args:
        wavelength_nm: Wavelength.
        reference_range_m: Where a target of 10 % is at the threshold; see the LiDAR model.
        divergence_rad: Full width of the beam at half intensity.
        pulse_m: Half of the pulse's length, c tau / 2.
        aperture_m: Width of the beam where it starts.
        overlap_m: Between which distances the receiver's view grows from nothing to all of the beam. Near the sensor it
            sees little: else each foggy frame would be a shell at 2 m. The far end is our choice.
        overlap_power: Power of that growth; 2 because beam and view widen in two directions (our choice).
    """

    wavelength_nm: float
    reference_range_m: float
    divergence_rad: float
    pulse_m: float = 0.75
    aperture_m: float = 0.01
    overlap_m: tuple[float, float] = (1.0, 10.0)
    overlap_power: float = 2.0

    def overlap(self, range_m: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """Share of the beam that the receiver sees, 0 to 1."""
        first, last = self.overlap_m
        return np.clip((range_m - first) / (last - first), 0.0, 1.0) ** self.overlap_power

    def width_m(self, range_m: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """Width of the beam."""
        return self.aperture_m + self.divergence_rad * range_m
