"""Whole files in and out: reads are bounded by the file's real size, writes are all or nothing."""

import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from farfield.errors import FileFormatError
from farfield.files.stand_ins import HEAD_BYTES, refuse_stand_in

MAX_BYTES = 1 << 30  # the largest file that a reader takes unless its caller says otherwise: 1 GiB


def read_bytes(path: Path | str, *, max_bytes: int = MAX_BYTES) -> bytes:
    """Read a whole regular file, refusing one that is larger than ``max_bytes`` before any of it is read.

    Args:
        path: The file.
        max_bytes: Largest size that is accepted.

    Raises:
        FileFormatError: If the file is larger, is no regular file, or something else stands in its place.
        OSError: If the file cannot be opened.
    """
    with Path(path).open("rb") as handle:
        status = os.fstat(handle.fileno())
        if not stat.S_ISREG(status.st_mode):
            raise FileFormatError(path, where="the file", expected="a regular file", got="a device or a pipe")
        if status.st_size > max_bytes:
            raise FileFormatError(
                path,
                where="the file",
                expected=f"at most {max_bytes} bytes",
                got=f"{status.st_size} bytes",
                fix="Pass a larger max_bytes if the file is meant to be so large.",
            )
        data = handle.read(status.st_size)
    refuse_stand_in(path, data[:HEAD_BYTES])
    return data


@contextmanager
def open_atomic(path: Path | str) -> Iterator[BinaryIO]:
    """Open a file for writing such that it appears under its name only when the block ends without an error.

    The bytes go to a temporary file in the same folder, reach the disk (fsync) and then replace ``path`` in one step.
    After an error or an interruption the old file, if there was one, is as it was.

    Args:
        path: The file to write; its folder must exist.

    Yields:
        A binary handle to write to.

    Raises:
        OSError: If the folder is missing or cannot be written.
    """
    path = Path(path)
    partial = path.with_name(f".{path.name[:100]}.{secrets.token_hex(6)}.part")
    flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
    descriptor = os.open(partial, flags, 0o666)  # the user's umask applies, as with open()
    try:
        with os.fdopen(descriptor, "w+b") as handle:
            yield handle
            handle.flush()
            os.fsync(handle.fileno())
        partial.replace(path)
    except BaseException:  # Ctrl-C too must not leave the partial file behind
        partial.unlink(missing_ok=True)
        raise


def write_bytes(path: Path | str, data: bytes) -> None:
    """Write a whole file, all or nothing."""
    with open_atomic(path) as handle:
        handle.write(data)


def write_text(path: Path | str, text: str) -> None:
    """Write a whole text file in UTF-8 with the line ends that the text has, all or nothing."""
    write_bytes(path, text.encode("utf-8"))
