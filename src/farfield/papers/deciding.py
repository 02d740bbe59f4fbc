"""The decision on every claim of a grid: differences paired by seed, pooled spreads, verdicts, Holm's column, power."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from farfield.metrics.deciding import (
    Decision,
    Difference,
    ScoreSample,
    Spread,
    decide,
    difference_of,
    holm,
    pooled,
    power,
)
from farfield.papers.claims import Claim, Claims, ClaimSide, Comparison
from farfield.papers.grid import BudgetSettings, ExperimentGrid, Tree
from farfield.papers.needs import need_of
from farfield.papers.scoring import sample_of
from farfield.papers.statistics import AnnotatedObjects, compared

Role = Literal["comparison", "control"]


@dataclass(frozen=True, kw_only=True)
class Scores:
    """The scores of all finished runs, by run and seed.

    Args:
        by_run: The JSON of each run's scores.
    """

    by_run: Mapping[str, Mapping[int, Tree]]

    @classmethod
    def of(cls, found: Iterable[Tree]) -> "Scores":
        """Sort the scores of jobs."""
        by_run: dict[str, dict[int, Tree]] = defaultdict(dict)
        for scores in found:
            for run in scores["runs"] if not scores.get("failed") else ():
                by_run[run][int(scores["seed"])] = scores
        return cls(by_run={run: dict(sorted(seeds.items())) for run, seeds in by_run.items()})

    def samples(self, run: str, cloud: str, name: str) -> dict[int, ScoreSample]:
        """A number of a run, by seed."""
        found = {}
        for seed, scores in self.by_run.get(run, {}).items():
            kept = scores["clouds"].get(cloud, {}).get("samples", {}).get(name)
            if kept is not None:
                found[seed] = sample_of(kept)
        return found


@dataclass(frozen=True, kw_only=True)
class DecidedComparison:
    """A comparison of a claim, in one metric, and what became of it.

    Args:
        claim: The claim.
        pair: The two rows.
        role: Whether the claim rests on it, or it is a control beside.
        metric: The metric; the claim's first one decides.
        seeds: Seeds that both rows have.
        decision: The decision; None where a row was not run.
        adjusted: The same after Holm's correction over all comparisons of the report.
        power: Probability of "holds" were the published difference the truth; None where that is not known.
        pool: What its spread was pooled with.
    """

    claim: Claim
    pair: Comparison
    role: Role
    metric: str
    seeds: tuple[int, ...] = ()
    decision: Decision | None = None
    adjusted: Decision | None = None
    power: float | None = None
    pool: str = ""

    @property
    def first(self) -> bool:
        """Whether its metric is the claim's first, which decides."""
        return self.metric == self.claim.metrics[0]


@dataclass
class _MeasuredDifference:
    """A comparison whose difference is known, before it is decided."""

    claim: Claim
    pair: Comparison
    role: Role
    metric: str
    seeds: tuple[int, ...] = ()
    difference: Difference | None = None
    pool: str = ""
    empty: bool = False  # no row found anything: equal zeros are no agreement

    def decision(self, spread: Spread | None) -> Decision | None:
        if self.difference is None:
            return None
        if self.empty:
            hypothesis = self.pair.hypothesis
            return Decision(
                verdict="no decision", difference=self.difference, hypothesis=hypothesis, reason="nothing found"
            )
        return decide(self.difference.with_pooled(spread), self.pair.hypothesis)


@dataclass(frozen=True, kw_only=True)
class DecisionRule:
    """What decisions rest on.

    Args:
        claims: The claims.
        grid: The grid.
        settings: The budget.
        scores: The scores of finished runs.
        objects: The annotated objects; None without claims on the data.
    """

    claims: Claims
    grid: ExperimentGrid
    settings: BudgetSettings
    scores: Scores
    objects: AnnotatedObjects | None = None
    cached: dict[str, dict[int, ScoreSample]] = field(default_factory=dict)

    def decided(self) -> list[DecidedComparison]:
        """All comparisons and controls of all claims in all their metrics, in the claims' order."""
        found = [self._found(*each) for each in self._all()]
        pools = {each.pool for each in found if each.pool}
        spreads = {pool: pooled(_differences(found, pool)) for pool in pools}
        decisions = [each.decision(spreads.get(each.pool)) for each in found]
        adjusted = self._adjusted(found, decisions)
        return [
            DecidedComparison(
                claim=each.claim,
                pair=each.pair,
                role=each.role,
                metric=each.metric,
                seeds=each.seeds,
                decision=decision,
                adjusted=corrected,
                power=_power(each, decision),
                pool=each.pool,
            )
            for each, decision, corrected in zip(found, decisions, adjusted, strict=True)
        ]

    def _all(self) -> Iterable[tuple[Claim, Comparison, Role, str]]:
        for claim in self.claims:
            for metric in claim.metrics:
                yield from ((claim, pair, "comparison", metric) for pair in claim.comparisons)
                yield from ((claim, pair, "control", metric) for pair in claim.controls)

    @staticmethod
    def _adjusted(found: Sequence[_MeasuredDifference], decisions: Sequence[Decision | None]) -> list[Decision | None]:
        """Holm's correction over the comparisons that decide claims: first metrics, no controls."""
        places = [
            place
            for place, (each, decision) in enumerate(zip(found, decisions, strict=True))
            if decision is not None and each.role == "comparison" and each.metric == each.claim.metrics[0]
        ]
        corrected = holm([decision for place in places if (decision := decisions[place]) is not None])
        result: list[Decision | None] = [None] * len(found)
        for place, decision in zip(places, corrected, strict=True):
            result[place] = decision
        return result

    def _found(self, claim: Claim, pair: Comparison, role: Role, metric: str) -> _MeasuredDifference:
        found = _MeasuredDifference(claim, pair, role, metric)
        statistic = self.claims.metrics[metric].statistic
        if statistic:
            if self.objects is not None:
                found.difference = compared(pair, statistic, self.objects, replicates=self.settings.replicates)
            return found
        a, b = (self._samples(row, claim, metric) for row in (pair.a, pair.b))
        found.seeds = tuple(sorted(a.keys() & b.keys()))
        if found.seeds:
            found.difference = difference_of([a[seed] for seed in found.seeds], [b[seed] for seed in found.seeds])
            found.pool = f"{metric}, {self._network(pair)}"
            found.empty = all(row[seed].value == 0 for row in (a, b) for seed in found.seeds)
        elif self.scores.by_run.get(pair.a.run) and self.scores.by_run.get(pair.b.run):
            found.difference = Difference(by_seed=(), s_seq=None, groups=0)  # run, but without such a figure
        return found

    def _samples(self, row: ClaimSide, claim: Claim, metric: str) -> dict[int, ScoreSample]:
        if row.run not in self.grid.runs:
            return {}
        need = need_of(row, claim, metric, self.claims, self.grid, self.settings.score)
        name = f"{need.run} {need.cloud} {need.name}"
        if name not in self.cached:
            self.cached[name] = self.scores.samples(need.run, need.cloud, need.name)
        return self.cached[name]

    def _network(self, pair: Comparison) -> str:
        """The networks of a pair: spreads are pooled over pairs of one size."""
        return " and ".join(sorted({self.grid.runs[row.run].network for row in (pair.a, pair.b)}))


def _differences(found: Sequence[_MeasuredDifference], pool: str) -> list[Difference]:
    """Differences of a pool; those of rows that found nothing do not scatter and do not count."""
    return [each.difference for each in found if each.pool == pool and each.difference is not None and not each.empty]


def _power(found: _MeasuredDifference, decision: Decision | None) -> float | None:
    """Power of a decision for the published difference, with the spreads that were found."""
    published = found.pair.published(found.metric)
    if decision is None or published is None:
        return None
    difference = decision.difference
    spread = difference.spread
    if spread is None or difference.s_seq is None or difference.n < 2:
        return None
    return power(
        published,
        s_seed=spread.s,
        s_seq=difference.s_seq,
        n=difference.n,
        df=spread.df,
        hypothesis=found.pair.hypothesis,
    )


def verdict_of(claim: Claim, decided: Sequence[DecidedComparison]) -> str:
    """The verdict on a claim: it holds where all its comparisons do, and holds not where one does not.

    Args:
        claim: The claim.
        decided: Its comparisons in its first metric, controls left out.
    """
    words = [each.decision.verdict if each.decision is not None else "not run" for each in decided]
    if not words or all(word in ("not run", "no decision") for word in words):
        return "not run" if "not run" in words or not words else "no decision"
    if "holds not" in words:
        return "holds not"
    if all(word == "holds" for word in words):
        return "holds by construction" if claim.by_construction else "holds"
    return "undecided"


def to_json(each: DecidedComparison) -> dict[str, Any]:
    """A decided comparison as JSON values."""
    return {
        "claim": each.claim.id,
        "role": each.role,
        "metric": each.metric,
        "a": each.pair.a.model_dump(mode="json"),
        "b": each.pair.b.model_dump(mode="json"),
        "kind": each.pair.kind,
        "margin": each.pair.margin,
        "excludes": each.pair.excludes,
        "published": each.pair.published(each.metric),
        "seeds": list(each.seeds),
        "pooled_with": each.pool,
        "decision": None if each.decision is None else each.decision.to_json(),
        "adjusted": None if each.adjusted is None else {"verdict": each.adjusted.verdict, "p": each.adjusted.p},
        "power": each.power,
    }
