"""Detectors meet data sets: one way from a detector to what it found, ready to be scored."""

from farfield.detection.against import against, in_coordinates
from farfield.detection.detecting import DetectionPlan, detect, given, median_ms, search
from farfield.detection.seeing import Frames, as_trained, suitable_clouds
from farfield.detection.work import FrameDetections

__all__ = [
    "DetectionPlan",
    "FrameDetections",
    "Frames",
    "against",
    "as_trained",
    "detect",
    "given",
    "in_coordinates",
    "median_ms",
    "search",
    "suitable_clouds",
]
