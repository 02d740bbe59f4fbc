"""What each annotator can take back and do again, found from the journal alone: it survives restarts."""

from collections import defaultdict
from typing import NamedTuple

from farfield.datasets.edits import Record

EDITS = ("box.", "track.")
"""Operations that can be taken back begin so; a save or a bookmark cannot."""
UNDO, REDO, KEEP = "undo", "redo", "keep"
"""Operations on steps; ``keep`` gives up taking a step back, where somebody else went on from it."""


class UndoStep(NamedTuple):
    """What one undo takes back.

    Args:
        seqs: The edits, in the order in which they were made.
        by: Who made them.
        group: Their group, if they have one.
    """

    seqs: tuple[int, ...]
    by: str
    group: str | None


class History:
    """Stacks of steps, one pair an annotator.

    A new edit clears what its annotator could do again. Taking back a step moves it from one stack to the other, as a
    step whose edits are the ones that took it back.
    """

    def __init__(self) -> None:
        self._back: dict[str, list[UndoStep]] = defaultdict(list)
        self._again: dict[str, list[UndoStep]] = defaultdict(list)

    def take(self, record: Record) -> None:
        """Take an edit of the journal in."""
        if record.op == UNDO:
            self._move(record, self._back, self._again)
        elif record.op == REDO:
            self._move(record, self._again, self._back)
        elif record.op == KEEP:
            self._pop(record, self._back)
        elif record.op.startswith(EDITS):
            steps = self._back[record.by]
            if record.group is not None and steps and steps[-1].group == record.group:
                steps[-1] = steps[-1]._replace(seqs=(*steps[-1].seqs, record.seq))
            else:
                steps.append(UndoStep((record.seq,), record.by, record.group))
            self._again[record.by].clear()

    def _move(self, record: Record, source: dict[str, list[UndoStep]], target: dict[str, list[UndoStep]]) -> None:
        owner, step = self._pop(record, source)
        target[owner].append(UndoStep((record.seq,), step.by, None))

    def _pop(self, record: Record, source: dict[str, list[UndoStep]]) -> tuple[str, UndoStep]:
        for owner, steps in source.items():
            if steps and steps[-1].seqs == record.undoes:
                return owner, steps.pop()
        raise ValueError(f"an {record.op} of {list(record.undoes)}, which is nobody's last step")

    def last(self, by: str | None, op: str = UNDO) -> UndoStep | None:
        """The step that an undo or a redo concerns now; None where there is none.

        Args:
            by: The annotator; None: whoever made the latest.
            op: ``undo`` or ``redo``.
        """
        stacks = self._back if op == UNDO else self._again
        tops = [steps[-1] for owner, steps in stacks.items() if steps and by in (None, owner)]
        return max(tops, key=_newest, default=None)

    def counts(self, by: str) -> tuple[int, int]:
        """How many steps an annotator can take back and do again."""
        return len(self._back.get(by, ())), len(self._again.get(by, ()))


def _newest(step: UndoStep) -> int:
    return step.seqs[-1]
