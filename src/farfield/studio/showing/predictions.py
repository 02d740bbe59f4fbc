"""Sets of predicted boxes, read from files or made by a detector here, and matched with the truth when they are shown.

A frame is matched as the protocol does that scores it. By centre distance (dds, nuscenes): predictions take turns by
falling score, each takes the nearest free box within the distance at which errors are taken, 2 m unless set. By overlap
(kradar and its variants, kitti): annotated boxes choose in their order the free prediction that overlaps most in space
and more than the least overlap, as at the lowest score threshold. What the protocol leaves out (another class, outside
its region) is neither right nor wrong.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.datasets.base import Dataset
from farfield.errors import ConfigError, FarfieldError
from farfield.frame import Annotation, Boxes, Key
from farfield.metrics import PROTOCOLS, Detections, Protocol
from farfield.metrics.box_files import read_predictions
from farfield.metrics.centre.evaluation import gather, match_boxes
from farfield.metrics.centre.matching import DROPPED
from farfield.metrics.centre.settings import CentreSettings
from farfield.metrics.kitti.evaluation import KittiSettings, gather_kitti
from farfield.metrics.kradar.frames import gather_kradar
from farfield.metrics.kradar.settings import KRadarSettings
from farfield.studio.messages.rows import BoxRow, Match, PredictedFrame, PredictionSet
from farfield.studio.showing.rows import boxes_of, predicted_rows

UNSEEN, FALSE, MATCHED, IGNORED = 0, 1, 2, 3
_COLOURS = ("#e69f00", "#56b4e9", "#009e73", "#cc79a7", "#d55e00", "#f0e442")  # Okabe and Ito
_WORDS: dict[int, Match] = {UNSEEN: "ignored", IGNORED: "ignored", MATCHED: "matched"}


@dataclass(eq=False)
class Predictions:
    """One set.

    Args:
        about: What it is called.
        boxes: Scored boxes by (sequence, frame); a detector's grow while it runs.
    """

    about: PredictionSet
    boxes: dict[Key, Boxes] = field(default_factory=dict)

    def frame(
        self, key: Key, truth: Sequence[BoxRow], reference: str, *, threshold: float = 0.0
    ) -> PredictedFrame | None:
        """What it predicts in a frame, matched; None where nothing is known of the frame.

        Args:
            key: The frame.
            truth: The annotated boxes as they stand now; rejected ones and open proposals do not count.
            reference: Name of the coordinates of both.
            threshold: Boxes of a lower score are left out.
        """
        boxes = self.boxes.get(key)
        if boxes is None:
            return None
        if boxes.score is not None:
            boxes = boxes[np.argsort(-boxes.score, kind="stable")]
            boxes = boxes[boxes.score >= threshold] if boxes.score is not None else boxes
        annotated = [row for row in truth if row.state not in ("proposed", "rejected")]
        matching = match_frame(
            self.about.protocol, boxes, Annotation(boxes=boxes_of(annotated)), key=key, reference=reference
        )
        rows = [
            replace(
                row,
                match="unknown" if matching.note or not annotated else _WORDS.get(verdict, "false"),
                truth=annotated[annotated_row].id if annotated_row >= 0 else None,
            )
            for row, verdict, annotated_row in zip(
                predicted_rows(boxes), matching.verdict.tolist(), matching.truth.tolist(), strict=True
            )
        ]
        return PredictedFrame(
            set=self.about.name,
            rows=tuple(rows),
            missed=tuple(row.id for row, missed in zip(annotated, matching.missed, strict=True) if missed),
            ignored=tuple(row.id for row, counts in zip(annotated, matching.counts, strict=True) if not counts),
        )


def read_set(path: Path, data: Dataset, *, format: str, protocol: str, number: int) -> Predictions:
    """Read a set of predictions for a data set.

    Args:
        path: File, or folder of files.
        data: The data set in whose frames they lie, in its coordinates.
        format: One of :data:`farfield.metrics.box_files.FORMATS`.
        protocol: By which they are matched.
        number: Number of the set, for its colour.

    Raises:
        ConfigError: If no frame of the data set is among theirs.
    """
    predictions = read_predictions(path, format=format)
    seen_in = data[0].reference
    if predictions.reference and predictions.reference != seen_in:
        raise ConfigError(
            f"{path}: expected boxes in the coordinates of {seen_in}, in which the data are shown; they stand in those "
            f"of {predictions.reference}. Open the data with --reference {predictions.reference}, or write the boxes "
            "anew"
        )
    boxes = boxes_of_frames(predictions.boxes, data)
    if not boxes:
        file_key, data_key = next(iter(predictions.boxes), ("", "none")), next(iter(data.keys), ("", "none"))
        raise ConfigError(
            f"{path}: expected predictions in frames of {data.root}, got none in common: the file holds {file_key}, "
            f"the data {data_key}. Sequence and frame must be the same text in both."
        )
    tracked = all(part.track_id is not None for part in boxes.values())
    about = PredictionSet(
        name=f"file-{number}",
        title=path.name,
        kind="tracks" if tracked else "detections",
        classes=tuple(sorted({str(name) for part in boxes.values() for name in np.unique(part.label)})),
        frames=len(boxes),
        protocol=protocol,
        colour=colour(number),
    )
    return Predictions(about, boxes)


def boxes_of_frames(boxes: Mapping[Key, Boxes], data: Dataset) -> dict[Key, Boxes]:
    """The boxes of the data set's frames; a file without sequences is taken for a data set that has only one."""
    keys = set(data.keys)
    exact = {key: part for key, part in boxes.items() if key in keys}
    sequences = set(data.sequences)
    if exact or len(sequences) != 1 or len({sequence for sequence, _ in boxes}) > 1:
        return exact
    only = next(iter(sequences))
    return {(only, frame): part for (_, frame), part in boxes.items() if (only, frame) in keys}


def colour(number: int) -> str:
    """Colour of a set, apart from the others for everybody."""
    return _COLOURS[number % len(_COLOURS)]


# Matching


@dataclass(frozen=True, eq=False)
class FrameMatching:
    """What a protocol makes of a frame.

    Args:
        verdict: Of each of n predictions: UNSEEN (the protocol does not look at it), FALSE, MATCHED or IGNORED.
        truth: The annotated box that each found, or -1, shape (n,).
        missed: Annotated boxes that must be found and were not, shape (m,).
        counts: Annotated boxes that must be found, shape (m,).
        note: Why nothing was matched; empty where it was.
    """

    verdict: Int[np.ndarray, " n"]
    truth: Int[np.ndarray, " n"]
    missed: Bool[np.ndarray, " m"]
    counts: Bool[np.ndarray, " m"]
    note: str = ""


def match_frame(protocol: str, predicted: Boxes, annotation: Annotation, *, key: Key, reference: str) -> FrameMatching:
    """Match the predictions of one frame.

    Args:
        protocol: Name of the protocol, such as ``"kradar"``.
        predicted: n boxes; those without scores count with 1.
        annotation: m annotated boxes of the same frame, in the same coordinates.
        key: The frame.
        reference: Name of the coordinates.
    """
    n, m = len(predicted), len(annotation)
    verdict, truth = np.zeros(n, dtype=np.int64), np.full(n, -1)
    counts, missed = np.zeros(m, dtype=bool), np.zeros(m, dtype=bool)
    scored = predicted if predicted.score is not None else predicted.replace(score=np.ones(n))
    detections = Detections(boxes={key: scored}, annotations={key: annotation}, reference=reference)
    note = ""
    try:
        for part in _class_verdicts(PROTOCOLS[protocol], detections.counted()):
            rows, boxes = (
                _match_rows(part.predicted, _numbers(scored)),
                _match_rows(part.annotated, _numbers(annotation.boxes)),
            )
            verdict[rows], truth[rows] = part.verdict, np.append(boxes, -1)[part.truth]
            counts[boxes] |= part.counts
            missed[boxes] |= part.counts & ~np.isin(np.arange(len(boxes)), part.truth)
    except FarfieldError as error:
        note = f"predictions are not matched: {error}"
    return FrameMatching(verdict, truth, missed, counts, note)


@dataclass(frozen=True, eq=False)
class _ClassVerdicts:
    """One class as the protocol saw it: boxes as rows of 7 numbers, verdicts, and rows of annotated boxes."""

    predicted: Float[np.ndarray, "n 7"]
    annotated: Float[np.ndarray, "m 7"]
    verdict: Int[np.ndarray, " n"]
    truth: Int[np.ndarray, " n"]
    counts: Bool[np.ndarray, " m"]


def _class_verdicts(protocol: Protocol, detections: Detections) -> Iterator[_ClassVerdicts]:
    if "label" not in protocol.options():
        yield from _by(protocol, detections, protocol.settings(detections))
        return
    names = dict.fromkeys([*protocol.labels(detections.annotated), *protocol.labels(detections.boxes)])
    for name in names:
        yield from _by(protocol, detections, protocol.settings(detections, label=name))


def _by(protocol: Protocol, detections: Detections, settings: Any) -> Iterator[_ClassVerdicts]:
    if isinstance(settings, CentreSettings):
        yield _by_centre(detections, settings)
    elif isinstance(settings, KRadarSettings):
        yield from _by_kradar(detections, settings)
    elif isinstance(settings, KittiSettings):
        yield _by_kitti(detections, settings)
    else:
        raise FarfieldError(f"protocol {protocol} does not say how it matches a frame; choose dds, kradar or kitti")


def _by_centre(detections: Detections, settings: CentreSettings) -> _ClassVerdicts:
    boxes = gather(detections.boxes, detections.annotated, settings)
    matches = match_boxes(boxes, settings).assigned[settings.epsilons[0], settings.error_thresholds_m[-1]]
    verdict = np.where(matches >= 0, MATCHED, np.where(matches == DROPPED, IGNORED, FALSE))
    truth = np.where(matches >= 0, matches, -1)
    return _ClassVerdicts(_numbers(boxes.predicted), _numbers(boxes.annotated), verdict, truth, ~boxes.ignored)


def _by_kradar(detections: Detections, settings: KRadarSettings) -> Iterator[_ClassVerdicts]:
    data = gather_kradar(detections.boxes, detections.annotated, settings, None)
    shift = np.zeros(7)
    shift[:3] = settings.origin_m if settings.boxes_in == "os2-64" else 0.0
    enough = data.overlap["3d"] > settings.ious[0]
    truth = _assign_by_overlap(data.pair[enough], data.overlap["3d"][enough], len(data.predicted))
    verdict = np.where(truth >= 0, MATCHED, FALSE)
    counts = np.ones(len(data.annotated), dtype=bool)
    yield _ClassVerdicts(data.predicted.box + shift, data.annotated.box + shift, verdict, truth, counts)


def _by_kitti(detections: Detections, settings: KittiSettings) -> _ClassVerdicts:
    data = gather_kitti(detections.boxes, detections.annotated, settings, {}, None)
    enough = data.overlap["3d"] > settings.least_overlap
    truth = _assign_by_overlap(data.pair[enough], data.overlap["3d"][enough], len(data.predicted))
    right = data.is_label[truth] & (truth >= 0) if len(data.is_label) else np.zeros(len(truth), dtype=bool)
    verdict = np.where(right, MATCHED, np.where(truth >= 0, IGNORED, FALSE))
    return _ClassVerdicts(_numbers(data.predicted), _numbers(data.annotated), verdict, truth, data.is_label)


def _assign_by_overlap(
    pair: Int[np.ndarray, "p 2"], overlap: Float[np.ndarray, " p"], predictions: int
) -> Int[np.ndarray, " n"]:
    """The annotated box of each prediction, or -1: boxes choose in their order what overlaps most and is free."""
    truth = np.full(predictions, -1)
    for box in np.unique(pair[:, 0]):
        rows = np.flatnonzero((pair[:, 0] == box) & (truth[pair[:, 1]] < 0))
        if len(rows):
            truth[pair[rows[overlap[rows].argmax()], 1]] = box
    return truth


def _numbers(boxes: Boxes) -> Float[np.ndarray, "n 7"]:
    return np.column_stack([boxes.centre_m, boxes.size_m, boxes.yaw_rad])


def _match_rows(rows: Float[np.ndarray, "k 7"], among: Float[np.ndarray, "n 7"]) -> Int[np.ndarray, " k"]:
    """Where rows stand among others that hold all of them, to the rounding of a shift; equal ones in their order."""
    places = np.zeros(len(rows), dtype=np.int64)
    free = np.ones(len(among), dtype=bool)
    for row, values in enumerate(rows):
        apart = np.where(free, np.abs(among - values).sum(axis=1), np.inf)
        places[row] = apart.argmin()
        free[places[row]] = False
    return places
