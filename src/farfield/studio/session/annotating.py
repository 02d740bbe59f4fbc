"""What windows that annotate ask for: edits, undo, fits, checks, saves.

The path of an edit to the disk:

    1. :func:`edit`           the handler of all edits, binds the plan of the message's class (:class:`plans`)
    2. :func:`_commit`        hands it to the one thread that edits, so that edits keep their order
    3. ``Store.edit``         calls the plan under its lock: the cells that change, or a refusal or conflict
    4. ``EditJournal.append`` numbers the edit and lets it wait for the journal's own thread
    5. ``EditJournal._write`` writes all that wait, calls fsync once for them, and resolves their futures
    6. :func:`_acknowledge`   waits for the edit's future, sends the ack, and tells the other windows

A RefusedError or JournalError of any step is answered as ``refused`` by ``Session.handle``, or by ``Session.aside`` in
what goes on beside further messages; a ConflictError is answered by :func:`_commit`.
"""

import asyncio
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Generic, TypeVar

from farfield.annotation import notes
from farfield.annotation.edits import (
    add_box,
    delete_box,
    fill_track,
    interpolate_track,
    merge_tracks,
    propagate_track,
    set_box,
    set_track,
    split_track,
)
from farfield.annotation.errors import ConflictError, RefusedError
from farfield.annotation.store import REDO, UNDO, Author, EditResult, Store, redo, undo
from farfield.datasets.edits import CellEdit
from farfield.errors import FarfieldError
from farfield.frame import Boxes, Key
from farfield.studio.inferring.jobs import InferJob
from farfield.studio.messages import requests
from farfield.studio.messages.replies import Ack, Changed, Checks, Failure, PolicyIs, Saved
from farfield.studio.messages.rows import BoxValue
from farfield.studio.session.session import HANDLERS, ClientWindow, Session, handles
from farfield.studio.showing.annotations import AnnotationService
from farfield.studio.showing.opened import plain_error

AUTOSAVE_S = 30.0
_PAUSE_S, _LONGEST_S = 0.05, 1.0  # without edits before a frame is checked, and how long it may wait
_EDITS_SAFE = "your edits are safe in the journal; fix the cause and save again"

P = TypeVar("P", bound=Callable[..., Sequence[CellEdit]])
R = TypeVar("R", bound=requests.Edit)


@dataclass(frozen=True)
class plans:  # noqa: N801 - a decorator
    """Register the decorated function as what an edit changes.

    It is called with the store and the :class:`PlannedEdit`, and gives the cells that change. It runs under the store's
    lock: a message that comes again is answered without it.

    Args:
        message: The class of messages.
    """

    message: type

    def __call__(self, plan: P) -> P:
        """Register it."""
        HANDLERS[self.message] = partial(edit, plan)
        return plan


@dataclass(frozen=True)
class PlannedEdit(Generic[R]):
    """An edit that a window requests, with the plan of its class.

    Args:
        plan: Finds the cells that change, from the store as it stands.
        request: The message.
        drive: The drive to which its tracks belong.
        annotation: The annotation that it changes.
    """

    plan: Callable[[Store, "PlannedEdit[R]"], Sequence[CellEdit]]
    request: R
    drive: str
    annotation: AnnotationService

    def make(self, author: Author) -> EditResult:
        """Change the store and append to its journal."""
        request = self.request
        return self.annotation.store.edit(
            author, request.id, request.op, self.changes, group=requests.group_of(request)
        )

    def changes(self, store: Store) -> Sequence[CellEdit]:
        """The cells that change; the store calls it under its lock."""
        return self.plan(store, self)

    def track_name(self, number: int) -> str:
        """The track that the page knows by a number."""
        return self.annotation.numbers.name(number)


async def edit(
    plan: Callable[..., Sequence[CellEdit]], session: Session, window: ClientWindow, request: requests.Edit
) -> None:
    """Make an edit; it is acknowledged once it is on the disk."""
    annotation = session.annotation
    planned = PlannedEdit(plan, request, _drive(session, window, request), annotation)
    await _commit(session, window, request.id, partial(planned.make, _author(window)))


def _author(window: ClientWindow) -> Author:
    return Author(window.annotator, window.id)


def _drive(session: Session, window: ClientWindow, request: requests.Edit) -> str:
    """The drive to which the tracks of an edit belong: that of its frame, else of the one that the window shows."""
    frame = requests.frame_of(request)
    frame = (window.frame or 0) if frame is None else frame
    session.opened.check(frame)
    return session.annotation.drive_of(frame)


def _key(store: Store, frame: int) -> Key:
    if not 0 <= frame < len(store.keys):
        raise RefusedError("frame", f"expected a frame from 0 to {len(store.keys) - 1}, got {frame}")
    return store.keys[frame]


def _row_in_drive(store: Store, frame: int, drive: str) -> int:
    """A frame's row in a drive.

    Raises:
        RefusedError: If the frame is not in it.
    """
    located = store.drives.locate(_key(store, frame))
    if located.drive != drive:
        raise RefusedError("frame", f"frame {frame} belongs to another drive than the track")
    return located.row


def _value(value: BoxValue, annotation: AnnotationService) -> dict[str, Any]:
    """A box's value as the store takes it."""
    return {
        "label": value.class_name,
        "box": list(value.box),
        "track": annotation.numbers.name(value.track),
        "state": value.state,
        "source": value.source,
        "attributes": dict(value.attributes),
    }


@plans(requests.BoxSet)
def _box_set(store: Store, planned: PlannedEdit[requests.BoxSet]) -> Sequence[CellEdit]:
    request = planned.request
    value = _value(request.value, planned.annotation)
    return set_box(store, _key(store, request.frame), request.box, request.base, value)


@plans(requests.BoxAdd)
def _box_add(store: Store, planned: PlannedEdit[requests.BoxAdd]) -> Sequence[CellEdit]:
    request = planned.request
    return add_box(store, _key(store, request.frame), request.box, _value(request.value, planned.annotation))


@plans(requests.BoxDelete)
def _box_delete(store: Store, planned: PlannedEdit[requests.BoxDelete]) -> Sequence[CellEdit]:
    request = planned.request
    return delete_box(store, _key(store, request.frame), request.box, request.base)


@plans(requests.TrackSet)
def _track_set(store: Store, planned: PlannedEdit[requests.TrackSet]) -> Sequence[CellEdit]:
    request = planned.request
    ends = None if request.ends is None else "" if request.ends < 0 else _key(store, request.ends)[1]
    return set_track(
        store,
        planned.drive,
        planned.track_name(request.track),
        request.base,
        label=request.class_name,
        size=request.size,
        locked=request.size_locked,
        ends=ends,
    )


@plans(requests.TrackMerge)
def _track_merge(store: Store, planned: PlannedEdit[requests.TrackMerge]) -> Sequence[CellEdit]:
    request = planned.request
    track, into = planned.track_name(request.track), planned.track_name(request.into)
    return merge_tracks(store, planned.drive, track, into, request.base, request.into_base)


@plans(requests.TrackSplit)
def _track_split(store: Store, planned: PlannedEdit[requests.TrackSplit]) -> Sequence[CellEdit]:
    request = planned.request
    track, new_track = planned.track_name(request.track), planned.track_name(request.new_track)
    return split_track(store, planned.drive, track, _key(store, request.frame)[1], new_track, request.base)


@plans(requests.TrackInterpolate)
def _track_interpolate(store: Store, planned: PlannedEdit[requests.TrackInterpolate]) -> Sequence[CellEdit]:
    request = planned.request
    first, last = (_row_in_drive(store, frame, planned.drive) for frame in (request.first, request.last))
    return interpolate_track(store, planned.drive, planned.track_name(request.track), first, last, request.id)


@handles(requests.TrackPropagate)
async def propagate(session: Session, window: ClientWindow, request: requests.TrackPropagate) -> None:
    """Carry a track on: that fits in many frames, so it holds up nobody's edits."""
    drive = _drive(session, window, request)
    session.aside(window, request.id, _propagate(session, window, request, drive))


async def _propagate(session: Session, window: ClientWindow, request: requests.TrackPropagate, drive: str) -> None:
    result = await session.in_thread(partial(_propagated, session.annotation, _author(window), request, drive))
    await _acknowledge(session, window, request.id, result)


def _propagated(
    annotation: AnnotationService, author: Author, request: requests.TrackPropagate, drive: str
) -> EditResult:
    store, track = annotation.store, annotation.numbers.name(request.track)
    first, last = (_row_in_drive(store, frame, drive) for frame in (request.first, request.last))
    refit = annotation.annotator.refit_near if request.fit else None
    course = propagate_track(store, drive, track, first, last, refit)
    plan = partial(fill_track, drive=drive, track=track, boxes=course.boxes, source="propagated", prefix=request.id)
    return store.edit(author, request.id, request.op, plan, data={"message": course.message})


@handles(requests.Undo)
async def take_back(session: Session, window: ClientWindow, request: requests.Undo) -> None:
    """Take back the last step: the message undo; :func:`~farfield.annotation.store.undo` does it."""
    await _step(session, window, request, undo)


@handles(requests.Redo)
async def do_again(session: Session, window: ClientWindow, request: requests.Redo) -> None:
    """Do again what was taken back last: the message redo; :func:`~farfield.annotation.store.redo` does it."""
    await _step(session, window, request, redo)


async def _step(
    session: Session,
    window: ClientWindow,
    request: requests.Undo | requests.Redo,
    step: Callable[..., EditResult],
) -> None:
    store, everybody = session.annotation.store, request.scope == "all"
    work = partial(step, store, _author(window), request.id, everybody=everybody, force=request.force)
    await _commit(session, window, request.id, work)


async def _commit(session: Session, window: ClientWindow, id: str, work: Callable[[], EditResult]) -> None:
    """Edits are taken in the order in which they come; aside, so that others follow, the disk is waited for."""
    annotation = session.annotation
    try:
        result = await annotation.editor.do(work)
    except ConflictError as error:
        window.send(await session.in_thread(partial(annotation.conflict, id, error)))
        return
    session.aside(window, id, _acknowledge(session, window, id, result))


async def _acknowledge(session: Session, window: ClientWindow, id: str, result: EditResult) -> None:
    """Once an edit is on the disk: acknowledge it, tell the others, and check the frames that are shown."""
    await asyncio.wrap_future(result.saved)
    saved_ns = str(time.time_ns())  # text: JavaScript's numbers are exact to 2^53 only
    annotation, record = session.annotation, result.record
    placed, removed, tracks = await session.in_thread(partial(annotation.changed, record))
    own_row = next((placement.row for placement in placed), None) if len(record.changes) == 1 else None
    can_undo, can_redo = annotation.undoable(window.annotator)
    window.send(
        Ack(id=id, seq=record.seq, version=record.seq, saved_ns=saved_ns, row=own_row, undo=can_undo, redo=can_redo)
    )
    if result.repeated:
        return
    changed = Changed(
        seq=record.seq,
        id=id,
        by=record.by,
        window=record.window,
        rows=tuple(placed),
        removed=tuple(removed),
        tracks=tuple(tracks),
        sentence=str((record.data or {}).get("message", "")),
    )
    _tell_windows(session, window, changed, is_step=record.op in (UNDO, REDO), alone=len(record.changes) == 1)


def _tell_windows(session: Session, window: ClientWindow, changed: Changed, *, is_step: bool, alone: bool) -> None:
    """Tell the other windows of an edit, and its own of what the tool did beyond the box that it sent.

    Args:
        session: Its windows are told.
        window: The window that edited.
        changed: The edit.
        is_step: Whether it is an undo or redo: the nearest frame that it changes is to be shown.
        alone: Whether one cell alone changed, which the window has of the acknowledgement already.
    """
    annotation = session.annotation
    frames = [*(row.frame for row in changed.rows), *(row.frame for row in changed.removed)]
    nearest = min(frames, key=lambda frame: abs(frame - (window.frame or 0)), default=None) if is_step else None
    for other in list(session.windows.values()):
        can_undo, can_redo = annotation.undoable(other.annotator)
        if other is not window:
            other.send(replace(changed, undo=can_undo, redo=can_redo))
        elif is_step or not alone or changed.tracks or changed.sentence:
            other.send(replace(changed, undo=can_undo, redo=can_redo, show=nearest))
    for frame in _shown_frames(session) & set(frames):
        check_soon(session, frame)


def _shown_frames(session: Session) -> set[int]:
    return {window.frame for window in session.windows.values() if window.frame is not None}


def check_soon(session: Session, frame: int) -> None:
    """Check a frame once edits pause for a moment, and tell the windows that show it."""
    waiting = frame in session.edited_at
    session.edited_at[frame] = time.monotonic()
    if not waiting:
        session.aside(None, None, _check(session, frame))


async def _check(session: Session, frame: int) -> None:
    began = time.monotonic()
    while (paused := time.monotonic() - session.edited_at[frame]) < _PAUSE_S and time.monotonic() - began < _LONGEST_S:
        await asyncio.sleep(_PAUSE_S - paused)
    del session.edited_at[frame]
    reply = await session.in_thread(partial(checks_of, session, frame))
    for window in session.windows.values():
        if window.frame == frame:
            window.send(reply)


def checks_of(session: Session, frame: int) -> Checks:
    """The findings of a frame, disagreements with the first set of detections among them."""
    key = session.frames.data.keys[frame]
    sets = (shown for shown in list(session.frames.sets.values()) if shown.about.kind == "detections")
    detections = next((shown.boxes[key] for shown in sets if key in shown.boxes), None)
    return Checks(frame=frame, rows=session.annotation.checks(frame, detections))


@handles(requests.CheckList)
async def check_list(session: Session, window: ClientWindow, request: requests.CheckList) -> None:
    """Findings of a frame, or of all."""
    annotation = session.annotation
    if request.frame is None:
        session.aside(window, None, _check_all(session, window, annotation))
        return
    session.opened.check(request.frame)
    window.send(await session.in_thread(partial(checks_of, session, request.frame)))


async def _check_all(session: Session, window: ClientWindow, annotation: AnnotationService) -> None:
    window.send(Checks(frame=None, rows=await session.in_thread(annotation.all_checks)))


@handles(requests.CheckIgnore)
async def check_ignore(session: Session, window: ClientWindow, request: requests.CheckIgnore) -> None:
    """Let a finding stand."""
    store = session.annotation.store
    work = partial(notes.ignore, store, _author(window), request.id, request.check, request.reason)
    await _commit(session, window, request.id, work)
    for frame in _shown_frames(session):
        check_soon(session, frame)


@handles(requests.Fit)
async def fit(session: Session, window: ClientWindow, request: requests.Fit) -> None:
    """Find the box that a gesture means."""
    annotation = session.annotation
    session.opened.check(request.frame)
    session.aside(window, request.id, _fit(session, window, annotation, request))


async def _fit(session: Session, window: ClientWindow, annotation: AnnotationService, request: requests.Fit) -> None:
    window.send(await session.in_thread(partial(annotation.fit, request)))


@handles(requests.PolicySet)
async def policy(session: Session, window: ClientWindow, request: requests.PolicySet) -> None:
    """Declare what the boxes hold."""
    store = session.annotation.store
    work = partial(notes.declare_extent, store, _author(window), request.id, request.extent)
    await _commit(session, window, request.id, work)
    if store.extent is not None:
        session.broadcast(PolicyIs(extent=store.extent))


@handles(requests.Timing)
async def timing(session: Session, window: ClientWindow, request: requests.Timing) -> None:
    """Note the time that a box took."""
    annotation = session.annotation
    session.opened.check(request.frame)
    key, id = annotation.store.keys[request.frame], f"time-{window.id}-{time.time_ns()}"[:64]
    note = partial(
        notes.record_time, annotation.store, _author(window), id, key, request.box, request.seconds, request.edits
    )
    await annotation.editor.do(note)


@handles(requests.Save)
async def save(session: Session, window: ClientWindow, request: requests.Save) -> None:
    """Write the label files."""
    session.aside(window, request.id, _save(session, window, session.annotation, request))


async def _save(session: Session, window: ClientWindow, annotation: AnnotationService, request: requests.Save) -> None:
    summary = await session.in_thread(
        partial(annotation.annotator.save, _author(window), request.id, folder=request.folder, format=request.format)
    )
    annotation.saved_seq = annotation.seq
    window.send(
        Saved(
            id=request.id,
            seq=summary.seq,
            files=summary.files,
            saved_ns=str(time.time_ns()),
            folder=summary.folder,
            sentence=f"{summary.files} label file{'' if summary.files == 1 else 's'} written",
        )
    )


async def propose(session: Session, job: InferJob, index: int, boxes: Boxes) -> None:
    """Add a detector's boxes of a frame as proposals."""
    annotation, author = session.annotation, Author(job.by, job.window)
    id, group = f"{job.id or job.name}-{index}"[-64:], job.id or job.name
    result = await annotation.editor.do(partial(annotation.annotator.propose, author, id, index, boxes, group))
    if result is not None:
        await _acknowledge(session, ClientWindow(id=job.window, annotator=job.by), result.record.id, result)


async def autosave(session: Session) -> None:
    """Write label files every half minute, where saves go into them: what is in the journal is safe without."""
    while True:
        await asyncio.sleep(AUTOSAVE_S)
        await save_now(session)


async def save_now(session: Session) -> None:
    """Write label files that have unsaved edits, where saves go into them."""
    annotation = session.annotating
    if annotation is None or not annotation.in_place or annotation.saved_seq == annotation.seq:
        return
    id, author = f"autosave-{time.time_ns()}", Author(session.annotator, "")
    try:
        summary = await session.in_thread(partial(annotation.annotator.save, author, id))
    except FarfieldError as error:
        sentence = f"the label files could not be saved: {plain_error(error, session.data)}"
        session.broadcast(Failure(sentence=sentence, mend=_EDITS_SAFE))
        return
    annotation.saved_seq = annotation.seq
    saved_ns = str(time.time_ns())
    session.broadcast(Saved(id=id, seq=summary.seq, files=summary.files, saved_ns=saved_ns, folder=summary.folder))
