"""Annotated objects: how far, of what class and size, and how many points each cloud lays on them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from farfield.frame import Boxes, Cloud
from farfield.geometry.boxes import count_points_in_boxes

DISTANCE_EDGES_M = np.geomspace(5.0, 320.0, 25)
VEHICLE_EDGES_M = np.linspace(0.0, 350.0, 36)
SURVIVAL_EDGES_M = np.array([0.0, 20.0, 40.0, 70.0, 100.0, 150.0, 250.0])
LEVEL_AT_M = 50.0
FIT_FROM_M, FIT_LEAST_BOXES, FIT_LEAST_POINTS = 10.0, 8, 3.0
NORMAL = "normal"


@dataclass(kw_only=True)
class ObjectRows:
    """One row for every annotated box: ground distance, class, size, weather, points by cloud, and radar excess."""

    frames: int = 0
    most_in_a_frame: int = 0
    _parts: list[tuple[Any, ...]] = field(default_factory=list)
    _counts: dict[str, list[tuple[int, Any]]] = field(default_factory=dict)
    _total: int = 0

    def add(
        self,
        boxes: Boxes,
        clouds: Mapping[str, Cloud],
        *,
        weather: str = "unknown",
        radar_excess: Float[np.ndarray, " n"] | None = None,
    ) -> None:
        """Count the points of each cloud in each box of one frame; ``radar_excess`` is kept as it is."""
        self.frames += 1
        self.most_in_a_frame = max(self.most_in_a_frame, len(boxes))
        if not len(boxes):
            return
        range_m = np.hypot(boxes.centre_m[:, 0], boxes.centre_m[:, 1])
        label = np.asarray(boxes.label, dtype=object)
        excess = np.full(len(boxes), np.nan) if radar_excess is None else radar_excess
        self._parts.append((range_m, label, boxes.size_m.copy(), np.full(len(boxes), weather, dtype=object), excess))
        for name, cloud in clouds.items():
            self._counts.setdefault(name, []).append((self._total, count_points_in_boxes(cloud.points_m, boxes)))
        self._total += len(boxes)

    def merge(self, other: "ObjectRows") -> None:
        """Take in the rows of other frames."""
        self.frames += other.frames
        self.most_in_a_frame = max(self.most_in_a_frame, other.most_in_a_frame)
        self._parts += other._parts
        for name, parts in other._counts.items():
            own = self._counts.setdefault(name, [])
            own += [(start + self._total, counts) for start, counts in parts]
        self._total += other._total

    def __len__(self) -> int:
        return self._total

    @property
    def range_m(self) -> Float[np.ndarray, " n"]:
        """Ground distance of each box's centre from the frame's origin."""
        return self._column(0, np.zeros(0))

    @property
    def label(self) -> Shaped[np.ndarray, " n"]:
        """Class of each box."""
        return self._column(1, np.zeros(0, dtype=object))

    @property
    def size_m(self) -> Float[np.ndarray, "n 3"]:
        """Length, width, height of each box."""
        return self._column(2, np.zeros((0, 3)))

    @property
    def weather(self) -> Shaped[np.ndarray, " n"]:
        """Weather of each box's frame."""
        return self._column(3, np.zeros(0, dtype=object))

    @property
    def radar_excess(self) -> Float[np.ndarray, " n"]:
        """Excess of the radar map at each box over its floor; NaN where unknown."""
        return self._column(4, np.zeros(0))

    @property
    def counts(self) -> dict[str, Int[np.ndarray, " n"]]:
        """Points inside each box by cloud; -1 where the frame had no such cloud."""
        columns = {}
        for name, parts in self._counts.items():
            column = np.full(self._total, -1, dtype=np.int64)
            for start, counts in parts:
                column[start : start + len(counts)] = counts
            columns[name] = column
        return columns

    def _column(self, number: int, empty: np.ndarray) -> np.ndarray:
        return np.concatenate([part[number] for part in self._parts]) if self._parts else empty

    def vehicles(self, labels: tuple[str, ...]) -> Bool[np.ndarray, " n"]:
        """Which boxes are of the classes that count as vehicles."""
        return np.isin(self.label.astype(np.str_), labels)

    def summary(self, vehicle_labels: tuple[str, ...]) -> dict[str, Any]:
        """Boxes a frame, classes with their sizes, and the distances of vehicles."""
        label, size_m = self.label.astype(np.str_), self.size_m
        names, number = np.unique(label, return_counts=True)
        classes = {}
        for row in np.argsort(-number, kind="stable"):
            class_size_m = size_m[label == names[row]]
            mean, std = class_size_m.mean(axis=0), class_size_m.std(axis=0)
            sizes = {
                axis: {"mean": float(mean[k]), "std": float(std[k])}
                for k, axis in enumerate(("length_m", "width_m", "height_m"))
            }
            classes[str(names[row])] = {
                "count": int(number[row]),
                "share": float(number[row] / len(label)),
                **sizes,
            }
        distance = np.histogram(self.range_m[self.vehicles(vehicle_labels)], VEHICLE_EDGES_M)[0]
        return {
            "annotated_frames": self.frames,
            "count": len(self),
            "per_frame": len(self) / max(self.frames, 1),
            "most_in_a_frame": self.most_in_a_frame,
            "classes": classes,
            "vehicle_distance": {"edges_m": VEHICLE_EDGES_M.tolist(), "count": distance.tolist()},
        }

    def points_summary(self, cloud: str, vehicle_labels: tuple[str, ...]) -> dict[str, Any]:
        """Points in vehicle boxes over distance, and by weather, for one cloud."""
        counts = self.counts.get(cloud, np.full(len(self), -1))
        chosen = self.vehicles(vehicle_labels) & (counts >= 0)
        range_m, count = self.range_m[chosen], counts[chosen]
        return {
            "points_in_vehicles": points_by_distance(range_m, count),
            "survival": survival(range_m, count, self.weather[chosen]),
        }

    def radar_summary(self, vehicle_labels: tuple[str, ...]) -> dict[str, Any] | None:
        """Radar excess at vehicles over distance, by weather; None without any."""
        chosen = self.vehicles(vehicle_labels) & np.isfinite(self.radar_excess)
        if not chosen.any():
            return None
        return radar_survival(self.range_m[chosen], self.radar_excess[chosen], self.weather[chosen])

    def pattern_ratio(self, vehicle_labels: tuple[str, ...]) -> float | None:
        """Points of the Gaussian over those of the uniform pattern in vehicles beyond 50 m; None without both."""
        counts = self.counts
        if not {"gaussian", "uniform"} <= set(counts):
            return None
        both = self.vehicles(vehicle_labels) & (counts["gaussian"] >= 0) & (counts["uniform"] >= 0)
        far = both & (self.range_m > 50.0)
        uniform = int(counts["uniform"][far].sum())
        return float(counts["gaussian"][far].sum() / uniform) if uniform else None


def points_by_distance(range_m: Float[np.ndarray, " n"], count: Int[np.ndarray, " n"]) -> dict[str, Any]:
    """Median points in a box for each bin of distance, and a straight line through them in log-log.

    The line is fitted to bins from 10 m on with at least 8 boxes and a median of at least 3 points, each weighted by
    its number of boxes. Nothing hidden and a sensor that resolves the boxes gives a slope of -2.

    Args:
        range_m: Distance of each box.
        count: Points inside each box.

    Returns:
        ``edges_m``, ``boxes``, ``median`` (None in empty bins), ``share_empty``, ``slope``, ``level`` (of the line at
        50 m) and ``fitted_m`` (from, to), the last three None where fewer than three bins qualify.
    """
    bin_index = np.digitize(range_m, DISTANCE_EDGES_M) - 1
    bins = len(DISTANCE_EDGES_M) - 1
    boxes = np.array([int((bin_index == k).sum()) for k in range(bins)])
    median = [float(np.median(count[bin_index == k])) if boxes[k] else None for k in range(bins)]
    empty = [float((count[bin_index == k] == 0).mean()) if boxes[k] else None for k in range(bins)]
    centre_m = np.sqrt(DISTANCE_EDGES_M[:-1] * DISTANCE_EDGES_M[1:])
    level = np.array([0.0 if value is None else value for value in median])
    used = (DISTANCE_EDGES_M[:-1] >= FIT_FROM_M - 1e-6) & (boxes >= FIT_LEAST_BOXES) & (level >= FIT_LEAST_POINTS)
    fit: dict[str, Any] = {"slope": None, "level": None, "fitted_m": None}
    if used.sum() >= 3:
        x = np.log10(centre_m[used] / LEVEL_AT_M)
        slope, height = np.polyfit(x, np.log10(level[used]), 1, w=np.sqrt(boxes[used]))
        ends = DISTANCE_EDGES_M[:-1][used][0], DISTANCE_EDGES_M[1:][used][-1]
        fit = {"slope": float(slope), "level": float(10**height), "fitted_m": [float(end) for end in ends]}
    return {
        "edges_m": DISTANCE_EDGES_M.tolist(),
        "boxes": boxes.tolist(),
        "median": median,
        "share_empty": empty,
        **fit,
    }


def survival(
    range_m: Float[np.ndarray, " n"], count: Int[np.ndarray, " n"], weather: Shaped[np.ndarray, " n"]
) -> dict[str, Any]:
    """Mean points in vehicle boxes by weather and distance, and their ratio to normal weather at the same distance.

    Args:
        range_m: Distance of each box.
        count: Points inside each box.
        weather: Weather of each box's frame.

    Returns:
        ``edges_m``, and for each weather ``boxes``, ``mean_points`` and ``ratio`` by bin; the ratio is None where
        either mean is missing or that of normal weather is 0. ``overall`` is the mean ratio over the bins that have
        one, each weighted by this weather's boxes.
    """
    bin_index = np.digitize(range_m, SURVIVAL_EDGES_M) - 1
    bins = range(len(SURVIVAL_EDGES_M) - 1)
    table: dict[str, Any] = {}
    for name in sorted(set(weather.tolist()), key=lambda values: (values != NORMAL, values)):
        members = [count[(weather == name) & (bin_index == k)] for k in bins]
        table[str(name)] = {
            "boxes": [len(values) for values in members],
            "mean_points": [float(values.mean()) if len(values) else None for values in members],
        }
    clear = table.get(NORMAL, {}).get("mean_points", [None for _ in bins])
    for row in table.values():
        row["ratio"] = [
            mean / base if mean is not None and base else None
            for mean, base in zip(row["mean_points"], clear, strict=True)
        ]
        ratios = [(ratio, n) for ratio, n in zip(row["ratio"], row["boxes"], strict=True) if ratio is not None]
        row["overall"] = sum(r * n for r, n in ratios) / sum(n for _, n in ratios) if ratios else None
    return {"edges_m": SURVIVAL_EDGES_M.tolist(), "weather": table}


def radar_survival(
    range_m: Float[np.ndarray, " n"], excess: Float[np.ndarray, " n"], weather: Shaped[np.ndarray, " n"]
) -> dict[str, Any]:
    """Median radar excess at vehicles by weather and distance, and its change against normal weather in dB.

    Args:
        range_m: Distance of each box.
        excess: Linear excess over the floor at each box.
        weather: Weather of each box's frame.

    Returns:
        ``edges_m``, and for each weather ``boxes``, ``median_db`` and ``change_db`` by bin, None where nothing rises
        above the floor; ``overall`` is the mean change, each bin weighted by this weather's boxes.
    """
    bin_index = np.digitize(range_m, SURVIVAL_EDGES_M) - 1
    bins = range(len(SURVIVAL_EDGES_M) - 1)
    table: dict[str, Any] = {}
    for name in sorted(set(weather.tolist()), key=lambda values: (values != NORMAL, values)):
        members = [excess[(weather == name) & (bin_index == k)] for k in bins]
        medians = [float(np.median(values)) if len(values) else 0.0 for values in members]
        levels = [10.0 * float(np.log10(values)) if values > 0 else None for values in medians]
        table[str(name)] = {"boxes": [len(values) for values in members], "median_db": levels}
    clear = table.get(NORMAL, {}).get("median_db", [None for _ in bins])
    for row in table.values():
        pairs = zip(row["median_db"], clear, strict=True)
        row["change_db"] = [None if a is None or b is None else a - b for a, b in pairs]
        changes = [(values, n) for values, n in zip(row["change_db"], row["boxes"], strict=True) if values is not None]
        row["overall"] = sum(values * n for values, n in changes) / sum(n for _, n in changes) if changes else None
    return {"edges_m": SURVIVAL_EDGES_M.tolist(), "weather": table}
