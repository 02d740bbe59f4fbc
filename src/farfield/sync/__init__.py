"""Clocks, synchronisation of streams and deskewing. Stamps are whole nanoseconds, int64."""

from farfield.geometry.deskewing import PoseTrack, deskew, deskew_boxes
from farfield.sync.clocks import ClockModel, drift_bound_ppm, fit_clock
from farfield.sync.matching import StampMatches, match_times
from farfield.sync.streaming import MatchBlock, MatchedGroup, StreamMatcher, match_blocks

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
