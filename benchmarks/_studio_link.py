"""A slow link for tests: a TCP proxy of 20 Mbit/s and 50 ms there and back, which slows WebSockets as well.

The 20 Mbit/s are those of the line: connections that are open at once share them.
"""

import asyncio
import contextlib
import threading
from collections.abc import Iterator
from functools import partial
from queue import Queue

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
