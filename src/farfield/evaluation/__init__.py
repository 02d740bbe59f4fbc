"""Detectors meet data sets: one way from a detector to what it found, ready to be scored."""

from farfield.evaluation.detecting import DetectionPlan, detect, given, median_ms, search
from farfield.evaluation.ground_truth import against, in_coordinates
from farfield.evaluation.views import Frames, as_trained, suitable_clouds
from farfield.evaluation.worker import FrameDetections

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
