"""Scores of finished weights calibrated by range and points, on frames of their sources that were not learnt from."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from farfield.datasets import Dataset
from farfield.detectors.runtime import Detector
from farfield.detectors.score_bands import calibration_error, fitted_bands
from farfield.detectors.weights import load_weights, save_weights
from farfield.errors import ConfigError
from farfield.geometry.boxes import BOX_MARGIN_M, count_points_in_boxes
from farfield.metrics.centre.matching import found_by

MATCH_M = 2.0
"""A box is an object if its centre lies so near to an annotated one of its class."""


@dataclass(frozen=True, eq=False, kw_only=True)
class MatchedBoxes:
    """Boxes of which is known whether each is an object.

    Args:
        score: Their scores.
        right: 1 of an object, 0 of a false box.
        range_m: Their ranges on the ground.
        points: Points in each.
        sequence: Number of the sequence that each is of.
    """

    score: Float[np.ndarray, " n"]
    right: Float[np.ndarray, " n"]
    range_m: Float[np.ndarray, " n"]
    points: Int[np.ndarray, " n"]
    sequence: Int[np.ndarray, " n"]

    def rows(self, chosen: np.ndarray) -> "MatchedBoxes":
        """Some of them."""
        return MatchedBoxes(**{name: values[chosen] for name, values in vars(self).items()})


@dataclass(frozen=True, kw_only=True)
class CalibrationSummary:
    """Expected calibration errors on sequences on which the bands were not fitted.

    Args:
        before: Of the network's own scores.
        after: Of the calibrated ones.
        boxes: Boxes in these sequences.
    """

    before: float
    after: float
    boxes: int

    def __str__(self) -> str:
        return f"expected calibration error {self.before:.3f}, calibrated {self.after:.3f} ({self.boxes} boxes)"


def calibrate_scores(weights: Path, sources: Sequence[tuple[Dataset, str]]) -> CalibrationSummary:
    """Fit the scores' bands to held-out frames and write them into the weights.

    Half of the sequences is fitted on first, to say what that does to the others' scores; what is written is fitted on
    all of them. Weights that have bands are fitted anew.

    Args:
        weights: The weights file, which is written anew.
        sources: Annotated frames of each source under the detector's classes, and which of their clouds is read.

    Raises:
        ConfigError: If nothing was detected in them.
    """
    network, provenance = load_weights(weights)
    detector = Detector(network, score_threshold=min(network.config.score_threshold, 0.05), calibrated=False)
    matched = matched_boxes(detector, sources)
    if not len(matched.score):
        raise ConfigError(f"{weights}: expected detections in the frames to calibrate scores on; there was none.")
    odd = matched.sequence % 2 == 1
    halves = [matched.rows(~odd), matched.rows(odd)]
    error = np.zeros(2)
    for fitted, tried in (halves, halves[::-1]):
        bands = fitted_bands(fitted.score, fitted.right, fitted.range_m, fitted.points)
        share = len(tried.score) / len(matched.score)
        calibrated = bands(tried.score, tried.range_m, tried.points)
        error += share * np.array([calibration_error(score, tried.right) for score in (tried.score, calibrated)])
    bands = fitted_bands(matched.score, matched.right, matched.range_m, matched.points)
    summary = CalibrationSummary(before=float(error[0]), after=float(error[1]), boxes=len(matched.score))
    save_weights(
        weights,
        network.state_dict(),
        config=network.config.model_copy(update={"score_bands": bands}),
        provenance={**provenance, "calibration": vars(summary)},
    )
    return summary


def matched_boxes(detector: Detector, sources: Sequence[tuple[Dataset, str]]) -> MatchedBoxes:
    """What a detector gives in annotated frames, each box matched with the objects of its class.

    Args:
        detector: The detector.
        sources: Annotated frames of each source, and which of their clouds is read.
    """
    names = ("score", "right", "range_m", "points", "sequence")
    columns: dict[str, list[np.ndarray]] = {name: [np.zeros(0)] for name in names}
    sequences: dict[tuple[int, str], int] = {}
    for number, (data, cloud) in enumerate(sources):
        reader = detector.with_cloud(cloud)
        for frame in data:
            boxes, annotated = reader(frame), frame.boxes
            if annotated is None or boxes.score is None or not len(boxes):
                continue
            right = np.zeros(len(boxes))
            for label in np.unique(boxes.label):
                rows = np.flatnonzero(boxes.label == label)
                finder = found_by(boxes[rows], annotated[annotated.label == label], distance_m=MATCH_M)
                right[rows[finder[finder >= 0]]] = 1.0
            of_sequence = sequences.setdefault((number, frame.sequence), len(sequences))
            count = count_points_in_boxes(frame.cloud(cloud).points_m, boxes, margin_m=BOX_MARGIN_M)
            values = (boxes.score, right, boxes.range_m, count, np.full(len(boxes), of_sequence))
            for name, column in zip(names, values, strict=True):
                columns[name].append(column)
    joined = {name: np.concatenate(parts) for name, parts in columns.items()}
    whole = {name: joined[name].astype(np.int64) for name in ("points", "sequence")}
    return MatchedBoxes(**{**joined, **whole})
