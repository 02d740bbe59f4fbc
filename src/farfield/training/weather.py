"""Weather laid over training frames, drawn anew for each: fog, rain, snow, ice on the window.

The physics is the simulator's (:mod:`farfield.simulation.overlay`); the
weather of a frame, and how many frames get any, are settings. Their defaults lie outside what the simulator's own
weathers hold, so that a detector that is scored on these has not seen them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from farfield.detectors.inputs import CloudInput
from farfield.errors import ConfigError
from farfield.geometry.boxes import BOX_MARGIN_M, Boxes, count_points_in_boxes
from farfield.simulation.overlay import LIDARS, OverlaidWeather, overlay, overlay_cells, preset_bounds
from farfield.simulation.radar.model import RadarModel
from farfield.simulation.weather.conditions import Weather
from farfield.simulation.weather.icing import BLOCKED_TRANSMISSION, WIDTHS_DEG
from farfield.training.augmentation import Points
from farfield.training.config import WeatherConfig

_CONDITIONS = {"fog": "fog", "rain": "rain", "snow": "heavy_snow", "ice": "overcast"}
_FREEZING_C, _MILD_C = -3.0, 10.0
POWER, INTENSITY = "power", "intensity"
_STEPS = 8  # rates are drawn from so many, so that the tables of drops and flakes are made once
_RATES = ("rain_mm_h", "snow_mm_h", "fog_m", "coverage", "film_mm")


def draw_weather(config: WeatherConfig, rng: np.random.Generator) -> OverlaidWeather | None:
    """Draw what is laid over a frame; None for the frames that stay as they are."""
    if rng.random() >= config.probability:
        return None
    kind = config.kinds[int(rng.integers(len(config.kinds)))]
    fog_m, rain, snow, film_mm = (
        float(np.geomspace(low, high, _STEPS)[rng.integers(_STEPS)])  # evenly in the logarithm
        for low, high in (config.fog_m, config.rain_mm_h, config.snow_mm_h, config.film_mm)
    )
    cover, across, up, through, rise_db = (
        rng.uniform(*span)
        for span in (
            config.drops if kind == "rain" else config.coverage,
            *(config.drops_deg if kind == "rain" else config.patches_deg),
            config.transmission,
            config.floor_rise_db,
        )
    )
    weather = Weather(
        _CONDITIONS[kind],
        mor_m=fog_m if kind == "fog" else Weather.mor_m,
        rain_mm_h=rain if kind == "rain" else 0.0,
        snow_mm_h=snow if kind == "snow" else 0.0,
        temperature_c=_FREEZING_C if kind in ("snow", "ice") else _MILD_C,
        icing=0.0 if kind == "fog" else float(cover),
        icing_age_s=float("inf"),
        film_mm=film_mm if kind == "rain" else 0.0,
    )
    seed = np.random.SeedSequence(int(rng.integers(1 << 62)))
    drops = "drop" if kind == "rain" else "ice"
    return OverlaidWeather(weather, seed, drops, (float(across), float(up)), float(through), float(rise_db))


def inside_presets(config: WeatherConfig) -> list[str]:
    """Settings that lie within what the simulator's own weathers hold, in words; empty where none does.

    The covered share of a window, its patches' widths and their transmission, rates, visibility and film count.
    """
    overlaps = []
    bounds = preset_bounds()
    spans = {name: getattr(config, name) for name in _RATES} | {"drops": config.drops}
    for name, (low, high) in spans.items():
        for condition, (least, most) in bounds.get("coverage" if name == "drops" else name, {}).items():
            if low <= most and high >= least:
                overlaps.append(f"{name} {low:g} to {high:g}: {condition} has {least:.3g} to {most:.3g}")
    low, high = config.transmission
    if low <= BLOCKED_TRANSMISSION <= high:
        overlaps.append(f"transmission {low:g} to {high:g}: the presets' is {BLOCKED_TRANSMISSION:g}")
    for name, kind in (("patches_deg", "ice"), ("drops_deg", "drop")):
        for (low, high), width in zip(getattr(config, name), WIDTHS_DEG[kind], strict=True):
            if low <= width <= high:
                overlaps.append(f"{name} {low:g} to {high:g}: the presets' is {width:g}")
    return overlaps


def check_weather(config: WeatherConfig | None, inputs: Mapping[str, CloudInput]) -> None:
    """See that weather can be laid over what a network reads.

    Raises:
        ConfigError: If an input is a LiDAR's, without power, and the LiDAR is not named.
    """
    if config is None or not config.probability or config.sensor is not None:
        return
    lidars = [name for name, cloud in inputs.items() if POWER not in cloud.columns]
    if lidars:
        raise ConfigError(
            f"weather: expected sensor, the LiDAR of {', '.join(lidars)}, to be one of {', '.join(LIDARS)}; got none."
        )


def read_with(cloud: CloudInput, config: WeatherConfig | None) -> tuple[str, ...]:
    """The columns to read of a cloud: those of the network, and a LiDAR's intensity where weather needs it."""
    if config is None or not config.probability or {POWER, INTENSITY} & set(cloud.columns):
        return cloud.columns
    return (*cloud.columns, INTENSITY)


def lay_over(
    points: Points, columns: Sequence[str], config: WeatherConfig, laid: OverlaidWeather, rng: np.random.Generator
) -> tuple[Points, Bool[np.ndarray, " n"]]:
    """Lay weather over one cloud.

    Args:
        points: Its points, shape (n, k), x, y and z first.
        columns: Names of the columns, k or fewer: with power it is a radar's; a LiDAR's without intensity counts as
            of one reflectance.
        config: The LiDAR, and where it stands.
        laid: What is laid.
        rng: Source of randomness.

    Returns:
        The points that are left and those of drops, flakes and fog, whose further columns are 0, shape (m, k); and
        which of the points are left, shape (n,).
    """
    if POWER in columns:
        power = list(columns).index(POWER)
        weaker = points.copy()
        options = {"floor_rise_db": laid.floor_rise_db}
        weaker[:, power] = overlay_cells(points[:, :3], points[:, power], RadarModel(), laid.weather, rng, **options)
        return weaker, np.ones(len(points), dtype=np.bool_)
    index = list(columns).index(INTENSITY) if INTENSITY in columns else None
    shown = np.full(len(points), config.reflectance, points.dtype) if index is None else points[:, index]
    over = overlay(points[:, :3], shown, LIDARS[config.sensor or ""], laid, rng, origin_m=config.origin_m)
    left = points[over.survives]
    added = np.zeros((len(over.points_m), points.shape[1]), dtype=points.dtype)
    added[:, :3] = over.points_m
    if index is not None:
        left[:, index] *= over.gain[over.survives]
        added[:, index] = over.intensity
    return np.concatenate([left, added]), over.survives


@dataclass(frozen=True, eq=False)
class WeatherOverlay:
    """Lays the weather of one frame over the table of all its clouds.

    Args:
        config: The settings.
        columns: Names of the table's columns; a last one without a name holds the number of a point's cloud.
        inputs: Columns of the network's inputs, in their order; the clouds of several samples stand one after another.
        laid: What is laid.
        rng: Source of randomness.
    """

    config: WeatherConfig
    columns: tuple[str, ...]
    inputs: tuple[tuple[str, ...], ...]
    laid: OverlaidWeather
    rng: np.random.Generator

    def __call__(self, points: Points, boxes: Boxes) -> tuple[Points, Boxes]:
        """The points in the weather, and the boxes but for those that had points and have none any more."""
        changed, left = [], []
        for part in np.unique(points[:, -1]):
            rows = points[points[:, -1] == part]
            read = self.inputs[int(part) % len(self.inputs)]
            named = [column if column in read else "" for column in self.columns]
            table, remaining = lay_over(rows, named, self.config, self.laid, self.rng)
            table[:, -1] = part
            changed.append(table)
            left.append(rows[remaining, :3])
        if not changed:
            return points, boxes
        return np.concatenate(changed), boxes[holding(points[:, :3], np.concatenate(left), boxes)]


def holding(before: Points, after: Points, boxes: Boxes) -> Bool[np.ndarray, " n"]:
    """Which boxes still have points, or had none before.

    Args:
        before: Points, x, y and z, shape (m, 3).
        after: Those of them that are left.
        boxes: The boxes.
    """
    had, have = (count_points_in_boxes(part, boxes, margin_m=BOX_MARGIN_M) for part in (before, after))
    return (have > 0) | (had == 0)
