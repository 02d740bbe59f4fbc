"""What a person should look at: findings of the frames that are shown, at once, and of the whole drive, in passing."""

import asyncio
import time
from collections.abc import Sequence
from functools import partial

from farfield.annotation.checking import LabelIssue
from farfield.annotation.findings import DriveFindings
from farfield.datasets.edits import Record
from farfield.frame import Boxes, Key
from farfield.studio.messages import requests
from farfield.studio.messages.replies import Checks, DriveChecks
from farfield.studio.session.session import ClientWindow, Session, handles

_PAUSE_S, _LONGEST_S = 0.05, 1.0  # without edits before a frame is checked, and how long it may wait
_AT_ONCE = 20
"""Frames of a part that are checked without their points: some ten milliseconds."""
_IDLE_S, _PATIENCE_S = 0.5, 4.0
"""A cloud is read for a check when no window sent anything for so long, or when that was waited for so long."""


def shown_frames(session: Session) -> set[int]:
    """The frames that windows show."""
    return {window.frame for window in list(session.windows.values()) if window.frame is not None}


async def check_edited(session: Session, record: Record, frames: set[int]) -> None:
    """Check again what an edit may have changed: at once where it is shown, in passing elsewhere in the drive."""
    for checker in list(session.checkers.values()):
        await checker.take(record)
    for frame in shown_frames(session) & frames:
        check_soon(session, frame)


def check_detected(session: Session, key: Key) -> None:
    """Check a frame again in which a detector was run."""
    for checker in session.checkers.values():
        checker.mark(key)


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
    key, annotation = session.frames.data.keys[frame], session.annotation
    checker = session.checkers.get(scope_of(session, frame))
    turn = None if checker is None else checker.findings.begin(key, points=True)
    try:
        issues = await session.in_thread(partial(annotation.annotator.check, frame, _detections(session, key)))
    except Exception:
        if checker is not None:
            checker.mark(key, points=True)  # that it cannot be checked is a finding of the drive
        raise
    reply = Checks(frame=frame, rows=tuple(map(annotation.check_row, issues)))
    for window in session.windows.values():
        if window.frame == frame:
            window.send(reply)
    if checker is not None and turn is not None and checker.findings.end(key, turn, issues, points=True):
        checker.tell([key])


def _detections(session: Session, key: Key) -> Boxes | None:
    """What the first set of detections that has the frame holds of it."""
    sets = (shown for shown in list(session.frames.sets.values()) if shown.about.kind == "detections")
    return next((shown.boxes[key] for shown in sets if key in shown.boxes), None)


def scope_of(session: Session, frame: int) -> str:
    """The drive of a frame; empty for a frame of none: those are checked together."""
    store, key = session.annotation.store, session.frames.data.keys[frame]
    drive = store.drives.locate(key).drive
    return drive if drive in store.drives.names else ""


@handles(requests.CheckList)
async def check_list(session: Session, window: ClientWindow, request: requests.CheckList) -> None:
    """Follow the findings of a drive: what is there now, then what comes."""
    session.opened.check(request.frame)
    drive = scope_of(session, request.frame)
    window.checking = drive
    checker = session.checkers.get(drive)
    if checker is None:
        checker = session.checkers[drive] = DriveChecker(session, drive)
        session.aside(None, None, checker.run())
    for other in session.checkers.values():
        other.wake()  # those of drives that nobody follows any more end
    window.send(checker.reply(list(checker.findings.issues)))


class DriveChecker:
    """Checks the frames of a drive as long as a window follows them; the cloud of no shown frame is read for it twice.

    Args:
        session: Its annotation is checked.
        drive: The drive; empty for all frames of none.
    """

    def __init__(self, session: Session, drive: str) -> None:
        store = session.annotation.store
        self.session, self.drive = session, drive
        keys = store.drives.keys(drive) if drive else [key for key in store.keys if not _has_drive(session, key)]
        self.findings = DriveFindings(store, keys, self._check_frame)
        self._due = asyncio.Event()

    async def take(self, record: Record) -> None:
        """Mark what an edit may have changed."""
        own, frames = await self.session.in_thread(partial(self.findings.affected, record))
        self.findings.mark(frames)
        self.findings.mark(own, points=True)
        self.wake()

    def mark(self, key: Key, *, points: bool = False) -> None:
        """Mark a frame that is to be checked again, with its points or without."""
        self.findings.mark([key], points=points)
        self.wake()

    def wake(self) -> None:
        """Look whether something is due, and whether somebody still follows the drive."""
        self._due.set()

    def reply(self, keys: Sequence[Key]) -> DriveChecks:
        """The findings of some frames as a message."""
        annotation, findings = self.session.annotation, self.findings
        return DriveChecks(
            drive=self.drive,
            frames=tuple(annotation.store.index_of[key] for key in keys),
            rows=tuple(annotation.check_row(issue) for key in keys for issue in findings.issues[key]),
            done=len(findings.keys) - len(findings.points_due),
            total=len(findings.keys),
        )

    def tell(self, keys: Sequence[Key]) -> None:
        """Tell the windows that follow the drive what was found in some frames."""
        followers = self._followers()
        reply = self.reply(keys) if followers else None
        for window in followers:
            window.send(reply)  # type: ignore[arg-type]

    def _followers(self) -> list[ClientWindow]:
        return [window for window in list(self.session.windows.values()) if window.checking == self.drive]

    async def run(self) -> None:
        """Check what is due, until nobody follows the drive any more."""
        try:
            while self._followers():
                await self._step()
        finally:
            self.session.checkers.pop(self.drive, None)

    async def _step(self) -> None:
        findings = self.findings
        if findings.labels_due:
            await self._check(list(findings.labels_due)[:_AT_ONCE], points=False)
        elif findings.points_due:
            await self._until_idle()
            key = next(iter(findings.points_due), None)
            if key is not None and not findings.labels_due:
                began = time.monotonic()
                await self._check([key], points=True)
                await asyncio.sleep(min(1.0, time.monotonic() - began))  # half of a core at most
        else:
            self._due.clear()
            await self._due.wait()
            await asyncio.sleep(_PAUSE_S)

    async def _check(self, keys: Sequence[Key], *, points: bool) -> None:
        findings = self.findings
        turns = {key: findings.begin(key, points=points) for key in keys}
        checked = await self.session.checks.do(lambda: {key: findings.check(key, points=points) for key in keys})
        self.tell([key for key, issues in checked.items() if findings.end(key, turns[key], issues, points=points)])

    async def _until_idle(self) -> None:
        """Wait for a pause in what people do, so that their frames come first."""
        began = time.monotonic()
        while (paused := time.monotonic() - self.session.busy_at) < _IDLE_S and time.monotonic() - began < _PATIENCE_S:
            await asyncio.sleep(_IDLE_S - paused)

    def _check_frame(self, key: Key, points: bool, before: Sequence[LabelIssue]) -> list[LabelIssue]:
        annotation = self.session.annotation
        index, detections = annotation.store.index_of[key], _detections(self.session, key)
        if points and index in shown_frames(self.session):
            return annotation.annotator.check(index, detections)
        return annotation.annotator.check_once(index, before, detections, points=points)


def _has_drive(session: Session, key: Key) -> bool:
    drives = session.annotation.store.drives
    return drives.locate(key).drive in drives.names
