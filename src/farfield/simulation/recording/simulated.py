"""Simulate a data set and write it in a real data set's layout: resumable, with several processes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from farfield.errors import ConfigError
from farfield.jobs import JobOptions, JobRun, Unit
from farfield.jobs.journal import mark_of, state_of
from farfield.jobs.runs import Progress
from farfield.simulation.recording.frames import Simulate, check_disk, journal_of, units_of
from farfield.simulation.recording.planning import MAX_STRIDE_S, frames_of_sequences
from farfield.simulation.recording.rigs import files_of, writer_for
from farfield.simulation.recording.settings import RecordingOptions, claim
from farfield.simulation.recording.words import announced, concluded

if TYPE_CHECKING:
    from farfield.simulation import Preset


_FINISHED = Unit("what belongs to whole sequences")


@dataclass(frozen=True, kw_only=True)
class RecordingSummary:
    """What a recording wrote.

    Args:
        recording: What was asked for, with all defaults resolved.
        verdicts: One a frame that was written now: "written", or for a frozen split "identical", "equivalent" or
            "different".
    """

    recording: RecordingOptions
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
    frames: int | None = None,
    sequences: int | None = None,
    sensors: str | Sequence[str] | None = None,
    weather: str | None = None,
    time: str | None = None,
    seed: int | None = None,
    stride_s: float | None = None,
    uniform_offset_ms: float | None = None,
    traffic: str | None = None,
    workers: int = 0,
    engine: str = "local",
    cache: bool = False,
    dry_run: bool = False,
    progress: Progress = iter,
    report: Callable[[str], object] | None = None,
) -> RecordingSummary:
    """Write a simulated data set in the layout of Cirrus, K-Radar, KITTI or RADIATE.

    Called again, it goes on where it stopped: a frame's files appear whole or not at all. The bytes do not depend on
    the number of workers.

    Args:
        preset: Name of what to simulate.
        out: Folder to write into; made if absent.
        frames: Number of frames in all, spread evenly over the sequences; the preset's own if None.
        sequences: Number of sequences; the preset's own if None.
        sensors: What to write, as names or as one text with commas; the preset's own if None.
        weather: Put every sequence into this weather; several with commas between take turns.
        time: Put every sequence into this time of day, "day" or "night".
        seed: The preset's own if None.
        stride_s: Seconds between frames of a sequence, at most 1; the preset's own if None.
        uniform_offset_ms: How much later the uniform pattern is taken, in every sequence.
        traffic: On which side traffic keeps, "right" or "left"; the preset's own if None.
        workers: Processes; 0 takes as many as there are cores, frames and memory for.
        engine: Where the frames are simulated: a name of ``farfield.jobs.ENGINES``.
        cache: Also write the binary cache that makes reading fast.
        dry_run: Say what would be done, and do nothing.
        progress: Wraps the numbers of the frames that are left, to show progress.
        report: Called with each line of what is going to be done and what was done.

    Raises:
        ConfigError: If there is no such preset, sensor or weather, or the settings do not go together.
        DatasetError: If the folder holds something else, or the disk has no room.
        BulkError: If the memory does not suffice for so many workers, or frames killed their workers twice.
    """
    changes: dict[str, Any] = {"weather": weather, "time": time, "stride_s": stride_s, "traffic": traffic}
    if uniform_offset_ms is not None:
        changes["uniform_offset_ms"] = (uniform_offset_ms, uniform_offset_ms)
    changes = {name: value for name, value in changes.items() if value is not None}
    chosen, frozen = _chosen(preset, changes, sensors, seed, cache=cache)
    recording = RecordingOptions(
        preset=chosen,
        seed=chosen.seed if seed is None else seed,
        sensors=_sensors(chosen, sensors),
        plan=frames_of_sequences(chosen, frames, sequences, frozen=frozen),
        out=Path(out),
        cache=cache,
        frozen=frozen,
    )
    bulk = JobOptions(workers=workers, engine=engine, progress=progress)
    if dry_run:
        _say(recording, bulk, report or _silent)
        return RecordingSummary(recording=recording, verdicts=())
    return _run(recording, bulk, report or _silent)


def _chosen(
    preset: str, changes: dict[str, Any], sensors: str | Sequence[str] | None, seed: int | None, *, cache: bool
) -> tuple["Preset", bool]:
    """The preset with its changes, and whether it is frozen."""
    from farfield.simulation import find_preset
    from farfield.simulation.frozen import FROZEN

    chosen, frozen = find_preset(preset, **changes), preset in FROZEN
    if frozen and (changes or sensors or seed not in (None, chosen.seed)):
        raise ConfigError(f"{preset} is frozen: expected its own seed and settings. Use cirrus-sim for others.")
    if chosen.stride_s > MAX_STRIDE_S or chosen.stride_s <= 0:
        raise ConfigError(f"--stride-s: expected more than 0 and at most {MAX_STRIDE_S:g} s, got {chosen.stride_s:g}")
    if cache and not files_of(chosen).caches:
        raise ConfigError("--cache: expected a Cirrus preset; files of other layouts have no such cache")
    return chosen, frozen


def _sensors(preset: "Preset", sensors: str | Sequence[str] | None) -> tuple[str, ...]:
    from farfield.simulation.presets import check_sensors

    if isinstance(sensors, str):
        sensors = sensors.replace(" ", "").split(",") if sensors else None
    return check_sensors(preset, tuple(sensors) if sensors else preset.sensors)


def _say(recording: RecordingOptions, bulk: JobOptions, report: Callable[[str], object]) -> None:
    """The lines of :func:`_run`, of a folder that is left as it is."""
    begun = recording.out.is_dir() and any(recording.out.iterdir())
    left = len(units_of(recording))
    for line in announced(recording, left, bulk.hands(Simulate(recording), left)):
        report(line)
    report(f"{recording.out} {'has files already; what fits is kept' if begun else 'is made'}; nothing is written now")


def _run(recording: RecordingOptions, bulk: JobOptions, report: Callable[[str], object]) -> RecordingSummary:
    claim(recording)
    units, journal, work = units_of(recording), journal_of(recording), Simulate(recording)
    left = sum(not journal.has(unit) for unit in units)
    for line in announced(recording, left, bulk.hands(work, left)):
        report(line)
    check_disk(recording, left)
    with JobRun(work, units, bulk, journal=journal) as running:
        for number in bulk.progress(running):
            if running.here:
                running.enter(number, work(running.unit(number)))
    outcome = running.outcome
    if files_of(recording.preset).finishes and (outcome.written or not journal.has(_FINISHED)):
        files = writer_for(recording.preset, recording.out).finish() or ()  # calibration, times, splits, odometry
        marks = {path.relative_to(recording.out).as_posix(): mark_of(path) for path in files}
        journal.add(_FINISHED, state_of((), journal.setting), marks)
        journal.finish()
    said = journal.values([units[place].name for place in sorted(outcome.clocks)])
    verdicts = tuple(str(verdict or "written") for verdict in said)
    for line in concluded(recording, verdicts):
        report(line)
    return RecordingSummary(recording=recording, verdicts=verdicts)


def _silent(line: str) -> None:
    """Say nothing."""
