"""The annotation of a data set as it stands: label files with the edits on top, versions, undo."""

import threading
from array import array
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from farfield.annotation.drives import DriveTable, TrackIndex
from farfield.annotation.errors import ConflictError, JournalError, RefusedError
from farfield.annotation.journal import EditJournal
from farfield.annotation.label_files import LabelFiles
from farfield.annotation.schema import Extent, Schema, load_schema
from farfield.datasets.base import Dataset
from farfield.datasets.edits import Cell, CellEdit, EditState, Record, box_cell, label_of, numbers, value_of
from farfield.datasets.edits.journal import check_values
from farfield.datasets.labels import BoxLabel, LabelFormat, Numbers
from farfield.frame import Key

EXTENT: Cell = ("extent",)


class Author(NamedTuple):
    """Who edits, and in which window."""

    by: str
    window: str = ""


class StoredBox(NamedTuple):
    """A box of a frame as it stands.

    Args:
        label: The box.
        version: Number of the edit that set it last: the ``base`` of the next one; 0 as the files have it.
        by: Who made that edit; empty as the files have it.
        proposal: The detector's box from which it came, or None.
    """

    label: BoxLabel
    version: int = 0
    by: str = ""
    proposal: Numbers | None = None


class EditResult(NamedTuple):
    """An edit that was taken.

    Args:
        record: The edit; its number is the new version of all that it changed.
        saved: Done when the edit is on the disk: acknowledge it only then.
        repeated: Whether it is a message that came before, sent again; nothing was changed by it now.
    """

    record: Record
    saved: "Future[Record]"
    repeated: bool = False


class WrittenLabels(NamedTuple):
    """What label files hold: the last save.

    Args:
        seq: Edits up to this one.
        time_ns: When.
        folder: Where, in words.
        format: In which format.
        left: Boxes that the format cannot hold: they are in the journal only.
    """

    seq: int
    time_ns: int
    folder: str
    format: str
    left: int = 0


Plan = Callable[["Store"], Sequence[CellEdit]]
"""What an edit changes, found from the store as it stands; raises where the edit is not possible."""


class Store:
    """The annotation of one data set. Any thread may call; edits are taken one at a time.

    Args:
        data: The data set, as its reader gives it (no maps: labels are kept in the reader's coordinates).
        labels: Its label files.
        folder: Folder of the journal, see :func:`farfield.datasets.edits.journal_folder`.
        schema: What may be annotated where ``classes.yaml`` beside the journal says nothing else.

    Raises:
        JournalHeldError: If another process annotates with this journal.
        FileFormatError: If the journal is damaged before its last line.
    """

    def __init__(self, data: Dataset, labels: LabelFormat, folder: Path, schema: Schema) -> None:
        self.data, self.folder = data, folder
        self.keys = data.keys
        self.index_of = {key: index for index, key in enumerate(self.keys)}
        self.drives = DriveTable(data)
        self.lock, self.saving = threading.RLock(), threading.Lock()
        self._labels, self._is_whole = labels, True
        self._begin()
        self.journal = EditJournal(folder, self._take, self._as_stored)
        try:
            self.schema = load_schema(folder, schema)
        except BaseException:
            self.journal.close()
            raise

    def _begin(self) -> None:
        """The annotation before the first edit."""
        self.files = LabelFiles(self._labels, self.keys, self.folder, self.data.root)
        self.state, self.history = EditState(), History()
        self.tracks = TrackIndex(self.rows, self.drives)
        self.written: WrittenLabels | None = None
        self._written_to: dict[tuple[str, str], int] = {}  # by folder and format: up to which edit
        self._box_edits = array("q")  # numbers of the edits of boxes

    def _as_stored(self) -> None:
        """After the journal failed: the annotation is what is on the disk, without the edits that were lost."""
        with self.lock:
            self._is_whole = False
            self._begin()
            self.journal.replay()
            self._is_whole = True

    def check_whole(self) -> None:
        """Refuse to go on with a part of the annotation, where the journal failed and could not be read again.

        Raises:
            JournalError: If it is so.
        """
        if not self._is_whole:
            raise JournalError(self.journal.failure)

    def _take(self, record: Record) -> None:
        check_values(record)
        self.history.take(record)
        self.state.apply(record)
        self.files.take(record)
        self.tracks.take(record)
        if any(change.cell[0] == "box" for change in record.changes):
            self._box_edits.append(record.seq)
        saved = (record.data or {}).get("written")
        if saved is not None:
            self.written = WrittenLabels(time_ns=record.time_ns, **saved)
            target = str((record.data or {}).get("folder", "")), self.written.format
            self._written_to[target] = max(self.written.seq, self._written_to.get(target, 0))

    @property
    def unwritten(self) -> int:
        """How many edits of boxes are in the journal only: no label file has them."""
        return self._box_edits_after(max(self._written_to.values(), default=0))

    def unwritten_in(self, folder: str, format: str) -> int:
        """How many edits of boxes the labels in a folder and format lack; the empty folder: in their places."""
        return self._box_edits_after(self._written_to.get((folder, format), 0))

    def _box_edits_after(self, seq: int) -> int:
        with self.lock:
            return len(self._box_edits) - bisect_right(self._box_edits, seq)

    @property
    def extent(self) -> Extent | None:
        """Whether boxes are whole bodies (``full``) or visible parts; None: not declared yet."""
        declared = self.state.get(EXTENT)
        return declared.value if declared is not None else self.schema.extent

    def rows(self, key: Key) -> tuple[StoredBox, ...]:
        """The boxes of a frame as they stand, the files' first, in their order; rejected proposals too.

        Raises:
            DatasetError: If there is no such frame, or its file was changed by another program.
            FileFormatError: If its file is damaged.
            JournalError: If the journal failed and could not be read again.
        """
        with self.lock:
            self.check_whole()
            touched = self.state.touched(key)
            rows = {label.id: StoredBox(label) for label in self.files.labels(key) if label.id not in touched}
            for name, standing in touched.items():
                if standing.value is not None:
                    rows[name] = _row(name, standing.value, standing.version, standing.by)
        return tuple(sorted(rows.values(), key=_BoxOrder(touched)))

    def row(self, key: Key, name: str) -> StoredBox | None:
        """One box of a frame; None where there is none (any more)."""
        with self.lock:
            standing = self.state.get(box_cell(key, name))
            if standing is not None:
                value = standing.value
                return None if value is None else _row(name, value, standing.version, standing.by)
            return next((StoredBox(label) for label in self.files.labels(key) if label.id == name), None)

    def value(self, cell: Cell) -> Any:
        """The value of a cell as it stands; None where there is nothing."""
        standing = self.state.get(cell)
        if standing is not None:
            return standing.value
        if cell[0] != "box":
            return None
        row = self.row((cell[1], cell[2]), cell[3])
        return None if row is None else value_of(row.label)

    def version(self, cell: Cell) -> int:
        """The version of a cell as it stands."""
        standing = self.state.get(cell)
        return 0 if standing is None else standing.version

    def change(self, cell: Cell, new: Any, *, base: int | None = None) -> CellEdit:
        """A change of a cell from what it is now.

        Args:
            cell: The cell.
            new: Its new value; None removes it.
            base: The version from which the edit starts; None: whatever it is.

        Raises:
            ConflictError: If the cell has another version.
        """
        present = self.version(cell)
        if base is not None and base != present:
            standing = self.state.get(cell)
            by = "" if standing is None else standing.by
            raise ConflictError(cell, self.value(cell), present, by)
        return CellEdit(cell, present, self.value(cell), new)

    def edit(
        self,
        author: Author,
        id: str,
        op: str,
        plan: Plan,
        *,
        group: str | None = None,
        undoes: Sequence[int] = (),
        data: Mapping[str, Any] | None = None,
    ) -> EditResult:
        """Make an edit: all of it, or nothing.

        Args:
            author: Who, and in which window.
            id: The client's name of it. One that was taken before is not made again.
            op: What is done; what begins with ``box.`` or ``track.`` can be taken back.
            plan: Finds what changes.
            group: Joins edits that are taken back together.
            undoes: The edits that it takes back or does again.
            data: What else the journal is to note.

        Raises:
            RefusedError: If it is not possible.
            ConflictError: If somebody changed the object in the meantime.
            JournalError: If the journal cannot be written.
        """
        with self.lock:
            before = self.journal.seq_of(id)
            if before is not None:
                return self._repeated(before, op)
            changes = tuple(plan(self))
            notes = dict(data or {}) | self._file_states(changes)
            record, saved = self.journal.append(
                id=id,
                by=author.by,
                window=author.window,
                op=op,
                changes=changes,
                group=group,
                undoes=undoes,
                data=notes,
            )
        return EditResult(record, saved)

    def _repeated(self, seq: int, op: str) -> EditResult:
        record = self.journal.read(seq)
        if record.op != op:
            raise RefusedError("id", f"the id {record.id!r} was used before, by a {record.op}", "Use a new id.")
        return EditResult(record, self.journal.pending(seq), repeated=True)

    def _file_states(self, changes: Sequence[CellEdit]) -> dict[str, Any]:
        """What is to be noted of the label files that are touched for the first time."""
        states: dict[str, Any] = {}
        for change in changes:
            if change.cell[0] == "box":
                states |= self.files.state((change.cell[1], change.cell[2]))
        return {"files": states} if states else {}

    def close(self) -> None:
        """Write what waits and let the journal go."""
        self.journal.close()

    def __enter__(self) -> "Store":
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


class _BoxOrder:
    """Places of a frame's boxes: those of the files in their order, then the added ones in theirs."""

    def __init__(self, touched: Mapping[str, Any]) -> None:
        self._born = {name: (standing.born, number) for number, (name, standing) in enumerate(touched.items())}
        self._added = {name for name, standing in touched.items() if not standing.original}

    def __call__(self, row: StoredBox) -> tuple[int, int, int]:
        name = row.label.id
        if name in self._added or not name.isdigit():
            return (1, *self._born[name])
        return (0, int(name), 0)


def _row(name: str, value: Mapping[str, Any], version: int, by: str) -> StoredBox:
    proposal = value.get("proposal")
    return StoredBox(label_of(name, value), version, by, None if proposal is None else numbers(proposal))


# Undo and redo: what each annotator can take back is derived from the journal alone, so it survives restarts

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
        return store.edit(author, id, KEEP, no_change, undoes=seqs)


def _step(store: Store, author: Author, id: str, op: str, everybody: bool, force: bool) -> EditResult:
    with store.lock:
        if store.journal.seq_of(id) is not None:
            return store.edit(author, id, op, no_change)
        step = _last(store, author, op, everybody)
        return store.edit(author, id, op, partial(inverse, step=step, force=force), undoes=step.seqs)


def _last(store: Store, author: Author, op: str, everybody: bool) -> UndoStep:
    step = store.history.last(None if everybody else author.by, REDO if op == REDO else UNDO)
    if step is None:
        what = "done again" if op == REDO else "taken back"
        raise RefusedError("nothing", f"there is nothing to be {what}")
    return step


def no_change(store: Store) -> Sequence[CellEdit]:
    """The plan of what changes no cell, such as the note of a save."""
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
