"""Rows of figures with their targets: printed as they come, and kept as text."""

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from _report import header

from farfield.files.atomic import write_text

WIDTHS = (64, 52, 42)


@dataclass
class Table:
    """Rows: what, figure, target, held."""

    rows: list[tuple[str, str, str, bool]] = field(default_factory=list)

    def add(self, what: str, figure: str, target: str, held: bool) -> None:
        """One row more, printed at once."""
        self.rows.append((what, figure, target, held))
        print(self._line(self.rows[-1]), flush=True)

    @staticmethod
    def _line(row: tuple[str, str, str, bool]) -> str:
        words = [f"{word:{width}s}" for word, width in zip(row[:3], WIDTHS, strict=True)]
        return " | ".join([*words, "held" if row[3] else "MISSED"])

    def text(self) -> str:
        """All rows."""
        names = [f"{word:{width}s}" for word, width in zip(("what", "measured", "target"), WIDTHS, strict=True)]
        return "\n".join([" | ".join(names), *map(self._line, self.rows)])


def reported(measure: Callable[[], Table], output: Path | None) -> int:
    """Measure, write the report where it is wanted, and give the exit status: 1 where a row was missed."""
    before = os.getloadavg()
    table = measure()
    load = f"load     {before[0]:.1f} before, {os.getloadavg()[0]:.1f} after (1 minute)"
    text = f"{header()}\n{load}\n\n{table.text()}\n"
    if output is not None:
        write_text(output, text)
    else:
        print(text)
    return 0 if all(held for *_, held in table.rows) else 1
