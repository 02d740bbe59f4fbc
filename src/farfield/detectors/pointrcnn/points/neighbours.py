"""Neighbourhoods: ball query, maximum over a group, and interpolation from the three nearest points.

The ball query is that of PointNet++ (NIPS 2017, section 3.2): the first ``limit`` points, by row, within the radius.
Candidates come from a grid of cells as wide as the radius: sorted cell numbers, found again by searchsorted.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

_CANDIDATES = 1 << 21  # pairs looked at in one go
_DISTANCES = 1 << 25  # distances held at once where all are computed


class Groups(NamedTuple):
    """Pairs of a centre and one of its points, sorted by centre and then by point.

    Args:
        centre: Row of the centre of each pair, shape (p,), int64.
        point: Row of the point of each pair, shape (p,), int64.
        centres: Number of centres.
    """

    centre: Tensor
    point: Tensor
    centres: int


def sorted_keys(keys: Tensor) -> Tensor:
    """Sort whole numbers; numpy sorts them several times faster than torch on a CPU."""
    return keys.sort().values if keys.is_cuda else torch.from_numpy(np.sort(keys.numpy()))


def frame_rows(lengths: Sequence[int], device: torch.device) -> Tensor:
    """Frame number of each row, shape (n,), int64."""
    return torch.repeat_interleave(
        torch.arange(len(lengths), device=device), torch.tensor(lengths, dtype=torch.long, device=device)
    )


def expand_ranges(low: Tensor, high: Tensor) -> tuple[Tensor, Tensor]:
    """All numbers of each half-open range [low, high), range after range, and the range that each belongs to."""
    count = high - low
    owner = torch.repeat_interleave(torch.arange(len(low), device=low.device), count)
    first = low - (count.cumsum(0) - count)
    return torch.arange(len(owner), device=low.device) + first[owner], owner


def chunks(cost: Tensor, limit: int) -> Iterator[slice]:
    """Stretches of rows whose costs sum to about ``limit`` each; a row that costs more stands alone."""
    step = torch.div(cost.cumsum(0) - cost, limit, rounding_mode="floor")
    edges = torch.nonzero(torch.diff(step))[:, 0].add(1).tolist()
    yield from (slice(a, b) for a, b in zip([0, *edges], [*edges, len(cost)], strict=True))


def first_pairs(keys: Tensor, points: int, limit: int, count: int) -> Groups:
    """Groups from unsorted numbers centre * points + point, at most ``limit`` pairs a centre."""
    keys = sorted_keys(keys)
    centre = torch.div(keys, max(points, 1), rounding_mode="floor")
    size = torch.bincount(centre, minlength=count)
    place = torch.arange(len(keys), device=keys.device) - (size.cumsum(0) - size)[centre]
    keep = place < limit
    centre = centre[keep]
    return Groups(centre, keys[keep] - centre * points, count)


def ball_query(
    points: Tensor,
    lengths: Sequence[int],
    centres: Tensor,
    centre_lengths: Sequence[int],
    *,
    radii_m: Sequence[float],
    limits: Sequence[int],
) -> list[Groups]:
    """Points within each radius of each centre of the same frame.

    Args:
        points: x, y, z, finite, shape (n, 3).
        lengths: Points of each frame.
        centres: x, y, z, finite, shape (m, 3).
        centre_lengths: Centres of each frame.
        radii_m: Radii; all are served by one search.
        limits: Pairs a centre that each radius keeps: the first by row.

    Returns:
        Groups for each radius.
    """
    n, m = len(points), len(centres)
    if not n or not m:
        none = torch.zeros(0, dtype=torch.long, device=points.device)
        return [Groups(none, none, m) for _ in radii_m]
    points, centres = points.detach().float(), centres.detach().float()
    order, low, high = _cells_around(points, lengths, centres, centre_lengths, 1.001 * max(radii_m))
    sorted_points = points[order]
    found: list[list[Tensor]] = [[] for _ in radii_m]
    for part in chunks((high - low).sum(1), _CANDIDATES):
        place, owner = expand_ranges(low[part].flatten(), high[part].flatten())
        centre = torch.div(owner, 3, rounding_mode="floor") + part.start
        gap2 = (sorted_points[place] - centres[centre]).square_().sum(1)
        for radius, keys in zip(radii_m, found, strict=True):
            near = torch.nonzero(gap2 <= radius * radius)[:, 0]
            keys.append(centre[near] * n + order[place[near]])
    return [first_pairs(torch.cat(keys), n, limit, m) for keys, limit in zip(found, limits, strict=True)]


def _cells_around(
    points: Tensor, lengths: Sequence[int], centres: Tensor, centre_lengths: Sequence[int], cell_m: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Sort points by their cell in x and y; for each centre the three stretches that hold its 3 x 3 cells.

    Returns:
        Rows of the points in sorted order, shape (n,); first and one past last place, shape (m, 3) each.
    """
    corner = torch.minimum(points[:, :2].amin(0), centres[:, :2].amin(0))
    both = [torch.floor((xyz[:, :2] - corner) / cell_m).long() + 1 for xyz in (points, centres)]
    nx, ny = (torch.maximum(both[0].amax(0), both[1].amax(0)) + 2).tolist()
    frames = (frame_rows(lengths, points.device), frame_rows(centre_lengths, points.device))
    key, around = ((frame * nx + cell[:, 0]) * ny + cell[:, 1] for frame, cell in zip(frames, both, strict=True))
    order = torch.argsort(key, stable=True)
    key = key[order]
    rows = around[:, None] + torch.tensor([-ny, 0, ny], device=points.device)
    return order, torch.searchsorted(key, rows - 1), torch.searchsorted(key, rows + 1, right=True)


class _GroupMax(torch.autograd.Function):
    """Maximum over the rows of each group; equal maxima share the gradient."""

    @staticmethod
    def forward(ctx: Any, values: Tensor, centre: Tensor, count: int) -> Tensor:
        wide = centre[:, None].expand_as(values)
        best = values.new_zeros(count, values.shape[1]).scatter_reduce(0, wide, values, "amax", include_self=False)
        ctx.save_for_backward(values, centre, best)
        return best

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None]:
        values, centre, best = ctx.saved_tensors
        winner = (values == best.index_select(0, centre)).to(gradient.dtype)
        ties = torch.zeros_like(best, dtype=torch.float32).index_add_(0, centre, winner.float())
        share = gradient / ties.clamp_(min=1).to(gradient.dtype)
        return winner.mul_(share.index_select(0, centre)), None, None


def group_max(values: Tensor, groups: Groups) -> Tensor:
    """Maximum of the values of each centre's pairs, shape (p, c) to (count, c); zero for a centre without any."""
    pooled: Tensor = _GroupMax.apply(values, groups.centre, groups.centres)
    return pooled


def three_nearest(
    queries: Tensor, query_lengths: Sequence[int], sources: Tensor, source_lengths: Sequence[int]
) -> tuple[Tensor, Tensor]:
    """The three nearest sources of the same frame, and their weights by inverse distance (PointNet++, equation 2).

    Args:
        queries: x, y, z, finite, shape (n, 3).
        query_lengths: Queries of each frame.
        sources: x, y, z, finite, shape (m, 3).
        source_lengths: Sources of each frame.

    Returns:
        Rows of the sources, shape (n, 3), int64; weights that sum to one, shape (n, 3). Where a frame has fewer than
        three sources the others weigh zero, and where it has none all do.
    """
    queries, sources = queries.detach().float(), sources.detach().float()
    rows, gaps, first = [], [], 0
    query_parts, source_parts = queries.split(list(query_lengths)), sources.split(list(source_lengths))
    for query, source in zip(query_parts, source_parts, strict=True):
        search = _nearest_by_tree if not queries.is_cuda else _nearest_by_distance
        row, gap = search(query, source)
        rows.append(row + first if len(source) else row)
        gaps.append(gap)
        first += len(source)
    row, gap = torch.cat(rows), torch.cat(gaps)
    weight = 1 / (gap + 1e-8)
    return row, weight / weight.sum(1, keepdim=True).clamp(min=1e-30)


def _nearest_by_tree(query: Tensor, source: Tensor) -> tuple[Tensor, Tensor]:
    if not len(source) or not len(query):
        return _nearest_by_distance(query, source)
    gap, row = cKDTree(source.numpy()).query(query.numpy(), k=[1, 2, 3], workers=torch.get_num_threads())
    row = np.where(np.isfinite(gap), row, 0)  # the tree gives the number of sources where there are too few
    return torch.from_numpy(row), torch.from_numpy(gap).float()


def _nearest_by_distance(query: Tensor, source: Tensor) -> tuple[Tensor, Tensor]:
    row = torch.zeros(len(query), 3, dtype=torch.long, device=query.device)
    gap = torch.full((len(query), 3), torch.inf, device=query.device)
    nearest = min(3, len(source))
    if not nearest:
        return row, gap
    step = max(1, _DISTANCES // len(source))
    for start in range(0, len(query), step):
        part = slice(start, start + step)
        gap2 = (query[part, None, 0] - source[:, 0]).square_()
        for axis in (1, 2):
            gap2 += (query[part, None, axis] - source[:, axis]).square_()
        best = gap2.topk(nearest, dim=1, largest=False)
        row[part, :nearest], gap[part, :nearest] = best.indices, best.values.sqrt()
    return row, gap


def interpolate(values: Tensor, row: Tensor, weight: Tensor) -> Tensor:
    """Weighted sum of three rows of ``values`` (m, c) for each query, shape (n, c); zero where there are none."""
    if not len(values):
        return values.new_zeros(len(row), values.shape[1]) + values.sum() * 0
    weight = weight.to(values.dtype)
    total = values.index_select(0, row[:, 0]) * weight[:, :1]
    for place in (1, 2):
        total = torch.addcmul(total, values.index_select(0, row[:, place]), weight[:, place, None])
    return total
