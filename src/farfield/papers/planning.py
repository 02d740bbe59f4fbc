"""What a grid will cost on this machine, and which of its claims it can decide, before anything is run."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from farfield.errors import ConfigError
from farfield.metrics.deciding import power
from farfield.papers.claims import Claim, Claims, Comparison
from farfield.papers.grid import BudgetSettings
from farfield.papers.jobs import TrainingJob
from farfield.papers.measuring import RunRate

S_SEED, S_SEQ, ROADS = 0.015, 0.008, 12
"""Spread of paired differences over seeds, and over draws of so many roads, met at small size: what power rests on."""
LIKELY, POSSIBLE = 0.8, 0.3
"""Power from which a claim can be decided, and from which it perhaps can."""
SCORING_S = 12.0
"""Core seconds that scoring a run on a cloud takes besides detecting, with its draws."""
PAGE_S = 60.0
RESERVE = 0.08
"""Share of the minutes asked for that a plan leaves where the fewest steps let it: paces are known to a few percent,
checkpoints take their time, and a command that is killed loses the steps since the last one."""
_SHARES = tuple(share / 100 for share in range(100, 0, -1))


@dataclass(frozen=True, kw_only=True)
class GridCost:
    """Core minutes of a grid, by what they go into.

    Args:
        simulating: Frames that are not there yet, those that only the page shows among them.
        training: Steps, and what comes before the first.
        scoring: Detecting in the frames that are scored, figures with their draws, the page.
    """

    simulating: float
    training: float
    scoring: float

    @property
    def core_minutes(self) -> float:
        """All of it."""
        return self.simulating + self.training + self.scoring


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


@dataclass(frozen=True, kw_only=True)
class GridPlan:
    """The plan of a grid.

    Args:
        budget: Name of the budget.
        steps_share: Share of the declared steps that is taken.
        steps: Steps by network.
        jobs: Number of trainings.
        rows: Number of runs a seed.
        seeds: Number of seeds.
        cost: What it costs.
        workers: Processes.
        outlooks: Which claims can be decided, one a comparison.
        paces: What was measured, by kind of job.
        simulating_s: What was measured, core seconds a frame by set.
    """

    budget: str
    steps_share: float
    steps: Mapping[str, int]
    jobs: int
    rows: int
    seeds: int
    cost: GridCost
    workers: int
    outlooks: tuple[PowerEstimate, ...] = ()
    paces: Mapping[str, RunRate] = field(default_factory=dict)
    simulating_s: Mapping[str, float] = field(default_factory=dict)

    @property
    def minutes(self) -> float:
        """Minutes on so many workers, each with a core of its own."""
        return self.cost.core_minutes / self.workers

    def to_json(self) -> dict[str, Any]:
        """All of it as JSON values."""
        return {**asdict(self), "core_minutes": self.cost.core_minutes, "minutes": self.minutes}


def paces_of(kept: Mapping[str, Any]) -> dict[str, RunRate]:
    """The paces of an outline that was kept as JSON."""
    return {kind: RunRate(**pace) for kind, pace in kept["paces"].items()}


def cost_of(
    jobs: Sequence[TrainingJob],
    steps_share: float,
    settings: BudgetSettings,
    paces: Mapping[str, RunRate],
    simulating_s: Mapping[str, float],
    frames_scored: int,
    *,
    beside_s: float = 0.0,
) -> GridCost:
    """Core minutes of jobs with a share of the budget's steps.

    Args:
        jobs: The jobs.
        steps_share: Share of the declared steps.
        settings: The budget.
        paces: The pace of each kind of job.
        simulating_s: Core seconds a frame of each set that is to be simulated.
        frames_scored: Number of frames on which each job is scored.
        beside_s: Core seconds that simulating takes besides: frames that the page alone shows.
    """
    lowered = settings.lowered(steps_share)
    training = sum(paces[job.kind].begin_s + lowered.steps_for(job.network) * paces[job.kind].step_s for job in jobs)
    scoring = sum(len(job.clouds) * (frames_scored * paces[job.kind].frame_s + SCORING_S) for job in jobs)
    sets = settings.sets
    simulating = beside_s + sum(
        seconds * sets[name].sequences * sets[name].frames for name, seconds in simulating_s.items()
    )
    return GridCost(simulating=simulating / 60, training=training / 60, scoring=(scoring + PAGE_S) / 60)


def fitted(
    jobs: Sequence[TrainingJob],
    settings: BudgetSettings,
    paces: Mapping[str, RunRate],
    simulating_s: Mapping[str, float],
    frames_scored: int,
    core_minutes: float | None,
    *,
    beside_s: float = 0.0,
) -> tuple[float, GridCost]:
    """The largest share of the declared steps whose cost fits with a reserve, or the least, and that cost.

    Seeds and rows are never fewer.

    Args:
        jobs: As of :func:`cost_of`, and so the next four.
        settings: The budget.
        paces: The pace of each kind of job.
        simulating_s: Core seconds a frame.
        frames_scored: Number of frames.
        core_minutes: What it is to take at most; None for no limit.
        beside_s: As of :func:`cost_of`.

    Raises:
        ConfigError: If it does not fit with the fewest steps either.
    """
    cost = GridCost(simulating=0.0, training=0.0, scoring=0.0)
    for share in _SHARES:
        cost = cost_of(jobs, share, settings, paces, simulating_s, frames_scored, beside_s=beside_s)
        least = settings.lowered(share) == settings.lowered(_SHARES[-1])
        if core_minutes is None or cost.core_minutes <= core_minutes * (1.0 if least else 1.0 - RESERVE):
            return share, cost
        if least:
            break
    parts = f"simulating {cost.simulating:.0f}, training {cost.training:.0f}, scoring {cost.scoring:.0f}"
    raise ConfigError(
        f"minutes: expected at least {cost.core_minutes:.0f} core minutes, which {len(jobs)} runs take on this machine "
        f"with the fewest steps, {settings.least_steps} ({parts}); got {core_minutes:.0f}. Runs with fewer steps say "
        "nothing of a method. Give more --minutes, more --workers or another --budget."
    )


def outlooks(claims: Claims, runs: Sequence[str], settings: BudgetSettings) -> tuple[PowerEstimate, ...]:
    """Which claims can be decided by runs of this number of seeds and roads, by the published differences."""
    roads = sum(settings.sets[name].sequences for name in settings.scored_on if name in settings.sets)
    trained = [claim for claim in claims if claims.metrics[claim.metrics[0]].protocol]
    pairs = [pair for claim in trained for pair in (*claim.comparisons, *claim.controls) if _has(pair, runs)]
    df = max(1, len(pairs) * (settings.seeds - 1))
    return tuple(
        _outlook(claim, pair, runs, settings.seeds, df, roads) for claim in trained for pair in claim.comparisons
    )


def _outlook(claim: Claim, pair: Comparison, runs: Sequence[str], seeds: int, df: int, roads: int) -> PowerEstimate:
    published = pair.published(claim.metrics[0])
    if published is None or not _has(pair, runs) or seeds < 2:
        return PowerEstimate(claim=claim.id, power=None, runs=_has(pair, runs))
    s_seq = S_SEQ * math.sqrt(ROADS / max(roads, 1))
    likely = power(published, s_seed=S_SEED, s_seq=s_seq, n=seeds, df=df, hypothesis=pair.hypothesis)
    return PowerEstimate(claim=claim.id, power=likely)


def _has(pair: Comparison, runs: Sequence[str]) -> bool:
    return all(row.run in runs for row in (pair.a, pair.b))


def outline_of(kept: Mapping[str, Any]) -> GridPlan:
    """Read an outline that was kept as JSON."""
    return GridPlan(
        budget=kept["budget"],
        steps_share=kept["steps_share"],
        steps=kept["steps"],
        jobs=kept["jobs"],
        rows=kept["rows"],
        seeds=kept["seeds"],
        cost=GridCost(**kept["cost"]),
        workers=kept["workers"],
        outlooks=tuple(PowerEstimate(**each) for each in kept["outlooks"]),
        paces=paces_of(kept),
        simulating_s=kept["simulating_s"],
    )


def described(outline: GridPlan) -> list[str]:
    """A plan in lines: runs, steps, minutes, and which claims can be decided."""
    cost = outline.cost
    steps = ", ".join(f"{network} {steps}" for network, steps in outline.steps.items())
    lowered = f" ({outline.steps_share:.0%} of those declared)" if outline.steps_share < 1 else ""
    lines = [
        f"budget {outline.budget}: {outline.rows} runs x {outline.seeds} seeds, {outline.jobs} trainings; "
        f"steps: {steps}{lowered}",
        f"cost on this machine: {cost.core_minutes:.0f} core minutes (simulating {cost.simulating:.0f}, training "
        f"{cost.training:.0f}, scoring {cost.scoring:.0f}) = {outline.minutes:.0f} minutes with {outline.workers} "
        f"worker{'' if outline.workers == 1 else 's'}",
    ]
    by_claim: dict[str, list[str]] = {}
    for each in outline.outlooks:
        by_claim.setdefault(each.claim, []).append(each.words)
    lines += ["can be decided, if the paper's differences are true:"]
    lines += [f"  {claim}: {', '.join(words)}" for claim, words in by_claim.items()]
    return lines
