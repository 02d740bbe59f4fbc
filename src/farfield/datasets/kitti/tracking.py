"""KITTI's tracking layout: clouds and images by sequence, one label and one calibration file a sequence.

``training/{velodyne/SSSS/*.bin, image_02/SSSS/*.png, label_02/SSSS.txt, calib/SSSS.txt}``. A folder of label files
alone (``label_02`` or ``label``) opens too: frames without clouds, boxes on plain camera axes.
"""

from collections.abc import Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from farfield.datasets.base import Dataset
from farfield.datasets.cloud_reading import CloudReading
from farfield.datasets.kitti.boxes import (
    annotation_of,
    boxes_in_axes,
    camera_from_calib,
    checked_axes,
    sized_camera,
)
from farfield.datasets.kitti.object import mounted
from farfield.errors import DatasetError
from farfield.files.images import read_image
from farfield.files.kitti import KittiTracks, read_calib, read_tracking
from farfield.files.point_times import PointTimes
from farfield.files.remote_paths import as_path
from farfield.files.suffixes import any_case, existing
from farfield.frame import Annotation, CameraField, Frame, Lazy
from farfield.geometry.cameras import CAMERA_T_LIDAR_AXES

_LABEL_FOLDERS = ("label_02", "label")
_COLUMNS = 4
_CLOUDS, _TRACKS = f"*{any_case('.bin')}", f"*{any_case('.txt')}"


class KittiTracking(Dataset):
    """KITTI tracking frames; ``frame_id`` is the number with six digits, boxes carry ``track_id``.

    The annotation is that of :class:`farfield.datasets.kitti.object.Kitti`. ``metadata["calibrated"]`` tells whether
    there was a calibration file; without one, boxes are turned to lidar axes but keep the camera's origin, and the
    annotated region is not known.

    Args:
        root: The folder with ``training`` or ``testing``, or one of those itself.
        part: ``"training"`` or ``"testing"``.
        classes: ``"cirrus"`` translates class names, ``"kitti"`` keeps them.
        bin_columns: Columns; None takes what the largest of the first clouds shows, and KITTI's four where it
            shows none.
        label_axes: As of :class:`~farfield.datasets.kitti.object.Kitti`.
        intensity_scale: Value that stands for full reflectance in all clouds; None is KITTI's 1 for four columns, else
            decides by some of them.
        point_times: Unit of the points' times, where the files have any.

    Raises:
        DatasetError: If there are neither clouds nor labels.
    """

    name = "kitti_tracking"
    reading: CloudReading

    def __init__(
        self,
        root: Path | str,
        *,
        part: Literal["training", "testing"] = "training",
        classes: Literal["cirrus", "kitti"] = "cirrus",
        bin_columns: int | None = None,
        label_axes: str = "camera",
        intensity_scale: float | int | None = None,
        point_times: PointTimes = "auto",
    ) -> None:
        checked_axes(label_axes)
        self.label_axes = label_axes
        self.root, self.classes = as_path(root), classes
        self.folder = self.root / part if (self.root / part).is_dir() else self.root
        names = {path.parent.name for path in self.folder.glob(f"velodyne/*/{_CLOUDS}")}
        self.labels = {p.stem: p for name in reversed(_LABEL_FOLDERS) for p in self.folder.glob(f"{name}/{_TRACKS}")}
        self._tracks = {sequence: _TrackFile(path) for sequence, path in self.labels.items()}
        names |= self.labels.keys()
        keys = [(name, stem) for name in sorted(names) for stem in self._stems(name)]
        if not keys:
            looked = "velodyne/<sequence>/*.bin, label_02/*.txt, label/*.txt"
            raise DatasetError(f"{self.root}: expected KITTI tracking data, found none. Looked for {looked}")
        self.sequences = tuple(name for name, _ in keys)
        self.frame_ids = tuple(stem for _, stem in keys)
        self.reading = CloudReading(
            sorted(self.folder.glob(f"velodyne/*/{_CLOUDS}")),
            bin_columns=bin_columns,
            intensity_scale=intensity_scale,
            point_times=point_times,
            usual_columns=_COLUMNS,
            usual_scale=1.0,  # KITTI's reflectance reaches 1
        )

    def _stems(self, sequence: str) -> list[str]:
        clouds = [path.stem for path in sorted(self.folder.glob(f"velodyne/{sequence}/{_CLOUDS}"))]
        if clouds or sequence not in self.labels:
            return clouds
        frames = self.tracks(sequence).frame
        return [f"{number:06d}" for number in range(int(frames.max(initial=-1)) + 1)]

    def tracks(self, sequence: str) -> KittiTracks:
        """Read the label file of a sequence, once."""
        return self._tracks[sequence].rows

    def _file(self, index: int, kind: str, *suffixes: str) -> Path | None:
        candidates = (
            self.folder / kind / self.sequences[index] / f"{self.frame_ids[index]}{suffix}" for suffix in suffixes
        )
        return next((path for candidate in candidates if (path := existing(candidate))), None)

    def files(self, index: int) -> Sequence[Path]:
        """List the files of frame ``index``; label and calibration files are shared by their sequence."""
        beside = [
            self._file(index, "velodyne", ".bin"),
            self._file(index, "image_02", ".png", ".jpg"),
            self.labels.get(self.sequences[index]),
            self._calib(index),
        ]
        return [path for path in beside if path]

    def _calib(self, index: int) -> Path | None:
        path = self.folder / "calib" / f"{self.sequences[index]}.txt"
        return path if path.is_file() else None

    def frame(self, index: int) -> Frame:
        """Build frame ``index``."""
        sequence, stem = self.sequences[index], self.frame_ids[index]
        cloud, image = self._file(index, "velodyne", ".bin"), self._file(index, "image_02", ".png", ".jpg")
        calib_path = self._calib(index)
        calib = None if calib_path is None else read_calib(calib_path)
        pictured = self.label_axes == "camera"
        cameras = {"camera": sized_camera(calib, image)} if calib is not None and pictured else {}
        annotation = None
        if sequence in self.labels:
            camera_T_lidar = CAMERA_T_LIDAR_AXES if calib is None else camera_from_calib(calib)
            field = CameraField(camera=cameras["camera"], name="the left colour camera") if cameras else None
            annotation = partial(
                self._tracks[sequence].annotation, int(stem), camera_T_lidar, self.label_axes, self.classes, field
            )
        return Frame(
            sequence=sequence,
            frame_id=stem,
            clouds=Lazy({} if cloud is None else {"lidar": self.reading.loader(cloud)}),
            images=Lazy({} if image is None else {"camera": partial(read_image, image)}),
            cameras=cameras,
            sensors=mounted(cameras, image is not None),
            load_annotation=annotation,
            metadata={"files": [str(path) for path in self.files(index)], "calibrated": calib is not None},
        )


class _TrackFile:
    """The label file of a sequence, read at the first access; the rows stay behind when it is pickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @cached_property
    def rows(self) -> KittiTracks:
        return read_tracking(self.path)

    def annotation(
        self,
        number: int,
        camera_T_lidar: Float[np.ndarray, "4 4"],
        label_axes: str,
        classes: str,
        field: CameraField | None,
    ) -> Annotation:
        rows = self.rows[self.rows.frame == number]
        boxes = boxes_in_axes(rows.objects, camera_T_lidar, label_axes, self.path, classes=classes)
        return annotation_of(rows.objects, boxes.replace(track_id=rows.track_id[rows.objects.has_box]), field)

    def __getstate__(self) -> dict[str, Path]:
        return {"path": self.path}
