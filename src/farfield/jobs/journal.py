"""What a work has finished, so that an interrupted one goes on and what was damaged is made again."""

import hashlib
import json
import os
import stat
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path, PurePosixPath
from threading import Lock, Timer
from typing import Any, NamedTuple

from farfield.errors import FileFormatError, plain
from farfield.files.atomic import open_atomic
from farfield.files.json_text import plain_json
from farfield.files.limits import open_file
from farfield.files.marks import Mark, mark_of
from farfield.files.outputs import check_replaceable
from farfield.jobs.units import Unit

GROUP_S, GROUP_UNITS = 0.05, 100
"""Lines are written together after so many seconds, or so many units: a lost line costs a unit done again."""


class _JournalEntry(NamedTuple):
    source: str
    files: dict[str, Mark]
    line: tuple[int, int]  # where the line stands in the file: offset and length


class JobJournal:
    """One line a finished unit: its name, the state of its sources, size and CRC-32 of each file, and its value.

    A file that changed after the journal is compared by its checksum, all others by their size. At the end the lines
    are sorted, so that the journal does not depend on who worked when.

    Args:
        path: The journal's file; its folder is made if it is missing.
        setting: All that decides the result besides the sources: with another one, every unit is done anew.
        overwrite: Forget what was done before.
        files: Whether the units write files into the journal's folder, which is then theirs: what killed workers left
            there unfinished is swept out.

    Raises:
        ConfigError: If something other than a regular file has its name.
        FileFormatError: If a line before the last is damaged; the last one is left out, as a killed command leaves it.
    """

    def __init__(self, path: Path, setting: str = "", *, overwrite: bool = False, files: bool = True) -> None:
        if overwrite or not (path.is_symlink() and path.is_file()):  # a link is read, and never written to
            check_replaceable(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        self.path, self.folder, self.setting, self.files = path, path.parent, setting, files
        self._entries: dict[str, _JournalEntry] = {}
        self._waiting: list[tuple[str, str, dict[str, Mark], bytes]] = []
        self._lock = Lock()
        self._timer: Timer | None = None
        self._read_ns, self._sorted = -1, True
        self._torn_at: int | None = None  # where a line begins that is not whole: what comes next is written there
        if overwrite:
            path.unlink(missing_ok=True)
        elif path.is_file():
            self._read()

    def __len__(self) -> int:
        return len(self._entries)

    def _read(self) -> None:
        offset, last = 0, ""
        with open_file(self.path, max_bytes=None) as handle:
            status = os.fstat(handle.fileno())
            self._read_ns = status.st_mtime_ns
            for number, line in enumerate(handle, start=1):
                is_last = offset + len(line) >= status.st_size
                try:
                    name, entry = _parse_line(line, offset, value=is_last)
                except _DAMAGES as error:
                    if is_last:  # cut off by an interruption: its unit is done again
                        self._torn_at = offset
                        break
                    raise self._damaged(number, error) from error
                self._sorted &= last < name
                self._entries[name], last, offset = entry, name, offset + len(line)

    def _damaged(self, number: int, error: Exception) -> FileFormatError:
        fix = "Delete that line, and its unit is done again, or the file (--overwrite), to begin anew."
        where, what = f"line {number}", "a journal entry"
        return FileFormatError(self.path, where=where, expected=what, got=plain(error)[:200], fix=fix)

    def has(self, unit: Unit) -> bool:
        """Whether a unit was made from these very sources with this setting, and its files are intact."""
        return not self.fault(unit)

    def fault(self, unit: Unit, *, every_byte: bool = False) -> str:
        """Why a unit must be done again; empty if it need not.

        Args:
            unit: The unit.
            every_byte: Compare all files by their checksum, not only those that changed after the journal.
        """
        entry = self._entries.get(unit.name)
        if entry is None:
            return "not written"
        if entry.source != state_of(unit.sources, self.setting):
            return "written from another source or with other settings"
        broken = [name for name, mark in entry.files.items() if not self._intact(name, mark, every_byte)]
        return f"damaged or missing: {', '.join(broken)}" if broken else ""

    def _intact(self, name: str, mark: Mark, every_byte: bool) -> bool:
        path = self.folder / name
        try:
            status = path.stat()
        except OSError:
            return False
        if status.st_size != mark[0] or not stat.S_ISREG(status.st_mode):
            return False
        return (status.st_mtime_ns <= self._read_ns and not every_byte) or mark_of(path) == mark

    def add(self, unit: Unit, source: str, files: dict[str, Mark], value: Any = None) -> None:
        """Record a finished unit; it is on disk a moment later, or after :meth:`commit`.

        Args:
            unit: The unit.
            source: State of its sources before it was done, see :func:`state_of`.
            files: Size and checksum of each file by its name below the journal's folder.
            value: What was computed.
        """
        head = json.dumps({"unit": unit.name, "source": source, "files": dict(sorted(files.items()))})
        tail = "" if value is None else "\t" + json.dumps(value, separators=(",", ":"))
        with self._lock:
            self._waiting.append((unit.name, source, files, f"{head}{tail}\n".encode()))
            full = len(self._waiting) >= GROUP_UNITS
            if not full and self._timer is None:
                self._timer = Timer(GROUP_S, self._commit_later)
                self._timer.daemon = True
                self._timer.start()
        if full:
            self.commit()

    def commit(self) -> None:
        """Write what waits, to the disk itself.

        Raises:
            OSError: If that fails, such as on a full disk; the file then is as it was, and all waits still.
        """
        with self._lock:
            if self._timer is not None:
                self._timer.cancel()
                self._timer = None
            if not self._waiting:
                return
            check_replaceable(self.path)
            with self.path.open("ab", buffering=0) as handle:
                if self._torn_at is not None:
                    handle.truncate(self._torn_at)
                    self._torn_at = None
                offset = handle.seek(0, os.SEEK_END)
                rest = memoryview(b"".join(line for *_, line in self._waiting))
                try:
                    while rest:
                        rest = rest[os.write(handle.fileno(), rest) :]
                    os.fsync(handle.fileno())
                except BaseException:  # a full disk, or a signal: no half line stays
                    handle.truncate(offset)
                    raise
            for name, source, files, line in self._waiting:
                self._entries[name] = _JournalEntry(source, files, (offset, len(line)))
                offset += len(line)
            self._waiting, self._sorted = [], False

    def _commit_later(self) -> None:
        with suppress(OSError):  # it waits on, and the next commit says what is wrong
            self.commit()

    def finish(self) -> None:
        """Commit and sort the lines by name, each unit once."""
        self.commit()
        if self._sorted:
            return
        with self._lock, open_file(self.path, max_bytes=None) as old, open_atomic(self.path) as new:
            entries: dict[str, _JournalEntry] = {}
            for name in sorted(self._entries):
                entry = self._entries[name]
                old.seek(entry.line[0])
                entries[name] = entry._replace(line=(new.tell(), entry.line[1]))
                new.write(old.read(entry.line[1]))
        self._entries, self._sorted, self._torn_at = entries, True, None

    def values(self, names: Iterable[str]) -> Iterable[Any]:
        """The values of units that are there, one at a time from the file."""
        self.commit()
        with open_file(self.path, max_bytes=None) as handle:
            for name in names:
                offset, length = self._entries[name].line
                handle.seek(offset)
                try:
                    value = plain_json(handle.read(length).partition(b"\t")[2] or b"null")
                except ValueError as error:
                    handle.seek(0)
                    raise self._damaged(handle.read(offset).count(b"\n") + 1, error) from error
                yield value

    def file_sizes(self) -> dict[str, int]:
        """Size of every file that was written, by its name below the journal's folder."""
        return {name: mark[0] for entry in self._entries.values() for name, mark in entry.files.items()}


_DAMAGES = (ValueError, KeyError, TypeError, AttributeError)


def _parse_line(line: bytes, offset: int, *, value: bool) -> tuple[str, _JournalEntry]:
    """A line's unit and entry; the value, which is read when it is needed, is looked at where that is asked for."""
    if not line.endswith(b"\n"):
        raise ValueError("a line without its end")
    if b"\0" in line:
        raise ValueError("zeros, as a disk leaves them that lost its power")
    head, _, tail = line.partition(b"\t")
    entry = plain_json(head)
    if value and tail:
        plain_json(tail)
    files = {str(path): (int(size), int(crc)) for path, (size, crc) in entry["files"].items()}
    outside = [path for path in files if ".." in PurePosixPath(path).parts or PurePosixPath(path).is_absolute()]
    if outside:
        raise ValueError(f"a file outside the folder: {outside[0][:80]}")
    return str(entry["unit"]), _JournalEntry(str(entry["source"]), files, (offset, len(line)))


def state_of(sources: Sequence[Path], setting: str) -> str:
    """Digest of the sources' names, sizes and times of change, and of what else decides the result."""
    digest = hashlib.sha256(setting.encode(errors="surrogateescape"))
    for path in sources:
        status = path.stat()
        name = f"\0{path.name}\0{status.st_size}\0{status.st_mtime_ns}"
        digest.update(name.encode(errors="surrogateescape"))
    return digest.hexdigest()[:32]
