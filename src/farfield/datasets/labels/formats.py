"""Label files that can be edited: one annotated object, what a format must do, and which format a data set has."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from farfield.datasets.base import Dataset
from farfield.errors import DatasetError
from farfield.frame import Key

Numbers = tuple[float, float, float, float, float, float, float]
"""x, y, z of the centre, length, width, height (full sizes, metres), yaw (radians): in the frame's coordinates."""

Value = str | int | float | bool


@dataclass(frozen=True, kw_only=True, slots=True)
class BoxLabel:
    """One annotated object of one frame.

    Args:
        id: Its name within the frame. That of an object which a file holds is its place among the file's objects of
            that frame: ``"0"``, ``"1"``...
        label: Class as the data set spells it.
        box: x, y, z, length, width, height, yaw, see :data:`Numbers`.
        track: Its identity over time as the data set writes it; empty where it has none.
        state: ``proposed``, ``edited``, ``accepted`` or ``rejected``; what a file holds was accepted.
        source: What it was drawn from: ``lidar``, ``radar``, ``camera``, ``interpolated``, ``propagated``,
            ``predicted``, ``detector``; empty where that is not known, as in most files.
        attributes: What else the format says of it, such as K-Radar's ``availability``.
        score: The detector's score of a proposal, or None.
    """

    id: str
    label: str
    box: Numbers
    track: str = ""
    state: str = "accepted"
    source: str = ""
    attributes: Mapping[str, Value] = field(default_factory=dict)
    score: float | None = None

    @property
    def keyframe(self) -> bool:
        """Whether a person stands for it: interpolation and propagation leave it as it is."""
        generated = self.source in ("interpolated", "propagated", "predicted", "detector")
        return self.state in ("edited", "accepted") and not (generated and self.state != "accepted")


@runtime_checkable
class LabelFormat(Protocol):
    """The label files of one data set. An object knows its data set's layout; what it parses comes from the caller.

    ``parse`` and ``render`` are functions of bytes: nothing is read or written by them.
    """

    @property
    def name(self) -> str:
        """The format's name, such as ``kradar-v2.1``."""

    @property
    def attributes(self) -> Mapping[str, tuple[Value, ...]]:
        """Attributes that the files can hold, each with its possible values; none listed: any."""

    def path(self, key: Key) -> Path:
        """The file in which a frame's labels stand or would stand; one file may hold several frames.

        Raises:
            DatasetError: If the data set has no such frame.
        """

    def parse(self, data: bytes, path: Path, keys: Sequence[Key]) -> Mapping[Key, tuple[BoxLabel, ...]]:
        """Labels of the frames in a file, in its order, with ``id`` the place in that order.

        Args:
            data: The file's bytes.
            path: The file, for messages.
            keys: Frames whose labels are wanted; one that the file does not mention has none.

        Raises:
            FileFormatError: If the file is damaged.
        """

    def render(self, data: bytes | None, path: Path, labels: Mapping[Key, Sequence[BoxLabel]]) -> bytes:
        """The file's bytes with other labels in some frames.

        An object whose ``id`` and values (as far as the files hold them) are those that ``parse`` finds in ``data``
        keeps its bytes, as do the header, everything that is no object, and the end of the file. One that changed is
        written anew in its place with ``repr(float)``, one that is missing in ``labels`` goes, and ids that ``data``
        does not have are appended in the order given.

        Args:
            data: The bytes of the file as it stands; None for a new one.
            path: The file, for messages.
            labels: All labels of each frame that changed; frames that are not named stay as they are.

        Raises:
            FileFormatError: If ``data`` is damaged.
            ConfigError: If a label cannot be written in this format, such as one of an unknown class.
        """


# Which format a data set has.

_OF_READER = {
    "kradar": "farfield.datasets.kradar.label_format:KRadarLabelFormat",
    "cirrus": "farfield.datasets.cirrus.label_format:CirrusLabelFormat",
    "kitti": "farfield.datasets.kitti.label_format:label_format",
    "kitti_raw": "farfield.datasets.kitti.raw:label_format",
    "sustechpoints": "farfield.datasets.sustechpoints:label_format",
    "cvat": "farfield.datasets.cvat:label_format",
    "supervisely": "farfield.datasets.supervisely:label_format",
    "xtreme1": "farfield.datasets.xtreme1:label_format",
    "labelcloud": "farfield.datasets.labelcloud:label_format",
    "openlabel": "farfield.datasets.openlabel:label_format",
}
"""Imported when asked: readers know this room, and not the other way round."""
_IN_A_FOLDER = {
    "boxes-csv": "farfield.datasets.labels.line_labels:CsvLabels",
    "openlabel": "farfield.datasets.labels.json_labels:OpenLabels",
    "sustechpoints": "farfield.datasets.labels.json_labels:SustechLabels",
    "cvat": "farfield.datasets.labels.json_labels:DatumaroLabels",
    "xtreme1": "farfield.datasets.labels.tool_labels:Xtreme1Labels",
    "labelcloud": "farfield.datasets.labels.tool_labels:LabelCloudLabels",
}


def readers_saved_in_place() -> tuple[str, ...]:
    """Names of the data sets whose own label files can be edited."""
    return tuple(_OF_READER)


def forms_in_a_folder() -> tuple[str, ...]:
    """Names of the label files that any data set's labels can be saved in."""
    return tuple(_IN_A_FOLDER)


def label_format(data: Dataset) -> LabelFormat | None:
    """The label files that a data set's own layout has, or None where Farfield does not edit them.

    Args:
        data: The data set; its maps do not matter, as label files stand in the reader's own coordinates.
    """
    name = _OF_READER.get(data.unwrapped.name)
    label_files: LabelFormat | None = None if name is None else _load(name)(data.unwrapped)
    return label_files


def label_files_in(folder: Path, name: str, *, reference: str = "") -> LabelFormat:
    """Label files of any data set in a folder of their own.

    Args:
        folder: The folder; for ``boxes-csv`` the file.
        name: ``boxes-csv``, ``openlabel``, ``sustechpoints``, ``cvat``, ``xtreme1`` or ``labelcloud``.
        reference: Sensor in whose coordinates the boxes stand; ``boxes-csv`` names it.

    Raises:
        DatasetError: If there is no such format.
    """
    if name not in _IN_A_FOLDER:
        raise DatasetError(f"label files: expected one of {', '.join(_IN_A_FOLDER)}; got {name!r}")
    named = {"reference": reference} if reference and name == "boxes-csv" else {}
    label_files: LabelFormat = _load(_IN_A_FOLDER[name])(folder, **named)
    return label_files


def _load(name: str) -> Callable[..., Any]:
    module, _, attribute = name.partition(":")
    loaded: Callable[..., Any] = getattr(import_module(module), attribute)
    return loaded
