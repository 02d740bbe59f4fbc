"""Where label files are written, and in which format."""

import re
import zipfile
from pathlib import Path
from typing import NamedTuple

from farfield.annotation.saving import export_labels, save_copy, save_in_place, save_place
from farfield.annotation.store import Author, Store
from farfield.datasets.labels.formats import label_files_in
from farfield.errors import ConfigError
from farfield.studio.options import StudioSettings

FORMATS = ("boxes-csv", "openlabel", "sustechpoints", "cvat")
"""Of any data set, beside its own."""
_DOTS = re.compile(r"^\.+$")


class SaveSummary(NamedTuple):
    """What a save wrote: how many files, where in words, the number of the journal's note."""

    files: int
    folder: str
    seq: int


def place_of(store: Store, settings: StudioSettings) -> Path | None:
    """Where saves go: None for the label files in their places."""
    if settings.out is not None:
        return settings.out
    return None if settings.write else save_place(store)


def save(
    store: Store, settings: StudioSettings, author: Author, id: str, folder: str | None, format: str
) -> SaveSummary:
    """Write the label files as the annotation stands.

    Args:
        store: The annotation.
        settings: What the studio was started with.
        author: Who saves.
        id: The client's name of the save.
        folder: A name beside the usual place; None for the usual place.
        format: Another format than the labels' own; empty for their own.

    Raises:
        FarfieldError: If a box cannot be written in the format, or the folder holds something else.
    """
    place = place_of(store, settings)
    format = format or settings.to
    if folder is not None:
        place = _beside(store, folder, place)
    if format and format != store.files.format.name:
        target = place or store.folder / "saved"
        target = target / f"labels-{format}"
        made = export_labels(store, _in(store, target, format), store.keys)
        return SaveSummary(len(made), target.name, store.state.seq)
    if place is None:
        saved = save_in_place(store, author, id)
        return SaveSummary(len(saved.files), "the data set's label files", saved.done.record.seq)
    saved = save_copy(store, author, id, place)
    return SaveSummary(len(saved.files), place.name, saved.done.record.seq)


def _beside(store: Store, name: str, place: Path | None) -> Path:
    """A folder of a name beside the usual place, never outside of it."""
    parent = (place.parent if place is not None else store.folder).resolve()
    found = (parent / name).resolve()
    if _DOTS.match(name) or not found.is_relative_to(parent) or found == parent:
        raise ConfigError(f"save: expected the name of a folder, got {name!r}")
    return found


def _in(store: Store, folder: Path, format: str):  # type: ignore[no-untyped-def]
    if format not in FORMATS:
        raise ConfigError(f"format: expected one of {', '.join(FORMATS)}, got {format!r}")
    path = folder / "labels.csv" if format == "boxes-csv" else folder
    return label_files_in(path, format, reference=store.data[0].reference)


def pack(store: Store, format: str, frames: tuple[int, ...], folder: Path, target: Path) -> int:
    """Write frames in a format and pack the files; gives how many there are.

    Args:
        store: The annotation.
        format: One of :data:`FORMATS`.
        frames: Numbers of the frames; none for all.
        folder: Where the files are made.
        target: The ZIP file.
    """
    keys = [store.keys[index] for index in frames if index < len(store.keys)] if frames else list(store.keys)
    made = export_labels(store, _in(store, folder, format), keys)
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as packed:
        for path in made:
            packed.write(path, path.relative_to(folder))
    return len(made)
