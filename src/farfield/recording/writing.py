"""Write simulated frames with several processes: frame by frame, each at once or not at all, resumable."""

import contextlib
import errno
import os
import shutil
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any

from farfield.errors import DatasetError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

if TYPE_CHECKING:
    from farfield.frame import Frame
    from farfield.simulation import Preset

_BLOCK = 10  # frames a job of a worker
_STAGING = ".unfinished-"
_LABELS = ("dataset1_annotation", "info_label", "KRadar_revised_visibility", "frame_record")  # in this order, last

# Bytes a frame by sensor, generously; an Ouster's point takes 80 bytes of ASCII, a Luminar's 70.
_BYTES = {
    "camera": 400_000,
    "cam-front": 5_000_000,
    "cam-left": 5_000_000,
    "cam-right": 5_000_000,
    "cam-rear": 5_000_000,
    "cells": 1_200_000,
    "sparse": 5_000_000,
    "polar3d": 16_300_000,
    "cube": 60_100_000,
    "tesseract": 260_000_000,
}
_BYTES_PER_SHOT = {"gaussian": 70, "uniform": 70, "os2-64": 80, "os1-128": 80}


@dataclass(frozen=True)
class Job:
    """Frames of one sequence for one worker."""

    preset: "Preset"
    seed: int
    sensors: tuple[str, ...]
    sequence: int
    indices: tuple[int, ...]
    out: str
    cache: bool
    check: bool


def writer_for(preset: "Preset", root: Path | str) -> Any:
    """The writer of the rig's data set."""
    if preset.rig == "cirrus":
        from farfield.datasets.cirrus import CirrusWriter

        return CirrusWriter(root)
    from farfield.datasets.kradar import KRadarWriter

    return KRadarWriter(root, columns=preset.columns)


def frame_bytes(preset: "Preset", sensors: tuple[str, ...]) -> int:
    """How many bytes a frame takes at most."""
    lines = {"gaussian": preset.lines, "uniform": preset.lines, "os2-64": 64, "os1-128": 128}
    shots = {name: count * preset.columns for name, count in lines.items()}
    sizes = [_BYTES[name] if name in _BYTES else shots[name] * _BYTES_PER_SHOT[name] for name in sensors]
    return sum(sizes) + 20_000


def jobs_for(
    plan: list[int], preset: "Preset", seed: int, sensors: tuple[str, ...], out: Path, *, cache: bool, check: bool
) -> Iterator[Job]:
    """Blocks of frames that are not complete yet."""
    for sequence, frames in enumerate(plan):
        missing = [i for i in range(frames) if not _complete(preset, seed, sensors, sequence, i, out, cache=cache)]
        for first in range(0, len(missing), _BLOCK):
            indices = tuple(missing[first : first + _BLOCK])
            yield Job(preset, seed, sensors, sequence, indices, str(out), cache, check)


def _complete(
    preset: "Preset", seed: int, sensors: tuple[str, ...], sequence: int, index: int, out: Path, *, cache: bool
) -> bool:
    """Whether all files of a frame are there; each appeared whole or not at all."""
    from farfield.simulation.sequence import planned_frame

    frame = planned_frame(preset, seed=seed, sequence=sequence, index=index, sensors=sensors)
    writer = writer_for(preset, out)
    paths = writer.paths(frame)
    if not all(path.is_file() for path in paths.values()):
        return False
    if not cache:
        return True
    from farfield.datasets.cloud_files import cache_path, is_fresh

    return all(is_fresh(cache_path(paths[name], writer.root), paths[name]) for name in frame.clouds if name in paths)


def check_disk(out: Path, needed: int, count: int) -> None:
    """Refuse to begin what cannot be finished.

    Raises:
        DatasetError: If the folder's disk has less room than the frames need.
    """
    free = shutil.disk_usage(out).free
    if needed > free:
        raise DatasetError(
            f"{out}: {count} frames need about {needed / 1e9:.1f} GB, {free / 1e9:.1f} GB are free. Write fewer frames "
            "(--frames), fewer sensors (--sensors), or to another disk."
        )


def work(jobs: list[Job], processes: int, count: int) -> list[str]:
    """Do all jobs and return one verdict a frame.

    Raises:
        DatasetError: If the disk is full or a worker process was killed; what was written stays.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    verdicts: list[str] = []
    columns = (TextColumn("simulating"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("simulating", total=count)
        for done in _batches(jobs, processes):
            verdicts += done
            bar.advance(task, len(done))
    return verdicts


def _batches(jobs: list[Job], processes: int) -> Iterator[list[str]]:
    if processes <= 1:
        for job in jobs:
            for verdict in _frames(job):
                yield [verdict]
        return
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        try:
            yield from pool.map(_do, jobs)
        except BrokenProcessPool as error:
            raise DatasetError(
                "a worker process was killed, perhaps for want of memory: run the same command again to go on, with "
                "fewer --workers"
            ) from error
        except BaseException:  # the frames that wait would only fail the same way
            pool.shutdown(wait=True, cancel_futures=True)
            raise


def _do(job: Job) -> list[str]:
    from numba import set_num_threads

    set_num_threads(1)  # as many processes as cores are at work already
    return list(_frames(job))


def _frames(job: Job) -> Iterator[str]:
    """Simulate and write the frames of one job; yields what the checksum says of each ("written" if there is none)."""
    from farfield.simulation.sequence import simulate_frame

    for index in job.indices:
        frame = simulate_frame(job.preset, seed=job.seed, sequence=job.sequence, index=index, sensors=job.sensors)
        try:
            write_whole(job.preset, frame, Path(job.out), cache=job.cache)
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                raise
            raise DatasetError(
                f"{job.out}: the disk is full. The frames written so far are whole and stay; make room and run the "
                "same command again to go on."
            ) from error
        yield _verdict(job, frame, index) if job.check else "written"


def write_whole(preset: "Preset", frame: "Frame", out: Path, *, cache: bool) -> None:
    """Write a frame beside the data set, then move its files to their places, the labels last."""
    with _locked(out, shared=True):
        staging = out / f"{_STAGING}{os.getpid()}"
        shutil.rmtree(staging, ignore_errors=True)
        try:
            writer = writer_for(preset, staging)
            paths = writer.write(frame)
            if cache:
                from farfield.datasets.cloud_files import write_rows_cache

                for name in frame.clouds:
                    write_rows_cache(paths[name], writer.root)
            files = [path for path in sorted(staging.rglob("*")) if path.is_file()]
            for path in sorted(files, key=_rank):
                target = out / path.relative_to(staging)
                target.parent.mkdir(parents=True, exist_ok=True)
                path.replace(target)
        finally:
            shutil.rmtree(staging, ignore_errors=True)


@contextlib.contextmanager
def _locked(folder: Path, *, shared: bool) -> Iterator[None]:
    """Hold a folder together with others, or alone, until done or killed; without locks where there are none (NFS).

    Raises:
        BlockingIOError: If it is to be held alone and others hold it.
    """
    if fcntl is None:
        yield
        return
    held = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(held, fcntl.LOCK_SH if shared else fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if isinstance(error, BlockingIOError):
                raise
        yield
    finally:
        os.close(held)


def _rank(path: Path) -> int:
    """What makes a frame count is moved last."""
    return max((_LABELS.index(part) + 1 for part in path.parts if part in _LABELS), default=0)


def sweep_out(out: Path) -> None:
    """Remove what killed workers left unfinished, unless another command writes a frame into the same folder."""
    with contextlib.suppress(BlockingIOError), _locked(out, shared=False):
        for folder in out.glob(f"{_STAGING}*"):
            shutil.rmtree(folder, ignore_errors=True)


def _verdict(job: Job, frame: "Frame", index: int) -> str:
    from farfield.simulation.frozen import compare, frame_record, frozen_records

    return compare(frame_record(frame), frozen_records(job.preset.name)[job.sequence, index])
