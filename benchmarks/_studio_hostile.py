"""Hostile clients of the studio's server: random and malformed messages and requests, and what may come of them.

Five windows at once send messages made from the classes of the protocol: fields out of bounds, of another kind, left
out, twice and unknown; frames, boxes, tracks and versions that are not; ids that were used. Beside them one window
annotates as a person does. *Nothing foreign, nothing stuck, no wrong edit*: the journal is compared with the messages.
"""

import contextlib
import http.client
import json
import math
import re
import socket as sockets
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path
from typing import Any, get_args

import numpy as np
from _studio_process import Started, connected, started
from _studio_scenes import write_folder
from websockets.exceptions import ConnectionClosed, InvalidMessage, InvalidStatus
from websockets.sync.client import ClientConnection

from farfield.datasets import open_dataset
from farfield.studio.messages import requests

FRAMES = 6
KINDS = {kind.op: kind for kind in get_args(get_args(requests.Request)[0])}
EDITS = ("box.set", "box.add", "box.delete", "track.set", "track.merge", "track.split", "track.interpolate")
BUSY = ("infer.start", "export", "track.propagate", "save", "check.list", "fit", "match.list")
"""What takes the server long, and comes seldom: a run is about what is wrong, not about how much is computed."""
ANSWERED = (*EDITS, "track.propagate", "undo", "redo", "fit", "export", "policy.set", "check.ignore", "save")
ANSWERS = ("ack", "refused", "conflict", "fitted", "job", "saved")
NUMBERS = (-1, 0, 1.5, 2**31, 2**53, 2**63, 10**40, 1e308, -1e308, math.nan, math.inf)
TEXTS = ("", "x" * 200, "0", "\x00", "\ud800", "../..", "é" * 70, "NaN")
WILD: tuple[Any, ...] = (*NUMBERS, *TEXTS, None, True, [], {}, [1], {"a": 1}, [[[[]]]])
RAW = (
    "",
    "{",
    "null",
    "[]",
    '"x"',
    "0",
    "nan",
    '{"op":"box.set"}',
    '{"op":null}',
    '{"op":["undo"]}',
    '{"op":"undo","op":"redo","id":"twice"}',
    '{"op":"undo","id":"a","id":"b"}',
    "[" * 50_000,
    '{"a":' * 20_000,
    '{"op":"frame.open","frame":1e400}',
    '{"op":"frame.open","frame":' + "9" * 5000 + "}",
    '{"op":"undo","id":"' + "x" * 100_000 + '"}',
    '{"op":"undo","id":"\\ud800"}',
    b"",
    b"\x00\xff",
    b'{"op":"undo","id":"bytes"}',
)


@dataclass(eq=False)
class Messages:
    """Makes messages, seeded.

    Args:
        rng: Draws them.
        name: Begins the ids of what it makes.
        boxes: Boxes that stood in each frame, with their versions, as a window saw them last; shared by all.
        made: Names were made up so often.
        malformed: Share of its messages that are damaged: a window that sends twenty of them is sent away.
        box: That of the message that is made.
        ids: Of what it sent.
    """

    rng: np.random.Generator
    name: str
    boxes: dict[int, dict[str, int]]
    made: int = 0
    malformed: float = 0.0
    box: str = ""
    ids: list[str] = field(default_factory=list)

    def draw(self) -> str | bytes:
        """A message, mostly of a kind that there is."""
        if self.rng.random() < self.malformed / 4:
            return RAW[self.rng.integers(len(RAW))]
        message = self.message()
        while self.rng.random() < self.malformed:
            self._damage(message)
        return json.dumps(message)

    def message(self) -> dict[str, Any]:
        """One whose fields have their kinds, though it may be of nothing that there is."""
        edit = self.rng.random() < 0.6
        names = EDITS if edit else [op for op in KINDS if op not in BUSY or self.rng.random() < 0.06]
        op = str(self.rng.choice(list(names)))
        message: dict[str, Any] = {"op": op}
        frame = int(self.rng.integers(FRAMES))
        self.box = ""
        for one in fields(KINDS[op]):
            needed = one.default is MISSING and one.default_factory is MISSING
            if one.name != "op" and (needed or self.rng.random() < 0.5):
                message[one.name] = self._field(op, one.name, frame)
        return message

    def _damage(self, message: dict[str, Any]) -> None:
        name = str(self.rng.choice(list(message)))
        way = self.rng.integers(5)
        if way == 0:
            del message[name]
            message.setdefault("op", "undo")
        elif way == 1:
            message["unknown" if self.rng.random() < 0.7 else "__proto__"] = self._wild()
        elif way == 2 and isinstance(message[name], dict):
            message[name] = {**message[name], str(self.rng.choice(["box", "x", "class_name"])): self._wild()}
        elif way == 3 and isinstance(message[name], list) and message[name]:
            message[name] = list(message[name])
            message[name][self.rng.integers(len(message[name]))] = self._wild()
        else:
            message[name] = self._wild()

    def _wild(self) -> Any:
        return WILD[self.rng.integers(len(WILD))]

    def _field(self, op: str, name: str, frame: int) -> Any:
        rng = self.rng
        if name == "id":
            self.made += 1
            if self.ids and rng.random() < 0.05:
                return str(rng.choice(self.ids))
            self.ids.append(f"{self.name}-{self.made}")
            return self.ids[-1]
        if name in ("frame", "first", "last"):
            return int(rng.choice([*[frame] * 12, rng.integers(FRAMES), FRAMES, 9_999_999]))
        if name == "box":
            self.box = self._box(op, frame)
            return self.box
        if name in ("base", "into_base"):
            version = self._version(self.box) if self.box[:1].isdecimal() else 0
            return int(rng.choice([*[version] * 10, 0, rng.integers(50), 2**53 - 1]))
        if name in ("track", "into", "new_track"):
            return int(rng.choice([rng.integers(1, 21), rng.integers(1, 40), 2**31 - 1]))
        if name in ("around", "value"):
            return self._numbers() if name == "around" or op == "preview" else self._value()
        if name == "ends":
            return int(rng.choice([-1, frame, 9_999_999, 2**62]))
        if name == "size":
            return rng.uniform(0.01, 60, 3).tolist()
        return self._word(op, name)

    def _word(self, op: str, name: str) -> Any:
        """A field of few or free values."""
        rng = self.rng
        words: dict[str, Sequence[Any]] = {
            "group": (None, "g1", "g2"),
            "scope": ("mine", "all"),
            "force": (True, False),
            "size_locked": (True, False),
            "fit": (True, False),
            "keep_size": (True, False),
            "propose": (True, False),
            "used": (True, False),
            "full": (True, False),
            "class_name": ("vehicle", "pedestrian", "no such class", ""),
            "type_name": ("", "van", "no such type"),
            "annotator": ("", "kim", "lee"),
            "window": ("w1", "w2"),
            "version": (requests.VERSION, 1, 99),
            "purpose": ("show", "ahead", "here"),
            "check": ("none/0/0", "x"),
            "reason": ("", "it is so"),
            "note": (None, "", "here"),
            "extent": ("full", "visible"),
            "detector": ("no such detector", "../../etc/passwd", ""),
            "job": ("job-1", "none"),
            "format": ("", "boxes-csv", "cvat", "no such format", "../x"),
            "folder": (None, "one", "..", "...", "a.b"),
            "name": ("export", "..", "x.y"),
            "frames": ([], [0], [5, 5, 0], [9_999_999], list(range(50))),
            "shots": ([], ["shot-1"], ["none"]),
            "kind": ("html", "gif", "labels") if op == "export" else ("click", "drag", "rectangle", "refit", "peak"),
            "what": ("undo", "redo"),
        }
        if name in words:
            values = words[name]
            return values[rng.integers(len(values))]
        if name == "at":
            return rng.uniform(-1200, 1200, rng.choice([0, 2, 4, 8])).tolist()
        return float(rng.uniform(0, 1)) if rng.random() < 0.5 else int(rng.integers(0, 20))

    def _box(self, op: str, frame: int) -> str:
        standing = list(self.boxes.get(frame, {})) or ["0:0"]
        if op == "box.add" and self.rng.random() < 0.8:
            self.made += 1
            return f"{frame}:{self.name}-b{self.made}"
        other = f"{self.rng.integers(FRAMES)}:{self.rng.integers(30)}"
        choices = [standing[self.rng.integers(len(standing))]] * 25 + [
            other,
            "0",
            ":",
            f"{frame}:",
            "9999999:0",
            "-1:0",
        ]
        return str(self.rng.choice(choices))

    def _version(self, box: str) -> int:
        return self.boxes.get(int(box.partition(":")[0] or 0), {}).get(box, 0)

    def _numbers(self) -> list[float]:
        rng = self.rng
        box = [*rng.uniform(-80, 80, 2), rng.uniform(-3, 3), *rng.uniform(0.3, 9, 3), rng.uniform(-4, 4)]
        if rng.random() < 0.1:
            box[rng.integers(7)] = float(rng.choice([1e9, -1.0, 0.0, 60.0, 60.1, 1000.0, 1e-300, 5e-324]))
        return [float(number) for number in box]

    def _value(self) -> dict[str, Any]:
        rng = self.rng
        value: dict[str, Any] = {"box": self._numbers(), "class_name": str(rng.choice(["vehicle", "pedestrian", "x"]))}
        if rng.random() < 0.7:
            value["track"] = int(rng.integers(1, 25))
        if rng.random() < 0.4:
            value["state"] = str(rng.choice(["proposed", "edited", "accepted", "rejected"]))
        if rng.random() < 0.3:
            value["source"] = str(rng.choice(["lidar", "radar", "interpolated", "predicted", "detector"]))
        if rng.random() < 0.1:
            wild = (1, 10**400, 1e308, "y" * 70_000, None, True, -0.0)[rng.integers(7)]
            value["attributes"] = {str(rng.choice(["note", "availability", "", "x" * 128])): wild}
        return value


@dataclass(eq=False)
class HostileRun:
    """What came of it.

    Args:
        messages: Sent over all sockets.
        edits: Records of the journal that were compared with their messages.
        answers: How many of each kind came.
        windows: Opened.
        requests: Of HTTP.
        faults: Sentences.
    """

    messages: int = 0
    edits: int = 0
    windows: int = 0
    requests: int = 0
    answers: dict[str, int] = field(default_factory=dict)
    faults: list[str] = field(default_factory=list)


class HostileWindow:
    """A window that sends anything; one that is sent away comes again.

    Args:
        live: The studio.
        messages: What it sends.
        sent: Edits by id, of all windows.
        run: What came of it.
    """

    def __init__(self, live: Started, messages: Messages, sent: dict[str, list[Any]], run: HostileRun) -> None:
        self.live, self.messages, self.sent, self.run = live, messages, sent, run
        self.waiting: dict[str, str] = {}
        self.lock = threading.Lock()

    def send(self, count: int, until: float) -> None:
        """Send so many messages, unless the time is up."""
        while count > 0 and time.monotonic() < until:
            self.run.windows += 1
            self.waiting.clear()
            try:
                with connected(self.live, self.messages.name) as socket:
                    reader = threading.Thread(target=self._read, args=(socket,), daemon=True)
                    reader.start()
                    count -= self._send(socket, count, until)
                    self._settled(reader)
            except ConnectionClosed:
                continue
            except (InvalidStatus, InvalidMessage, OSError, TimeoutError) as error:
                self.run.faults.append(f"no window could be opened: {type(error).__name__}: {error}")
                return

    def _send(self, socket: ClientConnection, count: int, until: float) -> int:
        rng, sent = self.messages.rng, 0
        self.messages.malformed = float(rng.choice([0.0, 0.02, 0.3]))
        burst = rng.random() < 0.3
        with contextlib.suppress(ConnectionClosed):
            for frame in range(FRAMES):
                socket.send(json.dumps({"op": "frame.open", "frame": frame}))
            while sent < min(count, 200) and time.monotonic() < until:
                text = self.messages.draw()
                self._note(text)
                socket.send(text)
                self.run.messages += 1
                sent += 1
                if not burst and rng.random() < 0.3:
                    time.sleep(0.02)
        return sent

    def _note(self, text: str | bytes) -> None:
        try:
            message = json.loads(text)
        except (ValueError, RecursionError):
            return
        if isinstance(message, dict) and isinstance(message.get("id"), str):
            self.sent.setdefault(message["id"], []).append(message)
            named = re.fullmatch(r"[A-Za-z0-9._:+-]{1,64}", message["id"])
            if named and message.get("op") in ANSWERED and isinstance(text, str):
                self.waiting[message["id"]] = message["op"]

    def _read(self, socket: ClientConnection) -> None:
        with contextlib.suppress(ConnectionClosed):
            while True:
                reply = json.loads(socket.recv())
                answers = self.run.answers
                answers[reply["op"]] = answers.get(reply["op"], 0) + 1
                if reply["op"] in ANSWERS and reply.get("id") is not None:
                    self.waiting.pop(reply["id"], None)
                self._look(reply)
                if reply.get("code") == "failed" or "error of its own" in str(reply.get("message", "")):
                    self.run.faults.append(f"a foreign exception: {reply}")
                if not _finite(reply):
                    self.run.faults.append(f"a reply that is not finite: {str(reply)[:200]}")

    def _look(self, reply: Mapping[str, Any]) -> None:
        """Note the boxes that stand, so that many messages are of them."""
        boxes = self.messages.boxes
        if reply["op"] == "frame.state" and not reply.get("unreadable"):
            boxes[reply["frame"]["index"]] = {row["id"]: row["version"] for row in reply["boxes"]}
        if reply["op"] == "ack" and reply.get("row"):
            boxes.setdefault(int(reply["row"]["id"].partition(":")[0]), {})[reply["row"]["id"]] = reply["version"]

    def _settled(self, reader: threading.Thread) -> None:
        """All that was asked is answered before long, unless the window was sent away."""
        until = time.monotonic() + 60
        while self.waiting and reader.is_alive() and time.monotonic() < until:
            time.sleep(0.02)
        if self.waiting and reader.is_alive():
            unanswered = list(self.waiting.items())[:5]
            self.run.faults.append(f"no answer within a minute to {unanswered}")


def _finite(value: Any) -> bool:
    if isinstance(value, float):
        return math.isfinite(value)
    if isinstance(value, dict):
        return all(map(_finite, value.values()))
    return all(map(_finite, value)) if isinstance(value, list) else True


def judged(folder: Path, sent: Mapping[str, Sequence[Any]], keys: Sequence[tuple[str, str]]) -> tuple[int, list[str]]:
    """How many records a journal has, and those that say something else than their message."""
    versions: dict[tuple[str, ...], int] = {}
    records, faults = 0, []
    for line in (folder / "edits.jsonl").read_text().splitlines():
        record = json.loads(line[9:])
        records += 1
        where = f"edit {record['seq']} ({record['op']})"
        if not _finite(record):
            faults.append(f"{where}: not finite")
        for cell, base, _, _ in record.get("changes", ()):
            if base != versions.get(tuple(cell), 0):
                faults.append(f"{where}: of version {base} of {cell}, which was at {versions.get(tuple(cell), 0)}")
            versions[tuple(cell)] = record["seq"]
        of_a_box = record["op"] in ("box.set", "box.add", "box.delete")
        if of_a_box and not any(_fits(record, message, keys) for message in sent.get(record["id"], ())):
            faults.append(f"{where}: is none of {sent.get(record['id'])}: {record.get('changes')}")
    return records, faults


def _fits(record: Mapping[str, Any], message: Mapping[str, Any], keys: Sequence[tuple[str, str]]) -> bool:
    """Whether a stored edit of a box is what a message said."""
    if message.get("op") != record["op"] or not record["changes"]:
        return False
    cell, base, _, new = record["changes"][0]
    frame = message.get("frame")
    if type(frame) is not int or not 0 <= frame < len(keys) or not {"box", "value", "base"} & message.keys():
        return False  # it had the same id, and was refused
    same = tuple(cell[1:3]) == tuple(keys[frame]) and message.get("box") == f"{frame}:{cell[3]}"
    if record["op"] != "box.add":
        same = same and base == message.get("base")
    if record["op"] == "box.delete":
        return same and (new is None or new["state"] == "rejected")
    wanted = message.get("value")
    if not isinstance(wanted, dict) or not {"box", "class_name"} <= wanted.keys():
        return False
    turn = math.remainder(new["box"][6] - wanted["box"][6], math.tau)
    return (
        same
        and new["label"] == wanted["class_name"]
        and new["box"][:6] == wanted["box"][:6]
        and abs(turn) < 1e-9
        and new.get("state", "accepted") == wanted.get("state", "edited")
    )


class Person:
    """A window that annotates as it should while the others attack: each edit is taken, or a conflict names the other.

    Args: those of :class:`HostileWindow`.
    """

    def __init__(self, live: Started, run: HostileRun, sent: dict[str, list[Any]]) -> None:
        self.live, self.run, self.sent = live, run, sent
        self.ended = threading.Event()
        self.taken = 0

    def work(self) -> None:
        """Move a box of its own to and fro until it is told to end."""
        with connected(self.live, "person") as socket:
            version, name, number = 0, "1:person-box", 0
            while not self.ended.is_set():
                number += 1
                value = {
                    "box": [10.0 + number % 7, 3.0, 0.0, 4.0, 2.0, 1.5, 0.1],
                    "class_name": "vehicle",
                    "track": 900,
                }
                message = {"op": "box.set", "id": f"person-{number}", "frame": 1, "box": name, "value": value}
                message |= {"op": "box.add"} if version == 0 else {"base": version}
                self.sent.setdefault(message["id"], []).append(message)
                socket.send(json.dumps(message))
                reply = _answer(socket, message["id"])
                if reply is None:
                    self.run.faults.append("a person's edit got no answer within a minute")
                    return
                if reply["op"] == "ack":
                    version = reply["version"]
                    self.taken += 1
                elif reply["op"] == "conflict":
                    version = reply["present"]["version"] if reply.get("present") else 0
                elif version:
                    self.run.faults.append(f"a person's edit was refused: {reply}")
                    return
                time.sleep(0.03)


def _answer(socket: ClientConnection, id: str) -> dict[str, Any] | None:
    with contextlib.suppress(TimeoutError):
        while True:
            reply = json.loads(socket.recv(timeout=60))
            if reply["op"] in ("ack", "conflict", "refused") and reply["id"] == id:
                return dict(reply)
    return None


PATHS = (
    "/",
    "/health",
    "/layer/0/0",
    "/layer/5/0",
    "/image/0/0",
    "/radar/0/bev",
    "/shot",
    "/export/x",
    "/socket",
    "/x",
)
ODD = (
    "%00",
    "..%2f",
    "%ff",
    "9" * 30,
    "-1",
    "é",
    "'",
    "<",
    "\\",
    "//",
    "?sweeps=",
    "?low=nan&high=inf",
    "?frame=a/b/c",
)


def request_anything(live: Started, rng: np.random.Generator, count: int, run: HostileRun) -> None:
    """Send requests of any kind, with the cookie; the server answers them all, none as an error of its own."""
    host, _, port = live.origin.removeprefix("http://").partition(":")
    for _ in range(count):
        path = str(rng.choice(PATHS)) + (str(rng.choice(ODD)) if rng.random() < 0.6 else "")
        method = str(rng.choice(["GET", "GET", "GET", "POST", "PUT", "HEAD", "OPTIONS", "DELETE", "X", "get"]))
        lines = [
            f"{method} {path} HTTP/1.1",
            f"Host: {host}:{port}",
            f"Cookie: {live.cookie}",
            f"Origin: {live.origin}",
        ]
        body = bytes(rng.integers(0, 256, rng.choice([0, 10, 5000]), dtype=np.uint8)) if rng.random() < 0.3 else b""
        if body and rng.random() < 0.3:
            body = b"\x89PNG\r\n\x1a\n" + body
        length = rng.choice([str(len(body)), str(len(body)), "-1", "x", "9" * 20, str(len(body) + 5), "0"])
        if body or rng.random() < 0.1:
            lines.append(f"Content-Length: {length}")
        if rng.random() < 0.1:
            lines.append(
                str(rng.choice(["Range: bytes=5-1", "If-None-Match: \xff", "Accept-Encoding: gzip;q=x", "A" * 9000]))
            )
        if rng.random() < 0.05:
            lines[0] = str(rng.choice(["", "GET", "GET / HTTP/9.9", "\x00\x01", "GET /" + "a" * 20_000 + " HTTP/1.1"]))
        run.requests += 1
        _raw_request(
            host, int(port), "\r\n".join(lines).encode("latin-1", "replace") + b"\r\n\r\n" + body, run, lines[0]
        )


def _raw_request(host: str, port: int, data: bytes, run: HostileRun, line: str) -> None:
    with sockets.create_connection((host, port), timeout=20) as raw:
        with contextlib.suppress(ConnectionError):
            raw.sendall(data)
            raw.shutdown(sockets.SHUT_WR)
        try:
            head = raw.recv(4096)
        except ConnectionError:
            return
        except TimeoutError:
            run.faults.append(f"no answer to {line[:80]!r}")
            return
    status = head.split(b" ", 2)[1:2]
    if status and status[0].startswith(b"5") and status[0] != b"503":
        run.faults.append(f"{line[:80]!r} was answered by {head[:60]!r}")


def run_hostile(
    folder: Path,
    *,
    messages: int,
    seed: int,
    windows: int = 5,
    seconds: float = 600.0,
    say: Callable[[str], None] = print,
) -> HostileRun:
    """Attack a studio, and judge what became of it.

    Args:
        folder: Where data and edits are made.
        messages: How many over the sockets; a tenth as many requests of HTTP go beside them.
        seed: Of all of them.
        windows: How many at once.
        seconds: When it ends at the latest.
        say: Gets a line now and then.
    """
    data = write_folder(folder / "drive", FRAMES, 2_000, seed=seed)
    run, sent, boxes = HostileRun(), dict[str, list[Any]](), dict[int, dict[str, int]]()
    log = folder / "terminal.txt"
    until = time.monotonic() + seconds
    options = ("--extent", "full", "--edits", str(folder / "edits"), "--classes", "vehicle:4.6,1.9,1.6")
    with started("annotate", str(data), *options, log=log) as live:
        person = Person(live, run, sent)
        helper = threading.Thread(target=person.work, daemon=True)
        helper.start()
        makers = [Messages(np.random.default_rng([seed, number]), f"h{number}", boxes) for number in range(windows)]
        hostile = [HostileWindow(live, maker, sent, run) for maker in makers]
        attacks = [threading.Thread(target=one.send, args=(messages // windows, until), daemon=True) for one in hostile]
        attacks.append(
            threading.Thread(
                target=request_anything,
                args=(live, np.random.default_rng([seed, 99]), messages // 10, run),
                daemon=True,
            )
        )
        for attack in attacks:
            attack.start()
        for attack in attacks:
            attack.join(max(1.0, until + 90 - time.monotonic()))
            if attack.is_alive():
                run.faults.append("a window or request did not come to its end")
        person.ended.set()
        helper.join(70)
        if person.taken == 0 or helper.is_alive():
            run.faults.append(f"{person.taken} edits of a person were taken, and the last one is stuck")
        _alive(live, run)
    terminal = log.read_text(errors="replace")
    foreign = re.search(r"^.*(Traceback|Exception|Error).*$", terminal, re.MULTILINE)
    if foreign:
        shown = terminal[max(0, foreign.start() - 200) : foreign.start() + 4000]
        run.faults.append(f"the terminal shows a foreign exception: {shown}")
    run.edits, faults = judged(folder / "edits", sent, open_dataset(data).keys)
    run.faults += faults
    for fault in run.faults:
        say(f"  {fault[:6000]}")
    return run


def _alive(live: Started, run: HostileRun) -> None:
    """At the end a new window gets every frame, and the server its health asked."""
    with contextlib.closing(http.client.HTTPConnection(live.origin.removeprefix("http://"), timeout=20)) as connection:
        connection.request("GET", "/health")
        if connection.getresponse().status != 200:
            run.faults.append("the server is not healthy at the end")
    with connected(live, "last") as socket:
        for frame in range(FRAMES):
            socket.send(json.dumps({"op": "frame.open", "frame": frame}))
            while json.loads(socket.recv(timeout=30)).get("op") != "frame.state":
                pass
