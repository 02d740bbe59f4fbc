"""Operators on points: sampling, budgets by range, neighbourhoods, and the points inside proposals.

Farthest point sampling (Qi et al., PointNet++, NIPS 2017, section 3.2) gives a sequence of which every prefix is again
the farthest point sampling of the whole set. A network's coarser levels are therefore prefixes of its finest one, and
one run a frame serves them all.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from pydantic import BaseModel, ConfigDict, Field, model_validator
from scipy.spatial import cKDTree
from torch import Tensor

from farfield.detectors.devices import constant, kernels_for, sent
from farfield.detectors.onnx.points import farthest_of_one
from farfield.detectors.onnx.points import share_budget as share_budget

_SIDE_BY_SIDE = 8  # a CPU samples this many frames faster one by one, more of them faster side by side


class BandConfig(BaseModel):
    """Bands of range and the share of a budget that each gets first; what a band leaves unused goes to the others."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    edges_m: tuple[float, ...] = Field(
        (0.0, 40.0, 80.0, 150.0, 250.0), min_length=2, max_length=33, description="edges of range bands"
    )
    shares: tuple[float, ...] = Field((0.4, 0.25, 0.2, 0.15), description="share of each band")

    @model_validator(mode="after")
    def _fit_together(self) -> "BandConfig":
        if len(self.shares) != len(self.edges_m) - 1:
            raise ValueError(f"expected {len(self.edges_m) - 1} shares, one a band of edges_m; got {len(self.shares)}")
        if not all(low < high for low, high in zip(self.edges_m, self.edges_m[1:], strict=False)):
            raise ValueError(f"expected edges_m that increase; got {self.edges_m}")
        if not all(share > 0 for share in self.shares):
            raise ValueError(f"expected positive shares; got {self.shares}")
        return self

    def of(self, centre_m: Tensor) -> Tensor:
        """Band of each row x, y, ...: the outermost bands also take what lies beyond their edges, shape (n,)."""
        inner = constant(self.edges_m[1:-1], centre_m.device, centre_m.dtype)
        return torch.bucketize(torch.hypot(centre_m[:, 0], centre_m[:, 1]).contiguous(), inner, right=True)


class WindowConfig(BaseModel):
    """Where the detector looks; points outside are dropped."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    range_m: float = Field(250.0, gt=0, description="forward reach, x from 0")
    half_width_m: float = Field(50.0, gt=0, description="lateral reach, y from -half_width_m to +half_width_m")
    z_min_m: float = Field(-6.0, description="points below are dropped")
    z_max_m: float = Field(6.0, description="points above are dropped")

    def rows(self, points: Tensor) -> Tensor:
        """Rows of the points inside, shape (k,)."""
        x, y, z = points[:, :3].unbind(1)
        inside = (x >= 0) & (x < self.range_m) & (y.abs() < self.half_width_m)
        return torch.nonzero(inside & (z >= self.z_min_m) & (z < self.z_max_m))[:, 0]


def content_rank(points: Tensor) -> Tensor:
    """A pseudo-random number in [0, 2^31) for each point that depends on its coordinates alone, shape (n,), int64.

    It replaces a random draw: the same cloud gives the same choice whatever the order of its points, and a cloud
    that augmentation has moved gives another.
    """
    bits = points[:, :3].contiguous().view(torch.int32).long() & 0xFFFFFFFF
    mixed = bits[:, 0] * 73856093 ^ bits[:, 1] * 19349663 ^ bits[:, 2] * 83492791
    for _ in range(2):  # the finaliser of a 32-bit MurmurHash3, one multiplication a turn
        mixed = ((mixed ^ (mixed >> 16)) & 0xFFFFFFFF) * 0x85EBCA6B & 0xFFFFFFFF
    return (mixed ^ (mixed >> 13)) & 0x7FFFFFFF


def sample_bands(points: Tensor, bands: BandConfig, budget: int) -> Tensor:
    """Choose points of one frame by a budget for each band of range.

    Args:
        points: x, y, z, ..., shape (n, 3 or more).
        bands: Bands and shares.
        budget: Points to choose.

    Returns:
        Rows of the chosen points in pseudo-random order, shape (min(n, budget),).
    """
    rank = content_rank(points)
    order = torch.argsort(rank, stable=True)
    if len(points) <= budget:
        return order
    return order[first_of_bands(bands.of(points[order]), bands.shares, budget)]


def first_of_bands(band: Tensor, shares: Sequence[float], budget: int) -> Tensor:
    """Rows of the items that are among the first of their band and within its budget, ascending, shape (k,)."""
    ordered, by_band = torch.sort(band, stable=True)
    edges = torch.searchsorted(ordered, torch.arange(len(shares) + 1, device=band.device)).tolist()
    granted = share_budget(np.diff(edges), shares, budget).tolist()
    return torch.cat([by_band[start : start + size] for start, size in zip(edges[:-1], granted, strict=True)]).sort()[0]


def prefix_rows(lengths: Sequence[int], count: int) -> tuple[list[int], list[int]]:
    """Where each frame's first ``count`` rows are: start rows and how many there are."""
    starts = np.cumsum([0, *lengths])[:-1].tolist()
    return starts, [min(count, length) for length in lengths]


def farthest_points(points: Tensor, lengths: Sequence[int], count: int) -> tuple[Tensor, list[int]]:
    """Farthest point sampling of each frame, exact, beginning with its first point.

    Args:
        points: x, y, z of all frames, finite, shape (n, 3).
        lengths: Rows of each frame.
        count: Points to choose of each frame.

    Returns:
        Chosen rows in the order of choice, frame after frame; how many each frame has: min(count, its length).
    """
    starts, counts = prefix_rows(lengths, count)
    points = points.detach().float()
    if not any(counts):
        return torch.zeros(0, dtype=torch.long, device=points.device), counts
    kernels = kernels_for(points.device, "pointrcnn.triton_sampling")
    if kernels is not None:
        return kernels.farthest_points(points, lengths, count), counts
    if not points.is_cuda and sum(counts) <= _SIDE_BY_SIDE * max(counts):
        xyz = points.numpy()
        parts = [farthest_of_one(xyz[s : s + n], k) + s for s, n, k in zip(starts, lengths, counts, strict=True)]
        return torch.from_numpy(np.concatenate(parts)), counts
    return _farthest_side_by_side(points, lengths, count), counts


def _farthest_side_by_side(points: Tensor, lengths: Sequence[int], count: int) -> Tensor:
    """All frames at once, padded to the longest."""
    device = points.device
    length = torch.tensor(lengths, device=device)
    start = length.cumsum(0) - length
    slot = torch.arange(int(max(lengths)), device=device)
    real = slot < length[:, None]
    row = torch.where(real, start[:, None] + slot, 0)
    x, y, z = points[row].unbind(2)
    gap2 = torch.where(real, torch.inf, -torch.inf)
    current = torch.zeros(len(lengths), 1, dtype=torch.long, device=device)
    steps = min(count, int(max(lengths)))
    chosen = torch.empty(len(lengths), steps, dtype=torch.long, device=device)
    for step in range(steps):
        chosen[:, step] = current[:, 0]
        total = (x - x.gather(1, current)).square_()
        total += (y - y.gather(1, current)).square_()
        total += (z - z.gather(1, current)).square_()
        torch.minimum(gap2, total, out=gap2)
        current = gap2.argmax(1, keepdim=True)
    taken = torch.arange(steps, device=device) < length[:, None]
    return (chosen + start[:, None])[taken]


def spread_points(
    points: Tensor, lengths: Sequence[int], count: int, *, finest_m: float = 0.1
) -> tuple[Tensor, list[int]]:
    """A fast stand-in for :func:`farthest_points`: one point a voxel, from coarse voxels to fine ones.

    Each level halves the voxels and adds one point in every voxel that has none yet. Prefixes are spread out as those
    of farthest point sampling are; sorting replaces the sequence of searches.

    Args:
        points: x, y, z of all frames, finite, shape (n, 3).
        lengths: Rows of each frame.
        count: Points to choose of each frame.
        finest_m: Edge of the finest voxels; points that share one of them come last, in their order.

    Returns:
        As :func:`farthest_points`.
    """
    starts, counts = prefix_rows(lengths, count)
    parts = [_spread(points[s : s + n], finest_m)[:k] + s for s, n, k in zip(starts, lengths, counts, strict=True)]
    return torch.cat([torch.zeros(0, dtype=torch.long, device=points.device), *parts]), counts


def _spread(points: Tensor, finest_m: float) -> Tensor:
    """All rows of one frame, coarse to fine."""
    if not len(points):
        return torch.zeros(0, dtype=torch.long, device=points.device)
    cell = torch.floor((points - points.amin(0)) / finest_m).long()
    levels = max(int(cell.max()).bit_length(), 1)
    rank = torch.full((len(points),), levels + 1, dtype=torch.long, device=points.device)
    for level in range(levels + 1):  # fine to coarse: the coarsest voxel that a point is the first of decides
        width = cell >> level
        extent = width.amax(0) + 1
        key = (width[:, 0] * extent[1] + width[:, 1]) * extent[2] + width[:, 2]
        order = torch.argsort(key, stable=True)
        fresh = torch.ones_like(key, dtype=torch.bool)
        fresh[1:] = key[order][1:] != key[order][:-1]
        rank[order[fresh]] = levels - level
    return torch.argsort(rank, stable=True)


# Neighbourhoods: ball query, maximum over a group, and interpolation from the three nearest points.
#
# The ball query is that of PointNet++ (NIPS 2017, section 3.2): the first ``limit`` points, by row, within the
# radius. Candidates come from a grid of cells as wide as the radius: sorted cell numbers, found again by
# searchsorted.

_CANDIDATES = 1 << 21  # pairs looked at in one go
_DISTANCES = 1 << 25  # distances held at once where all are computed
_DENSE_PAIRS = 1 << 23  # pairs of which a GPU computes all distances: calls cost it more than numbers


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
    if len(lengths) == 1:
        return torch.zeros(lengths[0], dtype=torch.long, device=device)
    length = sent(torch.tensor(lengths, dtype=torch.long), device)
    return torch.repeat_interleave(torch.arange(len(lengths), device=device), length, output_size=sum(lengths))


def expand_ranges(low: Tensor, high: Tensor, total: int) -> tuple[Tensor, Tensor]:
    """All numbers of each half-open range [low, high), range after range, and the range that each belongs to.

    Args:
        low: First number of each range, shape (n,).
        high: One past its last.
        total: How many numbers that makes; the host knows it, and need not read it.
    """
    count = high - low
    owner = torch.repeat_interleave(torch.arange(len(low), device=low.device), count, output_size=total)
    first = low - (count.cumsum(0) - count)
    return torch.arange(total, device=low.device) + first.index_select(0, owner), owner


def chunks(cost: Tensor, limit: int) -> Iterator[tuple[slice, int]]:
    """Stretches of rows whose costs sum to about ``limit`` each, and that sum; a row that costs more stands alone."""
    ends = cost.cumsum(0)
    total = int(ends[-1])
    if total <= limit:
        yield slice(0, len(cost)), total
        return
    step = torch.div(ends - cost, limit, rounding_mode="floor")
    edges = torch.nonzero(torch.diff(step))[:, 0].add(1).tolist()
    sums = np.diff([0, *ends[[edge - 1 for edge in edges]].tolist(), total]).tolist()
    yield from ((slice(a, b), size) for a, b, size in zip([0, *edges], [*edges, len(cost)], sums, strict=True))


def first_pairs(keys: Tensor, points: int, limit: int, count: int) -> Groups:
    """Groups from unsorted numbers centre * points + point, at most ``limit`` pairs a centre."""
    keys = sorted_keys(keys)
    centre = torch.div(keys, max(points, 1), rounding_mode="floor")
    return _first_of_each(Groups(centre, torch.sub(keys, centre, alpha=points), count), limit)


def _first_of_each(pairs: Groups, limit: int) -> Groups:
    """The first ``limit`` pairs of each centre."""
    early = torch.ones_like(pairs.centre, dtype=torch.bool)
    torch.ne(pairs.centre[limit:], pairs.centre[:-limit], out=early[limit:])  # the pair before by so many is another's
    row = early.nonzero().squeeze(1)
    return Groups(pairs.centre.index_select(0, row), pairs.point.index_select(0, row), pairs.centres)


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
    if points.is_cuda and len(lengths) == 1 and n * m <= _DENSE_PAIRS:
        return all_within(points, centres, radii_m, limits)
    order, low, high = _cells_around(points, lengths, centres, centre_lengths, 1.001 * max(radii_m))
    sorted_points = points[order]
    pairs: list[list[Tensor]] = [[] for _ in radii_m]
    for part, total in chunks((high - low).sum(1), _CANDIDATES):
        point, owner = expand_ranges(low[part].flatten(), high[part].flatten(), total)
        centre = torch.div(owner, 3, rounding_mode="floor") + part.start
        gap2 = (sorted_points[point] - centres[centre]).square_().sum(1)
        for radius, keys in zip(radii_m, pairs, strict=True):
            near = torch.nonzero(gap2 <= radius * radius).squeeze(1)
            row = order.index_select(0, point.index_select(0, near))
            keys.append(torch.add(row, centre.index_select(0, near), alpha=n))
    joined = [keys[0] if len(keys) == 1 else torch.cat(keys) for keys in pairs]
    return [first_pairs(keys, n, limit, m) for keys, limit in zip(joined, limits, strict=True)]


def all_within(points: Tensor, centres: Tensor, radii_m: Sequence[float], limits: Sequence[int]) -> list[Groups]:
    """The groups of :func:`ball_query` for one frame from the distances of all pairs: a third of the calls."""
    gap2 = (points[:, 0] - centres[:, 0, None]).square_()
    for axis in (1, 2):
        gap2 += (points[:, axis] - centres[:, axis, None]).square_()
    pairs = [(gap2 <= radius * radius).nonzero().unbind(1) for radius in radii_m]
    groups = [Groups(pair[0], pair[1], len(centres)) for pair in pairs]
    return [_first_of_each(group, limit) for group, limit in zip(groups, limits, strict=True)]


def _cells_around(
    points: Tensor, lengths: Sequence[int], centres: Tensor, centre_lengths: Sequence[int], cell_m: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Sort points by their cell in x and y; for each centre the three stretches that hold its 3 x 3 cells.

    Returns:
        Rows of the points in sorted order, shape (n,); first and one past last place, shape (m, 3) each.
    """
    both = torch.cat([points[:, :2], centres[:, :2]])
    cells = torch.floor((both - both.amin(0)) / cell_m).long() + 1
    nx, ny = (cells.amax(0) + 2).unbind(0)  # they stay on the device
    x, y = cells.unbind(1)
    if len(lengths) > 1:
        frame = torch.cat([frame_rows(lengths, points.device), frame_rows(centre_lengths, points.device)])
        x = x + frame * nx
    key, around = (x * ny + y).split([len(points), len(centres)])
    key, order = torch.sort(key, stable=True)
    rows = around[:, None] + torch.arange(-1, 2, device=points.device) * ny
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
    for neighbour in (1, 2):
        total = torch.addcmul(total, values.index_select(0, row[:, neighbour]), weight[:, neighbour, None])
    return total


# RoI point pooling (PointRCNN, section 3.3): the points inside each enlarged proposal.

_ROI_CANDIDATES = 1 << 21


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
    n, m, pairs = len(points), len(rois), [torch.zeros(0, dtype=torch.long, device=points.device)]
    first_point = first_roi = 0
    for length, roi_length in zip(lengths, roi_lengths, strict=True):
        inside = _of_one_frame(
            points[first_point : first_point + length], rois[first_roi : first_roi + roi_length], context_m
        )
        pairs += [(roi + first_roi) * n + point + first_point for roi, point in inside]
        first_point, first_roi = first_point + length, first_roi + roi_length
    return first_pairs(torch.cat(pairs), n, limit, m)


def _of_one_frame(points: Tensor, rois: Tensor, context_m: float) -> list[tuple[Tensor, Tensor]]:
    """Pairs of RoI and point, in pieces. Only points within reach along x are looked at."""
    if not len(points) or not len(rois):
        return []
    half = rois[:, 3:6] / 2 + context_m
    radius_m = torch.hypot(half[:, 0], half[:, 1]) * 1.0001 + 1e-3
    order = torch.argsort(points[:, 0], stable=True)
    ranked = points[order]
    x = ranked[:, 0].contiguous()
    low = torch.searchsorted(x, (rois[:, 0] - radius_m).contiguous())
    high = torch.searchsorted(x, (rois[:, 0] + radius_m).contiguous(), right=True)
    pairs = []
    for part, total in chunks(high - low, _ROI_CANDIDATES):
        point, roi = expand_ranges(low[part], high[part], total)
        roi = roi + part.start
        near = torch.nonzero((ranked[point, 1] - rois[roi, 1]).abs() <= radius_m[roi])[:, 0]
        point, roi = point[near], roi[near]
        inside = torch.nonzero((in_roi_frames(ranked[point], rois[roi]).abs() <= half[roi]).all(1))[:, 0]
        pairs.append((roi[inside], order[point[inside]]))
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
