"""Which format of label files a data set has."""

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from farfield.datasets.base import Dataset
from farfield.datasets.labels.contract import LabelFormat
from farfield.errors import DatasetError

_OF_READER = {
    "kradar": "farfield.datasets.kradar.label_format:KRadarLabelFormat",
    "cirrus": "farfield.datasets.cirrus.label_format:CirrusLabelFormat",
    "kitti": "farfield.datasets.kitti.label_format:KittiLabelFormat",
    "kitti_raw": "farfield.datasets.kitti.raw:label_format",
    "sustechpoints": "farfield.datasets.sustechpoints:label_format",
    "cvat": "farfield.datasets.cvat:label_format",
}
"""Imported when asked: readers know this room, and not the other way round."""
_IN_A_FOLDER = {
    "boxes-csv": "farfield.datasets.labels.csv_boxes:CsvLabels",
    "openlabel": "farfield.datasets.labels.tool_labels:OpenLabels",
    "sustechpoints": "farfield.datasets.labels.tool_labels:SustechLabels",
    "cvat": "farfield.datasets.labels.tool_labels:DatumaroLabels",
}


def label_format(data: Dataset) -> LabelFormat | None:
    """The label files that a data set's own layout has, or None where Farfield does not edit them.

    Args:
        data: The data set; its maps do not matter, as label files stand in the reader's own coordinates.
    """
    name = _OF_READER.get(data.unwrapped.name)
    found: LabelFormat | None = None if name is None else _load(name)(data.unwrapped)
    return found


def label_files_in(folder: Path, name: str, *, reference: str = "") -> LabelFormat:
    """Label files of any data set in a folder of their own.

    Args:
        folder: The folder; for ``boxes-csv`` the file.
        name: ``boxes-csv``, ``openlabel``, ``sustechpoints`` or ``cvat``.
        reference: Sensor in whose coordinates the boxes stand; ``boxes-csv`` names it.

    Raises:
        DatasetError: If there is no such format.
    """
    if name not in _IN_A_FOLDER:
        raise DatasetError(f"label files: expected one of {', '.join(_IN_A_FOLDER)}; got {name!r}")
    named = {"reference": reference} if reference and name == "boxes-csv" else {}
    found: LabelFormat = _load(_IN_A_FOLDER[name])(folder, **named)
    return found


def _load(name: str) -> Callable[..., Any]:
    module, _, thing = name.partition(":")
    loaded: Callable[..., Any] = getattr(import_module(module), thing)
    return loaded
