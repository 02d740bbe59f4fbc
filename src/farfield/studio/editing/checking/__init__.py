"""Live checks of annotated boxes: pure functions, quick enough to run at every edit."""

from farfield.studio.editing.checking.contract import (
    CheckedFrame,
    CheckSettings,
    DetectorBox,
    LabelIssue,
    NearbyTrack,
    SensorView,
    SizeRange,
    TrackStep,
)
from farfield.studio.editing.checking.running import CHECKS, check
from farfield.studio.editing.checking.scene import Surroundings
from farfield.studio.editing.checking.statistics import size_ranges

__all__ = [
    "CHECKS",
    "CheckSettings",
    "CheckedFrame",
    "DetectorBox",
    "LabelIssue",
    "NearbyTrack",
    "SensorView",
    "SizeRange",
    "Surroundings",
    "TrackStep",
    "check",
    "size_ranges",
]
