"""How far depth maps are off: MAE, RMSE, iMAE and iRMSE, by range.

The four figures of KITTI's depth completion benchmark (Uhrig et al., "Sparsity Invariant CNNs", 3DV 2017), over pixels
that have both a true and an estimated depth. KITTI takes the mean over images of each image's figure; :func:`mean_of`
does that, and adding up :class:`DepthErrors` pools the pixels of all images.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float

BINS_M: tuple[float, ...] = (0.0, 10.0, 20.0, 40.0, 80.0, 150.0, 250.0)
"""Ends of the ranges of the true depth."""

FIGURES = ("mae_mm", "rmse_mm", "imae_1_km", "irmse_1_km", "abs_rel", "within_1_25")
_LARGE = 1.25


@dataclass(frozen=True)
class DepthErrors:
    """Sums over the pixels of a range; figures are NaN where no pixel was estimated.

    Args:
        truth: Pixels with a true depth.
        compared: Pixels that also have an estimate.
        absolute: Sum of absolute errors in metres.
        squared: Sum of squared errors in metres squared.
        inverse: Sum of absolute errors of 1 / z in 1 / m.
        inverse_squared: Sum of their squares.
        relative: Sum of absolute errors over the true depth.
        close: Pixels whose estimate and truth are less than a factor of 1.25 apart.
    """

    truth: int = 0
    compared: int = 0
    absolute: float = 0.0
    squared: float = 0.0
    inverse: float = 0.0
    inverse_squared: float = 0.0
    relative: float = 0.0
    close: int = 0

    def __add__(self, other: "DepthErrors") -> "DepthErrors":
        return DepthErrors(*(getattr(self, name) + getattr(other, name) for name in self.__dataclass_fields__))

    @property
    def coverage(self) -> float:
        """Share of the true depths that have an estimate."""
        return float(self.compared / self.truth) if self.truth else float("nan")

    @property
    def mae_mm(self) -> float:
        """Mean absolute error in millimetres."""
        return 1e3 * self._mean(self.absolute)

    @property
    def rmse_mm(self) -> float:
        """Root of the mean squared error in millimetres."""
        return 1e3 * float(np.sqrt(self._mean(self.squared)))

    @property
    def imae_1_km(self) -> float:
        """Mean absolute error of the inverse depth in 1 / km."""
        return 1e3 * self._mean(self.inverse)

    @property
    def irmse_1_km(self) -> float:
        """Root of the mean squared error of the inverse depth in 1 / km."""
        return 1e3 * float(np.sqrt(self._mean(self.inverse_squared)))

    @property
    def abs_rel(self) -> float:
        """Mean of the absolute error over the true depth."""
        return self._mean(self.relative)

    @property
    def within_1_25(self) -> float:
        """Share of pixels within a factor of 1.25 of the truth."""
        return self._mean(float(self.close))

    def to_json(self) -> dict[str, Any]:
        """Counts and figures; null where there are none."""
        numbers = {name: float(getattr(self, name)) for name in (*FIGURES, "coverage")}
        tree: dict[str, Any] = {name: number if np.isfinite(number) else None for name, number in numbers.items()}
        return {"truth": self.truth, "compared": self.compared, **tree}

    def _mean(self, total: float) -> float:
        return total / self.compared if self.compared else float("nan")


def depth_errors(depth_m: Float[np.ndarray, "h w"], truth_m: Float[np.ndarray, "h w"]) -> DepthErrors:
    """The errors of one map.

    Args:
        depth_m: Estimates along the optical axis in metres, NaN for none, shape (h, w).
        truth_m: True depths, NaN for unknown, shape (h, w).
    """
    is_true = np.isfinite(truth_m) & (truth_m > 0)
    both = is_true & np.isfinite(depth_m) & (depth_m > 0)
    estimate, truth = depth_m[both].astype(np.float64), truth_m[both].astype(np.float64)
    error, inverse = np.abs(estimate - truth), np.abs(1 / estimate - 1 / truth)
    return DepthErrors(
        truth=int(is_true.sum()),
        compared=len(truth),
        absolute=float(error.sum()),
        squared=float((error**2).sum()),
        inverse=float(inverse.sum()),
        inverse_squared=float((inverse**2).sum()),
        relative=float((error / truth).sum()),
        close=int((np.maximum(estimate / truth, truth / estimate) < _LARGE).sum()),
    )


def errors_by_range(
    depth_m: Float[np.ndarray, "h w"], truth_m: Float[np.ndarray, "h w"], bins_m: Sequence[float] = BINS_M
) -> dict[str, DepthErrors]:
    """The errors of one map by the range of the truth: ``0-10``, ``10-20``..., first ``all``, within the last end."""
    within = {"all": (bins_m[0], bins_m[-1])}
    within |= {f"{low:g}-{high:g}": (low, high) for low, high in pairwise(bins_m)}
    return {
        name: depth_errors(depth_m, np.where((truth_m >= low) & (truth_m < high), truth_m, np.nan))
        for name, (low, high) in within.items()
    }


def mean_of(errors: Sequence[DepthErrors]) -> dict[str, float]:
    """Mean over images of each image's figures, as KITTI does; images without a compared pixel are left out."""
    counted = [image for image in errors if image.compared]
    return {
        name: float(np.mean([getattr(image, name) for image in counted])) if counted else float("nan")
        for name in FIGURES
    }
