"""Argoverse 1's tracking logs (Chang et al., CVPR 2019).

``<log>/lidar/PC_<time_ns>.ply``, ``per_sweep_annotations_amodal/tracked_object_labels_<time_ns>.json``,
``poses/city_SE3_egovehicle_<time_ns>.json``, ``<camera>/<camera>_<time_ns>.jpg``, ``vehicle_calibration_info.json``.
Coordinates are the ego vehicle's: x forward, y left, z up. Source: argoverse-api, MIT,
https://github.com/argoverse/argoverse-api.
"""

import hashlib
from collections.abc import Sequence
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from jaxtyping import Float

from farfield.datasets.base import Dataset, Indices, Poses, all_poses
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.files.argoverse1 import read_ego_pose, read_sweep_labels, read_vehicle_calibration
from farfield.files.ascii_table import whole_numbers
from farfield.files.images import image_size, read_image
from farfield.files.limits import MAX_RINGS
from farfield.files.ply import read_ply
from farfield.files.remote_paths import as_path
from farfield.files.suffixes import pattern_in_any_case
from farfield.frame import Annotation, Boxes, Camera, Cloud, Frame, Lazy, Sensor, camera_sensor
from farfield.frame.cloud_columns import returned
from farfield.geometry.poses import invert, pose, rotation_from_quaternion, yaw_from_quaternion
from farfield.vocabulary.classes import CIRRUS_FROM_ARGOVERSE1, normalised_class

_SWEEPS, _LABELS, _POSES = "lidar/PC_*.ply", "per_sweep_annotations_amodal", "poses"
_COLUMNS = ("x", "y", "z", "intensity", "laser_number")
_IMAGE_WITHIN_NS = 100_000_000
_FULL_INTENSITY = 255.0
_DEPTHS = ("", "*/", "*/*/")


def is_argoverse1(root: Path) -> bool:
    """Whether a folder holds logs of Argoverse 1: PLY sweeps, and labels, poses or a calibration beside them."""
    return any(True for prefix in _DEPTHS for path in root.glob(pattern_in_any_case(prefix + _SWEEPS)) if _is_log(path))


def _is_log(sweep: Path) -> bool:
    log = sweep.parents[1]
    return _time(sweep) is not None and any(
        (log / name).exists() for name in (_LABELS, _POSES, "vehicle_calibration_info.json", "city_info.json")
    )


def _time(path: Path) -> int | None:
    digits = path.stem.rpartition("_")[2]
    return int(digits) if digits.isascii() and digits.isdigit() and len(digits) <= 18 else None


class _Argoverse1Log:
    """One drive: its sweeps, cameras and pictures, each read once."""

    def __init__(self, root: Path) -> None:
        self.root, self.name = root, root.resolve().name
        paths = root.glob(pattern_in_any_case(_SWEEPS))
        self.sweeps = {time_ns: path for path in sorted(paths) if (time_ns := _time(path)) is not None}

    @property
    def part(self) -> str:
        """``train``, ``val`` or ``test``, as the folder above says (``train1`` to ``train4`` are one); else empty."""
        above = self.root.resolve().parent.name.rstrip("1234")
        return above if above in ("train", "val", "test") else ""

    def labels(self, time_ns: int) -> Path | None:
        path = self.root / _LABELS / f"tracked_object_labels_{time_ns}.json"
        return path if path.is_file() else None

    def pose(self, time_ns: int) -> Float[np.ndarray, "4 4"] | None:
        """The ego vehicle's pose in the city at a sweep; None where there is none."""
        path = self.root / _POSES / f"city_SE3_egovehicle_{time_ns}.json"
        if not path.is_file():
            return None
        quaternion, translation = read_ego_pose(path)
        return pose(rotation_from_quaternion(quaternion), translation)

    @cached_property
    def pictures(self) -> dict[str, dict[int, Path]]:
        """Pictures by camera and time."""
        folders = [path for path in sorted(self.root.iterdir()) if path.is_dir()]
        by_camera = {
            folder.name: {
                time_ns: path
                for path in sorted(folder.glob(pattern_in_any_case(f"{folder.name}_*.jpg")))
                if (time_ns := _time(path)) is not None
            }
            for folder in folders
            if folder.name.startswith(("ring_", "stereo_"))
        }
        return {name: paths for name, paths in by_camera.items() if paths}

    @cached_property
    def cameras(self) -> dict[str, Camera]:
        """The calibrated cameras of which there are pictures, which tell their size."""
        path = self.root / "vehicle_calibration_info.json"
        read = read_vehicle_calibration(path) if path.is_file() else {}
        cameras = {}
        for name, paths in self.pictures.items():
            if name in read:
                width, height = image_size(next(iter(paths.values())))
                ego_T_camera = pose(rotation_from_quaternion(read[name].quaternion_xyzw), read[name].translation_m)
                cameras[name] = Camera(
                    matrix=read[name].matrix, camera_T_lidar=invert(ego_T_camera), width_px=width, height_px=height
                )
        return cameras


class Argoverse1(Dataset):
    """Argoverse 1's logs: cloud ``"lidar"`` in ego coordinates, cameras by name, boxes with tracks, city poses.

    The cloud is that of two LiDARs on one mast, so it has no pose of its own; ``ring`` is ``laser_number``. Pictures
    are published undistorted. The annotation's ``details`` have ``occlusion``, -1 where a label has none. Track numbers
    are made of the UUIDs. Times do not count from 1970.

    Args:
        root: One log, a folder of logs, or one with ``train1``... ``val``, ``test``.
        classes: ``"cirrus"`` translates classes, ``"argoverse1"`` keeps them.

    Raises:
        DatasetError: If there is no sweep, or two logs have one name.
        ConfigError: If ``classes`` is unknown.
    """

    name = "argoverse1"

    def __init__(self, root: Path | str, *, classes: str = "cirrus") -> None:
        if classes not in ("cirrus", "argoverse1"):
            raise ConfigError(f"argoverse1: expected classes to be one of 'cirrus', 'argoverse1', got {classes!r}")
        self.root, self.classes = as_path(root), classes
        folders = {
            path.parents[1] for prefix in _DEPTHS for path in self.root.glob(pattern_in_any_case(prefix + _SWEEPS))
        }
        self.logs = [_Argoverse1Log(path) for path in sorted(folders)]
        self._index = [(log, time_ns) for log in self.logs for time_ns in sorted(log.sweeps)]
        if not self._index:
            raise DatasetError(f"{self.root}: expected <log>/{_SWEEPS}, found none")
        names = [log.name for log in self.logs]
        double = next((name for name in names if names.count(name) > 1), None)
        if double is not None:
            raise DatasetError(f"{self.root}: expected logs of different names, found {double!r} twice")
        self.sequences = tuple(log.name for log, _ in self._index)
        self.frame_ids = tuple(str(time_ns) for _, time_ns in self._index)

    def split_parts(self) -> dict[str, list[str]]:
        """The logs below ``train*``, ``val`` and ``test``; empty where some lie elsewhere."""
        parts: dict[str, list[str]] = {}
        for log in self.logs:
            parts.setdefault(log.part, []).append(log.name)
        return {} if "" in parts else parts

    def files(self, index: int) -> Sequence[Path]:
        """List the files of frame ``index``; the calibration is shared by the log."""
        log, time_ns = self._index[index]
        poses = log.root / _POSES / f"city_SE3_egovehicle_{time_ns}.json"
        others = (log.labels(time_ns), poses if poses.is_file() else None)
        return [log.sweeps[time_ns], *(path for path in others if path is not None)]

    def has_annotation(self, index: int) -> bool:
        """Whether there are labels of frame ``index``."""
        log, time_ns = self._index[index]
        return log.labels(time_ns) is not None

    def _times_of(self, indices: Indices) -> Indices | None:
        return np.array([self._index[index][1] for index in indices], dtype=np.int64)

    def _poses_of(self, indices: Indices) -> Poses | None:
        frames = (self._index[index] for index in indices)
        return all_poses(log.pose(time_ns) for log, time_ns in frames)

    def frame(self, index: int) -> Frame:
        """Build frame ``index``."""
        log, time_ns = self._index[index]
        labels = log.labels(time_ns)
        nearest = {name: min(paths, key=lambda time: abs(time - time_ns)) for name, paths in log.pictures.items()}
        times_ns = {name: time for name, time in nearest.items() if abs(time - time_ns) <= _IMAGE_WITHIN_NS}
        return Frame(
            sequence=log.name,
            frame_id=self.frame_ids[index],
            time_ns=time_ns,
            clouds=Lazy({"lidar": partial(_read_cloud, log.sweeps[time_ns])}),
            images=Lazy({name: partial(read_image, log.pictures[name][time]) for name, time in times_ns.items()}),
            cameras=log.cameras,
            sensors={
                "lidar": Sensor(kind="lidar", time_ns=time_ns),
                **{name: camera_sensor(camera) for name, camera in log.cameras.items()},
                **{name: camera_sensor(log.cameras.get(name), time) for name, time in times_ns.items()},
            },
            load_annotation=None if labels is None else partial(_read_annotation, labels, time_ns, self.classes),
            world_T_frame=log.pose(time_ns),
            reference="ego",
            metadata={"files": [str(path) for path in self.files(index)]},
        )


def _read_cloud(path: Path) -> Cloud:
    columns = read_ply(path)
    lacking = [name for name in _COLUMNS if name not in columns]
    if lacking:
        actual = ", ".join(columns)[:120]
        raise FileFormatError(path, where="the header", expected=f"{', '.join(_COLUMNS)}", got=actual)
    points = np.column_stack([columns[axis] for axis in "xyz"]).astype(np.float32)
    valid = returned(path, points)
    strength = columns["intensity"][valid].astype(np.float64)
    if not ((strength >= 0) & (strength <= _FULL_INTENSITY)).all():
        actual = f"{strength.min():g} to {strength.max():g}"
        raise FileFormatError(path, where="intensity", expected="numbers from 0 to 255", got=actual)
    lasers = columns["laser_number"][valid].astype(np.float64)
    ring = whole_numbers(lasers, largest=MAX_RINGS - 1, path=path, where="laser_number")
    extra = {name: values[valid] for name, values in columns.items() if name not in _COLUMNS}
    return Cloud(
        points[valid], (strength / _FULL_INTENSITY).astype(np.float32), {"ring": ring, **extra}, int((~valid).sum())
    )


def _read_annotation(path: Path, time_ns: int, classes: str) -> Annotation:
    labels = read_sweep_labels(path, time_ns)
    ours = [normalised_class(name, CIRRUS_FROM_ARGOVERSE1) for name in labels.name]
    boxes = Boxes(
        centre_m=labels.centre_m,
        size_m=labels.size_m,
        yaw_rad=yaw_from_quaternion(labels.quaternion_xyzw) if labels.name else np.zeros(0),
        label=list(labels.name) if classes == "argoverse1" else ours,
        track_id=np.array([_number(track) for track in labels.track], dtype=np.int64),
    )
    return Annotation(boxes=boxes, original_label=labels.name, details={"occlusion": labels.occlusion})


def _number(track: str) -> int:
    """A number for a UUID, the same in every file: 52 bits of its SHA-256."""
    return int(hashlib.sha256(track.encode()).hexdigest()[:13], 16)
