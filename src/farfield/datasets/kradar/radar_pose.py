"""Where K-Radar's radar stands: the text file, the yaw that it has no place for, and single frames' own files.

Three places, the later ones count more:

1. ``<sequence>/info_calib/calib_radar_lidar.txt``: frame difference, x and y (:mod:`farfield.datasets.kradar.texts`);
2. ``calib_radar_lidar.farfield.json`` beside it: yaw, time offset and sigma, as ``farfield calibrate`` writes them;
3. ``<sequence>/info_matching/<radar>_<lidar>.txt``: x, y and yaw of one frame, as the development kit writes them.

The second os1-128, of which no file of the release tells, has ``info_calib/calib_os2_os1.farfield.json``.
"""

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from farfield.datasets.kradar.index import FileIndex
from farfield.datasets.kradar.texts import numbers_of, read_radar_calibration
from farfield.errors import FileFormatError, plain
from farfield.files.atomic import read_bytes
from farfield.files.json_text import plain_json
from farfield.geometry.poses import invert, pose_from_yaw, unrigid
from farfield.vocabulary.kradar import KRADAR_ORIGIN_M

RADAR_FILE = "calib_radar_lidar.txt"
SIDE_FILE = "calib_radar_lidar.farfield.json"
LIDARS_FILE = "calib_os2_os1.farfield.json"
_MAX_BYTES = 1 << 20
_ROUNDED_M = 1e-3
_SUM = 0.0021  # of three numbers with three decimals


@dataclass(frozen=True, kw_only=True)
class InfoMatching:
    """One frame's ``info_matching`` of K-Radar's development kit.

    Args:
        names: File names of radar, LiDAR and camera.
        base: x and y in metres and yaw in degrees before.
        offset: What was added to them.
    """

    names: tuple[str, str, str]
    base: tuple[float, float, float]
    offset: tuple[float, float, float]

    @property
    def total(self) -> tuple[float, float, float]:
        """X and y in metres and yaw in degrees: what counts."""
        x, y, yaw = (a + b for a, b in zip(self.base, self.offset, strict=True))
        return x, y, yaw

    @property
    def os2_T_radar(self) -> Float[np.ndarray, "4 4"]:
        """Pose of the radar in the os2-64's frame."""
        x_m, y_m, yaw_deg = self.total
        return os2_T_radar_from(x_m, y_m, float(np.radians(yaw_deg)))

    def text(self) -> str:
        """The file: names, then total, base and offset; no line end after the last."""
        rows = [", ".join(f"{value:+.3f}" for value in row) for row in (self.total, self.base, self.offset)]
        return "\n".join([", ".join(self.names), *rows])


def os2_T_radar_from(x_m: float, y_m: float, yaw_rad: float) -> Float[np.ndarray, "4 4"]:
    """Pose of the radar from the files' numbers: ``p_radar = R(yaw) p_lidar + (x, y, 0.7)``."""
    return invert(pose_from_yaw(yaw_rad, (x_m, y_m, -KRADAR_ORIGIN_M[2])))


def matching_path(sequence: str, stem: str) -> Path:
    """A frame's file, relative to the root."""
    return Path(sequence, "info_matching", f"{stem}.txt")


def read_matching(path: Path) -> InfoMatching:
    """Read ``info_matching/<radar>_<lidar>.txt``.

    Raises:
        FileFormatError: If it is not a line of three names and three lines of three numbers, or they do not add up.
    """
    lines = read_bytes(path, max_bytes=_MAX_BYTES).decode("utf-8", errors="replace").splitlines()
    names = [name.strip() for name in lines[0].split(",")] if lines else []
    rows = [numbers_of(line.split(",")) for line in lines[1:4]]
    if len(names) != 3 or len(rows) != 3 or any(row is None or len(row) != 3 for row in rows):
        expected = "three names, three lines of three numbers"
        raise FileFormatError(path, where="the file", expected=expected, got=str(lines[:4])[:120])
    total, base, offset = (np.array(row, dtype=np.float64) for row in rows)
    if np.abs(base + offset - total).max() > _SUM:
        raise FileFormatError(path, where="line 2", expected=f"the sum {base + offset}", got=f"{total}")
    a, b = ((float(row[0]), float(row[1]), float(row[2])) for row in (base, offset))
    return InfoMatching(names=(names[0], names[1], names[2]), base=a, offset=b)


def read_side_file(path: Path) -> dict[str, Any]:
    """Read the side file of ``calib_radar_lidar.txt``.

    Raises:
        FileFormatError: If it is damaged, or says another x or y than the text file beside it.
    """
    try:
        content = plain_json(read_bytes(path, max_bytes=_MAX_BYTES))
        matrix = np.array(content["radar_T_lidar"], dtype=np.float64).reshape(4, 4)
        yaw = float(content["yaw_rad"])
        fault = unrigid(matrix) if np.isfinite(yaw) else "a yaw that is not finite"
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise FileFormatError(path, where="the file", expected="radar_T_lidar, yaw_rad", got=plain(error)) from error
    if fault:
        raise FileFormatError(path, where="radar_T_lidar, yaw_rad", expected="a rigid motion", got=fault)
    text = path.with_name(RADAR_FILE)
    if text.exists():
        _, x, y = read_radar_calibration(text)
        if max(abs(matrix[0, 3] + x), abs(matrix[1, 3] + y)) > _ROUNDED_M:
            actual = f"{matrix[0, 3]:.4f}, {matrix[1, 3]:.4f} against {-x:.4f}, {-y:.4f}"
            fix = "The text file counts: delete the side file or calibrate anew."
            raise FileFormatError(path, where="x, y", expected=f"those of {text.name}", got=actual, fix=fix)
    return dict(content, radar_T_lidar=matrix, yaw_rad=yaw)


def sequence_yaw_rad(files: FileIndex, sequence: str) -> float:
    """The yaw that a sequence's side file gives; 0 where there is none.

    A side file that is damaged or says another x or y than the text file is left out, with a warning.
    """
    path = files.find(Path(sequence, "info_calib", SIDE_FILE))
    if path is None:
        return 0.0
    try:
        return float(read_side_file(path)["yaw_rad"])
    except FileFormatError as error:
        warnings.warn(f"left out, yaw is 0: {error}", stacklevel=2)
        return 0.0


def read_os2_T_os1(files: FileIndex, sequence: str) -> Float[np.ndarray, "4 4"] | None:
    """Where the os1-128 stands in the os2-64's frame, as ``farfield calibrate lidar-lidar`` wrote it; or None.

    Raises:
        FileFormatError: If the file holds no rigid motion.
    """
    path = files.find(Path(sequence, "info_calib", LIDARS_FILE))
    if path is None:
        return None
    try:
        content = plain_json(read_bytes(path, max_bytes=_MAX_BYTES))
        matrix = np.array(content["os2_T_os1"], dtype=np.float64).reshape(4, 4)
        if fault := unrigid(matrix):
            raise ValueError(fault)
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise FileFormatError(path, where="os2_T_os1", expected="a rigid motion", got=plain(error)) from error
    return matrix
