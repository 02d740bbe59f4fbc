"""The open data set as a book of frames: what each shows, with predictions, trails and bookmarks."""

from collections.abc import Callable, Sequence
from typing import Any

from farfield.datasets.base import Dataset
from farfield.errors import ConfigError
from farfield.frame import Boxes, Drive
from farfield.frame.provenance import is_simulated
from farfield.metrics import PROTOCOLS
from farfield.studio.messages.replies import FrameState
from farfield.studio.messages.rows import BoxRow, PredictedFrame, Trail
from farfield.studio.session.bookmarks import BookmarkStore
from farfield.studio.session.trails import trails
from farfield.studio.settings import StudioSettings
from farfield.studio.showing.opened import OpenedDataset
from farfield.studio.showing.predictions import Predictions, read_set
from farfield.studio.showing.rows import annotated_rows, frame_info

Rows = Callable[[int], tuple[BoxRow, ...]]
Centres = Callable[[int], list[tuple[int, float, float, float]]]


class FrameCache:
    """Frames of a data set.

    Args:
        opened: The open data set.
        settings: What the studio was started with.
        rows: Gives the boxes of a frame where they are edited; those of the data set without it.
        centres: Gives number, x, y and z of their tracks, likewise.

    Raises:
        FarfieldError: If predictions cannot be read or belong to other frames, or the protocol is unknown.
    """

    def __init__(
        self, opened: OpenedDataset, settings: StudioSettings, rows: Rows | None = None, centres: Centres | None = None
    ) -> None:
        data = opened.data
        self.data, self.opened, self.rows, self.centres = data, opened, rows, centres
        self.protocol = settings.protocol or data.protocol
        _ = PROTOCOLS[self.protocol]
        self._drive_of = {index: drive for drive in opened.drives for index in drive.indices.tolist()}
        self.bookmarks = BookmarkStore(data.root, data.keys, settings.notes)
        self.simulated = is_simulated(data.root)
        self.first = first_of(settings.first, data)
        self.sets: dict[str, Predictions] = {}
        for place, path in enumerate(settings.predictions):
            found = read_set(path, data, format=settings.format, protocol=self.protocol, place=place)
            self.sets[found.about.name] = found

    def boxes(self, index: int) -> tuple[BoxRow, ...]:
        """The annotated boxes of a frame as they stand."""
        if self.rows is not None:
            return self.rows(index)
        frame = self.opened.frame(index)
        return () if frame.annotation is None else annotated_rows(frame.annotation, frame)

    def state(self, index: int, threshold: float = 0.0, sweeps: int = 1) -> FrameState:
        """All that a frame shows."""
        frame = self.opened.frame(index)
        layers, notes = self.opened.layers(index, sweeps)
        boxes = self.boxes(index)
        return FrameState(
            frame=frame_info(frame, index, simulated=self.simulated, extra=_facts(frame.metadata)),
            layers=layers,
            boxes=boxes,
            predicted=self.predicted(index, boxes, threshold),
            trails=self.trails(index, boxes),
            notes=notes,
        )

    def predicted(self, index: int, truth: Sequence[BoxRow], threshold: float) -> tuple[PredictedFrame, ...]:
        """What each set predicts in a frame, matched with the truth."""
        found = (self.predicted_by(each, index, truth, threshold) for each in list(self.sets.values()))
        return tuple(each for each in found if each is not None)

    def predicted_by(
        self, found: Predictions, index: int, truth: Sequence[BoxRow], threshold: float
    ) -> PredictedFrame | None:
        """What one set predicts in a frame; None where it knows nothing of it."""
        frame = self.opened.frame(index)
        return found.frame(frame.key, truth, frame.reference, threshold=threshold)

    def trails(self, index: int, boxes: Sequence[BoxRow]) -> tuple[Trail, ...]:
        """Where the tracks of a frame were and will be."""
        drive = self._drive_of.get(index)
        if drive is None:
            return ()
        tracks = [row.track for row in boxes if row.track is not None]
        found = trails("", drive, index, tracks, self._annotated) if tracks else ()
        return (*found, *(trail for each in list(self.sets.values()) for trail in self._predicted(each, drive, index)))

    def _annotated(self, index: int) -> list[tuple[int, float, float, float]]:
        if self.centres is not None:
            return self.centres(index)
        annotation = self.data.annotation(index)
        return [] if annotation is None else _centres(annotation.boxes)

    def _predicted(self, found: Predictions, drive: Drive, index: int) -> tuple[Trail, ...]:
        keys = self.data.keys
        here = found.boxes.get(keys[index])
        if here is None or here.track_id is None:
            return ()
        tracks = [int(track) for track in here.track_id if track >= 0]
        return trails(found.about.name, drive, index, tracks, lambda other: _centres(found.boxes.get(keys[other])))


def _centres(boxes: Boxes | None) -> list[tuple[int, float, float, float]]:
    if boxes is None or boxes.track_id is None:
        return []
    rows = zip(boxes.track_id.tolist(), boxes.centre_m.tolist(), strict=True)
    return [(track, x, y, z) for track, (x, y, z) in rows]


def _facts(metadata: Any) -> dict[str, str]:
    """Facts for people that are cheap to read and hold no path."""
    names = ("conditions_from", "boxes", "pair_dt_ms", "camera_dt_ms", "intensity_scale")
    return {name: str(metadata[name]) for name in names if name in metadata}


def first_of(text: str, data: Dataset) -> int:
    """The number of a frame from its number or ``sequence/frame``; 0 for nothing.

    Raises:
        ConfigError: If there is no such frame.
    """
    if not text:
        return 0
    sequence, slash, frame = text.rpartition("/")
    if slash and (sequence, frame) in data.keys:
        return data.keys.index((sequence, frame))
    if not slash and text.isdecimal() and int(text) < len(data):
        return int(text)
    if text in data.frame_ids:
        return data.frame_ids.index(text)
    example = "/".join(data.keys[0]) if len(data) else "none"
    raise ConfigError(f"frame: expected a number below {len(data)}, or sequence/frame such as {example}; got {text!r}")
