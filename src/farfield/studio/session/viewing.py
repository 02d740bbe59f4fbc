"""What windows that look ask for: the welcome, frames, bookmarks, boxes that others drag."""

from collections.abc import Sequence
from functools import partial

from farfield import __version__
from farfield.metrics import PROTOCOLS
from farfield.studio.messages import requests as asked
from farfield.studio.messages.replies import Bookmarks, Changed, Matches, Previewed, Welcome
from farfield.studio.messages.rows import BoxRow, MatchRow
from farfield.studio.session.detecting import detect_shown, offered
from farfield.studio.session.editing import check_soon
from farfield.studio.session.session import ClientWindow, Session
from farfield.studio.showing.opened import MOST_NAMED
from farfield.studio.showing.predictions import Predictions
from farfield.studio.showing.rows import annotated_rows, shown_classes, with_others


def welcome(desk: Session, window: ClientWindow) -> Welcome:
    """What is open, for a window that says hello."""
    book, data, settings = desk.book, desk.book.data, desk.settings
    labels = tuple(f"{sequence}/{frame}" for sequence, frame in data.keys) if len(data) <= MOST_NAMED else ()
    predicted = {name for each in book.sets.values() for name in each.about.classes}
    annotating = desk.annotating
    classes = shown_classes(data.name, settings.classes) if annotating is None else annotating.classes
    return Welcome(
        farfield=__version__,
        mode=settings.mode,
        data=data.name,
        title=settings.title or data.root.name,
        frames=len(data),
        drives=book.opened.drive_rows,
        labels=labels,
        classes=with_others(classes, sorted(predicted)) if annotating is None else classes,
        predictions=tuple(each.about for each in book.sets.values()),
        detectors=offered(settings),
        protocols=tuple(PROTOCOLS),
        bookmarks=book.bookmarks.rows(),
        tracks=() if annotating is None else annotating.tracks(book.first),
        annotator=window.annotator,
        window=window.id,
        windows=len(desk.windows),
        journal_seq=0 if annotating is None else annotating.seq,
        extent=None if annotating is None else annotating.extent,
        first=book.first,
        formats=() if annotating is None else annotating.formats,
        saves_to="" if annotating is None else annotating.saves_to,
        undo=annotating is not None and annotating.can(window.annotator, "undo"),
        redo=annotating is not None and annotating.can(window.annotator, "redo"),
    )


async def open_frame(desk: Session, window: ClientWindow, request: asked.FrameOpen) -> None:
    """Send a frame's state; requests run concurrently, so an earlier one is answered even after a later one."""
    if request.purpose != "ahead":
        window.frame, window.threshold, window.sweeps = request.frame, request.threshold, request.sweeps
    desk.aside(window, None, _show(desk, window, request))


async def _show(desk: Session, window: ClientWindow, request: asked.FrameOpen) -> None:
    desk.opened.check(request.frame)
    if request.purpose != "here":
        state = await desk.in_thread(lambda: desk.book.state(request.frame, request.threshold, request.sweeps))
        window.send(state)
    if request.purpose == "ahead":
        return
    detect_shown(desk, window, request.frame)
    if desk.annotating is not None:
        await _show_tracks(desk, window, request.frame)
        check_soon(desk, request.frame)


async def _show_tracks(desk: Session, window: ClientWindow, frame: int) -> None:
    """The tracks of a drive, when a window comes to it."""
    known = desk.annotating
    assert known is not None  # only where boxes are edited
    drive = known.drive_of(frame)
    if window.drive == drive:
        return
    first, window.drive = window.drive is None, drive
    if first and drive == known.drive_of(desk.book.first):
        return  # the welcome had them
    tracks = await desk.in_thread(lambda: known.tracks(frame))
    undo, redo = (known.can(window.annotator, what) for what in ("undo", "redo"))
    window.send(Changed(seq=known.seq, id="", by="", window="", tracks=tracks, undo=undo, redo=redo))


async def preview(desk: Session, window: ClientWindow, request: asked.Preview) -> None:
    """Pass a dragged box on to the windows that show its frame."""
    reply = Previewed(window=window.id, frame=request.frame, box=request.box, value=request.value)
    for other in desk.windows.values():
        if other is not window and other.frame == request.frame:
            other.send(reply)


async def bookmark(desk: Session, window: ClientWindow, request: asked.BookmarkSet) -> None:
    """Set a bookmark and tell everybody."""
    desk.opened.check(request.frame)
    kept = desk.book.bookmarks
    await desk.in_thread(lambda: kept.set(request.frame, request.note, window.annotator))
    desk.tell(Bookmarks(rows=kept.rows()))


# Which frames are worth a look: where a set of predictions misses boxes, or finds what is not there.

_AT_ONCE = 20
"""Frames of a part: few, so that marks appear soon and a thread is free for what a person waits for."""


async def match_list(desk: Session, window: ClientWindow, request: asked.MatchList) -> None:
    """Match all frames of all sets, part by part."""
    window.matching = token = object()
    desk.aside(window, None, _matched(desk, window, request.threshold, token))


async def _matched(desk: Session, window: ClientWindow, threshold: float, token: object) -> None:
    places = {key: index for index, key in enumerate(desk.book.data.keys)}
    for found in list(desk.book.sets.values()):
        frames = sorted(places[key] for key in list(found.boxes) if key in places)
        for start in range(0, max(1, len(frames)), _AT_ONCE):
            rows = await desk.in_thread(partial(_rows, desk, found, frames[start : start + _AT_ONCE], threshold))
            if window.matching is not token or desk.windows.get(window.id) is not window:
                return
            window.send(Matches(set=found.about.name, first=start == 0, rows=rows))


def _rows(desk: Session, found: Predictions, frames: Sequence[int], threshold: float) -> tuple[MatchRow, ...]:
    reference = desk.book.data[frames[0]].reference if frames else ""
    return tuple(row for index in frames if (row := _row(desk, found, index, reference, threshold)) is not None)


def _row(desk: Session, found: Predictions, index: int, reference: str, threshold: float) -> MatchRow | None:
    """Of one frame; None where nothing is wrong, or nothing was annotated and so nothing can be."""
    shown = found.frame(desk.book.data.keys[index], _truth(desk, index), reference, threshold=threshold)
    if shown is None:
        return None
    wrong = sum(row.match == "false" for row in shown.rows)
    return MatchRow(frame=index, missed=len(shown.missed), wrong=wrong) if shown.missed or wrong else None


def _truth(desk: Session, index: int) -> tuple[BoxRow, ...]:
    """The annotated boxes of a frame as they stand, no cloud read."""
    if desk.annotating is not None:
        return desk.annotating.outlines(index)
    annotation = desk.book.data.annotation(index)
    return () if annotation is None else annotated_rows(annotation)
