"""The decision rule against a pilot's numbers, by cases, and under correction for many claims."""

import numpy as np
import pytest
from scipy import stats

from farfield.errors import ConfigError
from farfield.metrics.deciding import Difference, Hypothesis, Spread, decide, holm, pooled

# DDS of a small PointPillars on the Gaussian pattern, three seeds a row; the spreads over sequences were measured too.
PILOT = {
    "joint": (0.461, 0.439, 0.412),
    "paired": (0.409, 0.429, 0.357),
    "shuffled": (0.518, 0.470, 0.478),
    "reversal": (0.526, 0.493, 0.470),
    "coin": (0.499, 0.506, 0.481),
}
PAIRS = {
    ("shuffled", "joint"): 0.007,
    ("reversal", "shuffled"): 0.003,
    ("paired", "joint"): 0.006,
    ("reversal", "coin"): 0.003,
}


def of(estimate: float, error: float, **facts: object) -> Difference:
    """A difference of two seeds with a given standard error that is known well."""
    found = Difference(**{"by_seed": (estimate, estimate), "s_seq": error, "groups": 12, **facts})
    return found.with_pooled(Spread(0.0, np.inf))


def pilot() -> dict[tuple[str, str], Difference]:
    found = {
        (a, b): Difference(by_seed=tuple(np.subtract(PILOT[a], PILOT[b]).tolist()), s_seq=s_seq, groups=12)
        for (a, b), s_seq in PAIRS.items()
    }
    spread = pooled(found.values())
    assert spread is not None
    assert (round(spread.s, 3), spread.df) == (0.021, 8)
    return {pair: each.with_pooled(spread) for pair, each in found.items()}


@pytest.mark.parametrize(
    ("pair", "estimate", "interval", "verdict"),
    [
        (("shuffled", "joint"), 0.051, (0.020, 0.083), "holds"),
        (("reversal", "shuffled"), 0.008, (-0.020, 0.036), "undecided"),
        (("paired", "joint"), -0.039, (-0.070, -0.008), "holds not"),
    ],
)
def test_the_pilot_is_decided_as_it_was(
    pair: tuple[str, str], estimate: float, interval: tuple[float, float], verdict: str
) -> None:
    found = pilot()[pair]
    assert found.estimate == pytest.approx(estimate, abs=6e-4)
    assert found.interval() == pytest.approx(interval, abs=1.2e-3)  # the pilot's rows have three digits
    assert decide(found).verdict == verdict


@pytest.mark.parametrize(
    ("kind", "margin", "low", "high", "verdict"),
    [
        ("above", 0.0, 0.001, 0.1, "holds"),
        ("above", 0.0, -0.001, 0.1, "undecided"),
        ("above", 0.0, -0.1, -0.001, "holds not"),
        ("above", 0.05, 0.04, 0.1, "undecided"),
        ("above", 0.05, 0.06, 0.1, "holds"),
        ("not_below", 0.01, -0.009, 0.1, "holds"),
        ("not_below", 0.01, -0.011, 0.1, "undecided"),
        ("not_below", 0.01, -0.1, -0.011, "holds not"),
        ("equivalent", 0.01, -0.009, 0.009, "holds"),
        ("equivalent", 0.01, -0.009, 0.011, "undecided"),
        ("equivalent", 0.01, 0.011, 0.02, "holds not"),
        ("equivalent", 0.01, -0.02, -0.011, "holds not"),
    ],
)
def test_the_interval_decides(kind: str, margin: float, low: float, high: float, verdict: str) -> None:
    z = stats.norm.ppf(0.975)
    found = of((low + high) / 2, (high - low) / 2 / z)
    assert found.interval() == pytest.approx((low, high))
    decision = decide(found, Hypothesis(kind=kind, margin=margin))  # type: ignore[arg-type]
    assert decision.verdict == verdict
    assert decision.p is not None
    assert (decision.p <= 0.05) == (verdict != "undecided")  # the p that is corrected says what the interval says


def test_the_sign_decides_whichever_row_stands_first() -> None:
    verdicts = {"holds": "holds not", "holds not": "holds", "undecided": "undecided"}
    for estimate in (-0.1, -0.01, 0.0, 0.01, 0.1):
        one, other = decide(of(estimate, 0.01)), decide(of(-estimate, 0.01))
        assert other.verdict == verdicts[one.verdict]
        assert one.p == pytest.approx(other.p)


def test_undecided_differences_that_can_only_be_small_are_called_so() -> None:
    assert decide(of(0.001, 0.005)).words == "undecided and smaller than 0.02"
    assert decide(of(0.015, 0.01)).words == "undecided"
    assert decide(of(0.015, 0.001)).words == "holds"
    assert decide(of(0.001, 0.005), small=0.005).words == "undecided"


def test_one_seed_one_sequence_or_no_figure_decide_nothing() -> None:
    one = Difference(by_seed=(0.3,), s_seq=0.01, groups=12, pooled=Spread(0.01, 20))
    assert decide(one).words == "one seed: no decision"
    assert str(decide(one)).startswith("+0.300 [+0.280, +0.320], n 1: one seed")
    assert decide(of(0.3, 0.01, grouped_by="frames")).words == "one sequence: no decision"
    assert decide(of(0.3, 0.01, by_seed=())).words == "no figure: no decision"
    assert decide(of(0.3, 0.01, s_seq=None)).words == "too few sequences have a figure: no decision"
    assert decide(of(0.3, 0.01, by_seed=(0.3,), trained=False)).verdict == "holds"


def test_a_difference_without_any_scatter_is_decided_by_its_sign() -> None:
    assert [decide(of(value, 0.0)).verdict for value in (0.1, 0.0, -0.1)] == ["holds", "undecided", "holds not"]


def test_holms_correction_against_worked_numbers() -> None:
    """p of 0.01, 0.02, 0.03, 0.04 become 0.04, 0.06, 0.06, 0.06; one decided at 1e-6 stays."""
    z = stats.norm.isf(np.array([0.02, 0.01, 0.04, 0.03]) / 2)
    decisions = [decide(of(float(each) * 0.01, 0.01)) for each in z]
    assert [d.verdict for d in decisions] == ["holds"] * 4
    adjusted = holm(decisions)
    assert [d.p for d in adjusted] == pytest.approx([0.06, 0.04, 0.06, 0.06])
    assert [d.verdict for d in adjusted] == ["undecided", "holds", "undecided", "undecided"]
    with_more = holm([*decisions, decide(of(-0.1, 0.01)), decide(of(0.0, 0.01)), decide(of(1.0, 1.0, by_seed=()))])
    assert with_more[4].verdict == "holds not"
    assert with_more[5].verdict == "undecided"
    assert with_more[6].verdict == "no decision"
    assert with_more[1].p == pytest.approx(0.05)


def test_correcting_never_decides_more() -> None:
    rng = np.random.default_rng(0)
    decisions = [decide(of(float(value), 0.01)) for value in rng.normal(0.01, 0.02, 30)]
    for before, after in zip(decisions, holm(decisions), strict=True):
        assert after.p is not None
        assert before.p is not None
        assert after.p >= before.p
        assert after.verdict in (before.verdict, "undecided")


def test_margins_that_mean_nothing_are_refused() -> None:
    for kind, margin in (("equivalent", 0.0), ("above", -0.1), ("not_below", float("nan"))):
        with pytest.raises(ConfigError, match="expected"):
            Hypothesis(kind=kind, margin=margin)  # type: ignore[arg-type]


def test_a_decision_is_json() -> None:
    tree = decide(pilot()["shuffled", "joint"]).to_json()
    assert tree["verdict"] == "holds"
    assert tree["claim"] == {"kind": "above", "margin": 0.0}
    assert tree["difference"]["s_seed"]["own"] == pytest.approx(0.018, abs=5e-4)
