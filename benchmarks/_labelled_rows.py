"""Models of labelled boxes for the structural cases: rows with centre, size, yaw, class, track and score.

A format writes the rows, an edit changes the rows and the files together or the files alone, and what a reader gives is
compared with the rows.
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from _structures import Case, Oracle, Reading, apart

import farfield as ff
from farfield.frame import Boxes
from farfield.inspection.doctor import examine

Row = dict[str, Any]
PLACES, SIZES = ("x", "y", "z"), ("l", "w", "h")


@dataclass
class Draft:
    """A case while it is made.

    Args:
        random: Its random numbers.
        rows: The model.
        edits: What was changed, in words.
        oracle: What has to happen.
        words: What has to be said.
    """

    random: np.random.Generator
    rows: list[Row]
    edits: list[str] = field(default_factory=list)
    oracle: Oracle = "same"
    words: str = ""

    def pick(self, choices: Sequence[Any]) -> Any:
        """One of some choices."""
        return choices[int(self.random.integers(len(choices)))]

    def note(self, edit: str, oracle: Oracle = "same", words: str = "") -> None:
        """An edit was made. What is refused stays so, whatever else is done."""
        self.edits.append(edit)
        ranks: tuple[Oracle, ...] = ("same", "said", "either", "refused")
        if ranks.index(oracle) >= ranks.index(self.oracle):
            unsure = "either" in (oracle, self.oracle)
            self.oracle, self.words = oracle, "" if unsure else words or self.words
        elif oracle == "either":
            self.words = ""


def model(
    random: np.random.Generator, frames: Sequence[str], classes: Sequence[str], *, scored: bool = False
) -> list[Row]:
    """Two to four boxes a frame ahead of the sensor, 12 m apart, each with a track of its own."""
    rows: list[Row] = []
    for frame in frames:
        for lane in range(int(random.integers(2, 5))):
            label = classes[int(random.integers(len(classes)))]
            row = {
                "frame": frame,
                "label": label,
                "x": 12.0 + 12 * len(rows) + random.uniform(-2, 2),
                "y": 7.0 * lane - 10 + random.uniform(-2, 2),
                "z": random.uniform(-1.2, -0.4),
                "l": random.uniform(3.6, 5.2),
                "w": random.uniform(1.6, 2.1),
                "h": random.uniform(1.3, 1.9),
                "yaw": random.uniform(-3, 3),
            }
            rounded = {name: round(value, 3) if isinstance(value, float) else value for name, value in row.items()}
            rows.append(rounded | {"track": len(rows) + 1, "points": int(random.integers(1, 400))})
    for row in rows if scored else []:
        row["score"] = round(random.uniform(0.05, 0.95), 3)
    return rows


def differing(frames: Mapping[str, Boxes | None], rows: Sequence[Row], *, ours: Mapping[str, str], columns: str) -> str:
    """What boxes by frame differ in from the model; empty where nothing does.

    Args:
        frames: What was read.
        rows: The model, in the order of the file.
        ours: The class of each name, as the format's page says; others keep their names.
        columns: What is compared beside place, size, yaw and class: some of ``track``, ``score``, ``points``.
    """
    names = dict.fromkeys([*frames, *(str(row["frame"]) for row in rows)])
    for name in names:
        expected = [row for row in rows if row["frame"] == name]
        boxes = frames.get(name)
        if boxes is None and not expected:
            continue
        if boxes is None:
            return f"frame {name}: nothing in place of {len(expected)} boxes"
        if len(boxes) != len(expected):
            return f"frame {name}: {len(boxes)} boxes in place of {len(expected)}"
        tables = [np.array([[row[key] for key in keys] for row in expected]) for keys in (PLACES, SIZES)]
        turns = np.array([row["yaw"] for row in expected]) - boxes.yaw_rad
        labels = np.array([ours.get(row["label"], row["label"]) for row in expected])
        parts = [
            apart(f"frame {name} label", boxes.label, labels),
            apart(f"frame {name} centre", boxes.centre_m, tables[0].reshape(-1, 3), tolerance=1e-4),
            apart(f"frame {name} size", boxes.size_m, tables[1].reshape(-1, 3), tolerance=1e-4),
            apart(f"frame {name} yaw", np.abs(np.exp(1j * turns) - 1), np.zeros(len(expected)), tolerance=1e-4),
        ]
        pairs = (("track", boxes.track_id), ("score", boxes.score), ("points", boxes.point_count))
        for key, values in pairs:
            wanted = [row.get(key) for row in expected]
            if key not in columns or (values is None and all(value is None for value in wanted)):
                continue
            if values is None:
                return f"frame {name}: no {key}"
            parts.append(
                apart(f"frame {name} {key}", values, np.array([-1 if value is None else value for value in wanted]))
            )
        fault = next(filter(None, parts), "")
        if fault:
            return fault
    return ""


def annotations(root: Path, **options: Any) -> dict[str, Boxes | None]:
    """The boxes of a data set by frame, None where a frame has no annotation."""
    data = ff.open_dataset(root, **options)
    return {
        frame: None if (annotation := data.annotation(index)) is None else annotation.boxes
        for index, (_, frame) in enumerate(data.keys)
    }


def doctor_words(root: Path, **options: Any) -> str:
    """What the doctor says of a data set."""
    report = examine(ff.open_dataset(root, **options))
    rows = (f"{row.severity} {row.topic}: {row.what} {row.fix}" for row in report.findings if row.severity != "ok")
    return "\n".join(rows)


def dataset_case(
    draft: Draft, root: Path, *, ours: Mapping[str, str], columns: str = "track", options: Mapping[str, Any] = {}
) -> Case:
    """The case of a data set's annotations; the doctor is asked where something has to be said."""
    said, rows = draft.oracle == "said", draft.rows
    return Case(
        tuple(draft.edits or ["none"]),
        draft.oracle,
        lambda: Reading(annotations(root, **options), doctor_words(root, **options) if said else ""),
        lambda frames: differing(frames, rows, ours=ours, columns=columns),
        draft.words,
    )


# Edits of the model itself, which files of every format have to bear.


def other_case(draft: Draft) -> None:
    """A class in capitals or small letters, which a reader takes for the same."""
    row = draft.pick(draft.rows)
    row["written"] = draft.pick([str.upper, str.lower])(row["label"])
    draft.note("class in other letters")


def own_class(draft: Draft) -> None:
    """A class that no data set has keeps its name."""
    draft.pick(draft.rows)["label"] = draft.pick(["Cone", "Forklift", "E-Scooter", "Sheep2"])
    draft.note("own class")


def without_boxes(draft: Draft) -> None:
    """A frame loses its boxes."""
    frame = draft.pick(sorted({row["frame"] for row in draft.rows}))
    draft.rows[:] = [row for row in draft.rows if row["frame"] != frame]
    draft.note("an empty frame")


def other_order(draft: Draft) -> None:
    """The boxes stand in another order, frames mixed."""
    draft.rows[:] = [draft.rows[index] for index in draft.random.permutation(len(draft.rows))]
    draft.note("boxes in another order")


def large_track(draft: Draft) -> None:
    """A track of many digits that all numbers hold exactly."""
    draft.pick(draft.rows)["track"] = draft.pick([2**31 - 1, 123456789, 0])
    draft.note("large or zero track")


def turned_on(draft: Draft) -> None:
    """A yaw a turn further on."""
    row = draft.pick(draft.rows)
    row["yaw"] = round(row["yaw"] + math.tau * draft.pick([-1, 1]), 6)
    draft.note("yaw a turn further")


def tiny_or_large(draft: Draft) -> None:
    """A box as long as a train, or as small as a hand, far away."""
    row = draft.pick(draft.rows)
    row |= {"l": draft.pick([0.05, 24.5]), "x": draft.pick([249.5, 0.125])}
    draft.note("unusual size and range")


MODEL_EDITS: tuple[Callable[[Draft], None], ...] = (
    *(other_case, own_class, without_boxes, other_order, large_track),
    *(turned_on, tiny_or_large),
)


# Edits of a text as a whole.


def encoded(draft: Draft, text: str, kinds: Sequence[str]) -> bytes:
    """A text in bytes, stored in another way that its format allows, or does not."""
    kind = draft.pick(kinds)
    if kind == "carriage returns":
        draft.note(kind)
        return text.replace("\n", "\r\n").encode()
    if kind == "byte order mark":
        draft.note(kind, "either")
        return b"\xef\xbb\xbf" + text.encode()
    if kind == "UTF-16":
        draft.note(kind, "refused")
        return text.encode(draft.pick(["utf-16", "utf-16-be"]))
    if kind == "blank lines":
        draft.note(kind)
        return (text.replace("\n", "\n\n", 1) + "\n").encode()
    if kind == "no last line end":
        draft.note(kind)
        return text.rstrip("\n").encode()
    if kind == "zero bytes":
        draft.note(kind, "refused")
        data, place = text.encode(), int(draft.random.integers(len(text)))
        return data[:place] + b"\0" * 40 + data[place:]
    if kind == "pointer of Git LFS":
        draft.note(kind, "refused", "git lfs pull")
        return b"version https://git-lfs.github.com/spec/v1\noid sha256:" + b"0" * 64 + b"\nsize 12345\n"
    if kind == "a page in HTML":
        draft.note(kind, "refused")
        return b"<!DOCTYPE html>\n<html><body>Not found</body></html>\n"
    if kind == "packed":
        draft.note(kind, "refused")
        return b"\x1f\x8b\x08\x00" + text.encode()
    return text.encode()


LAYOUTS = ("", "", "", "", "carriage returns", "byte order mark", "no last line end")
STRANGE = ("UTF-16", "zero bytes", "pointer of Git LFS", "a page in HTML", "packed")


def exponents(text: str) -> str:
    """The same numbers with exponents."""
    return re.sub(r"(?<![\w.\"])-?\d+\.\d+(?![\w.\"])", _exponent, text)


def _exponent(match: "re.Match[str]") -> str:
    return f"{float(match[0]):.15e}"
