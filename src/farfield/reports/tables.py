"""Tables of scores as rows of plain values, for the page."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from farfield.reports.results import counts, epsilons, figure, interval, part_names

Results = Mapping[str, Mapping[str, Any]]
NOTHING = "–"


@dataclass(frozen=True)
class Cell:
    """One figure of a table.

    Args:
        value: The figure, or None where nothing is annotated.
        interval: Bootstrap interval, or None.
    """

    value: float | None
    interval: tuple[float, float] | None = None

    @property
    def text(self) -> str:
        """The figure to three decimals, or a dash."""
        return NOTHING if self.value is None else f"{self.value:.3f}"

    @property
    def interval_text(self) -> str:
        """The interval to two decimals, or nothing."""
        return "" if self.interval is None else f"{self.interval[0]:.2f} to {self.interval[1]:.2f}"

    @property
    def percent(self) -> float:
        """The figure as a bar's length, 0 to 100."""
        return 0.0 if self.value is None else round(100 * min(max(self.value, 0.0), 1.0), 1)


@dataclass(frozen=True)
class Row:
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
    cells: Mapping[str, Cell] = field(default_factory=dict)


def range_name(part: str) -> str:
    """A bin's name as people read it: ``"0-70"`` becomes ``"0 to 70 m"``."""
    return "all ranges" if part == "overall" else " to ".join(part.split("-")) + " m"


def score_names(results: Results) -> list[str]:
    """Names of the scores that at least one result has, DDS first and then wDDS by epsilon."""
    found = sorted({name for result in results.values() for name in epsilons(result)}, key=float)
    return [f"dds/{epsilon}/dds" for epsilon in found]


def score_title(name: str) -> str:
    """Head of a figure's column: ``DDS``, ``wDDS 0.006``, ``mAP``, ``aIoU``, ``AP 0.5 m`` or ``AP 3d r40``."""
    kind, *steps = name.split("/")
    if not steps:
        return {"map": "mAP"}.get(kind, kind)
    if kind == "ap":
        metres = len(steps) == 1 and steps[0].replace(".", "", 1).isdecimal()
        return f"AP {float(steps[0]):g} m" if metres else " ".join(["AP", *steps])
    if steps[-1] != "dds":
        return {"map": "mAP", "aiou": "aIoU"}.get(steps[-1], steps[-1])
    return "DDS" if float(steps[0]) == 0 else f"wDDS {steps[0]}"


def rows(results: Results, names: Sequence[str]) -> list[Row]:
    """Rows by range, near to far and then overall, and inside a range by result.

    Args:
        results: Result JSON by name.
        names: Figures to take, such as ``"dds/0/dds"`` or ``"ap/2.0"``.
    """
    parts: list[str] = []
    for result in results.values():
        parts += [part for part in part_names(result) if part not in parts]
    parts.sort(key=lambda part: float(part.split("-")[0]))
    return [_row(name, result, part, names) for part in [*parts, "overall"] for name, result in results.items()]


def _row(name: str, result: Mapping[str, Any], part: str, names: Sequence[str]) -> Row:
    number = counts(result, part=part)
    cells = {each: Cell(figure(result, each, part=part), interval(result, each, part=part)) for each in names}
    return Row(name, part, number.get("annotated"), number.get("predictions"), cells)
