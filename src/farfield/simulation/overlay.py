"""Weather laid over what a sensor measured in other weather: what is lost of it, and what the air adds.

Augmentation by simulated fog, rain and snow follows Hahner et al. (fog, ICCV 2021; snow, CVPR 2022) and LISA (Kilic et
al., 2021); the physics is the simulator's own.

LiDAR sweeps: Each point stands for a shot whose signal its intensity and distance tell, S = rho / rho_ref (R_ref /
R)^2. The laid air takes exp(-2 alpha R) of it, the window its transmission twice; drops, flakes and fog compete with
what is left, as in the simulator itself (:func:`farfield.simulation.lidar.air.select_returns`). The sweep was detected
before: a point stays with the probability P(S') / P(S). Shots that brought nothing back meet drops and flakes too:
their directions are those of the sensor's grid that no point has.

Radar cells: A cell's power is the receiver's noise plus echoes. What air and radome take, twice, is taken from the
echoes alone: what lies above the floor shrinks, the floor stays. Rain's own echoes are left out: in a cell they lie 25
dB below the noise even at 20 mm/h. What the floor gains instead, as a wet radome's reflections may add, is a setting.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from farfield.radar.axes import POWER_UNIT
from farfield.simulation.lidar.air import BLANKING_M, SURFACE, beam_of, select_returns
from farfield.simulation.lidar.echoes import LidarEchoes
from farfield.simulation.lidar.model import (
    HDL_64E,
    OS1_128,
    OS2_64,
    REFERENCE_REFLECTANCE,
    LidarModel,
    detection_probability,
    range_spread_m,
)
from farfield.simulation.radar.model import RadarModel
from farfield.simulation.radar.propagation import two_way_loss_db
from farfield.simulation.weather.backscatter import FOG_MOR_M, Strongest, falling, soft_echo, strongest_particle
from farfield.simulation.weather.conditions import Weather, draw_weather
from farfield.simulation.weather.icing import WindowField
from farfield.simulation.weather.optics import extinction_per_m, film_transmission, haze_extinction_per_m
from farfield.vocabulary.conditions import WEATHERS

CLEAR_WEATHER = Weather()
"""The air in which a sweep counts as measured: a visibility of 20 km."""

_DRAWS = 200  # of each condition: its bounds are exact to a hundredth of their width


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
    bounds: dict[str, dict[str, tuple[float, float]]] = {}
    for condition in WEATHERS:
        draws = [draw_weather(condition, "day", np.random.default_rng(seed)) for seed in range(_DRAWS)]
        values = {
            "rain_mm_h": [weather.rain_mm_h for weather in draws],
            "snow_mm_h": [weather.snow_mm_h for weather in draws],
            "fog_m": [weather.mor_m for weather in draws if condition == "fog"],
            "film_mm": [weather.film_mm for weather in draws],
            "coverage": [share for weather in draws for share in (weather.icing_at(0.0), weather.icing) if share > 0],
        }
        for name, samples in values.items():
            if samples and max(samples) > 0:
                bounds.setdefault(name, {})[condition] = (min(samples), max(samples))
    return bounds


# LiDAR sweeps

LIDARS = {model.name: model for model in (LidarModel(), OS2_64, OS1_128, HDL_64E)}
"""The sensors by name."""

_LEAST_SIGNAL = 1.0  # a point that was measured had a signal of about the threshold at least
_FAINT = 0.3  # weaker echoes of the air are detected in one shot of seven hundred, at 0.8 dB
_LEVELS = 255  # intensities are written in so many steps


@dataclass(frozen=True, eq=False)
class WeatheredSweep:
    """What weather makes of a sweep.

    Args:
        survives: Which points are still there, shape (n,).
        gain: What their intensity is to be multiplied with, shape (n,).
        points_m: Returns of drops, flakes and fog, shape (m, 3).
        intensity: Theirs, shape (m,).
    """

    survives: Bool[np.ndarray, " n"]
    gain: Float32[np.ndarray, " n"]
    points_m: Float32[np.ndarray, "m 3"]
    intensity: Float32[np.ndarray, " m"]


@dataclass(frozen=True, eq=False)
class WindowEffect:
    """A window as it is laid over one frame.

    Args:
        field: In which order its parts get covered; None for a clean one.
        share: Covered share of its front.
        clear: One-way transmission where nothing covers it: that of the film of water.
        covered: The same where it is covered.
    """

    field: WindowField | None
    share: float
    clear: float
    covered: float

    @classmethod
    def draw(cls, model: LidarModel, laid: OverlaidWeather) -> "WindowEffect":
        """Draw what covers a sensor's window."""
        clear = film_transmission(laid.weather.film_mm, model.wavelength_nm)
        share = laid.weather.icing_at(0.0)
        if share <= 0:
            return cls(None, 0.0, clear, clear)
        half = 180.0 if model.spinning else model.azimuth_deg
        rows_deg = (-model.elevation_deg, model.elevation_deg) if model.beams is None else model.beams.elevation_deg
        field = WindowField.draw(
            laid.seed,
            laid.kind,
            azimuth_deg=half,
            elevation_deg=(min(rows_deg), max(rows_deg)),
            widths_deg=laid.patches_deg,
        )
        return cls(field, share, clear, clear * laid.transmission)

    def gain(self, direction_rad: Float32[np.ndarray, "n 2"]) -> Float32[np.ndarray, " n"]:
        """Two-way transmission for shots.

        Args:
            direction_rad: Azimuth and elevation of each, shape (n, 2).
        """
        once = np.full(len(direction_rad), self.clear, dtype=np.float32)
        if self.field is not None:
            azimuth, elevation = np.degrees(direction_rad).T
            once[self.field.covered(self.share, azimuth, elevation)] = self.covered
        return once**2


def overlay(
    points_m: Float32[np.ndarray, "n 3"],
    intensity: Float32[np.ndarray, " n"],
    model: LidarModel,
    laid: OverlaidWeather,
    rng: np.random.Generator,
    *,
    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> WeatheredSweep:
    """Lay weather over a sweep.

    Args:
        points_m: The points, with the axes of the sensor: x forward, y left, z up.
        intensity: Their reflectance, 0 to 1, as the sensor shows it in clear air.
        model: The sensor.
        laid: The weather, in addition to that of the sweep.
        rng: Source of randomness.
        origin_m: Where the sensor stands in the points' coordinates.
    """
    offset = points_m - np.array(origin_m, dtype=np.float32)
    level_m = np.hypot(offset[:, 0], offset[:, 1])
    range_m = np.maximum(np.hypot(level_m, offset[:, 2]), np.float32(0.1))
    azimuth, elevation = np.arctan2(offset[:, 1], offset[:, 0]), np.arctan2(offset[:, 2], level_m)
    direction_rad = np.column_stack([azimuth, elevation]).astype(np.float32)
    # what air and window leave of each point's signal
    window = WindowEffect.draw(model, laid)
    through = window.gain(direction_rad)
    before = np.maximum(intensity / REFERENCE_REFLECTANCE * (model.reference_range_m / range_m) ** 2, _LEAST_SIGNAL)
    alpha = extinction_per_m(laid.weather, model.wavelength_nm) - extinction_per_m(CLEAR_WEATHER, model.wavelength_nm)
    attenuated = (before * np.exp(-2 * alpha * range_m) * through).astype(np.float32)
    echoes = LidarEchoes(range_m, attenuated, np.zeros(len(attenuated), dtype=np.int64))
    # points survive by the ratio of the probabilities of detection, or are replaced by echoes of the air
    at_m, strength, kind = select_returns(model, laid.weather, echoes, range_m, through, None, rng)
    uniform, surface = rng.random(len(strength), dtype=np.float32), kind == SURFACE
    survives = surface & (uniform < detection_probability(model, strength) / detection_probability(model, before))
    gain = np.where(surface, np.minimum(strength / before, 1), 1).astype(np.float32)
    detected = np.flatnonzero(~surface & (uniform < detection_probability(model, strength) * (1 - model.dropout)))
    from_points = _returns((offset / range_m[:, None])[detected], at_m[detected], strength[detected], model, rng)
    # shots that hit nothing hear the air alone
    from_sky = _open_sky(direction_rad, model, laid.weather, window, rng)
    points_m, air_intensity = (np.concatenate(pair) for pair in zip(from_points, from_sky, strict=True))
    return WeatheredSweep(survives, gain, points_m + np.array(origin_m, dtype=np.float32), air_intensity)


def _open_sky(
    direction_rad: Float32[np.ndarray, "n 2"],
    model: LidarModel,
    weather: Weather,
    window: "WindowEffect",
    rng: np.random.Generator,
) -> tuple[Float32[np.ndarray, "m 3"], Float32[np.ndarray, " m"]]:
    """What the shots that met no surface bring back, of the sensor: points and intensities."""
    if not falling(weather, model.wavelength_nm) and weather.mor_m >= FOG_MOR_M:
        return np.zeros((0, 3), dtype=np.float32), np.zeros(0, dtype=np.float32)
    empty = empty_shots(direction_rad, model, rng)
    laws, source, power, at_m = _loudest(len(empty), model, weather, rng)
    met = np.flatnonzero(power > _FAINT)
    chance = detection_probability(model, power[met] * window.gain(empty[met])) * (1 - model.dropout)
    shots = met[rng.random(len(met), dtype=np.float32) < chance]
    for number, law in enumerate(laws):
        from_law = shots[source[shots] == number]
        at_m[from_law], _ = law.locate(power[from_law], rng.random(len(from_law)))
    shots = shots[at_m[shots] > model.min_range_m]
    attenuated = (power[shots] * window.gain(empty[shots])).astype(np.float32)
    azimuth, elevation = empty[shots].T
    across = np.cos(elevation)
    directions = np.column_stack([across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation)])
    return _returns(directions, at_m[shots], attenuated, model, rng)


def _loudest(
    count: int, model: LidarModel, weather: Weather, rng: np.random.Generator
) -> tuple[list[Strongest], Int[np.ndarray, " n"], Float[np.ndarray, " n"], Float32[np.ndarray, " n"]]:
    """What shots into the open hear loudest of the air.

    Returns:
        The laws of what falls; which of them each shot hears, -1 for fog; its signal; the range of fog's.
    """
    beam, extinction = beam_of(model), extinction_per_m(weather, model.wavelength_nm)
    source, power, at_m = np.full(count, -1), np.zeros(count), np.zeros(count, dtype=np.float32)
    if weather.mor_m < FOG_MOR_M:
        soft = soft_echo(beam, haze_extinction_per_m(weather.mor_m, model.wavelength_nm))
        low, high = BLANKING_M
        at, power = soft.beyond(low + (high - low) * rng.random(count))
        at_m[:] = at
    laws = [strongest_particle(particles, beam, extinction) for particles in falling(weather, model.wavelength_nm)]
    for number, law in enumerate(laws):
        strength = law.strength(rng.random(count), least=_FAINT)
        louder = np.flatnonzero(strength > power)
        source[louder], power[louder] = number, strength[louder]
    return laws, source, power, at_m


def empty_shots(
    direction_rad: Float32[np.ndarray, "n 2"], model: LidarModel, rng: np.random.Generator
) -> Float32[np.ndarray, "m 2"]:
    """Directions of the shots of a frame that brought nothing back.

    Those of a sensor that draws lines stand evenly over its field of view: a cloud does not show its pattern.

    Args:
        direction_rad: Azimuth and elevation of the points, shape (n, 2).
        model: The sensor.
        rng: Chooses among the directions without a point, if there are more of them than shots are missing.

    Returns:
        Azimuths and elevations, shape (m, 2); points and these are as many as the sensor has shots, or fewer.
    """
    azimuth, elevation = _grid(model)
    rising = elevation[::-1] if elevation[0] > elevation[-1] else elevation
    row = np.rint(np.interp(direction_rad[:, 1], rising, np.arange(len(rising)))).astype(np.int64)
    row = len(rising) - 1 - row if elevation[0] > elevation[-1] else row
    step = azimuth[0, 1] - azimuth[0, 0]
    column = np.rint((direction_rad[:, 0] - azimuth[row, 0]) / step).astype(np.int64)
    columns = azimuth.shape[1]
    column = column % columns if model.spinning else np.clip(column, 0, columns - 1)
    has_point = np.zeros(azimuth.size, dtype=np.bool_)
    has_point[row * columns + column] = True
    free = np.flatnonzero(~has_point)
    missing = max(azimuth.size - len(direction_rad), 0)
    if missing < len(free):
        free = rng.permutation(free)[:missing]
    row, column = np.divmod(free, columns)
    return np.column_stack([azimuth[row, column], elevation[row]]).astype(np.float32)


def _grid(model: LidarModel) -> tuple[Float[np.ndarray, "rings columns"], Float[np.ndarray, " rings"]]:
    """Azimuth of every shot and elevation of every row, radians."""
    column = np.arange(model.columns)
    if model.beams is None:
        half = np.radians(model.azimuth_deg)
        azimuth = -half + 2 * half * (column + 0.5) / model.columns
        elevation = np.radians(np.linspace(-model.elevation_deg, model.elevation_deg, model.lines))
        return np.broadcast_to(azimuth, (model.lines, model.columns)), elevation
    offset = np.radians(np.array(model.beams.offset_deg))
    azimuth = np.pi - 2 * np.pi * column / model.columns - offset[:, None]
    return azimuth, np.radians(np.array(model.beams.elevation_deg))


def _returns(
    towards: Float32[np.ndarray, "n 3"],
    at_m: Float32[np.ndarray, " n"],
    strength: Float32[np.ndarray, " n"],
    model: LidarModel,
    rng: np.random.Generator,
) -> tuple[Float32[np.ndarray, "n 3"], Float32[np.ndarray, " n"]]:
    """Points and intensities of echoes of the air that were heard; as the simulator measures them."""
    noise, texture = rng.standard_normal((2, len(at_m)), dtype=np.float32)
    measured = at_m + range_spread_m(model, strength).astype(np.float32) * noise
    intensity = (
        REFERENCE_REFLECTANCE / model.reference_range_m**2 * strength * measured**2 * np.exp(model.texture * texture)
    )
    points_m = (towards * measured[:, None]).astype(np.float32)
    return points_m, (np.rint(intensity.clip(0, 1) * _LEVELS) / _LEVELS).astype(np.float32)


# Radar cells

_LOOKS = 3.0  # independent looks that a cell's power averages, as those of the floor


def overlay_cells(
    points_m: Float32[np.ndarray, "n 3"],
    power: Float32[np.ndarray, " n"],
    model: RadarModel,
    weather: Weather,
    rng: np.random.Generator,
    *,
    floor_rise_db: float | int = 0.0,
) -> Float32[np.ndarray, " n"]:
    """What weather makes of the power of radar cells.

    Args:
        points_m: The cells, in the radar's frame.
        power: Mean power over Doppler, in ``POWER_UNIT``.
        model: The radar.
        weather: The weather, in addition to that in which the cells were measured.
        rng: Draws the speckle of what the floor gains.
        floor_rise_db: By how much the mean of the noise rises.

    Returns:
        Their power in that weather, shape (n,).
    """
    range_m = np.linalg.norm(points_m.astype(np.float64), axis=1)
    floor = floor_power(range_m, model)
    loss_db = two_way_loss_db(range_m, weather, model) - two_way_loss_db(range_m, CLEAR_WEATHER, model)
    changed = power - np.maximum(power - floor, 0.0) * (1 - 10 ** (-loss_db / 10))
    if floor_rise_db > 0:
        changed += floor * (10 ** (floor_rise_db / 10) - 1) * rng.gamma(_LOOKS, 1 / _LOOKS, len(power))
    return changed.astype(np.float32)


def floor_power(range_m: Float[np.ndarray, " n"], model: RadarModel) -> Float[np.ndarray, " n"]:
    """Mean power of noise in cells, in ``POWER_UNIT``, with the receiver's response by range."""
    response_db = np.interp(range_m, model.response_range_m, model.response_db)
    return model.noise_floor / POWER_UNIT * 10 ** (response_db / 10)
