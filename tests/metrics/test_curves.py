"""Curves under weights: a drive of weight zero might as well not have been there."""

import numpy as np
import pytest

from farfield.metrics.bootstrap import Bootstrap, evaluate_once, point_and_intervals, replicate_weights
from farfield.metrics.curves import (
    RECALL,
    Curves,
    Ranking,
    average_precisions,
    mean_errors,
    row_chunks,
    weighted_curves,
)

METHODS = ("nuscenes", "interp101", "area", "voc")
ONES = np.ones((1, 6))


def ranking(rng: np.random.Generator, *, rows: int = 200, groups: int = 6) -> Ranking:
    return Ranking(
        confidence=np.sort(rng.uniform(0, 1, rows))[::-1].copy(),
        is_match=rng.uniform(0, 1, rows) < np.linspace(0.95, 0.2, rows),
        group=rng.integers(0, groups, rows),
        annotated=rng.integers(30, 60, groups),
    )


def tied_ranking(rng: np.random.Generator, rows: int, *, groups: int = 6, found: float = 0.9) -> Ranking:
    return Ranking(
        confidence=np.sort(np.round(rng.uniform(0, 1, rows), 2))[::-1].copy(),  # with ties
        is_match=rng.uniform(0, 1, rows) < np.linspace(found, found / 4, rows),
        group=rng.integers(0, groups, rows),
        annotated=rng.integers(0, 1 + rows // 4, groups),
    )


def area(curves: Curves, method: str = "nuscenes") -> float:
    return float(average_precisions(curves, method=method)[0])


def error_of(curves: Curves, error: np.ndarray, method: str = "nuscenes") -> float:
    return float(mean_errors(curves, error, method=method)[0])


@pytest.mark.parametrize("method", METHODS)
def test_weight_zero_is_absence(rng: np.random.Generator, method: str) -> None:
    for _ in range(20):
        full = ranking(rng)
        kept = np.array([1.0, 0.0, 1.0, 1.0, 0.0, 1.0])
        rows = kept[full.group] > 0
        part = Ranking(
            confidence=full.confidence[rows],
            is_match=full.is_match[rows],
            group=full.group[rows],
            annotated=np.where(kept > 0, full.annotated, 0),
        )
        error = rng.uniform(0, 1, len(full.hits))
        weighted, alone = weighted_curves(full, kept[None]), weighted_curves(part, ONES)
        assert area(weighted, method) == pytest.approx(area(alone, method), abs=1e-12)
        kept_error = error[rows[full.hits]]
        plain = error_of(weighted, error, "tp_mean")
        assert plain == pytest.approx(error_of(alone, kept_error, "tp_mean"), abs=1e-12)
        # On the confidence axis the rows of weight zero still give confidences between their neighbours'.
        assert error_of(weighted, error) == pytest.approx(error_of(alone, kept_error), abs=0.02)


def test_all_weights_doubled_change_nothing(rng: np.random.Generator) -> None:
    full = ranking(rng)
    once, twice = weighted_curves(full, ONES), weighted_curves(full, 2 * ONES)
    np.testing.assert_allclose(once.precision, twice.precision, atol=1e-14)


@pytest.mark.parametrize("method", METHODS)
def test_a_weight_of_two_is_a_group_that_is_there_twice(rng: np.random.Generator, method: str) -> None:
    for rows in (1, 2, 7, 60, 400):
        full = ranking(rng, rows=rows)
        weights = rng.integers(0, 4, 6)
        times = weights[full.group]
        # Copies stand beside each other in the ranking, so areas that read precision between matches differ by them.
        copied = Ranking(
            confidence=np.repeat(full.confidence, times),
            is_match=np.repeat(full.is_match, times),
            group=np.repeat(full.group, times),
            annotated=weights * full.annotated,
        )
        error = rng.uniform(0, 1, len(full.hits))
        weighted, many = weighted_curves(full, weights[None].astype(float)), weighted_curves(copied, ONES)
        copied_error = np.repeat(error, times[full.hits])
        assert error_of(weighted, error, "tp_mean") == pytest.approx(
            error_of(many, copied_error, "tp_mean"), nan_ok=True, abs=1e-12
        )
        assert weighted.annotated[0] == many.annotated[0]
        np.testing.assert_allclose(weighted.matched[0, -1:], many.matched[0, -1:])
        if rows == 400:
            assert area(weighted, method) == pytest.approx(area(many, method), abs=0.03)


def test_precision_is_interpolated_as_numpy_does(rng: np.random.Generator) -> None:
    for rows in (1, 2, 5, 200):
        full = ranking(rng, rows=rows)
        curves = weighted_curves(full, ONES)
        if full.is_match.any():
            expected = np.interp(RECALL, full.recall, full.precision, right=0)
            np.testing.assert_allclose(curves.precision[0], expected, atol=1e-13)
            np.testing.assert_allclose(
                curves.confidence[0], np.interp(RECALL, full.recall, full.confidence, right=0), atol=1e-13
            )
        else:
            assert not curves.precision.any()


@pytest.mark.parametrize("rows", [0, 1, 2, 7, 60, 400])
@pytest.mark.parametrize("found", [0.0, 0.2, 1.0])
def test_figures_are_those_of_the_devkits_formulas(rng: np.random.Generator, rows: int, found: float) -> None:
    """Each row against a plain reading of calc_ap and calc_tp with numpy.interp and numpy.average."""
    full = tied_ranking(rng, rows, found=found)
    error = rng.uniform(0, 1, len(full.hits))
    weights = np.vstack([np.zeros(6), np.ones(6), np.eye(6), replicate_weights(6, 40, rng)])
    curves = weighted_curves(full, weights)
    areas = {method: average_precisions(curves, method=method) for method in METHODS}
    errors = {method: mean_errors(curves, error, method=method) for method in ("nuscenes", "tp_mean")}
    for row, weight in enumerate(weights):
        total = float(weight @ full.annotated)
        assert bool(curves.has_annotated[row]) == (total > 0)
        if total == 0:
            assert all(np.isnan(values[row]) for values in (*areas.values(), *errors.values()))
            continue
        match_weight = weight[full.group][full.hits]
        if match_weight.sum() == 0:
            assert all(values[row] == 0 for values in areas.values())
            assert all(values[row] == 1 for values in errors.values())
            continue
        ranks = np.cumsum(weight[full.group])[full.hits]
        matched = np.cumsum(match_weight)
        precision = np.divide(matched, ranks, out=np.ones(len(ranks)), where=ranks > 0)
        assert areas["area"][row] == pytest.approx(float(match_weight @ precision) / total, abs=1e-12)
        envelope = np.maximum.accumulate(precision[::-1])[::-1]
        assert areas["voc"][row] == pytest.approx(float(match_weight @ envelope) / total, abs=1e-12)
        assert errors["tp_mean"][row] == pytest.approx(np.average(error, weights=match_weight), abs=1e-12)
        assert areas["interp101"][row] == pytest.approx(curves.precision[row].mean(), abs=1e-12)
        above = np.maximum(curves.precision[row, 11:] - 0.1, 0).mean() / 0.9
        assert areas["nuscenes"][row] == pytest.approx(min(above, 1.0), abs=1e-12)
        reached = np.flatnonzero(curves.confidence[row])
        if not len(reached) or reached[-1] < 11:
            assert errors["nuscenes"][row] == 1
            continue
        first = int(np.argmax(matched > 0))
        running = np.cumsum(match_weight * error)
        running[first:] /= matched[first:]
        running[:first] = running[first]
        at = curves.confidence[row, 11 : reached[-1] + 1]
        expected = np.interp(at, full.confidence[full.hits][::-1], running[::-1]).mean()
        assert errors["nuscenes"][row] == pytest.approx(expected, abs=1e-12)


def test_chunks_hold_every_row_once() -> None:
    weights = replicate_weights(6, 500, np.random.default_rng(0))
    chunks = row_chunks(weights, 30_000)
    assert len(chunks) > 2
    np.testing.assert_array_equal(np.concatenate(chunks), weights)


def test_nothing_annotated_has_no_curve(rng: np.random.Generator) -> None:
    empty = ranking(rng)
    empty = Ranking(
        confidence=empty.confidence, is_match=empty.is_match & False, group=empty.group, annotated=np.zeros(6, int)
    )
    assert not weighted_curves(empty, ONES).has_annotated[0]
    assert empty.sampled() is None


def test_replicates_draw_as_many_groups_as_there_are(rng: np.random.Generator) -> None:
    weights = replicate_weights(7, 500, rng)
    assert (weights.sum(axis=1) == 7).all()
    assert weights.mean(axis=0) == pytest.approx(np.ones(7), abs=0.2)


def test_interval_of_a_mean_has_the_known_width() -> None:
    values = np.random.default_rng(5).normal(3.0, 1.0, 400)
    point, intervals = point_and_intervals(
        lambda w: {"all": {"mean": w @ values / w.sum(axis=1)}}, 400, Bootstrap(replicates=1000)
    )
    found = intervals["all"]["mean"]
    assert point["all"]["mean"] == pytest.approx(values.mean())
    assert found is not None
    half = 1.96 * values.std() / 20
    assert found == pytest.approx([values.mean() - half, values.mean() + half], abs=0.015)


def test_one_group_has_no_interval() -> None:
    for groups, settings in ((1, Bootstrap()), (5, Bootstrap(replicates=0)), (5, Bootstrap(replicates=1))):
        point, intervals = point_and_intervals(lambda w: {"all": {"a": np.ones(len(w))}}, groups, settings)
        assert point == {"all": {"a": 1.0}}
        assert intervals == {"all": {"a": None}}


def test_equal_draws_are_scored_once() -> None:
    rows: list[bytes] = []

    def first(weights: np.ndarray) -> dict[str, dict[str, np.ndarray]]:
        rows.extend(row.tobytes() for row in weights)
        return {"all": {"a": weights[:, 0]}}

    point, intervals = point_and_intervals(first, 2, Bootstrap(replicates=200))
    assert point == {"all": {"a": 1.0}}
    assert intervals == {"all": {"a": [0.0, 2.0]}}
    assert len(rows) == len(set(rows)) == 3


def test_figures_come_back_in_the_order_of_the_rows(rng: np.random.Generator) -> None:
    weights = replicate_weights(3, 50, rng)
    values = evaluate_once(lambda w: {"all": {"first": w[:, 0], "last": w[:, 2]}}, weights)["all"]
    np.testing.assert_array_equal(values["first"], weights[:, 0])
    np.testing.assert_array_equal(values["last"], weights[:, 2])
