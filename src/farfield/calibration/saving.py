"""Write calibrations into the files from which the readers take them; what was there is copied first, never lost.

K-Radar: ``info_calib/calib_radar_lidar.txt`` holds frame difference, x and y; yaw, time and sigma go into a side file,
and yaw into the development kit's ``info_matching/<radar>_<lidar>.txt`` of every frame on request; ``cam_N.yml`` of the
release that is read; ``calib_os2_os1.farfield.json``. KITTI and View-of-Delft: the change goes into ``Tr_velo_to_cam``
of ``calib/<frame>.txt``, of every frame with this calibration. Cirrus and own folders: our ``calibration.json``, or the
file that Cirrus' mapping names.
"""

import json
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from jaxtyping import Float

from farfield.calibration.radar_lidar import RadarCalibration
from farfield.calibration.radar_matching import RadarPose
from farfield.datasets.base import Dataset
from farfield.datasets.calibration import read_calibration, write_calibration
from farfield.datasets.cirrus import Cirrus
from farfield.datasets.folder import Folder
from farfield.datasets.kitti.boxes import camera_of
from farfield.datasets.kradar import KRadar
from farfield.datasets.kradar.layout import camera_number
from farfield.datasets.kradar.radar_pose import LIDARS_FILE, RADAR_FILE, SIDE_FILE, InfoMatching, matching_path
from farfield.datasets.kradar.texts import format_camera
from farfield.datasets.kradar.writer import camera_path
from farfield.errors import ConfigError, FarfieldError, FileFormatError
from farfield.files.atomic import read_bytes, write_bytes, write_text
from farfield.files.kitti import read_calib
from farfield.geometry.cameras import Camera
from farfield.geometry.poses import invert

_MAX_BYTES = 1 << 20
_OWN_FILE = "calibration.json"
_SAME = 1e-6


def keep_copy(path: Path) -> list[Path]:
    """Copy a file to ``NAME.before-<UTC time>`` beside it, and name the copy; nothing where there is no file."""
    if not path.exists():
        return []
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S.%fZ")
    copy = path.with_name(f"{path.name}.before-{stamp}")
    write_bytes(copy, read_bytes(path, max_bytes=_MAX_BYTES))
    return [copy]


def replace_text(path: Path, text: str) -> list[Path]:
    """Write a text, all or nothing, after :func:`keep_copy`; returns the file, and the copy."""
    path.parent.mkdir(parents=True, exist_ok=True)
    copies = keep_copy(path)
    write_text(path, text)
    return [path, *copies]


# Cameras


def save_camera(path: Path, name: str, before: Camera, after: Camera) -> list[Path]:
    """Write a camera by the file's suffix: ``.yml`` K-Radar's, ``.txt`` KITTI's, ``.json`` our own.

    Returns:
        The file, and the copy of what was there.

    Raises:
        FileFormatError: If the suffix is another.
    """
    if path.suffix == ".txt":
        return save_kitti_camera(path, before, after)
    if path.suffix == ".yml":
        return save_kradar_camera(path, after, camera_number(name))
    if path.suffix != ".json":
        raise FileFormatError(path, where="its name", expected=".txt, .yml or .json", got=path.suffix or "none")
    return _save_own_camera(path, name, after)


def _save_own_camera(path: Path, name: str, camera: Camera) -> list[Path]:
    """Write our own file, whatever its suffix: JSON is YAML too; other cameras in it stay."""
    cameras = dict(read_calibration(path)) if path.exists() else {}
    copies = keep_copy(path)
    write_calibration(path, cameras | {name: camera})
    return [path, *copies]


def save_kradar_camera(path: Path, camera: Camera, number: int) -> list[Path]:
    """Write ``cam_N.yml`` of either release: keys that are there get their new values, every other line stays."""
    new = dict(line.split(": ", 1) for line in format_camera(camera, number).splitlines())
    old = read_bytes(path, max_bytes=_MAX_BYTES).decode("utf-8") if path.exists() else ""
    lines = []
    for line in old.splitlines():
        key, colon, _ = line.partition(":")
        lines.append(f"{key}: {new.pop(key.strip())}" if colon and key.strip() in new else line)
    lines += [f"{key}: {value}" for key, value in new.items()]  # those that were not there
    return replace_text(path, "\n".join(lines) + "\n")


def save_kitti_camera(path: Path, before: Camera, after: Camera) -> list[Path]:
    """Fold a change of pose into ``Tr_velo_to_cam`` of a KITTI or View-of-Delft calibration; other lines stay.

    ``camera_T_lidar = B R0 Tr`` with B and R0 as they are, so ``Tr`` becomes ``Tr before^-1 after``.

    Raises:
        FileFormatError: If the file has no ``Tr_velo_to_cam``.
    """
    matrices: Mapping[str, np.ndarray] = read_calib(path)
    name = next((key for key in ("Tr_velo_to_cam", "Tr_velo_cam") if key in matrices), None)
    if name is None:
        raise FileFormatError(path, where="the file", expected="Tr_velo_to_cam", got=", ".join(matrices))
    old = np.vstack([matrices[name], [0.0, 0.0, 0.0, 1.0]])
    new = old @ invert(before.camera_T_lidar) @ after.camera_T_lidar
    text = read_bytes(path, max_bytes=_MAX_BYTES).decode("utf-8")
    row = f"{name}: " + " ".join(f"{value:.12e}" for value in new[:3].ravel())
    lines = [row if line.replace(":", " ").split()[:1] == [name] else line for line in text.splitlines()]
    return replace_text(path, "\n".join(lines) + "\n")


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
        path = reader.of_sequence(sequence).camera_files.get(name)
        return [path or reader.root / camera_path(sequence, camera_number(name))]
    if isinstance(reader, Cirrus):
        if reader.mapping.calib.convention == "cam_to_lidar":
            raise ConfigError("the mapping's calib.convention is cam_to_lidar: set it to lidar_to_cam, which we write")
        named = reader.mapping.calib.file
        return [reader.root / named if named else reader.calibration_file or reader.root / _OWN_FILE]
    if isinstance(reader, Folder):
        return [reader.calibration_file or reader.root / _OWN_FILE]
    members = [member for member, other in enumerate(data.sequences) if other == sequence]
    paths = [path for member in members for path in data.files(member) if path.parent.name == "calib"]
    alike = [path for path in dict.fromkeys(paths) if before is not None and _holds(path, before)]
    if not alike:
        raise ConfigError(
            f"{data.name}: nowhere to write a camera's calibration that its reader reads; give --save FILE.json"
        )
    return alike


def _holds(path: Path, camera: Camera) -> bool:
    """Whether a KITTI calibration has this pose."""
    try:
        stored = camera_of(read_calib(path)).camera_T_lidar
    except FarfieldError:
        return False
    return bool(np.abs(stored - camera.camera_T_lidar).max() < _SAME)


def save_camera_where_read(data: Dataset, index: int, name: str, before: Camera | None, after: Camera) -> list[Path]:
    """Write a camera into the files from which the reader takes it; copies of what was there stay beside them.

    Returns:
        Files written, and the copies.
    """
    files = camera_files(data, index, name, before)
    if isinstance(data.unwrapped, Cirrus | Folder):
        return [path for file in files for path in _save_own_camera(file, name, after)]
    return [path for file in files for path in save_camera(file, name, before or after, after)]


# K-Radar's radar and second LiDAR


def save_radar(path: Path, calibration: RadarCalibration, *, difference: int) -> list[Path]:
    """Write ``calib_radar_lidar.txt`` and its side file; header and line ends stay as they were.

    Args:
        path: The text file; made if it is not there.
        calibration: The calibration; its ``frames`` are added to the difference.
        difference: Radar index minus LiDAR index as it was read.

    Returns:
        The files written, and the copies of those that were there.
    """
    old = read_bytes(path, max_bytes=_MAX_BYTES).decode("utf-8") if path.exists() else "frame difference,x,y\n"
    ending = "\r\n" if "\r\n" in old else "\n"
    pose = calibration.pose
    values = f"{difference + pose.frames},{pose.x_m:.4f},{pose.y_m:.4f}"
    side = {
        "schema": 1,
        "radar_T_lidar": pose.matrix.ravel().tolist(),
        "yaw_rad": pose.yaw_rad,
        "frame_difference": difference + pose.frames,
        "time_offset_ns": round(pose.time_offset_s * 1e9),
        "sigma": calibration.solution.to_json()["parameters"],
        "unobserved": list(calibration.notes),
        "made_by": "farfield calibrate radar-lidar",
    }
    table, *table_copy = replace_text(path, f"{old.splitlines()[0]}{ending}{values}{ending}")
    side_file, *side_copy = replace_text(path.with_name(SIDE_FILE), json.dumps(side, indent=1) + "\n")
    return [table, side_file, *table_copy, *side_copy]


def save_radar_where_read(
    data: Dataset, index: int, calibration: RadarCalibration, *, matching: bool = True
) -> list[Path]:
    """Write a K-Radar sequence's radar: text file, side file, and ``info_matching`` of every frame.

    Args:
        data: A K-Radar.
        index: A frame of the sequence.
        calibration: The calibration.
        matching: Write the development kit's ``info_matching`` too, one file a frame.

    Raises:
        ConfigError: If the data set is another.
    """
    reader, sequence = data.unwrapped, data.sequences[index]
    if not isinstance(reader, KRadar):
        raise ConfigError(f"radar-lidar: only K-Radar's files have a place for it, got {data.name}")
    path = reader.root / sequence / "info_calib" / RADAR_FILE
    lidar_T_radar = data[index].sensors["radar"].frame_T_sensor
    stored = RadarPose.from_matrix(np.eye(4) if lidar_T_radar is None else invert(lidar_T_radar))
    written = save_radar(path, calibration, difference=reader.frame_difference(sequence))
    members = [member for member, other in enumerate(reader.sequences) if other == sequence] if matching else []
    return written + [file for member in members for file in _save_matching(reader, member, stored, calibration.pose)]


def _save_matching(reader: KRadar, index: int, stored: RadarPose, pose: RadarPose) -> list[Path]:
    """Write ``info_matching`` of a frame: the stored pose, and the offset from it."""
    entry = reader.entries[index]
    base = (stored.x_m, stored.y_m, float(np.degrees(stored.yaw_rad)))
    offset = (pose.x_m - base[0], pose.y_m - base[1], float(np.degrees(pose.yaw_rad)) - base[2])
    pictures = (path.name for path in reader.files(index) if path.parent.name in ("cam-front", "cam_front"))
    names = (f"tesseract_{entry.radar + pose.frames:05d}.mat", f"os2-64_{entry.lidar:05d}.pcd", next(pictures, "none"))
    text = InfoMatching(names=names, base=base, offset=offset).text()
    return replace_text(reader.root / matching_path(entry.sequence, entry.stem), text)


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
    return replace_text(path, json.dumps(content, indent=1) + "\n")
