"""aiMotive's multimodal data set (Matuszka et al., 2023): LiDAR, two radars, four cameras; needs the extra ``las``.

``<session>/dynamic/raw-revolutions/frame_<number>.laz`` or ``.las``, ``dynamic/box/3d_body/frame_<number>.json``,
``sensor/radar/<name>/<name>_<number>.json``, ``sensor/camera/<name>/<name>_<number>.jpg`` and
``sensor/calibration/calibration.json``; sessions lie in ``{train,val}/<condition>/``. Clouds and boxes stand in the
body's coordinates, which are the frame's.
"""

import re
from collections.abc import Mapping, Sequence
from functools import cached_property, partial
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Float

from farfield.datasets.base import Dataset, Indices, all_known
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.files.aimotive import PINHOLE, AimotiveSensor, read_boxes, read_sensors, read_targets, read_time
from farfield.files.images import read_image
from farfield.files.json_text import read_json
from farfield.files.las import read_las
from farfield.files.remote_paths import as_path
from farfield.files.suffixes import pattern_in_any_case
from farfield.frame import Annotation, Boxes, Camera, Cloud, Frame, Lazy, Sensor, camera_sensor
from farfield.frame.cloud_columns import returned
from farfield.geometry.poses import invert, transform_points, yaw_from_quaternion
from farfield.vocabulary.classes import CIRRUS_FROM_AIMOTIVE, normalised_class

SPLITS = ("train", "val", "test")
CLOUDS, BOXES = "dynamic/raw-revolutions", "dynamic/box/3d_body"
_LIDAR = "M_LIDAR_M"
_CALIBRATION = "sensor/calibration/calibration.json"
_NUMBER = re.compile(r"(?:^|_)(\d{1,12})$")
_FULL_INTENSITY, _NEAR_NS = 255.0, 1e9
_IN_BODY = ("is_body", 12345)
_DEPTHS = ("", "*/", "*/*/", *(f"{start}{split}/*/*/" for start in ("", "data/") for split in SPLITS))


def sessions_in(root: Path) -> list[Path]:
    """The sessions of a folder: itself, those in it, or in its conditions and splits, in the order of their names."""
    folders = {
        path.parents[depth]
        for prefix in _DEPTHS
        for pattern, depth in (("dynamic/raw-revolutions", 1), ("dynamic/box/3d_body", 2))
        for path in root.glob(prefix + pattern)
        if path.is_dir()
    }
    return sorted(folders, key=lambda path: path.resolve().name)


def is_aimotive(root: Path) -> bool:
    """Whether a folder holds sessions of aiMotive's data set, with a cloud or a file of boxes."""
    patterns = [*(pattern_in_any_case(f"{CLOUDS}/frame_*{end}") for end in (".laz", ".las")), f"{BOXES}/frame_*.json"]
    return any(next(root.glob(prefix + pattern), None) is not None for prefix in _DEPTHS for pattern in patterns)


class _Session:
    """One drive: which files each frame has, and the calibration, read once."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.name = root.resolve().name
        self.clouds = {**_numbered(root / CLOUDS, ".laz"), **_numbered(root / CLOUDS, ".las")}  # unpacked wins
        self.boxes = _numbered(root / BOXES, ".json")
        self.numbers = sorted({*self.clouds, *self.boxes})
        self.radars = {path.name: _numbered(path, ".json") for path in _folders(root / "sensor/radar")}
        self.pictures = {path.name: _numbered(path, ".jpg") for path in _folders(root / "sensor/camera")}

    @property
    def part(self) -> str:
        """``train``, ``val``, ``test`` or empty, as the folder above the condition's says."""
        above = self.root.resolve().parent.parent.name
        return above if above in SPLITS else ""

    @property
    def condition(self) -> str:
        """The condition's folder, such as ``nighttime``; empty where the session does not lie in one."""
        return self.root.resolve().parent.name if self.part else ""

    @cached_property
    def times_ns(self) -> dict[int, int]:
        """Times of the annotated frames.

        Raises:
            FileFormatError: If they do not go on from frame to frame.
        """
        times = {number: read_time(read_json(path), path) for number, path in self.boxes.items()}
        for earlier, later in pairwise(sorted(times)):
            if times[later] <= times[earlier]:
                expected, actual = f"a time after frame {earlier}'s {times[earlier]}", str(times[later])
                raise FileFormatError(self.boxes[later], where="Timestamp", expected=expected, got=actual)
        return times

    @cached_property
    def sensors(self) -> dict[str, AimotiveSensor]:
        """The calibrated sensors by name.

        Raises:
            DatasetError: If radars have no calibration: their targets stand in their own coordinates.
        """
        path = self.root / _CALIBRATION
        sensors = read_sensors(path) if path.is_file() else {}
        lacking = sorted(self.radars.keys() - sensors.keys())
        if lacking:
            raise DatasetError(f"{path}: expected the poses of {', '.join(lacking)}, whose targets lie beside it")
        return sensors


def _folders(root: Path) -> list[Path]:
    return sorted(path for path in root.iterdir() if path.is_dir()) if root.is_dir() else []


def _numbered(folder: Path, suffix: str) -> dict[int, Path]:
    """Files of a folder by the number in their names.

    Raises:
        DatasetError: If two have one number.
    """
    files: dict[int, Path] = {}
    for path in sorted(folder.glob(pattern_in_any_case(f"*{suffix}"))):
        match = _NUMBER.search(path.stem)
        if match is None or path.name.startswith("."):
            continue
        number = int(match[1])
        if number in files:
            raise DatasetError(f"{path}: expected one file a frame, got {files[number].name} of the same number too")
        files[number] = path
    return files


class Aimotive(Dataset):
    """aiMotive's sessions: cloud ``"lidar"``, a cloud for each radar by its name, images by camera, boxes.

    The LiDAR's cloud has ``offset_ns`` since the frame's time (which lies inside the sweep) and its file's other
    columns; a radar's has ``doppler_m_s``, radial velocity relative to the car, positive where a target goes away,
    ``rcs`` as the file has it, ``power_db`` and ``noise_db``. Nothing tells when a radar measured, so that its targets
    have no lag. The annotation's ``details`` are ``relative_velocity_m_s``, ``occluded`` and ``truncated``. Times are
    of the car's clock, which does not count from 1970. A session is a drive; ``split`` follows the folders ``train``
    and ``val``.

    Args:
        root: A session, a folder of sessions, a condition, a split, ``data`` or the folder that holds it.
        classes: ``"cirrus"`` translates class names, ``"aimotive"`` keeps them.

    Raises:
        DatasetError: If there is no session, or two have one name.
        ConfigError: If ``classes`` is unknown.
    """

    name = "aimotive"

    def __init__(self, root: Path | str, *, classes: str = "cirrus") -> None:
        if classes not in ("cirrus", "aimotive"):
            raise ConfigError(f"aimotive: expected classes to be one of 'cirrus', 'aimotive', got {classes!r}")
        self.root, self.classes = as_path(root), classes
        self.sessions = [_Session(path) for path in sessions_in(self.root)]
        self._index = [(session, number) for session in self.sessions for number in session.numbers]
        if not self._index:
            expected = f"<session>/{CLOUDS}/frame_*.laz, or .las, or <session>/{BOXES}/frame_*.json"
            raise DatasetError(f"{self.root}: expected {expected}, found none")
        names = [session.name for session in self.sessions]
        double = next((name for name in names if names.count(name) > 1), None)
        if double is not None:
            raise DatasetError(f"{self.root}: expected sessions of different names, found {double!r} twice")
        self.sequences = tuple(session.name for session, _ in self._index)
        self.frame_ids = tuple(f"{number:07d}" for _, number in self._index)

    def split_parts(self) -> dict[str, list[str]]:
        """The sessions below ``train``, ``val`` and ``test``; empty where some lie elsewhere."""
        parts: dict[str, list[str]] = {}
        for session in self.sessions:
            parts.setdefault(session.part, []).append(session.name)
        return {} if "" in parts else {name: parts[name] for name in SPLITS if name in parts}

    @property
    def notes(self) -> tuple[str, ...]:
        """Poses that are not read, and cameras whose lens no model of ours has."""
        moving = sum(any(session.root.glob("sensor/gnssins/egomotion*.json")) for session in self.sessions)
        lenses = {
            f"{name} ({sensor.model})"
            for session in self.sessions
            for name, sensor in session.sensors.items()
            if sensor.kind == "camera" and sensor.model != PINHOLE and name in session.pictures
        }
        texts = []
        if moving:
            texts.append(
                f"sensor/gnssins/egomotion*.json of {moving} of {len(self.sessions)} sessions are not read: what their "
                "keys mean was not to be seen in any file, so that frames have no poses"
            )
        if lenses:
            texts.append(
                f"the lenses of {', '.join(sorted(lenses))} are none of a pinhole: these pictures are shown without "
                "calibration"
            )
        return tuple(texts)

    def files(self, index: int) -> Sequence[Path]:
        """List the files of frame ``index``; the calibration is shared by the session."""
        session, number = self._index[index]
        sources = [session.clouds, session.boxes, *session.radars.values(), *session.pictures.values()]
        calibration = session.root / _CALIBRATION
        return [
            *(paths[number] for paths in sources if number in paths),
            *([calibration] if calibration.is_file() else []),
        ]

    def has_annotation(self, index: int) -> bool:
        """Whether there are boxes of frame ``index``."""
        session, number = self._index[index]
        return number in session.boxes

    def _times_of(self, indices: Indices) -> Indices | None:
        return all_known(self._index[index][0].times_ns.get(self._index[index][1]) for index in indices)

    def frame(self, index: int) -> Frame:
        """Build frame ``index``."""
        session, number = self._index[index]
        time_ns, sensors = session.times_ns.get(number), session.sensors
        clouds = {}
        described: dict[str, Sensor] = {}
        if number in session.clouds:
            clouds["lidar"] = partial(_read_cloud, session.clouds[number], time_ns)
            pose = sensors[_LIDAR].body_T_sensor if _LIDAR in sensors else None
            described["lidar"] = Sensor(kind="lidar", frame_T_sensor=pose, time_ns=time_ns)
        for name, paths in session.radars.items():
            if number in paths:
                clouds[name] = partial(_read_radar, paths[number], sensors[name].body_T_sensor)
                described[name] = Sensor(kind="radar", frame_T_sensor=sensors[name].body_T_sensor)
        images = {name: paths[number] for name, paths in session.pictures.items() if number in paths}
        cameras = {
            name: _camera(sensor)
            for name, sensor in sensors.items()
            if sensor.kind == "camera" and sensor.model == PINHOLE and name in session.pictures
        }
        for name in dict.fromkeys([*images, *cameras]):
            pose = sensors[name].body_T_sensor if name in sensors else None
            described[name] = Sensor(kind="camera", frame_T_sensor=pose, in_frame=False)
            if name in cameras:
                described[name] = camera_sensor(cameras[name])
        boxes = session.boxes.get(number)
        return Frame(
            sequence=session.name,
            frame_id=self.frame_ids[index],
            time_ns=time_ns,
            clouds=Lazy(clouds),
            images=Lazy({name: partial(read_image, path) for name, path in images.items()}),
            cameras=cameras,
            sensors=described,
            reference="body",
            load_annotation=None if boxes is None else partial(_read_annotation, boxes, self.classes),
            conditions={"condition": session.condition} if session.condition else {},
            metadata={"files": [str(path) for path in self.files(index)]},
        )


def _camera(sensor: AimotiveSensor) -> Camera:
    (fx, fy), (cx, cy) = sensor.focal_px, sensor.centre_px
    return Camera(
        matrix=np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
        distortion=np.array(sensor.distortion),
        camera_T_lidar=invert(sensor.body_T_sensor),
        width_px=sensor.size_px[0],
        height_px=sensor.size_px[1],
    )


def _read_cloud(path: Path, time_ns: int | None) -> Cloud:
    cloud = read_las(path)
    if cloud.records.get(_IN_BODY, b"true").rstrip(b"\0 ") != b"true":
        expected, actual = "a cloud in the body's coordinates", repr(cloud.records[_IN_BODY][:20])
        raise FileFormatError(path, where="the record is_body", expected=expected, got=actual)
    columns = dict(cloud.columns)
    points = np.column_stack([columns.pop(axis) for axis in "xyz"])
    valid = returned(path, points)
    strength = columns.pop("intensity")[valid].astype(np.float32) / np.float32(_FULL_INTENSITY)
    if strength.max(initial=0.0) > 1:
        actual = f"{strength.max() * _FULL_INTENSITY:g}"
        raise FileFormatError(path, where="intensity", expected="numbers from 0 to 255", got=actual)
    for name in ("offset_ns", "timestamp_ns"):  # the times are nanoseconds, not the seconds that LAS means
        columns.pop(name, None)
    extra = {name: values[valid] for name, values in columns.items()}
    times_ns = extra.pop("gps_time", None)
    if times_ns is not None and len(times_ns):
        start_ns = float(time_ns) if time_ns is not None else float(times_ns.min())
        since_ns = times_ns - start_ns
        if not (np.abs(since_ns) <= _NEAR_NS).all():
            actual = f"{since_ns.min():.6g} to {since_ns.max():.6g} ns"
            raise FileFormatError(
                path, where="gps_time", expected="times within 1 s of the frame's, in nanoseconds", got=actual
            )
        extra["offset_ns"] = np.rint(since_ns).astype(np.int64)
    return Cloud(points[valid].astype(np.float32), strength, extra, int((~valid).sum()))


def _read_radar(path: Path, body_T_radar: Float[np.ndarray, "4 4"]) -> Cloud:
    azimuth, elevation, range_m, speed, rcs, power, noise = read_targets(path).T
    flat = range_m * np.cos(elevation)
    own = np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), range_m * np.sin(elevation)])
    extra = {"doppler_m_s": speed, "rcs": rcs, "power_db": power, "noise_db": noise}
    extra |= {"azimuth_rad": azimuth, "elevation_rad": elevation, "range_m": range_m}
    columns: Mapping[str, np.ndarray] = {name: values.astype(np.float32) for name, values in extra.items()}
    return Cloud(transform_points(body_T_radar, own).astype(np.float32), None, columns)


def _read_annotation(path: Path, classes: str) -> Annotation:
    entries = read_boxes(path)
    ours = [normalised_class(name, CIRRUS_FROM_AIMOTIVE) for name in entries.name]
    boxes = Boxes(
        centre_m=entries.centre_m,
        size_m=entries.size_m,
        yaw_rad=yaw_from_quaternion(entries.quaternion_xyzw) if entries.name else np.zeros(0),
        label=list(entries.name) if classes == "aimotive" else ours,
        track_id=entries.track_id,
    )
    details = {
        "relative_velocity_m_s": entries.velocity_m_s,
        "occluded": entries.occluded,
        "truncated": entries.truncated,
    }
    return Annotation(boxes=boxes, original_label=entries.name, details=details)
