"""Normalised information distance between a picture's grey and a LiDAR's intensity: a last check, not a solver.

``(2 H(X, Y) - H(X) - H(Y)) / H(X, Y)`` (Li et al., "The similarity metric", IEEE Trans. Inf. Theory 2004, for
histograms: Kraskov et al. 2005). Its basin is 0.1 to 0.3 degree wide and its depth 0.1 to 0.2 %, so that it may only
say whether it agrees with what edges found.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Shaped
from scipy.stats import rankdata

from farfield.geometry.cameras import Camera
from farfield.geometry.poses import transform_points

_BINS = 32
_CELL_PX = 4
LEAST_INFORMATION_FRAMES = 10


def information_distance(
    camera: Camera,
    pictures: Sequence[Shaped[np.ndarray, "height width ..."]],
    points_m: Sequence[Float[np.ndarray, "_ 3"]],
    intensity: Sequence[Shaped[np.ndarray, " _"]],
) -> float:
    """Distance over all frames, from 0 (one tells the other) to 1 (nothing in common); 1 where no point is seen.

    Args:
        camera: The calibration to judge.
        pictures: One a frame.
        points_m: Points of each frame, shape (n, 3), at the moment of the picture.
        intensity: Their intensities; only their order counts.
    """
    joint = np.zeros((_BINS, _BINS))
    for picture, points, strength in zip(pictures, points_m, intensity, strict=True):
        height, width = picture.shape[:2]
        there = replace(camera, width_px=width, height_px=height)
        pixels, _, seen = there.project(points)
        if not seen.any():
            continue
        depth = transform_points(camera.camera_T_lidar, points)[:, 2]
        kept = _nearest(pixels[seen], depth[seen], width)
        rank = rankdata(strength[seen][kept], method="average") / len(kept)
        column, row = np.clip(np.floor(pixels[seen][kept]).astype(int), 0, [width - 1, height - 1]).T
        grey = picture.reshape(height, width, -1)[row, column].mean(axis=1) / 256.0
        np.add.at(joint, tuple(np.minimum((each * _BINS).astype(int), _BINS - 1) for each in (grey, rank)), 1.0)
    if not joint.any():
        return 1.0
    whole = _entropy(joint.ravel())
    return 1.0 if whole == 0 else (2 * whole - _entropy(joint.sum(axis=0)) - _entropy(joint.sum(axis=1))) / whole


def _nearest(pixels: Float[np.ndarray, "n 2"], depth: Float[np.ndarray, " n"], width: int) -> np.ndarray:
    """The nearest point of each cell: what lies behind it is hidden."""
    cell = np.floor(pixels / _CELL_PX).astype(np.int64)
    order = np.argsort(depth, kind="stable")
    _, first = np.unique((cell[:, 1] * width + cell[:, 0])[order], return_index=True)
    return order[first]


def _entropy(counts: Float[np.ndarray, " n"]) -> float:
    share = counts[counts > 0] / counts.sum()
    return float(-(share * np.log2(share)).sum())
