"""MATLAB v5 elements made by hand, so that they can say what is not so."""

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from farfield.files.mat import write_mat


def matrix(dims: tuple[int, ...], data: bytes, *, kind: int = 9, claimed: int | None = None, flags: int = 6) -> bytes:
    """An array 'x' that says what it is told to say: its dimensions, kind of number, flags, and its length in bytes."""
    sides = struct.pack(f"<II{len(dims)}i", 5, 4 * len(dims), *dims) + bytes(-4 * len(dims) % 8)
    body = struct.pack("<IIII", 6, 8, flags, 0) + sides + struct.pack("<HHc3x", 1, 1, b"x")
    body += struct.pack("<II", kind, len(data) if claimed is None else claimed) + data
    return struct.pack("<II", 14, len(body)) + body


def packed(data: bytes) -> bytes:
    """A compressed element."""
    squeezed = zlib.compress(data)
    return struct.pack("<II", 15, len(squeezed)) + squeezed


def file(path: Path, *elements: bytes) -> Path:
    """Write a file of these elements."""
    path.write_bytes(b"MATLAB 5.0".ljust(124) + b"\x00\x01IM" + b"".join(elements))
    return path


def damaged(folder: Path, array: np.ndarray, count: int, rng: np.random.Generator) -> Iterator[tuple[Path, bool]]:
    """Damaged files of ``array`` as "x", and whether they were compressed.

    They are cut short, have bytes changed, or random bytes behind a good header.
    """
    originals = []
    for compress in (False, True):
        write_mat(folder / "good.mat", "x", array, compress=compress)
        originals.append((folder / "good.mat").read_bytes())
    path = folder / "bad.mat"
    for case in range(count):
        data = bytearray(originals[case % 2])
        if case % 5 == 0:
            data = data[: int(rng.integers(0, len(data)))]
        elif case % 5 == 1:
            data[128:] = rng.integers(0, 256, int(rng.integers(0, 300)), dtype=np.uint8).tobytes()
        else:
            for place in rng.integers(124, 240 if case % 5 < 4 else len(data), 1 + case % 4):
                data[min(int(place), len(data) - 1)] = int(rng.integers(0, 256))
        path.write_bytes(bytes(data))
        yield path, case % 2 == 1
