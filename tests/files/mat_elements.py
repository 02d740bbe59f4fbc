"""MATLAB v5 elements made by hand, so that they can say what is not so."""

import struct
import zlib
from pathlib import Path


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
