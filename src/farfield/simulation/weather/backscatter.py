"""Echoes of what hangs and falls in the air, in a LiDAR's beam: rain drops and snow flakes, and the soft echo of fog.

Of drops and flakes only the strongest of each shot counts; it is drawn from its exact law. A particle of diameter D at
range r fills the share f = min((D / beam width)^2, 1) of the beam and returns

    S = (rho_p / rho_ref) f (R_ref / r)^2 xi(r) exp(-2 alpha r).

Particles are a Poisson process in volume and diameter (Marshall and Palmer, 1948: rain; Marshall and Gunn, 1952: snow,
as spheres of the melted flake, whose cross-section gives the extinction of falling snow). The count of particles
stronger than s is Poisson with mean L(s); hence the strongest is L^-1(-ln u) with u uniform, and its range follows the
share that each range has in dL(s). Both are tabulated once for a rate: a frame costs two look-ups a shot. A particle's
reflectance is rho_p = 2 pi beta / alpha, by which a volume of them has the backscatter beta and the extinction alpha.

The soft echo of fog is tabulated once for an extinction and looked up for each shot:

    S_soft(R) = (pi / rho_ref) R_ref^2 int beta xi(r) exp(-2 alpha r) / r^2 h(R - r) dr

is on the scale of a solid target's signal (a target of reflectance rho has S = rho / rho_ref (R_ref / R)^2 ...). h is a
sin^2 pulse of height 1, xi the overlap of beam and receiver, beta = alpha / 18.8 sr (Rasshofer et al., 2011).
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from farfield.simulation.weather.conditions import Weather
from farfield.simulation.weather.optics import (
    FOG_BACKSCATTER_PER_EXTINCTION,
    is_short_wave,
    rain_backscatter_per_extinction,
)


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


# Drops and flakes

_REFERENCE_REFLECTANCE = 0.1
_SMALLEST_M, _LARGEST_M = 0.05e-3, 6e-3
_FLAKE_LIDAR_RATIO_SR = 20.0  # alpha / beta of falling ice crystals; 15 to 25 are reported
_ICE_AT_1550 = 0.15 / 0.9  # how much less of what enters a flake comes back at 1550 nm than below 1000 nm
_LEVELS = np.geomspace(1e-2, 1e5, 141)
_LOG_LEVELS = np.log(_LEVELS)
_ROUNDING = 1 - 1e-6  # what is left out is surely weaker
_RANGES_M = np.geomspace(0.5, 120.0, 240)


@dataclass(frozen=True)
class Particles:
    """An exponential distribution of diameters, N(D) = n0 exp(-slope D).

    Args:
        n0_per_m4: Intercept, per m^3 of air and m of diameter.
        slope_per_m: Slope.
        reflectance: Diffuse reflectance that stands for a particle's backscatter.
    """

    n0_per_m4: float
    slope_per_m: float
    reflectance: float

    def above(self, diameter_m: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """Particles per m^3 larger than a diameter."""
        low = np.exp(-self.slope_per_m * np.clip(diameter_m, _SMALLEST_M, _LARGEST_M))
        return self.n0_per_m4 / self.slope_per_m * (low - np.exp(-self.slope_per_m * _LARGEST_M))

    @property
    def extinction_per_m(self) -> float:
        """Twice the cross-section per volume (diameters are large against the wavelength)."""
        return float(np.pi * self.n0_per_m4 / self.slope_per_m**3)


def rain_drops(rain_mm_h: float, wavelength_nm: float) -> Particles:
    """Drops after Marshall and Palmer."""
    reflectance = 2 * np.pi * rain_backscatter_per_extinction(wavelength_nm)
    return Particles(8000e3, 4.1e3 * rain_mm_h**-0.21, reflectance)


def snow_flakes(snow_mm_h: float, wavelength_nm: float) -> Particles:
    """Flakes after Marshall and Gunn, by the diameter of the melted flake."""
    reflectance = 2 * np.pi / _FLAKE_LIDAR_RATIO_SR * (1.0 if is_short_wave(wavelength_nm) else _ICE_AT_1550)
    return Particles(7600e3 * snow_mm_h**-0.87, 2.55e3 * snow_mm_h**-0.48, float(reflectance))


@dataclass(frozen=True, eq=False)
class Strongest:
    """The law of the strongest particle of a shot.

    Args:
        mean_count: Mean count of particles stronger than each of ``_LEVELS``, falling.
        range_cdf: For each level, the cumulative share of each of ``_RANGES_M``.
        fill: For each level and range, the share of the beam that such a particle fills.
    """

    mean_count: Float[np.ndarray, " levels"]
    range_cdf: Float[np.ndarray, "levels ranges"]
    fill: Float[np.ndarray, "levels ranges"]

    def strength(self, uniform: Float[np.ndarray, " n"], *, least: float = 0.0) -> Float[np.ndarray, " n"]:
        """Signal of each shot's strongest particle; 0 where none is worth a thought.

        Args:
            uniform: Uniform in [0, 1), one a shot.
            least: Weaker signals may come out as 0, which saves time.
        """
        power = np.zeros(len(uniform))
        most = self.mean_count[0] if least <= _LEVELS[0] else self.count_above(_ROUNDING * least)
        likely = np.maximum(uniform, 1e-12)
        shots = np.flatnonzero(likely > np.exp(-most) * _ROUNDING)
        count = -np.log(likely[shots])
        level = np.interp(count, self.mean_count[::-1], _LOG_LEVELS[::-1])
        power[shots] = np.where(count < self.mean_count[0], np.exp(level), 0.0)
        return power

    def count_above(self, strength: float) -> float:
        """Mean count of particles in a shot that are stronger than a signal."""
        return float(np.interp(np.log(strength), _LOG_LEVELS, self.mean_count))

    def locate(
        self, strength: Float[np.ndarray, " n"], uniform: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Range of particles of given strengths, and the share of the beam that each fills.

        Args:
            strength: Their signals, greater than 0.
            uniform: Uniform in [0, 1), one a particle.
        """
        step = _LOG_LEVELS[1] - _LOG_LEVELS[0]
        row = np.clip(np.round((np.log(strength) - _LOG_LEVELS[0]) / step), 0, len(_LEVELS) - 1).astype(np.int64)
        shares = len(_RANGES_M)
        rising = (self.range_cdf + np.arange(len(_LEVELS))[:, None]).reshape(-1)
        column = np.clip(np.searchsorted(rising, row + uniform) - row * shares, 0, shares - 1)
        return _RANGES_M[column], self.fill[row, column]


@lru_cache(maxsize=16)
def strongest_particle(particles: Particles, beam: Beam, extinction_per_m: float) -> Strongest:
    """Tabulate the law of the strongest particle.

    Args:
        particles: What falls.
        beam: The sensor's beam.
        extinction_per_m: Extinction of all that is in the air.
    """
    r = _RANGES_M
    full = particles.reflectance / _REFERENCE_REFLECTANCE * (beam.reference_range_m / r) ** 2
    full *= beam.overlap(r) * np.exp(-2 * extinction_per_m * r)
    fill = _LEVELS[:, None] / np.maximum(full, 1e-12)
    count = particles.above(np.sqrt(np.minimum(fill, 1.0)) * beam.width_m(r)) * (fill <= 1)
    count *= np.pi / 4 * beam.width_m(r) ** 2 * np.gradient(r)
    mean = count.sum(axis=1)
    density = np.maximum(-np.gradient(count, axis=0), 0.0) + 1e-30
    cdf = np.cumsum(density, axis=1)
    return Strongest(mean + 1e-12 * np.arange(len(mean))[::-1], cdf / cdf[:, -1:], np.minimum(fill, 1.0))


def falling(weather: Weather, wavelength_nm: float) -> list[Particles]:
    """What falls in a weather: nothing, drops, flakes, or both."""
    drops = [rain_drops(weather.rain_mm_h, wavelength_nm)] if weather.rain_mm_h > 0 else []
    flakes = [snow_flakes(weather.snow_mm_h, wavelength_nm)] if weather.snow_mm_h > 0 else []
    return drops + flakes


# Fog

FOG_MOR_M = 2000.0  # below this visibility (mist, fog) the soft echo is considered
_STEP_M, _REACH_M = 0.02, 60.0


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
        index = np.clip(np.ceil(blank_m / _STEP_M).astype(np.int64), 0, len(self.range_m) - 1)
        return self.peak_range_m[index], self.peak_strength[index]


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
    echo = np.convolve(source, pulse)[len(pulse) // 2 :][: len(range_m)] * _STEP_M
    strength = np.pi / _REFERENCE_REFLECTANCE * beam.reference_range_m**2 * echo
    last = len(strength) - 1
    backwards = np.maximum.accumulate(strength[::-1])[::-1]
    new_peak = np.where(strength >= backwards, np.arange(last + 1), last)
    peak = np.minimum.accumulate(new_peak[::-1])[::-1]
    return SoftEcho(range_m, strength, backwards, range_m[peak])
