"""Read point cloud tasks as CVAT exports them: Datumaro, KITTI raw with tracklets.

Its third form, "Sly Point Cloud", is read as what it is: :mod:`farfield.datasets.supervisely`.

A root is one task or holds tasks::

    annotations/*.json, point_clouds/**/*.pcd                  Datumaro
    tracklet_labels.xml, velodyne_points/data/*.pcd or *.bin   KITTI raw, as its authors publish drives, too;
                                                               frame_list.txt beside it names each number's sweep
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from farfield.datasets.base import Dataset
from farfield.datasets.cloud_reading import CloudReading
from farfield.datasets.labels.json_labels import DatumaroLabels, annotation_of
from farfield.datasets.labels.tracklet_labels import TrackletLabels
from farfield.datasets.labels.tracklet_reading import (
    FRAME_LIST,
    TrackletReading,
    checked_convention,
    read_tracklets,
)
from farfield.errors import DatasetError
from farfield.files.atomic import read_bytes
from farfield.files.cuboids import Cuboid
from farfield.files.datumaro import parse_datumaro
from farfield.files.point_times import PointTimes
from farfield.files.remote_paths import as_path
from farfield.files.tracklets import parse_tracklets
from farfield.frame import Annotation, Frame, Lazy, Sensor
from farfield.frame.cloud import CLOUD_SUFFIXES

_KITTI_CLOUDS, _TRACKLETS = "velodyne_points/data", "tracklet_labels.xml"
ByFrame = Mapping[str, tuple[Cuboid, ...]]


@dataclass(frozen=True)
class CvatTask:
    """One task: its folder, its clouds, and its label files."""

    folder: Path
    clouds: tuple[Path, ...]
    labels: tuple[Path, ...]
    parse: Callable[[bytes, Path], tuple[Cuboid, ...]]


def tasks(root: Path) -> list[CvatTask]:
    """The tasks in a folder: itself, or those in it, at most two folders down."""
    folders = [root, *sorted(root.glob("*")), *sorted(root.glob("*/*"))]
    members = [task for folder in folders if folder.is_dir() and (task := _task(folder)) is not None]
    return [task for task in members if not any(task.folder.is_relative_to(o.folder) for o in members if o is not task)]


def _task(folder: Path) -> CvatTask | None:
    for parse, pattern, cloud_folder in (
        (_datumaro, "annotations/*.json", "point_clouds"),
        (parse_tracklets, _TRACKLETS, _KITTI_CLOUDS),
    ):
        labels = tuple(sorted(folder.glob(pattern)))
        if labels and (folder / cloud_folder).is_dir():
            paths = sorted((folder / cloud_folder).rglob("*"))
            clouds = tuple(path for path in paths if path.suffix.lower() in CLOUD_SUFFIXES and path.is_file())
            return CvatTask(folder, clouds, labels, parse) if clouds else None
    return None


def _datumaro(data: bytes, path: Path) -> tuple[Cuboid, ...]:
    return tuple(placed.cuboid for placed in parse_datumaro(data, path))


class Cvat(Dataset):
    """Annotation tasks of CVAT: point cloud ``"lidar"``, boxes with track IDs; each task is a sequence.

    Args:
        root: A task, or a folder of tasks.
        tracklets: What the numbers of ``tracklet_labels.xml`` stand for: ``"kitti"``, ``"cvat"`` or ``"datumaro"``;
            None decides by the list beside it, the writer's marks, and the points in the boxes.
        bin_columns: Columns of ``.bin`` files; None takes what the largest of the first ones shows.
        intensity_scale: Value that stands for full reflectance in all clouds; None decides by some of them.
        point_times: Unit of the points' times, where the files have any: ``s``, ``ms``, ``us``, ``ns``, or ``none`` to
            leave the column as it is; ``auto`` decides by the sweeps' period.

    Raises:
        DatasetError: If there is none.
        ConfigError: If there is no such convention.
    """

    name = "cvat"
    reading: CloudReading

    def __init__(
        self,
        root: Path | str,
        *,
        tracklets: str | None = None,
        bin_columns: int | None = None,
        intensity_scale: float | int | None = None,
        point_times: PointTimes = "auto",
    ) -> None:
        self.root, self.tracklets = as_path(root), tracklets
        checked_convention(tracklets)
        self.tasks = tasks(self.root)
        if not self.tasks:
            looked = f"annotations/*.json with point_clouds, {_TRACKLETS} with {_KITTI_CLOUDS}"
            raise DatasetError(f"{self.root}: expected a task of CVAT, found none. Looked for {looked}")
        self.frames = [(task, index) for task in self.tasks for index in range(len(task.clouds))]
        for task in self.tasks:
            _check_names(task)
        self.sequences = tuple(task.folder.resolve().name for task, _ in self.frames)
        self.frame_ids = tuple(task.clouds[index].stem for task, index in self.frames)
        self.reading = CloudReading(
            [task.clouds[index] for task, index in self.frames],
            bin_columns=bin_columns,
            intensity_scale=intensity_scale,
            point_times=point_times,
        )

    def files(self, index: int) -> Sequence[Path]:
        """List the files of frame ``index``."""
        task, cloud_index = self.frames[index]
        labels = task.labels
        beside = [*labels, *(path.with_name(FRAME_LIST) for path in labels[:1])]
        return [task.clouds[cloud_index], *(path for path in beside if path.is_file())]

    def has_annotation(self, index: int) -> bool:
        """Whether there is a label file for frame ``index``; a frame that it does not mention has no objects."""
        return bool(self.frames[index][0].labels)

    def annotation(self, index: int) -> Annotation | None:
        """The boxes of frame ``index``."""
        load = self._annotation_of(index)
        return None if load is None else load()

    def _annotation_of(self, index: int) -> Callable[[], Annotation] | None:
        """What gives the annotation of frame ``index``; None where it has none."""
        task, cloud_index = self.frames[index]
        if not self.has_annotation(index):
            return None
        return partial(_annotation, task, cloud_index, self.tracklets, self.reading.bin_columns)

    def tracklets_of(self, task: CvatTask) -> TrackletReading:
        """The tracklets of a task; errors are those of :func:`read_tracklets`."""
        return _tracklets_of(task, self.tracklets, self.reading.bin_columns)

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What the numbers of each task's tracklets stand for, and by what that was decided."""
        readings = [self.tracklets_of(task) for task in self.tasks if task.parse is parse_tracklets]
        return tuple(reading.sentence for reading in readings if not reading.published)

    def frame(self, index: int) -> Frame:
        """Build frame ``index``."""
        task, cloud_index = self.frames[index]
        return Frame(
            sequence=self.sequences[index],
            frame_id=self.frame_ids[index],
            clouds=Lazy({"lidar": self.reading.loader(task.clouds[cloud_index])}),
            sensors={"lidar": Sensor(kind="lidar", frame_T_sensor=np.eye(4))},
            load_annotation=self._annotation_of(index),
            metadata={"files": [str(path) for path in self.files(index)]},
        )


def label_format(data: Cvat) -> DatumaroLabels | TrackletLabels | None:
    """The label files of a data set, to edit them.

    Datumaro's of one task or of tasks in the root, or KITTI's tracklets; None where they are mixed.
    """
    if all(task.parse is parse_tracklets for task in data.tasks):
        readings = {task.folder: data.tracklets_of(task) for task in data.tasks}
        places = {
            key: (task.labels[0], readings[task.folder].numbers[task.clouds[index].stem])
            for key, (task, index) in zip(data.keys, data.frames, strict=True)
        }
        return TrackletLabels(places, {task.labels[0]: readings[task.folder].convention for task in data.tasks})
    files = [task.labels[0] for task in data.tasks if task.parse is _datumaro and len(task.labels) == 1]
    if len(files) == len(data.tasks) == 1:
        return DatumaroLabels(files[0])
    named = all(path == DatumaroLabels(data.root).path((path.parents[1].name, "")) for path in files)
    return DatumaroLabels(data.root) if named and len(files) == len(data.tasks) else None


def _check_names(task: CvatTask) -> None:
    """Each cloud has a name of its own."""
    stems: dict[str, Path] = {}
    for cloud in task.clouds:
        twin = stems.setdefault(cloud.stem, cloud)
        if twin is not cloud:
            raise DatasetError(f"{cloud}: expected clouds of different names in a task, {twin} is called so too")


def _tracklets_of(task: CvatTask, convention: str | None, bin_columns: int | None) -> TrackletReading:
    return read_tracklets(task.labels[0], task.clouds, convention=convention, bin_columns=bin_columns)


def _annotation(task: CvatTask, index: int, convention: str | None, bin_columns: int | None) -> Annotation:
    if task.parse is parse_tracklets:
        return annotation_of(_tracklets_of(task, convention, bin_columns).boxes(task.clouds[index].stem))
    stems, stem = tuple(cloud.stem for cloud in task.clouds), task.clouds[index].stem
    boxes: tuple[Cuboid, ...] = ()
    for path in task.labels:
        status = path.stat()
        by_frame = _parsed(path, task.parse, status.st_mtime_ns, status.st_size)
        name = _frame_of_stem(path, stems, tuple(by_frame)).get(stem)
        if name is not None and boxes:
            raise DatasetError(
                f"{path}: expected each cloud in one of a task's files, found boxes of {name!r} in another too. "
                "Leave one of the files there"
            )
        boxes = boxes if name is None else by_frame[name]
    return annotation_of(boxes)


@lru_cache(maxsize=4)
def _frame_of_stem(path: Path, stems: tuple[str, ...], frames: tuple[str, ...]) -> Mapping[str, str]:
    """The frame of a file that each cloud is: that of its name, or of its number where names are numbers.

    Raises:
        DatasetError: If a frame with boxes is none of the clouds, or two are one.
    """
    number_of = {int(stem): stem for stem in stems if stem.isascii() and stem.isdigit()}
    frame_of: dict[str, str] = {}
    for frame in frames:
        number = int(frame) if frame.isascii() and frame.isdigit() else -1
        stem = frame if frame in stems else number_of.get(number, "")
        if not stem or stem in frame_of:
            problem = "no cloud of that name" if not stem else f"{stem} for {frame_of[stem]!r} too"
            raise DatasetError(
                f"{path}: expected boxes of the clouds {stems[0]} ... {stems[-1]}, each once, found {frame!r} and "
                f"{problem}. Name items as the clouds' files (id, or point_cloud: path), or put the clouds there."
            )
        frame_of[stem] = frame
    return frame_of


@lru_cache(maxsize=4)
def _parsed(path: Path, parse: Callable[[bytes, Path], tuple[Cuboid, ...]], changed_ns: int, size: int) -> ByFrame:
    """The cuboids of a file by frame; one file holds all frames of a task, and is parsed once while it stays."""
    del changed_ns, size
    cuboids_by_frame: dict[str, list[Cuboid]] = {}
    for cuboid in parse(read_bytes(path), path):
        cuboids_by_frame.setdefault(cuboid.frame, []).append(cuboid)
    return {name: tuple(cuboids) for name, cuboids in cuboids_by_frame.items()}
