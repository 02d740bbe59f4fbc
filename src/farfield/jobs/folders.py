"""What a command writes is held against others while it works, and swept of what killed ones left."""

import contextlib
import glob
import os
import re
import shutil
import stat
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from math import inf
from pathlib import Path
from typing import NamedTuple

from farfield.errors import ConfigError
from farfield.files.locking import open_lock_file, remove_unlocked, still_stands, try_lock
from farfield.files.outputs import OWN_OUTPUTS, check_replaceable

STAGING = ".unfinished-"
"""How the names of folders begin in which a unit's files are made before they are moved to their places."""

_PARTIAL = re.compile(r"\..*\.[0-9a-f]{12}\.part")  # of farfield.files.atomic
_LOCK = b"farfield\n"  # in the files that lock others
_PATIENCE_S = 12.0  # more than the workers of a killed command need to end
_PAUSE_S, _REMINDER_S = 0.05, 60.0


class _Lock(NamedTuple):
    handle: int
    thread: int
    times: int


_locks: dict[Path, _Lock] = {}
"""What this process holds, by its real path."""


@contextlib.contextmanager
def held(
    out: Path, *, file: bool = False, fix: str = "", waiting: Callable[[], object] | None = None
) -> Iterator[None]:
    """Hold what a command writes, so that no other one writes there; the same thread may hold it several times.

    The operating system keeps the lock, and lets it go when the command and its workers have ended, however they end.
    A folder is locked itself, and leaves nothing; a file by another beside it, which is removed at the end and blocks
    nobody if it stays; it is locked in a folder that is held too, since others may hold a file there alone.
    Without a lock where the file system has none (some NFS).

    Args:
        out: A folder, made if it is missing, or a file.
        file: Whether it is a file.
        fix: What to do where another command is at work there.
        waiting: Called where another command is at work there, and each minute anew; its end is waited for, however
            long it takes.

    Raises:
        ConfigError: If another command still writes there after some seconds and is not waited for, or if what should
            be the lock of a file is a link or a pipe.
    """
    path = out.parent.resolve() / out.name if file else out.resolve()
    thread = threading.get_ident()
    lock = _locks.get(path)
    if lock is not None and lock.thread == thread:
        _locks[path] = lock._replace(times=lock.times + 1)
        try:
            yield
        finally:
            _locks[path] = _locks[path]._replace(times=_locks[path].times - 1)
        return
    made = [folder for folder in ((path.parent if file else path), *path.parents) if not folder.exists()]
    try:
        _locks[path] = _Lock(_locked(out, path, file, fix, waiting), thread, 1)
        _sweep_out_partial(path, file)
        yield
    finally:
        try:
            _let_go(path, thread, made, file)
        finally:  # once more, if a signal ended it
            _let_go(path, thread, made, file)


def _let_go(path: Path, thread: int, made: Sequence[Path], file: bool) -> None:
    """Remove what only the lock needed, and end it; nothing if that is done."""
    lock = _locks.get(path)
    if lock is None or lock.thread != thread:
        return
    with contextlib.suppress(OSError):  # Windows keeps what is open; it blocks nobody
        if file:
            _lock_file(path).unlink(missing_ok=True)
    with contextlib.suppress(OSError):  # what stands in a folder keeps it
        for folder in made:
            folder.rmdir()
    del _locks[path]
    os.close(lock.handle)


def handles() -> tuple[int, ...]:
    """The locks of this process, for its workers to hold too: what they write is theirs until they have ended."""
    return tuple(lock.handle for lock in list(_locks.values()))


def _lock_file(path: Path) -> Path:
    return path.with_name(f".{path.name[:100]}.lock")


def _locked(out: Path, path: Path, file: bool, fix: str, waiting: Callable[[], object] | None) -> int:
    """Open and lock what stands under the name now."""
    until, reminder = time.monotonic() + _PATIENCE_S, -inf
    while True:
        (path.parent if file else path).mkdir(parents=True, exist_ok=True)
        by_file = file or sys.platform == "win32"  # where folders cannot be opened
        target = _lock_file(path) if by_file else path
        try:
            handle = _opened(target, by_file)
        except FileNotFoundError:  # whoever made the folder has just removed it
            if time.monotonic() > until:
                raise
            time.sleep(_PAUSE_S)
            continue
        free = False
        try:
            free = try_lock(handle)
            if free and still_stands(handle, target):
                if by_file and not os.fstat(handle).st_size:
                    with contextlib.suppress(OSError):  # another user's, or a full disk
                        os.write(handle, _LOCK)
                return handle
        except BaseException:
            if free and by_file:
                target.unlink(missing_ok=True)
            os.close(handle)
            raise
        os.close(handle)
        if not free and waiting is not None:
            until = time.monotonic() + _PATIENCE_S
            if time.monotonic() > reminder:
                reminder = time.monotonic() + _REMINDER_S
                waiting()
        if not free or time.monotonic() > until:
            if time.monotonic() > until:
                raise ConfigError(
                    f"{out}: expected no other command that writes there, but one runs. "
                    f"{fix or 'Wait until it has ended, or name another place to write to.'}"
                )
            time.sleep(_PAUSE_S)


def _opened(target: Path, by_file: bool) -> int:
    if not by_file:
        return os.open(target, os.O_RDONLY)
    check_replaceable(target, fix="Delete it: a file is locked by that name while it is written.")
    return open_lock_file(target)


def sweep_out(folder: Path) -> None:
    """Remove what killed workers left unfinished in a folder that is held."""
    for root, folders, files in os.walk(folder):
        for name in [name for name in folders if name.startswith(STAGING)]:
            shutil.rmtree(Path(root, name), ignore_errors=True)
            folders.remove(name)
        for name in files:
            if _PARTIAL.fullmatch(name):
                with contextlib.suppress(OSError):  # a link, or another user's
                    remove_unlocked(Path(root, name))


def _sweep_out_partial(path: Path, file: bool) -> None:
    """Remove files that killed commands left unfinished: of a file, or in a folder and those in it that none holds."""
    names = (path.name[:100], OWN_OUTPUTS) if file else ()
    parts = [part for name in names for part in path.parent.glob(f".{glob.escape(name)}.*.part")]
    locks = list[Path]()
    with contextlib.suppress(OSError):  # a folder that cannot be read or written: the command says so
        for folder in () if file else (path, *(inner for inner in path.iterdir() if _is_free(inner))):
            parts += folder.glob(".*.part")
            locks += folder.glob(".*.lock")
    for part in parts:
        if _PARTIAL.fullmatch(part.name):
            with contextlib.suppress(OSError):  # a link, or another user's
                remove_unlocked(part)
    for lock in locks:
        with contextlib.suppress(OSError):
            if stat.S_ISREG(lock.lstat().st_mode) and lock.stat().st_size == len(_LOCK) and lock.read_bytes() == _LOCK:
                remove_unlocked(lock)


def _is_free(folder: Path) -> bool:
    """Whether this is a folder, no link, in which no command is at work."""
    if sys.platform == "win32" or folder.is_symlink() or not folder.is_dir():
        return False
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError:  # another user's: nothing is swept there
        return False
    try:
        return try_lock(handle)
    finally:
        os.close(handle)
