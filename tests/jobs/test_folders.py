"""What a command writes is held against others, by the operating system: nothing that is left behind blocks."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from farfield.errors import ConfigError
from farfield.jobs import JobJournal, JobOptions, folders, run
from farfield.jobs.folders import held
from jobs.works import Copy, sources

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="other locks")
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(entry for entry in sys.path if entry)}


def holder(out: Path, *, file: bool) -> subprocess.Popen:
    """A process that holds something until it is ended."""
    code = f"""
import sys, pathlib
from farfield.jobs.folders import held
with held(pathlib.Path({str(out)!r}), file={file}):
    print("held", flush=True)
    sys.stdin.read()
"""
    pipe = subprocess.PIPE
    other = subprocess.Popen([sys.executable, "-c", code], env=ENVIRONMENT, stdin=pipe, stdout=pipe, text=True)
    assert other.stdout is not None
    assert other.stdout.readline() == "held\n"
    return other


@pytest.mark.parametrize("file", [False, True])
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_one_command_is_refused_while_another_writes_and_none_after_a_kill(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, file: bool
) -> None:
    monkeypatch.setattr(folders, "_PATIENCE_S", 0.3)
    out = tmp_path / "out"
    with holder(out, file=file) as other:
        with (
            pytest.raises(ConfigError, match=r"out: expected no other command that writes there.* Wait until"),
            held(out, file=file),
        ):
            pass
        with held(tmp_path / "beside", file=file):  # what stands beside it is free
            pass
        other.send_signal(number)
        other.wait(30)
        with held(out, file=file):
            pass
    assert [*tmp_path.iterdir()] == ([] if file else [out])  # the folder was made by the one that was killed


def test_one_waits_for_what_a_killed_command_still_does(tmp_path: Path) -> None:
    with holder(tmp_path, file=False) as other:
        killer = threading.Timer(0.5, other.kill)
        killer.start()
        began = time.monotonic()
        with held(tmp_path):
            assert time.monotonic() - began > 0.3
        killer.join()


def test_a_thread_may_hold_again_what_it_holds_and_another_may_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(folders, "_PATIENCE_S", 0.2)
    refused: list[str] = []
    with held(tmp_path / "out"):
        with held(tmp_path / "out" / ".." / "out"):
            pass
        thread = threading.Thread(target=hold_or_note, args=(tmp_path / "out", refused))
        thread.start()
        thread.join()
        assert len(refused) == 1
        (tmp_path / "out" / "a").touch()
    hold_or_note(tmp_path / "out", refused)
    assert len(refused) == 1


def hold_or_note(out: Path, refused: list[str]) -> None:
    try:
        with held(out):
            pass
    except ConfigError as error:
        refused.append(str(error))


def test_the_workers_of_a_killed_command_hold_its_folder_until_they_have_ended(tmp_path: Path) -> None:
    units, out = sources(tmp_path / "in", 4), tmp_path / "out"
    code = f"""
from pathlib import Path
from jobs.works import Copy, sources
from farfield.jobs import JobJournal, JobOptions, run
from farfield.jobs.folders import held
out = Path({str(out)!r})
with held(out):
    run(Copy(out, pause_s=30), sources(Path({str(tmp_path / "in")!r}), 4), JobOptions(workers=2),
        journal=JobJournal(out / ".journal", "a"))
"""
    command = subprocess.Popen([sys.executable, "-c", code], env=ENVIRONMENT)
    until = time.monotonic() + 60
    import psutil

    while len(workers := psutil.Process(command.pid).children()) < 2:
        assert time.monotonic() < until
        time.sleep(0.01)
    time.sleep(1.0)  # they are at their first units
    command.kill()
    command.wait(30)
    with held(out):
        assert not [worker for worker in workers if worker.is_running() and worker.status() != "zombie"]
        run(Copy(out), units, JobOptions(), journal=JobJournal(out / ".journal", "a"))


def test_what_killed_commands_left_is_swept_out_when_something_is_held(tmp_path: Path) -> None:
    (tmp_path / "inner").mkdir()
    (tmp_path / "other").mkdir()
    left = [tmp_path / ".a.csv.0123456789ab.part", tmp_path / "inner" / ".b.0123456789ab.part"]
    stay = [tmp_path / ".mine.part", tmp_path / "other" / ".c.0123456789ab.part"]
    for path in (*left, *stay):
        path.touch()
    with holder(tmp_path / "other", file=False) as other:
        # the holder swept its own folder: another command's file comes and goes there
        stay[1].touch()
        with held(tmp_path):
            assert [path.exists() for path in (*left, *stay)] == [False, False, True, True]
        other.kill()
    left[0].touch()
    left[1] = tmp_path / "..farfield_outputs.0123456789ab.part"
    left[1].touch()
    with held(tmp_path / "b.csv", file=True):
        assert [path.exists() for path in left] == [True, False]
    with held(tmp_path / "a.csv", file=True):
        assert not left[0].exists()


def test_a_file_system_without_locks_is_written_all_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(9, "as NFS says of an exclusive lock on a folder")

    monkeypatch.setattr("fcntl.flock", refuse)
    with held(tmp_path / "out"):
        assert (tmp_path / "out").is_dir()
    assert not (tmp_path / "out").exists()  # nothing was written into it


def test_a_part_that_is_being_written_without_a_lock_on_its_name_stays(tmp_path: Path) -> None:
    code = f"""
import sys, pathlib
from farfield.files.atomic import open_atomic
with open_atomic(pathlib.Path({str(tmp_path / "inner" / "a.csv")!r})) as handle:
    handle.write(b"rows")
    handle.flush()
    print("begun", flush=True)
    sys.stdin.read()
"""
    (tmp_path / "inner").mkdir()
    pipe = subprocess.PIPE
    for ended in ("killed", "done"):
        with subprocess.Popen([sys.executable, "-c", code], env=ENVIRONMENT, stdin=pipe, stdout=pipe) as writer:
            assert writer.stdout is not None
            assert writer.stdout.readline() == b"begun\n"
            for out, file in ((tmp_path, False), (tmp_path / "inner", False), (tmp_path / "inner" / "a.csv", True)):
                with held(out, file=file):
                    folders.sweep_out(tmp_path)
                assert len([*(tmp_path / "inner").glob(".a.csv.*.part")]) == 1
            if ended == "killed":
                writer.kill()
                writer.wait(30)
                with held(tmp_path):
                    assert not [*(tmp_path / "inner").iterdir()]
    assert [path.name for path in (tmp_path / "inner").iterdir()] == ["a.csv"]


def test_locks_of_files_that_killed_commands_left_are_swept_out_and_no_others(tmp_path: Path) -> None:
    with holder(tmp_path / "scores.json", file=True) as other:
        other.kill()
    assert (tmp_path / ".scores.json.lock").exists()
    (tmp_path / ".mine.lock").write_text("")
    with holder(tmp_path / "other.json", file=True) as other:
        with held(tmp_path):
            names = sorted(path.name for path in tmp_path.iterdir())
            assert names == [".mine.lock", ".other.json.lock"]
        other.kill()
    assert (tmp_path / ".mine.lock").exists()


def test_a_signal_while_a_lock_ends_leaves_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def signalled(self: Path, missing_ok: bool = False) -> None:
        monkeypatch.undo()
        raise SystemExit(143)

    with pytest.raises(SystemExit), held(tmp_path / "a.json", file=True):
        monkeypatch.setattr(Path, "unlink", signalled)
    assert not [*tmp_path.iterdir()]
    with held(tmp_path / "a.json", file=True):
        pass


def test_a_link_to_itself_ends_no_sweep(tmp_path: Path) -> None:
    parts = [tmp_path / f".{name}.0123456789ab.part" for name in "abcdef"]
    for path in parts[1:-1]:
        path.touch()
    for path in (parts[0], parts[-1], tmp_path / ".a.lock"):
        path.symlink_to(path.name)
    (tmp_path / ".b.lock").write_bytes(b"farfield\n")
    with held(tmp_path):
        assert [path.name for path in parts if path.exists()] == []
        assert not (tmp_path / ".b.lock").exists()
        parts[1].touch()
        folders.sweep_out(tmp_path)
        assert not parts[1].exists()


@pytest.mark.parametrize("kind", ["link", "pipe"])
def test_a_lock_is_a_regular_file_and_no_link_is_followed(tmp_path: Path, kind: str) -> None:
    (tmp_path / "data").mkdir()
    lock = tmp_path / "data" / ".a.json.lock"
    if kind == "link":
        lock.symlink_to(tmp_path / "elsewhere")
    else:
        os.mkfifo(lock)
    with (
        pytest.raises(ConfigError, match=r"\.a\.json\.lock: expected a regular file .*Delete it"),
        held(tmp_path / "data" / "a.json", file=True),
    ):
        pass
    assert not (tmp_path / "elsewhere").exists()


def test_a_file_within_a_held_folder_is_held_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(folders, "_PATIENCE_S", 0.2)
    with holder(tmp_path / "a.json", file=True) as other:
        with (
            held(tmp_path),
            pytest.raises(ConfigError, match=r"a\.json: expected no other command"),
            held(tmp_path / "a.json", file=True),
        ):
            pass
        other.kill()


def test_who_waits_says_so_again_and_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(folders, "_REMINDER_S", 0.1, raising=False)
    monkeypatch.setattr(folders, "_PATIENCE_S", 0.2)
    lines: list[float] = []
    with holder(tmp_path, file=False) as other:
        killer = threading.Timer(0.8, other.kill)
        killer.start()
        with held(tmp_path, waiting=lambda: lines.append(time.monotonic())):
            assert len(lines) > 3
        killer.join()


def test_a_folder_that_vanishes_again_and_again_is_tried_in_steps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(folders, "_PATIENCE_S", 0.3)
    calls: list[object] = []

    def missing(*words: object) -> int:
        calls.append(words)
        raise FileNotFoundError(2, "gone")

    monkeypatch.setattr(folders, "_opened", missing)
    with pytest.raises(FileNotFoundError), held(tmp_path / "out"):
        pass
    assert len(calls) < 20
