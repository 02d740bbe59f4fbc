"""What every benchmark prints first: command, machine, date, commit; and progress on the error stream."""

import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from farfield.frame.provenance import processor

ROOT = Path(__file__).resolve().parent.parent
SHARED_REAL = ROOT.parent / "shared" / "real"  # real frames beside the project, where there are any


def progress(items: Iterable[Any], what: str) -> Iterable[Any]:
    """Iterate with a progress bar on the error stream."""
    from rich.console import Console
    from rich.progress import track

    return track(items, what, console=Console(stderr=True), transient=True)


def header() -> str:
    """Command, machine, date, versions and commit, one a line; ``dirty`` where the tree differs from the commit."""
    root = ROOT
    command = [Path(sys.argv[0]).name, *sys.argv[1:]]
    lines = {
        "command": f"python benchmarks/{shlex.join(command)}",
        "machine": f"{processor()}, {os.cpu_count()} cores, {_memory_gib():.0f} GiB, {platform.system()}",
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "python": f"{platform.python_version()}, {_versions('numpy', 'scipy', 'torch')}",
        "commit": commit(root),
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
