"""Where figures come from: versions, processor, commit, and whether frames were simulated."""

import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

SIMULATION_FILE = "simulation.json"
"""The settings that ``farfield simulate`` leaves beside its frames."""


SIMULATION_JOURNAL = ".farfield_simulate.jsonl"
"""Which files ``farfield simulate`` wrote, a line of JSON a frame."""


def is_simulated(root: Path) -> bool:
    """Whether ``farfield simulate`` wrote a data set: its settings file lies in the folder, or above one that it wrote.

    Of a folder below, its journal says so; without a journal each is one that it wrote.
    """
    if (root / SIMULATION_FILE).is_file() or any(root.glob(f"dir_*to*/{SIMULATION_FILE}")):  # on K-Radar's disks
        return True
    parent, name = root.absolute().parent, root.absolute().name
    if not (parent / SIMULATION_FILE).is_file():
        return False
    journal = parent / SIMULATION_JOURNAL
    return not journal.is_file() or f'"{name}/'.encode() in journal.read_bytes()


def environment() -> dict[str, Any]:
    """Versions, processor and, in a git checkout, the commit of the code that runs."""
    packages = {}
    for name in ("farfield", "numpy", "scipy", "torch"):
        try:
            packages[name] = version(name)
        except PackageNotFoundError:
            packages[name] = "absent"
    return {
        "versions": packages,
        "python": platform.python_version(),
        "machine": platform.machine(),
        "processor": processor(),
        "commit": git_commit(),
    }


def processor() -> str:
    """Name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return next(filter(None, names), "") or platform.processor() or platform.machine()


def git_commit() -> str | None:
    """Commit of the source tree this package runs from, "-dirty" appended if it was changed; None outside one."""
    here = Path(__file__).resolve().parent
    try:
        described = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"],  # noqa: S607
            cwd=here,
            capture_output=True,
            text=True,
            timeout=10,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return described.stdout.strip() or None if described.returncode == 0 else None
