"""Boxes from gestures: a press and drag, a click, a box to fit again, a peak of the radar.

Every function takes the frame's original points, shape (n, 3), metres, float, all of them, with the ground and in the
coordinates in which boxes are kept, and gives a :class:`BoxFit`. None keeps anything between calls.
"""

from farfield.annotation.fitting.boxes import drop_to_ground, fit_click, fit_drag, fit_rectangle, refit
from farfield.annotation.fitting.prior import Box, BoxFit, Extent, FitCandidate, Prior, prior_of
from farfield.annotation.fitting.radar import fit_radar_peak, peak_near

__all__ = [
    "Box",
    "BoxFit",
    "Extent",
    "FitCandidate",
    "Prior",
    "drop_to_ground",
    "fit_click",
    "fit_drag",
    "fit_radar_peak",
    "fit_rectangle",
    "peak_near",
    "prior_of",
    "refit",
]
