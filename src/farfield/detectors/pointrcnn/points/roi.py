"""RoI point pooling (PointRCNN, section 3.3): the points inside each enlarged proposal."""

from collections.abc import Sequence

import torch
from torch import Tensor

from farfield.detectors.pointrcnn.points.neighbours import Groups, chunks, expand_ranges, first_pairs

_CANDIDATES = 1 << 21


def points_in_rois(
    points: Tensor, lengths: Sequence[int], rois: Tensor, roi_lengths: Sequence[int], *, context_m: float, limit: int
) -> Groups:
    """Points of the same frame inside each RoI grown by ``context_m`` at every face, surface included.

    Args:
        points: x, y, z, finite, shape (n, 3).
        lengths: Points of each frame.
        rois: x, y, z of the centre, length, width, height (metres), yaw (radians), shape (m, 7).
        roi_lengths: RoIs of each frame.
        context_m: Growth of each face.
        limit: Points a RoI keeps: the first by row.

    Returns:
        Pairs of a RoI (as centre) and a point.
    """
    points, rois = points.detach().float(), rois.detach().float()
    n, m, found = len(points), len(rois), [torch.zeros(0, dtype=torch.long, device=points.device)]
    first_point = first_roi = 0
    for length, roi_length in zip(lengths, roi_lengths, strict=True):
        inside = _of_one_frame(
            points[first_point : first_point + length], rois[first_roi : first_roi + roi_length], context_m
        )
        found += [(roi + first_roi) * n + point + first_point for roi, point in inside]
        first_point, first_roi = first_point + length, first_roi + roi_length
    return first_pairs(torch.cat(found), n, limit, m)


def _of_one_frame(points: Tensor, rois: Tensor, context_m: float) -> list[tuple[Tensor, Tensor]]:
    """Pairs of RoI and point, in pieces. Only points within reach along x are looked at."""
    if not len(points) or not len(rois):
        return []
    half = rois[:, 3:6] / 2 + context_m
    reach = torch.hypot(half[:, 0], half[:, 1]) * 1.0001 + 1e-3
    order = torch.argsort(points[:, 0], stable=True)
    ranked = points[order]
    x = ranked[:, 0].contiguous()
    low = torch.searchsorted(x, (rois[:, 0] - reach).contiguous())
    high = torch.searchsorted(x, (rois[:, 0] + reach).contiguous(), right=True)
    pairs = []
    for part in chunks(high - low, _CANDIDATES):
        place, roi = expand_ranges(low[part], high[part])
        roi = roi + part.start
        near = torch.nonzero((ranked[place, 1] - rois[roi, 1]).abs() <= reach[roi])[:, 0]
        place, roi = place[near], roi[near]
        inside = (in_roi_frames(ranked[place], rois[roi]).abs() <= half[roi]).all(1)
        pairs.append((roi[inside], order[place[inside]]))
    return pairs


def in_roi_frames(points: Tensor, rois: Tensor) -> Tensor:
    """Points as seen from RoIs, x along the heading (PointRCNN, section 3.3, canonical transformation).

    Args:
        points: x, y, z, shape (p, 3).
        rois: The RoI of each point, shape (p, 7).

    Returns:
        Coordinates from the RoIs' centres, shape (p, 3).
    """
    dx, dy, dz = (points - rois[:, :3]).unbind(1)
    cos, sin = torch.cos(rois[:, 6]), torch.sin(rois[:, 6])
    return torch.stack([dx * cos + dy * sin, dy * cos - dx * sin, dz], 1)
