"""KITTI raw: calibration and GPS/IMU records (Geiger et al.: "Vision meets Robotics: The KITTI Dataset", IJRR 2013)."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float

from farfield.errors import FileFormatError
from farfield.files.atomic import read_bytes

_TEXT_BYTES = 1 << 20
_RECORD = 30
_WORDS = ("calib_time",)

Matrices = Mapping[str, Float[np.ndarray, " n"]]


def read_raw_calib(path: Path | str) -> dict[str, Float[np.ndarray, " n"]]:
    """The numbers of ``calib_*.txt`` by name, such as ``R``, ``T``, ``P_rect_02``; the date is left out.

    Raises:
        FileFormatError: If a line is not ``NAME: numbers``, or a name comes twice.
    """
    found: dict[str, np.ndarray] = {}
    text = read_bytes(path, max_bytes=_TEXT_BYTES).decode("ascii", errors="replace")
    for number, line in enumerate(text.splitlines(), start=1):
        name, colon, rest = line.partition(":")
        if not line.strip() or name in _WORDS:
            continue
        if not colon or name in found:
            raise FileFormatError(path, where=f"line {number}", expected="NAME: numbers, once", found=repr(line[:60]))
        found[name] = _numbers(rest, path, number)
    if not found:
        raise FileFormatError(path, where="line 1", expected="NAME: numbers", found="no such line")
    return found


def _numbers(text: str, path: Path | str, line: int) -> Float[np.ndarray, " n"]:
    try:
        values = np.array([float(word) for word in text.split()], dtype=np.float64)
    except ValueError:
        values = np.array([np.nan])
    if not len(values) or not np.isfinite(values).all():
        raise FileFormatError(path, where=f"line {line}", expected="finite numbers", found=repr(text[:60]))
    return values


def rigid(calib: Matrices, path: Path | str) -> Float[np.ndarray, "4 4"]:
    """The motion of ``R`` and ``T``.

    Raises:
        FileFormatError: If it is none.
    """
    return _motion(_shaped(calib, "R", (3, 3), path), _shaped(calib, "T", (3,), path), path)


def _motion(rotation: np.ndarray, place: np.ndarray, path: Path | str) -> Float[np.ndarray, "4 4"]:
    if not 0.9 < float(np.linalg.det(rotation)) < 1.1:
        raise FileFormatError(path, where="R", expected="a rotation", found=repr(rotation.tolist())[:120])
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, place
    return matrix


def rectified(calib: Matrices, camera: str, path: Path | str) -> tuple[np.ndarray, np.ndarray, tuple[int, int]]:
    """A rectified camera: its matrix (3, 3), its pose in the first camera's own coordinates (4, 4), width and height.

    Args:
        calib: ``calib_cam_to_cam.txt``.
        camera: ``"00"`` to ``"03"``.
        path: The file, for messages.

    Raises:
        FileFormatError: If something is missing.
    """
    projection = _shaped(calib, f"P_rect_{camera}", (3, 4), path)
    pose = _motion(_shaped(calib, "R_rect_00", (3, 3), path), np.zeros(3), path)
    pose[:3, 3] = np.linalg.solve(projection[:, :3], projection[:, 3])
    width, height = _shaped(calib, f"S_rect_{camera}", (2,), path).astype(np.int64).tolist()
    return projection[:, :3].copy(), pose, (width, height)


def _shaped(calib: Matrices, name: str, shape: tuple[int, ...], path: Path | str) -> np.ndarray:
    values = calib.get(name)
    if values is None or values.size != np.prod(shape):
        found = "nothing" if values is None else f"{values.size} numbers"
        raise FileFormatError(path, where=name, expected=f"{int(np.prod(shape))} numbers", found=found)
    return values.reshape(shape)


def read_record(path: Path | str) -> Float[np.ndarray, " 30"]:
    """A record of ``oxts/data``: latitude, longitude (degrees), altitude (m), roll, pitch, yaw (radians), and more.

    Raises:
        FileFormatError: If the file is no such record.
    """
    values = _numbers(read_bytes(path, max_bytes=_TEXT_BYTES).decode("ascii", errors="replace"), path, 1)
    if len(values) != _RECORD or abs(values[0]) >= 90 or abs(values[1]) > 180:
        found = f"{len(values)} numbers"
        raise FileFormatError(path, where="line 1", expected=f"{_RECORD} numbers, degrees first", found=found)
    return values
