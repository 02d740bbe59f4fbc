"""Camera calibrations in a small file of our own, JSON or YAML.

One camera, or several under ``cameras``::

    cameras:
      camera:
        matrix: [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]     # pixels
        distortion: [k1, k2, p1, p2, k3]                  # optional, Brown-Conrady in OpenCV's order
        camera_T_lidar: [[...], [...], [...], [0, 0, 0, 1]]
        width: 1920
        height: 650
"""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from farfield.errors import FileFormatError, plain
from farfield.files.atomic import read_bytes, write_text
from farfield.geometry.cameras import Camera
from farfield.geometry.poses import invert

CALIBRATION_NAMES = ("calibration.yaml", "calibration.yml", "calibration.json")
_MAX_BYTES = 1 << 20

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


def read_calibration(path: Path | str, *, inverse: bool = False) -> dict[str, Camera]:
    """Read cameras by name; a file with one unnamed camera gives ``"camera"``.

    Args:
        path: JSON or YAML file.
        inverse: The file's 4 x 4 matrices map the camera to the lidar.

    Raises:
        FileFormatError: If the file is no such calibration or a rotation is not orthonormal.
    """
    try:
        content = yaml.safe_load(read_bytes(path, max_bytes=_MAX_BYTES).decode("utf-8"))  # JSON is YAML
        if isinstance(content, dict) and "cameras" not in content:
            content = {"cameras": {"camera": content}}
        entries = _CalibrationFile.model_validate(content).cameras
    except ValidationError as error:
        raise FileFormatError(path, where="keys", expected="cameras", got=plain(error), fix=_FIX) from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise FileFormatError(path, where="the file", expected="JSON or YAML", got=plain(error)) from error
    return {name: _camera(path, name, entry, inverse) for name, entry in entries.items()}


_FIX = "Give matrix (3 x 3), camera_T_lidar (4 x 4), and optionally distortion (5), width, height."


def _camera(path: Path | str, name: str, entry: _CameraEntry, inverse: bool) -> Camera:
    motion = np.array(entry.camera_T_lidar)
    error = float(np.abs(motion[:3, :3] @ motion[:3, :3].T - np.eye(3)).max())
    if not error < 1e-3 or np.linalg.det(motion[:3, :3]) < 0:
        raise FileFormatError(
            path,
            where=f"cameras.{name}.camera_T_lidar",
            expected="a rotation (orthonormal rows, determinant 1)",
            got=f"rows off by {error:.3g}",
            fix="Hand-tuned matrices distort the picture: calibrate anew or orthonormalise.",
        )
    return Camera(
        matrix=np.array(entry.matrix),
        distortion=np.array(entry.distortion),
        camera_T_lidar=invert(motion) if inverse else motion,
        width_px=entry.width,
        height_px=entry.height,
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
