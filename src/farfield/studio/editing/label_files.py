"""The label files beneath the edits: what they hold under which names, and which state of each file is known."""

import hashlib
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from farfield.datasets.edits import Record
from farfield.datasets.labels import BoxLabel, LabelFormat
from farfield.errors import DatasetError
from farfield.files.atomic import read_bytes
from farfield.frame import Key

Names = Mapping[Key, Sequence[str]]
MISSING = "missing"


def digest(data: bytes | None) -> str:
    """What a file is recognised by; a missing one too."""
    return MISSING if data is None else hashlib.sha256(data).hexdigest()


class LabelFiles:
    """Labels of the files, frame by frame, under names that stay the same when a file is saved.

    A file's objects are called by their place, ``"0"``, ``"1"``... When a file is saved, objects go and come, and
    places move: the journal keeps which object stands where in each state of each file that was written. A file in a
    state that nobody knows was changed by another program; edits of it are refused instead of hitting other objects.

    Args:
        files: The format, bound to its data set.
        keys: The data set's frames.
    """

    def __init__(self, files: LabelFormat, keys: Sequence[Key]) -> None:
        self.format = files
        self.path_of: dict[Key, Path] = {key: files.path(key) for key in keys}
        self.keys_of: dict[Path, list[Key]] = {}
        for key, path in self.path_of.items():
            self.keys_of.setdefault(path, []).append(key)
        folders = {str(path.parent) for path in self.keys_of}
        self.root = Path(os.path.commonpath(folders)) if folders else Path()
        self._known: dict[str, dict[str, dict[Key, list[str]]]] = {}
        self._labels: dict[Key, tuple[BoxLabel, ...]] = {}
        self._digests: dict[Path, str] = {}

    def relative(self, path: Path) -> str:
        """A label file's name below the folder that holds all of them."""
        return path.relative_to(self.root).as_posix()

    def take(self, record: Record) -> None:
        """Learn from an edit which states of files there were: ``data`` holds ``files``."""
        for name, state in (record.data or {}).get("files", {}).items():
            names = {(sequence, frame): list(ids) for sequence, frame, ids in state.get("names", ())}
            latest = dict(next(reversed(self._known.get(name, {"": {}}).values())))
            self._known.setdefault(name, {})[state["digest"]] = latest | names

    def labels(self, key: Key) -> tuple[BoxLabel, ...]:
        """A frame's labels as its file holds them, in the file's order.

        Raises:
            FileFormatError: If the file is damaged.
            DatasetError: If it was changed by another program since edits were made, or there is no such frame.
        """
        if key not in self.path_of:
            raise DatasetError(f"expected a frame of the data set, got {'/'.join(key)}")
        if key not in self._labels:
            self._load(self.path_of[key])
        return self._labels[key]

    def _load(self, path: Path) -> None:
        data = read_bytes(path) if path.is_file() else None
        self._digests[path] = digest(data)
        names = self._names(path)
        keys = self.keys_of[path]
        found = {} if data is None else self.format.parse(data, path, keys)
        for key in keys:
            self._labels[key] = _named(found.get(key, ()), names.get(key), path)

    def _names(self, path: Path) -> Names:
        known = self._known.get(self.relative(path), {})
        state = self._digests[path]
        if known and state not in known:
            raise DatasetError(
                f"{path}: was changed by another program since it was annotated here, and edits could hit other "
                "objects. Put back the file as it was (a copy from before the first save lies in .farfield-studio/"
                "original), or move .farfield-studio away to begin anew from the file as it is."
            )
        return known.get(state, {})

    def state(self, key: Key) -> dict[str, Any]:
        """What an edit of a frame notes about its file, where nothing is known of that yet; else nothing."""
        path = self.path_of[key]
        name = self.relative(path)
        self.labels(key)
        return {} if name in self._known else {name: {"digest": self._digests[path]}}

    def forget(self, paths: Iterable[Path]) -> None:
        """Read files again when they are next asked for, such as after a save."""
        for path in paths:
            self._digests.pop(path, None)
            for key in self.keys_of[path]:
                self._labels.pop(key, None)


def _named(labels: Sequence[BoxLabel], names: Sequence[str] | None, path: Path) -> tuple[BoxLabel, ...]:
    if names is None:
        return tuple(labels)
    if len(names) != len(labels):
        raise DatasetError(f"{path}: expected {len(names)} objects, as were saved, got {len(labels)}")
    pairs = zip(labels, names, strict=True)
    return tuple(label if label.id == name else replace(label, id=name) for label, name in pairs)
