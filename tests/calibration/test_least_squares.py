"""Robust least squares: sigma that covers the truth, outliers, and directions that the data cannot tell."""

from functools import partial

import numpy as np
import pytest

from farfield.calibration import Parameter, solve
from farfield.calibration.least_squares import consider_covariance
from farfield.errors import ConfigError

SLOPE = (
    Parameter(name="offset", unit="m", scale=0.01, prior_sigma=10.0),
    Parameter(name="slope", unit="m", scale=0.01, prior_sigma=10.0),
)


def line(value: np.ndarray, x: np.ndarray, y: np.ndarray, sigma: float) -> np.ndarray:
    return ((value[0] + value[1] * x - y) / sigma)[:, None]


def drawn(rng: np.random.Generator, spread: float, outliers: int = 0) -> tuple[np.ndarray, np.ndarray]:
    x = 5 + rng.uniform(-spread, spread, 60)
    y = 1.5 - 0.4 * x + rng.normal(0, 0.1, 60)
    y[:outliers] += 50
    return x, y


@pytest.mark.parametrize("count", [15, 40])
def test_errors_over_sigma_have_a_spread_of_one_with_few_groups(count: int) -> None:
    """What groups err by in common, and residuals beyond Huber's limit: the plain sandwich gave 1.6 and 1.4."""
    ratios = []
    for seed in range(60):
        rng = np.random.default_rng((count, seed))
        group = np.repeat(np.arange(count), rng.geometric(1 / 8, count))
        x = rng.uniform(-1, 1, (count, 2))[group] + rng.normal(0, 0.1, (len(group), 2))
        common = rng.normal(0, 0.08, (count, 2))[group]
        y = 1.5 - 0.4 * x + rng.normal(0, 0.1, x.shape) + common
        found = solve(partial(two_lines, x=x, y=y), np.zeros(2), SLOPE, group=group)
        ratios.append((found.value - [1.5, -0.4]) / found.sigma)
    assert (np.std(ratios, axis=0) < 1.25).all()
    assert (np.std(ratios, axis=0) > 0.75).all()


def two_lines(value: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return (value[0] + value[1] * x - y) / 0.1


def test_the_sigma_covers_the_truth() -> None:
    inside = []
    for seed in range(100):
        x, y = drawn(np.random.default_rng(seed), 3.0)
        found = solve(partial(line, x=x, y=y, sigma=0.1), np.zeros(2), SLOPE)
        inside.append(np.abs(found.value - [1.5, -0.4]) < 2 * found.sigma)
        assert found.unobserved == ()
    assert 0.88 <= np.mean(inside) <= 1.0


def test_outliers_do_not_pull() -> None:
    x, y = drawn(np.random.default_rng(0), 3.0, outliers=9)
    found = solve(partial(line, x=x, y=y, sigma=0.1), np.array([1.0, 0.0]), SLOPE)
    np.testing.assert_allclose(found.value, [1.5, -0.4], atol=0.2)


def test_blocks_of_equal_errors_count_once() -> None:
    rng = np.random.default_rng(1)
    x = np.repeat(rng.uniform(0, 10, 12), 20)
    y = 1.5 - 0.4 * x + np.repeat(rng.normal(0, 0.1, 12), 20)
    fit = partial(line, x=x, y=y, sigma=0.1)
    alone = solve(fit, np.zeros(2), SLOPE)
    blocks = solve(fit, np.zeros(2), SLOPE, group=np.repeat(np.arange(12), 20))
    assert (blocks.sigma > 2 * alone.sigma).all()


def test_what_cannot_be_told_is_named_and_keeps_the_prior() -> None:
    tight = tuple(Parameter(name=p.name, unit="m", scale=0.01, prior_sigma=0.5) for p in SLOPE)
    x, y = np.full(60, 1.0), np.full(60, 1.1)
    found = solve(partial(line, x=x, y=y, sigma=0.1), np.array([1.0, 0.0]), tight)
    assert found.unobserved == ("offset and slope cannot be told apart here",)
    np.testing.assert_allclose(found.value, [1.05, 0.05], atol=1e-3)
    assert found.to_json()["parameters"]["slope_cm"]["sigma"] > 25


def test_no_residuals_are_refused() -> None:
    with pytest.raises(ConfigError, match="finite residuals"):
        solve(lambda value: np.zeros((0, 1)), np.zeros(2), SLOPE)


def test_errors_that_all_residuals_share_do_not_average_out() -> None:
    """A line through points that are all 0.3 too high, and tilted by 0.02: both go into the solution as they are."""
    x, y = drawn(np.random.default_rng(0), 3.0)
    rows, value = partial(line, x=x, y=y, sigma=0.1), np.array([1.5, -0.4])
    high, tilted = np.full((len(x), 1), 0.3 / 0.1), (0.02 * x / 0.1)[:, None]
    found = consider_covariance(rows, value, SLOPE, np.stack([high, tilted]))
    np.testing.assert_allclose(found, np.diag([0.3**2, 0.02**2]), atol=1e-5)
    np.testing.assert_array_equal(consider_covariance(rows, value, SLOPE, np.zeros((1, len(x), 1))), np.zeros((2, 2)))
