"""Offset and drift against the truth of simulated clocks, the bound, and what stamps cannot tell."""

import numpy as np
import pytest

from farfield.errors import ConfigError
from farfield.sync import drift_bound_ppm, fit_clock
from farfield.sync.clocks import huber, lower_hull, theil_sen, unwrapped

DRIFT, OFFSET_NS = 7e-6, 3_000_000


def clocks(rng: np.random.Generator, noise_s: np.ndarray, rate: float = 10.0) -> tuple[np.ndarray, np.ndarray]:
    a = 1_574_859_771_000_000_000 + np.arange(len(noise_s)) * int(1e9 / rate)
    b = (
        a
        + OFFSET_NS
        + np.round((a - a[len(a) // 2]) * DRIFT).astype(np.int64)
        + np.round(noise_s * 1e9).astype(np.int64)
    )
    return a, b


def test_drift_comes_near_the_bound_for_symmetric_jitter() -> None:
    errors, inside, bound = [], 0, drift_bound_ppm(1e-3, 600, 59.9)
    assert bound == pytest.approx(2.36, abs=0.01)
    for seed in range(60):
        rng = np.random.default_rng(seed)
        clock = fit_clock(*clocks(rng, rng.normal(0, 1e-3, 600)))
        errors.append(clock.drift_ppm - 7)
        inside += abs(errors[-1]) < 2 * clock.drift_se_ppm
        assert abs(clock.offset_ns - OFFSET_NS) < 0.5e6
        assert clock.method == "huber"
        assert clock.bound_ppm == pytest.approx(bound, rel=0.2)
    assert np.sqrt(np.mean(np.square(errors))) < 1.25 * bound  # 60 seeds know their rms to 9 %
    assert 0.85 <= inside / 60 <= 1.0


def test_one_sided_delays_get_the_hull() -> None:
    errors = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        clock = fit_clock(*clocks(rng, rng.exponential(3e-3, 600)))
        assert clock.method == "hull"
        assert abs(clock.offset_ns - OFFSET_NS) < 0.1e6  # the least delay is near 0
        errors.append(clock.drift_ppm - 7)
    assert np.sqrt(np.mean(np.square(errors))) < 1.5


def test_outliers_and_a_set_clock_do_not_move_the_fit(rng: np.random.Generator) -> None:
    noise = rng.normal(0, 0.2e-3, 2000)
    noise[rng.random(2000) < 0.02] += 0.05
    clock = fit_clock(*clocks(rng, noise))
    assert abs(clock.drift_ppm - 7) < 0.5
    assert clock.steps == 0
    a, b = clocks(rng, rng.normal(0, 0.2e-3, 2000))
    b[1500:] += 40_000_000
    clock = fit_clock(a, b)
    assert clock.steps == 1
    assert clock.pairs < 1500
    assert abs(clock.drift_ppm - 7) < 0.5


def test_nearness_tells_the_offset_up_to_whole_periods() -> None:
    a = np.arange(3000, dtype=np.int64) * 100_000_000
    difference = np.round(np.arange(3000) * 40_000.0 + 16_000_000).astype(np.int64)  # 400 ppm: through several periods
    wrapped = (difference + 16_666_667) % 33_333_333 - 16_666_667
    clock = fit_clock(a, a + wrapped, modulo_ns=33_333_333)
    assert clock.drift_ppm == pytest.approx(400, abs=0.1)
    assert clock.modulo_ns == 33_333_333
    np.testing.assert_array_equal(np.diff(unwrapped(wrapped, 33_333_333) - difference), 0)


def test_lines_through_exact_points() -> None:
    x = np.linspace(-5, 5, 500)
    for fit in (theil_sen, lower_hull):
        slope, level = fit(x, 3 * x - 2)
        assert (slope, level) == pytest.approx((3, -2))
    slope, level = huber(x, 3 * x - 2 + np.where(np.arange(500) == 7, 1e3, 0), 2.9, -1.9)
    assert (slope, level) == pytest.approx((3, -2), abs=0.02)
    y = np.abs(x) + 1  # the line under it touches at 0
    slope, level = lower_hull(x, y)
    assert level == pytest.approx(1, abs=0.02)
    assert (slope * x + level <= y + 1e-9).all()


def test_too_few_pairs_are_refused() -> None:
    two = np.arange(2, dtype=np.int64)
    with pytest.raises(ConfigError, match="three pairs"):
        fit_clock(two, two)
    with pytest.raises(ConfigError, match="three pairs"):
        fit_clock(np.zeros(5, np.int64), np.arange(5, dtype=np.int64))
    with pytest.raises(ConfigError, match="period above 0"):
        unwrapped(two, 0)
