"""One open data set with the windows before it, and the table of what answers each message.

A function is registered for a class of messages in one step::

    @handles(requests.Preview)
    async def preview(session: Session, window: ClientWindow, request: requests.Preview) -> None: ...
"""

import asyncio
import os
import sys
import time
import traceback
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar

from farfield.datasets.base import Dataset
from farfield.errors import ConfigError, FarfieldError
from farfield.studio.exports import Exports
from farfield.studio.messages.replies import Bye, Refused, Reply, Windows
from farfield.studio.options import StudioSettings
from farfield.studio.session.frame_cache import FrameCache
from farfield.studio.showing.opened import OpenedDataset, plain_error
from farfield.studio.threads import ThreadGroup

if TYPE_CHECKING:
    from farfield.studio.calibrating.service import CalibrationService
    from farfield.studio.inferring.jobs import Jobs
    from farfield.studio.session.checking import DriveChecker
    from farfield.studio.showing.annotations import AnnotationService

_MOST_ANSWERS = 200
"""Answers to long requests that are kept for messages that come again."""
T = TypeVar("T")
H = TypeVar("H", bound=Callable[..., Awaitable[None]])


@dataclass(eq=False)
class ClientWindow:
    """One window of the page.

    Args:
        id: Its name, its own among those open.
        annotator: Who sits before it.
        room: How many replies may wait; a window that does not read them is sent away.
        matching: Changes with every request for matches, so that an older one is given up.
        checking: The drive whose findings it follows; None: of none.
    """

    id: str
    annotator: str
    room: int = 5000
    frame: int | None = None
    drive: str | None = None
    threshold: float = 0.0
    sweeps: int = 1
    matching: object = None
    checking: str | None = None
    replies: "asyncio.Queue[Reply | str]" = field(default_factory=asyncio.Queue)

    def send(self, reply: "Reply | str") -> None:
        """Queue a reply, or its text if that is the same for many."""
        if self.replies.qsize() > self.room:
            while not self.replies.empty():
                self.replies.get_nowait()
            self.replies.put_nowait(Bye(reason="this window did not read what it was sent: reload it"))
        else:
            self.replies.put_nowait(reply)


class ViewOnlyError(ConfigError):
    """The studio shows only."""

    code, mend = "view", "start it as `farfield annotate` to change boxes"

    def __init__(self) -> None:
        super().__init__("this studio shows only")


class Session:
    """What windows share.

    Args:
        settings: What the studio was started with.
    """

    def __init__(self, settings: StudioSettings) -> None:
        self.settings = settings
        self.annotator = settings.annotator
        self.windows: dict[str, ClientWindow] = {}
        self.threads = ThreadGroup(3, "session")
        self.checks = ThreadGroup(1, "check")
        self.exports = Exports()
        self.data: Dataset | None = None
        self.annotating: AnnotationService | None = None
        self.jobs: Jobs | None = None
        self.calibrating: CalibrationService | None = None
        self.edited_at: dict[int, float] = {}  # frames to be checked, and when each was edited last
        self.checkers: dict[str, DriveChecker] = {}  # of the drives whose findings windows follow
        self.busy_at = 0.0  # when a window last sent something
        self.under_way: set[str] = set()  # ids of the long edits that go on
        self.acknowledging: set[tuple[ClientWindow, str]] = set()  # who is to hear of which edits
        self._ready = asyncio.Event()
        self._tasks: set[asyncio.Task[Any]] = set()
        self._answers: dict[str, asyncio.Task[Any]] = {}

    @property
    def ready(self) -> bool:
        """Whether the data set is open."""
        return self._ready.is_set()

    @property
    def opened(self) -> OpenedDataset:
        """Layers of the open data set."""
        return self.frames.opened

    @property
    def annotation(self) -> "AnnotationService":
        """The annotation.

        Raises:
            ViewOnlyError: If the studio shows only.
        """
        if self.annotating is None:
            raise ViewOnlyError
        return self.annotating

    def open(self, data: Dataset) -> None:
        """Open a data set: reads files, so it is for a thread. :meth:`let_in` lets the windows in.

        Raises:
            FarfieldError: If predictions or edits cannot be read or do not belong to it.
        """
        self.data = data
        opened = OpenedDataset(data)
        if self.settings.mode == "annotate":
            from farfield.studio.showing.annotations import AnnotationService

            self.annotating = AnnotationService(opened, self.settings)
        annotation = self.annotating
        edited = () if annotation is None else (annotation.rows, annotation.centres)
        self.frames = FrameCache(opened, self.settings, *edited)
        if self.settings.calibration is not None:
            from farfield.studio.calibrating.service import CalibrationService

            self.calibrating = CalibrationService(data, self.settings.calibration)

    def let_in(self) -> None:
        """Let the windows in that wait."""
        self._ready.set()

    async def in_thread(self, work: Callable[[], T]) -> T:
        """Run what reads files or computes beside the event loop."""
        return await self.threads.do(work)

    def aside(self, window: ClientWindow | None, id: str | None, work: Awaitable[None]) -> None:
        """Let something go on aside, as a task, while further messages are answered.

        Args:
            window: Gets a refusal if it fails; None: nobody does.
            id: The client's name of the request.
            work: What goes on.
        """
        task = asyncio.get_running_loop().create_task(self._aside(window, id, work))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _aside(self, window: ClientWindow | None, id: str | None, work: Awaitable[None]) -> None:
        try:
            await work
        except Exception as error:  # noqa: BLE001
            refused = self.refusal(id, error)
            if window is not None:
                window.send(refused)

    async def once(self, request: Any, work: Callable[[], Coroutine[Any, Any, T]]) -> T:
        """Do what a message requests, which may take long; the same message again awaits the same answer.

        Args:
            request: The message.
            work: What is done, the first time.
        """
        key = repr(request)
        task = self._answers.get(key)
        if task is None:
            task = self._answers[key] = asyncio.get_running_loop().create_task(work())
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
            for old in list(self._answers)[:-_MOST_ANSWERS]:
                del self._answers[old]
        return await asyncio.shield(task)

    def refusal(self, id: str | None, error: Exception) -> Refused:
        """An error as a reply: its message, never a traceback or a path of this machine."""
        if isinstance(error, OSError) and error.strerror:
            name = os.fsdecode(error.filename) if isinstance(error.filename, str | bytes) else "the disk"
            sentence = plain_error(f"{name}: {error.strerror}", self.data)
            return Refused(id=id, code="disk", sentence=sentence, mend="Make room, or give the right to write there.")
        if not isinstance(error, FarfieldError):
            traceback.print_exception(error, file=sys.stderr)
            sentence = f"the studio met an error of its own ({type(error).__name__}); its terminal shows it"
            return Refused(id=id, code="failed", sentence=sentence)
        code, mend = str(getattr(error, "code", "refused")), plain_error(getattr(error, "mend", ""), self.data)
        sentence = str(getattr(error, "sentence", "")) or str(error)
        return Refused(id=id, code=code, sentence=plain_error(sentence, self.data), mend=mend)

    async def handle(self, window: ClientWindow, request: Any) -> None:
        """Answer a message by the handler of its class."""
        self.busy_at = time.monotonic()
        id = getattr(request, "id", None)
        try:
            handler = HANDLERS.get(type(request))
            if handler is None:
                raise ViewOnlyError
            await handler(self, window, request)
        except Exception as error:  # noqa: BLE001
            window.send(self.refusal(id, error))

    def window_name(self, name: str) -> str:
        """A name for a new window: the one that it requests if that is free."""
        free, number = name, 1
        while free in self.windows:
            number += 1
            free = f"{name[:56]}-{number}"
        return free

    async def join(self, window: ClientWindow, welcome: Callable[["Session", ClientWindow], Reply]) -> None:
        """Welcome a window, once the data set is open."""
        self.windows[window.id] = window
        await self._ready.wait()
        window.send(await self.in_thread(lambda: welcome(self, window)))
        self._count_windows()

    def leave(self, window: ClientWindow) -> None:
        """Forget a window."""
        self.windows.pop(window.id, None)
        self._count_windows()

    def broadcast(self, reply: Reply) -> None:
        """Send something to all windows."""
        for window in self.windows.values():
            window.send(reply)

    def _count_windows(self) -> None:
        names = tuple(sorted({window.annotator for window in self.windows.values() if window.annotator}))
        self.broadcast(Windows(count=len(self.windows), annotators=names))

    def goodbye(self, reason: str) -> None:
        """Say goodbye to all windows."""
        self.broadcast(Bye(reason=reason))

    async def close(self) -> None:
        """End what still works for the windows."""
        if self.calibrating is not None:
            self.calibrating.cancel()
        for task in list(self._tasks):
            task.cancel()
        if self.jobs is not None:
            await self.jobs.close()
        if self.annotating is not None:
            await self.in_thread(self.annotating.close)
        self.threads.end()
        self.checks.end()
        self.exports.close()


Handler = Callable[[Session, ClientWindow, Any], Awaitable[None]]
HANDLERS: dict[type, Handler] = {}
"""The function that answers each class of messages; the modules beside this one fill it as they are imported."""


@dataclass(frozen=True)
class handles:  # noqa: N801 - a decorator
    """Register the decorated function as the handler of a class of messages.

    Args:
        message: The class.
    """

    message: type

    def __call__(self, handler: H) -> H:
        """Register it."""
        HANDLERS[self.message] = handler
        return handler
