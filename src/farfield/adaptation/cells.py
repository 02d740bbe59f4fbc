"""The cells of a feature map that hold input points, and which of them count in a domain's loss.

A discriminator over all cells of near and far windows reads how empty they are, and its gradient asks the trunk to
invent cells or to blank them. So only cells that a point fell into count; near ones can be drawn so that their point
counts are distributed as those of the far ones; and background cells can weigh so that vehicles have the same share.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from farfield.detectors.features import FeatureMap, Features, PointFeatures
from farfield.detectors.sparse.cells import SparseTensor
from farfield.geometry.boxes import Boxes

_DENSITY_BINS = 6  # of log2: 1, 2 to 3, 4 to 7, 8 to 15, 16 to 31, 32 and more points
_HEAVIEST = 10.0
_SHOWN = 512  # rows of which variance and rank are logged


@dataclass(frozen=True, eq=False)
class Cells:
    """Occupied cells of a batch; points of point features count as cells of one point.

    Args:
        row: Where the features of each stand: among the cells of a dense map, ``(frame * nx + ix) * ny + iy``, or among
            the rows of sparse and point features, shape (n,), int64.
        frame: Frame of each, shape (n,), int64.
        cell: ``ix * ny + iy`` of each, -1 for points, shape (n,), int64.
        place_m: Centres, shape (n, 2).
        points: Input points in each, shape (n,), int64.
        share: Occupied cells over all cells of the map.
    """

    row: Tensor
    frame: Tensor
    cell: Tensor
    place_m: Tensor
    points: Tensor
    share: float = 1.0

    def __len__(self) -> int:
        return len(self.row)

    def __getitem__(self, chosen: Tensor | slice) -> "Cells":
        """Those of a mask, at indices, or of a slice."""
        row, frame, cell, place_m, points = (
            part[chosen] for part in (self.row, self.frame, self.cell, self.place_m, self.points)
        )
        return Cells(row, frame, cell, place_m, points, self.share)


def occupied(features: Features, inputs: Mapping[str, Sequence[Tensor]], z_range_m: tuple[float, float]) -> Cells:
    """The cells that hold at least one point of the input.

    Args:
        features: Of a batch.
        inputs: What the network read: clouds of each frame by input, x, y, z first.
        z_range_m: Lowest and highest point that the network looks at.
    """
    if isinstance(features, PointFeatures):
        rows = features.rows()
        row = torch.arange(len(rows.frame), device=rows.frame.device)
        return Cells(row, rows.frame, torch.full_like(row, -1), rows.place_m, torch.ones_like(row))
    nx, ny = map_shape(features)
    count = _counts(features, inputs, (nx, ny), z_range_m)
    share = float((count > 0).float().mean())
    if isinstance(features.values, SparseTensor):
        frame, _, ix, iy = features.values.indices().unbind(1)
        index = (frame * nx + ix) * ny + iy
        row = (count[index] > 0).nonzero().squeeze(1)
        index = index[row]
    else:
        row = index = count.nonzero().squeeze(1)
    cell = index % (nx * ny)
    ix, iy = torch.div(cell, ny, rounding_mode="floor"), cell % ny
    centre_m = [(i + 0.5) * features.cell_m + start for i, start in zip((ix, iy), features.origin_m, strict=True)]
    frame = torch.div(index, nx * ny, rounding_mode="floor")
    return Cells(row, frame, cell, torch.stack(centre_m, 1), count[index], share)


def map_shape(features: FeatureMap) -> tuple[int, int]:
    """Cells of a map along x and y."""
    nx, ny = features.values.shape[-2:]
    return int(nx), int(ny)


def _counts(
    features: FeatureMap, inputs: Mapping[str, Sequence[Tensor]], shape: tuple[int, int], z_range_m: tuple[float, float]
) -> Tensor:
    """Points in each cell of each frame, shape (frames * nx * ny,), int64."""
    (nx, ny), (x0, y0) = shape, features.origin_m
    total = torch.zeros(len(features) * nx * ny, dtype=torch.int64, device=device_of(features))
    for clouds in inputs.values():
        for frame, cloud in enumerate(clouds):
            ix = torch.floor((cloud[:, 0] - x0) / features.cell_m)
            iy = torch.floor((cloud[:, 1] - y0) / features.cell_m)
            keep = (ix >= 0) & (ix < nx) & (iy >= 0) & (iy < ny)
            keep &= (cloud[:, 2] >= z_range_m[0]) & (cloud[:, 2] < z_range_m[1])
            index = (frame * nx + ix[keep].long()) * ny + iy[keep].long()
            total += torch.bincount(index, minlength=len(total))
    return total


def device_of(features: Features) -> torch.device:
    """Where features lie."""
    if isinstance(features, PointFeatures):
        return features.xyz.device
    values = features.values
    return values.features.device if isinstance(values, SparseTensor) else values.device


def z_range_m(config: Any) -> tuple[float, float]:
    """Lowest and highest point that a detector looks at, from its configuration; without limit if it has no grid."""
    grid = getattr(config, "grid", None)
    return float(getattr(grid, "z_min_m", -np.inf)), float(getattr(grid, "z_max_m", np.inf))


def values_at(features: Features, cells: Cells) -> Tensor:
    """Features of the cells, shape (n, c)."""
    if isinstance(features, PointFeatures):
        return features.values[cells.row]
    if isinstance(features.values, SparseTensor):
        return features.values.features[cells.row]
    rows = features.values.permute(0, 2, 3, 1).reshape(-1, features.values.shape[1])  # no copy: maps lie channels last
    return rows[cells.row]


def shown(features: Features, cells: Cells) -> Tensor:
    """Up to 512 of the cells' features, evenly spread, detached: to log their variance and rank."""
    step = max(1, -(-len(cells) // _SHOWN))
    return values_at(features, cells[torch.arange(0, len(cells), step, device=cells.row.device)]).detach()


def inside(cells: Cells, boxes: Sequence[Boxes], margin_m: float) -> Tensor:
    """Which cells have their centre in a box of their frame, grown by a margin on each side, shape (n,), bool."""
    hit = torch.zeros(len(cells), dtype=torch.bool, device=cells.row.device)
    for frame, frame_boxes in enumerate(boxes):
        rows = (cells.frame == frame).nonzero().squeeze(1)
        if len(frame_boxes) and len(rows):
            hit[rows] = in_boxes(cells.place_m[rows], frame_boxes, margin_m).any(1)
    return hit


def in_boxes(place_m: Tensor, boxes: Boxes, margin_m: float) -> Tensor:
    """Which places lie in which boxes on the ground, grown by a margin, shape (n, boxes), bool."""
    parameters = np.column_stack(
        [boxes.centre_m[:, :2], boxes.size_m[:, :2], np.cos(boxes.yaw_rad), np.sin(boxes.yaw_rad)]
    )
    x, y, length, width, cos, sin = torch.from_numpy(parameters).to(place_m.device, torch.float32).unbind(1)
    dx, dy = place_m[:, :1] - x, place_m[:, 1:] - y
    along, across = (dx * cos + dy * sin).abs(), (dy * cos - dx * sin).abs()
    return (along <= length / 2 + margin_m) & (across <= width / 2 + margin_m)


def density_bins(points: Tensor) -> Tensor:
    """Which of six bins of log2 a number of points falls into, shape (n,), int64."""
    return torch.log2(points.clamp(min=1).double()).floor().long().clamp(max=_DENSITY_BINS - 1)


def match_density(points: Tensor, reference: Tensor, rng: np.random.Generator) -> Tensor:
    """Draw cells so that their numbers of points are distributed as those of the reference.

    As many are drawn, without repetition, as the rarest bin allows. Bins that only the reference has stay empty.

    Args:
        points: Points of the cells to draw from, shape (n,).
        reference: Points of the other cells, shape (m,).
        rng: The only source of randomness.

    Returns:
        Indices of the chosen cells, ascending, shape (k,), int64.
    """
    bins, reference_bins = density_bins(points).cpu().numpy(), density_bins(reference).cpu().numpy()
    supply = np.bincount(bins, minlength=_DENSITY_BINS)
    demand = np.where(supply > 0, np.bincount(reference_bins, minlength=_DENSITY_BINS), 0)
    chosen = [np.zeros(0, dtype=np.int64)]
    if demand.any():
        factor = (supply[demand > 0] / demand[demand > 0]).min()
        for number in np.flatnonzero(demand):
            rows = rng.permutation(np.flatnonzero(bins == number))
            chosen.append(rows[: round(factor * demand[number])])
    return torch.from_numpy(np.sort(np.concatenate(chosen))).to(points.device)


def background_weight(near_objects: float, near: float, far_objects: float, far: float) -> float:
    """Weight of far background cells, far objects weighing 1, at which objects have the share that they have near.

    1 where either region has no object or no background; otherwise from 0.1 to 10.

    Args:
        near_objects: Near cells that belong to objects.
        near: All near cells.
        far_objects: Far cells that belong to objects.
        far: All far cells.
    """
    if not 0 < near_objects < near or not 0 < far_objects < far:
        return 1.0
    weight = far_objects * (near - near_objects) / (near_objects * (far - far_objects))
    return min(max(weight, 1 / _HEAVIEST), _HEAVIEST)
