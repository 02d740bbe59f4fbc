"""Curves under weights: a drive of weight zero might as well not have been there."""

import numpy as np
import pytest

from farfield.metrics.bootstrap import Bootstrap, intervals, replicate_weights
from farfield.metrics.curves import RECALL, Ranking, average_precision, mean_error, weighted_curve


def ranking(rng: np.random.Generator, *, rows: int = 200, groups: int = 6) -> Ranking:
    return Ranking(
        confidence=np.sort(rng.uniform(0, 1, rows))[::-1].copy(),
        is_match=rng.uniform(0, 1, rows) < np.linspace(0.95, 0.2, rows),
        group=rng.integers(0, groups, rows),
        annotated=rng.integers(30, 60, groups),
    )


@pytest.mark.parametrize("method", ["nuscenes", "interp101", "area", "voc"])
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
        weighted, alone = weighted_curve(full, kept), weighted_curve(part)
        assert weighted is not None
        assert alone is not None
        assert average_precision(weighted, method=method) == pytest.approx(
            average_precision(alone, method=method), abs=1e-12
        )
        kept_error = error[rows[full.hits]]
        plain = mean_error(weighted, error, method="tp_mean")
        assert plain == pytest.approx(mean_error(alone, kept_error, method="tp_mean"), abs=1e-12)
        # On the confidence axis the rows of weight zero still give confidences between their neighbours'.
        assert mean_error(weighted, error) == pytest.approx(mean_error(alone, kept_error), abs=0.02)


def test_all_weights_doubled_change_nothing(rng: np.random.Generator) -> None:
    full = ranking(rng)
    once, twice = weighted_curve(full), weighted_curve(full, np.full(6, 2.0))
    assert once is not None
    assert twice is not None
    np.testing.assert_allclose(once.precision, twice.precision, atol=1e-14)


def test_precision_is_interpolated_as_numpy_does(rng: np.random.Generator) -> None:
    for rows in (1, 2, 5, 200):
        full = ranking(rng, rows=rows)
        curve = weighted_curve(full)
        assert curve is not None
        if full.is_match.any():
            expected = np.interp(RECALL, full.recall, full.precision, right=0)
            np.testing.assert_allclose(curve.precision, expected, atol=1e-13)
            np.testing.assert_allclose(
                curve.confidence, np.interp(RECALL, full.recall, full.confidence, right=0), atol=1e-13
            )
        else:
            assert not curve.precision.any()


def test_nothing_annotated_has_no_curve(rng: np.random.Generator) -> None:
    empty = ranking(rng)
    empty = Ranking(
        confidence=empty.confidence, is_match=empty.is_match & False, group=empty.group, annotated=np.zeros(6, int)
    )
    assert weighted_curve(empty) is None
    assert empty.sampled() is None


def test_replicates_draw_as_many_groups_as_there_are(rng: np.random.Generator) -> None:
    weights = replicate_weights(7, 500, rng)
    assert (weights.sum(axis=1) == 7).all()
    assert weights.mean(axis=0) == pytest.approx(np.ones(7), abs=0.2)


def test_interval_of_a_mean_has_the_known_width() -> None:
    rng = np.random.default_rng(5)
    values = rng.normal(3.0, 1.0, 400)
    found = intervals(lambda w: {"mean": float(w @ values / w.sum())}, 400, Bootstrap(replicates=1000))["mean"]
    assert found is not None
    half = 1.96 * values.std() / 20
    assert found == pytest.approx([values.mean() - half, values.mean() + half], abs=0.015)


def test_one_group_has_no_interval() -> None:
    assert intervals(lambda w: {"a": 1.0}, 1, Bootstrap()) == {"a": None}
    assert intervals(lambda w: {"a": 1.0}, 5, Bootstrap(replicates=0)) == {"a": None}


def test_equal_draws_are_scored_once() -> None:
    asked: list[bytes] = []

    def first(weight: np.ndarray) -> dict[str, float | None]:
        asked.append(weight.tobytes())
        return {"a": float(weight[0])}

    assert intervals(first, 2, Bootstrap(replicates=200)) == {"a": [0.0, 2.0]}
    assert len(asked) == len(set(asked)) == 3
