"""Scores of an adaptation on labelled frames that it did not learn from, for its page."""

from dataclasses import asdict, dataclass
from typing import Any

Interval = tuple[float, float]
NOTHING = "–"


@dataclass(frozen=True, kw_only=True)
class ScoreRow:
    """A figure of a class before and after.

    Args:
        label: The class.
        annotated: Number of its annotated objects.
        figure: What was scored.
        before: The figure before; None where there is none.
        after: The figure after.
        before_interval: Its interval, 95 %, or None.
        after_interval: The same after.
        gain: After minus before.
        gain_interval: Its interval, 95 %.
    """

    label: str
    annotated: int
    figure: str
    before: float | None
    after: float | None
    before_interval: Interval | None
    after_interval: Interval | None
    gain: float | None
    gain_interval: Interval | None


@dataclass(frozen=True, kw_only=True)
class HeldScores:
    """Scores on labelled frames that were not learnt from.

    Args:
        rows: Figures by class.
        frames: Number of these frames.
        drives: Number of their drives.
        shared_drives: How many of these have other frames that were learnt from.
        grouped_by: What was drawn for the intervals: ``"sequences"``, or ``"frames"`` of one sequence.
        groups: How many of them.
    """

    rows: tuple[ScoreRow, ...]
    frames: int
    drives: int
    shared_drives: int
    grouped_by: str
    groups: int

    def to_json(self) -> dict[str, Any]:
        """All of it as JSON values."""
        return asdict(self)

    @property
    def words(self) -> str:
        """What was scored, and what the intervals hold."""
        held = "drive" if self.drives == 1 else "drives"
        text = f"{self.frames} labelled frames of {self.drives} {held} that were not learnt from"
        if self.shared_drives:
            text += (
                f"; {self.shared_drives} of these drives had other frames that were, so scores may come out too good"
            )
        drawn = "drives" if self.grouped_by == "sequences" else "frames of the one drive"
        return (
            f"{text}. The labels were read at the end and decided nothing. Intervals, 95 %, are over draws of the "
            f"{drawn}: another training would give other figures, and that spread is not in them."
        )

    @property
    def lines(self) -> list[list[tuple[str, str]]]:
        """Rows of the table: each cell a figure and its interval."""
        return [
            [
                (row.label.replace("_", " "), ""),
                (f"{row.annotated:,}", ""),
                (row.figure, ""),
                _cell(row.before, row.before_interval),
                _cell(row.after, row.after_interval),
                _cell(row.gain, row.gain_interval, signed=True),
            ]
            for row in self.rows
        ]


def _cell(value: float | None, interval: Interval | None, *, signed: bool = False) -> tuple[str, str]:
    form = "+.3f" if signed else ".3f"
    if value is None:
        return NOTHING, ""
    return format(value, form), "" if interval is None else f"{interval[0]:{form}} to {interval[1]:{form}}"
