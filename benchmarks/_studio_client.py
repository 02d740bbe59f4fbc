"""A window of the studio without a browser: messages over its WebSocket, files over HTTP."""

import contextlib
import http.client
import json
import time
from collections.abc import Callable, Iterator
from typing import Any

from _studio_process import Started
from websockets.sync.client import ClientConnection, connect


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
def window(live: Started) -> Iterator[Client]:
    """Open a window."""
    where = f"ws{live.origin.removeprefix('http')}/socket"
    headers = {"Cookie": live.cookie}
    with connect(where, origin=live.origin, additional_headers=headers, max_size=1 << 26) as socket:  # type: ignore[arg-type]
        client = Client(socket, live)
        client.ask({"op": "hello", "window": "bench"}, lambda reply: reply["op"] == "welcome")
        yield client
