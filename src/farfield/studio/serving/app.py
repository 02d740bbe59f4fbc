"""The routes: the page, layers, pictures, radar maps, health, and the WebSocket."""

import asyncio
import itertools
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import urlencode

from starlette.applications import Starlette
from starlette.convertors import IntegerConvertor, register_url_convertor
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from farfield.errors import FarfieldError
from farfield.studio.messages.replies import Bye, Refused, write_reply
from farfield.studio.messages.requests import Edit, Hello, Redo, Undo, id_of, read_request
from farfield.studio.messages.rows import VERSION
from farfield.studio.serving.guard import App
from farfield.studio.session import annotating, calibrating, checking, detecting, exporting, saving, viewing
from farfield.studio.session.frame_cache import first_of
from farfield.studio.session.session import ClientWindow, Session
from farfield.studio.showing.opened import STATIC, Payload, plain_error
from farfield.studio.threads import ThreadGroup

T = TypeVar("T")
_KINDS = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".json": "application/json",
    ".woff2": "font/woff2",
}
HANDLER_MODULES = (annotating, calibrating, checking, detecting, exporting, saving, viewing)
"""Importing them registers what answers the page's messages."""
_PAGES = ("index.html", "calibrate.html")
_NO_PAGE = "The page is not built: run `npm ci && npm run build` in web/, or install a wheel, which holds it."


class _NumberConvertor(IntegerConvertor):
    """Numbers of nine digits at most: int() refuses thousands of them, and there is nothing of such a number."""

    regex = "[0-9]{1,9}"


register_url_convertor("number", _NumberConvertor())


def make_app(session: Session, *, static: Path = STATIC) -> App:
    """The application; who may speak to it is its :class:`~farfield.studio.serving.guard.Guard`'s business.

    Args:
        session: What is open, and who is at it.
        static: Folder of the built page.
    """
    routes = [
        Route("/health", _health),
        Route("/", _static),
        Route("/layer/{frame:number}/{layer:number}", _layer),
        Route("/image/{frame:number}/{layer:number}", _image),
        Route("/radar/{frame:number}/{kind:str}", _radar),
        Route("/shot", _shot, methods=["POST"]),
        Route("/export/{job:str}", _export),
        WebSocketRoute("/socket", socket),
        Route("/{name:str}", _static),
    ]
    app = Starlette(routes=routes, exception_handlers={FarfieldError: _refused, Exception: _failed})
    app.state.session, app.state.readers = session, ThreadGroup(4, "read")
    # The page's files by name: what is not among them is not there, whatever its name says.
    paths = sorted(static.iterdir()) if static.is_dir() else []
    app.state.files = {path.name: path for path in paths if path.is_file() and path.suffix in _KINDS}
    return app


async def _health(request: Request) -> Response:
    return JSONResponse({"status": "ok", "version": VERSION, "ready": request.app.state.session.ready})


async def _static(request: Request) -> Response:
    name = request.path_params.get("name", "index.html")
    if name == "index.html" and request.app.state.session.settings.mode == "calibrate":
        name = "calibrate.html"
    if name == "index.html" and request.query_params.get("frame", "0").rpartition("/")[1]:
        return _numbered(request)
    path = request.app.state.files.get(name)
    if path is None:
        return PlainTextResponse(_NO_PAGE if name in _PAGES else "There is nothing of this name.", 404)
    kind = _KINDS[path.suffix]
    return await in_thread(request, lambda: _answer(request, Payload.of(path.read_bytes(), kind)))


def _numbered(request: Request) -> Response:
    """Send a link to ``?frame=sequence/frame``, as reports have it, on to the frame's number."""
    session: Session = request.app.state.session
    try:
        index = first_of(request.query_params["frame"], session.frames.data) if session.ready else 0
    except FarfieldError:
        index = 0
    rest = {name: value for name, value in request.query_params.items() if name == "test"}
    return RedirectResponse("/?" + urlencode({"frame": index, **rest}), 303)


async def _layer(request: Request) -> Response:
    frame, layer = request.path_params["frame"], request.path_params["layer"]
    sweeps = _number(request, "sweeps", 1, 1, 20)
    return await _payload(request, lambda session: session.opened.cloud(frame, layer, sweeps))


async def _image(request: Request) -> Response:
    frame, layer = request.path_params["frame"], request.path_params["layer"]
    exact = request.query_params.get("exact") == "1"
    return await _payload(request, lambda session: session.opened.picture(frame, layer, exact=exact))


MOST_REACH_M = 30.0
"""So far from a place a window may ask for a radar's cells."""


async def _radar(request: Request) -> Response:
    frame, kind = request.path_params["frame"], request.path_params["kind"]
    if kind == "near":
        centre_m, reach_m = (_metres(request, "x", 0.0), _metres(request, "y", 0.0)), _metres(request, "reach", 8.0)
        return await _payload(
            request, lambda session: session.opened.radar_near(frame, centre_m, min(reach_m, MOST_REACH_M))
        )
    if kind not in ("bev", "bfs"):
        return PlainTextResponse("radar: expected bev, bfs or near", 404)
    low, high = _metres(request, "low", 0.0), _metres(request, "high", float("inf"))
    return await _payload(request, lambda session: session.opened.radar_map(frame, kind, low, high))


async def _shot(request: Request) -> Response:
    session: Session = request.app.state.session
    try:
        body = await request.body()
    except ClientDisconnect:  # whoever sent it went away: nobody waits for an answer
        return Response(status_code=400)
    name = await in_thread(request, lambda: session.exports.keep(body))
    return JSONResponse({"shot": name}, 201)


async def _export(request: Request) -> Response:
    session: Session = request.app.state.session
    file = session.exports.result(request.path_params["job"])
    if file is None:
        return PlainTextResponse("There is no such file; exports live as long as the studio runs.", 404)
    body = await in_thread(request, file.path.read_bytes)
    headers = {"content-disposition": f'attachment; filename="{file.name}"', "cache-control": "no-store"}
    return Response(body, media_type=file.kind, headers=headers)


async def _payload(request: Request, make: Callable[[Session], Payload]) -> Response:
    session: Session = request.app.state.session
    if not session.ready:
        return PlainTextResponse("The data set is still being opened.", 503)
    return await in_thread(request, lambda: _answer(request, make(session)))


def _answer(request: Request, payload: Payload) -> Response:
    """The answer; naming and packing the bytes takes milliseconds, so that this too is for a thread."""
    headers = {"etag": payload.tag, "cache-control": "no-cache", "vary": "accept-encoding"}
    if request.headers.get("if-none-match") == payload.tag:
        return Response(status_code=304, headers=headers)
    body, coding = payload.coded(request.headers.get("accept-encoding", ""))
    return Response(body, media_type=payload.kind, headers=headers | ({"content-encoding": coding} if coding else {}))


async def in_thread(request: Request, work: Callable[[], T]) -> T:
    """Run what reads files beside the event loop."""
    readers: ThreadGroup = request.app.state.readers
    return await readers.do(work)


def _number(request: Request, name: str, usual: int, low: int, high: int) -> int:
    text = request.query_params.get(name, "")
    return min(max(int(text), low), high) if text.isdecimal() and len(text) < 6 else usual


def _metres(request: Request, name: str, usual: float) -> float:
    try:
        value = float(request.query_params.get(name, usual))
    except ValueError:
        return usual
    return value if abs(value) <= 1000 else usual


async def _refused(request: Request, error: Exception) -> Response:
    data = request.app.state.session.data
    return PlainTextResponse(plain_error(error, data), 404 if request.method == "GET" else 400)


async def _failed(request: Request, error: Exception) -> Response:
    del request
    return PlainTextResponse(
        f"The studio met an error of its own ({type(error).__name__}); its terminal shows it.", 500
    )


# The WebSocket: one window of the page, its messages in order, replies as they come

WINDOWS = 8
"""Windows at a time."""
EDITS_A_SECOND = 200.0
"""Of a window, in the long run."""
EDITS_AT_ONCE = 1200
"""Of a window, in a burst."""
BAD_MESSAGES = 20
"""A window that sent so many invalid messages is closed."""
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
    session: Session = connection.app.state.session
    await connection.accept()
    window = await _greeted(connection, session)
    if window is None:
        return
    sending = asyncio.create_task(_send(connection, window))
    try:
        await session.join(window, viewing.welcome)
        await _receive(connection, session, window)
    except (WebSocketDisconnect, RuntimeError):
        pass
    finally:
        sending.cancel()
        await asyncio.gather(sending, return_exceptions=True)
        session.leave(window)


async def _greeted(connection: WebSocket, session: Session) -> ClientWindow | None:
    """The window, once it has said hello; None if it was sent away."""
    try:
        hello = read_request(await asyncio.wait_for(connection.receive_text(), _HELLO_S))
    except TimeoutError:  # a tab that was frozen as its socket opened says hello later: it may come again
        await connection.close(1013)
        return None
    except (FarfieldError, KeyError):
        hello = None
    except WebSocketDisconnect:
        return None
    reason = _why_not(hello, session)
    if reason:
        await _sent_away(connection, reason)
        return None
    return ClientWindow(
        id=session.window_name(hello.window), annotator=hello.annotator or session.annotator, room=_WAITING
    )


def _why_not(hello: Any, session: Session) -> str:
    """Why a window is sent away; empty if it is not."""
    if not isinstance(hello, Hello):
        return "expected hello as the first message"
    if hello.version != VERSION:
        return "the page is of another version of the studio: reload it"
    if len(session.windows) >= WINDOWS:
        return f"{WINDOWS} windows are open, and no more are served: close one"
    return ""


async def _sent_away(connection: WebSocket, reason: str) -> None:
    await connection.send_text('{"n":1,' + write_reply(Bye(reason=reason))[1:])
    await connection.close(1008)


async def _send(connection: WebSocket, window: ClientWindow) -> None:
    for number in itertools.count(1):  # by which the page knows that one was lost or came twice
        reply = await window.replies.get()
        text = reply if isinstance(reply, str) else write_reply(reply)
        await connection.send_text(f'{{"n":{number},{text[1:]}')
        if isinstance(reply, Bye):
            await connection.close(1001)
            return


async def _receive(connection: WebSocket, session: Session, window: ClientWindow) -> None:
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
            window.send(Refused(id=id_of(text), code="message", sentence=str(error), mend="reload the page"))
            if bad == BAD_MESSAGES:
                window.send(Bye(reason="this window sends messages that are none: reload it"))
            continue
        if isinstance(request, Edit | Undo | Redo) and not bucket.take():
            sentence = f"more than {EDITS_A_SECOND:g} edits a second came from this window"
            window.send(Refused(id=request.id, code="rate", sentence=sentence, mend="send it again in a second"))
            continue
        await session.handle(window, request)
