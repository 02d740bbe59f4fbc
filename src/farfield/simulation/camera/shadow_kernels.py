"""Shadows between and under things, compiled by numba. Import this module only where a picture is made."""

from typing import no_type_check

import numpy as np

from farfield.errors import MissingExtraError

try:
    from numba import njit
except ImportError as error:
    raise MissingExtraError("numba", "simulate", "Rendering camera pictures") from error


@njit(cache=True)
@no_type_check
def fill_light(lit, known, range_m, face, height, width, out):
    """Spread shadows known at one pixel in four to all.

    Each pixel takes the mean of the known pixels about it that lie at much the same distance, near ones first: those of
    its own row and the rows above and below, where every row and every column knows one pixel in four.
    """
    for v in range(height):
        for u in range(width):
            i = v * width + u
            if face[i] < 0:
                out[i] = np.float32(1)
                continue
            weight = np.float32(1.5) if known[i] else np.float32(0)
            total = weight * lit[i]
            for r in range(max(0, v - 1), min(height, v + 2)):
                for q in range(max(0, u - 3), min(width, u + 4)):
                    j = r * width + q
                    if j != i and known[j] and abs(range_m[j] - range_m[i]) < np.float32(0.05) * range_m[i]:
                        w = np.float32(1) / np.float32((q - u) ** 2 + 6 * (r - v) ** 2)
                        if face[j] != face[i]:
                            w *= np.float32(0.25)
                        total += w * lit[j]
                        weight += w
            out[i] = total / weight if weight > 0 else np.float32(1)


@njit(cache=True)
@no_type_check
def contact(dimmed, picture_range, directions, face, moving_from, rows, columns, width, body_T_world, shift, half_m):
    """Dim the sky's light on the ground under and beside a road user, by the distance from its outline."""
    for v in range(rows[0], rows[1]):
        for u in range(columns[0], columns[1]):
            i = v * width + u
            if face[i] < 0 or face[i] >= moving_from:
                continue
            far = picture_range[i]
            px, py, pz = (
                directions[i, 0] * far + shift[0],
                directions[i, 1] * far + shift[1],
                directions[i, 2] * far + shift[2],
            )
            bx = abs(body_T_world[0, 0] * px + body_T_world[0, 1] * py + body_T_world[0, 2] * pz) - half_m[0]
            by = abs(body_T_world[1, 0] * px + body_T_world[1, 1] * py + body_T_world[1, 2] * pz) - half_m[1]
            bz = abs(body_T_world[2, 0] * px + body_T_world[2, 1] * py + body_T_world[2, 2] * pz)
            if bz > 0.5 or bx > 1.5 or by > 1.5:
                continue
            outside = np.sqrt(max(bx, 0.0) ** 2 + max(by, 0.0) ** 2) + min(max(bx, by), 0.0)
            reach = np.float32(0.28)
            dimmed[i] *= np.float32(1) - np.float32(0.85) / (
                np.float32(1) + np.exp(np.float32(outside) / reach * np.float32(2))
            )
