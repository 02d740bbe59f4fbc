"""Scores calibrated by range and points: fitted on some boxes, better on others, kept in the weights."""

import numpy as np
import pytest
from scipy.special import expit

from farfield.datasets import in_memory
from farfield.detectors.runtime import Detector
from farfield.detectors.score_bands import ScoreBands, bands_of, calibration_error, fitted_bands
from farfield.detectors.weights import load_weights, save_weights
from farfield.experiments.calibrating import calibrate_scores


def boxes(count: int, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Scores that are too sure of far boxes and of those of few points."""
    range_m, points = rng.uniform(0, 250, count), rng.integers(1, 30, count)
    strength = rng.normal(-1.0, 2.0, count)
    truth = strength / np.where(range_m > 150, 2.5, 1.2) - np.where(points < 5, 1.5, 0.0)
    return expit(strength), (rng.random(count) < expit(truth)).astype(np.float64), range_m, points


def test_calibration_lowers_the_error_on_held_out_boxes(rng: np.random.Generator) -> None:
    bands = fitted_bands(*boxes(12000, rng))
    score, right, range_m, points = boxes(6000, rng)
    before, after = calibration_error(score, right), calibration_error(bands(score, range_m, points), right)
    assert before > 0.05
    assert after < 0.03
    row, column = bands_of(np.array([10.0, 69.9, 70.0, 400.0]), np.array([0, 4, 5, 99]))
    assert row.tolist() == [0, 0, 1, 2]
    assert column.tolist() == [0, 0, 1, 2]
    assert bands.temperature[2][2] > bands.temperature[0][2]
    assert bands.offset[0][0] < bands.offset[0][2] - 0.5


def test_too_few_boxes_change_nothing(rng: np.random.Generator) -> None:
    score, right, range_m, points = boxes(20, rng)
    np.testing.assert_allclose(fitted_bands(score, right, range_m, points)(score, range_m, points), score, atol=1e-6)


def test_a_perfect_score_has_no_error() -> None:
    assert calibration_error(np.array([0.0, 1.0, 1.0]), np.array([0.0, 1.0, 1.0])) == 0
    assert calibration_error(np.array([0.8, 0.8]), np.array([1.0, 0.0])) == pytest.approx(0.3)
    assert calibration_error(np.zeros(0), np.zeros(0)) == 0


def test_weights_keep_their_bands_and_detectors_apply_them(scene, trained, tmp_path) -> None:
    network = trained("pointpillars")
    halved = ScoreBands(ranges_m=(0.0, 30.0), points=(0,), temperature=((1.0,), (1.0,)), offset=((0.0,), (-2.0,)))
    path = tmp_path / "w.safetensors"
    config = network.config.model_copy(update={"score_bands": halved})
    save_weights(path, network.state_dict(), config=config, provenance={})
    assert load_weights(path)[0].config.score_bands == halved
    plain = Detector(network, precision="fp32", device="cpu", score_threshold=1e-4, max_boxes=5000)(scene.cloud())
    strength = np.log(plain.score / (1 - plain.score)) - 2.0 * (plain.range_m >= 30)
    for threshold, most in ((1e-3, 500), (0.05, 500), (0.05, 2)):  # limits are those of calibrated scores
        loaded = Detector(
            load_weights(path)[0], precision="fp32", device="cpu", score_threshold=threshold, max_boxes=most
        )
        assert loaded.config.score_threshold == loaded.info.score_threshold == threshold
        calibrated, expected = loaded(scene.cloud()), np.sort(expit(strength))[::-1]
        np.testing.assert_allclose(calibrated.score, expected[expected >= threshold][:most], rtol=1e-4)
        assert len(calibrated) > 0
    raw = Detector(load_weights(path)[0], precision="fp32", device="cpu", calibrated=False)
    own = Detector(network, precision="fp32", device="cpu")
    np.testing.assert_array_equal(raw(scene.cloud()).score, own(scene.cloud()).score)


def test_the_least_score_that_a_band_lifts_to_a_threshold() -> None:
    bands = ScoreBands(ranges_m=(0.0, 30.0), points=(0,), temperature=((1.0,), (2.0,)), offset=((-2.0,), (1.0,)))
    for threshold in (0.01, 0.05, 0.5):
        least = bands.least_score(threshold)
        both = [bands(np.full(1, least), np.full(1, range_m), np.ones(1, dtype=int))[0] for range_m in (0.0, 50.0)]
        assert max(both) == pytest.approx(threshold)
    assert bands.least_score(0.0) == bands.least_score(1e-3) == 0.0  # there the second band lifts every score


def test_weights_that_have_bands_are_fitted_anew(scene, trained, tmp_path) -> None:
    network = trained("pointpillars")
    halved = ScoreBands(ranges_m=(0.0,), points=(0,), temperature=((1.0,),), offset=((-3.0,),))
    errors = []
    for bands in (None, halved):
        path = tmp_path / f"{bands is None}.safetensors"
        config = network.config.model_copy(update={"score_bands": bands})
        save_weights(path, network.state_dict(), config=config, provenance={})
        errors.append(calibrate_scores(path, [(in_memory([scene]), next(iter(scene.clouds)))]))
    assert errors[0] == errors[1]
    assert errors[0].boxes > 0
