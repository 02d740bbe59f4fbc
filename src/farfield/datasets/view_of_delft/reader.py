"""View-of-Delft: an HDL-64 lidar, a ZF FRGen21 3+1D radar and a camera that looks down by seven degrees.

Palffy et al.: "Multi-class Road User Detection with 3+1D Radar in the View-of-Delft Dataset", RA-L 2022. Each sensor
has a tree in KITTI's layout.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from farfield.datasets.base import Dataset, Indices, Poses, all_known, drive_poses
from farfield.datasets.kitti.boxes import annotation_of, camera_from_calib, check_objects, sized_camera
from farfield.datasets.maps import Coordinates, FrameMap, TransformedCloud
from farfield.datasets.splits import SPLIT_SHARES
from farfield.datasets.view_of_delft.layout import CLIPS, PARTS, RADAR_COLUMNS, clip_of, find_trees
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.files.atomic import read_bytes
from farfield.files.images import read_image
from farfield.files.kitti import KittiObjects, read_calib, read_labels
from farfield.files.remote_paths import as_path
from farfield.files.suffixes import any_case, existing
from farfield.files.view_of_delft import DelftObjects, read_camera_poses, read_objects
from farfield.frame import (
    Annotation,
    Boxes,
    Camera,
    CameraField,
    Cloud,
    Constant,
    Frame,
    Lazy,
    Pose,
    Sensor,
    camera_sensor,
)
from farfield.frame.cloud import CloudSettings, read_cloud, read_radar_rows
from farfield.geometry.kitti import upright_from_camera
from farfield.geometry.poses import rotation_from_quaternion
from farfield.vocabulary.classes import CIRRUS_FROM_VIEW_OF_DELFT, normalised_class

REFLECTANCE_FULL = 255.0  # the lidar's, unlike KITTI's
RADAR_RATE_HZ = 13.0  # nominal; files count scans and give no times
_MOST_SCANS = 100

IMAGE_PX = (1936, 1216)
Reference = Literal["lidar", "radar"]
_HOLDS = {"radar_3frames": ("radar",), "radar_5frames": ("radar", "radar_3frames")}
_CLOUDS = f"velodyne/*{any_case('.bin')}"
_COMPANIONS = {"image_2": (".jpg", ".png"), "label_2": (".txt", ".json"), "pose": (".json",), "calib": (".txt",)}
_NEEDED_POINTS = 3


@dataclass(frozen=True, kw_only=True)
class _Rig:
    """What a frame's calibration files say: sensors to camera, and which of them the frame's coordinates belong to."""

    camera_T: Mapping[Reference, Float[np.ndarray, "4 4"]]
    calib: Mapping[Reference, Mapping[str, np.ndarray]]
    reference: Reference

    def reference_T(self, sensor: Reference) -> Float[np.ndarray, "4 4"]:
        return np.asarray(np.linalg.inv(self.camera_T[self.reference]) @ self.camera_T[sensor])


def _pose(rig: _Rig, world_T_camera: Mapping[str, Pose]) -> Pose | None:
    """Where the reference sensor stands in the odometry's world; None where one of both is not known."""
    posed = "odom" in world_T_camera and rig.reference in rig.camera_T
    return world_T_camera["odom"] @ rig.camera_T[rig.reference] if posed else None


class ViewOfDelft(Dataset):
    """View-of-Delft frames, from the data set's root or from one of its folders alone.

    Clouds are ``"lidar"``, ``"radar"`` (one scan), ``"radar_3frames"`` and ``"radar_5frames"``, those that are there.
    A radar cloud keeps all columns of its file in ``extra``:

    - ``rcs_dbsm``, the radar cross section,
    - ``v_r_m_s``, radial velocity relative to the radar, positive away from it; once more as ``doppler_m_s``, the name
      by which detectors of radar cells read it,
    - ``v_r_compensated_m_s``, the same over ground, without the ego vehicle's motion,
    - ``scan``, 0 for the newest, -1, -2...; ``lag_s`` is its age at :data:`RADAR_RATE_HZ`.

    Radial means along the ray from the radar, which stands at ``sensors["radar"].frame_T_sensor``. Clouds of several
    scans hold the points of the others.

    ``world_T_frame`` is the pose of the reference sensor in the odometry's frame, which is smooth within a drive and
    begins anew with the next; ``metadata["world_T_camera"]`` has the camera's poses in ``odom``, ``map`` and ``utm``,
    ``metadata["radar_velocity_m_s"]`` the radar's own velocity (x, y, z in its frame, see :func:`radar_velocity_m_s`).

    The annotation tells what :class:`~farfield.datasets.kitti.object.Kitti`'s does, and which objects are ``moving``
    (from the label's truncation column, which tells nothing else). Labels in JSON have ``activity`` and ``object_id``
    for ``details``.

    A sequence is a clip of the data set's documentation, or the part's name for frames that are in none.

    Args:
        root: The data set's root, or ``lidar``, ``radar``, ``radar_3frames`` or ``radar_5frames`` in it.
        part: ``"training"`` or ``"testing"``.
        classes: ``"cirrus"`` translates class names, ``"kitti"`` keeps them.
        reference: Whose coordinates everything is in: ``"lidar"``, ``"radar"``, or None for the lidar where there is
            one.
        nominal_times: Give frames the times that their numbers have at the radar's nominal :data:`RADAR_RATE_HZ`, since
            the files give none: good enough to stack sweeps, which need times.
        intensity_scale: Value that stands for full reflectance of the lidar (default: the published clouds' own).

    Raises:
        DatasetError: If there is no cloud.
        ConfigError: If an option is unknown.
    """

    name = "view_of_delft"
    references = ("lidar", "radar")

    def __init__(
        self,
        root: Path | str,
        *,
        part: Literal["training", "testing"] = "training",
        classes: Literal["cirrus", "kitti"] = "cirrus",
        reference: Reference | None = None,
        nominal_times: bool = False,
        intensity_scale: float | int | None = None,
    ) -> None:
        for option, value, choices in (
            ("part", part, PARTS),
            ("classes", classes, ("cirrus", "kitti")),
            ("reference", reference, (None, "lidar", "radar")),
        ):
            if value not in choices:
                raise ConfigError(f"view_of_delft: expected {option} to be one of {choices}, got {value!r}")
        if intensity_scale is not None and not 0 < intensity_scale < np.inf:
            raise ConfigError(f"intensity_scale: expected a positive number, got {intensity_scale!r}")
        self.root, self.classes, self.nominal_times = as_path(root), classes, nominal_times
        self.scale = REFLECTANCE_FULL if intensity_scale is None else float(intensity_scale)
        self.trees = find_trees(self.root, part)
        if not self.trees:
            raise DatasetError(f"{self.root}: expected clouds in [lidar|radar]/{part}/velodyne/*.bin, found none")
        self.reference: Reference = reference or ("lidar" if "lidar" in self.trees else "radar")
        self._clouds = {name: {p.stem: p for p in tree.glob(_CLOUDS)} for name, tree in self.trees.items()}
        self.frame_ids = tuple(sorted(set().union(*self._clouds.values())))
        self.sequences = tuple(clip_of(frame_id) or part for frame_id in self.frame_ids)

    @property
    def maps(self) -> tuple[FrameMap, ...]:
        """The map that stands for ``reference``, where that is not the usual one."""
        usual = next(name for name in self.references if any(_sensor(tree) == name for tree in self.trees))
        return () if self.reference == usual else (Coordinates(self.reference),)

    def _time_ns(self, index: int) -> int | None:
        """Time since the data set's frame 0 at the nominal rate, if that was asked for."""
        stem = self.frame_ids[index]
        is_number = self.nominal_times and stem.isascii() and stem.isdigit()
        return round(int(stem) * 1e9 / RADAR_RATE_HZ) if is_number else None

    def _times_of(self, indices: Indices) -> Indices | None:
        return all_known(self._time_ns(int(index)) for index in indices)

    def split_units(self) -> tuple[str, ...]:
        """Name what the official lists name, single frames; the lists keep clips whole."""
        return self.frame_ids

    def split_parts(self) -> dict[str, list[str]]:
        """Use ``ImageSets/{train,val,test}.txt`` where they are, or else the documented part of each clip."""
        if (self.root / self.split_file).is_file():
            return super().split_parts()
        folders = [folder / "ImageSets" for tree in self.trees.values() for folder in (tree.parent, tree)]
        for list_folder in [self.root / "ImageSets", *folders]:
            lists = {name: list_folder / f"{name}.txt" for name in SPLIT_SHARES}
            texts = {
                name: read_bytes(path).decode("ascii", "replace") for name, path in lists.items() if path.is_file()
            }
            if texts:
                return {name: text.split() for name, text in texts.items()}
        parts: dict[str, list[str]] = {name: [] for name in SPLIT_SHARES}
        for frame_id, clip in zip(self.frame_ids, self.sequences, strict=True):
            if clip in CLIPS:
                parts[CLIPS[clip][2]].append(frame_id)
        return parts if any(parts.values()) else {}

    def _file(self, index: int, kind: str, tree: str | None = None, suffixes: Sequence[str] = ()) -> Path | None:
        """A companion of frame ``index``: from the tree named, or from the first that has it, ``.txt`` first."""
        trees = list(self.trees.values()) if tree is None else [self.trees[tree]]
        names = [self.frame_ids[index] + suffix for suffix in suffixes or _COMPANIONS[kind]]
        paths = (folder / kind / name for name in names for folder in trees)
        return next((file for path in paths if (file := existing(path))), None)

    def files(self, index: int) -> Sequence[Path]:
        """List the files of frame ``index``."""
        clouds = [paths[self.frame_ids[index]] for paths in self._clouds.values() if self.frame_ids[index] in paths]
        calibs = [self._file(index, "calib", name) for name in self.trees]
        beside = [self._file(index, kind) for kind in ("image_2", "label_2", "pose")]
        return [*clouds, *(path for path in [*calibs, *beside] if path is not None)]

    def _poses_of(self, indices: Indices) -> Poses | None:
        return drive_poses(self._pose, indices)

    def _pose(self, index: int) -> Pose | None:
        path = self._file(index, "pose")
        return None if path is None else _pose(self._rig(index), read_camera_poses(path))

    def frame(self, index: int) -> Frame:
        """Build frame ``index``.

        Raises:
            DatasetError: If a calibration is missing that the labels or a cloud of another sensor need.
        """
        rig, image, pose = self._rig(index), self._file(index, "image_2"), self._file(index, "pose")
        clouds = self._cloud_loaders(index, rig)
        calib = rig.calib.get(rig.reference)
        cameras = {} if calib is None else {"camera": sized_camera(calib, image, size_px=IMAGE_PX)}
        world_T_camera = {} if pose is None else read_camera_poses(pose)
        return Frame(
            sequence=self.sequences[index],
            frame_id=self.frame_ids[index],
            time_ns=self._time_ns(index),
            clouds=Lazy(clouds),
            images=Lazy({} if image is None else {"camera": partial(read_image, image)}),
            cameras=cameras,
            sensors=_sensors(rig, clouds, cameras, image is not None),
            load_annotation=self._labels(index, rig, cameras.get("camera")),
            world_T_frame=_pose(rig, world_T_camera),
            reference=self.reference,
            metadata=Lazy(self._metadata(index, world_T_camera)),
        )

    def _metadata(self, index: int, world_T_camera: Mapping[str, np.ndarray]) -> dict[str, Callable[[], Any]]:
        loaders: dict[str, Callable[[], Any]] = {"files": Constant([str(path) for path in self.files(index)])}
        if self.frame_ids[index] in self._clouds.get("radar", ()):
            path = self._clouds["radar"][self.frame_ids[index]]
            loaders["radar_velocity_m_s"] = partial(_velocity, path)
        return loaders | ({"world_T_camera": Constant(world_T_camera)} if world_T_camera else {})

    def _rig(self, index: int) -> _Rig:
        calib: dict[Reference, Mapping[str, np.ndarray]] = {}
        for name in self.trees:
            path = self._file(index, "calib", name)
            if path is not None:
                calib.setdefault(_sensor(name), read_calib(path))
        camera_T = {sensor: camera_from_calib(matrices) for sensor, matrices in calib.items()}
        return _Rig(camera_T=camera_T, calib=calib, reference=self.reference)

    def _cloud_loaders(self, index: int, rig: _Rig) -> dict[str, Callable[[], Cloud]]:
        loaders: dict[str, Callable[[], Cloud]] = {}
        for name, paths in self._clouds.items():
            path, sensor = paths.get(self.frame_ids[index]), _sensor(name)
            if path is None:
                continue
            read: Callable[[], Cloud] = (
                partial(read_radar, path)
                if sensor == "radar"
                else partial(read_cloud, path, CloudSettings(intensity_scale=self.scale), bin_columns=4)
            )
            if sensor != rig.reference:
                self._need(index, rig, (sensor, rig.reference), f"{path}: to give it in the {rig.reference}'s frame")
                read = TransformedCloud(read, rig.reference_T(sensor))
            loaders[name] = read
        return loaders

    def _labels(self, index: int, rig: _Rig, camera: Camera | None) -> Callable[[], Annotation] | None:
        """A loader of what the label file tells, in the reference's coordinates."""
        path = self._file(index, "label_2")
        if path is None:
            return None
        region = None if camera is None else CameraField(camera=camera, name="the camera")
        upright: Reference = "radar" if "radar" in rig.camera_T or path.suffix.lower() == ".json" else "lidar"
        if path.suffix.lower() == ".json":
            if rig.reference != "radar":
                self._need(index, rig, ("radar", rig.reference), f"{path}: its boxes are in the radar's frame")
            read = partial(_read_json, path, self.classes)
        else:
            self._need(index, rig, (rig.reference,), f"{path}: its boxes are in the camera's frame")
            read = partial(_read_text, path, rig.camera_T[upright], self.classes)
        moves = None if upright == rig.reference else rig.reference_T(upright)
        return partial(_placed_annotation, read, moves, region)

    def _need(self, index: int, rig: _Rig, sensors: Sequence[Reference], why: str) -> None:
        missing = [sensor for sensor in sensors if sensor not in rig.camera_T]
        if missing:
            raise DatasetError(f"{why}, expected {missing[0]}/.../calib/{self.frame_ids[index]}.txt, found none")


def _sensor(cloud: str) -> Reference:
    return "lidar" if cloud == "lidar" else "radar"


def _sensors(rig: _Rig, clouds: Collection[str], cameras: Mapping[str, Camera], pictured: bool) -> dict[str, Sensor]:
    """Where the sensors stand in the reference's coordinates, in which all clouds are."""
    poses = {name: rig.reference_T(name) for name in rig.camera_T} if rig.reference in rig.camera_T else {}
    poses[rig.reference] = np.eye(4)
    sensors = {
        name: Sensor(kind=_sensor(name), frame_T_sensor=poses.get(_sensor(name)), holds=_HOLDS.get(name, ()))
        for name in dict.fromkeys([*clouds, *poses])
    }
    if cameras or pictured:
        sensors["camera"] = camera_sensor(cameras.get("camera"))
    return sensors


def _velocity(path: Path) -> Float[np.ndarray, " 3"] | None:
    return radar_velocity_m_s(read_radar(path))


def _placed_annotation(
    read: Callable[[], Annotation], target_T_source: Float[np.ndarray, "4 4"] | None, region: CameraField | None
) -> Annotation:
    annotation = read()
    return replace(annotation if target_T_source is None else annotation.moved(target_T_source), region=region)


def _read_text(path: Path, camera_T_sensor: Float[np.ndarray, "4 4"], classes: str) -> Annotation:
    """Labels in KITTI's form; two columns mean something else here: moving for truncation, and 1 for score."""
    raw = read_labels(path)
    check_objects(raw, path)
    objects = replace(raw, truncation=np.zeros(len(raw)), score=None)
    annotation = annotation_of(objects, boxes_from_labels(objects, camera_T_sensor, classes=classes), None)
    return replace(annotation, moving=raw[raw.has_box].truncation > 0)


def _read_json(path: Path, classes: str) -> Annotation:
    objects = read_objects(path)
    activity = [str(attributes.get("activity", "")) for attributes in objects.attributes]
    return Annotation(
        boxes=boxes_from_objects(objects, classes=classes),
        original_label=tuple(kitti_names(objects)),
        moving=np.array([name == "moving" for name in activity], dtype=np.bool_),
        details={"activity": np.array(activity, dtype=np.str_), "object_id": np.asarray(objects.object_id)},
    )


def read_radar(path: Path) -> Cloud:
    """Read a radar cloud in the radar's own frame: rows of x, y, z, RCS, v_r, v_r compensated, scan, seven float32.

    Raises:
        FileFormatError: If the file is damaged.
    """
    rows, missing = read_radar_rows(path, RADAR_COLUMNS)
    rcs_dbsm, scan = rows[:, 3], rows[:, 6]
    if not ((scan % 1 == 0) & (np.abs(scan) <= _MOST_SCANS)).all():
        raise FileFormatError(
            path,
            where="column 7, the scan",
            expected="whole numbers: 0, -1, -2...",
            got=f"{scan[scan % 1 != 0][:1].tolist() or np.abs(scan).max()}",
            fix=f"The file is damaged, or no table of {RADAR_COLUMNS} columns of View-of-Delft's.",
        )
    extra = {
        "rcs_dbsm": rcs_dbsm,
        "v_r_m_s": rows[:, 4],
        "doppler_m_s": rows[:, 4],
        "v_r_compensated_m_s": rows[:, 5],
        "scan": scan,
        "lag_s": np.abs(scan) / np.float32(RADAR_RATE_HZ),
    }
    contiguous = {name: np.ascontiguousarray(column) for name, column in extra.items()}
    return Cloud(rows[:, :3].copy(), None, contiguous, missing)


def radar_velocity_m_s(cloud: Cloud) -> Float[np.ndarray, " 3"] | None:
    """Solve the radar's own velocity over ground from a cloud in its frame, by least squares over the newest scan.

    A point's two velocities differ by the radar's motion along the ray, so ``v_r_compensated - v_r = ray . velocity``.

    Returns:
        x, y, z in metres a second, shape (3,); None for fewer than three points.
    """
    cloud = cloud[cloud.extra["scan"] == 0]
    ranges_m = np.linalg.norm(cloud.points_m.astype(np.float64), axis=1)
    cloud, ranges_m = cloud[ranges_m > 0], ranges_m[ranges_m > 0]
    if len(cloud) < _NEEDED_POINTS:
        return None
    difference = cloud.extra["v_r_compensated_m_s"].astype(np.float64) - cloud.extra["v_r_m_s"]
    return np.asarray(np.linalg.lstsq(cloud.points_m / ranges_m[:, None], difference, rcond=None)[0])


# Labels as boxes. The files' headings turn about the radar's vertical axis. The documentation says "around the LiDAR's
# -Z axis", but the nine-degree-of-freedom labels that the example frames have as well show that, seen in the radar's
# frame, the headings agree to 0.001 degrees; in the lidar's they are 0.35 degrees off, the angle between the sensors.


_RADAR_R_LABEL = np.diag([1.0, -1.0, -1.0])  # x forward, y right, z down to x forward, y left, z up
_KITTI_NAMES = {"car": "Car", "pedestrian": "Pedestrian"}


def boxes_from_labels(
    objects: KittiObjects, camera_T_sensor: Float[np.ndarray, "4 4"], *, classes: str = "cirrus"
) -> Boxes:
    """Convert View-of-Delft's objects to boxes in a sensor's frame: exact for the radar.

    The box stands upright in the sensor's frame, see :func:`~farfield.geometry.kitti.upright_from_camera`.

    Args:
        objects: Rows of a label file; the sixteenth column, always 1, is no score.
        camera_T_sensor: Radar (or lidar) to camera coordinates.
        classes: ``"cirrus"`` translates class names (unknown ones become ``unknown``), ``"kitti"`` keeps them.
    """
    boxed = objects[objects.has_box]
    centre, size, yaw = upright_from_camera(boxed.bottom_m, boxed.size_m, boxed.rotation_y_rad, camera_T_sensor)
    return Boxes(centre_m=centre, size_m=size, yaw_rad=yaw, label=_class_names(boxed.type.tolist(), classes))


def boxes_from_objects(objects: DelftObjects, *, classes: str = "cirrus") -> Boxes:
    """Convert the objects of a JSON label file to boxes in the radar's frame, upright: their roll and pitch are lost.

    Args:
        objects: The file's objects.
        classes: ``"cirrus"`` or ``"kitti"``, where a bicycle with a rider is a ``Cyclist``, as in the text files.
    """
    heading = rotation_from_quaternion(objects.quaternion_xyzw)[:, :, 0] @ _RADAR_R_LABEL
    return Boxes(
        centre_m=objects.centre_m @ _RADAR_R_LABEL,
        size_m=objects.size_m,
        yaw_rad=np.arctan2(heading[:, 1], heading[:, 0]),
        label=_class_names(kitti_names(objects), classes),
    )


def kitti_names(objects: DelftObjects) -> list[str]:
    """Class names of a JSON label file as the text files have them."""
    return [
        "Cyclist" if name == "bicycle" and attributes.get("has_rider") else _KITTI_NAMES.get(name, name)
        for name, attributes in zip(objects.class_name, objects.attributes, strict=True)
    ]


def _class_names(names: list[str], classes: str) -> Any:
    return [normalised_class(name, CIRRUS_FROM_VIEW_OF_DELFT) for name in names] if classes == "cirrus" else names
