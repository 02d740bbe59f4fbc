"""The text files of Astyx HiRes2019: points with a header line, sensors' poses and boxes in JSON."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from farfield.errors import FileFormatError
from farfield.files.ascii_table import parse_table
from farfield.files.atomic import read_bytes
from farfield.files.cuboids import FARTHEST_M, check_turns, is_name, numbers
from farfield.files.json_text import parse_json
from farfield.files.limits import MAX_BYTES, check_name

RADAR_COLUMNS = ("X", "Y", "Z", "V_r", "Mag")
LIDAR_COLUMNS = ("X", "Y", "Z", "Reflectivity", "LaserID", "Timestamp")
_JSON_BYTES = 1 << 24
_UNIT = 1e-3


@dataclass(frozen=True)
class AstyxObject:
    """An annotated object, in the radar's coordinates.

    Args:
        name: Its class.
        centre_m: x, y, z of its centre.
        size_m: Length, width, height.
        quaternion: Its rotation, w first.
        occlusion: 0 none, 1, 2 nearly whole.
        certainty: Of the label, 0 to 2.
    """

    name: str
    centre_m: tuple[float, ...]
    size_m: tuple[float, ...]
    quaternion: tuple[float, ...]
    occlusion: int
    certainty: int


def read_points(path: Path | str, columns: Sequence[str]) -> list[Float[np.ndarray, " n"]]:
    """The columns of a file of points.

    Args:
        path: The file: perhaps an empty line, a line of names, then numbers between spaces.
        columns: The names that are expected, in their order.

    Raises:
        FileFormatError: If the file has other names, no point, or anything but numbers.
    """
    lines = read_bytes(path, max_bytes=MAX_BYTES).replace(b"\r\n", b"\n").lstrip(b"\n").rstrip()
    head, _, body = lines.partition(b"\n")
    if head.decode("ascii", errors="replace").split() != list(columns):
        actual = repr(head[:80].decode("ascii", errors="replace"))
        raise FileFormatError(path, where="the header", expected=" ".join(columns), got=actual)
    if not body:
        raise FileFormatError(path, where="the points", expected="at least one", got="none")
    table = parse_table(body, dtypes=[np.dtype(np.float64)] * len(columns), separator=None, path=path, line=3)
    for name, column in zip(columns, table, strict=True):
        if not np.isfinite(column).all():
            raise FileFormatError(path, where=f"column {name}", expected="finite numbers", got="others")
    return table


def read_sensors(path: Path | str) -> dict[str, Mapping[str, Float[np.ndarray, "r c"]]]:
    """``T_to_ref_COS``, a pose in the radar's coordinates, shape (4, 4), and a camera's ``K``, (3, 3), by sensor.

    Raises:
        FileFormatError: If the file holds anything else.
    """
    content = parse_json(read_bytes(path, max_bytes=_JSON_BYTES), path, max_bytes=_JSON_BYTES)
    poses: dict[str, Mapping[str, Float[np.ndarray, "r c"]]] = {}
    for number, sensor in enumerate(_listed(content, "sensors", path)):
        where, name, data = f"sensors[{number}]", sensor.get("sensor_uid"), sensor.get("calib_data")
        if not isinstance(name, str) or not isinstance(data, dict):
            raise FileFormatError(path, where=where, expected="sensor_uid and calib_data", got=repr(sensor)[:80])
        matrices = {"T_to_ref_COS": _matrix(data.get("T_to_ref_COS"), 4, path, where)}
        if data.get("K") is not None:
            matrices["K"] = _matrix(data["K"], 3, path, where)
        pose = matrices["T_to_ref_COS"]
        turn, last = pose[:3, :3], pose[3].tolist()
        if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-2) or np.linalg.det(turn) < 0 or last != [0, 0, 0, 1]:
            raise FileFormatError(path, where=where, expected="a rotation and a place", got=repr(pose.tolist())[:120])
        poses[name] = matrices
    return poses


def read_objects(path: Path | str) -> list[AstyxObject]:
    """The annotated objects of a frame.

    Raises:
        FileFormatError: If the file holds anything else.
    """
    content = parse_json(read_bytes(path, max_bytes=_JSON_BYTES), path, max_bytes=_JSON_BYTES)
    return [
        _object(entry, path, f"objects[{number}]") for number, entry in enumerate(_listed(content, "objects", path))
    ]


def _object(entry: Mapping[str, Any], path: Path | str, where: str) -> AstyxObject:
    name = entry.get("classname")
    centre = numbers(entry.get("center3d"), 3, path, f"{where}.center3d", "x, y, z")
    size = numbers(entry.get("dimension3d"), 3, path, f"{where}.dimension3d", "length, width, height")
    turned = numbers(entry.get("orientation_quat"), 4, path, f"{where}.orientation_quat", "w, x, y, z")
    kinds = [entry.get(key, -1) for key in ("occlusion", "label_certainty")]
    sound = is_name(name) and max(map(abs, centre)) <= FARTHEST_M
    if not sound or min(size) <= 0 or abs(np.linalg.norm(turned) - 1) > _UNIT:
        expected = f"a class, a centre within {FARTHEST_M:g} m, a positive size and a unit quaternion"
        raise FileFormatError(path, where=where, expected=expected, got=repr(entry)[:120])
    check_turns(np.array([[*turned[1:], turned[0]]]), path, where)
    if not all(type(kind) is int for kind in kinds):
        raise FileFormatError(path, where=where, expected="whole occlusion and label_certainty", got=repr(kinds)[:80])
    return AstyxObject(check_name(path, where, str(name)), tuple(centre), tuple(size), tuple(turned), *kinds)


def _listed(content: Any, key: str, path: Path | str) -> list[Mapping[str, Any]]:
    entries = content.get(key) if isinstance(content, dict) else None
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise FileFormatError(path, where=key, expected="a list of objects", got=repr(entries)[:80])
    return entries


def _matrix(value: Any, side: int, path: Path | str, where: str) -> Float[np.ndarray, "r c"]:
    if not isinstance(value, list) or len(value) != side:
        raise FileFormatError(path, where=where, expected=f"{side} rows", got=repr(value)[:80])
    return np.array([numbers(row, side, path, where, f"{side} numbers a row") for row in value])
