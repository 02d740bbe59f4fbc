"""What may come of gestures at the studio's page: a model written from docs/studio.md, not from the page's code.

It sees what a person sees (the header, the counter, the chosen row of the list of objects, the numbers of the selected
box, whether help or the wall lies over them) at the moment of every key and button, and just after it; and it reads the
journal. *What is stored is what was shown*: each stored edit is of a frame, a box and numbers that some gesture of its
window had before it on the screen, and nothing is done more often than its key was pressed.
"""

import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

NUMBERS = ("x", "y", "z", "l", "w", "h", "yaw")
ROUNDED_M, ROUNDED_DEG = 0.0051, 0.051  # the page's fields have two places, of the yaw one


class Window(Protocol):
    """A window in which something was done."""

    entries: list[dict[str, Any]]
    sent: list[dict[str, Any]]


SMALL_M, TURN_DEG = 0.05, 1.0
MOVES = {
    "KeyW": (1, 0, 0),
    "KeyS": (-1, 0, 0),
    "KeyA": (0, 1, 0),
    "KeyD": (0, -1, 0),
    "KeyR": (0, 0, 1),
    "KeyF": (0, 0, -1),
}
TURNS = {"KeyQ": 1, "KeyE": -1}
SIZES = {
    "BracketLeft": (3, -1),
    "BracketRight": (3, 1),
    "Semicolon": (4, -1),
    "Quote": (4, 1),
    "Comma": (5, -1),
    "Period": (5, 1),
}


def told(entry: Mapping[str, Any], box: Sequence[float]) -> list[float] | None:
    """What the table of keys in docs/studio.md says that a key makes of a box; None: it says nothing of the numbers."""
    scale = 10 if entry["shift"] and not entry["alt"] else 0.2 if entry["alt"] and not entry["shift"] else 1
    x, y, z, length, width, height, yaw = box
    code, out = entry["code"], [x, y, z, length, width, height, yaw]
    if entry["ctrl"]:
        return None
    if code in MOVES:
        ahead, left, up = (SMALL_M * scale * way for way in MOVES[code])
        out[0] += ahead * math.cos(yaw) - left * math.sin(yaw)
        out[1] += ahead * math.sin(yaw) + left * math.cos(yaw)
        out[2] += up
        return out
    if code in TURNS:
        out[6] += math.radians(TURN_DEG * scale * TURNS[code])
        return out
    if code == "KeyG":
        out[6] += math.pi / 2 if entry["shift"] else math.pi
        return out
    return None


def _sized(entry: Mapping[str, Any], box: Sequence[float]) -> list[list[float]]:
    """What a key that sizes may make of a box: the far or the near face moves, and which that is, is not told here."""
    if entry["code"] not in SIZES or entry["ctrl"]:
        return []
    axis, sign = SIZES[entry["code"]]
    scale = 1 if entry["shift"] == entry["alt"] else 10 if entry["shift"] else 0.2
    grown = max(0.1, box[axis] + sign * SMALL_M * scale) - box[axis]
    ways = {3: (math.cos(box[6]), math.sin(box[6]), 0), 4: (-math.sin(box[6]), math.cos(box[6]), 0), 5: (0, 0, 1)}
    sized = []
    for side in (0.5, -0.5):
        out = list(box)
        out[axis] += grown
        out[:3] = (place + side * grown * way for place, way in zip(box[:3], ways[axis], strict=True))
        sized.append(out)
    return sized


def apart(a: Sequence[float], b: Sequence[float]) -> float:
    """How far two boxes differ, in units of what the fields round away; a number that is not shown (NaN) counts not."""
    turn = abs((math.degrees(a[6] - b[6]) + 180) % 360 - 180)
    away = [turn / ROUNDED_DEG, *(abs(p - q) / ROUNDED_M for p, q in zip(a[:6], b[:6], strict=True))]
    return max((part for part in away if not math.isnan(part)), default=0.0)


def shown_box(view: Mapping[str, Any]) -> list[float] | None:
    """The numbers of the inspector as a box; None where none is selected."""
    fields = view["fields"]
    if view["box"] is None or set(fields) != set(NUMBERS):
        return None
    return [fields[name] for name in NUMBERS[:6]] + [math.radians(fields["yaw"])]


@dataclass(eq=False)
class Verdict:
    """What was compared, and what was wrong.

    Args:
        edits: Stored edits of boxes that had a gesture.
        faults: Sentences.
    """

    edits: int = 0
    faults: list[str] = field(default_factory=list)


def journal(folder: Path) -> list[dict[str, Any]]:
    """All stored edits."""
    path = folder / "edits.jsonl"
    return [json.loads(line[9:]) for line in path.read_text().splitlines()] if path.is_file() else []


PRESSED = {
    "undo": (("KeyZ", True, False),),
    "redo": (("KeyZ", True, True),),
    "track.propagate": (("KeyP", False, False), ("KeyP", False, True)),
    "track.interpolate": (("KeyI", False, False),),
    "track.set": (("KeyO", False, False), ("KeyL", True, False), ("KeyC", False, True)),
    "box.delete": (("Delete", False, False),),
}
"""Operations that are stored at most as often as one of their keys (code, Ctrl, Shift) was pressed."""


def judge(
    records: Sequence[Mapping[str, Any]],
    windows: Mapping[str, Window],
    keys: Sequence[tuple[str, str]],
    others: Sequence[str] = (),
) -> Verdict:
    """Whether each stored edit is of what was shown when a gesture was made.

    Args:
        records: Of the journal.
        windows: By the names that they had.
        keys: Sequence and frame of each frame.
        others: Names of windows that are no hands.
    """
    verdict = Verdict()
    index_of = {key: index for index, key in enumerate(keys)}
    done: Counter[tuple[int, str]] = Counter()
    for record in records:
        name, op = record["window"], record["op"]
        if name in others or not name:  # a window of its own, or the studio itself
            continue
        window = windows.get(name) or _renamed(name, windows)
        if window is None:
            verdict.faults.append(f"edit {record['seq']} ({op}): of a window {name} that there was not")
            continue
        done[id(window), op] += 1
        changes = record.get("changes", ())
        for cell, _, _, new in changes:
            if cell[0] == "box" and new is not None and not np.isfinite(new["box"]).all():
                verdict.faults.append(f"edit {record['seq']} ({op}): not finite")
        if op in ("box.set", "box.add", "box.delete"):
            verdict.edits += op == "box.set"
            (_, sequence, frame, box), _, old, new = changes[0]
            identity = f"{index_of[sequence, frame]}:{box}"
            reason = _reason(op, window.entries, index_of[sequence, frame], frame, identity, old, new)
            where = f"edit {record['seq']} ({op}) of box {identity} in frame {frame}"
            verdict.faults += [f"{where}: {text}" for text in (reason, *_more(changes)) if text]
    for (number, op), count in done.items():
        entries = next(window.entries for window in windows.values() if id(window) == number)
        pressed = sum(_chord(entry) in PRESSED.get(op, ()) for entry in entries)
        pressed += sum(entry["again"] or entry["keep"] for entry in entries)
        if op in PRESSED and count > pressed:
            verdict.faults.append(f"{op} was stored {count} times, and its key pressed {pressed} times")
    for window in {id(one): one for one in windows.values()}.values():
        verdict.faults += [f"a message without its numbers left the page: {message}" for message in _hollow(window)]
    return verdict


def _chord(entry: Mapping[str, Any]) -> tuple[str, bool, bool]:
    return (entry["code"], entry["ctrl"], entry["shift"]) if entry["type"] == "keydown" else ("", False, False)


def _renamed(name: str, windows: Mapping[str, Window]) -> Window | None:
    """A window that has another name since a line broke: it begins alike."""
    return next((one for old, one in windows.items() if name.startswith(old.rpartition("-")[0] or old)), None)


def _hollow(window: Window) -> list[dict[str, Any]]:
    """Messages of boxes that lack a number: JSON makes null of what is none."""
    out = []
    for message in window.sent:
        value = message.get("value")
        numbers = value.get("box") if isinstance(value, dict) else value
        if message["op"] in ("box.set", "box.add", "preview") and (numbers is None or None in numbers):
            out.append(message)
    return out


def _more(changes: Sequence[Any]) -> list[str]:
    """What is wrong with the other changes of an edit of a box: a locked size goes to the boxes of its track only."""
    faults = []
    for cell, _, old, new in changes[1:]:
        if cell[0] != "box":
            continue
        same = old is not None and new is not None and new.get("track") == changes[0][3].get("track")
        if not (same and old["box"][:2] == new["box"][:2] and old["box"][6] == new["box"][6]):
            faults.append(f"box {cell[3]} of frame {cell[2]} was changed with it: {old} became {new}")
    return faults


def _reason(
    op: str,
    entries: Sequence[Mapping[str, Any]],
    index: int,
    frame: str,
    identity: str,
    old: Mapping[str, Any] | None,
    new: Mapping[str, Any] | None,
) -> str:
    """Why a stored edit of a box is none of what was shown; empty if it is."""
    entries = [entry for entry in entries if not entry["before"]["help"]]  # under the help nothing is shown
    if op == "box.add":
        makers = [e for e in entries if e["before"]["frame"] == frame and e["code"] in ("KeyV", "KeyD", "KeyC", "")]
        return "" if makers or any(entry["keep"] for entry in entries) else "nothing was made there"
    there = [entry for entry in entries if entry["before"]["frame"] == frame and entry["before"]["box"] == identity]
    if op == "box.delete":
        deleted = any(entry["code"] == "Delete" for entry in there)
        return "" if deleted or any(entry["keep"] for entry in entries) else "was not shown when Delete was pressed"
    assert new is not None
    if any(entry["keep"] for entry in entries) or any(entry["tile"] == index for entry in entries):
        return ""
    wall = [entry for entry in entries if entry["code"] == "Enter" and str(index) in entry["before"]["wall"]]
    if wall and old is not None and new["box"] == old["box"]:
        return ""
    if any(entry["code"] == "KeyX" for entry in there):  # it is fitted: its numbers come later
        return ""
    return _not_shown(there, identity, new)


def _not_shown(there: Sequence[Mapping[str, Any]], identity: str, new: Mapping[str, Any]) -> str:
    """Why a stored value is none that was shown; empty if it is."""
    if not there:
        return "no gesture had it before it on the screen"
    best = math.inf
    for entry in there:
        after = shown_box(entry.get("after") or {"box": None, "fields": {}})
        before = shown_box(entry["before"])
        if after is not None and entry["after"]["box"] == identity:
            best = min(best, apart(after, new["box"]))
        if before is not None:
            expected = told(entry, before)
            best = min(best, apart(before, new["box"]))
            for box in _sized(entry, before) if expected is None else [expected]:
                best = min(best, apart(box, new["box"]) / 2)
    return "" if best <= 1.01 else f"was never shown so: the nearest differs by {best:.1f} of what is rounded away"


def own_fault(text: str) -> bool:
    """Whether an error of the page is one: what a link loses, and a frame that cannot be read, are none."""
    return not any(word in text for word in ("Failed to load resource", "WebSocket", "net::"))


def compare(boxes: Sequence[Mapping[str, Any]], state: Mapping[str, Any]) -> list[str]:
    """What differs between the boxes that a window shows and those that the server has of the same frame."""
    shown = {row["id"]: row for row in boxes}
    stored = {row["id"]: row for row in state["boxes"]}
    faults = [
        f"box {name} of frame {state['frame']['index']} is shown or stored only"
        for name in shown.keys() ^ stored.keys()
    ]
    different = [
        name
        for name in shown.keys() & stored.keys()
        if apart(shown[name]["box"], stored[name]["box"]) > 1e-6 or shown[name]["version"] != stored[name]["version"]
    ]
    return faults + [f"box {name} is shown as {shown[name]}, and stored as {stored[name]}" for name in different]


def moved_from_docs(entries: Sequence[Mapping[str, Any]]) -> tuple[int, list[str]]:
    """How many keys did to the shown numbers what the docs say, and those that did something else.

    Only what stood there at once is a key's own: a refused key (an undo is on its way) may be followed by an answer
    of the server.
    """
    right, faults, held = 0, [], False
    for entry in entries:
        held = entry["type"] == "pointerdown" or (held and entry["type"] != "pointerup")
        if held:  # what is dragged is shown, and given up by a key
            continue
        before, after = shown_box(entry["before"]), shown_box(entry.get("after") or {"box": None, "fields": {}})
        if (
            entry["type"] != "keydown"
            or not entry.get("atOnce")
            or before is None
            or after is None
            or entry["after"]["box"] != entry["before"]["box"]
        ):
            continue
        expected = told(entry, before)
        if expected is None or entry["after"]["frame"] != entry["before"]["frame"] or apart(before, after) <= 1e-9:
            continue
        if apart(expected, after) > 2.1:
            faults.append(f"{entry['code']}: {before} became {after}, not {expected}")
        right += 1
    return right, faults
