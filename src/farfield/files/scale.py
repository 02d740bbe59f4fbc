"""Scale's LiDAR tasks: JSON frames as they are uploaded, and the answer, a list of the cuboids of each frame.

By Scale's pages (https://docs.scale.com/reference/data-types-and-the-frame-objects and lidar-callback-format) and by
what its own package writes (scale-lidar-io 1.2.5 of PyPI, Apache 2.0), all in one world, z up::

    {"images": [{"position": {"x", "y", "z"}, "heading": {"w", "x", "y", "z"}, "image_url": "s3://b/image-front-7.jpg",
                 "camera_model": "brown_conrady", "fx": 1000, "fy": 1000, "cx": 960, "cy": 540, "skew": 0, "k1": 0,
                 "timestamp": 1541196976735462000}],
     "points": [{"x": 1, "y": 2, "z": 3, "i": 0.5, "d": 0, "t": 1541196976735462000, "is_ground": true}],
     "device_position": {"x", "y", "z"}, "device_heading": {"w", "x", "y", "z"}, "timestamp": 1541196976735462000}

    [{"cuboids": [{"uuid": "4DBC...", "label": "Car", "position": {"x", "y", "z"}, "dimensions": {"x", "y", "z"},
                   "yaw": 1.63, "stationary": false, "camera_used": 1, "attributes": {"heading": "front"}}]}]

Yaw 0 looks along +y and counts counter-clockwise; y of the dimensions is the length
(https://github.com/scaleapi/pandaset-devkit, the same people's words for the same cuboids). A camera's axes are x
right, y down, z forward.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Literal
from urllib.parse import unquote

import numpy as np
from jaxtyping import Bool, Float, Int64

from farfield.errors import FileFormatError
from farfield.files.cuboids import FARTHEST_M, Cuboid, attributes_of, check_yaw, checked, word, xyz
from farfield.files.json_text import finite, parse_json
from farfield.files.segments_ai import rotation_of

TimeUnit = Literal["ns", "us", "ms", "s"]
PINHOLE = "brown_conrady"
_NS = {"ns": 1, "us": 10**3, "ms": 10**6, "s": 10**9}
_POINTS = re.compile(rb'"points"\s*:\s*\[')
_LATEST_NS = 5 * 10**18
_MOST_NORM_ERROR, _LEAST_UP = 0.01, math.cos(0.5)
_NOT_OURS = ("skew", "k4", "k5", "k6", "lx", "ly", "xi")
_MOST_LENS, _LARGEST_PX, _MOST_PARTS = 1e3, 1e6, 8
_FIELDS = ("camera_used", "distance_to_device", "numberOfPoints", "stationary")


@dataclass(frozen=True, kw_only=True, eq=False)
class ScaleCamera:
    """One image of a frame and the camera that took it.

    Args:
        number: The camera's number: ``camera_index``, or the image's place in the list.
        address: The parts of its address behind the host, file last.
        world_T_camera: Its pose (metres); axes x right, y down, z forward.
        matrix: Intrinsics in pixels.
        distortion: k1, k2, p1, p2, k3.
        unlike: What of its lens no pinhole of Brown and Conrady has, in words; empty where it is one.
        time_ns: When it was taken, nanoseconds; None where that is not said.
    """

    number: int
    address: tuple[str, ...]
    world_T_camera: Float[np.ndarray, "4 4"]
    matrix: Float[np.ndarray, "3 3"]
    distortion: Float[np.ndarray, " 5"]
    unlike: str
    time_ns: int | None


@dataclass(frozen=True, kw_only=True, eq=False)
class ScaleFrame:
    """What a frame's file says beside its points.

    Args:
        world_T_device: The device's pose (metres).
        time_ns: The frame's time, nanoseconds; None where that is not said.
        cameras: Its images in order.
    """

    world_T_device: Float[np.ndarray, "4 4"]
    time_ns: int | None
    cameras: tuple[ScaleCamera, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class ScalePoints:
    """The points of a frame; what no point of it has is None.

    Args:
        world_m: x, y, z in the world (metres), shape (n, 3).
        intensity: As written, shape (n,).
        device: Number of the device that measured each.
        time_ns: When each was measured, nanoseconds.
        ground: Whether each is of the ground; those that say nothing are not.
    """

    world_m: Float[np.ndarray, "n 3"]
    intensity: Float[np.ndarray, " n"] | None
    device: Int64[np.ndarray, " n"] | None
    time_ns: Int64[np.ndarray, " n"] | None
    ground: Bool[np.ndarray, " n"] | None


@dataclass(frozen=True, kw_only=True)
class ScaleOrder:
    """What a task's own JSON says of its frames.

    Args:
        attachments: Names of the frames' files in order.
        metres_per_unit: Metres of one unit of all coordinates; None where that is not said.
    """

    attachments: tuple[str, ...]
    metres_per_unit: float | None


def parse_frame(
    data: bytes, path: Path | str, *, metres_per_unit: float = 1.0, time_unit: TimeUnit = "ns"
) -> ScaleFrame:
    """What a frame's file says beside its points, which are passed over.

    Args:
        data: The file's bytes.
        path: The file, for messages.
        metres_per_unit: Metres of one unit of its coordinates.
        time_unit: Unit of the times of the frame and its images.

    Raises:
        FileFormatError: If it is not of this form, or the device has no pose or does not stand upright.
    """
    frame = _mapping(_without_points(data, path), path, "the root")
    for name in ("device_position", "device_heading"):
        if frame.get(name) is None:
            fix = "Without the device's pose nothing says where the sensor stood in the world."
            raise FileFormatError(path, where="the root", expected=f"the object {name}", got="none", fix=fix)
    pose = _pose(frame["device_position"], frame["device_heading"], metres_per_unit, path, "device")
    if pose[2, 2] < _LEAST_UP:
        expected = "a device whose z points up, within 0.5 rad"
        raise FileFormatError(path, where="device_heading", expected=expected, got=repr(frame["device_heading"])[:120])
    images = frame.get("images")
    if images is not None and not isinstance(images, list):
        raise FileFormatError(path, where="images", expected="a list", got=repr(images)[:80])
    cameras = tuple(
        _camera(_mapping(image, path, f"image {row}"), row, metres_per_unit, time_unit, path)
        for row, image in enumerate(images or [])
    )
    if len({camera.number for camera in cameras}) < len(cameras):
        raise FileFormatError(path, where="images", expected="each camera_index once", got="one twice")
    time_ns = _time_ns(frame.get("timestamp"), time_unit, path, "timestamp")
    return ScaleFrame(world_T_device=pose, time_ns=time_ns, cameras=cameras)


def _without_points(data: bytes, path: Path | str) -> Any:
    """A frame without its points where these are flat, as they have to be; else all of it."""
    if match := _POINTS.search(data):
        end = data.find(b"]", match.end())
        if end > 0:
            try:
                return parse_json(data[: match.end()] + data[end:], path)
            except FileFormatError:
                return parse_json(data, path)
    return parse_json(data, path)


def parse_points(data: bytes, path: Path | str, *, metres_per_unit: float = 1.0) -> ScalePoints:
    """The points of a frame.

    Args:
        data: The file's bytes.
        path: The file, for messages.
        metres_per_unit: Metres of one unit of its coordinates.

    Raises:
        FileFormatError: If it is not of this form, or some points say what others do not (``i``, ``d``, ``t``).
    """
    points = _mapping(parse_json(data, path), path, "the root").get("points")
    if not isinstance(points, list) or not all(isinstance(point, dict) for point in points):
        expected = "a list points of objects with x, y, z"
        raise FileFormatError(path, where="points", expected=expected, got=repr(points)[:80])
    columns = [_column(points, axis, path) for axis in "xyz"]
    if points and any(column is None for column in columns):
        raise FileFormatError(path, where="points", expected="x, y and z of all points", got=repr(points[0])[:80])
    rows = [np.zeros(0) if column is None else np.array(column, dtype=np.float64) for column in columns]
    world_m = np.column_stack(rows) * metres_per_unit
    if len(world_m) and not (np.abs(world_m) <= FARTHEST_M).all():
        row = int(np.argmax(~(np.abs(world_m) <= FARTHEST_M).all(axis=1)))
        expected = "coordinates within 10,000 km"
        raise FileFormatError(path, where=f"point {row}", expected=expected, got=repr(points[row])[:80])
    intensity, device, times = (_column(points, name, path) for name in "idt")
    return ScalePoints(
        world_m=world_m,
        intensity=None if intensity is None else np.array(intensity, dtype=np.float64),
        device=None if device is None else _whole(device, "d", 1 << 31, path),
        time_ns=None if times is None or not any(times) else _whole(times, "t", _LATEST_NS, path),
        ground=_ground(points, path),
    )


def _column(points: Sequence[Mapping[str, Any]], name: str, path: Path | str) -> list[Any] | None:
    """One number a point; None where no point has it. What is ``null`` is not there: tables write it so."""
    values = [point.get(name) for point in points]
    kinds = set(map(type, values))
    if kinds <= {type(None)}:
        return None
    if not kinds <= {int, float}:
        row = next(row for row, value in enumerate(values) if type(value) not in (int, float))
        expected = f"a number as {name} of every point, or of none"
        raise FileFormatError(path, where=f"point {row}", expected=expected, got=repr(values[row])[:80])
    return values


def _whole(values: Sequence[int | float], name: str, beyond: int, path: Path | str) -> Int64[np.ndarray, " n"]:
    """Whole numbers from 0 to below a bound; those with a point, as tables write them, have to be whole."""
    for row, value in enumerate(values):
        if not 0 <= value < beyond or value != int(value):
            expected = f"whole numbers from 0 to below {beyond:g} as {name}"
            raise FileFormatError(path, where=f"point {row}", expected=expected, got=repr(value))
    return np.array([int(value) for value in values], dtype=np.int64)


def _ground(points: Sequence[Mapping[str, Any]], path: Path | str) -> Bool[np.ndarray, " n"] | None:
    flags = [point.get("is_ground") for point in points]
    if all(flag is None for flag in flags):
        return None
    for row, flag in enumerate(flags):
        if flag is not None and not isinstance(flag, bool):
            raise FileFormatError(
                path, where=f"point {row}", expected="true or false as is_ground", got=repr(flag)[:80]
            )
    return np.array([bool(flag) for flag in flags])


def _pose(position: Any, heading: Any, metres_per_unit: float, path: Path | str, what: str) -> Float[np.ndarray, "4 4"]:
    origin = np.array(xyz(position, path, what, "position")) * metres_per_unit
    if np.abs(origin).max() > FARTHEST_M:
        raise FileFormatError(path, where=what, expected="a position within 10,000 km", got=repr(origin.tolist()))
    parts = [finite(heading.get(name)) for name in "wxyz"] if isinstance(heading, Mapping) else [None]
    w, *axis = (math.nan if part is None else part for part in parts)
    norm = math.hypot(w, *axis)
    if not abs(norm - 1) <= _MOST_NORM_ERROR:
        expected = "a heading with w, x, y, z, a quaternion of length 1"
        raise FileFormatError(path, where=what, expected=expected, got=repr(heading)[:120])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation_of(np.array([*axis, w])), origin
    return pose


def _camera(
    image: Mapping[str, Any], row: int, metres_per_unit: float, time_unit: TimeUnit, path: Path | str
) -> ScaleCamera:
    where = f"image {row}"
    number = image.get("camera_index")
    number = row if number is None else number
    if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number < 1000:
        raise FileFormatError(path, where=where, expected="a number below 1000 as camera_index", got=repr(number)[:80])
    address = image.get("image_url")
    if not isinstance(address, str) or not address_parts(address):
        raise FileFormatError(path, where=where, expected="an address as image_url", got=repr(address)[:80])
    lens = {name: finite(image.get(name), limit=_LARGEST_PX) for name in ("fx", "fy", "cx", "cy")}
    fx, fy, cx, cy = (math.nan if value is None else value for value in lens.values())
    if not (fx > 0 and fy > 0 and math.isfinite(cx + cy)):
        expected = "focal lengths above 0 and a middle in pixels as fx, fy, cx, cy"
        raise FileFormatError(path, where=where, expected=expected, got=repr(lens))
    numbers = {name: _lens_number(image, name, path, where) for name in ("k1", "k2", "p1", "p2", "k3", *_NOT_OURS)}
    model, factor = image.get("camera_model"), image.get("scale_factor")
    unlike = [f"{name} {numbers[name]:g}" for name in _NOT_OURS if numbers[name]]
    unlike += [] if model in (None, PINHOLE) else [f"camera_model {word(model, path, where, 'camera_model')}"]
    unlike += [] if factor in (None, 1) else [f"scale_factor {str(factor)[:40]}"]
    return ScaleCamera(
        number=number,
        address=address_parts(address),
        world_T_camera=_pose(image.get("position"), image.get("heading"), metres_per_unit, path, where),
        matrix=np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]),
        distortion=np.array([numbers[name] for name in ("k1", "k2", "p1", "p2", "k3")]),
        unlike=", ".join(unlike),
        time_ns=_time_ns(image.get("timestamp"), time_unit, path, f"{where}, timestamp"),
    )


def _lens_number(image: Mapping[str, Any], name: str, path: Path | str, where: str) -> float:
    value = image.get(name)
    number = 0.0 if value is None else finite(value, limit=_MOST_LENS)
    if number is None:
        raise FileFormatError(path, where=where, expected=f"a number as {name}", got=repr(value)[:80])
    return number


def address_parts(address: str) -> tuple[str, ...]:
    """The last parts of an address' path, without its query, file last.

    >>> address_parts("https://a.com/b/front%201/7.jpg?signature=c/d")
    ('b', 'front 1', '7.jpg')
    """
    bare = unquote(re.split(r"[?#]", address)[0]).replace("\\", "/")
    path = PurePosixPath(re.sub(r"^[A-Za-z][A-Za-z0-9+.-]*://[^/]*", "", bare))
    parts = tuple(part for part in path.parts if part != "/")[-_MOST_PARTS:]
    return () if any(part == ".." or not part.isprintable() for part in parts) else parts


def _time_ns(value: Any, unit: TimeUnit, path: Path | str, where: str) -> int | None:
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value * _NS[unit] < _LATEST_NS:
        fix = "Say its unit: --reader time_unit=s, ms, us or ns."
        raise FileFormatError(path, where=where, expected=f"a time in {unit}", got=repr(value)[:80], fix=fix)
    return value * _NS[unit] if isinstance(value, int) else round(value * _NS[unit])


def parse_answer(data: bytes, path: Path | str) -> tuple[tuple[Mapping[str, Any], ...], ...]:
    """The cuboids of each frame as they stand in a task's answer; :func:`cuboids_of` reads them.

    Raises:
        FileFormatError: If it is not of this form.
    """
    frames = parse_json(data, path)
    if not isinstance(frames, list):
        raise FileFormatError(path, where="the root", expected="a list of frames", got=repr(frames)[:80])
    return tuple(_of_frame(frame, path, f"frame {number}") for number, frame in enumerate(frames))


def _of_frame(frame: Any, path: Path | str, where: str) -> tuple[Mapping[str, Any], ...]:
    entries = _mapping(frame, path, where).get("cuboids")
    if not isinstance(entries, list):
        raise FileFormatError(path, where=where, expected="a list cuboids", got=repr(entries)[:80])
    return tuple(_mapping(entry, path, f"{where}, cuboid {number}") for number, entry in enumerate(entries))


def cuboids_of(
    entries: Sequence[Mapping[str, Any]],
    world_T_device: Float[np.ndarray, "4 4"],
    path: Path | str,
    where: str,
    *,
    metres_per_unit: float = 1.0,
) -> tuple[Cuboid, ...]:
    """A frame's boxes in its device's coordinates; roll and pitch within 0.5 rad are left out.

    Args:
        entries: The frame's cuboids as they are written.
        world_T_device: The device's pose (metres).
        path: The file, for messages.
        where: The frame in it.
        metres_per_unit: Metres of one unit of the file's coordinates.

    Raises:
        FileFormatError: If a cuboid is none, or an object stands twice in the frame.
    """
    cuboids = []
    tracks: set[str] = set()
    for number, entry in enumerate(entries):
        cuboid = _cuboid(entry, world_T_device, metres_per_unit, path, f"{where}, cuboid {number}")
        if cuboid.track and cuboid.track in tracks:
            expected, got = "an object once in a frame", f"uuid {cuboid.track!r} again"
            raise FileFormatError(path, where=f"{where}, cuboid {number}", expected=expected, got=got)
        tracks.add(cuboid.track)
        cuboids.append(cuboid)
    return tuple(cuboids)


def _cuboid(
    entry: Mapping[str, Any],
    world_T_device: Float[np.ndarray, "4 4"],
    metres_per_unit: float,
    path: Path | str,
    where: str,
) -> Cuboid:
    world_m = np.array(xyz(entry.get("position"), path, where, "position")) * metres_per_unit
    width, length, height = (side * metres_per_unit for side in xyz(entry.get("dimensions"), path, where, "dimensions"))
    turns = {name: finite(0 if entry.get(name) is None and name != "yaw" else entry.get(name)) for name in _TURNS}
    yaw, pitch, roll = (math.nan if turn is None else turn for turn in turns.values())
    if not math.isfinite(yaw + pitch + roll):
        expected = "radians as yaw, and as pitch and roll where they are there"
        raise FileFormatError(path, where=where, expected=expected, got=repr(turns)[:80])
    check_yaw(yaw, path, where)
    ahead = np.array([-math.sin(yaw), math.cos(yaw), 0.0]) @ world_T_device[:3, :3]
    label = word(entry.get("label"), path, where, "label")
    if not label.strip():
        raise FileFormatError(path, where=where, expected="a text as label", got=repr(label)[:80])
    uuid = entry.get("uuid")
    centre = (world_m - world_T_device[:3, 3]) @ world_T_device[:3, :3]
    heading = math.atan2(ahead[1], ahead[0])
    named = attributes_of(entry.get("attributes"))
    own = attributes_of({name: entry.get(name) for name in _FIELDS})
    return Cuboid(
        label=label,
        box=checked(centre.tolist(), [length, width, height], heading, path, where, tilt_rad=[roll, pitch]),
        track="" if uuid in (None, "") else word(uuid, path, where, "uuid"),
        attributes={f"attributes.{name}" if name in own else name: value for name, value in named.items()} | own,
    )


_TURNS = ("yaw", "pitch", "roll")


def parse_order(data: bytes, path: Path | str) -> ScaleOrder:
    """What a task's own JSON says of its frames: as it was sent, as Scale's API gives it, or in a callback's ``task``.

    Raises:
        FileFormatError: If it is not of this form, or two attachments have one name.
    """
    task = _mapping(parse_json(data, path), path, "the root")
    if "task" in task:
        task = _mapping(task["task"], path, "task")
    fields = task if "attachments" in task else _mapping(task.get("params"), path, "params")
    attachments = fields.get("attachments")
    addresses = attachments if isinstance(attachments, list) else [None]
    names = []
    for number, address in enumerate(addresses):
        parts = address_parts(address) if isinstance(address, str) else ()
        if not parts:
            where = f"attachment {number}"
            raise FileFormatError(path, where=where, expected="an address of a frame", got=repr(address)[:80])
        names.append(parts[-1])
    if len(set(names)) < len(names):
        twin = next(name for name in names if names.count(name) > 1)
        raise FileFormatError(path, where="attachments", expected="files of different names", got=f"{twin!r} twice")
    unit = fields.get("meters_per_unit")
    metres = None if unit is None else finite(unit, limit=1e6)
    if unit is not None and (metres is None or metres <= 0):
        raise FileFormatError(path, where="meters_per_unit", expected="a number above 0", got=repr(unit)[:80])
    return ScaleOrder(attachments=tuple(names), metres_per_unit=metres)


def _mapping(value: Any, path: Path | str, where: str) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise FileFormatError(path, where=where, expected="an object", got=repr(value)[:80])
    return value
