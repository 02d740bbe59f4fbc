"""Record what every verb writes, so that a change that must not change anything can be compared.

Before and after a change of the sources:

    python tools/record.py run records/before --real FOLDER
    python tools/record.py run records/after --real FOLDER
    python tools/record.py compare records/before records/after

``run`` takes the commands of ``record_commands.py`` one after the other, each in a fresh folder with the same relative
paths, and writes OUT/record.json (exit statuses, names of texts, pixels, arrays, bytes), OUT/texts (what was printed
and written, without times and places) and OUT/arrays. ``--source`` names the sources to record, by default those beside
this folder; ``--real`` (or FARFIELD_SHARED_REAL) a folder of real frames: commands that need what is not there are left
out and say so. ``--only`` takes the commands whose names match, and what they build on.

``compare`` prints each difference and exits 1 if there is one. ``--tolerance`` lets numbers differ, of texts and of
kept arrays. ``--renamings`` names a table, OLD NEW a line, that is applied to the words of A first; texts then count as
equal if they differ in blanks and lines of tables only, since longer words break lines elsewhere.

Only commands, the studio's wire and public names are used: what is inside may move.
"""

import argparse
import contextlib
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

from record_commands import STEPS, Step
from record_compare import compared, read_renamings
from record_texts import Digester, Places, is_left_out, sha

ROOT = Path(__file__).resolve().parents[1]
COMMAND = ("-m", "farfield.cli")
"""What ``farfield`` stands for, behind python."""

Stamp = tuple[int, int]


class Run:
    """One recording.

    Args:
        out: Folder of the record.
        source: Folder from which ``farfield`` is imported.
        real: Folder of real frames, or none.
    """

    def __init__(self, out: Path, source: Path, real: Path | None) -> None:
        self.out, self.source, self.real = out, source, real
        self.home = Path(tempfile.mkdtemp(prefix="record-")).resolve()  # of constant length: tables break lines alike
        self.began_s = time.time()
        self.names: dict[str, dict[str, str]] = {}

    def folder(self, step: Step) -> Path:
        """Where a step works."""
        return self.home / "steps" / step.name / "here"

    def take(self, step: Step) -> dict[str, Any]:
        """Run the commands of a step and record what came of them."""
        lacking = [name for name in step.real if self.real is None or not list(self.real.glob(name))]
        if lacking:
            return {"left out": f"no {', '.join(lacking)} among the real frames"}
        folder = self.folder(step)
        folder.mkdir(parents=True)
        for name in step.takes:
            shutil.copytree(self.home / "steps" / name / "here", folder, dirs_exist_ok=True)
        for path in (path for name in step.real for path in sorted((self.real or Path()).glob(name))):
            self._copy(path, folder / "real" / path.relative_to(self.real or Path()))
        before = dict(stamps(folder))
        texts = self.out / "texts" / step.name
        texts.mkdir(parents=True)
        done = [self._command(step, number, words, texts) for number, words in enumerate(step.commands)]
        files = self._files(step, before, texts)
        gone = sorted(name for name in before if not (folder / name).exists())
        return {"commands": done, "files": files, "gone": gone}

    @staticmethod
    def _copy(path: Path, to: Path) -> None:
        to.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            shutil.copytree(path, to, dirs_exist_ok=True)
        else:
            shutil.copy2(path, to)

    def _command(self, step: Step, number: int, words: str, texts: Path) -> dict[str, Any]:
        began = time.monotonic()
        line = [sys.executable, *_words(words, self.source)]
        streams = [self.home / "steps" / step.name / f"{number}.{kind}" for kind in ("out", "err")]
        with streams[0].open("wb") as out, streams[1].open("wb") as err:
            process = subprocess.Popen(
                line, cwd=self.folder(step), env=self._environment(), stdout=out, stderr=err, start_new_session=True
            )
            status, cpu_s = _ended(process, step.limit_s)
        names = {}
        for path in streams:
            text = self._digester().text(path.read_bytes().decode("utf-8", "replace"))
            (texts / path.name).write_text(text, encoding="utf-8")
            names[path.suffix[1:]] = sha(text.encode())
        seconds = round(time.monotonic() - began, 1)
        return {"words": words, "status": status, "seconds": seconds, "cpu_s": cpu_s, **names}

    def _files(self, step: Step, before: Mapping[str, Stamp], texts: Path) -> dict[str, Any]:
        digester, folder, found = self._digester(), self.folder(step), dict[str, Any]()
        for name, stamp in stamps(folder):
            if before.get(name) == stamp or is_left_out(name):
                continue
            plain = digester.places.plain(name)
            if any(fnmatch(plain, each) for each in step.varies):
                found[plain] = {"kind": "written"}
                continue
            entry, text = digester.file(name, (folder / name).read_bytes())
            found[plain] = entry
            if text is not None:
                path = texts / "files" / plain
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(text, encoding="utf-8")
        return found

    def _digester(self) -> Digester:
        words = {str(self.home): "SCRATCH", str(self.source.parent): "TREE", sys.prefix: "PYTHON"}
        words |= {str(Path(sys.executable).resolve().parents[1]): "PYTHON", os.uname().nodename: "HOST"}
        return Digester(Places(words, self.began_s, time.time()), self.out / "arrays")

    def _environment(self) -> dict[str, str]:
        kept = {name: value for name, value in os.environ.items() if name in ("PATH", "LD_LIBRARY_PATH")}
        one: tuple[str, ...] = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")
        one += ("OPENCV_FOR_THREADS_NUM",)  # its sums over several threads come out in another order each time
        return {
            **kept,
            **dict.fromkeys(one, "1"),
            **{"HOME": str(self.home), "TMPDIR": str(self.home), "PYTHONPATH": str(self.source)},
            **{"COLUMNS": "120", "TERM": "dumb", "TZ": "UTC", "LANG": "C.UTF-8", "MPLBACKEND": "Agg"},
            **{"PYTHONHASHSEED": "0", "CUDA_VISIBLE_DEVICES": "", "USER": "somebody"},
        }


def _ended(process: "subprocess.Popen[bytes]", limit_s: float) -> tuple[int | str, float]:
    """Wait for a process: its status, and the seconds of CPU that it took with its children."""
    until, status = time.monotonic() + limit_s, ""
    while True:
        pid, code, used = os.wait4(process.pid, os.WNOHANG)
        if pid:
            process.returncode = os.waitstatus_to_exitcode(code)
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)  # what it left behind
            return status or process.returncode, round(used.ru_utime + used.ru_stime, 1)
        if not status and time.monotonic() > until:
            status = f"killed after {limit_s:g} s"
            os.killpg(process.pid, signal.SIGKILL)
        time.sleep(0.02)


def stamps(folder: Path) -> Iterator[tuple[str, Stamp]]:
    """The files below a folder, with size and time of change."""
    for path in sorted(path for path in folder.rglob("*") if path.is_file() and not path.is_symlink()):
        status = path.stat()
        yield path.relative_to(folder).as_posix(), (status.st_size, status.st_mtime_ns)


def _words(words: str, source: Path) -> list[str]:
    """A command's words behind python: ``farfield VERB ...``, or a script of this folder."""
    first, *rest = words.split()
    if first == "farfield":
        return [*COMMAND, *rest]
    if first == "tree":  # a file of the sources' tree, copied
        return ["-c", _COPY, str(source.parent), *rest]
    return [str(Path(__file__).parent / first), *rest]


_COPY = "import shutil, sys; from pathlib import Path; [shutil.copy2(Path(sys.argv[1]) / n, '.') for n in sys.argv[2:]]"


def chosen(patterns: Sequence[str]) -> list[Step]:
    """The steps whose names match, and those that they build on, in the order of the list."""
    by_name = {step.name: step for step in STEPS}
    wanted = [step.name for step in STEPS if not patterns or any(fnmatch(step.name, each) for each in patterns)]
    known: set[str] = set()
    while wanted:
        name = wanted.pop()
        if name not in known:
            known.add(name)
            wanted += by_name[name].takes
    return [step for step in STEPS if step.name in known]


def record(run: Run, steps: Sequence[Step], jobs: int) -> dict[str, Any]:
    """Take the steps, some at a time, each after those that it builds on."""
    found: dict[str, Any] = {}
    left, running = list(steps), dict[Future[dict[str, Any]], Step]()
    with ThreadPoolExecutor(jobs) as pool:
        while left or running:
            ready = [step for step in left if all(name in found for name in step.takes)]
            for step in ready[: jobs - len(running)]:
                lost = [name for name in step.takes if "left out" in found[name]]
                left.remove(step)
                if lost:
                    found[step.name] = {"left out": f"{', '.join(lost)} left out"}
                else:
                    running[pool.submit(run.take, step)] = step
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                step = running.pop(future)
                found[step.name] = future.result()
                print(f"[{len(found)}/{len(steps)}] {step.name}: {_told(found[step.name])}", flush=True)
    return {step.name: found[step.name] for step in steps}


def _told(entry: Mapping[str, Any]) -> str:
    if "left out" in entry:
        return f"left out, {entry['left out']}"
    states = " ".join(str(each["status"]) for each in entry["commands"])
    seconds = sum(each["seconds"] for each in entry["commands"])
    cpu_s = sum(each["cpu_s"] for each in entry["commands"])
    return f"status {states}, {len(entry['files'])} files, {seconds:.1f} s, {cpu_s:.1f} s of CPU"


def run_command(options: argparse.Namespace) -> int:
    """``record.py run``."""
    out, source = Path(options.out), Path(options.source).resolve()
    real = options.real or os.environ.get("FARFIELD_SHARED_REAL")
    if (out / "record.json").exists():
        print(f"{out}: there is a record; name another folder", file=sys.stderr)
        return 2
    shutil.rmtree(out / "texts", ignore_errors=True)
    out.mkdir(parents=True, exist_ok=True)
    run, began = Run(out.resolve(), source, Path(real).resolve() if real else None), time.monotonic()
    steps = chosen(options.only)
    warm = [sys.executable, "-c", "import farfield, matplotlib.font_manager; print(farfield.__file__)"]
    where = subprocess.run(warm, env=run._environment(), capture_output=True, text=True, check=True)
    print(f"{len(steps)} of {len(STEPS)} steps, {options.jobs} at a time, of {where.stdout.strip()}")
    try:
        found = record(run, steps, options.jobs)
    finally:
        if not options.keep:
            shutil.rmtree(run.home, ignore_errors=True)
    uncovered = sorted(_verbs(out) - {words.split()[1] for step in STEPS for words in step.commands if " " in words})
    text = json.dumps({"format": 1, "only": options.only, "steps": found}, indent=1)
    (out / "record.json").write_text(text + "\n", encoding="utf-8")
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_min, minutes = (used.ru_utime + used.ru_stime) / 60, (time.monotonic() - began) / 60
    print(f"{out}/record.json in {minutes:.1f} min, {cpu_min:.1f} min of CPU")
    if uncovered:
        print(f"no step has the verbs {', '.join(uncovered)}", file=sys.stderr)
    return 0


def _verbs(out: Path) -> set[str]:
    """The verbs that ``farfield --help`` names."""
    path = out / "texts" / "help" / "0.out"
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    return set(re.findall(r"(?m)^  ([a-z][a-z-]+)  +\S", text.partition("verbs (")[2].partition("everywhere:")[0]))


def compare_command(options: argparse.Namespace) -> int:
    """``record.py compare``."""
    renamings = read_renamings(Path(options.renamings)) if options.renamings else {}
    count = 0
    for line in compared(Path(options.a), Path(options.b), renamings, options.tolerance):
        print(line)
        count += not line.startswith(("note:", "    "))
    print(f"{count} differences" if count else "no difference")
    return int(count > 0)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = parser.add_subparsers(required=True)
    run = verbs.add_parser("run", help="record what every verb writes")
    run.add_argument("out")
    run.add_argument("--only", nargs="+", default=[], metavar="PATTERN", help="names of steps, such as 'train-*'")
    run.add_argument("--jobs", type=int, default=2, help="steps at a time (2)")
    run.add_argument("--source", default=str(ROOT / "src"), help="folder of the sources to record")
    run.add_argument("--real", help="folder of real frames; FARFIELD_SHARED_REAL unless given")
    run.add_argument("--keep", action="store_true", help="leave the scratch folder")
    run.set_defaults(do=run_command)
    compare = verbs.add_parser("compare", help="print each difference between two records")
    compare.add_argument("a")
    compare.add_argument("b")
    compare.add_argument("--renamings", metavar="FILE", help="table of words, OLD NEW a line, applied to A")
    compare.add_argument("--tolerance", type=float, default=0.0, help="by how much numbers may differ (0)")
    compare.set_defaults(do=compare_command)
    options = parser.parse_args(arguments)
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # of a shell's background job, and of each process it starts
        signal.signal(signal.SIGINT, signal.default_int_handler)
    return int(options.do(options))


if __name__ == "__main__":
    sys.exit(main())
