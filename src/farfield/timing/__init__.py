"""Clocks, synchronisation of streams and deskewing. Stamps are whole nanoseconds, int64."""

from farfield.timing.blocks import Matched, match_blocks
from farfield.timing.clocks import Clock, drift_bound_ppm, fit_clock
from farfield.timing.deskewing import PoseTrack, deskew, deskew_boxes
from farfield.timing.matching import Matches, match_times
from farfield.timing.streaming import Group, StreamMatcher

__all__ = [
    "Clock",
    "Group",
    "Matched",
    "Matches",
    "PoseTrack",
    "StreamMatcher",
    "deskew",
    "deskew_boxes",
    "drift_bound_ppm",
    "fit_clock",
    "match_blocks",
    "match_times",
]
