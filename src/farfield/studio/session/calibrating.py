"""What calibration pages ask: residuals while values move, changes with undo, solvers as jobs, saving."""

import asyncio
import itertools
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

from farfield.errors import FarfieldError
from farfield.studio.calibrating.service import CalibrationError, CalibrationService, CancelledError
from farfield.studio.calibrating.task import CalibrationSolution
from farfield.studio.messages import calibration as requests
from farfield.studio.messages.calibration import CalibResidual, CalibSaved
from farfield.studio.messages.replies import Job
from farfield.studio.session.session import ClientWindow, Session, handles
from farfield.studio.showing.opened import plain_error

T = TypeVar("T")
_NUMBERS = itertools.count(1)
_STEPS = 1000
_REPORT_S = 0.1
"""Progress is reported at most so often."""


def _service(session: Session) -> CalibrationService:
    if session.calibrating is None:
        mend = "start it as `farfield calibrate radar-lidar DATA --page`"
        raise CalibrationError("view", "this studio does not calibrate", mend)
    return session.calibrating


def _ready(session: Session) -> CalibrationService:
    service = _service(session)
    if not service.ready:
        raise CalibrationError("reading", "the frames are still being read", "wait until they are")
    return service


CalibHandler = Callable[[Session, ClientWindow, Any], Awaitable[None]]


@dataclass(frozen=True)
class _once:  # noqa: N801 - a decorator
    """A handler that does nothing for a message that was taken before: the calibration as it stands answers it."""

    handler: CalibHandler

    async def __call__(self, session: Session, window: ClientWindow, request: Any) -> None:
        """Handle it unless it was."""
        service, message = _service(session), repr(request)
        if service.was_taken(message):
            window.send(service.state(request.id))
            return
        await self.handler(session, window, request)
        service.note_taken(message)


@handles(requests.CalibOpen)
async def opened(session: Session, window: ClientWindow, request: requests.CalibOpen) -> None:
    """Send the calibration; the first time, read the frames as a job."""
    service = _service(session)
    window.send(service.state(request.id))
    if service.ready or service.job is not None:
        return
    _start(session, window, request.id, "reading the frames", partial(_prepare, service))


def _prepare(service: CalibrationService, progress: Callable[[float], None]) -> None:
    service.task.prepare(progress)
    service.ready = True
    service.seq += 1


@handles(requests.CalibMatch)
async def residuals(session: Session, window: ClientWindow, request: requests.CalibMatch) -> None:
    """Send the residuals of some values."""
    service = _ready(session)
    session.opened.check(request.frame)
    values = service.values_of(request.radar, request.camera)
    session.aside(window, request.id, _residuals(session, window, request, values))


async def _residuals(session: Session, window: ClientWindow, request: requests.CalibMatch, values: object) -> None:
    service, started = _ready(session), time.monotonic()
    solved = service.now.solved if values == service.now.values else None
    snapshot = replace(service.now, values=values, solved=solved)  # type: ignore[arg-type]
    work = partial(service.task.residuals, snapshot, request.frame, full=request.full)
    residuals = await session.in_thread(work)
    residuals = replace(residuals, notes=(*residuals.notes, *service.remarks))
    spent = round(1e3 * (time.monotonic() - started), 1)
    window.send(CalibResidual(id=request.id, frame=request.frame, residuals=residuals, milliseconds=spent))


@handles(requests.CalibSet)
@_once
async def set_values(session: Session, window: ClientWindow, request: requests.CalibSet) -> None:
    """Take values."""
    del window
    service = _ready(session)
    service.set(request.base, service.values_of(request.radar, request.camera))
    session.broadcast(service.state(request.id))


@handles(requests.CalibPick)
@_once
async def pick(session: Session, window: ClientWindow, request: requests.CalibPick) -> None:
    """Add a pair."""
    del window
    service = _ready(session)
    service.pick(request.frame, request.point_m, request.pixel)
    session.broadcast(service.state(request.id))


@handles(requests.CalibUnpick)
@_once
async def unpick(session: Session, window: ClientWindow, request: requests.CalibUnpick) -> None:
    """Take a pair away, or leave it out or in."""
    del window
    service = _ready(session)
    service.unpick(request.pick, request.used)
    session.broadcast(service.state(request.id))


@handles(requests.CalibUndo)
@_once
async def undo(session: Session, window: ClientWindow, request: requests.CalibUndo) -> None:
    """Undo or redo."""
    del window
    service = _ready(session)
    service.undo(request.what)
    session.broadcast(service.state(request.id))


@handles(requests.CalibSolve)
@_once
async def solve(session: Session, window: ClientWindow, request: requests.CalibSolve) -> None:
    """Solve as a job."""
    service = _ready(session)
    _start(session, window, request.id, "solving", partial(_solve, service, request))


def _solve(
    service: CalibrationService, request: requests.CalibSolve, progress: Callable[[float], None]
) -> CalibrationSolution:
    return service.task.solve(service.now, request.how, progress, focal=request.focal)


@handles(requests.CalibCancel)
async def cancel(session: Session, window: ClientWindow, request: requests.CalibCancel) -> None:
    """Stop a job."""
    del window
    service = _service(session)
    if service.job != request.job:
        raise CalibrationError("job", f"there is no job {request.job} that runs")
    service.cancel()


@handles(requests.CalibSave)
@_once
async def save(session: Session, window: ClientWindow, request: requests.CalibSave) -> None:
    """Write the calibration."""
    service = _ready(session)
    session.aside(window, request.id, _save(session, service, request))


async def _save(session: Session, service: CalibrationService, request: requests.CalibSave) -> None:
    service.begin("save")
    try:
        files, copies = await session.in_thread(partial(service.save, request.to))
    finally:
        service.end()
    names = tuple(tuple(service.shown(path) for path in paths) for paths in (files, copies))
    session.broadcast(CalibSaved(id=request.id, files=names[0], copies=names[1]))
    session.broadcast(service.state(request.id))


@handles(requests.CalibRestore)
@_once
async def restore(session: Session, window: ClientWindow, request: requests.CalibRestore) -> None:
    """Put back what the last save replaced."""
    del window
    service = _ready(session)
    files = await session.in_thread(service.restore)
    names = tuple(service.shown(path) for path in files)
    session.broadcast(CalibSaved(id=request.id, files=names, copies=(), restored=True))
    session.broadcast(service.state(request.id))


Work = Callable[[Callable[[float], None]], CalibrationSolution | None]


def _start(session: Session, window: ClientWindow, name: str, message: str, work: Work) -> None:
    """Begin a job, if none runs."""
    service = _service(session)
    job = Job(id=name, job=f"calib-{next(_NUMBERS)}", kind="calibrate", state="running", total=_STEPS, message=message)
    service.begin(job.job)
    session.broadcast(job)
    session.aside(window, name, _run(session, service, replace(job, message=""), work))


async def _run(session: Session, service: CalibrationService, job: Job, work: Work) -> None:
    """Run a job with progress, and take its solution; all windows hear of it."""
    progress = _Progress(session, service, job)
    try:
        solution = await session.in_thread(partial(work, progress.step))
    except CancelledError:
        session.broadcast(replace(job, state="cancelled"))
        return
    except FarfieldError as error:
        session.broadcast(replace(job, state="failed", message=plain_error(error, session.data)))
        return
    except Exception:
        session.broadcast(replace(job, state="failed", message="the studio met an error of its own"))
        raise
    finally:
        service.end()
    if solution is not None:
        service.take(solution)
    session.broadcast(replace(job, state="done", done=_STEPS, message=solution.summary if solution else ""))
    session.broadcast(service.state(job.id))


class _Progress:
    """Reports to the windows how far a job is, from the thread in which it runs."""

    def __init__(self, session: Session, service: CalibrationService, job: Job) -> None:
        self.session, self.known, self.job = session, service, job
        self._loop = asyncio.get_running_loop()
        self._reported_s = self._began_s = time.monotonic()

    def step(self, share: float) -> None:
        """What a solver calls with the share that is done."""
        self.known.go_on()
        now = time.monotonic()
        if now - self._reported_s < _REPORT_S:
            return
        self._reported_s = now
        left = (now - self._began_s) * (1 - share) / share if share > 0.02 else None
        steps, eta = round(_STEPS * share), None if left is None else round(left, 1)
        self._loop.call_soon_threadsafe(self.session.broadcast, replace(self.job, done=steps, eta_s=eta))
