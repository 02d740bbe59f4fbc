"""A weather that is laid over what a sensor measured in another, and which of its figures the presets use themselves.

Augmentation by simulated fog, rain and snow follows Hahner et al. (fog, ICCV 2021; snow, CVPR 2022) and LISA (Kilic et
al., 2021); the physics is the simulator's own.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from farfield.simulation.weather.conditions import Weather, draw_weather
from farfield.vocabulary.conditions import WEATHERS

CLEAR = Weather()
"""The air in which a sweep counts as measured: a visibility of 20 km."""

_DRAWS = 200  # of each condition: its bounds are known to a hundredth of their width


@dataclass(frozen=True, eq=False)
class OverlaidWeather:
    """What is laid over one frame.

    Args:
        weather: What is in the air and covers the window; its icing is the covered share of the window's front.
        seed: Draws which parts of the window are covered.
        kind: "ice" (wide patches) or "drop" (small spots).
        patches_deg: Widths of the patches in azimuth and elevation: deviations of the smoothing.
        transmission: One-way transmission of a covered part.
        floor_rise_db: By how much a radar's noise rises.
    """

    weather: Weather
    seed: np.random.SeedSequence
    kind: str = "ice"
    patches_deg: tuple[float, float] = (8.0, 4.0)
    transmission: float = 0.05
    floor_rise_db: float = 0.0


@cache
def preset_bounds() -> dict[str, dict[str, tuple[float, float]]]:
    """Lowest and highest value of what draws of each condition hold: rates, visibility, film, covered shares.

    Returns:
        By figure and condition; a figure that a condition lacks (no rain, no fog, a clean window) is left out. Covered
        shares reach from what covers a window when a sequence begins to what covers it in the end.
    """
    found: dict[str, dict[str, tuple[float, float]]] = {}
    for condition in WEATHERS:
        drawn = [draw_weather(condition, "day", np.random.default_rng(seed)) for seed in range(_DRAWS)]
        values = {
            "rain_mm_h": [each.rain_mm_h for each in drawn],
            "snow_mm_h": [each.snow_mm_h for each in drawn],
            "fog_m": [each.mor_m for each in drawn if condition == "fog"],
            "film_mm": [each.film_mm for each in drawn],
            "coverage": [share for each in drawn for share in (each.icing_at(0.0), each.icing) if share > 0],
        }
        for name, seen in values.items():
            if seen and max(seen) > 0:
                found.setdefault(name, {})[condition] = (min(seen), max(seen))
    return found
