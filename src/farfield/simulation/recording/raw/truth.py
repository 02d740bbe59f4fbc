"""What is known of a raw recording: true times, clocks, poses, errors of the IMUs; as JSON beside the bag."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from farfield.files.atomic import write_text
from farfield.simulation.recording.raw.parts import streams_of
from farfield.simulation.recording.settings import RecordingOptions

if TYPE_CHECKING:
    from farfield.simulation.rigs.drive import SimulatedDrive

POSE_STEP_S = 0.02


def truth_path(recording: RecordingOptions, sequence: int) -> Path:
    """The file beside the bag of a drive."""
    return recording.out / f"{recording.preset.segment(sequence).name}_truth.json"


def truth(recording: RecordingOptions, sequence: int) -> dict[str, Any]:
    """All that is known of a drive.

    ``streams`` tells of each stream how its clock reads (``offset_ms`` at ``epoch_ns`` and ``drift_ppm`` against GPS
    time, ``jitter_ms``), when each message was taken (``true_ns``; a sweep when it began), which were lost, and the
    least time on the way to the computer, whose clock is ``computer``. ``poses`` are those of the car,
    ``world_T_base`` as rows of 3 x 4; ``mounts`` where the sensors sit in it.
    """
    from farfield.simulation.raw.clocks import schedule
    from farfield.simulation.raw.measure import ORIGIN_DEG, biases_of, mounts, small_camera
    from farfield.simulation.rigs.drive import drive_of

    drive = drive_of(recording.preset, recording.seed, sequence)
    plan = schedule(drive, recording.plan[sequence], streams_of(recording))
    camera = small_camera()
    return {
        "epoch_ns": plan.epoch_ns,
        "span_s": plan.span_s,
        "computer": asdict(plan.host),
        "streams": {name: stream.truth(plan.epoch_ns) for name, stream in plan.streams.items()},
        "mounts": {name: matrix[:3].ravel().tolist() for name, matrix in mounts(drive).items()},
        "imu_biases": {name: biases_of(drive, name) for name in ("imu_front", "imu_rear")},
        "camera": {"matrix": camera.matrix.ravel().tolist(), "distortion": camera.distortion.tolist()},
        "origin_deg": list(ORIGIN_DEG),
        "poses": _poses(drive, plan.epoch_ns, plan.span_s),
    }


def _poses(drive: "SimulatedDrive", epoch_ns: int, span_s: float) -> dict[str, Any]:
    from farfield.simulation.raw.measure import ego_poses

    time_s = np.arange(round((span_s + 0.2) / POSE_STEP_S) + 1) * POSE_STEP_S
    rows = np.round(ego_poses(drive, time_s)[:, :3].reshape(-1, 12), 9)
    return {"time_ns": (epoch_ns + np.rint(time_s * 1e9).astype(np.int64)).tolist(), "world_T_base": rows.tolist()}


def write_truth(recording: RecordingOptions, sequence: int) -> Path:
    """Write it."""
    path = truth_path(recording, sequence)
    write_text(path, json.dumps(truth(recording, sequence)) + "\n")
    return path
