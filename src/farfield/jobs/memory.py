"""How much memory is left to a work on this machine, within the limits of its container."""

from pathlib import Path

from farfield.jobs.engines import BulkError

_CGROUP = Path("/sys/fs/cgroup")


def available_bytes(cgroup: Path = _CGROUP) -> int:
    """Memory that programs can take now without swapping: the machine's, or what a container leaves of it."""
    import psutil

    free = int(psutil.virtual_memory().available)
    try:
        limit = (cgroup / "memory.max").read_text().strip()
        used = int((cgroup / "memory.current").read_text())
        stat = dict(line.split() for line in (cgroup / "memory.stat").read_text().splitlines())
        reclaimable = int(stat.get("inactive_file", 0))
    except (OSError, ValueError):
        return free
    return free if limit == "max" else min(free, max(0, int(limit) - used + reclaimable))


def fitting(workers: int, each_bytes: int, *, asked: bool, available: int | None = None) -> int:
    """How many workers fit into the memory.

    Args:
        workers: How many are wanted.
        each_bytes: What one takes at most; 0 where that is not known.
        asked: Whether the user asked for so many: then all must fit.
        available: Bytes that are free; measured unless given.

    Raises:
        BulkError: If not even one fits, or fewer than were asked for.
    """
    if workers <= 1 or not each_bytes:
        return workers
    free = available_bytes() if available is None else available
    room = int(free // each_bytes)
    if room < workers and asked:
        raise BulkError(
            f"--workers {workers}: expected {workers * each_bytes / 1e9:.1f} GB of free memory, {each_bytes / 1e9:.1f} "
            f"GB a worker, found {free / 1e9:.1f} GB. {f'--workers {room} fits' if room else 'Close other programs'}."
        )
    return max(1, min(workers, room))
