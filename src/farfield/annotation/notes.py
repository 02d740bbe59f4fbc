"""What the journal keeps beside boxes: the extent, findings let stand, bookmarks, the time that boxes took."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from functools import partial
from typing import NamedTuple

from farfield.annotation.errors import RefusedError
from farfield.annotation.store import EXTENT, Author, EditResult, Store, no_change
from farfield.datasets.edits import CellEdit
from farfield.frame import Key

IGNORED, BOOKMARK, TIMING = "ignored", "bookmark", "timing"
LONGEST_NOTE = 2000
LONGEST_PAUSE_S = 60.0
"""A pause that is longer was no work on a box."""


def declare_extent(store: Store, author: Author, id: str, extent: str) -> EditResult:
    """Say once what the boxes of the data set hold: whole bodies (``full``) or visible parts (``visible``).

    Raises:
        RefusedError: If it is neither, or the other was declared before.
    """
    return store.edit(author, id, "extent", partial(_extent, extent=extent))


_WORDS = {"full": "whole bodies", "visible": "visible parts"}


def _extent(store: Store, extent: str) -> Sequence[CellEdit]:
    if extent not in _WORDS:
        raise RefusedError("extent", f"expected full or visible, got {extent!r}")
    if store.extent is not None and store.extent != extent:
        sentence = f"the boxes of this data set hold {_WORDS[store.extent]}: that was declared before the first of them"
        raise RefusedError("extent", sentence, "Annotate the other kind in a copy of the data set.")
    return [] if store.extent == extent else [store.change(EXTENT, extent)]


def ignore(store: Store, author: Author, id: str, finding: str, reason: str) -> EditResult:
    """Let a finding stand, with a reason; an empty reason brings it back.

    Raises:
        RefusedError: If the reason is too long.
    """
    return store.edit(author, id, "check.ignore", partial(_note, cell=(IGNORED, finding), text=reason.strip() or None))


def _note(store: Store, cell: tuple[str, ...], text: str | None) -> Sequence[CellEdit]:
    if text is not None and len(text) > LONGEST_NOTE:
        raise RefusedError("note", f"expected at most {LONGEST_NOTE} characters, got {len(text)}")
    return [store.change(cell, text)] if store.value(cell) != text else []


def ignored_findings(store: Store) -> Mapping[str, str]:
    """Reasons by finding."""
    return {cell[1]: str(standing.value) for cell, standing in store.state.of_kind(IGNORED) if standing.value}


def bookmark(store: Store, author: Author, id: str, key: Key, note: str | None) -> EditResult:
    """Bookmark a frame; None takes the bookmark away.

    Raises:
        RefusedError: If there is no such frame, or the note is too long.
    """
    return store.edit(author, id, "bookmark", partial(_bookmark, key=key, note=note))


def _bookmark(store: Store, key: Key, note: str | None) -> Sequence[CellEdit]:
    if key not in store.index_of:
        raise RefusedError("frame", f"there is no frame {'/'.join(key)}")
    return _note(store, (BOOKMARK, *key), note)


class Mark(NamedTuple):
    """A bookmark: the frame, what is to be seen there, who set it."""

    key: Key
    note: str
    by: str


def bookmarks(store: Store) -> tuple[Mark, ...]:
    """All bookmarks in the order of the frames."""
    marks = [
        Mark((cell[1], cell[2]), standing.value, standing.by)
        for cell, standing in store.state.of_kind(BOOKMARK)
        if standing.value is not None and cell[1:3] in store.index_of  # a frame may have gone
    ]
    return tuple(sorted(marks, key=partial(_place, store)))


def _place(store: Store, mark: Mark) -> int:
    return store.index_of[mark.key]


def record_time(store: Store, author: Author, id: str, key: Key, name: str, seconds: float, edits: int) -> EditResult:
    """Record how long an annotator worked on a box, from its selection to the next one.

    Args:
        store: The annotation.
        author: Who.
        id: The client's name of the message.
        key: The frame.
        name: The box.
        seconds: Time; pauses above a minute cut, see :class:`Stopwatch`.
        edits: How many edits of it were made meanwhile.

    Raises:
        RefusedError: If the time is not one.
    """
    if not 0 <= seconds < 86_400:
        raise RefusedError("time", f"expected seconds of a day, got {seconds}")
    data = {"frame": list(key), "box": name, "seconds": round(float(seconds), 3), "edits": int(edits)}
    return store.edit(author, id, TIMING, no_change, data=data)


class AnnotationWork(NamedTuple):
    """An annotator's work on boxes.

    Args:
        boxes: How many boxes of how many frames.
        seconds: Time in all.
        edits: Edits in all.
    """

    boxes: int
    seconds: float
    edits: int

    @property
    def seconds_per_box(self) -> float:
        """Mean time a box; 0 where there is none."""
        return self.seconds / self.boxes if self.boxes else 0.0


def annotation_work(store: Store) -> Mapping[str, AnnotationWork]:
    """Work by annotator, from the whole journal."""
    seconds: dict[str, dict[tuple[str, ...], float]] = defaultdict(lambda: defaultdict(float))
    edits: dict[str, int] = defaultdict(int)
    for seq in range(1, len(store.journal) + 1):
        record = store.journal.read(seq)
        if record.op == TIMING:
            data = record.data or {}
            seconds[record.by][*data["frame"], data["box"]] += data["seconds"]
            edits[record.by] += data["edits"]
    return {by: AnnotationWork(len(boxes), sum(boxes.values()), edits[by]) for by, boxes in seconds.items()}


class Stopwatch:
    """Time on one box from what a person does: pauses above a minute do not count."""

    def __init__(self) -> None:
        self._last_s: float | None = None
        self.seconds = 0.0

    def act(self, now_s: float) -> None:
        """Something was done at a time, in seconds of any clock that does not run backwards."""
        if self._last_s is not None and now_s - self._last_s <= LONGEST_PAUSE_S:
            self.seconds += now_s - self._last_s
        self._last_s = now_s

    def lap(self, now_s: float) -> float:
        """The next box is selected: seconds of the one before; the clock starts anew."""
        self.act(now_s)
        seconds, self.seconds = self.seconds, 0.0
        return seconds
