"""Astyx HiRes2019 (Meyer and Kuschk: "Automotive Radar Dataset for Deep Learning Based 3D Object Detection", 2019).

``radar_6455/*.txt``, ``lidar_vlp16/*.txt``, ``camera_front/*.jpg``, ``calibration/*.json``,
``groundtruth_obj3d/*.json``. Boxes stand in the radar's coordinates, which are the frame's.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int64

from farfield.datasets.base import Dataset, Indices
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.files.ascii_table import whole_numbers
from farfield.files.astyx import LIDAR_COLUMNS, RADAR_COLUMNS, read_objects, read_points, read_sensors
from farfield.files.images import image_size, read_image
from farfield.files.limits import MAX_RINGS
from farfield.files.remote_paths import as_path
from farfield.files.suffixes import any_case, existing
from farfield.frame import Annotation, Boxes, Camera, Cloud, Frame, Lazy, Sensor, camera_sensor
from farfield.frame.cloud_columns import returned
from farfield.vocabulary.classes import CIRRUS_FROM_ASTYX, normalised_class

RADAR, LIDAR, CAMERA = "radar_6455", "lidar_vlp16", "camera_front"
_REFLECTIVITY_FULL, _HOUR_US = 255.0, 3_600_000_000


def root_of(folder: Path) -> Path | None:
    """Where the radar's folder stands: in the folder, or in the one of the archive's name in it."""
    candidates = (folder, folder / "dataset_astyx_hires2019")
    return next((candidate for candidate in candidates if any((candidate / RADAR).glob("*" + any_case(".txt")))), None)


class Astyx(Dataset):
    """Astyx' frames: clouds ``"radar"`` and ``"lidar"``, image ``"camera"``, boxes of the full objects.

    The radar's cloud has ``v_r_m_s`` (once more as ``doppler_m_s``), radial velocity relative to the radar, and
    ``magnitude_db``; the LiDAR's ``ring``, ``time_us``,
    microseconds of the hour, and ``offset_ns`` since the sweep's first point. The annotation's ``details`` are
    ``occlusion`` and ``certainty`` of each box. The frames are short pieces of drives, in one sequence: which follow
    one another is not told.

    Args:
        root: The folder with ``radar_6455``, or the one above.
        classes: ``"cirrus"`` translates class names, ``"astyx"`` keeps them.

    Raises:
        DatasetError: If there is no cloud of the radar.
        ConfigError: If ``classes`` is unknown.
    """

    name = "astyx"

    def __init__(self, root: Path | str, *, classes: str = "cirrus") -> None:
        if classes not in ("cirrus", "astyx"):
            raise ConfigError(f"astyx: expected classes to be one of 'cirrus', 'astyx', got {classes!r}")
        self.root, self.classes = as_path(root), classes
        folder = root_of(self.root)
        if folder is None:
            raise DatasetError(f"{self.root}: expected {RADAR}/*.txt, found none")
        self.folder = folder
        self.frame_ids = tuple(path.stem for path in sorted((folder / RADAR).glob("*" + any_case(".txt"))))
        self.sequences = (folder.resolve().name,) * len(self.frame_ids)

    def drive_indices(self) -> Mapping[str, Indices]:
        """No drives: frames of many short pieces."""
        return {}

    def _file(self, index: int, folder: str, suffix: str) -> Path | None:
        return existing(self.folder / folder / f"{self.frame_ids[index]}{suffix}")

    def files(self, index: int) -> Sequence[Path]:
        """List the files of frame ``index``."""
        sensors = ((RADAR, ".txt"), (LIDAR, ".txt"), (CAMERA, ".jpg"), ("calibration", ".json"))
        paths = [self._file(index, *kind) for kind in (*sensors, ("groundtruth_obj3d", ".json"))]
        return [path for path in paths if path is not None]

    def has_annotation(self, index: int) -> bool:
        """Whether there are boxes of frame ``index``."""
        return self._file(index, "groundtruth_obj3d", ".json") is not None

    def frame(self, index: int) -> Frame:
        """Build frame ``index``.

        Raises:
            DatasetError: If there is a LiDAR's cloud without a calibration.
        """
        lidar, picture = self._file(index, LIDAR, ".txt"), self._file(index, CAMERA, ".jpg")
        calibration, labels = self._file(index, "calibration", ".json"), self._file(index, "groundtruth_obj3d", ".json")
        calibrated = {} if calibration is None else read_sensors(calibration)
        clouds = {"radar": partial(_read_radar, self._file(index, RADAR, ".txt") or self.folder)}
        sensors = {"radar": Sensor(kind="radar", frame_T_sensor=np.eye(4))}
        if lidar is not None:
            if LIDAR not in calibrated:
                raise DatasetError(f"{lidar}: expected its pose in calibration/{self.frame_ids[index]}.json")
            pose = calibrated[LIDAR]["T_to_ref_COS"]
            clouds["lidar"] = partial(_read_lidar, lidar, pose)
            sensors["lidar"] = Sensor(kind="lidar", frame_T_sensor=pose)
        cameras = _cameras(calibrated.get(CAMERA, {}), picture)
        if cameras or picture is not None:
            sensors["camera"] = camera_sensor(cameras.get("camera"))
        return Frame(
            sequence=self.sequences[index],
            frame_id=self.frame_ids[index],
            clouds=Lazy(clouds),
            images=Lazy({} if picture is None else {"camera": partial(read_image, picture)}),
            cameras=cameras,
            sensors=sensors,
            reference="radar",
            load_annotation=None if labels is None else partial(_read_annotation, labels, self.classes),
            metadata={"files": [str(path) for path in self.files(index)]},
        )


def _cameras(matrices: Mapping[str, Float[np.ndarray, "r c"]], picture: Path | None) -> dict[str, Camera]:
    if "K" not in matrices:
        return {}
    width, height = (0, 0) if picture is None else image_size(picture)
    pose = np.linalg.inv(matrices["T_to_ref_COS"])
    return {"camera": Camera(matrix=matrices["K"], camera_T_lidar=pose, width_px=width, height_px=height)}


def _read_radar(path: Path) -> Cloud:
    x, y, z, velocity, magnitude = (column.astype(np.float32) for column in read_points(path, RADAR_COLUMNS))
    extra = {"v_r_m_s": velocity, "doppler_m_s": velocity, "magnitude_db": magnitude}
    points = np.stack([x, y, z], axis=1)
    valid = returned(path, points)
    return Cloud(points[valid], None, {name: column[valid] for name, column in extra.items()}, int((~valid).sum()))


def _read_lidar(path: Path, frame_T_lidar: Float[np.ndarray, "4 4"]) -> Cloud:
    columns = read_points(path, LIDAR_COLUMNS)
    valid = returned(path, np.stack(columns[:3], axis=1))
    x, y, z, strength, ring, time_us = (column[valid] for column in columns)
    outside = (strength < 0) | (strength > _REFLECTIVITY_FULL)
    if outside.any():
        got = f"{strength[outside][0]:g}"
        raise FileFormatError(path, where="column Reflectivity", expected="numbers from 0 to 255", got=got)
    placed = np.stack([x, y, z], axis=1) @ frame_T_lidar[:3, :3].T + frame_T_lidar[:3, 3]
    whole_us = whole_numbers(time_us, largest=_HOUR_US, path=path, where="column Timestamp")
    extra = {
        "ring": whole_numbers(ring, largest=MAX_RINGS - 1, path=path, where="column LaserID"),
        "time_us": whole_us,
        "offset_ns": _since_first_ns(whole_us),
    }
    intensity = (strength / _REFLECTIVITY_FULL).astype(np.float32)
    return Cloud(placed.astype(np.float32), intensity, extra, int((~valid).sum()))


def _since_first_ns(time_us: Int64[np.ndarray, " n"]) -> Int64[np.ndarray, " n"]:
    """Times of the hour since the first of a sweep, which may begin before the hour and end behind it."""
    if not len(time_us):
        return time_us
    from_one_us = (time_us - time_us[0] + _HOUR_US // 2) % _HOUR_US
    return (from_one_us - from_one_us.min()) * 1000


def _read_annotation(path: Path, classes: str) -> Annotation:
    objects = read_objects(path)
    if not objects:
        return Annotation(boxes=Boxes.empty())
    w, x, y, z = np.array([item.quaternion for item in objects]).T
    names = [item.name for item in objects]
    ours = names if classes == "astyx" else [normalised_class(name, CIRRUS_FROM_ASTYX) for name in names]
    boxes = Boxes(
        centre_m=np.array([item.centre_m for item in objects]),
        size_m=np.array([item.size_m for item in objects]),
        yaw_rad=np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
        label=ours,
    )
    details = {
        "occlusion": np.array([item.occlusion for item in objects]),
        "certainty": np.array([item.certainty for item in objects]),
    }
    return Annotation(boxes=boxes, original_label=tuple(names), details=details)
