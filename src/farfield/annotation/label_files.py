"""The label files beneath the edits: what they held before the first one, and which states of each are known."""

import hashlib
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from farfield.datasets.edits import Record
from farfield.datasets.labels import BoxLabel, LabelFormat
from farfield.errors import DatasetError
from farfield.files.atomic import read_bytes, write_bytes
from farfield.frame import Key

ORIGINAL = "original"
MISSING = "missing"


def digest(data: bytes | None) -> str:
    """What a file's state is recognised by; that it is missing is one too."""
    return MISSING if data is None else hashlib.sha256(data).hexdigest()


class LabelFiles:
    """Labels as the files had them before the first edit, frame by frame.

    Edits name objects by their places in that state, so it is kept: before a file is first written to, a copy goes to
    ``original/`` beside the journal. The journal has the digest of each file at its first edit and after each save. A
    file in a state that is none of these was changed by another program: it is refused, as edits could hit other
    objects, and a save would undo what the other program did.

    Args:
        files: The format, bound to its data set.
        keys: The data set's frames.
        folder: The journal's folder.
        root: The data set's folder: names of label files are relative to it, where all stand in it.
    """

    def __init__(self, files: LabelFormat, keys: Sequence[Key], folder: Path, root: Path) -> None:
        self.format, self.folder = files, folder
        self.path_of: dict[Key, Path] = {key: files.path(key) for key in keys}
        self.keys_of: dict[Path, list[Key]] = {}
        for key, path in self.path_of.items():
            self.keys_of.setdefault(path, []).append(key)
        self.root = root
        if not all(path.is_relative_to(root) for path in self.keys_of):
            self.root = Path(os.path.commonpath({str(path.parent) for path in self.keys_of}))
        self._known: dict[str, list[str]] = {}
        self._labels: dict[Key, tuple[BoxLabel, ...]] = {}

    def relative(self, path: Path) -> str:
        """A label file's name below the folder that holds all of them."""
        return path.relative_to(self.root).as_posix()

    def take(self, record: Record) -> None:
        """Learn from an edit which states of files there were: ``data`` holds ``files``."""
        for name, state in (record.data or {}).get("files", {}).items():
            self._known.setdefault(name, []).append(str(state))

    def labels(self, key: Key) -> tuple[BoxLabel, ...]:
        """A frame's labels before the first edit, in the file's order.

        Raises:
            FileFormatError: If the file is damaged.
            DatasetError: If it was changed by another program since edits were made, or there is no such frame.
        """
        if key not in self.path_of:
            raise DatasetError(f"expected a frame of the data set, got {'/'.join(key)}")
        if key not in self._labels:
            path = self.path_of[key]
            data = self.before(path)
            keys = self.keys_of[path]
            frames = {} if data is None else self.format.parse(data, path, keys)
            self._labels |= {frame_key: tuple(frames.get(frame_key, ())) for frame_key in keys}
        return self._labels[key]

    def before(self, path: Path) -> bytes | None:
        """A file's bytes before the first edit; None where there was no file.

        Raises:
            DatasetError: If the file, or the copy of what it was, is in a state that nobody knows.
        """
        data = _read(path)
        digests = self._known.get(self.relative(path))
        if digests is None:
            return data
        if digest(data) not in digests:
            raise DatasetError(
                f"{path}: was changed by another program since it was annotated here, and edits could hit other "
                f"objects. Put back the file as it was (a copy of its first state lies in {self.folder / ORIGINAL}, "
                "once it was saved), or move the journal's folder away to begin anew from the file as it is."
            )
        if digest(data) == digests[0]:
            return data
        if digests[0] == MISSING:
            return None
        copy = _read(self.copy_of(path))
        if digest(copy) != digests[0]:
            raise DatasetError(f"{self.copy_of(path)}: expected the file as it was before the first edit; it differs")
        return copy

    def copy_of(self, path: Path) -> Path:
        """Where the copy of a file's first state stands, once the file was written to."""
        return self.folder / ORIGINAL / self.relative(path)

    def keep_original(self, path: Path) -> None:
        """Copy a file's first state, unless that was done or there was no file."""
        data, copy = self.before(path), self.copy_of(path)
        if data is not None and not copy.is_file():
            copy.parent.mkdir(parents=True, exist_ok=True)
            write_bytes(copy, data)

    def state(self, key: Key) -> dict[str, Any]:
        """What an edit of a frame notes about its file, where nothing is known of that yet; else nothing."""
        path = self.path_of[key]
        name = self.relative(path)
        if name in self._known:
            return {}
        self.labels(key)
        return {name: digest(self.before(path))}

    def missing(self) -> bool:
        """Whether no label file stood there before the first edit, so that all are of the annotators' making."""
        return all(self._was_missing(path) for path in self.keys_of)

    def _was_missing(self, path: Path) -> bool:
        digests = self._known.get(self.relative(path))
        return not path.is_file() if digests is None else digests[0] == MISSING

    def of(self, keys: Iterable[Key]) -> dict[Path, list[Key]]:
        """The files of some frames, each with those frames."""
        files: dict[Path, list[Key]] = {}
        for key in keys:
            files.setdefault(self.path_of[key], []).append(key)
        return files


def _read(path: Path) -> bytes | None:
    return read_bytes(path) if path.is_file() else None
