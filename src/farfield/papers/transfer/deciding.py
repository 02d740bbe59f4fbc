"""The table of transfer from what its runs scored: means by row and share, and a decision on every comparison."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from farfield.frame.provenance import environment
from farfield.metrics.deciding import Decision, Difference, ScoreSample, decide, difference_of, holm, pooled
from farfield.papers.scoring import sample_of
from farfield.papers.transfer.declared import TransferComparison, TransferTable

Scored = Mapping[tuple[str, float], Mapping[int, ScoreSample]]


@dataclass(frozen=True, kw_only=True)
class ShareComparison:
    """A comparison at one share.

    Args:
        compared: The two rows.
        share: Share of the target's frames.
        frames: How many they are.
        decision: The decision.
        adjusted: The same after Holm's correction over all cells.
    """

    compared: TransferComparison
    share: float
    frames: int
    decision: Decision
    adjusted: Decision

    def to_json(self) -> dict[str, Any]:
        """Everything as JSON values."""
        rows = {"id": self.compared.id, "words": self.compared.words, "a": self.compared.a, "b": self.compared.b}
        said = {**rows, "share": self.share, "frames": self.frames, "said": str(self.decision)}
        return {**said, "decision": self.decision.to_json(), "adjusted": self.adjusted.words}


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
        said = {"row": self.row, "share": self.share, "frames": self.frames, "values": list(self.values)}
        return {**said, "mean": self.mean, "interval": None if self.interval is None else list(self.interval)}


def by_row(scores: Iterable[Mapping[str, Any]]) -> dict[tuple[str, float], dict[int, ScoreSample]]:
    """Samples by row and share, and within by seed."""
    found: dict[tuple[str, float], dict[int, ScoreSample]] = {}
    for each in scores:
        found.setdefault((each["row"], each["share"]), {})[int(each["seed"])] = sample_of(each["sample"])
    return found


def figures_of(table: TransferTable, scored: Scored) -> list[ShareScore]:
    """What every row reached at each of its shares, where it was scored."""
    found = []
    for row in table.rows:
        for share in table.shares_of(row):
            samples = [each for _, each in sorted(scored.get((row, share), {}).items()) if each.value is not None]
            if samples:
                values = tuple(float(each.value) for each in samples if each.value is not None)
                found.append(
                    ShareScore(
                        row=row,
                        share=share,
                        frames=table.frames_of(row, share),
                        values=values,
                        mean=float(np.mean(values)),
                        interval=_interval([np.asarray(each.draws) for each in samples]),
                    )
                )
    return found


def _interval(draws: Sequence[np.ndarray]) -> tuple[float, float] | None:
    """The middle 95 % of the mean over seeds under each draw."""
    if any(each.shape != draws[0].shape or not each.size for each in draws):
        return None
    means = np.mean(draws, axis=0)
    means = means[np.isfinite(means)]
    if not len(means):
        return None
    low, high = np.percentile(means, [2.5, 97.5])
    return float(low), float(high)


def cells_of(table: TransferTable, scored: Scored) -> list[ShareComparison]:
    """All comparisons at all shares of which both rows have a seed in common, decided by one pooled spread."""
    places, differences = list[tuple[TransferComparison, float]](), list[Difference]()
    for compared in table.comparisons:
        for share in table.every_share:
            one, other = scored.get((compared.a, share), {}), scored.get((compared.b, share), {})
            seeds = sorted(set(one) & set(other))
            if seeds:
                places.append((compared, share))
                differences.append(difference_of([one[s] for s in seeds], [other[s] for s in seeds]))
    spread = pooled(differences)
    decisions = [decide(each.with_pooled(spread)) for each in differences]
    return [
        ShareComparison(
            compared=compared,
            share=share,
            frames=table.frames_of(compared.a, share),
            decision=decision,
            adjusted=adjusted,
        )
        for (compared, share), decision, adjusted in zip(places, decisions, holm(decisions), strict=True)
    ]


def lines_of(table: TransferTable, scores: Sequence[Mapping[str, Any]]) -> list[str]:
    """The table as text."""
    scored = by_row(scores)
    steps = table.training["steps"]
    minutes = sum(each["clock"]["processor_s"] for each in scores) / 60
    lines = [
        f"{table.metric} of the {table.score.protocol} protocol, simulated",
        "mean over seeds, its interval of 95 % under draws of the scored drives, (each seed)",
        f"declared {table.digest[:12]}; {len(scores)} runs of {steps} steps, {minutes:.0f} minutes of a core",
        "",
        f"{'row':<88}{'share':>8}{'frames':>8}  AP",
    ]
    for each in figures_of(table, scored):
        row = table.rows[each.row]
        said = f"{row.words} ({table.worlds[row.world].words})"
        lines.append(f"{said[:87]:<88}{f'{100 * each.share:g} %':>8}{each.frames:>8}  {each}")
    lines += ["", "the first over the second: difference, interval of 95 %, decision (Holm's column)"]
    cells = cells_of(table, scored)
    for cell in cells:
        verdict = f"{cell.decision} ({cell.adjusted.words})"
        where = f"{f'{100 * cell.share:g} %':>8}{cell.frames:>8}"
        lines.append(f"{cell.compared.id:<4}{cell.compared.words:<82}{where}  {verdict}")
    return [*lines, "", *(plainly(each, cells) for each in table.comparisons)]


def plainly(compared: TransferComparison, cells: Iterable[ShareComparison]) -> str:
    """What a comparison came to over all its shares, as a sentence."""
    groups: dict[str, list[str]] = {}
    for cell in cells:
        if cell.compared.id == compared.id:
            groups.setdefault(cell.decision.verdict, []).append(f"{100 * cell.share:g} %")
    words = {
        "holds": "the first lies above at",
        "holds not": "the first lies below at",
        "undecided": "the interval holds 0, so neither is shown, at",
        "no decision": "too few seeds or drives to decide at",
    }
    said = [f"{words[verdict]} {', '.join(groups[verdict])}" for verdict in words if verdict in groups]
    return f"{compared.id} {compared.words}: {'; '.join(said) or 'not scored yet'}"


def tree_of(table: TransferTable, scores: Sequence[Mapping[str, Any]], planned: int) -> dict[str, Any]:
    """All that the table found, as JSON values: what ``transfer.json`` holds and the page shows.

    Args:
        table: The table.
        scores: What the finished runs scored.
        planned: Number of runs of the whole table.
    """
    scored = by_row(scores)
    cells = cells_of(table, scored)
    kept = [{name: value for name, value in each.items() if name != "sample"} for each in scores]
    return {
        "declared": table.digest,
        "words": table.words,
        "metric": table.metric,
        "protocol": table.score.protocol,
        "steps": table.training["steps"],
        "seeds": len({each["seed"] for each in scores}),
        "planned": planned,
        "done": len(scores),
        "minutes": round(sum(each["clock"]["processor_s"] for each in scores) / 60, 1),
        "rows": [
            {"name": name, "words": row.words, "world": table.worlds[row.world].words}
            for name, row in table.rows.items()
        ],
        "figures": [each.to_json() for each in figures_of(table, scored)],
        "comparisons": [cell.to_json() for cell in cells],
        "sentences": [plainly(each, cells) for each in table.comparisons],
        "runs": kept,
        "environment": environment(),
    }
