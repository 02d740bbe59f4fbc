"""Thresholds against numpy's quantile, clouds of many densities against plain selection."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.radar.axes import CUBE_SHAPE, OUTSIDE
from farfield.radar.products import cells_above, rounded_down, sparse_cloud, sparse_clouds, thresholds

RATES = (0.0001, 0.001, 0.01, 0.05, 0.1, 0.3, 0.5)  # "Enhanced K-Radar" varies 0.01 to 50 %


def spread(rng, shape):
    power = rng.exponential(8e10, shape).astype(np.float32)
    strong = rng.integers(0, power.size, power.size // 500)
    power.ravel()[strong] *= rng.exponential(300, len(strong)).astype(np.float32)
    power[rng.random(shape) < 0.485] = OUTSIDE
    return power


@pytest.mark.parametrize("over", ["all", "valid"])
def test_thresholds_equal_numpys_quantiles(rng, over):
    values = spread(rng, (100, 120, 50))
    counted = (values if over == "all" else values[values > OUTSIDE]).astype(np.float64).ravel()
    for rate, got in zip(RATES, thresholds(values, RATES, over=over), strict=True):
        assert got == pytest.approx(np.quantile(counted, 1 - rate), rel=1e-9)


@given(st.lists(st.sampled_from([-1.0, 0.0, 1.0, 1.5, 2.0, 7.0]), min_size=1, max_size=30), st.floats(0.001, 0.999))
def test_ties_and_few_cells(numbers, rate):
    values = np.array(numbers, dtype=np.float32)
    expected = np.quantile(values.astype(np.float64), 1 - rate)
    assert thresholds(values, [rate])[0] == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_a_sample_that_misleads_costs_time_only():
    """The sample sees other cells than there are; the answer is exact all the same."""
    values = np.full(1_200_000, 5.0, dtype=np.float32)
    values += np.arange(values.size, dtype=np.float32) * np.float32(1e-6)
    step = values.size // (1 << 16) | 7
    values[::step] *= 1e6
    assert thresholds(values, [0.01])[0] == pytest.approx(np.quantile(values.astype(np.float64), 0.99), rel=1e-6)


def test_no_cell_in_view_is_an_error():
    with pytest.raises(ValueError, match="inside the field of view"):
        thresholds(np.full(5, -1, dtype=np.float32), [0.1], over="valid")


def test_rounding_a_threshold_changes_no_choice(rng):
    values = rng.random(1000).astype(np.float32)
    for threshold in (*rng.random(50), *values[:50].astype(np.float64), 0.0, -1.0):
        chosen = values > rounded_down(float(threshold))
        assert np.array_equal(chosen, values.astype(np.float64) > threshold)


@pytest.mark.parametrize("over", ["all", "valid"])
def test_several_densities_at_once_are_the_single_ones(rng, over):
    cube = np.full(CUBE_SHAPE, OUTSIDE, dtype=np.float32)
    cube[60:90, 100:300, :200] = spread(rng, (30, 200, 200))
    together = sparse_clouds(cube, (0.001, 0.01, 0.002), over=over)
    assert list(together) == [0.001, 0.01, 0.002]
    valid = cube[cube > OUTSIDE].astype(np.float64)
    for rate, cloud in together.items():
        np.testing.assert_array_equal(cloud, sparse_cloud(cube, rate, over=over))
        level = np.quantile(cube.astype(np.float64) if over == "all" else valid, 1 - rate)
        assert len(cloud) == np.count_nonzero(cube > level)
        assert np.array_equal(np.unique(cloud[:, 3]), np.unique((cube[cube > level] / 1e13).astype(np.float32)))


def test_a_density_above_the_share_in_view_keeps_all_in_view():
    values = np.array([-1, -1, -1, 0, 2, 3], dtype=np.float32)
    level = thresholds(values, [0.9])[0]
    assert cells_above(values, level).tolist() == [3, 4, 5]
