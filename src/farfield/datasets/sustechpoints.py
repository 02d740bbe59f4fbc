"""Read scenes of SUSTechPOINTS.

A scene holds ``lidar/*.pcd``, ``label/*.json``, ``camera/<name>/*.jpg`` and ``calib/camera/<name>.json``; a root is one
scene, or holds scenes. Boxes and clouds are in the LiDAR's coordinates, whose x does not point ahead in every data set
that was annotated with it; ``rotate_deg`` turns them.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from farfield.datasets.base import Dataset
from farfield.datasets.cloud_reading import CloudReading
from farfield.datasets.labels.json_labels import SustechLabels, annotation_of
from farfield.errors import DatasetError, FileFormatError
from farfield.files.atomic import read_bytes
from farfield.files.cuboids import numbers
from farfield.files.images import image_size, read_image
from farfield.files.json_text import parse_json
from farfield.files.point_times import PointTimes
from farfield.files.remote_paths import as_path
from farfield.files.suffixes import any_case, existing
from farfield.files.sustechpoints import MAX_BYTES, parse_sustechpoints
from farfield.frame import Annotation, Camera, Frame, Lazy, Sensor, camera_sensor
from farfield.frame.cloud import CLOUD_SUFFIXES
from farfield.geometry.poses import unrigid

_IMAGES = (".jpg", ".jpeg", ".png")


def scenes(root: Path) -> list[Path]:
    """The scenes in a folder: itself, or those directly in it."""
    if _is_scene(root):
        return [root]
    return sorted(folder for folder in root.iterdir() if folder.is_dir() and _is_scene(folder))


def _is_scene(folder: Path) -> bool:
    clouds = (path for suffix in CLOUD_SUFFIXES for path in folder.glob(f"lidar/*{any_case(suffix)}"))
    return next(clouds, None) is not None and ((folder / "label").is_dir() or (folder / "calib").is_dir())


class SustechPoints(Dataset):
    """SUSTechPOINTS: cloud ``"lidar"``, an image a camera, boxes with their tracks; each scene is a sequence.

    Args:
        root: A scene, or a folder of scenes.
        bin_columns: Columns of ``.bin`` files; None takes what the largest of the first ones shows.
        intensity_scale: Value that stands for full reflectance in all clouds; None decides by some of them.
        point_times: Unit of the points' times, where the files have any: ``s``, ``ms``, ``us``, ``ns``, or ``none`` to
            leave the column as it is; ``auto`` decides by the sweeps' period.

    Raises:
        DatasetError: If there is none.
    """

    name = "sustechpoints"
    reading: CloudReading

    def __init__(
        self,
        root: Path | str,
        *,
        bin_columns: int | None = None,
        intensity_scale: float | int | None = None,
        point_times: PointTimes = "auto",
    ) -> None:
        self.root = as_path(root)
        self.scenes = scenes(self.root)
        if not self.scenes:
            raise DatasetError(f"{self.root}: expected scenes of SUSTechPOINTS (lidar/*.pcd, label/*.json), found none")
        self.clouds = [
            path
            for scene in self.scenes
            for path in sorted((scene / "lidar").iterdir())
            if path.suffix.lower() in CLOUD_SUFFIXES
        ]
        self.sequences = tuple(path.parent.parent.resolve().name for path in self.clouds)
        self.frame_ids = tuple(path.stem for path in self.clouds)
        self.reading = CloudReading(
            self.clouds, bin_columns=bin_columns, intensity_scale=intensity_scale, point_times=point_times
        )

    def label_path(self, index: int) -> Path:
        """The label file of frame ``index``, or where it would stand."""
        path = self.clouds[index]
        label = path.parent.parent / "label" / f"{path.stem}.json"
        return existing(label) or label

    def files(self, index: int) -> Sequence[Path]:
        """List the files of frame ``index``."""
        label = [self.label_path(index)] if self.has_annotation(index) else []
        return [self.clouds[index], *label, *self._images(index).values(), *self._calibrations(index).values()]

    def has_annotation(self, index: int) -> bool:
        """Whether there is a label file of frame ``index``."""
        return self.label_path(index).is_file()

    def annotation(self, index: int) -> Annotation | None:
        """The boxes of frame ``index``."""
        return _read_annotation(self.label_path(index)) if self.has_annotation(index) else None

    def frame(self, index: int) -> Frame:
        """Build frame ``index``."""
        images, calibrations = self._images(index), self._calibrations(index)
        cameras = {name: _camera(path, images.get(name)) for name, path in calibrations.items()}
        label = self.label_path(index)
        return Frame(
            sequence=self.sequences[index],
            frame_id=self.frame_ids[index],
            clouds=Lazy({"lidar": self.reading.loader(self.clouds[index])}),
            images=Lazy({name: partial(read_image, path) for name, path in images.items()}),
            cameras=cameras,
            sensors={
                "lidar": Sensor(kind="lidar", frame_T_sensor=np.eye(4)),
                **{name: camera_sensor(cameras.get(name)) for name in dict.fromkeys([*images, *cameras])},
            },
            load_annotation=partial(_read_annotation, label) if label.is_file() else None,
            metadata={"files": [str(path) for path in self.files(index)]},
        )

    def _images(self, index: int) -> dict[str, Path]:
        path = self.clouds[index]
        folders = sorted(folder for folder in (path.parent.parent / "camera").glob("*") if folder.is_dir())
        return {
            folder.name: image
            for folder in folders
            for suffix in _IMAGES
            if (image := existing(folder / f"{path.stem}{suffix}"))
        }

    def _calibrations(self, index: int) -> dict[str, Path]:
        folder = self.clouds[index].parent.parent / "calib" / "camera"
        return {path.stem: path for path in sorted(folder.glob("*.json"))}


def label_format(data: SustechPoints) -> SustechLabels:
    """The label files of a data set, to edit them."""
    return SustechLabels(data.root, scene=data.scenes == [data.root])


def _read_annotation(path: Path) -> Annotation:
    cuboids = [placed.cuboid for placed in parse_sustechpoints(read_bytes(path, max_bytes=MAX_BYTES), path)]
    return annotation_of(cuboids)


def _camera(path: Path, image: Path | None) -> Camera:
    content: Any = parse_json(read_bytes(path, max_bytes=MAX_BYTES), path, max_bytes=MAX_BYTES)
    if not isinstance(content, dict):
        raise FileFormatError(path, where="the root", expected="an object", got=repr(content)[:80])
    pose = np.array(numbers(content.get("extrinsic"), 16, path, "extrinsic", "a matrix row by row")).reshape(4, 4)
    matrix = np.array(numbers(content.get("intrinsic"), 9, path, "intrinsic", "a matrix row by row")).reshape(3, 3)
    if fault := unrigid(pose):
        expected = "a rigid motion from the LiDAR to the camera"
        raise FileFormatError(path, where="extrinsic", expected=expected, got=fault)
    if not (matrix[0, 0] > 0 and matrix[1, 1] > 0 and matrix[2].tolist() == [0, 0, 1]):
        expected = "fx, 0, cx, 0, fy, cy, 0, 0, 1"
        raise FileFormatError(path, where="intrinsic", expected=expected, got=repr(matrix.ravel().tolist())[:120])
    width, height = (0, 0) if image is None else image_size(image)
    return Camera(matrix=matrix, camera_T_lidar=pose, width_px=width, height_px=height)
