"""Sets of predicted boxes: read from files or made by a detector here, matched with the truth when they are shown."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from farfield.datasets.base import Dataset
from farfield.errors import ConfigError
from farfield.frame import Annotation, Boxes, Key
from farfield.metrics.reading import read_predictions
from farfield.studio.messages.rows import BoxRow, Match, PredictedFrame, PredictedRow, PredictionSet
from farfield.studio.showing.matching import IGNORED, MATCHED, UNSEEN, match_frame
from farfield.studio.showing.rows import boxes_of, predicted_rows

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
        known = [row for row in truth if row.state not in ("proposed", "rejected")]
        found = match_frame(self.about.protocol, boxes, Annotation(boxes=boxes_of(known)), key=key, reference=reference)
        rows = [
            _judged(row, "unknown" if found.note or not known else _WORDS.get(verdict, "false"), place, known)
            for row, verdict, place in zip(
                predicted_rows(boxes), found.verdict.tolist(), found.truth.tolist(), strict=True
            )
        ]
        return PredictedFrame(
            set=self.about.name,
            rows=tuple(rows),
            missed=tuple(row.id for row, missed in zip(known, found.missed, strict=True) if missed),
            ignored=tuple(row.id for row, counts in zip(known, found.counts, strict=True) if not counts),
        )


def _judged(row: PredictedRow, match: Match, place: int, known: Sequence[BoxRow]) -> PredictedRow:
    return replace(row, match=match, truth=known[place].id if place >= 0 else None)


def read_set(path: Path, data: Dataset, *, format: str, protocol: str, place: int) -> Predictions:
    """Read a set of predictions for a data set.

    Args:
        path: File, or folder of files.
        data: The data set in whose frames they lie, in its coordinates.
        format: One of :data:`farfield.metrics.reading.FORMATS`.
        protocol: By which they are matched.
        place: Number of the set, for its colour.

    Raises:
        ConfigError: If no frame of the data set is among theirs.
    """
    found = read_predictions(path, format=format)
    seen_in = data[0].reference
    if found.reference and found.reference != seen_in:
        raise ConfigError(
            f"{path}: expected boxes in the coordinates of {seen_in}, in which the data are shown; they stand in those "
            f"of {found.reference}. Open the data with --reference {found.reference}, or write the boxes anew"
        )
    boxes = named_as(found.boxes, data)
    if not boxes:
        theirs, ours = next(iter(found.boxes), ("", "none")), next(iter(data.keys), ("", "none"))
        raise ConfigError(
            f"{path}: expected predictions in frames of {data.root}, got none in common: the file holds {theirs}, the "
            f"data {ours}. Sequence and frame must be the same text in both."
        )
    tracked = all(part.track_id is not None for part in boxes.values())
    about = PredictionSet(
        name=f"file-{place}",
        title=path.name,
        kind="tracks" if tracked else "detections",
        classes=tuple(sorted({str(name) for part in boxes.values() for name in np.unique(part.label)})),
        frames=len(boxes),
        protocol=protocol,
        colour=colour(place),
    )
    return Predictions(about, boxes)


def named_as(boxes: Mapping[Key, Boxes], data: Dataset) -> dict[Key, Boxes]:
    """The boxes of the data set's frames; a file without sequences is taken for a data set that has only one."""
    known = set(data.keys)
    exact = {key: part for key, part in boxes.items() if key in known}
    sequences = set(data.sequences)
    if exact or len(sequences) != 1 or len({sequence for sequence, _ in boxes}) > 1:
        return exact
    only = next(iter(sequences))
    return {(only, frame): part for (_, frame), part in boxes.items() if (only, frame) in known}


def colour(place: int) -> str:
    """Colour of a set, apart from the others for everybody."""
    return _COLOURS[place % len(_COLOURS)]
