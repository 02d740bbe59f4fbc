"""Label files from the annotation as it stands: in their places, in a new folder, or in another format.

Files are always made from what they held before the first edit, so that lines that did not change, or were changed
back, keep their bytes.
"""

import os
import re
import zipfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from farfield.annotation.label_files import digest
from farfield.annotation.store import Author, EditResult, Store, no_change
from farfield.datasets.labels import BoxLabel, LabelFormat
from farfield.datasets.labels.formats import label_files_in
from farfield.errors import ConfigError
from farfield.files.atomic import read_bytes, write_bytes, write_text
from farfield.frame import Key

SAVE = "save"
FORMATS = ("boxes-csv", "openlabel", "sustechpoints", "cvat")
"""In which labels of any data set can be saved, beside its own."""
MARK = ".farfield-saved"
WRITTEN = ("edited", "accepted")
"""States of boxes that label files get; proposals that nobody accepted, and rejected ones, stay in the journal."""


class SavedLabels(NamedTuple):
    """What a save wrote.

    Args:
        folder: Where.
        files: The files that were written; those that hold the right bytes already are left alone.
        edit: The journal's note of it.
    """

    folder: Path
    files: tuple[Path, ...]
    edit: EditResult


class SaveSummary(NamedTuple):
    """What a save wrote: how many files, where in words, the number of the journal's note."""

    files: int
    folder: str
    seq: int


def save(
    store: Store, author: Author, id: str, *, target: Path | None, folder: str | None = None, format: str = ""
) -> SaveSummary:
    """Write the label files as the annotation stands.

    Args:
        store: The annotation.
        author: Who saves.
        id: The client's name of the save.
        target: The usual folder, see :func:`save_target`; None for the label files in their places.
        folder: A name beside the usual folder; None for the usual one.
        format: Another format than the labels' own; empty for their own.

    Raises:
        FarfieldError: If a box cannot be written in the format, or the folder holds something else.
    """
    if folder is not None:
        target = _sibling(store, folder, target)
    if format and format != store.files.format.name:
        export = (target or store.folder / "saved") / f"labels-{format}"
        paths = export_labels(store, _label_files(store, export, format), store.keys)
        return SaveSummary(len(paths), export.name, store.state.seq)
    if target is None:
        saved = save_in_place(store, author, id)
        return SaveSummary(len(saved.files), "the data set's label files", saved.edit.record.seq)
    saved = save_copy(store, author, id, target)
    return SaveSummary(len(saved.files), target.name, saved.edit.record.seq)


def save_target(store: Store, out: Path | None, *, write: bool = False) -> Path | None:
    """Where saves go: None for the label files in their places.

    Args:
        store: The annotation.
        out: The folder asked for, if any.
        write: Whether the label files in their places were asked for.
    """
    if out is not None:
        return out
    return None if write else save_place(store)


def _sibling(store: Store, name: str, target: Path | None) -> Path:
    """A folder of a name beside the usual one, never outside of it."""
    parent = (target.parent if target is not None else store.folder).resolve()
    folder = (parent / name).resolve()
    if re.fullmatch(r"\.+", name) or not folder.is_relative_to(parent) or folder == parent:
        raise ConfigError(f"save: expected the name of a folder, got {name!r}")
    return folder


def _label_files(store: Store, folder: Path, format: str) -> LabelFormat:
    if format not in FORMATS:
        raise ConfigError(f"format: expected one of {', '.join(FORMATS)}, got {format!r}")
    path = folder / "labels.csv" if format == "boxes-csv" else folder
    return label_files_in(path, format, reference=store.data[0].reference)


def pack(store: Store, format: str, frames: Sequence[int], folder: Path, target: Path) -> int:
    """Write frames in a format and pack the files; gives how many there are.

    Args:
        store: The annotation.
        format: One of :data:`FORMATS`.
        frames: Numbers of the frames; none for all.
        folder: Where the files are made.
        target: The ZIP file.
    """
    keys = [store.keys[index] for index in frames if index < len(store.keys)] if frames else list(store.keys)
    paths = export_labels(store, _label_files(store, folder, format), keys)
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in paths:
            archive.write(path, path.relative_to(folder))
    return len(paths)


def written_labels(store: Store, key: Key) -> tuple[BoxLabel, ...]:
    """The boxes of a frame that a label file gets, in order."""
    return tuple(row.label for row in store.rows(key) if row.label.state in WRITTEN)


def rendered(store: Store, path: Path, keys: Sequence[Key]) -> bytes | None:
    """A label file's bytes as the annotation stands; None where there was none and nothing to write.

    Args:
        store: The annotation.
        path: The file.
        keys: Those of its frames that were touched.
    """
    labels = {key: written_labels(store, key) for key in keys}
    before = store.files.before(path)
    if before is None and not any(labels.values()):
        return None
    return store.files.format.render(before, path, labels)


def changed_files(store: Store) -> dict[Path, bytes | None]:
    """Files whose bytes differ from what stands on the disk, with the bytes that they are to get (None: no file)."""
    files: dict[Path, bytes | None] = {}
    with store.lock:
        for path, keys in store.files.of(store.state.frames()).items():
            data = rendered(store, path, keys)
            present = read_bytes(path) if path.is_file() else None
            if data != present:
                files[path] = data
    return files


def save_in_place(store: Store, author: Author, id: str) -> SavedLabels:
    """Write what changed into the label files; before the first write of each, its copy goes to ``original/``.

    The journal knows of the new state before the file has it: a save that is interrupted leaves files of which each is
    in the state before or in the one after, and the next one finishes it.

    Args:
        store: The annotation.
        author: Who saves.
        id: The client's name of the save.

    Raises:
        ConfigError: If a box cannot be written in the data set's format.
        DatasetError: If a file was changed by another program.
        OSError: If a file cannot be written.
    """
    with store.saving:
        with store.lock:  # editing goes on while the files are written
            files = changed_files(store)
            for path in files:
                store.files.keep_original(path)
            states = {store.files.relative(path): digest(data) for path, data in files.items()}
            note = store.edit(author, id, SAVE, no_change, data={"files": states} if states else None)
        note.saved.result()
        for path, data in files.items():
            _write_or_remove(path, data)
    return SavedLabels(store.files.root, tuple(files), note)


def save_copy(store: Store, author: Author, id: str, folder: Path) -> SavedLabels:
    """Write all label files of the data set into a folder of their own; the data set's stay as they are.

    Args:
        store: The annotation.
        author: Who saves.
        id: The client's name of the save.
        folder: A folder that is new, empty, or of an earlier save of this data set.

    Raises:
        ConfigError: If the folder holds something else, or a box cannot be written in the data set's format.
    """
    with store.saving:
        _claim(folder, store)
        touched = store.files.of(store.state.frames())
        written = [
            path
            for path in store.files.keys_of
            if _updated(folder / store.files.relative(path), _current(store, path, touched.get(path)))
        ]
        if written:
            sync()
        note = store.edit(author, id, SAVE, no_change, data={"folder": str(folder), "count": len(written)})
        written = [folder / store.files.relative(path) for path in written]
    return SavedLabels(folder, tuple(written), note)


def _current(store: Store, path: Path, keys: Sequence[Key] | None) -> bytes | None:
    with store.lock:
        return store.files.before(path) if keys is None else rendered(store, path, keys)


def _updated(target: Path, data: bytes | None) -> bool:
    """Write a file where it differs, without waiting for the disk; whether it did."""
    if data is None or not target.is_file():
        differs = target.is_file() != (data is not None)
    else:
        differs = target.stat().st_size != len(data) or read_bytes(target) != data
    if differs and data is None:
        target.unlink()
    elif differs and data is not None:
        target.parent.mkdir(parents=True, exist_ok=True)
        partial = target.with_name(f".{target.name[:100]}.part")
        partial.write_bytes(data)
        partial.replace(target)
    return differs


def sync() -> None:
    """Wait until all that was written is on the disk: once for thousands of files."""
    if hasattr(os, "sync"):
        os.sync()


def export_labels(store: Store, labels: LabelFormat, keys: Sequence[Key]) -> tuple[Path, ...]:
    """Write frames in another format, into new files.

    Args:
        store: The annotation.
        labels: The format, bound to a folder of its own.
        keys: The frames.

    Returns:
        The files.

    Raises:
        ConfigError: If a box cannot be written in the format.
    """
    parts: dict[Path, dict[Key, Sequence[BoxLabel]]] = {}
    with store.lock:
        for key in keys:
            rows = enumerate(written_labels(store, key))
            parts.setdefault(labels.path(key), {})[key] = [replace(label, id=f"n{row}") for row, label in rows]
    for path, labels_of in parts.items():
        _write_or_remove(path, labels.render(None, path, labels_of))
    return tuple(parts)


def save_place(store: Store) -> Path | None:
    """Where saves go unless something else was said: None for the label files themselves.

    Those are written only where none stood before the first edit; else the labels are somebody's, and saves go beside
    the data set, into ``<folder>-edited``, or beside the journal where that cannot be written.
    """
    if store.files.missing():
        return None
    root = store.files.root
    beside = root.with_name(f"{root.name}-edited")
    inside = store.folder.parent == root.resolve() and os.access(root.resolve().parent, os.W_OK)
    return beside if inside else store.folder / "saved"


def _write_or_remove(path: Path, data: bytes | None) -> None:
    if data is None:
        path.unlink(missing_ok=True)
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, data)


def _claim(folder: Path, store: Store) -> None:
    mark = folder / MARK
    owner = f"{store.data.name} {store.files.root.name}\n"
    if folder.is_dir() and any(folder.iterdir()):
        ours = mark.is_file() and read_bytes(mark, max_bytes=4096).decode(errors="replace") == owner
        if not ours:
            raise ConfigError(
                f"{folder}: expected a new or empty folder, or one of an earlier save of these labels; it holds "
                "something else. Name another."
            )
    folder.mkdir(parents=True, exist_ok=True)
    write_text(mark, owner)
