"""Tables of scores as rows of plain values, for the page."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from farfield.evaluation.results import counts, figure, interval, part_names
from farfield.metrics.protocol import Protocol

Results = Mapping[str, Mapping[str, Any]]
NOTHING = "–"


@dataclass(frozen=True)
class TableCell:
    """One figure of a table.

    Args:
        value: The figure, or None where nothing is annotated.
        interval: Bootstrap interval, or None.
        unit: In which it is shown: ``"%"`` is in per cent, and an empty one a share.
    """

    value: float | None
    interval: tuple[float, float] | None = None
    unit: str = ""

    @property
    def text(self) -> str:
        """The figure to three decimals, in per cent to two, or a dash."""
        return NOTHING if self.value is None else figure_text(self.value, self.unit)

    @property
    def interval_text(self) -> str:
        """The interval with a decimal less, or nothing."""
        if self.interval is None:
            return ""
        return " to ".join(figure_text(end, self.unit, less=1) for end in self.interval)

    @property
    def percent(self) -> float:
        """The figure as a bar's length, 0 to 100."""
        return 0.0 if self.value is None else round(100 * min(max(self.value, 0.0), 1.0), 1)


def figure_text(value: float, unit: str, *, less: int = 0) -> str:
    """A figure as text without its unit; ``less`` decimals less than usual."""
    return f"{100 * value:.{2 - less}f}" if unit == "%" else f"{value:.{3 - less}f}"


@dataclass(frozen=True)
class ScoreTableRow:
    """Scores of one result in one range.

    Args:
        result: Name of the result.
        part: ``"overall"`` or the bin's name.
        annotated: Number of annotated boxes, or None where unknown.
        predicted: Number of predictions, or None.
        cells: Figures by name.
    """

    result: str
    part: str
    annotated: int | None
    predicted: int | None
    cells: Mapping[str, TableCell] = field(default_factory=dict)


def range_name(part: str) -> str:
    """A bin's name as people read it: ``"0-70"`` becomes ``"0 to 70 m"``."""
    return "all ranges" if part == "overall" else " to ".join(part.split("-")) + " m"


def heading(protocol: Protocol, name: str) -> str:
    """Head of a figure's column: its title and its unit."""
    unit = protocol.unit(name)
    return protocol.title(name) + (f" ({unit})" if unit else "")


def rows(results: Results, names: Sequence[str], protocol: Protocol) -> list[ScoreTableRow]:
    """Rows by range, near to far and then overall, and inside a range by result.

    Args:
        results: Result JSON by name.
        names: Figures to take, such as ``"dds/0/dds"`` or ``"ap/2.0"``.
        protocol: Says in which units they are shown.
    """
    parts: list[str] = []
    for result in results.values():
        parts += [part for part in part_names(result) if part not in parts]
    parts.sort(key=lambda part: float(part.split("-")[0]))
    ordered = [*parts, "overall"]
    return [_score_row(name, result, part, names, protocol) for part in ordered for name, result in results.items()]


def _score_row(
    name: str, result: Mapping[str, Any], part: str, names: Sequence[str], protocol: Protocol
) -> ScoreTableRow:
    number = counts(result, part=part)
    cells = {
        each: TableCell(figure(result, each, part=part), interval(result, each, part=part), protocol.unit(each))
        for each in names
    }
    return ScoreTableRow(name, part, number.get("annotated"), number.get("predictions"), cells)
