"""Simulated and converted frames in bulk."""

from farfield.simulation.recording.simulated import RecordingSummary, record
from farfield.simulation.recording.wanted import SimulationConfig, ensure
from farfield.simulation.recording.writing import write_whole

__all__ = ["RecordingSummary", "SimulationConfig", "ensure", "record", "write_whole"]
