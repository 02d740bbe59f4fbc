"""Every claim of a paper in a row: the paper's figure, ours with its interval, the decision, its controls, the size.

Rows are made of grids as they were decided: of the folders that ``farfield reproduce`` finished (:func:`read_grid`), or
of what a results file kept of them (``tools/claims.py``). Of several sizes a row shows the largest that is finished,
and what the others said where they differ.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from farfield.errors import FileFormatError, plain
from farfield.files.json_text import read_json
from farfield.papers.claims import Claim, Claims, ClaimSide, Comparison
from farfield.papers.grid import ExperimentGrid
from farfield.papers.prospects import outlooks
from farfield.vocabulary.counts import count_of
from farfield.vocabulary.published_tables import OVERALL

Role = Literal["comparison", "control"]
SUMMARY, TIMING = "reproduction.json", "timing.json"
_MAX_BYTES = 1 << 26
SIZES = ("laptop", "desk", "workstation", "table2", "gpu")
"""Budgets by what a training costs: table2 has more frames than a workstation's, and a quarter of a GPU's widths."""
HOLDING = ("holds", "holds by construction")
_SIDE = tuple(ClaimSide.model_fields)[:-1]  # all but the paper's row
_RELATIONS = {"above": "over", "not_below": "not below", "equivalent": "as good as"}


# What was decided


class _Recorded(BaseModel):
    """A part of what a finished reproduction wrote; what rows do not need is passed over."""

    model_config = ConfigDict(extra="ignore", frozen=True)


class RecordedDifference(_Recorded):
    """A difference between two rows with its interval."""

    estimate: float | None = None
    interval: tuple[float, float] | None = None
    n: int = Field(0, ge=0, description="seeds")
    trained: bool = True

    def __str__(self) -> str:
        if self.estimate is None:
            return "no figure"
        return f"{self.estimate:.3f}" + (" [{:.3f}, {:.3f}]".format(*self.interval) if self.interval else "")


class RecordedDecision(_Recorded):
    """A difference and what it says."""

    verdict: Literal["holds", "holds not", "undecided", "no decision"]
    difference: RecordedDifference


class RecordedComparison(_Recorded):
    """A comparison or control of a claim in one metric; without a decision where a row was not run."""

    role: Role
    metric: str
    decision: RecordedDecision | None = None
    power: float | None = None


class RecordedClaim(_Recorded):
    """A claim as it was decided."""

    id: str
    verdict: Literal["holds", "holds by construction", "holds not", "undecided", "no decision", "not run"]
    decided: tuple[RecordedComparison, ...]


class _RecordedRuns(_Recorded):
    planned: int = Field(ge=0)
    done: int = Field(ge=0)


class _RecordedClock(_Recorded):
    processor_s: float = Field(ge=0)
    brought: bool = Field(False, description="whether the weights were there, and were only scored")


class RecordedJob(_Recorded):
    """A training and its scoring: the runs that it stands for, and what the clocks say."""

    runs: tuple[str, ...]
    clock: tuple[_RecordedClock, ...] = ()

    @property
    def core_minutes(self) -> float:
        """The processor's time."""
        return sum(clock.processor_s for clock in self.clock) / 60

    @property
    def brought(self) -> bool:
        """Whether it was only scored here."""
        return bool(self.clock) and all(clock.brought for clock in self.clock)


class RecordedGrid(_Recorded):
    """A paper's grid as it was decided with one budget."""

    paper: Literal["cirrus", "kradar"]
    budget: str
    simulated: bool
    seeds: int = Field(ge=1)
    steps: dict[str, int]
    runs: _RecordedRuns
    claims_sha256: str
    claims: tuple[RecordedClaim, ...]
    jobs: tuple[RecordedJob, ...] = ()
    core_minutes: float | None = Field(None, description="what all of it took")
    planned_minutes: bool = Field(False, description="whether that was planned: it was trained elsewhere")

    @property
    def size(self) -> tuple[bool, int]:
        """What orders grids: real data above simulated, then by budget."""
        return not self.simulated, SIZES.index(self.budget) if self.budget in SIZES else -1

    @cached_property
    def by_id(self) -> Mapping[str, RecordedClaim]:
        """The claims by name."""
        return {claim.id: claim for claim in self.claims}

    def is_finished(self, claim: Claim) -> bool:
        """Whether a claim's runs are all done, those of its comparisons with every seed.

        Args:
            claim: The claim.
        """
        deciding = _of(self.by_id[claim.id], "comparison", claim.metrics[0])
        seeds = [row.decision.difference for row in deciding if row.decision is not None]
        whole = len(seeds) == len(deciding) and all(not row.trained or row.n >= self.seeds for row in seeds)
        return whole or self.runs.done >= self.runs.planned


def _of(claim: RecordedClaim, role: Role, metric: str) -> list[RecordedComparison]:
    return [row for row in claim.decided if (row.role, row.metric) == (role, metric)]


def paper_of(folder: Path) -> str:
    """The paper that a reproduction is of.

    Args:
        folder: What ``farfield reproduce`` wrote.

    Raises:
        FileFormatError: If it holds anything else.
    """
    path = folder / SUMMARY
    paper: str = _validated(_OfPaper, read_json(path, max_bytes=_MAX_BYTES), path).paper
    return paper


def read_grid(folder: Path, claims: Claims) -> RecordedGrid:
    """What a reproduction decided, and what its runs took.

    Args:
        folder: What ``farfield reproduce`` wrote.
        claims: The paper's claims.

    Raises:
        FileFormatError: If its files hold anything else, or decide on claims that were declared otherwise.
    """
    path, clocks = folder / SUMMARY, folder / TIMING
    tree = read_json(path, max_bytes=_MAX_BYTES)
    timing = read_json(clocks, max_bytes=_MAX_BYTES) if clocks.is_file() else {}
    grid: RecordedGrid = _validated(RecordedGrid, tree, path)
    check_claims(grid, claims, path)
    timed: _Timing = _validated(_Timing, timing, clocks)
    jobs = tuple(timed.runs.values())
    brought = any(job.brought for job in jobs)
    minutes = timed.planned.core_minutes if brought else sum(job.core_minutes for job in jobs)
    changes = {"jobs": () if brought else jobs, "core_minutes": minutes or None, "planned_minutes": brought}
    return grid.model_copy(update=changes)


class _OfPaper(_Recorded):
    paper: Literal["cirrus", "kradar"]


class _TimingPlan(_Recorded):
    core_minutes: float = 0.0


class _Timing(_Recorded):
    planned: _TimingPlan = _TimingPlan()
    runs: dict[str, RecordedJob] = Field(default_factory=dict)


def _validated(model: type[Any], tree: Any, path: Path) -> Any:
    try:
        return model.model_validate(tree)
    except ValidationError as error:
        expected = "what farfield reproduce writes"
        raise FileFormatError(path, where="keys", expected=expected, got=plain(error)) from None


def check_claims(grid: RecordedGrid, claims: Claims, path: Path) -> None:
    """Refuse decisions on other claims than those that are declared now, or other comparisons of them.

    Args:
        grid: What was decided.
        claims: The claims; their hash may be cut short in the grid.
        path: Where it stands, for the message.

    Raises:
        FileFormatError: If they differ.
    """
    if not grid.claims_sha256 or not claims.sha256.startswith(grid.claims_sha256):
        expected = f"claims as they are declared now, {claims.sha256[:16]}; --page decides anew"
        raise FileFormatError(path, where="claims_sha256", expected=expected, got=grid.claims_sha256[:16])
    for claim in claims:
        declared = comparisons_of(claim)
        rows = [(row.role, row.metric) for row in grid.by_id[claim.id].decided] if claim.id in grid.by_id else []
        if rows != [(role, metric) for role, metric, _ in declared]:
            expected = count_of(len(declared), "comparison")
            raise FileFormatError(path, where=claim.id, expected=expected, got=f"{len(rows)}, or in another order")


def comparisons_of(claim: Claim) -> list[tuple[Role, str, Comparison]]:
    """All that is decided for a claim, in order: in each metric its comparisons, then its controls."""
    rows: list[tuple[Role, str, Comparison]] = []
    for metric in claim.metrics:
        rows += [("comparison", metric, pair) for pair in claim.comparisons]
        rows += [("control", metric, pair) for pair in claim.controls]
    return rows


# Rows


class BudgetProspect(NamedTuple):
    """A larger budget that would decide a claim, by the paper's differences."""

    budget: str
    likely: bool
    """Whether every comparison is decided with a power of 80 %; else of 30 % or more."""


@dataclass(frozen=True, kw_only=True)
class ClaimRow:
    """A claim, what decided it and what would; its properties are the cells of a table.

    Args:
        claim: The claim.
        grid: The largest finished grid that decided it; None if none did.
        others: Further grids that decided it, the largest first.
        needed: The trainings that it needs at that size: those that its rows start from, and its controls' too.
        steps: Steps of those trainings.
        claims: All claims of the paper.
        declared: The paper's grid.
    """

    claim: Claim
    claims: Claims
    declared: ExperimentGrid
    grid: RecordedGrid | None = None
    others: tuple[RecordedGrid, ...] = ()
    needed: frozenset[str] = frozenset()
    steps: tuple[int, ...] = ()

    @property
    def verdict(self) -> str:
        """What the largest size says of it; ``"not run"`` where none did."""
        return "not run" if self.grid is None else self.grid.by_id[self.claim.id].verdict

    @property
    def published(self) -> str:
        """The paper's differences in the first metric, by commas; a dash where it prints none."""
        figures = [pair.published(self.claim.metrics[0]) for pair in self.claim.comparisons]
        if all(figure is None for figure in figures):
            return "-"
        return ", ".join("-" if figure is None else f"{figure:.3f}" for figure in figures)

    def ours(self, grid: RecordedGrid | None = None) -> list[str]:
        """Our differences in the first metric, a text a comparison, with its verdict where it is not the claim's.

        Args:
            grid: One of the other grids (default: the largest).
        """
        grid = grid or self.grid
        if grid is None:
            return []
        recorded, texts = grid.by_id[self.claim.id], []
        rows = _of(recorded, "comparison", self.claim.metrics[0])
        for label, row in zip(labels_of(self.claim.comparisons), rows, strict=True):
            verdict = row.decision.verdict if row.decision else "not run"
            whole = "holds" if recorded.verdict in HOLDING else recorded.verdict
            words = [label, str(row.decision.difference) if row.decision else "", verdict if verdict != whole else ""]
            texts.append(" ".join(word for word in words if word))
        return texts

    def labelled(self, verdict: str) -> list[str]:
        """Which of several comparisons have a verdict, in the first metric of the largest size.

        Args:
            verdict: The verdict.
        """
        rows = [] if self.grid is None else _of(self.grid.by_id[self.claim.id], "comparison", self.claim.metrics[0])
        pairs = zip(labels_of(self.claim.comparisons), rows, strict=False)
        return [label for label, row in pairs if label and row.decision and row.decision.verdict == verdict]

    @property
    def decision(self) -> str:
        """The verdict; in which other metric it is another; and how likely this size was to tell, if it did not."""
        if self.grid is None:
            return self.verdict
        recorded, first = self.grid.by_id[self.claim.id], self.claim.metrics[0]
        words = self.verdict
        for metric in self.claim.metrics[1:]:
            rows = _of(recorded, "comparison", metric)
            verdicts = [row.decision.verdict if row.decision else "not run" for row in rows]
            other = self.claim.verdict(verdicts)
            name = self.claims.metrics[metric].words.partition(" ")[0]
            words += f"; {other} in {name}" if other != self.verdict else ""
        powers = [row.power for row in _of(recorded, "comparison", first) if row.power is not None]
        if self.verdict == "undecided" and powers:
            words += f"; power {', '.join(f'{power:.0%}'.replace('%', ' %') for power in powers)}"
        return words

    @property
    def controls(self) -> list[str]:
        """What each control stands against, its verdicts and figures in the first metric; a text an explanation."""
        if not self.claim.controls:
            return []
        rows: Sequence[RecordedComparison | None] = [None] * len(self.claim.controls)
        if self.grid is not None:
            rows = _of(self.grid.by_id[self.claim.id], "control", self.claim.metrics[0])
        groups: dict[str, list[str]] = {}
        for pair, row in zip(self.claim.controls, rows, strict=True):
            decision = row.decision if row else None
            text = f"{decision.verdict} {decision.difference}" if decision else "not run"
            groups.setdefault(pair.excludes, []).append(text)
        return [f"{excludes}: {', '.join(dict.fromkeys(texts))}" for excludes, texts in groups.items()]

    @property
    def size(self) -> str:
        """The size that decided it: budget, steps, seeds."""
        if self.grid is None:
            return "-"
        where = f"{self.grid.budget}{'' if self.grid.simulated else ', real data'}"
        if not self.needed:
            return f"{where}: no training"
        span = " to ".join(f"{count:,}" for count in dict.fromkeys(self.steps[:1] + self.steps[-1:]))
        rows = _of(self.grid.by_id[self.claim.id], "comparison", self.claim.metrics[0])
        seeds = min((row.decision.difference.n for row in rows if row.decision), default=0)
        fewer = "" if seeds >= self.grid.seeds else f"{seeds} of "
        return f"{where}: {span} steps, {fewer}{count_of(self.grid.seeds, 'seed')}"

    @property
    def again(self) -> str:
        """What it takes to run it again: its trainings of the grid's, and core minutes."""
        if self.grid is None:
            return "-"
        whole = "" if self.grid.core_minutes is None else f"{self.grid.core_minutes:,.0f}"
        if not self.needed:
            return "frames alone"
        if self.grid.jobs:
            own = [job for job in self.grid.jobs if self.needed & set(job.runs)]
            return f"{sum(job.core_minutes for job in own):,.0f} of {whole} core min, {count_of(len(own), 'training')}"
        trainings = f"{len(self.needed) * self.grid.seeds} of {count_of(self.grid.runs.planned, 'training')}"
        planned = " planned" if self.grid.planned_minutes else ""
        return f"{trainings}; all {whole} core min{planned}" if whole else trainings

    @property
    def elsewhere(self) -> list[tuple[str, str]]:
        """Budgets that decided it otherwise, and what they said."""
        rows = [(grid.budget, grid.by_id[self.claim.id].verdict) for grid in self.others]
        return [(budget, verdict) for budget, verdict in rows if verdict != self.verdict]

    def would_decide(self, core_minutes: Mapping[str, float] | None = None) -> str:
        """What would decide it, in words; empty where it is held or refuted.

        Args:
            core_minutes: What the paper's budgets cost as planned, where that is known.
        """
        if self.verdict in (*HOLDING, "holds not"):
            return ""
        if all(pair.published(self.claim.metrics[0]) is None for pair in self.claim.comparisons):
            return "the paper prints no difference to plan by"
        prospect = self._prospect()
        if prospect is None:
            return "no larger budget: too small a difference for its seeds"
        minutes = (core_minutes or {}).get(prospect.budget)
        cost = "--plan says what it costs" if minutes is None else f"{minutes / 60:,.0f} core hours"
        return f"{'' if prospect.likely else 'perhaps '}budget {prospect.budget} ({cost})"

    @property
    def larger(self) -> list[str]:
        """Larger budgets that have the runs of its comparisons, the smallest first."""
        after = -1 if self.grid is None else self.grid.size[1]
        runs = {side.run for pair in self.claim.comparisons for side in (pair.a, pair.b) if side.run}
        budgets = [name for name in SIZES[after + 1 :] if name in self.declared.budgets]
        return [name for name in budgets if runs <= set(self.declared.runs_of(name))]

    def _prospect(self) -> BudgetProspect | None:
        """The smallest larger budget that decides the claim; else the smallest that perhaps does."""
        perhaps = None
        for budget in self.larger:
            runs, settings = tuple(self.declared.runs_of(budget)), self.declared.budgets[budget]
            estimates = outlooks(self.claims, runs, settings, of=(self.claim.id,))
            planned = {one.words for one in estimates if one.power is not None}
            if planned == {"yes"}:
                return BudgetProspect(budget, likely=True)
            if perhaps is None and planned and planned <= {"yes", "perhaps"}:
                perhaps = BudgetProspect(budget, likely=False)
        return perhaps


def claim_rows(claims: Claims, grid: ExperimentGrid, decided: Iterable[RecordedGrid]) -> list[ClaimRow]:
    """A row for every claim of a paper, also for those that no grid decided.

    Args:
        claims: The paper's claims.
        grid: Its declared grid.
        decided: Grids that were decided; those of other papers are passed over.
    """
    own = [one for one in decided if one.paper == claims.paper]
    return [_row(claim, claims, grid, own) for claim in claims]


def _row(claim: Claim, claims: Claims, grid: ExperimentGrid, decided: Iterable[RecordedGrid]) -> ClaimRow:
    """The largest finished grid that decided a claim, and what the claim needs of it."""
    ran = [one for one in decided if one.by_id[claim.id].verdict != "not run"]
    ran.sort(key=partial(_rank, claim), reverse=True)
    row = ClaimRow(claim=claim, claims=claims, declared=grid)
    if not ran:
        return row
    names = grid.runs_of(ran[0].budget) if ran[0].budget in grid.budgets else grid.runs
    own = {name for name in claim.runs if name in names}
    needed = frozenset(own | {names[name].start for name in own if names[name].start})
    steps = {ran[0].steps[names[name].network] for name in needed if names[name].network in ran[0].steps}
    return replace(row, grid=ran[0], others=tuple(ran[1:]), needed=needed, steps=tuple(sorted(steps)))


def _rank(claim: Claim, grid: RecordedGrid) -> tuple[bool, bool, int]:
    """What orders the grids that decided a claim: finished ones, of them the largest."""
    return (grid.is_finished(claim), *grid.size)


# Words


def labels_of(pairs: Sequence[Comparison]) -> list[str]:
    """What tells the comparisons of a claim apart, in a few words each; nothing where there is one alone.

    Args:
        pairs: The comparisons.
    """
    if len(pairs) == 1:
        return [""]
    shared = [name for name in _SIDE if all(getattr(pair.a, name) == getattr(pair.b, name) for pair in pairs)]
    shared = [name for name in shared if _varies(name, pairs) and (name != "minus" or "part" in shared)]
    labels = [_side_words(pair.a, shared) for pair in pairs]
    if len(set(labels)) == len(pairs) and all(labels):
        return labels
    varying = [name for name in _SIDE if _varies(name, pairs)]
    labels = []
    for pair in pairs:
        apart = [name for name in varying if getattr(pair.a, name) != getattr(pair.b, name)]
        sides = [_side_words(pair.a, varying), _side_words(pair.b, apart)]
        labels.append(f" {_RELATIONS[pair.kind]} ".join(words for words in sides if words))
    return labels


def _varies(name: str, pairs: Sequence[Comparison]) -> bool:
    return len({getattr(side, name) for pair in pairs for side in (pair.a, pair.b)}) > 1


def _side_words(side: ClaimSide, names: Sequence[str]) -> str:
    words = {
        "run": side.run.replace("_", " "),
        "cloud": f"on {side.cloud}" if side.cloud and not ("run" in names and side.cloud == side.run) else "",
        "part": OVERALL if side.part == OVERALL else side.part.removeprefix("weather/").replace("_", " "),
        "minus": f"minus {side.minus.removeprefix('weather/').replace('_', ' ')}" if side.minus else "",
        "metric": side.metric.replace("_", " "),
        "matched": "matched" if side.matched else "",
    }
    return " ".join(words[name] for name in names if words[name])


def counts_of(rows: Sequence[ClaimRow]) -> str:
    """How many claims hold, hold not, and are neither, in a sentence."""
    verdicts = [row.verdict for row in rows]
    holding, refuted = sum(verdict in HOLDING for verdict in verdicts), verdicts.count("holds not")
    undecided = verdicts.count("undecided") + verdicts.count("no decision")
    return (
        f"Of {count_of(len(rows), 'claim')} {holding} hold, {refuted} hold not, {undecided} are undecided and "
        f"{verdicts.count('not run')} were not run."
    )
