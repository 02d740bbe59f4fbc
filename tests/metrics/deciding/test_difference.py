"""Differences between rows: paired by seed, with the spread over seeds and over sequences."""

import pickle

import numpy as np
import pytest
from scipy import stats

from farfield.errors import ConfigError
from farfield.frame.annotation import Annotation
from farfield.metrics import Detections
from farfield.metrics.deciding import (
    Difference,
    ScoreSample,
    Spread,
    difference,
    difference_of,
    figure,
    measured,
    pooled,
)
from metrics.scenes import random_scene


def runs(spoilt: float, seeds: int = 3) -> list[Detections]:
    """Runs of one row: detections of the same frames, spoilt by a noise that differs from seed to seed."""
    predictions, annotations = random_scene(np.random.default_rng(0), frames=24, sequences=6)
    rows = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        moved = {
            key: boxes.replace(centre_m=boxes.centre_m + spoilt * rng.normal(0, 1, boxes.centre_m.shape))
            for key, boxes in predictions.items()
        }
        given = {key: Annotation(boxes=boxes) for key, boxes in annotations.items()}
        rows.append(Detections(boxes=moved, annotations=given))
    return rows


def of(*by_seed: float, s_seq: float | None = 0.0, **facts: object) -> Difference:
    return Difference(by_seed=by_seed, s_seq=s_seq, groups=12, **facts)


def as_sample(value: float | None, draws: np.ndarray, drawn: str = "x") -> ScoreSample:
    return ScoreSample(value=value, draws=draws, drawn=drawn, grouped_by="sequences", groups=9)


def test_a_row_does_not_differ_from_itself() -> None:
    found = difference(runs(1.0), runs(1.0), figure("dds/0/dds"), replicates=20, epsilons=(0.0,))
    assert found.by_seed == (0.0, 0.0, 0.0)
    assert found.s_seq == 0.0
    assert found.interval() == (0.0, 0.0)


def test_exchanging_the_rows_changes_the_sign_alone() -> None:
    one, other = (
        difference(runs(a), runs(b), figure("dds/0/dds"), replicates=50, epsilons=(0.0,))
        for a, b in ((0.2, 2.0), (2.0, 0.2))
    )
    assert one.estimate is not None
    assert one.estimate > 0
    assert one.estimate == -other.estimate  # type: ignore[operator]
    assert one.s_seq == pytest.approx(other.s_seq)
    low, high = one.interval() or (0, 0)
    assert other.interval() == pytest.approx((-high, -low))


def test_the_draw_is_the_same_for_both_rows_and_all_seeds() -> None:
    """What sequences add to both rows alike cancels: only the draw of the difference scatters."""
    common = np.random.default_rng(0).normal(0, 0.1, 400)
    own = np.random.default_rng(1).normal(0, 0.004, (2, 3, 400))
    a = [as_sample(0.6 + s / 100, common + own[0, s]) for s in range(3)]
    b = [as_sample(0.5, common + own[1, s]) for s in range(3)]
    found = difference_of(a, b)
    assert found.by_seed == pytest.approx((0.10, 0.11, 0.12))
    assert found.s_seq == pytest.approx(0.004 * np.sqrt(2 / 3), rel=0.15)


def test_another_range_may_be_the_other_rows_number() -> None:
    near, far = figure("dds/0/dds", "0-70"), figure("dds/0/dds", "70-150")
    row = runs(0.5, seeds=2)
    across = difference(row, row, near, b_scalar=far, replicates=10, epsilons=(0.0,))
    within = [run.score(epsilons=(0.0,)) for run in row]
    expected = [r.ranges["0-70"]["dds/0/dds"] - r.ranges["70-150"]["dds/0/dds"] for r in within]
    assert across.by_seed == pytest.approx(expected)


def test_the_interval_is_that_of_the_rule() -> None:
    found = of(0.02, 0.05, 0.08, s_seq=0.01).with_pooled(Spread(0.02, 20))
    reach = stats.t.ppf(0.975, 20) * np.sqrt(0.02**2 / 3 + 0.01**2)
    assert found.interval() == pytest.approx((0.05 - reach, 0.05 + reach))
    assert found.own is not None
    assert (found.own.s, found.own.df) == (pytest.approx(0.03), 2)


@pytest.mark.parametrize(("pool", "used"), [(0.02, 0.02), (0.016, 0.016), (0.014, 0.03), (0.2, 0.2)])
def test_a_pairs_own_spread_counts_where_it_is_more_than_twice_the_pooled_one(pool: float, used: float) -> None:
    found = of(0.02, 0.05, 0.08).with_pooled(Spread(pool, 20)).spread
    assert found is not None
    assert (found.s, found.df) == (pytest.approx(used), 2 if used == 0.03 else 20)


def test_pooling_weighs_by_degrees_of_freedom() -> None:
    pairs = [of(0.0, 0.02), of(0.0, 0.01, 0.02, 0.03), of(0.5), of(0.1, trained=False)]
    found = pooled(pairs)
    assert found is not None
    assert found.df == 4
    assert found.s == pytest.approx(
        np.sqrt((1 * np.var([0, 0.02], ddof=1) + 3 * np.var([0, 1, 2, 3], ddof=1) / 1e4) / 4)
    )
    assert pooled([of(0.5)]) is None


def test_one_seed_has_an_interval_over_sequences_only() -> None:
    found = of(0.03, s_seq=0.01).with_pooled(Spread(0.05, 20))
    assert found.spread is None
    assert found.interval() == pytest.approx((0.03 - 1.96 * 0.01, 0.03 + 1.96 * 0.01), abs=1e-4)


def test_a_figure_that_is_missing_in_one_run_leaves_none() -> None:
    draws = np.zeros(10)
    found = difference_of([as_sample(0.5, draws), as_sample(None, draws)], [as_sample(0.4, draws)] * 2)
    assert found.estimate is None
    assert found.interval() is None
    assert found.to_json()["estimate"] is None


def test_figures_missing_under_most_draws_give_no_spread() -> None:
    draws = np.r_[np.full(6, np.nan), np.zeros(4)]
    assert difference_of([as_sample(0.5, draws)], [as_sample(0.4, np.zeros(10))]).s_seq is None
    draws = np.r_[np.full(4, np.nan), np.zeros(6)]
    assert difference_of([as_sample(0.5, draws)], [as_sample(0.4, np.zeros(10))]).s_seq == 0.0


def test_rows_of_other_seeds_or_frames_are_refused() -> None:
    with pytest.raises(ConfigError, match="as many seeds"):
        difference(runs(1.0, 2), runs(1.0, 3), figure("dds/0/dds"), replicates=2)
    with pytest.raises(ConfigError, match="same frames"):
        difference_of([as_sample(0.5, np.zeros(9))], [as_sample(0.5, np.zeros(9), "y")])


def test_a_statistic_of_the_data_scatters_over_sequences_as_a_mean_does() -> None:
    values = np.random.default_rng(2).normal(1.0, 0.3, 40)
    found = measured(_Mean(values), 40, replicates=4000)
    assert found.estimate == pytest.approx(values.mean())
    assert found.s_seq == pytest.approx(values.std() / np.sqrt(40), rel=0.05)
    reach = stats.t.ppf(0.975, 39) * found.s_seq
    assert found.interval() == pytest.approx((values.mean() - reach, values.mean() + reach))
    assert measured(_nothing, 5).estimate is None


class _Mean:
    def __init__(self, values: np.ndarray) -> None:
        self.values = values

    def __call__(self, weight: np.ndarray) -> float:
        return float(weight @ self.values / weight.sum())


def _nothing(weight: np.ndarray) -> None:
    return None


def test_a_difference_travels_between_processes() -> None:
    found = of(0.1, 0.2, s_seq=0.01).with_pooled(Spread(0.1, 4))
    assert pickle.loads(pickle.dumps(found)) == found
