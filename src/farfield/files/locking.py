"""Locks of the operating system on open files, which end with whoever holds them."""

import os
import secrets
import sys
from pathlib import Path

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl


_LOCKED_BYTE = 1 << 30
"""Windows locks bytes, which nobody else can read then: one beyond the content."""


def lock(handle: int) -> None:
    """Lock an open file until it is closed or the process ends; nobody waits.

    Raises:
        BlockingIOError: If another one holds it.
        OSError: If its file system has no locks.
    """
    if sys.platform == "win32":
        position = os.lseek(handle, 0, os.SEEK_CUR)
        os.lseek(handle, _LOCKED_BYTE, os.SEEK_SET)
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        except PermissionError as error:
            raise BlockingIOError(*error.args) from None
        finally:
            os.lseek(handle, position, os.SEEK_SET)
    else:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


def try_lock(handle: int) -> bool:
    """Whether an open file could be locked, or its file system has no locks; nobody waits."""
    try:
        lock(handle)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        return True
    return True


def still_stands(handle: int, path: Path) -> bool:
    """Whether an open file is still that of its name: the one who held it may have removed it."""
    try:
        return os.path.samestat(os.fstat(handle), path.lstat())
    except FileNotFoundError:
        return False


def open_lock_file(path: Path) -> int:
    """Open a file that is there to be locked, made if it is missing; a link is not followed, a pipe not waited for.

    Raises:
        OSError: If a link has the name, or the file cannot be made or opened.
    """
    flags = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    try:
        return os.open(path, os.O_RDWR | os.O_CREAT | flags, 0o666)
    except PermissionError:  # another user's file: a lock needs no right to write
        return os.open(path, os.O_RDONLY | flags)


def locked_part(path: Path) -> tuple[Path, int]:
    """Make the temporary file in which a file is written: beside it, new, with a random name, and locked.

    Returns:
        Its name, and the open file, which whoever asked for it closes and removes.

    Raises:
        OSError: If it cannot be made.
    """
    flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
    while True:
        partial = path.with_name(f".{path.name[:100]}.{secrets.token_hex(6)}.part")
        handle = os.open(partial, flags, 0o666)  # the user's umask applies, as with open()
        if try_lock(handle) and still_stands(handle, partial):
            return partial, handle
        os.close(handle)  # it was just being swept away


def remove_unlocked(path: Path) -> bool:
    """Remove a file unless somebody holds it; whether it is gone. A link is not followed, and stays."""
    flags = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOFOLLOW", 0)
    try:
        handle = os.open(path, os.O_RDONLY | flags)
    except FileNotFoundError:
        return True
    try:
        if not try_lock(handle) or not still_stands(handle, path):  # else the name is another one's by now
            return False
        path.unlink(missing_ok=True)
        return True
    finally:
        os.close(handle)
