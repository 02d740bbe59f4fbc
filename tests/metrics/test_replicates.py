"""Many weights at once give what one after the other gives."""

import numpy as np
import pytest

from farfield.metrics.bootstrap import Bootstrap, intervals, replicate_weights
from farfield.metrics.curves import Ranking, average_precision, mean_error, weighted_curve
from farfield.metrics.replicates import average_precisions, mean_errors, shares, weighted_curves
from farfield.testing.protocols import example


def ranking(rng: np.random.Generator, rows: int, *, groups: int = 6, found: float = 0.9) -> Ranking:
    return Ranking(
        confidence=np.sort(np.round(rng.uniform(0, 1, rows), 2))[::-1].copy(),  # with ties
        is_match=rng.uniform(0, 1, rows) < np.linspace(found, found / 4, rows),
        group=rng.integers(0, groups, rows),
        annotated=rng.integers(0, 1 + rows // 4, groups),
    )


@pytest.mark.parametrize("rows", [0, 1, 2, 7, 60, 400])
@pytest.mark.parametrize("found", [0.0, 0.2, 1.0])
def test_each_row_is_the_curve_of_its_weights(rng: np.random.Generator, rows: int, found: float) -> None:
    full = ranking(rng, rows, found=found)
    error = rng.uniform(0, 1, len(full.hits))
    weights = np.vstack([np.zeros(6), np.ones(6), np.eye(6), replicate_weights(6, 40, rng)])
    curves = weighted_curves(full, weights)
    areas = {method: average_precisions(curves, method=method) for method in ("nuscenes", "interp101", "area", "voc")}
    errors = {method: mean_errors(curves, error, method=method) for method in ("nuscenes", "tp_mean")}
    for row, weight in enumerate(weights):
        one = weighted_curve(full, weight)
        assert bool(curves.known[row]) == (one is not None)
        for method, values in areas.items():
            expected = np.nan if one is None else average_precision(one, method=method)
            np.testing.assert_allclose(values[row], expected, atol=1e-12)
        for method, values in errors.items():
            expected = np.nan if one is None else mean_error(one, error, method=method)
            np.testing.assert_allclose(values[row], expected, atol=1e-12)


def test_shares_hold_every_row_once() -> None:
    rng = np.random.default_rng(0)
    weights = replicate_weights(6, 500, rng)
    parted = shares(ranking(rng, 30_000), weights)
    assert len(parted) > 2
    np.testing.assert_array_equal(np.concatenate(parted), weights)


@pytest.mark.parametrize("name", ["dds", "nuscenes"])
@pytest.mark.parametrize("settings", [{}, {"range_bins_m": (0.0, 20.0, 40.0, 300.0), "ap": "voc"}])
def test_intervals_are_those_of_one_after_the_other(
    monkeypatch: pytest.MonkeyPatch, name: str, settings: dict[str, object]
) -> None:
    options = {"label": "vehicle", "region": "none", "bootstrap": Bootstrap(replicates=60), **settings}
    at_once = example().score(name, **options).intervals
    with monkeypatch.context() as patch:
        patch.setattr("farfield.metrics.centre.protocol.intervals", one_by_one)
        apart = example().score(name, **options).intervals
    assert at_once.keys() == apart.keys()
    for part, figures in apart.items():
        assert at_once[part].keys() == figures.keys()
        for figure, interval in figures.items():
            found = at_once[part][figure]
            assert (found is None) == (interval is None), (part, figure)
            if interval is not None:
                np.testing.assert_allclose(found, interval, atol=1e-12)


def one_by_one(statistics: object, groups: int, settings: Bootstrap, *, many: object = None) -> object:
    """Intervals without the figures of many weights at once."""
    del many
    return intervals(statistics, groups, settings)  # type: ignore[arg-type]
