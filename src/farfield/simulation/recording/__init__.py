"""Simulated data sets on disk: frames in a real data set's layout, resumable and in bulk; raw streams in ``raw``."""

from farfield.simulation.recording.frames import recorded_frames, write_whole
from farfield.simulation.recording.options import RecordingOptions
from farfield.simulation.recording.recorder import RecordingSummary, SimulationConfig, ensure, record

__all__ = [
    "RecordingOptions",
    "RecordingSummary",
    "SimulationConfig",
    "ensure",
    "record",
    "recorded_frames",
    "write_whole",
]
