"""One process a journal: held by a lock that ends with the process, however that ends."""

import os
import warnings
from pathlib import Path

from farfield.annotation.errors import JournalHeldError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

LOCK = "lock"
MOUNTS = Path("/proc/self/mounts")
NETWORK = ("nfs", "nfs4", "cifs", "smb3", "fuse.sshfs")


def hold(folder: Path) -> int:
    """Hold a journal's folder; the handle holds it until it is closed or the process ends.

    Args:
        folder: The folder.

    Raises:
        JournalHeldError: If another process holds it.
    """
    network = network_file_system(folder)
    if network:
        warnings.warn(
            f"{folder}: stands on a network file system ({network}), whose locks and writes may not be kept: annotate "
            "a copy on a local disk, or open these labels on one machine only",
            stacklevel=3,
        )
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


def network_file_system(folder: Path) -> str:
    """Kind of the network file system on which a folder stands; empty where it is a local one, or not known."""
    try:
        mounts = [line.split(" ")[1:3] for line in MOUNTS.read_text(errors="replace").splitlines()]
    except OSError:  # no such list on this system
        return ""
    place = folder.resolve()
    over = [(len(point), kind) for point, kind in mounts if place.is_relative_to(point.replace("\\040", " "))]
    kind = max(over, default=(0, ""))[1]
    return kind if kind in NETWORK else ""
