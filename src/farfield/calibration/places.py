"""Where the readers of each data set look for a calibration, and writing it there.

K-Radar: ``cam_N.yml`` of the release that is read, ``calib_radar_lidar.txt`` with its side file, ``info_matching`` of
every frame, ``calib_os2_os1.farfield.json``. KITTI and View-of-Delft: ``calib/<frame>.txt`` of every frame with this
calibration. Cirrus and own folders: our ``calibration.json``, or the file that Cirrus' mapping names.
"""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from farfield.calibration.radar_lidar import RadarCalibration
from farfield.calibration.saving import keep_copy, replace_text, save_camera, save_radar
from farfield.datasets.base import Dataset
from farfield.datasets.calibration import read_calibration, write_calibration
from farfield.datasets.cirrus import Cirrus
from farfield.datasets.folder import Folder
from farfield.datasets.kitti.boxes import camera_of
from farfield.datasets.kradar import KRadar
from farfield.datasets.kradar.layout import camera_number
from farfield.datasets.kradar.radar_pose import LIDARS_FILE, RADAR_FILE, InfoMatching, matching_path
from farfield.datasets.kradar.writer import camera_path
from farfield.errors import ConfigError, FarfieldError
from farfield.files.kitti import read_calib
from farfield.geometry.cameras import Camera
from farfield.geometry.poses import invert

_OWN_FILE = "calibration.json"
_SAME = 1e-6


def holds_intrinsics(data: Dataset) -> bool:
    """Whether a camera's focal length and distortion are written too; KITTI's files take the pose alone."""
    return isinstance(data.unwrapped, KRadar | Cirrus | Folder)


def camera_files(data: Dataset, index: int, name: str, before: Camera | None) -> list[Path]:
    """Files from which a camera's calibration is read.

    Args:
        data: The data set.
        index: A frame of the sequence that was calibrated.
        name: Name of the image.
        before: The calibration as it was read; files of other frames that hold another one are left out.

    Raises:
        ConfigError: If the reader takes its calibration from elsewhere.
    """
    reader, sequence = data.unwrapped, data.sequences[index]
    if isinstance(reader, KRadar):
        known = reader.of_sequence(sequence).camera_files.get(name)
        return [known or reader.root / camera_path(sequence, camera_number(name))]
    if isinstance(reader, Cirrus):
        if reader.mapping.calib.convention == "cam_to_lidar":
            raise ConfigError("the mapping's calib.convention is cam_to_lidar: set it to lidar_to_cam, which we write")
        named = reader.mapping.calib.file
        return [reader.root / named if named else reader.calibration_file or reader.root / _OWN_FILE]
    if isinstance(reader, Folder):
        return [reader.calibration_file or reader.root / _OWN_FILE]
    members = [each for each, of in enumerate(data.sequences) if of == sequence]
    paths = [path for each in members for path in data.files(each) if path.parent.name == "calib"]
    found = [path for path in dict.fromkeys(paths) if before is not None and _is(path, before)]
    if not found:
        raise ConfigError(
            f"{data.name}: nowhere to write a camera's calibration that its reader reads; give --save FILE.json"
        )
    return found


def _is(path: Path, camera: Camera) -> bool:
    try:
        found = camera_of(read_calib(path)).camera_T_lidar
    except FarfieldError:
        return False
    return bool(np.abs(found - camera.camera_T_lidar).max() < _SAME)


def save_camera_where_read(data: Dataset, index: int, name: str, before: Camera | None, after: Camera) -> list[Path]:
    """Write a camera into the files from which the reader takes it; copies of what was there stay beside them.

    Returns:
        Files written, and the copies.
    """
    files = camera_files(data, index, name, before)
    if isinstance(data.unwrapped, Cirrus | Folder):
        return [path for file in files for path in _save_own(file, name, after)]
    return [path for file in files for path in save_camera(file, name, before or after, after)]


def _save_own(path: Path, name: str, camera: Camera) -> list[Path]:
    """Write our own file, whatever its suffix: JSON is YAML too; other cameras in it stay."""
    cameras = dict(read_calibration(path)) if path.exists() else {}
    copy = keep_copy(path)
    write_calibration(path, cameras | {name: camera})
    return [path, *([copy] if copy is not None else [])]


def save_radar_where_read(data: Dataset, index: int, found: RadarCalibration, *, matching: bool = True) -> list[Path]:
    """Write a K-Radar sequence's radar: text file, side file, and ``info_matching`` of every frame.

    Args:
        data: A K-Radar.
        index: A frame of the sequence.
        found: What was found.
        matching: Write the development kit's ``info_matching`` too, one file a frame.

    Raises:
        ConfigError: If the data set is another.
    """
    reader, sequence = data.unwrapped, data.sequences[index]
    if not isinstance(reader, KRadar):
        raise ConfigError(f"radar-lidar: only K-Radar's files have a place for it, got {data.name}")
    path = reader.root / sequence / "info_calib" / RADAR_FILE
    base = _base(data[index].sensors["radar"].frame_T_sensor)
    written = save_radar(path, found, difference=reader.frame_difference(sequence))
    members = [each for each, of in enumerate(reader.sequences) if of == sequence] if matching else []
    return written + [each for member in members for each in _save_matching(reader, member, base, found)]


def _base(os2_T_radar: Float[np.ndarray, "4 4"] | None) -> tuple[float, float, float]:
    radar_T_os2 = np.eye(4) if os2_T_radar is None else invert(os2_T_radar)
    yaw = float(np.degrees(np.arctan2(radar_T_os2[1, 0], radar_T_os2[0, 0])))
    return float(radar_T_os2[0, 3]), float(radar_T_os2[1, 3]), yaw


def _save_matching(
    reader: KRadar, index: int, base: tuple[float, float, float], found: RadarCalibration
) -> Sequence[Path]:
    entry, pose = reader.entries[index], found.pose
    offset = (pose.x_m - base[0], pose.y_m - base[1], float(np.degrees(pose.yaw_rad)) - base[2])
    pictures = (path.name for path in reader.files(index) if path.parent.name in ("cam-front", "cam_front"))
    names = (f"tesseract_{entry.radar + pose.frames:05d}.mat", f"os2-64_{entry.lidar:05d}.pcd", next(pictures, "none"))
    text = InfoMatching(names=names, base=base, offset=offset).text()
    path = reader.root / matching_path(entry.sequence, entry.stem)
    copy = replace_text(path, text)
    return [path, *([copy] if copy is not None else [])]


def save_lidars_where_read(data: Dataset, index: int, os2_T_os1: Float[np.ndarray, "4 4"]) -> list[Path]:
    """Write where a K-Radar's os1-128 stands, for the sequence of a frame.

    Raises:
        ConfigError: If the data set is another.
    """
    reader = data.unwrapped
    if not isinstance(reader, KRadar):
        raise ConfigError(f"lidar-lidar: only K-Radar's reader has a place for it, got {data.name}")
    path = reader.root / data.sequences[index] / "info_calib" / LIDARS_FILE
    content = {"schema": 1, "os2_T_os1": os2_T_os1.ravel().tolist(), "made_by": "farfield calibrate lidar-lidar"}
    copy = replace_text(path, json.dumps(content, indent=1) + "\n")
    return [path, *([copy] if copy is not None else [])]
