"""What the edits add up to: the present value of every cell that was touched."""

from collections.abc import Iterator
from typing import Any, NamedTuple

from farfield.datasets.edits.records import Cell, Record
from farfield.frame import Key


class CellState(NamedTuple):
    """A cell as it stands.

    Args:
        value: Its value; None where nothing is left.
        version: Number of the edit that set it last.
        by: Who made that edit.
        born: Number of the edit that touched it first.
        original: Whether the files have it, as opposed to one that was added.
    """

    value: Any
    version: int
    by: str
    born: int
    original: bool


class EditState:
    """The present value of every cell that was touched; what is not in it is as the files have it."""

    def __init__(self) -> None:
        self._cells: dict[Cell, CellState] = {}
        self._frames: dict[Key, dict[str, Cell]] = {}
        self.seq = 0

    def apply(self, record: Record) -> None:
        """Take an edit in; nothing of it if it does not fit.

        Raises:
            ValueError: If a value before is not the one that stands here, or the edit is out of turn.
        """
        if record.seq != self.seq + 1:
            raise ValueError(f"edit {record.seq} where {self.seq + 1} is due")
        for change in record.changes:
            present = self._cells.get(change.cell)
            if present is not None and present.value != change.old:
                raise ValueError(f"an edit of {'/'.join(change.cell)} that starts from another value")
        for change in record.changes:
            present = self._cells.get(change.cell)
            born = record.seq if present is None else present.born
            original = change.old is not None if present is None else present.original
            self._cells[change.cell] = CellState(change.new, record.seq, record.by, born, original)
            if present is None and change.cell[0] == "box":
                _, sequence, frame, name = change.cell
                self._frames.setdefault((sequence, frame), {})[name] = change.cell
        self.seq = record.seq

    def get(self, cell: Cell) -> CellState | None:
        """A cell as it stands; None where it was never touched."""
        return self._cells.get(cell)

    def touched(self, key: Key) -> dict[str, CellState]:
        """The boxes of a frame that were touched, by name, in the order in which they were."""
        return {name: self._cells[cell] for name, cell in self._frames.get(key, {}).items()}

    def frames(self) -> tuple[Key, ...]:
        """Frames in which a box was touched."""
        return tuple(self._frames)

    def of_kind(self, kind: str) -> Iterator[tuple[Cell, CellState]]:
        """All touched cells of a kind, such as ``"bookmark"``."""
        return ((cell, standing) for cell, standing in self._cells.items() if cell[0] == kind)
