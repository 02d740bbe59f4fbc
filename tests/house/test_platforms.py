"""What Windows does not have stands in files.locking and behind questions: nothing else calls it."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SOURCE = ROOT / "src" / "farfield"
MODULES = {"fcntl", "resource", "pwd", "grp", "termios", "tty", "pty", "syslog"}
OS_NAMES = {
    *("fork", "forkpty", "getuid", "geteuid", "getgid", "getegid", "getpgid", "killpg", "setsid", "setpgid", "mkfifo"),
    *("mknod", "statvfs", "fstatvfs", "uname", "sched_getaffinity", "nice", "chown", "lchown", "fchown", "fchmod"),
    *("getloadavg", "sysconf", "pread", "pwrite", "posix_fallocate", "posix_fadvise", "wait", "waitid", "WNOHANG"),
    *("O_NOFOLLOW", "O_NONBLOCK", "O_DIRECTORY", "O_CLOEXEC", "getxattr", "setxattr", "fchdir", "chroot", "openpty"),
}
SIGNAL_NAMES = {
    *("SIGKILL", "SIGHUP", "SIGALRM", "SIGUSR1", "SIGUSR2", "SIGPIPE", "SIGSTOP", "SIGCONT", "SIGCHLD", "alarm"),
    *("setitimer", "getitimer", "pthread_sigmask", "pthread_kill", "sigwait", "siginterrupt", "pause"),
}
GUARDED = {
    ("files/locking.py", "fcntl"),  # behind sys.platform
    ("files/laz_worker.py", "resource"),  # where it can be imported
    ("privacy/anonymising.py", "resource"),  # the same
    ("jobs/process.py", "os.sched_getaffinity"),  # behind hasattr
    ("sizing/measuring.py", "os.getloadavg"),  # the same
    ("sizing/measuring.py", "os.posix_fadvise"),  # the same
}


def posix_only(tree: ast.AST) -> set[str]:
    """Modules, and attributes of os and signal, that a source uses and Windows does not have."""
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names} & MODULES
        elif isinstance(node, ast.ImportFrom):
            names |= {node.module or ""} & MODULES
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            lacking = {"os": OS_NAMES, "signal": SIGNAL_NAMES}.get(node.value.id, set())
            names |= {f"{node.value.id}.{node.attr}"} if node.attr in lacking else set()
    return names


def test_a_call_that_windows_lacks_is_noticed() -> None:
    source = "import os, signal\nfrom fcntl import flock\nos.fork()\nsignal.alarm(1)\nos.replace('a', 'b')\n"
    assert posix_only(ast.parse(source)) == {"fcntl", "os.fork", "signal.alarm"}


def test_only_guarded_lines_call_what_windows_lacks() -> None:
    uses = {
        (path.relative_to(SOURCE).as_posix(), name)
        for path in SOURCE.rglob("*.py")
        for name in posix_only(ast.parse(path.read_text("utf-8")))
    }
    assert uses == GUARDED


WITHOUT = """
import fcntl, os, signal, sys, types
locks = types.ModuleType("msvcrt")
locks.LK_NBLCK, locks.positions = 2, []
def locking(handle, kind, count):
    locks.positions.append(os.lseek(handle, 0, os.SEEK_CUR))
    try:
        fcntl.lockf(handle, fcntl.LOCK_EX | fcntl.LOCK_NB, count, 0, os.SEEK_CUR)
    except BlockingIOError as error:
        raise PermissionError(*error.args) from None
locks.locking = locking
import farfield.jobs.local, psutil, tempfile  # with what they take from the system themselves
for name in [name for name in sys.modules if name.startswith("farfield")]:
    del sys.modules[name]
sys.modules["msvcrt"], platform = locks, sys.platform
sys.platform = "win32"
import farfield.files.locking
sys.platform = platform
farfield.files.locking.sys = types.SimpleNamespace(platform="win32")
for name in MODULES:
    sys.modules[name] = None
for name in OS_NAMES:
    if hasattr(os, name):
        delattr(os, name)
for name in SIGNAL_NAMES:
    if hasattr(signal, name):
        delattr(signal, name)
from farfield.cli import main
status = main(sys.argv[1:])
assert status or not sys.argv[1].startswith("convert") or set(locks.positions) == {1 << 30}
raise SystemExit(status)
"""


@pytest.mark.slow
def test_verbs_run_without_what_windows_lacks(tmp_path: Path) -> None:
    """A stand-in: Windows' own paths, processes and locks have not been met by these tests."""
    data, kitti, labels = tmp_path / "own", tmp_path / "kitti", tmp_path / "labels.csv"
    lacking = OS_NAMES - {"statvfs"}  # shutil and psutil ask Windows in another way
    head = f"MODULES, OS_NAMES, SIGNAL_NAMES = {MODULES!r}, {lacking!r}, {SIGNAL_NAMES!r}\n"
    for words in (
        ("new-dataset", data),
        ("doctor", data),
        ("stats", data, "--json", tmp_path / "stats.json"),
        ("convert", data, kitti, "--to", "kitti", "--workers", "2"),
        ("convert", data, labels, "--to", "boxes-csv"),
        ("view", data, "--html", tmp_path / "view.html"),
        ("show", data, "--out", tmp_path / "frame.png"),
    ):
        command = [sys.executable, "-c", head + WITHOUT, *map(str, words)]
        done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
        assert done.returncode == 0, (words, done.stdout[-500:], done.stderr[-3000:])
    assert (tmp_path / "frame.png").is_file()
    assert any(kitti.rglob("*.txt"))
