"""Statistics of the data that claims compare: points in annotated boxes by range, returns on objects by weather."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from farfield.datasets import Dataset
from farfield.errors import ConfigError
from farfield.geometry.boxes import BOX_MARGIN_M, count_points_in_boxes
from farfield.jobs import JobOptions, Unit, UnitResult, values
from farfield.metrics.deciding import Difference, measured
from farfield.papers.claims import ClaimSide, Comparison
from farfield.papers.locations import DataLocation
from farfield.vocabulary.patterns import PATTERNS

LEAST_RETURNS = 5
"""Returns from which an object counts as detectable."""
_LIDAR = "os2-64"


@dataclass(frozen=True, eq=False, kw_only=True)
class AnnotatedObjects:
    """The annotated objects of some sets, row by row.

    Args:
        points: Points of each cloud in each box, shape (n,), by cloud; -1 where a frame lacks the cloud.
        range_m: Distance of each in the plane, shape (n,).
        road: Number of the road that each is on: sequences of one name are one road in several weathers, shape (n,).
        weather: Weather of its frame, shape (n,); empty where it is not recorded.
        label: Its class, shape (n,).
        roads: Number of roads.
    """

    points: Mapping[str, Int[np.ndarray, " n"]]
    range_m: Float[np.ndarray, " n"]
    road: Int[np.ndarray, " n"]
    weather: Shaped[np.ndarray, " n"]
    label: Shaped[np.ndarray, " n"]
    roads: int

    @property
    def columns(self) -> dict[str, Any]:
        """Range, class, weather and points, for pictures."""
        return {
            "range_m": self.range_m,
            "label": self.label,
            "weather": self.weather,
            "points": dict(self.points),
        }

    def inside(self, part: str) -> Bool[np.ndarray, " n"]:
        """Which objects belong to a part: ``"overall"``, ``"200-250"`` or ``"weather/rain"``."""
        if part == "overall":
            return np.ones(len(self.range_m), dtype=bool)
        if part.startswith("weather/"):
            return np.asarray(self.weather == part.removeprefix("weather/"))
        low_m, high_m = map(float, part.split("-"))
        return np.asarray((self.range_m >= low_m) & (self.range_m < high_m))


@dataclass(frozen=True)
class _PointCounting:
    """Counts the points in the boxes of a frame; the unit's parameters are its index."""

    data: Dataset

    memory_bytes = 600_000_000

    def __call__(self, unit: Unit) -> UnitResult:
        frame = self.data[unit.parameters]
        if frame.annotation is None:
            return UnitResult()
        boxes = frame.annotation.boxes
        named = [name for name in (*PATTERNS, _LIDAR) if name in frame.clouds]
        clouds = {name: frame.cloud(name).points_m for name in named}
        counts = {name: count_points_in_boxes(points, boxes, margin_m=BOX_MARGIN_M) for name, points in clouds.items()}
        rows = (counts, boxes.range_m, frame.sequence, str(frame.conditions.get("weather", "")), boxes.label)
        return UnitResult(value=rows)


def objects_in(locations: Mapping[str, DataLocation], options: JobOptions) -> AnnotatedObjects:
    """Count points on the annotated objects of all sets.

    Args:
        locations: The sets.
        options: Workers and progress.
    """
    frames: list[Any] = []
    for location in locations.values():
        data = location.open()
        units = [Unit("/".join(key), parameters=index) for index, key in enumerate(data.keys)]
        results = values(_PointCounting(data), units, options)
        frames += [result.value for result in results if result.value is not None]
    roads = {name: number for number, name in enumerate(sorted({sequence for _, _, sequence, _, _ in frames}))}
    clouds = sorted({name for counts, *_ in frames for name in counts})
    lengths = [len(range_m) for _, range_m, *_ in frames]
    missing = [np.full(length, -1, dtype=np.int64) for length in lengths]
    return AnnotatedObjects(
        points={
            name: _concat([counts.get(name, gap) for (counts, *_), gap in zip(frames, missing, strict=True)], np.int64)
            for name in clouds
        },
        range_m=_concat([range_m for _, range_m, *_ in frames], np.float64),
        road=np.repeat([roads[sequence] for _, _, sequence, _, _ in frames], lengths).astype(np.int64),
        weather=np.repeat(np.array([weather for *_, weather, _ in frames], dtype=np.str_), lengths),
        label=np.concatenate([np.asarray(label, dtype=np.str_) for *_, label in frames] or [np.zeros(0, np.str_)]),
        roads=len(roads),
    )


def _concat(arrays: list[Any], kind: Any) -> Any:
    return np.concatenate(arrays).astype(kind) if arrays else np.zeros(0, dtype=kind)


Value = Callable[[Int[np.ndarray, " n"], Float[np.ndarray, " n"]], float | None]


def statistic_difference(pair: Comparison, statistic: str, objects: AnnotatedObjects, *, replicates: int) -> Difference:
    """The difference of a statistic between two rows of a claim, with its spread over roads.

    Args:
        pair: The rows, with their cloud and part.
        statistic: Its name.
        objects: The annotated objects.
        replicates: Draws of the roads.

    Raises:
        ConfigError: If there is no such statistic.
    """
    statistics: dict[str, Value] = {
        "log_points_in_boxes": _log_mean,
        "share_of_objects_with_returns": _share_with_returns,
    }
    if statistic not in statistics:
        raise ConfigError(f"statistic: expected one of {', '.join(statistics)}; got {statistic!r}")
    of_weights = partial(_difference, pair, statistics[statistic], objects)
    return measured(of_weights, objects.roads, replicates=replicates)


def _log_mean(points: Int[np.ndarray, " n"], weight: Float[np.ndarray, " n"]) -> float | None:
    """Logarithm of the weighted mean number of points; None where there is none."""
    total = float(weight.sum())
    mean = float(weight @ points) / total if total else 0.0
    return math.log(mean) if mean > 0 else None


def _share_with_returns(points: Int[np.ndarray, " n"], weight: Float[np.ndarray, " n"]) -> float | None:
    """Weighted share of objects with enough returns; None without objects."""
    total = float(weight.sum())
    return float(weight @ (points >= LEAST_RETURNS)) / total if total else None


def _row_value(
    row: ClaimSide, value: Value, objects: AnnotatedObjects, weight: Float[np.ndarray, " roads"]
) -> float | None:
    """The statistic of a row's part, minus that of the part that it subtracts; roads count by their weight."""
    points = objects.points.get(row.cloud)
    if points is None:
        return None
    total = 0.0
    for sign, part in zip((1, -1), row.parts, strict=False):
        rows = np.flatnonzero(objects.inside(part) & (points >= 0))
        of_part = value(points[rows], weight[objects.road[rows]])
        if of_part is None:
            return None
        total += sign * float(of_part)
    return total


def _difference(
    pair: Comparison, value: Value, objects: AnnotatedObjects, weight: Float[np.ndarray, " roads"]
) -> float | None:
    a, b = (_row_value(row, value, objects, weight) for row in (pair.a, pair.b))
    return None if a is None or b is None else a - b
