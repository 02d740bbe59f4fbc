"""What reports need: figures out of result JSON, which objects were found, and what a sensor calls its returns."""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32

from farfield.errors import ConfigError
from farfield.frame import Frame
from farfield.geometry.boxes import Boxes
from farfield.metrics.presenting import HitRule
from farfield.metrics.result import at
from farfield.radar.views import PRODUCTS, radar_views
from farfield.vocabulary.counts import count_of
from farfield.vocabulary.scores import SHOWN_SCORE

Result = Mapping[str, Any]


def part_names(result: Result) -> list[str]:
    """Names of the range bins, near to far."""
    names = result.get("ranges") or {}
    return sorted(names, key=lambda name: float(name.split("-")[0]))


def figure(result: Result, name: str, *, part: str = "overall") -> float | None:
    """One figure such as ``"dds/0/map"`` or ``"ap/0.5"`` of the whole or of a range bin.

    Args:
        result: Result JSON.
        name: Path of the figure.
        part: ``"overall"`` or a range bin's name.
    """
    home = result if part == "overall" else at(result, ("ranges", part))
    value = at(home, name.split("/"))
    return None if value is None else _number(value, f"{part} {name}")


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ConfigError(f"result, {where}: expected a number or null, got {value!r}. Score the predictions again.")
    return float(value)


def interval(result: Result, name: str, *, part: str = "overall") -> tuple[float, float] | None:
    """The bootstrap interval of a figure, or None."""
    value = at(result, ("intervals", part, *name.split("/")))
    if not isinstance(value, list | tuple) or len(value) != 2:
        return None
    return _number(value[0], f"interval of {name}"), _number(value[1], f"interval of {name}")


def counts(result: Result, *, part: str = "overall") -> dict[str, int]:
    """Counts of annotated boxes and predictions, as far as the result has them."""
    node = at(result, ("counts",)) if part == "overall" else at(result, ("counts", "ranges", part))
    return {name: int(value) for name, value in (node or {}).items() if isinstance(value, int)}


def scored_labels(results: Mapping[str, Result]) -> tuple[str, ...] | None:
    """Classes that count in the scores, merged ones included; None where the results do not say."""
    for result in results.values():
        settings = result.get("settings") or {}
        one = result.get("label") or settings.get("label")
        labels = settings.get("classes") or ([one] if one else [])
        if labels:
            merged = [name for name, target in (settings.get("relabel") or {}).items() if target in labels]
            return tuple(dict.fromkeys([*map(str, labels), *merged]))
    return None


# Which annotated boxes were found: for pictures and points-per-box plots, not for scores (those are in metrics).

VEHICLES = ("vehicle", "large_vehicle")
Key = tuple[str, str]


def of_classes(boxes: Boxes, labels: Collection[str] | None) -> Bool[np.ndarray, " n"]:
    """Which boxes bear one of the labels, shape (n,); all of them if ``labels`` is None."""
    return np.ones(len(boxes), dtype=bool) if labels is None else np.isin(boxes.label, list(labels))


def confident(predictions: Boxes, score_min: float) -> Boxes:
    """The predictions whose score is at least ``score_min``; all of them where there are no scores."""
    return predictions if predictions.score is None else predictions[predictions.score >= score_min]


def shown_predictions(predictions: Boxes | None, score_min: float) -> tuple[Boxes | None, str]:
    """The predictions that a picture shows, and what it says of the others; nothing where it shows all."""
    if predictions is None:
        return None, ""
    shown = confident(predictions, score_min)
    if len(shown) == len(predictions):
        return shown, ""
    return shown, f"{len(shown)} of {count_of(len(predictions), 'box', 'boxes')}: score {score_min:g} or more"


def annotated_objects(
    predictions: Mapping[Key, Boxes],
    annotations: Mapping[Key, Boxes],
    *,
    labels: Collection[str] | None = VEHICLES,
    score_min: float = SHOWN_SCORE,
    finding: HitRule | None = None,
    kind: str = "lidar",
) -> dict[str, Any]:
    """Collect range, point count and whether found of every annotated object, as JSON values for a report.

    Args:
        predictions: Scored boxes by (sequence, frame).
        annotations: Annotated boxes by (sequence, frame); boxes without a known point count are left out.
        labels: Classes that count; None for all.
        score_min: Predictions below it do not find anything.
        finding: When a box counts as found (default: within 2 m).
        kind: Of which sensor the points are.

    Returns:
        Lists ``range_m``, ``point_count``, ``found`` of equal length, ``score_min``, and ``finding`` in words.
    """
    finding = finding or HitRule()
    range_m: list[float] = []
    point_count: list[int] = []
    is_found: list[bool] = []
    for key, annotated in annotations.items():
        annotated = annotated[of_classes(annotated, labels)]
        if annotated.point_count is None:
            continue
        detected = confident(predictions.get(key, Boxes.empty(scored=True)), score_min)
        finder = finding.found_by(detected[of_classes(detected, labels)], annotated)
        counted = annotated.point_count >= 0
        range_m += np.round(annotated.range_m[counted], 2).tolist()
        point_count += annotated.point_count[counted].tolist()
        is_found += (finder[counted] >= 0).tolist()
    rows = {"range_m": range_m, "point_count": point_count, "found": is_found}
    return {**rows, "score_min": score_min, "finding": str(finding), "kind": kind}


# What a cloud's measurements are called: a LiDAR has points, a radar has cells of power.

_QUICK = ("cube", "cells")  # products that need no search for echoes
_WORDS = {"lidar": ("LiDAR point", "LiDAR points"), "radar": ("radar cell", "radar cells"), "": ("point", "points")}


def kind_of(frame: Frame, cloud: str | None) -> str:
    """Kind of the sensor that a cloud is of, ``"lidar"`` or ``"radar"``; empty where the frame does not say."""
    sensor = frame.sensors.get(cloud or next(iter(frame.clouds), ""))
    return "" if sensor is None else sensor.kind


def returns_word(kind: str, *, many: bool = False) -> str:
    """What one measurement of a cloud is called, or several."""
    return _WORDS.get(kind, _WORDS[""])[many]


def power_from_above(frame: Frame) -> Float32[np.ndarray, "y x"] | None:
    """A frame's mean power over height in dB, shape (400, 250), y and x of K-Radar's cube.

    Returns:
        None where the frame has no such product, or stands in other coordinates than the radar's.
    """
    if frame.reference != "radar" or not any(name in frame.radar for name in PRODUCTS):
        return None
    quick = next((name for name in _QUICK if name in frame.radar), None)
    products: Mapping[str, Any] = frame.radar if quick is None else {quick: frame.radar[quick]}
    views = radar_views(products)
    return None if views is None else views.bird_db
