"""Errors of depth maps against sums done by hand, by range, per image and pooled."""

import numpy as np
import pytest

from farfield.metrics.depth import DepthErrors, depth_errors, errors_by_range, mean_of

TRUTH = np.array([[10.0, 20.0, np.nan, 50.0]])
FOUND = np.array([[11.0, 18.0, 30.0, np.nan]])


def test_the_four_figures_by_hand() -> None:
    errors = depth_errors(FOUND, TRUTH)
    assert (errors.truth, errors.compared) == (3, 2)
    assert errors.coverage == pytest.approx(2 / 3)
    assert errors.mae_mm == pytest.approx(1500)
    assert errors.rmse_mm == pytest.approx(1000 * np.sqrt((1 + 4) / 2))
    one, two = 1 / 10 - 1 / 11, 1 / 18 - 1 / 20
    assert errors.imae_1_km == pytest.approx(1000 * (one + two) / 2)
    assert errors.irmse_1_km == pytest.approx(1000 * np.sqrt((one**2 + two**2) / 2))
    assert errors.abs_rel == pytest.approx(0.1)
    assert errors.within_1_25 == 1


def test_ranges_are_those_of_the_truth() -> None:
    parts = errors_by_range(FOUND, TRUTH, (0.0, 15.0, 40.0))
    assert {name: part.truth for name, part in parts.items()} == {"all": 2, "0-15": 1, "15-40": 1}
    assert parts["15-40"].mae_mm == pytest.approx(2000)


def test_a_mean_over_images_weighs_images_and_a_sum_weighs_pixels() -> None:
    small, large = depth_errors(np.full((1, 1), 14.0), np.full((1, 1), 10.0)), depth_errors(FOUND, TRUTH)
    assert mean_of([small, large])["mae_mm"] == pytest.approx((4000 + 1500) / 2)
    assert (small + large).mae_mm == pytest.approx((4000 + 3000) / 3)


def test_nothing_compared_is_no_figure() -> None:
    empty = depth_errors(np.full((2, 2), np.nan), np.full((2, 2), 5.0))
    assert np.isnan(empty.mae_mm)
    assert empty.coverage == 0
    assert np.isnan(mean_of([empty, DepthErrors()])["rmse_mm"])
    assert empty.to_json()["mae_mm"] is None
