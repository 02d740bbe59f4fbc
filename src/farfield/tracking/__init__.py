"""Tracking by detection: detections of a drive to tracks with identities and velocities."""

from farfield.tracking.joining import ANNOTATED, JoinSettings, joined, joining_of
from farfield.tracking.presets import PRESETS, preset, with_options
from farfield.tracking.settings import TrackerSettings
from farfield.tracking.tracker import track

__all__ = [
    "ANNOTATED",
    "PRESETS",
    "JoinSettings",
    "TrackerSettings",
    "joined",
    "joining_of",
    "preset",
    "track",
    "with_options",
]
