"""Frames of simulated sequences: the same bytes for the same (preset, seed, sequence, index), in whatever order.

A frame's clouds, images, radar products and boxes are computed when they are first read, each sensor from a random
stream of its own.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from farfield.errors import ConfigError
from farfield.frame import Frame
from farfield.simulation.presets import Preset, check_sensors, find_preset
from farfield.simulation.rig import RIGS
from farfield.simulation.rigs.drive import drive_of

_EPOCH_NS = 1_600_000_000_000_000_000


def frame_time_ns(preset: Preset, seed: int, sequence: int, index: int) -> int:
    """The time that names a frame: sequences lie 1000 s apart, seeds a million seconds."""
    start = _EPOCH_NS + (seed % 1000) * 10**15 + sequence * 10**12
    return start + round(index * preset.stride_s * 1e9)


def planned_frame(preset: Preset, *, seed: int, sequence: int, index: int, sensors: tuple[str, ...]) -> Frame:
    """A frame with its names and times; whatever else it has is computed when it is read, its pose is left out."""
    drive = drive_of(preset, seed, sequence)
    return RIGS[preset.rig].frame(drive, index, sensors, frame_time_ns(preset, seed, sequence, index))


def posed_frame(preset: Preset, *, seed: int, sequence: int, index: int, sensors: tuple[str, ...]) -> Frame:
    """A planned frame with the pose of its reference sensor, which needs the sequence's world but no ray."""
    frame = planned_frame(preset, seed=seed, sequence=sequence, index=index, sensors=sensors)
    drive = drive_of(preset, seed, sequence)
    return replace(frame, world_T_frame=drive.scene.ego_pose(drive.time_s(index)) @ drive.mounting.ego_T_lidar)


def simulate_frame(
    preset: str | Preset,
    *,
    seed: int | None = None,
    sequence: int,
    index: int,
    sensors: tuple[str, ...] | None = None,
    **changes: Any,
) -> Frame:
    """Simulate one frame.

    Args:
        preset: A preset or its name.
        seed: Seed of the whole data set (default: the preset's own).
        sequence: Number of the sequence; any number gives another world.
        index: Number of the frame within it.
        sensors: Which of the rig's sensors the frame has (default: the preset's own).
        changes: Settings of the preset to change, by name, such as ``weather="fog"``.

    Returns:
        The Cirrus rig gives clouds "gaussian" and "uniform" in the Gaussian sensor's frame (x forward, y left, z up,
        ground near z = -2), image "camera", and the boxes of the visible parts; the annotation's ``full_boxes`` are
        the whole bodies, its ``details`` ``point_count_gaussian`` and ``point_count_uniform``. The K-Radar rig gives
        clouds "os2-64" (the reference frame) and "os1-128", images "cam-front" and "cam-front-right"..., radar products
        in the radar's frame, and full boxes. The KITTI rig gives cloud "lidar", image "camera", and full boxes of what
        that camera sees, with ``truncation``, ``occlusion`` and ``box_px`` among the annotation's ``details``. The
        RADIATE rig gives radar products "polar" and "cartesian", cloud "radar" of the strongest cells, and full boxes
        of what stands out.

    Raises:
        ConfigError: If the preset is unknown or the frame lies beyond the sequence's duration.
        MissingExtraError: If embreex or numba is not installed (raised when a sensor is first read).
    """
    if isinstance(preset, str):
        preset = find_preset(preset, **changes)
    if sequence < 0 or index < 0 or index >= preset.max_frames(sequence):
        lasts = preset.segment(max(sequence, 0)).duration_s
        raise ConfigError(
            f"simulate: expected sequence >= 0 and a frame within 0..{lasts:g} s, got sequence {sequence}, frame "
            f"{index} at {index * preset.stride_s:g} s. Take fewer frames or a smaller stride_s."
        )
    sensors = check_sensors(preset, preset.sensors if sensors is None else sensors)
    seed = preset.seed if seed is None else seed
    return posed_frame(preset, seed=seed, sequence=sequence, index=index, sensors=sensors)


def simulate_sequence(
    preset: str | Preset,
    *,
    seed: int | None = None,
    sequence: int,
    frames: int | None = None,
    start: int = 0,
    sensors: tuple[str, ...] | None = None,
    **changes: Any,
) -> Iterator[Frame]:
    """Simulate consecutive frames of one sequence.

    Args:
        preset: A preset or its name.
        seed: Seed of the whole data set (default: the preset's own).
        sequence: Number of the sequence.
        frames: How many frames (default: the preset's own count).
        start: Number of the first frame.
        sensors: Which of the rig's sensors the frames have (default: the preset's own).
        changes: Settings of the preset to change, by name, such as ``stride_s=1.0`` or ``weather="rain"``.

    Yields:
        Frames as ``simulate_frame`` makes them.
    """
    if isinstance(preset, str):
        preset = find_preset(preset, **changes)
    count = preset.segment(sequence).frames if frames is None else frames
    for index in range(start, start + count):
        yield simulate_frame(preset, seed=seed, sequence=sequence, index=index, sensors=sensors)
