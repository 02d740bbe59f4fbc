"""What a conversion has written, so that an interrupted one goes on and a damaged file is written again."""

import hashlib
import json
import zlib
from collections.abc import Iterable, Sequence
from pathlib import Path

from farfield.errors import FileFormatError

JOURNAL_NAME = ".farfield_convert.jsonl"


class Journal:
    """One line a finished unit: its name, the state of its sources, and size and CRC-32 of each file written.

    Args:
        folder: Target of the conversion; made if it is missing.
        overwrite: Forget what was written before.
    """

    def __init__(self, folder: Path, *, overwrite: bool = False) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.path = folder, folder / JOURNAL_NAME
        self._done: dict[str, tuple[str, dict[str, list[int]]]] = {}
        if overwrite:
            self.path.unlink(missing_ok=True)
        elif self.path.is_file():
            self._read()

    def _read(self) -> None:
        lines = self.path.read_bytes().split(b"\n")
        whole = lines[:-1]  # a line without its end was cut off by an interruption
        for number, line in enumerate(whole, start=1):
            try:
                entry = json.loads(line)
                name, source = str(entry["unit"]), str(entry["source"])
                files = {str(path): [int(size), int(crc)] for path, (size, crc) in entry["files"].items()}
            except (ValueError, KeyError, TypeError, AttributeError) as error:
                mend = "Delete it, or pass --overwrite, to convert anew."
                raise FileFormatError(
                    self.path, where=f"line {number}", expected="a journal entry", found=str(error), mend=mend
                ) from error
            self._done[name] = (source, files)
        if lines[-1]:
            self.path.write_bytes(b"".join(line + b"\n" for line in whole))

    def has(self, unit: str, sources: Iterable[Path], setting: str) -> bool:
        """Whether a unit was written from these very sources with this setting, and its files are intact."""
        return not self.fault(unit, sources, setting)

    def fault(self, unit: str, sources: Iterable[Path], setting: str) -> str:
        """Why a unit must be written again; empty if it need not."""
        if unit not in self._done:
            return "not written"
        source, files = self._done[unit]
        if source != state_of(sources, setting):
            return "written from another source or with other settings"
        broken = [name for name, mark in files.items() if not self._intact(name, *mark)]
        return f"damaged or missing: {', '.join(broken)}" if broken else ""

    def _intact(self, name: str, size: int, crc: int) -> bool:
        path = self.folder / name
        return path.is_file() and path.stat().st_size == size and zlib.crc32(path.read_bytes()) == crc

    def add(self, unit: str, sources: Iterable[Path], setting: str, written: Sequence[Path]) -> None:
        """Record a finished unit; ``written`` lie below the folder."""
        files = {path.relative_to(self.folder).as_posix(): _mark(path) for path in written}
        source = state_of(sources, setting)
        with self.path.open("a", encoding="utf-8") as handle:
            handle.write(json.dumps({"unit": unit, "source": source, "files": files}) + "\n")
        self._done[unit] = (source, files)


def state_of(sources: Iterable[Path], setting: str) -> str:
    """Digest of the sources' names, sizes and times of change, and of what else decides the result."""
    digest = hashlib.sha256(setting.encode())
    for path in sources:
        status = path.stat()
        digest.update(f"\0{path.name}\0{status.st_size}\0{status.st_mtime_ns}".encode())
    return digest.hexdigest()[:32]


def _mark(path: Path) -> list[int]:
    return [path.stat().st_size, zlib.crc32(path.read_bytes())]
