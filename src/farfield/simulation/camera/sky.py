"""The light of a scene: sun, sky, air between, by the height of the sun, the clouds and the visibility."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float32

from farfield.simulation.weather.conditions import Weather

_DB_PER_KM = 10.0 / np.log(10.0) * 1000.0  # dB/km of an extinction of 1 /m
_WAVELENGTH_NM = 550.0
_NIGHT_AMBIENT = 0.02  # of a day's
_SUN_THICKNESS = np.array([0.07, 0.13, 0.26])  # zenith optical depth at red, green, blue


class Sky(NamedTuple):
    """Light and air; radiances in units in which a white surface under a clear noon sky is near 3.

    Args:
        sun: Unit vector towards the sun, shape (3,).
        sun_rgb: What a white surface facing the sun reflects of it; 0 under cloud and at night.
        zenith_rgb: Radiance of the sky overhead.
        horizon_rgb: Radiance of the sky at the horizon: the airlight of Koschmieder's law.
        ambient_rgb: What a white surface facing up reflects of the sky.
        bounce_rgb: What a white surface facing down reflects of the ground.
        extinction_per_m: Extinction at 550 nm.
        layer_m: Height of the layer that extinguishes.
        clouds: Share of the sky with drawn clouds.
        night: 1 at night, when lamps are lit, else 0.
        water: 0 dry road to 1 a film that mirrors.
        snow: Share of upward surfaces under snow.
        winter: 0 green foliage to 1 brown.
    """

    sun: Float32[np.ndarray, " 3"]
    sun_rgb: Float32[np.ndarray, " 3"]
    zenith_rgb: Float32[np.ndarray, " 3"]
    horizon_rgb: Float32[np.ndarray, " 3"]
    ambient_rgb: Float32[np.ndarray, " 3"]
    bounce_rgb: Float32[np.ndarray, " 3"]
    extinction_per_m: float
    layer_m: float
    clouds: float
    night: float
    water: float
    snow: float
    winter: float


def visible_extinction(weather: Weather) -> float:
    """Extinction at 550 nm, 1/m: haze or fog, rain and snow together.

    Haze and fog: ln(20) / MOR (Koschmieder with a contrast of 5 %). Rain: 3.64e-4 R^0.63, the Mie sum over the drops
    of Marshall and Palmer (1948). Snow: ITU-R P.1817, dry (5.42e-5 l + 5.4958776) S^1.38 dB/km, wet
    (1.023e-4 l + 3.7855466) S^0.72 dB/km, l in nm, S in mm/h.
    """
    haze = float(np.log(20.0)) / weather.mor_m
    rain = 3.64e-4 * weather.rain_mm_h**0.63
    rate = weather.snow_mm_h
    if weather.wet_snow:
        snow_db = (1.023e-4 * _WAVELENGTH_NM + 3.7855466) * rate**0.72
    else:
        snow_db = (5.42e-5 * _WAVELENGTH_NM + 5.4958776) * rate**1.38
    return haze + rain + (snow_db / float(_DB_PER_KM) if rate > 0 else 0.0)


def make_sky(weather: Weather) -> Sky:
    """The light of a weather.

    Day: a sun reddened by air (Beer-Lambert along 1 / (sin h + 0.15) air masses), a blue gradient that turns warm at
    the horizon when the sun is low, fading to the grey of a closed cover. Night: no sun and an ambient of 0.02.
    """
    elevation = np.radians(weather.sun_elevation_deg)
    azimuth = np.radians(weather.sun_azimuth_deg)
    up = float(np.sin(elevation))
    level = float(np.cos(elevation))
    sun = np.array([level * float(np.cos(azimuth)), level * float(np.sin(azimuth)), up], dtype=np.float32)
    night = weather.time == "night"
    cover = float(np.clip(weather.cloud_cover, 0.0, 1.0))
    height = float(np.clip(up / 0.7, 0.08, 1.0))
    direct = 0.0 if night else 3.0 * float(np.clip(1.15 - 1.35 * cover, 0.0, 1.0))
    sun_rgb = direct * np.exp(-_SUN_THICKNESS / (max(up, 0.0) + 0.15))
    warm = np.array([1.15, 0.9, 0.62]) * (1 - height) + np.array([0.90, 1.04, 1.22]) * height
    bright = 0.35 + 0.65 * height
    clear_zenith, clear_horizon = bright * np.array([0.10, 0.30, 0.85]), 0.95 * bright * warm
    grey_zenith, grey_horizon = bright * np.array([1.05, 1.10, 1.17]), bright * np.array([0.80, 0.84, 0.89])
    close = float(np.clip((cover - 0.3) / 0.6, 0.0, 1.0))
    zenith = clear_zenith * (1 - close) + grey_zenith * close
    horizon = clear_horizon * (1 - close) + grey_horizon * close
    if night:
        zenith = np.array([0.002, 0.003, 0.006]) + close * np.array([0.005, 0.004, 0.003])
        horizon = np.array([0.011, 0.0095, 0.0105]) + close * np.array([0.004, 0.003, 0.002])
    ambient = 0.6 * zenith + 0.4 * horizon
    if night:
        ambient = _NIGHT_AMBIENT * np.array([0.9, 0.95, 1.1])
    bounce = 0.16 * (ambient + sun_rgb * max(up, 0.0))
    return Sky(
        sun=sun,
        sun_rgb=sun_rgb.astype(np.float32),
        zenith_rgb=zenith.astype(np.float32),
        horizon_rgb=horizon.astype(np.float32),
        ambient_rgb=ambient.astype(np.float32),
        bounce_rgb=bounce.astype(np.float32),
        extinction_per_m=visible_extinction(weather),
        layer_m=250.0 if weather.mor_m < 2000 else 1200.0,
        clouds=cover if cover < 0.9 else 0.0,
        night=float(night),
        water=float(np.clip(weather.water_mm / 0.8, 0.0, 1.0)),
        snow=float(np.clip(weather.snow_cover, 0.0, 1.0)),
        winter=float(np.clip((10.0 - weather.temperature_c) / 10.0, 0.0, 1.0)),
    )
