"""Waymo's ``Objects``, in which its boxes of detections and labels are exchanged, and ``Submission``, which wraps them.

Both are messages in the wire format of Protocol Buffers (protobuf.dev, "Encoding"): fields, each a key (number times 8
plus kind) and a value: a varint (kind 0), eight bytes (1), a length and so many bytes (2), or four bytes (5). Waymo's
field numbers (waymo-research/waymo-open-dataset, ``label.proto``, ``metrics.proto``, ``submission.proto``, Apache-2.0):

    Objects     1 object, repeated; 2 zone without labels, repeated
    Object      1 Label, 2 score (float), 3 overlaps a zone without labels, 4 context, 5 microseconds, 6 camera
    Label       1 Box, 3 type, 4 id, 5 detection level, 6 tracking level, 7 points, 11 camera that sees it best,
                12 Box as the cameras see it, 13 points of the LiDAR on the roof
    Box         1-3 centre, 4 width, 5 length, 6 height, 7 heading (doubles)
    Submission  11 Objects

The file is walked over as it stands: no length is followed beyond what holds it, and nothing is kept of other fields.
"""

import math
import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.errors import ConfigError, FileFormatError
from farfield.files.atomic import open_atomic, read_bytes
from farfield.files.cuboids import FARTHEST_M
from farfield.files.limits import MAX_NAME

TYPES = ("TYPE_UNKNOWN", "TYPE_VEHICLE", "TYPE_PEDESTRIAN", "TYPE_SIGN", "TYPE_CYCLIST")
_VARINT, _EIGHT, _BYTES, _FOUR = 0, 1, 2, 5
_LARGEST_M = 1e3
_BOX_FIELDS = (1, 2, 3, 5, 4, 6, 7)  # x, y, z, length, width, height, heading
MAX_OBJECTS_BYTES, MAX_OBJECTS = 1 << 31, 10_000_000
"""Of one file; the predictions of the whole validation set are 6 to 8 million of 125 bytes."""
_MAX_ZONES, _MAX_RESULTS, _BATCH = 1_000_000, 1000, 1 << 16
_Span = tuple[int, int]
_Field = tuple[int, int, int | _Span]  # number, kind, value: a whole number, or from where to where the bytes stand


@dataclass(frozen=True, eq=False, kw_only=True)
class WaymoObjects:
    """Boxes of several frames, a row an object in the file's order, in the vehicle's frame (x ahead, y left, z up).

    Args:
        context: Name of the segment of each, n texts.
        time_us: Stamp of the frame, microseconds, shape (n,).
        type: Number of the type in :data:`TYPES`, shape (n,).
        id: Identity, n texts, empty where there is none.
        score: Scores, NaN where there is none (labels), shape (n,).
        box: Centre x, y, z, length, width, height (metres), heading (radians, counter-clockwise from +x), shape (n, 7).
        detection_level: 1, 2, or 0 where the number of points decides, shape (n,).
        points: LiDAR points in the box, -1 where not said, shape (n,).
        top_points: Those of the LiDAR on the roof, -1 where not said, shape (n,).
        no_label_zone: Whether it overlaps a zone without labels, shape (n,).
        camera: Name of the camera that sees it best, n texts, empty where none does.
        camera_box: The box as the cameras see it, NaN where it is not said, shape (n, 7).
        zones: Zones without labels in the file; none of them is kept.
    """

    context: tuple[str, ...]
    time_us: Int[np.ndarray, " n"]
    type: Int[np.ndarray, " n"]
    id: tuple[str, ...]
    score: Float[np.ndarray, " n"]
    box: Float[np.ndarray, "n 7"]
    detection_level: Int[np.ndarray, " n"]
    points: Int[np.ndarray, " n"]
    top_points: Int[np.ndarray, " n"]
    no_label_zone: Bool[np.ndarray, " n"]
    camera: tuple[str, ...]
    camera_box: Float[np.ndarray, "n 7"]
    zones: int = 0

    def __len__(self) -> int:
        return len(self.context)


@dataclass(slots=True)
class _Row:
    """One object as it is read."""

    context: str = ""
    time_us: int = -1
    type: int = 0
    id: str = ""
    score: float = math.nan
    box: tuple[float, ...] = ()
    detection_level: int = 0
    points: int = -1
    top_points: int = -1
    no_label_zone: int = 0
    camera: str = ""
    camera_box: tuple[float, ...] = (math.nan,) * 7


# Reading


def read_waymo_objects(path: Path | str) -> WaymoObjects:
    """Read a file of ``Objects`` or of a ``Submission``.

    Raises:
        FileFormatError: If the file is neither, is cut or damaged, or holds an object that no box can be: without a
            context, stamp or box, of a camera's image, or with values beyond any.
    """
    data = read_bytes(path, max_bytes=MAX_OBJECTS_BYTES)
    if data[:2] == b"\x1f\x8b":
        expected = "Objects as they stand; unpack the archive first (tar xzf) and name a file of it"
        raise FileFormatError(path, where="byte 0", expected=expected, got="a gzip archive")
    rows: list[_Row] = []
    parts: list[WaymoObjects] = []
    texts: dict[str, str] = {}  # one copy of a name that millions of objects share
    zones = 0
    where = "the file"
    try:
        for span in _objects_spans(data):
            for number, kind, value in _fields(data, *span):
                where = f"object {len(parts) * _BATCH + len(rows)}"
                if number == 1:
                    rows.append(_object(data, _span(number, kind, value)))
                    rows[-1].context = texts.setdefault(rows[-1].context, rows[-1].context)
                    rows[-1].camera = texts.setdefault(rows[-1].camera, rows[-1].camera)
                zones += number == 2
                if len(rows) == _BATCH:
                    parts.append(_columns(rows))
                    rows = []
                if len(parts) * _BATCH + len(rows) > MAX_OBJECTS:
                    raise ValueError(f"more than {MAX_OBJECTS:,} objects")
    except (ValueError, UnicodeDecodeError) as error:
        expected = "Waymo's Objects (protobuf): objects with a context, a stamp and a box"
        raise FileFormatError(path, where=where, expected=expected, got=str(error)[:200]) from error
    return _joined([*parts, _columns(rows)], zones)


def _objects_spans(data: bytes) -> Iterator[_Span]:
    """Where ``Objects`` stand: the whole file, or field 11 of a ``Submission``, which has others beside."""
    wrapped: list[int | _Span] = []
    stranger, zones = "", 0
    for number, kind, value in _fields(data, 0, len(data)):
        if number == 11 and kind == _BYTES:
            wrapped.append(value)
        if not stranger and (number > 2 or kind == _VARINT):
            stranger = f"field {number} of kind {kind}"
        zones += number == 2
        if zones > _MAX_ZONES or len(wrapped) > _MAX_RESULTS:
            raise ValueError(f"more than {_MAX_ZONES:,} zones or {_MAX_RESULTS:,} inference_results")
    if not stranger:
        yield 0, len(data)
        return
    if not wrapped:
        raise ValueError(f"{stranger} in a file without inference_results (field 11)")
    for value in wrapped:
        if isinstance(value, tuple):
            yield value


def _fields(data: bytes, start: int, end: int) -> Iterator[_Field]:
    """The fields of a message that stands from ``start`` up to ``end``."""
    at = start
    while at < end:
        key, at = _varint(data, at, end)
        number, kind = key >> 3, key & 7
        if number == 0 or number >= 1 << 29:
            raise ValueError(f"byte {at}: a field of number {number}")
        if kind == _VARINT:
            value, at = _varint(data, at, end)
            yield number, kind, value
            continue
        if kind == _BYTES:
            length, at = _varint(data, at, end)
        elif kind in (_EIGHT, _FOUR):
            length = 8 if kind == _EIGHT else 4
        else:
            raise ValueError(f"byte {at}: a field of kind {kind}")
        if length > end - at:
            raise ValueError(f"byte {at}: {length} bytes where {end - at} are left")
        yield number, kind, (at, at + length)
        at += length


def _varint(data: bytes, at: int, end: int) -> tuple[int, int]:
    """A number of 7 bits a byte, the lowest first, and where the next byte stands."""
    value = 0
    for shift in range(0, 70, 7):
        if at >= end:
            raise ValueError(f"byte {at}: the end within a number")
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            if value >= 1 << 64:
                break
            return value, at
    raise ValueError(f"byte {at}: a number of more than 64 bits")


def _span(number: int, kind: int, value: int | _Span) -> _Span:
    if kind != _BYTES or not isinstance(value, tuple):
        raise ValueError(f"field {number} of kind {kind}, no message")
    return value


def _whole(number: int, kind: int, value: int | _Span) -> int:
    if kind != _VARINT or not isinstance(value, int):
        raise ValueError(f"field {number} of kind {kind}, no whole number")
    return value - (1 << 64) if value >= 1 << 63 else value


def _text(data: bytes, number: int, kind: int, value: int | _Span) -> str:
    start, end = _span(number, kind, value)
    if end - start > MAX_NAME:
        raise ValueError(f"a name of {end - start} bytes, more than {MAX_NAME}")
    text = data[start:end].decode("utf-8")
    if any(ord(character) < 32 or ord(character) == 127 for character in text):
        raise ValueError(f"a name with a control character: {text[:40]!r}")
    return text


def _object(data: bytes, span: _Span) -> _Row:
    row = _Row()
    has_label = False
    for number, kind, value in _fields(data, *span):
        if number == 1:
            _read_label(data, _span(number, kind, value), row)
            has_label = True
        elif number == 2:
            if kind != _FOUR or not isinstance(value, tuple):
                raise ValueError(f"a score of kind {kind}")
            (row.score,) = struct.unpack_from("<f", data, value[0])
            if not math.isfinite(row.score):
                raise ValueError(f"the score {row.score}")
        elif number == 3:
            row.no_label_zone = int(_whole(number, kind, value) != 0)
        elif number == 4:
            row.context = _text(data, number, kind, value)
        elif number == 5:
            row.time_us = _whole(number, kind, value)
        elif number == 6 and _whole(number, kind, value) != 0:
            raise ValueError("an object of a camera's image, no box in space")
    if not has_label or not row.box:
        raise ValueError("no box")
    if not row.context or row.time_us < 0:
        raise ValueError("no context_name or frame_timestamp_micros, which say of which frame it is")
    return row


def _read_label(data: bytes, span: _Span, row: _Row) -> None:
    for number, kind, value in _fields(data, *span):
        if number == 1:
            row.box = _box(data, _span(number, kind, value))
        elif number == 3:
            row.type = _between(_whole(number, kind, value), 0, len(TYPES) - 1, "type")
        elif number == 4:
            row.id = _text(data, number, kind, value)
        elif number == 5:
            row.detection_level = _between(_whole(number, kind, value), 0, 2, "detection_difficulty_level")
        elif number == 7:
            row.points = _between(_whole(number, kind, value), 0, 1 << 31, "num_lidar_points_in_box")
        elif number == 11:
            row.camera = _text(data, number, kind, value)
        elif number == 12:
            start, end = _span(number, kind, value)
            if end > start:  # a box without numbers is none
                row.camera_box = _box(data, (start, end))
        elif number == 13:
            row.top_points = _between(_whole(number, kind, value), 0, 1 << 31, "num_top_lidar_points_in_box")


def _between(value: int, low: int, high: int, name: str) -> int:
    if not low <= value <= high:
        raise ValueError(f"{name} {value}, not from {low} to {high}")
    return value


def _box(data: bytes, span: _Span) -> tuple[float, ...]:
    values = dict.fromkeys(_BOX_FIELDS, 0.0)
    for number, kind, value in _fields(data, *span):
        if number in values:
            if kind != _EIGHT or not isinstance(value, tuple):
                raise ValueError(f"a box's field {number} of kind {kind}, no double")
            (values[number],) = struct.unpack_from("<d", data, value[0])
    box = tuple(values[number] for number in _BOX_FIELDS)
    if not all(math.isfinite(value) and abs(value) < FARTHEST_M for value in box):
        raise ValueError(f"a box of numbers that are not finite or above {FARTHEST_M:g}: {box}")
    if not all(0 < value < _LARGEST_M for value in box[3:6]):
        raise ValueError(f"a box of length, width, height {box[3:6]}, not from 0 to {_LARGEST_M:g} m")
    return box


def _joined(parts: Sequence[WaymoObjects], zones: int) -> WaymoObjects:
    columns: dict[str, Any] = {}
    for name in (field.name for field in fields(WaymoObjects) if field.name != "zones"):
        values = [getattr(part, name) for part in parts]
        columns[name] = np.concatenate(values) if isinstance(values[0], np.ndarray) else tuple(chain(*values))
    return WaymoObjects(**columns, zones=zones)


def _columns(rows: Sequence[_Row]) -> WaymoObjects:
    return WaymoObjects(
        context=tuple(row.context for row in rows),
        time_us=np.array([row.time_us for row in rows], dtype=np.int64),
        type=np.array([row.type for row in rows], dtype=np.int64),
        id=tuple(row.id for row in rows),
        score=np.array([row.score for row in rows], dtype=np.float64),
        box=np.array([row.box for row in rows], dtype=np.float64).reshape(-1, 7),
        detection_level=np.array([row.detection_level for row in rows], dtype=np.int64),
        points=np.array([row.points for row in rows], dtype=np.int64),
        top_points=np.array([row.top_points for row in rows], dtype=np.int64),
        no_label_zone=np.array([row.no_label_zone for row in rows], dtype=bool),
        camera=tuple(row.camera for row in rows),
        camera_box=np.array([row.camera_box for row in rows], dtype=np.float64).reshape(-1, 7),
    )


# Writing


def write_waymo_objects(path: Path | str, parts: Iterable[WaymoObjects]) -> int:
    """Write a file of ``Objects``, part after part; scores are rounded to single precision, which the format holds.

    Args:
        path: The file; it appears whole or not at all.
        parts: Objects, such as those of one frame after another; zones are not written.

    Returns:
        The number of objects.

    Raises:
        ConfigError: If a context is longer than readers take, or a number is not one that the format holds.
    """
    count = 0
    with open_atomic(path) as handle:
        for part in parts:
            for row in range(len(part)):
                handle.write(_message(1, _object_bytes(part, row)))
            count += len(part)
    return count


def _object_bytes(part: WaymoObjects, row: int) -> bytes:
    context = part.context[row].encode("utf-8")
    if not 0 < len(context) <= MAX_NAME or part.time_us[row] < 0:
        raise ConfigError(
            f"Waymo's objects: expected a context of 1 to {MAX_NAME} bytes and a stamp from 0 on, got "
            f"{part.context[row][:40]!r} and {part.time_us[row]}"
        )
    label = _message(1, _box_bytes(part.box[row])) + _number(3, int(part.type[row]))
    label += _message(4, part.id[row].encode("utf-8")) if part.id[row] else b""
    label += _number(5, int(part.detection_level[row])) if part.detection_level[row] else b""
    label += _number(7, int(part.points[row])) if part.points[row] >= 0 else b""
    label += _message(11, part.camera[row].encode("utf-8")) if part.camera[row] else b""
    label += _message(12, _box_bytes(part.camera_box[row])) if np.isfinite(part.camera_box[row]).all() else b""
    label += _number(13, int(part.top_points[row])) if part.top_points[row] >= 0 else b""
    score = part.score[row]
    fields = _message(1, label) + (b"" if np.isnan(score) else _key(2, _FOUR) + struct.pack("<f", score))
    fields += _number(3, 1) if part.no_label_zone[row] else b""
    return fields + _message(4, context) + _number(5, int(part.time_us[row]))


def _box_bytes(box: Float[np.ndarray, "7"]) -> bytes:
    numbered = sorted(zip(_BOX_FIELDS, box.tolist(), strict=True))
    return b"".join(_key(number, _EIGHT) + struct.pack("<d", value) for number, value in numbered)


def _key(number: int, kind: int) -> bytes:
    return _varint_bytes(number << 3 | kind)


def _number(number: int, value: int) -> bytes:
    return _key(number, _VARINT) + _varint_bytes(value)


def _message(number: int, data: bytes) -> bytes:
    return _key(number, _BYTES) + _varint_bytes(len(data)) + data


def _varint_bytes(value: int) -> bytes:
    parts = bytearray()
    while value >= 0x80:
        parts.append(value & 0x7F | 0x80)
        value >>= 7
    parts.append(value)
    return bytes(parts)
