"""From the light that reaches a camera to its picture: weather before and on the window, exposure, noise, sRGB.

What happens pixel by pixel is compiled by numba; see :mod:`farfield.simulation.camera.kernels`.
"""

from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Float, Float32, UInt8
from scipy.ndimage import gaussian_filter

from farfield.errors import MissingExtraError
from farfield.geometry.cameras import Camera
from farfield.simulation.camera.sky import Sky
from farfield.simulation.weather.conditions import Weather

# Pixel by pixel

try:
    from numba import njit
except ImportError as error:
    raise MissingExtraError("numba", "simulate", "Rendering camera pictures") from error


@njit(cache=True)
@no_type_check
def shrink(image, factor):
    """Means over blocks of ``factor`` x ``factor`` pixels; blocks at the lower and right edge may be smaller."""
    height, width, _ = image.shape
    rows, columns = (height + factor - 1) // factor, (width + factor - 1) // factor
    out = np.zeros((rows, columns, 3), np.float32)
    for v in range(height):
        for u in range(width):
            for c in range(3):
                out[v // factor, u // factor, c] += image[v, u, c]
    for r in range(rows):
        for q in range(columns):
            count = (min(height, (r + 1) * factor) - r * factor) * (min(width, (q + 1) * factor) - q * factor)
            for c in range(3):
                out[r, q, c] /= np.float32(count)
    return out


@njit(cache=True)
@no_type_check
def spread(image):
    """A lens that is sharp to about half a pixel: a separable kernel of 1/8, 3/4, 1/8."""
    height, width, _ = image.shape
    out = np.empty_like(image)
    side, middle = np.float32(0.125), np.float32(0.75)
    for v in range(height):
        for u in range(width):
            left, right = max(u - 1, 0), min(u + 1, width - 1)
            for c in range(3):
                out[v, u, c] = middle * image[v, u, c] + side * (image[v, left, c] + image[v, right, c])
    above = np.empty((width, 3), np.float32)
    for v in range(height):
        below = min(v + 1, height - 1)
        for u in range(width):
            for c in range(3):
                centre = out[v, u, c]
                before = above[u, c] if v > 0 else centre
                above[u, c] = centre
                out[v, u, c] = middle * centre + side * (before + out[below, u, c])
    return out


@njit(cache=True)
@no_type_check
def _between(low, row, column, c):
    """Bilinear sample of a small picture."""
    height, width = low.shape[0], low.shape[1]
    row = min(max(row, np.float32(0)), np.float32(height - 1))
    column = min(max(column, np.float32(0)), np.float32(width - 1))
    r, q = int(row), int(column)
    r1, q1 = min(r + 1, height - 1), min(q + 1, width - 1)
    a, b = row - np.float32(r), column - np.float32(q)
    top = low[r, q, c] + (low[r, q1, c] - low[r, q, c]) * b
    return top + (low[r1, q, c] + (low[r1, q1, c] - low[r1, q, c]) * b - top) * a


@njit(cache=True)
@no_type_check
def mix_low(image, low, cover, factor, lift):
    """Replace a share ``cover`` (small, shape (h', w', 1)) of each pixel by a small picture times ``lift``."""
    height, width, _ = image.shape
    step = np.float32(1) / np.float32(factor)
    for v in range(height):
        row = (np.float32(v) + np.float32(0.5)) * step - np.float32(0.5)
        for u in range(width):
            column = (np.float32(u) + np.float32(0.5)) * step - np.float32(0.5)
            share = _between(cover, row, column, 0)
            if share > 0.001:
                for c in range(3):
                    image[v, u, c] += share * (lift * _between(low, row, column, c) - image[v, u, c])


@njit(cache=True)
@no_type_check
def add_low(image, low, factor):
    """Add a small picture, scaled up."""
    height, width, _ = image.shape
    step = np.float32(1) / np.float32(factor)
    for v in range(height):
        row = (np.float32(v) + np.float32(0.5)) * step - np.float32(0.5)
        for u in range(width):
            column = (np.float32(u) + np.float32(0.5)) * step - np.float32(0.5)
            for c in range(3):
                image[v, u, c] += _between(low, row, column, c)


@njit(cache=True)
@no_type_check
def draw_drops(image, low, factor, drops):
    """Discs of water on the window: out of focus, each with a small upside-down picture of what lies around it.

    Rows of ``drops``: column, row, radius in pixels, strength.
    """
    height, width, _ = image.shape
    step = np.float32(1) / np.float32(factor)
    for k in range(drops.shape[0]):
        u0, v0, radius, strength = drops[k, 0], drops[k, 1], drops[k, 2], drops[k, 3]
        for v in range(max(0, int(v0 - radius)), min(height, int(v0 + radius) + 2)):
            for u in range(max(0, int(u0 - radius)), min(width, int(u0 + radius) + 2)):
                du, dv = (np.float32(u) - u0) / radius, (np.float32(v) - v0) / radius
                square = du * du + dv * dv
                if square >= 1:
                    continue
                edge = np.float32(1) - square * square * square
                share = strength * min(np.float32(1), (np.float32(1) - square) * np.float32(3))
                row = (v0 - dv * radius * np.float32(5)) * step
                column = (u0 - du * radius * np.float32(5)) * step
                for c in range(3):
                    refracted = _between(low, row, column, c) * (np.float32(0.72) + np.float32(0.28) * edge)
                    image[v, u, c] += share * (refracted - image[v, u, c])


@njit(cache=True)
@no_type_check
def draw_streaks(image, range_m, streaks, colours):
    """Soft lines with round ends, in front of what is farther; rows: u0, v0, u1, v1, radius, opacity, distance."""
    height, width, _ = image.shape
    for k in range(streaks.shape[0]):
        u0, v0, u1, v1 = streaks[k, 0], streaks[k, 1], streaks[k, 2], streaks[k, 3]
        radius, opacity, far = streaks[k, 4], streaks[k, 5], streaks[k, 6]
        au, av = u1 - u0, v1 - v0
        square = au * au + av * av + np.float32(1e-6)
        half_width = radius + np.float32(0.7)
        for v in range(max(0, int(min(v0, v1) - half_width)), min(height, int(max(v0, v1) + half_width) + 2)):
            for u in range(max(0, int(min(u0, u1) - half_width)), min(width, int(max(u0, u1) + half_width) + 2)):
                if range_m[v, u] < far:
                    continue
                pu, pv = np.float32(u) - u0, np.float32(v) - v0
                t = min(np.float32(1), max(np.float32(0), (pu * au + pv * av) / square))
                away = np.sqrt((pu - t * au) ** 2 + (pv - t * av) ** 2)
                share = opacity * min(np.float32(1), max(np.float32(0), (half_width - away) / np.float32(1.2)))
                for c in range(3):
                    image[v, u, c] += share * (colours[k, c] - image[v, u, c])


@njit(cache=True)
@no_type_check
def develop(image, gain, falloff, noise, read, shot, curve):
    """Exposure, vignetting, film-like shoulder 1 - exp(-x), noise, and the look-up of 8-bit sRGB values."""
    height, width, _ = image.shape
    out = np.empty((height, width, 3), np.uint8)
    count, top = noise.shape[0], np.float32(curve.shape[0] - 1)
    scale = np.float32(4.0) / np.float32(height * height + width * width)
    for v in range(height):
        dv = np.float32(v) - np.float32(0.5) * np.float32(height)
        for u in range(width):
            du = np.float32(u) - np.float32(0.5) * np.float32(width)
            factor = gain * (np.float32(1) - falloff * (du * du + dv * dv) * scale)
            for c in range(3):
                tone = np.float32(1) - np.exp(-image[v, u, c] * factor)
                grain = noise[(v * width + u + c * (count // 3)) % count]
                tone += grain * np.sqrt(read * read + shot * shot * max(tone, np.float32(0)))
                out[v, u, c] = curve[int(min(max(tone, np.float32(0)), np.float32(1)) * top)]
    return out


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
    drop_rng, fall_rng, noise_rng = rng.spawn(3)
    # the lens, and the exposure
    image = spread(image)
    gain = auto_gain(image)
    # what falls before the camera, light scattered by lens and fog, and what sticks to the window
    for streaks, colours in (_rain(exposure, weather, sky, fall_rng), _snow(exposure, weather, sky, fall_rng)):
        if len(streaks):
            draw_streaks(image, exposure.range_m, streaks, colours)
    if sky.night:
        _bloom(image, gain, sky)
    _drops(image, weather, drop_rng)
    _ice(image, exposure, weather, window_seed)
    # the sensor: exposure, vignetting, noise, sRGB
    boost = _NIGHT_NOISE if sky.night else 1.0
    noise = noise_rng.standard_normal(image.shape[0] * image.shape[1], dtype=np.float32)
    return develop(
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
    bright = np.maximum(shrink(image, _LOW // 2) - np.float32(1.8 / gain), np.float32(0))
    fog = float(np.clip(sky.extinction_per_m * 150.0, 0.0, 1.0))
    near = gaussian_filter(bright, (1.5, 1.5, 0), mode="constant")
    wide = gaussian_filter(bright, (9.0, 9.0, 0), mode="constant")
    glow = np.float32(0.25) * near + np.float32(0.35 + 0.9 * fog) * wide
    add_low(image, glow.astype(np.float32), _LOW // 2)


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
    if weather.rain_mm_h <= 0:
        return
    height, width, _ = image.shape
    count = int(rng.poisson(12 + 6.0 * weather.rain_mm_h))
    drops = np.empty((count, 4), dtype=np.float32)
    drops[:, 0], drops[:, 1] = rng.uniform(0, width, count), rng.uniform(0, height, count)
    drops[:, 2] = height * np.clip(np.exp(rng.normal(np.log(0.010), 0.55, count)), 0.004, 0.05)
    drops[:, 3] = rng.uniform(0.45, 0.9, count)
    low = shrink(image, _LOW // 2)
    draw_drops(image, low, np.float32(_LOW // 2), drops)


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
    share = _CAMERA_ICING * weather.icing_at(exposure.time_s)
    if share < 0.01 or weather.snow_mm_h <= 0:
        return
    cover = window_cover(image.shape[0], image.shape[1], share, seed)
    low = gaussian_filter(shrink(image, _LOW), (5.0, 5.0, 0), mode="nearest")
    mix_low(image, low.astype(np.float32), cover, np.float32(_LOW), np.float32(1.08))
