"""A pipe under the name of a file is refused at once: opening it would wait for a writer that never comes."""

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from farfield.datasets import contents
from farfield.errors import FileFormatError
from farfield.files import bag_guard, clock_logs
from farfield.frame.cloud import is_fresh, write_rows_cache
from farfield.inspection.doctor.survey import SurveyBlock, _digest_files
from farfield.jobs import JobJournal, Unit
from farfield.jobs.journal import mark_of, state_of
from farfield.sync.synchronising import read_match_table

if not hasattr(os, "mkfifo"):
    pytest.skip("no pipes with names", allow_module_level=True)

READERS: dict[str, Callable[[Path], Any]] = {
    "a checksum": mark_of,
    "a cache": lambda path: write_rows_cache(path, path.parent),
    "a digest": contents._contents,
    "a clock's log": clock_logs.is_clock_log,
    "a bag's size": bag_guard._check_size,
    "a bag's records": bag_guard.check_records,
    "a bag's kind": bag_guard.check_kind,
    "matches": read_match_table,
}


def _hung(number: int, frame: FrameType | None) -> None:
    del number, frame
    raise TimeoutError("it waits")


@pytest.fixture(autouse=True)
def alarm() -> Iterator[None]:
    before = signal.signal(signal.SIGALRM, _hung)
    signal.alarm(5)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("name", READERS)
def test_a_pipe_is_refused(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / "a.xyz")
    with pytest.raises(FileFormatError, match="expected a regular file, found a device or a pipe"):
        READERS[name](tmp_path / "a.xyz")


def test_a_pipe_in_place_of_what_a_journal_names_is_made_again(tmp_path: Path) -> None:
    (tmp_path / "made").write_bytes(b"")
    journal = JobJournal(tmp_path / "journal")
    journal.add(Unit("a"), state_of((), ""), {"made": mark_of(tmp_path / "made")})
    journal.finish()
    assert JobJournal(tmp_path / "journal").fault(Unit("a"), every_byte=True) == ""
    (tmp_path / "made").unlink()
    os.mkfifo(tmp_path / "made")
    for every_byte in (False, True):
        fault = JobJournal(tmp_path / "journal").fault(Unit("a"), every_byte=every_byte)
        assert fault == "damaged or missing: made"


def test_a_pipe_in_place_of_a_cached_cloud_is_refused(tmp_path: Path) -> None:
    source = tmp_path / "a.xyz"
    source.write_text("1 2 3 4 5\n")
    cached = write_rows_cache(source, tmp_path)
    assert is_fresh(cached, source)
    source.unlink()
    os.mkfifo(source)
    assert not is_fresh(cached, source)


def test_the_doctor_counts_no_pipe(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.npy")
    (tmp_path / "b.npy").write_bytes(b"points")
    block = SurveyBlock()
    _digest_files(block, [tmp_path / "a.npy", tmp_path / "b.npy"])
    assert [*block.clouds_by_digest.values()] == [[str(tmp_path / "b.npy")]]
