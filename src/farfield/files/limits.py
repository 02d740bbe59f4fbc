"""What one file may cost, whoever wrote it: the limits that readers share; ``docs/limits.md`` is printed from them.

Nothing is allocated on the word of a file. What it claims is compared with the bytes that it has, and what it unpacks
to with :data:`MAX_BYTES`, before memory is taken, so that a small file costs little: at most 1 GB beyond the data that
was asked for, and 20 s.
"""

import math
import os
import stat
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

from farfield.errors import FileFormatError

MAX_BYTES = 256 << 20
"""Of a file, and of what one file, chunk or array unpacks to, unless its reader states another limit."""
MAX_TENSOR_BYTES = 640 << 20
"""Of a file of MATLAB, packed or not: K-Radar's tesseracts have 519 MB."""
MAX_WEIGHTS_BYTES = 4 << 30
"""Of a file of weights or a checkpoint, whose numbers stand there as they are."""
FREE_BYTES, MAX_EXPANSION = 16 << 20, 256
"""Beyond so many bytes, the packed parts of a bag unpack to at most so many times their size."""
MAX_NUMBERS = 256
"""Numbers of a point: fields, each with its count."""
MAX_NAME = 200
"""Characters of a name: of a class, frame, sequence, track or sensor."""
MAX_RINGS = 1024
"""Rings of a LiDAR are numbered below it."""
MAX_PIXELS = 100_000_000
"""Width x height of a picture: 300 MB in memory."""
MAX_SCANNED_PIXELS = 20 * MAX_PIXELS
"""Width x height x scans of a JPEG, each drawn over the whole picture: cameras write one, progressive files ten."""


def fits_64_bits(number: int) -> bool:
    """Whether a whole number of a text is one of 64 bits, with a sign or without."""
    return -(1 << 63) <= number < 1 << 64


def is_addressable(shape: Sequence[int], item_bytes: int) -> bool:
    """Whether an array can have a shape: NumPy multiplies the sides beside a 0 too, and refuses what is beyond 63 bits.

    Args:
        shape: Its sides.
        item_bytes: Of each number, as it is in memory.
    """
    least = all(side >= 0 for side in shape)
    return least and len(shape) <= 32 and math.prod(side for side in shape if side) * max(item_bytes, 1) < 1 << 63


def open_file(path: Path | str, *, max_bytes: int | None = MAX_BYTES) -> BinaryIO:
    """Open a regular file for reading, refusing a larger one; a pipe without a writer is not waited for.

    Args:
        path: The file.
        max_bytes: Largest size that is accepted; None accepts any, where a file is read in pieces.

    Raises:
        FileFormatError: If it is larger, or no regular file.
        OSError: If it cannot be opened.
    """
    handle: BinaryIO = open(path, "rb", opener=_open_at_once)  # noqa: SIM115 - the caller closes it
    status = os.fstat(handle.fileno())
    if stat.S_ISREG(status.st_mode) and (max_bytes is None or status.st_size <= max_bytes):
        return handle
    handle.close()
    if not stat.S_ISREG(status.st_mode):
        raise FileFormatError(path, where="the file", expected="a regular file", got="a device or a pipe")
    raise FileFormatError(
        path,
        where="the file",
        expected=f"at most {max_bytes} bytes",
        got=f"{status.st_size} bytes",
        fix="Split it, or leave out what is not needed; in Python, readers take a larger max_bytes.",
    )


def _open_at_once(path: str, flags: int) -> int:
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def allowed_bytes(packed: int, *, most: int = MAX_BYTES) -> int:
    """To how many bytes so many packed ones may unpack.

    Args:
        packed: Their number.
        most: However many there are.
    """
    return min(most, FREE_BYTES + MAX_EXPANSION * packed)


def check_name(path: Path | str, where: str, name: str) -> str:
    """A name of a file, if it is none that fills the memory: arrays of names have the width of the longest.

    Raises:
        FileFormatError: If it has more than :data:`MAX_NAME` characters.
    """
    if len(name) > MAX_NAME:
        expected, actual = f"a name of at most {MAX_NAME} characters", f"{len(name)}: {name[:40]!r}..."
        raise FileFormatError(path, where=where, expected=expected, got=actual)
    return name


def check_numbers(path: Path | str, where: str, count: int) -> None:
    """Refuse points of more numbers than any sensor or tool writes.

    Raises:
        FileFormatError: If a point has more than :data:`MAX_NUMBERS`.
    """
    if count > MAX_NUMBERS:
        raise FileFormatError(path, where=where, expected=f"at most {MAX_NUMBERS} numbers per point", got=f"{count}")
