"""Parts of what was found: the frames of a road, a weather or a time of day, the boxes of a sector; and every class."""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Bool

from farfield.errors import ConfigError
from farfield.files.disk_dict import MappedView, alike
from farfield.frame.drive import Key
from farfield.frame.where import ANNOTATED_COLUMNS, Where
from farfield.geometry.boxes import Boxes
from farfield.metrics.centre.matching import found_by
from farfield.metrics.detections import PROTOCOLS, Detections, Protocol
from farfield.metrics.frames import BoxesByFrame
from farfield.metrics.result import Result, nest
from farfield.vocabulary.conditions import CONDITIONS

AZIMUTHS_DEG = (0.0, 15.0, 30.0, 60.0)
"""Edges of the sectors to both sides of straight ahead: a Gaussian pattern is densest in the middle."""

KINDS = (*CONDITIONS, "azimuth")
"""By what detections can be parted."""


def parts(
    detections: Detections, kinds: Collection[str] = KINDS, *, azimuths_deg: Sequence[float] = AZIMUTHS_DEG
) -> dict[str, dict[str, Detections]]:
    """Detections by condition of their frames and by sector.

    A sector such as ``"15-30"`` holds the annotated and predicted boxes whose own azimuth, to the left or to the
    right, lies in [15, 30) degrees: each sector is scored as if there were nothing beside it, as range bins are.

    Args:
        detections: Detections.
        kinds: Some of :data:`KINDS`; a condition that no frame states has no entry.
        azimuths_deg: Edges of the sectors, degrees, rising.

    Returns:
        By kind and value, such as ``["road"]["urban"]``, in the order of the vocabulary.
    """
    detections = replace(detections.counted(), checked=True)  # notes on oddities are those of the whole
    parted = dict[str, dict[str, Detections]]()
    for kind in (kind for kind in CONDITIONS if kind in kinds):
        stated = {key: conditions[kind] for key, conditions in detections.conditions.items() if kind in conditions}
        present = set(stated.values())
        values = [name for name in CONDITIONS[kind] if name in present]
        values += sorted(present.difference(values))
        if values:
            parted[kind] = {
                value: _of_frames(detections, {k for k, v in stated.items() if v == value}) for value in values
            }
    if "azimuth" in kinds:
        edges = [(low, high) for low, high in pairwise(map(float, azimuths_deg))]
        parted["azimuth"] = {
            f"{low:g}-{high:g}": _of_boxes(detections, partial(_in_sector, low, high)) for low, high in edges
        }
    return parted


def by_part(
    detections: Detections,
    protocol: str | Protocol = "dds",
    kinds: Collection[str] = KINDS,
    *,
    azimuths_deg: Sequence[float] = AZIMUTHS_DEG,
    **settings: Any,
) -> dict[str, dict[str, Result]]:
    """Score each part of the detections by itself; arguments are those of :func:`parts` and of ``Detections.score``.

    All parts have the class that is most frequent in the whole unless one is given.

    Raises:
        ConfigError: As of ``Detections.score``.
    """
    chosen = PROTOCOLS[protocol] if isinstance(protocol, str) else protocol
    if settings.get("label") is None and "label" in chosen.options():
        settings["label"] = getattr(chosen.settings(detections.counted(), **settings), "label", None)
    parted = parts(detections, kinds, azimuths_deg=azimuths_deg)
    return {
        kind: {value: part.score(chosen, **settings) for value, part in values.items()}
        for kind, values in parted.items()
    }


def parts_json(scored: Mapping[str, Mapping[str, Result]]) -> dict[str, Any]:
    """The figures of parts as JSON values, under the names that K-Radar's results have them under.

    Args:
        scored: What :func:`by_part` gives.

    Returns:
        ``conditions`` and ``counts`` by kind and value, ``intervals`` by ``"kind/value"``; null is "not annotated".
    """
    tree: dict[str, Any] = {"conditions": {}, "counts": {}, "intervals": {}}
    for kind, values in scored.items():
        for value, part in values.items():
            is_scored = any(figure is not None for figure in part.figures.values())
            tree["conditions"].setdefault(kind, {})[value] = nest(part.figures) if is_scored else None
            counts = {name: number for name, number in part.counts.items() if isinstance(number, int)}
            tree["counts"].setdefault(kind, {})[value] = counts
            tree["intervals"][f"{kind}/{value}"] = nest(part.intervals.get("overall", {}))
    return tree


def of_slice(detections: Detections, where: Where) -> Detections:
    """The boxes that fulfil a condition, predicted and annotated, and the frames in which some may.

    Predicted boxes lack some columns, such as the number of points: where the condition uses one, a predicted box
    goes with the annotated one that it finds, and stays where it finds none.

    Args:
        detections: Detections.
        where: The condition.

    Raises:
        ConfigError: If no annotated box fulfils it.
    """
    counted = detections.counted()
    boxes, annotations = alike(counted.boxes), alike(counted.annotations)
    details: dict[Key, Any] = {}
    before, after = [0, 0], [0, 0]
    for key, annotation in counted.annotations.items():
        conditions, predicted = counted.conditions.get(key, {}), counted.boxes[key]
        before = [before[0] + len(annotation.boxes), before[1] + len(predicted)]
        if not where.of_frame(key, conditions):
            continue
        marked = where.of_boxes(annotation.boxes, key, conditions, annotation)
        if where.columns & set(ANNOTATED_COLUMNS):
            finder = found_by(predicted, annotation.boxes)
            inside = np.ones(len(predicted), dtype=bool)
            inside[finder[(finder >= 0) & ~marked]] = False
        else:
            inside = where.of_boxes(predicted, key, conditions)
        boxes[key], annotations[key] = predicted[inside], annotation[marked]
        after = [after[0] + int(marked.sum()), after[1] + int(inside.sum())]
        if key in counted.prediction_details:
            rows = counted.prediction_details[key]
            details[key] = {name: np.asarray(values)[inside] for name, values in rows.items()}
    if not after[0]:
        raise ConfigError(f"--where {where.text}: expected annotated boxes that fulfil it, found none of {before[0]}")
    note = (
        f"where {where.text}: {after[0]} of {before[0]} annotated and {after[1]} of {before[1]} predicted boxes count, "
        f"in {len(annotations)} of {len(counted.annotations)} frames"
    )
    return replace(
        counted,
        boxes=boxes,
        annotations=annotations,
        prediction_details=details,
        conditions={key: values for key, values in counted.conditions.items() if key in annotations},
        notes=(*counted.notes, note),
    )


def _of_frames(detections: Detections, keys: Collection[Any]) -> Detections:
    boxes, annotations = alike(detections.boxes), alike(detections.annotations)
    for key in (key for key in detections.annotations if key in keys):
        boxes[key], annotations[key] = detections.boxes[key], detections.annotations[key]
    return replace(
        detections,
        boxes=boxes,
        annotations=annotations,
        prediction_details={key: rows for key, rows in detections.prediction_details.items() if key in annotations},
        conditions={key: conditions for key, conditions in detections.conditions.items() if key in annotations},
    )


def _of_boxes(detections: Detections, inside: Callable[[Boxes], Bool[np.ndarray, " n"]]) -> Detections:
    masks = {key: inside(detections.boxes[key]) for key in detections.prediction_details}
    details = {
        key: {name: np.asarray(rows)[masks[key]] for name, rows in columns.items()}
        for key, columns in detections.prediction_details.items()
    }
    return replace(
        detections,
        boxes=MappedView(detections.boxes, partial(_cut, inside)),
        annotations=MappedView(detections.annotations, partial(_cut_annotation, inside)),
        prediction_details=details,
    )


def _cut(inside: Callable[[Boxes], Any], boxes: Boxes) -> Boxes:
    return boxes[inside(boxes)]


def _cut_annotation(inside: Callable[[Boxes], Any], annotation: Any) -> Any:
    return annotation[inside(annotation.boxes)]


def _in_sector(low_deg: float, high_deg: float, boxes: Boxes) -> Bool[np.ndarray, " n"]:
    beside = np.abs(np.arctan2(boxes.centre_m[:, 1], boxes.centre_m[:, 0]))
    return (beside >= math.radians(low_deg)) & (beside < math.radians(high_deg))


@dataclass(frozen=True)
class ClassRow:
    """One class in a table of all classes.

    Args:
        label: The class.
        annotated: How many boxes of it are annotated; where it is scored by itself, in the region that counts.
        figures: Its figures by name; None where there is none.
        why: Why there is none: ``"not annotated"``, ``"not learnt"``, or ``"counted as vehicle"``; empty if there is.
    """

    label: str
    annotated: int
    figures: Mapping[str, float | None] | None
    why: str

    def to_json(self) -> dict[str, Any]:
        """The row as JSON values."""
        return {"annotated": self.annotated, "figures": self.figures, **({"why": self.why} if self.why else {})}


def mean_of_classes(rows: Sequence[ClassRow]) -> dict[str, Any] | None:
    """The mean of each figure over the classes that have it, each class counting alike; None below two classes.

    Args:
        rows: What :func:`by_class` gives.

    Returns:
        ``of``, ``annotated`` (all of them) and ``figures``, as JSON values.
    """
    scored = [row for row in rows if row.figures and any(value is not None for value in row.figures.values())]
    if len(scored) < 2:
        return None
    means: dict[str, float | None] = {}
    for name in dict.fromkeys(name for row in scored for name in row.figures or ()):
        values = [value for row in scored if (value := (row.figures or {}).get(name)) is not None]
        means[name] = sum(values) / len(values) if len(values) == len(scored) else None
    labels, annotated = [row.label for row in scored], sum(row.annotated for row in scored)
    return {"of": labels, "annotated": annotated, "figures": means}


def by_class(detections: Detections, protocol: str | Protocol = "dds", **settings: Any) -> list[ClassRow]:
    """A row for each class of a data set, null where nothing is annotated or learnt.

    The classes are the protocol's: Cirrus' eight, or for K-Radar's protocols its seven, of which the two groups are
    counted as what they are groups of; and all others that the detector knows. A class stands for itself where the
    detector learnt it; where it learnt the class only
    under another name (large vehicles as vehicles) it is counted there, as the setting ``relabel`` says.

    Args:
        detections: Detections; without a word on what the detector learnt, the classes that it found count as learnt.
        protocol: The protocol or its name.
        **settings: Its settings; a label is of no use here.

    Raises:
        ConfigError: If a setting is unknown or impossible.
    """
    chosen = PROTOCOLS[protocol] if isinstance(protocol, str) else protocol
    detections, settings = detections.counted(), {name: value for name, value in settings.items() if name != "label"}
    annotated, learnt = _labels(detections.annotated), set(detections.classes) or set(_labels(detections.boxes))
    relabel = {**(settings.get("relabel") or chosen.default("relabel") or {})}
    relabel = {name: other for name, other in relabel.items() if name not in learnt}
    class_settings = {**settings, "relabel": relabel}
    rows, listed_labels = list[ClassRow](), set[str]()
    listed = {*chosen.classes, *chosen.classes.values()}
    others = {name: name for name in detections.classes or sorted(learnt) if name not in listed}
    for name, label in {**chosen.classes, **others}.items():
        other = relabel.get(label, label)
        number = sum(count for alias, count in annotated.items() if relabel.get(alias, alias) == label)
        if label in listed_labels:
            rows.append(ClassRow(name, 0, None, f"counted as {label}"))
        elif other != label and other in chosen.classes.values():
            rows.append(ClassRow(name, annotated.get(label, 0), None, f"counted as {other}"))
        elif not number:
            rows.append(ClassRow(name, 0, None, "not annotated"))
        elif not any(relabel.get(alias, alias) == label for alias in learnt):
            rows.append(ClassRow(name, number, None, "not learnt"))
        else:
            figures, counted = _figures_of(
                detections, chosen, label, settings if chosen.several_classes else class_settings
            )
            why = "" if figures else f"not scored by {chosen}"
            rows.append(ClassRow(name, number if counted is None else counted, figures, why))
        listed_labels.add(label)
    return rows


def _figures_of(
    detections: Detections, protocol: Protocol, label: str, settings: Mapping[str, Any]
) -> tuple[dict[str, float | None] | None, int | None]:
    """The headline of one class, None where the protocol leaves the class out, and how many boxes of it counted."""
    options = dict(settings)
    if "ignore" in protocol.options():
        ignore = settings.get("ignore") or protocol.default("ignore") or ()
        options["ignore"] = tuple(name for name in ignore if name != label)
    if not protocol.several_classes:
        options["label"] = label
    result = detections.evaluated(protocol, protocol.settings(detections, **options)).to_json()
    figures, prefix = protocol.headline(result), f"ap/{label}/"
    if not protocol.several_classes:
        counted = result["counts"].get("annotated")
        return dict(figures), counted if isinstance(counted, int) else None
    own = {name.removeprefix(prefix): value for name, value in figures.items() if name.startswith(prefix)}
    counted = (result["counts"].get("classes") or {}).get(label, {}).get("annotated")
    return own or None, counted if isinstance(counted, int) else None


def _labels(boxes: BoxesByFrame) -> dict[str, int]:
    counts: dict[str, int] = {}
    for part in boxes.values():
        for name in np.asarray(part.label).tolist():
            counts[name] = counts.get(name, 0) + 1
    return counts
