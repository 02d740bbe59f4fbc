"""Start the studio: a port, a link, a browser, and what is said in the terminal."""

import asyncio
import contextlib
import json
import os
import socket
import sys
import webbrowser
from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING

import uvicorn

from farfield.errors import ConfigError
from farfield.jobs.process import pythons_interrupt
from farfield.studio.options import StudioSettings
from farfield.studio.serving.guard import AccessTokens, App, Guard, Receive, Scope, Send, answer
from farfield.vocabulary.studio import STUDIO_PORT

if TYPE_CHECKING:
    from farfield.datasets.base import Dataset
    from farfield.studio.session.session import Session

MESSAGE_BYTES = 1 << 20
"""Longest message of a WebSocket."""
PING_S = 20.0
_TRIED = 50
Say = Callable[[str], None]


class DeferredApp:
    """Listens before anything heavy is imported: requests wait for the application, and ``/health`` says so."""

    def __init__(self) -> None:
        self._app: App | None = None
        self._there = asyncio.Event()

    def take(self, app: App) -> None:
        """Pass everything on to an application from now on."""
        self._app = app
        self._there.set()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Wait for the application, then let it answer."""
        if self._app is None and scope["type"] == "http" and scope["path"] == "/health":
            body = json.dumps({"status": "ok", "ready": False})
            await answer(send, 200, body, kind="application/json")
            return
        await self._there.wait()
        assert self._app is not None
        await self._app(scope, receive, send)


def listening(port: int | None) -> socket.socket:
    """A socket that listens on 127.0.0.1: the port asked for, or the first free one from 8877 on; 0: any.

    Raises:
        ConfigError: If the port that was asked for is taken, or all tried are.
    """
    ports = [port] if port is not None else range(STUDIO_PORT, STUDIO_PORT + _TRIED)
    for candidate in ports:
        listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind(("127.0.0.1", candidate))
            listener.listen(128)
        except OSError:
            listener.close()
            continue
        return listener
    problem = (
        f"port {port} is taken" if port is not None else f"ports {STUDIO_PORT} to {STUDIO_PORT + _TRIED - 1} are taken"
    )
    raise ConfigError(f"{problem}: choose another with --port, or end what listens there")


def _say(line: str) -> None:
    with contextlib.suppress(OSError):  # a terminal that is gone: the work goes on and is saved
        print(line, flush=True)


def serve(
    open_data: "Callable[[], Dataset]",
    settings: StudioSettings,
    *,
    port: int | None = None,
    browser: bool = True,
    say: Say = _say,
) -> int:
    """Serve a data set until Ctrl-C.

    Args:
        open_data: Opens it; called in a thread while the server listens already.
        settings: What the studio is started with.
        port: Port to listen on; None takes the first free one from 8877 on.
        browser: Whether the browser is opened; never over SSH.
        say: Writes a line into the terminal.

    Raises:
        FarfieldError: If the data set cannot be opened or the port is taken.
    """
    with contextlib.closing(listening(port)) as listener, contextlib.suppress(KeyboardInterrupt), pythons_interrupt():
        asyncio.run(serving(listener, open_data, settings, browser=browser, say=say))
    return 0


async def serving(
    listener: socket.socket,
    open_data: "Callable[[], Dataset]",
    settings: StudioSettings,
    *,
    browser: bool,
    say: Say,
    ended: asyncio.Event | None = None,
) -> None:
    """Serve on a socket that listens, until Ctrl-C or until ``ended`` is set; arguments as of :func:`serve`."""
    deferred, entry = DeferredApp(), AccessTokens(listener.getsockname()[1])
    server = _Server(_config(Guard(deferred, entry)))
    tasks = [
        asyncio.create_task(server.serve(sockets=[listener])),
        asyncio.create_task(_open(server, deferred, open_data, settings)),
    ]
    running, opening = tasks
    if ended is not None:
        tasks.append(asyncio.create_task(ended.wait()))  # type: ignore[arg-type]
    with _enter_for_link(entry, say):
        try:
            say("\n".join(_words(entry)))
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            if opening.done():
                opening.result()  # raises what went wrong
                if browser and not os.environ.get("SSH_CONNECTION"):
                    await asyncio.get_running_loop().run_in_executor(None, webbrowser.open, link(entry))
                await asyncio.wait([task for task in tasks if task is not opening], return_when=asyncio.FIRST_COMPLETED)
        finally:
            server.should_exit = True
            await asyncio.wait([running], timeout=10)
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            if server.session is not None:
                await _save_and_close(server.session, say)


def _config(app: App) -> uvicorn.Config:
    return uvicorn.Config(
        app,
        log_level="warning",
        access_log=False,
        server_header=False,
        date_header=False,
        ws="websockets-sansio",
        ws_max_size=MESSAGE_BYTES,
        ws_ping_interval=PING_S,
        ws_ping_timeout=PING_S,
        lifespan="off",
        timeout_graceful_shutdown=2,
    )


class _Server(uvicorn.Server):
    """Says goodbye to the windows before it stops."""

    session: "Session | None" = None

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Say goodbye, then stop."""
        if self.session is not None:
            self.session.goodbye("the studio was ended in its terminal")
            await asyncio.sleep(0.05)
        await super().shutdown(sockets)


async def _open(
    server: _Server, deferred: DeferredApp, open_data: "Callable[[], Dataset]", settings: StudioSettings
) -> None:
    """Import what is heavy, open the data set, and let the windows in."""
    session, app = await asyncio.to_thread(_session_and_app, settings)
    server.session = session
    deferred.take(app)
    await session.in_thread(lambda: session.open(open_data()))
    session.let_in()
    if session.annotating is not None:
        from farfield.studio.session.saving import autosave

        session.aside(None, None, autosave(session))
        session.aside(None, None, _import_scipy())


def _session_and_app(settings: StudioSettings) -> "tuple[Session, App]":
    from farfield.studio.serving.app import make_app
    from farfield.studio.session.session import Session

    session = Session(settings)
    return session, make_app(session)


async def _import_scipy() -> None:
    """Import what the first fit would else wait for."""
    await asyncio.to_thread(import_module, "scipy.spatial")


async def _save_and_close(session: "Session", say: Say) -> None:
    from farfield.studio.session.saving import save_at_exit

    try:
        sentence = await save_at_exit(session) if session.ready else ""
        if sentence:
            say(sentence)
    finally:
        await session.close()


def link(entry: AccessTokens) -> str:
    """A link that lets one window in."""
    return f"http://127.0.0.1:{entry.port}/?token={entry.new_token()}"


def _words(entry: AccessTokens) -> list[str]:
    """What the terminal shows: the link, and over SSH the line that makes the tunnel."""
    lines = [f"farfield studio: {link(entry)}"]
    remote = os.environ.get("SSH_CONNECTION", "").split()
    if len(remote) == 4:
        user = os.environ.get("USER", "") or os.environ.get("LOGNAME", "")
        where = f"{user}@{remote[2]}" if user else remote[2]
        lines.insert(0, f"on your own machine, first: ssh -N -L {entry.port}:127.0.0.1:{entry.port} {where}")
    lines.append("the link is good once, for ten minutes; Enter prints a new one, Ctrl-C ends the studio")
    return lines


@contextlib.contextmanager
def _enter_for_link(entry: AccessTokens, say: Say) -> Iterator[None]:
    """Print a new link at each Enter, where a person sits at the terminal."""
    if not sys.stdin or not sys.stdin.isatty():
        yield
        return
    loop = asyncio.get_running_loop()
    loop.add_reader(sys.stdin.fileno(), partial(_new_link, entry, say))
    try:
        yield
    finally:
        loop.remove_reader(sys.stdin.fileno())


def _new_link(entry: AccessTokens, say: Say) -> None:
    sys.stdin.readline()
    say(link(entry))
