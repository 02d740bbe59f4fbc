"""What windows that look ask for: the welcome, frames, bookmarks, boxes that others drag, frames worth a look."""

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from farfield import __version__
from farfield.annotation.schema import shown_classes
from farfield.metrics import PROTOCOLS
from farfield.studio.messages import requests
from farfield.studio.messages.replies import Bookmarks, Changed, FrameState, Matches, Previewed, Welcome
from farfield.studio.messages.rows import BoxRow, MatchRow
from farfield.studio.session.checking import check_soon
from farfield.studio.session.detecting import detect_shown, offered
from farfield.studio.session.session import ClientWindow, Session, handles
from farfield.studio.showing.opened import MOST_NAMED
from farfield.studio.showing.predictions import Predictions
from farfield.studio.showing.rows import annotated_rows, class_specs, with_others


def _store_name(session: Session) -> str:
    """What no other annotation on this machine has, and no path can be read from."""
    annotating = session.annotating
    folder = session.frames.data.root if annotating is None else annotating.store.folder
    return hashlib.sha256(str(folder.resolve()).encode("utf-8", "surrogateescape")).hexdigest()[:24]


def welcome(session: Session, window: ClientWindow) -> Welcome:
    """What is open, for a window that says hello."""
    frames, data, settings = session.frames, session.frames.data, session.settings
    labels = tuple(f"{sequence}/{frame}" for sequence, frame in data.keys) if len(data) <= MOST_NAMED else ()
    predicted = {name for shown in frames.sets.values() for name in shown.about.classes}
    annotating = session.annotating
    classes = class_specs(shown_classes(data.name, settings.classes)) if annotating is None else annotating.classes
    can_undo, can_redo = (False, False) if annotating is None else annotating.undoable(window.annotator)
    return Welcome(
        farfield=__version__,
        mode=settings.mode,
        data=data.name,
        store=_store_name(session),
        title=settings.title or data.root.name,
        frames=len(data),
        drives=frames.opened.drive_rows,
        labels=labels,
        classes=with_others(classes, sorted(predicted)) if annotating is None else classes,
        predictions=tuple(shown.about for shown in frames.sets.values()),
        detectors=offered(settings, data),
        protocols=tuple(PROTOCOLS),
        bookmarks=frames.bookmarks.rows(),
        tracks=() if annotating is None else annotating.tracks(frames.first),
        annotator=window.annotator,
        window=window.id,
        windows=len(session.windows),
        journal_seq=0 if annotating is None else annotating.seq,
        extent=None if annotating is None else annotating.store.extent,
        first=frames.first,
        formats=() if annotating is None else annotating.formats,
        written=None if annotating is None else annotating.labels(),
        drive="" if annotating is None or not len(data) else annotating.drive_of(frames.first),
        undo=can_undo,
        redo=can_redo,
    )


@handles(requests.FrameOpen)
async def open_frame(session: Session, window: ClientWindow, request: requests.FrameOpen) -> None:
    """Send a frame's state; requests run concurrently, so an earlier one is answered even after a later one."""
    session.opened.check(request.frame)
    if request.purpose != "ahead":
        window.frame, window.threshold, window.sweeps = request.frame, request.threshold, request.sweeps
    session.aside(window, None, _show(session, window, request))


async def _show(session: Session, window: ClientWindow, request: requests.FrameOpen) -> None:
    if request.purpose != "here":
        state = await session.in_thread(partial(_state, session, request))
        window.send(state)
        if state.unreadable:
            if request.purpose != "ahead" and session.annotating is not None:
                check_soon(session, request.frame)  # a frame that cannot be read is a finding of its drive
            return
    if request.purpose == "ahead":
        return
    detect_shown(session, window, request.frame)
    if session.annotating is not None:
        await _show_tracks(session, window, request.frame)
        check_soon(session, request.frame)


def _state(session: Session, request: requests.FrameOpen) -> FrameState:
    """A frame as it stands; one that cannot be read says so in place of its picture."""
    seq = 0 if session.annotating is None else session.annotating.seq  # before the boxes: they hold at least this
    try:
        return replace(session.frames.state(request.frame, request.threshold, request.sweeps), seq=seq)
    except Exception as error:  # noqa: BLE001
        refused = session.refusal(None, error)
        return replace(session.frames.unreadable(request.frame, f"{refused.sentence} {refused.mend}".strip()), seq=seq)


async def _show_tracks(session: Session, window: ClientWindow, frame: int) -> None:
    """The tracks of a drive, when a window comes to it."""
    annotation = session.annotation
    drive = annotation.drive_of(frame)
    if window.drive == drive:
        return
    first, window.drive = window.drive is None, drive
    if first and drive == annotation.drive_of(session.frames.first):
        return  # the welcome had them
    tracks = await session.in_thread(lambda: annotation.tracks(frame))
    can_undo, can_redo = annotation.undoable(window.annotator)
    unwritten = annotation.store.unwritten
    window.send(
        Changed(
            seq=annotation.seq,
            id="",
            by="",
            window="",
            tracks=tracks,
            drive=drive,
            undo=can_undo,
            redo=can_redo,
            unwritten=unwritten,
        )
    )


@handles(requests.Preview)
async def preview(session: Session, window: ClientWindow, request: requests.Preview) -> None:
    """Pass a dragged box on to the windows that show its frame."""
    reply = Previewed(window=window.id, frame=request.frame, box=request.box, value=request.value)
    for other in session.windows.values():
        if other is not window and other.frame == request.frame:
            other.send(reply)


@handles(requests.BookmarkSet)
async def bookmark(session: Session, window: ClientWindow, request: requests.BookmarkSet) -> None:
    """Set a bookmark and tell everybody."""
    session.opened.check(request.frame)
    bookmarks = session.frames.bookmarks
    await session.in_thread(lambda: bookmarks.set(request.frame, request.note, window.annotator))
    session.broadcast(Bookmarks(rows=bookmarks.rows(), answers=request.id))


# Frames in which a set of predictions misses boxes, or has false ones

_AT_ONCE = 20
"""Frames of a part: few, so that marks appear soon and a thread is free for what a person waits for."""


@handles(requests.MatchList)
async def match_list(session: Session, window: ClientWindow, request: requests.MatchList) -> None:
    """Match all frames of all sets, part by part."""
    window.matching = token = object()
    session.aside(window, None, _match_sets(session, window, request.threshold, token))


async def _match_sets(session: Session, window: ClientWindow, threshold: float, token: object) -> None:
    index_of = {key: index for index, key in enumerate(session.frames.data.keys)}
    for predictions in list(session.frames.sets.values()):
        frames = sorted(index_of[key] for key in list(predictions.boxes) if key in index_of)
        for start in range(0, max(1, len(frames)), _AT_ONCE):
            rows = await session.in_thread(
                partial(_rows, session, predictions, frames[start : start + _AT_ONCE], threshold)
            )
            if window.matching is not token or session.windows.get(window.id) is not window:
                return
            window.send(Matches(set=predictions.about.name, first=start == 0, rows=rows))


def _rows(session: Session, predictions: Predictions, frames: Sequence[int], threshold: float) -> tuple[MatchRow, ...]:
    reference = session.frames.data[frames[0]].reference if frames else ""
    return tuple(
        row for index in frames if (row := _row(session, predictions, index, reference, threshold)) is not None
    )


def _row(session: Session, predictions: Predictions, index: int, reference: str, threshold: float) -> MatchRow | None:
    """Of one frame; None where nothing is wrong, or nothing was annotated and so nothing can be."""
    shown = predictions.frame(session.frames.data.keys[index], _truth(session, index), reference, threshold=threshold)
    if shown is None:
        return None
    wrong = sum(row.match == "false" for row in shown.rows)
    return MatchRow(frame=index, missed=len(shown.missed), wrong=wrong) if shown.missed or wrong else None


def _truth(session: Session, index: int) -> tuple[BoxRow, ...]:
    """The annotated boxes of a frame as they stand, no cloud read."""
    if session.annotating is not None:
        return session.annotating.outlines(index)
    annotation = session.frames.data.annotation(index)
    return () if annotation is None else annotated_rows(annotation, index)
