"""One process a journal: held by a lock that ends with the process, however that ends."""

import os
import warnings
from pathlib import Path

from farfield.studio.editing.errors import JournalHeldError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

LOCK = "lock"


def hold(folder: Path) -> int:
    """Hold a journal's folder; the handle holds it until it is closed or the process ends.

    Args:
        folder: The folder.

    Raises:
        JournalHeldError: If another process holds it.
    """
    handle = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        _lock(handle, folder)
    except BlockingIOError:
        pid = os.read(handle, 32).decode("ascii", "replace").strip()
        os.close(handle)
        raise JournalHeldError(str(folder), int(pid) if pid.isdigit() else 0) from None
    os.ftruncate(handle, 0)
    os.write(handle, f"{os.getpid()}\n".encode())
    return handle


def _lock(handle: int, folder: Path) -> None:
    if fcntl is None:
        warnings.warn(f"{folder}: this system has no file locks: open these labels once only", stacklevel=4)
        return
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError as error:  # some network file systems
        warnings.warn(f"{folder}: cannot be locked ({error}): open these labels once only", stacklevel=4)
