"""The store of a data set: which label files, where the journal stands, what may be annotated."""

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from farfield.annotation.edits import LARGEST_M
from farfield.annotation.schema import AttributeSettings, ClassSettings, Extent, Schema, Size, fastest
from farfield.annotation.store import Store
from farfield.datasets.base import Dataset
from farfield.datasets.edits import journal_folder
from farfield.datasets.edits.journal import user_folder
from farfield.datasets.labels import BoxLabel, LabelFormat
from farfield.datasets.labels.formats import label_files_in, label_format
from farfield.errors import ConfigError, FarfieldError
from farfield.files.atomic import read_bytes, write_bytes
from farfield.frame import Key
from farfield.studio.messages.rows import ClassSpec
from farfield.studio.options import StudioSettings
from farfield.studio.showing.rows import annotated_classes, numbers, shown_classes
from farfield.vocabulary.classes import CIRRUS_CLASSES

START = "labels.csv"
_LOOKED = 50


def open_store(data: Dataset, settings: StudioSettings) -> Store:
    """Open the annotation of a data set.

    Label files that Farfield can edit are edited; of other data sets what is annotated is copied once into a CSV beside
    the journal, which then holds the labels.

    Args:
        data: The data set without maps.
        settings: What the studio was started with.

    Raises:
        FarfieldError: If another process annotates it, or the journal or its classes are damaged.
    """
    folder = journal_of(data, settings)
    labels = label_format(data)
    if labels is None:
        if settings.write:
            raise ConfigError(
                f"--write: the label files of this {data.name} data set cannot be edited in their places. Leave it "
                f"out: edits are kept in {folder.name}, and saved as boxes-csv, or in another format with --to."
            )
        labels = _copied(data, folder)
    borne = borne_classes(labels, data)
    schema = Schema(
        extent=settings.extent or known_extent(data),
        classes=offered_classes(data.name, settings.classes, borne),
        attributes={name: AttributeSettings(values=tuple(values)) for name, values in labels.attributes.items()},
    )
    return Store(data, labels, folder, schema)


def journal_of(data: Dataset, settings: StudioSettings) -> Path:
    """The folder of the journal: as given, beside the labels, or among the user's data for frames that ship."""
    if settings.edits is not None or data.name == "samples":
        folder = settings.edits or user_folder(data.root)
        folder.mkdir(parents=True, exist_ok=True)
        return folder
    return journal_folder(data.root)


def known_extent(data: Dataset) -> Extent | None:
    """What the boxes of a data set hold, if the first annotated frames tell; None where none is annotated."""
    for index in range(min(len(data), _LOOKED)):
        if data.has_annotation(index):
            annotation = data.annotation(index)
            if annotation is not None and len(annotation):
                return annotation.extent
    return None


def borne_classes(labels: LabelFormat, data: Dataset) -> dict[str, Size]:
    """The classes that boxes of the first frames bear, as their files spell them, with their median sizes."""
    files: dict[Path, list[Key]] = {}
    for key in data.keys[:_LOOKED]:
        files.setdefault(labels.path(key), []).append(key)
    sizes: dict[str, list[tuple[float, ...]]] = {}
    for path, keys in files.items():
        try:
            found = labels.parse(bytes(read_bytes(path)), path, keys) if path.is_file() else {}
        except FarfieldError:
            continue  # said when a frame of the file is opened
        for label in itertools.chain.from_iterable(found.values()):
            if all(0 < length <= LARGEST_M for length in label.box[3:6]):
                sizes.setdefault(label.label, []).append(label.box[3:6])
    return {name: _three(np.median(rows, axis=0)) for name, rows in sizes.items()}


def offered_classes(format_name: str, given: Sequence[str], borne: Mapping[str, Size]) -> dict[str, ClassSettings]:
    """The classes to offer: those given, else the data set's; in Cirrus's words where its boxes bear these.

    What boxes bear beside is offered too, with its own size: else such a box could be moved and no second one drawn.

    Args:
        format_name: Format of the data set.
        given: As of :func:`~farfield.studio.showing.rows.shown_classes`.
        borne: Of :func:`borne_classes`.
    """
    specs = annotated_classes(format_name, given)
    if borne and set(borne) <= set(CIRRUS_CLASSES):
        specs = shown_classes(format_name, given)
    offered = {spec.name: _class(spec) for spec in specs}
    others = {name: size for name, size in borne.items() if name and name not in offered}
    return offered | {name: ClassSettings(size_m=size, fastest_m_s=fastest(name)) for name, size in others.items()}


def _three(values: np.ndarray) -> Size:
    length, width, height = values.tolist()
    return length, width, height


def _class(spec: ClassSpec) -> ClassSettings:
    types = {each.name: each.size for each in spec.types}
    return ClassSettings(size_m=spec.size, types=types, fastest_m_s=fastest(spec.name))


def _copied(data: Dataset, folder: Path) -> LabelFormat:
    """Labels in a CSV of their own, begun with what the data set has."""
    path = folder / START
    labels = label_files_in(path, "boxes-csv", reference=data[0].reference)
    if not path.is_file():
        found = {data.keys[index]: _labels(data, index) for index in range(len(data)) if data.has_annotation(index)}
        if any(found.values()):
            write_bytes(path, labels.render(None, path, found))
    return labels


def _labels(data: Dataset, index: int) -> tuple[BoxLabel, ...]:
    annotation = data.annotation(index)
    if annotation is None:
        return ()
    boxes = annotation.boxes
    tracks = [-1] * len(boxes) if boxes.track_id is None else boxes.track_id.tolist()
    return tuple(
        BoxLabel(
            id=f"n{row}",
            label=str(boxes.label[row]),
            box=numbers(boxes, row),
            track=str(track) if track >= 0 else "",
        )
        for row, track in enumerate(tracks)
    )
