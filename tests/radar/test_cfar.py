"""CFAR: factors against closed forms and integrals, false alarms counted on simulated noise, targets by hand."""

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import quad

from farfield.radar.cfar import (
    CfarWindow,
    cell_averaging_factor,
    cfar,
    cfar_threshold,
    ordered_statistic_factor,
    rank_of,
)

SMALL = CfarWindow(guard=(1, 1, 0), training=(2, 2, 0))  # 7 x 7 cells less 3 x 3: 40
SHAPE = (150, 100, 6)


@pytest.mark.parametrize("cells", [1, 7, 40])
@pytest.mark.parametrize("false_alarm", [1e-2, 1e-6])
def test_cell_averaging_factor_of_exponential_power_is_the_closed_form(cells, false_alarm):
    expected = cells * (false_alarm ** (-1 / cells) - 1)
    assert cell_averaging_factor(false_alarm, cells) == pytest.approx(expected, rel=1e-10)


def test_cell_averaging_factor_of_several_looks_is_the_f_distributions():
    expected = stats.f.isf(1e-4, 2 * 63, 2 * 63 * 40)
    assert cell_averaging_factor(1e-4, 40, 63) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("cells", "place"), [(40, 30), (24, 12), (8, 8)])
def test_ordered_statistic_factor_gives_the_false_alarms_asked_for(cells, place):
    """The density of the k-th of n exponentials, integrated by quad."""

    def share(level, factor):
        order = stats.beta(place, cells - place + 1)
        return order.pdf(-np.expm1(-level)) * np.exp(-level) * np.exp(-factor * level)

    factor = ordered_statistic_factor(1e-3, cells, place)
    assert quad(share, 0, 40, args=(factor,), limit=200)[0] == pytest.approx(1e-3, rel=1e-6)


def test_the_integral_over_looks_meets_the_product_of_one_look():
    exact = ordered_statistic_factor(1e-5, 40, 30, 1)
    assert ordered_statistic_factor(1e-5, 40, 30, 1 + 1e-9) == pytest.approx(exact, rel=1e-5)


@pytest.mark.parametrize("kind", ["cell-averaging", "ordered-statistic"])
@pytest.mark.parametrize("looks", [1, 16])
def test_false_alarms_in_noise_are_as_many_as_asked_for(kind, looks):
    """Borders too, where fewer cells train. 90,000 cells at 0.01: 900 expected, 30 standard deviation, correlated."""
    noise = np.random.default_rng(3).gamma(looks, 1 / looks, SHAPE)
    found = cfar(noise, kind=kind, window=SMALL, false_alarm=0.01, looks=looks)
    assert len(found) == pytest.approx(900, abs=150)
    row = np.unravel_index(found, SHAPE)[0]
    at_border = np.count_nonzero((row < 3) | (row >= SHAPE[0] - 3))
    assert at_border == pytest.approx(900 * 6 / SHAPE[0], abs=25)


def test_thresholds_equal_those_of_loops():
    rng = np.random.default_rng(5)
    power = rng.exponential(1.0, (9, 8, 4))
    window = CfarWindow(guard=(1, 0, 1), training=(1, 2, 0))
    for kind in ("cell-averaging", "ordered-statistic"):
        got = cfar_threshold(power, kind=kind, window=window, false_alarm=0.02)
        for place in np.ndindex(power.shape):
            cells = place + window.offsets()
            cells = cells[((cells >= 0) & (cells < power.shape)).all(axis=1)]
            assert len(set(map(tuple, cells.tolist()))) == len(cells)
            values = np.sort(power[tuple(cells.T)])
            if kind == "cell-averaging":
                expected = values.mean() * cell_averaging_factor(0.02, len(values))
            else:
                k = rank_of(len(values), 0.75)
                expected = values[k - 1] * ordered_statistic_factor(0.02, len(values), k)
            assert got[place] == pytest.approx(expected, rel=1e-9)


def test_the_offsets_leave_out_the_guard_zone():
    assert len(SMALL.offsets()) == 40
    assert np.abs(SMALL.offsets()).max(axis=1).min() == 2


def test_a_second_target_deafens_cell_averaging_only():
    power = np.ones((40, 40, 1))
    power[20, 20] = power[20, 23] = 30.0
    expected = np.ravel_multi_index([(20, 20), (20, 23), (0, 0)], power.shape).tolist()
    assert cfar(power, kind="ordered-statistic", window=SMALL, false_alarm=1e-4).tolist() == expected
    assert cfar(power, kind="cell-averaging", window=SMALL, false_alarm=1e-8).tolist() == []


def test_cells_with_no_neighbours_are_not_detected():
    power = np.full((1, 1, 3), 5.0)
    assert np.isinf(cfar_threshold(power, window=SMALL)).all()


@pytest.mark.parametrize(
    "options", [{"false_alarm": 0.0}, {"false_alarm": 1.0}, {"looks": 0}, {"rank": 0.0}, {"rank": 1.5}]
)
def test_impossible_arguments_are_refused(options):
    with pytest.raises(ValueError, match="CFAR: expected"):
        cfar(np.ones((3, 3, 3)), **options)


def test_a_window_without_training_cells_is_refused():
    with pytest.raises(ValueError, match="training cells"):
        CfarWindow(training=(0, 0, 0))
    with pytest.raises(ValueError, match="widths of 0 or more"):
        CfarWindow(guard=(-1, 0, 0))
