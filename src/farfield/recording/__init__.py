"""Simulated and converted frames in bulk."""

from farfield.recording.simulated import RecordingSummary, record
from farfield.recording.wanted import SimulationConfig, ensure
from farfield.recording.writing import write_whole

__all__ = ["RecordingSummary", "SimulationConfig", "ensure", "record", "write_whole"]
