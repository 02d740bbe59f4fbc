"""RTNH, the Radar Tensor Network with Height (K-Radar: Paek, Kong and Wijaya, NeurIPS 2022, section 3.4, appendix E).

The strongest cells of the radar's Cartesian cube -> sparse 3D convolutions at three resolutions -> each collapsed over
its height and brought to one bird's-eye map -> head -> rotated NMS. ``form: published`` is ``cfg_RTNH.yml`` of the
paper's benchmark; ``form: wide`` is the current one, ``cfg_RTNH_wide.yml``. Differences from the released code: all
boxes of a frame keep the cells assigned to them, frames without boxes teach background, there is no limit on the
number of cells, and convolutions that a normalisation follows have no bias, which it would cancel. Two differences
are settings, and imported checkpoints of the kit set them: its wide form has a second linear layer on each cell
(``lifted_channels: 64``), and its first form numbers cells from one below the limits (``first_cell: before it``).
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal, cast

import torch
from pydantic import Field
from torch import Tensor, nn
from torch.nn import functional

from farfield.detectors.config import Channels
from farfield.detectors.features import FeatureMap, in_type_of
from farfield.detectors.kradar.radar_detector import CellEncoder, RadarDetector, RadarDetectorConfig, RadarNeck
from farfield.detectors.layers import affine, normalise_rows
from farfield.detectors.network import InputColumns
from farfield.detectors.sparse import (
    SparseBlock,
    SparseConv,
    SparseSequential,
    SparseTensor,
    SubmanifoldConv,
    normalised,
)
from farfield.detectors.sparse.cells import Triple
from farfield.detectors.sparse.tables import occupied_map, reached_map


class RTNHConfig(RadarDetectorConfig):
    """Everything that decides the shape of the network and its boxes; the widths are the published ones."""

    name: str = "rtnh"
    max_points: Annotated[int, Field(ge=0, le=1000)] = Field(
        0, description="0: a linear layer on each cell's mean; else the maximum over so many points (PointNet)"
    )
    positions: Literal["metres", "unit"] = Field("metres", description="unit: as shares of the grid, -1 to 1")
    cell_channels: Channels = Field(64, description="channels of the first layer of cells")
    lifted_channels: Annotated[int, Field(ge=0, le=4096)] = Field(
        0, description="channels of a second linear layer on each cell, 64 in the kit's wide form; 0: there is none"
    )
    widths: tuple[Channels, ...] = Field(
        (64, 128, 256), min_length=1, max_length=6, description="channels of each block"
    )
    execution: Literal["auto", "sparse", "dense"] = Field("auto", description="one function, two ways to compute it")


class RTNH(RadarDetector):
    """The network: its outputs are the head's maps."""

    low_precision: ClassVar[tuple[str, ...]] = ("backbone", "head")

    def __init__(self, config: RTNHConfig | None = None) -> None:
        config = config or RTNHConfig()
        super().__init__(config)
        multiple = 2 ** (len(config.widths) - 1)
        self.encoder = CellEncoder(
            config.grid,
            config.columns,
            multiple=multiple,
            channels=config.cell_channels,
            max_points=config.max_points,
            lifted=config.lifted_channels,
            low_m=config.low_m,
            log_power=config.power == "log",
            unit_positions=config.positions == "unit",
        )
        self.backbone = RadarBackbone(
            self.encoder.channels,
            widths=config.widths,
            neck_width=config.neck_width,
            depth=config.grid.shape(multiple)[0],
            execution=config.execution,
        )
        self.add_head(self.backbone.channels, multiple)

    def input_columns(self) -> InputColumns:
        """What the encoder's linear layer reads of a cell."""
        return {"encoder.linear.weight": (1, self.encoder.columns)}

    def encode(self, batch: Mapping[str, list[Tensor]]) -> FeatureMap:
        """Occupied cells, 3D sparse convolution blocks and neck (appendix E.1 and E.2)."""
        cells = self.encoder(batch["points"])
        return self.on_raster(self.backbone(cells.replace(in_type_of(self.backbone, cells.features))))


# RTNH's backbone (K-Radar, NeurIPS 2022, section 3.4 and appendix E.2) and the neck that RTNH and RTN share.
#
# Three stages of sparse 3D convolutions, each of one strided and two submanifold layers; the height of each stage is
# collapsed by a convolution as tall as its map; transposed convolutions bring all to the resolution of the first.
#
# A radar cloud can fill most of its raster, and then dense convolution is faster. Both ways compute the same function
# with the same weights: what no cell reaches stays zero.

Execution = Literal["auto", "sparse", "dense"]
DENSE_SHARE = {"training": 0.2, "pairs": 0.35, "tables": 0.6, "tables, matrix tiles": 0.28}
"""Share of cells that the first layer reaches from which ``auto`` convolves densely, by what sparse convolution would
do (radar_detector_speed.py). Matrix tiles (AMX) make products cheap beside looking up neighbours."""
DENSE_CELLS = 80_000
"""With pairs also from so many cells on: their products no longer fit what sparse convolution allows itself."""
SLAB_BYTES, WHOLE_BYTES = 2**22, 2**24
"""Of the result of a dense convolution: finished before the next part of it is begun, where the whole is larger."""


class RadarBackbone(nn.Module):
    """The 3D sparse convolution blocks with their neck.

    Args:
        c_in: Features a cell.
        widths: Channels of each stage; each stage after the first halves the resolution.
        neck_width: Channels that each stage contributes to the bird's-eye map.
        depth: Layers of cells along z.
        execution: How to convolve: sparse, dense, or whichever is faster.
    """

    def __init__(
        self, c_in: int, *, widths: Sequence[int], neck_width: int, depth: int, execution: Execution = "auto"
    ) -> None:
        super().__init__()
        self.execution = execution
        self.stages, self.to_bev = nn.ModuleList(), nn.ModuleList()
        for number, width in enumerate(widths):
            step = 1 if number == 0 else 2
            depth = (depth - 1) // step + 1
            first = normalised(SparseConv(c_in, width, (3, 3, 3), (step, step, step), (1, 1, 1)), eps=1e-5)
            rest = [normalised(SubmanifoldConv(width, width), eps=1e-5) for _ in range(2)]
            self.stages.append(SparseSequential(first, *rest))
            collapse = SparseConv(width, width, (depth, 1, 1), (1, 1, 1), (0, 0, 0))
            self.to_bev.append(normalised(collapse, eps=1e-5))
            c_in = width
        self.neck = RadarNeck(widths, [2**n for n in range(len(widths))], neck_width, overlap=True)
        self.channels = self.neck.channels

    @property
    def _first(self) -> SparseBlock:
        return cast(SparseBlock, cast(SparseSequential, self.stages[0])[0])

    def _branches(self) -> list[tuple[SparseSequential, SparseBlock]]:
        """Each stage with the block that collapses its cells to the bird's-eye map."""
        branches = zip(self.stages, self.to_bev, strict=True)
        return [(cast(SparseSequential, stage), cast(SparseBlock, collapse)) for stage, collapse in branches]

    def forward(self, cells: SparseTensor) -> Tensor:
        """Occupied cells to a bird's-eye map (b, channels, nx, ny)."""
        cells = dataclasses.replace(cells, close=True)
        if self.execution == "sparse" or (self.execution == "auto" and not _convolves_fast(cells.features)):
            return self._sparse(cells)
        occupied = occupied_map(cells)
        if self.execution == "dense" or self._fills(cells, _reached(occupied, self._first.conv)):
            return self._dense(cells, occupied)
        return self._sparse(cells)

    def _fills(self, cells: SparseTensor, reached: Tensor) -> bool:
        """Whether the cells that the first layer reaches are so many that dense convolution is faster."""
        count, size = int(reached.sum()), reached.numel()
        if self.training:
            return count >= DENSE_SHARE["training"] * size
        if self._first.conv.by_table(cells):
            has_matrix_tiles = getattr(torch.cpu, "_is_amx_tile_supported", bool)()
            return count >= DENSE_SHARE["tables, matrix tiles" if has_matrix_tiles else "tables"] * size
        return count >= min(DENSE_SHARE["pairs"] * size, DENSE_CELLS)

    def _sparse(self, sparse: SparseTensor) -> Tensor:
        maps, cells = [], sparse
        for stage, collapse in self._branches():  # as in SparseSequential: searches first
            cells = stage.plan(cells)
            collapse.plan(cells)
        for stage, collapse in self._branches():
            sparse = stage(sparse)
            maps.append(collapse(sparse).dense().squeeze(2))
        out: Tensor = self.neck(maps)
        return out

    def _dense(self, cells: SparseTensor, occupied: Tensor) -> Tensor:
        volume, maps = cells.dense(), []
        for stage, collapse in self._branches():
            for block in stage:
                volume, occupied = dense_block(cast(SparseBlock, block), volume, occupied)
            maps.append(dense_block(collapse, volume, occupied)[0].squeeze(2))
        out: Tensor = self.neck(maps)
        return out


def _convolves_fast(features: Tensor) -> bool:
    """Whether PyTorch has a fast dense 3D convolution here: with one thread it has none for float32 on a CPU."""
    device = features.device.type
    coarse = features.dtype != torch.float32 or torch.is_autocast_enabled(device)
    return device != "cpu" or (torch.backends.mkldnn.is_available() and (coarse or torch.get_num_threads() > 1))


def _reached(occupied: Tensor, conv: Any) -> Tensor:
    """The cells that hold a value after a convolution, in the form of :func:`occupied_map`."""
    return (
        occupied if isinstance(conv, SubmanifoldConv) else reached_map(occupied, conv.kernel, conv.stride, conv.padding)
    )


def _kernel(conv: Any, dtype: torch.dtype) -> Tensor:
    """Weights as dense convolution takes them, (c_out, c_in, D, h, w); laid out once where no gradient is asked for."""
    weight = conv.weight.to(dtype).view(*conv.kernel, conv.c_in, conv.c_out).permute(4, 3, 0, 1, 2)
    if torch.is_grad_enabled():
        return weight
    cached, version, kernel = getattr(
        conv, "laid_out", (None, None, None)
    )  # holds the weights: their place stays theirs
    if cached is None or (cached.data_ptr(), version) != (conv.weight.data_ptr(), conv.weight._version):
        kernel = None
    if kernel is None or kernel.dtype != dtype:
        kernel = weight.contiguous(memory_format=torch.channels_last_3d)
        conv.laid_out = (conv.weight.detach(), conv.weight._version, kernel)
    return kernel


def dense_block(block: SparseBlock, volume: Tensor, occupied: Tensor) -> tuple[Tensor, Tensor]:
    """What a sparse block computes, by dense convolution.

    Args:
        block: Sparse convolution, normalisation, ReLU.
        volume: Features, zero where no cell is occupied, shape (b, c, D, nx, ny), channels last in memory.
        occupied: 1 at the occupied cells, else 0, shape (b, 1, D, nx, ny), uint8.

    Returns:
        The same two after the block.
    """
    conv: Any = block.conv
    submanifold = isinstance(conv, SubmanifoldConv)
    stride: Triple = (1, 1, 1) if submanifold else conv.stride
    padding = tuple(size // 2 for size in conv.kernel) if submanifold else conv.padding
    device = volume.device.type
    dtype = torch.get_autocast_dtype(device) if torch.is_autocast_enabled(device) else conv.weight.dtype
    bias = None if conv.bias is None else conv.bias.to(dtype)
    folded = isinstance(block.norm, nn.Identity) and not torch.is_grad_enabled()
    plain = (conv.kernel, stride, padding) == ((3, 3, 3), (1, 1, 1), (1, 1, 1))
    if folded and plain and device == "cpu" and occupied.numel() * conv.c_out * dtype.itemsize > WHOLE_BYTES:
        occupied = _reached(occupied, conv)
        return _in_slabs(volume.to(dtype), _kernel(conv, dtype), bias, occupied), occupied
    if block.training and not submanifold and conv.kernel == (volume.shape[2], 1, 1):
        out = _collapsed(volume.to(dtype), conv.weight.to(dtype), bias)
    else:
        out = functional.conv3d(volume.to(dtype), _kernel(conv, dtype), bias, stride, padding)
    occupied = _reached(occupied, conv)
    rows = out.permute(0, 2, 3, 4, 1).reshape(-1, conv.c_out)
    if block.training:
        keys = occupied.flatten().nonzero().squeeze(1)
        active = torch.relu(normalise_rows(block.norm, rows.index_select(0, keys)))
        rows = active.new_zeros(rows.shape).index_copy(0, keys, active)
    else:
        if isinstance(block.norm, nn.BatchNorm1d):
            scale, shift = affine(block.norm)
            rows = torch.addcmul(shift, rows.float(), scale).to(dtype)
        rows = rows.relu_().mul_(occupied.view(-1, 1).to(rows.dtype))
    return rows.view(len(out), *out.shape[2:], conv.c_out).permute(0, 4, 1, 2, 3), occupied


def _collapsed(volume: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
    """A convolution as tall as its map, weights (D, c_in, c_out), as one matrix product.

    oneDNN's own leaves much of the weights' gradient unset in bfloat16 on CPUs with matrix tiles (AMX), torch 2.13.
    """
    columns = volume.permute(0, 3, 4, 2, 1).flatten(3)
    out = functional.linear(columns, weight.flatten(0, 1).T, bias)
    return out.permute(0, 3, 1, 2).unsqueeze(2)


def _in_slabs(volume: Tensor, kernel: Tensor, bias: Tensor | None, occupied: Tensor) -> Tensor:
    """A 3 x 3 x 3 convolution, ReLU and the occupied cells' mask, a few layers of height at a time.

    So what follows the convolution finds its result in the caches.
    """
    batch, _, depth, nx, ny = volume.shape
    mask = occupied.to(volume.dtype)
    out = volume.new_empty(batch, depth, nx, ny, len(kernel)).permute(0, 4, 1, 2, 3)
    layers = max(1, SLAB_BYTES // (out[:, :, 0].numel() * out.element_size()))
    for start in range(0, depth, layers):
        end = min(start + layers, depth)
        below, above = min(start, 1), min(depth - end, 1)
        part = volume[:, :, start - below : end + above]
        if not (below and above):
            part = functional.pad(part, (0, 0, 0, 0, 1 - below, 1 - above))
        slab = functional.conv3d(part, kernel, bias, 1, (0, 1, 1)).relu_()
        torch.mul(slab, mask[:, :, start:end], out=out[:, :, start:end])
    return out
