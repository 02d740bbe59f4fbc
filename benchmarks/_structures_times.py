"""Structural edits of lists of stamps and of tables of poses: units, forms, zones, lines that are none."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from _structures import Case, Family, Oracle, Reading, apart

from farfield.errors import FileFormatError
from farfield.files import poses_csv, stamps

UNITS = {"s": 9, "ms": 6, "us": 3, "ns": 0}
"""Decimal places from a unit to nanoseconds."""


def stamp_list(random: np.random.Generator, folder: Path) -> Case:
    """Times to the nanosecond in one of the forms of docs/timing.md, the lists changed in one way."""
    count = int(random.integers(3, 60))
    start_ns = int(random.integers(400_000_000, 4_000_000_000)) * 10**9 + int(random.integers(0, 10**9))
    times_ns = [start_ns + int(step) for step in np.cumsum(random.integers(0, 2 * 10**8, count))]
    form = str(random.choice(["whole", "point", "header", "csv", "date", "date with zone", "radiate"]))
    unit, header = "s", ""
    if form in ("whole", "header", "csv"):
        unit = str(random.choice([*UNITS]))
    if form == "whole":  # a number of so many digits shows its unit from 2001 on
        times_ns = [time + 10**18 for time in times_ns] if start_ns < 10**18 else times_ns
    texts = [_number(time, unit, point=form in ("point", "csv")) for time in times_ns]
    if form in ("whole", "header"):
        scale = 10 ** UNITS[unit]
        times_ns = [time // scale * scale for time in times_ns]
    zone_minutes = 0
    if form.startswith("date"):
        zone_minutes = int(random.choice([0, 120, -330])) if form == "date with zone" else 0
        zone = f"{'-' if zone_minutes < 0 else '+'}{abs(zone_minutes) // 60:02d}:{abs(zone_minutes) % 60:02d}"
        texts = [
            _date(time + zone_minutes * 60 * 10**9) + (zone if form == "date with zone" else "") for time in times_ns
        ]
    if form == "radiate":
        texts = [f"Frame: {row + 1:06d} Time: {_number(time, 's', point=True)}" for row, time in enumerate(times_ns)]
    if form == "header":
        header = str(random.choice([f"time_{unit}", f"stamp_{unit}" if unit == "ns" else f"time_{unit}"]))
    if form == "csv":
        header = f"frame,time_{unit},x"
        texts = [f"{row},{text},1.5" for row, text in enumerate(texts)]
    words, oracle, lines = _edited(random, texts, form)
    text = ("\r\n" if words == "CR LF" else "\n").join([*([header] if header else []), *lines])
    (folder / "times.txt").write_text(text + ("" if words == "no end of the last line" else "\n"), newline="")
    difference = partial(_times_differ, times_ns)
    return Case((f"{form} in {unit}", words), oracle, partial(_read_stamps, folder / "times.txt"), difference)


def _number(time_ns: int, unit: str, *, point: bool) -> str:
    scale = 10 ** UNITS[unit]
    whole, rest = divmod(time_ns, scale)
    return f"{whole}.{rest:0{UNITS[unit]}d}" if point and UNITS[unit] else str(whole)


def _date(time_ns: int) -> str:
    return str(np.datetime64(time_ns, "ns")).replace("T", " ")


def _edited(random: np.random.Generator, texts: Sequence[str], form: str) -> tuple[str, Oracle, list[str]]:
    """One edit of the lines."""
    at, lines = int(random.integers(1, len(texts))), [*texts]
    before, line, behind = lines[:at], lines[at], lines[at + 1 :]
    digits = line.split(",")[1] if form == "csv" else line
    options: list[tuple[str, Oracle, list[str]]] = [
        *(("as it is", "same", lines),) * 4,
        ("CR LF", "same", lines),
        ("no end of the last line", "same", lines),
        ("a word in a line", "refused", [*before, line.replace(digits, "none"), *behind]),
        ("two points", "refused", [*before, line.replace(digits, "1.2.3"), *behind]),
        ("an underscore", "refused", [*before, line.replace(digits, digits[:2] + "_" + digits[2:]), *behind]),
        ("NaN", "refused", [*before, line.replace(digits, "nan"), *behind]),
        ("an exponent", "refused", [*before, line.replace(digits, "1.7e9"), *behind]),
    ]
    if form != "radiate":
        options.append(("an empty line", "same", [*before, "", line, *behind]))
    if form.startswith("date"):
        options += [
            ("no such day", "refused", [*before, "2023-02-30" + line[10:], *behind]),
            ("a year that is too early", "refused", [*before, "1500" + line[4:], *behind]),
            ("a year that is too late", "refused", [*before, "2300" + line[4:], *behind]),
            ("a zone in one line", "refused", [*before, line[:29] + ("" if len(line) > 29 else "+02:00"), *behind]),
        ]
    elif form != "radiate":
        options.append(("a number too large", "refused", [*before, line.replace(digits, "9" * 19), *behind]))
    return options[random.integers(len(options))]


def _read_stamps(path: Path) -> Reading:
    form = stamps.recognise_stamps(path)
    if form is None:
        raise FileFormatError(path, where="line 1", expected="stamps", got="others")  # what sync says of it
    return Reading(np.concatenate([*stamps.read_stamps(form)]))


def _times_differ(expected: Sequence[int], actual: Any) -> str:
    if len(actual) != len(expected):
        return f"{len(actual)} stamps in place of {len(expected)}"
    wrong = [row for row, time in enumerate(expected) if int(actual[row]) != time]
    return f"stamp {wrong[0]}: {int(actual[wrong[0]])} in place of {expected[wrong[0]]}" if wrong else ""


# Tables of poses: docs/odometry.md's columns.


def pose_table(random: np.random.Generator, folder: Path) -> Case:
    """A table of poses as ``farfield track`` writes it."""
    count = int(random.integers(1, 30))
    times = np.cumsum(random.integers(1, 2 * 10**8, count)) + 17 * 10**17
    places, turns = np.round(random.normal(0, 90, (count, 3)), 6), random.normal(size=(count, 4))
    turns = np.round(turns / np.linalg.norm(turns, axis=1, keepdims=True), 9)
    rows = [
        ["drive", f"{row:06d}", "lidar", str(times[row]), *map(str, places[row]), *map(str, turns[row]), "placed", ""]
        for row in range(count)
    ]
    rows[0][11] = "begins"
    names = list(poses_csv.COLUMNS)
    at = int(random.integers(count))
    kinds: dict[str, Oracle] = {
        "as it is": "same",
        "as it was": "same",
        "quaternions negated": "same",
        "CR LF": "same",
        "a column dropped": "refused",
        "columns exchanged": "refused",
        "a header with blanks": "refused",
        "a frame twice": "refused",
        "a place of NaN": "refused",
        "a quaternion of 0": "refused",
        "a quaternion of length 2": "refused",
        "a time with a point": "refused",
        "another drive": "refused",
        "another reference": "refused",
        "an unknown state": "refused",
        "a line too short": "refused",
        "no rows": "refused",
    }
    kind = str(random.choice([*kinds]))
    if kind in ("a frame twice", "another drive", "another reference") and count < 2:
        kind = "as it is"
    other = rows[(at + 1) % count]
    if kind == "quaternions negated":
        rows = [[*row[:7], *(str(-float(value)) for value in row[7:11]), *row[11:]] for row in rows]
    elif kind == "a column dropped":
        rows, names = [row[:-1] for row in rows], names[:-1]
    elif kind == "columns exchanged":
        names[4], names[5] = names[5], names[4]
    elif kind == "a header with blanks":
        names = [f" {name}" for name in names]
    elif kind == "no rows":
        rows = []
    elif kind == "a line too short":
        rows[at] = rows[at][:-2]
    elif kind == "a quaternion of 0":
        rows[at][7:11] = ["0"] * 4
    elif kind == "a quaternion of length 2":
        rows[at][7:11] = [str(2 * float(value)) for value in rows[at][7:11]]
    else:
        changes = {"a frame twice": (1, other[1]), "a place of NaN": (5, "nan"), "a time with a point": (3, "1.5")}
        changes |= {"another drive": (0, "b"), "another reference": (2, "b"), "an unknown state": (11, "flying")}
        if kind in changes:
            rows[at][changes[kind][0]] = changes[kind][1]
    text = ("\r\n" if kind == "CR LF" else "\n").join([",".join(row) for row in [names, *rows]] + [""])
    (folder / "poses.csv").write_text(text, newline="")
    expected = {"places": places, "turns": _rotations(turns), "times": times}
    return Case((kind,), kinds[kind], partial(_read_poses, folder / "poses.csv"), partial(_poses_differ, expected))


def _rotations(turns: np.ndarray) -> np.ndarray:
    """Rotation matrices of quaternions x, y, z, w."""
    x, y, z, w = (turns / np.linalg.norm(turns, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def _read_poses(path: Path) -> Reading:
    table = poses_csv.read_poses(path)
    motions = table.world_T_frame
    times = np.array(table.times_ns)
    return Reading({"places": motions[:, :3, 3], "turns": motions[:, :3, :3], "times": times})


def _poses_differ(expected: Mapping[str, np.ndarray], actual: Mapping[str, np.ndarray]) -> str:
    return next((text for name in expected if (text := apart(name, actual[name], expected[name]))), "")


FAMILIES = (Family("stamps", stamp_list, 4), Family("poses csv", pose_table, 2))
