"""Live checks of annotated boxes: pure functions, quick enough to run at every edit."""

from farfield.annotation.checking.contract import (
    CheckedFrame,
    CheckSettings,
    DetectorBox,
    LabelIssue,
    NearbyTrack,
    SensorView,
    SizeRange,
    TrackStep,
)
from farfield.annotation.checking.running import CHECKS, check
from farfield.annotation.checking.scene import Surroundings
from farfield.annotation.checking.statistics import size_ranges

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
