"""The polar picture of a turning radar without height nor Doppler, as RADIATE's Navtech gives it, and what is read off.

RADIATE: Sheeny et al., ICRA 2021. A picture has 576 ranges by 400 azimuths, counted clockwise from forward, 8 bits of
decibels.
"""

import numpy as np
from jaxtyping import Float32, UInt8

CELL_M = 100.0 / 576
"""Of the polar picture along range, and of the Cartesian one along both axes."""
POLAR_SHAPE, CARTESIAN_SHAPE = (576, 400), (1152, 1152)
CENTRE_PX = 575.5
"""Row and column of the radar in the Cartesian picture, whose rows run backwards and columns to the right."""
TURN_S = 0.25


def strongest_cells(
    picture: Float32[np.ndarray, "ranges azimuths"], share: float
) -> tuple[Float32[np.ndarray, "n 3"], Float32[np.ndarray, " n"]]:
    """The strongest cells of a polar picture as points at z = 0: those above the rest, at most ``share`` of all.

    Cell (i, j) lies ``i`` cells away, in the middle of the j-th of 400 sectors, counted clockwise from forward.

    Args:
        picture: Shape (576, 400).
        share: In (0, 1].

    Returns:
        Points, shape (n, 3), and the picture's values there.
    """
    count = int(share * picture.size)
    rest = picture.size - count
    weakest = np.partition(picture, rest - 1, axis=None)[rest - 1] if rest else -1.0
    row, column = np.nonzero(picture > weakest)
    range_m, azimuth_rad = row * CELL_M, -(column + 0.5) * (2 * np.pi / POLAR_SHAPE[1])
    points = np.column_stack([range_m * np.cos(azimuth_rad), range_m * np.sin(azimuth_rad), np.zeros(len(row))])
    return points.astype(np.float32), picture[row, column]


def cartesian(polar: UInt8[np.ndarray, "ranges azimuths"]) -> UInt8[np.ndarray, "height width"]:
    """The picture from above, forward up and right to the right: bilinear in range and azimuth, 0 beyond the last."""
    offset = np.arange(CARTESIAN_SHAPE[0]) - CENTRE_PX
    ahead, right = -offset[:, None], offset[None, :]
    row = np.hypot(ahead, right)
    column = np.arctan2(right, ahead) / (2 * np.pi) * POLAR_SHAPE[1] - 0.5
    inside = row <= POLAR_SHAPE[0] - 1
    first, left = np.minimum(row.astype(np.int64), POLAR_SHAPE[0] - 2), np.floor(column).astype(np.int64)
    down, across = np.clip(row - first, 0.0, 1.0), column - left
    near, far = left % POLAR_SHAPE[1], (left + 1) % POLAR_SHAPE[1]
    values = polar.astype(np.float32)
    upper = values[first, near] * (1 - across) + values[first, far] * across
    lower = values[first + 1, near] * (1 - across) + values[first + 1, far] * across
    return np.where(inside, np.rint(upper * (1 - down) + lower * down), 0).astype(np.uint8)
