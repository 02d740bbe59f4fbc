"""Threads beside the server's event loop, which never waits for a file, and a cache that they share."""

import asyncio
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from concurrent.futures import ThreadPoolExecutor
from typing import Generic, TypeVar

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


V = TypeVar("V")


class Cache(Generic[V]):
    """Values by key, the longest unused dropped first. Threads that ask for one value make it once.

    Args:
        most: The sum of sizes up to which values are kept.
        size: Of a value.
    """

    def __init__(self, most: int, size: Callable[[V], int]) -> None:
        self.most, self.size = most, size
        self.held = 0
        self._values: OrderedDict[Hashable, V] = OrderedDict()
        self._lock = threading.Lock()
        self._making: dict[Hashable, threading.Lock] = {}

    def get(self, key: Hashable, make: Callable[[], V]) -> V:
        """The value of a key, made if it is not there."""
        with self._lock:
            if key in self._values:
                self._values.move_to_end(key)
                return self._values[key]
            making = self._making.setdefault(key, threading.Lock())
        with making:
            with self._lock:
                if key in self._values:
                    return self._values[key]
            value = make()
            self._keep(key, value)
        return value

    def _keep(self, key: Hashable, value: V) -> None:
        with self._lock:
            self._making.pop(key, None)
            self._values[key] = value
            self.held += self.size(value)
            while self.held > self.most and len(self._values) > 1:
                _, dropped = self._values.popitem(last=False)
                self.held -= self.size(dropped)

    def drop(self, matches: Callable[[Hashable], bool]) -> None:
        """Forget the values of some keys."""
        with self._lock:
            for key in [key for key in self._values if matches(key)]:
                self.held -= self.size(self._values.pop(key))
