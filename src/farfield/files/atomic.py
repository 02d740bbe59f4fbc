"""Whole files in and out: reads are bounded by the file's real size, writes are all or nothing."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from farfield.errors import FileFormatError
from farfield.files.limits import MAX_BYTES, open_file
from farfield.files.locking import locked_part
from farfield.files.outputs import check_replaceable, note_output
from farfield.files.stand_ins import HEAD_BYTES, refuse_stand_in


def read_bytes(path: Path | str, *, max_bytes: int = MAX_BYTES) -> bytes:
    """Read a whole regular file, refusing one that is larger than ``max_bytes`` before any of it is read.

    Args:
        path: The file.
        max_bytes: Largest size that is accepted.

    Raises:
        FileFormatError: If the file is larger, is no regular file, or something else stands in its place.
        OSError: If the file cannot be opened.
    """
    if Path(path).is_dir():
        raise FileFormatError(path, where="the file", expected="a regular file", got="a folder")
    with open_file(path, max_bytes=max_bytes) as handle:
        data = handle.read(os.fstat(handle.fileno()).st_size)
    refuse_stand_in(path, data[:HEAD_BYTES])
    return data


@contextmanager
def open_atomic(path: Path | str) -> Iterator[BinaryIO]:
    """Open a file for writing such that it appears under its name only when the block ends without an error.

    The bytes go to a temporary file in the same folder, reach the disk (fsync) and then replace ``path`` in one step.
    It is locked meanwhile, so that no other command sweeps it out as one that a killed command left.
    After an error or an interruption the old file, if there was one, is as it was.

    Args:
        path: The file to write; its folder must exist.

    Yields:
        A binary handle to write to.

    Raises:
        ConfigError: If a link, a pipe, a device or a folder stands under the name: only regular files are replaced.
        OSError: If the folder is missing or cannot be written.
    """
    path = Path(path)
    check_replaceable(path)
    partial, lock = path, -1
    try:
        partial, lock = locked_part(path)
        with os.fdopen(os.dup(lock), "w+b") as handle:
            yield handle
            handle.flush()
            os.fsync(handle.fileno())
        if sys.platform == "win32":  # where an open file cannot be moved
            os.close(lock)
            lock = -1
        move_into_place(partial, path)
    except BaseException:  # Ctrl-C too must not leave the partial file behind
        if partial != path:
            partial.unlink(missing_ok=True)
        raise
    finally:
        if lock >= 0:
            os.close(lock)


def move_into_place(partial: Path, path: Path) -> None:
    """Give a finished file its name in one step; only a regular file that has the name is replaced.

    Raises:
        ConfigError: If something else stands there.
        OSError: If it cannot be moved.
    """
    check_replaceable(path)
    note_output(path, partial)
    partial.replace(path)


def write_bytes(path: Path | str, data: bytes) -> None:
    """Write a whole file, all or nothing."""
    with open_atomic(path) as handle:
        handle.write(data)


def write_text(path: Path | str, text: str) -> None:
    """Write a whole text file in UTF-8 with the line ends that the text has, all or nothing.

    What a name of a file that is not UTF-8 brings into it is written as :func:`readable` shows it.
    """
    write_bytes(path, readable(text).encode("utf-8"))


def readable(name: str) -> str:
    r"""A name of a file or folder as text that can be written: bytes that are not UTF-8 become ``\xff``.

    >>> readable("caf\udce9"), readable("café")
    ('caf\\xe9', 'café')
    """
    try:
        name.encode("utf-8")
    except UnicodeEncodeError:
        return name.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")
    return name
