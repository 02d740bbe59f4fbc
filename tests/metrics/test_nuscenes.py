"""The nuScenes protocol against the devkit's own figures and a slow oracle."""

from dataclasses import replace

import numpy as np
import pytest

from farfield.metrics import Bootstrap, NuScenesSettings, evaluate_nuscenes

from . import reference
from .scenes import NO_BOOTSTRAP, as_predictions, boxes, car, random_scene


def test_equals_the_devkit_on_real_detections(real_detections) -> None:
    detections, expected = real_detections
    settings = NuScenesSettings(label="Car", ties="later_first", bootstrap=NO_BOOTSTRAP)
    tree = evaluate_nuscenes(detections.boxes, detections.annotated, settings).to_json()
    assert tree["ap"] == pytest.approx(expected["ap"], abs=1e-9)
    for name in ("trans_err", "scale_err", "orient_err"):
        assert tree["errors"][name] == pytest.approx(expected[f"{name}_2m"], abs=1e-9)
    assert (tree["counts"]["frames"], tree["counts"]["annotated"]) == (expected["frames"], expected["annotated"])


@pytest.mark.parametrize("ties", ["nearest_first", "stable", "later_first"])
def test_equals_the_plain_evaluation_with_ties(rng: np.random.Generator, ties: str) -> None:
    for _ in range(2):
        predictions, annotations = random_scene(rng)
        settings = NuScenesSettings(label="vehicle", ties=ties, bootstrap=NO_BOOTSTRAP)
        result = evaluate_nuscenes(predictions, annotations, settings)
        expected = reference.evaluate(predictions, annotations, settings)["0"]
        assert [result.figures[f"ap/{t}"] for t in settings.thresholds_m] == pytest.approx(expected["ap"], abs=1e-12)


def test_of_equal_scores_the_nearer_or_the_later_prediction_comes_first() -> None:
    annotated = {("s", "0"): boxes([car(10)], scored=False)}
    predicted = {("s", "0"): boxes([car(10, score=0.5), car(11, score=0.5)])}
    settings = NuScenesSettings(label="vehicle", bootstrap=NO_BOOTSTRAP)
    result = evaluate_nuscenes(predicted, annotated, replace(settings, ties="later_first"))
    assert result.figures["errors/trans_err"] == pytest.approx(1.0)  # the second one, a metre away, took the box
    assert evaluate_nuscenes(predicted, annotated, settings).figures["errors/trans_err"] == pytest.approx(0.0)


def test_errors_of_a_worked_pair() -> None:
    annotated = {("s", "0"): boxes([(10, 0, 0, 4, 2, 2, 0.0, 0)], scored=False)}
    predicted = {("s", "0"): boxes([(10.3, 0.4, 5, 2, 2, 2, 0.25 + 2 * np.pi, 0.7)])}
    result = evaluate_nuscenes(predicted, annotated, NuScenesSettings(label="vehicle", bootstrap=NO_BOOTSTRAP))
    assert result.figures["errors/trans_err"] == pytest.approx(0.5)  # in the plane: heights do not count
    assert result.figures["errors/scale_err"] == pytest.approx(0.5)
    assert result.figures["errors/orient_err"] == pytest.approx(0.25)


def test_errors_are_one_below_the_least_recall() -> None:
    annotated = {("s", "0"): boxes([car(10 * i) for i in range(1, 11)], scored=False)}
    result = evaluate_nuscenes(
        {("s", "0"): boxes([car(10, score=0.5)])}, annotated, NuScenesSettings(label="vehicle", bootstrap=NO_BOOTSTRAP)
    )
    assert [result.figures[f"errors/{n}_err"] for n in ("trans", "scale", "orient")] == [1.0, 1.0, 1.0]


def test_annotated_against_annotated_is_one(rng: np.random.Generator) -> None:
    _, annotations = random_scene(rng, frames=30)
    settings = NuScenesSettings(label="vehicle", bootstrap=NO_BOOTSTRAP)
    result = evaluate_nuscenes(as_predictions(annotations), annotations, settings)
    for name, value in result.figures.items():
        assert value == pytest.approx(0.0 if "err" in name else 1.0, abs=1e-12), name


def test_no_aligned_overlap_and_a_table(rng: np.random.Generator) -> None:
    settings = NuScenesSettings(label="vehicle", bootstrap=Bootstrap(replicates=10))
    result = evaluate_nuscenes(*random_scene(rng), settings)
    assert result.to_json()["dds"] == {}
    for shown in ("AP at 0.5 m", "trans_err", "ties=nearest_first", "distance=bev", "annotated"):
        assert shown in str(result)


def test_the_mean_is_that_of_the_first_epsilon_as_its_parts_are(rng: np.random.Generator) -> None:
    scene, plain = random_scene(rng), {"label": "vehicle", "bootstrap": NO_BOOTSTRAP}
    several = evaluate_nuscenes(*scene, NuScenesSettings(epsilons=(0.0, 0.02), **plain))
    assert several.figures == evaluate_nuscenes(*scene, NuScenesSettings(**plain)).figures
