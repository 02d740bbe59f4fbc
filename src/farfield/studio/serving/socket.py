"""The WebSocket: one window of the page, its messages in order, replies as they come."""

import asyncio
import time
from collections.abc import Callable
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from farfield.errors import FarfieldError
from farfield.studio.messages.checking import read_request, write_reply
from farfield.studio.messages.replies import VERSION, Bye, Refused, Reply
from farfield.studio.messages.requests import Edit, Hello, Redo, Undo
from farfield.studio.serving.limits import BAD_MESSAGES, EDITS_A_SECOND, EDITS_AT_ONCE, WINDOWS
from farfield.studio.session.desk import Session
from farfield.studio.session.looking import welcome
from farfield.studio.session.window import ClientWindow

_HELLO_S = 10.0
_WAITING = 5000
"""Replies that may wait for a slow window before it is closed."""


class Bucket:
    """How many edits a window may still send: so many at once, so many a second in the long run.

    Args:
        clock: Seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.clock, self.left, self.at = clock, float(EDITS_AT_ONCE), clock()

    def take(self) -> bool:
        """Whether one more may pass."""
        now = self.clock()
        self.left = min(EDITS_AT_ONCE, self.left + (now - self.at) * EDITS_A_SECOND)
        self.at = now
        if self.left < 1:
            return False
        self.left -= 1
        return True


async def socket(connection: WebSocket) -> None:
    """Serve one window until it goes."""
    desk: Session = connection.app.state.desk
    await connection.accept()
    window = await _greeted(connection, desk)
    if window is None:
        return
    sending = asyncio.create_task(_send(connection, window))
    try:
        await desk.join(window, welcome)
        await _receive(connection, desk, window)
    except (WebSocketDisconnect, RuntimeError):
        pass
    finally:
        sending.cancel()
        await asyncio.gather(sending, return_exceptions=True)
        desk.leave(window)


async def _greeted(connection: WebSocket, desk: Session) -> ClientWindow | None:
    """The window, once it has said hello; None if it was sent away."""
    try:
        hello = read_request(await asyncio.wait_for(connection.receive_text(), _HELLO_S))
    except (FarfieldError, TimeoutError, KeyError):
        hello = None
    except WebSocketDisconnect:
        return None
    reason = _why_not(hello, desk)
    if reason:
        await _sent_away(connection, reason)
        return None
    return ClientWindow(id=desk.name_of(hello.window), annotator=hello.annotator or desk.annotator, room=_WAITING)


def _why_not(hello: Any, desk: Session) -> str:
    """Why a window is sent away; empty if it is not."""
    if not isinstance(hello, Hello):
        return "expected hello as the first message"
    if hello.version != VERSION:
        return "the page is of another version of the studio: reload it"
    if len(desk.windows) >= WINDOWS:
        return f"{WINDOWS} windows are open, and no more are served: close one"
    return ""


async def _sent_away(connection: WebSocket, reason: str) -> None:
    await connection.send_text(write_reply(Bye(reason=reason)))
    await connection.close(1008)


async def _send(connection: WebSocket, window: ClientWindow) -> None:
    while True:
        reply = await window.replies.get()
        await connection.send_text(reply if isinstance(reply, str) else write_reply(reply))
        if isinstance(reply, Bye):
            await connection.close(1001)
            return


async def _receive(connection: WebSocket, desk: Session, window: ClientWindow) -> None:
    bucket, bad = Bucket(), 0
    while True:
        try:
            text = await connection.receive_text()
        except KeyError:  # bytes
            text = ""
        try:
            request = read_request(text)
        except FarfieldError as error:
            bad += 1
            window.send(Refused(id=None, code="message", sentence=str(error), mend="reload the page"))
            if bad == BAD_MESSAGES:
                window.send(Bye(reason="this window sends messages that are none: reload it"))
            continue
        if isinstance(request, Edit | Undo | Redo) and not bucket.take():
            window.send(_too_fast(request.id))
            continue
        await desk.handle(window, request)


def _too_fast(name: str) -> Reply:
    sentence = f"more than {EDITS_A_SECOND:g} edits a second came from this window"
    return Refused(id=name, code="rate", sentence=sentence, mend="send it again in a second")
