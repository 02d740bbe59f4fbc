"""The journal: every edit is on the disk before it is acknowledged.

Group commit: a thread writes all edits that wait and calls fsync once for them; those that come meanwhile share the
next one. A line is never changed or cut, so that every edit can be taken back, also after a restart. One process writes
a journal: a lock holds its folder, which ends with the process, however that ends.
"""

import os
import threading
import time
import warnings
from array import array
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from farfield.annotation.errors import JournalError, JournalHeldError, RefusedError
from farfield.datasets.edits import JOURNAL, CellEdit, Record, decode, encode, read_journal
from farfield.datasets.edits.journal import LONGEST_LINE
from farfield.errors import FarfieldError
from farfield.files.limits import open_file
from farfield.files.locking import lock

Take = Callable[[Record], None]


class EditJournal:
    """Edits of one data set, appended by one process; any thread may append.

    Args:
        folder: Its folder, see :func:`farfield.datasets.edits.journal_folder`.
        take: Called with each edit that the file holds, in order, while it is opened.
        failed: Called where edits that were taken could not be written, before anybody is told.

    Raises:
        JournalHeldError: If another process has it open.
        FileFormatError: If a line before the last is damaged.
    """

    def __init__(self, folder: Path, take: Take, failed: Callable[[], None] = lambda: None) -> None:
        self._failed = failed
        self.folder, self.path = folder, folder / JOURNAL
        folder.mkdir(parents=True, exist_ok=True)
        self._held = hold(folder)
        self._ids: dict[str, int] = {}
        self._take = take
        try:
            self._open()
        except BaseException:
            os.close(self._held)
            raise
        self._waiting: list[tuple[bytes, Record, Future[Record]]] = []
        self._writing: list[tuple[bytes, Record, Future[Record]]] = []
        self._changed = threading.Condition()
        self._closing, self._failure = False, ""
        self._thread = threading.Thread(target=self._write, name="journal", daemon=True)
        self._thread.start()

    def _open(self) -> None:
        if self.path.is_file():
            replay = read_journal(self.path, self._replayed)
            self._starts, self._end, torn = replay
        else:
            self._starts, self._end, torn = array("q"), 0, b""
        self._file = os.open(self.path, os.O_RDWR | os.O_CREAT, 0o666)
        if torn:
            keep = self.folder / f"{JOURNAL}.torn-{len(self._starts) + 1}"
            keep.write_bytes(torn)
            os.ftruncate(self._file, self._end)
            warnings.warn(
                f"{self.path}: line {len(self._starts) + 1} is torn (an edit that was never acknowledged); it was left "
                f"out and is kept in {keep.name}",
                stacklevel=4,
            )
        os.lseek(self._file, self._end, os.SEEK_SET)
        os.fsync(self._file)
        _sync_folder(self.folder)

    def _replayed(self, record: Record) -> None:
        self._ids[record.id] = record.seq
        self._take(record)

    def __len__(self) -> int:
        return len(self._starts)

    @property
    def failure(self) -> str:
        """Why no more edits are taken; empty while all is well."""
        return self._failure

    def replay(self) -> None:
        """Hand on the edits that are on the disk once more, after a failure: they are all that there is."""
        with self._changed:
            self._ids.clear()
            replay = read_journal(self.path, self._replayed)
            self._starts, self._end = replay.starts, replay.end

    def seq_of(self, name: str) -> int | None:
        """Number of the edit that a client called so; None if there is none."""
        return self._ids.get(name)

    def append(
        self,
        *,
        id: str,
        by: str,
        window: str,
        op: str,
        changes: Sequence[CellEdit] = (),
        group: str | None = None,
        undoes: Sequence[int] = (),
        data: Mapping[str, Any] | None = None,
    ) -> "tuple[Record, Future[Record]]":
        """Add an edit at the end.

        Args: those of :class:`~farfield.datasets.edits.Record`; its number and time are given here.

        Returns:
            The edit, and a future that is done when it is on the disk: only then is it acknowledged.

        Raises:
            JournalError: If the journal is closed or could not be written before.
            RefusedError: If its line would be longer than the journal's reader takes.
            ValueError: If a number is not finite, or the id was used before.
        """
        with self._changed:
            if self._failure or self._closing:
                raise JournalError(self._failure or f"{self.path} is closed")
            if id in self._ids:
                raise ValueError(f"Journal.append: the id {id!r} was used by edit {self._ids[id]}")
            seq = len(self._starts) + 1
            record = Record(seq, id, time.time_ns(), by, window, op, tuple(changes), group, tuple(undoes), data)
            line, future = encode(record), Future[Record]()
            if len(line) > LONGEST_LINE:
                raise RefusedError(
                    "long",
                    f"the edit changes {len(record.changes)} objects at once: {len(line) >> 20} MiB of the journal, "
                    f"of which one line may hold {LONGEST_LINE >> 20}. Nothing was changed.",
                    "Do it in several parts, such as some of the frames at a time.",
                )
            future.set_running_or_notify_cancel()  # whoever waits may go away; the edit stays
            self._take(record)
            self._starts.append(self._end)
            self._end += len(line)
            self._ids[id] = seq
            self._waiting.append((line, record, future))
            self._changed.notify()
        return record, future

    def read(self, seq: int) -> Record:
        """An edit by its number.

        Raises:
            IndexError: If there is none.
        """
        with self._changed:
            if not 1 <= seq <= len(self._starts):
                raise IndexError(f"{self.path}: expected an edit from 1 to {len(self._starts)}, got {seq}")
            waiting = {record.seq: record for _, record, _ in (*self._writing, *self._waiting)}
            if seq in waiting:
                return waiting[seq]
            start, end = self._starts[seq - 1], self._starts[seq] if seq < len(self._starts) else self._end
        with open_file(self.path, max_bytes=None) as handle:
            handle.seek(start)
            return decode(handle.read(end - start))

    def pending(self, seq: int) -> "Future[Record]":
        """A future that is done when the edit is on the disk, also long after."""
        with self._changed:
            for _, record, future in (*self._writing, *self._waiting):
                if record.seq == seq:
                    return future
        future = Future[Record]()
        future.set_result(self.read(seq))
        return future

    def _write(self) -> None:
        while True:
            with self._changed:
                while not self._waiting and not self._closing:
                    self._changed.wait()
                if not self._waiting:
                    return
                self._writing, self._waiting = self._waiting, []
                batch = self._writing
            try:
                rest = memoryview(b"".join(line for line, _, _ in batch))
                while rest:
                    rest = rest[os.write(self._file, rest) :]
                os.fsync(self._file)
            except OSError as error:
                self._fail(error)
                return
            with self._changed:
                self._writing = []
            for _, record, future in batch:
                future.set_result(record)

    def _fail(self, error: OSError) -> None:
        """Take no more edits; whatever was taken in and is not on the disk is no edit."""
        with self._changed:
            self._failure = (
                f"{self.path}: edits could not be written ({error.strerror or error}). Those that were acknowledged "
                "are safe. Make room or repair the disk, then start the studio again."
            )
            futures = [future for _, _, future in (*self._writing, *self._waiting)]
            self._writing, self._waiting = [], []
        try:
            self._failed()
        except (FarfieldError, OSError) as fault:
            self._failure += f" Nor could the journal be read again: {fault}"
        finally:  # whatever happens, those that wait are told
            for future in futures:
                future.set_exception(JournalError(self._failure))

    def close(self) -> None:
        """Write what waits and let the journal go."""
        with self._changed:
            if self._closing:
                return
            self._closing = True
            self._changed.notify()
        self._thread.join()
        os.close(self._file)
        os.close(self._held)

    def __enter__(self) -> "EditJournal":
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _sync_folder(folder: Path) -> None:
    """Bring a new name in a folder to the disk."""
    if os.name != "posix":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


LOCK = "lock"
MOUNTS = Path("/proc/self/mounts")
NETWORK = ("nfs", "nfs4", "cifs", "smb3", "fuse.sshfs")


def hold(folder: Path) -> int:
    """Hold a journal's folder; the handle holds it until it is closed or the process ends.

    Args:
        folder: The folder.

    Raises:
        JournalHeldError: If another process holds it.
    """
    network = network_file_system(folder)
    if network:
        warnings.warn(
            f"{folder}: stands on a network file system ({network}), whose locks and writes may not be kept: annotate "
            "a copy on a local disk, or open these labels on one machine only",
            stacklevel=3,
        )
    handle = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        _lock(handle, folder)
    except BlockingIOError:
        pid = os.read(handle, 32).decode("ascii", "replace").strip()
        os.close(handle)
        raise JournalHeldError(str(folder), int(pid) if pid.isdigit() else 0) from None
    os.ftruncate(handle, 0)
    os.write(handle, f"{os.getpid()}\n".encode())
    return handle


def _lock(handle: int, folder: Path) -> None:
    try:
        lock(handle)
    except BlockingIOError:
        raise
    except OSError as error:  # some network file systems
        warnings.warn(f"{folder}: cannot be locked ({error}): open these labels once only", stacklevel=4)


def network_file_system(folder: Path) -> str:
    """Kind of the network file system on which a folder stands; empty where it is a local one, or not known."""
    try:
        mounts = [line.split(" ")[1:3] for line in MOUNTS.read_text(errors="replace").splitlines()]
    except OSError:  # no such list on this system
        return ""
    real_folder = folder.resolve()
    over = [(len(point), kind) for point, kind in mounts if real_folder.is_relative_to(point.replace("\\040", " "))]
    kind = max(over, default=(0, ""))[1]
    return kind if kind in NETWORK else ""
