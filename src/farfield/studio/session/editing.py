"""What windows that annotate ask for: edits, undo, fits, checks, saves."""

import asyncio
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from farfield.annotation import notes
from farfield.annotation.errors import ConflictError
from farfield.annotation.store import REDO, UNDO, Author, EditResult
from farfield.errors import ConfigError, FarfieldError
from farfield.frame import Boxes
from farfield.studio.annotating.annotation import AnnotationService
from farfield.studio.annotating.saves import save as save_labels
from farfield.studio.inferring.jobs import InferJob
from farfield.studio.messages import requests as asked
from farfield.studio.messages.replies import Ack, Changed, Checks, Conflict, Failure, PolicyIs, Saved
from farfield.studio.session.session import ClientWindow, Session
from farfield.studio.showing.opened import plain_error


def annotating(desk: Session) -> AnnotationService:
    """The annotation.

    Raises:
        ConfigError: If the studio shows only.
    """
    if desk.annotating is None:
        raise ViewOnly
    return desk.annotating


class ViewOnly(ConfigError):  # noqa: N818
    """The studio shows only."""

    code = "view"
    mend = "start it as `farfield annotate` to change boxes"

    def __init__(self) -> None:
        super().__init__("this studio shows only")


async def edit(desk: Session, window: ClientWindow, request: asked.Edit) -> None:
    """Make an edit; it is acknowledged once it is on the disk."""
    known = annotating(desk)
    frame = getattr(request, "frame", window.frame if window.frame is not None else 0)
    if isinstance(request, asked.TrackPropagate | asked.TrackInterpolate):
        frame = request.first
    desk.opened.check(frame)
    author, drive = Author(window.annotator, window.id), known.drive_of(frame)
    if isinstance(request, asked.TrackPropagate):
        desk.aside(window, request.id, _slowly(desk, window, request, author, drive))
        return
    await _taken(desk, window, request.id, partial(known.edit, author, request, drive))


async def _slowly(
    desk: Session, window: ClientWindow, request: asked.TrackPropagate, author: Author, drive: str
) -> None:
    """Propagation fits in many frames: it holds up nobody's edits."""
    done = await desk.in_thread(lambda: annotating(desk).edit(author, request, drive))
    await _saved(desk, window, request.id, done)


async def undo(desk: Session, window: ClientWindow, request: asked.Undo | asked.Redo) -> None:
    """Take back or do again."""
    store, author = annotating(desk).store, Author(window.annotator, window.id)
    step = store.undo if isinstance(request, asked.Undo) else store.redo
    everybody = request.scope == "all"
    await _taken(
        desk, window, request.id, lambda: step(store, author, request.id, everybody=everybody, force=request.force)
    )


async def _taken(desk: Session, window: ClientWindow, name: str, work: Callable[[], EditResult]) -> None:
    """Edits are taken in the order in which they come; that they are on the disk is waited for beside them."""
    known = annotating(desk)
    try:
        done = await known.editor.do(work)
    except ConflictError as error:
        window.send(await desk.in_thread(partial(_conflict, known, name, error)))
        return
    desk.aside(window, name, _saved(desk, window, name, done))


def _conflict(known: AnnotationService, name: str, error: ConflictError) -> Conflict:
    if error.cell[0] == "track":
        sentence = f"track {error.cell[2]} was changed by {error.by or 'somebody'} meanwhile"
        track = known.shown.track(error.cell[1], error.cell[2])
        return Conflict(id=name, by=error.by, sentence=sentence, track=track)
    key = (error.cell[1], error.cell[2])
    row, index = known.store.row(key, error.cell[3]), known.store.index_of[key]
    present = None if row is None else known.shown.box(index, row)
    what = "removed" if row is None else "changed"
    sentence = f"{error.by or 'somebody'} {what} this box meanwhile"
    return Conflict(id=name, by=error.by, sentence=sentence, frame=index, present=present)


async def _saved(desk: Session, window: ClientWindow, name: str, done: EditResult) -> None:
    """Once an edit is on the disk: acknowledge it, tell the others, and check the frames that are shown."""
    await asyncio.wrap_future(done.saved)
    saved_ns = str(time.time_ns())
    known, record = annotating(desk), done.record
    placed, removed, tracks = await desk.in_thread(lambda: known.changed(record))
    own = next((each.row for each in placed), None) if len(record.changes) == 1 else None
    undo, redo = _able(known, window)
    window.send(Ack(id=name, seq=record.seq, version=record.seq, saved_ns=saved_ns, row=own, undo=undo, redo=redo))
    if done.repeated:
        return
    changed = Changed(
        seq=record.seq,
        id=name,
        by=record.by,
        window=record.window,
        rows=tuple(placed),
        removed=tuple(removed),
        tracks=tuple(tracks),
        sentence=str((record.data or {}).get("message", "")),
    )
    _spread(desk, window, changed, steps=record.op in (UNDO, REDO), alone=len(record.changes) == 1)


def _able(known: AnnotationService, window: ClientWindow) -> tuple[bool, bool]:
    """Whether a window's annotator can undo and redo."""
    return known.can(window.annotator, UNDO), known.can(window.annotator, REDO)


def _spread(desk: Session, window: ClientWindow, changed: Changed, *, steps: bool, alone: bool) -> None:
    """Tell the other windows of an edit, and its own of what the tool did beyond the box that it sent."""
    known = annotating(desk)
    frames = [*(each.frame for each in changed.rows), *(each.frame for each in changed.removed)]
    nearest = min(frames, key=lambda frame: abs(frame - (window.frame or 0)), default=None) if steps else None
    for other in list(desk.windows.values()):
        undo, redo = _able(known, other)
        if other is not window:
            other.send(replace(changed, undo=undo, redo=redo))
        elif steps or not alone or changed.tracks or changed.sentence:
            other.send(replace(changed, undo=undo, redo=redo, show=nearest))
    shown = {other.frame for other in desk.windows.values() if other.frame is not None}
    for frame in shown & set(frames):
        check_soon(desk, frame)


def check_soon(desk: Session, frame: int) -> None:
    """Check a frame once edits pause for a moment, and tell the windows that show it."""
    waiting = frame in desk.checking
    desk.checking[frame] = time.monotonic()
    if waiting:
        return
    desk.aside(ClientWindow(id="", annotator=""), None, _check(desk, frame))


async def _check(desk: Session, frame: int) -> None:
    began = time.monotonic()
    while (paused := time.monotonic() - desk.checking[frame]) < _PAUSE_S and time.monotonic() - began < _LONGEST_S:
        await asyncio.sleep(_PAUSE_S - paused)
    del desk.checking[frame]
    reply = await desk.in_thread(lambda: checks_of(desk, frame))
    for window in desk.windows.values():
        if window.frame == frame:
            window.send(reply)


def checks_of(desk: Session, frame: int) -> Checks:
    """The findings of a frame, disagreements with the sets of detections among them."""
    known, key = annotating(desk), desk.book.data.keys[frame]
    found = [
        each.boxes[key] for each in desk.book.sets.values() if key in each.boxes and each.about.kind == "detections"
    ]
    return Checks(frame=frame, rows=known.checks(frame, found[0] if found else None))


async def check_list(desk: Session, window: ClientWindow, request: asked.CheckList) -> None:
    """Findings of a frame, or of all."""
    annotating(desk)
    if request.frame is None:
        desk.aside(window, None, _check_all(desk, window))
        return
    desk.opened.check(request.frame)
    frame = request.frame
    window.send(await desk.in_thread(lambda: checks_of(desk, frame)))


async def _check_all(desk: Session, window: ClientWindow) -> None:
    window.send(Checks(frame=None, rows=await desk.in_thread(annotating(desk).all_checks)))


async def check_ignore(desk: Session, window: ClientWindow, request: asked.CheckIgnore) -> None:
    """Let a finding stand."""
    store, author = annotating(desk).store, Author(window.annotator, window.id)
    await _taken(
        desk, window, request.id, lambda: notes.ignore(store, author, request.id, request.check, request.reason)
    )
    for frame in {other.frame for other in desk.windows.values() if other.frame is not None}:
        check_soon(desk, frame)


async def fit(desk: Session, window: ClientWindow, request: asked.Fit) -> None:
    """Find the box that a gesture means."""
    known = annotating(desk)
    desk.opened.check(request.frame)
    desk.aside(window, request.id, _fit(desk, window, known, request))


async def _fit(desk: Session, window: ClientWindow, known: AnnotationService, request: asked.Fit) -> None:
    window.send(await desk.in_thread(lambda: known.fitter.fit(request)))


async def policy(desk: Session, window: ClientWindow, request: asked.PolicySet) -> None:
    """Declare what the boxes hold."""
    store, author = annotating(desk).store, Author(window.annotator, window.id)
    await _taken(desk, window, request.id, lambda: notes.declare_extent(store, author, request.id, request.extent))
    if store.extent is not None:
        desk.tell(PolicyIs(extent=store.extent))


async def timing(desk: Session, window: ClientWindow, request: asked.Timing) -> None:
    """Note the time that a box took."""
    known, author = annotating(desk), Author(window.annotator, window.id)
    desk.opened.check(request.frame)
    key, name = known.store.keys[request.frame], f"time-{window.id}-{time.time_ns()}"[:64]
    note = partial(notes.worked, known.store, author, name, key, request.box, request.seconds, request.edits)
    await known.editor.do(note)


async def save(desk: Session, window: ClientWindow, request: asked.Save) -> None:
    """Write the label files."""
    annotating(desk)
    desk.aside(window, request.id, _save(desk, window, request))


async def _save(desk: Session, window: ClientWindow, request: asked.Save) -> None:
    known, author = annotating(desk), Author(window.annotator, window.id)
    written = await desk.in_thread(
        lambda: save_labels(known.store, desk.settings, author, request.id, request.folder, request.format)
    )
    known.saved_seq = known.seq
    words = f"{written.files} label file{'' if written.files == 1 else 's'} written"
    window.send(
        Saved(
            id=request.id,
            seq=written.seq,
            files=written.files,
            saved_ns=str(time.time_ns()),
            folder=written.folder,
            sentence=words,
        )
    )


async def propose(desk: Session, job: InferJob, index: int, boxes: Boxes) -> None:
    """Add what a detector found in a frame as proposals."""
    known, author = annotating(desk), Author(job.by, job.window)
    work = partial(known.propose, author, f"{job.id or job.name}-{index}"[-64:], index, boxes, job.id or job.name)
    done = await known.editor.do(work)
    if done is not None:
        await _saved(desk, ClientWindow(id=job.window, annotator=job.by), done.record.id, done)


async def autosave(desk: Session) -> None:
    """Write label files every half minute, where saves go into them: what is in the journal is safe without."""
    while True:
        await asyncio.sleep(AUTOSAVE_S)
        await save_now(desk)


async def save_now(desk: Session) -> None:
    """Write label files that have unsaved edits, where saves go into them."""
    known = desk.annotating
    if known is None or not known.in_place or known.saved_seq == known.seq:
        return
    name = f"autosave-{time.time_ns()}"
    try:
        author = Author(desk.annotator, "")
        written = await desk.in_thread(lambda: save_labels(known.store, desk.settings, author, name, None, ""))
    except FarfieldError as error:
        desk.tell(Failure(sentence=f"the label files could not be saved: {plain_error(error, desk.data)}", mend=_KEPT))
        return
    known.saved_seq = known.seq
    saved_ns = str(time.time_ns())
    desk.tell(Saved(id=name, seq=written.seq, files=written.files, saved_ns=saved_ns, folder=written.folder))


AUTOSAVE_S = 30.0
_PAUSE_S, _LONGEST_S = 0.05, 1.0  # without edits before a frame is checked, and how long it may wait
_KEPT = "your edits are safe in the journal; mend the cause and save again"
