"""Talk to a studio over its wire and write down what it answers.

    python record_studio.py VERB TALK WORDS...

starts ``farfield VERB WORDS...`` in the present folder, holds the talk TALK with it (looking, editing, tracking,
calibrating) and writes what each window received as JSON and what was fetched as files, below ``got``. Messages that
come when they please are sorted or left out: what is written does not depend on who was quicker.
"""

import contextlib
import http.client
import itertools
import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

Message = dict[str, Any]
GOT = Path("got")
_UNTOLD = (
    "job",
    "windows",
    "checks",
    "drive.checks",
)  # progress, who is there, checks of frames: when there is time; asked for below
_LAST = ("matches", "predicted")  # told anew whenever something changed: the last one of each frame and set
_ENDED = ("done", "failed", "cancelled")
_KINDS = {"text/html": ".html", "image/png": ".png", "image/jpeg": ".jpg", "image/webp": ".webp", "image/gif": ".gif"}
_KINDS |= {"application/json": ".json", "application/zip": ".zip", "text/plain": ".txt"}
_VALUE = ("box", "class_name", "track", "state", "source", "attributes")


class Studio:
    """A studio that was started as a user does."""

    def __init__(self, verb: str, words: list[str]) -> None:
        self.said: list[str] = []
        command = [sys.executable, "-m", "farfield.cli", verb, *words, "--no-browser", "--port", "0"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        self.host, self.cookie = "", ""
        try:
            self.enter()
        except OSError:
            self.end()
            raise

    def enter(self) -> None:
        """Follow the printed link, and wait until the data are open."""
        for line in self.process.stdout or ():
            self.said.append(line)
            if found := re.search(r"http://([\w.:]+)/\?token=(\S+)", line):
                self.host = found.group(1)
                _, headers, _ = self.request("GET", f"/?token={found.group(2)}")
                self.cookie = headers["set-cookie"].partition(";")[0]
                break
        else:
            raise SystemExit("the studio ended without a link:\n" + "".join(self.said))
        until = time.monotonic() + 60
        while time.monotonic() < until and not json.loads(self.request("GET", "/health")[2])["ready"]:
            time.sleep(0.05)

    def request(self, method: str, path: str, body: bytes | None = None) -> tuple[int, dict[str, str], bytes]:
        """One request: status, headers, body."""
        connection = http.client.HTTPConnection(self.host, timeout=60)
        headers = {"Cookie": self.cookie, "Origin": f"http://{self.host}"} if self.cookie else {}
        connection.request(method, path, body, headers)
        answer = connection.getresponse()
        content = answer.read()
        connection.close()
        return answer.status, {name.lower(): value for name, value in answer.getheaders()}, content

    def fetch(self, path: str, name: str = "") -> Message:
        """Keep what a path gives as a file; return what is told of it."""
        status, headers, body = self.request("GET", "/" + path.lstrip("/"))
        kind = headers.get("content-type", "").partition(";")[0]
        file = GOT / ((name or re.sub(r"\W+", "-", path).strip("-") or "root") + _KINDS.get(kind, ".bin"))
        file.parent.mkdir(exist_ok=True)
        file.write_bytes(body)
        told = ("content-type", "content-disposition", "cache-control", "etag", "content-security-policy")
        return {"path": path, "status": status, **{key: headers.get(key) for key in told}}

    def end(self) -> None:
        """Stop it as Ctrl-C does."""
        self.process.send_signal(signal.SIGINT)
        rest, _ = self.process.communicate(timeout=60)
        self.said.append(rest)
        print("".join(self.said), f"status {self.process.returncode}", sep="\n")


class Window:
    """A window of the page, with all that it was told."""

    def __init__(self, socket: ClientConnection, name: str) -> None:
        self.socket, self.name, self.numbers = socket, name, itertools.count(1)
        self.talk: list[Message] = []
        self.beside: dict[str, Any] = {}
        self.tracks: dict[int, Message] = {}

    def ask(self, op: str, *awaited: str, **fields: Any) -> Message:
        """Send a message, wait for the replies that it has, and return the first."""
        number = f"{self.name}-{next(self.numbers)}"
        named = {} if op in _NAMELESS else {"id": number}
        message = {"op": op, **named, **fields}
        self.socket.send(json.dumps(message))
        got: dict[str, Message] = {}
        while not all(each in got for each in awaited):
            reply = self.receive(30)
            if reply is None:
                got["nothing"] = {"op": "nothing more"}
                break
            kind, mine = reply["op"], reply.get("id") in (None, message.get("id", reply.get("id")))
            if kind in ("refused", "conflict") and mine:
                got = {kind: reply}
                break
            ends = kind != "job" or reply["state"] in _ENDED
            if kind in awaited and kind not in got and mine and ends:
                got[kind] = reply
            else:
                self._keep(reply)
        ordered = [got[each] for each in (*awaited, *sorted(got.keys() - set(awaited))) if each in got]
        self.talk.append({"sent": message, "got": ordered})
        return ordered[0] if ordered else {}

    def raw(self, text: str) -> None:
        """Send what is no message; it is refused."""
        self.socket.send(text)
        while (reply := self.receive(30)) is not None and reply["op"] != "refused":
            self._keep(reply)
        self.talk.append({"sent": text, "got": [reply]})

    def receive(self, seconds: float) -> Message | None:
        """The next message, or None if none comes."""
        try:
            reply: Message = json.loads(self.socket.recv(timeout=seconds))
        except TimeoutError:
            return None
        for track in reply.get("tracks", ()):
            self.tracks[track["track"]] = track
        return reply

    def _keep(self, reply: Message) -> None:
        kind = reply["op"]
        if kind in _LAST:
            where = str(reply.get("set") if kind == "matches" else reply.get("frame"))
            self.beside.setdefault(kind, {})[where] = reply
        elif kind not in _UNTOLD:
            self.beside.setdefault(kind, []).append(reply)

    def quiet(self) -> None:
        """Take what still comes."""
        while (reply := self.receive(0.7)) is not None:
            self._keep(reply)

    def open(self, frame: int, **more: Any) -> Message:
        """Open a frame."""
        return self.ask("frame.open", "frame.state", frame=frame, **more)

    def set(self, frame: int, row: Message, **changed: Any) -> Message:
        """Change a box."""
        value = {name: row[name] for name in _VALUE} | changed
        return self.ask("box.set", "ack", frame=frame, box=row["id"], base=row["version"], value=value)

    def checks(self, frame: int | None) -> Message:
        """The findings of a frame or of its whole drive, once all frames are checked with their points."""
        self.quiet()
        message = {"op": "check.list", "frame": frame or 0}
        self.socket.send(json.dumps(message))
        rows: dict[int, list[Message]] = {}
        done = False
        while not done and (reply := self.receive(60)) is not None:
            if reply["op"] != "drive.checks":
                self._keep(reply)
                continue
            rows |= {index: [row for row in reply["rows"] if row["frame"] == index] for index in reply["frames"]}
            done = reply["done"] == reply["total"] == len(rows)
        frames = sorted(rows) if frame is None else [frame]
        checks: Message = {"op": "drive.checks", "rows": [row for index in frames for row in rows.get(index, ())]}
        self.talk.append({"sent": message, "got": [checks]})
        return checks

    def base(self, track: int) -> int:
        """The version of a track as it was told last."""
        return int(self.tracks.get(track, {"version": 0})["version"])

    def write(self) -> None:
        """Write all down."""
        GOT.mkdir(exist_ok=True)
        beside = {kind: self.beside[kind] for kind in sorted(self.beside)}
        text = json.dumps({"talk": self.talk, "beside": beside}, indent=1, sort_keys=True)
        (GOT / f"{self.name}.json").write_text(text + "\n")


_NAMELESS = ("hello", "frame.open", "preview", "check.list", "timing", "match.list")


@contextlib.contextmanager
def window(studio: Studio, name: str, **hello: Any) -> Iterator[tuple[Window, Message]]:
    """Open a window and say hello."""
    headers, origin = {"Cookie": studio.cookie}, f"http://{studio.host}"
    where = f"ws://{studio.host}/socket"
    with connect(where, origin=Origin(origin), additional_headers=headers, max_size=1 << 26) as socket:
        opened = Window(socket, name)
        try:
            welcome = opened.ask("hello", "welcome", window=name, **hello)
            yield opened, welcome
            opened.quiet()
        finally:
            opened.write()


def looking(studio: Studio) -> None:
    """Frames, layers, pictures, maps, pages, films, matching; edits are refused."""
    told = [studio.fetch(path) for path in ("health", "", "index.html", "studio.js", "calibrate.html", "nothing.js")]
    with window(studio, "one") as (one, welcome):
        for frame in range(min(welcome["frames"], 3)):
            state = one.open(frame, sweeps=2, threshold=0.2)
            told += [studio.fetch(layer["url"]) for layer in state.get("layers", ())]
        told += [studio.fetch(f"{layer['url']}?sweeps=2") for layer in state["layers"] if layer["kind"] == "points"]
        told += [studio.fetch(f"{layer['url']}?exact=1") for layer in state["layers"] if layer["kind"] == "image"]
        told += [studio.fetch(f"radar/0/{kind}?low=-2&high=4") for kind in ("bev", "bfs", "none")]
        told += [studio.fetch(path) for path in ("layer/99/0", "layer/0/99", "image/0/0", "export/none", "?frame=1/1")]
        one.ask("frame.open", "frame.state", frame=99)
        one.ask("frame.open", frame=0, purpose="here")
        one.ask("match.list", *(["matches"] if welcome["predictions"] else []), threshold=0.3)
        one.ask("bookmark.set", "bookmarks", frame=0, note="look")
        row = state["boxes"][0] if state["boxes"] else {"id": "x", "version": 0, **dict.fromkeys(_VALUE)}
        one.set(0, row)
        one.ask("undo", "changed")
        one.ask("calib.open", "calib.state")
        one.ask("nothing.such", "refused")
        _films(studio, one, told)
        one.ask("export", "job", kind="html", frames=[0], name="page")
        told.append(studio.fetch(one.talk[-1]["got"][0].get("url") or "none", "page"))
        _detections(one, welcome)
    _write("fetched", told)


def _films(studio: Studio, one: Window, told: list[Message]) -> None:
    shots = []
    for path in sorted(Path("photos").glob("*.png")):
        status, _, body = studio.request("POST", "/shot", path.read_bytes())
        told.append({"shot": status, "answer": body.decode()})
        shots.append(json.loads(body)["shot"])
    told.append({"bad shot": studio.request("POST", "/shot", b"<svg/>")[0]})
    for kind in ("gif", "webp"):
        done = one.ask("export", "job", kind=kind, shots=shots, name="film", rate_hz=5)
        told.append(studio.fetch(done.get("url") or "none", f"film-{kind}"))
    one.ask("export", "job", kind="gif", shots=["shot-999"])


def _detections(one: Window, welcome: Message, **more: Any) -> None:
    names = [row["name"] for row in welcome["detectors"]]
    wanted = "pointpillars-kradar-sim" if welcome["data"] == "kradar" else "pointpillars-cirrus-sim"
    if wanted in names:
        one.ask("infer.start", "job", detector=wanted, first=0, last=1, threshold=0.3, **more)
        one.open(0)
        one.open(1)
    one.ask("infer.start", "job", detector="none", first=0, last=0)
    one.ask("infer.cancel", "job", job="job-99")


def editing(studio: Studio) -> None:
    """Boxes changed, added, removed, fitted, checked, undone, proposed, saved and exported; a second window sees it."""
    with window(studio, "one") as (one, welcome), window(studio, "two", annotator="lee") as (two, _):
        told: list[Message] = []
        state = one.open(0)
        two.open(0)
        rows = sorted(state["boxes"], key=lambda row: (-(row["points"] or 0), row["id"]))
        row, other = rows[0], rows[1]
        ack = one.set(0, row, box=[row["box"][0] + 1.0, *row["box"][1:]])
        two.set(0, row, box=row["box"])  # came too late
        two.set(0, other, box=[*other["box"][:6], 0.5], state="accepted")
        one.set(0, row | {"version": ack.get("version", 0)}, class_name="no such class")
        one.ask("policy.set", "ack", extent="full")
        one.ask("policy.set", "ack", extent="visible")
        for number, box in enumerate((row["box"], [12.0, 3.0, -0.7, 4.2, 1.8, 1.5, 0.3])):
            value = {"box": box, "class_name": row["class_name"], "source": "lidar", "track": 950 + number}
            one.ask("box.add", "ack", frame=0, box=f"new-{number}", value=value, group="both")
        _fits(one, row)
        two.ask("preview", frame=0, box=other["id"], value=[*other["box"][:6], 1.0])
        checks = one.checks(0)
        one.checks(None)
        for found in checks.get("rows", ())[:1]:
            one.ask("check.ignore", "ack", check=found["id"], reason="it is so")
        one.ask("bookmark.set", "bookmarks", frame=0, note="look again")
        one.ask("bookmark.set", "bookmarks", frame=1, note="there")
        one.ask("bookmark.set", "bookmarks", frame=1, note=None)
        one.ask("timing", frame=0, box=row["id"], seconds=4.5, edits=2)
        one.ask("match.list", *(["matches"] if welcome["predictions"] else []), threshold=0.3)
        one.ask("box.delete", "ack", frame=0, box="new-1", base=_version(one, "new-1"))
        one.ask("undo", "ack", "changed")
        one.ask("undo", "ack", "changed")
        one.ask("redo", "ack", "changed")
        two.ask("undo", "ack", "changed", scope="all", force=True)
        two.ask("redo", "ack", "changed", scope="all")
        _detections(one, welcome, propose=True)
        one.ask("save", "saved")
        for format in welcome["formats"]:
            one.ask("save", "saved", folder=f"as-{format}", format=format)
            one.ask("export", "job", kind="labels", format=format, name=f"mine-{format}", frames=[0, 1])
            told.append(studio.fetch(one.talk[-1]["got"][0].get("url") or "none", f"labels-{format}"))
        one.ask("save", "saved", folder="..")
        one.ask("calib.open", "calib.state")
        one.raw("{")
        one.raw('{"op": "box.set", "frame": 0}')
        one.open(0)
        one.checks(0)
    _write("fetched", told)


def _fits(one: Window, row: Message) -> None:
    x, y, _, length, width, _, yaw = row["box"]
    kind = {"frame": 0, "class_name": row["class_name"]}
    one.ask("fit", "fitted", kind="click", at=[x, y], **kind)
    one.ask("fit", "fitted", kind="drag", at=[x - length / 2, y, x + length / 2, y], **kind)
    corners = [x - length, y - width, x + length, y - width, x + length, y + width, x - length, y + width]
    one.ask("fit", "fitted", kind="rectangle", at=corners, **kind)
    around = [x + 0.3, y - 0.2, *row["box"][2:6], yaw + 0.05]
    one.ask("fit", "fitted", kind="refit", around=around, **kind)
    one.ask("fit", "fitted", kind="refit", around=around, keep_size=True, **kind)
    one.ask("fit", "fitted", kind="peak", at=[x, y], **kind)
    one.ask("fit", "fitted", kind="click", at=[x], **kind)


def _version(one: Window, box: str) -> int:
    rows = [reply["row"] for each in one.talk for reply in each["got"] if reply.get("row")]
    return next((int(row["version"]) for row in reversed(rows) if row["id"] == box), 0)


def tracking(studio: Studio) -> None:
    """Tracks made, filled, carried on, split, joined, locked and ended."""
    with window(studio, "one") as (one, welcome):
        frames = welcome["drives"][0]["frames"]
        first, middle, last = frames[0], frames[len(frames) // 2], frames[-1]
        row = max(one.open(first)["boxes"], key=lambda row: (row["points"] or 0, row["id"]))
        for number, (frame, shift) in enumerate([(first, 0.0), (last, 4.0)]):
            box = [row["box"][0] + shift, *row["box"][1:]]
            value = {"box": box, "class_name": row["class_name"], "track": 900}
            one.ask("box.add", "ack", frame=frame, box=f"own-{number}", value=value)
        one.ask("track.interpolate", "ack", "changed", track=900, first=first, last=last)
        one.ask("track.set", "ack", "changed", track=900, base=one.base(900), size_locked=True, size=row["box"][3:6])
        one.ask("track.split", "ack", "changed", track=900, frame=middle, new_track=901, base=one.base(900))
        one.ask("track.propagate", "ack", "changed", track=901, first=middle, last=last, fit=True)
        merged = {"track": 901, "into": 900, "base": one.base(901), "into_base": one.base(900)}
        one.ask("track.merge", "ack", "changed", **merged)
        one.ask("track.set", "ack", "changed", track=900, base=one.base(900), ends=middle)
        if row["track"] is not None:
            one.ask("track.propagate", "ack", "changed", track=row["track"], first=first, last=middle, fit=False)
            one.ask("track.set", "ack", "changed", track=row["track"], base=one.base(row["track"]), ends=-1)
        one.ask("track.set", "ack", "changed", track=777, base=0, size_locked=True)
        one.ask("track.set", "ack", "changed", track=900, base=0, size_locked=False)
        for op in ("undo", "undo", "undo", "redo", "undo"):
            one.ask(op, "ack", "changed")
        for frame in (first, middle, last):
            one.open(frame)
            one.checks(frame)
        one.checks(None)
        one.ask("save", "saved")


def calibrating(studio: Studio) -> None:
    """Values set, matched, solved, picked, undone, saved and put back."""
    with window(studio, "one") as (one, _):
        one.ask("calib.open", "job")
        state = one.ask("calib.open", "calib.state")
        part = "radar" if state["radar"] else "camera"
        frame = state["frames"][0]["index"]
        shift = {"x_m": state["radar"]["x_m"] + 0.2} if part == "radar" else {"moved": [0.01, *[0.0] * 5]}
        values = state[part] | shift
        one.ask("calib.match", "calib.residual", frame=frame, **{part: values})
        one.ask("calib.match", "calib.residual", frame=frame, full=True, **{part: state[part]})
        after = one.ask("calib.set", "calib.state", base=state["seq"], **{part: values})
        one.ask("calib.set", "calib.state", base=state["seq"], **{part: values})  # from a state that is no more
        for what in ("undo", "redo", "redo"):
            one.ask("calib.undo", "calib.state", what=what)
        for number in range(8):
            point = [10.0 + 3 * number, 3.0 - number, -1.0 + 0.2 * number]
            pixel = [600.0 - 60 * number, 300.0 - 12 * number + 7 * (number % 3)]
            one.ask("calib.pick", "calib.state", frame=frame, point_m=point, pixel=pixel)
        one.ask("calib.unpick", "calib.state", pick=3, used=False)
        one.ask("calib.unpick", "calib.state", pick=4)
        one.ask("calib.unpick", "calib.state", pick=99)
        for how in ("objects", "pairs", "edges"):
            one.ask("calib.solve", "job", how=how)
            one.ask("calib.open", "calib.state")
        one.ask("calib.cancel", "job", job="calib-99")
        for to in ("folder", "data"):
            one.ask("calib.save", "calib.saved", "calib.state", to=to)
        one.ask("calib.restore", "calib.saved", "calib.state")
        one.ask("calib.set", "calib.state", base=-1)
        one.ask("box.delete", "ack", frame=0, box="a", base=0)
        one.beside.pop("calib.state", None)  # the same ones, told to all windows
        del after
    _write("fetched", [studio.fetch(path) for path in ("", "calibrate.js")])


def _write(name: str, told: list[Message]) -> None:
    GOT.mkdir(exist_ok=True)
    (GOT / f"{name}.json").write_text(json.dumps(told, indent=1, sort_keys=True) + "\n")


TALKS: dict[str, Callable[[Studio], None]] = {each.__name__: each for each in (looking, editing, tracking, calibrating)}


def main(arguments: list[str]) -> None:
    """Hold a talk."""
    verb, talk, *words = arguments
    studio = Studio(verb, words)
    try:
        TALKS[talk](studio)
    finally:
        studio.end()


if __name__ == "__main__":
    main(sys.argv[1:])
