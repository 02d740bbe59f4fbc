"""The table of transfer from what its runs scored: means by row and share, and a decision on every comparison."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from farfield.frame.provenance import environment
from farfield.metrics.deciding import Decision, ScoreSample
from farfield.papers.deciding import decide_all, row_difference
from farfield.papers.scoring import sample_of
from farfield.papers.transfer.table import TransferComparison, TransferTable
from farfield.vocabulary.counts import count_of

RowSamples = Mapping[tuple[str, float], Mapping[int, ScoreSample]]
"""Samples by row and share, and within by seed."""


@dataclass(frozen=True, kw_only=True)
class ShareComparison:
    """A comparison at one share.

    Args:
        comparison: The two rows.
        share: Share of the target's frames.
        frames: How many they are.
        decision: The decision.
        adjusted: The same after Holm's correction over all cells.
    """

    comparison: TransferComparison
    share: float
    frames: int
    decision: Decision
    adjusted: Decision

    def to_json(self) -> dict[str, Any]:
        """Everything as JSON values."""
        return {
            "id": self.comparison.id,
            "words": self.comparison.words,
            "a": self.comparison.a,
            "b": self.comparison.b,
            "share": self.share,
            "frames": self.frames,
            "said": str(self.decision),
            "decision": self.decision.to_json(),
            "adjusted": self.adjusted.words,
        }


@dataclass(frozen=True, kw_only=True)
class ShareScore:
    """What a row reached at one share.

    Args:
        row: The row's name.
        share: Share of its world's frames.
        frames: How many they are.
        values: The figure of each seed, in the seeds' order.
        mean: Over seeds.
        interval: Of the mean, 95 %, under draws of the scored sequences, the same for all seeds.
    """

    row: str
    share: float
    frames: int
    values: tuple[float, ...]
    mean: float
    interval: tuple[float, float] | None

    def __str__(self) -> str:
        spans = "" if self.interval is None else f" [{self.interval[0]:.3f}, {self.interval[1]:.3f}]"
        return f"{self.mean:.3f}{spans} ({' '.join(f'{value:.3f}' for value in self.values)})"

    def to_json(self) -> dict[str, Any]:
        """Everything as JSON values."""
        return asdict(self)


def by_row(scores: Iterable[Mapping[str, Any]]) -> dict[tuple[str, float], dict[int, ScoreSample]]:
    """Samples by row and share, and within by seed."""
    samples: dict[tuple[str, float], dict[int, ScoreSample]] = {}
    for run in scores:
        samples.setdefault((run["row"], run["share"]), {})[int(run["seed"])] = sample_of(run["sample"])
    return samples


def figures_of(table: TransferTable, samples: RowSamples) -> list[ShareScore]:
    """What every row reached at each of its shares, where it was scored."""
    figures = []
    for row, share in table.row_shares:
        by_seed = [sample for _, sample in sorted(samples.get((row, share), {}).items()) if sample.value is not None]
        values = tuple(float(sample.value) for sample in by_seed if sample.value is not None)
        if values:
            figures.append(
                ShareScore(
                    row=row,
                    share=share,
                    frames=table.frames_of(row, share),
                    values=values,
                    mean=float(np.mean(values)),
                    interval=_interval([np.asarray(sample.draws) for sample in by_seed]),
                )
            )
    return figures


def _interval(draws: Sequence[np.ndarray]) -> tuple[float, float] | None:
    """The middle 95 % of the mean over seeds under each draw."""
    if any(of_seed.shape != draws[0].shape or not of_seed.size for of_seed in draws):
        return None
    means = np.mean(draws, axis=0)
    means = means[np.isfinite(means)]
    if not len(means):
        return None
    low, high = np.percentile(means, [2.5, 97.5])
    return float(low), float(high)


def cells_of(table: TransferTable, samples: RowSamples) -> list[ShareComparison]:
    """All comparisons at all shares of which both rows have a seed in common, decided by one pooled spread."""
    pairs = [
        (comparison, share, row_difference(a, b, pool="transfer"))
        for comparison in table.comparisons
        for share in table.every_share
        for a, b in [[samples.get((row, share), {}) for row in (comparison.a, comparison.b)]]
        if a.keys() & b.keys()
    ]
    return [
        ShareComparison(
            comparison=comparison,
            share=share,
            frames=table.frames_of(comparison.a, share),
            decision=decision,
            adjusted=adjusted,
        )
        for (comparison, share, _), (decision, adjusted) in zip(
            pairs, decide_all([difference for *_, difference in pairs]), strict=True
        )
        if decision is not None and adjusted is not None
    ]


def lines_of(table: TransferTable, scores: Sequence[Mapping[str, Any]]) -> list[str]:
    """The table as text."""
    samples = by_row(scores)
    cells = cells_of(table, samples)
    lines = [
        f"{table.metric} of the {table.score.protocol} protocol, simulated",
        "mean over seeds, its interval of 95 % under draws of the scored drives, (each seed)",
        f"declared {table.digest[:12]}; {count_of(len(scores), 'run')} of {count_of(table.training['steps'], 'step')}, "
        f"{_minutes(scores):.0f} minutes of a core",
        "",
        f"{'row':<88}{'share':>8}{'frames':>8}  AP",
    ]
    lines += [
        f"{table.row_words(score.row)[:87]:<88}{f'{100 * score.share:g} %':>8}{score.frames:>8}  {score}"
        for score in figures_of(table, samples)
    ]
    lines += ["", "the first over the second: difference, interval of 95 %, decision (Holm's column)"]
    for cell in cells:
        target = f"{f'{100 * cell.share:g} %':>8}{cell.frames:>8}"
        verdict = f"{cell.decision} ({cell.adjusted.words})"
        lines.append(f"{cell.comparison.id:<4}{cell.comparison.words:<82}{target}  {verdict}")
    return [*lines, "", *(sentence_of(comparison, cells) for comparison in table.comparisons)]


def _minutes(scores: Sequence[Mapping[str, Any]]) -> float:
    """Core minutes that runs took."""
    return sum(run["clock"]["processor_s"] for run in scores) / 60


def sentence_of(comparison: TransferComparison, cells: Iterable[ShareComparison]) -> str:
    """The decisions on a comparison over all its shares, as a sentence."""
    groups: dict[str, list[str]] = {}
    for cell in cells:
        if cell.comparison.id == comparison.id:
            groups.setdefault(cell.decision.verdict, []).append(f"{100 * cell.share:g} %")
    phrases = {
        "holds": "the first lies above at",
        "holds not": "the first lies below at",
        "undecided": "the interval holds 0, so neither is shown, at",
        "no decision": "too few seeds or drives to decide at",
    }
    parts = [f"{phrases[verdict]} {', '.join(groups[verdict])}" for verdict in phrases if verdict in groups]
    return f"{comparison.id} {comparison.words}: {'; '.join(parts) or 'not scored yet'}"


def tree_of(table: TransferTable, scores: Sequence[Mapping[str, Any]], planned: int) -> dict[str, Any]:
    """All of the table as JSON values: what ``transfer.json`` holds and the page shows.

    Args:
        table: The table.
        scores: Scores of the finished runs.
        planned: Number of runs of the complete table.
    """
    samples = by_row(scores)
    cells = cells_of(table, samples)
    return {
        "declared": table.digest,
        "words": table.words,
        "metric": table.metric,
        "protocol": table.score.protocol,
        "steps": table.training["steps"],
        "seeds": len({run["seed"] for run in scores}),
        "planned": planned,
        "done": len(scores),
        "minutes": round(_minutes(scores), 1),
        "rows": [
            {"name": name, "words": row.words, "world": table.worlds[row.world].words}
            for name, row in table.rows.items()
        ],
        "figures": [score.to_json() for score in figures_of(table, samples)],
        "comparisons": [cell.to_json() for cell in cells],
        "sentences": [sentence_of(comparison, cells) for comparison in table.comparisons],
        "runs": [{name: value for name, value in run.items() if name != "sample"} for run in scores],
        "environment": environment(),
    }
