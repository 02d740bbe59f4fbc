"""PandaSet (Xiao et al., ITSC 2021): scenes of a Pandar64, a forward-facing PandarGT and six cameras.

``<scene>/lidar/00.pkl.gz`` with ``poses.json`` and ``timestamps.json``, ``annotations/cuboids``,
``annotations/semseg``, ``camera/<name>``, ``meta/gps.json``, as the devkit describes them
(https://github.com/scaleapi/pandaset-devkit). Its data frames are pickles of pandas, which are read without being run.
"""

from collections.abc import Mapping, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int64

from farfield.datasets.base import Dataset, Indices, Poses
from farfield.datasets.tracks import track_number
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.files.cuboids import FARTHEST_M, is_name
from farfield.files.data_frames import Column, read_data_frame
from farfield.files.images import image_size, read_image
from farfield.files.limits import MAX_NAME
from farfield.files.pandaset import Placement, read_gps, read_intrinsics, read_placements, read_stamps
from farfield.files.remote_paths import as_path
from farfield.files.suffixes import existing
from farfield.frame import Annotation, Boxes, Camera, Cloud, Frame, Lazy, Sensor, camera_sensor
from farfield.frame.cloud_columns import returned
from farfield.geometry.poses import invert, pose, rotation_from_quaternion, transform_points
from farfield.vocabulary.classes import CIRRUS_FROM_PANDASET, normalised_class

SENSORS = ("pandar64", "pandargt")
"""The LiDARs by their number in the files' column ``d``."""
_FRAME_T_EGO = np.array([[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])  # y is forward in the files
_SUFFIXES = (".pkl.gz", ".pkl")
_MOST_LAG_S, _LARGEST_M, _MOST_YAW = 1.0, 1e3, 4 * np.pi
_NO_SENSOR = -1
_WORDS = ("object_motion", "rider_status", "pedestrian_behavior", "pedestrian_age")


def scenes_in(root: Path) -> list[Path]:
    """The scenes of a folder: itself, or those in it, by name."""
    candidates = [root, *sorted(root.glob("*"))]
    return [folder for folder in candidates if (folder / "lidar/poses.json").is_file() and _sweeps(folder)]


def _sweeps(scene: Path) -> dict[int, Path]:
    """The files of sweeps by their number; a packed one counts before another."""
    return _numbered(scene / "lidar")


def _numbered(folder: Path) -> dict[int, Path]:
    files: dict[int, Path] = {}
    for suffix in _SUFFIXES:
        for path in sorted(folder.glob(f"*{suffix}")):
            stem = path.name.removesuffix(suffix)
            if stem.isascii() and stem.isdigit() and len(stem) <= 6:
                files.setdefault(int(stem), path)
    return dict(sorted(files.items()))


class _Track:
    """Poses and times of a sensor, one a frame, by their folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @cached_property
    def placements(self) -> Placement:
        return read_placements(self._file("poses.json"))

    @cached_property
    def times_ns(self) -> Int64[np.ndarray, " n"]:
        path = self._file("timestamps.json")
        times_ns = read_stamps(path)
        if len(times_ns) != len(self.placements[0]):
            expected = f"{len(self.placements[0])} times, one for each of poses.json"
            raise FileFormatError(path, where="the file", expected=expected, got=f"{len(times_ns)}")
        return times_ns

    def _file(self, name: str) -> Path:
        path = self.folder / name
        if not path.is_file():
            raise DatasetError(f"{path}: expected the sensor's {path.stem}, one a frame, found no such file")
        return path

    def check(self, number: int) -> None:
        """Refuse a frame that has no pose or time."""
        if number >= len(self.times_ns):
            expected = f"a pose and a time of frame {number}"
            got = f"those of {len(self.times_ns)} frames"
            raise FileFormatError(self.folder / "poses.json", where="the file", expected=expected, got=got)

    def pose(self, number: int) -> Float[np.ndarray, "4 4"]:
        self.check(number)
        positions, turns = self.placements
        return pose(rotation_from_quaternion(turns[number]), positions[number])


class _PandaScene:
    """One scene: its sweeps, poses, times and cameras, each read once."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.sweeps, self.cuboids = _sweeps(folder), _numbered(folder / "annotations/cuboids")
        self.classes = _numbered(folder / "annotations/semseg")
        self.lidar = _Track(folder / "lidar")

    @cached_property
    def cameras(self) -> dict[str, _Track]:
        folders = sorted((self.folder / "camera").glob("*"))
        return {path.name: _Track(path) for path in folders if (path / "intrinsics.json").is_file()}

    @cached_property
    def matrices(self) -> dict[str, Float[np.ndarray, "3 3"]]:
        return {name: read_intrinsics(track.folder / "intrinsics.json") for name, track in self.cameras.items()}

    @cached_property
    def gps(self) -> list[dict[str, float]]:
        path = self.folder / "meta/gps.json"
        return read_gps(path) if path.is_file() else []

    def world_T_frame(self, number: int) -> Float[np.ndarray, "4 4"]:
        return self.lidar.pose(number) @ invert(_FRAME_T_EGO)

    def pictures(self, number: int) -> dict[str, Path]:
        paths = {name: existing(track.folder / f"{number:02d}.jpg") for name, track in self.cameras.items()}
        return {name: path for name, path in paths.items() if path is not None}


class PandaSet(Dataset):
    """PandaSet's scenes: clouds ``"pandar64"`` and ``"pandargt"``, boxes with tracks, six cameras.

    Coordinates are the car's: the files' poses stand on the ground below the LiDARs and head along their y, which is
    our x. A frame's stamp is the end of Pandar64's turn; ``offset_ns`` of a point counts from it and is negative for
    most, and PandarGT's sweep lies up to 0.1 s from Pandar64's. ``semseg`` is the class of a point where the scene
    has it. Points and boxes stand in the world's coordinates in the files and are moved in float64.

    A moving object that both LiDARs see has a box a LiDAR, at its own moment. Where both stand in a frame, that of
    ``boxes_of`` is taken; others stay. ``annotation.moving`` is the opposite of ``stationary``; ``details`` hold
    ``sensor_id``, ``camera_used`` and the words of the attributes. Cameras have no distortion, as the devkit projects.

    Args:
        root: A folder of scenes such as ``002``, or one scene.
        classes: ``"cirrus"`` translates class names, ``"pandaset"`` keeps them.
        boxes_of: The LiDAR whose boxes are taken of objects that have two.

    Raises:
        DatasetError: If there is no sweep.
        ConfigError: If an option is unknown.
    """

    name = "pandaset"

    def __init__(self, root: Path | str, *, classes: str = "cirrus", boxes_of: str = "pandar64") -> None:
        if classes not in ("cirrus", "pandaset"):
            raise ConfigError(f"pandaset: expected classes to be one of 'cirrus', 'pandaset', got {classes!r}")
        if boxes_of not in SENSORS:
            raise ConfigError(f"pandaset: expected boxes_of to be one of {', '.join(SENSORS)}, got {boxes_of!r}")
        self.root, self.classes, self.boxes_of = as_path(root), classes, boxes_of
        self.scenes = [_PandaScene(folder) for folder in scenes_in(self.root)]
        self._index = [(scene, number) for scene in self.scenes for number in scene.sweeps]
        if not self._index:
            raise DatasetError(f"{self.root}: expected [<scene>/]lidar/*.pkl.gz with lidar/poses.json, found none")
        self.sequences = tuple(scene.folder.resolve().name for scene, _ in self._index)
        self.frame_ids = tuple(f"{number:02d}" for _, number in self._index)

    @property
    def assumptions(self) -> tuple[str, ...]:
        """Whose boxes are read of objects that have two."""
        return (f"pandaset: of moving objects with a box a LiDAR those of {self.boxes_of} are read (boxes_of)",)

    def files(self, index: int) -> Sequence[Path]:
        """List the files of frame ``index``."""
        scene, number = self._index[index]
        tables = [files[number] for files in (scene.sweeps, scene.cuboids, scene.classes) if number in files]
        beside = [scene.folder / "lidar/poses.json", scene.folder / "lidar/timestamps.json"]
        return [*tables, *(path for path in beside if path.is_file()), *scene.pictures(number).values()]

    def has_annotation(self, index: int) -> bool:
        """Whether there are boxes of frame ``index``."""
        scene, number = self._index[index]
        return number in scene.cuboids

    def _times_of(self, indices: Indices) -> Indices | None:
        frames = [self._index[index] for index in indices]
        for scene, number in frames:
            scene.lidar.check(number)
        return np.array([scene.lidar.times_ns[number] for scene, number in frames], dtype=np.int64)

    def _poses_of(self, indices: Indices) -> Poses | None:
        frames = [self._index[index] for index in indices]
        return np.stack([scene.world_T_frame(number) for scene, number in frames])

    def frame(self, index: int) -> Frame:
        """Build frame ``index``.

        Raises:
            FileFormatError: If the scene's poses or times are damaged, or those of the frame are missing.
        """
        scene, number = self._index[index]
        world_T_frame, pictures = scene.world_T_frame(number), scene.pictures(number)
        time_ns = int(scene.lidar.times_ns[number])
        read = partial(_read_cloud, scene.sweeps[number], scene.classes.get(number), world_T_frame, time_ns)
        cameras = {name: _camera(scene, name, number, path, world_T_frame) for name, path in pictures.items()}
        times = {name: int(scene.cameras[name].times_ns[number]) for name in pictures}
        frame_T_world = invert(world_T_frame)
        labels = scene.cuboids.get(number)
        load = None
        if labels is not None:
            load = partial(_read_annotation, labels, frame_T_world, self.classes, SENSORS.index(self.boxes_of))
        metadata: dict[str, Any] = {"files": [str(path) for path in self.files(index)]}
        if number < len(scene.gps):
            metadata["gps"] = scene.gps[number]
        return Frame(
            sequence=self.sequences[index],
            frame_id=self.frame_ids[index],
            time_ns=time_ns,
            clouds=Lazy({name: partial(read, sensor) for sensor, name in enumerate(SENSORS)}),
            images=Lazy({name: partial(read_image, path) for name, path in pictures.items()}),
            cameras=cameras,
            sensors={
                **{name: Sensor(kind="lidar", time_ns=time_ns if name == SENSORS[0] else None) for name in SENSORS},
                **{name: camera_sensor(camera, times[name]) for name, camera in cameras.items()},
            },
            load_annotation=load,
            world_T_frame=world_T_frame,
            reference="ego",
            metadata=metadata,
        )


def _camera(
    scene: _PandaScene, name: str, number: int, picture: Path, world_T_frame: Float[np.ndarray, "4 4"]
) -> Camera:
    width, height = image_size(picture)
    camera_T_frame = invert(scene.cameras[name].pose(number)) @ world_T_frame
    return Camera(matrix=scene.matrices[name], camera_T_lidar=camera_T_frame, width_px=width, height_px=height)


def _numbers(table: Mapping[str, Column], name: str, path: Path) -> Float[np.ndarray, " n"]:
    """A column of finite numbers, or of NaN as well."""
    column = table.get(name)
    if not isinstance(column, np.ndarray) or column.dtype.kind not in "iuf":
        got = "none" if column is None else "texts or flags"
        raise FileFormatError(path, where=f"column {name}", expected="numbers", got=got)
    return column.astype(np.float64)


def _whole(table: Mapping[str, Column], name: str, bounds: tuple[int, int], path: Path) -> Int64[np.ndarray, " n"]:
    """A column of whole numbers within bounds, both included."""
    values = _numbers(table, name, path)
    odd = ~((values >= bounds[0]) & (values <= bounds[1]) & (values == np.floor(values)))
    if odd.any():
        expected = f"whole numbers from {bounds[0]} to {bounds[1]}"
        raise FileFormatError(path, where=f"column {name}", expected=expected, got=f"{values[odd][0]:g}")
    return values.astype(np.int64)


def _read_cloud(
    path: Path, classes: Path | None, world_T_frame: Float[np.ndarray, "4 4"], time_ns: int, sensor: int
) -> Cloud:
    """One LiDAR's points of a sweep, in the frame's coordinates."""
    table = read_data_frame(path)
    mine = _whole(table, "d", (0, len(SENSORS) - 1), path) == sensor
    world_m = np.column_stack([_numbers(table, axis, path)[mine] for axis in "xyz"])
    if np.isinf(world_m).any():  # of which moving makes NaN, as of no return
        raise FileFormatError(path, where="columns x, y, z", expected="finite coordinates", got="infinite ones")
    points_m = transform_points(invert(world_T_frame), world_m)
    extra: dict[str, np.ndarray] = {"offset_ns": _offsets_ns(table, mine, time_ns, path)}
    if classes is not None:
        extra["semseg"] = _read_classes(classes, len(mine))[mine]
    valid = returned(path, points_m)
    strength = _numbers(table, "i", path)[mine]
    if not ((strength >= 0) & (strength <= 255)).all():
        actual = f"{strength.min():g} to {strength.max():g}"
        raise FileFormatError(path, where="column i", expected="values from 0 to 255", got=actual)
    intensity = (strength[valid] / 255).astype(np.float32)
    rest = {name: column[valid] for name, column in extra.items()}
    return Cloud(points_m[valid].astype(np.float32), intensity, rest, int((~valid).sum()))


def _offsets_ns(
    table: Mapping[str, Column], mine: Bool[np.ndarray, " n"], time_ns: int, path: Path
) -> Int64[np.ndarray, " m"]:
    """Times of points since the frame's stamp."""
    offset_s = _numbers(table, "t", path)[mine] - time_ns * 1e-9
    far = ~(np.abs(offset_s) <= _MOST_LAG_S)
    if far.any():
        expected = f"times within {_MOST_LAG_S:g} s of the frame's {time_ns * 1e-9:.3f}"
        raise FileFormatError(path, where="column t", expected=expected, got=f"{offset_s[far][0]:g} s from it")
    return np.rint(offset_s * 1e9).astype(np.int64)


def _read_classes(path: Path, count: int) -> Int64[np.ndarray, " n"]:
    """The class of each point of a sweep, as numbered in classes.json."""
    table = read_data_frame(path)
    classes = _whole(table, "class", (0, 1 << 15), path)
    if len(classes) != count:
        raise FileFormatError(
            path, where="column class", expected=f"{count} classes, one a point", got=f"{len(classes)}"
        )
    return classes


def _texts(table: Mapping[str, Column], name: str, path: Path, count: int, *, needed: bool = True) -> list[str]:
    """A column of words; where it may lack, NaN and None are no word."""
    column: Any = table.get(name)
    if column is None and not needed:
        return [""] * count
    words = [] if column is None or (isinstance(column, np.ndarray) and needed) else list(column)
    plain = [word if isinstance(word, str) or needed else "" for word in words]
    sound = all(isinstance(word, str) and len(word) <= MAX_NAME and (is_name(word) or not needed) for word in plain)
    if len(plain) != count or not sound:
        raise FileFormatError(path, where=f"column {name}", expected="names", got="none, or something else")
    return plain


def _read_annotation(path: Path, frame_T_world: Float[np.ndarray, "4 4"], classes: str, sensor: int) -> Annotation:
    table = read_data_frame(path)
    yaw = _numbers(table, "yaw", path)
    count = len(yaw)
    centre_m = np.column_stack([_numbers(table, f"position.{axis}", path) for axis in "xyz"])
    size_m = np.column_stack([_numbers(table, f"dimensions.{axis}", path) for axis in "yxz"])
    sound = (np.abs(centre_m) <= FARTHEST_M).all(axis=1) & (np.abs(yaw) <= _MOST_YAW)
    sound &= ((size_m > 0) & (size_m <= _LARGEST_M)).all(axis=1)
    if not sound.all():
        row = int(np.argmin(sound))
        got = f"centre {centre_m[row].tolist()}, size {size_m[row].tolist()}, yaw {yaw[row]:g}"
        expected = "a place and positive sizes in metres and a yaw in radians"
        raise FileFormatError(path, where=f"box {row}", expected=expected, got=got[:200])
    uuid, label = (_texts(table, name, path, count) for name in ("uuid", "label"))
    if len(set(uuid)) < count:
        raise FileFormatError(path, where="column uuid", expected="an object once", got="one twice")
    seen_by, chosen = _chosen(table, uuid, sensor, path)
    boxes = Boxes(
        centre_m=centre_m,
        size_m=size_m,
        yaw_rad=yaw + np.pi / 2,
        label=label if classes == "pandaset" else [normalised_class(name, CIRRUS_FROM_PANDASET) for name in label],
        track_id=np.array([track_number(name) for name in uuid], dtype=np.int64),
    )
    words = {name: _texts(table, f"attributes.{name}", path, count, needed=False) for name in _WORDS}
    details: dict[str, Any] = {name: np.array(column, dtype=np.str_) for name, column in words.items()}
    if "camera_used" in table:
        details["camera_used"] = _whole(table, "camera_used", (_NO_SENSOR, 100), path)
    whole = Annotation(
        boxes=boxes.transform(frame_T_world),
        moving=~_flags(table, "stationary", path),
        original_label=tuple(label),
        details=details | {"sensor_id": seen_by},
    )
    return whole[chosen]


def _chosen(
    table: Mapping[str, Column], uuid: Sequence[str], sensor: int, path: Path
) -> tuple[Int64[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Which LiDAR each box was drawn for, -1 for both; and which are left where an object has two in the frame."""
    if "cuboids.sensor_id" not in table and "cuboids.sibling_id" not in table:
        return np.full(len(uuid), _NO_SENSOR, dtype=np.int64), np.ones(len(uuid), dtype=bool)
    seen_by = _whole(table, "cuboids.sensor_id", (_NO_SENSOR, len(SENSORS) - 1), path)
    siblings = _texts(table, "cuboids.sibling_id", path, len(uuid), needed=False)
    row_of = {name: row for row, name in enumerate(uuid)}
    chosen = np.ones(len(uuid), dtype=bool)
    for row, sibling in enumerate(siblings):  # a few name themselves, or one that names another
        other = row_of.get(sibling, row)
        for mine, twin in ((row, other), (other, row)):
            if seen_by[mine] == sensor and seen_by[twin] == 1 - sensor:
                chosen[twin] = False
    return seen_by, chosen


def _flags(table: Mapping[str, Column], name: str, path: Path) -> Bool[np.ndarray, " n"]:
    column = table.get(name)
    flags = [] if column is None else list(column)
    if column is None or not all(isinstance(flag, bool | np.bool_) for flag in flags):
        raise FileFormatError(path, where=f"column {name}", expected="flags", got="none, or something else")
    return np.array(flags, dtype=bool)
