"""Straight lines through points with outliers: Theil-Sen, Huber, and the line under all points."""

from itertools import pairwise

import numpy as np
from jaxtyping import Float

HUBER_K = 1.345
"""Huber's constant: 95 % of least squares' efficiency for Gaussian errors."""
GROUPS = 200
"""Theil-Sen takes the slopes between the medians of so many stretches."""

Values = Float[np.ndarray, " n"]


def theil_sen(x: Values, y: Values) -> tuple[float, float]:
    """Median of the slopes between all pairs of points, or of the medians of :data:`GROUPS` stretches; and the level.

    Args:
        x: Increasing.
        y: As many.

    Returns:
        Slope, and level at ``x = 0``.
    """
    if len(x) > GROUPS:
        size = len(x) // GROUPS
        few = slice(0, size * GROUPS)
        x0, y0 = (np.median(part[few].reshape(GROUPS, size), axis=1) for part in (x, y))
    else:
        x0, y0 = x, y
    first, second = np.triu_indices(len(x0), 1)
    run = x0[second] - x0[first]
    apart = run > 0
    slope = float(np.median((y0[second] - y0[first])[apart] / run[apart])) if apart.any() else 0.0
    return slope, float(np.median(y0 - slope * x0))


def huber(x: Values, y: Values, slope: float, level: float) -> tuple[float, float]:
    """Huber's regression by reweighted least squares from a robust start, its scale from the start's residuals.

    Args:
        x: Where.
        y: What.
        slope: Of the start.
        level: Of the start, at ``x = 0``.

    Returns:
        Slope, and level at ``x = 0``.
    """
    residual = y - level - slope * x
    scale = 1.4826 * float(np.median(np.abs(residual - np.median(residual))))
    if scale <= 0:
        return slope, level
    for _ in range(30):
        size = np.abs(y - level - slope * x)
        weight = np.minimum(1.0, HUBER_K * scale / np.maximum(size, 1e-300))
        total = weight.sum()
        x_mean, y_mean = float(weight @ x) / total, float(weight @ y) / total
        spread = float(weight @ (x - x_mean) ** 2)
        if spread <= 0:
            return slope, level
        new = float(weight @ ((x - x_mean) * (y - y_mean))) / spread
        change, slope = abs(new - slope), new
        level = y_mean - slope * x_mean
        if change * np.ptp(x) < 1e-6 * scale:
            break
    return float(slope), float(level)


def lower_hull(x: Values, y: Values) -> tuple[float, float]:
    """The line under all points whose distances add up to the least: the edge of the lower hull over the mean of ``x``.

    Args:
        x: Not decreasing; of equal ones the lowest counts.
        y: As many.

    Returns:
        Slope, and level at ``x = 0``.
    """
    chain: list[tuple[float, float]] = []
    for point in zip(x.tolist(), y.tolist(), strict=True):
        if chain and chain[-1][0] == point[0]:
            if point[1] >= chain[-1][1]:
                continue
            chain.pop()
        while len(chain) > 1 and _above(chain[-2], chain[-1], point):
            chain.pop()
        chain.append(point)
    middle = float(x.mean())
    for (x0, y0), (x1, y1) in pairwise(chain):
        if x0 <= middle <= x1:
            slope = (y1 - y0) / (x1 - x0)
            return slope, y0 - slope * x0
    return 0.0, chain[0][1]


def _above(before: tuple[float, float], middle: tuple[float, float], after: tuple[float, float]) -> bool:
    """Whether the middle point lies on or above the line between its neighbours."""
    return (middle[1] - before[1]) * (after[0] - before[0]) >= (after[1] - before[1]) * (middle[0] - before[0])
