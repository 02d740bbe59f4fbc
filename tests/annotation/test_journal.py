"""The journal: acknowledged means on the disk, once, by one process."""

import asyncio
import contextlib
import os
import subprocess
import sys
import threading
from concurrent.futures import Future, wait
from pathlib import Path
from typing import Any

import pytest

from farfield.annotation import journal as module
from farfield.annotation.errors import JournalError, JournalHeldError, RefusedError
from farfield.annotation.journal import EditJournal
from farfield.datasets.edits import CellEdit, Record, encode, read_journal
from farfield.datasets.edits import journal as edits_journal
from farfield.errors import FileFormatError

CELL = ("box", "a", "0001", "4")


def _ignored(record: Record) -> None:
    del record


def _append(journal: EditJournal, name: str, value: Any = 0) -> tuple[Record, "Future[Record]"]:
    return journal.append(id=name, by="ann", window="w", op="box.set", changes=[CellEdit(CELL, 0, None, value)])


def _read(path: Path) -> list[Record]:
    found: list[Record] = []
    read_journal(path, found.append)
    return found


def test_acknowledged_is_on_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[int] = []
    real = os.fsync
    monkeypatch.setattr(module.os, "fsync", lambda handle: (synced.append(os.fstat(handle).st_size), real(handle)))
    with EditJournal(tmp_path, _ignored) as journal:
        record, done = _append(journal, "a")
        assert done.result(10) == record
        assert synced[-1] == journal.path.stat().st_size == len(encode(record))
    assert _read(journal.path) == [record]


def test_edits_that_wait_share_one_fsync(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls, gate, real = [], threading.Event(), os.fsync
    with EditJournal(tmp_path, _ignored) as journal:
        monkeypatch.setattr(module.os, "fsync", lambda handle: (gate.wait(10), calls.append(handle), real(handle)))
        futures = [_append(journal, f"e{number}")[1] for number in range(100)]
        assert not any(future.done() for future in futures)
        assert journal.read(100).id == "e99"  # also before it is on the disk
        gate.set()
        wait(futures, 10)
        assert len(calls) <= 3
    assert [record.seq for record in _read(journal.path)] == [*range(1, 101)]


@pytest.mark.parametrize("value", [10**20, -(10**400), "\ud800", {1: 2, "1": 3}])
def test_what_could_not_be_read_again_is_not_written(tmp_path: Path, value: Any) -> None:
    with EditJournal(tmp_path, _ignored) as journal:
        _append(journal, "a")[1].result(10)
        size = journal.path.stat().st_size
        with contextlib.suppress(ValueError):
            _append(journal, "b", value)[1].result(10)
        _append(journal, "c")[1].result(10)
        assert journal.path.stat().st_size > size
    records = _read(tmp_path / "edits.jsonl")
    assert records[-1].id == "c"
    assert [record.seq for record in records] == [*range(1, len(records) + 1)]


def test_an_id_is_recognised_after_a_restart(tmp_path: Path) -> None:
    with EditJournal(tmp_path, _ignored) as journal:
        record = _append(journal, "a", 7)[0]
        with pytest.raises(ValueError, match="used by edit 1"):
            _append(journal, "a", 8)
    seen: list[Record] = []
    with EditJournal(tmp_path, seen.append) as journal:
        assert seen == [record]
        assert journal.seq_of("a") == 1
        assert journal.seq_of("b") is None
        assert journal.pending(1).result(0) == record
        with pytest.raises(ValueError, match="used by edit 1"):
            _append(journal, "a", 8)
        assert _append(journal, "b")[0].seq == 2


def test_a_torn_end_is_dropped_and_kept_aside(tmp_path: Path) -> None:
    with EditJournal(tmp_path, _ignored) as journal:
        first = _append(journal, "a")[0]
    torn = encode(first._replace(seq=2, id="b"))[:-5]
    with journal.path.open("ab") as handle:
        handle.write(torn)
    with pytest.warns(UserWarning, match="line 2 is torn"):
        journal = EditJournal(tmp_path, _ignored)
    with journal:
        assert len(journal) == 1
        third = _append(journal, "c")[0]
    assert (tmp_path / "edits.jsonl.torn-2").read_bytes() == torn
    assert _read(journal.path) == [first, third]


def test_a_damaged_line_stops_and_lets_go(tmp_path: Path) -> None:
    with EditJournal(tmp_path, _ignored) as journal:
        for name in "abc":
            _append(journal, name)
    data = journal.path.read_bytes()
    journal.path.write_bytes(data.replace(b'"id":"b"', b'"id":"x"'))
    for _ in range(2):  # the lock was let go
        with pytest.raises(FileFormatError, match="line 2"):
            EditJournal(tmp_path, _ignored)
    assert journal.path.read_bytes() != data


def test_a_second_process_is_refused_with_the_first_ones_number(tmp_path: Path) -> None:
    code = (
        "import sys, pathlib\nfrom farfield.annotation.journal import EditJournal\n"
        "with EditJournal(pathlib.Path(sys.argv[1]), print):\n    print('open', flush=True)\n    sys.stdin.read()"
    )
    command = [sys.executable, "-c", code, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as first:
        assert first.stdout is not None
        assert first.stdout.readline() == "open\n"
        with pytest.raises(JournalHeldError, match=f"process {first.pid} "):
            EditJournal(tmp_path, _ignored)
        first.communicate("")
    EditJournal(tmp_path, _ignored).close()


def test_a_network_file_system_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mounts = tmp_path / "mounts"
    mounts.write_text(f"/dev/a / ext4 rw 0 0\nhost:/x {tmp_path.resolve()}/far\\040away nfs4 rw 0 0\n")
    monkeypatch.setattr("farfield.annotation.journal.MOUNTS", mounts)
    EditJournal(tmp_path / "near", _ignored).close()
    with pytest.warns(UserWarning, match="nfs4"):
        EditJournal(tmp_path / "far away", _ignored).close()


def test_a_full_disk_is_said_and_acknowledged_edits_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with EditJournal(tmp_path, _ignored) as journal:
        first, done = _append(journal, "a")
        done.result(10)
        with monkeypatch.context() as patch:
            patch.setattr(module.os, "write", lambda handle, data: _full())
            lost = _append(journal, "b")[1]
            with pytest.raises(JournalError, match="No space left"):
                lost.result(10)
        with pytest.raises(JournalError, match="No space left"):
            _append(journal, "c")
        assert "No space left" in journal.failure
    assert _read(journal.path) == [first]


def test_whoever_waits_is_told_where_the_journal_cannot_be_read_again_either(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with EditJournal(tmp_path, _ignored, _unreadable) as journal, monkeypatch.context() as patch:
        patch.setattr(module.os, "write", lambda handle, data: _full())
        with pytest.raises(JournalError, match=r"No space left.*Nor could the journal be read again.*Input/output"):
            _append(journal, "a")[1].result(10)
        with pytest.raises(JournalError, match="Nor could the journal be read again"):
            _append(journal, "b")


def _unreadable() -> None:
    raise OSError(5, "Input/output error")


def _full() -> int:
    raise OSError(28, "No space left on device")


def test_many_threads_append(tmp_path: Path) -> None:
    with EditJournal(tmp_path, _ignored) as journal:
        threads = [threading.Thread(target=_appends, args=(journal, f"t{n}")) for n in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    found = _read(journal.path)
    assert [record.seq for record in found] == [*range(1, 201)]
    for n in range(8):  # each thread's in its order
        assert [r.id for r in found if r.id.startswith(f"t{n}-")] == [f"t{n}-{place}" for place in range(25)]


def _appends(journal: EditJournal, name: str) -> None:
    for place in range(25):
        _append(journal, f"{name}-{place}")


def test_whoever_waits_may_go_away(tmp_path: Path) -> None:
    with EditJournal(tmp_path, _ignored) as journal:
        asyncio.run(_cancelled(journal))
        assert _append(journal, "b")[1].result(10).seq == 2
    assert len(_read(journal.path)) == 2


async def _cancelled(journal: EditJournal) -> None:
    waiting = asyncio.ensure_future(asyncio.wrap_future(_append(journal, "a")[1]))
    await asyncio.sleep(0)
    waiting.cancel()
    with pytest.raises(asyncio.CancelledError):
        await waiting


def test_a_closed_journal_takes_nothing(tmp_path: Path) -> None:
    journal = EditJournal(tmp_path, _ignored)
    journal.close()
    journal.close()
    with pytest.raises(JournalError, match="closed"):
        _append(journal, "a")
    with pytest.raises(IndexError, match="from 1 to 0"):
        journal.read(1)


def test_an_edit_longer_than_the_reader_takes_is_refused_and_nothing_is_stored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for reading_or_writing in (module, edits_journal):
        monkeypatch.setattr(reading_or_writing, "LONGEST_LINE", 2000, raising=False)
    with EditJournal(tmp_path, _ignored) as journal:
        room = 2000 - len(encode(_append(journal, "a", "")[0]))
        _append(journal, "b", "x" * room)[1].result(10)
        with pytest.raises(RefusedError, match="Nothing was changed"):
            _append(journal, "c", "x" * (room + 1))
        assert journal.seq_of("c") is None
        _append(journal, "d")[1].result(10)
    with EditJournal(tmp_path, _ignored) as journal:
        assert [record.id for record in _read(journal.path)] == ["a", "b", "d"]
