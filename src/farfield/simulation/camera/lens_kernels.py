"""What happens to a picture inside the camera, pixel by pixel, compiled by numba; see ``kernels``."""

from typing import no_type_check

import numpy as np

from farfield.errors import MissingExtraError

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
                here = out[v, u, c]
                before = above[u, c] if v > 0 else here
                above[u, c] = here
                out[v, u, c] = middle * here + side * (before + out[below, u, c])
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
                    seen = _between(low, row, column, c) * (np.float32(0.72) + np.float32(0.28) * edge)
                    image[v, u, c] += share * (seen - image[v, u, c])


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
        reach = radius + np.float32(0.7)
        for v in range(max(0, int(min(v0, v1) - reach)), min(height, int(max(v0, v1) + reach) + 2)):
            for u in range(max(0, int(min(u0, u1) - reach)), min(width, int(max(u0, u1) + reach) + 2)):
                if range_m[v, u] < far:
                    continue
                pu, pv = np.float32(u) - u0, np.float32(v) - v0
                t = min(np.float32(1), max(np.float32(0), (pu * au + pv * av) / square))
                away = np.sqrt((pu - t * au) ** 2 + (pv - t * av) ** 2)
                share = opacity * min(np.float32(1), max(np.float32(0), (reach - away) / np.float32(1.2)))
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
