"""Where a command may write: regular files and new names alone, and never over what it reads."""

import os
import re
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import lru_cache
from pathlib import Path
from urllib.parse import quote, quote_from_bytes

from farfield.errors import ConfigError, FileFormatError
from farfield.files.locking import locked_part, open_lock_file, still_stands, try_lock
from farfield.files.marks import mark_of
from farfield.files.sizes import room

_PROBE_BYTES = 1 << 16  # which a full disk refuses
OWN_OUTPUTS = ".farfield_outputs"
"""The list of outputs that stand among inputs, in their folder."""

_LINE = re.compile(r"\d{1,20} \d{1,10}( [\w.~%-]{1,1000}){3}", re.ASCII)  # size, CRC-32, command, flag, name
_LIST_BYTES = 1 << 24
_PATIENCE_S, _PAUSE_S = 10.0, 0.01  # a list is held for as long as a file is summed
_REMEMBERED_S = 10.0  # verbs look twice: before and after they know the data
_KINDS = {
    stat.S_IFLNK: "a symbolic link",
    stat.S_IFIFO: "a pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
    stat.S_IFDIR: "a folder",
}


_among_inputs: dict[Path, tuple[str, str]] = {}
"""Outputs of this process that stand in a folder which it reads: the command and the flag that write them."""

_verb: ContextVar[str] = ContextVar("verb", default="")
"""The verb that runs; none from Python."""


@contextmanager
def of_command(verb: str) -> Iterator[None]:
    """Say whose outputs they are that are looked at in the block.

    Args:
        verb: The verb that runs.
    """
    token = _verb.set(verb)
    try:
        yield
    finally:
        _verb.reset(token)


def check_replaceable(path: Path, what: str = "", *, fix: str = "") -> None:
    """Refuse to write over anything but a regular file: a link, a pipe or a device would be gone, not written into.

    Args:
        path: The file that is going to be written, or to be replaced.
        what: The flag that names it, for the message.
        fix: What to do, where the user does not choose the name.

    Raises:
        ConfigError: If something else stands there.
    """
    try:
        mode = path.lstat().st_mode
    except OSError:  # a new name; what else is wrong with it is said when it is opened
        return
    if not stat.S_ISREG(mode):
        got = _KINDS.get(stat.S_IFMT(mode), "something else")
        fix = fix or ("Name the file that it leads to." if stat.S_ISLNK(mode) else "")
        flag = f"{what} " if what else ""
        raise ConfigError(f"{flag}{path}: expected a regular file or a new name, got {got}. {fix}".rstrip())


def check_outputs(
    inputs: Iterable[Path | str | None],
    *,
    files: Mapping[str, Path | None] | None = None,
    folders: Mapping[str, Path | None] | None = None,
    apart: bool = False,
) -> None:
    """Look at everything that a command is going to write before it works: whether it can be, and harms no input.

    An output is no input, by its real path and by its inode, so that hard links are found too; nor is it a file that
    stands below a folder that is read, unless the same command wrote it there by the same flag as it is now
    (:func:`note_output`). Two outputs are not one. The file's or folder's first parent that is there takes
    a file. Nothing is left behind.

    Args:
        inputs: Files and folders that are read; names of nothing, such as a bundled detector's, are none.
        files: Files by the flags that name them.
        folders: Folders by the flags that name them; links to folders are folders.
        apart: Whether outputs must stand beside the folders that are read, neither within them nor around them.

    Raises:
        ConfigError: If an output is an input or another output, or something other than a file or a folder.
        OSError: If a folder cannot be written into.
    """
    sources = [Path(source) for source in inputs if source is not None and Path(source).exists()]
    flag_of: dict[Path, str] = {}
    for flag, path in [*(files or {}).items(), *(folders or {}).items()]:
        if path is None:
            continue
        twin = flag_of.setdefault(path.resolve(), flag)
        if twin != flag:
            raise ConfigError(f"{flag} {path}: expected another name than that of {twin}: one would replace the other")
    for flag, path in (files or {}).items():
        if path is not None:
            check_replaceable(path, flag)
            for source in sources:
                _check_file(flag, path, source, apart=apart)
            check_writable(path.parent, flag)
    for flag, path in (folders or {}).items():
        if path is not None:
            if os.path.lexists(path) and not path.is_dir():
                raise ConfigError(f"{flag} {path}: expected a folder, found something else of that name")
            for source in sources:
                _check_folder(flag, path, source, apart=apart)
            check_writable(path, flag)


def check_writable(folder: Path, flag: str = "") -> None:
    """See that files can be written into a folder, or into the first of its parents that is there.

    Args:
        folder: The folder, which need not be there yet.
        flag: The flag that names it, for the message.

    Raises:
        ConfigError: If one of its parents is no folder.
        OSError: If nothing can be written there.
    """
    above = next((parent for parent in (folder, *folder.parents) if os.path.lexists(parent)), Path())
    if not above.is_dir():
        got = "a link to nothing" if above.is_symlink() else "a file"
        raise ConfigError(f"{f'{flag}: ' if flag else ''}expected a folder at {above}, found {got} of that name")
    try:
        with tempfile.TemporaryFile(dir=above) as probe:  # without a name where the file system can
            probe.write(bytes(_PROBE_BYTES))
            probe.flush()
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(above)) from error


def check_room(folder: Path, needed_bytes: float | int) -> None:
    """Refuse to begin what the disk has no room for.

    Args:
        folder: Where it is written, or will be.
        needed_bytes: What it takes at least, as far as that can be told before the work.

    Raises:
        ConfigError: If less is free.
    """
    above = next((parent for parent in (folder, *folder.parents) if parent.is_dir()), Path())
    free = shutil.disk_usage(above).free
    if round(needed_bytes) > free:
        raise ConfigError(f"{folder}: about {room(needed_bytes, free)}. Make room, or write to another disk.")


def _check_file(flag: str, path: Path, source: Path, *, apart: bool) -> None:
    inside = source.is_dir() and source.resolve() in path.resolve().parents
    if inside and apart:
        raise ConfigError(f"{flag} {path}: expected a file beside {source}, which is read, got one within it")
    owner = (_verb.get(), flag)
    if inside:
        _check_list(path.parent / OWN_OUTPUTS)
        _among_inputs[path.resolve()] = owner
    if not path.exists():
        return
    if path.samefile(source):
        raise ConfigError(f"{flag} {path}: expected another name than that of {source}, which is read")
    if (not _is_own_output(path, owner)) if inside else (source.is_dir() and _holds_now(source, path.stat())):
        raise ConfigError(
            f"{flag} {path}: expected a new name, got a file of {source}, which is read. Name another, or delete it."
        )


def note_output(path: Path, content: Path) -> None:
    """Before an output that stands among inputs takes its name: write down what it holds, in a list beside it.

    What the list says of the file that is being replaced stays, as long as that one is there: a command that is killed
    in between may write it again. Other commands that write into the list at once wait for one another.

    Args:
        path: The name that it is going to have; nothing is done unless it was found to stand in a folder that is read.
        content: The finished file.

    Raises:
        ConfigError: If the list is no regular file, cannot be read, or is held by another command for too long.
        OSError: If it cannot be written.
    """
    owner = _among_inputs.get(path.parent.resolve() / path.name)
    if owner is None:
        return
    outputs = path.parent / OWN_OUTPUTS
    lock = _lock_list(outputs)
    try:
        lines, line = _noted(outputs), _line(path.name, content, owner)
        if line in lines:
            return
        name = line.rpartition(" ")[2]
        old = [_line(path.name, path, owner)] if path.exists() else []
        others = [other for other in lines if other.rpartition(" ")[2] != name or other in old]
        partial, handle = locked_part(outputs)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write("".join(f"{other}\n" for other in (*others, line)).encode("ascii"))
                file.flush()
                os.fsync(file.fileno())
            if sys.platform == "win32":  # where an open file cannot be replaced
                os.close(lock)
                lock = -1
            partial.replace(outputs)
        finally:
            partial.unlink(missing_ok=True)
    finally:
        if lock >= 0:
            os.close(lock)


def _lock_list(outputs: Path) -> int:
    """Open and lock the list that stands there now, a new one if there is none."""
    until = time.monotonic() + _PATIENCE_S
    while True:
        _check_list(outputs)
        handle = open_lock_file(outputs)
        if (free := try_lock(handle)) and still_stands(handle, outputs):
            return handle
        os.close(handle)
        if time.monotonic() > until:
            raise ConfigError(f"{outputs}: expected a list that no other command holds, but one runs. Try again.")
        if not free:
            time.sleep(_PAUSE_S)


def _check_list(outputs: Path) -> None:
    """Refuse a list of outputs that is no regular file or cannot be read.

    Raises:
        ConfigError: If it is so.
    """
    check_replaceable(outputs, fix="Delete it: a list of outputs is kept there.")
    if os.path.lexists(outputs) and not os.access(outputs, os.R_OK):
        raise ConfigError(
            f"{outputs}: expected a list of outputs that can be read, got one that cannot. Allow it, or delete it."
        )


def _is_own_output(path: Path, owner: tuple[str, str]) -> bool:
    """Whether the same command wrote a file among its inputs, by the same flag, as it is now."""
    try:
        lines = _noted(path.parent / OWN_OUTPUTS)
        return bool(lines) and _line(path.name, path, owner) in lines
    except (OSError, FileFormatError):
        return False


def _line(name: str, content: Path, owner: tuple[str, str]) -> str:
    """What the list says of a file: size, CRC-32, command, flag and name, their bytes quoted as in an address."""
    size, crc = mark_of(content)
    verb, flag = (quote(word, safe="") or "-" for word in owner)
    return f"{size} {crc} {verb} {flag} {quote_from_bytes(os.fsencode(name), safe='')}"


def _noted(outputs: Path) -> list[str]:
    """The lines of a list of outputs that are of its form; one that is damaged is no file's."""
    if not outputs.is_file() or outputs.is_symlink() or outputs.stat().st_size > _LIST_BYTES:
        return []
    lines = outputs.read_text(encoding="ascii", errors="replace").split("\n")
    return [line for line in lines if _LINE.fullmatch(line)]


def _holds_now(folder: Path, status: os.stat_result) -> bool:
    moment = int(time.monotonic() / _REMEMBERED_S)
    return _holds(folder.resolve(), status.st_dev, status.st_ino, status.st_ctime_ns, moment)


@lru_cache(maxsize=64)
def _holds(folder: Path, device: int, inode: int, changed_ns: int, moment: int) -> bool:
    """Whether a file of an inode stands below a folder, behind links too; the answer is remembered for some seconds.

    Args:
        folder: The folder.
        device: The file's.
        inode: The file's.
        changed_ns: When the inode changed, as by a further hard link: then it is looked for anew.
        moment: When this is asked, in steps of the time for which the answer stands.
    """
    del changed_ns, moment
    folders, visited = [folder], set[tuple[int, int]]()
    while folders:
        top = folders.pop()
        try:
            own = top.stat()
            if (own.st_dev, own.st_ino) in visited:
                continue
            visited.add((own.st_dev, own.st_ino))
            with os.scandir(top) as listing:
                entries = list(listing)
        except OSError:  # a folder that cannot be listed is none that is read
            continue
        for entry in entries:
            with suppress(OSError):  # a link to nothing, or to itself
                if entry.is_dir():
                    folders.append(Path(entry))
                elif entry.inode() == inode or entry.is_symlink():
                    status = entry.stat()
                    if (status.st_dev, status.st_ino) == (device, inode):
                        return True
    return False


def _check_folder(flag: str, path: Path, source: Path, *, apart: bool) -> None:
    real, real_source = path.resolve(), source.resolve()
    if path.exists() and path.samefile(source):
        raise ConfigError(f"{flag} {path}: expected another folder than {source}, which is read")
    if apart and source.is_dir() and (real_source in real.parents or real in real_source.parents):
        where = "within" if real_source in real.parents else "around"
        raise ConfigError(f"{flag} {path}: expected a folder beside {source}, which is read, got one {where} it")
