"""What a recording says of itself before and after the work, line by line."""

from collections.abc import Iterator, Sequence

from farfield.frame.provenance import SIMULATION_FILE
from farfield.simulation.recording.frames import bytes_needed
from farfield.simulation.recording.settings import RecordingOptions

_SHOWN = 6  # sequences whose weather is shown


def announced(recording: RecordingOptions, count: int, processes: int) -> Iterator[str]:
    """What is going to be written: frames, sensors, room, weather.

    Args:
        recording: What is written where.
        count: Frames that are still missing.
        processes: Processes that will work.
    """
    from farfield.simulation.rigs.drive import drive_of

    preset, seed, plan = recording.preset, recording.seed, recording.plan
    yield f"preset {preset.name}, seed {seed}: {sum(plan)} frames in {len(plan)} sequences, {count} still to write"
    needed_gb = bytes_needed(recording, count) / 1e9
    yield f"  {', '.join(recording.sensors)}; every {preset.stride_s:g} s; at most {needed_gb:.2f} GB"
    if len(plan) > 1 and max(plan) == 1:
        yield (
            f"  note: {len(plan)} drives of one frame each, another road and weather every time: nothing follows a "
            "frame. For frames of one drive add --sequences 1, for several drives more --frames"
        )
    for sequence in range(len(plan))[:_SHOWN]:
        drive = drive_of(preset, seed, sequence)
        yield f"  {drive.segment.name}: {drive.segment.road}; {drive.weather.describe()}"
    if len(plan) > _SHOWN:
        yield f"  ... {len(plan) - _SHOWN} more, all in {recording.out / SIMULATION_FILE}"
    yield f"  {processes} process{'es' if processes > 1 else ''}, into {recording.out}"


def concluded(recording: RecordingOptions, verdicts: Sequence[str]) -> Iterator[str]:
    """What was written, and what the checksums of a frozen split say."""
    yield f"wrote {len(verdicts)} frames into {recording.out}"
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
