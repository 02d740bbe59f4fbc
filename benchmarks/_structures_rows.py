"""Structural edits of clouds without names of columns: KITTI's ``.bin``, rows in ``.npy``, text in ``.xyz``."""

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from _structures import Case, Family, Oracle
from _structures_clouds import (
    Edit,
    Sweeps,
    bad_strength,
    bright_strength,
    bright_strength_overruled,
    case_of,
    infinite_place,
    make_sweeps,
    missing_returns,
    no_strength,
    nothing_returned,
    numbered,
    on_a_map,
    own_scale,
    scaled_strength,
    stems,
)

EDITS: tuple[Edit, ...] = (
    *(missing_returns, missing_returns, missing_returns, nothing_returned, infinite_place, on_a_map),
    *(scaled_strength, scaled_strength, own_scale, bad_strength, bright_strength, bright_strength_overruled),
    *(no_strength, numbered),
)


def more_columns(random: np.random.Generator, sweeps: Sweeps, most: int) -> None:
    """Columns behind the intensity: rings and distances have names, others are extra0 and so on."""
    number = int(random.integers(0, most))
    kinds = [str(kind) for kind in random.choice(["ring", "range_m", "extra", "extra"], number)]
    kinds = [kind if kind == "extra" or kinds.index(kind) == row else "extra" for row, kind in enumerate(kinds)]
    for row, columns in enumerate(sweeps.columns):
        count = len(sweeps.points[row])
        for place, kind in enumerate(kinds):
            values = {
                "ring": np.arange(count) % 32,
                "range_m": np.linalg.norm(sweeps.points[row].astype(np.float64), axis=1),
                "extra": random.uniform(-7, 7, count) + 11 * place,
            }[kind]
            name = kind if kind != "extra" else f"extra{place}"
            columns[name] = values.astype(np.float32)
            sweeps.extra[row][name] = columns[name]
    if number:
        sweeps.edit(f"{number + 4} columns")


def table(columns: dict[str, np.ndarray], kind: str = "f4") -> np.ndarray:
    """Columns side by side."""
    return np.column_stack([values.astype(kind) for values in columns.values()])


# ``.bin``: float32, little-endian, without a header (KITTI's readme).


def velodyne(random: np.random.Generator, folder: Path) -> Case:
    """Sweeps as KITTI's velodyne files."""
    sweeps = make_sweeps(random, points=int(random.integers(300, 500)))
    if random.random() < 0.4:
        more_columns(random, sweeps, 6)
    if random.random() < 0.8:
        _edit(random, sweeps)
    count = len(sweeps.columns[0])
    if random.random() < 0.5:
        sweeps.options["bin_columns"] = count
        sweeps.edit(f"--columns {count}")
    elif count != 4 or sweeps.edits:
        sweeps.edit("columns not said", "either")
    how = str(
        random.choice(["", "", "", ".BIN", "cut", "big-endian", "float64", "a count before", "npy", "pcd", "empty"])
    )
    refused: dict[str, Oracle] = dict.fromkeys(["cut", "big-endian", "float64", "npy", "pcd", "empty"], "refused")
    if how:
        own: Oracle = "same" if how == ".BIN" else "refused" if count > 3 else "either"
        sweeps.edit(how, refused.get(how, own))
    for stem, columns in zip(stems(sweeps), sweeps.columns, strict=True):
        data = _changed(random, table(columns), how)
        (folder / f"{stem}{'.BIN' if how == '.BIN' else '.bin'}").write_bytes(data)
    sweeps.words = "" if "UTM coordinates" in sweeps.edits or len(sweeps.edits) > 1 else sweeps.words
    return case_of(sweeps, folder)


def _edit(random: np.random.Generator, sweeps: Sweeps) -> None:
    EDITS[random.integers(len(EDITS))](random, sweeps)
    if sweeps.strength is None and any(sweeps.extra):  # without the fourth column the fifth would be it
        sweeps.extra = [{} for _ in sweeps.extra]
        sweeps.columns = [{axis: columns[axis] for axis in "xyz"} for columns in sweeps.columns]


def _changed(random: np.random.Generator, rows: np.ndarray, how: str) -> bytes:
    """The bytes of a ``.bin``, or what stands in its place."""
    data = rows.astype("<f4").tobytes()
    if how == "cut":
        return data[: -int(random.integers(1, 4))]
    if how == "big-endian":
        return rows.astype(">f4").tobytes()
    if how == "float64":
        return rows.astype("<f8").tobytes()
    if how == "a count before":
        return len(rows).to_bytes(4, "little") + data
    if how == "empty":
        return b""
    if how == "npy":
        handle = io.BytesIO()
        np.save(handle, rows)
        return handle.getvalue()
    return b"# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n" + data if how == "pcd" else data


# Rows in ``.npy``.

NPY_EDITS: tuple[tuple[str, Oracle], ...] = (
    *(("f8", "same"), ("f2", "same"), ("big-endian", "same"), ("Fortran's order", "same"), ("version 2", "same")),
    *((".NPY", "same"), ("a row a quantity", "either"), ("longer", "refused"), ("cut", "refused")),
    *(("three axes", "refused"), ("one axis", "refused"), ("complex", "refused"), ("text", "refused")),
    *(("booleans", "refused"), ("objects", "refused"), ("two columns", "refused"), ("no rows", "either")),
    *(("npz", "refused"), ("whole numbers", "same")),
)


def npy_rows(random: np.random.Generator, folder: Path) -> Case:
    """Sweeps as rows in npy files."""
    sweeps = make_sweeps(random)
    if random.random() < 0.4:
        more_columns(random, sweeps, 4)
    how, oracle = NPY_EDITS[random.integers(len(NPY_EDITS))] if random.random() < 0.6 else ("", "same")
    if random.random() < 0.7 and how not in ("f2", "whole numbers", "no rows"):
        _edit(random, sweeps)
    if how == "whole numbers":
        _whole(random, sweeps)
    if how == "f2":
        _half(sweeps)
    if how:
        sweeps.edit(how, oracle)
    for stem, columns in zip(stems(sweeps), sweeps.columns, strict=True):
        wide = any(values.dtype.itemsize == 8 for values in columns.values())
        data = _array_bytes(table(columns, "f8" if wide or how == "f8" else "f4"), how)
        (folder / f"{stem}{'.NPY' if how == '.NPY' else '.npy'}").write_bytes(data)
    if how == "no rows":
        for row, points in enumerate(sweeps.points):
            sweeps.points[row], sweeps.valid[row] = points[:0], sweeps.valid[row][:0]
            sweeps.extra[row] = {}
        sweeps.strength = [np.zeros(0)] * 3
    return case_of(sweeps, folder)


def _whole(random: np.random.Generator, sweeps: Sweeps) -> None:
    """Places in whole metres and intensities to 255, in an array of integers."""
    for row, columns in enumerate(sweeps.columns):
        sweeps.points[row] = np.rint(sweeps.points[row])
        columns |= {axis: sweeps.points[row][:, place] for place, axis in enumerate("xyz")}
        columns["intensity"] = np.rint(columns["intensity"] * 255)
        sweeps.strength[row] = columns["intensity"] / 255  # type: ignore[index]
        for name in sweeps.extra[row]:
            columns[name] = sweeps.extra[row][name] = random.integers(-9000, 9000, len(sweeps.points[row]))
    sweeps.extra = [{f"extra{place}": values for place, values in enumerate(extra.values())} for extra in sweeps.extra]


def _half(sweeps: Sweeps) -> None:
    """Numbers that float16 holds."""
    for row, columns in enumerate(sweeps.columns):
        for name, values in columns.items():
            columns[name] = values.astype("f2").astype("f4")
        sweeps.points[row] = np.column_stack([columns[axis] for axis in "xyz"])
        sweeps.strength[row] = columns["intensity"]  # type: ignore[index]
        sweeps.extra[row] = {name: columns[name] for name in sweeps.extra[row]}


def _array_bytes(rows: np.ndarray, how: str) -> bytes:
    array: np.ndarray = {
        "f2": rows.astype("f2") if how == "f2" else rows,
        "big-endian": rows.astype(rows.dtype.newbyteorder(">")),
        "Fortran's order": np.asfortranarray(rows),
        "a row a quantity": np.ascontiguousarray(rows.T),
        "three axes": rows[None],
        "one axis": rows.reshape(-1),
        "complex": rows.astype("c8"),
        "text": rows[:, :4].astype("U9"),
        "booleans": rows > 0,
        "objects": rows.astype(object) if how == "objects" else rows,
        "two columns": rows[:, :2],
        "no rows": rows[:0],
        "whole numbers": rows.astype("i4") if how == "whole numbers" else rows,
    }.get(how, rows)
    handle = io.BytesIO()
    if how == "npz":
        np.savez(handle, rows=rows)
    else:
        version = (2, 0) if how == "version 2" else (1, 0)
        np.lib.format.write_array(handle, array, version=version, allow_pickle=how == "objects")
    data = handle.getvalue()
    return data[:-2] if how == "cut" else data + data[-16:] if how == "longer" else data


# Text.

XYZ_EDITS: tuple[tuple[str, Oracle], ...] = (
    *((",", "same"), (";", "same"), ("\t", "same"), ("  ", "same"), (", ", "same"), ("CR LF", "same")),
    *(("no end of the last line", "same"), ("blanks at the ends", "same"), ("blanks before", "same")),
    *(("scientific", "same"), ("+ signs", "same"), ("more digits", "same"), (".XYZ", "same"), ("CR", "either")),
    *(("a header", "refused"), ("a comment", "refused"), ("a blank line", "refused"), ("a short line", "refused")),
    *(("a long line", "refused"), ("decimal commas", "refused"), ("byte order mark", "either"), ("UTF-16", "refused")),
    *(("1_0", "refused"), ("0x1", "refused"), ("a long minus", "refused"), ("1d3", "refused"), ("empty", "refused")),
    *(("a separator behind", "either"), ("a word", "refused"), ("six: colours", "same"), ("six: normals", "same")),
)


def xyz(random: np.random.Generator, folder: Path) -> Case:
    """Sweeps as text."""
    sweeps = make_sweeps(random)
    how, oracle = XYZ_EDITS[random.integers(len(XYZ_EDITS))] if random.random() < 0.8 else ("", "same")
    if how.startswith("six"):
        _six(random, sweeps, how)
    else:
        if random.random() < 0.4:
            more_columns(random, sweeps, 4)
        if random.random() < 0.6 and how != "more digits":
            _edit(random, sweeps)
    if how:
        sweeps.edit(repr(how), oracle)
    for stem, columns in zip(stems(sweeps), sweeps.columns, strict=True):
        data = _text_bytes(random, table(columns, "f8"), how)
        (folder / f"{stem}{'.XYZ' if how == '.XYZ' else '.xyz'}").write_bytes(data)
    return case_of(sweeps, folder)


def _six(random: np.random.Generator, sweeps: Sweeps, how: str) -> None:
    """Three colours, or a normal, in the place of the intensity."""
    for row, columns in enumerate(sweeps.columns):
        del columns["intensity"]
        count = len(sweeps.points[row])
        values = random.integers(0, 256, (count, 3)).astype("f8")
        values[0] = 255
        if how == "six: normals":
            values = random.normal(size=(count, 3))
            values = np.round(values / np.linalg.norm(values, axis=1, keepdims=True), 5)
        names = ("r", "g", "b") if how == "six: colours" else ("nx", "ny", "nz")
        columns |= dict(zip(names, values.T, strict=True))
        sweeps.extra[row] = dict(zip(names, values.T, strict=True))
    sweeps.strength = None


def _text_bytes(random: np.random.Generator, rows: np.ndarray, how: str) -> bytes:
    separator = how if how in (",", ";", "\t", "  ", ", ") else str(random.choice([",", " "]))
    if how == "decimal commas":
        separator = str(random.choice([";", " ", "\t"]))
    style = {"scientific": "{:.9e}", "+ signs": "{:+.9g}", "more digits": "{:.17g}"}.get(how, "{:.9g}")
    lines = [separator.join(style.format(value) for value in row) for row in rows.tolist()]
    if how == "decimal commas":
        lines = [line.replace(".", ",") for line in lines]
    at = int(random.integers(1, len(lines)))
    changes: dict[str, Sequence[str]] = {
        "a header": [separator.join("xyzi"), *lines],
        "a comment": ["# x y z i", *lines],
        "a blank line": [*lines[:at], "", *lines[at:]],
        "a short line": [*lines[:at], lines[at].rsplit(separator, 1)[0], *lines[at + 1 :]],
        "a long line": [*lines[:at], lines[at] + separator + "1", *lines[at + 1 :]],
        "blanks at the ends": [line + " " for line in lines],
        "blanks before": [" " + line for line in lines],
        "a separator behind": [line + separator for line in lines],
        "1_0": [*lines[:at], lines[at] + separator + "1", *lines[at + 1 :]],
    }
    for word, cell in (
        ("1_0", "1_0"),
        ("0x1", "0x1F"),
        ("a long minus", "\u22121.5"),
        ("1d3", "1d3"),
        ("a word", "none"),
    ):
        changes[word] = [*lines[:at], separator.join([cell, *lines[at].split(separator)[1:]]), *lines[at + 1 :]]
    end = {"CR LF": "\r\n", "CR": "\r"}.get(how, "\n")
    text = end.join(changes.get(how, lines)) + ("" if how == "no end of the last line" else end)
    if how == "UTF-16":
        return text.encode("utf-16")
    return b"" if how == "empty" else (b"\xef\xbb\xbf" if how == "byte order mark" else b"") + text.encode()


FAMILIES = (Family("bin", velodyne, 8), Family("npy rows", npy_rows, 7), Family("xyz", xyz, 8))
