"""Live checks of annotated boxes: pure functions, quick enough to run at every edit."""

from farfield.studio.editing.checking.contract import (
    CheckSettings,
    Course,
    Detected,
    Finding,
    Scene,
    SizeRange,
    Step,
    View,
)
from farfield.studio.editing.checking.running import CHECKS, check
from farfield.studio.editing.checking.scene import Surroundings
from farfield.studio.editing.checking.statistics import size_ranges

__all__ = [
    "CHECKS",
    "CheckSettings",
    "Course",
    "Detected",
    "Finding",
    "Scene",
    "SizeRange",
    "Step",
    "Surroundings",
    "View",
    "check",
    "size_ranges",
]
