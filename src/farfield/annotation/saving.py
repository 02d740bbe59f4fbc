"""Label files from the annotation as it stands: in their places, in a new folder, or in another format.

Files are always made from what they held before the first edit, so that lines that did not change, or were changed
back, keep their bytes.
"""

import os
import re
import zipfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from farfield.annotation.journal import LOCK
from farfield.annotation.label_files import ORIGINAL, digest
from farfield.annotation.schema import SCHEMA
from farfield.annotation.store import Author, EditResult, Store, no_change
from farfield.datasets.edits import JOURNAL
from farfield.datasets.labels import BoxLabel, LabelFormat
from farfield.datasets.labels.formats import forms_in_a_folder, label_files_in
from farfield.errors import ConfigError
from farfield.files.atomic import move_into_place, read_bytes, write_bytes, write_text
from farfield.files.locking import locked_part
from farfield.files.outputs import check_writable
from farfield.frame import Key
from farfield.vocabulary.counts import count_of

SAVE = "save"
FORMATS = forms_in_a_folder()
"""In which labels of any data set can be saved, beside its own."""
MARK = ".farfield-saved"
WRITTEN = ("edited", "accepted")
"""States of boxes that label files get; proposals that nobody accepted, and rejected ones, stay in the journal."""


class UnwrittenBox(NamedTuple):
    """A box that its label file cannot hold: that file keeps what it held, and the journal keeps the box.

    Args:
        key: The frame.
        name: The box; empty where no single one is to blame.
        sentence: Why.
    """

    key: Key
    name: str
    sentence: str


class SavedLabels(NamedTuple):
    """What a save wrote.

    Args:
        folder: Where.
        files: The files that were written; those that hold the right bytes already are left alone.
        edit: The journal's note of it.
        unwritten: Boxes for which a file was left as it was.
    """

    folder: Path
    files: tuple[Path, ...]
    edit: EditResult
    unwritten: tuple[UnwrittenBox, ...] = ()


class SaveSummary(NamedTuple):
    """What a save wrote: how many files, where in words, the number of the journal's note, and what it could not."""

    files: int
    folder: str
    seq: int
    unwritten: tuple[UnwrittenBox, ...] = ()


class UnwrittenError(ConfigError):
    """Some boxes cannot be written in the format; all other label files were written.

    Args:
        summary: What was written, and which boxes were not.
    """

    def __init__(self, summary: SaveSummary) -> None:
        self.summary = summary
        lines = [f"frame {'/'.join(key)}, box {name or '?'}: {text}" for key, name, text in summary.unwritten[:5]]
        more = f" and {len(summary.unwritten) - 5} more" if len(summary.unwritten) > 5 else ""
        super().__init__(
            f"{count_of(len(summary.unwritten), 'box', 'boxes')} could not be "
            "written; their label files stay as they were, and "
            f"{summary.files} others were written: {'; '.join(lines)}{more}"
        )

    def __reduce__(self) -> tuple[type["UnwrittenError"], tuple[SaveSummary]]:
        return UnwrittenError, (self.summary,)


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
        UnwrittenError: If boxes cannot be written in the format, once the files of all others are written.
        FarfieldError: If the folder holds something else, or cannot be written to.
    """
    target = save_sibling(store, folder, target)
    try:
        summary = _saved(store, author, id, target, format)
    except OSError as error:
        reason = f"{error.strerror or error}{f' ({Path(str(error.filename)).name})' if error.filename else ''}"
        fix = "Make room, or name a folder that can be written to, and save again: the journal has all edits."
        raise ConfigError(f"save: the label files could not be written: {reason}. {fix}") from error
    if summary.unwritten:
        raise UnwrittenError(summary)
    return summary


def _saved(store: Store, author: Author, id: str, target: Path | None, format: str) -> SaveSummary:
    if format and format != store.files.format.name:
        saved = save_as(store, author, id, save_folder_of(store, target, format), format)
    elif target is None:
        saved = save_in_place(store, author, id)
    else:
        saved = save_copy(store, author, id, target)
    folder = save_words(store, target, format)
    return SaveSummary(len(saved.files), folder, saved.edit.record.seq, saved.unwritten)


def save_folder_of(store: Store, target: Path | None, format: str) -> Path:
    """The folder of labels in another format than their own, in the usual one or beside the journal."""
    return (target or store.folder / "saved") / f"labels-{format}"


def save_words(store: Store, target: Path | None, format: str) -> str:
    """Where a save goes, in words; arguments as of :func:`save`."""
    if format and format != store.files.format.name:
        return save_folder_of(store, target, format).name
    return "the data set's label files" if target is None else target.name


def unwritten_in(store: Store, *, target: Path | None, folder: str | None = None, format: str = "") -> int:
    """How many edits of boxes the label files of a save lack; arguments as of :func:`save`."""
    target, own = save_sibling(store, folder, target), store.files.format.name
    if format and format != own:
        return store.unwritten_in(_noted(save_folder_of(store, target, format)), format)
    return store.unwritten_in("" if target is None else _noted(target), own)


def _noted(folder: Path) -> str:
    """A folder as the journal's note of a save has it."""
    return str(folder.resolve())


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


def save_sibling(store: Store, name: str | None, target: Path | None) -> Path | None:
    """A folder of a name beside the usual one, never outside of it; the usual one without a name.

    Raises:
        ConfigError: If the name is that of no folder.
    """
    if name is None:
        return target
    parent = (target.parent if target is not None else store.folder).resolve()
    folder = (parent / name).resolve()
    if re.fullmatch(r"\.+", name) or not folder.is_relative_to(parent) or folder == parent:
        raise ConfigError(f"save: expected the name of a folder, got {name!r}")
    if _holds_own_files(store, folder):
        raise ConfigError(f"save: expected the name of a folder, got {name!r}, which the studio needs. Choose another.")
    return folder


def _holds_own_files(store: Store, folder: Path) -> bool:
    """Whether a folder is the journal's or a name within it that the annotation itself uses, in any case of letters."""
    journal = store.folder.resolve()
    if not folder.is_relative_to(journal) or folder == journal:
        return journal.is_relative_to(folder)
    first = folder.relative_to(journal).parts[0].casefold()
    labels = {path.name.casefold() for path in store.files.keys_of if path.parent == store.folder}
    return first in {ORIGINAL, LOCK, SCHEMA, *labels} or first.startswith(JOURNAL)


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


class _RenderedFiles(NamedTuple):
    """The bytes that files are to get (None: no file), boxes for which one cannot be made, and up to which edit."""

    files: dict[Path, bytes | None]
    unwritten: list[UnwrittenBox]
    seq: int


def _rendered_files(store: Store) -> _RenderedFiles:
    """The files with edits."""
    files: dict[Path, bytes | None] = {}
    unwritten: list[UnwrittenBox] = []
    with store.lock:
        store.check_whole()
        for path, keys in store.files.of(store.state.frames()).items():
            try:
                files[path] = rendered(store, path, keys)
            except ConfigError as error:
                labels = {
                    key: [label for label in written_labels(store, key) if label.id in store.state.touched(key)]
                    for key in keys
                }
                unwritten += _unwritten(store.files.format, path, labels, error)
        return _RenderedFiles(files, unwritten, store.state.seq)


def _unwritten(
    format: LabelFormat, path: Path, labels: Mapping[Key, Sequence[BoxLabel]], error: ConfigError
) -> list[UnwrittenBox]:
    """The boxes that keep a file from being made: those that cannot be written alone; else the frames as they are."""
    boxes: list[UnwrittenBox] = []
    for key, label in ((key, label) for key, rows in labels.items() for label in rows):
        try:
            format.render(None, path, {key: [replace(label, id="n0")]})
        except ConfigError as fault:
            boxes.append(UnwrittenBox(key, label.id, str(fault)))
    return boxes or [UnwrittenBox(next(iter(labels)), "", str(error))]


def _note(
    store: Store, author: Author, id: str, rendered_files: _RenderedFiles, where: str, format: str, **data: object
) -> EditResult:
    """Note in the journal up to which edit the labels are written, where, in which format, and what is left out."""
    written = {"seq": rendered_files.seq, "folder": where, "format": format, "left": len(rendered_files.unwritten)}
    with store.lock:
        note = store.edit(author, _free_id(store, id), SAVE, no_change, data={"written": written, **data})
    note.saved.result()
    return note


def _free_id(store: Store, id: str) -> str:
    """The name of a save's note: a save that comes again writes what is there now, and is noted once more."""
    return id if store.journal.seq_of(id) is None else f"{id[:48]}.{store.state.seq + 1}"


def save_in_place(store: Store, author: Author, id: str) -> SavedLabels:
    """Write what changed into the label files; before the first write of each, its copy goes to ``original/``.

    The journal knows of the new state before the file has it: a save that is interrupted leaves files of which each is
    in the state before or in the one after, and the next one finishes it.

    Args:
        store: The annotation.
        author: Who saves.
        id: The client's name of the save.

    Returns:
        What was written. A file whose boxes cannot all be written stays as it was, and the boxes are named.

    Raises:
        DatasetError: If a file was changed by another program.
        OSError: If a file cannot be written.
    """
    with store.saving:
        with store.lock:  # editing goes on while the files are written
            rendered_files = _rendered_files(store)
            present = {path: read_bytes(path) if path.is_file() else None for path in rendered_files.files}
            files = {path: data for path, data in rendered_files.files.items() if data != present[path]}
            for path in files:
                store.files.keep_original(path)
            states = {store.files.relative(path): digest(data) for path, data in files.items()}
            if states:
                note = store.edit(author, _free_id(store, id), SAVE, no_change, data={"files": states})
        if states:
            note.saved.result()
        for path, data in files.items():
            _write_or_remove(path, data)
        note = _note(store, author, id, rendered_files, "the data set's label files", store.files.format.name)
    return SavedLabels(store.files.root, tuple(files), note, tuple(rendered_files.unwritten))


def save_copy(store: Store, author: Author, id: str, folder: Path) -> SavedLabels:
    """Write all label files of the data set into a folder of their own; the data set's stay as they are.

    Args:
        store: The annotation.
        author: Who saves.
        id: The client's name of the save.
        folder: A folder that is new, empty, or of an earlier save of this data set.

    Returns:
        What was written. A file whose boxes cannot all be written is left out, or as it was, and the boxes are named.

    Raises:
        ConfigError: If the folder holds something else.
    """
    with store.saving:
        _claim(folder, store)
        rendered_files = _rendered_files(store)
        touched = store.files.of(store.state.frames())
        written = [
            path
            for path in store.files.keys_of
            if (path in rendered_files.files or path not in touched)
            and _updated(folder / store.files.relative(path), _current(store, path, rendered_files.files))
        ]
        if written:
            sync()
        data = {"folder": _noted(folder), "count": len(written)}
        note = _note(store, author, id, rendered_files, folder.name, store.files.format.name, **data)
        written = [folder / store.files.relative(path) for path in written]
    return SavedLabels(folder, tuple(written), note, tuple(rendered_files.unwritten))


def save_as(store: Store, author: Author, id: str, folder: Path, format: str) -> SavedLabels:
    """Write all frames in another format, into files of their own.

    Args:
        store: The annotation.
        author: Who saves.
        id: The client's name of the save.
        folder: Where the files go.
        format: One of :data:`FORMATS`.

    Returns:
        What was written. A file whose boxes cannot all be written is left out, or as it was, and the boxes are named.

    Raises:
        ConfigError: If there is no such format.
    """
    labels = _label_files(store, folder, format)
    with store.saving:
        with store.lock:
            frames = {key: written_labels(store, key) for key in store.keys}
            rendered_files = _RenderedFiles({}, [], store.state.seq)
        parts: dict[Path, dict[Key, Sequence[BoxLabel]]] = {}
        for key, rows in frames.items():
            parts.setdefault(labels.path(key), {})[key] = rows
        for path, part in parts.items():
            try:
                rendered_files.files[path] = labels.render(None, path, _as_new(part))
            except ConfigError as error:
                rendered_files.unwritten.extend(_unwritten(labels, path, part, error))
        for path, data in rendered_files.files.items():
            _write_or_remove(path, data)
        count = len(rendered_files.files)
        note = _note(store, author, id, rendered_files, folder.name, format, folder=_noted(folder), count=count)
    return SavedLabels(folder, tuple(rendered_files.files), note, tuple(rendered_files.unwritten))


def _as_new(frames: Mapping[Key, Sequence[BoxLabel]]) -> dict[Key, Sequence[BoxLabel]]:
    """Boxes under the names that a file gives those that are new to it."""
    return {key: [replace(label, id=f"n{row}") for row, label in enumerate(rows)] for key, rows in frames.items()}


def _current(store: Store, path: Path, rendered_files: Mapping[Path, bytes | None]) -> bytes | None:
    with store.lock:
        store.check_whole()
        return rendered_files[path] if path in rendered_files else store.files.before(path)


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
        partial, handle = locked_part(target)  # nobody could lay a link in its place
        try:
            with open(handle, "wb", closefd=False) as file:
                file.write(data)
            move_into_place(partial, target)
        finally:
            os.close(handle)
            partial.unlink(missing_ok=True)
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
            parts.setdefault(labels.path(key), {})[key] = written_labels(store, key)
    for path, labels_of in parts.items():
        _write_or_remove(path, labels.render(None, path, _as_new(labels_of)))
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
    if store.folder.parent == root.resolve():
        with suppress(OSError, ConfigError):  # read-only, full, or something else of the name
            check_writable(beside.resolve())
            return beside
    return store.folder / "saved"


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
