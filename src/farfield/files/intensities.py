"""Intensities of clouds: the full scale that their numbers show, and numbers brought to [0, 1]."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Shaped

from farfield.errors import FileFormatError

_FULL_SCALES = (1.0, 255.0, 65535.0)
_FEW, _LITTLE_BEYOND = 0.01, 1.5
"""Outliers: share of the intensities above 0 that lie beyond a scale, and how far they may if all are whole numbers."""


@np.errstate(invalid="ignore", over="ignore")  # damaged numbers
def intensity_scale_of(strengths: Sequence[Shaped[np.ndarray, " _"]]) -> float:
    """Value that stands for full reflectance in the clouds of a data set: 1, 255 or 65535.

    The smallest that covers them, but for outliers: fewer than one in a hundred, among numbers with a fraction or
    little above. Whole numbers of an integer type never reach from 0 to 1. Beyond 65535 it is the largest.

    >>> intensity_scale_of([np.array([0.2, 0.9])]), intensity_scale_of([np.array([3, 200.0]), np.array([0.5])])
    (1.0, 255.0)
    """
    scales = _FULL_SCALES[1:] if strengths and all(values.dtype.kind in "iu" for values in strengths) else _FULL_SCALES
    joined = np.concatenate([values.astype(np.float64) for values in strengths] or [np.zeros(0)])
    positive = joined[np.isfinite(joined) & (joined > 0)]
    largest = float(positive.max(initial=0.0))
    for scale in scales:
        beyond = positive > scale * (1 + 1e-6)
        if not beyond.any():
            return scale
        fractions = (positive[~beyond] % 1 != 0).any()
        if beyond.mean() < _FEW and (largest <= _LITTLE_BEYOND * scale or fractions):
            return scale
    return largest


@np.errstate(invalid="ignore", over="ignore")
def scaled_intensity(
    path: Path | str, strength: Shaped[np.ndarray, " n"], scale: float | int
) -> Float32[np.ndarray, " n"]:
    """Intensities brought to [0, 1].

    Args:
        path: The file, for messages.
        strength: As the file has them.
        scale: Value that stands for full reflectance.

    Raises:
        FileFormatError: If one is not finite, negative or beyond the scale.
    """
    values = np.asarray(strength, dtype=np.float32)
    impossible = values[~(np.isfinite(values) & (values >= 0))]
    if len(impossible):
        raise FileFormatError(
            path,
            where="the intensity column",
            expected="finite values of 0 or more",
            got=f"{len(impossible)} of {len(values)} that are none, such as {impossible[0]:g}",
            fix="Write 0 where the strength is not known, linear numbers for decibels, or no such column.",
        )
    largest = float(values.max(initial=0.0))
    if largest > scale * (1 + 1e-5):
        raise FileFormatError(
            path,
            where="the intensity column",
            expected=f"values from 0 to {scale:g}",
            got=f"values to {largest:g}",
            fix="Give the value that stands for full reflectance in all clouds, such as --intensity-scale "
            f"{largest:.6g} (in Python and experiments intensity_scale={largest:.6g}), or mend the column.",
        )
    return np.clip(values / np.float32(scale), 0.0, 1.0)
