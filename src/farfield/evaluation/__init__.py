"""Detectors meet data sets: one way from a detector to what it found, ready to be scored."""

from farfield.evaluation.detecting import (
    DetectionPlan,
    FrameDetections,
    detect,
    detections_from_boxes,
    median_ms,
    plan_detection,
)
from farfield.evaluation.ground_truth import attach_ground_truth, in_coordinates
from farfield.evaluation.views import Frames, as_trained, suitable_clouds

__all__ = [
    "DetectionPlan",
    "FrameDetections",
    "Frames",
    "as_trained",
    "attach_ground_truth",
    "detect",
    "detections_from_boxes",
    "in_coordinates",
    "median_ms",
    "plan_detection",
    "suitable_clouds",
]
