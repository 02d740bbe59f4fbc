"""Data sets of the nuScenes schema: a frame is a sample, in the coordinates of the car at its time."""

from collections import Counter
from collections.abc import Mapping, Sequence
from copy import copy
from functools import cached_property, partial
from itertools import chain
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from jaxtyping import Float, UInt8

from farfield.datasets.base import Dataset, Indices, Poses, all_known, all_poses
from farfield.datasets.nuscenes.clouds import SweepFile, is_of_four_columns, load_cloud
from farfield.datasets.nuscenes.dialects import NUSCENES, T4, TRUCKSCENES, Dialect, TableFolder, table_folders
from farfield.datasets.nuscenes.presence import check_there, far_apart, path_within, what_to_unpack
from farfield.datasets.nuscenes.tables import Rows, SchemaTables
from farfield.datasets.splits import SPLIT_SHARES, read_parts
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.files.cuboids import check_turns
from farfield.files.images import read_image
from farfield.files.intensities import intensity_scale_of
from farfield.files.pcd import read_pcd
from farfield.files.remote_paths import as_path
from farfield.frame import Annotation, Boxes, Camera, Frame, Lazy, Sensor
from farfield.geometry.poses import invert, pose, rotation_from_quaternion
from farfield.vocabulary.classes import NUSCENES_DETECTION_CLASSES, normalised_class
from farfield.vocabulary.counts import count_of
from farfield.vocabulary.nuscenes_splits import official_parts

_LEADING = ("LIDAR_TOP", "LIDAR_CONCAT", "LIDAR_LEFT")
_ORDER = {"lidar": 0, "radar": 1, "camera": 2}
_SAMPLES = 3
_LOOKED_AT = 16
_MOST_SWEEPS = 100
_LARGEST_COEFFICIENT = 1e6


class SchemaDataset(Dataset):
    """Samples of the nuScenes schema: clouds by channel, images, boxes with velocities, tracks and official counts.

    Coordinates are the car's (x forward, y left, z up, at the rear axle on the ground) at the sample's time: that of
    its key sweep of the top LiDAR, or of TruckScenes the pose nearest to the sample's time. Every cloud and camera goes
    by its own calibration and its own pose; ``lag_s`` says how long before the frame's time a point was measured. A
    radar's velocities are turned with its points and stay as measured: relative to the sensor or, ``*_comp``,
    compensated; ``doppler_m_s`` is the relative one along the line of sight. Nothing is filtered. A camera whose lens
    has more than the five coefficients k1, k2, p1, p2, k3 has a picture and a place, and is none of ``cameras``.

    The annotation's ``original_label`` are the categories; its ``details`` are ``visibility``, ``attribute`` (with
    commas between where there are several), ``radar_points``, ``instance_token`` and ``annotation_token``.

    Args:
        root: The folder with ``samples`` and the tables.
        version: The folder of the tables, such as ``"v1.0-mini"``, where there are several.
        classes: ``"cirrus"`` translates categories, ``"original"`` keeps them, ``"detection"`` takes the names of
            nuScenes' detection task for those that it scores and keeps the others.
        sweeps: Files of each LiDAR and radar in a cloud: the key frame's and those before it by ``prev``.
        size_order: ``"wlh"`` as the schema says, or ``"lwh"`` of data sets that store the length first.
        axes: ``"car"``, or ``"world"``: the same origin, axes as of the map, as nuScenes' scores measure.
        intensity_scale: Value that stands for full reflectance in a LiDAR's PCD files (default: 1, 255 or 65535 by some
            of them).
        whole_scenes: Whether scenes are left out of which files lack, key frames or sweeps that are asked for, as where
            some of the archives are unpacked. A sensor without any folder does not count. Looks for every file.

    Raises:
        DatasetError: If there are no such tables, they disagree, or no scene is whole.
        ConfigError: If an option is unknown, or there are several versions.
    """

    dialect: ClassVar[Dialect]

    def __init__(
        self,
        root: Path | str,
        *,
        version: str = "",
        classes: Literal["cirrus", "original", "detection"] = "cirrus",
        sweeps: int = 1,
        size_order: Literal["wlh", "lwh"] = "wlh",
        axes: Literal["car", "world"] = "car",
        intensity_scale: float | None = None,
        whole_scenes: bool = False,
    ) -> None:
        for name, value, choices in (
            ("classes", classes, ("cirrus", "original", "detection")),
            ("size_order", size_order, ("wlh", "lwh")),
            ("axes", axes, ("car", "world")),
        ):
            if value not in choices:
                raise ConfigError(f"{self.name}: expected {name} to be one of {', '.join(choices)}, got {value!r}")
        if type(sweeps) is not int or not 1 <= sweeps <= _MOST_SWEEPS:
            raise ConfigError(f"{self.name}: expected sweeps from 1 to {_MOST_SWEEPS}, got {sweeps!r}")
        self.root, self.sweeps = as_path(root), sweeps
        self.classes: Literal["cirrus", "original", "detection"] = classes
        self.axes: Literal["car", "world"] = axes
        self.size_order, self._given_scale = size_order, intensity_scale
        folders = [folder for folder in table_folders(self.root, self.dialect) if version in ("", folder.version)]
        if not folders:
            sought = f"the version {version}" if version else f"the tables of {self.dialect.title}"
            raise DatasetError(f"{self.root}: expected {sought}, found none")
        if self.dialect.versions is not None and len(folders) > 1:
            names = ", ".join(folder.version for folder in folders)
            raise ConfigError(
                f"{self.root}: expected one version, found {names}. Name one: --tables {folders[0].version} "
                f"(version={folders[0].version!r} in Python and experiments)."
            )
        self.stores = [SchemaTables(folder, self.dialect, size_order) for folder in folders]
        self._index = [(store, int(row)) for store in self.stores for row in store.samples]
        if not self._index:
            raise DatasetError(f"{folders[0].tables}: expected samples in sample.json, found none")
        self._check_t4()
        self._left_out = ""
        if whole_scenes:
            self._index = self._of_whole_scenes()
        self.sequences = tuple(self._sequence_names())
        self.frame_ids = tuple(store["sample"]["token"][row].decode() for store, row in self._index)

    def _check_t4(self) -> None:
        if self.dialect.versions is None:
            for store in self.stores:
                count = len(store["scene"]["token"])
                if count != 1:
                    raise DatasetError(f"{store.path('scene')}: expected exactly one scene a data set, got {count}")

    def _of_whole_scenes(self) -> list[tuple[SchemaTables, int]]:
        """The samples of scenes that lack no file of the sensors that have a folder."""
        scenes = [(id(store), int(store["sample"]["scene_token"][row])) for store, row in self._index]
        torn: dict[tuple[int, int], Path] = {}
        for index, scene in enumerate(scenes):
            if scene not in torn and (path := self._first_missing(index, of_folders=True)) is not None:
                torn[scene] = path
        count = len(set(scenes))
        if len(torn) == count:
            path = torn[scenes[0]]
            unpack = what_to_unpack(path, self._index[0][0].folder)
            raise DatasetError(f"{self.root}: expected a scene that lacks no file, found none: no {path}. {unpack}")
        if torn:
            self._left_out = f"{len(torn)} of {count_of(count, 'scene')} lack files and are left out (whole_scenes)"
        return [entry for entry, scene in zip(self._index, scenes, strict=True) if scene not in torn]

    def _sequence_names(self) -> list[str]:
        """The scenes' names; where several data sets share one, behind their folder's."""
        owners = Counter(name for store in self.stores for name in store["scene"]["name"])
        names = []
        for store, row in self._index:
            name = str(store["scene"]["name"][store["sample"]["scene_token"][row]])
            folder = store.folder.root.relative_to(self.root).as_posix()
            names.append(name if owners[name] == 1 else f"{folder}/{name}")
        return names

    @property
    def notes(self) -> tuple[str, ...]:
        """Counts in the tables that are not those of the records, lenses that are not modelled, files not there."""
        notes = [note for store in self.stores for note in store.notes]
        lenses = sorted({channel for store in self.stores for channel in _further_lenses(store)})
        if lenses:
            notes.append(
                f"pictures of {', '.join(lenses)} are shown without calibration: lenses of more than k1, k2, p1, p2, "
                "k3 have no place in cameras"
            )
        return (*notes, *([self._left_out] if self._left_out else []), *self._missing_files())

    def _missing_files(self) -> list[str]:
        """A sentence on the files that are not there, by a few frames that are spread over the set."""
        looked_at = list(far_apart(len(self), _LOOKED_AT))[:_LOOKED_AT]
        lacking = [path for index in looked_at if (path := self._first_missing(index)) is not None]
        if not lacking:
            return []
        folder = next(store.folder for store in self.stores if lacking[0].is_relative_to(store.folder.root))
        return [
            f"files are missing of {len(lacking)} of the {count_of(len(looked_at), 'frame')} that were looked at, such "
            f"as {lacking[0].relative_to(self.root)}. {what_to_unpack(lacking[0], folder)}. What is there can be read; "
            "whole_scenes=True (in Python, or under options of an experiment) leaves out the scenes that lack files"
        ]

    def _first_missing(self, index: int, *, of_folders: bool = False) -> Path | None:
        """The first file of a frame that is not there, perhaps only of sensors of which there is a folder."""
        try:
            sensors = self._files_by_sensor(index)
        except FileFormatError:  # reading the frame says it
            return None
        files = [path for paths in sensors if not of_folders or paths[0].parent.is_dir() for path in paths]
        return next((path for path in files if not path.is_file()), None)

    def _unread(self) -> list[str]:
        """What the first data set holds that is not read."""
        store = self.stores[0]
        tables = {name: what for name, what in self.dialect.unread.items() if store.path(name).is_file()}
        names = [f"{name} ({what})" for name, what in tables.items()]
        names += ["maps"] if any((store.folder.root / name).is_dir() for name in ("maps", "map")) else []
        return [f"not read: {', '.join(names)}"] if names else []

    @property
    def assumptions(self) -> tuple[str, ...]:
        """Sizes by which cars are wider than long, columns and scales taken by the numbers, and what is not read."""
        sentences = []
        ratio = self._width_over_length()
        if ratio is not None and ratio > 1:
            other = "lwh" if self.size_order == "wlh" else "wlh"
            sentences.append(
                f"sizes are taken as {self.size_order}, by which cars are {ratio:.1f} times as wide as long (median): "
                f"if they are {other}, say --size-order {other}"
            )
        if self.dialect.undecided_columns and self._of_four_columns():
            sentences.append(
                f"LiDAR files are taken for points of 4 columns by their numbers: the schema says "
                f"{self.dialect.bin_columns}, and no file beside them says how many"
            )
        if self._given_scale is None and self._spread_clouds(".pcd"):
            sentences.append(
                f"intensities reach to {self.intensity_scale:g} by the first clouds (--intensity-scale says it)"
            )
        return (*sentences, *self._unread())

    def _width_over_length(self) -> float | None:
        """Median of width over length of cars, over all stores; None without cars."""
        ratios = []
        for store in self.stores:
            categories = store["category"]["name"][store["instance"]["category_token"]]
            is_car = np.array([normalised_class(str(name), self.dialect.classes) == "vehicle" for name in categories])
            rows = np.flatnonzero(is_car[store["sample_annotation"]["instance_token"]]) if len(is_car) else _NO_ROWS
            size_m = store.size_m(rows)
            ratios.append(size_m[:, 1] / size_m[:, 0])
        joined = np.concatenate(ratios)
        return float(np.median(joined)) if len(joined) else None

    @cached_property
    def _leading_files(self) -> list[SweepFile]:
        """The leading LiDAR's files of a few frames that are spread over the set, of those that are there."""
        files: list[SweepFile] = []
        for index in far_apart(len(self), _SAMPLES):
            store, _ = self._index[index]
            leading = [data for data in self._data(index)[:1] if self._modality(store, data) == "lidar"]
            files += [file for data in leading if (file := self._sweep(store, np.eye(4), data)).path.is_file()]
            if len(files) == _SAMPLES:
                break
        return files

    def _spread_clouds(self, suffix: str) -> list[SweepFile]:
        return [file for file in self._leading_files if file.path.suffix.lower() == suffix]

    def _of_four_columns(self) -> bool:
        return any(is_of_four_columns(file, self.dialect) for file in self._spread_clouds(".bin"))

    @cached_property
    def intensity_scale(self) -> float:
        """Value that stands for full reflectance in a LiDAR's PCD files."""
        if self._given_scale is not None:
            return self._given_scale
        clouds = [read_pcd(file.path, spare_bytes=1) for file in self._spread_clouds(".pcd")]
        return intensity_scale_of([cloud["intensity"] for cloud in clouds if "intensity" in cloud])

    def split_parts(self) -> dict[str, list[str]]:
        """The scenes of each part: by a file of the data set, the tables' ``splits.json``, or nuScenes' authors."""
        named = super().split_parts()
        folder = self.stores[0].folder
        if not named and len(self.stores) == 1:
            named = read_parts(folder.tables / "splits.json", self.split_units())
            named = {part: named[part] for part in SPLIT_SHARES if part in named}
        if not named and self.dialect.name == "nuscenes":
            named = official_parts(folder.version, list(dict.fromkeys(self.sequences)))
        return named

    @staticmethod
    def _modality(store: SchemaTables, data: int) -> str:
        return str(store["sensor"]["modality"][store.sensor_of[data]])

    @staticmethod
    def _channel(store: SchemaTables, data: int) -> str:
        return str(store["sensor"]["channel"][store.sensor_of[data]])

    @staticmethod
    def _file(store: SchemaTables, data: int, column: str = "filename") -> Path:
        """The file of a record, whose name stays in the data set's folder."""
        name = store["sample_data"][column][data].decode("utf-8")
        table = store.path("sample_data")
        return path_within(store.folder.root, name, table=table, where=f"record {data}", column=column)

    def _data(self, index: int) -> list[int]:
        """Key records of a frame: the leading LiDAR first, then by kind and channel."""
        store, row = self._index[index]
        rows = store.key_data.of(row).tolist()
        return sorted(rows, key=partial(_rank, store))

    def _chain(self, store: SchemaTables, data: int) -> list[int]:
        """A record and those before it by ``prev``, as many as there are to be."""
        rows = [data]
        while len(rows) < self.sweeps and (before := int(store["sample_data"]["prev"][rows[-1]])) >= 0:
            rows.append(before)
        return rows

    def _files_by_sensor(self, index: int) -> list[list[Path]]:
        """The files of a frame's clouds and images, of each the key frame's first."""
        store, _ = self._index[index]
        records = [
            [data] if self._modality(store, data) == "camera" else self._chain(store, data)
            for data in self._data(index)
        ]
        return [[self._file(store, data) for data in rows] for rows in records]

    def files(self, index: int) -> Sequence[Path]:
        """List the files of frame ``index``: clouds, images and the tables."""
        store, _ = self._index[index]
        return [*chain.from_iterable(self._files_by_sensor(index)), store.path("sample_annotation")]

    def has_annotation(self, index: int) -> bool:
        """Whether there are annotations: a data set with an empty table of them, as the test parts are, has none."""
        return len(self._index[index][0]["sample_annotation"]["token"]) > 0

    def _reference(self, index: int) -> tuple[int, int]:
        """Time (microseconds) and row of the pose of the frame's coordinates."""
        store, row = self._index[index]
        data, sample = store["sample_data"], store["sample"]
        sample_us = int(sample["timestamp"][row])
        rows = [] if self.dialect.reference == "pose" else self._data(index)
        if not rows:
            return sample_us, store.pose_at(int(sample["scene_token"][row]), sample_us)
        return int(data["timestamp"][rows[0]]), int(data["ego_pose_token"][rows[0]])

    def _world_T_frame(self, index: int) -> Float[np.ndarray, "4 4"]:
        store, _ = self._index[index]
        world_T_car = _pose_at(store["ego_pose"], self._reference(index)[1])
        return world_T_car if self.axes == "car" else pose(np.eye(3), world_T_car[:3, 3])

    def _times_of(self, indices: Indices) -> Indices | None:
        return all_known(1000 * self._reference(index)[0] for index in indices.tolist())

    def _poses_of(self, indices: Indices) -> Poses | None:
        return all_poses(self._world_T_frame(index) for index in indices.tolist())

    def frame(self, index: int) -> Frame:
        """Build frame ``index``."""
        store, row = self._index[index]
        time_us, _ = self._reference(index)
        world_T_frame = self._world_T_frame(index)
        frame_T_world = invert(world_T_frame)
        clouds, images, cameras, sensors = {}, {}, {}, {}
        for data in self._data(index):
            channel, modality = self._channel(store, data), self._modality(store, data)
            motion = _frame_T_sensor(store, frame_T_world, data)
            if modality == "camera":
                camera = _camera(store, data, motion)
                if camera is not None:
                    cameras[channel] = camera
                images[channel] = partial(_read_picture, self._file(store, data), store.folder)
                time_ns = 1000 * int(store["sample_data"]["timestamp"][data])
                sensors[channel] = Sensor(kind="camera", frame_T_sensor=motion, in_frame=False, time_ns=time_ns)
                continue
            files = [self._sweep(store, frame_T_world, entry) for entry in self._chain(store, data)]
            scale = self.intensity_scale if modality == "lidar" and files[0].path.suffix.lower() == ".pcd" else None
            clouds[channel] = partial(load_cloud, files, modality, self.dialect, time_us, scale)
            kind: Any = modality
            sensors[channel] = Sensor(kind=kind, frame_T_sensor=motion, time_ns=1000 * files[0].time_us)
        annotated = self.has_annotation(index)
        rows = store.annotations.of(row)
        scene = int(store["sample"]["scene_token"][row])
        return Frame(
            sequence=self.sequences[index],
            frame_id=self.frame_ids[index],
            time_ns=1000 * time_us,
            clouds=Lazy(clouds),
            images=Lazy(images),
            cameras=cameras,
            sensors=sensors,
            reference="ego" if self.axes == "car" else "ego in the map's axes",
            load_annotation=partial(self._annotation, store, rows, frame_T_world) if annotated else None,
            world_T_frame=world_T_frame,
            metadata={
                "files": [str(path) for path in self.files(index)],
                "description": str(store["scene"]["description"][scene]),
                "sample_token": self.frame_ids[index],
            },
        )

    def _sweep(self, store: SchemaTables, frame_T_world: Float[np.ndarray, "4 4"], data: int) -> SweepFile:
        has_info = bool(store["sample_data"]["info_filename"][data])
        return SweepFile(
            path=self._file(store, data),
            info=self._file(store, data, "info_filename") if has_info else None,
            folder=store.folder,
            time_us=int(store["sample_data"]["timestamp"][data]),
            frame_T_sensor=_frame_T_sensor(store, frame_T_world, data),
        )

    def annotation(self, index: int) -> Annotation | None:
        """What was annotated in frame ``index``, without its clouds."""
        store, row = self._index[index]
        if not self.has_annotation(index):
            return None
        return self._annotation(store, store.annotations.of(row), invert(self._world_T_frame(index)))

    def _annotation(self, store: SchemaTables, rows: Rows, frame_T_world: Float[np.ndarray, "4 4"]) -> Annotation:
        if not len(rows):
            return Annotation(boxes=Boxes.empty(), original_label=())
        table = store["sample_annotation"]
        quaternion = table["rotation"][rows][:, [1, 2, 3, 0]]
        path = store.path("sample_annotation")
        check_turns(quaternion, path, f"annotation {{}} of sample {table['sample_token'][rows[0]]}")
        rotation = frame_T_world[:3, :3] @ rotation_from_quaternion(quaternion)
        instances = table["instance_token"][rows]
        original = [str(store["category"]["name"][row]) for row in store["instance"]["category_token"][instances]]
        boxes = Boxes(
            centre_m=table["translation"][rows] @ frame_T_world[:3, :3].T + frame_T_world[:3, 3],
            size_m=store.size_m(rows),
            yaw_rad=np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0]),
            label=[self._class_of(name) for name in original],
            track_id=instances,
            point_count=table["num_lidar_pts"][rows],
            velocity_m_s=store.velocities(rows) @ frame_T_world[:3, :3].T,
        )
        return Annotation(boxes=boxes, original_label=tuple(original), details=_details(store, rows))

    def _class_of(self, category: str) -> str:
        if self.classes == "cirrus":
            return normalised_class(category, self.dialect.classes)
        return NUSCENES_DETECTION_CLASSES.get(category, category) if self.classes == "detection" else category

    def as_scored(self) -> "SchemaDataset":
        """The same samples as nuScenes' result files see them: in the map's axes, under the detection task's names."""
        scored = copy(self)
        scored.axes, scored.classes = "world", "detection"
        return scored


_NO_ROWS = np.zeros(0, dtype=np.int64)


def _rank(store: SchemaTables, data: int) -> tuple[int, int, str]:
    sensor = store.sensor_of[data]
    channel = str(store["sensor"]["channel"][sensor])
    leading = _LEADING.index(channel) if channel in _LEADING else len(_LEADING)
    return _ORDER[str(store["sensor"]["modality"][sensor])], leading, channel


def _pose_at(table: Mapping[str, Any], row: int) -> Float[np.ndarray, "4 4"]:
    quaternion = np.asarray(table["rotation"][row], dtype=np.float64)[[1, 2, 3, 0]]
    return pose(rotation_from_quaternion(quaternion), np.asarray(table["translation"][row], dtype=np.float64))


def _frame_T_sensor(
    store: SchemaTables, frame_T_world: Float[np.ndarray, "4 4"], data: int
) -> Float[np.ndarray, "4 4"]:
    """Where a sensor stood at the time of a record, seen from the frame; the world's place is taken off in float64."""
    table = store["sample_data"]
    world_T_car = _pose_at(store["ego_pose"], int(table["ego_pose_token"][data]))
    car_T_sensor = _pose_at(store["calibrated_sensor"], int(table["calibrated_sensor_token"][data]))
    return np.asarray(frame_T_world @ world_T_car @ car_T_sensor)


def _read_picture(path: Path, folder: TableFolder) -> UInt8[np.ndarray, "height width 3"]:
    check_there(path, folder)
    return read_image(path)


def _further_lenses(store: SchemaTables) -> set[str]:
    """Channels of cameras whose lenses have more coefficients than five."""
    calibrations = store["calibrated_sensor"]
    distorted = [
        row
        for row, distortion in enumerate(calibrations["camera_distortion"])
        if isinstance(distortion, list) and any(distortion[5:])
    ]
    return {str(store["sensor"]["channel"][calibrations["sensor_token"][row]]) for row in distorted}


def _camera(store: SchemaTables, data: int, frame_T_camera: Float[np.ndarray, "4 4"]) -> Camera | None:
    """The camera of a record; None where its lens has further coefficients than k1, k2, p1, p2, k3."""
    table, calibrations = store["sample_data"], store["calibrated_sensor"]
    row = int(table["calibrated_sensor_token"][data])
    distortion = calibrations["camera_distortion"][row] or []
    numbers = isinstance(distortion, list) and all(
        type(number) in (int, float) and abs(number) < _LARGEST_COEFFICIENT for number in distortion
    )
    if not numbers or len(distortion) not in (0, 4, 5, 8, 12, 14):
        expected = f"camera_distortion of 0, 4, 5, 8, 12 or 14 numbers below {_LARGEST_COEFFICIENT:g}"
        got = repr(distortion)[:80]
        raise FileFormatError(store.path("calibrated_sensor"), where=f"record {row}", expected=expected, got=got)
    if any(distortion[5:]):
        return None
    coefficients = np.zeros(5)
    coefficients[: min(5, len(distortion))] = distortion[:5]
    return Camera(
        matrix=np.array(calibrations["camera_intrinsic"][row], dtype=np.float64),
        distortion=coefficients,
        camera_T_lidar=invert(frame_T_camera),
        width_px=max(0, int(table["width"][data])),
        height_px=max(0, int(table["height"][data])),
    )


def _details(store: SchemaTables, rows: Rows) -> dict[str, np.ndarray]:
    table = store["sample_annotation"]
    lists = table["attribute_tokens"]
    names = store["attribute"]["name"]
    attributes = [
        ",".join(str(names[number]) for number in lists.tokens[lists.starts[row] : lists.starts[row + 1]])
        for row in rows.tolist()
    ]
    visible = table["visibility_token"][rows]
    levels = [str(store["visibility"]["level"][row]) if row >= 0 else "" for row in visible.tolist()]
    return {
        "visibility": np.array(levels, dtype=np.str_),
        "attribute": np.array(attributes, dtype=np.str_),
        "radar_points": table["num_radar_pts"][rows],
        "instance_token": store["instance"]["token"][table["instance_token"][rows]].astype(np.str_),
        "annotation_token": table["token"][rows].astype(np.str_),
    }


class NuScenesData(SchemaDataset):
    """nuScenes (Caesar et al., CVPR 2020); see :class:`SchemaDataset`."""

    name = "nuscenes"
    dialect = NUSCENES


class TruckScenesData(SchemaDataset):
    """MAN TruckScenes (Fent et al., NeurIPS Datasets 2024), with six LiDARs and six 4D radars."""

    name = "truckscenes"
    dialect = TRUCKSCENES


class T4Data(SchemaDataset):
    """Tier IV's T4 data sets, one scene each; LiDAR clouds stand where their calibration says, usually in the car's."""

    name = "t4"
    dialect = T4
