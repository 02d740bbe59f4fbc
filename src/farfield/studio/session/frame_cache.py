"""The open data set as a book of frames: what each shows, with predictions, trails and bookmarks."""

import hashlib
import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from farfield.datasets.base import Dataset
from farfield.errors import ConfigError, FileFormatError, plain
from farfield.files.atomic import read_bytes, write_text
from farfield.files.json_text import plain_json
from farfield.frame import Boxes, Drive, Key
from farfield.frame.provenance import is_simulated
from farfield.geometry.poses import invert, transform_points
from farfield.metrics import PROTOCOLS
from farfield.studio.messages.replies import FrameState
from farfield.studio.messages.rows import Bookmark, BoxRow, FrameInfo, PredictedFrame, Trail
from farfield.studio.options import StudioSettings
from farfield.studio.showing.opened import OpenedDataset
from farfield.studio.showing.predictions import Predictions, read_set
from farfield.studio.showing.rows import annotated_rows, frame_info
from farfield.studio.threads import Cache

Centres = Callable[[int], Sequence[tuple[int, float, float, float]]]
"""Track number and centre of each box of a frame that has one."""
_FACTS = ("conditions_from", "boxes", "pair_dt_ms", "camera_dt_ms", "intensity_scale")
"""Of a frame's metadata: cheap to read, and without a path."""
Rows = Callable[[int], tuple[BoxRow, ...]]
_KEPT_FRAMES = 1000
"""Frames whose centres stay in memory: the trails of a frame need those of twenty others."""


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
        self._truth: Cache[Sequence[tuple[int, float, float, float]]] = Cache(_KEPT_FRAMES, lambda _: 1)
        self._drive_of = {index: drive for drive in opened.drives for index in drive.indices.tolist()}
        self.bookmarks = BookmarkStore(data.root, data.keys, settings.notes)
        self.simulated = is_simulated(data.root)
        self.first = first_of(settings.first, data)
        self.sets: dict[str, Predictions] = {}
        for number, path in enumerate(settings.predictions):
            predictions = read_set(path, data, format=settings.format, protocol=self.protocol, number=number)
            self.sets[predictions.about.name] = predictions

    def boxes(self, index: int) -> tuple[BoxRow, ...]:
        """The annotated boxes of a frame as they stand."""
        if self.rows is not None:
            return self.rows(index)
        frame = self.opened.frame(index)
        return () if frame.annotation is None else annotated_rows(frame.annotation, index, frame)

    def state(self, index: int, threshold: float = 0.0, sweeps: int = 1) -> FrameState:
        """All that a frame shows."""
        frame = self.opened.frame(index)
        layers, notes = self.opened.layers(index, sweeps)
        facts = {name: str(frame.metadata[name]) for name in _FACTS if name in frame.metadata}
        boxes = self.boxes(index)
        return FrameState(
            frame=frame_info(frame, index, simulated=self.simulated, extra=facts),
            layers=layers,
            boxes=boxes,
            predicted=self.predicted(index, boxes, threshold),
            trails=self.trails(index, boxes),
            notes=notes,
        )

    def unreadable(self, index: int, reason: str) -> FrameState:
        """What stands in the place of a frame that cannot be read: nothing of it, and why."""
        sequence, frame_id = self.data.keys[index]
        frame = FrameInfo(index=index, sequence=sequence, frame_id=frame_id, time_ns=None, annotated=False)
        return FrameState(frame=frame, layers=(), boxes=(), unreadable=reason)

    def predicted(self, index: int, truth: Sequence[BoxRow], threshold: float) -> tuple[PredictedFrame, ...]:
        """What each set predicts in a frame, matched with the truth."""
        frames = (self.predicted_by(frame, index, truth, threshold) for frame in list(self.sets.values()))
        return tuple(frame for frame in frames if frame is not None)

    def predicted_by(
        self, predictions: Predictions, index: int, truth: Sequence[BoxRow], threshold: float
    ) -> PredictedFrame | None:
        """What one set predicts in a frame; None where it knows nothing of it."""
        frame = self.opened.frame(index)
        return predictions.frame(frame.key, truth, frame.reference, threshold=threshold)

    def trails(self, index: int, boxes: Sequence[BoxRow]) -> tuple[Trail, ...]:
        """Where the tracks of a frame were and will be."""
        drive = self._drive_of.get(index)
        if drive is None:
            return ()
        tracks = [row.track for row in boxes if row.track is not None]
        annotated = trails("", drive, index, tracks, self._annotated) if tracks else ()
        return (
            *annotated,
            *(
                trail
                for predictions in list(self.sets.values())
                for trail in self._predicted(predictions, drive, index)
            ),
        )

    def _annotated(self, index: int) -> Sequence[tuple[int, float, float, float]]:
        if self.centres is not None:
            return self.centres(index)
        return self._truth.get(index, lambda: self._read_centres(index))

    def _read_centres(self, index: int) -> Sequence[tuple[int, float, float, float]]:
        annotation = self.data.annotation(index)
        return [] if annotation is None else _centres(annotation.boxes)

    def _predicted(self, predictions: Predictions, drive: Drive, index: int) -> tuple[Trail, ...]:
        keys = self.data.keys
        boxes = predictions.boxes.get(keys[index])
        if boxes is None or boxes.track_id is None:
            return ()
        tracks = [int(track) for track in boxes.track_id if track >= 0]
        return trails(
            predictions.about.name, drive, index, tracks, lambda other: _centres(predictions.boxes.get(keys[other]))
        )


def _centres(boxes: Boxes | None) -> list[tuple[int, float, float, float]]:
    if boxes is None or boxes.track_id is None:
        return []
    rows = zip(boxes.track_id.tolist(), boxes.centre_m.tolist(), strict=True)
    return [(track, x, y, z) for track, (x, y, z) in rows]


_NUMBER_DIGITS = 10
"""No data set has so many frames; int() refuses thousands of digits."""


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
    if not slash and text.isdecimal() and len(text) < _NUMBER_DIGITS and int(text) < len(data):
        return int(text)
    if text in data.frame_ids:
        return data.frame_ids.index(text)
    example = "/".join(data.keys[0]) if len(data) else "none"
    raise ConfigError(f"frame: expected a number below {len(data)}, or sequence/frame such as {example}; got {text!r}")


AROUND = 10
"""Frames before and after."""


def trails(name: str, drive: Drive, index: int, tracks: Sequence[int], centres: Centres) -> tuple[Trail, ...]:
    """The trails of some tracks.

    Args:
        name: Of the set, empty for annotations.
        drive: The drive that holds the frame; without poses its centres stay in their frames' own coordinates.
        index: The frame shown.
        tracks: Numbers of the tracks.
        centres: Gives the boxes of any frame.
    """
    row = int(np.flatnonzero(drive.indices == index)[0])
    points: dict[int, list[tuple[int, float, float, float]]] = {track: [] for track in tracks}
    for other in range(max(row - AROUND, 0), min(row + AROUND + 1, len(drive.indices))):
        frame = int(drive.indices[other])
        boxes = [box for box in centres(frame) if box[0] in points]
        if boxes:
            centres_m = _seen_from(drive, row, other, np.array([box[1:] for box in boxes]))
            for box, (x, y, z) in zip(boxes, centres_m.tolist(), strict=True):
                points[box[0]].append((frame, x, y, z))
    return tuple(Trail(set=name, track=track, points=tuple(trail)) for track, trail in points.items() if trail)


def _seen_from(drive: Drive, row: int, other: int, centres_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    if drive.world_T_frame is None or row == other:
        return centres_m
    return transform_points(invert(drive.world_T_frame[row]) @ drive.world_T_frame[other], centres_m)


_MAX_BYTES = 16 << 20


def data_folder() -> Path:
    """The user's data folder of Farfield, ``XDG_DATA_HOME/farfield`` or ``~/.local/share/farfield``."""
    folder = os.environ.get("XDG_DATA_HOME", "")
    return (Path(folder) if folder else Path.home() / ".local" / "share") / "farfield"


class BookmarkStore:
    """Frames to come back to.

    Args:
        root: Folder of the data set.
        keys: (sequence, frame) of its frames, by which bookmarks are kept: numbers change as frames are added.
        folder: Where they are kept (default: the user's data folder).
    """

    def __init__(self, root: Path, keys: tuple[Key, ...], folder: Path | None = None) -> None:
        name = hashlib.blake2b(os.fsencode(root.resolve()), digest_size=8).hexdigest()
        self.path = (folder or data_folder() / "bookmarks") / f"{name}.json"
        self._keys = keys
        self._index = {key: index for index, key in enumerate(keys)}
        self._rows: dict[Key, tuple[str, str]] = self._read()

    def _read(self) -> dict[Key, tuple[str, str]]:
        if not self.path.is_file():
            return {}
        try:
            rows = plain_json(read_bytes(self.path, max_bytes=_MAX_BYTES))["bookmarks"]
            return {(str(r["sequence"]), str(r["frame"])): (str(r["note"]), str(r["by"])) for r in rows}
        except (ValueError, KeyError, TypeError) as error:
            expected = "bookmarks"
            raise FileFormatError(self.path, where="the file", expected=expected, got=plain(error)) from error

    def set(self, frame: int, note: str | None, by: str) -> None:
        """Set the bookmark of a frame; None takes it away. Written at once."""
        key = self._keys[frame]
        if note is None:
            self._rows.pop(key, None)
        else:
            self._rows[key] = note, by
        rows = [{"sequence": key[0], "frame": key[1], "note": note, "by": by} for key, (note, by) in self._rows.items()]
        self.path.parent.mkdir(parents=True, exist_ok=True)
        write_text(self.path, json.dumps({"bookmarks": rows}, indent=1) + "\n")

    def rows(self) -> tuple[Bookmark, ...]:
        """The bookmarks of the frames that are there, in their order."""
        bookmarks = [(self._index[key], *rest) for key, rest in self._rows.items() if key in self._index]
        return tuple(Bookmark(frame=frame, note=note, by=by) for frame, note, by in sorted(bookmarks))
