"""Point operators in plain PyTorch: one code for CPU and CUDA, ragged rather than padded.

Points of a batch are the rows of one tensor, frame after frame, and ``lengths`` says how many rows each frame has.
Neighbourhoods are lists of pairs, so that their cost follows the neighbours there are and not the limit.
"""

from farfield.detectors.pointrcnn.points.neighbours import (
    Groups,
    ball_query,
    frame_rows,
    group_max,
    interpolate,
    three_nearest,
)
from farfield.detectors.pointrcnn.points.roi import in_roi_frames, points_in_rois
from farfield.detectors.pointrcnn.points.sampling import (
    BandConfig,
    WindowConfig,
    content_rank,
    farthest_points,
    first_of_bands,
    prefix_rows,
    sample_bands,
    share_budget,
    spread_points,
)

__all__ = [
    "BandConfig",
    "Groups",
    "WindowConfig",
    "ball_query",
    "content_rank",
    "farthest_points",
    "first_of_bands",
    "frame_rows",
    "group_max",
    "in_roi_frames",
    "interpolate",
    "points_in_rois",
    "prefix_rows",
    "sample_bands",
    "share_budget",
    "spread_points",
    "three_nearest",
]
