"""K-Radar's average precision (Paek et al., NeurIPS 2022): AP3D and AP_BEV by class, overlap and condition.

The measure is KITTI's: annotated boxes choose predictions, precision is sampled at 41 recalls. Protocol ``kradar``
takes boxes as they stand, the mean over 40 recalls, and every frame; the ``kradar-compat`` variants repeat what
K-Radar's development kit computes, see :mod:`farfield.metrics.kradar.settings`. Figures lie in [0, 1], the table shows
per cent.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from farfield.frame.drive import Drive, Key
from farfield.metrics.bootstrap import Bootstrap, Statistics, Weighted, intervals
from farfield.metrics.counts import ThresholdCounts, recall_mean, shifted
from farfield.metrics.frames import BoxesByFrame
from farfield.metrics.kradar.conditions import group_conditions
from farfield.metrics.kradar.counting import MEASURES, ClassMatches, count, match
from farfield.metrics.kradar.frames import KRadarFrames, Visibility, gather_kradar
from farfield.metrics.kradar.settings import KRadarSettings
from farfield.metrics.result import Result, nest, table
from farfield.vocabulary.conditions import CONDITIONS, condition_name

__all__ = ["KRadarResult", "KRadarSettings", "evaluate_kradar"]

_SEEN_BY = ("R", "L", "L1")
_NAMES = {"R": "seen by the radar", "L": "seen by the LiDAR alone", "L1": "visibility not known"}
_Counts = dict[tuple[str, float], ThresholdCounts]
Conditions = Mapping[Key, Mapping[str, str]]


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class KRadarResult(Result):
    """AP by class, measure and overlap: overall, by range, condition and visibility.

    Args:
        conditions: Figures by kind of condition (``weather``, ``road``, ``time``) and value.
        visibility: Figures of the boxes that the radar sees (``R``), the LiDAR alone (``L``), not known (``L1``); the
            others may then be found or not.
    """

    conditions: Mapping[str, Mapping[str, Statistics]] = field(default_factory=dict)
    visibility: Mapping[str, Statistics] = field(default_factory=dict)

    def __str__(self) -> str:
        tables = "\n\n".join(self._table(label) for label in self.settings["classes"])
        cut = self.counts["predictions_cut"]
        note = f"{cut} predictions at or below the score cut are left out" if cut else ""
        frames = f"{self.counts['frames']} of {self.counts['frames_given']} frames count"
        return f"{tables}\n\n{frames}; {note or 'no prediction is cut'}\n{self.footer()}"

    def to_json(self) -> dict[str, Any]:
        """The result as JSON values, see :meth:`Result.to_json`; with ``conditions`` and ``visibility``."""
        tree = super().to_json()
        tree["conditions"] = {
            kind: {value: _known(part) for value, part in parts.items()} for kind, parts in self.conditions.items()
        }
        tree["visibility"] = {name: _known(part) for name, part in self.visibility.items()}
        return tree

    def parts(self) -> Iterator[tuple[str, str, Statistics, Mapping[str, Any]]]:
        """Name, title, figures and counts of the whole and of every subset."""
        yield "overall", "all", self.figures, self.counts
        for name, part in self.ranges.items():
            yield name, f"{name} m", part, self.counts["ranges"][name]
        for kind, values in self.conditions.items():
            for value, part in values.items():
                yield f"{kind}/{value}", f"{kind}: {value}", part, self.counts["conditions"][kind][value]
        for name, part in self.visibility.items():
            yield f"visibility/{name}", _NAMES.get(name, name), part, self.counts["visibility"][name]

    def _table(self, label: str) -> str:
        names = [(measure, f"{iou:g}") for measure in MEASURES for iou in self.settings["ious"]]
        rows = []
        for part, title, figures, counted in self.parts():
            values = [figures.get(f"ap/{label}/{measure}/{iou}") for measure, iou in names]
            cells = ["-" if value is None else f"{100 * value:.2f}" for value in values]
            rows.append([title, *cells, *(str(counted["classes"][label][n]) for n in ("annotated", "predictions"))])
            drawn = [self.intervals.get(part, {}).get(f"ap/{label}/{measure}/{iou}") for measure, iou in names]
            if part == "overall" and any(drawn):
                spans = [f"{100 * d[0]:.1f}-{100 * d[1]:.1f}" if d else "-" for d in drawn]
                rows.append(["  [low, high]", *spans, "", ""])
        head = ["", *(f"{measure.upper()} {iou}" for measure, iou in names), "annotated", "predicted"]
        return f"{self.protocol}: AP of {label!r} in per cent; '-': nothing annotated\n\n{table(head, rows)}"


def evaluate_kradar(
    predictions: BoxesByFrame,
    annotations: BoxesByFrame,
    settings: KRadarSettings | None = None,
    *,
    conditions: Conditions | None = None,
    visibility: Visibility | None = None,
    protocol: str = "kradar",
    drives: Sequence[Drive] = (),
) -> KRadarResult:
    """Score predictions with K-Radar's average precision.

    Args:
        predictions: Scored boxes by (sequence, frame). A frame without an entry has no detections.
        annotations: Annotated boxes by (sequence, frame): every frame that counts, those without boxes too.
        settings: The options; None takes those of ``kradar``. Variants: :func:`kradar_settings`.
        conditions: ``weather``, ``road`` and ``time`` of each frame. Every subset is then scored by itself.
        visibility: ``R``, ``L`` or ``L1`` of each annotated box of a frame, in the order of its boxes.
        protocol: What the result is to be called.
        drives: Drives of the data, which the bootstrap draws; without them sequences are drawn.

    Returns:
        Figures in [0, 1] named ``ap/vehicle/3d/0.3``, ``ap/vehicle/bev/0.5``...

    Raises:
        ConfigError: If predictions lie in frames that are not annotated, lack scores, or the visibility does not fit.
    """
    settings = settings or KRadarSettings()
    data = gather_kradar(predictions, annotations, settings, visibility, drives)
    counted, counts = _all_counts(data, settings, conditions or {}, with_visibility=visibility is not None)
    figures = {part: _figures(found, settings) for part, found in counted.items()}
    ranges = {f"{low:g}-{high:g}": figures.pop(f"{low:g}-{high:g}") for low, high in settings.bins_m}
    by_kind: dict[str, dict[str, Statistics]] = {}
    for part in figures:
        kind, _, value = part.partition("/")
        if value:
            by_kind.setdefault(kind, {})[value] = figures[part]
    seen = by_kind.pop("visibility", {})
    return KRadarResult(
        protocol=protocol,
        label=settings.label,
        settings=settings.to_json(),
        convention=settings.convention(),
        figures=figures["overall"],
        ranges=ranges,
        conditions=by_kind,
        visibility=seen,
        counts=_nested(counts, len(annotations), data.cut),
        intervals=_intervals(counted, figures | ranges, data, settings),
        grouped_by=data.grouped_by,
        curves={"overall": _curves(counted["overall"])},
    )


def weighted_kradar(
    predictions: BoxesByFrame,
    annotations: BoxesByFrame,
    settings: KRadarSettings,
    *,
    conditions: Conditions | None = None,
    visibility: Visibility | None = None,
    drives: Sequence[Drive] = (),
) -> Weighted:
    """The figures as functions of group weights; the arguments are those of :func:`evaluate_kradar`."""
    data = gather_kradar(predictions, annotations, settings, visibility, drives)
    by_group = replace(settings, bootstrap=Bootstrap(replicates=2))  # counts are kept by group
    counted, _ = _all_counts(data, by_group, conditions or {}, with_visibility=visibility is not None)
    parts = {
        name: partial(_moved_part, name, *_drawing({name: found}, data, settings)) for name, found in counted.items()
    }
    return Weighted(parts=parts, groups=tuple(data.group.tolist()), grouped_by=data.grouped_by)


_Parts = dict[str, dict[str, _Counts]]


def _all_counts(
    data: KRadarFrames, settings: KRadarSettings, conditions: Conditions, *, with_visibility: bool
) -> tuple[_Parts, dict[str, dict[str, Any]]]:
    """Counts at thresholds by part and class, and the numbers of frames and boxes by part."""
    tally = _ThresholdTally(data, drawn=settings.bootstrap.replicates > 0)
    subsets = list(_subsets(data, conditions))
    for kind, label in enumerate(settings.classes):
        whole = match(data, settings, kind)
        tally.add("overall", label, whole)
        for part, inside in subsets:
            tally.add(part, label, whole, inside)
        for low_m, high_m in settings.bins_m:
            near = {
                name: (side.range_m >= low_m) & (side.range_m < high_m)
                for name, side in (("predicted_in", data.predicted), ("annotated_in", data.annotated))
            }
            tally.add(f"{low_m:g}-{high_m:g}", label, match(data, settings, kind, **near))
        for name in _SEEN_BY if with_visibility else ():
            unlike = data.annotated.seen_by != name
            tally.add(f"visibility/{name}", label, match(data, settings, kind, optional=unlike))
    return tally.parts, tally.counts


class _ThresholdTally:
    """Counts at thresholds by part and class, and the numbers of frames and boxes by part.

    Args:
        data: All frames.
        drawn: Whether intervals are drawn, so that counts are kept by group.
    """

    def __init__(self, data: KRadarFrames, *, drawn: bool) -> None:
        self.data = data
        self.group = data.group if drawn else np.zeros(len(data.keys), dtype=np.int64)
        self.groups = data.groups if drawn else 1
        self.parts: _Parts = {}
        self.counts: dict[str, dict[str, Any]] = {}

    def add(self, part: str, label: str, matched: ClassMatches, inside: Bool[np.ndarray, " f"] | None = None) -> None:
        """Count one class in one part: in all frames, or in those marked."""
        self.parts.setdefault(part, {})[label] = count(matched, inside, self.group, self.groups)
        counted = self.data.counted if inside is None else self.data.counted & inside
        here = self.counts.setdefault(part, {"frames": int(counted.sum()), "classes": {}})
        there = [matched.annotated_frame, matched.frame]
        sums = [len(frame) if inside is None else int(inside[frame].sum()) for frame in there]
        here["classes"][label] = dict(zip(("annotated", "predictions"), sums, strict=True))


def _subsets(data: KRadarFrames, conditions: Conditions) -> Iterator[tuple[str, Bool[np.ndarray, " f"]]]:
    """Frames of each condition of which anything is known."""
    for kind in CONDITIONS:
        if not any(kind in values for values in conditions.values()):
            continue
        stated = [condition_name(conditions.get(key, {}).get(kind, "")) for key in data.keys]
        values = np.array(stated, dtype=np.str_)
        for value in group_conditions(conditions, kind):
            yield f"{kind}/{value}", values == value


def _figures(found: Mapping[str, _Counts], settings: KRadarSettings) -> Statistics:
    values: Statistics = {}
    for label, counts in found.items():
        for (measure, iou), at in counts.items():
            sampled = at.sampled(gaps=settings.sampling == "gaps")
            value = None if sampled is None else recall_mean(sampled, settings.recall_points)
            values[f"ap/{label}/{measure}/{iou:g}"] = value
    return values


def _intervals(
    parts: _Parts, point: Mapping[str, Statistics], data: KRadarFrames, settings: KRadarSettings
) -> dict[str, dict[str, list[float] | None]]:
    """Interval of each figure: the figure plus what the smooth AP gains or loses under resampling."""
    if settings.bootstrap.replicates == 0:
        return {}
    flat = _flat(parts)
    drawn: dict[str, dict[str, list[float] | None]] = {}
    moved = partial(_moved, settings.recall_points, flat, point, _start(flat, data, settings))
    for name, interval in intervals(moved, data.groups, settings.bootstrap).items():
        part, _, figure = name.partition("|")
        drawn.setdefault(part, {})[figure] = interval
    return drawn


def _flat(parts: _Parts) -> dict[str, ThresholdCounts]:
    return {
        f"{part}|ap/{label}/{measure}/{iou:g}": at
        for part, found in parts.items()
        for label, counts in found.items()
        for (measure, iou), at in counts.items()
    }


def _start(
    flat: Mapping[str, ThresholdCounts], data: KRadarFrames, settings: KRadarSettings
) -> dict[str, float | None]:
    """The smooth AP of every figure, from which draws depart."""
    return {name: _smooth(settings.recall_points, at, np.ones(data.groups)) for name, at in flat.items()}


def _drawing(
    parts: _Parts, data: KRadarFrames, settings: KRadarSettings
) -> tuple[int, dict[str, ThresholdCounts], dict[str, Statistics], dict[str, float | None]]:
    """What :func:`_moved` takes before the weights."""
    flat, point = _flat(parts), {part: _figures(found, settings) for part, found in parts.items()}
    return settings.recall_points, flat, point, _start(flat, data, settings)


def _moved_part(
    part: str,
    points: int,
    flat: Mapping[str, ThresholdCounts],
    point: Mapping[str, Statistics],
    start: Mapping[str, float | None],
    weight: Float[np.ndarray, " g"],
) -> Statistics:
    return {name.removeprefix(f"{part}|"): v for name, v in _moved(points, flat, point, start, weight).items()}


def _smooth(points: int, at: ThresholdCounts, weight: Float[np.ndarray, " g"]) -> float | None:
    sampled = at.smooth(weight)
    return None if sampled is None else recall_mean(sampled, points)


def _moved(
    points: int,
    flat: Mapping[str, ThresholdCounts],
    point: Mapping[str, Statistics],
    start: Mapping[str, float | None],
    weight: Float[np.ndarray, " g"],
) -> Statistics:
    values: Statistics = {}
    for name, at in flat.items():
        part, _, figure = name.partition("|")
        values[name] = shifted(point[part][figure], _smooth(points, at, weight), start[name])
    return values


def _nested(counts: dict[str, dict[str, Any]], given: int, cut: int) -> dict[str, Any]:
    """Counts as the result holds them: the whole at the top, subsets by kind."""
    for part in counts.values():
        for name in ("annotated", "predictions"):
            part[name] = sum(found[name] for found in part["classes"].values())
    tree = {**counts.pop("overall"), "frames_given": given, "predictions_cut": cut}
    tree |= {"ranges": {}, "conditions": {}, "visibility": {}}
    for name, part in counts.items():
        kind, _, value = name.partition("/")
        if not value:
            tree["ranges"][name] = part
        elif kind == "visibility":
            tree["visibility"][value] = part
        else:
            tree["conditions"].setdefault(kind, {})[value] = part
    return tree


def _curves(found: Mapping[str, _Counts]) -> dict[str, dict[str, dict[str, Any]]]:
    tree: dict[str, dict[str, dict[str, Any]]] = {}
    for label, counts in found.items():
        for (measure, iou), at in counts.items():
            tree.setdefault(label, {}).setdefault(measure, {})[f"{iou:g}"] = at.curve()
    return tree


def _known(part: Statistics) -> dict[str, Any] | None:
    return None if all(value is None for value in part.values()) else nest(part)
