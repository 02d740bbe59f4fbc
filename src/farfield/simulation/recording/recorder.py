"""Simulate a data set and write it in a real data set's layout: resumable, with several processes."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, model_serializer

from farfield.files.marks import mark_of
from farfield.files.sizes import sized
from farfield.frame.provenance import SIMULATION_FILE
from farfield.jobs import JobOptions, JobRun, Unit
from farfield.jobs.folders import held
from farfield.jobs.journal import state_of
from farfield.jobs.runs import Progress
from farfield.simulation.recording.frames import Simulate, bytes_needed, check_disk, claim, journal_of, units_of
from farfield.simulation.recording.options import Recording, RecordingOptions, silent
from farfield.simulation.rig import RIGS
from farfield.vocabulary.conditions import Side, World
from farfield.vocabulary.counts import count_of

_FINISHED = Unit("what belongs to whole sequences")
_SHOWN = 6  # sequences whose weather is shown


@dataclass(frozen=True, kw_only=True)
class RecordingSummary:
    """What a recording wrote.

    Args:
        recording: What was recorded, with all defaults resolved.
        verdicts: One a frame that was written now: "written", or for a frozen split "identical", "equivalent" or
            "different".
    """

    recording: Recording
    verdicts: tuple[str, ...]

    @property
    def out(self) -> Path:
        """The folder of the data set."""
        return self.recording.out

    @property
    def different(self) -> int:
        """How many frames of a frozen split are not the recorded ones."""
        return self.verdicts.count("different")


def record(
    preset: str,
    out: Path | str,
    *,
    progress: Progress = iter,
    report: Callable[[str], object] | None = None,
    **options: Any,
) -> RecordingSummary:
    """Write a simulated data set in the layout of Cirrus, K-Radar, KITTI or RADIATE.

    Called again, it resumes where it stopped: a frame's files appear whole or not at all. The bytes do not depend on
    the number of workers.

    Args:
        preset: Name of what to simulate.
        out: Folder to write into; made if absent.
        progress: Wraps the numbers of the frames that are left, to show progress.
        report: Called with each line of what is going to be done and what was done.
        **options: Fields of :class:`RecordingOptions`, such as ``frames``, ``sensors``, ``weather``, ``workers``.

    Raises:
        ConfigError: If there is no such preset, sensor or weather, or the options do not go together.
        DatasetError: If the folder holds something else, or the disk has no room.
        BulkError: If the memory does not suffice for so many workers, or frames killed their workers twice.
    """
    report = report or silent
    chosen = RecordingOptions(**options)
    recording = chosen.resolve(preset, Path(out))
    jobs = JobOptions(workers=chosen.workers, engine=chosen.engine, address=chosen.address, progress=progress)
    work, units = Simulate(recording), units_of(recording)
    if chosen.dry_run:
        for line in announced(recording, len(units), jobs.num_workers(work, len(units))):
            report(line)
        begun = recording.out.is_dir() and any(recording.out.iterdir())
        report(
            f"{recording.out} {'has files already; what fits is kept' if begun else 'is made'}; nothing is written now"
        )
        return RecordingSummary(recording=recording, verdicts=())
    with held(recording.out, fix="It is simulated there: run the same command again when that has ended."):
        # claim the folder, and find what is left to do
        claim(recording)
        journal = journal_of(recording)
        missing = sum(not journal.has(unit) for unit in units)
        for line in announced(recording, missing, jobs.num_workers(work, missing)):
            report(line)
        check_disk(recording, missing)
        # simulate and write the frames that are missing
        with JobRun(work, units, jobs, journal=journal) as running:
            for number in jobs.progress(running):
                if running.here:
                    running.enter(number, work(running.unit(number)))
        outcome = running.outcome
        # write what belongs to whole sequences: calibration, times, splits, odometry
        rig = RIGS[recording.preset.rig]
        if rig.finishes and (outcome.written or not journal.has(_FINISHED)):
            writer: Any = rig.writer(recording.out, recording.preset)
            marks = {path.relative_to(recording.out).as_posix(): mark_of(path) for path in writer.finish() or ()}
            journal.add(_FINISHED, state_of((), journal.setting), marks)
            journal.finish()
        values = journal.values([units[row].name for row in sorted(outcome.clocks)])
        verdicts = tuple(str(verdict or "written") for verdict in values)
    for line in concluded(recording, verdicts):
        report(line)
    return RecordingSummary(recording=recording, verdicts=verdicts)


def announced(recording: Recording, count: int, processes: int) -> Iterator[str]:
    """What is going to be written: frames, sensors, room, weather.

    Args:
        recording: What is written where.
        count: Frames that are still missing.
        processes: Processes that will work.
    """
    from farfield.simulation.rigs.drive import drive_of

    preset, seed, plan = recording.preset, recording.seed, recording.plan
    yield (
        f"preset {preset.name}, seed {seed}: {count_of(sum(plan), 'frame')} in "
        f"{count_of(len(plan), 'sequence')}, {count} still to write"
    )
    most = sized(bytes_needed(recording, count))
    yield f"  {', '.join(recording.sensors)}; every {preset.stride_s:g} s; at most {most}"
    if len(plan) > 1 and max(plan) == 1:
        yield (
            f"  note: {count_of(len(plan), 'drive')} of one frame each, another "
            "road and weather every time: nothing follows a "
            "frame. For frames of one drive add --sequences 1, for several drives more --frames"
        )
    for sequence in range(len(plan))[:_SHOWN]:
        drive = drive_of(preset, seed, sequence)
        yield f"  {drive.segment.name}: {drive.segment.road}; {drive.weather.describe()}"
    if len(plan) > _SHOWN:
        yield f"  ... {len(plan) - _SHOWN} more, all in {recording.out / SIMULATION_FILE}"
    yield f"  {count_of(processes, 'process')}, into {recording.out}"


def concluded(recording: Recording, verdicts: Sequence[str]) -> Iterator[str]:
    """What was written, and what the checksums of a frozen split say."""
    yield f"wrote {count_of(len(verdicts), 'frame')} into {recording.out}"
    if not recording.frozen:
        return
    if not verdicts:
        yield "checksums: nothing was written, nothing checked; frames are compared when they are simulated"
        return
    counts = {name: verdicts.count(name) for name in ("identical", "equivalent", "different")}
    yield "checksums: " + ", ".join(f"{count} {name}" for name, count in counts.items())
    if counts["equivalent"]:
        yield "  equivalent: point counts agree; another processor rounds single-precision rays differently"
    if counts["different"]:
        yield "  different: these frames are not the frozen ones. Scores on them cannot be compared with others."


class SimulationConfig(BaseModel):
    """A simulated data set that is made where ``data.path`` does not exist yet."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    preset: str = Field(description="which one, as `farfield simulate --help` lists them")
    sequences: int = Field(ge=1, description="drives")
    frames: int = Field(ge=1, description="frames of each sequence")
    seed: int = Field(0, description="another seed gives other roads and traffic")
    sensors: str | None = Field(None, description="what to write, separated by commas; the preset's own if left out")
    stride_s: float | None = Field(None, gt=0, le=1, description="time between frames; the preset's own if left out")
    traffic: Side | None = Field(None, description="on which side it keeps; the preset's own if left out")
    world: World | None = Field(None, description="what stands beside and on the roads; the preset's own if left out")

    @model_serializer(mode="wrap")
    def _serialise(self, serialise: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        """All settings; side and world only where they are given, so that data and trainings are named as before."""
        late = ("traffic", "world")
        return {name: value for name, value in serialise(self).items() if name not in late or value is not None}


def ensure(
    config: SimulationConfig | None,
    path: Path,
    progress: Progress = iter,
    report: Callable[[str], object] | None = None,
) -> RecordingSummary | None:
    """Simulate a data set where there is none yet, or go on with one that was begun; leave other data as they are.

    Where another command simulates it, its end is waited for: several trainings may begin at once.

    Args:
        config: What to simulate; None leaves everything as it is.
        path: Where the data set stands or is going to stand; a relative path starts at the current folder.
        progress: As of ``record``.
        report: As of ``record``.

    Returns:
        What was recorded; None if nothing had to be simulated.

    Raises:
        ConfigError, DatasetError: As of ``record``.
    """
    if config is None or _has_other_data(path):
        return None
    report = report or silent
    with held(path, waiting=partial(report, f"another command simulates {path}: this one goes on when it has ended")):
        if _has_other_data(path):
            return None
        return _record_config(config, path, progress=progress, report=report)


def _has_other_data(path: Path) -> bool:
    """Whether something stands there that ``farfield simulate`` did not begin; hidden files are of one that begins."""
    if not path.is_dir():
        return path.exists()
    # Listed first: the file is written before all others, so what another command just begins is never taken for data
    entries = [entry for entry in path.iterdir() if not entry.name.startswith(".")]
    return bool(entries) and not (path / SIMULATION_FILE).is_file()


def planned_recording(config: SimulationConfig, path: Path) -> Recording:
    """What :func:`ensure` would record into an absent folder; nothing is written.

    Raises:
        ConfigError: As of ``record``.
    """
    return _record_config(config, path, dry_run=True).recording


def _record_config(config: SimulationConfig, path: Path, **others: Any) -> RecordingSummary:
    from farfield.simulation import find_preset

    return record(
        config.preset,
        path,
        frames=config.sequences * config.frames,
        sequences=config.sequences,
        sensors=config.sensors,
        seed=config.seed,
        stride_s=config.stride_s,
        traffic=config.traffic,
        world=config.world,
        cache=RIGS[find_preset(config.preset).rig].caches,
        **others,
    )
