"""A detector over a data set: the one place where data, detectors and metrics meet."""

from farfield.evaluation.detecting import DetectionPlan, FrameDetections, detect, median_ms, plan_detection
from farfield.evaluation.ground_truth import (
    attach_ground_truth,
    detections_from_boxes,
    in_coordinates,
    read_detections,
    with_conditions,
)
from farfield.evaluation.views import as_trained, suitable_clouds

__all__ = [
    "DetectionPlan",
    "FrameDetections",
    "as_trained",
    "attach_ground_truth",
    "detect",
    "detections_from_boxes",
    "in_coordinates",
    "median_ms",
    "plan_detection",
    "read_detections",
    "suitable_clouds",
    "with_conditions",
]
