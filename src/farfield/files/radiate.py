"""RADIATE's files: time lists and annotated tracks (Sheeny et al., ICRA 2021; format: the authors' SDK's README)."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from farfield.errors import FileFormatError
from farfield.files.atomic import read_bytes
from farfield.files.cuboids import is_name
from farfield.files.json_text import read_json
from farfield.files.limits import check_name

MAX_TEXT_BYTES = 1 << 27
_PICTURE_PX, _MOST_DEG = 1152, 720.0
_FORM = "Frame: 000001 Time: 1574859771.744660272"


@dataclass(frozen=True, eq=False, kw_only=True)
class RadiateTracks:
    """Boxes of a sequence, one row a box, in pixels of the Cartesian radar picture (1152 x 1152, forward is up).

    Args:
        frame: Number of the radar frame, from 1, shape (n,).
        track_id: Identity over the sequence, shape (n,).
        class_name: ``car``, ``van``, ``group_of_pedestrians``..., n names.
        corner_px: Left and top of the box before it is turned about its centre, shape (n, 2).
        size_px: Width (to the right) and height (down) before it is turned, shape (n, 2).
        rotation_deg: Counter-clockwise turn, shape (n,).
    """

    frame: Int[np.ndarray, " n"]
    track_id: Int[np.ndarray, " n"]
    class_name: tuple[str, ...]
    corner_px: Float[np.ndarray, "n 2"]
    size_px: Float[np.ndarray, "n 2"]
    rotation_deg: Float[np.ndarray, " n"]

    def __len__(self) -> int:
        return len(self.class_name)

    def of_frame(self, number: int) -> "RadiateTracks":
        """The boxes of one radar frame."""
        rows = np.flatnonzero(self.frame == number)
        names = ("frame", "track_id", "corner_px", "size_px", "rotation_deg")
        columns: dict[str, Any] = {name: getattr(self, name)[rows] for name in names}
        return RadiateTracks(class_name=tuple(self.class_name[row] for row in rows), **columns)


def read_times(path: Path | str) -> dict[int, int]:
    """Read a list of a sensor's frames: number to nanoseconds.

    The digits after the point are a count of nanoseconds, which the recorder wrote without leading zeros.

    Raises:
        FileFormatError: If a line has another form.
    """
    times: dict[int, int] = {}
    text = read_bytes(path, max_bytes=MAX_TEXT_BYTES).decode("ascii", "replace")
    for number, line in enumerate(text.splitlines(), start=1):
        fields = line.split()
        if not fields:
            continue
        seconds, _, fraction = fields[-1].partition(".")
        digits = [fields[1] if len(fields) == 4 else "", seconds, fraction or "0"]
        limits = (9, 12, 9)
        good = len(fields) == 4 and fields[0] == "Frame:" and fields[2] == "Time:"
        if not good or not all(
            d.isascii() and d.isdigit() and len(d) <= n for d, n in zip(digits, limits, strict=True)
        ):
            raise FileFormatError(path, where=f"line {number}", expected=f"such as {_FORM!r}", got=repr(line[:80]))
        if int(digits[0]) in times:
            raise FileFormatError(path, where=f"line {number}", expected="each frame once", got=repr(line[:80]))
        times[int(digits[0])] = int(digits[1]) * 1_000_000_000 + int(digits[2])
    return times


def read_tracks(path: Path | str) -> RadiateTracks:
    """Read ``annotations.json``: a list of objects, each with one box or an empty list for every radar frame.

    Raises:
        FileFormatError: If it is no such list, or a box's numbers are missing or no use.
    """
    entries = read_json(path, max_bytes=MAX_TEXT_BYTES)
    if not isinstance(entries, list):
        raise _wrong(path, "the file", "a JSON list of objects", type(entries).__name__)
    rows: list[tuple[int, int, str, list[float]]] = []
    objects = [_object(path, number, entry) for number, entry in enumerate(entries)]
    turns, filled = len(objects[0][2]) if objects else 0, set[tuple[int, int]]()
    for number, (name, track_id, boxes) in enumerate(objects):
        if len(boxes) != turns:
            expected = f"an entry for each radar frame, {turns} as in the objects before"
            raise _wrong(path, f"object {number}", expected, str(len(boxes)))
        for index, box in enumerate(boxes):
            if box != []:
                if (track_id, index) in filled:
                    expected = f"the track {track_id} once in a frame"
                    raise _wrong(path, f"object {number}, box {index}", expected, "a second box")
                filled.add((track_id, index))
                rows.append((index + 1, track_id, name, _box(path, f"object {number}, box {index}", box)))
    numbers = np.array([row[3] for row in rows], dtype=np.float64).reshape(len(rows), 5)
    return RadiateTracks(
        frame=np.array([row[0] for row in rows], dtype=np.int64),
        track_id=np.array([row[1] for row in rows], dtype=np.int64),
        class_name=tuple(row[2] for row in rows),
        corner_px=numbers[:, :2],
        size_px=numbers[:, 2:4],
        rotation_deg=numbers[:, 4],
    )


def _object(path: Path | str, number: int, entry: Any) -> tuple[str, int, list[Any]]:
    values = [entry.get(key) for key in ("class_name", "id", "bboxes")] if isinstance(entry, dict) else [None] * 3
    name, track_id, boxes = values
    sound = is_name(name) and isinstance(boxes, list) and type(track_id) is int and 0 <= track_id < 2**31
    if not sound:
        raise _wrong(path, f"object {number}", "id, class_name and bboxes", repr(entry))
    return check_name(path, f"object {number}", str(name)), int(str(track_id)), list(boxes or [])


def _box(path: Path | str, where: str, box: Any) -> list[float]:
    position = box.get("position") if isinstance(box, dict) else None
    values = [*position, box.get("rotation")] if isinstance(position, list) else []
    if len(values) != 5 or not all(type(v) in (int, float) and abs(v) <= 1e6 for v in values):
        raise _wrong(path, where, "position of four numbers and rotation, or an empty list", repr(box))
    if not (values[2] > 0 and values[3] > 0):
        raise _wrong(path, where, "a positive width and height", repr(box))
    left, top, width, height, rotation = values
    centre_px = left + width / 2, top + height / 2
    if not all(-_PICTURE_PX <= pixel <= 2 * _PICTURE_PX for pixel in centre_px) or abs(rotation) > _MOST_DEG:
        expected = f"a centre in pixels of the picture ({_PICTURE_PX}), a rotation in degrees within two turns"
        raise _wrong(path, where, expected, repr(box))
    return [float(value) for value in values]


def _wrong(path: Path | str, where: str, expected: str, actual: str) -> FileFormatError:
    return FileFormatError(path, where=where, expected=expected, got=actual[:120])


def times_text(times_ns: dict[int, int]) -> str:
    """The text of a time list, as the recorder writes it: nanoseconds after the point without leading zeros."""
    lines = []
    for number, time_ns in sorted(times_ns.items()):
        seconds, rest = divmod(time_ns, 1_000_000_000)
        lines.append(f"Frame: {number:06d} Time: {seconds}.{rest}\n")
    return "".join(lines)


def tracks_text(tracks: RadiateTracks, frames: int) -> str:
    """The text of ``annotations.json``: one object a track and class, with a box or an empty list for every frame.

    Args:
        tracks: Boxes of a sequence.
        frames: Its number of radar frames.
    """
    objects: dict[tuple[int, str], list[Any]] = {}
    for row, name in enumerate(tracks.class_name):
        boxes = objects.setdefault((int(tracks.track_id[row]), name), [[] for _ in range(frames)])
        position = [round(float(value), 6) for value in (*tracks.corner_px[row], *tracks.size_px[row])]
        boxes[int(tracks.frame[row]) - 1] = {
            "position": position,
            "rotation": round(float(tracks.rotation_deg[row]), 6),
        }
    entries = [{"id": number, "class_name": name, "bboxes": boxes} for (number, name), boxes in sorted(objects.items())]
    return json.dumps(entries)
