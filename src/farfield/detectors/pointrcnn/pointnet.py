"""PointNet++ (Qi et al., NIPS 2017): set abstraction on several scales, and feature propagation.

The first layer of each shared perceptron is linear before its normalisation, so it is applied to the points before they
are grouped or interpolated, and not to each of their copies: the same function for a fraction of the work.
Normalisation counts each neighbour once; where the original fills groups up with copies, so would its statistics.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, Literal, NamedTuple, cast

import torch
from pydantic import BaseModel, ConfigDict, Field, model_validator
from torch import Tensor, nn
from torch.nn import functional

from farfield.detectors.config import Channels
from farfield.detectors.layers import fold_linear, normalise_rows
from farfield.detectors.pointrcnn.points import (
    Groups,
    ball_query,
    farthest_points,
    group_max,
    interpolate,
    spread_points,
    three_nearest,
)

Widths = Annotated[tuple[Channels, ...], Field(min_length=1, max_length=16)]


class SetAbstractionConfig(BaseModel):
    """One level: its centres, and one neighbourhood and one perceptron for each scale."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    centres: int = Field(ge=1, le=65536)
    radii_m: tuple[Annotated[float, Field(gt=0)], ...] = Field(
        min_length=1, max_length=8, description="set abstractions, each on fewer points"
    )
    limits: tuple[Annotated[int, Field(ge=1, le=4096)], ...] = Field(description="neighbours that each scale keeps")
    widths: tuple[Widths, ...]

    @model_validator(mode="after")
    def _fit_together(self) -> "SetAbstractionConfig":
        if not len(self.radii_m) == len(self.limits) == len(self.widths):
            raise ValueError("expected as many limits and widths as radii_m")
        return self


class BackboneConfig(BaseModel):
    """Levels from fine to coarse, and the perceptrons that bring features back to the finer levels."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    levels: tuple[SetAbstractionConfig, ...] = Field(
        min_length=1, max_length=8, description="set abstractions, from fine to coarse"
    )
    propagation: tuple[Widths, ...] = Field(description="one perceptron a level; the first leads to all points")
    sampling: Literal["fps", "voxel"] = Field("fps", description="farthest points, or the faster one point a voxel")

    @model_validator(mode="after")
    def _fit_together(self) -> "BackboneConfig":
        if len(self.propagation) != len(self.levels):
            raise ValueError(f"expected {len(self.levels)} entries of propagation, got {len(self.propagation)}")
        centres = [level.centres for level in self.levels]
        if centres != sorted(centres, reverse=True):
            raise ValueError(f"expected levels with fewer and fewer centres, got {centres}")
        return self


class SharedMlp(nn.Module):
    """A perceptron on rows: linear, batch normalisation, ReLU, again and again.

    Args:
        widths: Features of the input and of each layer.
        norm: Normalise; without it the layers have a bias.
    """

    def __init__(self, widths: Sequence[int], *, norm: bool = True) -> None:
        super().__init__()
        pairs = list(pairwise(widths))
        self.linears = nn.ModuleList(nn.Linear(c_in, c_out, bias=not norm) for c_in, c_out in pairs)
        self.norms = nn.ModuleList(nn.BatchNorm1d(c_out) if norm else nn.Identity() for _, c_out in pairs)

    @property
    def dtype(self) -> torch.dtype:
        """Type of the weights, to which inputs are cast."""
        return self._first.weight.dtype

    @property
    def _first(self) -> nn.Linear:
        return cast(nn.Linear, self.linears[0])

    def forward(self, rows: Tensor) -> Tensor:
        """Rows (n, c_in) to rows (n, c_out)."""
        return self.after_first(self.linears[0](rows.to(self.dtype)))

    def first(self, rows: Tensor, columns: slice) -> Tensor:
        """The part of the first layer that reads these columns of the input; the bias is left to ``after_first``."""
        return functional.linear(rows.to(self.dtype), self._first.weight[:, columns])

    def after_first(self, rows: Tensor, *, bias: bool = False) -> Tensor:
        """Everything after the first layer; ``bias`` adds that layer's, which :meth:`first` leaves out."""
        if bias and self._first.bias is not None:
            rows = rows + self._first.bias
        rows = functional.relu(normalise_rows(self.norms[0], rows))
        for linear, norm in zip(self.linears[1:], self.norms[1:], strict=True):
            rows = functional.relu(normalise_rows(norm, linear(rows.to(self.dtype))))
        return rows

    def fold_norm(self) -> None:
        """Fold each normalisation into its linear layer, in place."""
        for index, (linear, norm) in enumerate(zip(self.linears, self.norms, strict=True)):
            if isinstance(norm, nn.BatchNorm1d) and isinstance(linear, nn.Linear):
                self.linears[index], self.norms[index] = fold_linear(linear, norm), nn.Identity()


class SetAbstraction(nn.Module):
    """Features of centres from the points around them (PointNet++, sections 3.2 and 3.3, multi-scale grouping).

    Offsets from the centre are given in radii, so that all scales see numbers of one size.

    Args:
        c_in: Features a point; may be 0.
        config: The level.
        norm: Use batch normalisation.
    """

    def __init__(self, c_in: int, config: SetAbstractionConfig, *, norm: bool = True) -> None:
        super().__init__()
        self.config, self.c_in = config, c_in
        self.mlps = nn.ModuleList(SharedMlp((3 + c_in, *widths), norm=norm) for widths in config.widths)
        self.channels = sum(widths[-1] for widths in config.widths)

    def forward(
        self,
        xyz: Tensor,
        features: Tensor | None,
        lengths: Sequence[int],
        centres: Tensor,
        centre_lengths: Sequence[int],
    ) -> Tensor:
        """Features of the centres, shape (m, channels), from points (n, 3) and their features (n, c_in)."""
        config = self.config
        groups = ball_query(xyz, lengths, centres, centre_lengths, radii_m=config.radii_m, limits=config.limits)
        pooled = []
        for mlp, radius, group in zip(self.mlps, config.radii_m, groups, strict=True):
            offset = (xyz.index_select(0, group.point) - centres.index_select(0, group.centre)) / radius
            pooled.append(pool_group(cast(SharedMlp, mlp), group, offset, features))
        return torch.cat(pooled, 1)


def pool_group(mlp: SharedMlp, group: Groups, offset: Tensor, features: Tensor | None) -> Tensor:
    """Perceptron on each pair of a group and the maximum over each centre (PointNet, equation 1).

    Args:
        mlp: Reads three columns of the offset and then the features.
        group: Pairs of centres and points.
        offset: What each pair adds: where the point is, shape (p, 3).
        features: Features of the points, shape (n, c), or None.
    """
    rows = mlp.first(offset, slice(0, 3))
    if features is not None:
        rows = rows + mlp.first(features, slice(3, None)).index_select(0, group.point)
    return group_max(mlp.after_first(rows, bias=True), group)


class FeaturePropagation(nn.Module):
    """Features of a finer level from a coarser one by interpolation, joined with its own (PointNet++, section 3.4).

    Args:
        c_coarse: Features of the coarser level.
        c_fine: Features that the finer level already has; may be 0.
        widths: Layers of the perceptron.
    """

    def __init__(self, c_coarse: int, c_fine: int, widths: Sequence[int]) -> None:
        super().__init__()
        self.c_coarse, self.channels = c_coarse, widths[-1]
        self.mlp = SharedMlp((c_coarse + c_fine, *widths))

    def forward(self, coarse: Tensor, row: Tensor, weight: Tensor, fine: Tensor | None) -> Tensor:
        """Features of the finer level, shape (n, channels); ``row`` and ``weight`` are those of ``three_nearest``."""
        rows = interpolate(self.mlp.first(coarse, slice(0, self.c_coarse)), row, weight)
        if fine is not None:
            rows = rows + self.mlp.first(fine, slice(self.c_coarse, None))
        return self.mlp.after_first(rows, bias=True)


class _PointLevel(NamedTuple):
    """Points of a level; the rows of each frame are in the order in which they were sampled."""

    xyz: Tensor
    lengths: list[int]
    features: Tensor | None


class PointNet2(nn.Module):
    """The encoder and decoder: features for every point of every frame.

    Args:
        c_in: Features a point; may be 0.
        config: Levels and widths.
    """

    def __init__(self, c_in: int, config: BackboneConfig) -> None:
        super().__init__()
        self.config = config
        channels, abstractions = [c_in], []
        for level in config.levels:
            abstractions.append(SetAbstraction(channels[-1], level))
            channels.append(abstractions[-1].channels)
        self.abstractions = nn.ModuleList(abstractions)
        carried, propagations = channels[-1], []
        for fine, widths in zip(channels[-2::-1], config.propagation[::-1], strict=True):
            propagations.append(FeaturePropagation(carried, fine, widths))
            carried = widths[-1]
        self.propagations = nn.ModuleList(propagations)
        self.channels = carried

    def forward(self, xyz: Tensor, features: Tensor | None, lengths: Sequence[int]) -> Tensor:
        """Features of all points, shape (n, channels).

        Args:
            xyz: Coordinates in metres, shape (n, 3), float32.
            features: Further features, shape (n, c_in); None if there are none.
            lengths: Points of each frame.
        """
        levels = [_PointLevel(xyz, list(lengths), features)]
        for abstraction, rows in zip(self.abstractions, self._choices(xyz, lengths), strict=True):
            last, (chosen, counts) = levels[-1], rows
            centres = last.xyz[chosen]
            pooled = abstraction(last.xyz, last.features, last.lengths, centres, counts)
            levels.append(_PointLevel(centres, counts, pooled))
        carried = levels[-1].features
        for propagation, fine, coarse in zip(self.propagations, levels[-2::-1], levels[:0:-1], strict=True):
            row, weight = three_nearest(fine.xyz, fine.lengths, coarse.xyz, coarse.lengths)
            carried = propagation(carried, row, weight, fine.features)
        assert carried is not None
        return carried

    def _choices(self, xyz: Tensor, lengths: Sequence[int]) -> list[tuple[Tensor, list[int]]]:
        """Rows of each level's points in the level before, and how many each frame has.

        Samples are sequences of which every prefix is a sample, so one run serves all levels.
        """
        sample = farthest_points if self.config.sampling == "fps" else spread_points
        counts = [level.centres for level in self.config.levels]
        choices = [sample(xyz, lengths, counts[0])]
        for count in counts[1:]:
            before = choices[-1][1]
            lengths_now = [min(count, length) for length in before]
            starts = [sum(before[:frame]) for frame in range(len(before))]
            parts = [torch.arange(s, s + k, device=xyz.device) for s, k in zip(starts, lengths_now, strict=True)]
            choices.append((torch.cat(parts), lengths_now))
        return choices
