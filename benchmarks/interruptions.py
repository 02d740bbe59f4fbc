"""Every verb that writes, killed, on a full disk, on a read-only one, and twice at once: what a rerun leaves.

``signals``: verbs that resume are ended 20 times, half by SIGTERM, half by SIGKILL, by turns with one and two workers,
in chains of five that go on where the one before was ended; all others four times. ``full_disk``: a small tmpfs, then a
larger one. ``read_only``: a tmpfs that is read only, then writable. ``twice``: two commands at the same moment. After
each the same command has to leave the bytes of one that nothing disturbed, no other file, and no process. The first of
a chain, and what a full disk or another command ends, are processes of their own; the others are forks of this one,
which has imported what they need.

What was tried is kept below ``build/``: a part that was interrupted, or tries some cases by ``--only``, goes on with
it, and its section has all rows that there are, each with its commit. A row that missed is tried again.
"""

import argparse
import contextlib
import hashlib
import json
import os

os.environ["OMP_NUM_THREADS"] = "1"  # read when torch is imported: a fork computes with as many threads as a process

import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil
from _forked_commands import ForkedCommand, import_all
from _interrupted_verbs import CASES, CLOCKS, DATA, LEFT_OUT, TIMING, VerbCase, chosen, lacking, verbs_without_case
from _report import MissingError, Part, Table, commit, part_parser, run_parts

from farfield.files.atomic import write_text
from farfield.frame.provenance import git_commit

SINGLE = 4
IMPORT_S = 2.0  # of CPU: torch
PATIENCE_S, GONE_S = 600.0, 20.0
_MARK = "FARFIELD_INTERRUPTION"
_AGAIN = "Run the same command again"
_REFUSED = "expected no other command that writes there"
ROOT = Path(__file__).resolve().parents[1]


@dataclass
class Undisturbed:
    """What a command leaves that nothing disturbs.

    Args:
        hashes: SHA-256 by name of its files, but for what the clock measured.
        names: All its files.
        cpu_s: Seconds of CPU that it takes.
        size: Bytes that it adds.
    """

    hashes: dict[str, str]
    names: set[str]
    cpu_s: float
    size: int


@dataclass
class Bench:
    """Where commands run, and what was found.

    Args:
        home: A folder for all.
        faults: What went wrong, a line each.
        sessions: Those of commands, by the name of the folder in which they work.
    """

    home: Path
    faults: list[str] = field(default_factory=list)
    count: int = 0
    sessions: dict[str, list[int]] = field(default_factory=dict)

    def data(self, case: VerbCase) -> Path:
        """What a case reads, made when it is first asked for."""
        folder = self.home / "data" / (case.data or "nothing")
        whole = folder.with_name(f"{folder.name} is whole")
        if not whole.is_file():
            shutil.rmtree(folder, ignore_errors=True)
            folder.parent.mkdir(exist_ok=True)
            DATA[case.data](folder)
            whole.touch()
        return folder

    def folder(self, case: VerbCase) -> Path:
        """A new folder for a case, with a copy of its data where it writes into them."""
        folder = self.unused()
        folder.mkdir()
        fill(case, self.data(case), folder)
        return folder

    def unused(self) -> Path:
        """A folder that is not there yet."""
        self.count += 1
        return self.home / f"run-{os.getpid()}-{self.count}"

    def begin(
        self, case: VerbCase, folder: Path, workers: int, *, alone: bool = False
    ) -> "subprocess.Popen[str] | ForkedCommand":
        """Start a case; its processes bear the folder's name in their environment, or are of its session.

        Args:
            case: The case.
            folder: Where it writes.
            workers: Its workers.
            alone: Start a process of its own where others are forks.
        """
        command = case.command(self.data(case), workers)
        environment = {_MARK: folder.name, "PYTHONPATH": str(ROOT / "src"), "OMP_NUM_THREADS": "1"}
        if not alone and not case.program:
            imported = self.home / f"modules of {case.verb}.json"
            import_all(imported)
            forked = ForkedCommand(command[command.index(case.verb) :], folder, environment, imported)
            self.sessions.setdefault(folder.name, []).append(forked.pid)
            return forked
        running = subprocess.Popen(
            command,
            cwd=folder,
            env={**os.environ, **environment},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self.sessions.setdefault(folder.name, []).append(running.pid)
        return running

    def undisturbed(self, case: VerbCase) -> Undisturbed:
        """Run a case once, by one worker; what it left is remembered in the folder of all."""
        asked_for = f"{case.line} {case.data} {case.out} {commit(ROOT)}"
        kept = self.home / f"{hashlib.sha256(asked_for.encode()).hexdigest()[:12]}.json"
        if kept.is_file():
            tree = json.loads(kept.read_text())
            return Undisturbed(**{**tree, "names": set(tree["names"])})
        if not case.program and not (self.home / f"modules of {case.verb}.json").is_file():
            first = self.folder(case)
            self.begin(case, first, 1).communicate(timeout=PATIENCE_S)
            shutil.rmtree(first)
        folder = self.folder(case)
        before = size_of(folder)
        running, most = self.begin(case, folder, 1), 0.0
        with drained(running) as words:
            while running.poll() is None:
                most = max(most, cpu_s(running.pid))
                time.sleep(0.01)
        if running.returncode:
            raise MissingError(f"{case.line}: status {running.returncode}: {words[-1][-600:]}")
        left = Undisturbed(hashes(folder, case.clocks), names(folder), most, size_of(folder) - before)
        kept.write_text(json.dumps({**vars(left), "names": sorted(left.names)}))
        shutil.rmtree(folder)
        return left

    def compare(self, name: str, case: VerbCase, folder: Path, expected: Undisturbed, what: str) -> bool:
        """Run a case to its end and hold what it leaves against what it should."""
        before = len(self.faults)
        running = self.begin(case, folder, 1)
        words = running.communicate(timeout=PATIENCE_S)[1]
        if running.returncode:
            self.fault(name, what, f"the rerun ends with {running.returncode}: {words.strip()[-400:]}")
        else:
            left, different = names(folder), differing(hashes(folder, case.clocks), expected.hashes)
            if different:
                self.fault(name, what, f"{len(different)} of other bytes, such as {', '.join(different[:5])}")
            if left != expected.names:
                self.fault(name, what, f"other files: {', '.join(sorted(left ^ expected.names)[:5])}")
        self.gone(name, folder, what)
        return len(self.faults) == before

    def gone(self, name: str, folder: Path, what: str) -> None:
        """See that no process of a folder is left."""
        until = time.monotonic() + GONE_S
        while (left := marked(folder.name, self.sessions.get(folder.name, ()))) and time.monotonic() < until:
            time.sleep(0.1)
        if left:
            self.fault(name, what, f"processes are left: {', '.join(map(str, left))}")
        for pid in left:
            with contextlib.suppress(OSError):
                os.kill(pid, signal.SIGKILL)

    def fault(self, name: str, what: str, words: str) -> None:
        """Note what went wrong."""
        self.faults.append(f"{name}, {what}: {words}")
        print(f"  {self.faults[-1]}", file=sys.stderr, flush=True)


def fill(case: VerbCase, data: Path, folder: Path) -> None:
    """Copy the data of a case that writes into them."""
    if case.inside:
        shutil.copytree(data, folder / case.out)


@contextlib.contextmanager
def drained(running: "subprocess.Popen[str] | ForkedCommand") -> Iterator[list[str]]:
    """Read what a command says while it is watched."""
    from threading import Thread

    words: list[str] = []
    assert running.stderr is not None
    reader = Thread(target=lambda: words.append(running.stderr.read()))  # type: ignore[union-attr]
    reader.start()
    yield words
    reader.join()
    running.stderr.close()


def cpu_s(pid: int) -> float:
    """CPU of a process and of its children."""
    total = 0.0
    with contextlib.suppress(psutil.Error):
        process = psutil.Process(pid)
        for one in (process, *process.children(recursive=True)):
            with contextlib.suppress(psutil.Error):
                total += sum(one.cpu_times()[:4])
    return total


def files(folder: Path) -> Iterator[Path]:
    """All files, also while they come and go."""
    for root, _, file_names in os.walk(folder):
        yield from (Path(root, name) for name in file_names)


def size_of(folder: Path, only: Collection[str] | None = None) -> int:
    """Bytes of all files, or of those of some names."""
    total = 0
    for path in files(folder):
        if only is not None and path.relative_to(folder).as_posix() not in only:
            continue
        with contextlib.suppress(OSError):
            total += path.stat().st_size
    return total


def names(folder: Path) -> set[str]:
    """Names of all files below a folder, the hidden ones too, and of folders that hold none.

    What the clock measured of an evaluation is left out: where all came from the journal, there is nothing to write.
    """
    empty = {f"{Path(root).relative_to(folder)}/" for root, below, inside in os.walk(folder) if not (below or inside)}
    present = {path.relative_to(folder).as_posix() for path in files(folder) if path.name != TIMING}
    return present | (empty - {"./"})


def hashes(folder: Path, clocks: Sequence[str] = ()) -> dict[str, str]:
    """SHA-256 of each file but for those that hold what a clock measured; of a journal without its sources' times."""
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(_SOURCE.sub(b"", path.read_bytes())).hexdigest()
        for path in files(folder)
        if path.name not in (*CLOCKS, *clocks)
    }


_SOURCE = re.compile(rb'"source": "[0-9a-f]{32}"')
"""In a line of a journal: a digest of when its sources changed, too."""


def differing(one: dict[str, str], other: dict[str, str]) -> list[str]:
    """Names in both whose hashes differ."""
    return sorted(name for name in one.keys() & other.keys() if one[name] != other[name])


def marked(mark: str, sessions: Sequence[int] = ()) -> list[int]:
    """Processes of a folder, by their environment or their session."""
    pids = []
    for path in Path("/proc").glob("[0-9]*/environ"):
        with contextlib.suppress(OSError):
            pid = int(path.parent.name)
            if f"{_MARK}={mark}".encode() in path.read_bytes().split(b"\0") or os.getsid(pid) in sessions:
                pids.append(pid)
    return pids


def unfinished(folder: Path) -> list[str]:
    """Files and folders that are no results."""
    return sorted(name for name in names(folder) if name.endswith((".part", ".lock")) or "unfinished-" in name)


# Signals


def interrupt(
    bench: Bench,
    name: str,
    case: VerbCase,
    folder: Path,
    number: int,
    workers: int,
    reached: "Moment",
    *,
    alone: bool = False,
) -> bool:
    """Start a case and end it by a signal when a moment is reached; whether it was at work."""
    what = f"{signal.Signals(number).name} with {workers} workers"
    left_before = unfinished(folder)  # by a kill: the next run may be ended before it comes to sweep
    running = bench.begin(case, folder, workers, alone=alone)
    with drained(running) as words:
        until = time.monotonic() + PATIENCE_S
        while running.poll() is None and not reached(running.pid) and time.monotonic() < until:
            time.sleep(reached.pause_s)
        at_work = running.poll() is None
        if at_work:
            running.send_signal(number)
        try:
            status = running.wait(90)
        except subprocess.TimeoutExpired:
            bench.fault(name, what, "it goes on for 90 s")
            running.kill()
            status = running.wait()
    at_work = at_work and status != 0  # else it had ended before it saw the signal
    if at_work and number == signal.SIGTERM:
        bench.gone(name, folder, what)
        if status not in (143, -signal.SIGTERM):
            bench.fault(name, what, f"status {status}: {words[-1].strip()[-300:]}")
        elif status == 143 and _AGAIN not in words[-1]:
            bench.fault(name, what, f"it does not say how to go on: {words[-1].strip()[-200:]}")
        if "Traceback" in words[-1].split("Exception ignored")[0]:
            bench.fault(name, what, f"a traceback: {words[-1].strip()[-600:]}")
        if left := sorted(set(unfinished(folder)) - set(left_before)):
            bench.fault(name, what, f"left: {', '.join(left[:4])}")
    elif not at_work and status and "Close other programs" not in words[-1]:  # too little memory for two workers
        bench.fault(name, what, f"status {status} before the signal: {words[-1].strip()[-300:]}")
    return at_work


@dataclass(frozen=True)
class Moment:
    """A share of the work: of the bytes that it writes, or of its CPU, whichever comes first where both are set.

    To look for it costs CPU too, so that it is looked for a hundred times while the work takes.
    """

    folder: Path
    before: int
    size: float
    cpu: float
    pause_s: float
    only: Collection[str] | None = None

    def __call__(self, pid: int) -> bool:
        """Whether it is reached."""
        return size_of(self.folder, self.only) - self.before > self.size or cpu_s(pid) > self.cpu


def signalled(bench: Bench, name: str, case: VerbCase, count: int) -> str:
    """End a case by signals, and run it to its end; how many were sent and how many met it at work."""
    expected, at_work, sent = bench.undisturbed(case), 0, 0
    chain, only = case.chain if case.resumes else 1, expected.names if case.unpacks else None
    while sent < count:
        links = min(chain, count - sent)
        folder = bench.folder(case)
        begun = size_of(folder, only)
        for link in range(links):
            number = (signal.SIGTERM, signal.SIGKILL)[sent % 2]
            workers = 1 + (sent // 2) % 2 if case.workers else 1
            share = (link + (sent * 0.37) % 1) / links if links > 1 else (sent + 0.5) / count
            by_bytes = case.resumes and sent % 3 < 2
            # a resumed run has less to do: what it costs to start and the share of what is left
            left = 1.0 - max(0.0, size_of(folder, only) - begun) / max(1, expected.size)
            cpu = expected.cpu_s * (1.5 if by_bytes else 0.25 + 0.7 * share * left)
            size = share * expected.size if by_bytes else float("inf")
            alone = link == 0  # the others are forks; both ways the same moment of the work
            pause_s = min(0.1, max(0.004, expected.cpu_s / 100))
            moment = Moment(folder, begun, size, cpu + (IMPORT_S if alone and case.needs else 0.0), pause_s, only)
            at_work += interrupt(bench, name, case, folder, number, workers, moment, alone=alone)
            sent += 1
        bench.compare(name, case, folder, expected, f"after signals {sent - links + 1} to {sent}")
        shutil.rmtree(folder)
    return f"{sent} signals, {at_work} met it at work"


def run_signals(arguments: Sequence[str]) -> int:
    """End verbs at moments spread over their work."""
    parser = _parser(run_signals)
    parser.add_argument("--signals", type=int, default=20, help="of each verb that resumes")
    parser.add_argument("--others", type=int, default=SINGLE, help="of each other verb")
    options = parser.parse_args(arguments)
    counts = (options.others, options.signals)
    return _each(
        options,
        "equal bytes, nothing left",
        lambda bench, name, case: signalled(bench, name, case, counts[case.resumes]),
        lambda case: counts[case.resumes],
    )


# A full and a read-only disk


@contextlib.contextmanager
def tmpfs(folder: Path, size: int) -> Iterator[None]:
    """A small file system of its own.

    Raises:
        MissingError: If this user or machine may not mount one.
    """
    folder.mkdir(exist_ok=True)
    done = subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", folder], capture_output=True)
    if done.returncode:
        raise MissingError(f"no tmpfs can be mounted here: {done.stderr.decode().strip()}")
    try:
        yield
    finally:
        subprocess.run(["umount", "-l", folder], check=True)
        folder.rmdir()


def _remounted(folder: Path, *options: str) -> None:
    subprocess.run(["mount", "-o", ",".join(("remount", *options)), folder], check=True)


def _refused(bench: Bench, name: str, case: VerbCase, folder: Path, what: str) -> bool:
    """Run a case that cannot write; whether it ended with 1 and one sentence."""
    before = len(bench.faults)
    running = bench.begin(case, folder, 1, alone=True)
    words = running.communicate(timeout=PATIENCE_S)[1]
    own = [line for line in words.splitlines() if line.startswith("farfield ")]
    if running.returncode != 1:
        bench.fault(name, what, f"status {running.returncode}: {words.strip()[-300:]}")
    if "Traceback" in words or "Errno" in words:
        bench.fault(name, what, f"a traceback or a number: {words.strip()[-800:]}")
    elif len(own) != 1:
        bench.fault(name, what, f"{len(own)} sentences: {words.strip()[-300:]}")
    bench.gone(name, folder, what)
    return len(bench.faults) == before


def full(bench: Bench, name: str, case: VerbCase, shares: Sequence[float]) -> str:
    """Fill the disk at some shares of what a case writes; what was tried."""
    expected = bench.undisturbed(case)
    whole = expected.size + (size_of(bench.data(case)) if case.inside else 0)
    tried = 0
    for share in shares:
        room = (whole - expected.size) + int(expected.size * share)
        folder = bench.unused()
        with tmpfs(folder, 1 << 30):
            fill(case, bench.data(case), folder)
            used = shutil.disk_usage(folder).used
            page = os.sysconf("SC_PAGE_SIZE")
            _remounted(folder, f"size={max(used + page, room // page * page)}")
            ballast = folder / ".ballast"
            if not share:  # no byte is free; a tmpfs of no size would have no limit
                with contextlib.suppress(OSError), ballast.open("wb", buffering=0) as handle:
                    while handle.write(bytes(page)):
                        pass
            what = f"disk full at {share:.0%}"
            tried += _refused(bench, name, case, folder, what)
            ballast.unlink(missing_ok=True)
            if left := unfinished(folder):
                bench.fault(name, what, f"left: {', '.join(left[:4])}")
            _remounted(folder, f"size={1 << 30}")
            bench.compare(name, case, folder, expected, what)
    return f"{tried} of {len(shares)} refused in a sentence"


def run_full_disk(arguments: Sequence[str]) -> int:
    """Fill the disk under each verb, then make room."""
    parser = _parser(run_full_disk)
    parser.add_argument("--shares", type=float, nargs="+", default=[0.0, 0.6], help="of what a verb writes")
    options = parser.parse_args(arguments)
    target = "1, one sentence; equal bytes after"
    return _each(options, target, lambda *words: full(*words, options.shares), lambda _: options.shares)


def read_only(bench: Bench, name: str, case: VerbCase) -> str:
    """Let a case write where nothing can be written, then where it can."""
    expected = bench.undisturbed(case)
    folder = bench.unused()
    with tmpfs(folder, 1 << 30):
        fill(case, bench.data(case), folder)
        _remounted(folder, "ro")
        refused = _refused(bench, name, case, folder, "read only")
        _remounted(folder, "rw")
        bench.compare(name, case, folder, expected, "read only")
    return "refused in a sentence" if refused else "not refused in a sentence"


def run_read_only(arguments: Sequence[str]) -> int:
    """Let each verb write on a read-only disk, then on a writable one."""
    return _each(_parser(run_read_only).parse_args(arguments), "1, one sentence; equal bytes after", read_only)


# Two at once


def both(bench: Bench, name: str, case: VerbCase, workers: int) -> str:
    """Start a case twice at the same moment."""
    expected, folder = bench.undisturbed(case), bench.folder(case)
    running = [bench.begin(case, folder, workers, alone=True) for _ in range(2)]
    words = [command.communicate(timeout=PATIENCE_S)[1] for command in running]
    statuses = [command.returncode for command in running]
    if 0 not in statuses:
        bench.fault(name, "two at once", f"none is done: {' | '.join(text.strip()[-200:] for text in words)}")
    for status, text in zip(statuses, words, strict=True):
        if status and _REFUSED not in text and "nothing is written over" not in text:
            bench.fault(name, "two at once", f"status {status}: {text.strip()[-400:]}")
    if "expected a new or empty folder" not in "".join(words):
        bench.compare(name, case, folder, expected, "two at once") if case.verb != "new-dataset" else None
    if differing(hashes(folder, case.clocks), expected.hashes) or names(folder) != expected.names:
        bench.fault(name, "two at once", "other bytes or files")
    shutil.rmtree(folder)
    return "one waited" if statuses == [0, 0] else "one was refused"


def run_twice(arguments: Sequence[str]) -> int:
    """Start each verb twice at once."""
    parser = _parser(run_twice)
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args(arguments)
    return _each(options, "one waits or is refused; equal bytes", lambda *words: both(*words, options.workers))


# What the parts share


def _parser(part: Callable[[Sequence[str]], int]) -> argparse.ArgumentParser:
    parser = part_parser(part.__doc__)
    parser.set_defaults(part=part.__name__.removeprefix("run_"))
    parser.add_argument("--only", nargs="+", help=f"some of: {', '.join(CASES)}")
    parser.add_argument("--again", action="store_true", help="try those that held before, too")
    parser.add_argument("--home", type=Path, default=ROOT / "build" / "interruptions", help="keep data and rows here")
    return parser


class Rows:
    """Rows of a part that were measured before, in a file that an interrupted run goes on with.

    Args:
        path: The file, a row a line.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        lines = path.read_text().splitlines() if path.is_file() else []
        self.rows: dict[str, dict[str, Any]] = {row["name"]: row for row in map(json.loads, lines)}

    def add(self, name: str, **row: Any) -> None:
        """One row more, or in place of the one of this name."""
        self.rows[name] = {"name": name, **row}
        write_text(self.path, "".join(f"{json.dumps(row)}\n" for row in self.rows.values()))


def _each(
    options: argparse.Namespace,
    target: str,
    tried: Callable[[Bench, str, VerbCase], str],
    setting: Callable[[VerbCase], object] = str,
) -> int:
    """Try what was not tried before, or did not hold; print all rows that there are, and what was left out or wrong."""
    if missing := verbs_without_case():
        raise SystemExit(f"verbs without a command in benchmarks/_interrupted_verbs.py: {', '.join(missing)}")
    options.home.mkdir(parents=True, exist_ok=True)
    bench, cases, table = Bench(options.home.resolve()), chosen(options.only), Table()
    rows, faults, untried = Rows(options.home / f"{options.part}.jsonl"), list[str](), list[str]()
    for name, case in CASES.items():
        state, row = f"{case.line} {setting(case)}", rows.rows.get(name)
        stands = (
            row is not None and row["state"] == state and (name not in cases or (row["held"] and not options.again))
        )
        if not stands and (name not in cases or lacking(case)):
            untried.append(name if name not in cases else f"{name} ({lacking(case)} is not installed)")
            continue
        if not stands:
            before, code = len(bench.faults), git_commit()
            try:
                figure = tried(bench, name, case)
            except MissingError as error:
                table.add(name, f"left out: {str(error)[:200]}", "", False)
                continue
            if git_commit() != code:  # weights and results tell the code that made them: their bytes are others
                del bench.faults[before:]
                table.add(name, "left out: the code changed meanwhile", "", False)
                continue
            wrong = bench.faults[before:]
            rows.add(name, state=state, figure=figure, held=not wrong, faults=wrong, commit=commit(ROOT))
        row = rows.rows[name]
        table.add(name, f"{row['figure']} ({row['commit']})", target, row["held"])
        faults += row["faults"]
    for verb, why in LEFT_OUT.items():
        print(f"left out: {verb}, {why}")
    if untried:
        print(f"not tried yet: {', '.join(untried)}")
    print(f"\n{len(faults)} faults" + "".join(f"\n  {fault}" for fault in faults), flush=True)
    return table.status


_FEW = "--home TMP/home --only 'convert --to kitti'"
if __name__ == "__main__":
    raise SystemExit(
        run_parts(
            __doc__,
            {
                "signals": Part(run_signals, f"{_FEW} sync --signals 5 --others 1", exact=True),
                "full_disk": Part(run_full_disk, f"{_FEW} sync --shares 0.6", exact=True),
                "read_only": Part(run_read_only, f"{_FEW} score", exact=True),
                "twice": Part(run_twice, f"{_FEW} sync", exact=True),
            },
        )
    )
