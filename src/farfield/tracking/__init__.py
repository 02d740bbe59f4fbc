"""Tracking by detection: detections of a drive to tracks with identities and velocities."""

from farfield.tracking.presets import PRESETS, preset
from farfield.tracking.settings import TrackerSettings
from farfield.tracking.tracker import track

__all__ = ["PRESETS", "TrackerSettings", "preset", "track"]
