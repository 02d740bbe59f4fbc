"""Networks as graphs of fixed operators: what an exported file computes, from prepared inputs to decoded boxes.

A graph takes what a reading of :mod:`farfield.detectors.onnx` prepares, tables of neighbours among it, and holds the
layers of a trained network whose normalisation is folded. Sums over neighbours are gathers and products here, since
ONNX has no sparse convolution; nothing in a graph depends on how many points there are.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor, nn

from farfield.detectors.anchors.grid import DIRECTION_OFFSET_RAD, SIZE_RATIOS, AnchorGrid
from farfield.detectors.anchors.head import AnchorHead
from farfield.detectors.features import FeatureMap
from farfield.detectors.kradar.rtn import RTN
from farfield.detectors.kradar.rtnh import RTNH
from farfield.detectors.kradar.softmax_head import SoftmaxHead
from farfield.detectors.pointpillars.network import PointPillars
from farfield.detectors.second.network import Second
from farfield.detectors.sparse import SparseBlock, SparseConv, SubmanifoldConv
from farfield.detectors.voxelnet.middle import MiddleLayer, border_cells
from farfield.detectors.voxelnet.network import VoxelNet

Outputs = dict[str, Tensor]
_GATHERED = 320  # numbers of a row that are gathered at once
_SMALLEST_M = 0.1
LEAST = -1e9
"""Less than any number of a network: files hold no infinite ones."""


class Graph(nn.Module):
    """What one file computes of one frame.

    Attributes:
        outputs: Names of what it gives.
    """

    outputs: tuple[str, ...] = ("boxes", "scores", "labels", "index")

    def named(self, inputs: Mapping[str, Tensor]) -> Outputs:
        """The outputs of named inputs.

        Args:
            inputs: As the reading prepares them.
        """
        raise NotImplementedError

    def forward(self, inputs: dict[str, Tensor]) -> tuple[Tensor, ...]:
        """The outputs in their order."""
        named = self.named(inputs)
        return tuple(named[name] for name in self.outputs)


# Products by tables.


def with_zero_row(rows: Tensor, value: float = 0.0) -> Tensor:
    """The rows and one more: what a table's "none" stands for."""
    return torch.cat([rows, rows.new_full((1, rows.shape[1]), value)])


def convolved(rows: Tensor, conv: Any, table: Tensor, *, multiply_first: bool = False, bias: bool = True) -> Tensor:
    """A sparse convolution by a table.

    Args:
        rows: Features of the input cells, shape (n, c_in).
        conv: Its weights, shape (k, c_in, c_out), and bias.
        table: Row of the input under each kernel element, ``n`` for none, shape (m, k).
        multiply_first: Make the products at the inputs and gather those: less where outputs are more than inputs.
        bias: Add it.
    """
    weight, padded = conv.weight, with_zero_row(rows)
    size, c_in, c_out = weight.shape
    total: Tensor | None = None
    divisors = [number for number in range(1, size + 1) if size % number == 0 and number * c_in <= _GATHERED]
    wide = 1 if multiply_first else max(divisors, default=1)
    for start in range(0, size, wide):
        if multiply_first:
            part = (padded @ weight[start]).index_select(0, table[:, start])
        else:
            gathered = padded.index_select(0, table[:, start : start + wide].reshape(-1)).reshape(-1, wide * c_in)
            part = gathered @ weight[start : start + wide].reshape(wide * c_in, c_out)
        total = part if total is None else total + part
    assert total is not None
    return total + conv.bias if bias and conv.bias is not None else total


def block(rows: Tensor, layer: SparseBlock, table: Tensor, added: Tensor | None = None) -> Tensor:
    """A sparse convolution whose normalisation is folded, what is added, and ReLU where it has one."""
    assert isinstance(layer.norm, nn.Identity)
    conv: Any = layer.conv
    rows = rows @ conv.weight[0] + conv.bias if len(conv.weight) == 1 else convolved(rows, conv, table)
    rows = rows if added is None else rows + added
    return torch.relu(rows) if layer.relu else rows


def maximum(values: Tensor, member: Tensor, groups: int | torch.SymInt) -> Tensor:
    """The largest value of each group of rows that are not negative, shape (groups, c)."""
    start = values.new_zeros(groups, values.shape[1])
    return start.scatter_reduce(0, member[:, None].expand(-1, values.shape[1]), values, "amax")


def image_of(rows: Tensor, cell: Tensor, cells: int, shape: Sequence[int]) -> Tensor:
    """A map (1, c, nx, ny) with rows at its cells, zero elsewhere; ``shape`` is nx, ny and the channels."""
    canvas = rows.new_zeros(cells, rows.shape[1]).index_put((cell,), rows)
    return canvas.view(1, *shape).permute(0, 3, 1, 2)


# Heads: from a dense map to the decoded boxes of the best anchors.


class AnchorBoxes(nn.Module):
    """The anchor head with its decoding (see :mod:`farfield.detectors.anchors.head`).

    Args:
        head: The head, on a map of all its cells.
    """

    kinds: Tensor
    headings: Tensor

    def __init__(self, head: AnchorHead) -> None:
        super().__init__()
        self.head, self.grid = head, head.anchors
        kinds, headings = anchor_constants(self.grid)
        self.register_buffer("kinds", kinds)
        self.register_buffer("headings", headings)

    def forward(self, image: Tensor) -> Outputs:
        """Boxes, scores, labels and anchors of the best anchors of a map (1, c, nx, ny)."""
        grid, config = self.grid, self.head.config
        maps = self.head(FeatureMap(values=image, cell_m=1.0, origin_m=(0.0, 0.0)))
        logits, codes, directions = maps.logits[0], maps.codes[0], maps.directions[0]
        strength = logits if logits.ndim == 1 else logits.amax(1)
        best = torch.topk(strength, min(config.candidates, len(grid)))
        index = best.indices
        labels = index % grid.per_cell // 2 if logits.ndim == 1 else logits.index_select(0, index).argmax(1)
        code = codes.index_select(0, index)
        direction = directions.index_select(0, index)
        backwards = (direction[:, 1] > direction[:, 0]).to(code.dtype)
        anchors = anchors_at(grid, self.kinds, self.headings, index)
        return {
            "boxes": decoded(grid, code, backwards, anchors),
            "scores": torch.sigmoid(best.values),
            "labels": labels,
            "index": index,
        }


def anchor_constants(grid: AnchorGrid) -> tuple[Tensor, Tensor]:
    """Height and size of each class, shape (k, 4), and the headings, shape (2,), float32."""
    kinds = np.column_stack([grid.z_m, grid.sizes_m])
    return torch.from_numpy(kinds).float(), torch.from_numpy(np.asarray(grid.headings_rad)).float()


def anchors_at(grid: AnchorGrid, kinds: Tensor, headings: Tensor, index: Tensor) -> Tensor:
    """The anchors with these flat indices as x, y, z, l, w, h, yaw, shape (k, 7), float32."""
    cell, slot = index // grid.per_cell, index % grid.per_cell
    x = (cell // grid.ny).to(kinds.dtype) * float(grid.step_m[0]) + float(grid.first_m[0])
    y = (cell % grid.ny).to(kinds.dtype) * float(grid.step_m[1]) + float(grid.first_m[1])
    heading = headings.index_select(0, slot % 2)
    return torch.cat([torch.stack([x, y], 1), kinds.index_select(0, slot // 2), heading[:, None]], 1)


def wrapped(angle: Tensor) -> Tensor:
    """Angles in [-pi, pi)."""
    return angle - 2 * math.pi * torch.floor((angle + math.pi) / (2 * math.pi))


def decoded(grid: AnchorGrid, code: Tensor, backwards: Tensor, anchors: Tensor) -> Tensor:
    """Boxes of codes at anchors, as :func:`farfield.detectors.anchors.grid.decode`, shape (k, 7)."""
    diagonal = torch.sqrt(anchors[:, 3] ** 2 + anchors[:, 4] ** 2)
    centre = code[:, :3] * torch.stack([diagonal, diagonal, anchors[:, 5]], 1) + anchors[:, :3]
    low, high = map(math.log, SIZE_RATIOS)
    size = torch.exp(code[:, 3:6].clamp(low, high)) * anchors[:, 3:6]
    residual = code[:, 6] - math.pi * torch.round(code[:, 6] / math.pi)
    if grid.style == "farfield":
        yaw = wrapped(anchors[:, 6] + residual + math.pi * backwards)
    else:
        yaw = wrapped(anchors[:, 6] + residual)
        turn = yaw - DIRECTION_OFFSET_RAD
        fixed = (turn - 2 * math.pi * torch.floor(turn / (2 * math.pi)) >= math.pi).to(code.dtype)
        yaw = wrapped(yaw + math.pi * (fixed - backwards).abs())
    return torch.cat([centre, size, yaw[:, None]], 1)


class SoftmaxBoxes(nn.Module):
    """The softmax head with its decoding (see :mod:`farfield.detectors.kradar.softmax_head`).

    Args:
        head: The head, on a map of all its cells.
    """

    kinds: Tensor
    headings: Tensor

    def __init__(self, head: SoftmaxHead) -> None:
        super().__init__()
        self.head, self.grid = head, head.anchors
        kinds, headings = anchor_constants(self.grid)
        self.register_buffer("kinds", kinds)
        self.register_buffer("headings", headings)

    def forward(self, image: Tensor) -> Outputs:
        """Boxes, scores, labels and anchors of the best cells of a map (1, c, nx, ny); background scores 0."""
        grid = self.grid
        maps = self.head(FeatureMap(values=image, cell_m=1.0, origin_m=(0.0, 0.0)))
        probability, codes = torch.softmax(maps.logits[0], 1), maps.codes[0]
        strength, label = probability.max(1)
        strength = torch.where(label > 0, strength, 0.0)
        best = torch.topk(strength, min(self.head.config.candidates, grid.nx * grid.ny))
        slot = (label.index_select(0, best.indices) - 1).clamp(min=0)
        index = best.indices * grid.per_cell + slot
        anchors = anchors_at(grid, self.kinds, self.headings, index)
        code = codes.reshape(-1, 8).index_select(0, index)
        size = (anchors[:, 3:6] + code[:, 3:6]).clamp(min=_SMALLEST_M)
        yaw = torch.atan2(torch.sin(anchors[:, 6]) + code[:, 7], torch.cos(anchors[:, 6]) + code[:, 6])
        boxes = torch.cat([anchors[:, :3] + code[:, :3], size, yaw[:, None]], 1)
        return {"boxes": boxes, "scores": best.values, "labels": slot // 2, "index": index}


def head_of(network: Any) -> nn.Module:
    """A network's head with its decoding."""
    return SoftmaxBoxes(network.head) if isinstance(network.head, SoftmaxHead) else AnchorBoxes(network.head)


# The detectors.


class PillarGraph(Graph):
    """PointPillars, from described points."""

    def __init__(self, network: PointPillars) -> None:
        super().__init__()
        self.encoder, self.backbone, self.head = network.encoder, network.backbone, head_of(network)

    def named(self, inputs: Mapping[str, Tensor]) -> Outputs:
        """See :class:`~farfield.detectors.onnx.readings.PillarReading`."""
        encoder: Any = self.encoder
        learned = torch.relu(encoder.linear(inputs["points"]))
        pooled = maximum(learned, inputs["pillar"], inputs["cell"].shape[0])
        if "padded" in inputs:
            padding = torch.relu(encoder.linear.bias)[None]
            pooled = torch.where(inputs["padded"][:, None], torch.maximum(pooled, padding), pooled)
        shape = (encoder.nx, encoder.ny, encoder.channels)
        image = image_of(pooled, inputs["cell"], encoder.nx * encoder.ny, shape)
        return cast(Outputs, self.head(self.backbone(image)))


class SecondGraph(Graph):
    """SECOND, from mean voxels and tables."""

    def __init__(self, network: Second, shape: tuple[int, int, int]) -> None:
        super().__init__()
        self.middle, self.backbone, self.head = network.middle, network.backbone, head_of(network)
        self.shape = shape  # of the last level

    def named(self, inputs: Mapping[str, Tensor]) -> Outputs:
        """See :class:`~farfield.detectors.onnx.readings.SecondReading`."""
        rows = levels(inputs["voxels"], list(self.middle), inputs)
        depth, nx, ny = self.shape
        channels = rows.shape[1]
        image = image_of(rows, inputs["cell"], nx * ny * depth, (nx, ny, depth * channels))
        return cast(Outputs, self.head(self.backbone(image)))


def levels(rows: Tensor, layers: Sequence[Any], inputs: Mapping[str, Tensor]) -> Tensor:
    """Sparse blocks one after the other; each strided one goes on to the next level's tables."""
    level = 0
    for layer in layers:
        strided = isinstance(layer.conv, SparseConv)
        level += strided
        rows = block(rows, layer, inputs[f"strided_{level}" if strided else f"around_{level}"])
    return rows


class VoxelNetGraph(Graph):
    """VoxelNet, from described points and tables; the background of its middle layers is a constant."""

    columns: Tensor
    rows_y: Tensor

    def __init__(self, network: VoxelNet, shapes: Sequence[tuple[int, int, int]], margin: int) -> None:
        super().__init__()
        self.encoder, self.backbone, self.head = network.encoder, network.backbone, head_of(network)
        self.layers, self.shape = network.middle.layers, shapes[-1]
        depth, nx, ny = shapes[0]
        ground = torch.zeros(depth, min(nx, margin), min(ny, margin), network.config.voxel_channels)
        for number, layer in enumerate(self.layers, 1):
            assert isinstance(layer, MiddleLayer)
            assert isinstance(layer.norm, nn.Identity)
            level = layer._ground(ground)
            level = level if layer.conv.bias is None else level + layer.conv.bias
            ground = torch.relu(level)
            self.register_buffer(f"level_{number}", level.flatten(0, 2).detach())
            self.register_buffer(f"background_{number}", ground.flatten(0, 2).detach())
        depth, sx, sy, channels = ground.shape
        small = ground.permute(1, 2, 0, 3).reshape(sx, sy, depth * channels)
        self.register_buffer("small", small.detach())
        self.register_buffer("columns", border_cells(self.shape[1], sx))
        self.register_buffer("rows_y", border_cells(self.shape[2], sy))

    def named(self, inputs: Mapping[str, Tensor]) -> Outputs:
        """See :class:`~farfield.detectors.onnx.readings.VoxelNetReading`."""
        rows = self._encoded(inputs["points"], inputs["voxel"], inputs["first"])
        for number, layer in enumerate(self.layers, 1):
            ground = inputs[f"ground_{number}"]
            values = convolved(rows, layer.conv, inputs[f"strided_{number}"], multiply_first=True, bias=False)
            lifted = getattr(self, f"level_{number}").index_select(0, ground) + values
            rows = torch.relu(lifted) - getattr(self, f"background_{number}").index_select(0, ground)
        depth, nx, ny = self.shape
        base = cast(Tensor, self.small).index_select(0, self.columns).index_select(1, self.rows_y)
        base = base.reshape(nx * ny * depth, -1)
        cell = inputs["cell"]
        image = base.index_put((cell,), base.index_select(0, cell) + rows)
        image = image.view(1, nx, ny, -1).permute(0, 3, 1, 2)
        return cast(Outputs, self.head(self.backbone(image)))

    def _encoded(self, features: Tensor, voxel: Tensor, first: Tensor) -> Tensor:
        """Voxel features, each the maximum over its points; ``first`` is the row of each voxel's first point."""
        for layer in self.encoder.layers:
            features = layer(features)
            features = torch.cat([features, maximum(features, voxel, first.shape[0]).index_select(0, voxel)], 1)
        return maximum(self.encoder.last(features), voxel, first.shape[0])


class RadarMapGraph(Graph):
    """RTN, from the values of occupied cells."""

    def __init__(self, network: RTN) -> None:
        super().__init__()
        self.trunk, self.neck, self.head = network.trunk, network.neck, head_of(network)
        self.shape, self.mean = network.config.grid.shape(network.multiple), network.config.height == "mean"

    def named(self, inputs: Mapping[str, Tensor]) -> Outputs:
        """See :class:`~farfield.detectors.onnx.readings.RadarMapReading`."""
        depth, nx, ny = self.shape
        values = inputs["values"]
        table = values.new_zeros(depth * nx * ny, values.shape[1]).index_put((inputs["cell"],), values)
        image = table.view(1, depth, nx, ny, -1)
        image = image.mean(1, keepdim=True) if self.mean else image
        image = image.permute(0, 4, 1, 2, 3).flatten(1, 2)
        return cast(Outputs, self.head(self.neck(self.trunk(image))))


class RadarCellGraph(Graph):
    """RTNH, from occupied cells and tables."""

    def __init__(self, network: RTNH, shapes: Sequence[tuple[int, int, int]]) -> None:
        super().__init__()
        self.encoder, self.backbone, self.head = network.encoder, network.backbone, head_of(network)
        self.shapes = shapes

    def named(self, inputs: Mapping[str, Tensor]) -> Outputs:
        """See :class:`~farfield.detectors.onnx.readings.RadarCellReading`."""
        rows, maps = self.cell_rows(inputs), []
        for number, (stage, collapse) in enumerate(self.backbone._branches(), 1):
            for layer in stage:
                table = "around" if isinstance(cast(Any, layer).conv, SubmanifoldConv) else "strided"
                rows = block(rows, cast(SparseBlock, layer), inputs[f"{table}_{number}"])
            column = block(rows, collapse, inputs[f"column_{number}"])
            _, nx, ny = self.shapes[number - 1]
            maps.append(image_of(column, inputs[f"place_{number}"], nx * ny, (nx, ny, column.shape[1])))
        return cast(Outputs, self.head(self.backbone.neck(maps)))

    def cell_rows(self, inputs: Mapping[str, Tensor]) -> Tensor:
        """Learned features of the occupied cells, one row each."""
        linear = self.encoder.linear
        if "points" in inputs:
            learned = linear(inputs["points"])
            start = torch.where(inputs["padded"], 0.0, LEAST)[:, None].expand(-1, learned.shape[1])
            rows = start.scatter_reduce(0, inputs["row"][:, None].expand(-1, learned.shape[1]), learned, "amax")
        else:
            rows = linear(inputs["cells"])
        return cast(Tensor, self.encoder.lift(rows))
