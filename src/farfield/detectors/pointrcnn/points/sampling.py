"""Choosing points: farthest point sampling, its fast stand-in on voxels, and budgets by range.

Farthest point sampling (Qi et al., PointNet++, NIPS 2017, section 3.2) gives a sequence of which every prefix is again
the farthest point sampling of the whole set. A network's coarser levels are therefore prefixes of its finest one, and
one run a frame serves them all.
"""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float32, Int
from pydantic import BaseModel, ConfigDict, Field, model_validator
from torch import Tensor

from farfield.detectors.triton_jit import kernels_for

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
        inner = centre_m.new_tensor(self.edges_m[1:-1])
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


def share_budget(available: Int[np.ndarray, " b"], shares: Sequence[float], budget: int) -> Int[np.ndarray, " b"]:
    """Split a budget among bands by their shares; none gets more than it has, and the rest goes to the others.

    Args:
        available: Items in each band.
        shares: Weight of each band, positive.
        budget: Items to choose altogether.

    Returns:
        Items to take from each band; they sum to the budget or to all that is available.
    """
    granted = np.zeros(len(available), dtype=np.int64)
    weight = np.asarray(shares, dtype=np.float64)
    left = min(int(budget), int(available.sum()))
    while left > 0:
        open_bands = np.flatnonzero(granted < available)
        part = np.floor(left * weight[open_bands] / weight[open_bands].sum()).astype(np.int64)
        if not part.any():
            part[np.argsort(-weight[open_bands], kind="stable")[:left]] = 1
        part = np.minimum(part, (available - granted)[open_bands])
        granted[open_bands] += part
        left -= int(part.sum())
    return granted


def content_rank(points: Tensor) -> Tensor:
    """A pseudo-random number in [0, 2^31) for each point that depends on its coordinates alone, shape (n,), int64.

    It stands in for a random draw: the same cloud gives the same choice whatever the order of its points, and a cloud
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
    """Whether each item is among the first of its band that the band's budget lets in, shape (n,), bool."""
    available = torch.bincount(band, minlength=len(shares)).cpu().numpy()
    granted = torch.from_numpy(share_budget(available, shares, budget)).to(band.device)
    by_band = torch.argsort(band, stable=True)
    first = torch.from_numpy(np.cumsum(available) - available).to(band.device)
    place = torch.empty_like(by_band)
    place[by_band] = torch.arange(len(band), device=band.device)
    return place - first[band] < granted[band]


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
    starts, taken = prefix_rows(lengths, count)
    points = points.detach().float()
    if not any(taken):
        return torch.zeros(0, dtype=torch.long, device=points.device), taken
    kernels = kernels_for(points.device, "pointrcnn.points.triton_kernels")
    if kernels is not None:
        return kernels.farthest_points(points, lengths, count), taken
    if not points.is_cuda and sum(taken) <= _SIDE_BY_SIDE * max(taken):
        xyz = points.numpy()
        parts = [_farthest_of_one(xyz[s : s + n], k) + s for s, n, k in zip(starts, lengths, taken, strict=True)]
        return torch.from_numpy(np.concatenate(parts)), taken
    return _farthest_side_by_side(points, lengths, count), taken


def _farthest_of_one(xyz: Float32[np.ndarray, "n 3"], count: int) -> Int[np.ndarray, " k"]:
    """One frame on the CPU. With the points sorted along an axis, a chosen point changes one stretch of them only.

    No distance is above the radius of the last choice, so points farther along the axis keep theirs: exact.
    """
    if not count:
        return np.zeros(0, dtype=np.int64)
    axis = int(np.ptp(xyz, axis=0).argmax())
    order = np.argsort(xyz[:, axis], kind="stable")
    columns = np.ascontiguousarray(xyz[order].T)
    along = columns[axis].astype(np.float64)
    gap2 = np.full(len(xyz), np.inf, dtype=np.float32)
    spare = np.empty((2, len(xyz)), dtype=np.float32)
    chosen = np.empty(count, dtype=np.int64)
    current, low, high = int(np.flatnonzero(order == 0)[0]), 0, len(xyz)
    for step in range(count):
        chosen[step] = current
        total, term = spare[0, low:high], spare[1, low:high]
        for column, out in zip(columns, (total, term, term), strict=True):
            np.subtract(column[low:high], column[current], out=out)
            np.multiply(out, out, out=out)
            if out is term:
                np.add(total, term, out=total)
        np.minimum(gap2[low:high], total, out=gap2[low:high])
        current = int(gap2.argmax())
        reach = float(gap2[current]) ** 0.5 * 1.0001 + 1e-6
        low, high = along.searchsorted((along[current] - reach, along[current] + reach))
    return order[chosen]


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
    starts, taken = prefix_rows(lengths, count)
    parts = [_spread(points[s : s + n], finest_m)[:k] + s for s, n, k in zip(starts, lengths, taken, strict=True)]
    return torch.cat([torch.zeros(0, dtype=torch.long, device=points.device), *parts]), taken


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
