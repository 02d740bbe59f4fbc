"""What an edit may meet: a refusal, a conflict with another window, a journal that cannot take it."""

from typing import Any

from farfield.errors import FarfieldError


class RefusedError(FarfieldError):
    """An edit that is not possible; nothing was changed.

    Args:
        code: A word for programs, such as ``extent`` or ``unknown-class``.
        sentence: What is wrong, for people.
        fix: What to do.
    """

    def __init__(self, code: str, sentence: str, mend: str = "") -> None:
        self.code, self.sentence, self.mend = code, sentence, mend
        super().__init__(f"{sentence} {mend}".strip())

    def __reduce__(self) -> tuple[Any, ...]:
        return RefusedError, (self.code, self.sentence, self.mend)


class ConflictError(FarfieldError):
    """Somebody changed the object since the version from which the edit starts; nothing was changed.

    Args:
        cell: What was changed.
        present: Its value now; None where it is gone.
        version: Its version now.
        by: Who made the present value.
    """

    def __init__(self, cell: tuple[str, ...], present: Any, version: int, by: str) -> None:
        self.cell, self.present, self.version, self.by = cell, present, version, by
        what = "removed" if present is None else "changed"
        super().__init__(f"{'/'.join(cell)} was {what} by {by or 'somebody'} in the meantime (version {version})")

    def __reduce__(self) -> tuple[Any, ...]:
        return ConflictError, (self.cell, self.present, self.version, self.by)


class JournalHeldError(FarfieldError):
    """Another process writes this journal.

    Args:
        folder: The journal's folder.
        pid: The other process, 0 where it is not known.
    """

    def __init__(self, folder: str, pid: int) -> None:
        self.folder, self.pid = folder, pid
        who = f"process {pid}" if pid else "another process"
        super().__init__(
            f"{folder}: {who} annotates these labels already. Open a second window on its address (it printed the "
            "link), or end it first."
        )

    def __reduce__(self) -> tuple[Any, ...]:
        return JournalHeldError, (self.folder, self.pid)


class JournalError(FarfieldError):
    """The journal could not be written, such as on a full disk: from then on no edit is taken."""

    code = "journal"
