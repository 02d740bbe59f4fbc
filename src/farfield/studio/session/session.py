"""The desk: one open data set, the windows before it, and what each message does."""

import asyncio
import sys
import traceback
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar

from farfield.datasets.base import Dataset
from farfield.errors import FarfieldError
from farfield.studio.exports import Exports
from farfield.studio.messages.replies import Bye, Refused, Reply, Windows
from farfield.studio.options import StudioSettings
from farfield.studio.session.frame_cache import FrameCache
from farfield.studio.showing.opened import OpenedDataset, plain_error
from farfield.studio.threads import ThreadGroup

if TYPE_CHECKING:
    from farfield.studio.annotating.annotation import AnnotationService
    from farfield.studio.calibrating.service import CalibrationService
    from farfield.studio.inferring.jobs import Jobs

T = TypeVar("T")
_ONLY_SHOWS = "this studio shows only"
_ANNOTATE = "start it as `farfield annotate` to change boxes"


@dataclass(eq=False)
class ClientWindow:
    """A window.

    Args:
        id: Its name, its own among those open.
        annotator: Who sits before it.
        matching: Changes with every request for matches, so that an older one is given up.
        room: How many replies may wait; a window that does not read loses its place.
    """

    id: str
    annotator: str
    room: int = 5000
    frame: int | None = None
    drive: str | None = None
    threshold: float = 0.0
    sweeps: int = 1
    matching: object = None
    replies: "asyncio.Queue[Reply | str]" = field(default_factory=asyncio.Queue)

    def send(self, reply: "Reply | str") -> None:
        """Queue a reply, or its text if that is the same for many."""
        if self.replies.qsize() > self.room:
            while not self.replies.empty():
                self.replies.get_nowait()
            self.replies.put_nowait(Bye(reason="this window did not read what it was sent: reload it"))
        else:
            self.replies.put_nowait(reply)


Handler = Callable[["Session", ClientWindow, Any], Awaitable[None]]


class Session:
    """What windows share.

    Args:
        settings: What the studio was started with.
        handlers: What each kind of message does.
    """

    def __init__(self, settings: StudioSettings, handlers: dict[type, Handler]) -> None:
        self.settings, self.handlers = settings, handlers
        self.annotator = settings.annotator
        self.windows: dict[str, ClientWindow] = {}
        self.threads = ThreadGroup(3, "desk")
        self.exports = Exports()
        self.data: Dataset | None = None
        self.annotating: AnnotationService | None = None
        self.jobs: Jobs | None = None
        self.calibrating: CalibrationService | None = None
        self.checking: dict[int, float] = {}  # frames to be checked, and when each was edited last
        self._ready = asyncio.Event()
        self._tasks: set[asyncio.Task[None]] = set()

    @property
    def ready(self) -> bool:
        """Whether the data set is open."""
        return self._ready.is_set()

    @property
    def opened(self) -> OpenedDataset:
        """Layers of the open data set."""
        return self.book.opened

    def open(self, data: Dataset) -> None:
        """Take a data set: what reads files, for a thread. :meth:`let_in` lets the windows in.

        Raises:
            FarfieldError: If predictions or edits cannot be read or do not belong to it.
        """
        self.data = data
        opened = OpenedDataset(data)
        if self.settings.mode == "annotate":
            from farfield.studio.annotating.annotation import AnnotationService

            self.annotating = AnnotationService(opened, self.settings)
        edited = self.annotating
        given = () if edited is None else (edited.rows, edited.centres)
        self.book = FrameCache(opened, self.settings, *given)
        if self.settings.calibration is not None:
            from farfield.studio.calibrating.service import CalibrationService

            self.calibrating = CalibrationService(data, self.settings.calibration)

    def let_in(self) -> None:
        """Let the windows in that wait."""
        self._ready.set()

    async def in_thread(self, work: Callable[[], T]) -> T:
        """Run what reads files or computes beside the event loop."""
        return await self.threads.do(work)

    def aside(self, window: ClientWindow, name: str | None, work: Awaitable[None]) -> None:
        """Let something go on beside further messages; what goes wrong is told to the window."""
        task = asyncio.get_running_loop().create_task(self._aside(window, name, work))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _aside(self, window: ClientWindow, name: str | None, work: Awaitable[None]) -> None:
        try:
            await work
        except Exception as error:  # noqa: BLE001
            window.send(self.refusal(name, error))

    def refusal(self, name: str | None, error: Exception) -> Refused:
        """An error as a reply: its message, never a traceback or a path of this machine."""
        if not isinstance(error, FarfieldError):
            traceback.print_exception(error, file=sys.stderr)
            sentence = f"the studio met an error of its own ({type(error).__name__}); its terminal shows it"
            return Refused(id=name, code="failed", sentence=sentence)
        code, mend = str(getattr(error, "code", "refused")), plain_error(getattr(error, "mend", ""), self.data)
        sentence = str(getattr(error, "sentence", "")) or str(error)
        return Refused(id=name, code=code, sentence=plain_error(sentence, self.data), mend=mend)

    async def handle(self, window: ClientWindow, request: Any) -> None:
        """Do what a message asks."""
        name = getattr(request, "id", None)
        work = self.handlers.get(type(request))
        if work is None:
            window.send(Refused(id=name, code="view", sentence=_ONLY_SHOWS, mend=_ANNOTATE))
            return
        try:
            await work(self, window, request)
        except Exception as error:  # noqa: BLE001
            window.send(self.refusal(name, error))

    def name_of(self, wanted: str) -> str:
        """A name for a new window: the one that it wants if that is free."""
        name, number = wanted, 1
        while name in self.windows:
            number += 1
            name = f"{wanted[:56]}-{number}"
        return name

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

    def tell(self, reply: Reply, *, but: ClientWindow | None = None) -> None:
        """Send something to all windows, or to all but one."""
        for window in self.windows.values():
            if window is not but:
                window.send(reply)

    def _count_windows(self) -> None:
        names = tuple(sorted({window.annotator for window in self.windows.values() if window.annotator}))
        self.tell(Windows(count=len(self.windows), annotators=names))

    def goodbye(self, reason: str) -> None:
        """Say goodbye to all windows."""
        self.tell(Bye(reason=reason))

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
        self.exports.close()
