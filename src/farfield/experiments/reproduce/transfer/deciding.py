"""The table of transfer from what its runs scored: means by row and share, and a decision on every comparison."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from farfield.experiments.reproduce.scoring import sample_of
from farfield.experiments.reproduce.transfer.declared import Compared, Table
from farfield.metrics.deciding import Decision, Difference, Sample, decide, difference_of, holm, pooled

Scored = Mapping[tuple[str, float], Mapping[int, Sample]]


@dataclass(frozen=True, kw_only=True)
class Cell:
    """A comparison at one share.

    Args:
        compared: The two rows.
        share: Share of the target's frames.
        decision: The decision.
        adjusted: The same after Holm's correction over all cells.
    """

    compared: Compared
    share: float
    decision: Decision
    adjusted: Decision

    def to_json(self) -> dict[str, Any]:
        """Everything as JSON values."""
        said = {"id": self.compared.id, "a": self.compared.a, "b": self.compared.b, "share": self.share}
        return {**said, "decision": self.decision.to_json(), "adjusted": self.adjusted.words}


def by_row(scores: Iterable[Mapping[str, Any]]) -> dict[tuple[str, float], dict[int, Sample]]:
    """Samples by row and share, and within by seed."""
    found: dict[tuple[str, float], dict[int, Sample]] = {}
    for each in scores:
        found.setdefault((each["row"], each["share"]), {})[int(each["seed"])] = sample_of(each["sample"])
    return found


def cells_of(table: Table, scored: Scored) -> list[Cell]:
    """All comparisons at all shares of which both rows have a seed in common, decided by one pooled spread."""
    places, differences = list[tuple[Compared, float]](), list[Difference]()
    for compared in table.comparisons:
        for share in table.shares:
            one, other = scored.get((compared.a, share), {}), scored.get((compared.b, share), {})
            seeds = sorted(set(one) & set(other))
            if seeds:
                places.append((compared, share))
                differences.append(difference_of([one[s] for s in seeds], [other[s] for s in seeds]))
    spread = pooled(differences)
    decisions = [decide(each.with_pooled(spread)) for each in differences]
    return [
        Cell(compared=compared, share=share, decision=decision, adjusted=adjusted)
        for (compared, share), decision, adjusted in zip(places, decisions, holm(decisions), strict=True)
    ]


def lines_of(table: Table, scores: Sequence[Mapping[str, Any]]) -> list[str]:
    """The table as text."""
    scored = by_row(scores)
    steps = table.training["steps"]
    minutes = sum(each["clock"]["processor_s"] for each in scores) / 60
    lines = [
        f"{table.metric} of the {table.score.protocol} protocol, simulated; mean over seeds (each seed)",
        f"declared {table.digest[:12]}; {len(scores)} runs of {steps} steps, {minutes:.0f} minutes of a core",
        "",
        f"{'row':<52}" + "".join(f"{f'{100 * share:g} % of the frames':>30}" for share in table.shares),
    ]
    for name, row in table.rows.items():
        said = f"{row.words} ({table.worlds[row.world].words})"
        lines.append(f"{said[:51]:<52}" + "".join(f"{_mean(scored.get((name, s), {})):>30}" for s in table.shares))
    lines += ["", "difference, interval of 95 %, decision (Holm's column)"]
    for cell in cells_of(table, scored):
        verdict = f"{cell.decision} ({cell.adjusted.words})"
        lines.append(f"{cell.compared.id} {cell.compared.words:<50} {100 * cell.share:>4g} %  {verdict}")
    return lines


def _mean(samples: Mapping[int, Sample]) -> str:
    values = [each.value for _, each in sorted(samples.items()) if each.value is not None]
    if not values:
        return "-"
    return f"{np.mean(values):.3f} ({' '.join(f'{value:.3f}' for value in values)})"
