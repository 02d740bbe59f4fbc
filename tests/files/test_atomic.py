"""Writes are all or nothing; reads are bounded."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from farfield.errors import FileFormatError
from farfield.files import locking
from farfield.files.atomic import open_atomic, read_bytes, write_bytes, write_text


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_written_bytes_and_text_come_back(tmp_path: Path) -> None:
    write_bytes(tmp_path / "a.bin", b"\x00\xff\r\n")
    write_text(tmp_path / "b.txt", "grün\n")
    assert read_bytes(tmp_path / "a.bin") == b"\x00\xff\r\n"
    assert (tmp_path / "b.txt").read_bytes() == "grün\n".encode()
    assert names(tmp_path) == ["a.bin", "b.txt"]


@pytest.mark.parametrize("failure", [RuntimeError, KeyboardInterrupt, OSError])
def test_an_error_leaves_the_old_file_and_no_litter(tmp_path: Path, failure: type[BaseException]) -> None:
    path = tmp_path / "cloud.bin"
    write_bytes(path, b"old")
    with pytest.raises(failure), open_atomic(path) as handle:  # noqa: PT012
        handle.write(b"half of the n")
        raise failure
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["cloud.bin"]


def test_nothing_is_seen_under_the_name_before_the_end(tmp_path: Path) -> None:
    path = tmp_path / "cloud.bin"
    with open_atomic(path) as handle:
        handle.write(b"x" * 100_000)
        handle.flush()
        assert not path.exists()
    assert path.stat().st_size == 100_000


def test_a_process_killed_while_writing_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "cloud.bin"
    write_bytes(path, b"old")
    code = (
        "import os, signal, sys\nfrom farfield.files.atomic import open_atomic\n"
        "with open_atomic(sys.argv[1]) as handle:\n"
        "    handle.write(b'new'); handle.flush(); os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    finished = subprocess.run([sys.executable, "-c", code, str(path)], check=False)
    assert finished.returncode == -9
    assert path.read_bytes() == b"old"


def test_the_user_s_umask_decides_who_may_read(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        write_bytes(tmp_path / "a", b"")
    finally:
        os.umask(before)
    assert (tmp_path / "a").stat().st_mode & 0o777 == 0o640


def test_very_long_names_and_missing_folders(tmp_path: Path) -> None:
    write_bytes(tmp_path / ("n" * 250), b"1")
    assert names(tmp_path) == ["n" * 250]
    with pytest.raises(FileNotFoundError):
        write_bytes(tmp_path / "absent" / "a", b"1")


def test_too_large_a_file_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "huge"
    with path.open("wb") as handle:
        handle.truncate(1 << 40)  # 1 TiB of nothing: takes no room on the disk
    with pytest.raises(FileFormatError, match=r"huge, the file: expected at most 268435456 bytes, found 1099511627776"):
        read_bytes(path)


def test_devices_are_no_files() -> None:
    with pytest.raises(FileFormatError, match="expected a regular file"):
        read_bytes(os.devnull)


def test_a_file_that_took_the_name_of_a_swept_one_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / ".a.lock"
    path.touch()

    def replaced(handle: int) -> bool:
        path.rename(tmp_path / "old")
        path.write_text("another command's")
        return True

    monkeypatch.setattr(locking, "try_lock", replaced)
    assert not locking.remove_unlocked(path)
    assert path.read_text() == "another command's"


def test_a_full_disk_in_the_second_try_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = os.open

    def full(path: Path, flags: int, mode: int = 0o777) -> int:
        if any(tmp_path.glob(".*.part")):
            raise OSError(28, "No space left on device")
        return opened(path, flags, mode)

    monkeypatch.setattr("os.open", full)
    monkeypatch.setattr(locking, "try_lock", lambda handle: False)  # as if it was just being swept away
    with pytest.raises(OSError, match="No space left"):
        write_bytes(tmp_path / "a", b"")
