"""The desk: one open data set, the windows before it, and what each message does."""

import asyncio
import sys
import traceback
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from farfield import __version__
from farfield.datasets.base import Dataset
from farfield.errors import FarfieldError
from farfield.frame import Drive
from farfield.metrics import PROTOCOLS
from farfield.studio.messages import requests as asked
from farfield.studio.messages.replies import (
    Bookmarks as BookmarkList,
)
from farfield.studio.messages.replies import (
    Bye,
    FrameState,
    Previewed,
    Refused,
    Reply,
    Welcome,
    Windows,
)
from farfield.studio.messages.rows import BoxRow, PredictedFrame, Trail
from farfield.studio.session.bookmarks import Bookmarks
from farfield.studio.session.settings import StudioSettings
from farfield.studio.session.trails import trails
from farfield.studio.session.window import Window
from farfield.studio.showing.classes import classes_of
from farfield.studio.showing.opened import Opened, plain_error
from farfield.studio.showing.predictions import Predictions, read_set
from farfield.studio.showing.rows import annotated_rows, frame_info

T = TypeVar("T")
_MOST_LABELS = 20_000


class Desk:
    """What windows share.

    Args:
        settings: What the studio was started with.
    """

    def __init__(self, settings: StudioSettings) -> None:
        self.settings = settings
        self.annotator = settings.annotator
        self.windows: dict[str, Window] = {}
        self.threads = ThreadPoolExecutor(3, thread_name_prefix="studio-desk")
        self._ready = asyncio.Event()
        self.data: Dataset | None = None
        self.sets: dict[str, Predictions] = {}

    @property
    def ready(self) -> bool:
        """Whether the data set is open."""
        return self._ready.is_set()

    def open(self, data: Dataset) -> None:
        """Take a data set: what reads files, for a thread. :meth:`opened_now` lets the windows in.

        Raises:
            FarfieldError: If predictions cannot be read or do not belong to it.
        """
        settings = self.settings
        self.data, self.opened = data, Opened(data)
        self.protocol = settings.protocol or data.protocol
        _ = PROTOCOLS[self.protocol]
        self.classes = classes_of(data.name, settings.classes)
        self.drives = data.drives()
        self._drive_of = {int(index): drive for drive in self.drives for index in drive.indices}
        self.bookmarks = Bookmarks(data.root, data.keys, settings.notes)
        for place, path in enumerate(settings.predictions):
            found = read_set(path, data, format=settings.format, protocol=self.protocol, place=place)
            self.sets[found.about.name] = found

    def opened_now(self) -> None:
        """Let the windows in that wait."""
        self._ready.set()

    async def in_thread(self, work: Callable[[], T]) -> T:
        """Run what reads files or computes beside the event loop."""
        return await asyncio.get_running_loop().run_in_executor(self.threads, work)

    def name_of(self, wanted: str) -> str:
        """A name for a new window: the one that it wants if that is free."""
        name, number = wanted, 1
        while name in self.windows:
            number += 1
            name = f"{wanted[:56]}-{number}"
        return name

    async def join(self, window: Window) -> None:
        """Welcome a window, once the data set is open."""
        self.windows[window.id] = window
        await self._ready.wait()
        window.send(await self.in_thread(lambda: self._welcome(window)))
        self._count_windows()

    async def leave(self, window: Window) -> None:
        """Forget a window."""
        self.windows.pop(window.id, None)
        self._count_windows()

    def stop(self, reason: str) -> None:
        """Say goodbye to all windows."""
        self.tell(Bye(reason=reason))

    async def close(self) -> None:
        """End what still works for the windows."""
        self.threads.shutdown(wait=False, cancel_futures=True)

    def tell(self, reply: Reply, *, but: Window | None = None) -> None:
        """Send something to all windows, or to all but one."""
        for window in self.windows.values():
            if window is not but:
                window.send(reply)

    def _count_windows(self) -> None:
        names = tuple(sorted({window.annotator for window in self.windows.values() if window.annotator}))
        self.tell(Windows(count=len(self.windows), annotators=names))

    async def handle(self, window: Window, request: Any) -> None:
        """Do what a message asks; what takes time goes on beside further messages."""
        work = _HANDLERS.get(type(request))
        if work is None:
            window.send(Refused(id=getattr(request, "id", None), code="view", sentence=_ONLY_SHOWS, mend=_ANNOTATE))
            return
        await work(self, window, request)

    def refusal(self, name: str | None, error: FarfieldError) -> Refused:
        """An error as a reply: its message, never a path of this machine."""
        code = str(getattr(error, "code", "refused"))
        sentence = plain_error(error, self.data)
        return Refused(id=name, code=code, sentence=sentence, mend=str(getattr(error, "mend", "")))

    async def frame_open(self, window: Window, request: asked.FrameOpen) -> None:
        """Show a frame; a window that asks for another meanwhile gets both."""
        window.frame, window.threshold, window.sweeps = request.frame, request.threshold, request.sweeps
        asyncio.get_running_loop().create_task(self._show(window, request))

    async def _show(self, window: Window, request: asked.FrameOpen) -> None:
        try:
            self.opened.check(request.frame)
            window.send(await self.in_thread(lambda: self.state(request.frame, request.threshold, request.sweeps)))
        except FarfieldError as error:
            window.send(self.refusal(None, error))
        except Exception as error:  # noqa: BLE001
            traceback.print_exception(error, file=sys.stderr)
            sentence = f"the studio met an error of its own ({type(error).__name__}); its terminal shows it"
            window.send(Refused(id=None, code="failed", sentence=sentence))

    async def preview(self, window: Window, request: asked.Preview) -> None:
        """Pass a dragged box on to the others."""
        reply = Previewed(window=window.id, frame=request.frame, box=request.box, value=request.value)
        for other in self.windows.values():
            if other is not window and other.frame == request.frame:
                other.send(reply)

    async def bookmark(self, window: Window, request: asked.BookmarkSet) -> None:
        """Set a bookmark and tell everybody."""
        self.opened.check(request.frame)
        by = window.annotator
        await self.in_thread(lambda: self.bookmarks.set(request.frame, request.note, by))
        self.tell(BookmarkList(rows=self.bookmarks.rows()))

    def boxes(self, index: int) -> tuple[BoxRow, ...]:
        """The annotated boxes of a frame as they stand."""
        frame = self.opened.frame(index)
        annotation = frame.annotation
        return () if annotation is None else annotated_rows(annotation, frame)

    def state(self, index: int, threshold: float = 0.0, sweeps: int = 1) -> FrameState:
        """All that a frame shows."""
        frame = self.opened.frame(index)
        layers, notes = self.opened.layers(index, sweeps)
        boxes = self.boxes(index)
        known = {"conditions_from": frame.metadata["conditions_from"]} if "conditions_from" in frame.metadata else {}
        return FrameState(
            frame=frame_info(frame, index, extra={name: str(value) for name, value in known.items()}),
            layers=layers,
            boxes=boxes,
            predicted=self.predicted(index, boxes, threshold),
            trails=self._trails(index, boxes),
            notes=notes,
        )

    def predicted(self, index: int, truth: tuple[BoxRow, ...], threshold: float) -> tuple[PredictedFrame, ...]:
        """What each set predicts in a frame, matched with the truth."""
        frame = self.opened.frame(index)
        found = [
            each.frame(frame.key, truth, frame.reference, threshold=threshold) for each in list(self.sets.values())
        ]
        return tuple(each for each in found if each is not None)

    def _trails(self, index: int, boxes: tuple[BoxRow, ...]) -> tuple[Trail, ...]:
        drive = self._drive_of.get(index)
        if drive is None:
            return ()
        tracks = [row.track for row in boxes if row.track is not None]
        found = trails("", drive, index, tracks, self._annotated_centres) if tracks else ()
        return (*found, *(trail for each in self.sets.values() for trail in self._trails_of(each, drive, index)))

    def _annotated_centres(self, index: int) -> list[tuple[int, float, float, float]]:
        annotation = self.opened.data.annotation(index)
        if annotation is None or annotation.boxes.track_id is None:
            return []
        boxes = annotation.boxes
        return [(int(t), *map(float, c)) for t, c in zip(boxes.track_id, boxes.centre_m, strict=True)]  # type: ignore[misc]

    def _trails_of(self, found: Predictions, drive: Drive, index: int) -> tuple[Trail, ...]:
        here = found.boxes.get(self.opened.data.keys[index])
        if here is None or here.track_id is None or not len(here):
            return ()
        tracks = [int(track) for track in here.track_id if track >= 0]
        return trails(found.about.name, drive, index, tracks, lambda other: _centres(found, self.opened, other))

    def _welcome(self, window: Window) -> Welcome:
        data, settings = self.opened.data, self.settings
        labels = tuple(f"{sequence}/{frame}" for sequence, frame in data.keys) if len(data) <= _MOST_LABELS else ()
        return Welcome(
            farfield=__version__,
            mode=settings.mode,
            data=data.name,
            title=settings.title or data.root.name,
            frames=len(data),
            drives=self.opened.drives,
            labels=labels,
            classes=self.classes,
            predictions=tuple(each.about for each in self.sets.values()),
            detectors=(),
            protocols=tuple(PROTOCOLS),
            bookmarks=self.bookmarks.rows(),
            tracks=(),
            annotator=window.annotator,
            window=window.id,
            windows=len(self.windows),
            journal_seq=0,
            extent=None,
            first=min(settings.first, max(len(data) - 1, 0)),
        )


def _centres(found: Predictions, opened: Opened, index: int) -> list[tuple[int, float, float, float]]:
    boxes = found.boxes.get(opened.data.keys[index])
    if boxes is None or boxes.track_id is None:
        return []
    return [(int(t), *map(float, c)) for t, c in zip(boxes.track_id, boxes.centre_m, strict=True)]  # type: ignore[misc]


_ONLY_SHOWS = "this studio shows only"
_ANNOTATE = "start it as `farfield annotate` to change boxes"
_HANDLERS: dict[type, Callable[..., Any]] = {
    asked.FrameOpen: Desk.frame_open,
    asked.Preview: Desk.preview,
    asked.BookmarkSet: Desk.bookmark,
}
