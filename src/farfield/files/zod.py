"""Files of a single frame of the Zenseact Open Dataset: JSON of its calibration, motion and objects.

After the authors' development kit (https://github.com/zenseact/zod, MIT).
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int64

from farfield.errors import FileFormatError, plain
from farfield.files.atomic import read_bytes
from farfield.files.cuboids import FARTHEST_M, check_turns, is_name, numbers
from farfield.files.json_text import finite, json_at, read_json
from farfield.files.limits import MAX_NAME

_JSON_BYTES = 1 << 26
_EPOCH_S, _MOST_POSES, _LARGEST_M = (1e9, 4e9), 1_000_000, 1e3
_TIME = re.compile(r"(?:^|_)(\d{4})-(\d\d)-(\d\d)T(\d\d)[:_-](\d\d)[:_-](\d\d)[._](\d{1,6})Z?\Z")
_TRAINVAL_BYTES, _WINDOW, _RECORD, _MOST_FRAMES = 1 << 29, 1 << 22, 1 << 18, 1_000_000
_LIST = re.compile(r'\s*(,?)\s*"(\w{1,40})"\s*:\s*\[')
_NEXT = re.compile(r"\s*(,?)\s*")
_INCONCLUSIVE = "Inconclusive"
_SIZES = ("size_3d_length", "size_3d_width", "size_3d_height")
_TURN = tuple(f"orientation_3d_q{axis}" for axis in "xyzw")
_FLAGS = {True: 1, "True": 1, False: 0, "False": 0, None: -1}


@dataclass(frozen=True)
class ZodCalibration:
    """Where the LiDAR and the front camera stand in the car.

    Args:
        ego_T_lidar: Of the LiDAR, whose y looks forward.
        ego_T_camera: Of the camera.
        lens: The camera's other entries as they stand in the file: a fisheye lens after Kannala and Brandt.
    """

    ego_T_lidar: Float[np.ndarray, "4 4"]
    ego_T_camera: Float[np.ndarray, "4 4"]
    lens: Mapping[str, Any]


@dataclass(frozen=True)
class ZodObject:
    """An annotated object.

    Args:
        name: Its class, and behind a ``_`` its type where it has one.
        uuid: Its name in the file.
        image_px: Left, top, right and bottom end in the picture.
        centre_m: Of its box, in the LiDAR's coordinates; None where it has no box.
        size_m: Length, width, height.
        quaternion_xyzw: The box's turn.
        unclear: Whether the annotators were not sure of it.
        occlusion: In words, empty where it is not told.
        with_rider: 1 yes, 0 no, -1 not told.
    """

    name: str
    uuid: str
    image_px: tuple[float, ...]
    centre_m: tuple[float, ...] | None
    size_m: tuple[float, ...]
    quaternion_xyzw: tuple[float, ...]
    unclear: bool
    occlusion: str
    with_rider: int


def time_of_name(path: Path) -> int | None:
    """The time at the end of a file's name in nanoseconds since 1970; None where there is none.

    >>> time_of_name(Path("000000_quebec_2022-02-14T13:23:32.251875Z.npy"))
    1644845012251875000
    """
    match = _TIME.search(path.stem)
    if match is None:
        return None
    *fields, fraction = match.groups()
    try:
        year, month, day, hour, minute, second = (int(field) for field in fields)
        moment = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
    except ValueError:
        return None
    return int(moment.timestamp()) * 10**9 + int(fraction.ljust(6, "0")) * 1000


def read_calibration(path: Path) -> ZodCalibration:
    """A frame's calibration.

    Raises:
        FileFormatError: If the file holds anything else.
    """
    content = read_json(path, max_bytes=_JSON_BYTES)
    camera = content.get("FC") if isinstance(content, dict) else None
    if not isinstance(camera, dict):
        raise FileFormatError(path, where="FC", expected="the front camera's calibration", got=repr(content)[:80])
    lidar, own = (_matrix(camera.get(name), path, f"FC.{name}") for name in ("lidar_extrinsics", "extrinsics"))
    lens = {name: value for name, value in camera.items() if not name.endswith("extrinsics")}
    return ZodCalibration(lidar, own, lens)


def read_motion(path: Path) -> tuple[Int64[np.ndarray, " n"], Float[np.ndarray, "n 4 4"]]:
    """Times in nanoseconds since 1970, rising, and the car's pose at each.

    Raises:
        FileFormatError: If the file holds anything else.
    """
    content = read_json(path, max_bytes=_JSON_BYTES)
    poses, stamps = (content.get(name) if isinstance(content, dict) else None for name in ("poses", "timestamps"))
    if not isinstance(poses, list) or not isinstance(stamps, list) or not 2 <= len(poses) == len(stamps) <= _MOST_POSES:
        raise FileFormatError(path, where="poses", expected="two or more, with a time each", got=repr(poses)[:80])
    times = [finite(stamp, limit=1e12) for stamp in stamps]
    seconds = [time for time in times if time is not None and _EPOCH_S[0] <= time <= _EPOCH_S[1]]
    times_ns = np.array([round(time * 1e6) * 1000 for time in seconds], dtype=np.int64)
    if len(seconds) != len(times) or (np.diff(times_ns) <= 0).any():
        got = repr(stamps)[:80]
        raise FileFormatError(path, where="timestamps", expected="rising seconds since 1970", got=got)
    matrices = [_matrix(pose, path, f"poses[{number}]") for number, pose in enumerate(poses)]
    return times_ns, np.stack(matrices)


def read_words(path: Path) -> dict[str, str]:
    """The entries of a file of facts that are texts.

    Raises:
        FileFormatError: If it is no JSON object.
    """
    content = read_json(path, max_bytes=_JSON_BYTES)
    if not isinstance(content, dict):
        raise FileFormatError(path, where="the file", expected="a JSON object", got=type(content).__name__)
    return {key: word for key, word in content.items() if isinstance(word, str) and is_name(word) and len(word) < 200}


def sweeps_listed(path: Path) -> list[str]:
    """File names of a frame's sweeps in the order of ``info.json``; empty where that does not list them.

    Raises:
        FileFormatError: If it is no JSON object.
    """
    content = read_json(path, max_bytes=_JSON_BYTES)
    if not isinstance(content, dict):
        raise FileFormatError(path, where="the file", expected="a JSON object", got=type(content).__name__)
    by_lidar = content.get("lidar_frames", content.get("lidarFrames"))
    listed = next(iter(by_lidar.values()), None) if isinstance(by_lidar, dict) and len(by_lidar) == 1 else None
    paths = [entry.get("filepath") for entry in listed if isinstance(entry, dict)] if isinstance(listed, list) else []
    return [Path(name).name for name in paths if isinstance(name, str)]


def read_objects(path: Path) -> list[ZodObject]:
    """The annotated objects of a frame.

    Raises:
        FileFormatError: If the file holds anything but a list of features.
    """
    content = read_json(path, max_bytes=_JSON_BYTES)
    if not isinstance(content, list):
        raise FileFormatError(path, where="the file", expected="a list of features", got=repr(content)[:80])
    return [_object(entry, path, f"object {number}") for number, entry in enumerate(content)]


def read_identities(path: Path) -> list[str]:
    """The frames of a part of a split, one a line.

    Raises:
        FileFormatError: If a line is no number.
    """
    lines = read_bytes(path, max_bytes=1 << 24).decode("ascii", errors="replace").split()
    odd = next((line for line in lines if not line.isdigit() or len(line) > 6), None)
    if odd is not None:
        raise FileFormatError(path, where="a line", expected="the number of a frame", got=repr(odd)[:40])
    return [line.zfill(6) for line in lines]


def read_trainval(path: Path) -> dict[str, list[str]]:
    """The frames of each part by ``trainval-frames-full.json``, whose parts are ``train``, ``val``, ``blacklisted``.

    The file of the whole set has some hundred megabytes, so its records are read one by one.

    Raises:
        FileFormatError: If it is anything but an object of lists of records with an ``id``.
    """
    try:
        text = read_bytes(path, max_bytes=_TRAINVAL_BYTES).decode("utf-8-sig")
        return _parts_of(text)
    except ValueError as error:  # also of Unicode and JSON
        expected = 'lists of records, {"train": [{"id": "000000", ...}, ...], "val": [...]}'
        raise FileFormatError(path, where="the file", expected=expected, got=plain(error)[:120]) from error


def _parts_of(text: str) -> dict[str, list[str]]:
    parts: dict[str, list[str]] = {}
    start = re.match(r"\s*\{", text)
    if start is None:
        raise ValueError(f"{text[:40]!r} at the start")
    at = start.end()
    while (head := _LIST.match(text, at)) is not None and bool(head.group(1)) == bool(parts):
        name, at = head.group(2), head.end()
        if name in parts:
            raise ValueError(f"the part {name} twice")
        parts[name], at = _identities_at(text, at)
    if text[at:].strip() != "}":
        raise ValueError(f"{text[at : at + 40]!r} behind {len(parts)} lists")
    return parts


def _identities_at(text: str, at: int) -> tuple[list[str], int]:
    """The numbers of a list's records, and where it ends; a record is decoded from a window of the text alone."""
    names: list[str] = []
    window, start = "", at
    while True:
        if at - start + _RECORD > len(window) and start + len(window) < len(text):
            window, start = text[at : at + _WINDOW], at
        gap = _NEXT.match(window, at - start)
        inside = at - start if gap is None else gap.end()
        comma = gap is not None and bool(gap.group(1))
        if not comma and window.startswith("]", inside):
            return names, start + inside + 1
        if comma != bool(names) or len(names) == _MOST_FRAMES:
            raise ValueError(f"{window[inside : inside + 40]!r} behind {len(names)} records")
        record, inside = json_at(window, inside)
        at = start + inside
        name = record.get("id") if isinstance(record, dict) else None
        if not isinstance(name, str) or not (name.isascii() and name.isdigit()) or len(name) > 6:
            raise ValueError(f"{name!r} as the number of a frame")
        names.append(name.zfill(6))


def _matrix(value: Any, path: Path, where: str) -> Float[np.ndarray, "4 4"]:
    if not isinstance(value, list) or len(value) != 4:
        raise FileFormatError(path, where=where, expected="4 rows", got=repr(value)[:80])
    matrix = np.array([numbers(row, 4, path, where, "4 numbers a row") for row in value])
    turn = matrix[:3, :3]
    rigid = np.allclose(turn @ turn.T, np.eye(3), atol=1e-3) and np.linalg.det(turn) > 0
    if not rigid or matrix[3].tolist() != [0, 0, 0, 1] or np.abs(matrix[:3, 3]).max() > FARTHEST_M:
        raise FileFormatError(path, where=where, expected="a rotation and a place", got=repr(value)[:120])
    return matrix


def _object(entry: Any, path: Path, where: str) -> ZodObject:
    facts = entry.get("properties") if isinstance(entry, dict) else None
    shape = entry.get("geometry") if isinstance(entry, dict) else None
    if not isinstance(facts, dict) or not isinstance(shape, dict):
        raise FileFormatError(path, where=where, expected="geometry and properties", got=repr(entry)[:80])
    label, kind = facts.get("class"), facts.get("type", facts.get("object_type"))
    uuid = facts.get("annotation_uuid", "")
    words = [label, *([] if kind is None else [kind])]
    if not all(is_name(word) and len(word) <= MAX_NAME // 2 for word in words) or not isinstance(uuid, str):
        raise FileFormatError(path, where=where, expected="a class, a type and a uuid", got=repr(facts)[:120])
    occlusion = facts.get("occlusion_ratio")
    unclear, rider = (_FLAGS.get(_plain(facts.get(name))) for name in ("unclear", "with_rider"))
    if unclear is None or rider is None:
        got = repr({name: facts.get(name) for name in ("unclear", "with_rider")})[:120]
        raise FileFormatError(path, where=where, expected="True, False or nothing", got=got)
    placed = facts.get("location_3d") is not None
    centre, size, turn = _box(facts, path, where) if placed else (None, (), ())
    return ZodObject(
        name=str(label) if kind is None or kind == label else f"{label}_{kind}",
        uuid=uuid[:MAX_NAME],
        image_px=_extent(shape.get("coordinates"), path, where),
        centre_m=centre,
        size_m=size,
        quaternion_xyzw=turn,
        unclear=unclear == 1 or _INCONCLUSIVE in words,
        occlusion=occlusion[:MAX_NAME] if isinstance(occlusion, str) else "",
        with_rider=rider,
    )


def _plain(value: Any) -> Any:
    return value if value is None or isinstance(value, bool | str) else "neither"


def _extent(points: Any, path: Path, where: str) -> tuple[float, ...]:
    """Left, top, right and bottom end of some points of a picture."""
    listed: Sequence[Any] = points if isinstance(points, list) else []
    pixels = np.array([numbers(point, 2, path, where, "a point of the picture") for point in listed[:10_000]])
    if not len(pixels):
        raise FileFormatError(path, where=where, expected="points of the picture", got=repr(points)[:80])
    return (*pixels.min(axis=0).tolist(), *pixels.max(axis=0).tolist())


def _box(
    facts: Mapping[str, Any], path: Path, where: str
) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
    location = facts["location_3d"]
    coordinates = location.get("coordinates") if isinstance(location, dict) else None
    centre = numbers(coordinates, 3, path, f"{where}, location_3d", "x, y, z")
    size = numbers([facts.get(name) for name in _SIZES], 3, path, f"{where}, size_3d", "length, width, height")
    turn = numbers([facts.get(name) for name in _TURN], 4, path, f"{where}, orientation_3d", "x, y, z, w")
    if max(map(abs, centre)) > FARTHEST_M or not 0 < min(size) <= max(size) <= _LARGEST_M:
        expected = "a place and positive sizes in metres"
        raise FileFormatError(path, where=where, expected=expected, got=f"{centre}, {size}")
    check_turns(np.array([turn]), path, where)
    return tuple(centre), tuple(size), tuple(turn)
