"""Clocks, synchronisation of streams and deskewing. Stamps are whole nanoseconds, int64."""

from farfield.timing.blocks import MatchBlock, match_blocks
from farfield.timing.clocks import ClockModel, drift_bound_ppm, fit_clock
from farfield.timing.deskewing import PoseTrack, deskew, deskew_boxes
from farfield.timing.matching import StampMatches, match_times
from farfield.timing.streaming import MatchedGroup, StreamMatcher

__all__ = [
    "ClockModel",
    "MatchBlock",
    "MatchedGroup",
    "PoseTrack",
    "StampMatches",
    "StreamMatcher",
    "deskew",
    "deskew_boxes",
    "drift_bound_ppm",
    "fit_clock",
    "match_blocks",
    "match_times",
]
