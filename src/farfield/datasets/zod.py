"""Zenseact Open Dataset, single frames (Alibeigi et al., ICCV 2023): a key sweep with its picture and objects.

``single_frames/<number>/{lidar_velodyne/*.npy, camera_front_blur/*.jpg, annotations/object_detection.json,
calibration.json, ego_motion.json, metadata.json, info.json}``, ``splits/frames_*.txt`` or
``trainval-frames-*.json``. What it does not say itself is taken from the authors' kit
(https://github.com/zenseact/zod).
"""

from collections.abc import Iterator, Sequence, Set
from functools import cached_property, partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int64

from farfield.datasets.base import Dataset, Indices, Poses, all_known, all_poses
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.files.images import read_image
from farfield.files.npy import read_npy
from farfield.files.remote_paths import as_path
from farfield.files.suffixes import any_case
from farfield.files.zod import (
    ZodCalibration,
    ZodObject,
    read_calibration,
    read_identities,
    read_motion,
    read_objects,
    read_trainval,
    read_words,
    sweeps_listed,
    time_of_name,
)
from farfield.frame import Annotation, Boxes, Cloud, Constant, Frame, Key, Lazy, Sensor
from farfield.frame.cloud_columns import returned
from farfield.geometry.deskewing import PoseTrack
from farfield.geometry.poses import invert, yaw_from_quaternion
from farfield.vocabulary.classes import normalised_class
from farfield.vocabulary.counts import count_of

FRAME_T_LIDAR = np.array([[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
"""The LiDAR looks along its y, which is our x."""
OWN_CAR_M = np.array([[-1.5, -3.0, -1.5], [1.5, 3.0, 0.5]])
"""Where returns are the measuring car's own, in the LiDAR's coordinates; the ends do not belong to it."""
CIRRUS_FROM_ZOD = {
    **dict.fromkeys(("Vehicle_Car", "Vehicle_Van", "Vehicle_Emergency"), "vehicle"),
    **dict.fromkeys(("Vehicle_Truck", "Vehicle_Bus", "Vehicle_TramTrain", "Vehicle_HeavyEquip"), "large_vehicle"),
    "Vehicle_Trailer": "trailer",
    "VulnerableVehicle_Bicycle": "bicycle",
    "VulnerableVehicle_Motorcycle": "motorcycle",
    **dict.fromkeys(
        ("VulnerableVehicle_Stroller", "VulnerableVehicle_Wheelchair", "VulnerableVehicle_PersonalTransporter"),
        "wheeled_pedestrian",
    ),
    "Pedestrian": "pedestrian",
    "Animal": "animal",
}
_FIELDS = ("x", "y", "z", "timestamp", "intensity", "diode_index")
_PICTURES = ("blur", "dnat", "original")
_CONDITIONS = {"time": "time_of_day", "weather": "scraped_weather", "road": "road_type", "surface": "road_condition"}
_PARTS, _VERSIONS = ("train", "val"), ("full", "mini")
_MOST_OFFSET_US = 1_000_000


def folders_in(root: Path) -> list[Path]:
    """The folders of single frames: below ``single_frames``, in the folder, or itself."""
    for base in (root / "single_frames", root):
        folders = sorted(path for path in base.glob("*") if path.name.isdigit() and _sweeps(path))
        if folders:
            return folders
    return [root] if _sweeps(root) and (root / "calibration.json").is_file() else []


def _sweeps(folder: Path) -> list[Path]:
    """Sweeps with a time in their name, in its order."""
    paths = (folder / "lidar_velodyne").glob("*" + any_case(".npy"))
    timed = [(time_ns, path) for path in paths if (time_ns := time_of_name(path)) is not None]
    return [path for _, path in sorted(timed)]


class _Folder:
    """One single frame: its key sweep, those round it, and what belongs to it, each read once."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.name = folder, folder.resolve().name
        self.sweeps = _sweeps(folder)

    @cached_property
    def key(self) -> int:
        """Place of the annotated sweep among those that are there: the middle one of the frame's list."""
        info = self.folder / "info.json"
        listed = sweeps_listed(info) if info.is_file() else []
        names = [path.name.replace(":", "_") for path in self.sweeps]  # as disks of Windows have them
        if listed:
            middle = listed[len(listed) // 2].replace(":", "_")
            if middle not in names:
                raise DatasetError(f"{info}: expected its middle sweep {middle} in lidar_velodyne, found none")
            return names.index(middle)
        if len(names) % 2 == 0:
            raise DatasetError(
                f"{self.folder}: expected info.json with the list of sweeps, or an odd number of sweeps, of which the "
                f"middle one is annotated; found {len(names)}"
            )
        return len(names) // 2

    @cached_property
    def known_key(self) -> int | None:
        """Place of the annotated sweep; None where it cannot be told, as :attr:`key` says."""
        try:
            return self.key
        except (DatasetError, FileFormatError):
            return None

    def file(self, name: str) -> Path | None:
        path = self.folder / name
        return path if path.is_file() else None

    @cached_property
    def calibration(self) -> ZodCalibration | None:
        path = self.file("calibration.json")
        return None if path is None else read_calibration(path)

    @cached_property
    def track(self) -> PoseTrack | None:
        path = self.file("ego_motion.json")
        if path is None or self.calibration is None:
            return None
        times_ns, world_T_ego = read_motion(path)
        try:
            return PoseTrack(times_ns, world_T_ego @ self.calibration.ego_T_lidar @ invert(FRAME_T_LIDAR))
        except ConfigError as error:
            raise FileFormatError(path, where="poses", expected="rigid motions", got=str(error)[:120]) from error

    def pose(self, time_ns: int) -> Float[np.ndarray, "4 4"] | None:
        times_ns = np.array([time_ns], dtype=np.int64)
        covered = self.track is not None and bool(self.track.covers(times_ns)[0])
        return self.track.at(times_ns)[0] if covered and self.track is not None else None

    @cached_property
    def picture(self) -> Path | None:
        """The key picture: blurred faces before changed ones; of several the middle."""
        for kind in _PICTURES:
            paths = sorted((self.folder / f"camera_front_{kind}").glob("*" + any_case(".jpg")))
            if paths:
                return paths[len(paths) // 2]
        return None


class Zod(Dataset):
    """ZOD's single frames: cloud ``"lidar"``, picture ``"front"``, boxes of the key sweep.

    A single frame is a drive: its key sweep, which is annotated, and the sweeps before and after it that are there,
    with poses. Coordinates are the LiDAR's, turned so that x looks forward (y in the files). Points have ``ring``
    (``diode_index``) and ``offset_ns``; returns of the measuring car itself are left out.

    ``annotation.details``: ``uuid``, ``occlusion`` in words, ``with_rider`` (1, 0, -1 not told) and ``unclear``.
    Objects that were annotated in the picture alone stand in ``unboxed["image_only_px"]`` (left, top, right, bottom)
    and ``unboxed["image_only_label"]``, and ``metadata["image_only"]`` counts them. The camera's fisheye lens (Kannala
    and Brandt) has no place in ``cameras``; its numbers stand in ``metadata["lens"]``.

    Args:
        root: The data set's folder, ``single_frames``, or one single frame.
        classes: ``"cirrus"`` translates class names, ``"zod"`` keeps them: class, ``_``, type.
        own_car: Whether to keep the returns of the measuring car.

    Raises:
        DatasetError: If there is no sweep.
        ConfigError: If ``classes`` is unknown.
    """

    name = "zod"

    def __init__(self, root: Path | str, *, classes: str = "cirrus", own_car: bool = False) -> None:
        if classes not in ("cirrus", "zod"):
            raise ConfigError(f"zod: expected classes to be one of 'cirrus', 'zod', got {classes!r}")
        self.root, self.classes, self.own_car = as_path(root), classes, own_car
        self.folders = [_Folder(folder) for folder in folders_in(self.root)]
        self._index = [(folder, number) for folder in self.folders for number in range(len(folder.sweeps))]
        if not self._index:
            raise DatasetError(f"{self.root}: expected single_frames/<number>/lidar_velodyne/*_<time>Z.npy, found none")
        self.sequences = tuple(folder.name for folder, _ in self._index)
        self.frame_ids = tuple(str(self._time_ns(index)) for index in range(len(self._index)))

    @property
    def notes(self) -> tuple[str, ...]:
        """What of the set cannot be used."""
        pictures = any(folder.picture is not None for folder in self.folders[:100])
        lens = "zod: pictures are shown without calibration: the camera's fisheye lens has no place in cameras"
        torn = [folder.name for folder in self.folders if folder.known_key is None]
        which = f"zod: which sweep is annotated cannot be told of {count_of(len(torn), 'single frame')}, such as "
        return (*([lens] if pictures else []), *([f"{which}{torn[0]}: taken for not annotated"] if torn else []))

    def _time_ns(self, index: int) -> int:
        folder, number = self._index[index]
        return time_of_name(folder.sweeps[number]) or 0

    def _is_key(self, index: int) -> bool:
        folder, number = self._index[index]
        return number == folder.known_key

    def split_parts(self) -> dict[str, list[str]]:
        """The single frames of each part: those that were published, or a file of the user's where they are not."""
        return self._published or super().split_parts()

    def benchmark_keys(self, name: str) -> Set[Key]:
        """(sequence, frame) of ``"train"`` or ``"val"``, which :meth:`split` gives without ``by`` as well.

        Raises:
            ConfigError: If there is no such part.
        """
        parts = self._published
        if name not in parts:
            return super().benchmark_keys(name)
        members = set(parts[name])
        return {key for key in self.keys if key[0] in members}

    @cached_property
    def _published(self) -> dict[str, list[str]]:
        """The parts of ``splits/frames_full_*.txt`` or ``frames_mini_*.txt``, or of ``trainval-frames-*.json``."""
        names = {folder.name for folder in self.folders}
        for path, parts in self._listed():
            twice = set(parts["train"]) & set(parts["val"])
            if twice:
                raise DatasetError(f"{path}: expected {min(twice)} in one part, found it in both")
            return {part: [name for name in parts[part] if name in names] for part in _PARTS}
        return {}

    def _listed(self) -> Iterator[tuple[Path, dict[str, list[str]]]]:
        """Files that list the parts, the split files before the records of the kit."""
        bases = (self.root, self.root.parent, self.root.parent.parent)
        for base, version in product(bases, _VERSIONS):
            files = {part: base / "splits" / f"frames_{version}_{part}.txt" for part in _PARTS}
            if all(path.is_file() for path in files.values()):
                yield files["train"], {part: read_identities(path) for part, path in files.items()}
        for base, version in product(bases, _VERSIONS):
            path = base / f"trainval-frames-{version}.json"
            if path.is_file():
                yield path, {"train": [], "val": []} | read_trainval(path)

    def files(self, index: int) -> Sequence[Path]:
        """List the files of frame ``index``."""
        folder, number = self._index[index]
        beside = [folder.file(name) for name in ("calibration.json", "ego_motion.json", "info.json")]
        key = [folder.file("annotations/object_detection.json"), folder.picture] if self._is_key(index) else []
        return [folder.sweeps[number], *(path for path in (*beside, *key) if path is not None)]

    def has_annotation(self, index: int) -> bool:
        """Whether frame ``index`` is a key sweep with objects."""
        folder, _ = self._index[index]
        return self._is_key(index) and folder.file("annotations/object_detection.json") is not None

    def _times_of(self, indices: Indices) -> Indices | None:
        return all_known(self._time_ns(int(index)) for index in indices)

    def _poses_of(self, indices: Indices) -> Poses | None:
        return all_poses(self._index[index][0].pose(self._time_ns(int(index))) for index in indices)

    def frame(self, index: int) -> Frame:
        """Build frame ``index``.

        Raises:
            DatasetError: If it cannot be told which sweep is annotated.
            FileFormatError: If a file is damaged.
        """
        folder, number = self._index[index]
        time_ns, key = self._time_ns(index), number == folder.key
        labels = folder.file("annotations/object_detection.json") if key else None
        picture, words = folder.picture if key else None, folder.file("metadata.json")
        sensors = {"lidar": Sensor(kind="lidar", frame_T_sensor=np.eye(4), time_ns=time_ns)}
        metadata: dict[str, Any] = {"files": Constant([str(path) for path in self.files(index)])}
        if picture is not None:
            sensors["front"] = _camera(folder.calibration, picture)
            if folder.calibration is not None:
                metadata["lens"] = Constant(dict(folder.calibration.lens))
        if labels is not None:
            metadata["image_only"] = partial(_count_image_only, labels)
        facts = {} if words is None else read_words(words)
        return Frame(
            sequence=folder.name,
            frame_id=self.frame_ids[index],
            time_ns=time_ns,
            clouds=Lazy({"lidar": partial(_read_sweep, folder.sweeps[number], self.own_car)}),
            images=Lazy({} if picture is None else {"front": partial(read_image, picture)}),
            sensors=sensors,
            load_annotation=None if labels is None else partial(_read_annotation, labels, self.classes),
            world_T_frame=folder.pose(time_ns),
            reference="lidar",
            conditions={name: facts[field] for name, field in _CONDITIONS.items() if field in facts},
            metadata=Lazy(metadata),
        )


def _camera(calibration: ZodCalibration | None, picture: Path) -> Sensor:
    pose = None
    if calibration is not None:
        pose = FRAME_T_LIDAR @ invert(calibration.ego_T_lidar) @ calibration.ego_T_camera
    return Sensor(kind="camera", frame_T_sensor=pose, in_frame=False, time_ns=time_of_name(picture))


def _read_sweep(path: Path, own_car: bool) -> Cloud:
    rows = read_npy(path, fields=True)
    names = rows.dtype.names or ()
    kinds = {"x": "f", "y": "f", "z": "f", "timestamp": "iu", "intensity": "u", "diode_index": "u"}
    sound = rows.ndim == 1 and all(name in names and rows.dtype[name].kind in kinds[name] for name in _FIELDS)
    if not sound or rows.dtype["intensity"].itemsize != 1:
        expected = f"one row a point of fields {', '.join(_FIELDS)}, intensity of one byte"
        raise FileFormatError(path, where="the header", expected=expected, got=f"{rows.shape} of {rows.dtype}"[:200])
    lidar_m = np.column_stack([rows[axis] for axis in "xyz"]).astype(np.float32)
    valid = returned(path, lidar_m)
    with np.errstate(invalid="ignore"):
        own = ((lidar_m > OWN_CAR_M[0]) & (lidar_m < OWN_CAR_M[1])).all(axis=1)
    rest = valid if own_car else valid & ~own
    offset_us: Int64[np.ndarray, " n"] = rows["timestamp"].astype(np.int64)[rest]
    if len(offset_us) and np.abs(offset_us).max() > _MOST_OFFSET_US:
        expected = "microseconds within a second of the time in the file's name"
        raise FileFormatError(path, where="field timestamp", expected=expected, got=f"{np.abs(offset_us).max()}")
    x, y, z = lidar_m[rest].T
    extra = {"ring": rows["diode_index"][rest], "offset_ns": offset_us * 1000}
    intensity = rows["intensity"][rest].astype(np.float32) / np.float32(255)
    return Cloud(np.column_stack([y, -x, z]), intensity, extra, int((~valid).sum()))


def _count_image_only(path: Path) -> str:
    """How many objects were annotated in the picture alone, in words."""
    objects = read_objects(path)
    return f"{sum(entry.centre_m is None for entry in objects)} of {len(objects)} objects have no box in 3D"


def _read_annotation(path: Path, classes: str) -> Annotation:
    objects = read_objects(path)
    boxed = [entry for entry in objects if entry.centre_m is not None]
    flat = [entry for entry in objects if entry.centre_m is None]
    names = [entry.name for entry in boxed]
    turns = np.array([entry.quaternion_xyzw for entry in boxed], dtype=np.float64).reshape(-1, 4)
    boxes = Boxes(
        centre_m=np.array([entry.centre_m for entry in boxed], dtype=np.float64).reshape(-1, 3),
        size_m=np.array([entry.size_m for entry in boxed], dtype=np.float64).reshape(-1, 3),
        yaw_rad=yaw_from_quaternion(turns) if boxed else np.zeros(0),
        label=names if classes == "zod" else [_translated(entry) for entry in boxed],
    ).transform(FRAME_T_LIDAR)
    return Annotation(
        boxes=boxes,
        original_label=tuple(names),
        details={
            "uuid": np.array([entry.uuid for entry in boxed], dtype=np.str_),
            "occlusion": np.array([entry.occlusion for entry in boxed], dtype=np.str_),
            "with_rider": np.array([entry.with_rider for entry in boxed], dtype=np.int64),
            "unclear": np.array([entry.unclear for entry in boxed], dtype=bool),
        },
        unboxed={
            "image_only_px": np.array([entry.image_px for entry in flat], dtype=np.float64).reshape(-1, 4),
            "image_only_label": tuple(entry.name for entry in flat),
        },
    )


def _translated(entry: ZodObject) -> str:
    """Our class; of the published ones that are none of ours, and of what is unclear, ``unknown``."""
    published = ("Vehicle", "VulnerableVehicle", "PoleObject", "Traffic", "DynamicBarrier")
    if entry.unclear or (entry.name not in CIRRUS_FROM_ZOD and entry.name.startswith(published)):
        return "unknown"
    return normalised_class(entry.name, CIRRUS_FROM_ZOD)
