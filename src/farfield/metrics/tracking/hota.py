"""HOTA (Luiten et al., IJCV 2021) and identity F1 (Ristani et al., ECCV workshops 2016), over boxes of any similarity.

For each threshold alpha = 0.05, 0.1 ... 0.95, with the matches of a similarity of at least alpha:

    DetA = TP / (TP + FN + FP)
    AssA = mean over matches c of TPA(c) / (TPA(c) + FNA(c) + FPA(c))
    HOTA = sqrt(DetA AssA),   all averaged over alpha

TPA(c) counts the frames in which the two tracks of c match each other, FNA and FPA those in which only one of them is
there. Identity F1 pairs whole tracks one to one so that the frames in common, IDTP, are most:

    IDF1 = 2 IDTP / (annotated boxes + predicted boxes)

Before both, predicted boxes that lie on ignored annotated ones (similarity of 0.5 or more), or that match nothing and
are excused, are taken away with the ignored boxes, as TrackEval does for KITTI. HOTA then matches each frame once,
whatever the threshold, by similarity times how well the two tracks fit as wholes.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment

from farfield.metrics.tracking.clear import Figures
from farfield.metrics.tracking.scene import TrackingScene, best_pairs

ALPHAS = np.arange(0.05, 0.99, 0.05)
_ON_IGNORED = 0.5
_EPSILON = float(np.finfo(float).eps)
_NAMES = ("HOTA", "DetA", "AssA", "DetRe", "DetPr", "AssRe", "AssPr", "LocA")


def without_ignored(scene: TrackingScene) -> TrackingScene:
    """The boxes that count for HOTA and identity F1."""
    near = np.flatnonzero(scene.similarity >= _ON_IGNORED - _EPSILON)
    a, b = scene.pair[near].T
    chosen = best_pairs(a, b, scene.similarity[near], scene.annotated.frame[a])
    a, b = a[chosen], b[chosen]
    away = scene.predicted.aside.copy()
    away[b] = scene.annotated.aside[a]
    return scene.cut(~scene.annotated.aside, ~away)


class Hota:
    """HOTA's matching of a whole data set, from which figures of all and of range bins are drawn.

    Args:
        scene: Boxes that count, see :func:`without_ignored`.
    """

    def __init__(self, scene: TrackingScene) -> None:
        self.scene = scene
        a, b = scene.pair.T
        rows = np.bincount(a, scene.similarity, minlength=len(scene.annotated))
        columns = np.bincount(b, scene.similarity, minlength=len(scene.predicted))
        alignment = scene.similarity / (rows[a] + columns[b] - scene.similarity)
        self.lengths = _lengths(scene.annotated.track), _lengths(scene.predicted.track)
        of_pair, number = _track_pairs(scene)
        alike = np.bincount(number, alignment, minlength=len(of_pair))
        fit = alike / (self._spans(of_pair) - alike)
        gain = fit[number] * scene.similarity
        chosen = best_pairs(a, b, gain, scene.annotated.frame[a])
        self.a, self.b, self.similarity = a[chosen], b[chosen], scene.similarity[chosen]
        self.of_pair, self.number = of_pair, number[chosen]

    def _spans(self, of_pair: Int[np.ndarray, "k 2"]) -> Float[np.ndarray, " k"]:
        """Frames of both tracks of each pair of tracks, added."""
        return (self.lengths[0][of_pair[:, 0]] + self.lengths[1][of_pair[:, 1]]).astype(np.float64)

    def figures(self, bin_m: tuple[float, float] | None = None) -> Figures:
        """Figures of all boxes or of a range bin, means over the thresholds; None where nothing is annotated."""
        here = _inside(self.scene.annotated.range_m, bin_m)
        if not here.any():
            return dict.fromkeys(_NAMES)
        at = np.array([self._at(alpha, here, bin_m) for alpha in ALPHAS])
        return dict(zip(_NAMES, at.mean(axis=0).tolist(), strict=True))

    def _at(self, alpha: float, here: Bool[np.ndarray, " m"], bin_m: tuple[float, float] | None) -> tuple[float, ...]:
        hit = self.similarity >= alpha - _EPSILON
        counted = hit & here[self.a]
        true = int(counted.sum())
        missed = int(here.sum()) - true
        is_matched = np.zeros(len(self.scene.predicted), dtype=bool)
        is_matched[self.b[hit]] = True
        false = int((_inside(self.scene.predicted.range_m, bin_m) & ~is_matched).sum())
        common = np.bincount(self.number[hit], minlength=len(self.of_pair)).astype(np.float64)
        pairs = self.number[counted]
        shares = [
            float((common / np.maximum(spans, 1))[pairs].sum() / max(true, 1))
            for spans in (
                self._spans(self.of_pair) - common,
                self.lengths[0][self.of_pair[:, 0]],
                self.lengths[1][self.of_pair[:, 1]],
            )
        ]
        detected = true / max(true + missed + false, 1)
        localisation = float(self.similarity[counted].sum() / true) if true else 1.0
        recall, precision = true / max(true + missed, 1), true / max(true + false, 1)
        return (float(np.sqrt(detected * shares[0])), detected, shares[0], recall, precision, *shares[1:], localisation)


def identity_f1(scene: TrackingScene, least: float) -> float | None:
    """Identity F1: the share of boxes that bear the one right identity; None where nothing is annotated.

    Args:
        scene: Boxes that count, see :func:`without_ignored`.
        least: Similarity from which two boxes are the same.
    """
    if not len(scene.annotated):
        return None
    of_pair, number = _track_pairs(scene)
    common = np.bincount(number[scene.similarity >= least], minlength=len(of_pair))
    worth = np.zeros([len(_lengths(rows.track)) for rows in (scene.annotated, scene.predicted)])
    worth[tuple(of_pair.T)] = common
    right = float(worth[linear_sum_assignment(worth, maximize=True)].sum())
    return 2 * right / (len(scene.annotated) + len(scene.predicted))


def _inside(range_m: Float[np.ndarray, " n"], bin_m: tuple[float, float] | None) -> Bool[np.ndarray, " n"]:
    low, high = bin_m or (0.0, np.inf)
    return (range_m >= low) & (range_m < high)


def _lengths(track: Int[np.ndarray, " n"]) -> Int[np.ndarray, " t"]:
    return np.bincount(track, minlength=1)


def _track_pairs(scene: TrackingScene) -> tuple[Int[np.ndarray, "k 2"], Int[np.ndarray, " p"]]:
    """Pairs of tracks that touch, and which of them each pair of boxes belongs to."""
    named = np.column_stack([scene.annotated.track[scene.pair[:, 0]], scene.predicted.track[scene.pair[:, 1]]])
    of_pair, number = np.unique(named, axis=0, return_inverse=True)
    return of_pair, number.reshape(-1)
