"""What was annotated, counted over every frame of a data set: by class, weather, road, time, range and visibility.

Only annotations and conditions are read, no cloud: a data set of annotations alone can be counted too. K-Radar's are
read all at once.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float, Int, Shaped

from farfield.datasets.base import Dataset
from farfield.datasets.kradar import KRadar
from farfield.datasets.kradar.label_table import read_label_table
from farfield.errors import FarfieldError
from farfield.frame import Boxes, Frame
from farfield.jobs import HERE, JobOptions, Unit, UnitResult, blocks, values
from farfield.vocabulary.conditions import CONDITIONS, UNKNOWN
from farfield.vocabulary.counts import count_of

_BLOCK = 50  # frames that a worker reads at a time
RANGE_EDGES_M = (0.0, 20.0, 40.0, 60.0, 80.0, 100.0, 150.0, 200.0, np.inf)
_KRADAR_SIGHT = {"R": "seen by the radar", "L": "by the LiDAR only", "L1": "not matched", "": UNKNOWN}
_KITTI_SIGHT = ("fully visible", "partly hidden", "largely hidden", UNKNOWN)
_POINTS = ("no point", "1 to 9 points", "10 points or more", UNKNOWN)


@dataclass(frozen=True, eq=False, kw_only=True)
class Census:
    """Columns over frames (``f`` rows) and over annotated objects (``n`` rows).

    Args:
        sequence: Sequence of each frame.
        conditions: Weather, road and time of each frame by kind; ``unknown`` where the frame does not say.
        objects: Number of objects of each frame; -1 where it was not annotated.
        frame: Row of the frame of each object.
        name: Class of each object as the data set has it.
        range_m: Ground distance of each object from the frame's origin.
        size_m: Length, width and height of each object.
        visibility: How each object is seen, in words of the data set, or ``unknown``.
        track: Track of each object, unique within its sequence; None where the data set has none.
        farfield_class: Farfield's name of each class.
        damaged: Frames that could not be read, and why.
    """

    sequence: Shaped[np.ndarray, " f"]
    conditions: Mapping[str, Shaped[np.ndarray, " f"]]
    objects: Int[np.ndarray, " f"]
    frame: Int[np.ndarray, " n"]
    name: Shaped[np.ndarray, " n"]
    range_m: Float[np.ndarray, " n"]
    size_m: Float[np.ndarray, "n 3"]
    visibility: Shaped[np.ndarray, " n"]
    track: Int[np.ndarray, " n"] | None = None
    farfield_class: Mapping[str, str] = field(default_factory=dict)
    damaged: tuple[str, ...] = ()

    def of_objects(self, kind: str) -> Shaped[np.ndarray, " n"]:
        """A column over objects: ``name``, ``visibility``, ``range`` (the bin, in words), or a condition."""
        if kind == "range":
            return np.array(range_names(), dtype=np.str_)[np.digitize(self.range_m, RANGE_EDGES_M) - 1]
        if kind in self.conditions:
            return self.conditions[kind][self.frame]
        return {"name": self.name, "visibility": self.visibility}[kind]

    def names(self, kind: str) -> list[str]:
        """What a column over objects holds: most frequent first, ranges and degrees of visibility in their order."""
        counts = Counter(self.of_objects(kind).tolist())
        if kind == "range":
            filled = [index for index, name in enumerate(range_names()) if name in counts]
            return range_names()[filled[0] : filled[-1] + 1] if filled else []  # an empty bin keeps its place
        if kind == "visibility":
            order = [*_KRADAR_SIGHT.values(), *_KITTI_SIGHT, *_POINTS]
            return sorted(counts, key=lambda name: (name == UNKNOWN, order.index(name) if name in order else 0))
        return [name for name, _ in counts.most_common()]

    def table(self, rows: str, columns: str) -> dict[str, dict[str, int]]:
        """Objects by two columns, such as ``name`` and ``weather``; combinations that do not occur are 0."""
        counts = Counter(zip(self.of_objects(rows).tolist(), self.of_objects(columns).tolist(), strict=True))
        across = self.names(columns)
        return {row: {column: counts[row, column] for column in across} for row in self.names(rows)}

    def frames_by(self, kind: str) -> dict[str, int]:
        """Frames by a condition, most first."""
        return dict(Counter(self.conditions[kind].tolist()).most_common())

    def sequences(self) -> list[dict[str, Any]]:
        """One row a sequence, in the order of the data set: frames, conditions, objects (K-Radar's Table 5)."""
        rows = []
        for name in dict.fromkeys(self.sequence.tolist()):
            in_sequence = self.sequence == name
            conditions = {
                kind: ", ".join(dict.fromkeys(self.conditions[kind][in_sequence].tolist())) for kind in CONDITIONS
            }
            objects = int(np.maximum(self.objects[in_sequence], 0).sum())
            rows.append({"sequence": name, "frames": int(in_sequence.sum()), **conditions, "objects": objects})
        return rows

    def tracks(self) -> dict[str, int]:
        """Number of tracks of each class; nothing where the data set has none."""
        if self.track is None:
            return {}
        sequence = self.sequence[self.frame].tolist()
        keys = set(zip(self.name.tolist(), sequence, self.track.tolist(), strict=True))
        return dict(Counter(name for name, _, track in keys if track >= 0).most_common())

    @property
    def known(self) -> tuple[str, ...]:
        """Which of the conditions, and whether visibility, are known of any frame or object."""
        kinds = [kind for kind in CONDITIONS if (self.conditions[kind] != UNKNOWN).any()]
        return (*kinds, "visibility") if (self.visibility != UNKNOWN).any() else tuple(kinds)

    def summary(self) -> dict[str, Any]:
        """Every figure as plain numbers, lists and mappings that JSON takes."""
        annotated = self.objects >= 0
        sequences, tracks = self.sequences(), self.tracks()
        means = {name: self.size_m[self.name == name].mean(axis=0).round(3).tolist() for name in self.names("name")}
        return {
            "frames": len(self.sequence),
            "annotated_frames": int(annotated.sum()),
            "empty_frames": int((self.objects == 0).sum()),
            "sequences": len(sequences),
            "objects": len(self.name),
            "objects_per_annotated_frame": len(self.name) / max(int(annotated.sum()), 1),
            "most_objects_in_a_frame": int(self.objects.max(initial=0)),
            "classes": {
                name: {
                    "objects": int((self.name == name).sum()),
                    "tracks": tracks.get(name),
                    "farfield_class": self.farfield_class.get(name, name),
                    "mean_size_m": means[name],
                }
                for name in self.names("name")
            },
            "frames_by": {kind: self.frames_by(kind) for kind in CONDITIONS if kind in self.known},
            "objects_by": {
                f"class_and_{kind}": self.table("name", kind)
                for kind in (*CONDITIONS, "range", "visibility")
                if kind == "range" or kind in self.known
            },
            "visibility_by": {
                kind: self.table(kind, "visibility") for kind in ("range", *CONDITIONS) if self._is_known(kind)
            },
            "table_5": sequences,
            "damaged": list(self.damaged),
        }

    def _is_known(self, kind: str) -> bool:
        return "visibility" in self.known and (kind == "range" or kind in self.known)


def range_names() -> list[str]:
    """Names of the bins of range.

    >>> range_names()[0], range_names()[-1]
    ('0 to 20 m', '200 m and more')
    """
    inner = [f"{low:g} to {high:g} m" for low, high in pairwise(RANGE_EDGES_M[:-1])]
    return [*inner, f"{RANGE_EDGES_M[-2]:g} m and more"]


def take_census(dataset: Dataset, bulk: JobOptions = HERE) -> Census:
    """Count the annotations of every frame.

    Args:
        dataset: What :func:`farfield.datasets.open_dataset` gave.
        bulk: Who reads them.
    """
    reader = dataset.unwrapped
    as_written = all(getattr(function, "keeps_annotation", False) for function in dataset.maps)
    if isinstance(reader, KRadar) and as_written and len(set(dataset.keys)) == len(dataset):
        return _census_of_kradar(dataset, reader, bulk)
    return _census_of_frames(dataset, bulk)


def _census_of_kradar(dataset: Dataset, reader: KRadar, bulk: JobOptions) -> Census:
    """The same counts as over its frames, from the table of all annotations."""
    count = len(dataset)
    entries = [reader.entries[index] for index in dataset.origins]
    table = read_label_table(entries, bulk)
    keys = list(zip(table.sequence.tolist(), table.stem.tolist(), strict=True))
    row_of = {key: row for row, key in enumerate(dataset.keys)}
    rows = np.array([row_of[key] for key in keys], dtype=np.int64)
    objects = np.full(count, -1, dtype=np.int64)
    objects[rows] = table.per_frame
    boxes = table.boxes()
    label = np.asarray(boxes.label).tolist()
    return Census(
        sequence=np.array(dataset.sequences, dtype=np.str_),
        conditions=_conditions([_conditions_of(reader, sequence) for sequence in dataset.sequences]),
        objects=objects,
        frame=rows[table.frame],
        name=table.name,
        range_m=table.range_m,
        size_m=table.size_m,
        visibility=np.array([_KRADAR_SIGHT[flag] for flag in table.availability.tolist()], dtype=np.str_),
        track=table.track if table.tracked.all() else None,
        farfield_class=dict(zip(table.name.tolist(), label, strict=True)),
        damaged=table.damaged,
    )


def _conditions_of(reader: KRadar, sequence: str) -> Mapping[str, str]:
    try:
        return reader.of_sequence(sequence).conditions
    except FarfieldError:
        return {}


def _conditions(rows: Sequence[Mapping[str, str]]) -> dict[str, Shaped[np.ndarray, " f"]]:
    return {kind: np.array([str(row.get(kind, UNKNOWN)) for row in rows], dtype=np.str_) for kind in CONDITIONS}


@dataclass(kw_only=True)
class _CensusRows:
    """What some frames say."""

    conditions: list[Mapping[str, str]] = field(default_factory=list)
    objects: list[int] = field(default_factory=list)
    parts: list[Boxes] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    sight: list[str] = field(default_factory=list)
    damaged: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class _AnnotationReading:
    """Reads the annotations of a block of frames."""

    dataset: Dataset

    def __call__(self, unit: Unit) -> UnitResult:
        rows = _CensusRows()
        for index in unit.parameters:
            self._count(index, rows)
        return UnitResult(value=rows)

    def _count(self, index: int, rows: _CensusRows) -> None:
        boxes, conditions = None, {}
        try:
            frame = self.dataset[index]
            boxes, conditions = frame.boxes, dict(frame.conditions)
            if boxes is not None:
                called, sight = class_names(frame, boxes), visibility(frame, boxes)
                rows.names += called
                rows.sight += sight
        except (FarfieldError, OSError, ValueError) as error:
            rows.damaged.append(str(error))
            boxes = None
        rows.conditions.append(conditions)
        rows.objects.append(-1 if boxes is None else len(boxes))
        rows.parts += [] if boxes is None else [boxes]


def _census_of_frames(dataset: Dataset, bulk: JobOptions) -> Census:
    rows = _CensusRows()
    for block in values(_AnnotationReading(dataset), blocks(len(dataset), _BLOCK), bulk):
        for name, column in vars(rows).items():
            column += getattr(block.value, name)
    conditions, parts, names, sight, objects = rows.conditions, rows.parts, rows.names, rows.sight, rows.objects
    counts = np.array(objects, dtype=np.int64)
    tracked = bool(parts) and all(part.track_id is not None for part in parts if len(part))
    together = Boxes.concatenate([part.plain() for part in parts])
    ids = [part.track_id for part in parts if part.track_id is not None and len(part)]
    return Census(
        sequence=np.array(dataset.sequences, dtype=np.str_),
        conditions=_conditions(conditions),
        objects=counts,
        frame=np.repeat(np.arange(len(counts)), np.maximum(counts, 0)),
        name=np.array(names, dtype=np.str_),
        range_m=np.hypot(together.centre_m[:, 0], together.centre_m[:, 1]),
        size_m=together.size_m,
        visibility=np.array(sight, dtype=np.str_),
        track=np.concatenate(ids) if tracked and ids else None,
        farfield_class=dict(zip(names, np.asarray(together.label).tolist(), strict=True)),
        damaged=tuple(rows.damaged),
    )


def class_names(frame: Frame, boxes: Boxes) -> list[str]:
    """Class of each box as the data set's files have it, where the reader tells; else Farfield's."""
    raw = None if frame.annotation is None else frame.annotation.original_label
    return np.asarray(boxes.label).tolist() if raw is None else [str(name) for name in raw]


def visibility(frame: Frame, boxes: Boxes) -> list[str]:
    """How each box is seen: K-Radar's availability, KITTI's occlusion, or the points inside; else ``unknown``."""
    annotation = frame.annotation
    if annotation is not None and annotation.visibility is not None:
        return [_KRADAR_SIGHT.get(str(flag), UNKNOWN) for flag in annotation.visibility]
    hidden = None if annotation is None else annotation.details.get("occlusion")
    if hidden is not None:
        return [_KITTI_SIGHT[int(level)] if 0 <= int(level) < 3 else UNKNOWN for level in hidden]
    if boxes.point_count is not None:
        level_index = np.digitize(boxes.point_count, (0, 1, 10)) - 1
        return [_POINTS[int(level)] for level in level_index]
    return [UNKNOWN] * len(boxes)


# What is special about a data set, in words beside its figures.


def dataset_notes(dataset: Dataset) -> tuple[str, ...]:
    """Of a K-Radar: versions of its annotations, and where its conditions come from; nothing of others."""
    reader = dataset.unwrapped
    if not isinstance(reader, KRadar):
        return ()
    versions = Counter(reader.entries[index].version or "none" for index in dataset.origins)
    sources: Counter[str] = Counter()
    for sequence in dict.fromkeys(dataset.sequences):
        try:
            sources[reader.of_sequence(sequence).conditions_from or "nowhere"] += 1
        except FarfieldError:
            sources["a damaged file"] += 1
    shown = ", ".join(f"{version} in {count_of(count, 'frame', spec=',')}" for version, count in versions.most_common())
    source_text = ", ".join(f"{source} in {count_of(count, 'sequence')}" for source, count in sources.most_common())
    return f"annotations: {shown}", f"conditions come from: {source_text}"
