"""What a detector lost: missed objects and false boxes, each with a loss, and the frames that lost most.

An annotated object that was found loses one less the score of the best box that finds it, a missed one loses 1, a false
box its score; a frame loses the sum. So no threshold decides, and a sure mistake counts more than an unsure one.
"""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import itemgetter
from pathlib import Path
from typing import Any, Literal

import numpy as np

from farfield.errors import ConfigError, FileFormatError
from farfield.evaluation.report_data import of_classes
from farfield.files.json_text import read_json
from farfield.frame.where import Where, columns_of_boxes
from farfield.geometry.boxes import Boxes
from farfield.metrics.detections import Detections
from farfield.metrics.frames import in_region
from farfield.metrics.presenting import HitRule

LOST = "lost.json"
KINDS = ("missed", "false", "unsure")
BY = ("class", "range", "points", "weather", "road", "time", "sequence")
"""By what losses are summed."""
_FORMAT, _MOST_OBJECTS, _MOST_BYTES = 1, 2000, 64 << 20
_RANGE_EDGES_M = (0, 30, 70, 100, 150, 200, 250)
_POINT_EDGES = (0, 1, 5, 10, 20, 50, 100, 500)
_NUMBERS = ("loss", "range_m", "x_m", "y_m", "z_m", "length_m", "width_m", "height_m", "yaw_deg", "points", "score")
_TEXTS = ("kind", "sequence", "frame", "label", "weather", "road", "time")

Row = Mapping[str, Any]


def lost_of(
    detections: Detections,
    *,
    finding: HitRule,
    labels: Collection[str] | None,
    settings: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """What was lost in the frames of some detections, as JSON values.

    Args:
        detections: The detections.
        finding: When a box counts as found.
        labels: Classes that count; None for all.
        settings: The score's settings: boxes outside its region do not count; None for everywhere.

    Returns:
        ``frames`` and ``objects``, those that lost most first; objects that were found by a score of 0.5 or more are
        left out, and of the others all but the first 2,000. ``other_classes`` counts the annotated objects of classes
        that do not count.
    """
    objects: list[dict[str, Any]] = []
    frames: list[dict[str, Any]] = []
    region, others = _region_of(settings or {}), Counter[str]()
    for key, annotation in detections.annotations.items():
        conditions = detections.conditions.get(key, {})
        counts, inside = of_classes(annotation.boxes, labels), in_region(annotation.boxes, region)
        annotated = annotation[counts & inside]
        others.update(np.asarray(annotation.boxes.label)[~counts & inside].tolist())
        boxes = detections.boxes.get(key, Boxes.empty(scored=True))
        boxes = boxes[of_classes(boxes, labels) & in_region(boxes, region)]
        finder = finding.found_by(boxes, annotated.boxes)
        score = np.zeros(len(boxes)) if boxes.score is None else boxes.score
        taken = np.where(finder >= 0, score[finder] if len(score) else 0.0, 0.0)
        false = np.setdiff1d(np.arange(len(boxes)), finder[finder >= 0])
        marked = columns_of_boxes(annotated.boxes, key, conditions, annotated)
        wrong = columns_of_boxes(boxes[false], key, conditions)
        kinds = np.where(finder < 0, "missed", "unsure")
        own = _rows({**marked, "kind": kinds, "loss": 1.0 - taken, "score": np.where(finder < 0, np.nan, taken)})
        own += _rows({**wrong, "kind": np.full(len(false), "false"), "loss": score[false], "score": score[false]})
        frames.append(
            {
                "sequence": key[0],
                "frame": key[1],
                "loss": round(sum(row["loss"] for row in own), 4),
                "missed": int((finder < 0).sum()),
                "false": len(false),
                "annotated": len(annotated.boxes),
                **{name: str(conditions[name]) for name in ("weather", "road", "time") if name in conditions},
            }
        )
        objects += [row for row in own if row["kind"] != "unsure" or row["loss"] > 0.5]
    return {
        "finding": str(finding),
        "classes": sorted(labels or ()),
        "other_classes": dict(others.most_common()),
        "frames": sorted(frames, key=itemgetter("loss"), reverse=True),
        "objects": sorted(objects, key=itemgetter("loss"), reverse=True)[:_MOST_OBJECTS],
        "objects_in_all": len(objects),
    }


@dataclass(frozen=True)
class _Region:
    """Where boxes count."""

    region: Literal["window", "range", "none"]
    range_bins_m: tuple[float, ...]
    window_m: tuple[float, float, float, float]


def _region_of(settings: Mapping[str, Any]) -> _Region:
    """The region of a score's settings; everywhere, where they name none of ours."""
    name, edges, window = (settings.get(word) for word in ("region", "range_bins_m", "window_m"))
    if name not in ("window", "range") or not edges or (name == "window" and not window):
        return _Region("none", (), (0.0, 0.0, 0.0, 0.0))
    bounds = tuple(map(float, window or (0, 0, 0, 0)))
    return _Region(name, tuple(map(float, edges)), (bounds[0], bounds[1], bounds[2], bounds[3]))


def _rows(columns: Mapping[str, Any]) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    for number in range(len(columns["loss"])):
        row: dict[str, Any] = {name: str(columns[name][number]) for name in _TEXTS if name in columns}
        for name in _NUMBERS:
            value = float(columns[name][number]) if name in columns else np.nan
            if np.isfinite(value):
                row[name] = round(value, 4)
        rows.append(row)
    return rows


@dataclass(frozen=True, kw_only=True)
class Lost:
    """What an evaluation lost on one cloud.

    Args:
        cloud: Its name.
        finding: When an object counts as found, in words.
        frames: The frames, those that lost most first.
        objects: The objects, likewise.
        objects_in_all: How many there were before only the first were written.
        classes: Classes that count; none for all.
        other_classes: Number of annotated objects of each other class.
    """

    cloud: str
    finding: str
    frames: Sequence[Row]
    objects: Sequence[Row]
    objects_in_all: int
    classes: tuple[str, ...] = ()
    other_classes: Mapping[str, int] = field(default_factory=dict)

    def where(self, condition: Where | None, kinds: Collection[str] = KINDS) -> "Lost":
        """The objects of some kinds that fulfil a condition, and the frames that hold such, by their loss of these.

        Args:
            condition: The condition; None for all.
            kinds: Some of :data:`KINDS`.
        """
        rows = [row for row in self.objects if row["kind"] in kinds]
        if condition is not None:
            rows = [row for row in rows if condition.holds(_columns(row), 1)[0]]
        if condition is None and set(kinds) == set(KINDS):
            return self
        sums: dict[tuple[str, str], dict[str, Any]] = {}
        whole = {(row["sequence"], row["frame"]): row for row in self.frames}
        for row in rows:
            key = (row["sequence"], row["frame"])
            one = sums.setdefault(key, {**whole.get(key, {}), **dict(zip(("sequence", "frame"), key, strict=True))})
            if "counted" not in one:
                one |= {"counted": True, "loss": 0.0, "missed": 0, "false": 0}
            one["loss"] += row["loss"]
            one["missed"] += row["kind"] == "missed"
            one["false"] += row["kind"] == "false"
        frames = sorted(sums.values(), key=itemgetter("loss"), reverse=True)
        return replace(self, frames=frames, objects=rows, objects_in_all=len(rows))

    def by(self, kind: str) -> list[dict[str, Any]]:
        """Losses summed by a property, the greatest first.

        Args:
            kind: One of :data:`BY`.

        Raises:
            ConfigError: If it is none.
        """
        if kind not in BY:
            raise ConfigError(f"--by: expected one of {', '.join(BY)}, got {kind!r}")
        sums: dict[str, dict[str, Any]] = {}
        for row in self.objects:
            one = sums.setdefault(_value(row, kind), {"loss": 0.0, "missed": 0, "false": 0, "unsure": 0})
            one["loss"] += row["loss"]
            one[row["kind"]] += 1
        rows = [{"value": value, **one} for value, one in sums.items()]
        return sorted(rows, key=itemgetter("loss"), reverse=True)


def read_lost(folder: Path) -> list[Lost]:
    """What an evaluation lost, cloud by cloud.

    Args:
        folder: The evaluation's folder, or the file in it.

    Raises:
        ConfigError: If there is no such file.
        FileFormatError: If it is damaged.
    """
    path = folder / LOST if folder.is_dir() else folder.parent / LOST
    if not folder.exists() or not path.is_file():
        raise ConfigError(f"{folder}: expected {LOST}, as farfield evaluate writes it; found none. Run it again")
    tree = read_json(path, max_bytes=_MOST_BYTES)
    try:
        return [
            Lost(
                cloud=str(cloud),
                finding=str(part["finding"]),
                frames=[_checked(row, ("sequence", "frame"), ("loss",)) for row in part["frames"]],
                objects=[_checked(row, ("kind", "sequence", "frame", "label"), ("loss",)) for row in part["objects"]],
                objects_in_all=int(part["objects_in_all"]),
                classes=tuple(map(str, part.get("classes", ()))),
                other_classes={str(name): int(count) for name, count in part.get("other_classes", {}).items()},
            )
            for cloud, part in tree["clouds"].items()
        ]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise FileFormatError(
            path, where="the file", expected="what farfield evaluate writes", got=f"{type(error).__name__} {error}"
        ) from None


def lost_json(by_cloud: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """The content of the file.

    Args:
        by_cloud: What :func:`lost_of` gives, by cloud.
    """
    return {"format": _FORMAT, "clouds": dict(by_cloud)}


def _checked(row: Any, texts: Sequence[str], numbers: Sequence[str]) -> dict[str, Any]:
    if not all(isinstance(row[name], str) for name in texts) or not all(
        isinstance(row[name], int | float) for name in numbers
    ):
        raise ValueError(f"a row {str(row)[:80]}")
    if "kind" in row and row["kind"] not in KINDS:
        raise ValueError(f"the kind {str(row['kind'])[:40]}")
    return dict(row)


def _columns(row: Row) -> dict[str, Any]:
    columns = {name: np.array([row[name]]) for name in (*_NUMBERS, *_TEXTS) if name in row}
    if "x_m" in row:
        columns["bearing_deg"] = np.degrees(np.arctan2([float(row["y_m"])], [float(row["x_m"])]))
    return columns


def _value(row: Row, kind: str) -> str:
    if kind == "range":
        return _bin(float(row.get("range_m", 0.0)), _RANGE_EDGES_M, " m")
    if kind == "points":
        return "not counted" if "points" not in row else _bin(float(row["points"]), _POINT_EDGES, " points")
    return str(row.get("label" if kind == "class" else kind, "not stated"))


def _bin(value: float, edges: Sequence[int], unit: str) -> str:
    number = int(np.searchsorted(edges, value, side="right")) - 1
    upper = edges[number + 1] if number + 1 < len(edges) else None
    return f"{edges[number]}{f'-{upper}' if upper is not None else '+'}{unit}"
