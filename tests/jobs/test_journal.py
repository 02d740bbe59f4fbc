"""The journal: resuming, damage, interruption, group commit, order, values."""

import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from farfield.errors import FileFormatError
from farfield.jobs import JobJournal, JobOptions, Outcome, Unit, run
from farfield.jobs.folders import STAGING
from farfield.jobs.journal import mark_of, state_of
from jobs.works import Copy, sources


def copied(
    units: list[Unit], out: Path, bulk: JobOptions | None = None, fatal: str = "", setting: str = "a"
) -> Outcome:
    out.mkdir(exist_ok=True)
    return run(Copy(out, fatal), units, bulk or JobOptions(), journal=JobJournal(out / ".journal", setting))


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def counts(outcome: Outcome) -> tuple[int, int]:
    return outcome.written, outcome.skipped


def test_the_same_files_and_journal_whoever_worked_and_whatever_died(tmp_path: Path) -> None:
    units = sources(tmp_path / "in")
    assert counts(copied(units, tmp_path / "one")) == (12, 0)
    expected = contents(tmp_path / "one")
    assert len(expected) == 13
    assert counts(copied(units, tmp_path / "two", JobOptions(workers=2))) == (12, 0)
    assert contents(tmp_path / "two") == expected
    (tmp_path / "killed").mkdir()
    assert counts(copied(units, tmp_path / "killed" / "out", JobOptions(workers=2), fatal="05")) == (12, 0)
    assert (tmp_path / "killed" / "died").exists()
    assert contents(tmp_path / "killed" / "out") == expected
    assert counts(copied(units[::-1], tmp_path / "back")) == (12, 0)
    assert contents(tmp_path / "back") == expected


def test_only_what_changed_is_done_again(tmp_path: Path) -> None:
    units, out = sources(tmp_path / "in"), tmp_path / "out"
    copied(units, out)
    expected = contents(out)
    assert counts(copied(units, out)) == (0, 12)
    time.sleep(0.01)
    (out / "03.txt").write_text("x" * (out / "03.txt").stat().st_size)  # damaged, of the same size
    (out / "04.txt").unlink()
    with (out / "05.txt").open("a") as handle:
        handle.write("more")
    assert counts(copied(units, out)) == (3, 9)
    assert contents(out) == expected
    (tmp_path / "in" / "07.in").write_text("other words")
    assert counts(copied(units, out)) == (1, 11)
    assert counts(copied(units, out, setting="b")) == (12, 0)


def test_files_that_were_copied_elsewhere_are_compared_by_their_bytes(tmp_path: Path) -> None:
    units, out = sources(tmp_path / "in"), tmp_path / "out"
    copied(units, out)
    for path in out.glob("*.txt"):
        os.utime(path, (2e9, 2e9))
    assert counts(copied(units, out)) == (0, 12)
    journal = JobJournal(out / ".journal", "a")
    (out / "03.txt").write_bytes(b"x" * (out / "03.txt").stat().st_size)
    os.utime(out / "03.txt", (1, 1))  # as old as the rest: only every byte tells
    assert journal.has(units[3])
    assert journal.fault(units[3], every_byte=True) == "damaged or missing: 03.txt"


def test_a_killed_command_loses_at_most_the_last_moment_and_goes_on(tmp_path: Path) -> None:
    units, out = sources(tmp_path / "in"), tmp_path / "out"
    copied(units, tmp_path / "whole")
    out.mkdir()
    code = f"""
from pathlib import Path
from jobs.works import Copy, sources
from farfield.jobs import JobJournal, JobOptions, Unit, run
folder, out = Path({str(tmp_path / "in")!r}), Path({str(out)!r})
units = [Unit(f"{{n:02d}}", (folder / f"{{n:02d}}.in",), n) for n in range(12)]
run(Copy(out, pause_s=0.15), units, JobOptions(workers=2), journal=JobJournal(out / ".journal", "a"))
"""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(entry for entry in sys.path if entry)}
    command = subprocess.Popen([sys.executable, "-c", code], env=environment)
    until = time.monotonic() + 60
    while len(list(out.glob("*.txt"))) < 6:
        assert time.monotonic() < until
        time.sleep(0.005)
    command.send_signal(signal.SIGKILL)
    command.wait(30)
    time.sleep(0.5)  # its workers notice
    there = len(list(out.glob("*.txt")))
    (out / ".99.txt.0123456789ab.part").write_text("left")
    (out / f"{STAGING}1").mkdir()
    done = copied(units, out)
    assert done.skipped >= there - 3
    assert done.written >= 12 - there
    assert contents(out) == contents(tmp_path / "whole")


def test_lines_are_written_a_moment_later_or_a_hundred_together(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("farfield.jobs.journal.GROUP_S", 2.0)  # no moment passes between two of the lines below
    journal = JobJournal(tmp_path / ".journal")
    for number in range(250):
        journal.add(Unit(str(number)), "", {})
    assert (tmp_path / ".journal").read_bytes().count(b"\n") == 200
    until = time.monotonic() + 20
    while (tmp_path / ".journal").read_bytes().count(b"\n") < 250:
        assert time.monotonic() < until
        time.sleep(0.01)
    assert len(JobJournal(tmp_path / ".journal")) == 250


def test_a_disk_that_is_full_leaves_no_half_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Half of what waits reaches the disk, in the thread that writes a moment later too; then there is room again."""
    path = tmp_path / ".journal"
    journal = JobJournal(path, "s")
    journal.add(Unit("a"), "", {})
    journal.commit()
    before, real = path.read_bytes(), os.write
    monkeypatch.setattr(os, "write", half_written)
    monkeypatch.setattr(os, "fsync", disk_full)
    journal.add(Unit("b"), "", {})
    time.sleep(0.3)
    assert capsys.readouterr().err == ""
    with pytest.raises(OSError, match="No space"):
        journal.commit()
    assert path.read_bytes() == before
    monkeypatch.setattr(os, "write", real)
    monkeypatch.undo()
    journal.add(Unit("c"), "", {})
    journal.finish()
    assert len(JobJournal(path, "s")) == 3
    assert path.read_bytes().count(b"\n") == 3


def half_written(handle: int, data: bytes) -> int:
    return os.pwrite(handle, bytes(data)[: max(1, len(data) // 2)], os.fstat(handle).st_size)


def disk_full(*_: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def test_values_are_read_one_at_a_time_and_a_cut_line_is_dropped(tmp_path: Path) -> None:
    path = tmp_path / ".journal"
    journal, units = JobJournal(path, "s"), [Unit(name) for name in "cab"]
    for number, unit in enumerate(units):
        journal.add(unit, state_of((), "s"), {}, [number, "ä\t\n"])
    assert list(journal.values("abc")) == [[1, "ä\t\n"], [2, "ä\t\n"], [0, "ä\t\n"]]
    journal.finish()
    assert list(journal.values("abc")) == [[1, "ä\t\n"], [2, "ä\t\n"], [0, "ä\t\n"]]
    whole = path.read_bytes()
    assert [line.split(b'"')[3] for line in whole.splitlines()] == [b"a", b"b", b"c"]
    path.write_bytes(whole + b'{"unit": "d", "sour')
    again = JobJournal(path, "s")
    assert path.read_bytes() != whole  # whoever only reads changes nothing: another command may be writing the line
    assert [again.has(unit) for unit in units] == [True] * 3
    assert list(again.values("ca")) == [[0, "ä\t\n"], [1, "ä\t\n"]]


GOOD = b'{"unit": "a", "source": "s", "files": {}}\t1\n'


@pytest.mark.parametrize(
    "line",
    [
        b"words\n",
        b"[]\n",
        b'{"unit": "a"}\n',
        b'{"unit": "a", "source": "", "files": {"../x": [1, 2]}}\n',
        b'{"unit": "a", "source": "", "files": {"/etc/passwd": [1, 2]}}\n',
        b'{"unit": "a", "source": "", "files": {"x": 3}}\n',
    ],
)
def test_what_is_no_journal_is_refused(line: bytes, tmp_path: Path) -> None:
    path = tmp_path / ".journal"
    path.write_bytes(line + GOOD)
    with pytest.raises(FileFormatError, match=r"line 1: expected a journal entry.*Delete that line.*--overwrite"):
        JobJournal(path)
    assert len(JobJournal(path, overwrite=True)) == 0


@pytest.mark.parametrize(
    "torn",
    [
        b"\0" * 40,
        b"\0" * 40 + b"\n",
        b'{"unit": "d", "sour\0\0\0\n',
        b'{"unit": "d", "source": "s", "files": {}}\t[1, 2\n',
        b'{"unit": "d", "source": "s", "files": {}}\t[1, \0\0]\n',
        b'{"unit": "d"',
        b"words\n",
    ],
)
def test_a_damaged_last_line_is_left_out_and_its_unit_done_again(torn: bytes, tmp_path: Path) -> None:
    path = tmp_path / ".journal"
    path.write_bytes(GOOD + torn)
    journal = JobJournal(path, "s")
    assert list(journal.values(["a"])) == [1]
    assert path.read_bytes() == GOOD + torn
    journal.add(Unit("d"), state_of((), "s"), {}, [2])
    journal.finish()
    assert list(JobJournal(path, "s").values("ad")) == [1, [2]]
    assert b"\0" not in path.read_bytes()


@pytest.mark.parametrize("damage", [b"[1, \0\0]", b"[1, 2"])
def test_a_damaged_value_elsewhere_is_named_by_its_line(damage: bytes, tmp_path: Path) -> None:
    path = tmp_path / ".journal"
    path.write_bytes(
        GOOD + b'{"unit": "b", "source": "s", "files": {}}\t' + damage + b"\n" + GOOD.replace(b'"a"', b'"c"')
    )
    with pytest.raises(FileFormatError, match=r"line 2: expected a journal entry.*Delete that line"):
        list(JobJournal(path, "s").values("abc"))


def test_marks_are_size_and_checksum(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"123456789")
    assert mark_of(tmp_path / "a") == (9, 0xCBF43926)  # the published check value of CRC-32
