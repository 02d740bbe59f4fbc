"""How many frames of each sequence a recording has."""

from typing import TYPE_CHECKING

from farfield.errors import ConfigError

if TYPE_CHECKING:
    from farfield.simulation import Preset

MAX_STRIDE_S = 1.0
"""Readers begin a new segment after a longer pause."""


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
        plan = spread(frames, [preset.segment(i).frames if frozen else preset.longest(i) for i in used])
    _check_room(preset, plan)
    return tuple(plan)


def spread(total: int, longest: list[int]) -> list[int]:
    """Spread frames evenly over sequences, none beyond its length.

    Raises:
        ConfigError: If the sequences together have no room for them.
    """
    if total > sum(longest):
        raise ConfigError(
            f"--frames: {len(longest)} sequences have room for {sum(longest)} frames, got {total}. Take more "
            "--sequences or a smaller --stride-s."
        )
    plan = [0] * len(longest)
    while (left := total - sum(plan)) > 0:
        open_ones = [i for i, most in enumerate(longest) if plan[i] < most]
        for rank, i in enumerate(open_ones):
            share = left // len(open_ones) + (rank < left % len(open_ones))
            plan[i] = min(plan[i] + share, longest[i])
    return plan


def _check_room(preset: "Preset", plan: list[int]) -> None:
    for sequence, planned in enumerate(plan):
        if planned > preset.longest(sequence):
            raise ConfigError(
                f"--stride-s: sequence {sequence} lasts {preset.segment(sequence).duration_s:g} s and has room for "
                f"{preset.longest(sequence)} frames, expected {planned}. Take a smaller --stride-s or fewer --frames."
            )
