"""Boxes of any detector as comma-separated text with a header line.

Columns, in any order: ``sequence`` (may be absent), ``frame``, ``label``, ``x``, ``y``, ``z`` (centre, metres, x
forward, y left, z up), ``l``, ``w``, ``h`` (full sizes, metres), ``yaw_rad`` (counter-clockwise from +x), ``score``
(empty or absent for annotated boxes); also ``track_id`` and ``point_count`` (both may be absent), and the velocity over
ground ``vx_m_s``, ``vy_m_s`` and perhaps ``vz_m_s`` along the same axes (empty in a row where it is not known), and
``doppler_m_s``, a radar's radial velocity relative to the sensor, away from it positive (likewise); and ``reference``,
the sensor in whose coordinates the boxes stand, the same in every row.
"""

import csv
import io
import math
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int, Shaped

from farfield.errors import ConfigError, FileFormatError, plain
from farfield.files.atomic import open_atomic, read_bytes
from farfield.files.limits import check_name

MOST_COUNT = 1 << 53
"""Whole numbers from here on are not all told apart in float64."""
_NUMBERS = ("x", "y", "z", "l", "w", "h", "yaw_rad")
_LEAST_M = 1e-4
_MOST = {"x": 1e7, "y": 1e7, "z": 1e7, "l": 1e6, "w": 1e6, "h": 1e6, "yaw_rad": 1e3}
"""Beyond the coordinates of any map, sizes in millimetres, and any turn; velocities: 1e6 m/s."""
_FASTEST_M_S = 1e6
_NEEDED = ("frame", "label", *_NUMBERS)
_WORDS = ("sequence", "frame", "label", "reference")
_COUNTS = ("track_id", "point_count")
_VELOCITY = ("vx_m_s", "vy_m_s", "vz_m_s")
_DOPPLER = "doppler_m_s"
_OPTIONAL = ("sequence", "score", *_COUNTS, _DOPPLER, "reference")
COLUMNS = ("sequence", *_NEEDED, "score", *_COUNTS, *_VELOCITY, _DOPPLER, "reference")


@dataclass(frozen=True, eq=False, kw_only=True)
class BoxRows:
    """Boxes of one or many frames, one row a box.

    Args:
        frame: Name of the frame, shape (n,).
        label: Class names, shape (n,).
        centre_m: x, y, z, shape (n, 3).
        size_m: Length, width, height, all positive, shape (n, 3).
        yaw_rad: Heading, shape (n,).
        sequence: Name of the sequence, shape (n,), or None where the file has no such column.
        score: Shape (n,), or None where no row has one.
        track_id: Shape (n,), or None; -1 where a row has none.
        point_count: Shape (n,), or None; -1 where a row has none.
        velocity_m_s: Velocity over ground, x, y and perhaps z, shape (n, 2) or (n, 3), or None; NaN where a row has
            none.
        doppler_m_s: Radial velocity relative to the sensor, away from it positive, shape (n,), or None; NaN likewise.
        reference: Sensor in whose coordinates the boxes stand, shape (n,), one name for all; None where not known.
    """

    frame: Shaped[np.ndarray, " n"]
    label: Shaped[np.ndarray, " n"]
    centre_m: Float[np.ndarray, "n 3"]
    size_m: Float[np.ndarray, "n 3"]
    yaw_rad: Float[np.ndarray, " n"]
    sequence: Shaped[np.ndarray, " n"] | None = None
    score: Float[np.ndarray, " n"] | None = None
    track_id: Int[np.ndarray, " n"] | None = None
    point_count: Int[np.ndarray, " n"] | None = None
    velocity_m_s: Float[np.ndarray, "n axes"] | None = None
    doppler_m_s: Float[np.ndarray, " n"] | None = None
    reference: Shaped[np.ndarray, " n"] | None = None

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def stands_in(self) -> str:
        """The reference of all rows; empty where it is not known."""
        return str(self.reference[0]) if self.reference is not None and len(self.reference) else ""


def read_boxes_csv(path: Path | str) -> BoxRows:
    """Read boxes of any detector, or annotated boxes.

    Raises:
        FileFormatError: If the header lacks a column or has an unknown one, or a row holds anything but finite numbers
            and positive sizes, or only some rows have a score, or a row has a part of a velocity, or two have different
            references.
    """
    return parse_boxes_csv(read_bytes(path), path)


def parse_boxes_csv(data: bytes, path: Path | str) -> BoxRows:
    """Parse the content of such a file; ``path`` is for messages, errors are those of :func:`read_boxes_csv`."""
    rows = _csv_rows(path, _decoded(data, path))
    header = [name.strip() for name in next(rows, (1, []))[1]]
    _check_header(path, header)
    numbers = {name: array("d") for name in COLUMNS if name in header and name not in _WORDS}
    texts: dict[str, list[str]] = {name: [] for name in _WORDS if name in header}
    spellings: dict[tuple[str, str], str] = {}
    interned: dict[str, str] = {}  # one string a name, however many rows bear it
    for line, row in rows:
        if len(row) != len(header):
            raise _wrong(path, line, f"{len(header)} columns as in the header", str(len(row)))
        if [text.strip() for text in row] == header:
            fix = "Tables were joined with their headers: leave one header, in the first line."
            raise FileFormatError(path, where=f"line {line}", expected="a box", got="the header again", fix=fix)
        for name, text in zip(header, row, strict=True):
            written, text = text, text.strip()
            if name in texts:
                if not text or not text.isprintable():
                    raise _wrong(path, line, f"a {name} on one line", repr(text[:40]) if text else "an empty cell")
                check_name(path, f"line {line}, {name}", text)
                if name in ("sequence", "frame") and spellings.setdefault((name, text), written) != written:
                    expected = f"each {name} spelt in one way: blanks about a name are no part of it"
                    raise _wrong(path, line, expected, f"{written!r} and {spellings[name, text]!r}")
                texts[name].append(interned.setdefault(text, text))
            else:
                numbers[name].append(_number(path, line, name, text))
    return _assemble(path, texts, {name: np.array(values, dtype=np.float64) for name, values in numbers.items()})


def zeros_note(names: Iterable[str], others: Iterable[str]) -> str:
    """That names differ from others by zeros before them alone, as a sentence; empty where they do not.

    >>> zeros_note(["7"], ["0007", "0008"])
    "Some differ by leading zeros alone, such as '7' and '0007': a spreadsheet drops them."
    """
    by_number = {name.lstrip("0"): name for name in others if name.isascii() and name.isdigit()}
    for name in names:
        other = by_number.get(name.lstrip("0")) if name.isascii() and name.isdigit() else None
        if other is not None and other != name:
            return f"Some differ by leading zeros alone, such as {name!r} and {other!r}: a spreadsheet drops them."
    return ""


def write_boxes_csv(path: Path | str, rows: BoxRows) -> None:
    """Write boxes with full precision; columns that are None are left out, except ``score``, which is left empty."""
    write_boxes_csv_parts(path, [rows])


def write_boxes_csv_parts(path: Path | str, parts: Iterable[BoxRows]) -> None:
    """Write boxes part by part, such as one frame each, so that all need never be in memory.

    Raises:
        ValueError: If a part lacks a column that the first part with boxes has.
    """
    with open_atomic(path) as handle:
        for text in format_boxes_csv_parts(parts):
            handle.write(text.encode())


def format_boxes_csv_parts(parts: Iterable[BoxRows]) -> Iterator[str]:
    """The text that :func:`write_boxes_csv_parts` writes, piece by piece; errors are the same."""
    names, begun = [*_NEEDED, "score"], False
    for part in parts:
        names = names if begun else _columns(part)
        missing = set(names) - {*_columns(part)} if len(part) else set()
        if missing:
            raise ValueError(f"write_boxes_csv: {', '.join(sorted(missing))} present in some parts only")
        if len(part):
            yield _text(None if begun else names, _cells(part, names))
            begun = True
    if not begun:
        yield _text(names, [])


def _columns(rows: BoxRows) -> list[str]:
    velocity = 0 if rows.velocity_m_s is None else rows.velocity_m_s.shape[1]
    present = {name for name in _OPTIONAL if getattr(rows, name) is not None} | {*_VELOCITY[:velocity]}
    return [name for name in COLUMNS if name in _NEEDED or name == "score" or name in present]


def _cells(rows: BoxRows, names: Sequence[str]) -> Iterable[Sequence[object]]:
    velocity = {} if rows.velocity_m_s is None else _velocity_cells(rows.velocity_m_s)
    table: dict[str, Iterable[object]] = {name: [""] * len(rows) for name in names}
    table |= {"frame": rows.frame.tolist(), "label": rows.label.tolist(), "yaw_rad": rows.yaw_rad.tolist()}
    table |= dict(zip("xyz", rows.centre_m.T.tolist(), strict=True)) if len(rows) else {}
    table |= dict(zip("lwh", rows.size_m.T.tolist(), strict=True)) if len(rows) else {}
    for name in _OPTIONAL:
        values = getattr(rows, name)
        if values is not None:
            table[name] = values.tolist()
    if rows.doppler_m_s is not None:
        table[_DOPPLER] = ["" if math.isnan(value) else value for value in rows.doppler_m_s.tolist()]
    table |= velocity
    return zip(*(table[name] for name in names), strict=True)


def _text(header: Sequence[str] | None, cells: Iterable[Sequence[object]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    if header is not None:
        writer.writerow(header)
    writer.writerows(cells)
    return text.getvalue()


def _velocity_cells(velocity_m_s: Float[np.ndarray, "n axes"]) -> dict[str, list[object]]:
    """Columns of velocities, empty where any part of one is not known."""
    cells = velocity_m_s.astype(object)
    cells[np.isnan(velocity_m_s).any(axis=1)] = ""
    return dict(zip(_VELOCITY, cells.T.tolist(), strict=False))


def _wrong(path: Path | str, line: int, expected: str, actual: str) -> FileFormatError:
    return FileFormatError(path, where=f"line {line}", expected=expected, got=actual)


def _decoded(data: bytes, path: Path | str) -> str:
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        actual = f"byte 0x{error.object[error.start]:02x}: {plain(error)}"
        raise FileFormatError(path, where=f"byte {error.start}", expected="UTF-8 text", got=actual) from None


def _csv_rows(path: Path | str, text: str) -> Iterator[tuple[int, list[str]]]:
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    try:
        for row in reader:
            if row:
                yield reader.line_num, row
    except csv.Error as error:
        raise _wrong(path, reader.line_num, "comma-separated text", str(error)) from None


def _check_header(path: Path | str, header: list[str]) -> None:
    missing = [name for name in _NEEDED if name not in header]
    unknown = [name for name in header if name not in COLUMNS]
    actual = f"{', '.join(header)[:200]}" if header else "an empty file"
    if missing or unknown or len(set(header)) < len(header):
        perhaps = ", ".join((*_OPTIONAL, *_VELOCITY))
        raise FileFormatError(
            path,
            where="line 1",
            expected=f"a header with each of {', '.join(_NEEDED)} once (and perhaps {perhaps})",
            got=actual,
            fix=_fix(header, missing),
        )
    axes = [name for name in _VELOCITY if name in header]
    if axes and axes[:2] != list(_VELOCITY[:2]):
        raise FileFormatError(path, where="line 1", expected="vx_m_s and vy_m_s, or no velocities", got=actual)


def _fix(header: list[str], missing: list[str]) -> str:
    if len(header) == 1:
        for letter, word in ((";", "semicolons"), ("\t", "tabs"), (" ", "blanks")):
            if letter in header[0]:
                return f"Its columns are separated by {word}: separate them by commas, with points in numbers."
    renamed = [f"rename {name!r} to {needed!r}" for needed in missing for name in header if _means(name, needed)]
    advice = f" Perhaps {', '.join(renamed)}." if renamed else ""
    return f"Missing: {', '.join(missing)}.{advice}" if missing else ""


_ALIKE = {
    "frame": ("frame_id", "file", "filename", "stem", "sample"),
    "label": ("class", "class_name", "name", "category", "type"),
    "x": ("x_m", "cx", "center_x", "centre_x", "tx"),
    "y": ("y_m", "cy", "center_y", "centre_y", "ty"),
    "z": ("z_m", "cz", "center_z", "centre_z", "tz"),
    "l": ("length", "length_m", "dx"),
    "w": ("width", "width_m", "dy"),
    "h": ("height", "height_m", "dz"),
    "yaw_rad": ("yaw", "heading", "rotation", "rotation_z", "rot_z", "theta", "rz"),
}
"""What others call the columns."""


def _means(name: str, needed: str) -> bool:
    return name.strip().lower() in _ALIKE.get(needed, ())


def _number(path: Path | str, line: int, name: str, text: str) -> float:
    if not text and name in (*_OPTIONAL, *_VELOCITY):
        return -1.0 if name in _COUNTS else math.nan
    try:
        value = float(text) if text.isascii() and "_" not in text else math.nan
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise _wrong(path, line, f"a finite number as {name}", repr(text[:40]))
    if name in "lwh" and value < _LEAST_M:
        raise _wrong(path, line, f"a positive size as {name}, {_LEAST_M:g} m or more", text[:40])
    most = _MOST.get(name, _FASTEST_M_S)
    if name in (*_NUMBERS, *_VELOCITY, _DOPPLER) and abs(value) > most:
        raise _wrong(path, line, f"a number within {most:g} as {name}", text[:40])
    if name in _COUNTS and (value != round(value) or abs(value) >= MOST_COUNT):
        raise _wrong(path, line, f"a whole number as {name}, below 2^53", text[:40])
    return value


def _assemble(path: Path | str, texts: dict[str, list[str]], numbers: dict[str, np.ndarray]) -> BoxRows:
    score = numbers.get("score")
    if score is not None and np.isnan(score).any():
        if not np.isnan(score).all():
            raise FileFormatError(
                path, where="column score", expected="a score in every row or in none", got="both kinds of rows"
            )
        score = None
    names = {name: np.array(values, dtype=np.str_) if values else np.empty(0, "<U1") for name, values in texts.items()}
    counts = {name: numbers[name].astype(np.int64) for name in _COUNTS if name in numbers}
    references = sorted(set(texts.get("reference", ())))
    if len(references) > 1:
        expected, actual = (
            "one reference in all rows: the boxes of a file share their coordinates",
            ", ".join(references),
        )
        raise FileFormatError(path, where="column reference", expected=expected, got=actual[:80])
    return BoxRows(
        frame=names["frame"],
        label=names["label"],
        sequence=names.get("sequence"),
        centre_m=np.column_stack([numbers[name] for name in "xyz"]),
        size_m=np.column_stack([numbers[name] for name in "lwh"]),
        yaw_rad=numbers["yaw_rad"],
        score=score,
        track_id=counts.get("track_id"),
        point_count=counts.get("point_count"),
        velocity_m_s=_velocity(path, numbers),
        doppler_m_s=numbers.get(_DOPPLER),
        reference=names.get("reference"),
    )


def _velocity(path: Path | str, numbers: dict[str, np.ndarray]) -> Float[np.ndarray, "n axes"] | None:
    columns = [numbers[name] for name in _VELOCITY if name in numbers]
    if not columns:
        return None
    velocity = np.column_stack(columns)
    unknown = np.isnan(velocity)
    torn = np.flatnonzero(unknown.any(axis=1) != unknown.all(axis=1))
    if len(torn):
        expected = f"{', '.join(_VELOCITY[: len(columns)])} all with a number or all empty"
        raise FileFormatError(path, where=f"box {torn[0] + 1}", expected=expected, got="both kinds of cells")
    return velocity


# Boxes as named columns, rows of numbers and CSV files, and the other way; what is returned are fields of a Boxes.

_PLACES, _SIZES, _VELOCITY_COLUMNS = ("x", "y", "z"), ("l", "w", "h"), ("vx_m_s", "vy_m_s", "vz_m_s")
_COUNT_COLUMNS = ("track_id", "point_count")
_NEEDED_COLUMNS = ("label", *_PLACES, *_SIZES, "yaw_rad")
_KEY = ("sequence", "frame")
_MOST_RAD = 6.3  # a little over a whole turn: beyond it an angle is more likely one in degrees

Fields = dict[str, Any]


@runtime_checkable
class BoxColumns(Protocol):
    """Columns by name: a dictionary, or a DataFrame, which is no Mapping."""

    def keys(self) -> Iterable[Any]:
        """Their names."""

    def __getitem__(self, name: Any, /) -> Any:
        """One of them."""


def columns_of(boxes: Mapping[str, Any]) -> dict[str, Shaped[np.ndarray, " n"]]:
    """The fields of boxes as columns, named as in our CSV files; those that are None are left out."""
    table = {"label": boxes["label"]}
    table |= dict(zip(_PLACES, boxes["centre_m"].T, strict=True)) | dict(zip(_SIZES, boxes["size_m"].T, strict=True))
    table["yaw_rad"] = boxes["yaw_rad"]
    table |= {name: boxes[name] for name in ("score", *_COUNT_COLUMNS) if boxes[name] is not None}
    if boxes["velocity_m_s"] is not None:
        table |= dict(zip(_VELOCITY_COLUMNS, boxes["velocity_m_s"].T, strict=False))
    return table


def fields_of(table: BoxColumns) -> Fields:
    """Fields of boxes from a table of named columns: a dictionary, a DataFrame, a structured array's columns.

    Raises:
        ConfigError: If a column is missing, the boxes are those of several frames, or yaw stands in degrees.
    """
    names = [str(name) for name in table.keys()]  # noqa: SIM118 - what has columns need not iterate over them
    missing = [name for name in _NEEDED_COLUMNS if name not in names]
    if missing:
        raise ConfigError(
            f"Boxes: expected the columns {', '.join(_NEEDED_COLUMNS)}; missing: {', '.join(missing)}"
            f" of {', '.join(names)}."
        )
    _check_one_frame(
        "Boxes", {name: np.asarray(table[name]) for name in _KEY if name in names}, "select the rows of one frame first"
    )
    numbers = {
        name: np.asarray(table[name], dtype=np.float64)
        for name in names
        if name in {*_NEEDED_COLUMNS[1:], "score", *_COUNT_COLUMNS, *_VELOCITY_COLUMNS}
    }
    yaw_rad = _radians(numbers["yaw_rad"])
    axes = [name for name in _VELOCITY_COLUMNS if name in names]
    fields: Fields = {
        "centre_m": np.stack([numbers[name] for name in _PLACES], axis=1),
        "size_m": np.stack([numbers[name] for name in _SIZES], axis=1),
        "yaw_rad": yaw_rad,
        "label": [str(word) for word in np.asarray(table["label"])],
        "score": numbers.get("score"),
        "velocity_m_s": np.stack([numbers[name] for name in axes], axis=1) if len(axes) > 1 else None,
    }
    score = fields["score"]
    if score is not None and len(score) and np.isnan(score).all():
        fields["score"] = None
    # Whole numbers as pandas leaves them where one is missing: -1 there.
    counts = {name: numbers[name] for name in _COUNT_COLUMNS if name in names}
    for name, count in counts.items():
        if np.abs(count[~np.isnan(count)]).max(initial=0) >= MOST_COUNT:
            raise ConfigError(f"Boxes: expected whole numbers below 2^53 as {name}, got one of {count.max():.0f}")
    return fields | {name: np.where(np.isnan(count), -1, count).astype(np.int64) for name, count in counts.items()}


def _radians(yaw: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    if np.abs(yaw).max(initial=0.0) > _MOST_RAD:
        raise ConfigError(
            f"Boxes: expected yaw in radians, got up to {np.abs(yaw).max():g}; np.radians(...) turns degrees into them"
        )
    return yaw


def rows_of(boxes: Shaped[np.ndarray, "n columns"]) -> Fields:
    """Places, sizes and headings from rows x, y, z, length, width, height, yaw.

    Raises:
        ConfigError: If rows have another length, or yaw stands in degrees.
    """
    rows = np.asarray(boxes, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != 7:
        raise ConfigError(f"Boxes: expected shape (n, 7): x, y, z, length, width, height, yaw (rad); got {rows.shape}")
    return {"centre_m": rows[:, :3], "size_m": rows[:, 3:6], "yaw_rad": _radians(rows[:, 6])}


def read_fields(path: Path | str, *, frame: str | None, sequence: str | None) -> Fields:
    """Fields of the boxes of one frame of a CSV file.

    Raises:
        ConfigError: If there are several frames and none is named, or none of that name.
        FileFormatError: If the file is no such file.
    """
    rows = read_boxes_csv(path)
    keep = np.ones(len(rows), dtype=bool)
    for word, name, column in (("sequence", sequence, rows.sequence), ("frame", frame, rows.frame)):
        if name is None:
            continue
        keep &= False if column is None else column == name
        if not keep.any():
            choices = [] if column is None else [str(name) for name in np.unique(column)[:8]]
            raise ConfigError(f"{path}: no boxes of the {word} {name!r}; there are {', '.join(choices) or 'none'}")
    keys = {"frame": rows.frame[keep]} | ({} if rows.sequence is None else {"sequence": rows.sequence[keep]})
    _check_one_frame(str(path), keys, "choose with frame= and sequence=")
    names = ("centre_m", "size_m", "yaw_rad", "label", "score", *_COUNT_COLUMNS, "velocity_m_s")
    return {name: None if getattr(rows, name) is None else getattr(rows, name)[keep] for name in names}


def _check_one_frame(where: str, keys: Mapping[str, Shaped[np.ndarray, " n"]], fix: str) -> None:
    if not keys:
        return
    frames = set(zip(*(map(str, column) for column in keys.values()), strict=True))
    if len(frames) > 1:
        raise ConfigError(f"{where}: expected the boxes of one frame, got {len(frames)}; {fix}")


def write_fields(path: Path | str, boxes: Mapping[str, Any], *, frame: str, sequence: str) -> None:
    """Write boxes as those of one frame."""
    count = len(boxes["yaw_rad"])
    names = {"frame": np.full(count, frame), "sequence": np.full(count, sequence) if sequence else None}
    write_boxes_csv(path, BoxRows(**{**boxes, **names}))
