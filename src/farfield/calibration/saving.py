"""Write calibrations where the readers find them; what was there is copied first, never lost.

K-Radar's ``info_calib/calib_radar_lidar.txt`` holds frame difference, x and y; yaw, time and sigma go into a side file,
and yaw into the development kit's ``info_matching/<radar>_<lidar>.txt`` on request. KITTI's change goes into
``Tr_velo_to_cam`` alone.
"""

import json
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from jaxtyping import Float

from farfield.calibration.radar_lidar import RadarCalibration
from farfield.calibration.radar_matching import RadarPose
from farfield.datasets.calibration import read_calibration, write_calibration
from farfield.datasets.kradar.layout import camera_number
from farfield.datasets.kradar.radar_pose import SIDE_FILE
from farfield.datasets.kradar.texts import format_camera
from farfield.errors import FileFormatError
from farfield.files.atomic import read_bytes, write_bytes, write_text
from farfield.files.kitti import read_calib
from farfield.geometry.cameras import Camera
from farfield.geometry.poses import invert, pose_from_yaw

_MAX_BYTES = 1 << 20


def keep_copy(path: Path) -> Path | None:
    """Copy a file to ``NAME.before-<UTC time>`` beside it; None where there is none."""
    if not path.exists():
        return None
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S.%fZ")
    copy = path.with_name(f"{path.name}.before-{stamp}")
    write_bytes(copy, read_bytes(path, max_bytes=_MAX_BYTES))
    return copy


def replace_text(path: Path, text: str) -> Path | None:
    """Write a text, all or nothing, after :func:`keep_copy`; returns the copy."""
    path.parent.mkdir(parents=True, exist_ok=True)
    copy = keep_copy(path)
    write_text(path, text)
    return copy


def save_radar(path: Path, found: RadarCalibration, *, difference: int) -> list[Path]:
    """Write ``calib_radar_lidar.txt`` and its side file; header and line ends stay as they were.

    Args:
        path: The text file; made if it is not there.
        found: The calibration; its ``frames`` are added to the difference.
        difference: Radar index minus LiDAR index as it was read.

    Returns:
        The files written, and the copies of those that were there.
    """
    old = read_bytes(path, max_bytes=_MAX_BYTES).decode("utf-8") if path.exists() else "frame difference,x,y\n"
    ending = "\r\n" if "\r\n" in old else "\n"
    pose = found.pose
    values = f"{difference + pose.frames},{pose.x_m:.4f},{pose.y_m:.4f}"
    written = {path: f"{old.splitlines()[0]}{ending}{values}{ending}"}
    side = {
        "schema": 1,
        "radar_T_lidar": radar_T_lidar(pose).ravel().tolist(),
        "yaw_rad": pose.yaw_rad,
        "frame_difference": difference + pose.frames,
        "time_offset_ns": round(pose.time_offset_s * 1e9),
        "sigma": found.solution.to_json()["parameters"],
        "unobserved": list(found.notes),
        "made_by": "farfield calibrate radar-lidar",
    }
    written[path.with_name(SIDE_FILE)] = json.dumps(side, indent=1) + "\n"
    copies = [replace_text(each, text) for each, text in written.items()]
    return [*written, *(copy for copy in copies if copy is not None)]


def radar_T_lidar(pose: RadarPose) -> Float[np.ndarray, "4 4"]:
    """The pose as a matrix."""
    return pose_from_yaw(pose.yaw_rad, (pose.x_m, pose.y_m, pose.z_m))


def save_kradar_camera(path: Path, camera: Camera, number: int) -> list[Path]:
    """Write ``cam_N.yml`` of either release: known keys get their new values, every other line stays."""
    new = dict(line.split(": ", 1) for line in format_camera(camera, number).splitlines())
    old = read_bytes(path, max_bytes=_MAX_BYTES).decode("utf-8") if path.exists() else ""
    lines = [_renewed(line, new) for line in old.splitlines()]
    lines += [f"{key}: {value}" for key, value in new.items()]  # those that were not there
    copy = replace_text(path, "\n".join(lines) + "\n")
    return [path, *([copy] if copy is not None else [])]


def _renewed(line: str, new: dict[str, str]) -> str:
    key, colon, _ = line.partition(":")
    return f"{key}: {new.pop(key.strip())}" if colon and key.strip() in new else line


def save_kitti_camera(path: Path, before: Camera, after: Camera) -> list[Path]:
    """Fold a change of pose into ``Tr_velo_to_cam`` of a KITTI or View-of-Delft calibration; other lines stay.

    ``camera_T_lidar = B R0 Tr`` with B and R0 as they are, so ``Tr`` becomes ``Tr before^-1 after``.

    Raises:
        FileFormatError: If the file has no ``Tr_velo_to_cam``.
    """
    matrices: Mapping[str, np.ndarray] = read_calib(path)
    name = next((each for each in ("Tr_velo_to_cam", "Tr_velo_cam") if each in matrices), None)
    if name is None:
        raise FileFormatError(path, where="the file", expected="Tr_velo_to_cam", found=", ".join(matrices))
    old = np.vstack([matrices[name], [0.0, 0.0, 0.0, 1.0]])
    new = old @ invert(before.camera_T_lidar) @ after.camera_T_lidar
    text = read_bytes(path, max_bytes=_MAX_BYTES).decode("utf-8")
    row = f"{name}: " + " ".join(f"{value:.12e}" for value in new[:3].ravel())
    lines = [row if line.replace(":", " ").split()[:1] == [name] else line for line in text.splitlines()]
    copy = replace_text(path, "\n".join(lines) + "\n")
    return [path, *([copy] if copy is not None else [])]


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
        raise FileFormatError(path, where="its name", expected=".txt, .yml or .json", found=path.suffix or "none")
    cameras = dict(read_calibration(path)) if path.exists() else {}
    copy = keep_copy(path)
    write_calibration(path, cameras | {name: after})
    return [path, *([copy] if copy is not None else [])]
