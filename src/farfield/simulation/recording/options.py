"""What ``farfield simulate`` takes, and what comes of it: a preset with its changes and the frames of each sequence."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from farfield.errors import ConfigError
from farfield.simulation.rig import RIGS

if TYPE_CHECKING:
    from farfield.simulation import Preset

MAX_STRIDE_S = 1.0
"""Readers begin a new segment after a longer pause."""

SWEEP_PERIOD_S = 0.1
"""Time between sweeps of a raw recording."""


@dataclass(frozen=True, kw_only=True)
class RecordingOptions:
    """What to simulate and where to write it.

    Args:
        preset: What to simulate: a preset's name; raw recordings take a preset too.
        out: Folder to write into; made if absent.
        frames: Number of frames in all, spread evenly over the sequences; the preset's own if None. Of a raw recording
            the sweeps of each LiDAR in all, 10 a second.
        sequences: Number of sequences; the preset's own if None.
        sensors: What to write, as names or as one text with commas; the preset's own if None, of a raw recording all.
        weather: Put every sequence into this weather; several with commas between take turns.
        time: Put every sequence into this time of day, "day" or "night".
        seed: The preset's own if None.
        stride_s: Seconds between frames of a sequence, at most 1; the preset's own if None. Not for raw recordings.
        uniform_offset_ms: How much later the uniform pattern is measured, in every sequence.
        traffic: On which side traffic keeps, "right" or "left"; the preset's own if None. Not for raw recordings.
        workers: Processes; 0 takes as many as there are cores, units of work and memory for.
        engine: Where the work is done: a name of ``farfield.jobs.ENGINES``.
        cache: Also write the binary cache that makes reading fast. Not for raw recordings.
        raw: Write the raw streams of each drive, in bags, instead of frames.
        dry_run: Report what would be done, and do nothing.
    """

    preset: "str | Preset"
    out: Path
    frames: int | None = None
    sequences: int | None = None
    sensors: str | Sequence[str] | None = None
    weather: str | None = None
    time: str | None = None
    seed: int | None = None
    stride_s: float | None = None
    uniform_offset_ms: float | None = None
    traffic: str | None = None
    workers: int = 0
    engine: str = "local"
    cache: bool = False
    raw: bool = False
    dry_run: bool = False

    @property
    def preset_changes(self) -> dict[str, Any]:
        """Settings of the preset that are changed, as :func:`farfield.simulation.find_preset` takes them."""
        span_ms = None if self.uniform_offset_ms is None else (self.uniform_offset_ms, self.uniform_offset_ms)
        changes = {
            "weather": self.weather,
            "time": self.time,
            "stride_s": self.stride_s,
            "traffic": self.traffic,
            "uniform_offset_ms": span_ms,
        }
        return {name: value for name, value in changes.items() if value is not None}

    def resolve(self) -> "Recording":
        """The recording that these options describe.

        Raises:
            ConfigError: If there is no such preset, sensor or weather, or the options do not go together.
        """
        from farfield.simulation import find_preset
        from farfield.simulation.frozen import FROZEN
        from farfield.simulation.presets import check_sensors

        changes = self.preset_changes
        if self.raw and (self.stride_s is not None or self.cache or self.traffic is not None):
            raise ConfigError(
                "--recording: expected neither --stride-s, --cache nor --traffic; the sensors run at their own rates"
            )
        preset = find_preset(self.preset, **changes) if isinstance(self.preset, str) else self.preset
        frozen = preset.name in FROZEN
        # which presets, changes and formats go together
        if self.raw:
            if preset.rig != "cirrus" or frozen:
                raise ConfigError(
                    f"--recording: expected a preset of the Cirrus car, not frozen, such as cirrus-sim; got "
                    f"{preset.name}"
                )
            preset = replace(preset, stride_s=SWEEP_PERIOD_S)
        elif frozen and (changes or self.sensors or self.seed not in (None, preset.seed)):
            raise ConfigError(
                f"{preset.name} is frozen: expected its own seed and settings. Use cirrus-sim for others."
            )
        if preset.stride_s > MAX_STRIDE_S or preset.stride_s <= 0:
            raise ConfigError(
                f"--stride-s: expected more than 0 and at most {MAX_STRIDE_S:g} s, got {preset.stride_s:g}"
            )
        if self.cache and not RIGS[preset.rig].caches:
            raise ConfigError("--cache: expected a Cirrus preset; files of other layouts have no such cache")
        # sensors, and how many frames of each sequence
        sensors = self.sensors
        if isinstance(sensors, str):
            sensors = sensors.replace(" ", "").split(",") if sensors else None
        default = RIGS[preset.rig].sensors if self.raw else preset.sensors
        return Recording(
            preset=preset,
            seed=preset.seed if self.seed is None else self.seed,
            sensors=check_sensors(preset, tuple(sensors) if sensors else default),
            plan=frames_of_sequences(preset, self.frames, self.sequences, frozen=frozen),
            out=self.out,
            cache=self.cache,
            frozen=frozen,
            raw=self.raw,
        )


@dataclass(frozen=True, kw_only=True)
class Recording:
    """What is written where.

    Args:
        preset: What is simulated, with its changes.
        seed: Its seed.
        sensors: Which sensors are written.
        plan: Number of frames of each sequence; of a raw recording, sweeps.
        out: The folder.
        cache: Whether the binary cache of the clouds is written too.
        frozen: Whether frames are compared with the recorded checksums of the preset.
        raw: Whether the raw streams are written, in bags, instead of frames.
    """

    preset: "Preset"
    seed: int
    sensors: tuple[str, ...]
    plan: tuple[int, ...]
    out: Path
    cache: bool = False
    frozen: bool = False
    raw: bool = False


def frames_of_sequences(
    preset: "Preset", frames: int | None, sequences: int | None, *, frozen: bool
) -> tuple[int, ...]:
    """Number of frames of each sequence.

    Args:
        preset: What is simulated.
        frames: Frames in all, spread evenly; the preset's own if None.
        sequences: Number of sequences; the preset's own if None.
        frozen: Whether only the preset's own sequences and frames may be taken.

    Raises:
        ConfigError: If the sequences have no room for the frames, or a frozen split has fewer.
    """
    count = len(preset.segments) if sequences is None else sequences
    if count < 1:
        raise ConfigError(f"--sequences: expected at least 1, got {count}")
    most = len(preset.segments) * preset.segments[0].frames
    if frozen and (count > len(preset.segments) or (frames or 0) > most):
        raise ConfigError(
            f"{preset.name} is frozen: expected at most {len(preset.segments)} x {preset.segments[0].frames} frames"
        )
    if frames is None:
        plan = [preset.segment(sequence).frames for sequence in range(count)]
    elif frames < 1:
        raise ConfigError(f"--frames: expected at least 1, got {frames}")
    else:
        used = range(min(count, frames))
        plan = spread(frames, [preset.segment(i).frames if frozen else preset.max_frames(i) for i in used])
    for sequence, planned in enumerate(plan):
        if planned > preset.max_frames(sequence):
            raise ConfigError(
                f"--stride-s: sequence {sequence} lasts {preset.segment(sequence).duration_s:g} s and has room for "
                f"{preset.max_frames(sequence)} frames, expected {planned}. Take a smaller --stride-s or fewer "
                "--frames."
            )
    return tuple(plan)


def spread(total: int, capacity: list[int]) -> list[int]:
    """Spread frames evenly over sequences, none beyond its length.

    Raises:
        ConfigError: If the sequences together have no room for them.
    """
    if total > sum(capacity):
        raise ConfigError(
            f"--frames: {len(capacity)} sequences have room for {sum(capacity)} frames, got {total}. Take more "
            "--sequences or a smaller --stride-s."
        )
    plan = [0] * len(capacity)
    while (remaining := total - sum(plan)) > 0:
        unfilled = [i for i, most in enumerate(capacity) if plan[i] < most]
        for rank, i in enumerate(unfilled):
            share = remaining // len(unfilled) + (rank < remaining % len(unfilled))
            plan[i] = min(plan[i] + share, capacity[i])
    return plan


def silent(line: str) -> None:
    """Report nothing: the default of ``report``."""
