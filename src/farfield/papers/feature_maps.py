"""Features before and after an adaptation: two axes of each for a picture, and how well a line tells the domains."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.adaptation.probes import OccupiedFeatures, occupied_features
from farfield.detectors.runtime import Detector
from farfield.papers.grid import Score, Tree
from farfield.papers.locations import DataLocation
from farfield.vocabulary.patterns import PATTERNS

FRAMES = 6
"""Frames that are looked at, each of another road where there are so many."""
SHOWN = 400
"""Cells of each domain in a picture."""
PAIRS = {"range": ("gaussian", "range"), "pattern": ("both_shuffled", "pattern_reversal")}
"""What tells the domains apart: the run before its adaptation, and the run after."""
_RIDGE = 1e-3
_DIGITS = 4

Rows = Float[np.ndarray, "n c"]
Mask = Bool[np.ndarray, " n"]


def feature_maps(weights: Mapping[str, Path], location: DataLocation, score: Score) -> list[Tree]:
    """Features of every pair of runs that is there, as JSON values.

    Args:
        weights: Weights of the first seed by run.
        location: The frames that runs are scored on.
        score: How runs are scored: its ranges tell near from far.
    """
    data = location.open()
    first = {sequence: index for index, (sequence, _) in reversed([*enumerate(data.keys)])}
    frames = [data[index] for index in sorted(first.values())[:FRAMES]]
    pairs = []
    for by, runs in PAIRS.items():
        if all(run in weights for run in runs) and len(frames) > 1:
            sides = [_side(*_features(by, weights[run], frames, score)) for run in runs]
            pairs.append({"by": by, "runs": list(runs), "sides": sides})
    return pairs


def _features(
    by: str, weights: Path, frames: list[Any], score: Score
) -> tuple[OccupiedFeatures, Mask, tuple[str, str]]:
    """Features, which of them are of the second domain, and the names of both."""
    detector = Detector.load(weights)
    if by == "range":
        edges_m = score.edges_m("III") or (0.0, 100.0, 250.0)
        features = occupied_features(detector, frames, PATTERNS[0])
        names = (f"nearer than {edges_m[1]:g} m", f"{edges_m[1]:g} m and farther")
        return features, features.range_m >= edges_m[1], names
    by_pattern = [occupied_features(detector, frames, cloud) for cloud in PATTERNS]
    features = OccupiedFeatures(
        values=np.concatenate([pattern.values for pattern in by_pattern]),
        range_m=np.concatenate([pattern.range_m for pattern in by_pattern]),
        frame=np.concatenate([pattern.frame for pattern in by_pattern]),
    )
    return features, np.repeat([False, True], [len(pattern.range_m) for pattern in by_pattern]), PATTERNS


def _side(features: OccupiedFeatures, second: Mask, names: tuple[str, str]) -> Tree:
    axes = principal(features.values)
    rng = np.random.default_rng(0)
    domains = {}
    for name, mask in zip(names, (~second, second), strict=True):
        rows = np.sort(rng.permutation(np.flatnonzero(mask))[:SHOWN])
        domains[name] = np.round(axes[rows], _DIGITS).tolist()
    return {"domains": domains, "probe": probe_accuracy(features.values, second, features.frame)}


def principal(values: Rows) -> Float[np.ndarray, "n 2"]:
    """The two axes along which rows vary most, each number scaled to a spread of 1 first, shape (n, 2)."""
    scaled = _scaled(values, values)
    _, vectors = np.linalg.eigh(scaled.T @ scaled)
    chosen = vectors[:, ::-1][:, :2]
    signs = np.sign(chosen[np.abs(chosen).argmax(axis=0), np.arange(chosen.shape[1])])  # eigenvectors have no sign
    return np.asarray(scaled @ (chosen * signs))


def probe_accuracy(values: Rows, second: Mask, frame: Int[np.ndarray, " n"]) -> float | None:
    """Balanced accuracy of a linear probe that learns on every other frame and is tried on the rest.

    Args:
        values: Features, shape (n, c).
        second: Which are of the second domain, shape (n,).
        frame: Number of the frame of each, shape (n,).

    Returns:
        0.5 where a line cannot tell the domains, 1 where it always can; None where one half lacks a domain.
    """
    learnt = frame % 2 == 0
    if not all(len(np.unique(second[half])) == len((False, True)) for half in (learnt, ~learnt)):
        return None
    rows = np.column_stack([_scaled(values, values[learnt]), np.ones(len(values))])
    share = second[learnt].mean()
    weight = np.where(second[learnt], 0.5 / share, 0.5 / (1 - share))  # both domains weigh alike
    gram = (rows[learnt].T * weight) @ rows[learnt]
    gram += _RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram))
    line = np.linalg.solve(gram, (rows[learnt].T * weight) @ np.where(second[learnt], 1.0, -1.0))
    predicted, true = rows[~learnt] @ line > 0, second[~learnt]
    return round(float((predicted[true].mean() + (~predicted[~true]).mean()) / 2), _DIGITS)


def _scaled(values: Rows, reference: Float[np.ndarray, "m c"]) -> Rows:
    spread = reference.std(axis=0)
    return np.asarray((values - reference.mean(axis=0)) / np.where(spread > 0, spread, 1.0))
