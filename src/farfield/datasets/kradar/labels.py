"""Annotation files of K-Radar, versions 1.0, 1.1, 2.0 and 2.1.

The first line is the header. Then one object a line: what stands before the class differs by version. Yaw is in degrees
(real files leave +-180), the last three numbers are half the length, width and height, x, y, z the centre in the
os2-64's frame::

    * idx(tesseract_os2-64_cam-front_os1-128_cam-lrr)=00033_00001_00002_00001_00004, timestamp=1643292946.710046076
    *, 5, 5, Sedan, x, y, z, yaw, l/2, w/2, h/2                 v1.0: number, number in the frame before
    *, R, 5, 5, Sedan, ...                                      v1.1
    *, 0, Sedan, ...                                            v2.0: track
    *, R, 0, Sedan, ...                                         v2.1: availability, track
    #, 5, 5, Sedan, x, y, azimuth, l/2, w/2                     v1.0: seen from above only
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Int

from farfield.datasets.kradar.layout import INDEX_NAMES
from farfield.errors import FileFormatError
from farfield.files.atomic import read_bytes
from farfield.files.cuboids import is_name
from farfield.files.limits import check_name
from farfield.frame import Annotation, Boxes, Footprints
from farfield.vocabulary.classes import CIRRUS_FROM_KRADAR, KRADAR_FROM_CIRRUS, normalised_class

MAX_BYTES = 4 << 20
_LARGEST = 1e6
MOST_DEG = 720.0
_OBJECT = re.compile(r"([*#])\s*,")  # an object may stand on the header's line
_HEADER = re.compile(
    r"\*\s*idx\s*\([^)]*\)\s*=\s*(-?\d{1,9})_(-?\d{1,9})_(-?\d{1,9})_(-?\d{1,9})_(-?\d{1,9})\s*,"
    r"\s*timestamp\s*=\s*(\d{1,9}|[0-8]\d{9})(?:\.(\d{1,9})\d*)?\s*"
)
_OLD_HEADER = re.compile(r"\*\s*radar\s+idx\s*:[^\n*#]*")
_AVAILABILITY = {"R": "R", "L": "L", "L1": "L1", "LL": "L", "LR": "L1"}  # LL, LR and l are slips of the pen


@dataclass(frozen=True, eq=False, kw_only=True)
class KRadarLabels:
    """One annotation file.

    Args:
        indices: Index of each sensor's frame by its name (``radar``, ``os2-64``, ``cam-front``, ``os1-128``,
            ``cam-lrr``), or empty where the header has another form.
        time_ns: Time of the os2-64's sweep, or None.
        boxes: The objects; ``track_id`` is v2's track. v1 only numbers the objects of a frame, which identifies none.
        raw_label: Class of each object as written.
        availability: ``R`` (the radar sees it), ``L`` (only the LiDAR does) or ``L1`` (not known) of each object; empty
            in versions that do not say.
        from_above: Class, x, y, azimuth (degrees), and half the length and width of objects without a height.
    """

    boxes: Boxes
    indices: Mapping[str, int] = field(default_factory=dict)
    time_ns: int | None = None
    raw_label: tuple[str, ...] = ()
    availability: tuple[str, ...] = ()
    from_above: tuple[tuple[str, tuple[float, ...]], ...] = ()


def read_labels(path: Path, version: str = "") -> KRadarLabels:
    """Read one annotation file of any version.

    Args:
        path: The file.
        version: The version that its folder names; empty where it is not known.

    Raises:
        FileFormatError: If it is damaged, or has objects of another version.
    """
    return parse_labels(read_bytes(path, max_bytes=MAX_BYTES), path, version)


@dataclass(frozen=True, kw_only=True)
class LabelLine:
    """One object as it stands in the file.

    Args:
        availability: ``R``, ``L``, ``L1``, or nothing where the line does not say.
        numbers: The one or two whole numbers before the class: the track, or its number now and in the frame before.
        name: Class.
        values: x, y, z in metres, yaw in degrees, half the length, width and height.
        slip: Whether the availability was misspelt.
    """

    availability: str
    numbers: tuple[int, ...]
    name: str
    values: tuple[float, ...]
    slip: bool = False


@dataclass(frozen=True, kw_only=True)
class LabelText:
    """One annotation file as it is written; ``usual_header`` and ``merged_header`` describe its first line."""

    indices: Mapping[str, int]
    time_ns: int | None
    lines: tuple[LabelLine, ...]
    from_above: tuple[tuple[str, tuple[float, ...]], ...]
    usual_header: bool
    merged_header: bool


def parse_text(data: bytes, path: Path | str) -> LabelText:
    """Parse the content of an annotation file and change nothing in it; ``path`` is for messages.

    Raises:
        FileFormatError: As :func:`parse_labels`.
    """
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        actual = f"byte 0x{data[error.start]:02x}"
        raise FileFormatError(path, where=f"byte {error.start}", expected="UTF-8 text", got=actual) from None
    marks = list(_OBJECT.finditer(text))
    header = text[: marks[0].start()] if marks else text
    indices, time_ns = _parse_header(header, path)
    lines, above, line, counted = [], [], 1, 0
    for number, mark in enumerate(marks):
        end = marks[number + 1].start() if number + 1 < len(marks) else len(text)
        cells = [cell.strip() for cell in text[mark.end() : end].strip().rstrip(",").split(",")]
        line, counted = line + text.count("\n", counted, mark.start()), mark.start()
        where = f"line {line}"
        if mark[1] == "#":
            above.append(_parse_from_above(cells, path, where))
        else:
            lines.append(_parse_object(cells, path, where))
    return LabelText(
        indices=indices,
        time_ns=time_ns,
        lines=tuple(lines),
        from_above=tuple(above),
        usual_header=time_ns is not None,
        merged_header=bool(marks and header.strip() and "\n" not in header),
    )


def check_version(forms: Iterable[tuple[bool, int]], version: str, path: Path | str) -> None:
    """Refuse objects of another version than the file's: their tracks or availabilities would be lost.

    Args:
        forms: Of each object whether it has an availability, and how many whole numbers.
        version: The file's version; empty where it is not known, so that all objects are to be of one.
        path: The file, for messages.

    Raises:
        FileFormatError: If there is one.
    """
    for number, (flagged, numbers) in enumerate(forms):
        version = version or f"v{3 - numbers}.{int(flagged)}"
        if flagged != version.endswith(".1") or (version.startswith("v2") and numbers > 1):
            before = "R, L or L1, " if version.endswith(".1") else ""
            expected = f"objects of {version}: *, {before}{'a track' if version.startswith('v2') else 'two numbers'}"
            actual = f"{'an' if flagged else 'no'} availability and {numbers} whole numbers"
            raise FileFormatError(path, where=f"object {number}", expected=expected, got=actual)


def parse_labels(data: bytes, path: Path | str, version: str = "") -> KRadarLabels:
    """Parse the content of an annotation file; ``path`` is for messages, ``version`` as of :func:`read_labels`.

    Raises:
        FileFormatError: If the header or an object is not of a form above or of the version, or a number is not finite.
    """
    text = parse_text(data, path)
    check_version(((bool(line.availability), len(line.numbers)) for line in text.lines), version, path)
    table = np.array([line.values for line in text.lines], dtype=np.float64).reshape(-1, 7)
    boxes = Boxes(
        centre_m=table[:, :3],
        size_m=2 * table[:, 4:],
        yaw_rad=np.deg2rad(table[:, 3]),
        label=[normalised_class(line.name, CIRRUS_FROM_KRADAR) for line in text.lines],
        track_id=_tracks(text.lines),
    )
    availability = tuple(line.availability for line in text.lines if line.availability)
    return KRadarLabels(
        boxes=boxes,
        indices=text.indices,
        time_ns=text.time_ns,
        raw_label=tuple(line.name for line in text.lines),
        availability=availability if len(availability) == len(text.lines) else (),
        from_above=text.from_above,
    )


def _tracks(lines: Sequence[LabelLine]) -> Int[np.ndarray, " n"] | None:
    """v2's tracks; None where a line has v1's two numbers, the object's in its frame and in the frame before."""
    if any(len(line.numbers) > 1 for line in lines):
        return None
    return np.array([line.numbers[0] for line in lines], dtype=np.int64)


def footprints(rows: Sequence[tuple[str, tuple[float, ...]]]) -> Footprints:
    """Objects seen from above (class, x, y, azimuth in degrees, half the length and width) in Farfield's units."""
    table = np.array([values for _, values in rows], dtype=np.float64).reshape(-1, 5)
    return Footprints(
        label=tuple(name for name, _ in rows),
        centre_m=table[:, :2],
        size_m=2 * table[:, 3:],
        yaw_rad=np.deg2rad(table[:, 2]),
    )


def annotation_of(labels: KRadarLabels, version: str) -> Annotation:
    """One file's content as an annotation of its version; only version 2 has tracks."""
    return Annotation(
        boxes=labels.boxes.replace(track_id=None) if version.startswith("v1") else labels.boxes,
        visibility=labels.availability if len(labels.availability) == len(labels.boxes) else None,
        original_label=labels.raw_label,
        unboxed={"from_above": footprints(labels.from_above)},
        version=version,
    )


def _parse_header(text: str, path: Path | str) -> tuple[dict[str, int], int | None]:
    match = _HEADER.fullmatch(text.strip())
    if match:
        numbers = [int(group) for group in match.groups()[:5]]
        time_ns = int(match[6]) * 1_000_000_000 + int((match[7] or "").ljust(9, "0"))
        return dict(zip(INDEX_NAMES, numbers, strict=True)), time_ns
    if not text.strip() or _OLD_HEADER.fullmatch(text.strip()):
        return {}, None
    expected = "the header '* idx(...)=00033_00001_00002_00001_00004, timestamp=...'"
    raise FileFormatError(path, where="line 1", expected=expected, got=repr(text[:100]))


def _parse_object(cells: Sequence[str], path: Path | str, where: str) -> LabelLine:
    before, name, numbers = cells[:-8], cells[-8] if len(cells) > 8 else "", cells[-7:]
    values = [_number(cell) for cell in numbers]
    availability, slip = "", False
    if before and _whole(before[0]) is None:
        availability = _AVAILABILITY.get(before[0].upper(), "")
        slip = before[0] != availability
        before = before[1:] if availability else []
    integers = [number for number in map(_whole, before) if number is not None]
    finite = [value for value in values if value is not None]
    complete = len(integers) == len(before) in (1, 2) and len(finite) == 7
    if not complete or not is_name(name) or _number(name) is not None:
        expected = "*, [R, L or L1,] one or two whole numbers, a class and seven numbers"
        raise FileFormatError(path, where=where, expected=expected, got=repr(", ".join(cells))[:120])
    if min(finite[4:]) <= 0:
        raise FileFormatError(path, where=where, expected="positive sizes", got=repr(cells[-3:])[:120])
    if abs(finite[3]) > MOST_DEG:
        raise FileFormatError(path, where=where, expected="degrees within two turns", got=repr(cells[-4])[:120])
    check_name(path, where, name)
    return LabelLine(availability=availability, numbers=tuple(integers), name=name, values=tuple(finite), slip=slip)


def _parse_from_above(cells: Sequence[str], path: Path | str, where: str) -> tuple[str, tuple[float, ...]]:
    values = [_number(cell) for cell in cells[-5:]]
    finite = tuple(value for value in values if value is not None)
    if len(cells) not in (7, 8) or len(finite) != 5 or not is_name(cells[-6]):
        expected = "#, one or two whole numbers, a class and five numbers"
        raise FileFormatError(path, where=where, expected=expected, got=repr(", ".join(cells))[:120])
    return cells[-6], finite


def _number(text: str) -> float | None:
    try:
        value = float(text) if text.isascii() and "_" not in text else float("nan")
    except ValueError:
        return None
    return value if abs(value) < _LARGEST else None


def _whole(text: str) -> int | None:
    return int(text) if re.fullmatch(r"[+-]?[0-9]{1,18}", text) else None


def format_header(indices: Mapping[str, int], time_ns: int) -> str:
    """An annotation file's first line, without its end; the LiDAR's index stands for those that are missing."""
    numbers = "_".join(f"{indices.get(name, indices['os2-64']):05d}" for name in INDEX_NAMES)
    seconds, rest = divmod(time_ns, 1_000_000_000)
    return f"* idx(tesseract_os2-64_cam-front_os1-128_cam-lrr)={numbers}, timestamp={seconds}.{rest:09d}"


def format_labels(
    boxes: Boxes, indices: Mapping[str, int], time_ns: int, *, version: str, availability: Sequence[str] = ()
) -> str:
    """Write an annotation file's text.

    Objects of classes that K-Radar does not annotate (animals, unknown) are left out; see ``KRADAR_FROM_CIRRUS``.

    Args:
        boxes: Full boxes in the os2-64's frame, with Cirrus' class names.
        indices: Index of each sensor's frame; the LiDAR's stands for those that are missing.
        time_ns: Time of the os2-64's sweep.
        version: ``"v1.0"`` or ``"v2.1"``.
        availability: ``R``, ``L`` or ``L1`` of each box, for v2.1; all are ``R`` if it is empty.
    """
    header = format_header(indices, time_ns)
    tracks = np.arange(len(boxes)) if boxes.track_id is None else boxes.track_id
    flags = list(availability) or ["R"] * len(boxes)
    degrees, half = np.rad2deg(boxes.yaw_rad).tolist(), (boxes.size_m / 2).tolist()
    lines = []
    names = np.asarray(boxes.label).tolist()
    for row, (name, centre) in enumerate(zip(names, boxes.centre_m.tolist(), strict=True)):
        if (kradar_class := KRADAR_FROM_CIRRUS.get(name)) is None:
            continue
        track = int(tracks[row])
        before = f"{track}, {track}" if version == "v1.0" else f"{flags[row]}, {track}"
        values = ", ".join(repr(float(value)) for value in (*centre, degrees[row], *half[row]))
        lines.append(f"*, {before}, {kradar_class}, {values}\n")
    return header + ("\n" if lines else "") + "".join(lines)
