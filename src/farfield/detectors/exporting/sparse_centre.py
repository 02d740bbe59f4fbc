"""The fully sparse detector as a graph of two halves, which share a file: to votes, and from a grown map to boxes."""

import math
from collections.abc import Mapping
from typing import Any, cast

import torch
from torch import Tensor

from farfield.detectors.exporting.graphs import LEAST, Graph, Outputs, block, with_zero_row, wrapped
from farfield.detectors.sparse import SparseBlock, SparseConv
from farfield.detectors.sparsecentre.network import ResidualBlock, SparseCentre

_LOG_SIZE = (math.log(0.05), math.log(40.0))


class SparseCentreGraph(Graph):
    """See :class:`~farfield.detectors.onnx.sparse_centre.SparseCentreReading`."""

    outputs = ("map_out", "votes", "boxes", "heat")

    def __init__(self, network: SparseCentre) -> None:
        super().__init__()
        self.network = network

    def named(self, inputs: Mapping[str, Tensor]) -> Outputs:
        """Both halves; whose inputs have no rows gives none."""
        flat = self._pyramid(self._columns(inputs), inputs)
        votes = self.network.diffusion.vote(flat)
        return {"map_out": flat, "votes": votes, **self._boxes(inputs)}

    def _columns(self, inputs: Mapping[str, Tensor]) -> Tensor:
        """The encoder, and the cells above one another summed."""
        rows, level = inputs["voxels"], 0
        for layer in self.network.encoder:
            strided = isinstance(layer, SparseBlock) and isinstance(layer.conv, SparseConv)
            level += strided
            table = inputs[f"strided_{level}" if strided else f"around_{level}"]
            rows = (
                residual(rows, layer, table)
                if isinstance(layer, ResidualBlock)
                else block(rows, cast(SparseBlock, layer), table)
            )
        padded = with_zero_row(block(rows, self.network.to_map, inputs["heights"]))
        heights = inputs["heights"]
        total = padded.index_select(0, heights[:, 0])
        for layer_of_z in range(1, heights.shape[1]):
            total = total + padded.index_select(0, heights[:, layer_of_z])
        return total

    def _pyramid(self, rows: Tensor, inputs: Mapping[str, Tensor]) -> Tensor:
        pyramid, levels = self.network.pyramid, []
        for number, level in enumerate(pyramid.levels):
            if number:
                rows = block(rows, cast(SparseBlock, pyramid.down[number - 1]), inputs[f"down_{number}"])
            for layer in cast(Any, level):
                rows = residual(rows, layer, inputs[f"flat_{number}"])
            levels.append(rows)
        rows = levels.pop()
        for number in range(len(levels), 0, -1):
            up, fine = cast(Any, pyramid.up[number - 1]), levels.pop()
            conv = up.conv
            size, c_in, c_out = conv.weight.shape
            products = (rows @ conv.weight.permute(1, 0, 2).reshape(c_in, size * c_out)).reshape(-1, c_out)
            back = products.index_select(0, inputs[f"up_{number}"])
            back = back if conv.bias is None else back + conv.bias
            back = torch.relu(back) if up.relu else back
            rows = residual(fine + back, cast(Any, pyramid.smooth[number - 1]), inputs[f"flat_{number - 1}"])
        return rows

    def _boxes(self, inputs: Mapping[str, Tensor]) -> Outputs:
        network, table = self.network, inputs["around"]
        carried = network.diffusion.carry(
            torch.cat([inputs["map"].index_select(0, inputs["carrier"]), inputs["rest"]], 1)
        )
        carried = carried * inputs["share"][:, None]
        rows = with_zero_row(inputs["map"]).index_select(0, inputs["stayed"])
        rows = rows.scatter_reduce(0, inputs["landed"][:, None].expand(-1, rows.shape[1]), carried, "sum")
        for layer in network.refine:
            rows = residual(rows, cast(ResidualBlock, layer), table)
        head = network.head
        logits = head.heat(block(rows, head.heat_stem, table))
        codes = head.box(block(rows, head.box_stem, table))
        around, peaks = with_zero_row(logits, LEAST), inputs["peak"]
        best = logits
        for step in range(peaks.shape[1]):
            best = torch.maximum(best, around.index_select(0, peaks[:, step]))
        heat = torch.where(logits >= best, torch.sigmoid(logits), 0.0)
        heat = torch.where(torch.isnan(logits), logits, heat)
        size = torch.exp(codes[:, 3:6].clamp(*_LOG_SIZE))
        yaw = torch.atan2(codes[:, 6], codes[:, 7]) / 2
        backwards = torch.sin(yaw) * codes[:, 8] + torch.cos(yaw) * codes[:, 9] < 0
        yaw = wrapped(yaw + math.pi * backwards.to(yaw.dtype))
        centre = inputs["place_m"] + codes[:, :2] * head.cell_m
        height = inputs["height_m"] + codes[:, 2]
        return {"boxes": torch.cat([centre, height[:, None], size, yaw[:, None]], 1), "heat": heat}


def residual(rows: Tensor, layer: ResidualBlock, table: Tensor) -> Tensor:
    """Two submanifold convolutions beside the identity."""
    return block(block(rows, layer.first, table), layer.second, table, added=rows)
