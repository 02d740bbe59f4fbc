"""The roadside's statistics: a medium of known depth, planes, clusters by hand, two worlds told apart."""

from dataclasses import replace

import numpy as np
import pytest

from farfield.frame import Boxes
from farfield.geometry import clusters, ground
from farfield.geometry.clusters import least_rectangle_m
from farfield.geometry.ground import ground_m
from farfield.inspection.statistics import background
from farfield.inspection.statistics.background import (
    FEATURES,
    BackgroundSample,
    BackgroundTally,
    area_under_roc,
    background_samples,
    interval_over_sequences,
    logistic_weights,
    tell_apart,
)

CAR = Boxes(
    centre_m=np.array([[20.0, 3.0, -1.0]]),
    size_m=np.array([[4.4, 2.0, 1.8]]),
    yaw_rad=np.zeros(1),
    label=["vehicle"],
)


def road(rng: np.random.Generator) -> np.ndarray:
    """Flat ground ahead at -1.8 m."""
    points = rng.uniform((4, -30, -1.8), (40, 30, -1.8), (30_000, 3))
    return points + rng.normal(0, 0.01, points.shape) * (0, 0, 1)


def hedge(rng: np.random.Generator, mu: float) -> np.ndarray:
    """A flat medium at x = 12 m, 10 m long and 4 m high, into which beams come an exponential depth of mean 1/mu."""
    points = rng.uniform((12, -5, -1.3), (12, 5, 2.7), (4000, 3))
    points[:, 0] += rng.exponential(1 / mu, len(points))
    return points


@pytest.mark.parametrize(("mu", "thickness_cm"), [(2, 19), (5, 14.6), (12, 7.6), (40, 2.7), (100, 1.0)])
def test_a_medium_is_as_thick_as_it_was_computed_to_be(
    mu: float, thickness_cm: float, rng: np.random.Generator
) -> None:
    """Depths against a computation by another program, normal incidence, one patch after the other."""
    sample = background_samples(np.concatenate([road(rng), hedge(rng, mu)]), None, "a")[0]
    assert 100 * sample.thickness_m == pytest.approx(thickness_cm, rel=0.2)
    assert (sample.scatter > 0.5) == (mu <= 8)


def test_objects_have_a_thickness_of_their_own(rng: np.random.Generator) -> None:
    """A car's side with 3 cm of relief, beside a hedge: neither says anything of the other."""
    side = rng.uniform((18, 2.1, -1.4), (22, 2.1, -0.3), (3000, 3)) + rng.normal(0, 0.03, (3000, 1)) * [0, 1, 0]
    scene = np.concatenate([road(rng), hedge(rng, 5), side])
    sample = background_samples(scene, CAR, "a")[0]
    assert 100 * sample.thickness_in_boxes_m == pytest.approx(3.0, rel=0.15)
    assert 100 * sample.thickness_m == pytest.approx(14.6, rel=0.2)
    assert np.isnan(background_samples(scene, None, "a")[0].thickness_in_boxes_m)


def test_the_ground_goes_under_what_stands_on_it(rng: np.random.Generator) -> None:
    slope = road(rng)
    slope[:, 2] += 0.03 * slope[:, 0]
    car = rng.uniform((15, -1, -1.3), (19, 1, 0), (3000, 3))
    below = ground_m(np.concatenate([slope, car]))
    np.testing.assert_allclose(below[:-3000], slope[:, 2], atol=0.15)
    np.testing.assert_allclose(below[-3000:], -1.8 + 0.03 * car[:, 0], atol=0.15)


def block(rng: np.random.Generator, centre: tuple[float, float], size: tuple[float, float, float]) -> np.ndarray:
    """Points in a block that stands on the road."""
    middle = np.array([*centre, -1.8 + 0.35 + size[2] / 2])
    return middle + rng.uniform(-0.5, 0.5, (600, 3)) * size


@pytest.mark.parametrize(
    ("size", "above", "annotated", "count"),
    [
        ((4.2, 1.8, 1.4), False, False, 1),
        ((4.2, 1.8, 1.4), False, True, 0),
        ((4.2, 1.8, 1.4), True, False, 0),
        ((8.5, 1.8, 1.4), False, False, 0),
        ((4.2, 3.4, 1.4), False, False, 0),
        ((4.2, 1.8, 0.3), False, False, 0),
        ((0.6, 0.5, 1.4), False, False, 0),
    ],
    ids=["car", "annotated", "below a crown", "long", "wide", "flat", "small"],
)
def test_clusters_of_a_cars_size_are_counted(
    size: tuple[float, float, float], above: bool, annotated: bool, count: int, rng: np.random.Generator
) -> None:
    parts = [road(rng), block(rng, (20.0, 3.0), size)]
    if above:
        parts.append(rng.uniform((19.5, 2.5, 1.5), (20.5, 3.5, 3), (50, 3)))
    boxes = Boxes.empty()
    if annotated:
        boxes = CAR
    assert [sample.clusters for sample in background_samples(np.concatenate(parts), boxes, "a")] == [count]


def test_behind_is_looked_at_where_somebody_annotated_there(rng: np.random.Generator) -> None:
    around = np.concatenate([road(rng), road(rng) * (-1, 1, 1)])
    assert len(background_samples(around, None, "a")) == 2
    assert len(background_samples(around, CAR, "a")) == 1
    assert len(background_samples(around[:30_000], None, "a")) == 1


def test_nothing_is_measured_of_nothing() -> None:
    sample = background_samples(np.zeros((0, 3)), None, "a")[0]
    assert np.isnan(sample.thickness_m)
    assert (sample.clusters, len(sample.patches)) == (0, 0)
    tally = BackgroundTally(samples=[sample])
    assert tally.summary()["thickness_m"] == {"value": None, "low": None, "high": None}
    assert tell_apart([sample], [sample]) is None


def test_the_least_rectangle_is_found_in_any_turn(rng: np.random.Generator) -> None:
    corners = np.array([[0, 0], [4, 0], [4, 1.5], [0, 1.5]])
    for turn in rng.uniform(0, np.pi, 5):
        turned = corners @ [[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]
        assert least_rectangle_m(turned) == pytest.approx((4, 1.5))
    assert least_rectangle_m(np.array([[0.0, 0], [1, 1], [2, 2]]))[1] == 0


def samples(rng: np.random.Generator, shift: float, count: int = 6) -> list[BackgroundSample]:
    return [
        BackgroundSample(f"road {n}", 0.1, 0.5, 0.2, 3, rng.normal(0, 1, (200, len(FEATURES))) + shift * np.eye(7)[0])
        for n in range(count)
    ]


def test_worlds_are_told_apart_as_far_as_they_differ(rng: np.random.Generator) -> None:
    same = tell_apart(samples(rng, 0), samples(rng, 0))
    other = tell_apart(samples(rng, 0), samples(rng, 2))
    assert same is not None
    assert other is not None
    assert same.tried_on == "other sequences"
    assert same.by_classifier == pytest.approx(0.5, abs=0.05)
    assert same.by_thickness < 0.55
    exact = 0.921  # of two normals whose means lie two deviations apart: Phi(sqrt 2)
    assert other.by_thickness == pytest.approx(exact, abs=0.015)
    assert other.by_classifier == pytest.approx(exact, abs=0.02)
    assert next(iter(other.features)) == next(iter(other.lost_without)) == FEATURES[0]
    assert max(list(other.lost_without.values())[1:]) < 0.01 < 0.3 < other.lost_without[FEATURES[0]]
    assert other.classifier_interval is not None
    assert other.classifier_interval[0] < exact < other.classifier_interval[1]


def test_roads_that_differ_widen_the_interval_of_an_area(rng: np.random.Generator) -> None:
    """Patches of one road are alike: six roads whose middles scatter say less than their number of patches."""
    spreads = []
    for scatter in (0.0, 1.0):
        worlds = [
            [replace(one, patches=one.patches + scatter * rng.normal(0, 1, 7)) for one in samples(rng, shift)]
            for shift in (0, 1)
        ]
        apart = tell_apart(*worlds)
        assert apart is not None
        assert apart.thickness_interval is not None
        spreads.append(apart.thickness_interval[1] - apart.thickness_interval[0])
    assert spreads[0] < 0.1
    assert spreads[1] > 3 * spreads[0]


def test_one_sweep_of_each_is_told_apart_without_a_classifier(rng: np.random.Generator) -> None:
    apart = tell_apart(samples(rng, 0, count=1), samples(rng, 2, count=1))
    assert apart is not None
    assert apart.by_thickness > 0.8
    assert (apart.by_classifier, apart.thickness_interval, apart.classifier_interval) == (None, None, None)
    assert apart.lost_without == {}
    assert apart.tried_on == "sweeps of one sequence"


def test_the_area_counts_pairs() -> None:
    scores, positive = np.array([1.0, 2, 2, 3]), np.array([False, True, False, True])
    assert area_under_roc(scores, positive) == pytest.approx((1 + 0.5 + 1 + 1) / 4)


def test_the_classifier_finds_the_best_weights(rng: np.random.Generator) -> None:
    inputs = np.column_stack([np.ones(4000), rng.normal(0, 1, 4000)])
    positive = (rng.random(4000) < 1 / (1 + np.exp(-(0.3 + 1.5 * inputs[:, 1])))).astype(float)
    weights = logistic_weights(inputs, positive, ridge=1e-9)
    assert weights[1] == pytest.approx(1.5, abs=0.15)


def test_intervals_draw_whole_sequences(rng: np.random.Generator) -> None:
    values = np.repeat(rng.normal(0, 1, 12), 50)
    sequences = [f"road {index}" for index in np.repeat(np.arange(12), 50)]
    interval = interval_over_sequences(values, sequences, np.nanmean)
    assert interval["high"] is not None
    assert interval["low"] is not None
    assert interval["high"] - interval["low"] > 0.6  # 2 x 1.96 / sqrt(12), not / sqrt(600)


def test_the_eye_is_frozen() -> None:
    """What was measured before is compared with what is measured later: by the same constants."""
    frozen = {
        "SECTOR_RAD": pytest.approx(np.pi / 3),
        "NEAR_M": 4.0,
        "FAR_M": 40.0,
        "_BEHIND_SHARE": 0.25,
        "_BELOW_M": 0.5,
        "_BOX_MARGIN_M": 0.2,
        "_CLUSTER_BOX_MARGIN_M": 0.5,
        "_VOXEL_M": 0.1,
        "_PATCHES": 1500,
        "_PATCH_M": 0.75,
        "_LEAST_POINTS": 10,
        "_LOW_M": 0.3,
        "_ROUGH": 0.03,
        "_CLUSTER_IN_BOXES": 0.3,
        "_TELLING_VOXEL_M": 0.2,
        "_TELLING_POINTS": 24,
        "_TELLING_HIGH_M": 6.0,
        "_TELLING_PATCHES": 500,
    }
    own = {name: value for name, value in vars(background).items() if name.isupper()}
    drawing = {"FEATURES": FEATURES, "_RESAMPLED": 500, "_AREAS_DRAWN": 200}
    assert {name: value for name, value in own.items() if name not in drawing} == frozen
    assert len(FEATURES) == 7
    assert {name: value for name, value in vars(clusters).items() if name.isupper()} == {
        "_LOW_M": 0.3,
        "_TOP_M": 2.6,
        "_CELL_M": 0.3,
        "_POINTS": 10,
        "_HEIGHT_M": 0.6,
        "_LONG_M": (1.2, 6.0),
        "_WIDE_M": (0.3, 2.6),
        "_ABOVE_M": (2.8, 8.0),
        "_ABOVE_NEAR_M": 1.0,
        "_ABOVE_POINTS": 3,
    }
    assert {name: value for name, value in vars(ground).items() if name.isupper()} == {
        "_CELL_M": 1.0,
        "_QUANTILE": 0.05,
        "_OPENING_CELLS": 5,
    }
