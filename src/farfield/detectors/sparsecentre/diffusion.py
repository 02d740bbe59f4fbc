"""Feature diffusion: occupied cells of an object make the cell at its centre occupied, with features of their own.

A sparse map has no cell where no point fell, and the centre of an object seen from one side is often such a place.
SAFDNet (arXiv 2403.05817, section 3.3) spreads the cells that it takes for foreground over a neighbourhood fixed by
class. Here each foreground cell also predicts the step to its object's centre, as in FSD (arXiv 2207.10035, section
3.1), and a small neighbourhood of that place becomes occupied: a trailer of 15 m is reached without filling a disc.
"""

from itertools import pairwise, product
from typing import NamedTuple

import torch
from torch import Tensor, nn

from farfield.detectors.sparse import SparseTensor, dilate, neighbour_table


class DiffusedMap(NamedTuple):
    """A map after diffusion.

    Attributes:
        sparse: The map with its new cells.
        height_m: Reference height of each cell, shape (n,).
        votes: Foreground logit and step to the centre (x, y, in cells) of each cell before, shape (m, 3), float32.
    """

    sparse: SparseTensor
    height_m: Tensor
    votes: Tensor


class CentreDiffusion(nn.Module):
    """Spread foreground cells to the centres that they predict.

    Args:
        channels: Channels of the map.
        threshold: Cells with a foreground score above this vote.
        least: So many best cells of each frame vote in any case: the branch learns from its first step.
        ring: Cells around a voted one that become occupied as well.
        reach_cells: Longest step along x and along y.
    """

    def __init__(self, channels: int, *, threshold: float, least: int, ring: int, reach_cells: float) -> None:
        super().__init__()
        self.threshold, self.least, self.reach_cells = threshold, least, reach_cells
        side = range(-ring, ring + 1)
        self.ring = [(0, dx, dy) for dx, dy in product(side, side) if (dx, dy) != (0, 0)]
        self.vote = nn.Linear(channels, 3)
        self.carry = nn.Linear(channels + 2, channels)
        with torch.no_grad():
            self.vote.weight.normal_(std=0.01)
            self.vote.bias.copy_(torch.tensor([-2.2, 0.0, 0.0]))

    def forward(self, sparse: SparseTensor, height_m: Tensor) -> DiffusedMap:
        """Grow the map.

        Args:
            sparse: A map of depth 1.
            height_m: Reference height of each cell, shape (m,).
        """
        votes = self.vote(sparse.features).float()
        score, steps = torch.sigmoid(votes[:, 0]), votes[:, 1:].clamp(-self.reach_cells, self.reach_cells)
        rows, voted, rest = self._landing(sparse, score.detach(), steps)
        keys = dilate(voted, sparse.shape, self.ring, others=sparse.keys, frames=sparse.batch_size)
        carried = self.carry(torch.cat([sparse.features[rows], rest.to(sparse.features.dtype)], 1))
        carried = carried * score[rows, None].to(carried.dtype)
        landed, stayed = torch.searchsorted(keys, voted), torch.searchsorted(keys, sparse.keys)
        features, _ = means_at(carried, landed, len(keys))
        features = features.index_add(0, stayed, sparse.features.to(features.dtype))
        height, known = means_at(height_m[rows], landed, len(keys))
        known = known.index_fill(0, stayed, True)
        height = _spread(height.index_copy(0, stayed, height_m), known, keys, sparse.shape, self.ring)
        grown = SparseTensor(features, keys, sparse.shape, sparse.batch_size, sparse.rulebooks)
        return DiffusedMap(grown, height, votes)

    def _landing(self, sparse: SparseTensor, score: Tensor, steps: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Rows of the voting cells, keys of the cells they vote for, and their places in those cells, (v, 2)."""
        _, nx, ny = sparse.shape
        frame, _, ix, iy = sparse.indices().unbind(1)
        chosen = score > self.threshold
        frames = torch.arange(sparse.batch_size + 1, device=frame.device) * (nx * ny)
        edges = torch.searchsorted(sparse.keys, frames).tolist()
        for start, end in pairwise(edges):
            best = torch.topk(score[start:end], min(self.least, end - start)).indices
            chosen[start + best] = True
        place = torch.stack([ix, iy], 1) + 0.5 + steps
        cell = torch.floor(place.detach()).long()
        chosen &= (cell[:, 0] >= 0) & (cell[:, 0] < nx) & (cell[:, 1] >= 0) & (cell[:, 1] < ny)
        rows = chosen.nonzero().squeeze(1)
        return rows, ((frame * nx + cell[:, 0]) * ny + cell[:, 1])[rows], (place - cell - 0.5)[rows]


def means_at(values: Tensor, place: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Mean of the rows that fall to each place, zero where none does.

    Sums are of float64, where those of float32 numbers near one another are exact, so that the order of a GPU's
    additions does not matter.

    Args:
        values: Rows, shape (n, ...).
        place: Number of each row's place, shape (n,), int64.
        count: Number of places.

    Returns:
        The means, shape (count, ...), of the values' dtype, and whether rows fall there, shape (count,).
    """
    total = values.new_zeros(count, *values.shape[1:], dtype=torch.float64).index_add(0, place, values.double())
    rows = total.new_zeros(count).index_add(0, place, total.new_ones(len(place)))
    divisor = rows.clamp(min=1).reshape(-1, *[1] * (values.dim() - 1))
    return (total / divisor).to(values.dtype), rows > 0


def _spread(
    height_m: Tensor, known: Tensor, keys: Tensor, shape: tuple[int, int, int], ring: list[tuple[int, int, int]]
) -> Tensor:
    """Give cells without a height the mean of their neighbours'."""
    empty = (~known).nonzero().squeeze(1)
    table = neighbour_table(keys, keys[empty], shape, ring).long()
    weight = torch.cat([known, known.new_zeros(1)]).to(height_m.dtype)[table]
    around = torch.cat([height_m, height_m.new_zeros(1)])[table]
    return height_m.index_copy(0, empty, (around * weight).sum(1) / weight.sum(1).clamp(min=1))
