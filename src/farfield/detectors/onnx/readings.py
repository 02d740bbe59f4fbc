"""From a cloud's points to what an exported network reads, in numpy: pillars, voxels, radar cells.

One reading a kind of detector: its settings stand in the ONNX file, and :meth:`Reading.detect` asks the network. Each
does what the encoder of its detector does in PyTorch, down to the number type.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping
from typing import Annotated, ClassVar, Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Int
from pydantic import Field, model_validator

from farfield.detectors.config import GridConfig, VoxelGridConfig
from farfield.detectors.onnx.cells import (
    Triple,
    first_of_groups,
    in_float32,
    means_by_group,
    neighbour_table,
    split_keys,
    strided_table,
)
from farfield.files.yaml_text import PlainSettings

Tensors = Mapping[str, np.ndarray]
Run = Callable[[Tensors], Tensors]
"""Asks the network: from its inputs by name to its outputs by name."""

Positions = Literal["absolute", "relative"]
Columns = tuple[str, ...]
_LOG_POWER_UNIT = 0.01
_CUBE: Triple = (3, 3, 3)
_MOST_LAYERS = 1000

Size = Annotated[int, Field(ge=1, le=16)]
Padding = Annotated[int, Field(ge=0, le=16)]
Lower = Annotated[float, Field(ge=-1000, le=0)]


class DecodedBoxes(NamedTuple):
    """Decoded boxes before the suppression.

    Attributes:
        rows: x, y, z of the centre, length, width, height, yaw, shape (k, 7).
        score: Shape (k,).
        kind: Number of the class of each, shape (k,).
    """

    rows: Float[np.ndarray, "k 7"]
    score: Float[np.ndarray, " k"]
    kind: Int[np.ndarray, " k"]


class Reading(PlainSettings, ABC):
    """How one kind of detector reads points.

    Attributes:
        columns: Columns of the points, positions first.
    """

    columns: Columns = Field(min_length=3, max_length=32)

    @abstractmethod
    def inputs(self, points: Float32[np.ndarray, "n c"]) -> dict[str, np.ndarray]:
        """What the network reads of one frame, by the names of its inputs."""

    results: ClassVar[tuple[str, ...]] = ("boxes", "scores", "labels")
    """Outputs of the network that are looked at."""

    def detect(self, points: Float32[np.ndarray, "n c"], run: Run, first: Tensors | None = None) -> DecodedBoxes:
        """The decoded boxes of one frame.

        Args:
            points: What the network reads.
            run: Asks it.
            first: What :meth:`inputs` gives, where that was made before.
        """
        return candidates_of(run(self.inputs(points) if first is None else first))

    def blank(self) -> dict[str, tuple[str, tuple[int | None, ...]]]:
        """Of each input its number type and its sides after the first; None for one that weights decide."""
        return described(self.inputs(np.zeros((0, len(self.columns)), dtype=np.float32)))

    @property
    def others(self) -> list[int]:
        """Numbers of the columns that are no position."""
        return list(range(3, len(self.columns)))


def described(tensors: Tensors, open_sides: Collection[str] = ()) -> dict[str, tuple[str, tuple[int | None, ...]]]:
    """Number type and sides after the first of arrays, as an ONNX file states them."""
    types = {name: "?" if values.dtype == np.bool_ else values.dtype.str for name, values in tensors.items()}
    sides = {
        name: tuple(None if name in open_sides else side for side in values.shape[1:])
        for name, values in tensors.items()
    }
    return {name: (types[name], sides[name]) for name in tensors}


def candidates_of(outputs: Tensors) -> DecodedBoxes:
    """What the outputs ``boxes``, ``scores`` and ``labels`` say."""
    return DecodedBoxes(outputs["boxes"].astype(np.float64), outputs["scores"].astype(np.float64), outputs["labels"])


class PillarReading(Reading):
    """Points to pillars (PointPillars); each point is described for itself, the network takes the maximum."""

    kind: Literal["pillars"] = "pillars"
    grid: GridConfig
    multiple: int = Field(ge=1, le=1024)
    features: Literal["farfield", "openpcdet"]
    max_points: int = Field(0, ge=0)
    positions: Positions

    def inputs(self, points: Float32[np.ndarray, "n c"]) -> dict[str, np.ndarray]:
        """``points``: described points; ``pillar``: row of each one's pillar; ``cell``: cell of each pillar."""
        grid, (nx, ny), y_min_m = self.grid, self.grid.shape(self.multiple), self.grid.y_min_m(self.multiple)
        ix, iy = np.floor(points[:, 0] / grid.cell_m), np.floor((points[:, 1] - y_min_m) / grid.cell_m)
        inside = (ix >= 0) & (ix < nx) & (iy >= 0) & (iy < ny)
        inside &= (points[:, 2] >= grid.z_min_m) & (points[:, 2] < grid.z_max_m)
        key = ix[inside].astype(np.int64) * ny + iy[inside].astype(np.int64)
        rows = first_of_groups(key, self.max_points) if self.features == "openpcdet" else np.arange(len(key))
        points, key = points[inside][rows], key[rows]
        cell, pillar, count = np.unique(key, return_inverse=True, return_counts=True)
        describe = self._published if self.features == "openpcdet" else self._described
        tensors = {"points": in_float32(describe(points, key, pillar, count, ny)), "pillar": pillar, "cell": cell}
        return {**tensors, "padded": count < self.max_points} if self.max_points else tensors

    def _centres_m(self, key: np.ndarray, ny: int) -> np.ndarray:
        cell_m, half = np.float32(self.grid.cell_m), np.float32(0.5)
        ix, iy = (index.astype(np.float32) for index in np.divmod(key, ny))
        return np.stack([(ix + half) * cell_m, (iy + half) * cell_m + np.float32(self.grid.y_min_m(self.multiple))], 1)

    def _described(
        self, points: np.ndarray, key: np.ndarray, pillar: np.ndarray, count: np.ndarray, ny: int
    ) -> np.ndarray:
        grid, xyz = self.grid, points[:, :3]
        mean = means_by_group(xyz, pillar, len(count)).astype(np.float32)
        scale = np.array([grid.range_m, grid.half_width_m, grid.z_max_m], dtype=np.float32)
        first, cell_m = 0 if self.positions == "absolute" else 2, np.float32(grid.cell_m)
        to_centre = (xyz[:, :2] - self._centres_m(key, ny)) / cell_m
        number = np.log1p(count.astype(np.float32))[pillar, None]
        parts = [(xyz / scale)[:, first:], (xyz - mean[pillar]) / cell_m, to_centre, number, points[:, self.others]]
        return np.concatenate(parts, 1)

    def _published(
        self, points: np.ndarray, key: np.ndarray, pillar: np.ndarray, count: np.ndarray, ny: int
    ) -> np.ndarray:
        xyz, strength = points[:, :3], self.columns.index("intensity")
        mean = means_by_group(xyz, pillar, len(count)).astype(np.float32)
        height = np.full((len(key), 1), (self.grid.z_min_m + self.grid.z_max_m) / 2, dtype=np.float32)
        centre = np.concatenate([self._centres_m(key, ny), height], 1)
        return np.concatenate([xyz, points[:, [strength]], xyz - mean[pillar], xyz - centre], 1)


class VoxelReading(Reading, ABC):
    """Points to voxels of a grid."""

    grid: VoxelGridConfig
    multiple: int = Field(ge=1, le=65536)

    @model_validator(mode="after")
    def _few_layers(self) -> "VoxelReading":
        if self.shape[0] > _MOST_LAYERS:
            raise ValueError(f"expected at most {_MOST_LAYERS} layers of cells along z, got {self.shape[0]}")
        return self

    @property
    def shape(self) -> Triple:
        """Cells along z, x and y."""
        return self.grid.shape(self.multiple)

    def located(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The points inside the grid and the voxel of each, numbered ``(iz * nx + ix) * ny + iy``."""
        (depth, nx, ny), (dx, dy, dz), grid = self.shape, self.grid.cell_m, self.grid
        x_m, y_m, z_m = self.from_limits(points).T
        ix, iy = np.floor(x_m / dx), np.floor((y_m - grid.y_min_m(self.multiple)) / dy)
        iz = np.floor((z_m - grid.z_min_m) / dz)
        inside = (ix >= 0) & (ix < nx) & (iy >= 0) & (iy < ny) & (iz >= 0) & (iz < depth - grid.extra_layers)
        z, x, y = (index[inside].astype(np.int64) for index in (iz, ix, iy))
        return points[inside], (z * nx + x) * ny + y

    def from_limits(self, points: np.ndarray) -> np.ndarray:
        """x, y and z of the points as the grid's limits count them, shape (n, 3)."""
        return points[:, :3]

    def centres_m(self, keys: Int[np.ndarray, " n"]) -> Float32[np.ndarray, "n 3"]:
        """x, y and z of voxels in metres."""
        iz, ix, iy = split_keys(keys, self.shape).astype(np.float32)
        (dx, dy, dz), grid, half = map(np.float32, self.grid.cell_m), self.grid, np.float32(0.5)
        y_min_m = np.float32(grid.y_min_m(self.multiple))
        return np.stack([(ix + half) * dx, (iy + half) * dy + y_min_m, (iz + half) * dz + np.float32(grid.z_min_m)], 1)

    @property
    def scale_m(self) -> Float32[np.ndarray, " 3"]:
        """Lengths by which mean positions are divided."""
        grid = self.grid
        return np.array([grid.range_m, grid.half_width_m, max(abs(grid.z_min_m), abs(grid.z_max_m))], dtype=np.float32)

    def mean_voxels(
        self, points: np.ndarray, *, published: bool, positions: Positions, max_points: int
    ) -> tuple[Int[np.ndarray, " n"], Float32[np.ndarray, "n c"]]:
        """The occupied voxels, ascending, and the mean features of each."""
        points, key = self.located(points)
        if max_points:
            rows = first_of_groups(key, max_points)
            points, key = points[rows], key[rows]
        keys, member, count = np.unique(key, return_inverse=True, return_counts=True)
        centre = self.centres_m(keys)
        values = np.concatenate([points[:, :3] - centre[member], points[:, self.others]], 1)
        mean = means_by_group(values, member, len(keys)).astype(np.float32)
        offset, rest = mean[:, :3], mean[:, 3:]
        position = centre + offset
        if published:
            return keys, np.concatenate([position, rest[:, [self.columns.index("intensity") - 3]]], 1)
        number = np.log1p(count.astype(np.float32))[:, None]
        scaled = (position / self.scale_m)[:, 0 if positions == "absolute" else 2 :]
        return keys, np.concatenate([offset / np.array(self.grid.cell_m, np.float32), scaled, number, rest], 1)


class SparseLevel(PlainSettings):
    """A strided sparse convolution, and the submanifold ones behind it.

    Attributes:
        kernel: Size along z, x and y.
        stride: Step along them.
        padding: Empty cells on both sides along them.
        followed: Whether submanifold convolutions with a kernel of three cells follow.
    """

    kernel: tuple[Size, Size, Size]
    stride: tuple[Size, Size, Size]
    padding: tuple[Padding, Padding, Padding]
    followed: bool


def level_tables(
    keys: np.ndarray, shape: Triple, levels: tuple[SparseLevel, ...]
) -> tuple[dict[str, np.ndarray], list[tuple[np.ndarray, Triple]]]:
    """Tables ``strided_N`` and ``around_N`` of levels one after the other, and the cells after each."""
    tables: dict[str, np.ndarray] = {}
    cells = []
    for number, level in enumerate(levels, 1):
        keys, shape, tables[f"strided_{number}"] = strided_table(keys, shape, level.kernel, level.stride, level.padding)
        if level.followed:
            tables[f"around_{number}"] = neighbour_table(keys, keys, shape, _CUBE)
        cells.append((keys, shape))
    return tables, cells


def stacked_rows(keys: np.ndarray, shape: Triple) -> np.ndarray:
    """Where each cell stands in a map whose channels are those of all layers of z, lowest first."""
    depth, _, ny = shape
    iz, ix, iy = split_keys(keys, shape)
    return np.asarray((ix * ny + iy) * depth + iz)


class SecondReading(VoxelReading):
    """Points to mean voxels and the tables of the sparse middle layers (SECOND)."""

    kind: Literal["second"] = "second"
    features: Literal["farfield", "openpcdet"]
    positions: Positions
    max_points: int = Field(0, ge=0)
    levels: tuple[SparseLevel, ...] = Field(min_length=1, max_length=8)

    def inputs(self, points: Float32[np.ndarray, "n c"]) -> dict[str, np.ndarray]:
        """``voxels``, ``around_0``, the tables of each level, and ``cell``: where its last one's cells stand."""
        published = self.features == "openpcdet"
        read = {"published": published, "positions": self.positions, "max_points": self.max_points}
        keys, features = self.mean_voxels(points, **read)  # type: ignore[arg-type]
        tables, cells = level_tables(keys, self.shape, self.levels)
        around = neighbour_table(keys, keys, self.shape, _CUBE)
        return {"voxels": in_float32(features), "around_0": around, **tables, "cell": stacked_rows(*cells[-1])}


class VoxelNetReading(VoxelReading):
    """Points by voxel, and the tables of the middle layers, whose cells differ from a background (VoxelNet)."""

    kind: Literal["voxelnet"] = "voxelnet"
    positions: Positions
    max_points: int = Field(ge=1, le=10_000)
    levels: tuple[SparseLevel, ...] = Field(min_length=1, max_length=8)
    margin: int = Field(ge=1, le=64)

    def inputs(self, points: Float32[np.ndarray, "n c"]) -> dict[str, np.ndarray]:
        """``points``, ``voxel`` of each, each voxel's ``first``; tables, ``ground_N`` of each level; ``cell``."""
        points, key = self.located(points)
        order = np.argsort(_hash(points), kind="stable")
        order = order[np.argsort(key[order], kind="stable")]
        points, key = points[order], key[order]
        rows = first_of_groups(key, self.max_points)
        points = points[rows]
        keys, start, member = np.unique(key[rows], return_index=True, return_inverse=True)
        mean = means_by_group(points[:, :3], member, len(keys)).astype(np.float32)
        first = 0 if self.positions == "absolute" else 2
        to_mean = (points[:, :3] - mean[member]) / np.array(self.grid.cell_m, np.float32)
        described = [(points[:, :3] / self.scale_m)[:, first:], points[:, self.others], to_mean]
        tables, cells = level_tables(keys, self.shape, self.levels)
        grounds = {f"ground_{n}": self._ground(*level) for n, level in enumerate(cells, 1)}
        named = {"points": in_float32(np.concatenate(described, 1)), "voxel": member, "first": start}
        return {**named, **tables, **grounds, "cell": stacked_rows(*cells[-1])}

    def _ground(self, keys: np.ndarray, shape: Triple) -> np.ndarray:
        iz, ix, iy = split_keys(keys, shape)
        sx, sy = (min(size, self.margin) for size in shape[1:])
        return np.asarray((iz * sx + border_cells(shape[1], sx)[ix]) * sy + border_cells(shape[2], sy)[iy])


def border_cells(size: int, small: int) -> Int[np.ndarray, " size"]:
    """Cell of a small axis that stands for each cell of a long one: ends cell by cell, one for all between."""
    margin, cell = small // 2, np.arange(size)
    from_end = cell - size + small
    return np.where(cell < margin, cell, np.where(from_end >= small - margin, from_end, margin))


def _hash(points: np.ndarray) -> np.ndarray:
    """A number that looks random, from the bits of the coordinates, shape (n,), int64; it wraps, as PyTorch's does."""
    bits = np.ascontiguousarray(points[:, :3], dtype=np.float32).view(np.int32).astype(np.int64)
    with np.errstate(over="ignore"):
        mixed = (bits * np.array([73856093, 19349663, 83492791], dtype=np.int64)).sum(1)
        mixed = (mixed ^ (mixed >> 29)) * np.int64(0x1CE4E5B9BF58476D)
    return np.asarray(mixed ^ (mixed >> 32))


class RadarReading(VoxelReading, ABC):
    """Radar points on their raster, power first among the columns behind the position.

    Attributes:
        low_m: How far beyond the grid's lower limits the raster begins along x, y and z: 0, or a cell below it.
        log_power: Read the logarithm of the power.
    """

    low_m: tuple[Lower, Lower, Lower] = (0.0, 0.0, 0.0)
    log_power: bool = False

    def from_limits(self, points: np.ndarray) -> np.ndarray:
        """As of any voxels, on a raster that may begin below the grid's limits."""
        return points[:, :3] - np.array(self.low_m, dtype=np.float32)

    def scaled(self, points: np.ndarray) -> np.ndarray:
        """The points with their power as it is, or as its logarithm."""
        if not self.log_power:
            return points
        points = points.copy()
        column = self.columns.index("power")
        points[:, column] = np.log1p(np.maximum(points[:, column], np.float32(0.0)) / np.float32(_LOG_POWER_UNIT))
        return points


class RadarMapReading(RadarReading):
    """Mean values of each occupied cell, and its place in the image (RTN)."""

    kind: Literal["radar-map"] = "radar-map"

    def inputs(self, points: Float32[np.ndarray, "n c"]) -> dict[str, np.ndarray]:
        """``values`` of the occupied cells, and ``cell``: number of each."""
        points, key = self.located(points)
        keys, member = np.unique(key, return_inverse=True)
        values = self.scaled(points)[:, self.others]
        return {"values": in_float32(means_by_group(values, member, len(keys))), "cell": keys}


class RadarCellReading(RadarReading):
    """Occupied cells, and the tables of the sparse stages with their columns (RTNH)."""

    kind: Literal["radar-cells"] = "radar-cells"
    max_points: int = Field(0, ge=0, le=1000)
    unit_positions: bool = False
    levels: tuple[SparseLevel, ...] = Field(min_length=1, max_length=8)

    def inputs(self, points: Float32[np.ndarray, "n c"]) -> dict[str, np.ndarray]:
        """``cells`` or ``points`` with the ``row`` of each; tables; each stage's ``column_N`` with its ``place_N``."""
        points, key = self.located(points)
        points = self._in_unit_grid(points) if self.unit_positions else points
        features = self.scaled(points)
        if self.max_points:
            rows = first_of_groups(key, self.max_points)
            keys, member, count = np.unique(key[rows], return_inverse=True, return_counts=True)
            padded = count < self.max_points
            tensors = {"points": in_float32(features[rows]), "row": member, "padded": padded}
        else:
            keys, member = np.unique(key, return_inverse=True)
            tensors = {"cells": in_float32(means_by_group(features, member, len(keys)))}
        tables, cells = level_tables(keys, self.shape, self.levels)
        for number, (level_keys, shape) in enumerate(cells, 1):
            whole: Triple = (shape[0], 1, 1)
            table = strided_table(level_keys, shape, whole, (1, 1, 1), (0, 0, 0))
            tables |= {f"place_{number}": table[0], f"column_{number}": table[2]}
        return {**tensors, **tables}

    def _in_unit_grid(self, points: np.ndarray) -> np.ndarray:
        grid = self.grid
        low = np.array([0.0, -grid.half_width_m, grid.z_min_m], dtype=np.float32)
        high = np.array([grid.range_m, grid.half_width_m, grid.z_max_m], dtype=np.float32)
        return np.concatenate([(points[:, :3] - low) / (high - low) * 2 - 1, points[:, 3:]], 1)
