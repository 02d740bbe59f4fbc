"""How thick, how rough and how cluttered the roadside is: what a detector could take for a vehicle, or tell worlds by.

A real hedge is decimetres deep to a beam, a flat one has no depth at all. The statistics look at a sweep without its
annotated objects, in a sector ahead (and behind, where the sensor looks there): thickness T and scatter S of small
patches, the share S_all of what is neither ground nor planar, and clusters C of a car's size.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float, Float64, Int
from scipy.spatial import cKDTree

from farfield.frame import Boxes
from farfield.geometry.boxes import points_in_boxes
from farfield.geometry.clusters import car_sized
from farfield.geometry.ground import ground_m

Points = Float64[np.ndarray, "n 3"]

# The constants are frozen: what is measured later is measured with the same eye.
SECTOR_RAD, NEAR_M, FAR_M = np.deg2rad(60.0), 4.0, 40.0
_BEHIND_SHARE = 0.25  # of the points ahead: so many behind make a second sample, where somebody annotated there
_BELOW_M = 0.5
_BOX_MARGIN_M, _CLUSTER_BOX_MARGIN_M = 0.2, 0.5
_VOXEL_M, _PATCHES, _PATCH_M, _LEAST_POINTS, _LOW_M = 0.1, 1500, 0.75, 10, 0.3
_ROUGH = 0.03  # smallest share of a patch's variance that is no plane
_CLUSTER_IN_BOXES = 0.3  # of a cluster's points: those with more are an annotated object
_TELLING_VOXEL_M, _TELLING_POINTS, _TELLING_HIGH_M, _TELLING_PATCHES = 0.2, 24, 6.0, 500

FEATURES = ("smallest variance", "middle variance", "largest variance", "scatter", "linearity", "verticality", "height")
"""What a patch is told by: logarithms of the variances along its axes, their shares, the normal's tilt, the height."""


@dataclass(frozen=True, eq=False)
class BackgroundSample:
    """One sector of one sweep.

    Args:
        sequence: The sweep's sequence.
        thickness_m: T, median over the patches of the standard deviation along their normals; NaN without patches.
        scatter: S, share of the points above the ground about which lies no plane; NaN where there are none.
        scatter_of_all: S_all, S times the share of points above the ground.
        clusters: C, clusters of a car's size outside boxes.
        patches: Features of thinner patches, by which worlds can be told apart, shape (p, 7): :data:`FEATURES`.
        thickness_in_boxes_m: T of the points above the ground within annotated boxes; NaN without patches.
    """

    sequence: str
    thickness_m: float
    scatter: float
    scatter_of_all: float
    clusters: int
    patches: Float64[np.ndarray, "p 7"]
    thickness_in_boxes_m: float = np.nan


def background_samples(
    points_m: Float[np.ndarray, "n 3"], boxes: Boxes | None, sequence: str
) -> list[BackgroundSample]:
    """Samples of one sweep: ahead, and behind where the sensor looks there too.

    Args:
        points_m: Its points, the sensor near the origin, shape (n, 3).
        boxes: Annotated objects, whose points do not count; None where nobody annotated.
        sequence: Its sequence.
    """
    points = points_m.astype(np.float64)
    range_m = np.hypot(points[:, 0], points[:, 1])
    points = points[(range_m >= NEAR_M) & (range_m <= FAR_M)]
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    ahead, behind = np.abs(azimuth) <= SECTOR_RAD, np.abs(azimuth) >= np.pi - SECTOR_RAD
    annotated_behind = boxes is None or bool((boxes.centre_m[:, 0] < 0).any())  # KITTI's are in the camera's view alone
    sectors = [ahead, behind] if annotated_behind and behind.sum() > _BEHIND_SHARE * ahead.sum() else [ahead]
    return [_sample(points[sector], boxes, sequence) for sector in sectors]


def _sample(points: Points, boxes: Boxes | None, sequence: str) -> BackgroundSample:
    rng = np.random.default_rng(0)
    height_m = points[:, 2] - ground_m(points)
    points, height_m = points[height_m > -_BELOW_M], height_m[height_m > -_BELOW_M]
    outside = ~_in_boxes(points, boxes, _BOX_MARGIN_M)
    clusters = sum(
        bool(in_boxes.mean() < _CLUSTER_IN_BOXES)
        for in_boxes in (_in_boxes(points[rows], boxes, _CLUSTER_BOX_MARGIN_M) for rows in car_sized(points, height_m))
    )
    inside = points[_in_boxes(points, boxes, 0.0) & (height_m > _LOW_M)]
    points, height_m = points[outside], height_m[outside]

    thin = _one_per_voxel(points, _VOXEL_M, rng)
    points, height_m = points[thin], height_m[thin]
    above = np.flatnonzero(height_m > _LOW_M)
    centres = rng.permutation(above)[:_PATCHES]
    variances, thickness_m = _thickness(points, centres)
    rough = variances[:, 0] > _ROUGH * variances.sum(axis=1)
    scatter = float(rough.sum()) / len(centres) if len(centres) else np.nan  # lone points are no scatter
    return BackgroundSample(
        sequence=sequence,
        thickness_m=thickness_m,
        scatter=scatter,
        scatter_of_all=scatter * len(above) / len(points) if len(centres) else np.nan,
        clusters=clusters,
        patches=_telling_patches(points, height_m, rng),
        thickness_in_boxes_m=_thickness_in_boxes_m(inside),
    )


def _thickness_in_boxes_m(points: Points) -> float:
    """T of points of objects; its draws take nothing from those of the background."""
    rng = np.random.default_rng(0)
    thin = points[_one_per_voxel(points, _VOXEL_M, rng)]
    return _thickness(thin, rng.permutation(len(thin))[:_PATCHES])[1]


def _thickness(points: Points, centres: Int[np.ndarray, " c"]) -> tuple[Float64[np.ndarray, "p 3"], float]:
    """Variances of the patches about some points along their axes, and T: NaN without patches."""
    covariances, _ = _patches(points, centres)
    variances = np.linalg.eigvalsh(covariances)
    if not len(variances):
        return variances, np.nan
    return variances, float(np.median(np.sqrt(np.maximum(variances[:, 0], 0))))


def _in_boxes(points: Points, boxes: Boxes | None, margin_m: float) -> Bool[np.ndarray, " n"]:
    inside = np.zeros(len(points), dtype=bool)
    if boxes is not None and len(boxes):
        inside[np.concatenate(points_in_boxes(points, boxes, margin_m=margin_m))] = True
    return inside


def _one_per_voxel(points: Points, voxel_m: float, rng: np.random.Generator) -> Int[np.ndarray, " m"]:
    """Rows of one random point in each voxel, in a random order."""
    order = rng.permutation(len(points))
    _, first = np.unique(np.floor(points[order] / voxel_m).astype(np.int64), axis=0, return_index=True)
    return rng.permutation(order[first])


def _patches(
    points: Points, centres: Int[np.ndarray, " c"], most: int | None = None
) -> tuple[Float64[np.ndarray, "p 3 3"], Int[np.ndarray, " p"]]:
    """Covariance of the points about each of some points, of at most so many, and which have enough about them."""
    tree = cKDTree(points)
    neighbours = tree.query_ball_point(points[centres], _PATCH_M, return_sorted=True) if len(centres) else []
    enough = [row for row, near in enumerate(neighbours) if len(near) >= _LEAST_POINTS]
    if not enough:
        return np.zeros((0, 3, 3)), np.zeros(0, dtype=np.int64)
    parts = [np.asarray(neighbours[row])[:most] for row in enough]
    counts = np.array([len(part) for part in parts])
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    near = points[np.concatenate(parts)]
    mean = np.add.reduceat(near, starts) / counts[:, None]
    away = near - np.repeat(mean, counts, axis=0)
    products = np.add.reduceat(away[:, :, None] * away[:, None, :], starts)
    return products / counts[:, None, None], centres[enough]


def _telling_patches(
    points: Points, height_m: Float64[np.ndarray, " n"], rng: np.random.Generator
) -> Float64[np.ndarray, "p 7"]:
    """Features of patches of few points, so that density tells little."""
    low = height_m < _TELLING_HIGH_M
    points, height_m = points[low], height_m[low]
    thin = _one_per_voxel(points, _TELLING_VOXEL_M, rng)
    points, height_m = points[thin], height_m[thin]
    centres = rng.permutation(np.flatnonzero(height_m > _LOW_M))[:_TELLING_PATCHES]
    covariances, rows = _patches(points, centres, most=_TELLING_POINTS)
    if not len(rows):
        return np.zeros((0, len(FEATURES)))
    variances, axes = np.linalg.eigh(covariances)
    variances = np.maximum(variances, 1e-8)
    normal_up = np.abs(axes[:, 2, 0])
    smallest, middle, largest = variances.T
    return np.column_stack(
        [
            np.log(variances),
            smallest / variances.sum(axis=1),
            (largest - middle) / largest,
            1 - normal_up,
            height_m[rows],
        ]
    )


# Over many sweeps, and between two worlds.


@dataclass(kw_only=True)
class BackgroundTally:
    """Samples of one cloud of a data set."""

    samples: list[BackgroundSample] = field(default_factory=list)

    def add(self, points_m: Float[np.ndarray, "n 3"], boxes: Boxes | None, sequence: str) -> None:
        """Take the samples of one sweep."""
        self.samples += background_samples(points_m, boxes, sequence)

    def merge(self, other: "BackgroundTally") -> None:
        """Take in the samples of other sweeps."""
        self.samples += other.samples

    def summary(self) -> dict[str, Any]:
        """Medians of T, S and S_all, the mean of C, each with a 95 % interval by resampling sequences."""
        columns = {
            "thickness_m": (np.array([sample.thickness_m for sample in self.samples]), np.nanmedian),
            "scatter": (np.array([sample.scatter for sample in self.samples]), np.nanmedian),
            "scatter_of_all": (np.array([sample.scatter_of_all for sample in self.samples]), np.nanmedian),
            "thickness_in_boxes_m": (np.array([one.thickness_in_boxes_m for one in self.samples]), np.nanmedian),
            "clusters": (np.array([float(sample.clusters) for sample in self.samples]), np.nanmean),
        }
        sequences = [sample.sequence for sample in self.samples]
        return {"samples": len(self.samples)} | {
            name: interval_over_sequences(values, sequences, statistic) for name, (values, statistic) in columns.items()
        }


_RESAMPLED = 500


def interval_over_sequences(
    values: Float64[np.ndarray, " n"], sequences: Sequence[str], statistic: Any
) -> dict[str, float | None]:
    """A statistic of samples with a 95 % interval: whole sequences are drawn anew, since their sweeps look alike."""
    if not np.isfinite(values).any():
        return {"value": None, "low": None, "high": None}
    names = sorted(set(sequences))
    of = {name: values[[sequence == name for sequence in sequences]] for name in names}
    rng = np.random.default_rng(0)
    drawn = [
        np.concatenate([of[names[index]] for index in rng.integers(len(names), size=len(names))])
        for _ in range(_RESAMPLED)
    ]
    spread = [float(statistic(part)) for part in drawn if np.isfinite(part).any()]
    low, high = np.percentile(spread, [2.5, 97.5]) if len(names) > 1 else (None, None)
    return {"value": float(statistic(values)), "low": low, "high": high}


def area_under_roc(scores: Float64[np.ndarray, " n"], positive: Bool[np.ndarray, " n"]) -> float:
    """Area under the ROC: how often a positive scores above a negative; 0.5 tells nothing apart."""
    _, level = np.unique(scores, return_inverse=True)
    return _weighted_area(level, positive, np.ones(len(level)))


def _weighted_area(
    level: Int[np.ndarray, " n"], positive: Bool[np.ndarray, " n"], weight: Float64[np.ndarray, " n"]
) -> float:
    """The area where each score counts so often; ``level`` numbers the different scores upwards, ties count half."""
    up = np.bincount(level[positive], weight[positive], minlength=level.max(initial=0) + 1)
    down = np.bincount(level[~positive], weight[~positive], minlength=len(up))
    pairs = up.sum() * down.sum()
    return float((up * (np.cumsum(down) - down / 2)).sum() / pairs) if pairs else float("nan")


@dataclass(frozen=True, kw_only=True)
class ToldApart:
    """How well two worlds are told apart by their patches.

    Args:
        by_thickness: Area under the ROC of the patches' smallest variance alone (AUC_T), at least 0.5.
        by_classifier: That of a classifier of all features and their squares, on what it did not learn from; None where
            a world has but one sweep.
        tried_on: What that is: other sequences, or other sweeps of the one sequence that a world has.
        thickness_interval: 95 % interval of the first over drawn sequences, or over drawn sweeps of a single one; None
            where a world has but one sweep.
        classifier_interval: That of the second; the classifier stays what it learnt.
        features: Area under the ROC of each feature alone, at least 0.5, most telling first.
        lost_without: How much of its area the classifier loses where a feature is shuffled among the patches that it is
            tried on, most telling first; empty without a classifier.
    """

    by_thickness: float
    by_classifier: float | None
    tried_on: Literal["other sequences", "sweeps of one sequence"]
    thickness_interval: tuple[float, float] | None
    classifier_interval: tuple[float, float] | None
    features: Mapping[str, float]
    lost_without: Mapping[str, float]

    def to_json(self) -> dict[str, Any]:
        """All of it as JSON values."""
        return {**vars(self), "features": dict(self.features), "lost_without": dict(self.lost_without)}


@dataclass(frozen=True, eq=False)
class _World:
    """Patches of one world, and the unit of each: its sequence, or its sweep where all are of one sequence."""

    patches: Float64[np.ndarray, "p 7"]
    unit: Int[np.ndarray, " p"]
    units: int

    @classmethod
    def of(cls, samples: Sequence[BackgroundSample]) -> "_World":
        names = sorted({sample.sequence for sample in samples})
        number = {name: row for row, name in enumerate(names)}
        units = [number[sample.sequence] if len(names) > 1 else row for row, sample in enumerate(samples)]
        patches = np.concatenate([np.zeros((0, len(FEATURES))), *(sample.patches for sample in samples)])
        unit = np.repeat(np.asarray(units, dtype=np.int64), [len(sample.patches) for sample in samples])
        return cls(patches, unit, max(units, default=-1) + 1)

    def half(self, second: bool) -> "_World":
        """The first or the second half of its units: kinds of road may alternate."""
        rows = (self.unit >= self.units / 2) == second
        return _World(self.patches[rows], self.unit[rows], self.units)


def tell_apart(one: Sequence[BackgroundSample], two: Sequence[BackgroundSample]) -> ToldApart | None:
    """How well patches of two worlds are told apart; None where one of them has none.

    The classifier learns from half of the sequences and is tried on the others, then the other way round; a world of
    one sequence is cut between its sweeps.
    """
    worlds = _World.of(one), _World.of(two)
    if not all(len(world.patches) for world in worlds):
        return None
    values, second = np.concatenate([world.patches for world in worlds]), _is_second(worlds)
    alone = {name: _folded(area_under_roc(values[:, column], second)) for column, name in enumerate(FEATURES)}
    thinner = 1.0 if area_under_roc(values[:, 0], second) >= 0.5 else -1.0
    trials, lost = [], np.zeros(len(FEATURES))
    for learn, test in ((False, True), (True, False)):
        learnt, tried = [world.half(learn) for world in worlds], [world.half(test) for world in worlds]
        if all(len(world.patches) for world in (*learnt, *tried)):
            scores, without = _classified(learnt, tried)
            trials.append((scores, tried))
            lost += area_under_roc(scores, _is_second(tried)) - without
    by_classifier = [area_under_roc(scores, _is_second(tried)) for scores, tried in trials]
    losses = dict(zip(FEATURES, (lost / max(len(trials), 1)).tolist(), strict=True)) if trials else {}
    return ToldApart(
        by_thickness=alone[FEATURES[0]],
        by_classifier=float(np.mean(by_classifier)) if trials else None,
        tried_on=_tried_on(one, two),
        thickness_interval=_area_interval([(thinner * values[:, 0], worlds)]),
        classifier_interval=_area_interval(trials) if trials else None,
        features=dict(sorted(alone.items(), key=lambda item: -item[1])),
        lost_without=dict(sorted(losses.items(), key=lambda item: -item[1])),
    )


def _tried_on(*worlds: Sequence[BackgroundSample]) -> Literal["other sequences", "sweeps of one sequence"]:
    single = any(len({sample.sequence for sample in world}) < 2 for world in worlds)
    return "sweeps of one sequence" if single else "other sequences"


def _is_second(worlds: Sequence[_World]) -> Bool[np.ndarray, " n"]:
    return np.repeat([False, True], [len(world.patches) for world in worlds])


def _folded(area: float) -> float:
    return max(area, 1 - area)


_AREAS_DRAWN = 200


def _area_interval(trials: Sequence[tuple[np.ndarray, Sequence[_World]]]) -> tuple[float, float] | None:
    """A 95 % interval of the mean area of some trials: in each, units of both worlds are drawn anew."""
    if any(len(np.unique(world.unit)) < 2 for _, worlds in trials for world in worlds):
        return None
    rng = np.random.default_rng(0)
    areas = np.zeros((len(trials), _AREAS_DRAWN))
    for row, (scores, worlds) in enumerate(trials):
        _, level = np.unique(scores, return_inverse=True)
        second = _is_second(worlds)
        for draw in range(_AREAS_DRAWN):
            weights = []
            for world in worlds:
                units = np.unique(world.unit)
                drawn = np.bincount(rng.choice(units, size=len(units)), minlength=world.units)
                weights.append(drawn[world.unit].astype(np.float64))
            areas[row, draw] = _weighted_area(level, second, np.concatenate(weights))
    low, high = np.nanpercentile(areas.mean(axis=0), [2.5, 97.5])
    return float(low), float(high)


def _classified(
    learnt: Sequence[_World], tried: Sequence[_World]
) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, "7"]]:
    """Scores of a logistic classifier on patches that it did not learn from, and its area without each feature."""
    values, trial = (np.concatenate([world.patches for world in worlds]) for worlds in (learnt, tried))
    mean, spread = values.mean(axis=0), values.std(axis=0) + 1e-9
    weights = logistic_weights(_squared(values, mean, spread), _is_second(learnt).astype(np.float64))
    rng = np.random.default_rng(0)
    without = np.zeros(len(FEATURES))
    for column in range(len(FEATURES)):
        shuffled = trial.copy()
        shuffled[:, column] = rng.permutation(shuffled[:, column])
        without[column] = area_under_roc(_squared(shuffled, mean, spread) @ weights, _is_second(tried))
    return _squared(trial, mean, spread) @ weights, without


def _squared(values: np.ndarray, mean: np.ndarray, spread: np.ndarray) -> np.ndarray:
    scaled = np.clip((values - mean) / spread, -5, 5)
    return np.column_stack([np.ones(len(scaled)), scaled, scaled**2])


def logistic_weights(
    inputs: Float64[np.ndarray, "n k"], positive: Float64[np.ndarray, " n"], *, ridge: float = 1e-3
) -> Float64[np.ndarray, " k"]:
    """Weights of a logistic classifier, both classes counted alike, by Newton's method."""
    share = max(positive.mean(), 1e-9), max(1 - positive.mean(), 1e-9)
    weight = np.where(positive > 0, 0.5 / share[0], 0.5 / share[1]) / len(inputs)
    weights = np.zeros(inputs.shape[1])
    for _ in range(30):
        chance = 1 / (1 + np.exp(-np.clip(inputs @ weights, -30, 30)))
        gradient = inputs.T @ (weight * (chance - positive)) + ridge * weights
        curvature = (inputs * (weight * chance * (1 - chance))[:, None]).T @ inputs + ridge * np.eye(len(weights))
        step = np.linalg.solve(curvature, gradient)
        weights = weights - step
        if np.abs(step).max() < 1e-8:
            break
    return weights
