"""What a work has finished, so that an interrupted one goes on and what was damaged is made again."""

import hashlib
import json
import os
import zlib
from collections.abc import Iterable, Sequence
from pathlib import Path, PurePosixPath
from threading import Lock, Timer
from typing import Any, NamedTuple

from farfield.errors import FileFormatError, plain
from farfield.files.atomic import open_atomic
from farfield.jobs.units import Unit

GROUP_S, GROUP_UNITS = 0.05, 100
"""Lines are written together after so many seconds, or so many units: a lost line costs a unit done again."""

Mark = tuple[int, int]
"""Size and CRC-32 of a file."""


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
        FileFormatError: If the file is no journal.
    """

    def __init__(self, path: Path, setting: str = "", *, overwrite: bool = False, files: bool = True) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self.path, self.folder, self.setting, self.files = path, path.parent, setting, files
        self._entries: dict[str, _JournalEntry] = {}
        self._waiting: list[tuple[str, str, dict[str, Mark], bytes]] = []
        self._lock = Lock()
        self._timer: Timer | None = None
        self._read_ns, self._sorted = -1, True
        if overwrite:
            path.unlink(missing_ok=True)
        elif path.is_file():
            self._read()

    def __len__(self) -> int:
        return len(self._entries)

    def _read(self) -> None:
        self._read_ns = self.path.stat().st_mtime_ns
        offset, last, number = 0, "", 0
        with self.path.open("rb") as handle:
            for number, line in enumerate(handle, start=1):
                if not line.endswith(b"\n"):  # cut off by an interruption
                    break
                try:
                    name, entry = _parse_line(line, offset)
                except (ValueError, KeyError, TypeError, AttributeError) as error:
                    fix = "Delete it, or pass --overwrite, to begin anew."
                    raise FileFormatError(
                        self.path, where=f"line {number}", expected="a journal entry", got=plain(error), fix=fix
                    ) from error
                self._sorted &= last < name
                self._entries[name], last, offset = entry, name, offset + len(line)
        if offset < self.path.stat().st_size:
            os.truncate(self.path, offset)
            os.utime(self.path, ns=(self._read_ns, self._read_ns))

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
        if status.st_size != mark[0]:
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
                self._timer = Timer(GROUP_S, self.commit)
                self._timer.daemon = True
                self._timer.start()
        if full:
            self.commit()

    def commit(self) -> None:
        """Write what waits, to the disk itself."""
        with self._lock:
            if self._timer is not None:
                self._timer.cancel()
                self._timer = None
            if not self._waiting:
                return
            with self.path.open("ab") as handle:
                offset = handle.tell()
                handle.write(b"".join(line for *_, line in self._waiting))
                handle.flush()
                os.fsync(handle.fileno())
            for name, source, files, line in self._waiting:
                self._entries[name] = _JournalEntry(source, files, (offset, len(line)))
                offset += len(line)
            self._waiting, self._sorted = [], False

    def finish(self) -> None:
        """Commit and sort the lines by name, each unit once."""
        self.commit()
        if self._sorted:
            return
        with self._lock, self.path.open("rb") as old, open_atomic(self.path) as new:
            for name in sorted(self._entries):
                entry = self._entries[name]
                old.seek(entry.line[0])
                self._entries[name] = entry._replace(line=(new.tell(), entry.line[1]))
                new.write(old.read(entry.line[1]))
        self._sorted = True

    def values(self, names: Iterable[str]) -> Iterable[Any]:
        """The values of units that are there, one at a time from the file."""
        self.commit()
        with self.path.open("rb") as handle:
            for name in names:
                offset, length = self._entries[name].line
                handle.seek(offset)
                yield json.loads(handle.read(length).partition(b"\t")[2] or b"null")


def _parse_line(line: bytes, offset: int) -> tuple[str, _JournalEntry]:
    entry = json.loads(line.partition(b"\t")[0])
    files = {str(path): (int(size), int(crc)) for path, (size, crc) in entry["files"].items()}
    outside = [path for path in files if ".." in PurePosixPath(path).parts or PurePosixPath(path).is_absolute()]
    if outside:
        raise ValueError(f"a file outside the folder: {outside[0][:80]}")
    return str(entry["unit"]), _JournalEntry(str(entry["source"]), files, (offset, len(line)))


def state_of(sources: Sequence[Path], setting: str) -> str:
    """Digest of the sources' names, sizes and times of change, and of what else decides the result."""
    digest = hashlib.sha256(setting.encode())
    for path in sources:
        status = path.stat()
        digest.update(f"\0{path.name}\0{status.st_size}\0{status.st_mtime_ns}".encode())
    return digest.hexdigest()[:32]


def mark_of(path: Path) -> Mark:
    """Size and CRC-32 of a file."""
    size = crc = 0
    with path.open("rb") as handle:
        while block := handle.read(1 << 20):
            size, crc = size + len(block), zlib.crc32(block, crc)
    return size, crc
