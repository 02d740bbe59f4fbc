"""LAS point clouds, versions 1.0 to 1.4, point formats 0 to 10, and LAZ, their packed form (extra ``las``).

Source: ASPRS, "LAS Specification 1.4 - R15" (2019), https://github.com/ASPRSorg/LAS. Coordinates are whole numbers,
which become metres in float64; what a file says to be in another unit is refused (:mod:`farfield.files.las_units`).
Points marked *withheld*, which the specification calls deleted, are left out, and it is said.
"""

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float, Shaped, UInt8

from farfield.errors import FileFormatError
from farfield.files.atomic import read_bytes
from farfield.files.las_units import check_metres
from farfield.files.laz import RECORD, unpack_laz
from farfield.files.limits import MAX_BYTES, allowed_bytes, check_name, check_numbers, open_file
from farfield.vocabulary.counts import count_of

SUFFIXES = (".las", ".laz")
_HEADER = struct.Struct("<4sHH16sBB32s32sHHHIIBHI5I12d")  # of 1.0 to 1.2: 227 bytes
_SIZES = {0: 227, 1: 227, 2: 227, 3: 235, 4: 375}
_RECORD_HEAD, _LONG_RECORD_HEAD = struct.Struct("<H16sHH32s"), struct.Struct("<H16sHQ32s")
_PACKED = 0x80
_MAX_RECORDS_BYTES = 16 << 20

_PLACE = (("X", "<i4"), ("Y", "<i4"), ("Z", "<i4"), ("intensity", "<u2"))
_OLD = (*_PLACE, ("returns", "u1"), ("class", "u1"), ("rank", "i1"), ("user_data", "u1"), ("point_source_id", "<u2"))
_NEW = (*_PLACE, ("returns", "u1"), ("flags", "u1"), ("classification", "u1"), ("user_data", "u1"),
        ("angle", "<i2"), ("point_source_id", "<u2"), ("gps_time", "<f8"))  # fmt: skip
_TIME, _COLOURS, _NEAR = ("gps_time", "<f8"), (("red", "<u2"), ("green", "<u2"), ("blue", "<u2")), ("nir", "<u2")
_WAVE = (("wave_descriptor", "u1"), ("wave_offset", "<u8"), ("wave_bytes", "<u4"), ("wave_location", "<f4"),
         ("wave_x", "<f4"), ("wave_y", "<f4"), ("wave_z", "<f4"))  # fmt: skip
_FORMATS: dict[int, tuple[tuple[str, str], ...]] = {
    0: _OLD, 1: (*_OLD, _TIME), 2: (*_OLD, *_COLOURS), 3: (*_OLD, _TIME, *_COLOURS), 4: (*_OLD, _TIME, *_WAVE),
    5: (*_OLD, _TIME, *_COLOURS, *_WAVE), 6: _NEW, 7: (*_NEW, *_COLOURS), 8: (*_NEW, *_COLOURS, _NEAR),
    9: (*_NEW, *_WAVE), 10: (*_NEW, *_COLOURS, _NEAR, *_WAVE),
}  # fmt: skip
_FIRST_NEW = 6
_OLDEST = {0: 3, 1: 3, 2: 3, 3: 5, 4: 10}
"""The highest point format of each version; 1.0 and 1.1 know two, and files of theirs with the next two are read."""
_ANGLE_STEP_DEG = 0.006
_EXTRA_RECORD, _EXTRA_BYTES = ("LASF_Spec", 4), 192
_EXTRA_TYPES = ("u1", "i1", "<u2", "<i2", "<u4", "<i4", "<u8", "<i8", "<f4", "<f8")
_WAVES_INSIDE, _ADJUSTED_TIME = 1 << 1, 1
_WEEK_S, _MOST_ADJUSTED_S, _MOST_SWEEP_S = 604_800.0, 3.0e9, 0.5  # the second is in the year 2106
_GPS_EPOCH_S, _ADJUSTED_BY_S = 315_964_800, 1_000_000_000
_LEAP_SECONDS = (
    (1_483_228_800, 18),
    (1_435_708_800, 17),
    (1_341_100_800, 16),
    (1_230_768_000, 15),
    (1_136_073_600, 14),
)
"""Since when (seconds since 1970, UTC) GPS time is so many seconds ahead of UTC, from 2006 on (IERS Bulletin C)."""
_FIX = "The file is truncated, or its header is wrong: fetch it again, or write it anew with the tool that made it."


@dataclass(frozen=True)
class LasCloud:
    """What a LAS or LAZ file holds.

    Args:
        columns: By name, each of shape (n,), or (n, count): ``x``, ``y``, ``z`` in metres (float64), ``intensity`` and
            all else that a point has, ``withheld`` points left out. Where the points' GPS times are those of one sweep,
            ``timestamp_ns`` since 1970 (UTC), or ``offset_ns`` since the first of them where they count from the week.
        remarks: What is not as it seems: a sentence each.
        records: Data of the file's variable length records by user and number.
    """

    columns: Mapping[str, Shaped[np.ndarray, "..."]]
    remarks: tuple[str, ...] = ()
    records: Mapping[tuple[str, int], bytes] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class LasHeader:
    """What a header says, checked for consistency in itself and with the file's size.

    Args:
        minor: Version 1.minor.
        encoding: The global encoding's bits.
        point_format: 0 to 10.
        packed: Whether the points are those of LAZ.
        start: Byte at which they begin.
        point_bytes: Of each.
        points: Their number.
        scale_m: Of x, y, z.
        offset_m: Of x, y, z.
        low_m: The least x, y, z that the header promises.
        high_m: The largest.
        by_return: How many points are each return, first to fifth or fifteenth; all 0 where nobody counted.
        records: Data of the variable length records by user and number.
    """

    minor: int
    encoding: int
    point_format: int
    packed: bool
    start: int
    point_bytes: int
    points: int
    scale_m: tuple[float, float, float]
    offset_m: tuple[float, float, float]
    low_m: tuple[float, float, float]
    high_m: tuple[float, float, float]
    by_return: tuple[int, ...]
    records: Mapping[tuple[str, int], bytes]


def read_las(path: Path | str, *, max_bytes: int = MAX_BYTES) -> LasCloud:
    """Read a LAS or LAZ file.

    Args:
        path: The file.
        max_bytes: Largest file, and largest size of the unpacked points, that is accepted.

    Raises:
        MissingExtraError: If it is LAZ, and lazrs is not installed.
        FileFormatError: If the header contradicts itself, the file's size or the points, the coordinates are said to be
            anything but metres, or the points do not unpack.
    """
    data = read_bytes(path, max_bytes=max_bytes)
    header = parse_las_header(data, path=path)
    check_metres(header.records, path=path)
    size = header.points * header.point_bytes
    if size > (most := allowed_bytes(len(data), most=max_bytes)):
        raise FileFormatError(path, where="the header", expected=f"points of at most {most} bytes", got=f"{size}")
    fields = _fields(header, path)
    body = memoryview(data)[header.start : header.start + size]
    if header.packed:
        record = header.records.get(RECORD)
        if record is None:
            raise FileFormatError(path, where="the records", expected="'laszip encoded'", got="none", fix=_FIX)
        packing = {"start": header.start, "points": header.points, "point_bytes": header.point_bytes}
        body = memoryview(unpack_laz(data, record, **packing, path=path) if header.points else b"")
    rows = np.frombuffer(body, np.uint8).reshape(header.points, header.point_bytes)
    return _cloud(rows, fields, header, path)


def las_middle(path: Path | str) -> Float[np.ndarray, " 3"] | None:
    """About where a file's points lie, metres, shape (3,), by a few bytes of which nothing else is checked.

    The middle of the box that the header promises, or the first point where it promises none; None without either.
    """
    with open_file(path, max_bytes=None) as file:
        head = file.read(_HEADER.size)
        if not head.startswith(b"LASF") or len(head) < _HEADER.size:
            return None
        values = _HEADER.unpack(head)
        file.seek(values[11] + (8 if values[13] & _PACKED else 0))  # the first of a packed chunk is not packed itself
        first = file.read(12)
    high, low = np.array(values[-6:], dtype=np.float64).reshape(3, 2).T
    if (low <= high).all() and (low.any() or high.any()):
        middle_m = (low + high) / 2
    elif len(first) == 12:
        middle_m = np.frombuffer(first, "<i4") * np.array(values[-12:-9]) + values[-9:-6]
    else:
        return None
    return middle_m if np.isfinite(middle_m).all() else None


def parse_las_header(data: bytes, *, path: Path | str) -> LasHeader:
    """Parse and check the header of a LAS or LAZ file.

    Raises:
        FileFormatError: If it is none, contradicts itself, or promises more than the file holds.
    """
    if not data.startswith(b"LASF"):
        raise FileFormatError(path, where="byte 0", expected="LASF", got=repr(data[:8]))
    if len(data) < _HEADER.size:
        raise FileFormatError(path, where="the header", expected="227 bytes or more", got=str(len(data)), fix=_FIX)
    values = _HEADER.unpack_from(data)
    encoding, major, minor, header_bytes, start, records, kind, point_bytes, old_count = (
        values[2], *values[4:6], *values[10:16],
    )  # fmt: skip
    if major != 1 or minor not in _SIZES:
        raise FileFormatError(path, where="byte 24", expected="version 1.0 to 1.4", got=f"{major}.{minor}")
    if not max(_SIZES[minor], _HEADER.size) <= header_bytes <= start <= len(data):
        expected = f"a header of {_SIZES[minor]} bytes or more, and points behind it"
        actual = f"{header_bytes} bytes, points from byte {start} of {len(data)} on"
        raise FileFormatError(path, where="byte 94", expected=expected, got=actual, fix=_FIX)
    packed, point_format = bool(kind & _PACKED), kind & 0x3F
    if point_format > _OLDEST[minor] or kind & 0x40:
        expected = f"a point format of 0 to {_OLDEST[minor]} in version 1.{minor}"
        raise FileFormatError(path, where="byte 104", expected=expected, got=f"{point_format}")
    least = sum(np.dtype(dtype).itemsize for _, dtype in _FORMATS[point_format])
    if point_bytes < least:
        expected = f"points of {least} bytes or more (format {point_format})"
        raise FileFormatError(path, where="byte 105", expected=expected, got=f"{point_bytes} bytes", fix=_FIX)
    points, by_return, waves, extended, extended_count = old_count, list(values[16:21]), 0, 0, 0
    if minor >= 3:
        waves = struct.unpack_from("<Q", data, 227)[0]
    if minor == 4:
        extended, extended_count, points, *by_return = struct.unpack_from("<QIQ15Q", data, 235)
        if old_count not in (0, points):
            expected, actual = f"{points} points, as at byte 247", f"{old_count}"
            raise FileFormatError(path, where="byte 107", expected=expected, got=actual, fix=_FIX)
    scale, offset, bounds = values[21:24], values[24:27], np.array(values[27:33])
    _check_scales(np.array(scale), np.array(offset), path)
    waves_inside = bool(encoding & _WAVES_INSIDE) and waves > 0
    ends = [at for at, inside in ((waves, waves_inside), (extended, extended_count > 0)) if inside]
    if not packed:
        _check_points(data, start, points * point_bytes, point_bytes, ends, path)
    table = dict(_records(data, header_bytes, start, records, path))
    if extended_count:
        table = dict(_records(data, extended, len(data), extended_count, path, long=True)) | table
    return LasHeader(
        minor=minor,
        encoding=encoding,
        point_format=point_format,
        packed=packed,
        start=start,
        point_bytes=point_bytes,
        points=points,
        scale_m=scale,
        offset_m=offset,
        low_m=tuple(bounds[1::2].tolist()),
        high_m=tuple(bounds[::2].tolist()),
        by_return=tuple(by_return),
        records=table,
    )


def _check_scales(scale: Float[np.ndarray, " 3"], offset: Float[np.ndarray, " 3"], path: Path | str) -> None:
    if not (np.isfinite(scale).all() and (np.abs(scale) >= 1e-9).all() and (np.abs(scale) <= 1e3).all()):
        expected = "scales of x, y, z from 1e-9 to 1000"
        raise FileFormatError(path, where="byte 131", expected=expected, got=str(scale.tolist()), fix=_FIX)
    if not (np.isfinite(offset).all() and (np.abs(offset) <= 1e9).all()):
        raise FileFormatError(path, where="byte 155", expected="finite offsets", got=str(offset.tolist()), fix=_FIX)


def _check_points(data: bytes, start: int, size: int, point_bytes: int, ends: list[int], path: Path | str) -> None:
    """See that the points are as many as the header says: no more, and no less, up to what stands behind them."""
    end = min(ends, default=len(data))
    rest = end - start - size
    if not 0 <= rest < (point_bytes if not ends else end):
        expected = f"{size // point_bytes} points of {point_bytes} bytes up to byte {end}"
        actual = f"{(end - start) / point_bytes:.6g} of them"
        raise FileFormatError(path, where=f"byte {start}", expected=expected, got=actual, fix=_FIX)


def _records(
    data: bytes, start: int, end: int, count: int, path: Path | str, *, long: bool = False
) -> Iterator[tuple[tuple[str, int], bytes]]:
    """The variable length records between two bytes, those of 1.4 at the end of the file with longer headers."""
    head = _LONG_RECORD_HEAD if long else _RECORD_HEAD
    total = 0
    for number in range(count):
        if start + head.size > end:
            expected, actual = f"{count} records", f"the end of their room in number {number}"
            raise FileFormatError(path, where=f"byte {start}", expected=expected, got=actual, fix=_FIX)
        _, user, kind, size, _ = head.unpack_from(data, start)
        start += head.size
        if size > end - start:
            expected, actual = f"a record of at most {end - start} bytes", f"{size}"
            raise FileFormatError(path, where=f"byte {start}", expected=expected, got=actual, fix=_FIX)
        total += size
        if total <= _MAX_RECORDS_BYTES:  # beyond it are only tables of other tools
            yield (user.partition(b"\0")[0].decode("latin-1"), kind), data[start : start + size]
        start += size


@dataclass(frozen=True)
class _Field:
    """A number of a point: where it stands, and what the file says to it, if it is one of the file's own."""

    name: str
    dtype: np.dtype
    offset: int
    count: int = 1
    scale: tuple[float, float] | None = None
    no_data: float | int | None = None


def _fields(header: LasHeader, path: Path | str) -> list[_Field]:
    """All numbers of a point: those of its format, then those of the extra bytes, told or not."""
    fields, at = [], 0
    for name, kind in _FORMATS[header.point_format]:
        fields.append(_Field(name, np.dtype(kind), at))
        at += np.dtype(kind).itemsize
    extra = header.records.get(_EXTRA_RECORD, b"")
    if len(extra) % _EXTRA_BYTES:
        expected = f"extra bytes described in {_EXTRA_BYTES} bytes each"
        raise FileFormatError(path, where="the record LASF_Spec 4", expected=expected, got=f"{len(extra)} bytes")
    names = {part.name.lower() for part in fields} | {"x", "y", "z", "withheld", "offset_ns", "timestamp_ns"}
    check_numbers(path, "the record LASF_Spec 4", len(extra) // _EXTRA_BYTES)
    for start in range(0, len(extra), _EXTRA_BYTES):
        added = _extra_field(extra[start : start + _EXTRA_BYTES], at, path)
        at += added.count * added.dtype.itemsize
        if added.name.lower() in names or at > header.point_bytes:
            where, actual = "the record LASF_Spec 4", f"{added.name!r} to byte {at} of {header.point_bytes}"
            raise FileFormatError(path, where=where, expected="names that differ, in a point", got=actual, fix=_FIX)
        names.add(added.name.lower())
        fields.append(added)
    if at < header.point_bytes:
        fields.append(_Field("extra_bytes", np.dtype("u1"), at, header.point_bytes - at))
    check_numbers(path, "byte 105", sum(part.count for part in fields))
    return fields


def _extra_field(data: bytes, at: int, path: Path | str) -> _Field:
    kind, options = data[2], data[3]
    name = data[4:36].partition(b"\0")[0].decode("utf-8", errors="replace")
    where = "the record LASF_Spec 4"
    if not name or not name.isprintable() or kind > 30 or (kind == 0 and not options):
        expected = "a name and a type from 0 to 30 for each of the extra bytes"
        raise FileFormatError(path, where=where, expected=expected, got=f"{name!r} of type {kind}"[:80], fix=_FIX)
    check_name(path, where, name)
    if kind == 0:
        return _Field(name, np.dtype("u1"), at, options)
    dtype = np.dtype(_EXTRA_TYPES[(kind - 1) % 10])
    wide = {"u": "<u8", "i": "<i8", "f": "<f8"}[dtype.kind]
    no_data = np.frombuffer(data, wide, 1, 40)[0].item() if options & 1 else None
    factor = struct.unpack_from("<d", data, 112)[0] if options & 8 else 1.0
    added = struct.unpack_from("<d", data, 136)[0] if options & 16 else 0.0
    if not (np.isfinite([factor, added]).all() and factor):
        actual = f"{factor} and {added}"
        raise FileFormatError(path, where=f"{where}, {name}", expected="a scale and an offset", got=actual, fix=_FIX)
    return _Field(name, dtype, at, (kind - 1) // 10 + 1, (factor, added) if options & 24 else None, no_data)


def _cloud(rows: UInt8[np.ndarray, "n bytes"], fields: list[_Field], header: LasHeader, path: Path | str) -> LasCloud:
    raw = {part.name: _values(rows, part) for part in fields}
    columns: dict[str, np.ndarray] = {}
    for axis, scale, offset in zip("xyz", header.scale_m, header.offset_m, strict=True):
        columns[axis] = raw.pop(axis.upper()) * scale + offset
    _check_bounds(columns, header, path)
    columns["intensity"] = raw.pop("intensity")
    columns |= _flags(raw, header.point_format >= _FIRST_NEW)
    columns |= raw
    remarks = _counted(columns["return_number"], header, path)
    withheld = columns.pop("withheld") != 0
    if withheld.any():
        deleted = count_of(int(withheld.sum()), "point")
        remarks.append(f"{path}: {deleted} of {len(withheld)} marked as withheld (deleted): left out")
        columns = {name: values[~withheld] for name, values in columns.items()}
    if "gps_time" in columns and len(columns["gps_time"]):
        times, remark = _times(columns["gps_time"], bool(header.encoding & _ADJUSTED_TIME), path)
        columns |= times
        remarks += [remark] if remark else []
    return LasCloud(columns, tuple(remarks), header.records)


def _values(rows: UInt8[np.ndarray, "n bytes"], part: _Field) -> Shaped[np.ndarray, "..."]:
    width = part.count * part.dtype.itemsize
    values = np.ascontiguousarray(rows[:, part.offset : part.offset + width]).view(part.dtype)
    values = values[:, 0] if part.count == 1 else values
    values = values.astype(part.dtype.newbyteorder("="), copy=False)
    if part.scale is None and part.no_data is None:
        return values
    factor, added = part.scale or (1.0, 0.0)
    numbers = values.astype(np.float64) * factor + added
    return numbers if part.no_data is None else np.where(values == part.no_data, np.nan, numbers)


def _flags(raw: dict[str, np.ndarray], is_new: bool) -> dict[str, np.ndarray]:
    """Return numbers, classification, flags and the scan angle of their packed bytes, which are taken from the rest."""
    returns = raw.pop("returns")
    if is_new:
        flags = raw.pop("flags")
        return {
            "return_number": returns & 15,
            "number_of_returns": returns >> 4,
            "synthetic": flags & 1,
            "key_point": flags >> 1 & 1,
            "withheld": flags >> 2 & 1,
            "overlap": flags >> 3 & 1,
            "scanner_channel": flags >> 4 & 3,
            "scan_direction_flag": flags >> 6 & 1,
            "edge_of_flight_line": flags >> 7,
            "scan_angle_deg": (raw.pop("angle") * _ANGLE_STEP_DEG).astype(np.float32),
        }
    kind = raw.pop("class")
    return {
        "return_number": returns & 7,
        "number_of_returns": returns >> 3 & 7,
        "scan_direction_flag": returns >> 6 & 1,
        "edge_of_flight_line": returns >> 7,
        "classification": kind & 31,
        "synthetic": kind >> 5 & 1,
        "key_point": kind >> 6 & 1,
        "withheld": kind >> 7,
        "scan_angle_deg": raw.pop("rank").astype(np.float32),
    }


def _check_bounds(columns: Mapping[str, np.ndarray], header: LasHeader, path: Path | str) -> None:
    """See that all points lie where the header says: packed points have no checksum, and damaged ones lie anywhere."""
    low, high = np.array(header.low_m), np.array(header.high_m)
    if not (low.any() or high.any()) or not header.points:  # a header that nobody filled in
        return
    slack = np.abs(header.scale_m) + 1e-6 * np.maximum(np.abs(low), np.abs(high))
    for axis, name in enumerate("xyz"):
        values = columns[name]
        if not low[axis] - slack[axis] <= values.min() <= values.max() <= high[axis] + slack[axis]:
            raise FileFormatError(
                path,
                where="byte 179",
                expected=f"points whose {name} is {low[axis]:.9g} to {high[axis]:.9g}, as the header says",
                got=f"{values.min():.9g} to {values.max():.9g}",
                fix="The points are damaged, or the header is wrong: fetch the file again, or write it anew.",
            )


def _counted(returns: UInt8[np.ndarray, " n"], header: LasHeader, path: Path | str) -> list[str]:
    """Compare the points with the header's counts by return: packed ones must agree, since their bytes tell no number.

    Counts that nobody filled in, or of points that have no return number, tell nothing.
    """
    counts = np.bincount(returns, minlength=16)
    if not any(header.by_return) or counts[0] or counts[len(header.by_return) + 1 :].any():
        return []
    actual = tuple(counts[1 : len(header.by_return) + 1].tolist())
    if actual == header.by_return:
        return []
    if header.packed:
        expected, fix = f"points by return: {header.by_return}", "The points are damaged, or the header is wrong."
        raise FileFormatError(path, where="the points", expected=expected, got=f"{actual}", fix=fix)
    return [f"{path}: its header counts {header.by_return} points by return, its points are {actual}"]


def _times(gps_time: Float[np.ndarray, " n"], adjusted: bool, path: Path | str) -> tuple[dict[str, np.ndarray], str]:
    """The points' times in nanoseconds where they are those of a sweep, and what is wrong with them, if anything is."""
    if not np.isfinite(gps_time).all():
        got = "others"
        raise FileFormatError(path, where="gps_time", expected="finite numbers", got=got, fix=_FIX)
    first, span = float(gps_time.min()), float(np.ptp(gps_time))
    if span == 0:
        return {}, ""
    low, high = (-_ADJUSTED_BY_S, _MOST_ADJUSTED_S) if adjusted else (0.0, _WEEK_S)
    if not low <= first <= first + span <= high:
        kind = "adjusted GPS seconds" if adjusted else "seconds of a GPS week"
        return {}, (
            f"{path}: gps_time is {first:.9g} to {first + span:.9g}, which are no {kind}, as the header says: it is "
            "left as it is; --point-times s, ms, us or ns takes it for the points' times"
        )
    if span > _MOST_SWEEP_S:
        return {}, ""
    since_first = np.rint((gps_time - first) * 1e9).astype(np.int64)
    whole = int(np.floor(first))
    gps_s = whole + _ADJUSTED_BY_S + _GPS_EPOCH_S
    ahead = next((seconds for since, seconds in _LEAP_SECONDS if gps_s - seconds >= since), None)
    if not adjusted or ahead is None:
        return {"offset_ns": since_first}, ""
    start_ns = (gps_s - ahead) * 1_000_000_000 + round((first - whole) * 1e9)
    return {"timestamp_ns": start_ns + since_first}, ""
