"""Taking back and doing again: the inverse of a step, as an edit at the journal's end."""

from collections.abc import Sequence
from functools import partial

from farfield.annotation.errors import ConflictError, RefusedError
from farfield.annotation.history import KEEP, REDO, UNDO, UndoStep
from farfield.annotation.store import Author, EditResult, Store
from farfield.datasets.edits import Cell, CellEdit


def undo(store: Store, author: Author, id: str, *, everybody: bool = False, force: bool = False) -> EditResult:
    """Take back the last step.

    Args:
        store: The annotation.
        author: Who.
        id: The client's name of this undo.
        everybody: Take back whatever was done last by anybody, not only the author's own.
        force: Also where somebody else changed one of the objects since: their value goes.

    Raises:
        RefusedError: If there is nothing to take back.
        ConflictError: If somebody else changed one of the objects since, and not ``force``: who, and the value now.
    """
    return _step(store, author, id, UNDO, everybody, force)


def redo(store: Store, author: Author, id: str, *, everybody: bool = False, force: bool = False) -> EditResult:
    """Do again what was taken back last; see :func:`undo`."""
    return _step(store, author, id, REDO, everybody, force)


def keep(store: Store, author: Author, id: str) -> EditResult:
    """Leave the last step as it is, so that the next undo takes back the one before it."""
    with store.lock:
        seqs = () if store.journal.seq_of(id) is not None else _last(store, author, KEEP, False).seqs
        return store.edit(author, id, KEEP, _nothing, undoes=seqs)


def _step(store: Store, author: Author, id: str, op: str, everybody: bool, force: bool) -> EditResult:
    with store.lock:
        if store.journal.seq_of(id) is not None:
            return store.edit(author, id, op, _nothing)
        step = _last(store, author, op, everybody)
        return store.edit(author, id, op, partial(inverse, step=step, force=force), undoes=step.seqs)


def _last(store: Store, author: Author, op: str, everybody: bool) -> UndoStep:
    step = store.history.last(None if everybody else author.by, REDO if op == REDO else UNDO)
    if step is None:
        what = "done again" if op == REDO else "taken back"
        raise RefusedError("nothing", f"there is nothing to be {what}")
    return step


def _nothing(store: Store) -> Sequence[CellEdit]:
    del store
    return ()


def inverse(store: Store, step: UndoStep, force: bool) -> Sequence[CellEdit]:
    """The changes that bring back what was before a step.

    Raises:
        ConflictError: If an object is no longer as the step left it, and not ``force``.
    """
    first: dict[Cell, CellEdit] = {}
    last: dict[Cell, CellEdit] = {}
    for seq in step.seqs:
        for change in store.journal.read(seq).changes:
            first.setdefault(change.cell, change)
            last[change.cell] = change
    for cell, change in last.items():
        standing = store.state.get(cell)
        if standing is not None and standing.value != change.new and not force:
            raise ConflictError(cell, standing.value, standing.version, standing.by)
    return [store.change(cell, change.old) for cell, change in first.items()]
