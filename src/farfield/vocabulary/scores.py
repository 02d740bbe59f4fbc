"""From which score on boxes count, in one place.

A detector gives its boxes from its weights' own threshold on, which is low (0.05 in most of ours): scores such as AP
follow the whole curve and need the unsure boxes too. ``ff.load_detector``, ``predict`` and ``evaluate`` do the same,
so that a file of boxes scores as the detector does. Who gives a threshold (``score_threshold=``,
``--score-threshold``) gets it everywhere. Pictures are for people: they leave out what is unsure, and say so.
"""

SHOWN_SCORE = 0.3
"""Boxes below are left out of pictures, pages and films unless another threshold is given."""
