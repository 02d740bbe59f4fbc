"""KITTI's raw data (Geiger et al.: "Vision meets Robotics: The KITTI Dataset", IJRR 2013), synchronised and rectified.

``<date>/<date>_drive_NNNN_sync/{velodyne_points,image_00..03,oxts}``, ``tracklet_labels.xml`` in the drive, and the
three files of calibration in ``<date>``. A turn of the LiDAR has three stamps: when it starts, when it looks ahead (as
the cameras fire), and when it ends.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int64
from scipy.spatial.transform import Rotation

from farfield.datasets.base import Dataset, Indices, Poses, drive_poses
from farfield.datasets.cloud_reading import CloudReading
from farfield.datasets.labels.tracklet_reading import (
    FRAME_LIST,
    TrackletReading,
    checked_convention,
    read_tracklets,
)
from farfield.errors import DatasetError, FileFormatError
from farfield.files.images import read_image
from farfield.files.kitti import read_raw_calib, read_record, rectified, rigid
from farfield.files.point_times import PointTimes
from farfield.files.remote_paths import as_path
from farfield.files.stamps import read_stamps, recognise_stamps
from farfield.files.suffixes import any_case, existing
from farfield.frame import Annotation, Camera, Frame, Lazy, Sensor, camera_sensor
from farfield.geometry.poses import invert, pose

if TYPE_CHECKING:
    from farfield.datasets.labels.tracklet_labels import TrackletLabels

CLOUDS, CAMERAS = "velodyne_points", ("image_00", "image_01", "image_02", "image_03")
_COLUMNS = 4
_LABELS = "tracklet_labels.xml"
_IMAGES = (".png", ".jpg")
_STAMPS = {"middle": "timestamps.txt", "start": "timestamps_start.txt", "end": "timestamps_end.txt"}
_EARTH_M = 6_378_137.0


def drives_in(root: Path) -> list[Path]:
    """The drives in a folder: itself, or those one or two folders down."""
    stamps = f"{CLOUDS}/{_STAMPS['middle']}"
    return [path.parents[1] for above in ("", "*/", "*/*/") for path in sorted(root.glob(above + stamps))]


class KittiRaw(Dataset):
    """KITTI's raw drives: cloud ``"lidar"``, images ``"image_00"`` to ``"image_03"``, tracked boxes of full objects.

    A frame's time is the middle of its turn; ``metadata["turn_ns"]`` has its start and end. ``world_T_frame`` comes
    from the GPS/IMU where it has a record: metres east, north and up of the drive's first one. Boxes' ``track_id`` is
    the object's place in the file of tracklets. Stamps are local times without a zone, taken as UTC.

    Args:
        root: A drive, the folder of its day, or the one above.
        tracklets: What the numbers of ``tracklet_labels.xml`` stand for: ``"kitti"``, ``"cvat"`` or ``"datumaro"``;
            None decides by the list beside it, the writer's marks, and the points in the boxes.
        bin_columns: Columns of the clouds; None takes what the first show, and KITTI's four where they show none.
        intensity_scale: Value that stands for full reflectance in all clouds; None is KITTI's 1 for four columns, else
            decides by some of them.
        point_times: Unit of the points' times, where the files have any.

    Raises:
        DatasetError: If there is no drive.
        ConfigError: If there is no such convention.
    """

    name = "kitti_raw"
    reading: CloudReading

    def __init__(
        self,
        root: Path | str,
        *,
        tracklets: str | None = None,
        bin_columns: int | None = None,
        intensity_scale: float | int | None = None,
        point_times: PointTimes = "auto",
    ) -> None:
        self.root, self.tracklets = as_path(root), tracklets
        checked_convention(tracklets)
        self.folders = drives_in(self.root)
        self.clouds = [
            path for folder in self.folders for path in sorted((folder / CLOUDS / "data").glob(f"*{any_case('.bin')}"))
        ]
        if not self.clouds:
            raise DatasetError(f"{self.root}: expected drives with {CLOUDS}/data/*.bin and timestamps, found none")
        self._sweeps: dict[Path, tuple[Path, ...]] = {}
        for path in self.clouds:
            self._sweeps[path.parents[2]] = (*self._sweeps.get(path.parents[2], ()), path)
        self._first_record = {folder: min(folder.glob("oxts/data/*.txt"), default=None) for folder in self.folders}
        self.sequences = tuple(self._drive(index).resolve().name for index in range(len(self.clouds)))
        self.frame_ids = tuple(path.stem for path in self.clouds)
        self.reading = CloudReading(
            self.clouds,
            bin_columns=bin_columns,
            intensity_scale=intensity_scale,
            point_times=point_times,
            usual_columns=_COLUMNS,
            usual_scale=1.0,  # KITTI's reflectance reaches 1
        )

    def _drive(self, index: int) -> Path:
        return self.clouds[index].parents[2]

    def _image(self, index: int, camera: str) -> Path | None:
        candidates = (self._drive(index) / camera / "data" / f"{self.frame_ids[index]}{suffix}" for suffix in _IMAGES)
        return next((path for candidate in candidates if (path := existing(candidate))), None)

    def files(self, index: int) -> Sequence[Path]:
        """List the files of frame ``index``."""
        drive = self._drive(index)
        record, labels = drive / "oxts" / "data" / f"{self.frame_ids[index]}.txt", drive / _LABELS
        images = [path for camera in CAMERAS if (path := self._image(index, camera)) is not None]
        beside = (record, labels, labels.with_name(FRAME_LIST))
        return [self.clouds[index], *images, *(path for path in beside if path.is_file())]

    def has_annotation(self, index: int) -> bool:
        """Whether the drive of frame ``index`` has tracklets; a frame that they do not mention has no objects."""
        return (self._drive(index) / _LABELS).is_file()

    def _reading(self, drive: Path) -> Callable[[], TrackletReading]:
        """What reads a drive's tracklets."""
        convention, columns = self.tracklets, self.reading.bin_columns
        return partial(read_tracklets, drive / _LABELS, self._sweeps[drive], convention=convention, bin_columns=columns)

    def tracklets_of(self, drive: Path) -> TrackletReading:
        """The tracklets of a drive's folder; errors are those of :func:`read_tracklets`."""
        return self._reading(drive)()

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What the numbers of each drive's tracklets stand for, and by what that was decided."""
        readings = [self.tracklets_of(drive) for drive in self._sweeps if (drive / _LABELS).is_file()]
        return tuple(reading.sentence for reading in readings if not reading.published)

    def _times_of(self, indices: Indices) -> Indices | None:
        times_ns = [self._time_ns(index, "middle") for index in np.asarray(indices).tolist()]
        return None if None in times_ns else np.array(times_ns, dtype=np.int64)

    def _pose(self, index: int) -> Float[np.ndarray, "4 4"] | None:
        drive = self._drive(index)
        return placed(drive, self.frame_ids[index], self._first_record[drive])

    def _poses_of(self, indices: Indices) -> Poses | None:
        return drive_poses(self._pose, indices)

    def _time_ns(self, index: int, which: str) -> int | None:
        path = self._drive(index) / CLOUDS / _STAMPS[which]
        return stamp_of(path, self.frame_ids[index])

    def frame(self, index: int) -> Frame:
        """Build frame ``index``."""
        drive, frame_id = self._drive(index), self.frame_ids[index]
        images = {camera: path for camera in CAMERAS if (path := self._image(index, camera)) is not None}
        cameras = cameras_of(drive.parent)
        labels = drive / _LABELS
        turn = tuple(self._time_ns(index, which) for which in ("start", "end"))
        times = {name: stamp_of(drive / name / _STAMPS["middle"], frame_id) for name in (*images, *cameras)}
        return Frame(
            sequence=self.sequences[index],
            frame_id=frame_id,
            time_ns=self._time_ns(index, "middle"),
            clouds=Lazy({"lidar": self.reading.loader(self.clouds[index])}),
            images=Lazy({name: partial(read_image, path) for name, path in images.items()}),
            cameras=cameras,
            sensors={
                "lidar": Sensor(kind="lidar", frame_T_sensor=np.eye(4), time_ns=self._time_ns(index, "middle")),
                **{name: camera_sensor(cameras.get(name), time) for name, time in times.items()},
            },
            world_T_frame=self._pose(index),
            load_annotation=partial(_annotation, self._reading(drive), frame_id) if labels.is_file() else None,
            metadata={"files": [str(path) for path in self.files(index)], "turn_ns": turn},
        )


def label_format(data: KittiRaw) -> "TrackletLabels":
    """The tracklets of a data set's drives, to edit them."""
    from farfield.datasets.labels.tracklet_labels import TrackletLabels

    readings = {drive: data.tracklets_of(drive) for drive in dict.fromkeys(cloud.parents[2] for cloud in data.clouds)}
    places = {
        key: (cloud.parents[2] / _LABELS, readings[cloud.parents[2]].numbers[cloud.stem])
        for key, cloud in zip(data.keys, data.clouds, strict=True)
    }
    return TrackletLabels(places, {reading.path: reading.convention for reading in readings.values()})


def stamp_of(path: Path, frame_id: str) -> int | None:
    """The stamp of a frame in a list that begins with frame 0, or None without a list or so many lines."""
    if not path.is_file() or not frame_id.isdigit():
        return None
    status = path.stat()
    stamps = _stamps(path, status.st_mtime_ns, status.st_size)
    return int(stamps[int(frame_id)]) if int(frame_id) < len(stamps) else None


@lru_cache(maxsize=32)
def _stamps(path: Path, changed_ns: int, size: int) -> Int64[np.ndarray, " n"]:
    del changed_ns, size
    stamps = recognise_stamps(path)
    if stamps is None:
        raise FileFormatError(path, where="line 1", expected="a date and a time", got="something else")
    return np.concatenate(list(read_stamps(stamps)))


def cameras_of(day: Path) -> dict[str, Camera]:
    """The rectified cameras of a day's calibration, in the LiDAR's coordinates; none where it is not there.

    Raises:
        FileFormatError: If a file is damaged.
    """
    between, ahead = day / "calib_cam_to_cam.txt", day / "calib_velo_to_cam.txt"
    if not between.is_file() or not ahead.is_file():
        return {}
    calib, first_T_lidar = read_raw_calib(between), rigid(read_raw_calib(ahead), ahead)
    cameras = {}
    for name in CAMERAS:
        matrix, rectified_T_first, (width, height) = rectified(calib, name[-2:], between)
        camera_T_lidar = rectified_T_first @ first_T_lidar
        cameras[name] = Camera(matrix=matrix, camera_T_lidar=camera_T_lidar, width_px=width, height_px=height)
    return cameras


def placed(drive: Path, frame_id: str, beginning: Path | None) -> Float[np.ndarray, "4 4"] | None:
    """Where the LiDAR stands, from the GPS/IMU's record in a Mercator map about the drive's first record.

    Args:
        drive: The drive's folder.
        frame_id: The frame.
        beginning: The drive's first record; None where it has none.

    Raises:
        FileFormatError: If a record or the calibration is damaged.
    """
    record, calibration = drive / "oxts" / "data" / f"{frame_id}.txt", drive.parent / "calib_imu_to_velo.txt"
    if beginning is None or not record.is_file() or not calibration.is_file():
        return None
    first = read_record(beginning)
    scale = float(np.cos(np.radians(first[0])))
    here = _pose(read_record(record), scale)
    here[:3, 3] -= _pose(first, scale)[:3, 3]
    return here @ invert(rigid(read_raw_calib(calibration), calibration))


def _pose(record: Float[np.ndarray, " 30"], scale: float) -> Float[np.ndarray, "4 4"]:
    """Pose of the GPS/IMU in a Mercator map of a scale, x east, y north, z up (development kit of the raw data)."""
    latitude, longitude, altitude, roll, pitch, yaw = record[:6]
    east = scale * _EARTH_M * np.radians(longitude)
    north = scale * _EARTH_M * np.log(np.tan(np.radians(90 + latitude) / 2))
    return pose(Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix(), np.array([east, north, altitude]))


def _annotation(reading: Callable[[], TrackletReading], frame_id: str) -> Annotation:
    from farfield.datasets.labels.json_labels import annotation_of

    return annotation_of(reading().boxes(frame_id))
