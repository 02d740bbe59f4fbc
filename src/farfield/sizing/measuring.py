"""Measure a machine within a time: each case in turn, as often as its share of the time allows."""

import os
import shutil
import statistics
import tempfile
import time
import zlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from farfield.datasets import Dataset
from farfield.errors import ConfigError, MissingExtraError
from farfield.frame.provenance import environment, processor
from farfield.jobs import JobOptions, Unit, UnitResult, values
from farfield.jobs.process import usable_cores
from farfield.sizing.cases import BenchCase, BenchFrames, detector_cases, verb_cases
from farfield.sizing.rates import MachineRates, MeasuredRate

MOST = 30
"""Repeats of a case at most, after one that does not count."""
_INFLATED_TIMES = 3
_DISK_BYTES, _BLOCK_BYTES = 256_000_000, 8_000_000
_INFLATED_BYTES = 16_000_000
_SIDE_BY_SIDE, _ALONE = 24, 6  # units of the trial of two workers, and of one

Progress = Callable[[Sequence[BenchCase]], Iterable[BenchCase]]


def cases_of(only: Sequence[str], frames: BenchFrames, device: str | None = None, gpu: str = "") -> list[BenchCase]:
    """What is measured.

    Args:
        only: ``verbs``, ``detectors``, or parts of names; none for all.
        frames: To measure on.
        device: Where detectors run.
        gpu: The GPU's name; empty for the processor.

    Raises:
        ConfigError: If a word fits nothing.
    """
    cases = [*verb_cases(frames, device, gpu), *detector_cases(frames, device, gpu)]
    for word in only:
        if not any(_fits(case, word) for case in cases):
            names = ", ".join(dict.fromkeys(case.name for case in cases))
            raise ConfigError(f"--only: expected verbs, detectors or a part of a name of {names}; got {word!r}")
    return [case for case in cases if not only or any(_fits(case, word) for word in only)]


def _fits(case: BenchCase, word: str) -> bool:
    return word == f"{case.kind}s" or word in case.name


def measure_rates(
    *, minutes: float = 2.0, only: Sequence[str] = (), device: str | None = None, progress: Progress = iter
) -> MachineRates:
    """Measure this machine: every bulk verb, every detector that ships, two workers side by side, the disk.

    Frames are simulated into a folder for temporary files, which is removed.

    Args:
        minutes: How long it may take; each case has an equal share of it, and counts once however long that takes.
        only: As of :func:`cases_of`.
        device: Where detectors run, such as ``"cpu"`` or ``"cuda:0"`` (default: a GPU if there is one).
        progress: Wraps the cases, to show progress.

    Raises:
        ConfigError: If the time is not above 0, a word fits nothing, or there is no such device.
        MissingExtraError: If the simulator is not installed.
    """
    if not 0 < minutes <= 24 * 60:
        raise ConfigError(f"--minutes: expected more than 0 and at most {24 * 60}, got {minutes:g}")
    ends_at, gpu = time.monotonic() + 60 * minutes, _gpu_name(device)
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
    with tempfile.TemporaryDirectory(prefix="farfield-bench-") as name:
        folder = Path(name)
        frames = BenchFrames(folder)
        cases = cases_of(only, frames, device, gpu)
        rates, left_out = list[MeasuredRate](), dict[str, str]()
        for number, case in enumerate(progress(cases)):
            share_s = max(0.0, ends_at - time.monotonic()) / (len(cases) - number)
            try:
                rates.append(measured(case, folder / "out", share_s))
            except ImportError as error:
                missing = error if isinstance(error, MissingExtraError) else MissingExtraError.of(error, case.name)
                if missing is None or number == len(cases) - 1 == len(left_out):  # nothing could be measured
                    raise missing or error from error
                left_out[case.label] = str(missing)
        probe = next((made for made in ("cirrus", "kradar") if made in vars(frames)), None)
        two_at_once = None if probe is None else side_by_side(getattr(frames, probe))
        read, write = disk_rates(folder)
        facts = environment()
        return MachineRates(
            version=facts["versions"]["farfield"],
            commit=facts["commit"] or "",
            date=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
            processor=processor(),
            cores=usable_cores(),
            memory_bytes=_memory_bytes(),
            gpu=gpu,
            load=load,
            two_at_once=two_at_once,
            inflate_mb_s=inflating_rate(),
            disk_read_mb_s=read,
            disk_write_mb_s=write,
            sizes=frames.sizes(),
            rates=tuple(rates),
            left_out=left_out,
        )


def measured(case: BenchCase, out: Path, share_s: float) -> MeasuredRate:
    """Measure a case: once without counting, once that counts, and on until its share of the time is over.

    Args:
        case: What to measure.
        out: Folder that it may write into; removed after each time.
        share_s: How long it may take, seconds.
    """
    began, samples = time.monotonic(), list[tuple[float, float]]()
    while len(samples) < 2 or (len(samples) <= MOST and time.monotonic() - began < share_s):
        samples.append(case.measure(out))
        shutil.rmtree(out, ignore_errors=True)
    counted = samples[1:]
    return MeasuredRate(
        name=case.name,
        kind=case.kind,
        frames_of=case.frames_of,
        precision=case.precision,
        on=case.on,
        reads=case.reads,
        seconds=tuple(seconds for seconds, _ in counted),
        bytes_out=statistics.median(size for _, size in counted),
    )


def _memory_bytes() -> float:
    import psutil

    return float(psutil.virtual_memory().total)


def _gpu_name(device: str | None) -> str:
    """The name of the GPU on which detectors run; empty where that is the processor, or torch is absent."""
    from importlib.util import find_spec

    if find_spec("torch") is None:
        return ""
    from farfield.detectors.devices import chosen_device, name_of

    chosen = chosen_device(device)
    return "" if chosen.type == "cpu" else name_of(chosen)


@dataclass(frozen=True)
class ReadingTrial:
    """Reads a frame's clouds, and says in which process and from when to when, seconds of a clock that all share.

    Args:
        frames: The frames.
    """

    frames: Dataset

    def __call__(self, unit: Unit) -> UnitResult:
        """Read the frame of a number."""
        began = time.monotonic()
        frame = self.frames[unit.parameters % len(self.frames)]
        for name in frame.clouds:
            np.sort(frame.cloud(name).points_m, axis=0)
        return UnitResult(value=(os.getpid(), began, time.monotonic()))


def side_by_side(frames: Dataset) -> float | None:
    """What two workers that read frames do, as a share of twice what one does alone; None on a single core.

    Only units count that began and ended while both were at work.

    Args:
        frames: What they read.
    """
    if usable_cores() < 2:
        return None
    units = [Unit(str(number), parameters=number) for number in range(_SIDE_BY_SIDE)]
    alone = [result.value for result in values(ReadingTrial(frames), units[:_ALONE], JobOptions(workers=1))]
    both = [result.value for result in values(ReadingTrial(frames), units, JobOptions(workers=2))]
    return share_of_two(alone[1:], both)


def share_of_two(alone: Sequence[tuple[int, float, float]], both: Sequence[tuple[int, float, float]]) -> float | None:
    """The share from process, begin and end of each unit; None where two were never at work together.

    Args:
        alone: Units that one process did.
        both: Units that two processes did.
    """
    by_process: dict[int, list[tuple[float, float]]] = {}
    for process, began, ended in both:
        by_process.setdefault(process, []).append((began, ended))
    if len(by_process) < 2:
        return None
    first = max(min(began for began, _ in spans) for spans in by_process.values())
    last = min(max(ended for _, ended in spans) for spans in by_process.values())
    within = [ended - began for _, began, ended in both if began >= first and ended <= last]
    if not within or not alone:
        return None
    return min(1.0, statistics.median(ended - began for _, began, ended in alone) / statistics.median(within))


def inflating_rate() -> float:
    """Megabytes a second, unpacked, of inflating doubles like a radar's power, which were single once."""
    power = np.random.default_rng(0).exponential(1e12, _INFLATED_BYTES // 8).astype(np.float32).astype(np.float64)
    packed = zlib.compress(power.tobytes(), 1)
    taken = []
    for _ in range(_INFLATED_TIMES):
        began = time.perf_counter()
        zlib.decompress(packed)
        taken.append(time.perf_counter() - began)
    return _INFLATED_BYTES / 1e6 / statistics.median(taken)


def disk_rates(folder: Path, size_bytes: int = _DISK_BYTES) -> tuple[float | None, float | None]:
    """Megabytes a second of reading and of writing one large file, of what is on the disk and not in memory.

    Args:
        folder: On the disk.
        size_bytes: Size of the file.

    Returns:
        Reading and writing; None for reading where the system cannot be told to forget the file.
    """
    path, block = folder / "disk.bin", np.random.default_rng(0).bytes(min(_BLOCK_BYTES, size_bytes))
    began = time.perf_counter()
    with path.open("wb") as file:
        for _ in range(size_bytes // len(block)):
            file.write(block)
        file.flush()
        os.fsync(file.fileno())
        written = time.perf_counter() - began
        if hasattr(os, "posix_fadvise"):
            os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
    size_mb = size_bytes // len(block) * len(block) / 1e6
    reading = None
    if hasattr(os, "posix_fadvise"):
        began = time.perf_counter()
        with path.open("rb", buffering=0) as file:
            while file.read(_BLOCK_BYTES):
                pass
        reading = size_mb / (time.perf_counter() - began)
    path.unlink()
    return reading, size_mb / written
