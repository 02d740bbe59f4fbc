"""A full disk: one sentence, no traceback, and the same command goes on once there is room."""

import errno
import os
import tempfile
import time
from pathlib import Path

import pytest

from farfield.jobs import JobJournal, Unit
from farfield.jobs.process import without_torch_folder

FULL = OSError(errno.ENOSPC, "No space left on device")


def test_a_journal_keeps_what_a_full_disk_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    journal = JobJournal(tmp_path / "journal", files=False)
    journal.add(Unit("a"), "s", {}, 1)
    journal.commit()
    before = (tmp_path / "journal").read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", _full)
        journal.add(Unit("b"), "s", {}, 2)
        time.sleep(0.3)  # its timer writes meanwhile, in a thread of its own
        assert "Traceback" not in capsys.readouterr().err
        assert (tmp_path / "journal").read_bytes() == before  # no half line
        with pytest.raises(OSError, match="No space left"):
            journal.commit()
    journal.finish()
    assert list(JobJournal(tmp_path / "journal", files=False).values(["a", "b"])) == [1, 2]


def _full(descriptor: int) -> None:
    del descriptor
    raise FULL


def test_an_empty_folder_of_torch_goes_and_others_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    pytest.importorskip("torch")
    (tmp_path / "torchinductor_before").mkdir()
    with without_torch_folder():
        (tmp_path / "torchinductor_me").mkdir()
        (tmp_path / "torchinductor_full" / "code").mkdir(parents=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["torchinductor_before", "torchinductor_full"]
