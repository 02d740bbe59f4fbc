"""The store of a data set: which label files, where the journal stands, what may be annotated."""

from pathlib import Path

from farfield.datasets.base import Dataset
from farfield.datasets.edits import journal_folder
from farfield.datasets.edits.places import user_folder
from farfield.datasets.labels import BoxLabel, LabelFormat
from farfield.datasets.labels.choosing import label_files_in, label_format
from farfield.files.atomic import write_bytes
from farfield.studio.editing.schema import AttributeSettings, ClassSettings, Extent, Schema, fastest
from farfield.studio.editing.store import Store
from farfield.studio.messages.rows import ClassSpec
from farfield.studio.settings import StudioSettings
from farfield.studio.showing.classes import annotated_classes
from farfield.studio.showing.rows import numbers

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
        labels = _copied(data, folder)
    classes = annotated_classes(data.name, settings.classes)
    schema = Schema(
        extent=settings.extent or known_extent(data),
        classes={spec.name: _class(spec) for spec in classes},
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


def _class(spec: ClassSpec) -> ClassSettings:
    types = {each.name: each.size for each in spec.types}
    return ClassSettings(size_m=spec.size, types=types, fastest_m_s=fastest(spec.name))


def _copied(data: Dataset, folder: Path) -> LabelFormat:
    """Labels in a CSV of their own, begun with what the data set has."""
    path = folder / START
    labels = label_files_in(path, "boxes-csv")
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
