"""KITTI's object detection layout (Geiger, Lenz, Urtasun: "Are we ready for Autonomous Driving?", CVPR 2012).

``training/{velodyne,label_2,calib,image_2}/NNNNNN.*``. Boxes come into the lidar's frame through R0_rect and
Tr_velo_to_cam, with their centre instead of the centre of their bottom.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from farfield.datasets.base import Dataset
from farfield.datasets.cloud_files import columns_shown, read_cloud
from farfield.datasets.drives import Indices
from farfield.datasets.kitti.boxes import annotation_of, camera_from_calib, sized_camera
from farfield.errors import ConfigError, DatasetError
from farfield.files.bin_columns import names_of
from farfield.files.clouds import read_bin
from farfield.files.images import read_image
from farfield.files.kitti import KittiObjects, read_calib, read_labels
from farfield.frame import Annotation, Boxes, Camera, CameraField, Frame, Lazy, Sensor, camera_sensor
from farfield.geometry.image_boxes import image_boxes
from farfield.geometry.kitti import camera_from_lidar, lidar_from_camera
from farfield.vocabulary.classes import CIRRUS_FROM_KITTI, normalised_class

_IMAGE_SUFFIXES = (".png", ".jpg")
_COLUMNS, _LOOKED_AT = 4, 8


class Kitti(Dataset):
    """KITTI object frames: cloud ``"lidar"``, image ``"camera"`` (image_2), boxes of the full objects.

    The annotation's ``details`` are ``truncation``, ``occlusion``, ``box_px`` and ``alpha_rad`` of each box, its
    ``unboxed["dontcare_px"]`` the 2D boxes of ``DontCare``. Only what the camera sees was annotated: its ``region``.

    Args:
        root: The folder with ``training`` or ``testing``, or one of those itself.
        part: ``"training"`` or ``"testing"``.
        classes: ``"cirrus"`` translates class names, ``"kitti"`` keeps them.
        bin_columns: Numbers a point in the clouds; None takes what the largest of the first clouds shows, and KITTI's
            four where it does not show it.

    Raises:
        DatasetError: If there is no cloud.
    """

    name = "kitti"

    def __init__(
        self,
        root: Path | str,
        *,
        part: Literal["training", "testing"] = "training",
        classes: Literal["cirrus", "kitti"] = "cirrus",
        bin_columns: int | None = None,
    ) -> None:
        if classes not in ("cirrus", "kitti"):
            raise ConfigError(f"kitti: expected classes to be one of 'cirrus', 'kitti', got {classes!r}")
        self.root, self.classes = Path(root), classes
        places = [self.root / part, self.root]
        self.folder = next((place for place in places if any(place.glob("velodyne/*.bin"))), places[0])
        self.clouds = sorted(self.folder.glob("velodyne/*.bin"))
        if not self.clouds:
            raise DatasetError(f"{self.root}: expected KITTI clouds in {part}/velodyne/*.bin, found none")
        self.frame_ids = tuple(path.stem for path in self.clouds)
        self.sequences = (part,) * len(self.clouds)
        self.bin_columns = bin_columns or columns_shown(self.clouds[:_LOOKED_AT]) or _COLUMNS
        if self.name == Kitti.name and self.bin_columns > _COLUMNS:
            self._refuse_radar()

    def _refuse_radar(self) -> None:
        """A column that equals the distance is a radar's: TJ4DRadSet has KITTI's folders."""
        names = names_of(read_bin(self.clouds[0], columns=self.bin_columns))
        if "range_m" in names:
            raise DatasetError(
                f"{self.clouds[0]}: expected a LiDAR's points, got a radar's: of {len(names)} numbers a point number "
                f"{names.index('range_m') + 1} is its range. Open TJ4DRadSet with format=tj4dradset"
            )

    def drive_indices(self) -> Mapping[str, Indices]:
        """No drives: the set shuffles their frames."""
        return {}

    def _split_from_file(self) -> dict[str, list[str]]:
        """Use the usual lists ``ImageSets/{train,val,test}.txt`` where they stand in the root."""
        parts: dict[str, list[str]] = {}
        for name in ("train", "val", "test"):
            path = self.root / "ImageSets" / f"{name}.txt"
            if path.is_file():
                parts[name] = path.read_text("ascii").split()
        return parts or super()._split_from_file()

    def _file(self, index: int, kind: str, suffix: str) -> Path | None:
        path = self.folder / kind / f"{self.frame_ids[index]}{suffix}"
        return path if path.is_file() else None

    def files(self, index: int) -> Sequence[Path]:
        """List the files of frame ``index``."""
        beside = [self._file(index, "label_2", ".txt"), self._file(index, "calib", ".txt"), self._image(index)]
        return [self.clouds[index], *(path for path in beside if path)]

    def _image(self, index: int) -> Path | None:
        return next((path for suffix in _IMAGE_SUFFIXES if (path := self._file(index, "image_2", suffix))), None)

    def frame(self, index: int) -> Frame:
        """Build frame ``index``.

        Raises:
            DatasetError: If there are labels but no calibration.
        """
        labels, image = self._file(index, "label_2", ".txt"), self._image(index)
        calib_path = self._file(index, "calib", ".txt")
        calib = None if calib_path is None else read_calib(calib_path)
        if labels is not None and calib is None:
            raise DatasetError(f"{labels}: expected calib/{labels.name} beside it: boxes stand in the camera's frame")
        scale = 1.0 if self.bin_columns == _COLUMNS else None  # KITTI's reflectance reaches 1; others are not known
        load = partial(read_cloud, self.clouds[index], bin_columns=self.bin_columns, intensity_scale=scale)
        annotation, cameras = None, {} if calib is None else {"camera": sized_camera(calib, image)}
        if labels is not None and calib is not None:
            region = CameraField(camera=cameras["camera"], name="the left colour camera")
            annotation = partial(_read_annotation, labels, camera_from_calib(calib), self.classes, region)
        return Frame(
            sequence=self.sequences[index],
            frame_id=self.frame_ids[index],
            clouds=Lazy({"lidar": load}),
            images=Lazy({} if image is None else {"camera": partial(read_image, image)}),
            cameras=cameras,
            sensors=mounted(cameras, image is not None),
            load_annotation=annotation,
            metadata={"files": [str(path) for path in self.files(index)]},
        )


def mounted(cameras: Mapping[str, Camera], pictured: bool) -> dict[str, Sensor]:
    """The lidar, in whose coordinates a frame is, and the camera, if it has a calibration or an image."""
    known = {"lidar": Sensor(kind="lidar", frame_T_sensor=np.eye(4))}
    if cameras or pictured:
        known["camera"] = camera_sensor(cameras.get("camera"))
    return known


def _read_annotation(
    path: Path, camera_T_lidar: Float[np.ndarray, "4 4"], classes: str, region: CameraField
) -> Annotation:
    objects = read_labels(path)
    return annotation_of(objects, boxes_from_objects(objects, camera_T_lidar, classes=classes), region)


def boxes_from_objects(
    objects: KittiObjects, camera_T_lidar: Float[np.ndarray, "4 4"], *, classes: str = "cirrus"
) -> Boxes:
    """Convert KITTI objects to lidar boxes; rows without a 3D box (``DontCare``) are left out.

    Args:
        objects: Rows of a label or detection file.
        camera_T_lidar: Lidar to rectified camera coordinates.
        classes: ``"cirrus"`` translates class names (unknown ones become ``unknown``), ``"kitti"`` keeps them.
    """
    kept = objects[objects.has_box]
    centre, size, yaw = lidar_from_camera(kept.bottom_m, kept.size_m, kept.rotation_y_rad, camera_T_lidar)
    names = kept.type.tolist()
    if classes == "cirrus":
        names = [normalised_class(name, CIRRUS_FROM_KITTI) for name in names]
    return Boxes(centre_m=centre, size_m=size, yaw_rad=yaw, label=names, score=kept.score)


def objects_from_boxes(boxes: Boxes, camera: Camera, *, classes: Mapping[str, str]) -> KittiObjects:
    """Convert lidar boxes to KITTI objects: the inverse of :func:`boxes_from_objects`, with 2D boxes.

    A box behind the camera or outside its image gets the 2D box -1 -1 -1 -1. Occlusion is not known (3).

    Args:
        boxes: Boxes in lidar coordinates.
        camera: The left colour camera (its pose is taken as that of the rectified frame).
        classes: Class names by ours; others become ``Misc``.
    """
    bottom, size, rotation_y = camera_from_lidar(boxes.centre_m, boxes.size_m, boxes.yaw_rad, camera.camera_T_lidar)
    box_px, truncation = image_boxes(boxes, camera)
    alpha = rotation_y - np.arctan2(bottom[:, 0], bottom[:, 2])
    return KittiObjects(
        type=np.array([classes.get(str(name), "Misc") for name in boxes.label], dtype=np.str_),
        truncation=truncation,
        occlusion=np.full(len(boxes), 3, dtype=np.int64),
        alpha_rad=np.mod(alpha + np.pi, 2 * np.pi) - np.pi,
        box_px=box_px,
        size_m=size,
        bottom_m=bottom,
        rotation_y_rad=rotation_y,
        score=boxes.score,
        line=np.arange(1, len(boxes) + 1, dtype=np.int64),
    )
