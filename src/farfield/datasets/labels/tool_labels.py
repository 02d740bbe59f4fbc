"""Label files of annotation tools: OpenLABEL, SUSTechPOINTS, and Datumaro's JSON as CVAT takes it."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

from farfield.datasets.labels.contract import BoxLabel
from farfield.datasets.labels.json_labels import JsonLabels
from farfield.errors import DatasetError
from farfield.files import datumaro, openlabel, supervisely, sustechpoints
from farfield.files.cuboids import Cuboid, CuboidEntry
from farfield.files.json_text import span
from farfield.frame import Key


def file_name(sequence: str) -> str:
    """A sequence's name as that of a file or folder.

    >>> file_name("a/b c"), file_name("..")
    ('a_b_c', '_')
    """
    return "".join(letter if letter.isalnum() or letter in "-_." else "_" for letter in sequence).lstrip(".") or "_"


@dataclass(frozen=True)
class SustechLabels(JsonLabels):
    """``<sequence>/label/<frame>.json`` below a folder, or ``label/<frame>.json`` where it is one scene.

    Args:
        folder: The folder.
        scene: Whether the folder is the scene itself.
    """

    name: ClassVar[str] = "sustechpoints"
    folder: Path
    scene: bool = False

    def path(self, key: Key) -> Path:
        """The file of a frame."""
        return (self.folder if self.scene else self.folder / file_name(key[0])) / "label" / f"{file_name(key[1])}.json"

    def placed(self, data: bytes, path: Path) -> Sequence[CuboidEntry]:
        """All cuboids of the frame."""
        return sustechpoints.parse_sustechpoints(data, path)

    def empty(self) -> str:
        """An empty list."""
        return "[]\n"

    def values(self, cuboid: Cuboid, text: str, place: CuboidEntry | None) -> Mapping[tuple[str | int, ...], Any]:
        """Place, size, yaw, class and track."""
        del text, place
        return sustechpoints.values(cuboid)

    def with_new(self, text: str, cuboid: Cuboid) -> str:
        """An entry more."""
        return sustechpoints.with_new(text, cuboid)


@dataclass(frozen=True)
class OpenLabels(JsonLabels):
    """One OpenLABEL file a sequence, ``<sequence>.json``.

    An object is of one class in all frames: changing it in one changes it in all.

    Args:
        folder: Where the files stand.
    """

    name: ClassVar[str] = "openlabel"
    folder: Path

    def path(self, key: Key) -> Path:
        """The file of a frame's sequence."""
        return self.folder / f"{file_name(key[0])}.json"

    def placed(self, data: bytes, path: Path) -> Sequence[CuboidEntry]:
        """All cuboids of the sequence."""
        return openlabel.parse_openlabel(data, path)

    def empty(self) -> str:
        """A file without frames."""
        return openlabel.format_openlabel([], [])

    def values(self, cuboid: Cuboid, text: str, place: CuboidEntry | None) -> Mapping[tuple[str | int, ...], Any]:
        """The numbers of ``val``, 9 or 10 as they stand."""
        nine = place is not None and span(text, (*place.steps, "val", 9)) is None
        return openlabel.values_of_nine(cuboid) if nine else openlabel.values(cuboid)

    def prepared(self, text: str, place: CuboidEntry | None, cuboid: Cuboid) -> str:
        """The object's class."""
        if place is None or place.cuboid.label == cuboid.label:
            return text
        return openlabel.with_class(text, place.cuboid.track, cuboid.label)

    def with_new(self, text: str, cuboid: Cuboid) -> str:
        """A cuboid more."""
        return openlabel.with_new(text, cuboid)

    def moves(self, old: Cuboid, new: BoxLabel) -> bool:
        """Another track is another object."""
        return old.track != new.track


@dataclass(frozen=True)
class DatumaroLabels(JsonLabels):
    """``<sequence>/annotations/default.json`` below a folder, or one file for all.

    Args:
        folder: The folder, or the one file if its name ends in ``.json``.
    """

    name: ClassVar[str] = "cvat"
    folder: Path

    def path(self, key: Key) -> Path:
        """The file of a frame's sequence."""
        if self.folder.suffix == ".json":
            return self.folder
        return self.folder / file_name(key[0]) / "annotations" / "default.json"

    def placed(self, data: bytes, path: Path) -> Sequence[CuboidEntry]:
        """All cuboids of the sequence."""
        return datumaro.parse_datumaro(data, path)

    def empty(self) -> str:
        """A file without items."""
        return datumaro.format_datumaro([], [])

    def values(self, cuboid: Cuboid, text: str, place: CuboidEntry | None) -> Mapping[tuple[str | int, ...], Any]:
        """Place, size, yaw, class, track and attributes."""
        del place
        return datumaro.values(cuboid, datumaro.class_names(json.loads(text.removeprefix("\ufeff")), self.folder))

    def prepared(self, text: str, place: CuboidEntry | None, cuboid: Cuboid) -> str:
        """A class that the file does not know yet."""
        del place
        return datumaro.with_class(text, cuboid.label)

    def with_new(self, text: str, cuboid: Cuboid) -> str:
        """An annotation more."""
        return datumaro.with_new(text, replace(cuboid, frame=file_name(cuboid.frame)))


@dataclass(frozen=True)
class SuperviselyLabels(JsonLabels):
    """``ann/<cloud file>.json`` of Supervisely's point clouds, one file a cloud.

    A figure belongs to an object, whose key is the track: changing the class of one changes that of all of its figures
    in the file. Tags stay as they are.

    Args:
        paths: The file of each frame, by sequence and frame.
    """

    name: ClassVar[str] = "supervisely"
    paths: Mapping[Key, Path]

    def path(self, key: Key) -> Path:
        """The file of a frame.

        Raises:
            DatasetError: If there is no such frame.
        """
        if key not in self.paths:
            raise DatasetError(f"expected a frame of this data set, got {'/'.join(key)}")
        return self.paths[key]

    def placed(self, data: bytes, path: Path) -> Sequence[CuboidEntry]:
        """All cuboids of the frame."""
        return supervisely.placed_supervisely(data, path)

    def empty(self) -> str:
        """A file without objects."""
        return json.dumps({"description": "", "tags": [], "objects": [], "figures": []}, indent=1) + "\n"

    def values(self, cuboid: Cuboid, text: str, place: CuboidEntry | None) -> Mapping[tuple[str | int, ...], Any]:
        """Place, size and yaw."""
        del text, place
        return supervisely.values(cuboid)

    def prepared(self, text: str, place: CuboidEntry | None, cuboid: Cuboid) -> str:
        """The object's class."""
        if place is None or place.cuboid.label == cuboid.label:
            return text
        return supervisely.with_class(text, place.cuboid.track, cuboid.label)

    def with_new(self, text: str, cuboid: Cuboid) -> str:
        """A figure more."""
        return supervisely.with_new(text, cuboid)

    def moves(self, old: Cuboid, new: BoxLabel) -> bool:
        """Another track is another object."""
        return old.track != new.track
