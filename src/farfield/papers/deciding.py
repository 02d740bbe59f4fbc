"""The decision on every comparison of a grid: differences paired by seed, pooled spreads, verdicts, Holm, power.

:func:`decide_all` is the rule, the same for the papers' grids and the table of transfer; :class:`DecisionRule` takes
the differences of a paper's claims from what its runs scored.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from farfield.metrics.deciding import (
    Decision,
    Difference,
    Hypothesis,
    ScoreSample,
    decide,
    difference_of,
    holm,
    pooled,
    power,
)
from farfield.papers.claims import Claim, Claims, ClaimSide, Comparison
from farfield.papers.grid import BudgetSettings, ExperimentGrid, Tree
from farfield.papers.scoring import need_of, sample_of
from farfield.papers.statistics import AnnotatedObjects, statistic_difference

Role = Literal["comparison", "control"]


@dataclass(frozen=True, kw_only=True)
class RowDifference:
    """The difference between two rows, before it is decided.

    Args:
        difference: The difference; None where a row was not run.
        seeds: Seeds that both rows have.
        hypothesis: What is claimed of it.
        pool: Differences of one pool have one spread over seeds; empty for a difference without seeds.
        all_zero: Whether both rows score 0 with all seeds: equal zeros are no agreement.
        corrected: Whether it takes part in Holm's correction.
    """

    difference: Difference | None = None
    seeds: tuple[int, ...] = ()
    hypothesis: Hypothesis = field(default_factory=Hypothesis)
    pool: str = ""
    all_zero: bool = False
    corrected: bool = True


def row_difference(
    a: Mapping[int, ScoreSample], b: Mapping[int, ScoreSample], *, pool: str, **options: Any
) -> RowDifference:
    """The difference of two rows over the seeds that both have.

    Args:
        a: A number of the first row, by seed.
        b: The same of the second.
        pool: As of :class:`RowDifference`, and so the other options.
        options: Its further fields.
    """
    seeds = tuple(sorted(a.keys() & b.keys()))
    if not seeds:
        return RowDifference(**options)
    difference = difference_of([a[seed] for seed in seeds], [b[seed] for seed in seeds])
    return RowDifference(difference=difference, seeds=seeds, pool=pool, **options)


def decide_all(rows: Sequence[RowDifference]) -> list[tuple[Decision | None, Decision | None]]:
    """Decide on differences by intervals of 95 %.

    The variance of a difference is s_seed^2 / n + s_seq^2 (:mod:`farfield.metrics.deciding`), s_seed pooled over all
    differences of its pool. Holm, "A simple sequentially rejective multiple test procedure", 1979.

    Args:
        rows: The differences of a report.

    Returns:
        For each the decision, and the same after Holm's correction; None where a row was not run or is not corrected.
    """
    # the spread over seeds of each pool; rows that score nothing do not scatter and do not count
    pools: dict[str, list[Difference]] = defaultdict(list)
    for row in rows:
        if row.pool and row.difference is not None and not row.all_zero:
            pools[row.pool].append(row.difference)
    spreads = {pool: pooled(differences) for pool, differences in pools.items()}
    # each interval against what is claimed
    decisions: list[Decision | None] = []
    for row in rows:
        if row.difference is None:
            decisions.append(None)
        elif row.all_zero:
            nothing = Decision(
                verdict="no decision", difference=row.difference, hypothesis=row.hypothesis, reason="nothing found"
            )
            decisions.append(nothing)
        else:
            decisions.append(decide(row.difference.with_pooled(spreads.get(row.pool)), row.hypothesis))
    # Holm's correction over those that decide
    tested = {index: decision for index, decision in enumerate(decisions) if decision and rows[index].corrected}
    adjusted = dict(zip(tested, holm(list(tested.values())), strict=True))
    return [(decision, adjusted.get(index)) for index, decision in enumerate(decisions)]


@dataclass(frozen=True, kw_only=True)
class Scores:
    """The scores of all finished runs, by run and seed.

    Args:
        by_run: The JSON of each run's scores.
    """

    by_run: Mapping[str, Mapping[int, Tree]]

    @classmethod
    def of(cls, trees: Iterable[Tree]) -> "Scores":
        """Sort the scores of jobs; those that diverged have none."""
        by_run: dict[str, dict[int, Tree]] = defaultdict(dict)
        for scores in trees:
            for run in scores["runs"] if not scores.get("failed") else ():
                by_run[run][int(scores["seed"])] = scores
        return cls(by_run={run: dict(sorted(seeds.items())) for run, seeds in by_run.items()})

    def samples(self, run: str, cloud: str, name: str) -> dict[int, ScoreSample]:
        """A number of a run, by seed."""
        trees = {
            seed: scores["clouds"].get(cloud, {}).get("samples", {}).get(name)
            for seed, scores in self.by_run.get(run, {}).items()
        }
        return {seed: sample_of(tree) for seed, tree in trees.items() if tree is not None}


@dataclass(frozen=True, kw_only=True)
class DecidedComparison:
    """A comparison of a claim, in one metric, and its decision.

    Args:
        claim: The claim.
        pair: The two rows.
        role: Whether the claim rests on it, or it is a control beside.
        metric: The metric; the claim's first one decides.
        seeds: Seeds that both rows have.
        decision: The decision; None where a row was not run.
        adjusted: The same after Holm's correction over all comparisons of the report.
        power: Probability of "holds" were the published difference the truth; None where it cannot be computed.
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

    def to_json(self) -> dict[str, Any]:
        """All of it as JSON values."""
        return {
            "claim": self.claim.id,
            "role": self.role,
            "metric": self.metric,
            "a": self.pair.a.model_dump(mode="json"),
            "b": self.pair.b.model_dump(mode="json"),
            "kind": self.pair.kind,
            "margin": self.pair.margin,
            "excludes": self.pair.excludes,
            "published": self.pair.published(self.metric),
            "seeds": list(self.seeds),
            "pooled_with": self.pool,
            "decision": None if self.decision is None else self.decision.to_json(),
            "adjusted": None if self.adjusted is None else {"verdict": self.adjusted.verdict, "p": self.adjusted.p},
            "power": self.power,
        }


@dataclass(frozen=True, kw_only=True)
class DecisionRule:
    """What decisions on a paper's claims rest on.

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

    def decide(self) -> list[DecidedComparison]:
        """All comparisons and controls of all claims in all their metrics, in the claims' order."""
        comparisons = list(self._comparisons())
        rows = [self._difference(*comparison) for comparison in comparisons]
        return [
            DecidedComparison(
                claim=claim,
                pair=pair,
                role=role,
                metric=metric,
                seeds=row.seeds,
                decision=decision,
                adjusted=adjusted,
                power=_power(pair.published(metric), decision),
                pool=row.pool,
            )
            for (claim, pair, role, metric), row, (decision, adjusted) in zip(
                comparisons, rows, decide_all(rows), strict=True
            )
        ]

    def _comparisons(self) -> Iterator[tuple[Claim, Comparison, Role, str]]:
        for claim in self.claims:
            for metric in claim.metrics:
                yield from ((claim, pair, "comparison", metric) for pair in claim.comparisons)
                yield from ((claim, pair, "control", metric) for pair in claim.controls)

    def _difference(self, claim: Claim, pair: Comparison, role: Role, metric: str) -> RowDifference:
        """The difference of two rows; Holm's correction is over first metrics, no controls."""
        corrected = role == "comparison" and metric == claim.metrics[0]
        options: dict[str, Any] = {"hypothesis": pair.hypothesis, "corrected": corrected}
        statistic = self.claims.metrics[metric].statistic
        if statistic:
            if self.objects is None:
                return RowDifference(**options)
            difference = statistic_difference(pair, statistic, self.objects, replicates=self.settings.replicates)
            return RowDifference(difference=difference, **options)
        a, b = (self._samples(row, claim, metric) for row in (pair.a, pair.b))
        if a.keys() & b.keys():
            networks = sorted({self.grid.runs[row.run].network for row in (pair.a, pair.b)})
            all_zero = all(row[seed].value == 0 for row in (a, b) for seed in a.keys() & b.keys())
            # spreads are pooled over pairs of one size of network
            return row_difference(a, b, pool=f"{metric}, {' and '.join(networks)}", all_zero=all_zero, **options)
        if self.scores.by_run.get(pair.a.run) and self.scores.by_run.get(pair.b.run):
            no_figure = Difference(by_seed=(), s_seq=None, groups=0)  # run, but without such a figure
            return RowDifference(difference=no_figure, **options)
        return RowDifference(**options)

    def _samples(self, row: ClaimSide, claim: Claim, metric: str) -> dict[int, ScoreSample]:
        if row.run not in self.grid.runs:
            return {}
        need = need_of(row, claim, metric, self.claims, self.grid, self.settings.score)
        name = f"{need.run} {need.cloud} {need.name}"
        if name not in self.cached:
            self.cached[name] = self.scores.samples(need.run, need.cloud, need.name)
        return self.cached[name]


def _power(published: float | None, decision: Decision | None) -> float | None:
    """Power of a decision for the published difference, with the measured spreads."""
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
        hypothesis=decision.hypothesis,
    )


def verdict_of(claim: Claim, comparisons: Sequence[DecidedComparison]) -> str:
    """The verdict on a claim: it holds where all its comparisons do, and fails where one fails.

    Args:
        claim: The claim.
        comparisons: Its comparisons in its first metric, controls left out.
    """
    verdicts = [row.decision.verdict if row.decision is not None else "not run" for row in comparisons]
    return claim.verdict(verdicts)
