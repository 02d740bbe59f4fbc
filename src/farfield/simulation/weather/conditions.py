"""The weather of one sequence: what it is, how hard it rains or snows, what covers the road and the sensors."""

from dataclasses import dataclass, replace

import numpy as np

from farfield.errors import ConfigError
from farfield.vocabulary.conditions import TIMES, WEATHERS


@dataclass(frozen=True)
class Weather:
    """Everything about the weather that a sensor can notice. All are inputs, written beside the data.

    Args:
        condition: One of ``WEATHERS``, K-Radar's seven.
        time: "day" or "night".
        mor_m: Meteorological optical range: where contrast falls to 5 % by haze or fog alone.
        rain_mm_h: Rain rate.
        snow_mm_h: Snowfall as liquid water.
        wet_snow: Whether the flakes are wet (sleet).
        temperature_c: Air temperature.
        wind_m_s: Horizontal wind.
        water_mm: Depth of water on the road.
        snow_cover: Share of the ground that snow covers, 0 to 1; tracks stay darker.
        icing: Share of the forward-facing part of a sensor's window that ice or snow blocks in the end, 0 to 1.
        icing_tau_s: Time constant with which it gets there.
        icing_age_s: For how long it had been growing when the sequence began.
        film_mm: Water film on a radar's radome.
        sun_elevation_deg: Height of the sun; below 0 at night.
        sun_azimuth_deg: Its direction, counter-clockwise from the world's x axis.
        cloud_cover: 0 clear sky to 1 overcast.
    """

    condition: str = "normal"
    time: str = "day"
    mor_m: float = 20_000.0
    rain_mm_h: float = 0.0
    snow_mm_h: float = 0.0
    wet_snow: bool = False
    temperature_c: float = 15.0
    wind_m_s: float = 2.0
    water_mm: float = 0.0
    snow_cover: float = 0.0
    icing: float = 0.0
    icing_tau_s: float = 120.0
    icing_age_s: float = 0.0
    film_mm: float = 0.0
    sun_elevation_deg: float = 40.0
    sun_azimuth_deg: float = 120.0
    cloud_cover: float = 0.2

    def __post_init__(self) -> None:
        if self.condition not in WEATHERS:
            raise ConfigError(f"weather: expected one of {', '.join(WEATHERS)}; got {self.condition!r}")
        if self.time not in TIMES:
            raise ConfigError(f"time of day: expected one of {', '.join(TIMES)}; got {self.time!r}")

    def icing_at(self, time_s: float) -> float:
        """Blocked share of the window after ``time_s`` seconds of the sequence (reference: c (1 - exp(-t / tau)))."""
        return self.icing * (1.0 - float(np.exp(-(self.icing_age_s + time_s) / self.icing_tau_s)))

    def describe(self) -> str:
        """One line with every figure that matters, for logs and data sets."""
        parts = [f"{self.condition}, {self.time}", f"visibility {self.mor_m:.0f} m"]
        parts += [f"rain {self.rain_mm_h:.1f} mm/h"] * (self.rain_mm_h > 0)
        parts += [f"{'wet ' * self.wet_snow}snow {self.snow_mm_h:.1f} mm/h"] * (self.snow_mm_h > 0)
        parts += [f"water {self.water_mm:.2f} mm"] * (self.water_mm > 0)
        parts += [f"snow covers {self.snow_cover:.0%}"] * (self.snow_cover > 0)
        parts += [f"windows covered to {self.icing:.0%} within {self.icing_tau_s:.0f} s"] * (self.icing > 0)
        parts += [f"radome film {self.film_mm:.2f} mm"] * (self.film_mm > 0)
        return "; ".join([*parts, f"{self.temperature_c:.0f} degrees C"])


def draw_weather(condition: str, time: str, rng: np.random.Generator) -> Weather:
    """Draw one sequence's weather within the bounds of a condition.

    Rates and visibilities follow K-Radar's descriptions: fog thins LiDAR only lightly (MOR 400 to 1000 m), sleet
    freezes to a layer on the sensors' windows, heavy snow (over 1 cm/h) piles up on their front within minutes, rain
    runs off.

    Args:
        condition: One of ``WEATHERS``.
        time: "day" or "night".
        rng: Source of randomness.

    Raises:
        ConfigError: If condition or time is unknown.
    """
    sun = float(rng.uniform(12, 60)) if time == "day" else float(rng.uniform(-40, -12))
    base = Weather(
        condition,
        time,
        mor_m=float(rng.uniform(15_000, 25_000)),
        temperature_c=float(rng.uniform(5, 25)),
        wind_m_s=float(rng.uniform(0, 5)),
        sun_elevation_deg=sun,
        sun_azimuth_deg=float(rng.uniform(-180, 180)),
        cloud_cover=float(rng.uniform(0, 0.4)),
    )
    low, mid, wide = (float(value) for value in rng.random(3))
    if condition == "normal":
        return base
    base = replace(base, cloud_cover=1.0)
    if condition == "overcast":
        return base
    if condition == "fog":
        return replace(base, mor_m=400 + 600 * low, water_mm=0.1, film_mm=0.02 * mid, icing=0.02)
    if condition == "rain":
        rate = float(np.exp(np.log(2) + low * np.log(5)))
        return replace(
            base, rain_mm_h=rate, mor_m=8000.0, water_mm=0.5 + 0.7 * mid, film_mm=0.02 + 0.02 * wide, icing=0.03
        )
    cold = replace(base, temperature_c=-5.0 + 4.0 * wide, mor_m=6000.0)
    if condition == "sleet":
        return replace(
            cold,
            rain_mm_h=0.5 + low,
            snow_mm_h=1.5 + 2.0 * low,
            wet_snow=True,
            water_mm=0.5 + 0.5 * mid,
            snow_cover=0.25 * mid,
            icing=0.75,
            icing_tau_s=120.0,
            icing_age_s=120.0 + 480.0 * mid,
            film_mm=0.03,
        )
    if condition == "light_snow":
        return replace(cold, snow_mm_h=0.3 + 0.6 * low, snow_cover=0.2 + 0.4 * mid, icing=0.05, film_mm=0.0)
    return replace(
        cold,
        snow_mm_h=1.0 + 2.0 * low,
        snow_cover=0.7 + 0.3 * mid,
        icing=0.60,
        icing_tau_s=300.0,
        icing_age_s=300.0 + 600.0 * mid,
        film_mm=0.01,
    )
