"""Scores by centre distance: DDS, wDDS and nuScenes."""

from farfield.metrics.centre.dds import DdsSettings
from farfield.metrics.centre.objects import ObjectDifferences, ObjectIntervals, object_differences, object_intervals

__all__ = ["DdsSettings", "ObjectDifferences", "ObjectIntervals", "object_differences", "object_intervals"]
