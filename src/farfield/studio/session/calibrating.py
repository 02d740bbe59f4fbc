"""What calibration pages ask: residuals while values move, changes with undo, solvers as jobs, saving."""

import asyncio
import itertools
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TypeVar

from farfield.errors import FarfieldError
from farfield.studio.calibrating.service import CalibrationError, CalibrationService, CancelledError
from farfield.studio.calibrating.task import CalibrationSolution
from farfield.studio.messages import calibration as asked
from farfield.studio.messages.calibration import CalibResidual, CalibSaved
from farfield.studio.messages.replies import Job
from farfield.studio.session.session import ClientWindow, Handler, Session
from farfield.studio.showing.opened import plain_error

T = TypeVar("T")
_NUMBERS = itertools.count(1)
_STEPS = 1000
_TOLD_S = 0.1
"""Progress is told at most so often."""


def _known(desk: Session) -> CalibrationService:
    if desk.calibrating is None:
        mend = "start it as `farfield calibrate radar-lidar DATA --page`"
        raise CalibrationError("view", "this studio does not calibrate", mend)
    return desk.calibrating


def _ready(desk: Session) -> CalibrationService:
    found = _known(desk)
    if not found.ready:
        raise CalibrationError("reading", "the frames are still being read", "wait until they are")
    return found


async def opened(desk: Session, window: ClientWindow, request: asked.CalibOpen) -> None:
    """Tell the calibration; the first time, read the frames as a job."""
    known = _known(desk)
    window.send(known.state(request.id))
    if known.ready or known.job is not None:
        return
    _start(desk, window, request.id, "reading the frames", partial(_prepared, known))


def _prepared(known: CalibrationService, told: Callable[[float], None]) -> None:
    known.task.prepare(told)
    known.ready = True
    known.seq += 1


async def matched(desk: Session, window: ClientWindow, request: asked.CalibMatch) -> None:
    """Tell the residuals of some values."""
    known = _ready(desk)
    desk.opened.check(request.frame)
    values = known.wanted(request.radar, request.camera)
    desk.aside(window, request.id, _residuals(desk, window, request, values))


async def _residuals(desk: Session, window: ClientWindow, request: asked.CalibMatch, values: object) -> None:
    known, started = _ready(desk), time.monotonic()
    there = replace(known.now, values=values)  # type: ignore[arg-type]
    work = partial(known.task.residuals, there, request.frame, full=request.full)
    found = await desk.in_thread(work)
    spent = round(1e3 * (time.monotonic() - started), 1)
    window.send(CalibResidual(id=request.id, frame=request.frame, residuals=found, milliseconds=spent))


async def put(desk: Session, window: ClientWindow, request: asked.CalibSet) -> None:
    """Take values."""
    del window
    known = _ready(desk)
    known.set(request.base, known.wanted(request.radar, request.camera))
    desk.tell(known.state(request.id))


async def pick(desk: Session, window: ClientWindow, request: asked.CalibPick) -> None:
    """Add a pair."""
    del window
    known = _ready(desk)
    known.pick(request.frame, request.point_m, request.pixel)
    desk.tell(known.state(request.id))


async def unpick(desk: Session, window: ClientWindow, request: asked.CalibUnpick) -> None:
    """Take a pair away, or leave it out or in."""
    del window
    known = _ready(desk)
    known.unpick(request.pick, request.used)
    desk.tell(known.state(request.id))


async def undo(desk: Session, window: ClientWindow, request: asked.CalibUndo) -> None:
    """Undo or redo."""
    del window
    known = _ready(desk)
    known.undo(request.what)
    desk.tell(known.state(request.id))


async def solve(desk: Session, window: ClientWindow, request: asked.CalibSolve) -> None:
    """Solve as a job."""
    known = _ready(desk)
    _start(desk, window, request.id, "solving", partial(_solved, known, request))


def _solved(known: CalibrationService, request: asked.CalibSolve, told: Callable[[float], None]) -> CalibrationSolution:
    return known.task.solve(known.now, request.how, told, focal=request.focal)


async def cancel(desk: Session, window: ClientWindow, request: asked.CalibCancel) -> None:
    """Stop a job."""
    del window
    known = _known(desk)
    if known.job != request.job:
        raise CalibrationError("job", f"there is no job {request.job} that runs")
    known.cancel()


async def save(desk: Session, window: ClientWindow, request: asked.CalibSave) -> None:
    """Write the calibration."""
    known = _ready(desk)
    desk.aside(window, request.id, _saved(desk, known, request))


async def _saved(desk: Session, known: CalibrationService, request: asked.CalibSave) -> None:
    known.begin("save")
    try:
        files, copies = await desk.in_thread(partial(known.save, request.to))
    finally:
        known.end()
    names = tuple(tuple(known.shown(path) for path in paths) for paths in (files, copies))
    desk.tell(CalibSaved(id=request.id, files=names[0], copies=names[1]))
    desk.tell(known.state(request.id))


async def restore(desk: Session, window: ClientWindow, request: asked.CalibRestore) -> None:
    """Put back what the last save replaced."""
    del window
    known = _ready(desk)
    files = await desk.in_thread(known.restore)
    names = tuple(known.shown(path) for path in files)
    desk.tell(CalibSaved(id=request.id, files=names, copies=(), restored=True))
    desk.tell(known.state(request.id))


Work = Callable[[Callable[[float], None]], CalibrationSolution | None]


def _start(desk: Session, window: ClientWindow, name: str, words: str, work: Work) -> None:
    """Begin a job, if none runs."""
    known = _known(desk)
    job = Job(id=name, job=f"calib-{next(_NUMBERS)}", kind="calibrate", state="running", total=_STEPS, message=words)
    known.begin(job.job)
    desk.tell(job)
    desk.aside(window, name, _run(desk, known, replace(job, message=""), work))


async def _run(desk: Session, known: CalibrationService, job: Job, work: Work) -> None:
    """Run a job with progress, and take what it finds; all windows are told."""
    progress = _Progress(desk, known, job)
    try:
        found = await desk.in_thread(partial(work, progress.step))
    except CancelledError:
        desk.tell(replace(job, state="cancelled"))
        return
    except FarfieldError as error:
        desk.tell(replace(job, state="failed", message=plain_error(error, desk.data)))
        return
    except Exception:
        desk.tell(replace(job, state="failed", message="the studio met an error of its own"))
        raise
    finally:
        known.end()
    if found is not None:
        known.take(found)
    desk.tell(replace(job, state="done", done=_STEPS, message=found.words if found else ""))
    desk.tell(known.state(job.id))


class _Progress:
    """Tells the windows how far a job is, from the thread in which it runs."""

    def __init__(self, desk: Session, known: CalibrationService, job: Job) -> None:
        self.desk, self.known, self.job = desk, known, job
        self._loop = asyncio.get_running_loop()
        self._told = self._began = time.monotonic()

    def step(self, share: float) -> None:
        """What a solver calls with the share that is done."""
        self.known.go_on()
        now = time.monotonic()
        if now - self._told < _TOLD_S:
            return
        self._told = now
        left = (now - self._began) * (1 - share) / share if share > 0.02 else None
        done, eta = round(_STEPS * share), None if left is None else round(left, 1)
        self._loop.call_soon_threadsafe(self.desk.tell, replace(self.job, done=done, eta_s=eta))


HANDLERS: dict[type, Handler] = {
    asked.CalibOpen: opened,
    asked.CalibMatch: matched,
    asked.CalibSet: put,
    asked.CalibPick: pick,
    asked.CalibUnpick: unpick,
    asked.CalibUndo: undo,
    asked.CalibSolve: solve,
    asked.CalibCancel: cancel,
    asked.CalibSave: save,
    asked.CalibRestore: restore,
}
