"""What windows that annotate ask for: edits, undo, fits, findings let stand.

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
from farfield.annotation.proposals import ProposalRange, accept_proposals, proposals_of
from farfield.annotation.store import REDO, UNDO, Author, EditResult, Store, no_change, redo, undo
from farfield.datasets.edits import CellEdit, Record
from farfield.frame import Boxes, Key
from farfield.studio.inferring.jobs import InferJob
from farfield.studio.messages import requests
from farfield.studio.messages.replies import Ack, Changed, PolicyIs, Proposals
from farfield.studio.messages.rows import BoxValue
from farfield.studio.session.checking import check_edited, check_soon, shown_frames
from farfield.studio.session.session import HANDLERS, ClientWindow, Session, handles
from farfield.studio.showing.annotations import AnnotationService

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
    planned = PlannedEdit(plan, request, _drive(session, request), annotation)
    await _commit(session, window, request.id, partial(planned.make, _author(window)))


def _author(window: ClientWindow) -> Author:
    return Author(window.annotator, window.id)


def _drive(session: Session, request: requests.Edit | requests.ProposalsCount) -> str:
    """The drive to which the tracks of an edit belong: that of the frame that it names."""
    frame = requests.frame_of(request)
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
    name = planned.annotation.box_name(request.frame, request.box)
    return set_box(store, _key(store, request.frame), name, request.base, value)


@plans(requests.BoxAdd)
def _box_add(store: Store, planned: PlannedEdit[requests.BoxAdd]) -> Sequence[CellEdit]:
    request = planned.request
    name = planned.annotation.box_name(request.frame, request.box) if ":" in request.box else request.box
    key, value = _key(store, request.frame), _value(request.value, planned.annotation)
    if request.fresh and value["track"] and store.tracks.boxes(planned.drive, value["track"]):
        value["track"] = store.tracks.new(planned.drive)
    return add_box(store, key, name, value)


@plans(requests.BoxDelete)
def _box_delete(store: Store, planned: PlannedEdit[requests.BoxDelete]) -> Sequence[CellEdit]:
    request = planned.request
    name = planned.annotation.box_name(request.frame, request.box)
    return delete_box(store, _key(store, request.frame), name, request.base)


@plans(requests.BoxAccept)
def _box_accept(store: Store, planned: PlannedEdit[requests.BoxAccept]) -> Sequence[CellEdit]:
    request = planned.request
    first, last = (_row_in_drive(store, frame, planned.drive) for frame in (request.first, request.last))
    meant = ProposalRange(drive=planned.drive, first=first, last=last, score=request.score)
    return accept_proposals(store, meant, count=request.count, base=request.base)


@plans(requests.TrackSet)
def _track_set(store: Store, planned: PlannedEdit[requests.TrackSet]) -> Sequence[CellEdit]:
    request = planned.request
    _require_shown(planned)
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
    _require_shown(planned)
    track, into = planned.track_name(request.track), planned.track_name(request.into)
    return merge_tracks(store, planned.drive, track, into, request.base, request.into_base)


@plans(requests.TrackSplit)
def _track_split(store: Store, planned: PlannedEdit[requests.TrackSplit]) -> Sequence[CellEdit]:
    request = planned.request
    _require_shown(planned)
    track, new_track = planned.track_name(request.track), planned.track_name(request.new_track)
    return split_track(store, planned.drive, track, _key(store, request.frame)[1], new_track, request.base)


def _require_shown(planned: PlannedEdit[Any]) -> None:
    """Refuse an edit of a track whose box in the frame is no longer as it was shown."""
    request = planned.request
    planned.annotation.require_shown(request.frame, request.box, request.box_base)


@plans(requests.TrackInterpolate)
def _track_interpolate(store: Store, planned: PlannedEdit[requests.TrackInterpolate]) -> Sequence[CellEdit]:
    request = planned.request
    planned.annotation.require_shown(request.frame, request.box, request.base)
    first, last = (_row_in_drive(store, frame, planned.drive) for frame in (request.first, request.last))
    return interpolate_track(store, planned.drive, planned.track_name(request.track), first, last, request.id)


@handles(requests.TrackPropagate)
async def propagate(session: Session, window: ClientWindow, request: requests.TrackPropagate) -> None:
    """Carry a track on: that fits in many frames, so it holds up nobody's edits."""
    drive = _drive(session, request)
    if request.id in session.under_way:
        return  # it came before, and is answered once it is made
    session.under_way.add(request.id)
    session.aside(window, request.id, _propagate(session, window, request, drive))


async def _propagate(session: Session, window: ClientWindow, request: requests.TrackPropagate, drive: str) -> None:
    annotation = session.annotation
    try:
        result = await session.in_thread(partial(_propagated, annotation, _author(window), request, drive))
    except ConflictError as error:
        window.send(await session.in_thread(partial(annotation.conflict, request.id, error)))
        return
    finally:
        session.under_way.discard(request.id)
    await _acknowledge(session, window, request.id, result)


def _propagated(
    annotation: AnnotationService, author: Author, request: requests.TrackPropagate, drive: str
) -> EditResult:
    store, track = annotation.store, annotation.numbers.name(request.track)
    if store.journal.seq_of(request.id) is not None:  # it came before
        return store.edit(author, request.id, request.op, no_change)
    annotation.require_shown(request.first, request.box, request.base)
    first, last = (_row_in_drive(store, frame, drive) for frame in (request.first, request.last))
    refit = annotation.annotator.refit_near if request.fit else None
    course = propagate_track(store, drive, track, first, last, refit, always=abs(last - first) == 1)
    plan = partial(
        fill_track,
        drive=drive,
        track=track,
        boxes=course.boxes,
        source="propagated",
        prefix=request.id,
        predicted=course.predicted,
    )
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
    if (window, id) in session.acknowledging:
        return  # it came before, and is answered by what goes on already
    session.acknowledging.add((window, id))
    try:
        await _answer(session, window, id, result)
    finally:
        session.acknowledging.discard((window, id))


async def _answer(session: Session, window: ClientWindow, id: str, result: EditResult) -> None:
    await asyncio.wrap_future(result.saved)
    saved_ns = str(time.time_ns())  # text: JavaScript's numbers are exact to 2^53 only
    annotation, record = session.annotation, result.record
    placed, removed, tracks = await session.in_thread(partial(annotation.changed, record, shown_frames(session)))
    own_row = next((placement.row for placement in placed), None) if len(record.changes) == 1 else None
    can_undo, can_redo = annotation.undoable(window.annotator)
    unwritten = annotation.store.unwritten
    ack = Ack(
        id=id,
        seq=record.seq,
        version=record.seq,
        saved_ns=saved_ns,
        row=own_row,
        undo=can_undo,
        redo=can_redo,
        unwritten=unwritten,
    )
    changed = Changed(
        seq=record.seq,
        id=id,
        by=record.by,
        window=record.window,
        rows=tuple(placed),
        removed=tuple(removed),
        tracks=tuple(tracks),
        drive=_drive_of(annotation, record),
        sentence=str((record.data or {}).get("message", "")),
        unwritten=unwritten,
    )
    others = [] if result.repeated else [other for other in session.windows.values() if other is not window]
    _tell_windows(session, window, changed, others, op=record.op)
    window.send(ack)
    if not result.repeated:
        await check_edited(session, record, {row.frame for rows in (changed.rows, changed.removed) for row in rows})


def _drive_of(annotation: AnnotationService, record: Record) -> str:
    """The drive whose boxes or tracks an edit changed: there is one, as tracks do not leave theirs."""
    for change in record.changes:
        if change.cell[0] == "track":
            return change.cell[1]
        if change.cell[0] == "box":
            return annotation.store.drives.locate((change.cell[1], change.cell[2])).drive
    return ""


def _tell_windows(
    session: Session, window: ClientWindow, changed: Changed, others: Sequence[ClientWindow], *, op: str
) -> None:
    """Tell other windows of an edit, and its own, before the ack, of all that the ack of a box does not hold.

    Args:
        session: Its annotation was changed.
        window: The window that edited.
        changed: The edit.
        others: The other windows.
        op: What was done; after an undo or redo the nearest frame that it changes is to be shown.
    """
    annotation, is_step = session.annotation, op in (UNDO, REDO)
    frames = [*(row.frame for row in changed.rows), *(row.frame for row in changed.removed)]
    nearest = min(frames, key=lambda frame: abs(frame - (window.frame or 0)), default=None) if is_step else None
    alone = op.startswith("box.") and len(frames) == 1 and not changed.tracks and not changed.sentence
    empty = not (is_step or frames or changed.tracks or changed.sentence)
    for other in (*others, *(() if alone or empty else (window,))):
        can_undo, can_redo = annotation.undoable(other.annotator)
        show = nearest if other is window else None
        other.send(replace(changed, undo=can_undo, redo=can_redo, show=show))


@handles(requests.ProposalsCount)
async def proposals_count(session: Session, window: ClientWindow, request: requests.ProposalsCount) -> None:
    """Say how many proposals a person would accept."""
    annotation = session.annotation
    drive = _drive(session, request)
    window.send(await session.in_thread(partial(_counted, annotation, request, drive)))


def _counted(annotation: AnnotationService, request: requests.ProposalsCount, drive: str) -> Proposals:
    store = annotation.store
    keys = store.drives.keys(drive)
    with store.lock:
        meant = ProposalRange(drive=drive, first=0, last=len(keys) - 1, score=request.score)
        frames = [store.index_of[row.key] for row in proposals_of(store, meant)]
        return Proposals(
            id=request.id,
            frame=request.frame,
            score=request.score,
            seq=annotation.seq,
            here=frames.count(request.frame),
            count=len(frames),
            frames=len(set(frames)),
            first=store.index_of[keys[0]],
            last=store.index_of[keys[-1]],
        )


@handles(requests.CheckIgnore)
async def check_ignore(session: Session, window: ClientWindow, request: requests.CheckIgnore) -> None:
    """Let a finding stand."""
    store = session.annotation.store
    work = partial(notes.ignore, store, _author(window), request.id, request.check, request.reason)
    await _commit(session, window, request.id, work)
    for frame in shown_frames(session):
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
    name = annotation.box_name(request.frame, request.box)
    note = partial(notes.record_time, annotation.store, _author(window), id, key, name, request.seconds, request.edits)
    await annotation.editor.do(note)


async def propose(session: Session, job: InferJob, index: int, boxes: Boxes) -> None:
    """Add a detector's boxes of a frame as proposals."""
    annotation, author = session.annotation, Author(job.by, job.window)
    id, group = f"{job.id or job.name}-{index}"[-64:], job.id or job.name
    result = await annotation.editor.do(partial(annotation.annotator.propose, author, id, index, boxes, group))
    if result is not None:
        await _acknowledge(session, ClientWindow(id=job.window, annotator=job.by), result.record.id, result)
