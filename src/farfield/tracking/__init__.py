"""Tracking by detection: detections of a drive to tracks with identities and velocities."""

from farfield.tracking.offline import ANNOTATED, JoinSettings, join_settings, join_tracks
from farfield.tracking.presets import PRESETS, TrackerSettings, preset, with_options
from farfield.tracking.tracker import track

__all__ = [
    "ANNOTATED",
    "PRESETS",
    "JoinSettings",
    "TrackerSettings",
    "join_settings",
    "join_tracks",
    "preset",
    "track",
    "with_options",
]
