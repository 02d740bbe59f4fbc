"""A studio as a user starts it, a window of it without a browser, and a slow link between them."""

import asyncio
import contextlib
import http.client
import json
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from queue import Queue
from typing import Any

from websockets.sync.client import ClientConnection, connect

# A studio as a user starts it: the command in a process of its own, entered by its printed link.


@dataclass(frozen=True)
class Started:
    """A running studio.

    Args:
        origin: Scheme, host and port.
        cookie: What its link gave.
        pid: Its process.
    """

    origin: str
    cookie: str
    pid: int = 0


@contextlib.contextmanager
def started(verb: str, *arguments: str, log: Path | None = None) -> Iterator[Started]:
    """Run ``farfield view`` or ``annotate`` without a browser, and end it.

    Args:
        verb: The command.
        arguments: Its own.
        log: A file that gets what the terminal shows; None: it goes where the link is read.

    Raises:
        RuntimeError: If it ends without a link.
    """
    command = [sys.executable, "-m", "farfield.cli", verb, *arguments, "--no-browser"]
    with contextlib.ExitStack() as stack:
        shown = subprocess.STDOUT if log is None else stack.enter_context(log.open("ab"))
        process = stack.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE, stderr=shown, text=True))
        try:
            yield _entered(process)
        finally:
            process.terminate()


def _entered(process: "subprocess.Popen[str]") -> Started:
    assert process.stdout is not None
    said = ""
    for line in process.stdout:
        said += line
        found = re.search(r"http://([\w.:]+)/\?token=(\S+)", line)
        if found:
            host, token = found.groups()
            connection = http.client.HTTPConnection(host, timeout=30)
            connection.request("GET", f"/?token={token}")
            cookie = str(connection.getresponse().getheader("set-cookie"))
            connection.close()
            return Started(f"http://{host}", cookie.partition(";")[0], process.pid)
    raise RuntimeError(f"the studio ended without a link:\n{said}")


# A window of the studio without a browser: messages over its WebSocket, files over HTTP.


class Client:
    """A window that said hello.

    Args:
        socket: Its connection.
        live: The studio.
    """

    def __init__(self, socket: ClientConnection, live: Started) -> None:
        self.socket, self.live = socket, live

    def ask(self, message: dict[str, Any], wanted: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """Send a message and wait for a reply; a refusal ends the program."""
        self.socket.send(json.dumps(message))
        while True:
            reply = json.loads(self.socket.recv(timeout=60))
            if reply["op"] == "refused":
                raise SystemExit(f"{message['op']}: {reply}")
            if wanted(reply):
                return reply

    def open(self, frame: int) -> dict[str, Any]:
        """A frame's state."""
        return self.ask({"op": "frame.open", "frame": frame}, lambda reply: reply["op"] == "frame.state")

    def edits_ms(self, frame: int, count: int) -> list[float]:
        """Milliseconds from an edit to its acknowledgement, one after the other: a box moved to and fro."""
        row = self.open(frame)["boxes"][0]
        value = {name: row[name] for name in ("box", "class_name", "track", "attributes")}
        version, took = row["version"], []
        for number in range(count):
            name = f"edit-{time.time_ns()}"
            value["box"][0] += 0.05 if number % 2 else -0.05
            message = {"op": "box.set", "id": name, "frame": frame, "box": row["id"], "base": version, "value": value}
            begin = time.perf_counter()
            version = self.ask(message, lambda reply, name=name: reply["op"] == "ack" and reply["id"] == name)[
                "version"
            ]
            took.append((time.perf_counter() - begin) * 1e3)
        return took

    def html_bytes(self, frame: int) -> int:
        """Size of one frame as a file that opens from disk."""
        message = {"op": "export", "id": "html", "kind": "html", "frames": [frame]}
        job = self.ask(message, lambda reply: reply["op"] == "job" and reply["state"] in ("done", "failed"))
        connection = http.client.HTTPConnection(self.live.origin.removeprefix("http://"), timeout=60)
        connection.request("GET", "/" + job["url"].lstrip("/"), headers={"cookie": self.live.cookie})
        answer = connection.getresponse()
        size = len(answer.read())
        connection.close()
        if answer.status != 200:
            raise SystemExit(f"html: status {answer.status}, {job}")
        return size


@contextlib.contextmanager
def connected(live: Started, name: str) -> Iterator[ClientConnection]:
    """A socket of which the studio knows the window's name, and has welcomed it."""
    where = f"ws{live.origin.removeprefix('http')}/socket"
    headers = {"Cookie": live.cookie}
    options: dict[str, Any] = {"additional_headers": headers, "max_size": 1 << 26, "open_timeout": 60}
    with connect(where, origin=live.origin, **options) as socket:  # type: ignore[arg-type]
        socket.send(json.dumps({"op": "hello", "window": name}))
        while json.loads(socket.recv(timeout=60))["op"] != "welcome":
            pass
        yield socket


@contextlib.contextmanager
def window(live: Started) -> Iterator[Client]:
    """Open a window."""
    with connected(live, "bench") as socket:
        yield Client(socket, live)


# A slow link for tests: a TCP proxy of 20 Mbit/s and 50 ms there and back, which slows WebSockets as well.
#
# The 20 Mbit/s are those of the line: connections that are open at once share them.
#


PIECE = 16_384
QUEUE_S = 0.1
"""What waits before the line, as in a router's queue: a proxy that is woken late loses nothing of the rate by it."""


class Line:
    """One direction of the link, which all connections share.

    Args:
        delay_s: Until what left arrives.
        bytes_s: Bytes a second.
    """

    def __init__(self, delay_s: float, bytes_s: float) -> None:
        self.delay_s, self.bytes_s, self.free_at = delay_s, bytes_s, 0.0

    def take(self, piece: bytes, now: float) -> float:
        """When the last byte of a piece has left."""
        self.free_at = max(self.free_at, now) + len(piece) / self.bytes_s
        return self.free_at


async def carry(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, line: Line) -> None:
    """One direction: pieces leave as fast as the line takes them, and arrive after the delay."""
    loop, delay_s = asyncio.get_running_loop(), line.delay_s
    under_way: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue()
    delivering = asyncio.create_task(_deliver(under_way, writer))
    try:
        while piece := await reader.read(PIECE):
            left = line.take(piece, loop.time())
            under_way.put_nowait((left + delay_s, piece))
            await asyncio.sleep(left - loop.time() - QUEUE_S)
        under_way.put_nowait((loop.time() + delay_s, b""))
        await delivering
    finally:
        delivering.cancel()
        writer.close()


async def _deliver(under_way: "asyncio.Queue[tuple[float, bytes]]", writer: asyncio.StreamWriter) -> None:
    while True:
        due, piece = await under_way.get()
        await asyncio.sleep(due - asyncio.get_running_loop().time())
        if not piece:
            return
        writer.write(piece)
        await writer.drain()


async def _connected(
    reader: asyncio.StreamReader, writer: asyncio.StreamWriter, *, port: int, up: Line, down: Line
) -> None:
    there = await asyncio.open_connection("127.0.0.1", port)
    both = [asyncio.create_task(carry(*each)) for each in ((reader, there[1], up), (there[0], writer, down))]
    with contextlib.suppress(asyncio.CancelledError):
        await asyncio.wait(both, return_when=asyncio.ALL_COMPLETED)
    for each in both:
        each.cancel()
    await asyncio.gather(*both, return_exceptions=True)


async def _serve(
    made: "Queue[tuple[asyncio.AbstractEventLoop, asyncio.Event, int]]", port: int, delay_s: float, bytes_s: float
) -> None:
    ended = asyncio.Event()
    up, down = Line(delay_s, bytes_s), Line(delay_s, bytes_s)
    server = await asyncio.start_server(partial(_connected, port=port, up=up, down=down), "127.0.0.1", 0)
    made.put((asyncio.get_running_loop(), ended, server.sockets[0].getsockname()[1]))
    await ended.wait()
    server.close()


@contextlib.contextmanager
def slow_link(port: int, *, delay_s: float = 0.025, bytes_s: float = 2.5e6) -> Iterator[int]:
    """Pass connections on to a port of this machine over a slow line; gives the port to connect to.

    Args:
        port: Where the server listens.
        delay_s: Of each direction.
        bytes_s: Bytes a second of each direction, of all connections together.
    """
    made: Queue[tuple[asyncio.AbstractEventLoop, asyncio.Event, int]] = Queue()
    work = partial(_serve, made, port, delay_s, bytes_s)
    thread = threading.Thread(target=lambda: asyncio.run(work()), name="slow-link", daemon=True)
    thread.start()
    loop, ended, here = made.get(timeout=10)
    try:
        yield here
    finally:
        loop.call_soon_threadsafe(ended.set)
        thread.join(10)
