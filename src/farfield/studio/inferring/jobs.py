"""Detection as jobs with progress: frames that somebody looks at go before those of a whole sequence."""

import asyncio
import logging
import time
from collections import deque
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from functools import partial

from farfield.errors import FarfieldError
from farfield.frame import Boxes
from farfield.studio.inferring.worker import Worker
from farfield.studio.messages.replies import Job
from farfield.studio.threads import ThreadGroup

Deliver = Callable[["InferJob", int, Boxes], Awaitable[None]]
_LOG = logging.getLogger(__name__)
_REPORT_S = 0.2
"""Progress is reported at most so often."""
_MOST_ENDED = 200
"""Jobs that have ended and are remembered, for requests that come again."""


@dataclass(eq=False)
class InferJob:
    """A detector over some frames.

    Args:
        id: The client's name of the request.
        name: Of the job.
        detector: Which.
        frames: Numbers of the frames that are left.
        window: Who asked.
        threshold: Least score of what is proposed.
        by: Annotator who asked.
        propose: Whether boxes become proposals of the annotation.
    """

    id: str
    name: str
    detector: str
    frames: deque[int]
    window: str = ""
    threshold: float = 0.0
    propose: bool = False
    by: str = ""
    total: int = 0
    frames_done: int = 0
    seconds: float = 0.0
    state: str = "queued"
    message: str = ""
    reported_at: float = field(default=0.0)

    def reply(self) -> Job:
        """Its progress as a message."""
        left = (self.total - self.frames_done) * self.seconds / self.frames_done if self.frames_done else None
        return Job(
            id=self.id,
            job=self.name,
            kind="infer",
            state=self.state,  # type: ignore[arg-type]
            done=self.frames_done,
            total=self.total,
            eta_s=None if left is None or self.state != "running" else round(left, 1),
            message=self.message,
        )


class Jobs:
    """Jobs of one worker.

    Args:
        worker: Who detects.
        deliver: Takes the boxes of a frame.
        tell: Takes a job whose progress is to be reported.
    """

    def __init__(self, worker: Worker, deliver: Deliver, tell: Callable[[InferJob], None]) -> None:
        self.worker, self.deliver, self.tell = worker, deliver, tell
        self.jobs: dict[str, InferJob] = {}
        self._waiting: deque[InferJob] = deque()
        self._wake = asyncio.Event()
        self._thread = ThreadGroup(1, "detect")
        self._task: asyncio.Task[None] | None = None

    def add(self, job: InferJob) -> None:
        """Queue a job; one of a single frame goes before longer ones."""
        job.total = len(job.frames)
        self.jobs[job.name] = job
        if job.total == 1:
            self._waiting.appendleft(job)
        else:
            self._waiting.append(job)
        self.tell(job)
        self._wake.set()
        if self._task is None:
            self._task = asyncio.get_running_loop().create_task(self._run())

    def cancel(self, name: str) -> bool:
        """Stop a job after the frame that it is at; False where there is none that runs."""
        job = self.jobs.get(name)
        if job is None or job.state not in ("queued", "running"):
            return False
        self._end(job, "cancelled")
        return True

    async def close(self) -> None:
        """End everything."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)
        self.worker.stop()
        self._thread.end()

    async def _run(self) -> None:
        while True:
            if not self._waiting:
                self._wake.clear()
                await self._wake.wait()
                continue
            job = self._waiting[0]
            if not job.frames:
                self._end(job, "done")
                continue
            try:
                await self._next(job)
            except Exception:  # noqa: BLE001 - it ends this job, not those behind it
                _LOG.exception("detecting with %s", job.detector)
                job.message = "the studio met an error of its own; the terminal shows it"
                self._end(job, "failed")

    async def _next(self, job: InferJob) -> None:
        job.state, index, started = "running", job.frames.popleft(), time.monotonic()
        if not job.frames_done:
            self.tell(job)
        try:
            boxes = await self._thread.do(partial(self.worker.ask, job.detector, index))
        except FarfieldError as error:
            job.message = str(error)
            self._end(job, "failed")
            return
        if job.state == "cancelled":
            return
        job.frames_done += 1
        job.seconds += time.monotonic() - started
        await self.deliver(job, index, boxes)
        if not job.frames:
            self._end(job, "done")
        elif time.monotonic() - job.reported_at > _REPORT_S:
            job.reported_at = time.monotonic()
            self.tell(job)

    def _end(self, job: InferJob, state: str) -> None:
        job.state = state
        job.frames.clear()
        if job in self._waiting:
            self._waiting.remove(job)
        ended = [name for name, other in self.jobs.items() if other.state not in ("queued", "running")]
        for name in ended[:-_MOST_ENDED]:
            del self.jobs[name]
        self.tell(job)
