"""Extinction and backscatter of air, fog, rain and snow at the wavelengths of the sensors.

Haze and fog follow Koschmieder (contrast 5 % at the meteorological optical range) and Kim's exponent for the wavelength
(I. I. Kim et al., 2001); rain is a fit to Mie sums over the drops of Marshall and Palmer; snow is ITU-R P.1817.
"""

import numpy as np

from farfield.simulation.weather.conditions import Weather

FOG_BACKSCATTER_PER_EXTINCTION = 1 / 18.8  # per sr; lidar ratio of liquid clouds, O'Connor et al. (2004)
_PER_M_OF_DB_PER_KM = np.log(10) / 10 / 1000
_CONTRAST_AT_MOR, _CONTRAST_AT_VISIBILITY = 0.05, 0.02


def is_short_wave(wavelength_nm: float | int) -> bool:
    """Whether a sensor works below 1000 nm, where water and ice hardly absorb (865, 905 nm), unlike at 1550 nm."""
    return bool(wavelength_nm < 1200)


def kim_exponent(visibility_m: float | int) -> float:
    """Exponent q of the wavelength in Kim's law, for a visibility by 2 % contrast."""
    v_km = visibility_m / 1000
    if v_km < 0.5:
        return 0.0
    if v_km < 1:
        return v_km - 0.5
    if v_km < 6:
        return 0.16 * v_km + 0.34
    return 1.3 if v_km < 50 else 1.6


def haze_extinction_per_m(mor_m: float | int, wavelength_nm: float | int) -> float:
    """Extinction of haze or fog.

    Args:
        mor_m: Meteorological optical range (5 % contrast at 550 nm).
        wavelength_nm: Wavelength.
    """
    at_550 = -np.log(_CONTRAST_AT_MOR) / mor_m
    visibility_m = mor_m * np.log(_CONTRAST_AT_VISIBILITY) / np.log(_CONTRAST_AT_MOR)
    return float(at_550 * (wavelength_nm / 550) ** -kim_exponent(visibility_m))


def rain_extinction_per_m(rain_mm_h: float | int) -> float:
    """Extinction of rain, 3.64e-4 R^0.63, the same at all near-infrared wavelengths."""
    return float(3.64e-4 * rain_mm_h**0.63)


def rain_backscatter_per_extinction(wavelength_nm: float | int) -> float:
    """Ratio beta / alpha of rain per sr: drops absorb at 1550 nm what they send back at 905 nm.

    Spheres would give 0.19 at 905 nm by their glory, which falling drops lack: 0.05.
    """
    return 0.05 if is_short_wave(wavelength_nm) else 0.003


def snow_extinction_per_m(snow_mm_h: float | int, wavelength_nm: float | int, *, wet: bool) -> float:
    """Extinction of falling snow after ITU-R P.1817, a S^b dB/km with S as liquid water.

    Args:
        snow_mm_h: Snowfall as liquid water.
        wavelength_nm: Wavelength.
        wet: Whether the flakes are wet.
    """
    if wet:
        db_per_km = (1.023e-4 * wavelength_nm + 3.7855466) * snow_mm_h**0.72
    else:
        db_per_km = (5.42e-5 * wavelength_nm + 5.4958776) * snow_mm_h**1.38
    return float(db_per_km * _PER_M_OF_DB_PER_KM)


def extinction_per_m(weather: Weather, wavelength_nm: float | int) -> float:
    """Extinction of all that is in the air."""
    return (
        haze_extinction_per_m(weather.mor_m, wavelength_nm)
        + rain_extinction_per_m(weather.rain_mm_h)
        + snow_extinction_per_m(weather.snow_mm_h, wavelength_nm, wet=weather.wet_snow)
    )


def film_transmission(film_mm: float | int, wavelength_nm: float | int) -> float:
    """One-way transmission of a water film: absorption of 800 per m at 1550 nm, 8 per m below 1000 nm."""
    return float(np.exp(-(8.0 if is_short_wave(wavelength_nm) else 800.0) * film_mm / 1000))
