"""Ouster's own files, OSF of the second generation: sweeps as pictures of ranges, packed, with the sensors' metadata.

Written from the schemas and writers of github.com/ouster-lidar/ouster-sdk (BSD-3-Clause, ``ouster_osf/fb``): a header,
chunks of messages, and a list of them at the end, each a FlatBuffer behind its size and before its check sum. A
sweep's fields are pictures, beam by column: packed as zpng since ouster-sdk 0.15, as PNG before.
"""

import io
import os
import struct
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from jaxtyping import Bool, Float64, Int64, Shaped, UInt8

from farfield.errors import FileFormatError, MissingExtraError
from farfield.files.flat_tables import FlatBuffer, FlatTable
from farfield.files.json_text import parse_json
from farfield.files.limits import MAX_BYTES, open_file
from farfield.files.ouster import OusterSensor, body_T_sensor_of, check_motion, sensor_of
from farfield.files.stand_ins import check_itself

_HEADER_MARK, _LIST_MARK, _CHUNK_MARK = b"OSF$", b"OSF#", b"OSF!"
_FIRST_VERSIONS = range(20, 30)  # of the second generation; later ones count major, minor and patch in 16 bits each
_MOST_HEADER_BYTES, _MOST_MESSAGES = 1 << 12, 1 << 20
_SENSOR, _SWEEPS = "ouster/v1/os_sensor/LidarSensor", "ouster/v1/os_sensor/LidarScanStream"
_EXTRINSICS = "ouster/v1/os_sensor/Extrinsics"
_FIELDS = {1: "range", 2: "range_2", 3: "signal", 4: "signal_2", 5: "reflectivity", 6: "reflectivity_2", 7: "near_ir"}
_KINDS = {1: "u1", 2: "<u2", 3: "<u4", 4: "<u8"}
_ZPNG, _PNG = 0xFBF8, b"\x89PNG"
_PLACES = np.dtype([("start_ns", "<u8"), ("end_ns", "<u8"), ("offset", "<u8")])
_FIELD = np.dtype([("name", "u1"), ("kind", "u1")])


@dataclass(frozen=True)
class OsfMessage:
    """Where a sweep stands: its chunk, its place in it, and whose it is.

    Args:
        chunk: First byte of the chunk.
        number: Of the chunk's messages.
        sensor: The sensor's number.
        time_ns: Of its first measured column.
        measured: Columns that were measured.
        world_T_sensor: Where the sensor stood then, shape (4, 4); None where the file does not say.
    """

    chunk: int
    number: int
    sensor: int
    time_ns: int
    measured: int
    world_T_sensor: Float64[np.ndarray, "4 4"] | None


@dataclass(frozen=True, eq=False)
class OsfSweep:
    """One sweep.

    Args:
        fields: Pictures by name (``range`` in millimetres, ``reflectivity``, ``near_ir``, ``signal``, a second return's
            with ``_2``), shape (beams, columns).
        times_ns: Of each column, by the sensor's clock, shape (columns,).
        measured: Whether it was, shape (columns,).
    """

    fields: Mapping[str, Shaped[np.ndarray, "beams columns"]]
    times_ns: Int64[np.ndarray, " columns"]
    measured: Bool[np.ndarray, " columns"]


@dataclass(frozen=True, eq=False)
class OsfFile:
    """One file, indexed.

    Args:
        path: The file.
        sensors: What their metadata say, by number.
        body_T_sensor: Where they stand on their carrier, whose poses the sweeps have, by number, shape (4, 4).
        names: What the sensors are called: by serial number, or by their number.
        messages: The sweeps, in the order of the file.
    """

    path: Path
    sensors: Mapping[int, OusterSensor]
    body_T_sensor: Mapping[int, Float64[np.ndarray, "4 4"]]
    names: Mapping[int, str]
    messages: tuple[OsfMessage, ...]

    @classmethod
    def of(cls, path: Path) -> "OsfFile":
        """Index a file: one pass through it, without unpacking a picture.

        Raises:
            FileFormatError: If it is no OSF of the second generation, unfinished or damaged.
        """
        check_itself(path)
        with open_file(path, max_bytes=None) as file:
            start, listed = _listed(path, file)
            entries = {entry.whole(0, "I"): entry for entry in listed.tables(4)}
            contents = {
                number: parse_json(_described(path, entry), path)
                for number, entry in entries.items()
                if entry.text(1) == _SENSOR
            }
            sensors = {number: sensor_of(content, path, unpacked=True) for number, content in contents.items()}
            placed = {number: body_T_sensor_of(content, path) for number, content in contents.items()}
            placed |= _extrinsics(path, [entry for entry in entries.values() if entry.text(1) == _EXTRINSICS])
            streams = {
                number: FlatBuffer(path, "a stream", _sized(path, "a stream", entry.content(2))).root().whole(0, "I")
                for number, entry in entries.items()
                if entry.text(1) == _SWEEPS
            }
            messages = list[OsfMessage]()
            for entry in listed.array(3, _PLACES):
                messages += _messages(path, file, start + int(entry["offset"]), streams, sensors, placed)
                if len(messages) > _MOST_MESSAGES:
                    raise FileFormatError(
                        path, where="the file", expected=f"at most {_MOST_MESSAGES} sweeps", got="more"
                    )
        return cls(
            path,
            sensors,
            placed,
            {number: _serial(content, number) for number, content in contents.items()},
            tuple(messages),
        )

    def sweep(self, message: OsfMessage) -> OsfSweep:
        """Unpack a sweep.

        Raises:
            FileFormatError: If it is damaged, or packed in another way.
            MissingExtraError: If it is packed as zpng, and zstandard is not installed.
        """
        with open_file(self.path, max_bytes=None) as file:
            table = _chunk(self.path, file, message.chunk).tables(0)[message.number]
        sensor = self.sensors[message.sensor]
        sweep = _opened(self.path, message.chunk, table)
        times_ns, measured = _columns(sweep, sensor)
        kinds, pictures = sweep.array(1, _FIELD), sweep.tables(0)
        if len(kinds) != len(pictures):
            raise sweep.buffer.fault(f"{len(kinds)} pictures", f"{len(pictures)}")
        fields = {
            _FIELDS[int(kind["name"])]: _picture(picture, int(kind["kind"]), sensor)
            for kind, picture in zip(kinds, pictures, strict=True)
            if int(kind["name"]) in _FIELDS
        }
        if "range" not in fields:
            raise sweep.buffer.fault("a picture of ranges", "none")
        return OsfSweep(fields, times_ns, measured)


def is_osf(path: Path) -> bool:
    """Whether a file begins as an OSF."""
    if not path.is_file():
        return False
    with open_file(path, max_bytes=None) as file:
        return file.read(12)[8:] == _HEADER_MARK


def _buffer(path: Path, file: BinaryIO, at: int, mark: bytes, most: int, where: str) -> FlatBuffer:
    """The FlatBuffer at a byte of the file, its size, mark and check sum as they must be."""
    end = file.seek(0, os.SEEK_END)
    if at > end:
        raise FileFormatError(path, where=where, expected=f"a place within the file's {end} bytes", got=f"byte {at}")
    file.seek(at)
    size_bytes = file.read(4)
    size = int.from_bytes(size_bytes, "little") if len(size_bytes) == 4 else 0
    if not 8 <= size <= most:
        raise FileFormatError(path, where=where, expected=f"8 to {most} bytes", got=f"{size}")
    data, check = file.read(size), file.read(4)
    if len(data) < size or len(check) < 4:
        raise FileFormatError(path, where=where, expected=f"{size} bytes and a check sum", got="the file's end")
    if data[4:8] != mark:
        raise FileFormatError(path, where=where, expected=mark.decode(), got=data[4:8].hex(" "))
    if zlib.crc32(size_bytes + data) != int.from_bytes(check, "little"):
        fix = "Copy the file anew."
        raise FileFormatError(path, where=where, expected="the check sum of its bytes", got="another", fix=fix)
    return FlatBuffer(path, where, data)


def _listed(path: Path, file: BinaryIO) -> tuple[int, FlatTable]:
    """Where the chunks begin, and the list at the file's end."""
    buffer = _buffer(path, file, 0, _HEADER_MARK, _MOST_HEADER_BYTES, "the header")
    header = buffer.root()
    version, status = header.whole(0, "Q"), header.whole(1, "B")
    if version not in _FIRST_VERSIONS and version >> 48 != 2:
        fix = "Convert it with ouster-cli of ouster-sdk 0.13 or later."
        raise FileFormatError(path, where="the header", expected="OSF version 2", got=f"version {version}", fix=fix)
    if status != 2:
        fix = "Its recording was not ended; ouster-cli osf recover mends it."
        raise FileFormatError(path, where="the header", expected="a finished file", got=f"status {status}", fix=fix)
    at = header.whole(2, "Q", 1)
    return len(buffer.data) + 8, _buffer(path, file, at, _LIST_MARK, MAX_BYTES, "the list at its end").root()


def _chunk(path: Path, file: BinaryIO, at: int) -> FlatTable:
    return _buffer(path, file, at, _CHUNK_MARK, MAX_BYTES, f"the chunk at byte {at}").root()


def _sized(path: Path, where: str, content: bytes) -> bytes:
    """A buffer without the size before it."""
    size = int.from_bytes(content[:4], "little")
    if len(content) < 12 or size > len(content) - 4:
        raise FileFormatError(path, where=where, expected=f"{size} bytes", got=f"{len(content)}")
    return content[4 : 4 + size]


def _described(path: Path, entry: FlatTable) -> bytes:
    """A sensor's metadata, a JSON text."""
    return FlatBuffer(path, "a sensor", _sized(path, "a sensor", entry.content(2))).root().content(0)


def _extrinsics(path: Path, entries: list[FlatTable]) -> dict[int, Float64[np.ndarray, "4 4"]]:
    """Where sensors stand on their carrier, by the entries that say it apart from the metadata and in their stead."""
    placed = dict[int, Float64[np.ndarray, "4 4"]]()
    for entry in entries:
        table = FlatBuffer(path, "an extrinsic", _sized(path, "an extrinsic", entry.content(2))).root()
        sensor, numbers = table.whole(1, "I"), table.array(0, "<f8")
        if len(numbers) != 16 or not np.isfinite(numbers).all():
            raise table.buffer.fault("16 finite numbers", f"{len(numbers)}")
        pose = numbers.reshape(4, 4).copy()
        check_motion(path, f"the extrinsic of sensor {sensor}", pose)
        if not np.array_equal(placed.setdefault(sensor, pose), pose):
            raise table.buffer.fault(f"one for sensor {sensor}", "several that differ")
    return placed


def _serial(content: Any, number: int) -> str:
    """What a sensor is called: its serial number, where its metadata say it."""
    info = content.get("sensor_info", content) if isinstance(content, dict) else {}
    serial = str(info.get("prod_sn", "")) if isinstance(info, dict) else ""
    return serial if serial.isalnum() and len(serial) <= 40 else f"sensor{number}"


def _opened(path: Path, chunk: int, message: FlatTable) -> FlatTable:
    """The sweep in a message."""
    where = f"a sweep of the chunk at byte {chunk}"
    return FlatBuffer(path, where, _sized(path, where, message.content(2))).root()


def _messages(
    path: Path,
    file: BinaryIO,
    at: int,
    streams: Mapping[int, int],
    sensors: Mapping[int, OusterSensor],
    placed: Mapping[int, Float64[np.ndarray, "4 4"]],
) -> list[OsfMessage]:
    """The sweeps of a chunk; messages of other streams are passed over."""
    messages = []
    for number, message in enumerate(_chunk(path, file, at).tables(0)):
        sensor = streams.get(message.whole(1, "I"), -1)
        if sensor not in sensors:
            continue
        sweep = _opened(path, at, message)
        times_ns, measured = _columns(sweep, sensors[sensor])
        if not measured.any():
            continue
        first = int(np.flatnonzero(measured)[0])
        world_T_body = _pose(sweep, sensors[sensor], first)
        pose = None if world_T_body is None else world_T_body @ placed[sensor]
        messages.append(OsfMessage(at, number, sensor, int(times_ns[first]), int(measured.sum()), pose))
    return messages


def _columns(
    sweep: FlatTable, sensor: OusterSensor
) -> tuple[Int64[np.ndarray, " columns"], Bool[np.ndarray, " columns"]]:
    """Times of a sweep's columns, and which were measured; those must be in the order of time."""
    times, status = sweep.array(2, "<u8"), sweep.array(4, "<u4")
    if not len(times) == len(status) == sensor.columns:
        got = f"{len(times)} times and {len(status)} states"
        raise sweep.buffer.fault(f"those of {sensor.columns} columns", got)
    measured = status & 1 == 1
    if (times[measured] >> 62).any():
        raise sweep.buffer.fault("times of columns in nanoseconds", f"{times[measured].max()}")
    return times.astype(np.int64), measured


def _pose(sweep: FlatTable, sensor: OusterSensor, column: int) -> Float64[np.ndarray, "4 4"] | None:
    """The carrier's pose at a column; None where there are none, or all the identity, as writers without any do it."""
    poses = sweep.array(6, "<f8")
    if not len(poses):
        return None
    if len(poses) != 16 * sensor.columns or not np.isfinite(poses).all():
        raise sweep.buffer.fault(f"finite poses of {sensor.columns} columns", f"{len(poses)} numbers")
    poses = poses.reshape(-1, 4, 4)
    return None if (poses == np.eye(4)).all() else poses[column].copy()


def _picture(picture: FlatTable, kind: int, sensor: OusterSensor) -> Shaped[np.ndarray, "beams columns"]:
    """A field of a sweep, unpacked."""
    content, buffer = picture.content(0), picture.buffer
    shape = (sensor.beams, sensor.columns)
    if kind not in _KINDS:
        raise buffer.fault("a picture of whole numbers without a sign", f"kind {kind}")
    dtype = np.dtype(_KINDS[kind])
    if content[:4] == _PNG:
        return _staggered(_png(content, shape, dtype, buffer.fault), sensor)
    if len(content) < 8 or struct.unpack("<H", content[:2])[0] != _ZPNG:
        raise buffer.fault("a picture packed as zpng or PNG", content[:4].hex(" ") or "nothing")
    width, height, channels, channel_bytes = struct.unpack("<HHBB", content[2:8])
    if (height, width) != shape or channels * channel_bytes != dtype.itemsize:
        expected = f"{shape[1]} x {shape[0]} pixels of {dtype.itemsize} bytes"
        raise buffer.fault(expected, f"{width} x {height} of {channels} x {channel_bytes}")
    return _zpng(_zstd(content[8:], height * width * dtype.itemsize, buffer.fault), shape, dtype)


_Fault = Callable[[str, str], FileFormatError]


def _zstd(content: bytes, size: int, fault: _Fault) -> bytes:
    """Bytes that zstd packed, of which there must be so many."""
    try:
        import zstandard
    except ImportError as error:
        raise MissingExtraError("zstandard", "sensors", "reading OSF") from error
    try:
        stated = zstandard.frame_content_size(content)
        unpacked = zstandard.ZstdDecompressor().decompress(content, max_output_size=size) if stated == size else b""
    except zstandard.ZstdError as error:
        raise fault(f"{size} bytes packed by zstd", str(error)) from error
    if len(unpacked) != size:
        raise fault(f"{size} bytes packed by zstd", f"{stated}")
    return unpacked


def _zpng(content: bytes, shape: tuple[int, int], dtype: np.dtype[Any]) -> Shaped[np.ndarray, "beams columns"]:
    """Pixels from their differences to the left, byte by byte; four-byte ones stand in planes of mixed bytes."""
    rows, columns = shape
    if dtype.itemsize == 4:
        last, green, red, alpha = np.frombuffer(content, dtype=np.uint8).reshape(4, rows, columns)
        middle = green + last
        steps = np.stack([middle - red, middle, last, alpha], axis=2)
    else:
        steps = np.frombuffer(content, dtype=np.uint8).reshape(rows, columns, dtype.itemsize)
    pixels: UInt8[np.ndarray, "rows columns bytes"] = np.cumsum(steps, axis=1, dtype=np.uint8)
    return np.ascontiguousarray(pixels).view(dtype)[:, :, 0]


def _png(
    content: bytes, shape: tuple[int, int], dtype: np.dtype[Any], fault: _Fault
) -> Shaped[np.ndarray, "beams columns"]:
    """Pixels of a PNG: grey of one or two bytes, or four channels that are a number's bytes."""
    from PIL import Image, UnidentifiedImageError

    mode = {1: ("L",), 2: ("I;16", "I;16B"), 4: ("RGBA",)}.get(dtype.itemsize, ())
    try:
        with Image.open(io.BytesIO(content), formats=["PNG"]) as picture:
            if picture.size != shape[::-1] or picture.mode not in mode:
                raise fault(
                    f"{shape[1]} x {shape[0]} pixels of {dtype.itemsize} bytes", f"{picture.size}, {picture.mode}"
                )
            pixels = np.asarray(picture)
    except (OSError, SyntaxError, ValueError, UnidentifiedImageError, zlib.error) as error:
        raise fault("a PNG", str(error)[:80]) from error
    return np.ascontiguousarray(pixels).view(dtype)[:, :, 0] if dtype.itemsize == 4 else pixels.astype(dtype)


def _staggered(
    picture: Shaped[np.ndarray, "beams columns"], sensor: OusterSensor
) -> Shaped[np.ndarray, "beams columns"]:
    """A picture as the sensor measured it: PNGs hold each row shifted, so that columns show one direction."""
    shifts = sensor.shift_columns
    if shifts is None:
        expected = "pixel_shift_by_row in the metadata, by which its pictures are shifted"
        raise FileFormatError("OSF", where="the metadata", expected=expected, got="none")
    columns = (np.arange(sensor.columns)[None] + shifts[:, None]) % sensor.columns
    return np.take_along_axis(picture, columns, axis=1)
