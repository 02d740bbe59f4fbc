"""Small and odd cases on which kernels and plain versions are compared, here and in the tests."""

import numpy as np
import torch

SHAPE = (5, 9, 8)
STRIDED = [
    ((3, 3, 3), (2, 2, 2), (1, 1, 1)),
    ((3, 3, 3), (2, 2, 2), (0, 1, 1)),
    ((3, 1, 1), (2, 1, 1), (0, 0, 0)),
    ((2, 2, 2), (2, 2, 2), (0, 0, 0)),
    ((1, 2, 2), (1, 2, 2), (0, 0, 0)),
    ((3, 3, 3), (1, 3, 2), (1, 2, 1)),
]


def cells(share, frames=3):
    """Keys of some of the cells."""
    generator = torch.Generator().manual_seed(0)
    return (torch.rand(360 * frames, generator=generator) < share).nonzero().squeeze(1)


def drawn(rng, count, spread_m):
    """Boxes as rows x, y, z, length, width, height, yaw, many of them upon one another."""
    sides = rng.uniform(0.3, 12, (count, 2))
    place, height = rng.uniform(-spread_m, spread_m, (count, 2)), rng.uniform(1, 3, count)
    rows = np.column_stack([place, rng.normal(0, 1, count), sides, height, rng.uniform(-9, 9, count)])
    nudge = [1, 1, 1, 0, 0, 0, 1]
    rows[count // 2 :] = rows[: count - count // 2] + rng.normal(0, 0.2, (count - count // 2, 7)) * nudge
    return rows
