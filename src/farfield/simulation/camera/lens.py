"""From the light that reaches a camera to its picture: weather before and on the window, exposure, noise, sRGB."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, UInt8
from scipy.ndimage import gaussian_filter

from farfield.geometry.cameras import Camera
from farfield.simulation.camera.sky import Sky
from farfield.simulation.weather.conditions import Weather

_LOW = 8  # size of a pixel of the small pictures that stand for what is out of focus
_FALLOFF = 0.28  # light lost in the corners
_READ, _SHOT = 0.0022, 0.008
_NIGHT_NOISE = 4.0
_KEY = 0.40
_GAIN_RANGE = (0.1, 4.0)
_CONTRAST = 0.5
_CAMERA_ICING = 0.45  # share of a window's icing that lies before the camera, which is wiped now and then


@dataclass(frozen=True, eq=False)
class Exposure:
    """What the drawing of drops and flakes needs to know of a picture.

    Args:
        camera: The camera.
        velocity_m_s: The camera's own velocity in camera axes (x right, y down, z forward).
        down: Unit vector down in camera axes.
        range_m: Distance of what each pixel sees, shape (h, w).
        time_s: Time since the sequence began.
    """

    camera: Camera
    velocity_m_s: Float[np.ndarray, " 3"]
    down: Float[np.ndarray, " 3"]
    range_m: Float32[np.ndarray, "h w"]
    time_s: float


def finish(
    image: Float32[np.ndarray, "h w 3"],
    exposure: Exposure,
    weather: Weather,
    sky: Sky,
    rng: np.random.Generator,
    window_seed: np.random.SeedSequence,
) -> UInt8[np.ndarray, "h w 3"]:
    """Turn radiance into an 8-bit picture.

    Args:
        image: Linear radiance.
        exposure: Camera, motion and distances.
        weather: What falls, and what sticks to the window.
        sky: The light.
        rng: Draws drops, flakes and noise of this picture.
        window_seed: Draws where the camera's window is dirty; the same for all pictures of a sequence.
    """
    from farfield.simulation.camera import lens_kernels

    drop_rng, fall_rng, noise_rng = rng.spawn(3)
    image = lens_kernels.spread(image)
    gain = auto_gain(image)
    for streaks, colours in (_rain(exposure, weather, sky, fall_rng), _snow(exposure, weather, sky, fall_rng)):
        if len(streaks):
            lens_kernels.draw_streaks(image, exposure.range_m, streaks, colours)
    if sky.night:
        _bloom(image, gain, sky)
    _drops(image, weather, drop_rng)
    _ice(image, exposure, weather, window_seed)
    boost = _NIGHT_NOISE if sky.night else 1.0
    noise = noise_rng.standard_normal(image.shape[0] * image.shape[1], dtype=np.float32)
    return lens_kernels.develop(
        image,
        np.float32(gain),
        np.float32(_FALLOFF),
        noise,
        np.float32(_READ * boost),
        np.float32(_SHOT * boost),
        srgb_curve(),
    )


def srgb_curve(steps: int = 4096) -> UInt8[np.ndarray, " steps"]:
    """8-bit value of evenly spaced linear values from 0 to 1: sRGB (IEC 61966-2-1), then a mild S for contrast."""
    linear = np.linspace(0.0, 1.0, steps)
    curved = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    steep = curved * curved * (3 - 2 * curved)
    return np.round(255 * ((1 - _CONTRAST) * curved + _CONTRAST * steep)).astype(np.uint8)


def auto_gain(image: Float32[np.ndarray, "h w 3"]) -> float:
    """Gain that brings the luminance to a fixed key, within a camera's limits.

    Metered is the mean of the arithmetic and the geometric mean, so that a bright sky is not lost.
    """
    luminance = image[::8, ::8] @ np.array([0.2126, 0.7152, 0.0722], dtype=np.float32)
    mean = 0.5 * float(np.exp(np.mean(np.log(luminance + 1e-3)))) + 0.5 * float(np.mean(luminance))
    return float(np.clip(_KEY / mean, *_GAIN_RANGE))


def _bloom(image: Float32[np.ndarray, "h w 3"], gain: float, sky: Sky) -> None:
    """Light of lamps that lens and fog scatter around them."""
    from farfield.simulation.camera import lens_kernels

    bright = np.maximum(lens_kernels.shrink(image, _LOW // 2) - np.float32(1.8 / gain), np.float32(0))
    fog = float(np.clip(sky.extinction_per_m * 150.0, 0.0, 1.0))
    near = gaussian_filter(bright, (1.5, 1.5, 0), mode="constant")
    wide = gaussian_filter(bright, (9.0, 9.0, 0), mode="constant")
    glow = np.float32(0.25) * near + np.float32(0.35 + 0.9 * fog) * wide
    lens_kernels.add_low(image, glow.astype(np.float32), _LOW // 2)


def _fallers(
    exposure: Exposure,
    count: int,
    reach_m: tuple[float, float],
    fall_m_s: float,
    shutter_s: float,
    rng: np.random.Generator,
) -> Float32[np.ndarray, "n 7"]:
    """Particles spread evenly in the space before a camera, each drawn along its path while the shutter is open."""
    camera = exposure.camera
    u = rng.uniform(0, camera.width_px, count)
    v = rng.uniform(0, camera.height_px, count)
    near, far = reach_m
    distance = np.cbrt(rng.uniform(near**3, far**3, count))
    speed = fall_m_s * exposure.down - exposure.velocity_m_s
    fx, fy, cx, cy = camera.matrix[0, 0], camera.matrix[1, 1], camera.matrix[0, 2], camera.matrix[1, 2]
    du = (fx * speed[0] - (u - cx) * speed[2]) / distance * shutter_s
    dv = (fy * speed[1] - (v - cy) * speed[2]) / distance * shutter_s
    length = np.hypot(du, dv)
    shorten = np.minimum(1.0, 120.0 / np.maximum(length, 1e-6))
    zero = np.zeros(count)
    lines = np.stack([u, v, u + du * shorten, v + dv * shorten, zero, zero, distance], axis=1)
    return lines.astype(np.float32)


def _lit_drops(distance: Float32[np.ndarray, " n"], sky: Sky, share: float) -> Float32[np.ndarray, "n 3"]:
    """Radiance of drops and flakes: the sky's light, and by night the ego vehicle's head lamps."""
    own = sky.night * 0.8 / (1.0 + (distance / 5.0) ** 2)
    light = 0.5 * (sky.ambient_rgb + sky.horizon_rgb) + 0.3 * sky.sun_rgb
    return (share * (light[None] + own[:, None])).astype(np.float32)


def _rain(
    exposure: Exposure, weather: Weather, sky: Sky, rng: np.random.Generator
) -> tuple[Float32[np.ndarray, "n 7"], Float32[np.ndarray, "n 3"]]:
    pixels = exposure.camera.width_px * exposure.camera.height_px / 921_600
    count = int(700 * pixels * weather.rain_mm_h**0.6)
    lines = _fallers(exposure, count, (1.0, 12.0), 6.5, 0.008 if not sky.night else 0.02, rng)
    lines[:, 4] = np.clip(0.0012 * exposure.camera.matrix[0, 0] / lines[:, 6], 0.1, 1.5)
    length = np.hypot(lines[:, 2] - lines[:, 0], lines[:, 3] - lines[:, 1])
    lines[:, 5] = np.clip(2.4 * lines[:, 4] / (1 + 0.04 * length), 0.03, 0.3)
    return lines, _lit_drops(lines[:, 6], sky, 1.05)


def _snow(
    exposure: Exposure, weather: Weather, sky: Sky, rng: np.random.Generator
) -> tuple[Float32[np.ndarray, "n 7"], Float32[np.ndarray, "n 3"]]:
    pixels = exposure.camera.width_px * exposure.camera.height_px / 921_600
    count = int(3200 * pixels * weather.snow_mm_h**0.7)
    lines = _fallers(exposure, count, (0.7, 22.0), 2.0 if weather.wet_snow else 1.0, 0.006, rng)
    size_m = 0.0012 + 0.0016 * rng.standard_exponential(count, dtype=np.float32)
    lines[:, 4] = np.clip(size_m * exposure.camera.matrix[0, 0] / lines[:, 6], 0.05, 9.0)
    length = np.hypot(lines[:, 2] - lines[:, 0], lines[:, 3] - lines[:, 1])
    lines[:, 5] = np.clip(1.5 * lines[:, 4], 0.0, 0.85) / (1 + 0.12 * length / (lines[:, 4] + 0.7))
    return lines, _lit_drops(lines[:, 6], sky, 1.25)


def _drops(image: Float32[np.ndarray, "h w 3"], weather: Weather, rng: np.random.Generator) -> None:
    """Drops on the camera's window in rain and sleet."""
    from farfield.simulation.camera import lens_kernels

    if weather.rain_mm_h <= 0:
        return
    height, width, _ = image.shape
    count = int(rng.poisson(12 + 6.0 * weather.rain_mm_h))
    drops = np.empty((count, 4), dtype=np.float32)
    drops[:, 0], drops[:, 1] = rng.uniform(0, width, count), rng.uniform(0, height, count)
    drops[:, 2] = height * np.clip(np.exp(rng.normal(np.log(0.010), 0.55, count)), 0.004, 0.05)
    drops[:, 3] = rng.uniform(0.45, 0.9, count)
    low = lens_kernels.shrink(image, _LOW // 2)
    lens_kernels.draw_drops(image, low, np.float32(_LOW // 2), drops)


def window_cover(
    height_px: int, width_px: int, share: float, seed: np.random.SeedSequence
) -> Float32[np.ndarray, "h w 1"]:
    """How much of each part of the window ice or snow covers: a smooth random field cut at a quantile.

    Args:
        height_px: Rows of the picture.
        width_px: Columns of the picture.
        share: Covered share, 0 to 1.
        seed: Draws the field; a greater share covers all that a smaller one did.
    """
    rows, columns = -(-height_px // _LOW), -(-width_px // _LOW)
    rng = np.random.default_rng(seed)
    field = sum(
        weight * size * gaussian_filter(rng.standard_normal((rows, columns)), size, mode="nearest")
        for size, weight in ((9.0, 1.0), (3.0, 0.5), (1.0, 0.25))
    )
    field = np.asarray(field) / np.std(np.asarray(field))
    edge = np.quantile(field, 1.0 - share) if share > 0 else np.inf
    return (0.93 * np.clip((field - edge) / 0.35 + 0.5, 0.0, 1.0)).astype(np.float32)[..., None]


def _ice(
    image: Float32[np.ndarray, "h w 3"], exposure: Exposure, weather: Weather, seed: np.random.SeedSequence
) -> None:
    """Frost and snow on the window, which let through a bright blur."""
    from farfield.simulation.camera import lens_kernels

    share = _CAMERA_ICING * weather.icing_at(exposure.time_s)
    if share < 0.01 or weather.snow_mm_h <= 0:
        return
    cover = window_cover(image.shape[0], image.shape[1], share, seed)
    low = gaussian_filter(lens_kernels.shrink(image, _LOW), (5.0, 5.0, 0), mode="nearest")
    lens_kernels.mix_low(image, low.astype(np.float32), cover, np.float32(_LOW), np.float32(1.08))
