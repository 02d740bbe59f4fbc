"""A slow link for tests: a TCP proxy of 20 Mbit/s and 50 ms there and back, which slows WebSockets as well."""

import asyncio
import contextlib
import threading
from collections.abc import Iterator
from functools import partial
from queue import Queue

PIECE = 16_384


async def carry(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, delay_s: float, bytes_s: float) -> None:
    """One direction: pieces leave as fast as the line takes them, and arrive after the delay."""
    loop, free_at = asyncio.get_running_loop(), 0.0
    under_way: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue()
    delivering = asyncio.create_task(_deliver(under_way, writer))
    try:
        while piece := await reader.read(PIECE):
            free_at = max(free_at, loop.time()) + len(piece) / bytes_s
            under_way.put_nowait((free_at + delay_s, piece))
            await asyncio.sleep(free_at - loop.time())
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
    reader: asyncio.StreamReader, writer: asyncio.StreamWriter, *, port: int, delay_s: float, bytes_s: float
) -> None:
    there = await asyncio.open_connection("127.0.0.1", port)
    both = [asyncio.create_task(carry(a, b, delay_s, bytes_s)) for a, b in ((reader, there[1]), (there[0], writer))]
    with contextlib.suppress(asyncio.CancelledError):
        await asyncio.wait(both, return_when=asyncio.ALL_COMPLETED)
    for each in both:
        each.cancel()
    await asyncio.gather(*both, return_exceptions=True)


async def _serve(made: "Queue[tuple[asyncio.AbstractEventLoop, asyncio.Event, int]]", **line: float) -> None:
    ended = asyncio.Event()
    server = await asyncio.start_server(partial(_connected, **line), "127.0.0.1", 0)  # type: ignore[arg-type]
    made.put((asyncio.get_running_loop(), ended, server.sockets[0].getsockname()[1]))
    await ended.wait()
    server.close()


@contextlib.contextmanager
def slow_link(port: int, *, delay_s: float = 0.025, bytes_s: float = 2.5e6) -> Iterator[int]:
    """Pass connections on to a port of this machine over a slow line; gives the port to connect to.

    Args:
        port: Where the server listens.
        delay_s: Of each direction.
        bytes_s: Bytes a second of each direction of each connection.
    """
    made: Queue[tuple[asyncio.AbstractEventLoop, asyncio.Event, int]] = Queue()
    work = partial(_serve, made, port=port, delay_s=delay_s, bytes_s=bytes_s)
    thread = threading.Thread(target=lambda: asyncio.run(work()), name="slow-link", daemon=True)
    thread.start()
    loop, ended, here = made.get(timeout=10)
    try:
        yield here
    finally:
        loop.call_soon_threadsafe(ended.set)
        thread.join(10)
