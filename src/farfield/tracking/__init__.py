"""Tracking by detection: detections of a drive to tracks with identities and velocities."""

from farfield.tracking.joining import Joining, joined
from farfield.tracking.presets import PRESETS, preset, with_options
from farfield.tracking.settings import TrackerSettings
from farfield.tracking.tracker import track

__all__ = ["PRESETS", "Joining", "TrackerSettings", "joined", "preset", "track", "with_options"]
