"""What ``farfield simulate`` takes, and what comes of it: a preset with its changes and the frames of each sequence."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from farfield.errors import ConfigError
from farfield.simulation.rig import RIGS
from farfield.vocabulary.conditions import Side, Time, Weather, World
from farfield.vocabulary.counts import count_of

if TYPE_CHECKING:
    from farfield.simulation import Preset

MAX_STRIDE_S = 1.0
"""Readers begin a new segment after a longer pause."""

SWEEP_PERIOD_S = 0.1
"""Time between sweeps of a raw recording."""


@dataclass(frozen=True, kw_only=True)
class RecordingOptions:
    """How a preset is written: the flags of ``farfield simulate`` and the keywords of :func:`farfield.simulate`.

    Args:
        frames: Number of frames in all, spread evenly over the sequences (default: the preset's own).
        sequences: Number of sequences, each another road with other traffic (default: the preset's own).
        sensors: What to write, separated by commas. Cirrus: gaussian, uniform, camera. K-Radar: os2-64, os1-128,
            cam-front, cam-left, cam-right, cam-rear, cells (the radar's cells in the wide region, to train on), sparse,
            polar3d, cube, tesseract (260 MB a frame). RADIATE: polar, cartesian.
        weather: Put every sequence into this weather; several with commas between take turns.
        time: Put every sequence into this time of day.
        seed: Another seed gives another world (default: the preset's own).
        stride_s: Seconds between frames of a sequence, at most 1 (default: the preset's own). Not with --recording.
        uniform_offset_ms: How much later the uniform pattern is taken, in every sequence; 0 is the ideal pair.
        traffic: On which side it keeps; the left is the mirror image of the right. The preset's own unless given. Not
            with --recording.
        world: What stands beside and on the roads: v2, or v3 with plants that rays enter, street furniture, rows of
            parked vehicles and bodies with the surfaces of real ones. The preset's own unless given.
        workers: Processes; 0 takes as many as there are cores, frames and memory for.
        engine: Where the frames are simulated: local, ray, or an installed engine's name.
        address: Ray's cluster: auto for the one that this machine is a node of, or HOST:PORT (default: a Ray of this
            machine alone, started for the command).
        cache: Also write the binary cache that makes reading fast (Cirrus). Not with --recording.
        recording: Write the raw streams of each drive of the Cirrus car instead of frames: a ROS 2 bag (MCAP) with the
            LiDARs at 10 Hz, the camera at 30 Hz (320 pixels wide), two IMUs at 100 Hz, GPS at 1 Hz and the car's pose,
            each with a clock of its own, and SEQUENCE_truth.json beside. --frames counts sweeps, 10 a second.
        dry_run: Say what would be written, and write nothing.
    """

    frames: int | None = None
    sequences: int | None = None
    sensors: str | Sequence[str] | None = None
    weather: Weather | str | None = None
    time: Time | None = None
    seed: int | None = None
    stride_s: float | None = None
    uniform_offset_ms: float | None = None
    traffic: Side | None = None
    world: World | None = None
    workers: int = 0
    engine: str = "local"
    address: str = ""
    cache: bool = False
    recording: bool = False
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
            "world": self.world,
            "uniform_offset_ms": span_ms,
        }
        return {name: value for name, value in changes.items() if value is not None}

    def resolve(self, preset: "str | Preset", out: Path) -> "Recording":
        """The recording that these options describe.

        Args:
            preset: What to simulate, or its name.
            out: Folder to write into; made if absent.

        Raises:
            ConfigError: If there is no such preset, sensor or weather, or the options do not go together.
        """
        from farfield.simulation import find_preset
        from farfield.simulation.frozen import FROZEN
        from farfield.simulation.presets import check_sensors

        changes = self.preset_changes
        if self.recording and (self.stride_s is not None or self.cache or self.traffic is not None):
            raise ConfigError(
                "--recording: expected neither --stride-s, --cache nor --traffic; the sensors run at their own rates"
            )
        preset = find_preset(preset, **changes) if isinstance(preset, str) else preset
        frozen = preset.name in FROZEN
        # which presets, changes and formats go together
        if self.recording:
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
        default = RIGS[preset.rig].sensors if self.recording else preset.sensors
        return Recording(
            preset=preset,
            seed=preset.seed if self.seed is None else self.seed,
            sensors=check_sensors(preset, tuple(sensors) if sensors else default),
            plan=frames_of_sequences(preset, self.frames, self.sequences, frozen=frozen),
            out=out,
            cache=self.cache,
            frozen=frozen,
            raw=self.recording,
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
            f"{preset.name} is frozen: expected at most {len(preset.segments)} "
            f"x {count_of(preset.segments[0].frames, 'frame')}"
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
                f"{count_of(preset.max_frames(sequence), 'frame')}, expected "
                f"{planned}. Take a smaller --stride-s or fewer "
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
            f"--frames: {count_of(len(capacity), 'sequence has', 'sequences have')} room "
            f"for {count_of(sum(capacity), 'frame')}, got {total}. Take more "
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
