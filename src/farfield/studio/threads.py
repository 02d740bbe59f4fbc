"""Threads beside the server's event loop, which never waits for a file."""

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")


class ThreadGroup:
    """Some threads.

    Args:
        count: How many; with one, what is asked for is done in the order in which it is asked for.
        name: How they are called.
    """

    def __init__(self, count: int, name: str) -> None:
        self._pool = ThreadPoolExecutor(count, thread_name_prefix=f"studio-{name}")

    async def do(self, work: Callable[[], T]) -> T:
        """Run something in one of them."""
        return await asyncio.get_running_loop().run_in_executor(self._pool, work)

    def end(self, *, wait: bool = False) -> None:
        """Begin nothing more; with ``wait``, until what was begun is done."""
        self._pool.shutdown(wait=wait, cancel_futures=True)
