"""Structural edits of K-Radar's files: the Ouster's PCD with nine fields, sparse points in npy, MATLAB's arrays."""

import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from _structures import Case, Family, Oracle, Reading, apart
from _structures_pcd import pcd_bytes
from _structures_sets import Rows, case, far_place, infinite_place, made, nan_returns, no_returns, points_of

from farfield.datasets.kradar.products import read_lidar, read_radar

OUSTER = {"x": (1, 90), "y": (-40, 40), "z": (-2, 3), "intensity": (0, 900), "t#": (0, 99_000_000)}
OUSTER |= {"reflectivity#": (0, 200), "ring#": (0, 64), "ambient#": (0, 900), "range#": (500, 90_000)}
OUSTER_TYPES = dict(
    zip((name.rstrip("#") for name in OUSTER), ("f4", "f4", "f4", "f4", "u4", "u2", "u1", "u2", "u4"), strict=True)
)


def kradar_lidar(random: np.random.Generator, folder: Path) -> Case:
    """K-Radar's os2-64."""
    columns, valid = made(random, OUSTER)
    columns["t"] = np.sort(columns["t"])
    columns["t"][[0, -1]] = 0, 98_000_000
    rows = Rows(columns, valid, _kradar_lidar)
    edits = (no_returns, nan_returns, bad_signal, infinite_place, far_place)
    if random.random() < 0.7:
        edits[random.integers(len(edits))](random, rows)
    types = dict(OUSTER_TYPES)
    how = str(
        random.choice(
            ["", "", "reordered", "dropped", "range as f4", "t as f8 in seconds", "places as f8", "ring as u2"]
        )
    )
    if how == "dropped":
        del rows.columns[[*rows.columns][random.integers(9)]]
    if how == "reordered":
        rows.columns = {name: rows.columns[name] for name in reversed([*rows.columns])}
    types |= {
        "range as f4": {"range": "f4"},
        "ring as u2": {"ring": "u2"},
        "places as f8": dict.fromkeys("xyz", "f8"),
    }.get(how, {})
    written = {name: values.astype(types[name]) for name, values in rows.columns.items()}
    if how == "t as f8 in seconds":
        written["t"] = rows.columns["t"] * 1e-9
    if how:
        rows.edit(how, "refused" if how == "dropped" else "same")
    encoding = str(random.choice(["ascii", "binary", "binary_compressed"]))
    (folder / "os2-64_00001.pcd").write_bytes(pcd_bytes(written, encoding))
    return case(rows, partial(read_lidar, folder / "os2-64_00001.pcd", "os2-64"))


def bad_signal(random: np.random.Generator, rows: Rows) -> None:
    """A number of photons that is none."""
    value = float(random.choice([np.nan, np.inf, -3.0]))
    rows.columns["intensity"][int(random.choice(np.flatnonzero(rows.valid)))] = value
    rows.edit(f"intensity {value}", "refused")


def _kradar_lidar(rows: Rows) -> Mapping[str, np.ndarray]:
    columns = rows.columns
    names = {"signal": "intensity", "time_ns": "t", "reflectivity": "reflectivity", "ring": "ring", "range_mm": "range"}
    strength = np.clip(columns["intensity"] / 1024, 0, 1)
    return {
        "points": points_of(rows, "xyz"),
        "intensity": strength,
        **{our: columns[name] for our, name in names.items()},
    }


SPARSE = {"x": (1, 100), "y": (-40, 40), "z": (-2, 6), "power": (0.001, 5), "doppler": (-2, 2)}


def kradar_sparse(random: np.random.Generator, folder: Path) -> Case:
    """K-Radar's sparse points: x, y, z, power over 1e13, perhaps Doppler; float64 rows."""
    columns, _ = made(random, SPARSE)
    table = np.column_stack([*columns.values()])[:, : int(random.choice([4, 5]))]
    edits: tuple[tuple[str, Callable[[], np.ndarray], Oracle], ...] = (
        ("as it is", lambda: table, "same"),
        ("f4", lambda: table.astype("f4"), "same"),
        ("big-endian", lambda: table.astype(">f8"), "same"),
        ("Fortran's order", lambda: np.asfortranarray(table), "same"),
        ("a power of NaN", lambda: _with(random, table, 3, np.nan), "refused"),
        ("a power of inf", lambda: _with(random, table, 3, np.inf), "refused"),
        ("a negative power", lambda: _with(random, table, 3, -0.5), "refused"),
        ("a place of NaN", lambda: _with(random, table, 1, np.nan), "refused"),
        ("a place of inf", lambda: _with(random, table, 0, np.inf), "refused"),
        ("whole numbers", lambda: table.astype("i8"), "refused"),
        ("three columns", lambda: table[:, :3], "refused"),
        ("six columns", lambda: np.column_stack([table, table])[:, :6], "refused"),
        ("a row a quantity", lambda: table.T, "refused"),
        ("one axis", lambda: table.reshape(-1), "refused"),
        ("three axes", lambda: table[None], "refused"),
        ("no rows", lambda: table[:0], "either"),
        ("complex", lambda: table.astype("c16"), "refused"),
        ("text", lambda: table.astype("U8"), "refused"),
        ("structured", lambda: table.astype("f8").view([(f"c{n}", "f8") for n in range(table.shape[1])]), "refused"),
    )
    words, change, oracle = edits[random.integers(len(edits))]
    array = change()
    np.save(folder / "a.npy", array)
    data = (folder / "a.npy").read_bytes()
    how = str(random.choice(["", "", "", "cut", "longer"]))
    if how:
        (folder / "a.npy").write_bytes(data[:-3] if how == "cut" else data + data[-40:])
        oracle = "refused"
    difference = partial(_table_differs, np.asarray(array) if oracle == "same" else array)
    return Case((words, how), oracle, lambda: Reading(read_radar(folder / "a.npy", "sparse")), difference)


def _with(random: np.random.Generator, table: np.ndarray, column: int, value: float) -> np.ndarray:
    changed = table.copy()
    changed[int(random.integers(len(table))), column] = value
    return changed


def _table_differs(expected: np.ndarray, actual: Any) -> str:
    return apart("array", actual, expected)


# MATLAB's level 5 ("MAT-File Format"), written here.

CLASSES = {"f8": (6, 9), "f4": (7, 7), "i4": (12, 5), "u2": (11, 4), "i2": (10, 3), "u1": (9, 2)}
"""Class of the array and type of its data by number type."""


def _element(kind: int, data: bytes) -> bytes:
    return struct.pack("<II", kind, len(data)) + data + b"\0" * (-len(data) % 8)


def mat_bytes(
    name: str,
    array: np.ndarray,
    *,
    stored: str = "",
    packed: bool = False,
    sides: Sequence[int] | None = None,
    flags: int = 0,
    short_name: bool = False,
) -> bytes:
    """A file of one array; ``stored`` is the type that MATLAB shrinks whole numbers to."""
    kind, own = CLASSES[array.dtype.str[1:]]
    body = _element(6, struct.pack("<II", kind | flags, 0))
    body += _element(5, struct.pack(f"<{array.ndim}i", *(sides or array.shape)))
    small = struct.pack("<HH", 1, len(name)) + name.encode().ljust(4, b"\0")
    body += small if short_name and len(name) <= 4 else _element(1, name.encode())
    data_kind = CLASSES[stored][1] if stored else own
    body += _element(data_kind, array.astype(f"<{stored}" if stored else array.dtype).tobytes(order="F"))
    matrix = struct.pack("<II", 14, len(body)) + body
    if packed:
        compressed = zlib.compress(matrix)
        matrix = struct.pack("<II", 15, len(compressed)) + compressed
    return b"MATLAB 5.0 MAT-file, made here".ljust(124) + struct.pack("<HH", 0x0100, 0x4D49) + matrix


def mat(random: np.random.Generator, folder: Path) -> Case:
    """An array in a MATLAB file, which K-Radar's cubes and tensors are."""
    from farfield.files.mat import read_mat

    kind = str(random.choice([*CLASSES]))
    shape = tuple(int(side) for side in random.integers(1, 7, int(random.integers(2, 5))))
    array = random.integers(0, 100, shape).astype(kind)
    data = mat_bytes("arr_zyx", array)
    edits: tuple[tuple[str, Callable[[], bytes], Oracle], ...] = (
        ("as it is", lambda: data, "same"),
        ("packed", lambda: mat_bytes("arr_zyx", array, packed=True), "same"),
        ("stored as bytes", lambda: mat_bytes("arr_zyx", array, stored="u1"), "same"),
        ("after another array", lambda: mat_bytes("n", array * 0) + data[128:], "same"),
        ("another name", lambda: mat_bytes("arr_zyy", array), "refused"),
        ("a dimension too large", lambda: mat_bytes("arr_zyx", array, sides=(shape[0] + 1, *shape[1:])), "refused"),
        ("a negative dimension", lambda: mat_bytes("arr_zyx", array, sides=(-shape[0], *shape[1:])), "refused"),
        ("complex", lambda: mat_bytes("arr_zyx", array, flags=0x0800), "refused"),
        ("cut", lambda: data[:-9], "refused"),
        ("big-endian", lambda: data[:124] + b"\x01\x00MI" + data[128:], "refused"),
        (
            "level 7.3",
            lambda: b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + b"\x89HDF\r\n\x1a\n" + data,
            "refused",
        ),
        ("header alone", lambda: data[:128], "refused"),
    )
    words, change, oracle = edits[random.integers(len(edits))]
    (folder / "a.mat").write_bytes(change())
    difference = partial(_table_differs, array)
    return Case(
        (f"{kind} of {len(shape)} axes", words),
        oracle,
        lambda: Reading(read_mat(folder / "a.mat", "arr_zyx")),
        difference,
    )


FAMILIES = (
    Family("kradar lidar", kradar_lidar, 4),
    Family("kradar sparse", kradar_sparse, 3),
    Family("mat", mat, 3),
)
