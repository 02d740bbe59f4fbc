"""KITTI's object layout, read and written (Geiger, Lenz, Urtasun: "Are we ready for Autonomous Driving?", CVPR 2012).

``training/{velodyne,label_2,calib,image_2}/NNNNNN.*``. Boxes come into the lidar's frame through R0_rect and
Tr_velo_to_cam, with their centre instead of the centre of their bottom.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from farfield.datasets.base import Dataset, Indices
from farfield.datasets.cloud_reading import CloudReading
from farfield.datasets.kitti.boxes import (
    annotation_of,
    boxes_in_axes,
    camera_from_calib,
    checked_axes,
    objects_from_boxes,
    sized_camera,
)
from farfield.datasets.losses import Capacity
from farfield.errors import ConfigError, DatasetError, FileFormatError, plain
from farfield.files.atomic import read_bytes, write_text
from farfield.files.clouds import bin_columns, names_of, read_bin, write_bin
from farfield.files.images import read_image, write_image
from farfield.files.kitti import read_calib, read_labels, write_labels
from farfield.files.point_times import PointTimes
from farfield.files.remote_paths import as_path
from farfield.files.suffixes import any_case, existing
from farfield.frame import Annotation, Boxes, Camera, CameraField, Cloud, Frame, Lazy, Sensor, camera_sensor
from farfield.frame.cloud import read_radar_rows
from farfield.vocabulary.classes import CIRRUS_FROM_KITTI, KITTI_FROM_CIRRUS

_IMAGE_SUFFIXES = (".png", ".jpg")
_CLOUDS = f"velodyne/*{any_case('.bin')}"
_COLUMNS = 4
_LIST_BYTES = 64 << 20


class Kitti(Dataset):
    """KITTI object frames: cloud ``"lidar"``, image ``"camera"`` (image_2), boxes of the full objects.

    The annotation's ``details`` are ``truncation``, ``occlusion``, ``box_px`` and ``alpha_rad`` of each box, its
    ``unboxed["dontcare_px"]`` the 2D boxes of ``DontCare``. Only what the camera sees was annotated: its ``region``.

    Args:
        root: The folder with ``training`` or ``testing``, or one of those itself.
        part: ``"training"`` or ``"testing"``.
        classes: ``"cirrus"`` translates class names, ``"kitti"`` keeps them.
        bin_columns: Columns of the clouds; None takes what the largest of the first clouds shows, and KITTI's
            four where it does not show it.
        label_axes: ``"camera"``, or of own labels with a unit calibration ``"lidar"`` (x y z is a box's centre in the
            LiDAR's axes, rotation_y its yaw) or ``"lidar-bottom"`` (x y z is the bottom's centre); the calibration is
            then no camera's.
        intensity_scale: Value that stands for full reflectance in all clouds; None is KITTI's 1 for four
            columns, else decides by some of them.
        point_times: Unit of the points' times, where the files have any: ``s``, ``ms``, ``us``, ``ns``, or ``none`` to
            leave the column as it is; ``auto`` decides by the sweeps' period.

    Raises:
        DatasetError: If there is no cloud.
    """

    name = "kitti"
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
        if classes not in ("cirrus", "kitti"):
            raise ConfigError(f"kitti: expected classes to be one of 'cirrus', 'kitti', got {classes!r}")
        self.root, self.classes = as_path(root), classes
        folders = [self.root / part, self.root]
        self.folder = next((folder for folder in folders if any(folder.glob(_CLOUDS))), folders[0])
        self.clouds = sorted(self.folder.glob(_CLOUDS))
        if not self.clouds:
            raise DatasetError(f"{self.root}: expected KITTI clouds in {part}/velodyne/*.bin, found none")
        self.frame_ids = tuple(path.stem for path in self.clouds)
        self.sequences = (part,) * len(self.clouds)
        self.reading = CloudReading(
            self.clouds,
            bin_columns=bin_columns,
            intensity_scale=intensity_scale,
            point_times=point_times,
            usual_columns=_COLUMNS,
            usual_scale=1.0,  # KITTI's reflectance reaches 1
        )
        self.bin_columns = self.reading.bin_columns or _COLUMNS
        if self.name == Kitti.name and self.bin_columns > _COLUMNS:
            self._refuse_radar()

    def _refuse_radar(self) -> None:
        """A column that equals the distance is a radar's: TJ4DRadSet has KITTI's folders."""
        names = names_of(read_bin(self.clouds[0], columns=self.bin_columns))
        if "range_m" in names:
            raise DatasetError(
                f"{self.clouds[0]}: expected a LiDAR's points, got a radar's: of {len(names)} columns number "
                f"{names.index('range_m') + 1} is its range. Open TJ4DRadSet with format=tj4dradset"
            )

    def drive_indices(self) -> Mapping[str, Indices]:
        """No drives: the set shuffles their frames."""
        return {}

    def split_parts(self) -> dict[str, list[str]]:
        """Use the usual lists ``ImageSets/{train,val,test}.txt`` where they stand in the root."""
        parts: dict[str, list[str]] = {}
        for name in ("train", "val", "test"):
            path = self.root / "ImageSets" / f"{name}.txt"
            if path.is_file():
                try:
                    parts[name] = read_bytes(path, max_bytes=_LIST_BYTES).decode("ascii").split()
                except UnicodeDecodeError as error:
                    expected = "numbers of frames, one a line"
                    raise FileFormatError(path, where="the list", expected=expected, got=plain(error)) from error
        return parts or super().split_parts()

    def _file(self, index: int, kind: str, suffix: str) -> Path | None:
        return existing(self.folder / kind / f"{self.frame_ids[index]}{suffix}")

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
        if labels is not None and calib is None and self.label_axes == "camera":
            raise DatasetError(
                f"{labels}: expected calib/{labels.name} beside it: boxes stand in the camera's frame. "
                "Labels in the LiDAR's axes are read by --label-axes lidar or lidar-bottom"
            )
        load = self.reading.loader(self.clouds[index])
        pictured = calib is not None and self.label_axes == "camera"
        annotation, cameras = None, {"camera": sized_camera(calib, image)} if calib is not None and pictured else {}
        if labels is not None:
            camera_T_lidar = np.eye(4) if calib is None else camera_from_calib(calib)
            region = CameraField(camera=cameras["camera"], name="the left colour camera") if cameras else None
            read = partial(_read_annotation, labels, camera_T_lidar, self.label_axes, self.classes)
            annotation = partial(read, region)
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
    sensors = {"lidar": Sensor(kind="lidar", frame_T_sensor=np.eye(4))}
    if cameras or pictured:
        sensors["camera"] = camera_sensor(cameras.get("camera"))
    return sensors


def _read_annotation(
    path: Path, camera_T_lidar: Float[np.ndarray, "4 4"], label_axes: str, classes: str, region: CameraField | None
) -> Annotation:
    objects = read_labels(path)
    return annotation_of(objects, boxes_in_axes(objects, camera_T_lidar, label_axes, path, classes=classes), region)


# TJ4DRadSet (Zheng et al.: "TJ4DRadSet: A 4D Radar Dataset for Autonomous Driving", ITSC 2022), its 4D radar: KITTI's
# folders, but ``velodyne/*.bin`` holds a radar's points: rows of eight float32, x, y, z, v_r, range, power, azimuth and
# elevation. ``Tr_velo_to_cam`` goes from the radar to the camera.

COLUMNS = ("x", "y", "z", "v_r_m_s", "range_m", "power_db", "azimuth_deg", "elevation_deg")
_RANGE, _RANGE_WITHIN_M, _RANGE_SHARE = COLUMNS.index("range_m"), 0.1, 0.01


def is_tj4dradset(root: Path) -> bool:
    """Whether a folder in KITTI's layout holds points of eight numbers whose fifth is their range."""
    for base in (root / "training", root / "testing", root):
        first = next(iter(sorted(base.glob(_CLOUDS))[:1]), None)
        if first is not None:
            try:
                columns = bin_columns(first)
            except (FileFormatError, OSError):
                return False
            return columns.count == len(COLUMNS) and columns.names[_RANGE] == COLUMNS[_RANGE]
    return False


class Tj4dRadSet(Kitti):
    """TJ4DRadSet frames: cloud ``"radar"``, image ``"camera"`` (image_2), boxes of the full objects.

    The cloud keeps all columns in ``extra``: ``v_r_m_s``, radial velocity relative to the radar, positive away from it
    (once more as ``doppler_m_s``), ``range_m``, ``power_db``, ``azimuth_deg``, ``elevation_deg``. Everything is in the
    radar's coordinates. Options are those of :class:`~farfield.datasets.kitti.object.Kitti`.
    """

    name = "tj4dradset"

    def frame(self, index: int) -> Frame:
        """Build frame ``index``."""
        frame = super().frame(index)
        sensors = {name: sensor for name, sensor in frame.sensors.items() if name != "lidar"}
        radar = Sensor(kind="radar", frame_T_sensor=np.eye(4))
        clouds = Lazy({"radar": partial(read_radar, self.clouds[index])})
        return replace(frame, clouds=clouds, sensors={"radar": radar, **sensors})


def read_radar(path: Path) -> Cloud:
    """Read a cloud of the radar, in its own coordinates.

    Raises:
        FileFormatError: If the file is damaged.
    """
    rows, missing = read_radar_rows(path, len(COLUMNS))
    distance_m = np.linalg.norm(rows[:, :3].astype(np.float64), axis=1)
    if not (np.abs(rows[:, _RANGE] - distance_m) < _RANGE_WITHIN_M + _RANGE_SHARE * distance_m).all():
        raise FileFormatError(
            path,
            where="column 5, the range",
            expected="the distance of x, y, z",
            got="others",
            fix=f"The file is damaged, or no table of {len(COLUMNS)} columns of TJ4DRadSet's.",
        )
    extra = {name: np.ascontiguousarray(rows[:, number]) for number, name in enumerate(COLUMNS) if number > 2}
    return Cloud(rows[:, :3].copy(), None, {**extra, "doppler_m_s": extra["v_r_m_s"]}, missing)


# Writing KITTI's layout.

_SUFFIXES = {"velodyne": "bin", "calib": "txt", "label_2": "txt", "image_2": "png"}
# Stands in where a data set has no calibration: the image size of Cirrus, looking along x, 79 degrees wide.
VIRTUAL_CAMERA = Camera(
    matrix=np.array([[1173.0, 0.0, 959.5], [0.0, 1173.0, 324.5], [0.0, 0.0, 1.0]]), width_px=1920, height_px=650
)


def spelled_in_kitti(label: str) -> str:
    """A class as KITTI's files spell it: KITTI's name of ours, or its own without blanks."""
    return KITTI_FROM_CIRRUS.get(label) or "_".join(label.split())


KITTI_HOLDS = Capacity(
    title="KITTI's folders",
    read_by="kitti",
    holds=frozenset({"scores", "empty frames"}),
    pictures="front",
    attributes=frozenset({"occlusion"}),
    spelled=spelled_in_kitti,
    aliases=CIRRUS_FROM_KITTI,
    field_of_camera=True,
    file_names=None,
    reasons={
        "names": "files are numbered; frames.csv tells which is which",
        "region": "labels are read again as those of the camera's field",
        "distortion": "rectify the images beforehand",
        "attributes": "2D boxes, truncation and alpha are made anew",
    },
)


class KittiWriter:
    """Write ``training/{velodyne,label_2,calib,image_2}/NNNNNN.*``.

    The camera is the one that looks ahead, see :attr:`Frame.front_camera`. Boxes behind it or outside its image are
    written too, with the 2D box -1 -1 -1 -1. A frame without calibration gets a virtual camera at the lidar's origin
    and no image. Lens distortion has no place in KITTI's calibration: rectify the images beforehand, or leave 2D boxes
    unused.

    Args:
        root: Folder in which ``training`` is made.
        classes: KITTI's names by ours; others stay.
    """

    def __init__(self, root: Path | str, *, classes: Mapping[str, str] = KITTI_FROM_CIRRUS) -> None:
        self.root, self.classes = as_path(root), classes

    def write(
        self,
        number: int,
        frame: Frame,
        *,
        cloud: str | None = None,
        boxes: Boxes | None = None,
        occlusion: Int[np.ndarray, " n"] | None = None,
    ) -> dict[str, Path]:
        """Write one frame under a number.

        Args:
            number: 0 to 999999.
            frame: The frame.
            cloud: Which cloud; None takes the first; it must be one with intensity.
            boxes: Boxes to label instead of the frame's.
            occlusion: How far each box is hidden: 0 visible, 1 partly, 2 largely occluded, 3 unknown; None: unknown.

        Returns:
            The files written, by kind.

        Raises:
            DatasetError: If the number has more than six digits, or the cloud is a radar's, without intensity.
        """
        if not 0 <= number <= 999_999:
            raise DatasetError(f"frame {frame.key}: expected a KITTI number from 0 to 999999, got {number}")
        name = frame.front_camera
        camera = VIRTUAL_CAMERA if name is None else frame.cameras[name]
        boxes = frame.boxes if boxes is None else boxes
        points = frame.cloud(cloud)
        if points.intensity is None:
            raise DatasetError(
                f"frame {frame.key}: KITTI's velodyne files hold LiDAR clouds with intensity, got a cloud of "
                f"{', '.join(points.columns)}. Choose by `cloud` one of {', '.join(frame.clouds)} that has it."
            )
        paths = {"velodyne": self.path("velodyne", number), "calib": self.path("calib", number)}
        for path in paths.values():
            path.parent.mkdir(parents=True, exist_ok=True)
        write_bin(paths["velodyne"], np.column_stack([points.points_m, points.intensity]))
        write_text(paths["calib"], calibration_text(camera))
        if boxes is not None:
            paths["label_2"] = self.path("label_2", number)
            paths["label_2"].parent.mkdir(parents=True, exist_ok=True)
            objects = objects_from_boxes(boxes, camera, classes=self.classes)
            write_labels(paths["label_2"], objects if occlusion is None else replace(objects, occlusion=occlusion))
        if name is not None and name in frame.images:
            paths["image_2"] = self.path("image_2", number)
            paths["image_2"].parent.mkdir(parents=True, exist_ok=True)
            write_image(paths["image_2"], frame.images[name])
        return paths

    def path(self, kind: str, number: int) -> Path:
        """The file of a number: ``velodyne``, ``calib``, ``label_2`` or ``image_2``."""
        return self.root / "training" / kind / f"{number:06d}.{_SUFFIXES[kind]}"


def calibration_text(camera: Camera) -> str:
    """KITTI's calibration file for one camera: P0 to P3 alike, no rectification."""
    projection = np.column_stack([camera.matrix, np.zeros(3)])
    matrices = {f"P{number}": projection for number in range(4)}
    matrices |= {"R0_rect": np.eye(3), "Tr_velo_to_cam": camera.camera_T_lidar[:3], "Tr_imu_to_velo": np.eye(4)[:3]}
    rows = {name: " ".join(repr(value) for value in matrix.ravel().tolist()) for name, matrix in matrices.items()}
    return "".join(f"{name}: {row}\n" for name, row in rows.items())
