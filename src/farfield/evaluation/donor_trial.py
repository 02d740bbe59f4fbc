"""A detector's false vehicles over the pasted cars that it finds: the curve, what it falls into, and its intervals."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64

from farfield.errors import DatasetError
from farfield.frame import Boxes

# The constants are frozen: what is measured later is measured with the same eye.
RANGES_M = ((6, 20), (20, 35), (35, 50), (50, 70))
LEAST_POINTS, RECALL = 5, 0.8
RECALLS = (0.5, 0.6, 0.7, 0.8, 0.9)
POINTS = ((1, 5), (5, 20), (20, 100), (100, 1 << 30))
KINDS = ("plant", "wall or other tall thing", "few points", "other")
DRAWS = 500


@dataclass(frozen=True, kw_only=True)
class PastedCar:
    """One car in one sweep.

    Args:
        sweep: Row of the sweep.
        range_m: Ground distance of its middle.
        points: Its points.
        score: Score of the detection at its place; -inf where there is none.
    """

    sweep: int
    range_m: float
    points: int
    score: float


@dataclass(frozen=True, kw_only=True)
class FalseVehicle:
    """One vehicle that is detected where none is.

    Args:
        sweep: Row of the sweep.
        score: Its score.
        kind: What stands there, one of :data:`KINDS`.
        box: Its box, one row.
        points: Points in it.
    """

    sweep: int
    score: float
    kind: str
    box: Boxes
    points: int


Shares = dict[str, tuple[float | None, int]]
"""Recall and number of cars by what they are sorted by; None of no car."""


@dataclass
class DonorTrial:
    """A detector's false vehicles and found cars in some sweeps.

    Args:
        sweeps: How many.
        cars: The pasted cars.
        false: The false vehicles.
        scenes: Scene of each sweep; sweeps of one scene look alike, so whole scenes are drawn where there are several.
    """

    sweeps: int = 0
    cars: list[PastedCar] = field(default_factory=list)
    false: list[FalseVehicle] = field(default_factory=list)
    scenes: list[str] = field(default_factory=list)

    def add(self, other: "DonorTrial", name: str) -> None:
        """Take in the sweeps of another set, whose scenes are called after it."""
        self.cars += [replace(car, sweep=car.sweep + self.sweeps) for car in other.cars]
        self.false += [replace(one, sweep=one.sweep + self.sweeps) for one in other.false]
        self.scenes += [f"{name}/{scene}" for scene in other.scenes]
        self.sweeps += other.sweeps

    def drawn_sweeps(self, rng: np.random.Generator) -> Int64[np.ndarray, " s"]:
        """Rows of sweeps of one draw: of scenes with all their sweeps, or of sweeps where all are of one scene."""
        names = sorted(set(self.scenes))
        if len(names) < 2:
            return rng.integers(self.sweeps, size=self.sweeps)
        rows = {name: [row for row, scene in enumerate(self.scenes) if scene == name] for name in names}
        drawn = rng.integers(len(names), size=len(names))
        return np.concatenate([np.asarray(rows[names[row]], dtype=np.int64) for row in drawn])

    def curve(self, sweeps: Int64[np.ndarray, " s"] | None = None) -> tuple[Float64[np.ndarray, " t"], ...]:
        """Thresholds, falling, with the recall of cars of five points and more and the false vehicles a sweep.

        Args:
            sweeps: Rows of sweeps that count, as often as they are named (default: all).
        """
        weight = np.bincount(np.arange(self.sweeps) if sweeps is None else sweeps, minlength=self.sweeps)
        cars = [car for car in self.cars if car.points >= LEAST_POINTS]
        car_score = np.array([car.score for car in cars])
        car_weight = np.array([weight[car.sweep] for car in cars], dtype=np.float64)
        false_score = np.array([one.score for one in self.false])
        false_weight = np.array([weight[one.sweep] for one in self.false], dtype=np.float64)
        threshold = np.unique(np.concatenate([car_score[np.isfinite(car_score)], false_score]))[::-1]
        recall = _weight_above(car_score, car_weight, threshold) / max(car_weight.sum(), 1)
        return threshold, recall, _weight_above(false_score, false_weight, threshold) / max(weight.sum(), 1)

    def at_recall(self, recall: float = RECALL, sweeps: Int64[np.ndarray, " s"] | None = None) -> float | None:
        """False vehicles a sweep at the highest threshold of a recall; None where it is not reached."""
        _, reached, false = self.curve(sweeps)
        at = np.flatnonzero(reached >= recall)
        return float(false[at[0]]) if len(at) else None

    def threshold_at(self, recall: float = RECALL) -> float | None:
        """The threshold of a recall; None where it is not reached."""
        threshold, reached, _ = self.curve()
        at = np.flatnonzero(reached >= recall)
        return float(threshold[at[0]]) if len(at) else None

    def recall_by_range(self, threshold: float) -> Shares:
        """Recall and number of cars of five points and more by range, at a threshold."""
        return recall_by_range([car for car in self.cars if car.points >= LEAST_POINTS], threshold, RANGES_M)

    def recall_by_points(self, threshold: float) -> Shares:
        """The same by points."""
        return recall_by_points(self.cars, threshold, POINTS)

    def false_by_range(self, threshold: float) -> dict[str, float]:
        """False vehicles a sweep by range, at a threshold; those nearer than the first range count there."""
        counted = [one for one in self.false if one.score >= threshold]
        range_m = np.array([one.box.range_m[0] for one in counted])
        nearest_m = RANGES_M[0][0]
        return {
            f"{low}-{high} m": float(((range_m >= low * (low > nearest_m)) & (range_m < high)).sum())
            / max(self.sweeps, 1)
            for low, high in RANGES_M
        }

    def false_by_points(self, threshold: float) -> dict[str, float]:
        """False vehicles a sweep by the points in their boxes, at a threshold."""
        points = np.array([one.points for one in self.false if one.score >= threshold])
        return {
            _span_name(low, high): float(((points >= low) & (points < high)).sum()) / max(self.sweeps, 1)
            for low, high in ((0, POINTS[0][0]), *POINTS)
        }

    def to_json(self) -> dict[str, Any]:
        """All of it as JSON values; a car that is not found has no score."""
        return {
            "sweeps": self.sweeps,
            "scenes": self.scenes,
            "cars": [asdict(car) | {"score": None if np.isinf(car.score) else car.score} for car in self.cars],
            "false": [
                {
                    "sweep": one.sweep,
                    "score": one.score,
                    "kind": one.kind,
                    "points": one.points,
                    "box": [*one.box.centre_m[0].tolist(), *one.box.size_m[0].tolist(), float(one.box.yaw_rad[0])],
                    "label": str(one.box.label[0]),
                }
                for one in self.false
            ],
        }

    @classmethod
    def from_json(cls, tree: Mapping[str, Any]) -> "DonorTrial":
        """What :meth:`to_json` gave."""
        cars = [PastedCar(**row | {"score": -np.inf if row["score"] is None else row["score"]}) for row in tree["cars"]]
        false = []
        for row in tree["false"]:
            numbers = np.array(row["box"], dtype=np.float64)
            box = Boxes(
                centre_m=numbers[None, :3],
                size_m=numbers[None, 3:6],
                yaw_rad=numbers[6:],
                label=[row["label"]],
                score=np.array([row["score"]]),
            )
            same = {name: row[name] for name in ("sweep", "score", "kind", "points")}
            false.append(FalseVehicle(box=box, **same))
        return cls(sweeps=tree["sweeps"], cars=cars, false=false, scenes=list(tree["scenes"]))


def recall_by_range(cars: Sequence[PastedCar], threshold: float, spans: Sequence[tuple[int, int]]) -> Shares:
    """Recall and number of cars by range at a threshold."""
    return {
        f"{low}-{high} m": _share(cars, threshold, [low <= car.range_m < high for car in cars]) for low, high in spans
    }


def recall_by_points(cars: Sequence[PastedCar], threshold: float, spans: Sequence[tuple[int, int]]) -> Shares:
    """Recall and number of cars by points at a threshold."""
    return {
        _span_name(low, high): _share(cars, threshold, [low <= car.points < high for car in cars])
        for low, high in spans
    }


def _share(cars: Sequence[PastedCar], threshold: float, inside: Sequence[bool]) -> tuple[float | None, int]:
    scores = np.array([car.score for car, counts in zip(cars, inside, strict=True) if counts])
    return (float(np.mean(scores >= threshold)) if len(scores) else None), len(scores)


def _span_name(low: int, high: int) -> str:
    if high >= 1 << 30:
        return f"{low} and more"
    return str(low) if high == low + 1 else f"{low} to {high - 1}"


def _weight_above(
    score: Float64[np.ndarray, " n"], weight: Float64[np.ndarray, " n"], threshold: Float64[np.ndarray, " t"]
) -> Float64[np.ndarray, " t"]:
    """Weight of the scores at or above each threshold."""
    order = np.argsort(score)
    below = np.searchsorted(score[order], threshold, side="left")
    total = np.concatenate([[0.0], np.cumsum(weight[order])])
    return total[-1] - total[below]


Figure = Callable[[DonorTrial, Int64[np.ndarray, " s"]], float | None]
"""A figure of a trial over some rows of sweeps, as often as they are named; None where it is not reached."""


def interval_over_sweeps(trial: DonorTrial, statistic: Figure, *, draws: int = DRAWS) -> tuple[float, float] | None:
    """A 95 % interval of a figure over drawn scenes, the same draws for every detector; None where it is not reached.

    Of a single scene its sweeps are drawn. The upper end is infinite where some draws do not reach the figure.

    Args:
        trial: The trial.
        statistic: The figure over some rows of sweeps.
        draws: How often scenes are drawn.
    """
    rng = np.random.default_rng(0)
    values = [statistic(trial, trial.drawn_sweeps(rng)) for _ in range(draws)]
    reached = [np.inf if value is None else value for value in values]
    low, high = np.quantile(reached, [0.025, 0.975], method="nearest")
    return (float(low), float(high)) if np.isfinite(low) else None


def paired_difference(
    before: DonorTrial, after: DonorTrial, statistic: Figure, *, draws: int = DRAWS
) -> tuple[float, tuple[float, float] | None] | None:
    """A figure's change between two runs over the same sweeps, with its 95 % interval over scenes drawn for both alike.

    Args:
        before: The first run.
        after: The second.
        statistic: The figure over some rows of sweeps.
        draws: How often scenes are drawn.

    Returns:
        The difference, after less before, and its interval, None where a run does not reach the figure in more than one
        of twenty draws; None where a run does not reach it at all.

    Raises:
        DatasetError: If the two runs are not of the same scenes.
    """
    if (before.sweeps, before.scenes) != (after.sweeps, after.scenes):
        raise DatasetError(
            f"expected two runs over the same sweeps, got {before.sweeps} of {len(set(before.scenes))} scenes and "
            f"{after.sweeps} of {len(set(after.scenes))}"
        )
    rng = np.random.default_rng(0)
    rows = [np.arange(before.sweeps), *(before.drawn_sweeps(rng) for _ in range(draws))]
    pairs = [(statistic(before, sweeps), statistic(after, sweeps)) for sweeps in rows]
    changes = [np.nan if old is None or new is None else new - old for old, new in pairs]
    if np.isnan(changes[0]):
        return None
    drawn = np.array(changes[1:])
    if not draws or np.isnan(drawn).mean() > 0.05:
        return changes[0], None
    low, high = np.nanquantile(drawn, [0.025, 0.975])
    return changes[0], (float(low), float(high))
