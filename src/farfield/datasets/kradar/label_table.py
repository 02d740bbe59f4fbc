"""All annotations of a K-Radar tree in one table, read fast; and what is wrong with the files, counted.

Files that are written as K-Radar's own tools write them are matched as a whole by one regular expression; only the
others take the tolerant way of :func:`~farfield.datasets.kradar.labels.parse_text`.
"""

import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from farfield.datasets.kradar.index import KRadarFiles
from farfield.datasets.kradar.labels import MAX_BYTES, MOST_DEG, check_version, parse_text
from farfield.datasets.kradar.layout import INDEX_NAMES
from farfield.errors import FarfieldError
from farfield.files.atomic import read_bytes
from farfield.files.limits import MAX_NAME
from farfield.frame import Boxes
from farfield.jobs import HERE, JobOptions, Unit, UnitResult, blocks, values
from farfield.vocabulary.classes import CIRRUS_FROM_KRADAR, normalised_class

_NUMBER = r"(-?\d{1,5}(?:\.\d{1,20})?(?:e-\d{1,2})?)"
_SIZE = r"(?!0+(?:\.0*)?(?![\d.]))(\d{1,5}(?:\.\d{1,20})?(?:e-\d{1,2})?)"  # above 0
_HEADER = (
    r"\* idx\(tesseract_os2-64_cam-front_os1-128_cam-lrr\)=(\d{5})_(\d{5})_(\d{5})_(\d{5})_(\d{5}), "
    r"timestamp=([0-8]\d{9})\.(\d{9})([ ]?)\r?"
)
_LINE = (
    r"\n\*, (?:(R|L1?), )?(-?\d{1,9}), (?:(-?\d{1,9}), )?([A-Z][A-Za-z ]*[a-z])"
    + f", {_NUMBER}" * 4
    + f", {_SIZE}" * 3
    + r"\r?"
)
_FILE_RE = re.compile(f"{_HEADER}((?:{re.sub(r'[(](?![?])', '(?:', _LINE)})*+)\n?", re.ASCII)
_LINE_RE = re.compile(_LINE, re.ASCII)
_BLOCK = 500  # files that a worker reads at a time
_SHORTEST_M = {"vehicle": 1.5, "large_vehicle": 2.5}
_SMALLEST_M, _TALLEST_M, _LONGEST_M = 0.2, 6.0, 30.0

DEFECTS = {
    "merged_header": "files whose header and first object share a line",
    "blanks": "files with stray blanks",
    "slip": "files with an availability such as LL, LR or l",
    "other_header": "files without the usual header",
    "without_height": "files with boxes that are seen from above only (#)",
    "short_line": "objects without the number in the frame before (10 fields)",
    "yaw_turned": "yaws outside -180 to 180 degrees",
    "odd_size": "boxes of a size that no object of their class has",
    "doubled_track": "objects whose track stands twice in a frame",
    "odd_index": "frames whose radar and LiDAR indices differ from the file's name",
}
SINGLE = {"files": "file", "objects": "object", "yaws": "yaw", "boxes": "box", "frames": "frame"}
"""The first words of these, of a single one."""


@dataclass(frozen=True, eq=False, kw_only=True)
class LabelTable:
    """Columns over frames (``f`` rows) and objects (``n`` rows).

    Args:
        sequence: Sequence of each frame.
        stem: Name of each frame, ``<radar>_<os2-64>``.
        version: Version of each frame's file, such as ``"v2.1"``.
        indices: Indices of the five sensors of each frame in the order of ``INDEX_NAMES``; -1 where unknown.
        time_ns: Time of the os2-64's sweep; -1 where unknown.
        frame: Row of the frame of each object, rising.
        name: K-Radar's class of each object, as written.
        availability: ``R``, ``L`` or ``L1`` of each object; empty where the version does not say.
        track: Track (v2) or number within its frame (v1, no identity) of each object.
        centre_m: Centre of each box in the os2-64's frame.
        size_m: Full length, width and height: twice what the file has.
        yaw_deg: Yaw as written: degrees, not wrapped.
        defects: How often each of :data:`DEFECTS` was met.
        damaged: What was wrong with the files that could not be read; they are no rows.
    """

    sequence: Shaped[np.ndarray, " f"]
    stem: Shaped[np.ndarray, " f"]
    version: Shaped[np.ndarray, " f"]
    indices: Int[np.ndarray, "f 5"]
    time_ns: Int[np.ndarray, " f"]
    frame: Int[np.ndarray, " n"]
    name: Shaped[np.ndarray, " n"]
    availability: Shaped[np.ndarray, " n"]
    track: Int[np.ndarray, " n"]
    centre_m: Float[np.ndarray, "n 3"]
    size_m: Float[np.ndarray, "n 3"]
    yaw_deg: Float[np.ndarray, " n"]
    defects: dict[str, int] = field(default_factory=dict)
    damaged: tuple[str, ...] = ()

    @property
    def per_frame(self) -> Int[np.ndarray, " f"]:
        """Number of objects of each frame."""
        return np.bincount(self.frame, minlength=len(self.stem))

    @property
    def range_m(self) -> Float[np.ndarray, " n"]:
        """Ground distance of each box's centre from the os2-64."""
        return np.hypot(self.centre_m[:, 0], self.centre_m[:, 1])

    @property
    def tracked(self) -> Bool[np.ndarray, " n"]:
        """Which objects have a track: those of version 2."""
        return ~np.char.startswith(self.version[self.frame].astype(np.str_), "v1")

    def tracks(self) -> dict[str, int]:
        """Number of tracks of each class; a track is one within its sequence. Version 1 has none."""
        columns = (self.name, self.sequence[self.frame], self.track)
        keys = set(zip(*(column[self.tracked].tolist() for column in columns), strict=True))
        return dict(Counter(name for name, _, _ in keys).most_common())

    def boxes(self) -> Boxes:
        """All objects in one, with Cirrus' class names; ``track_id`` is -1 for objects of version 1."""
        tracked = self.tracked
        ours = {name: normalised_class(name, CIRRUS_FROM_KRADAR) for name in set(self.name.tolist())}
        return Boxes(
            centre_m=self.centre_m,
            size_m=self.size_m,
            yaw_rad=np.deg2rad(self.yaw_deg),
            label=[ours[name] for name in self.name.tolist()],
            track_id=np.where(tracked, self.track, -1) if tracked.any() or not len(tracked) else None,
        )

    def boxes_by_frame(self) -> dict[tuple[str, str], Boxes]:
        """The objects of every frame by (sequence, frame), empty frames included."""
        every, ends = self.boxes(), np.cumsum(self.per_frame).tolist()
        keys = zip(self.sequence.tolist(), self.stem.tolist(), strict=True)
        starts = [0, *ends[:-1]]
        return {key: every[slice(start, end)] for key, start, end in zip(keys, starts, ends, strict=True)}


@dataclass
class _LabelColumns:
    """Columns that grow; a line is availability, number, number in the frame before, class and seven numbers."""

    frames: list[tuple[str, str, str]] = field(default_factory=list)
    headers: list[tuple[int, ...]] = field(default_factory=list)
    counts: list[int] = field(default_factory=list)
    lines: list[tuple[str, ...]] = field(default_factory=list)
    defects: Counter[str] = field(default_factory=Counter)
    damaged: list[str] = field(default_factory=list)

    def extend(self, others: "_LabelColumns") -> None:
        """Append the rows of further frames."""
        self.frames += others.frames
        self.headers += others.headers
        self.counts += others.counts
        self.lines += others.lines
        self.defects.update(others.defects)
        self.damaged += others.damaged


def read_label_table(entries: Iterable[KRadarFiles], bulk: JobOptions = HERE) -> LabelTable:
    """Read the annotations of many frames; those without any are left out.

    Args:
        entries: Frames, such as those of :attr:`~farfield.datasets.kradar.reader.KRadar.entries`.
        bulk: Who reads.

    Returns:
        The table. A damaged file is named in ``damaged`` and left out.
    """
    rows, labelled = _LabelColumns(), [entry for entry in entries if entry.label is not None]
    ranges = blocks(len(labelled), _BLOCK)
    units = [replace(block, parameters=labelled[block.parameters.start : block.parameters.stop]) for block in ranges]
    for result in values(_read_block, units, bulk):
        rows.extend(result.value)
    return _table(rows)


def _read_block(unit: Unit) -> UnitResult:
    rows = _LabelColumns()
    for entry in unit.parameters:
        try:
            _read(entry, entry.label, rows)
        except (FarfieldError, OSError) as error:
            rows.damaged.append(str(error))
    return UnitResult(value=rows)


def _read(entry: KRadarFiles, path: Path, rows: _LabelColumns) -> None:
    data = read_bytes(path, max_bytes=MAX_BYTES)
    match = _FILE_RE.fullmatch(data.decode("utf-8", errors="replace"))
    lines = [] if match is None else _LINE_RE.findall(match[9])
    if match is None or any(len(line[3]) > MAX_NAME or abs(float(line[7])) > MOST_DEG for line in lines):
        _read_slowly(data, entry, path, rows)
        return
    check_version(((bool(row[0]), 2 if row[2] else 1) for row in lines), entry.version or "", path)
    rows.frames.append((entry.sequence, entry.stem, entry.version or ""))
    rows.headers.append((*map(int, match.groups()[:5]), int(match[6] + match[7])))
    rows.counts.append(len(lines))
    rows.lines += lines
    rows.defects["blanks"] += bool(match[8])


def _read_slowly(data: bytes, entry: KRadarFiles, path: Path, rows: _LabelColumns) -> None:
    text = parse_text(data, path)
    check_version(((bool(line.availability), len(line.numbers)) for line in text.lines), entry.version or "", path)
    indices = [text.indices.get(name, -1) for name in INDEX_NAMES]
    rows.frames.append((entry.sequence, entry.stem, entry.version or ""))
    rows.headers.append((*indices, -1 if text.time_ns is None else text.time_ns))
    rows.counts.append(len(text.lines))
    for line in text.lines:
        numbers = [str(number) for number in (*line.numbers, "")[:2]]
        rows.lines.append((line.availability, *numbers, line.name, *map(repr, line.values)))
    slip = any(line.slip for line in text.lines)
    rows.defects["merged_header"] += text.merged_header
    rows.defects["slip"] += slip
    rows.defects["other_header"] += not text.usual_header
    rows.defects["without_height"] += bool(text.from_above)
    rows.defects["blanks"] += not (text.merged_header or slip or text.from_above) and text.usual_header


def _table(rows: _LabelColumns) -> LabelTable:
    frames = np.array(rows.frames, dtype=np.str_).reshape(-1, 3)
    headers = np.array(rows.headers, dtype=np.int64).reshape(-1, 6)
    columns = list(zip(*rows.lines, strict=True)) or [()] * 11
    numbers = np.array([list(map(float, column)) for column in columns[4:]], dtype=np.float64)
    table = LabelTable(
        sequence=frames[:, 0],
        stem=frames[:, 1],
        version=frames[:, 2],
        indices=headers[:, :5],
        time_ns=headers[:, 5],
        frame=np.repeat(np.arange(len(frames)), rows.counts),
        name=np.array(columns[3], dtype=np.str_),
        availability=np.array(columns[0], dtype=np.str_),
        track=np.array(list(map(int, columns[1])), dtype=np.int64),
        centre_m=numbers[:3].T.copy(),
        size_m=2.0 * numbers[4:].T,
        yaw_deg=numbers[3],
        damaged=tuple(rows.damaged),
    )
    short = (np.array(columns[2], dtype=np.str_) == "") & (table.version[table.frame] == "v1.0")
    counted = {name: int(mask.sum()) for name, mask in _defects(table).items()}
    table.defects.update(dict.fromkeys(DEFECTS, 0) | rows.defects | counted | {"short_line": int(short.sum())})
    return table


def _defects(table: LabelTable) -> dict[str, Bool[np.ndarray, " _"]]:
    """Which objects or frames have those defects that the columns show."""
    order = np.lexsort((table.track, table.frame))
    frame, track = table.frame[order], table.track[order]
    named = np.array([stem.split("_") for stem in table.stem.tolist()], dtype=np.int64).reshape(-1, 2)
    indexed = table.indices[:, 0] >= 0
    return {
        "yaw_turned": np.abs(table.yaw_deg) > 180.0,
        "odd_size": odd_sizes(table),
        "doubled_track": (frame[1:] == frame[:-1]) & (track[1:] == track[:-1]),
        "odd_index": indexed & (table.indices[:, :2] != named).any(axis=1),
    }


def odd_sizes(table: LabelTable) -> Bool[np.ndarray, " n"]:
    """Which boxes no object of their class fills: vehicles shorter than 1.5 m, trucks than 2.5 m, and the like."""
    ours = {name: normalised_class(name, CIRRUS_FROM_KRADAR) for name in set(table.name.tolist())}
    shortest = np.array([_SHORTEST_M.get(ours[name], _SMALLEST_M) for name in table.name.tolist()], dtype=np.float64)
    length, height = table.size_m[:, 0], table.size_m[:, 2]
    small = (length < shortest) | (table.size_m < _SMALLEST_M).any(axis=1)
    return small | (length > _LONGEST_M) | (height > _TALLEST_M)
