"""What air, rain, fog, snow and a wet radome take from a radar at 77 GHz, and what rain sends back."""

from typing import Literal

import numpy as np
from jaxtyping import Float

from farfield.simulation.radar.model import LIGHT_M_S, RadarModel
from farfield.simulation.radar.points import ScattererKind, Scatterers
from farfield.simulation.weather.conditions import Weather

# ITU-R P.838-3, tables 1 to 4: a, b, c of each Gaussian term, then slope and intercept over log10 of the frequency.
_K_H = (
    ((-5.33980, -0.10008, 1.13098), (-0.35351, 1.26970, 0.45400), (-0.23789, 0.86036, 0.15354),
     (-0.94158, 0.64552, 0.16817)), -0.18961, 0.71147,
)  # fmt: skip
_K_V = (
    ((-3.80595, 0.56934, 0.81061), (-3.44965, -0.22911, 0.51059), (-0.39902, 0.73042, 0.11899),
     (0.50167, 1.07319, 0.27195)), -0.16398, 0.63297,
)  # fmt: skip
_ALPHA_H = (
    ((-0.14318, 1.82442, -0.55187), (0.29591, 0.77564, 0.19822), (0.32177, 0.63773, 0.13164),
     (-5.37610, -0.96230, 1.47828), (16.1721, -3.29980, 3.43990)), 0.67849, -1.95537,
)  # fmt: skip
_ALPHA_V = (
    ((-0.07771, 2.33840, -0.76284), (0.56727, 0.95545, 0.54039), (-0.20238, 1.14520, 0.26809),
     (-48.2991, 0.791669, 0.116226), (48.5833, 0.791459, 0.116479)), -0.053739, 0.83433,
)  # fmt: skip

# Volume reflectivity of rain at 77 GHz: Mie sums (miepython 3.3) over drops of Marshall and Palmer's sizes.
_RAIN_MM_H = (1.0, 2.5, 5.0, 10.0, 25.0, 50.0)
_RAIN_M2_M3 = (1.0e-4, 2.3e-4, 3.9e-4, 6.4e-4, 1.1e-3, 1.7e-3)
_INVERSE_GAMMA_SHAPE = 2.5  # heavy-tailed drop clusters; default
LEAF_DB_M = 3.0
_MOST_LEAF_DB = 30.0
_RIME = complex(1.75, -0.003)  # frost of 0.4 g/cm3: Looyenga's mixture of air and ice of 3.17
_RIME_MM = 2.0  # thickness where icing is complete; default


def _fit(terms: tuple[tuple[tuple[float, float, float], ...], float, float], log_ghz: float) -> float:
    gaussians, slope, intercept = terms
    bumps = (a * np.exp(-(((log_ghz - b) / c) ** 2)) for a, b, c in gaussians)
    return float(sum(bumps)) + slope * log_ghz + intercept


def rain_coefficients(frequency_ghz: float, polarisation: Literal["h", "v"] = "h") -> tuple[float, float]:
    """Coefficients k and alpha of gamma = k R^alpha in dB/km, R in mm/h (ITU-R P.838-3, equations 2, 3)."""
    k, alpha = (_K_H, _ALPHA_H) if polarisation == "h" else (_K_V, _ALPHA_V)
    log_ghz = float(np.log10(frequency_ghz))
    return 10 ** _fit(k, log_ghz), _fit(alpha, log_ghz)


def rain_loss_db_km(rate_mm_h: float, frequency_ghz: float) -> float:
    """One-way loss in rain, horizontal polarisation."""
    k, alpha = rain_coefficients(frequency_ghz)
    return k * rate_mm_h**alpha if rate_mm_h > 0 else 0.0


def water_permittivity(frequency_ghz: float, temperature_c: float) -> complex:
    """Permittivity of liquid water, e' - j e'' (double Debye model of ITU-R P.840, equations 6 to 11)."""
    theta = 300.0 / (273.15 + temperature_c)
    static, middle, optical = 77.66 + 103.3 * (theta - 1), 0.0671 * (77.66 + 103.3 * (theta - 1)), 3.52
    first = 20.20 - 146.0 * (theta - 1) + 316.0 * (theta - 1) ** 2
    second = 39.8 * first
    return complex(
        (static - middle) / (1 + 1j * frequency_ghz / first)
        + (middle - optical) / (1 + 1j * frequency_ghz / second)
        + optical
    )


def fog_loss_db_km(mor_m: float, frequency_ghz: float, temperature_c: float) -> float:
    """One-way loss in fog (ITU-R P.840): K_l times liquid water, the latter from the visibility.

    P.840 names 0.05 g/m3 for a visibility of 300 m and 0.5 g/m3 for one of 50 m; a power law joins both. Above 2 km
    there is no fog.
    """
    if mor_m >= 2000.0:
        return 0.0
    water_g_m3 = 0.05 * (300.0 / mor_m) ** (1.0 / np.log10(6.0))
    return fog_coefficient(frequency_ghz, temperature_c) * float(water_g_m3)


def fog_coefficient(frequency_ghz: float, temperature_c: float) -> float:
    """K_l in dB/km per g/m3 of cloud liquid water (ITU-R P.840, equation 2)."""
    permittivity = water_permittivity(frequency_ghz, temperature_c)
    loss = -permittivity.imag
    eta = (2.0 + permittivity.real) / loss
    return 0.819 * frequency_ghz / (loss * (1.0 + eta**2))


def film_amplitude(thickness_mm: float, permittivity: complex, frequency_hz: float) -> complex:
    """Amplitude that passes a film at normal incidence: transfer matrix of one layer in air, exp(+j w t)."""
    index = complex(np.sqrt(permittivity))
    depth = 2 * np.pi * index * thickness_mm * 1e-3 * frequency_hz / LIGHT_M_S
    passed = np.cos(depth) + 0.5j * (index + 1 / index) * np.sin(depth)
    return complex(np.exp(2j * np.pi * thickness_mm * 1e-3 * frequency_hz / LIGHT_M_S) / passed)


def film_loss_db(thickness_mm: float, permittivity: complex, frequency_hz: float) -> float:
    """One-way loss of a film that covers the whole radome."""
    return float(-20 * np.log10(abs(film_amplitude(thickness_mm, permittivity, frequency_hz))))


def radome_loss_db(weather: Weather, model: RadarModel, time_s: float = 0.0) -> float:
    """One-way loss of the radome: a film of water on part of it, and frost that grows like the windows' icing.

    Films pass and dry parts pass in parallel, so their amplitudes add by area.
    """
    water = water_permittivity(model.carrier_hz / 1e9, max(weather.temperature_c, 0.0))
    film = film_amplitude(weather.film_mm, water, model.carrier_hz)
    part = 1.0 + model.radome_wetting * (film - 1.0)
    freezing = weather.icing_at(time_s) if weather.temperature_c < 0.0 else 0.0
    return float(-20 * np.log10(abs(part))) + film_loss_db(_RIME_MM * freezing, _RIME, model.carrier_hz)


def loss_db_km(weather: Weather, model: RadarModel) -> float:
    """One-way loss a kilometre of air, fog, rain and snow; wet snow counts as rain times the melting factor."""
    ghz = model.carrier_hz / 1e9
    total = model.gas_db_km
    if weather.condition == "fog":
        total += fog_loss_db_km(weather.mor_m, ghz, weather.temperature_c)
    if weather.wet_snow:
        return total + model.melting_factor * rain_loss_db_km(weather.rain_mm_h + weather.snow_mm_h, ghz)
    return total + rain_loss_db_km(weather.rain_mm_h, ghz) + model.dry_snow_db_km * weather.snow_mm_h


def two_way_loss_db(
    range_m: Float[np.ndarray, "*n"], weather: Weather, model: RadarModel, time_s: float = 0.0
) -> Float[np.ndarray, "*n"]:
    """Loss to a target and back: 2 gamma R / 1000, and the radome twice.

    Args:
        range_m: Distances, any shape.
        weather: The sequence's weather.
        model: The radar.
        time_s: Seconds since the sequence began, for icing.
    """
    return np.asarray(2.0 * (loss_db_km(weather, model) * range_m / 1000.0 + radome_loss_db(weather, model, time_s)))


def leaf_factor(path_m: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Power that comes back through plants, there and back: 3 dB a metre each way, 30 dB at most.

    Weissberger's law gives 1.5 dB a metre at 76.5 GHz, the early one of ITU-R 5.8 dB for the first metre (both are fits
    to forests at lower frequencies; ITU-R P.833-10 needs tables of species); beyond the cap what was scattered
    arrives. In leaf; a bare tree takes about 1 dB a metre.

    Args:
        path_m: Path within plants, any shape.
    """
    return np.asarray(10 ** (-2 * np.minimum(LEAF_DB_M * path_m, _MOST_LEAF_DB) / 10))


def rain_reflectivity_m2_m3(weather: Weather) -> float:
    """Radar cross section of a cubic metre of rain; melting flakes count as rain, dry ones for nothing."""
    rate = weather.rain_mm_h + (weather.snow_mm_h if weather.wet_snow else 0.0)
    if rate <= 0.0:
        return 0.0
    low_slope = np.log(_RAIN_M2_M3[1] / _RAIN_M2_M3[0]) / np.log(_RAIN_MM_H[1] / _RAIN_MM_H[0])
    if rate < _RAIN_MM_H[0]:
        return float(_RAIN_M2_M3[0] * rate**low_slope)
    return float(np.exp(np.interp(np.log(rate), np.log(_RAIN_MM_H), np.log(_RAIN_M2_M3))))


def rain_clutter(
    weather: Weather, model: RadarModel, velocity_m_s: Float[np.ndarray, " 3"], rng: np.random.Generator
) -> Scatterers:
    """Echoes of rain near the radar: a Poisson number of scatterers, evenly in range and angle.

    Each stands for its share of the volume, sigma = eta R^2 dOmega dR, times an inverse-gamma draw of mean 1.

    Args:
        weather: Sets the reflectivity; none gives no scatterers.
        model: The radar.
        velocity_m_s: The radar's own velocity in its own axes, shape (3,).
        rng: Source of randomness.
    """
    eta = rain_reflectivity_m2_m3(weather)
    count = int(rng.poisson(model.clutter_scatterers)) if eta > 0 else 0
    if count == 0:
        return Scatterers.join([])
    axes = model.axes
    low, high = np.radians([axes.azimuth_deg[0], axes.azimuth_deg[-1]])
    bottom, top = np.radians([axes.elevation_deg[0], axes.elevation_deg[-1]])
    near_m = 2.0 * axes.range_step_m
    range_m = rng.uniform(near_m, model.clutter_reach_m, count)
    azimuth, elevation = rng.uniform(low, high, count), rng.uniform(bottom, top, count)
    towards = np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], 1)
    volume_m3 = range_m**2 * np.cos(elevation) * (high - low) * (top - bottom) * (model.clutter_reach_m - near_m)
    fluctuation = (_INVERSE_GAMMA_SHAPE - 1.0) / rng.gamma(_INVERSE_GAMMA_SHAPE, 1.0, count)
    spread = np.hypot(model.clutter_spread_m_s, 0.3 * weather.wind_m_s)
    speed = -towards @ velocity_m_s + rng.normal(0.0, spread, count)
    return Scatterers.of(
        towards * range_m[:, None], speed, eta * volume_m3 / count * fluctuation, kind=ScattererKind.RAIN
    )
