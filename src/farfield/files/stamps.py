"""Lists of time stamps as text, read in blocks into whole nanoseconds; no number passes through floating point.

Forms: one number a line, with or without a header; a column of a CSV with a header; KITTI raw's dates
(``2011-09-26 13:02:25.964389445``: local time without a zone, taken as UTC), also with a zone (``Z``, ``+02:00``);
RADIATE's ``Frame: 000001 Time: s.ns``.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Int64, Shaped

from farfield.errors import FileFormatError
from farfield.files.limits import open_file
from farfield.files.remote_paths import as_path
from farfield.files.stand_ins import check_itself

Unit = Literal["auto", "s", "ms", "us", "ns"]
BLOCK_BYTES = 1 << 20
LONGEST_LINE = 4096
_DIGITS = {"s": 9, "ms": 6, "us": 3, "ns": 0}
_NUMBER = re.compile(rb"-?\d{1,19}(?:\.\d{1,30})?\s*$")
_DATE = re.compile(rb"\d{4}-\d\d-\d\d[ T]\d\d:\d\d:\d\d(?:\.\d{1,9})?(Z|[+-]\d\d:?\d\d)?\s*$")
_RADIATE = re.compile(rb"Frame: \d{1,9} Time: \d{1,12}\.\d{1,9}\s*$")
_COLUMNS = ("time_ns", "timestamp_ns", "stamp_ns", "time_us", "time_ms", "time_s", "timestamp", "stamp", "time", "t")
_NAMED = re.compile(r"[1-9][0-9]{15,18}")
_LATEST_NS = 5 * 10**18 - 1  # leaves room to add a tolerance
_SUFFIX = re.compile(r"_(ns|us|ms|s)$")

Stamps = Int64[np.ndarray, " _"]


@dataclass(frozen=True)
class StampList:
    """A list of stamps that was recognised, and how it is read.

    Args:
        path: The file.
        form: ``number``, ``csv``, ``date`` or ``radiate``.
        unit: Unit of the numbers.
        guessed: Whether the unit was guessed from the size of the first number.
        header: Whether the first line is a header.
        column: The column of a CSV.
        zoned: Whether dates have a zone.
    """

    path: Path
    form: Literal["number", "csv", "date", "radiate"]
    unit: Literal["s", "ms", "us", "ns"] = "s"
    guessed: bool = False
    header: bool = False
    column: int = 0
    zoned: bool = False


def recognise_stamps(path: Path | str, *, unit: Unit = "auto") -> StampList | None:
    """Say how a text file's stamps are read, or None where it is no list of stamps.

    Integers without a unit in the header are taken as the unit that :func:`_unit_of` gives their digits, numbers
    with a point as seconds.

    Raises:
        FileFormatError: If it is a list of whole numbers that fit no unit.
    """
    path = as_path(path)
    check_itself(path)
    with open_file(path, max_bytes=None) as handle:
        first, second = handle.readline(LONGEST_LINE), handle.readline(LONGEST_LINE)
    if _RADIATE.match(first):
        return StampList(path, "radiate")
    if (date := _DATE.match(first)) is not None:
        return StampList(path, "date", zoned=date[1] is not None)
    if _NUMBER.match(first):
        return StampList(path, "number", *_unit(path, "", first, unit))
    names = first.decode("utf-8", "replace").strip().lower().split(",")
    column = next((names.index(name) for name in _COLUMNS if name in names), None)
    values = second.strip().split(b",")
    if column is None or len(values) != len(names) or not _NUMBER.match(values[column]):
        return None
    form: Literal["number", "csv"] = "number" if len(names) == 1 else "csv"
    return StampList(path, form, *_unit(path, names[column], values[column], unit), header=True, column=column)


def _unit(path: Path, name: str, number: bytes, unit: Unit) -> tuple[Literal["s", "ms", "us", "ns"], bool]:
    if unit != "auto":
        return unit, False
    if (suffix := _SUFFIX.search(name)) is not None:
        return suffix.group(1), False  # type: ignore[return-value]
    if b"." in number:
        return "s", False
    size = len(number.strip().lstrip(b"-"))
    if (of_size := _unit_of(size)) is not None:
        return of_size, True
    raise FileFormatError(
        path, where="the first stamp", expected="a number whose unit shows: Unix time, or seconds with a point",
        got=number.decode("ascii", "replace").strip(), fix="Say the unit: --unit ns, us, ms or s.",
    )  # fmt: skip


def _unit_of(digits: int) -> Literal["s", "ms", "us", "ns"] | None:
    """The unit in which a whole number of so many digits is a time after 1973 (of 17, after May 1970); None for few."""
    sizes: tuple[tuple[Literal["s", "ms", "us", "ns"], int], ...] = (("ns", 17), ("us", 15), ("ms", 12), ("s", 9))
    return next((unit for unit, least in sizes if digits >= least), None)


def name_time_ns(name: str) -> int | None:
    """Unix time in nanoseconds that the name of a file or frame is, by the rule of lists of stamps; None if it is none.

    Names of 16 to 19 digits are times; shorter ones, and those that begin with 0, are numbers of frames.

    >>> name_time_ns("1558131117608556768"), name_time_ns("1558131117608556"), name_time_ns("0000000000000001")
    (1558131117608556768, 1558131117608556000, None)
    """
    unit = _unit_of(len(name)) if _NAMED.fullmatch(name) else None
    time_ns = None if unit is None else int(name) * 10 ** _DIGITS[unit]
    return time_ns if time_ns is not None and time_ns <= _LATEST_NS else None


def read_stamps(stamps: StampList) -> Iterator[Int64[np.ndarray, " _"]]:
    """Read a list block by block, in the order in which it was written.

    Raises:
        FileFormatError: If a line has another form, or a stamp does not fit.
    """
    if stamps.form == "radiate":
        from farfield.files.radiate import read_times

        times = list(read_times(stamps.path).values())
        late = next((line for line, time in enumerate(times, start=1) if time > _LATEST_NS), None)
        if late is not None:
            raise _wrong(stamps.path, late, "a stamp before the year 2116", f"{times[late - 1]} ns")
        yield np.array(times, dtype=np.int64)
        return
    for number, block in _blocks(stamps.path, stamps.header):
        if stamps.form == "date":
            yield _dates(stamps, number, block)
        elif stamps.form == "csv":
            yield _numbers(stamps, number, _column(stamps, number, block))
        else:
            yield _numbers(stamps, number, block)


def _blocks(path: Path, header: bool) -> Iterator[tuple[int, bytes]]:
    """Whole lines, at least one, with the number of the first; the last ends with a newline."""
    number, rest = 1, b""
    with open_file(path, max_bytes=None) as handle:
        if header:
            handle.readline(LONGEST_LINE)
            number = 2
        while piece := handle.read(BLOCK_BYTES):
            end = piece.rfind(b"\n") + 1
            if not end and len(rest) + len(piece) > LONGEST_LINE:
                raise _wrong(path, number, f"lines of at most {LONGEST_LINE} bytes", "a longer one")
            if end:
                block = (rest + piece[:end]).replace(b"\r\n", b"\n")
                yield number, block
                number += block.count(b"\n")
                rest = piece[end:]
            else:
                rest += piece
    if rest.strip():
        yield number, rest.replace(b"\r", b"") + b"\n"


def _numbers(stamps: StampList, number: int, block: bytes) -> Stamps:
    """One number a line, all lines of one shape (length, place of the point) at once."""
    text = np.frombuffer(block, dtype=np.uint8)
    ends = np.flatnonzero(text == ord("\n"))
    starts = np.concatenate([[0], ends[:-1] + 1])
    lines = np.arange(len(ends))[ends > starts]
    starts, ends = starts[lines], ends[lines]
    negative = text[starts] == ord("-")
    starts = starts + negative
    points = np.flatnonzero(text == ord("."))
    first = np.searchsorted(points, starts)
    count = np.searchsorted(points, ends) - first
    at = np.full(len(starts), 1 << 40)
    at[count > 0] = points[first[count > 0]]
    digits = np.minimum(at, ends) - starts
    length = ends - starts
    values = np.empty(len(starts), dtype=np.int64)
    wrong = (count > 1) | (length > 50) | (digits < 1) | (length == digits + 1)
    for shape in np.unique(np.minimum(length, 63) * 64 + np.minimum(digits, 63)):
        rows = np.flatnonzero((np.minimum(length, 63) * 64 + np.minimum(digits, 63) == shape) & ~wrong)
        if len(rows):
            wrong[rows] = ~_fill(values, rows, text, starts, int(length[rows[0]]), int(digits[rows[0]]), stamps.unit)
    if wrong.any():
        line = int(lines[np.argmax(wrong)])
        shown = block.split(b"\n")[line][:60].decode("utf-8", "replace")
        raise _wrong(stamps.path, number + line, f"a stamp in {stamps.unit} between the years 1823 and 2116", shown)
    return np.where(negative, -values, values)


def _fill(
    stamps_list: Stamps,
    rows: Stamps,
    text: Shaped[np.ndarray, " _"],
    starts: Stamps,
    length: int,
    digit_count: int,
    unit: str,
) -> Shaped[np.ndarray, " _"]:
    """Numbers of one shape; digits below a nanosecond are cut. Says which are numbers that fit."""
    scale = _DIGITS[unit]
    digits = text[starts[rows][:, None] + np.arange(length)].astype(np.int64) - ord("0")
    shown = np.delete(digits, digit_count, axis=1) if digit_count < length else digits
    sound = ((shown >= 0) & (shown <= 9)).all(axis=1)
    used = shown[:, : digit_count + scale]
    exponents = digit_count + scale - 1 - np.arange(used.shape[1])
    fits = exponents <= 18
    sound &= ~(used[:, ~fits] != 0).any(axis=1)
    sound &= ~((used[:, exponents == 18] > 4).any(axis=1))  # below 5e18: 158 years
    stamps_list[rows] = used[:, fits] @ 10 ** exponents[fits]
    return sound


def _column(stamps: StampList, number: int, block: bytes) -> bytes:
    """One column of a CSV as lines."""
    rows = [line.split(b",") for line in block.split(b"\n")[:-1]]
    short = next((row_index for row_index, row in enumerate(rows) if row != [b""] and len(row) <= stamps.column), None)
    if short is not None:
        raise _wrong(stamps.path, number + short, f"{stamps.column + 1} columns or more", f"{len(rows[short])}")
    return b"\n".join(row[stamps.column].strip() if row != [b""] else b"" for row in rows) + b"\n"


def _dates(stamps: StampList, number: int, block: bytes) -> Stamps:
    path, texts, offsets_ns = stamps.path, [], []
    for row, line in enumerate(block.split(b"\n")[:-1]):
        if not line.strip():
            continue
        date = _DATE.match(line)
        if date is None:
            raise _wrong(path, number + row, "a date such as 2011-09-26 13:02:25.964389445", repr(line[:60]))
        if (date[1] is not None) != stamps.zoned:
            expected = "a zone in every line, or in none, as in the first"
            raise _wrong(path, number + row, expected, repr(line.strip()[:60].decode("ascii")))
        zone = (date[1] or b"Z").decode("ascii").replace(":", "")
        text = line.strip().decode("ascii").replace(" ", "T")
        texts.append(text.removesuffix((date[1] or b"").decode("ascii")))
        minutes = 0 if zone == "Z" else int(zone[1:3]) * 60 + int(zone[3:])
        offsets_ns.append((-1 if zone.startswith("-") else 1) * minutes * 60_000_000_000)
    try:
        dates = np.array(texts, dtype="datetime64[ns]")
    except ValueError as error:
        raise _wrong(path, number, "dates of the calendar", str(error)[:80]) from error
    outside = [text for text in texts if not "1823" < text[:4] < "2116"]
    if outside:
        raise _wrong(path, number, "dates between the years 1823 and 2116", outside[0])
    return dates.astype(np.int64) - np.array(offsets_ns, dtype=np.int64)


def _wrong(path: Path, line: int, expected: str, actual: str) -> FileFormatError:
    return FileFormatError(path, where=f"line {line}", expected=expected, got=actual)
