"""``farfield simulate``: write a simulated data set in the layout of Cirrus."""

import json
import os
import shutil
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro

from farfield.errors import ConfigError, DatasetError

if TYPE_CHECKING:
    from farfield.frame import Frame
    from farfield.simulation import Preset

_SETTINGS_FILE = "simulation.json"
_BLOCK = 10  # frames a job of a worker
_MAX_STRIDE_S = 1.0  # readers begin a new segment after a longer pause


@dataclass(frozen=True)
class _Job:
    """Frames of one sequence for one worker."""

    preset: "Preset"
    seed: int
    sequence: int
    indices: tuple[int, ...]
    out: str
    cache: bool
    check: bool


def run(
    preset: tyro.conf.Positional[str],
    out: tyro.conf.Positional[Path],
    /,
    *,
    frames: int | None = None,
    sequences: int | None = None,
    seed: int | None = None,
    stride_s: float | None = None,
    uniform_offset_ms: float | None = None,
    workers: int = 0,
    cache: bool = False,
) -> int:
    """Write a simulated data set in the layout of Cirrus: two scan patterns, boxes of the visible parts.

    examples:
      farfield simulate cirrus-sim data/sim --frames 100
      farfield simulate cirrus-sim-highway data/highway --frames 200 --sequences 40 --seed 3 --workers 4 --cache
      farfield simulate cirrus-sim-val-v1 data/val

    Run again, it goes on where it stopped. A frozen preset (cirrus-sim-val-v1) is compared with its recorded
    checksums; exit status 1 if a frame differs. The bytes do not depend on the number of workers.

    Args:
        preset: cirrus-sim (highway and town in turn), cirrus-sim-highway, cirrus-sim-urban, mini, cirrus-sim-val-v1.
        out: Folder to write into; made if absent. Frames go to Cirrus_dataset1 below it.
        frames: Number of frames in all, spread evenly over the sequences; the preset's own unless given.
        sequences: Number of sequences, each another road with other traffic; the preset's own unless given.
        seed: Another seed gives another world; the preset's own unless given.
        stride_s: Seconds between frames of a sequence, at most 1; the preset's own unless given.
        uniform_offset_ms: How much later the uniform pattern is taken.
        workers: Processes; 0 takes as many as there are cores.
        cache: Also write the binary cache that makes reading fast.
    """
    from farfield.simulation import find_preset
    from farfield.simulation.frozen import FROZEN

    asked = {"stride_s": stride_s, "uniform_offset_ms": uniform_offset_ms}
    changes = {name: value for name, value in asked.items() if value is not None}
    chosen = find_preset(preset, **changes)
    frozen = preset in FROZEN
    if frozen and (changes or seed not in (None, chosen.seed)):
        raise ConfigError(f"{preset} is frozen: expected its own seed and settings. Use cirrus-sim for others.")
    if chosen.stride_s > _MAX_STRIDE_S or chosen.stride_s <= 0:
        raise ConfigError(f"--stride-s: expected more than 0 and at most {_MAX_STRIDE_S:g} s, got {chosen.stride_s:g}")
    plan = _plan(chosen, frames, sequences, frozen=frozen)
    used_seed = chosen.seed if seed is None else seed
    _settle(out, chosen, used_seed)
    jobs = list(_jobs(plan, chosen, used_seed, out, cache=cache, check=frozen))
    count = sum(len(job.indices) for job in jobs)
    _check_disk(out, chosen, count, cache=cache)
    processes = min(workers if workers > 0 else os.cpu_count() or 1, max(len(jobs), 1))
    _announce(chosen, used_seed, plan, count, processes, out)
    verdicts = _work(jobs, processes, count)
    return _conclude(verdicts, out, frozen=frozen)


def _plan(preset: "Preset", frames: int | None, sequences: int | None, *, frozen: bool) -> list[int]:
    """Number of frames of each sequence."""
    count = preset.sequences if sequences is None else sequences
    total = preset.frames * count if frames is None else frames
    for flag, value in (("--sequences", count), ("--frames", total)):
        if value < 1:
            raise ConfigError(f"{flag}: expected at least 1, got {value}")
    count = min(count, total)
    plan = [total // count + (index < total % count) for index in range(count)]
    if frozen and (count > preset.sequences or max(plan) > preset.frames):
        raise ConfigError(f"{preset.name} is frozen: expected at most {preset.sequences} x {preset.frames} frames")
    longest = int((preset.duration_s - preset.uniform_offset_ms / 1000) / preset.stride_s + 1e-9) + 1
    if max(plan) > longest:
        raise ConfigError(
            f"--frames: a sequence lasts {preset.duration_s:g} s, so expected at most {longest} frames each, got "
            f"{max(plan)}. Ask for more --sequences or a smaller --stride-s."
        )
    return plan


def _settle(out: Path, preset: "Preset", seed: int) -> None:
    """Claim the folder for these settings, or make sure that it was claimed for the same ones."""
    from farfield.files.atomic import write_text

    settings = json.loads(json.dumps({"seed": seed, "preset": asdict(preset)}))
    record = out / _SETTINGS_FILE
    if record.is_file():
        try:
            found = json.loads(record.read_text("utf-8"))
        except ValueError as error:
            raise DatasetError(f"{record}: expected the settings of a simulation, found: {error}") from error
        if found != settings:
            raise DatasetError(
                f"{out}: expected a data set of preset {preset.name}, seed {seed}, with the same settings; "
                f"{record.name} there says otherwise. Name another folder, or remove this one."
            )
        return
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise DatasetError(f"{out}: expected an empty or absent folder, or one that farfield simulate began")
    out.mkdir(parents=True, exist_ok=True)
    write_text(record, json.dumps(settings, indent=1) + "\n")


def _jobs(plan: list[int], preset: "Preset", seed: int, out: Path, *, cache: bool, check: bool) -> Iterator[_Job]:
    """Blocks of frames that are not complete yet."""
    for sequence, frames in enumerate(plan):
        missing = [index for index in range(frames) if not _complete(preset, seed, sequence, index, out, cache=cache)]
        for first in range(0, len(missing), _BLOCK):
            yield _Job(preset, seed, sequence, tuple(missing[first : first + _BLOCK]), str(out), cache, check)


def _complete(preset: "Preset", seed: int, sequence: int, index: int, out: Path, *, cache: bool) -> bool:
    """Whether all files of a frame are there; each was written at once or not at all."""
    from farfield.datasets.cirrus import CirrusWriter
    from farfield.datasets.cloud_files import cache_path, is_fresh
    from farfield.frame import Boxes, Frame, Lazy
    from farfield.simulation.sequence import frame_times_ns

    times = frame_times_ns(preset, seed, sequence, index)
    clouds: Any = Lazy(dict.fromkeys(times, dict))
    frame = Frame(
        sequence="", frame_id="", time_ns=times["gaussian"], times_ns=times, clouds=clouds, annotation=Boxes.empty
    )
    writer = CirrusWriter(out)
    paths = writer.paths(frame)
    if not all(path.is_file() for path in paths.values()):
        return False
    return not cache or all(is_fresh(cache_path(paths[name], writer.root), paths[name]) for name in times)


def _check_disk(out: Path, preset: "Preset", count: int, *, cache: bool) -> None:
    """Refuse to begin what cannot be finished."""
    shots = preset.lidar.lines * preset.lidar.columns
    needed = count * shots * (70 + (40 if cache else 0))
    free = shutil.disk_usage(out).free
    if needed > free:
        raise DatasetError(f"{out}: {count} frames need about {needed / 1e9:.1f} GB, {free / 1e9:.1f} GB are free")


def _announce(preset: "Preset", seed: int, plan: list[int], count: int, processes: int, out: Path) -> None:
    lidar = preset.lidar
    print(f"preset {preset.name}, seed {seed}: {sum(plan)} frames in {len(plan)} sequences, {count} still to write")
    print(
        f"  every {preset.stride_s:g} s; uniform pattern {preset.uniform_offset_ms:g} ms later; {lidar.lines} lines x "
        f"{lidar.columns} shots over {2 * lidar.azimuth_deg:g} x {2 * lidar.elevation_deg:g} degrees"
    )
    print(
        f"  Gaussian sigma {lidar.sigma_deg:g} degrees around {lidar.focus_deg:g}; a 10 % target is seen with "
        f"probability 0.5 at {lidar.reference_range_m:g} m; nothing beyond {lidar.max_range_m:g} m"
    )
    print(f"  {processes} process{'es' if processes > 1 else ''}, into {out}")


def _work(jobs: list[_Job], processes: int, count: int) -> list[str]:
    """Do all jobs and return one verdict a frame."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    verdicts: list[str] = []
    columns = (TextColumn("simulating"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("simulating", total=count)
        if processes <= 1:
            for job in jobs:
                for verdict in _frames(job):
                    verdicts.append(verdict)
                    bar.advance(task)
            return verdicts
        with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
            for done in pool.map(_do, jobs):
                verdicts += done
                bar.advance(task, len(done))
    return verdicts


def _do(job: _Job) -> list[str]:
    return list(_frames(job))


def _frames(job: _Job) -> Iterator[str]:
    """Simulate and write the frames of one job; yields what the checksum says of each ("written" if there is none)."""
    from farfield.datasets.cirrus import CirrusWriter
    from farfield.simulation import simulate_frame

    writer = CirrusWriter(job.out)
    for index in job.indices:
        frame = simulate_frame(job.preset, seed=job.seed, sequence=job.sequence, index=index)
        _write(writer, frame, cache=job.cache)
        yield _verdict(job, frame, index) if job.check else "written"


def _write(writer: Any, frame: "Frame", *, cache: bool) -> None:
    from farfield.datasets.cloud_files import write_rows_cache

    paths = writer.write(frame)
    if cache:
        for name in frame.clouds:
            write_rows_cache(paths[name], writer.root)


def _verdict(job: _Job, frame: "Frame", index: int) -> str:
    from farfield.simulation.frozen import compare, frame_record, frozen_records

    return compare(frame_record(frame), frozen_records(job.preset.name)[job.sequence, index])


def _conclude(verdicts: list[str], out: Path, *, frozen: bool) -> int:
    print(f"wrote {len(verdicts)} frames into {out}")
    if not frozen:
        return 0
    if not verdicts:
        print("checksums: nothing was written, nothing checked; frames are compared when they are simulated")
        return 0
    counts = {name: verdicts.count(name) for name in ("identical", "equivalent", "different")}
    print("checksums: " + ", ".join(f"{count} {name}" for name, count in counts.items()))
    if counts["equivalent"]:
        print("  equivalent: point counts agree; another processor rounds single-precision rays differently")
    if counts["different"]:
        print("  different: these frames are not the frozen ones. Scores on them cannot be compared with others.")
    return int(counts["different"] > 0)
