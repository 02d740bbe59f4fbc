"""Clouds with the label files of an annotation tool beside them: what the readers of such tools have in common."""

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from farfield.datasets.base import Dataset, Indices, Poses, drive_poses
from farfield.datasets.cloud_reading import CloudReading
from farfield.datasets.labels.json_labels import annotation_of
from farfield.errors import DatasetError
from farfield.files.atomic import read_bytes
from farfield.files.cuboids import Cuboid, CuboidEntry
from farfield.files.point_times import PointTimes
from farfield.files.remote_paths import as_path
from farfield.frame import Annotation, Camera, Frame, Key, Lazy, Sensor, camera_sensor
from farfield.frame.cloud import CLOUD_SUFFIXES

Parser = Callable[..., Sequence[CuboidEntry]]
"""Gives a file's cuboids from its bytes, its path (for messages) and the options of :attr:`LabelledClouds.parsing`."""


@dataclass(frozen=True, kw_only=True)
class LabelledCloud:
    """One cloud, and where its labels stand.

    Args:
        cloud: The cloud's file.
        sequence: Its sequence.
        labels: The file of its labels, or where that would stand.
        within: The cloud's name in that file; empty where the file is of this cloud alone.
        annotated: Whether the file says anything of the cloud; None: where it is there.
    """

    cloud: Path
    sequence: str
    labels: Path
    within: str = ""
    annotated: bool | None = None


class LabelledClouds(Dataset):
    """Point cloud ``"lidar"`` and boxes; a subclass finds the clouds and names the parser of label files.

    Args:
        root: The folder.
        bin_columns: Columns of ``.bin`` files; None takes what the largest of the first ones shows.
        intensity_scale: Value that stands for full reflectance in all clouds; None decides by some of them.
        point_times: Unit of the points' times, where the files have any.

    Raises:
        DatasetError: If nothing of this layout is there, or two clouds of a sequence have one name.
    """

    reading: CloudReading
    looked_at: str
    """What was looked for, in an error."""
    parser: Parser

    def __init__(
        self,
        root: Path | str,
        *,
        bin_columns: int | None = None,
        intensity_scale: float | int | None = None,
        point_times: PointTimes = "auto",
    ) -> None:
        self.root = as_path(root)
        self.members = tuple(self.find())
        if not self.members:
            raise DatasetError(f"{self.root}: expected {self.looked_at}; found none")
        self.sequences = tuple(member.sequence for member in self.members)
        self.frame_ids = tuple(member.cloud.stem for member in self.members)
        twins: dict[Key, Path] = {}
        for key, member in zip(self.keys, self.members, strict=True):
            twin = twins.setdefault(key, member.cloud)
            if twin is not member.cloud:
                raise DatasetError(f"{member.cloud}: expected clouds of different names, {twin} is called so too")
        self.reading = CloudReading(
            [member.cloud for member in self.members],
            bin_columns=bin_columns,
            intensity_scale=intensity_scale,
            point_times=point_times,
        )

    @abstractmethod
    def find(self) -> Sequence[LabelledCloud]:
        """The clouds in order."""

    def parsing(self, path: Path) -> Mapping[str, Any]:
        """Options with which a label file is parsed."""
        del path
        return {}

    def pictures(self, index: int) -> tuple[Mapping[str, Callable[[], Any]], Mapping[str, Camera], Sequence[Path]]:
        """Images and calibrated cameras of frame ``index``, and the files they are read from."""
        del index
        return {}, {}, ()

    def time_ns(self, index: int) -> int | None:
        """When frame ``index`` was, in nanoseconds since 1970; None where that is not known."""
        del index
        return None

    def world_T_frame(self, index: int) -> Float[np.ndarray, "4 4"] | None:
        """The pose of frame ``index`` in the world; None where that is not known."""
        del index
        return None

    def _poses_of(self, indices: Indices) -> Poses | None:
        return drive_poses(self.world_T_frame, indices)

    def files(self, index: int) -> Sequence[Path]:
        """List the files of frame ``index``."""
        member = self.members[index]
        labels = [member.labels] if member.labels.is_file() else []
        return [member.cloud, *labels, *self.pictures(index)[2]]

    def has_annotation(self, index: int) -> bool:
        """Whether the labels say anything of frame ``index``, be it that nothing is there."""
        member = self.members[index]
        return member.labels.is_file() if member.annotated is None else member.annotated

    def annotation(self, index: int) -> Annotation | None:
        """The boxes of frame ``index``."""
        load = self._loader(index)
        return None if load is None else load()

    def _loader(self, index: int) -> Callable[[], Annotation] | None:
        if not self.has_annotation(index):
            return None
        member = self.members[index]
        options = tuple(sorted(self.parsing(member.labels).items()))
        return partial(read_annotation, member.labels, type(self).parser, options, member.within)

    def frame(self, index: int) -> Frame:
        """Build frame ``index``."""
        images, cameras, _ = self.pictures(index)
        return Frame(
            sequence=self.sequences[index],
            frame_id=self.frame_ids[index],
            time_ns=self.time_ns(index),
            clouds=Lazy({"lidar": self.reading.loader(self.members[index].cloud)}),
            images=Lazy(dict(images)),
            cameras=dict(cameras),
            sensors={
                "lidar": Sensor(kind="lidar", frame_T_sensor=np.eye(4)),
                **{name: camera_sensor(cameras.get(name)) for name in dict.fromkeys([*images, *cameras])},
            },
            load_annotation=self._loader(index),
            world_T_frame=self.world_T_frame(index),
            metadata={"files": [str(path) for path in self.files(index)]},
        )


def clouds_in(folder: Path) -> list[Path]:
    """The clouds directly in a folder, in order; none where there is no such folder."""
    if not folder.is_dir():
        return []
    paths = (path for path in folder.iterdir() if not path.name.startswith("."))
    return sorted(path for path in paths if path.suffix.lower() in CLOUD_SUFFIXES and path.is_file())


def folders_with(root: Path, matches: Callable[[Path], bool], *, deep: int = 2) -> list[Path]:
    """Folders of a layout: the root itself, or those in it, so many folders down, in order."""
    if matches(root):
        return [root]
    patterns = ["/".join(["*"] * depth) for depth in range(1, deep + 1)]
    for pattern in patterns:
        folders = sorted(folder for folder in root.glob(pattern) if folder.is_dir() and matches(folder))
        if folders:
            return folders
    return []


def names_of_folders(root: Path, folders: Sequence[Path]) -> dict[Path, str]:
    """A sequence's name of each folder: its own, with its parent's where two are called alike."""
    own = [folder.resolve().name for folder in folders]
    if len(set(own)) == len(own):
        return dict(zip(folders, own, strict=True))
    return {folder: folder.relative_to(root).as_posix() for folder in folders}


def read_annotation(path: Path, parser: Parser, options: tuple[tuple[str, Any], ...], within: str) -> Annotation:
    """The boxes of one cloud.

    Args:
        path: The label file.
        parser: Its parser.
        options: The parser's options.
        within: The cloud's name in the file; empty where the file is of one cloud.

    Raises:
        FileFormatError: If the file is damaged.
    """
    status = path.stat()
    return annotation_of(_parsed(path, parser, options, status.st_mtime_ns, status.st_size).get(within, ()))


@lru_cache(maxsize=4)
def _parsed(
    path: Path, parser: Parser, options: tuple[tuple[str, Any], ...], changed_ns: int, size: int
) -> Mapping[str, tuple[Cuboid, ...]]:
    """The cuboids of a file by frame; a file of many frames is parsed once while it stays."""
    del changed_ns, size
    by_frame: dict[str, list[Cuboid]] = {}
    for entry in parser(read_bytes(path), path, **dict(options)):
        by_frame.setdefault(entry.cuboid.frame, []).append(entry.cuboid)
    return {name: tuple(cuboids) for name, cuboids in by_frame.items()}
