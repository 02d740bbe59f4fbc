"""Frames of simulated sequences: the same bytes for the same (preset, seed, sequence, index), in whatever order."""

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Int

from farfield.errors import ConfigError
from farfield.frame import Boxes, Frame
from farfield.geometry.poses import invert
from farfield.simulation import labels
from farfield.simulation.lidar.model import PATTERNS, Scan
from farfield.simulation.presets import Preset, find_preset
from farfield.simulation.world.scene import Scene, State
from farfield.simulation.lidar.sweep import Sweep, sweep

_EPOCH_NS = 1_600_000_000_000_000_000


def frame_time_ns(preset: Preset, seed: int, sequence: int, index: int) -> int:
    """The time that names a frame: sequences lie 1000 s apart, seeds a million seconds."""
    start = _EPOCH_NS + (seed % 1000) * 10**15 + sequence * 10**12
    return start + round(index * preset.stride_s * 1e9)


def frame_times_ns(preset: Preset, seed: int, sequence: int, index: int) -> dict[str, int]:
    """The time of each pattern's sweep."""
    stem = frame_time_ns(preset, seed, sequence, index)
    return {"gaussian": stem, "uniform": stem + round(preset.uniform_offset_ms * 1e6)}


def road_of(preset: Preset, sequence: int) -> str:
    """The template of a sequence: mixed presets alternate highway and urban."""
    return ("highway", "urban")[sequence % 2] if preset.road == "mixed" else preset.road


@lru_cache(maxsize=2)
def _scene(preset: Preset, seed: int, sequence: int) -> Scene:
    source = np.random.SeedSequence((seed, sequence))
    scene_seed, sensor_seed = source.spawn(2)
    height = np.random.default_rng(sensor_seed).uniform(*preset.sensor_height_m)
    return Scene(road_of(preset, sequence), scene_seed, duration_s=preset.duration_s, sensor_height_m=float(height))


def _sweep(preset: Preset, state: State, pattern: str, seeds: np.random.SeedSequence, later: State) -> Sweep:
    """Cast one pattern; its cloud is given in the Gaussian sensor's frame of ``state``."""
    rng = np.random.default_rng(seeds)
    origin = (0.0, 0.0, 0.0) if pattern == "gaussian" else preset.uniform_origin_m
    scan = Scan.draw(pattern, preset.lidar, rng, origin_m=origin)
    result = sweep(scan, preset.lidar, later.bodies, later.world_T_lidar, rng)
    if later is state:
        return result
    moved = result.cloud.transform(invert(state.world_T_lidar) @ later.world_T_lidar)
    return Sweep(moved, result.actor)


def _annotate(state: State, sweeps: dict[str, Sweep], later: State) -> tuple[Boxes, Boxes]:
    """Visible and full boxes of the road users with enough points, in the same order."""
    full = labels.full_boxes(state.actors, state.bottom_m, state.yaw_rad, invert(state.world_T_lidar))
    owners = {"gaussian": sweeps["gaussian"].actor, "uniform": _renumber(sweeps["uniform"].actor, later, state)}
    counts = {name: np.bincount(owner[owner >= 0], minlength=len(full)) for name, owner in owners.items()}
    both = counts["gaussian"] + counts["uniform"]
    kept = (both >= labels.MIN_POINTS_BOTH) & (counts["gaussian"] >= labels.MIN_POINTS_GAUSSIAN)
    kept &= full.centre_m[:, 0] > 0
    row = np.full(len(full) + 1, -1)
    row[np.flatnonzero(kept)] = np.arange(kept.sum())
    owner = row[np.concatenate([owners["gaussian"], owners["uniform"] if later is state else np.full(0, -1)])]
    points = [sweeps["gaussian"].cloud.points_m] + ([sweeps["uniform"].cloud.points_m] if later is state else [])
    joined = np.concatenate(points)[owner >= 0]
    chosen = full[kept].replace(point_count=counts["gaussian"][kept])
    visible = labels.visible_boxes(chosen, joined, owner[owner >= 0]) if len(chosen) else chosen
    return visible, full[kept].replace(point_count=counts["uniform"][kept])


def _renumber(actor: Int[np.ndarray, " n"], source: State, target: State) -> Int[np.ndarray, " n"]:
    """Translate rows of one state's road users to those of another state; -1 where it lacks them."""
    if source is target:
        return actor
    rows = {item.track_id: row for row, item in enumerate(target.actors)}
    table = np.array([rows.get(item.track_id, -1) for item in source.actors] + [-1])
    return table[actor]


def simulate_frame(
    preset: str | Preset, *, seed: int | None = None, sequence: int, index: int, **changes: Any
) -> Frame:
    """Simulate one frame with both patterns.

    Args:
        preset: A preset or its name.
        seed: Seed of the whole data set; the preset's own unless given.
        sequence: Number of the sequence; any number gives another world.
        index: Number of the frame within it.
        changes: Settings of the preset to change, by name.

    Returns:
        Clouds "gaussian" and "uniform" in the Gaussian sensor's frame (x forward, y left, z up, ground near z = -2),
        annotated with the boxes of the visible parts; ``metadata`` holds ``full_boxes`` (the whole bodies, in the
        same order), ``point_count_gaussian`` and ``point_count_uniform``.

    Raises:
        ConfigError: If the preset is unknown or the frame lies beyond the sequence's duration.
        MissingExtraError: If embreex is not installed.
    """
    chosen = find_preset(preset, **changes) if isinstance(preset, str) else preset
    seed = chosen.seed if seed is None else seed
    time_s = index * chosen.stride_s
    later_s = time_s + chosen.uniform_offset_ms / 1000
    if sequence < 0 or index < 0 or later_s > chosen.duration_s:
        raise ConfigError(
            f"simulate: expected sequence >= 0 and a frame within 0..{chosen.duration_s:g} s, got sequence {sequence}, "
            f"frame {index} at {later_s:g} s. Ask for fewer frames, a smaller stride_s, or a longer duration_s."
        )
    scene = _scene(chosen, seed, sequence)
    state = scene.at(time_s)
    later = state if later_s == time_s else scene.at(later_s)
    frame_seed = np.random.SeedSequence((seed, sequence, index), spawn_key=(7,)).spawn(2)
    sweeps = {
        name: _sweep(chosen, state, name, child, later if name == "uniform" else state)
        for name, child in zip(PATTERNS, frame_seed, strict=True)
    }
    visible, full = _annotate(state, sweeps, later)
    stem = frame_time_ns(chosen, seed, sequence, index)
    return Frame(
        sequence=f"segment_{sequence:02d}",
        frame_id=str(stem),
        time_ns=stem,
        times_ns=frame_times_ns(chosen, seed, sequence, index),
        clouds={name: result.cloud for name, result in sweeps.items()},
        annotation=lambda: visible,
        world_T_lidar=state.world_T_lidar,
        conditions={"road": scene.template, "weather": "normal", "time": "day"},
        metadata={
            "full_boxes": full.replace(point_count=visible.point_count),
            "point_count_gaussian": visible.point_count,
            "point_count_uniform": full.point_count,
            "box_protocol": "visible",
            "preset": chosen.name,
            "seed": seed,
        },
    )


def simulate_sequence(
    preset: str | Preset,
    *,
    seed: int | None = None,
    sequence: int,
    frames: int | None = None,
    start: int = 0,
    **changes: Any,
) -> Iterator[Frame]:
    """Simulate consecutive frames of one sequence.

    Args:
        preset: A preset or its name.
        seed: Seed of the whole data set; the preset's own unless given.
        sequence: Number of the sequence.
        frames: How many frames; the preset's own count unless given.
        start: Number of the first frame.
        changes: Settings of the preset to change, by name, such as ``stride_s=1.0``.

    Yields:
        Frames as ``simulate_frame`` makes them.
    """
    chosen = find_preset(preset, **changes) if isinstance(preset, str) else preset
    count = chosen.frames if frames is None else frames
    for index in range(start, start + count):
        yield simulate_frame(chosen, seed=seed, sequence=sequence, index=index)
