"""What a network's trunk gives: features with a place, on a bird's-eye map (dense or sparse) or at points.

Three things can be done with them whatever their form: a head reads them, ``rows`` lists them with the frame and place
of each, and ``split`` parts the frames of two batches that went through the trunk together.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from farfield.detectors.sparse.cells import SparseTensor


class FeatureRows(NamedTuple):
    """Features one by one.

    Attributes:
        values: The features, shape (n, c).
        frame: Number of the frame of each, shape (n,), int64.
        place_m: x and y of each in metres, shape (n, 2).
    """

    values: Tensor
    frame: Tensor
    place_m: Tensor


def chosen_rows(count: int, limit: int | None, generator: torch.Generator | None) -> Tensor | None:
    """Which of ``count`` rows to take, ascending, shape (limit,), int64; None for all of them.

    Args:
        count: Rows there are.
        limit: Rows to take at most.
        generator: Draws them; without one they are spread evenly.
    """
    if limit is None or count <= limit:
        return None
    if generator is None:
        return (torch.arange(limit) * count) // limit
    return torch.randperm(count, generator=generator, device=generator.device)[:limit].sort().values


def in_type_of(weights: nn.Module, values: Tensor) -> Tensor:
    """The values in the number type of a module's weights; as they are where autocast chooses the type."""
    if torch.is_autocast_enabled(values.device.type):
        return values
    return values.to(next(weights.parameters()).dtype)


@dataclass(frozen=True, eq=False, kw_only=True)
class FeatureMap:
    """Features of the cells of a bird's-eye grid.

    Args:
        values: Dense features (b, c, nx, ny), or sparse ones on a grid of nx x ny cells and any depth.
        cell_m: Edge length of a cell.
        origin_m: x and y of the corner of the first cell.
        aux: What the head reads beside them: dense tensors with one row a frame, or sparse tensors of the same frames.
    """

    values: Tensor | SparseTensor
    cell_m: float
    origin_m: tuple[float, float]
    aux: Mapping[str, Tensor | SparseTensor] = field(default_factory=dict)

    @property
    def dense(self) -> Tensor:
        """The dense features, shape (b, c, nx, ny).

        Raises:
            TypeError: If the features are sparse.
        """
        if isinstance(self.values, SparseTensor):
            raise TypeError(
                "FeatureMap: expected dense features, (b, c, nx, ny); got sparse ones: this head wants maps"
            )
        return self.values

    @property
    def sparse(self) -> SparseTensor:
        """The sparse features.

        Raises:
            TypeError: If the features are dense.
        """
        if not isinstance(self.values, SparseTensor):
            raise TypeError("FeatureMap: expected sparse features; got dense ones: this head wants occupied cells")
        return self.values

    def __len__(self) -> int:
        return self.values.batch_size if isinstance(self.values, SparseTensor) else len(self.values)

    def rows(self, limit: int | None = None, generator: torch.Generator | None = None) -> FeatureRows:
        """The features of the cells, frame after frame; of sparse features those of the occupied cells.

        Args:
            limit: Take at most so many, of all frames together: dense maps at long range have 100,000 and more.
            generator: Draws which; without one they are spread evenly.
        """
        if isinstance(self.values, SparseTensor):
            sparse, index = self.values, chosen_rows(len(self.values.keys), limit, generator)
            values, cells = sparse.features, sparse.indices()
            if index is not None:
                index = index.to(cells.device)
                values, cells = values[index], cells[index]
            frame, _, ix, iy = cells.unbind(1)
            return FeatureRows(values, frame, self._places_m(ix, iy))
        frames, channels, nx, ny = self.values.shape
        index = chosen_rows(frames * nx * ny, limit, generator)
        cell = torch.arange(frames * nx * ny) if index is None else index
        cell = cell.to(self.values.device)
        frame, ix, iy = cell // (nx * ny), cell // ny % nx, cell % ny
        if index is None:
            values = self.values.permute(0, 2, 3, 1).reshape(-1, channels)
        else:
            values = self.values[frame, :, ix, iy]  # without a copy of the whole map
        return FeatureRows(values, frame, self._places_m(ix, iy))

    def _places_m(self, ix: Tensor, iy: Tensor) -> Tensor:
        x, y = ((i + 0.5) * self.cell_m + start for i, start in zip((ix, iy), self.origin_m, strict=True))
        return torch.stack([x, y], 1)

    def split(self, n: int) -> "tuple[FeatureMap, FeatureMap]":
        """The first ``n`` frames, and the rest.

        Raises:
            ValueError: If that leaves no frame on one side.
        """
        _check_split(n, len(self))
        one, other = _parted(self.values, n)
        aux = {name: _parted(value, n) for name, value in self.aux.items()}
        first, rest = ({name: pair[side] for name, pair in aux.items()} for side in (0, 1))
        return (
            FeatureMap(values=one, cell_m=self.cell_m, origin_m=self.origin_m, aux=first),
            FeatureMap(values=other, cell_m=self.cell_m, origin_m=self.origin_m, aux=rest),
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class PointFeatures:
    """Features of points, frame after frame.

    Args:
        values: The features, shape (n, c).
        xyz: Coordinates in metres, shape (n, 3).
        lengths: Points of each frame.
        aux: What the head reads beside them: tensors with one row a point.
    """

    values: Tensor
    xyz: Tensor
    lengths: Sequence[int]
    aux: Mapping[str, Tensor] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.lengths)

    def rows(self, limit: int | None = None, generator: torch.Generator | None = None) -> FeatureRows:
        """The features of the points; see :meth:`FeatureMap.rows`."""
        numbers = torch.arange(len(self.lengths), device=self.xyz.device)
        frame = numbers.repeat_interleave(torch.tensor(self.lengths, device=self.xyz.device))
        rows = FeatureRows(self.values, frame, self.xyz[:, :2])
        index = chosen_rows(len(self.values), limit, generator)
        return rows if index is None else FeatureRows(*(part[index.to(part.device)] for part in rows))

    def split(self, n: int) -> "tuple[PointFeatures, PointFeatures]":
        """The first ``n`` frames, and the rest.

        Raises:
            ValueError: If that leaves no frame on one side.
        """
        _check_split(n, len(self))
        points = sum(self.lengths[:n])
        sides = (slice(None, points), self.lengths[:n]), (slice(points, None), self.lengths[n:])
        first, rest = (
            PointFeatures(
                values=self.values[part],
                xyz=self.xyz[part],
                lengths=lengths,
                aux={name: value[part] for name, value in self.aux.items()},
            )
            for part, lengths in sides
        )
        return first, rest


Features = FeatureMap | PointFeatures


def _parted(value: Tensor | SparseTensor, n: int) -> tuple[Any, Any]:
    return value.split(n) if isinstance(value, SparseTensor) else (value[:n], value[n:])


def _check_split(n: int, frames: int) -> None:
    if not 0 < n < frames:
        raise ValueError(f"split: expected 1 to {frames - 1} of {frames} frames, got {n}")
