"""Power: against a table of simulated trials, limits that are known exactly, and the rule itself played out."""

import numpy as np
import pytest
from scipy import stats

from farfield.errors import ConfigError
from farfield.metrics.deciding import Difference, Hypothesis, Spread, decide, half_width, power

TRUE = (0.010, 0.017, 0.025, 0.050, 0.090)
TABLE = [  # s_seed, s_seq, n, df, half width, power at TRUE: 4,000 simulated trials of the rule
    (0.008, 0.006, 3, None, 0.031, (0.01, 0.05, 0.22, 0.97, 1)),
    (0.008, 0.006, 3, 20, 0.016, (0.23, 0.56, 0.89, 1, 1)),
    (0.008, 0.006, 5, None, 0.019, (0.10, 0.37, 0.78, 1, 1)),
    (0.008, 0.006, 5, 20, 0.015, (0.26, 0.64, 0.94, 1, 1)),
    (0.008, 0.006, 8, None, 0.016, (0.21, 0.58, 0.91, 1, 1)),
    (0.008, 0.006, 8, 20, 0.014, (0.28, 0.68, 0.95, 1, 1)),
    (0.015, 0.008, 3, None, 0.046, (0.0, 0.02, 0.06, 0.56, 0.98)),
    (0.015, 0.008, 3, 20, 0.024, (0.12, 0.27, 0.51, 0.98, 1)),
    (0.015, 0.008, 5, None, 0.028, (0.05, 0.14, 0.39, 0.97, 1)),
    (0.015, 0.008, 5, 20, 0.022, (0.14, 0.34, 0.63, 1, 1)),
]


@pytest.mark.parametrize(("s_seed", "s_seq", "n", "df", "width", "expected"), TABLE)
def test_power_is_that_of_simulated_trials(
    s_seed: float, s_seq: float, n: int, df: float | None, width: float, expected: tuple[float, ...]
) -> None:
    spreads = {"s_seed": s_seed, "s_seq": s_seq, "n": n, "df": df}
    assert half_width(**spreads) == pytest.approx(width, rel=0.12)  # the table's is the mean of estimated ones
    found = [power(true, **spreads) for true in TRUE]
    assert found == pytest.approx(expected, abs=0.02)
    assert power(0.0, **spreads) <= 0.02 + 1e-3


@pytest.mark.parametrize(
    ("kind", "margin", "true"), [("above", 0.0, 0.02), ("not_below", 0.01, 0.0), ("equivalent", 0.03, 0.0)]
)
def test_the_rule_played_out_holds_as_often_as_its_power_says(kind: str, margin: float, true: float) -> None:
    rng, hypothesis, trials = np.random.default_rng(0), Hypothesis(kind=kind, margin=margin), 2000  # type: ignore[arg-type]
    holds = 0
    for _ in range(trials):
        by_seed = true + rng.normal(0, 0.006) + rng.normal(0, 0.01, 3)
        spread = Spread(0.01 * float(np.sqrt(rng.chisquare(20) / 20)), 20)
        found = Difference(by_seed=tuple(by_seed.tolist()), s_seq=0.006, groups=12)
        # the pooled spread alone: the rule's exception for outliers is not in the power
        centred = Difference(by_seed=(found.estimate,) * 3, s_seq=0.006, groups=12)  # type: ignore[arg-type]
        holds += decide(centred.with_pooled(spread), hypothesis).verdict == "holds"
    expected = power(true, s_seed=0.01, s_seq=0.006, n=3, df=20, hypothesis=hypothesis)
    assert holds / trials == pytest.approx(expected, abs=4 * np.sqrt(expected * (1 - expected) / trials))


def test_known_spreads_give_the_normal_law() -> None:
    for n in (2, 7):
        error = float(np.sqrt(0.01**2 / n + 0.005**2))
        expected = stats.norm.sf(stats.norm.ppf(0.975) - 0.02 / error)
        assert power(0.02, s_seed=0.01, s_seq=0.005, n=n, df=float("inf")) == pytest.approx(expected)
        assert power(0.02, s_seed=0.01, s_seq=0.005, n=n, df=1e6) == pytest.approx(expected, abs=1e-3)


def test_power_grows_with_the_difference_the_seeds_and_the_sequences() -> None:
    spreads = {"s_seed": 0.01, "s_seq": 0.006, "df": 20}
    by_true = [power(true, n=3, **spreads) for true in np.linspace(-0.02, 0.08, 9).tolist()]
    assert by_true == sorted(by_true)
    by_seeds = [power(0.02, n=n, **spreads) for n in (2, 3, 5, 9)]
    assert by_seeds == sorted(by_seeds)
    by_sequences = [power(0.02, s_seed=0.01, s_seq=s_seq, n=3, df=20) for s_seq in (0.02, 0.01, 0.005, 0.0)]
    assert by_sequences == sorted(by_sequences)


def test_a_false_claim_holds_at_most_once_in_forty() -> None:
    assert power(0.0, s_seed=0.01, s_seq=0.0, n=3, df=20) == pytest.approx(0.025, abs=1e-5)
    assert power(-0.01, s_seed=0.01, s_seq=0.0, n=3, df=20, hypothesis=Hypothesis(kind="not_below", margin=0.01)) == (
        pytest.approx(0.025, abs=1e-5)
    )


def test_without_scatter_the_truth_is_found() -> None:
    assert power(0.001, s_seed=0.0, s_seq=0.0, n=2) == 1.0
    assert power(0.0, s_seed=0.0, s_seq=0.0, n=2) == 0.0


def test_one_seed_without_a_pooled_spread_has_no_power() -> None:
    with pytest.raises(ConfigError, match="two seeds or a pooled spread"):
        power(0.1, s_seed=0.01, s_seq=0.0, n=1)
