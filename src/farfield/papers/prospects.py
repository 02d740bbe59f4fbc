"""Which claims a budget can decide: the power of each comparison, were the paper's difference the truth."""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import lru_cache

from farfield.metrics.deciding import power
from farfield.papers.claims import Claims, Comparison
from farfield.papers.grid import BudgetSettings

S_SEED, S_SEQ, ROADS = 0.015, 0.008, 12
"""Spread of paired differences over seeds, and over draws of so many roads, met at small size: what power rests on."""
LIKELY, POSSIBLE = 0.8, 0.3
"""Power from which a claim can be decided, and from which it perhaps can."""


@dataclass(frozen=True, kw_only=True)
class PowerEstimate:
    """Whether a comparison of a claim can be decided.

    Args:
        claim: The claim's id.
        power: Probability of "holds" were the published difference the truth; None where the paper prints none.
        runs: Whether this budget has its runs.
    """

    claim: str
    power: float | None
    runs: bool = True

    @property
    def words(self) -> str:
        """In words."""
        if not self.runs:
            return "not run at this budget"
        if self.power is None:
            return "no published difference"
        return "yes" if self.power >= LIKELY else "perhaps" if self.power >= POSSIBLE else "hardly"


def outlooks(
    claims: Claims, runs: Sequence[str], settings: BudgetSettings, *, of: Collection[str] | None = None
) -> tuple[PowerEstimate, ...]:
    """Which claims can be decided by runs of this number of seeds and roads, by the published differences.

    Args:
        claims: The claims.
        runs: The runs of the budget.
        settings: The budget.
        of: Names of the claims that it is asked of (default: all).
    """
    roads = sum(settings.sets[name].sequences for name in settings.scored_on if name in settings.sets)
    s_seq, seeds = S_SEQ * math.sqrt(ROADS / max(roads, 1)), settings.seeds
    trained = [claim for claim in claims if claims.metrics[claim.metrics[0]].protocol]
    df = max(1, sum(_has_runs(pair, runs) for claim in trained for pair in claim.pairs) * (seeds - 1))
    estimates = []
    chosen = [claim for claim in trained if of is None or claim.id in of]
    for claim, pair in [(declared, pair) for declared in chosen for pair in declared.comparisons]:
        published, has_runs = pair.published(claim.metrics[0]), _has_runs(pair, runs)
        likely = None
        if published is not None and has_runs and seeds >= 2:
            likely = _power(published, s_seed=S_SEED, s_seq=s_seq, n=seeds, df=df, hypothesis=pair.hypothesis)
        estimates.append(PowerEstimate(claim=claim.id, power=likely, runs=has_runs))
    return tuple(estimates)


_power = lru_cache(maxsize=1024)(power)


def _has_runs(pair: Comparison, runs: Sequence[str]) -> bool:
    return pair.a.run in runs and pair.b.run in runs
