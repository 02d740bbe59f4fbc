"""The Waymo Open Dataset v2 (Sun et al., CVPR 2020) in its Parquet components; needs the extra ``argoverse2``.

``[training/]<component>/<segment>.parquet``: ``lidar``, ``lidar_calibration``, ``lidar_pose``, ``vehicle_pose``,
``lidar_box``, ``camera_image``, ``camera_calibration``, ``stats``. Coordinates are the car's at the frame's stamp.
"""

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cached_property, partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int64, UInt8

from farfield.datasets.base import Dataset, Indices, Poses
from farfield.datasets.tracks import track_number
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.files.cuboids import FARTHEST_M
from farfield.files.images import decode_image
from farfield.files.limits import MAX_PIXELS
from farfield.files.parquet import read_rows
from farfield.files.remote_paths import as_path
from farfield.files.waymo import (
    CAMERA,
    LASER,
    OBJECT,
    STAMP,
    component_columns,
    inclinations_of,
    list_of,
    moved_by_pixels,
    numbers_of,
    points_of_pixels,
    poses_of,
    read_image_rows,
    stamps_of,
    texts_of,
)
from farfield.frame import Annotation, Boxes, Camera, Cloud, Frame, Key, Lazy, Sensor, camera_sensor
from farfield.frame.cloud_columns import returned
from farfield.geometry.cameras import CAMERA_T_LIDAR_AXES
from farfield.geometry.poses import invert, unrigid
from farfield.vocabulary.classes import normalised_class

LASERS = ("top", "front", "side_left", "side_right", "rear")  # numbers 1 to 5
CAMERAS = ("front", "front_left", "front_right", "side_left", "side_right")
TYPES = ("Unknown", "Vehicle", "Pedestrian", "Sign", "Cyclist")
CIRRUS_FROM_WAYMO = {
    "Unknown": "unknown",
    "Vehicle": "vehicle",
    "Pedestrian": "pedestrian",
    "Sign": "unknown",
    "Cyclist": "bicycle",
}
PARTS = {"training": "train", "validation": "val", "testing": "test"}
_TOP, _FARTHEST_PIXEL_M, _LARGEST_M, _MOST_YAW, _FASTEST_M_S = 1, 50.0, 1e3, 4 * np.pi, 200.0
_BOX, _LIDAR, _POSE = "LiDARBoxComponent", "LiDARComponent", "LiDARPoseComponent"
_SIDES = ("x", "y", "z")


@dataclass(frozen=True)
class _Laser:
    """A LiDAR's place, and what its rows' inclinations come from."""

    vehicle_T_lidar: Float[np.ndarray, "4 4"]
    inclinations_rad: Float[np.ndarray, " n"] | None
    bounds_rad: tuple[float, float]


def segments_in(root: Path) -> list[tuple[Path, str]]:
    """The folders of components and the names of the segments in them."""
    folders = [root, *(root / part for part in PARTS)]
    return [
        (folder, path.stem)
        for folder in folders
        for path in sorted((folder / "vehicle_pose").glob("*.parquet"))
        if (folder / "lidar").is_dir() or (folder / "lidar_box").is_dir()
    ]


class _WaymoSegment:
    """One segment: its tables, each read once but for ranges and pictures."""

    def __init__(self, folder: Path, name: str) -> None:
        self.folder, self.name = folder, name

    def __getstate__(self) -> dict[str, Any]:
        return {"folder": self.folder, "name": self.name}  # what was read stays behind

    def path(self, component: str) -> Path:
        return self.folder / component / f"{self.name}.parquet"

    def present(self, component: str) -> Path | None:
        path = self.path(component)
        return path if path.is_file() else None

    @cached_property
    def poses(self) -> tuple[Int64[np.ndarray, " n"], Float[np.ndarray, "n 4 4"]]:
        """Stamps in microseconds, rising, and the car's pose at each."""
        path, field = self.path("vehicle_pose"), "world_from_vehicle.transform"
        table = component_columns(path, "VehiclePoseComponent", [field], [STAMP])
        stamps, poses = stamps_of(path, table[STAMP]), poses_of(path, table[field], field)
        if not len(stamps) or len(np.unique(stamps)) < len(stamps):
            got = "none" if not len(stamps) else "one twice"
            raise FileFormatError(path, where=f"column {STAMP}", expected="stamps, each once", got=got)
        _check_rigid(path, field, poses)
        order = np.argsort(stamps)
        return stamps[order], poses[order]

    @cached_property
    def row_of_sweep(self) -> dict[tuple[int, int], int]:
        return _rows(self.path("lidar"), LASER) if self.present("lidar") else {}

    @cached_property
    def row_of_pixel_pose(self) -> dict[tuple[int, int], int]:
        return _rows(self.path("lidar_pose"), LASER) if self.present("lidar_pose") else {}

    @cached_property
    def row_of_picture(self) -> dict[tuple[int, int], int]:
        return _rows(self.path("camera_image"), CAMERA) if self.present("camera_image") else {}

    @cached_property
    def lasers(self) -> dict[int, _Laser]:
        path = self.path("lidar_calibration")
        if not path.is_file():
            raise DatasetError(f"{path}: expected where the LiDARs stand and their rows look, found no such file")
        mount, spread = "extrinsic.transform", [f"beam_inclination.{name}" for name in ("min", "max")]
        values = "beam_inclination.values"
        table = component_columns(path, "LiDARCalibrationComponent", [mount, *spread], [LASER], optional=[values])
        places = poses_of(path, table[mount], mount)
        _check_rigid(path, mount, places)
        bounds = np.column_stack([numbers_of(path, table[name], name) for name in spread]).astype(np.float64)
        lasers: dict[int, _Laser] = {}
        for row, laser in enumerate(_numbered(path, table[LASER], LASER, LASERS)):
            listed = list_of(path, table[values], values, row) if values in table else None
            if laser in lasers:
                raise FileFormatError(path, where=f"row {row}", expected="a LiDAR once", got=f"{laser} twice")
            lasers[laser] = _Laser(places[row], listed, (float(bounds[row, 0]), float(bounds[row, 1])))
        return lasers

    @cached_property
    def cameras(self) -> dict[int, tuple[Camera, Float[np.ndarray, "4 4"]]]:
        """Cameras without a pose, and where each stands in the car."""
        path = self.path("camera_calibration")
        if not path.is_file():
            return {}
        lens = [f"intrinsic.{name}" for name in ("f_u", "f_v", "c_u", "c_v", "k1", "k2", "p1", "p2", "k3")]
        mount, size = "extrinsic.transform", ("width", "height")
        table = component_columns(path, "CameraCalibrationComponent", [*lens, mount, *size], [CAMERA])
        numbers = np.column_stack([numbers_of(path, table[name], name) for name in (*lens, *size)]).astype(np.float64)
        sound = np.isfinite(numbers).all() and (numbers[:, [0, 1, 9, 10]] > 0).all() and (numbers[:, 9:] < 1e5).all()
        if not sound:
            raise FileFormatError(path, where="the table", expected="focal lengths and sizes in pixels", got="others")
        places = poses_of(path, table[mount], mount)
        _check_rigid(path, mount, places)
        cameras = {}
        for row, number in enumerate(_numbered(path, table[CAMERA], CAMERA, CAMERAS)):
            fu, fv, cu, cv, *distortion, width, height = numbers[row].tolist()
            matrix = np.array([[fu, 0.0, cu], [0.0, fv, cv], [0.0, 0.0, 1.0]])
            camera = Camera(matrix=matrix, distortion=np.array(distortion), width_px=int(width), height_px=int(height))
            cameras[number] = camera, places[row]
        return cameras

    @cached_property
    def picture_poses(self) -> tuple[Float[np.ndarray, "n 4 4"], Float[np.ndarray, " n"]]:
        """The car's pose when the middle of each picture was taken, and that time in seconds."""
        path = self.path("camera_image")
        pose, time = "pose.transform", "pose_timestamp"
        table = component_columns(path, "CameraImageComponent", [pose, time], [])
        poses, times = poses_of(path, table[pose], pose), numbers_of(path, table[time], time, kinds="f")
        _check_rigid(path, pose, poses)
        return poses, times.astype(np.float64)

    @cached_property
    def boxes(self) -> Mapping[str, Any] | None:
        path = self.path("lidar_box")
        return _read_boxes(path) if path.is_file() else None

    @cached_property
    def conditions(self) -> dict[int, dict[str, str]]:
        path = self.path("stats")
        if not path.is_file():
            return {}
        fields = ("time_of_day", "location", "weather")
        table = component_columns(path, "StatsComponent", fields, [STAMP])
        stamps = stamps_of(path, table[STAMP]).tolist()
        words = [texts_of(path, table[name], name, empty=True) for name in fields]
        rows = zip(*words, strict=True)
        return {
            stamp: {key: word for key, word in zip(("time", "location", "weather"), row, strict=True) if word}
            for stamp, row in zip(stamps, rows, strict=True)
        }


def _check_rigid(path: Path, field: str, poses: Float[np.ndarray, "n 4 4"]) -> None:
    for row, matrix in enumerate(poses):
        fault = unrigid(matrix) or ("a place beyond any map" if np.abs(matrix[:3, 3]).max() > FARTHEST_M else "")
        if fault:
            raise FileFormatError(path, where=f"column {field}, row {row}", expected="a rigid motion", got=fault[:120])


def _numbered(path: Path, column: Any, key: str, names: Sequence[str]) -> list[int]:
    numbers = numbers_of(path, column, key, kinds="iu")
    odd = (numbers < 1) | (numbers > len(names))
    if odd.any():
        expected = f"1 to {len(names)} ({', '.join(names)})"
        raise FileFormatError(path, where=f"column {key}", expected=expected, got=f"{numbers[odd][0]}")
    return [int(number) for number in numbers]


def _rows(path: Path, key: str) -> dict[tuple[int, int], int]:
    """Row of each stamp and sensor."""
    table = component_columns(path, "", [], [STAMP, key])
    stamps = stamps_of(path, table[STAMP]).tolist()
    sensors = _numbered(path, table[key], key, LASERS if key == LASER else CAMERAS)
    rows = {pair: row for row, pair in enumerate(zip(stamps, sensors, strict=True))}
    if len(rows) < len(stamps):
        raise FileFormatError(path, where="the keys", expected="a stamp and sensor once", got="one twice")
    return rows


class Waymo(Dataset):
    """Waymo's segments: five LiDARs, boxes with official counts and tracks, five cameras, poses.

    Cloud ``"lidar"`` holds the points of all LiDARs and both returns, as the official counts do; ``"top"``,
    ``"front"``, ``"side_left"``, ``"side_right"`` and ``"rear"`` hold one's each. Their columns: ``laser`` (1 to 5 in
    this order), ``return_number`` (1, 2), ``range_m``, ``elongation``, ``no_label_zone`` and ``raw_intensity``, which
    has no upper end; ``intensity`` is its hyperbolic tangent. Points of the top LiDAR are moved from the car's pose at
    their own pixel to the frame's (rolling shutter).

    ``boxes.point_count`` is ``num_lidar_points_in_box``; ``velocity_m_s`` is the files' speed, which stands in world
    axes (their issue 39), turned into the car's. ``annotation.details``: ``detection_level``, by which
    protocol ``waymo`` scores, and ``tracking_level`` (0 unset, 1, 2), ``top_points`` (-1 unset). Signs are boxes, too:
    class ``unknown``.

    Args:
        root: A folder of components, or one with ``training``, ``validation``, ``testing``.
        classes: ``"cirrus"`` translates types, ``"waymo"`` keeps them.
        pixel_poses: Whether to use ``lidar_pose``; without it the top LiDAR's points are up to 1 m off at 30 m/s.

    Raises:
        DatasetError: If there is no segment.
        ConfigError: If ``classes`` is unknown.
    """

    name = "waymo"

    def __init__(self, root: Path | str, *, classes: str = "cirrus", pixel_poses: bool = True) -> None:
        if classes not in ("cirrus", "waymo"):
            raise ConfigError(f"waymo: expected classes to be one of 'cirrus', 'waymo', got {classes!r}")
        self.root, self.classes, self.pixel_poses = as_path(root), classes, pixel_poses
        self.segments = [_WaymoSegment(folder, name) for folder, name in segments_in(self.root)]
        names = [segment.name for segment in self.segments]
        if len(set(names)) < len(names):
            twice = next(name for number, name in enumerate(names) if name in names[:number])
            raise DatasetError(f"{self.root}: expected segment {twice} in one folder, found it in two: open one part")
        self._index = [(segment, row) for segment in self.segments for row in range(len(segment.poses[0]))]
        if not self._index:
            expected = "[training/]vehicle_pose/<segment>.parquet with lidar or lidar_box beside it"
            raise DatasetError(f"{self.root}: expected {expected}, found none")
        self.sequences = tuple(segment.name for segment, _ in self._index)
        self.frame_ids = tuple(str(segment.poses[0][row]) for segment, row in self._index)

    @property
    def notes(self) -> tuple[str, ...]:
        """What the top LiDAR's points lack."""
        off = "the top LiDAR's points are not moved by their pixels' poses (pixel_poses): up to 1 m off at 30 m/s"
        return () if self.pixel_poses else (f"waymo: {off}",)

    def split_parts(self) -> dict[str, list[str]]:
        """The segments of the parts by a file of the user's, or by folders; a part without a folder is not there."""
        return super().split_parts() or self._published()

    def benchmark_keys(self, name: str) -> Set[Key]:
        """(sequence, frame) of ``"train"``, ``"val"`` or ``"test"``: what lies in the folder of that part.

        Raises:
            ConfigError: If there is no such folder.
        """
        parts = self._published()
        if name not in parts:
            folder = next((folder for folder, part in PARTS.items() if part == name), "")
            got = f"{name!r}: unpack {folder}/ beside them" if folder else repr(name)
            expected = f"a part whose folder is there ({', '.join(parts) or 'none of ' + ', '.join(PARTS)})"
            raise ConfigError(f"{self.root}: expected {expected}, got {got}")
        members = set(parts[name])
        return {key for key in self.keys if key[0] in members}

    def _published(self) -> dict[str, list[str]]:
        """The segments by the folder of a part in which they lie; of a link its own name counts first."""
        parts: dict[str, list[str]] = {}
        for segment in self.segments:
            names = (segment.folder.absolute().name, segment.folder.resolve().name)
            part = next((PARTS[name] for name in names if name in PARTS), None)
            if part is not None:
                parts.setdefault(part, []).append(segment.name)
        return parts

    def files(self, index: int) -> Sequence[Path]:
        """List the files of frame ``index``, which are shared by its segment."""
        names = ("lidar", "lidar_calibration", "lidar_pose", "vehicle_pose", "lidar_box")
        pictures = ("camera_image", "camera_calibration", "stats")
        paths = (self._index[index][0].present(name) for name in (*names, *pictures))
        return [path for path in paths if path is not None]

    def has_annotation(self, index: int) -> bool:
        """Whether the segment of frame ``index`` has boxes."""
        return self._index[index][0].present("lidar_box") is not None

    def _times_of(self, indices: Indices) -> Indices | None:
        return np.array([self._index[i][0].poses[0][self._index[i][1]] * 1000 for i in indices], dtype=np.int64)

    def _poses_of(self, indices: Indices) -> Poses | None:
        return np.stack([self._index[i][0].poses[1][self._index[i][1]] for i in indices])

    def frame(self, index: int) -> Frame:
        """Build frame ``index``.

        Raises:
            DatasetError: If a component lacks that another needs.
            FileFormatError: If one is damaged.
        """
        segment, row = self._index[index]
        stamp, world_T_vehicle = int(segment.poses[0][row]), segment.poses[1][row]
        sweeps = {name: number for number, name in enumerate(LASERS, 1) if (stamp, number) in segment.row_of_sweep}
        read = partial(read_cloud, segment, stamp, pixel_poses=self.pixel_poses)
        loaders = {name: partial(read, (number,)) for name, number in sweeps.items()}
        whole = {"lidar": partial(read, tuple(sweeps.values()))} if sweeps else {}
        places = {name: segment.lasers[number].vehicle_T_lidar for name, number in sweeps.items()} if sweeps else {}
        pictures = _pictures(segment, stamp, world_T_vehicle)
        boxes = segment.boxes
        load = None
        if boxes is not None:
            rows = np.flatnonzero(boxes["stamp"] == stamp)
            load = partial(_annotation, {key: _taken(column, rows) for key, column in boxes.items()}, self.classes,
                           world_T_vehicle)  # fmt: skip
        time_ns = stamp * 1000
        return Frame(
            sequence=segment.name,
            frame_id=self.frame_ids[index],
            time_ns=time_ns,
            clouds=Lazy(whole | loaders),
            images=Lazy({name: picture.load for name, picture in pictures.items() if picture.load is not None}),
            cameras={name: picture.camera for name, picture in pictures.items()},
            sensors={
                **({"lidar": Sensor(kind="lidar", time_ns=time_ns, holds=tuple(sweeps))} if sweeps else {}),
                **{name: Sensor(kind="lidar", frame_T_sensor=mount, time_ns=time_ns) for name, mount in places.items()},
                **{name: camera_sensor(picture.camera, picture.time_ns) for name, picture in pictures.items()},
            },
            load_annotation=load,
            world_T_frame=world_T_vehicle,
            reference="ego",
            conditions=segment.conditions.get(stamp, {}),
            metadata={"files": [str(path) for path in self.files(index)]},
        )


@dataclass(frozen=True)
class _Picture:
    """A camera at a frame, and what loads its picture if there is one."""

    camera: Camera
    time_ns: int | None
    load: Any


def _pictures(segment: _WaymoSegment, stamp: int, world_T_vehicle: Float[np.ndarray, "4 4"]) -> dict[str, _Picture]:
    """The cameras by name; a name that a LiDAR has as well begins with ``camera_``."""
    pictures = {}
    for number, (camera, vehicle_T_camera) in segment.cameras.items():
        row = segment.row_of_picture.get((stamp, number))
        camera_T_vehicle, time_ns, load = invert(vehicle_T_camera), None, None
        if row is not None:
            poses, times = segment.picture_poses
            camera_T_vehicle = camera_T_vehicle @ invert(poses[row]) @ world_T_vehicle
            time_ns = _time_ns(segment.path("camera_image"), float(times[row]), stamp)
            load = partial(_read_picture, segment.path("camera_image"), row)
        placed = Camera(
            matrix=camera.matrix,
            distortion=camera.distortion,
            camera_T_lidar=CAMERA_T_LIDAR_AXES @ camera_T_vehicle,
            width_px=camera.width_px,
            height_px=camera.height_px,
        )
        pictures[f"camera_{CAMERAS[number - 1]}"] = _Picture(placed, time_ns, load)
    return pictures


def _time_ns(path: Path, time_s: float, stamp_us: int) -> int:
    if not abs(time_s - stamp_us * 1e-6) <= 1.0:
        expected = f"a time within a second of the frame's {stamp_us * 1e-6:.3f} s"
        raise FileFormatError(path, where="column pose_timestamp", expected=expected, got=f"{time_s:.3f}")
    return round(time_s * 1e6) * 1000


def _read_picture(path: Path, row: int) -> UInt8[np.ndarray, "height width 3"]:
    (held,) = read_rows(path, ["[CameraImageComponent].image"], [row])
    data = held["[CameraImageComponent].image"].to_pylist()[0]
    if not isinstance(data, bytes):
        raise FileFormatError(path, where=f"row {row}", expected="a picture", got=type(data).__name__)
    return decode_image(BytesIO(data), path, max_pixels=MAX_PIXELS)


def read_cloud(segment: "_WaymoSegment", stamp: int, lasers: Sequence[int], *, pixel_poses: bool) -> Cloud:
    """Points of some LiDARs of a segment at a stamp, both returns, in the car's coordinates.

    Raises:
        DatasetError: If calibration or pixels' poses are missing.
        FileFormatError: If a table is damaged.
    """
    rows = sorted((segment.row_of_sweep[stamp, laser], laser) for laser in lasers)
    path = segment.path("lidar")
    images = read_image_rows(
        path, _LIDAR, ["range_image_return1", "range_image_return2"], [row for row, _ in rows], channels=4
    )
    frame_row = int(np.searchsorted(segment.poses[0], stamp))
    world_T_vehicle = segment.poses[1][frame_row]
    parts: list[tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 6"]]] = []
    for (_, laser), image in zip(rows, images, strict=True):
        if laser not in segment.lasers:
            raise DatasetError(f"{segment.path('lidar_calibration')}: expected a row of LiDAR {laser}, found none")
        poses = _pixel_poses(segment, stamp) if pixel_poses and laser == _TOP else None
        for number, pixels in enumerate(image.returns, 1):
            if pixels is not None:
                part = _points(
                    path, pixels, segment.lasers[laser], segment.path("lidar_calibration"), poses, world_T_vehicle
                )
                marks = np.full((len(part[0]), 2), (laser, number), dtype=np.float64)
                parts.append((part[0], np.hstack([part[1], marks])))
    points_m = np.concatenate([np.zeros((0, 3)), *(points for points, _ in parts)])
    columns = np.concatenate([np.zeros((0, 6)), *(rest for _, rest in parts)])
    valid = returned(path, points_m)
    distance, raw, elongation, zone, laser_of, number_of = columns[valid].T
    extra = {
        "laser": laser_of.astype(np.int8),
        "return_number": number_of.astype(np.int8),
        "range_m": distance.astype(np.float32),
        "elongation": elongation.astype(np.float32),
        "no_label_zone": zone > 0,
        "raw_intensity": raw.astype(np.float32),
    }
    return Cloud(points_m[valid].astype(np.float32), np.tanh(raw).astype(np.float32), extra, int((~valid).sum()))


def _points(
    path: Path,
    pixels: Float[np.ndarray, "h w 4"],
    laser: _Laser,
    calibration: Path,
    poses: Float[np.ndarray, "h w 6"] | None,
    world_T_vehicle: Float[np.ndarray, "4 4"],
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 4"]]:
    """Points of one return in the car's coordinates, and its four channels."""
    measured: Bool[np.ndarray, "h w"] = pixels[..., 0] > 0
    channels = pixels[measured].astype(np.float64)
    if not np.isfinite(pixels[..., 0]).all() or not np.isfinite(channels).all() or (channels[:, 1:3] < 0).any():
        expected = "finite ranges, and intensities and elongations from 0 on where something returned"
        raise FileFormatError(path, where="a range image", expected=expected, got="others")
    inclinations = inclinations_of(calibration, laser.inclinations_rad, laser.bounds_rad, len(pixels))
    points_m = points_of_pixels(pixels[..., 0], measured, laser.vehicle_T_lidar, inclinations)
    if poses is None:
        return points_m, channels
    if poses.shape[:2] != pixels.shape[:2]:
        expected, got = f"pixels' poses of {pixels.shape[:2]}", f"{poses.shape[:2]}"
        raise FileFormatError(path, where="a range image", expected=expected, got=got)
    chosen = poses[measured]
    away_m = np.linalg.norm(chosen[:, 3:] - world_T_vehicle[:3, 3], axis=1)
    if not (away_m <= _FARTHEST_PIXEL_M).all() or not (np.abs(chosen[:, :3]) <= _MOST_YAW).all():
        expected = f"pixels' poses within {_FARTHEST_PIXEL_M:g} m of the frame's"
        raise FileFormatError(path, where="lidar_pose", expected=expected, got=f"{away_m.max():.4g} m")
    return moved_by_pixels(points_m, chosen, world_T_vehicle), channels


def _pixel_poses(segment: _WaymoSegment, stamp: int) -> Float[np.ndarray, "h w 6"]:
    path, row = segment.path("lidar_pose"), segment.row_of_pixel_pose.get((stamp, _TOP))
    poses = None
    if row is not None:
        (image,) = read_image_rows(path, _POSE, ["range_image_return1"], [row], channels=6)
        poses = image.returns[0]
    if poses is None:
        raise DatasetError(
            f"{path}: expected the pixels' poses of the top LiDAR at {stamp}, found none. Fetch lidar_pose, or open "
            "with pixel_poses=False, which leaves its points up to 1 m off at 30 m/s."
        )
    return poses


def _taken(column: Any, rows: Int64[np.ndarray, " k"]) -> Any:
    return None if column is None else column[rows]


def _read_boxes(path: Path) -> dict[str, Any]:
    """All boxes of a segment, checked."""
    centre = [f"box.center.{side}" for side in _SIDES]
    size = [f"box.size.{side}" for side in _SIDES]
    speed = [f"speed.{side}" for side in _SIDES]
    counts = ["num_lidar_points_in_box", "num_top_lidar_points_in_box"]
    levels = ["difficulty_level.detection", "difficulty_level.tracking"]
    fields = [*centre, *size, "box.heading", "type", counts[0]]
    table = component_columns(path, _BOX, fields, [STAMP, OBJECT], optional=[counts[1], *speed, *levels])
    numbers = {name: numbers_of(path, table[name], name) for name in fields}
    boxes: dict[str, Any] = {
        "stamp": stamps_of(path, table[STAMP]),
        "object": np.array(texts_of(path, table[OBJECT], OBJECT), dtype=np.str_),
        "centre_m": np.column_stack([numbers[name] for name in centre]).astype(np.float64),
        "size_m": np.column_stack([numbers[name] for name in size]).astype(np.float64),
        "yaw_rad": numbers["box.heading"].astype(np.float64),
        "type": numbers["type"].astype(np.float64),
        "point_count": numbers[counts[0]],
        "top_points": _with_holes(path, table, counts[1], -1),
        "detection_level": _with_holes(path, table, levels[0], 0),
        "tracking_level": _with_holes(path, table, levels[1], 0),
        "speed_m_s": np.column_stack([_with_holes(path, table, name, np.nan) for name in speed]),
    }
    sound = (np.abs(boxes["centre_m"]) <= FARTHEST_M).all(axis=1) & (np.abs(boxes["yaw_rad"]) <= _MOST_YAW)
    sound &= ((boxes["size_m"] > 0) & (boxes["size_m"] <= _LARGEST_M)).all(axis=1)
    sound &= np.isin(boxes["type"], np.arange(len(TYPES))) & (boxes["point_count"] >= 0)
    sound &= np.isin(boxes["detection_level"], (0, 1, 2)) & np.isin(boxes["tracking_level"], (0, 1, 2))
    sound &= ~(np.abs(boxes["speed_m_s"]) > _FASTEST_M_S).any(axis=1) & (boxes["top_points"] >= -1)
    if not sound.all():
        row = int(np.argmin(sound))
        shown = {name: np.asarray(column[row]).tolist() for name, column in boxes.items() if name != "stamp"}
        expected = "a possible box: metres, radians, a type, counts and levels that are published, a speed in m/s"
        raise FileFormatError(path, where=f"row {row}", expected=expected, got=repr(shown)[:300])
    return boxes


def _with_holes(path: Path, table: Mapping[str, Any], name: str, hole: float | int) -> np.ndarray:
    """A column that may lack, or have holes, filled."""
    if name not in table:
        return np.full(len(table[STAMP]), hole)
    column = table[name]
    if not column.null_count:
        return numbers_of(path, column, name)
    values = column.to_numpy(zero_copy_only=False).astype(np.float64)
    return np.where(column.is_null().to_numpy(zero_copy_only=False), hole, values)


def _annotation(table: Mapping[str, Any], classes: str, world_T_vehicle: Float[np.ndarray, "4 4"]) -> Annotation:
    names = tuple(TYPES[int(number)] for number in table["type"])
    if len(set(table["object"].tolist())) < len(names):
        raise DatasetError(f"lidar_box at {table['stamp'][0]}: expected an object once, found one twice")
    boxes = Boxes(
        centre_m=table["centre_m"],
        size_m=table["size_m"],
        yaw_rad=table["yaw_rad"],
        label=list(names) if classes == "waymo" else [normalised_class(name, CIRRUS_FROM_WAYMO) for name in names],
        track_id=np.array([track_number(name) for name in table["object"].tolist()], dtype=np.int64),
        point_count=table["point_count"].astype(np.int64),
        velocity_m_s=table["speed_m_s"].astype(np.float64) @ world_T_vehicle[:3, :3],  # from world axes to the car's
    )
    details = {name: table[name].astype(np.int64) for name in ("detection_level", "tracking_level", "top_points")}
    return Annotation(boxes=boxes, original_label=names, details=details)
