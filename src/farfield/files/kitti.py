"""KITTI's text files: calibration, object labels, tracking labels, and detections in 15 comma-separated columns.

Everything stays in KITTI's own convention: rectified camera frame (x right, y down, z forward), a box is the centre of
its *bottom* face, sizes are height, width, length, and ``rotation_y`` turns about y (0 looks along x, clockwise seen
from above). Readers of data sets convert; this module only moves text to arrays and back.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from farfield.errors import FileFormatError
from farfield.files.atomic import read_bytes, write_text
from farfield.files.cuboids import is_name
from farfield.files.limits import check_name

MAX_TEXT_BYTES = 1 << 26  # KITTI's largest label file has 2 MB
DETECTION_TYPES = {1: "Pedestrian", 2: "Car", 3: "Cyclist"}
_FARTHEST_M, _LARGEST_M, _MOST_RAD = 1e7, 1e6, 1e3
_LABEL_COLUMNS = 15  # type, truncation, occlusion, alpha, 2D box, h w l, x y z, rotation_y; then perhaps a score


@dataclass(frozen=True, eq=False, kw_only=True)
class KittiObjects:
    """Objects in KITTI's camera convention, one row an object.

    Args:
        type: ``Car``, ``Van``, ``DontCare``..., shape (n,).
        truncation: Share outside the image in [0, 1] (tracking: 0, 1, 2); -1 unknown, shape (n,).
        occlusion: 0 visible, 1 partly, 2 largely occluded, 3 unknown; -1 not given, shape (n,).
        alpha_rad: Observation angle, shape (n,); -10 not given.
        box_px: 2D box as left, top, right, bottom, shape (n, 4), pixels.
        size_m: Height, width, length, shape (n, 3); -1 (object) or -1000 (tracking) where there is no 3D box.
        bottom_m: Centre of the bottom face in the camera frame, shape (n, 3).
        rotation_y_rad: Turn about the camera's y axis, shape (n,).
        score: Detection scores, shape (n,), or None for labels.
        line: Line of the file that each row comes from, from 1, shape (n,).
    """

    type: Shaped[np.ndarray, " n"]
    truncation: Float[np.ndarray, " n"]
    occlusion: Int[np.ndarray, " n"]
    alpha_rad: Float[np.ndarray, " n"]
    box_px: Float[np.ndarray, "n 4"]
    size_m: Float[np.ndarray, "n 3"]
    bottom_m: Float[np.ndarray, "n 3"]
    rotation_y_rad: Float[np.ndarray, " n"]
    score: Float[np.ndarray, " n"] | None
    line: Int[np.ndarray, " n"]

    def __len__(self) -> int:
        return len(self.type)

    def __getitem__(self, index: slice | Bool[np.ndarray, " n"] | Int[np.ndarray, " k"]) -> "KittiObjects":
        columns: dict[str, Any] = {column.name: getattr(self, column.name) for column in fields(self)}
        chosen: dict[str, Any] = {name: None if rows is None else rows[index] for name, rows in columns.items()}
        return replace(self, **chosen)

    @property
    def has_box(self) -> Bool[np.ndarray, " n"]:
        """Which objects have a 3D box (``DontCare`` has none), shape (n,)."""
        return np.asarray((self.size_m > 0).all(axis=1))


@dataclass(frozen=True, eq=False, kw_only=True)
class KittiTracks:
    """Objects of a whole sequence, each with its frame and track.

    Args:
        frame: Frame number, shape (n,).
        track_id: Track number, -1 where there is none, shape (n,).
        objects: The objects, n rows.
    """

    frame: Int[np.ndarray, " n"]
    track_id: Int[np.ndarray, " n"]
    objects: KittiObjects

    def __len__(self) -> int:
        return len(self.frame)

    def __getitem__(self, index: slice | Bool[np.ndarray, " n"] | Int[np.ndarray, " k"]) -> "KittiTracks":
        return KittiTracks(frame=self.frame[index], track_id=self.track_id[index], objects=self.objects[index])


def read_calib(path: Path | str) -> dict[str, Float[np.ndarray, "rows columns"]]:
    """Read a calibration file: ``NAME: numbers`` a line, with or without the colon.

    Returns:
        12 numbers as a (3, 4) and 9 numbers as a (3, 3) matrix, by name (``P2``, ``R0_rect``, ``Tr_velo_to_cam``...).
        A name without numbers is left out: View-of-Delft ends its files with an empty ``Tr_imu_to_velo:``.

    Raises:
        FileFormatError: If a line has another number of values, is no number, or a name comes twice.
    """
    matrices: dict[str, np.ndarray] = {}
    for number, line in _lines(path):
        name, *values = line.replace(":", " ", 1).split()
        if len(values) not in (0, 9, 12):
            raise _wrong(path, number, "a name and 9 or 12 numbers", f"{len(values)} values after {name[:40]!r}")
        if name in matrices:
            raise _wrong(path, number, "each name once", f"{name[:40]!r} for the second time")
        if values:
            matrices[name] = _numbers(path, [values], [number])[0].reshape(3, -1)
    if not matrices:
        raise _wrong(path, 1, "calibration matrices", "an empty file")
    return matrices


def read_labels(path: Path | str) -> KittiObjects:
    """Read an object label or detection file: 15 columns separated by spaces, or 16 with a score.

    An empty file is a frame without objects.

    Raises:
        FileFormatError: If a line has another number of columns, or holds anything but finite numbers after the type.
    """
    return parse_labels(read_bytes(path, max_bytes=MAX_TEXT_BYTES), path)


def parse_labels(data: bytes, path: Path | str) -> KittiObjects:
    """Parse the content of such a file; ``path`` is for messages, errors are those of :func:`read_labels`."""
    return _objects(path, *_rows_of(path, _numbered(data, path), skip=0))


def read_tracking(path: Path | str) -> KittiTracks:
    """Read a tracking label or result file: frame, track, then the columns of an object label.

    Raises:
        FileFormatError: As :func:`read_labels`, and if a frame or a track is no whole number.
    """
    lines, rows = _rows_of(path, _lines(path), skip=2)
    ids = _whole(path, [row[:2] for row in rows], lines, 2)
    objects = _objects(path, lines, [row[2:] for row in rows])
    return _tracks(path, ids[:, 0], ids[:, 1], objects)


def read_detections(path: Path | str) -> KittiTracks:
    """Read tracking detections in 15 comma-separated columns.

    The columns are frame, type (1 pedestrian, 2 car, 3 cyclist), 2D box, score, h w l, x y z of the bottom centre,
    rotation_y, alpha.

    Raises:
        FileFormatError: If a line has another number of columns or a value is out of its domain.
    """
    lines: list[int] = []
    rows: list[list[str]] = []
    for number, line in _lines(path):
        row = line.split(",")
        if len(row) != 15:
            raise _wrong(path, number, "15 comma-separated columns", f"{len(row)}")
        lines.append(number)
        rows.append(row)
    values = _numbers(path, rows, lines, columns=15)
    ids = _whole(path, [row[:2] for row in rows], lines, 2)
    unknown = np.flatnonzero(~np.isin(ids[:, 1], list(DETECTION_TYPES)))
    if len(unknown):
        raise _wrong(path, lines[unknown[0]], f"a type code of {DETECTION_TYPES}", str(ids[unknown[0], 1]))
    objects = KittiObjects(
        type=np.array([DETECTION_TYPES[code] for code in ids[:, 1].tolist()], dtype=np.str_),
        truncation=np.full(len(rows), -1.0),
        occlusion=np.full(len(rows), -1),
        alpha_rad=values[:, 14],
        box_px=values[:, 2:6],
        size_m=values[:, 7:10],
        bottom_m=values[:, 10:13],
        rotation_y_rad=values[:, 13],
        score=values[:, 6],
        line=np.array(lines, dtype=np.int64),
    )
    _check_possible(path, objects)
    return _tracks(path, ids[:, 0], np.full(len(rows), -1), objects)


def write_labels(path: Path | str, objects: KittiObjects) -> None:
    """Write an object label file (15 columns, 16 where there are scores), numbers as precise as they are."""
    write_text(path, "".join(f"{row}\n" for row in _text(objects)))


def write_tracking(path: Path | str, tracks: KittiTracks) -> None:
    """Write a tracking label file (17 columns, 18 where there are scores)."""
    rows = zip(tracks.frame.tolist(), tracks.track_id.tolist(), _text(tracks.objects), strict=True)
    write_text(path, "".join(f"{frame} {track} {row}\n" for frame, track, row in rows))


def _text(objects: KittiObjects) -> list[str]:
    number: Callable[[float], str] = repr
    values = np.column_stack([objects.alpha_rad, objects.box_px, objects.size_m, objects.bottom_m])
    values = np.column_stack([values, objects.rotation_y_rad])
    if objects.score is not None:
        values = np.column_stack([values, objects.score])
    heads = zip(objects.type.tolist(), objects.truncation.tolist(), objects.occlusion.tolist(), strict=True)
    return [
        " ".join([kind, f"{truncation:g}", str(occlusion), *map(number, row)])
        for (kind, truncation, occlusion), row in zip(heads, values.tolist(), strict=True)
    ]


def _wrong(path: Path | str, line: int, expected: str, actual: str) -> FileFormatError:
    return FileFormatError(path, where=f"line {line}", expected=expected, got=actual)


def _lines(path: Path | str) -> list[tuple[int, str]]:
    """Numbered lines that are not blank."""
    return _numbered(read_bytes(path, max_bytes=MAX_TEXT_BYTES), path)


def _numbered(data: bytes, path: Path | str) -> list[tuple[int, str]]:
    try:
        text = data.decode("ascii")
    except UnicodeDecodeError as error:
        actual = f"byte 0x{data[error.start]:02x}"
        raise FileFormatError(path, where=f"byte {error.start}", expected="ASCII text", got=actual) from None
    if "\0" in text:  # as a disk leaves it that lost its power
        raise FileFormatError(path, where=f"byte {text.index(chr(0))}", expected="ASCII text", got="a zero byte")
    return [(number, line) for number, line in enumerate(text.split("\n"), 1) if line.strip()]


def _rows_of(path: Path | str, numbered: Sequence[tuple[int, str]], *, skip: int) -> tuple[list[int], list[list[str]]]:
    """Space-separated rows of ``skip`` columns and a label, all of the same width."""
    lines: list[int] = []
    rows: list[list[str]] = []
    widths = (skip + _LABEL_COLUMNS, skip + _LABEL_COLUMNS + 1)
    for number, line in numbered:
        row = line.split()
        expected = widths if not rows else (len(rows[0]),)
        if len(row) not in expected:
            columns = " or ".join(map(str, expected)) + " space-separated columns"
            raise _wrong(path, number, columns + (" as in the lines before" if rows else ""), str(len(row)))
        lines.append(number)
        rows.append(row)
    return lines, rows


def _numbers(
    path: Path | str, rows: Sequence[Sequence[str]], lines: Sequence[int], *, columns: int = 0
) -> Float[np.ndarray, "n columns"]:
    """Turn rows of equal width into finite numbers, or name the first line that has another."""
    for row, line in zip(rows, lines, strict=True):
        strange = next((word for word in row if "_" in word), None)  # which Python takes for a digit's mark
        if strange is not None:
            raise _wrong(path, line, "a number", repr(strange[:40]))
    try:
        values = np.array(rows, dtype=np.float64) if rows else np.zeros((0, columns))
    except ValueError:
        for row, line in zip(rows, lines, strict=True):
            for word in row:
                try:
                    float(word)
                except ValueError:
                    raise _wrong(path, line, "a number", repr(word[:40])) from None
        raise
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        row, column = bad[0].tolist()
        raise _wrong(path, lines[row], "finite numbers", repr(rows[row][column][:40]))
    return values


def _whole(path: Path | str, rows: list[list[str]], lines: list[int], columns: int) -> Int[np.ndarray, "n columns"]:
    values = _numbers(path, rows, lines, columns=columns)
    bad = np.flatnonzero(((values != np.round(values)) | (np.abs(values) > 2**53)).any(axis=1))
    if len(bad):
        raise _wrong(path, lines[bad[0]], "whole numbers", " ".join(rows[bad[0]])[:60])
    return values.astype(np.int64)


def _objects(path: Path | str, lines: list[int], rows: list[list[str]]) -> KittiObjects:
    width = len(rows[0]) if rows else _LABEL_COLUMNS
    values = _numbers(path, [row[1:] for row in rows], lines, columns=width - 1)
    occlusion = _whole(path, [row[2:3] for row in rows], lines, 1)[:, 0]
    names = [check_name(path, f"line {line}", row[0]) for row, line in zip(rows, lines, strict=True)]
    objects = KittiObjects(
        type=np.array(names, dtype=np.str_) if rows else np.empty(0, "<U1"),
        truncation=values[:, 0],
        occlusion=occlusion,
        alpha_rad=values[:, 2],
        box_px=values[:, 3:7],
        size_m=values[:, 7:10],
        bottom_m=values[:, 10:13],
        rotation_y_rad=values[:, 13],
        score=values[:, 14] if width > _LABEL_COLUMNS else None,
        line=np.array(lines, dtype=np.int64),
    )
    _check_possible(path, objects)
    return objects


def _check_possible(path: Path | str, objects: KittiObjects) -> None:
    """Refuse what no writer means: places beyond any map, sizes beyond millimetres, numbers of another column."""
    left, top, right, bottom = objects.box_px.T
    columns: tuple[tuple[str, Any], ...] = (
        ("a class as type", [_is_number(name) or not is_name(name) for name in objects.type.tolist()]),
        ("a truncation from 0 to 1 (tracking: 0 to 2), or -1", (objects.truncation < -1) | (objects.truncation > 2)),
        ("an occlusion from 0 to 3, or -1", (objects.occlusion < -1) | (objects.occlusion > 3)),
        ("a 2D box: left, top, right, bottom", (right < left) | (bottom < top)),
    )
    for expected, wrong in columns:
        for row in np.flatnonzero(wrong)[:1].tolist():
            shown = [objects.type[row], objects.truncation[row], objects.occlusion[row], *objects.box_px[row]]
            raise _wrong(path, int(objects.line[row]), expected, " ".join(map(str, shown)))
    limits = ((objects.bottom_m, _FARTHEST_M), (objects.size_m, _LARGEST_M), (objects.rotation_y_rad, _MOST_RAD))
    for values, most in limits:
        beyond = np.argwhere(np.abs(values) > most)
        if len(beyond):
            expected = (
                f"places within {_FARTHEST_M:g} metres, sizes within {_LARGEST_M:g}, turns within {_MOST_RAD:g} rad"
            )
            raise _wrong(path, int(objects.line[beyond[0][0]]), expected, f"{values[tuple(beyond[0])]:g}")


def _is_number(text: str) -> bool:
    """Whether a word is a number that is no name; whole numbers are, of detectors that count their classes."""
    try:
        float(text)
    except ValueError:
        return False
    return not text.isdigit()


def _tracks(
    path: Path | str, frame: Int[np.ndarray, " n"], track_id: Int[np.ndarray, " n"], objects: KittiObjects
) -> KittiTracks:
    if len(frame) and frame.min() < 0:
        row = int(np.flatnonzero(frame < 0)[0])
        raise _wrong(path, int(objects.line[row]), "a frame number from 0 on", str(frame[row]))
    return KittiTracks(frame=frame, track_id=track_id, objects=objects)


# KITTI raw: calibration and GPS/IMU records (Geiger et al.: "Vision meets Robotics: The KITTI Dataset", IJRR 2013).

_TEXT_BYTES = 1 << 20
_RECORD = 30
_WORDS = ("calib_time",)

Matrices = Mapping[str, Float[np.ndarray, " n"]]


def read_raw_calib(path: Path | str) -> dict[str, Float[np.ndarray, " n"]]:
    """The numbers of ``calib_*.txt`` by name, such as ``R``, ``T``, ``P_rect_02``; the date is left out.

    Raises:
        FileFormatError: If a line is not ``NAME: numbers``, or a name comes twice.
    """
    matrices: dict[str, np.ndarray] = {}
    text = read_bytes(path, max_bytes=_TEXT_BYTES).decode("ascii", errors="replace")
    for number, line in enumerate(text.splitlines(), start=1):
        name, colon, rest = line.partition(":")
        if not line.strip() or name in _WORDS:
            continue
        if not colon or name in matrices:
            raise FileFormatError(path, where=f"line {number}", expected="NAME: numbers, once", got=repr(line[:60]))
        matrices[name] = _floats(rest, path, number)
    if not matrices:
        raise FileFormatError(path, where="line 1", expected="NAME: numbers", got="no such line")
    return matrices


def read_rows(path: Path | str, columns: int, *, largest: float = _FARTHEST_M) -> Float[np.ndarray, "n columns"]:
    """Read rows of so many numbers, such as the odometry benchmark's poses (12) and times (1).

    Args:
        path: The file.
        columns: Numbers a line.
        largest: No number is larger.

    Raises:
        FileFormatError: If there is none, or a line has another number of columns or a number that is none or beyond.
    """
    rows = []
    for number, line in _lines(path):
        values = _floats(line, path, number)
        if len(values) != columns or not (np.abs(values) <= largest).all():
            raise _wrong(path, number, f"{columns} numbers of at most {largest:g}", repr(line[:60]))
        rows.append(values)
    if not rows:
        raise _wrong(path, 1, f"lines of {columns} numbers", "an empty file")
    return np.stack(rows)


def _floats(text: str, path: Path | str, line: int) -> Float[np.ndarray, " n"]:
    try:
        values = np.array([float(word) for word in text.split()], dtype=np.float64)
    except ValueError:
        values = np.array([np.nan])
    if not len(values) or not np.isfinite(values).all():
        raise FileFormatError(path, where=f"line {line}", expected="finite numbers", got=repr(text[:60]))
    return values


def rigid(calib: Matrices, path: Path | str) -> Float[np.ndarray, "4 4"]:
    """The motion of ``R`` and ``T``.

    Raises:
        FileFormatError: If it is none.
    """
    return _motion(_shaped(calib, "R", (3, 3), path), _shaped(calib, "T", (3,), path), path)


def _motion(rotation: np.ndarray, translation: np.ndarray, path: Path | str) -> Float[np.ndarray, "4 4"]:
    if not 0.9 < float(np.linalg.det(rotation)) < 1.1:
        raise FileFormatError(path, where="R", expected="a rotation", got=repr(rotation.tolist())[:120])
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, translation
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
        actual = "nothing" if values is None else f"{values.size} numbers"
        raise FileFormatError(path, where=name, expected=f"{int(np.prod(shape))} numbers", got=actual)
    return values.reshape(shape)


def read_record(path: Path | str) -> Float[np.ndarray, " 30"]:
    """A record of ``oxts/data``: latitude, longitude (degrees), altitude (m), roll, pitch, yaw (radians), and more.

    Raises:
        FileFormatError: If the file is no such record.
    """
    values = _floats(read_bytes(path, max_bytes=_TEXT_BYTES).decode("ascii", errors="replace"), path, 1)
    if len(values) != _RECORD or abs(values[0]) >= 90 or abs(values[1]) > 180:
        actual = f"{len(values)} numbers"
        raise FileFormatError(path, where="line 1", expected=f"{_RECORD} numbers, degrees first", got=actual)
    return values
