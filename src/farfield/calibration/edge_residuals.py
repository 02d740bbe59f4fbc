"""How far the picture's edges lie from the LiDAR's: what is told of a camera's calibration, never what is minimised."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from farfield.calibration.edges import SIGMAS_PX, EdgeViews, sample_gradient
from farfield.geometry.cameras import Camera

_CLEAR = 3.0  # times the usual gradient


@dataclass(frozen=True, eq=False, kw_only=True)
class EdgeResiduals:
    """Residuals of the LiDAR's edges near which the picture has a clear one.

    Args:
        across_px: How far across the edge the picture's lies, signed, shape (n,), pixels.
        weight: What each counts in the score, shape (n,).
    """

    across_px: Float[np.ndarray, " n"]
    weight: Float[np.ndarray, " n"]

    @property
    def median_px(self) -> float | None:
        """Median distance in pixels, each edge counting as it does in the score; None without edges.

        So counted it tells a wrong pose best: large jumps are outlines, while the many small ones lie in clutter, where
        some edge of the picture is always near.
        """
        if not len(self.across_px):
            return None
        away = np.abs(self.across_px)
        return float(np.quantile(away, 0.5, weights=self.weight, method="inverted_cdf"))


def edge_residuals(camera: Camera, views: EdgeViews, *, reach_px: int = 6) -> EdgeResiduals:
    """How far across each LiDAR edge the nearest clear edge of the picture lies.

    Clear are the gradient's local maxima that are three times the usual one; within ``reach_px`` to each side. Their
    places are those of parabolas through the pixels beside them.
    """
    pixels, _, _ = replace(camera, width_px=0, height_px=0).project(views.points_m)
    pixels = np.nan_to_num(pixels, nan=-1e6)
    steps = np.arange(-reach_px - 1.0, reach_px + 1.5, 0.5)
    across = np.eye(2)[views.axis]
    found = np.stack([sample_gradient(views, pixels + step * across, len(SIGMAS_PX) - 1) for step in steps])
    inner = found[2:-2]
    top = (inner > _CLEAR) & (inner >= found[1:-3]) & (inner >= found[3:-1])
    nearest = np.where(top, np.abs(steps[2:-2])[:, None], np.inf).argmin(axis=0)
    low, mid, high = (np.take_along_axis(found, nearest[None] + each, axis=0)[0] for each in (0, 2, 4))
    bend = np.minimum(low - 2 * mid + high, -1e-9)
    within = np.clip(0.5 * (low - high) / bend, -0.5, 0.5)
    seen = top.any(axis=0)
    return EdgeResiduals(across_px=(steps[2:-2][nearest] + within)[seen], weight=views.weight[seen])
