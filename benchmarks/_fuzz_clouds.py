"""Clouds as drivers and tools write them, odd but good and wrong, for fuzz_readers.py: from the file to the Cloud."""

import io
import struct
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from farfield.datasets.kradar.products import read_lidar, read_radar
from farfield.datasets.memory import CloudFiles
from farfield.files import clouds, pcd
from farfield.frame import Cloud

Recipe = tuple[str, Callable[[Path], Any], tuple[bytes, ...], Callable[[Any], bool], tuple[bytes, ...]]
_POINTS, _NOW_NS = 300, 1_700_000_000_123_456_000
_MOST_OFFSET_NS = 2_000_000_000


def cloud_targets(folder: Path) -> Mapping[str, Recipe]:
    """Suffix, reader, good files, what a valid result is, and files that must be refused, by the reader's name."""
    rng = np.random.default_rng(11)
    places = dict(zip("xyz", rng.uniform(1, 60, (3, _POINTS)).astype(np.float32), strict=True))
    good = [places | columns for columns in _good(rng)]
    wrong = [places | columns for columns in _wrong(rng)]
    rows = [np.column_stack(list(columns.values())).astype(np.float32) for columns in (good[0], good[5])]
    power = np.column_stack([rng.normal(0, 30, (20, 3)), rng.exponential(1, 20)])
    ouster = places | {"intensity": rng.integers(0, 900, _POINTS).astype(np.float32)}
    ouster |= {name: rng.integers(0, 60, _POINTS).astype(kind) for name, kind in _OUSTER.items()}
    ouster["t"] = np.linspace(0, 99_000_000, _POINTS).astype(np.uint32)
    rubbish = [ouster | {"intensity": _with(ouster["intensity"], value)} for value in (np.nan, -5)]
    return {
        "cloud pcd": (".pcd", read_one, _files(folder, good, _pcd), is_sound, _files(folder, wrong, _pcd)),
        "cloud ffcloud": (".ffcloud", read_one, _files(folder, good, _cache), is_sound, _files(folder, wrong, _cache)),
        "cloud npy": (".npy", read_one, _files(folder, good, _table), is_sound, _files(folder, wrong, _table)),
        "cloud rows npy": (".npy", read_one, _files(folder, rows, _npy), is_sound, ()),
        "kradar lidar pcd": (
            ".pcd",
            lambda path: read_lidar(path, "os2-64"),
            _files(folder, [ouster], _pcd),
            is_sound,
            _files(folder, rubbish, _pcd),
        ),
        "kradar sparse npy": (
            ".npy",
            lambda path: read_radar(path, "sparse"),
            _files(folder, [power], _npy),
            is_power,
            _files(folder, [_with(power, value) for value in (np.nan, np.inf, -1.0)], _npy),
        ),
        "cloud npz": (".npz", read_one, _npz(good[0]), is_sound, ()),
        "cloud ply": (".ply", read_one, (_ply(rows[0], "<"), _ply(rows[0], ">"), _ply(rows[0], "")), is_sound, ()),
        "cloud las": (".las", read_one, (_las(rows[0]),), is_sound, ()),
    }


def _npz(columns: dict[str, np.ndarray]) -> tuple[bytes, ...]:
    made = []
    for save in (np.savez, np.savez_compressed):
        file = io.BytesIO()
        save(file, **columns)
        made.append(file.getvalue())
    return tuple(made)


def _ply(rows: np.ndarray, order: str) -> bytes:
    """Rows of x, y, z, intensity, with faces of three and four corners behind them."""
    encoding = {"<": "binary_little_endian", ">": "binary_big_endian", "": "ascii"}[order]
    head = ["ply", f"format {encoding} 1.0", f"element vertex {len(rows)}"]
    head += [f"property float {name}" for name in ("x", "y", "z", "intensity")]
    head += ["element face 4", "property list uchar int vertex_indices", "end_header", ""]
    faces = [list(range(3 + number % 2)) for number in range(4)]
    if order:
        body = rows[:, :4].astype(order + "f4").tobytes()
        body += b"".join(struct.pack(f"{order}B{len(face)}i", len(face), *face) for face in faces)
    else:
        lines = [" ".join(f"{value:.6f}" for value in row) for row in rows[:, :4]]
        lines += [" ".join(map(str, [len(face), *face])) for face in faces]
        body = "\n".join(lines).encode()
    return "\n".join(head).encode() + body


def _las(rows: np.ndarray) -> bytes:
    """Version 1.2, point format 1, with a record of GeoTIFF's keys."""
    keys = struct.pack("<4H", 1, 1, 0, 1) + struct.pack("<4H", 1024, 0, 1, 1) + struct.pack("<4H", 3076, 0, 1, 9001)
    keys = struct.pack("<4H", 1, 1, 0, 2) + keys[8:]
    record = struct.pack("<H16sHH32s", 0, b"LASF_Projection", 34735, len(keys), b"") + keys
    whole = np.rint(rows[:, :3] * 1000).astype(int)
    low, high = whole.min(axis=0) / 1000, whole.max(axis=0) / 1000
    head = struct.pack("<4sHH16sBB32s32sHHHIIBHI", b"LASF", 0, 0, b"", 1, 2, b"", b"", 1, 2024, 227, 227 + len(record),
                       1, 1, 28, len(rows))  # fmt: skip
    head += struct.pack("<5I", len(rows), 0, 0, 0, 0) + struct.pack("<6d", 0.001, 0.001, 0.001, 0, 0, 0)
    head += struct.pack("<6d", *np.column_stack([high, low]).ravel())
    points = (
        struct.pack("<iiiHBBbBHd", *place, round(255 * strength), 9, 0, 0, 0, 0, 10 + number * 1e-4)
        for number, (place, strength) in enumerate(zip(whole.tolist(), rows[:, 3].tolist(), strict=True))
    )
    return head + record + b"".join(points)


_OUSTER = {"t": "u4", "reflectivity": "u2", "ring": "u1", "ambient": "u2", "range": "u4"}


def _good(rng: np.random.Generator) -> Iterator[dict[str, np.ndarray]]:
    turn_ns = np.linspace(0, 99_000_000, _POINTS).astype(np.int64)
    yield {"intensity": rng.uniform(0, 1, _POINTS).astype(np.float32)}
    yield {"Intensity": rng.integers(0, 256, _POINTS).astype(np.uint8), "t": turn_ns.astype(np.uint32)}
    yield {"reflectivity": rng.integers(0, 65536, _POINTS).astype(np.uint16), "time": (turn_ns / 1e9).astype("f4")}
    yield {"i": rng.uniform(0, 255, _POINTS).astype(np.float32), "timestamp": (_NOW_NS + turn_ns) / 1e9}
    yield {"timestamp": (_NOW_NS + turn_ns) // 1000, "normal": rng.normal(size=(_POINTS, 3)).astype(np.float32)}
    yield {"intensity": np.full(_POINTS, 0.5, np.float32), "ring": (np.arange(_POINTS) % 32).astype(np.uint16)}
    yield {"t": ((turn_ns + (1 << 32) - 40_000_000) % (1 << 32)).astype(np.uint32)}
    yield {"offset_time": (turn_ns // 1000 - 99_000).astype(np.int32), "intensity": np.zeros(_POINTS, np.float32)}
    yield {"timestamp": rng.integers(0, 1 << 62, _POINTS).view(np.float64) * 1e250}


def _wrong(rng: np.random.Generator) -> Iterator[dict[str, np.ndarray]]:
    strong = rng.uniform(0, 1, _POINTS).astype(np.float32)
    for value in (np.nan, np.inf, -1.0):
        yield {"intensity": _with(strong, value)}
    yield {"x": _with(strong, np.inf)}
    yield {"t": rng.uniform(0, 1, _POINTS)}  # of a turn: no time
    yield {"t": np.linspace(0, 1.5, _POINTS)}
    yield {"time_ns": np.linspace(0, 0.1, _POINTS)}
    yield {"time": (_NOW_NS / 1e9 + np.linspace(0, 0.1, _POINTS)).astype(np.float32)}  # in steps of 128 s
    yield {"t": _with(np.linspace(0, 0.1, _POINTS), np.nan)}
    yield {"t": np.array([-(2**63), 2**63 - 1] * (_POINTS // 2), np.int64)}


def _with(values: np.ndarray, value: float) -> np.ndarray:
    changed = values.copy()
    changed[7 if values.ndim == 1 else (7, 3)] = value
    return changed


def _files(folder: Path, contents: Any, write: Callable[[Path, Any], None]) -> tuple[bytes, ...]:
    data = []
    for content in contents:
        write(folder / "cloud.npy", content)
        data.append((folder / "cloud.npy").read_bytes())
    return tuple(data)


def _pcd(path: Path, columns: dict[str, np.ndarray]) -> None:
    pcd.write_pcd(path, columns)


def _cache(path: Path, columns: dict[str, np.ndarray]) -> None:
    clouds.write_cache(path, columns)


def _table(path: Path, columns: dict[str, np.ndarray]) -> None:
    table = np.zeros(_POINTS, [(name, values.dtype, values.shape[1:]) for name, values in columns.items()])
    for name, values in columns.items():
        table[name] = values
    np.save(path, table)


def _npy(path: Path, rows: np.ndarray) -> None:
    np.save(path, rows)


def read_one(path: Path) -> Cloud:
    """The cloud as a verb reads it, with what its data set of one file shows."""
    return CloudFiles([path])[0].cloud()


def is_sound(cloud: Cloud) -> bool:
    """Finite places and intensities in [0, 1], and times within two seconds of the sweep."""
    offsets = cloud.extra.get("offset_ns", np.zeros(0))
    strength = np.zeros(0) if cloud.intensity is None else cloud.intensity
    return bool(
        np.isfinite(cloud.points_m).all()
        and ((strength >= 0) & (strength <= 1)).all()
        and (np.abs(offsets) <= _MOST_OFFSET_NS).all()
    )


def is_power(points: np.ndarray) -> bool:
    """Finite numbers, and power of 0 or more."""
    return bool(np.isfinite(points).all() and (points[:, 3] >= 0).all())
