"""The soft echo of fog: tabulated once for an extinction, looked up for each shot.

    S_soft(R) = (pi / rho_ref) R_ref^2 int beta xi(r) exp(-2 alpha r) / r^2 h(R - r) dr

is on the scale of a solid target's signal (a target of reflectance rho has S = rho / rho_ref (R_ref / R)^2 ...). h is a
sin^2 pulse of height 1, xi the overlap of beam and receiver, beta = alpha / 18.8 sr (Rasshofer et al., 2011).
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from farfield.simulation.weather.beam import Beam
from farfield.simulation.weather.optics import FOG_BACKSCATTER_PER_EXTINCTION

FOG_MOR_M = 2000.0  # below this visibility (mist, fog) the soft echo is considered
_STEP_M, _REACH_M = 0.02, 60.0
_REFERENCE_REFLECTANCE = 0.1


@dataclass(frozen=True, eq=False)
class SoftEcho:
    """The echo of fog alone, for a receiver that ignores what comes from nearer than a blanking distance.

    Args:
        range_m: Distances, rising, shape (k,).
        strength: Signal over the threshold from each of them.
        peak_strength: Strongest signal from there or beyond.
        peak_range_m: Where that one lies.
    """

    range_m: Float[np.ndarray, " k"]
    strength: Float[np.ndarray, " k"]
    peak_strength: Float[np.ndarray, " k"]
    peak_range_m: Float[np.ndarray, " k"]

    def beyond(self, blank_m: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Distance and strength of the strongest echo from beyond each blanking distance."""
        place = np.clip(np.ceil(blank_m / _STEP_M).astype(np.int64), 0, len(self.range_m) - 1)
        return self.peak_range_m[place], self.peak_strength[place]


@lru_cache(maxsize=16)
def soft_echo(beam: Beam, extinction_per_m: float) -> SoftEcho:
    """Tabulate the echo of fog.

    Args:
        beam: The sensor's beam.
        extinction_per_m: Extinction of the fog at its wavelength.
    """
    range_m = np.arange(0.0, _REACH_M, _STEP_M)
    r = np.maximum(range_m, _STEP_M)
    source = beam.overlap(r) * np.exp(-2 * extinction_per_m * r) / r**2
    source *= extinction_per_m * FOG_BACKSCATTER_PER_EXTINCTION
    pulse = np.sin(np.pi * np.arange(0.0, 2 * beam.pulse_m, _STEP_M) / (2 * beam.pulse_m)) ** 2
    heard = np.convolve(source, pulse)[len(pulse) // 2 :][: len(range_m)] * _STEP_M
    strength = np.pi / _REFERENCE_REFLECTANCE * beam.reference_range_m**2 * heard
    last = len(strength) - 1
    backwards = np.maximum.accumulate(strength[::-1])[::-1]
    new_peak = np.where(strength >= backwards, np.arange(last + 1), last)
    place = np.minimum.accumulate(new_peak[::-1])[::-1]
    return SoftEcho(range_m, strength, backwards, range_m[place])
