"""Features on the occupied cells of a batch of 3D grids."""

import math
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor

Triple = tuple[int, int, int]


def encode_keys(indices: Tensor, shape: Triple) -> Tensor:
    """Number cells: ``((b * D + iz) * nx + ix) * ny + iy``.

    Args:
        indices: b, iz, ix, iy of each cell, shape (n, 4), int64, inside the grid.
        shape: Cells along z, x and y.
    """
    depth, nx, ny = shape
    return ((indices[:, 0] * depth + indices[:, 1]) * nx + indices[:, 2]) * ny + indices[:, 3]


def decode_keys(keys: Tensor, shape: Triple) -> Tensor:
    """The inverse of :func:`encode_keys`: b, iz, ix, iy of each cell, shape (n, 4), int64."""
    depth, nx, ny = shape
    rest = torch.div(keys, ny, rounding_mode="floor")
    above = torch.div(rest, nx, rounding_mode="floor")
    frame = torch.div(above, depth, rounding_mode="floor")
    return torch.stack([frame, above - frame * depth, rest - above * nx, keys - rest * ny], 1)


@dataclass(frozen=True, eq=False)
class SparseTensor:
    """Features of the occupied cells of a batch of grids.

    Attributes:
        features: One row a cell, shape (n, c).
        keys: Number of each cell as in :func:`encode_keys`, shape (n,), int64, ascending, each once.
        shape: Cells along z, x and y.
        batch_size: Number of frames; some may have no cell.
        rulebooks: Rulebooks found so far, shared by all tensors derived from this one.
        close: The cells lie close together on a small grid: in half precision on a CPU, where no gradient is asked for,
            they are convolved by neighbour tables.
    """

    features: Tensor
    keys: Tensor
    shape: Triple
    batch_size: int
    rulebooks: dict[Any, Any] = field(default_factory=dict, repr=False)
    close: bool = False

    def __post_init__(self) -> None:
        if self.features.ndim != 2 or self.keys.shape != self.features.shape[:1] or self.keys.dtype != torch.int64:
            raise ValueError(
                "Expected features (n, c) and int64 keys (n,); got features "
                f"{tuple(self.features.shape)} and {self.keys.dtype} keys {tuple(self.keys.shape)}."
            )
        if not 0 < self.batch_size * math.prod(self.shape) < 2**63:
            raise ValueError(f"Expected 1 to 2**63 - 1 cells; got {self.batch_size} frames of {self.shape}.")

    @classmethod
    def from_indices(cls, features: Tensor, indices: Tensor, shape: Triple, batch_size: int) -> "SparseTensor":
        """Sort cells given in any order.

        Args:
            features: One row a cell, shape (n, c).
            indices: b, iz, ix, iy of each cell, shape (n, 4), int64; each cell once.
            shape: Cells along z, x and y.
            batch_size: Number of frames.

        Raises:
            ValueError: If a cell lies outside the grid or comes twice.
        """
        limits = indices.new_tensor([batch_size, *shape])
        if not bool(((indices >= 0) & (indices < limits)).all()):
            raise ValueError(f"Expected cells inside {batch_size} frames of {shape}; got some outside.")
        keys, order = torch.sort(encode_keys(indices, shape))
        if bool((keys[1:] == keys[:-1]).any()):
            raise ValueError("Expected each cell once; got some twice: merge their features first.")
        return cls(features[order], keys, shape, batch_size)

    def indices(self) -> Tensor:
        """Frame and place of each cell: b, iz, ix, iy, shape (n, 4), int64."""
        return decode_keys(self.keys, self.shape)

    def dense(self) -> Tensor:
        """The whole grid, zero where no cell is occupied, shape (batch_size, c, D, nx, ny); differentiable."""
        channels = self.features.shape[1]
        cells = self.features.new_zeros(self.batch_size * math.prod(self.shape), channels)
        grid = cells.index_copy_(0, self.keys, self.features).view(self.batch_size, *self.shape, channels)
        return grid.permute(0, 4, 1, 2, 3)

    def replace(self, features: Tensor) -> "SparseTensor":
        """Other features on the same cells."""
        return replace(self, features=features)

    def moved(self, features: Tensor, keys: Tensor, shape: Triple) -> "SparseTensor":
        """Features on other cells of the same frames, with the rulebooks found so far."""
        return replace(self, features=features, keys=keys, shape=shape)

    def split(self, n: int) -> "tuple[SparseTensor, SparseTensor]":
        """The first ``n`` frames, and the rest; both have at least one. Rulebooks are found anew."""
        cells = n * math.prod(self.shape)
        edge = int(torch.searchsorted(self.keys, cells))
        one = replace(self, features=self.features[:edge], keys=self.keys[:edge], batch_size=n, rulebooks={})
        return one, replace(
            self,
            features=self.features[edge:],
            keys=self.keys[edge:] - cells,
            batch_size=self.batch_size - n,
            rulebooks={},
        )
