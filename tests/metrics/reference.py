"""A slow, plain evaluation box by box, written from the definitions: the oracle for the vectorised one."""

import math
from typing import Any

import numpy as np

from farfield.geometry.boxes import Boxes
from farfield.geometry.iou import aligned_iou
from farfield.metrics.centre.settings import CentreSettings

from .scenes import ByFrame


def evaluate(
    predictions: ByFrame, annotations: ByFrame, s: CentreSettings, low: float = 0.0, high: float = math.inf
) -> dict[str, Any]:
    """DDS, mAP and aIoU by epsilon, AP by threshold at the first epsilon; None where nothing is annotated."""
    keys = sorted(annotations, key=lambda key: (key[0], int(key[1])))
    if s.ties == "later_first":  # by the lines of the file, as the devkit sees them
        keys = [*predictions, *(key for key in keys if key not in predictions)]
    found, real = _collect(predictions, annotations, keys, s)
    binned = s.range_assign == "match_then_bin"
    if not binned:
        found = [p for p in found if low <= p["range"] < high]
        real = [g for g in real if low <= g["range"] < high]
    if s.ties == "later_first":
        found.sort(key=lambda p: (-p["score"], -p["index"]))
    else:
        found.sort(key=lambda p: (-p["score"], p["frame"], p["index"]))
    total = sum(not g["ignored"] and (not binned or low <= g["range"] < high) for g in real)
    result: dict[str, Any] = {}
    for epsilon in s.epsilons:
        aps, overlaps = [], []
        for threshold in s.thresholds_m:
            rows = _match(found, real, threshold, epsilon, s)
            if binned:
                rows = [(p, g) for p, g in rows if low <= (p if g is None else g)["range"] < high]
            aps.append(_ap(rows, total, s.ap))
            if s.aiou_threshold_m in ("all", threshold):
                overlaps.append(1 - _tp_mean(rows, total, s))
        result[f"{epsilon:g}"] = None
        if total:
            result[f"{epsilon:g}"] = {"ap": aps, "map": float(np.mean(aps)), "aiou": float(np.mean(overlaps))}
    return result


def _nearest(part: Boxes) -> list[int]:
    """The nearer box first, then that of the least x, y, z, l, w, h, yaw, class."""
    rows = [[*map(float, row), str(name)] for row, name in zip(part.to_numpy(), part.label, strict=True)]
    return sorted(range(len(rows)), key=lambda i: [float(np.hypot(*rows[i][:2])), *rows[i]])


def _collect(predictions: ByFrame, annotations: ByFrame, keys: list, s: CentreSettings) -> tuple[list, list]:
    found, real = [], []
    for frame, key in enumerate(keys):
        part, marks = predictions.get(key), annotations[key]
        if s.ties == "nearest_first":
            part, marks = None if part is None else part[_nearest(part)], marks[_nearest(marks)]
        rows = [] if part is None else sorted(range(len(part)), key=lambda i: (-part.score[i], i))[: s.max_boxes]
        for i in sorted(rows):
            if s.relabel.get(str(part.label[i]), str(part.label[i])) == s.label and _inside(part.centre_m[i], s):
                found.append(_row(part, i, frame) | {"score": float(part.score[i]), "index": len(found)})
        for i in range(len(marks)):
            label = s.relabel.get(str(marks.label[i]), str(marks.label[i]))
            enough = s.min_points == 0 or marks.point_count[i] < 0 or marks.point_count[i] >= s.min_points
            if label in (s.label, *s.ignore) and _inside(marks.centre_m[i], s) and enough:
                real.append(_row(marks, i, frame) | {"ignored": label in s.ignore})
    return found, real


def _row(part: Any, i: int, frame: int) -> dict[str, Any]:
    x, y, _ = part.centre_m[i]
    return {"frame": frame, "box": part[i], "centre": part.centre_m[i], "range": math.hypot(x, y)}


def _inside(centre: np.ndarray, s: CentreSettings) -> bool:
    x, y, _ = centre
    if s.region == "none":
        return True
    inside = s.range_bins_m[0] <= math.hypot(x, y) < s.range_bins_m[-1]
    return inside if s.region == "range" else inside and 0 <= x <= 250 and abs(y) <= 50


def _match(found: list, real: list, threshold: float, epsilon: float, s: CentreSettings) -> list:
    """(prediction, annotated or None) in rank order, without the dropped ones."""
    taken: set[int] = set()
    rows = []
    for p in found:
        best, least, limit = None, math.inf, 0.0
        for j, g in enumerate(real):
            if j in taken or g["frame"] != p["frame"]:
                continue
            axes = 3 if s.distance == "3d" else 2
            distance = math.sqrt(sum((a - b) ** 2 for a, b in zip(p["centre"][:axes], g["centre"][:axes], strict=True)))
            omega = math.exp(epsilon * (g if s.omega_range == "gt" else p)["range"])
            cost = distance / omega if s.match == "nearest_normalised" else distance
            if cost < least:
                best, least, limit, true_distance = j, cost, threshold * omega, distance
        if best is not None and true_distance < limit:
            if real[best]["ignored"]:
                continue
            taken.add(best)
            rows.append((p, real[best]))
        else:
            rows.append((p, None))
    return rows


def _ap(rows: list, total: int, method: str) -> float:
    hits = np.cumsum([g is not None for _, g in rows]) if rows else np.zeros(0)
    if total == 0 or len(rows) == 0 or hits[-1] == 0:
        return 0.0
    precision, recall = hits / np.arange(1, len(rows) + 1), hits / total
    if method in ("area", "voc"):
        area = 0.0
        for i, (_, g) in enumerate(rows):
            if g is not None:
                area += (precision[i:].max() if method == "voc" else precision[i]) / total
        return area
    sampled = np.interp(np.linspace(0, 1, 101), recall, precision, right=0)
    if method == "interp101":
        return float(sampled.mean())
    return float(np.clip(sampled[11:] - 0.1, 0, None).mean() / 0.9)


def _tp_mean(rows: list, total: int, s: CentreSettings) -> float:
    hits = np.cumsum([g is not None for _, g in rows]) if rows else np.zeros(0)
    if total == 0 or len(rows) == 0 or hits[-1] == 0:
        return 1.0
    pairs = [(p, g) for p, g in rows if g is not None]
    sides = [
        Boxes.concatenate([pair[side]["box"].replace(score=None, point_count=None) for pair in pairs])
        for side in (0, 1)
    ]
    errors = 1 - aligned_iou(*sides, kind=s.aiou)
    if s.aiou_mean == "tp_mean":
        return float(errors.mean())
    running = np.cumsum(errors) / np.arange(1, len(errors) + 1)
    scores = np.array([p["score"] for p, _ in rows])
    confidence = np.interp(np.linspace(0, 1, 101), hits / total, scores, right=0)
    last = np.flatnonzero(confidence)[-1]
    if last < 11:
        return 1.0
    matched = np.array([p["score"] for p, _ in pairs])
    return float(np.interp(confidence[::-1], matched[::-1], running[::-1])[::-1][11 : last + 1].mean())
