"""The parts of a benchmark script, the header of what they print, and the file that keeps it.

    python benchmarks/SCRIPT.py [PART [OPTIONS]] [--tiny] [--output FILE] [--section NAME]

runs one part, or all of them. What a part prints (command, machine, date, commit, figures) becomes its section of
``benchmarks/results/SCRIPT.txt``. ``--tiny`` takes seconds, says nothing of the claim, and is kept only in FILE.
"""

import argparse
import contextlib
import io
import os
import platform
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

from farfield.files.atomic import write_text
from farfield.frame.provenance import processor

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "benchmarks" / "results"
SHARED_REAL = ROOT.parent / "shared" / "real"  # real frames beside the project, where there are any
WIDTHS = (64, 52, 42)
"""Columns of a Table: what, measured, target."""

_SECTION = re.compile(r"^==== (.+)\n", flags=re.MULTILINE)
_running: list[str] = []
"""The part that runs and its arguments, as they go into the header and to child processes."""


class MissingError(Exception):
    """What a part needs is not on this machine; it is left out."""


class Part(NamedTuple):
    """A part of a script."""

    run: Callable[[Sequence[str]], int | None]
    """Takes the arguments, prints, and gives 1 where a limit is missed."""
    tiny: str | None = ""
    """Arguments of the tiny setting; TMP is a folder that the parts of a call share. None: nothing of it runs small."""
    alone: bool = False
    """Runs only when it is named: it changes files of the project, or needs what is made elsewhere."""
    exact: bool = False
    """A miss is no matter of time: it also counts in the tiny setting."""


def run_parts(documentation: str | None, parts: Mapping[str, Part]) -> int:
    """Run the parts that the command line names, and keep what they print; the exit status.

    Args:
        documentation: The script's docstring.
        parts: The script's parts by name.
    """
    common = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    common.add_argument("--tiny", action="store_true")
    common.add_argument("--child", action="store_true")
    common.add_argument("--output", type=Path)
    common.add_argument("--section")
    options, words = common.parse_known_args()
    if words and words[0] in parts:
        names = [words.pop(0)]
    elif len(parts) == 1:
        names = [*parts]
    elif words:
        print(f"{documentation}\nparts: {', '.join(parts)}; --help of a part says its options\n\n{__doc__}")
        return int(words[0] not in ("-h", "--help"))
    else:
        names = [name for name, part in parts.items() if (part.tiny is not None if options.tiny else not part.alone)]
    if len(names) > 1 and not options.tiny:  # a process each: threads and peaks of memory are a part's own
        kept = ["--output", str(options.output)] * (options.output is not None)
        return max(subprocess.run([sys.executable, sys.argv[0], name, *kept], check=False).returncode for name in names)
    output = options.output or (None if options.tiny else RESULTS / f"{Path(sys.argv[0]).stem}.txt")
    status = 0
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            part = parts[name]
            _running[:] = [name] * (len(parts) > 1)
            tiny = shlex.split((part.tiny or "").replace("TMP", folder)) if options.tiny else []
            if options.child:
                return part.run(words) or 0
            began = _cpu_s()
            missed, text = _printed(part, [*tiny, *words])
            if options.tiny:
                print(f"{name}: {_cpu_s() - began:.1f} s of CPU", file=sys.stderr)
            status = max(status, missed if part.exact or not options.tiny else 0)
            if output is not None:
                keep_section(output, options.section or name, text)
    return status


def _printed(part: Part, arguments: Sequence[str]) -> tuple[int, str]:
    """Run a part; its status and what it printed."""
    copy = _Copy(sys.stdout)
    with contextlib.redirect_stdout(copy):
        print(header(arguments), end="\n\n", flush=True)
        try:
            missed = part.run(arguments) or 0
        except MissingError as absent:
            print(f"left out: {absent}")
            missed = 0
        print(flush=True)
    return missed, copy.getvalue()


def _cpu_s() -> float:
    """Processor time of this process and of those that it waited for."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


class _Copy(io.StringIO):
    """What is printed, kept beside."""

    def __init__(self, stream: Any) -> None:
        super().__init__()
        self.stream = stream

    def write(self, text: str) -> int:
        self.stream.write(text)
        return super().write(text)

    def flush(self) -> None:
        self.stream.flush()


def sections(path: Path) -> dict[str, str]:
    """The sections of a results file by name; what stands before the first has none."""
    pieces = _SECTION.split(path.read_text(encoding="utf-8"))
    return dict(zip(pieces[1::2], pieces[2::2], strict=True))


def keep_section(path: Path, name: str, text: str) -> None:
    """Put a section into a results file, in place of the one of that name."""
    pieces = sections(path) if path.exists() else {}
    pieces[name] = text
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, "\n".join(f"==== {title}\n{piece.strip()}\n" for title, piece in pieces.items()))


def part_parser(documentation: str | None) -> argparse.ArgumentParser:
    """A parser of a part's arguments that shows its docstring."""
    name = " ".join([Path(sys.argv[0]).name, *_running])
    text = re.sub(r"^ {4}", "", documentation or "", flags=re.MULTILINE).replace("%", "%%")
    return argparse.ArgumentParser(name, description=text, formatter_class=argparse.RawDescriptionHelpFormatter)


def child_command(*words: object) -> list[str]:
    """The command of the running part with other arguments, for a process of its own; it prints no header."""
    return [sys.executable, sys.argv[0], *_running, "--child", *map(str, words)]


def child_output(*words: object, environment: Mapping[str, str] | None = None) -> str:
    """What the running part prints in a process of its own."""
    environment = {**os.environ, **(environment or {})}
    done = subprocess.run(child_command(*words), check=True, stdout=subprocess.PIPE, text=True, env=environment)
    return done.stdout


def progress(items: Iterable[Any], what: str) -> Iterable[Any]:
    """Iterate with a progress bar on the error stream."""
    from rich.console import Console
    from rich.progress import track

    return track(items, what, console=Console(stderr=True), transient=True)


def header(arguments: Sequence[str] | None = None) -> str:
    """Command, machine, date, versions and commit, one a line; ``dirty`` where the tree differs from the commit."""
    command = [Path(sys.argv[0]).name, *(sys.argv[1:] if arguments is None else [*_running, *arguments])]
    lines = {
        "command": f"python benchmarks/{shlex.join(command)}",
        "machine": f"{processor()}, {os.cpu_count()} cores, {_memory_gib():.0f} GiB, {platform.system()}",
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "python": f"{platform.python_version()}, {_versions('numpy', 'scipy', 'torch')}",
        "commit": commit(ROOT),
    }
    return "\n".join(f"{name:<8} {value}" for name, value in lines.items())


def _memory_gib() -> float:
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30


def _versions(*packages: str) -> str:
    from importlib.metadata import PackageNotFoundError, version

    found = []
    for package in packages:
        try:
            found.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            continue
    return ", ".join(found)


def commit(root: Path) -> str:
    """The commit, ``dirty`` where the tree differs from it; what FARFIELD_COMMIT says of a copy without its history."""
    if stated := os.environ.get("FARFIELD_COMMIT"):
        return stated
    return git(root, "rev-parse", "--short", "HEAD") + (
        " (dirty)" if git(root, "status", "--porcelain", "--untracked-files=no") else ""
    )


def git(root: Path, *arguments: str) -> str:
    """What git says; ``unknown`` outside a checkout."""
    done = subprocess.run(["git", "-C", root, *arguments], capture_output=True, text=True, check=False)
    return done.stdout.strip() if done.returncode == 0 else "unknown"


@dataclass
class Table:
    """Rows of figures with their targets, printed as they come: what, figure, target, held."""

    rows: list[tuple[str, str, str, bool]] = field(default_factory=list)

    def add(self, what: str, figure: str, target: str, held: bool) -> None:
        """One row more."""
        if not self.rows:
            self._print("what", "measured", "target", "")
        self.rows.append((what, figure, target, held))
        self._print(what, figure, target, "held" if held else "MISSED")

    @staticmethod
    def _print(*cells: str) -> None:
        padded = [f"{cell:{width}s}" for cell, width in zip(cells, WIDTHS, strict=False)]
        print(" | ".join([*padded, cells[-1]]), flush=True)

    @property
    def status(self) -> int:
        """1 where a row missed its target."""
        return int(not all(held for *_, held in self.rows))


@contextlib.contextmanager
def load_printed() -> Iterator[None]:
    """Print the load of the machine before and after."""
    before = os.getloadavg()
    yield
    print(f"load     {before[0]:.1f} before, {os.getloadavg()[0]:.1f} after (1 minute)")
