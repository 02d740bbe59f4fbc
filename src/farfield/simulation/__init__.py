"""Physics to Frame: roads, traffic, LiDARs, radar, cameras and weather; two measuring cars with their sensors."""

from farfield.simulation.presets import PRESETS, Preset, find_preset
from farfield.simulation.sequence import simulate_frame, simulate_sequence

__all__ = ["PRESETS", "Preset", "find_preset", "simulate_frame", "simulate_sequence"]
