"""A studio that really listens, for tests: server in a thread, HTTP and WebSocket clients of its own."""

import asyncio
import contextlib
import http.client
import itertools
import json
import re
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect

from farfield.datasets.base import Dataset
from farfield.studio.options import StudioSettings
from farfield.studio.samples import open_samples
from farfield.studio.serving import run

_NAMES = itertools.count(1)


class Live:
    """A running studio."""

    def __init__(self, port: int, lines: list[str]) -> None:
        self.port, self.lines = port, lines
        self.host = f"127.0.0.1:{port}"
        self.origin = f"http://{self.host}"
        self.cookie = ""

    def token(self) -> str:
        """The token of the printed link."""
        return re.findall(r"token=(\S+)", " ".join(self.lines))[-1]

    def request(self, method: str, path: str, body: bytes | None = None, **headers: str) -> tuple[int, dict, bytes]:
        """One request as it is told: status, headers, body. ``host`` and ``cookie`` can be given or emptied."""
        named = {name.replace("_", "-"): value for name, value in headers.items()}
        named.setdefault("host", self.host)
        named.setdefault("cookie", self.cookie)
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=30)
        connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
        for name, value in named.items():
            if value:
                connection.putheader(name, value)
        if body is not None and "content-length" not in named:
            connection.putheader("content-length", str(len(body)))
        connection.endheaders(body)
        answer = connection.getresponse()
        content = answer.read()
        connection.close()
        return answer.status, {name.lower(): value for name, value in answer.getheaders()}, content

    def get(self, path: str, **headers: str) -> tuple[int, dict, bytes]:
        """GET as the studio's own page does it."""
        return self.request("GET", path, **headers)

    def enter(self) -> None:
        """Follow the printed link."""
        _, headers, _ = self.request("GET", f"/?token={self.token()}")
        self.cookie = headers["set-cookie"].split(";")[0]

    @contextlib.contextmanager
    def raw(self, **headers: str) -> Iterator[ClientConnection]:
        """A WebSocket as it is told, without hello."""
        origin = headers.pop("origin", self.origin) or None
        given = {"Cookie": headers.pop("cookie", self.cookie)} | headers
        with connect(
            f"ws://{self.host}/socket",
            origin=origin,  # type: ignore[arg-type]
            additional_headers={name: value for name, value in given.items() if value},
            open_timeout=20,
            max_size=1 << 26,
        ) as socket:
            yield socket

    @contextlib.contextmanager
    def window(self, name: str | None = None, **hello: Any) -> Iterator["Client"]:
        """A window that said hello."""
        with self.raw() as socket:
            client = Client(socket, name or f"w{next(_NAMES)}")
            client.send(op="hello", window=client.name, **hello)
            client.welcome = client.until("welcome")
            yield client


class Client:
    """A window of the page, in Python."""

    def __init__(self, socket: ClientConnection, name: str) -> None:
        self.socket, self.name = socket, name
        self.welcome: dict[str, Any] = {}
        self.numbers = itertools.count(1)

    def new_id(self) -> str:
        """An identity for an edit."""
        return f"{self.name}-{next(self.numbers)}"

    def send(self, **message: Any) -> None:
        """Send a message."""
        self.socket.send(json.dumps(message))

    def receive(self, timeout: float = 60.0) -> dict[str, Any]:
        """The next message."""
        return json.loads(self.socket.recv(timeout=timeout))

    def until(self, *ops: str, wanted: Callable[[dict[str, Any]], bool] = lambda _: True) -> dict[str, Any]:
        """The next message of one of these kinds; others are passed over."""
        while True:
            message = self.receive()
            if message["op"] in ops and wanted(message):
                return message

    def open(self, frame: int, **more: Any) -> dict[str, Any]:
        """Open a frame."""
        self.send(op="frame.open", frame=frame, **more)
        return self.until("frame.state", "refused")


@contextlib.contextmanager
def studio(
    open_data: Callable[[], Dataset] = open_samples, *, browser: bool = False, **settings: Any
) -> Iterator[Live]:
    """Run a studio on a free port; its windows can enter when this gives it."""
    settings.setdefault("notes", Path("/nonexistent"))
    lines, failed = list[str](), list[BaseException]()
    listener = run.listening(0)
    port = listener.getsockname()[1]
    listener.close()
    stop: list[Callable[[], None]] = []

    def work() -> None:
        try:
            asyncio.run(_until_stopped(open_data, StudioSettings(**settings), port, lines, stop, browser))
        except BaseException as error:  # shown by the test that started it
            failed.append(error)

    thread = threading.Thread(target=work, name="studio", daemon=True)
    thread.start()
    live = Live(port, lines)
    try:
        _wait(live, failed)
        live.enter()
        yield live
    finally:
        for each in stop:
            with contextlib.suppress(RuntimeError):  # it ended by itself
                each()
        thread.join(20)
        if failed:
            raise failed[0]
        assert not thread.is_alive(), "the studio did not stop"


async def _until_stopped(
    open_data: Callable[[], Dataset],
    settings: StudioSettings,
    port: int,
    lines: list[str],
    stop: list[Callable[[], None]],
    browser: bool,
) -> None:
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    stop.append(lambda: loop.call_soon_threadsafe(ended.set))
    with contextlib.closing(run.listening(port)) as listener:
        await run.serving(listener, open_data, settings, browser=browser, say=lines.append, ended=ended)


def _wait(live: Live, failed: list[BaseException]) -> None:
    until = time.monotonic() + 60
    while time.monotonic() < until:
        if failed:
            raise failed.pop()
        with contextlib.suppress(OSError):
            if json.loads(live.request("GET", "/health")[2])["ready"]:
                return
        time.sleep(0.02)
    raise AssertionError("the studio did not start")
