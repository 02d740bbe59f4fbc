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
]
