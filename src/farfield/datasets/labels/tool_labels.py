"""Label files of Supervisely, labelCloud and Xtreme1, edited value by value."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

from farfield.datasets.labels.formats import BoxLabel
from farfield.datasets.labels.json_labels import JsonLabels, file_name
from farfield.errors import DatasetError
from farfield.files import labelcloud, supervisely, xtreme1
from farfield.files.cuboids import Cuboid, CuboidEntry
from farfield.files.json_text import plain_json
from farfield.frame import Key


@dataclass(frozen=True)
class SuperviselyLabels(JsonLabels):
    """``ann/<cloud file>.json`` of Supervisely's point clouds, one file a cloud, or an episode's ``annotation.json``.

    A figure belongs to an object, whose key is the track: changing the class of one changes that of all of its figures
    in the file. Tags stay as they are.

    Args:
        paths: The file of each frame, by sequence and frame.
        axes: Whose axes the boxes have.
        frames: The number of each frame of an episode; empty where a file is of one cloud.
    """

    name: ClassVar[str] = "supervisely"
    paths: Mapping[Key, Path]
    axes: supervisely.Axes = "cvat"
    frames: Mapping[Key, str] = field(default_factory=dict)

    def path(self, key: Key) -> Path:
        """The file of a frame.

        Raises:
            DatasetError: If there is no such frame.
        """
        return _path_of(key, self.paths)

    def placed(self, data: bytes, path: Path) -> Sequence[CuboidEntry]:
        """All cuboids of the file."""
        parse = supervisely.parse_episode if self.frames else supervisely.parse_supervisely
        return parse(data, path, axes=self.axes)

    def of_frame(self, placed: CuboidEntry, key: Key) -> bool:
        """Whether a cuboid is a frame's, of an episode by its number."""
        return placed.cuboid.frame == self.in_file(key)

    def in_file(self, key: Key) -> str:
        """The frame's number."""
        return self.frames.get(key, "")

    def empty(self) -> str:
        """A file without objects."""
        return supervisely.format_episode([], len(self.frames)) if self.frames else supervisely.empty_cloud()

    def values(self, cuboid: Cuboid, text: str, existing: CuboidEntry | None) -> Mapping[tuple[str | int, ...], Any]:
        """Place, size and yaw."""
        del text, existing
        return supervisely.values(cuboid, self.axes)

    def prepared(self, text: str, existing: CuboidEntry | None, cuboid: Cuboid) -> str:
        """The object's class."""
        if existing is None or existing.cuboid.label == cuboid.label:
            return text
        return supervisely.with_class(text, existing.cuboid.track, cuboid.label)

    def with_new(self, text: str, cuboid: Cuboid) -> str:
        """A figure more."""
        return supervisely.with_new(text, cuboid, self.axes, episode=bool(self.frames))

    def moves(self, old: Cuboid, new: BoxLabel) -> bool:
        """Another track is another object."""
        return old.track != new.track


@dataclass(frozen=True)
class LabelCloudLabels(JsonLabels):
    """``<sequence>/labels/<frame>.json`` of labelCloud below a folder, or the files that are named.

    An object keeps its form; a new one takes that of the file's first, or ``vertices``. There is no place for tracks,
    which stay in the journal.

    Args:
        folder: The folder.
        paths: The file of each frame, by sequence and frame; none: by the folder.
        clouds: Name of each file's cloud.
        angles: What rotations count where a file does not show it.
    """

    name: ClassVar[str] = "labelcloud"
    folder: Path
    paths: Mapping[Key, Path] = field(default_factory=dict)
    clouds: Mapping[Path, str] = field(default_factory=dict)
    angles: labelcloud.Angles | None = None

    def path(self, key: Key) -> Path:
        """The file of a frame.

        Raises:
            DatasetError: If the files are named and there is no such frame.
        """
        own = self.folder / file_name(key[0]) / "labels" / f"{file_name(key[1])}.json"
        return _path_of(key, self.paths) if self.paths else own

    def placed(self, data: bytes, path: Path) -> Sequence[CuboidEntry]:
        """All cuboids of the frame."""
        return labelcloud.parse_labelcloud(data, path, angles=self.angles)

    def render(self, data: bytes | None, path: Path, labels: Mapping[Key, Sequence[BoxLabel]]) -> bytes:
        """The file with other labels, which still shows what its rotations count; a new one names its cloud."""
        if data is None:
            data = labelcloud.format_labelcloud([], self.clouds.get(path, "")).encode()
        shown = labelcloud.angles_in(data, path)
        unit = self.angles if shown is None or shown == "either" else shown
        text = super(LabelCloudLabels, replace(self, angles=unit)).render(data, path, labels).decode()
        return labelcloud.with_unit_shown(text, unit).encode()

    def empty(self) -> str:
        """A file without objects."""
        return labelcloud.format_labelcloud([], "")

    def values(self, cuboid: Cuboid, text: str, existing: CuboidEntry | None) -> Mapping[tuple[str | int, ...], Any]:
        """Class, place, size and yaw in the object's form."""
        forms = labelcloud.forms_in(text, self.angles)
        number = 0 if existing is None else int(existing.steps[1])
        return labelcloud.values(cuboid, forms[number])

    def with_new(self, text: str, cuboid: Cuboid) -> str:
        """An object more."""
        forms = labelcloud.forms_in(text, self.angles)
        return labelcloud.with_new(text, cuboid, forms[0] if forms else "vertices")


@dataclass(frozen=True)
class Xtreme1Labels(JsonLabels):
    """``<sequence>/result/<frame>.json`` of Xtreme1 below a folder, or the files that are named.

    Args:
        folder: The folder.
        paths: The file of each frame, by sequence and frame; none: by the folder.
    """

    name: ClassVar[str] = "xtreme1"
    folder: Path
    paths: Mapping[Key, Path] = field(default_factory=dict)

    def path(self, key: Key) -> Path:
        """The file of a frame.

        Raises:
            DatasetError: If the files are named and there is no such frame.
        """
        own = self.folder / file_name(key[0]) / "result" / f"{file_name(key[1])}.json"
        return _path_of(key, self.paths) if self.paths else own

    def placed(self, data: bytes, path: Path) -> Sequence[CuboidEntry]:
        """All cuboids of the frame."""
        return xtreme1.parse_xtreme1(data, path)

    def empty(self) -> str:
        """A file without objects."""
        return xtreme1.format_xtreme1([])

    def values(self, cuboid: Cuboid, text: str, existing: CuboidEntry | None) -> Mapping[tuple[str | int, ...], Any]:
        """Place, size, yaw, class, track and the attributes that stand there."""
        entry: Any = plain_json(text) if existing is not None else None
        for step in () if existing is None else existing.steps:
            entry = entry[step]
        return xtreme1.values(cuboid, entry)

    def with_new(self, text: str, cuboid: Cuboid) -> str:
        """An object more."""
        return xtreme1.with_new(text, cuboid)

    def stale(self) -> Sequence[tuple[str | int, ...]]:
        """The count of points in a box that was moved."""
        return (("contour", "pointN"),)


def _path_of(key: Key, paths: Mapping[Key, Path]) -> Path:
    if key not in paths:
        raise DatasetError(f"expected a frame of this data set, got {'/'.join(key)}")
    return paths[key]
