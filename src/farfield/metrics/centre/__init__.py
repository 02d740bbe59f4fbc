"""Scores by centre distance: DDS, wDDS and nuScenes."""

from farfield.metrics.centre.dds import DdsSettings
from farfield.metrics.centre.objects import ObjectIntervals, object_intervals

__all__ = ["DdsSettings", "ObjectIntervals", "object_intervals"]
