"""Camera calibrations in a small file of our own, JSON or YAML.

One camera, or several under ``cameras``::

    cameras:
      camera:
        matrix: [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]     # pixels
        distortion: [k1, k2, p1, p2, k3]                  # optional, Brown-Conrady in OpenCV's order
        camera_T_lidar: [[...], [...], [...], [0, 0, 0, 1]]
        width: 1920
        height: 650

Files of ROS (camera_info), OpenCV (FileStorage) and Kalibr (camchain) are read for what they hold, see
:mod:`farfield.datasets.foreign_calibration`: intrinsics mostly, without which place a camera cannot be drawn into.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from farfield.datasets.foreign_calibration import ForeignCamera, check_matrix, foreign_cameras, parse_calibration
from farfield.errors import FileFormatError, plain
from farfield.files.atomic import read_bytes, write_text
from farfield.files.yaml_text import MAX_BYTES
from farfield.geometry.cameras import Camera
from farfield.geometry.poses import invert

CALIBRATION_NAMES = ("calibration.yaml", "calibration.yml", "calibration.json")

_Row3 = tuple[float, float, float]
_Row4 = tuple[float, float, float, float]


class _CameraEntry(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    matrix: tuple[_Row3, _Row3, _Row3]
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    camera_T_lidar: tuple[_Row4, _Row4, _Row4, _Row4]
    width: int = Field(0, ge=0)
    height: int = Field(0, ge=0)


class _CalibrationFile(BaseModel):
    model_config = ConfigDict(extra="forbid")

    cameras: dict[str, _CameraEntry]


@dataclass(frozen=True, eq=False, kw_only=True)
class CalibrationFile:
    """What a calibration file holds.

    Args:
        cameras: Cameras by name whose place against the LiDAR is known.
        intrinsics: Those whose place is not, with that of a camera at the LiDAR that looks ahead.
        form: Whose form the file has; empty for our own.
    """

    cameras: Mapping[str, Camera]
    intrinsics: Mapping[str, Camera]
    form: str = ""


def read_calibration_file(path: Path | str, *, inverse: bool = False) -> CalibrationFile:
    """Read cameras and intrinsics by name; a file with one unnamed camera gives ``"camera"``.

    Args:
        path: JSON or YAML file.
        inverse: The file's 4 x 4 matrices map the camera to the lidar.

    Raises:
        FileFormatError: If the file is no such calibration or a rotation is not orthonormal.
    """
    try:
        content = parse_calibration(read_bytes(path, max_bytes=MAX_BYTES).decode("utf-8"))  # JSON is YAML
        foreign = foreign_cameras(content)
    except (yaml.YAMLError, ValueError, TypeError) as error:
        raise FileFormatError(path, where="the file", expected="a calibration", got=plain(error), fix=_FIX) from error
    if foreign is None:
        return CalibrationFile(cameras=_own_cameras(path, content, inverse), intrinsics={})
    entries = {name: _foreign(path, name, camera, inverse) for name, camera in foreign.items()}
    placed = {name for name, camera in foreign.items() if camera.camera_T_lidar is not None}
    return CalibrationFile(
        cameras={name: entry for name, entry in entries.items() if name in placed},
        intrinsics={name: entry for name, entry in entries.items() if name not in placed},
        form=next(iter(foreign.values())).form,
    )


def read_calibration(path: Path | str, *, inverse: bool = False) -> dict[str, Camera]:
    """Read cameras by name, as :func:`read_calibration_file`, where the place of each is known.

    Raises:
        FileFormatError: Also if the file holds intrinsics alone.
    """
    content = read_calibration_file(path, inverse=inverse)
    if not content.cameras and content.intrinsics:
        raise FileFormatError(
            path, where="the file", expected="camera_T_lidar", got=f"intrinsics alone ({content.form})", fix=_PLACE
        )
    return dict(content.cameras)


def read_intrinsics(path: Path | str) -> dict[str, Camera]:
    """Read the intrinsics of all cameras of a file, those without a place too.

    Raises:
        FileFormatError: As of :func:`read_calibration_file`.
    """
    content = read_calibration_file(path)
    return {**content.intrinsics, **content.cameras}


def usable_cameras(path: Path | None, *, inverse: bool = False) -> tuple[dict[str, Camera], tuple[str, ...]]:
    """The cameras of a data set's calibration, and what is to be said where the file gives less than it should.

    Clouds and pictures need no calibration: a file that cannot be used keeps nothing but the cameras away.

    Args:
        path: The file, or None.
        inverse: As of :func:`read_calibration_file`.

    Returns:
        Cameras by name, and sentences.
    """
    if path is None:
        return {}, ()
    try:
        content = read_calibration_file(path, inverse=inverse)
    except (FileFormatError, OSError) as error:
        return {}, (f"no camera is calibrated, for the calibration cannot be used: {error}",)
    if not content.intrinsics:
        return dict(content.cameras), ()
    names = ", ".join(content.intrinsics)
    return dict(content.cameras), (
        f"{path}: {content.form} holds the intrinsics of {names}, and not where it stands: nothing is drawn into its "
        f"pictures. {_PLACE}",
    )


_PLACE = (
    "Add camera_T_lidar (4 x 4) to the file, or find it: farfield calibrate lidar-camera FOLDER --intrinsics FILE "
    "--position X Y Z, or with --pairs."
)


def _foreign(path: Path | str, name: str, camera: ForeignCamera, inverse: bool) -> Camera:
    lens = Camera(
        matrix=camera.matrix, distortion=camera.distortion, width_px=camera.width_px, height_px=camera.height_px
    )
    if camera.camera_T_lidar is None:
        return lens
    _check_rotation(path, name, camera.camera_T_lidar)
    return replace(lens, camera_T_lidar=invert(camera.camera_T_lidar) if inverse else camera.camera_T_lidar)


def _own_cameras(path: Path | str, content: Any, inverse: bool) -> dict[str, Camera]:
    try:
        if isinstance(content, dict) and "cameras" not in content:
            content = {"cameras": {"camera": content}}
        entries = _CalibrationFile.model_validate(content).cameras
    except ValidationError as error:
        raise FileFormatError(path, where="keys", expected="cameras", got=plain(error), fix=_FIX) from error
    return {name: _camera(path, name, entry, inverse) for name, entry in entries.items()}


_FIX = "Give matrix (3 x 3), camera_T_lidar (4 x 4), and optionally distortion (5), width, height."


def _camera(path: Path | str, name: str, entry: _CameraEntry, inverse: bool) -> Camera:
    matrix, motion = np.array(entry.matrix), np.array(entry.camera_T_lidar)
    try:
        check_matrix(matrix)
    except ValueError as error:
        raise FileFormatError(path, where=f"cameras.{name}", expected="a camera", got=str(error), fix=_FIX) from error
    _check_rotation(path, name, motion)
    return Camera(
        matrix=matrix,
        distortion=np.array(entry.distortion),
        camera_T_lidar=invert(motion) if inverse else motion,
        width_px=entry.width,
        height_px=entry.height,
    )


def _check_rotation(path: Path | str, name: str, motion: Float[np.ndarray, "4 4"]) -> None:
    if motion[3].tolist() != [0, 0, 0, 1]:
        got, fix = " ".join(f"{value:g}" for value in motion[3]), "A transposed matrix looks so: write its rows."
        raise FileFormatError(
            path, where=f"cameras.{name}.camera_T_lidar", expected="0 0 0 1 as the last row", got=got, fix=fix
        )
    with np.errstate(over="ignore", invalid="ignore"):  # numbers of 1e300 are no rotation either
        error = float(np.abs(motion[:3, :3] @ motion[:3, :3].T - np.eye(3)).max())
    if not error < 1e-3 or np.linalg.det(motion[:3, :3]) < 0:
        raise FileFormatError(
            path,
            where=f"cameras.{name}.camera_T_lidar",
            expected="a rotation (orthonormal rows, determinant 1)",
            got=f"rows off by {error:.3g}",
            fix="Hand-tuned matrices distort the picture: calibrate anew or orthonormalise.",
        )


def write_calibration(path: Path | str, cameras: Mapping[str, Camera]) -> None:
    """Write cameras by name as JSON, whole or not at all."""
    entries = {
        name: {
            "matrix": camera.matrix.tolist(),
            "distortion": camera.distortion.tolist(),
            "camera_T_lidar": camera.camera_T_lidar.tolist(),
            "width": camera.width_px,
            "height": camera.height_px,
        }
        for name, camera in sorted(cameras.items())
    }
    write_text(path, json.dumps({"cameras": entries}, indent=1) + "\n")
