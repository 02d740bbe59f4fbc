"""PointRCNN as a graph of its two stages, which share a file; neighbourhoods and proposals are found between them."""

from collections.abc import Mapping
from typing import Any, cast

import torch
from torch import Tensor

from farfield.detectors.exporting.graphs import Graph, Outputs, maximum
from farfield.detectors.pointrcnn.network import PointRCNN
from farfield.detectors.pointrcnn.pointnet import SharedMlp


class PointGraph(Graph):
    """See :class:`~farfield.detectors.onnx.points.PointReading`."""

    outputs = ("semantic_out", "foreground", "proposed", "confidence", "boxes")
    sizes: Tensor

    def __init__(self, network: PointRCNN) -> None:
        super().__init__()
        self.network = network
        self.register_buffer("sizes", torch.tensor(list(network.config.sizes_m.values()), dtype=torch.float32))

    def named(self, inputs: Mapping[str, Tensor]) -> Outputs:
        """Both stages; one whose inputs have no rows gives none."""
        return {**self._first(inputs), **self._second(inputs)}

    def _first(self, inputs: Mapping[str, Tensor]) -> Outputs:
        network, backbone = self.network, self.network.backbone
        xyz, features = [inputs["xyz"]], [inputs["features"]]
        for number, layer in enumerate(backbone.abstractions, 1):
            abstraction = cast(Any, layer)
            chosen = inputs[f"chosen_{number}"]
            centres, pooled = xyz[-1].index_select(0, chosen), []
            for scale, (mlp, radius_m) in enumerate(zip(abstraction.mlps, abstraction.config.radii_m, strict=True)):
                pair = inputs[f"centre_{number}_{scale}"], inputs[f"point_{number}_{scale}"]
                offset = (xyz[-1].index_select(0, pair[1]) - centres.index_select(0, pair[0])) / radius_m
                pooled.append(pooled_group(mlp, *pair, offset, features[-1], chosen.shape[0]))
            xyz.append(centres)
            features.append(torch.cat(pooled, 1))
        carried = features.pop()
        for number, layer in zip(range(len(backbone.propagations), 0, -1), backbone.propagations, strict=True):
            propagation, fine = cast(Any, layer), features.pop()
            rows = propagation.mlp.first(carried, slice(0, propagation.c_coarse))
            near, weight = inputs[f"near_{number}"], inputs[f"weight_{number}"]
            parts = [rows.index_select(0, near[:, which]) * weight[:, which, None] for which in range(3)]
            rows = parts[0] + parts[1] + parts[2]
            if fine.shape[1]:
                rows = rows + propagation.mlp.first(fine, slice(propagation.c_coarse, None))
            carried = propagation.mlp.after_first(rows, bias=True)
        logits, codes = network.segmentation(carried), network.generation(carried)
        size = self.sizes.index_select(0, logits.argmax(1))
        reference = torch.cat([inputs["xyz"], size, torch.zeros_like(size[:, :1])], 1)
        proposed = network.coder.decode(codes, reference)
        return {"semantic_out": carried, "foreground": torch.sigmoid(logits), "proposed": proposed}

    def _second(self, inputs: Mapping[str, Tensor]) -> Outputs:
        stage, proposals = self.network.refinement, inputs["proposals"]
        local = inputs["local"]
        rows = stage.local(torch.cat([local, inputs["extra"]], 1))
        rows = stage.merge(torch.cat([inputs["semantic"].index_select(0, inputs["inside"]), rows], 1))
        for number, layer in enumerate(stage.levels, 1):
            level = cast(Any, layer)
            chosen = inputs[f"roi_chosen_{number}"]
            centres, pooled = local.index_select(0, chosen), []
            for scale, (mlp, radius_m) in enumerate(zip(level.mlps, level.config.radii_m, strict=True)):
                pair = inputs[f"roi_centre_{number}_{scale}"], inputs[f"roi_point_{number}_{scale}"]
                offset = (local.index_select(0, pair[1]) - centres.index_select(0, pair[0])) / radius_m
                pooled.append(pooled_group(mlp, *pair, offset, rows, chosen.shape[0]))
            local, rows = centres, torch.cat(pooled, 1)
        summed = stage.pool.first(local, slice(0, 3)) + stage.pool.first(rows, slice(3, None))
        pooled_rows = maximum(stage.pool.after_first(summed, bias=True), inputs["owner"], proposals.shape[0])
        codes = stage.box(pooled_rows)
        size = self.sizes.index_select(0, inputs["kinds"])
        boxes = self.network.refiner.decode(codes, torch.cat([proposals[:, :3], size, proposals[:, 6:]], 1))
        return {"confidence": torch.sigmoid(stage.confidence(pooled_rows)), "boxes": boxes}


def pooled_group(
    mlp: SharedMlp, centre: Tensor, point: Tensor, offset: Tensor, features: Tensor, centres: int | torch.SymInt
) -> Tensor:
    """Perceptron on each pair and the maximum over each centre; zero for one without any."""
    rows = mlp.first(offset, slice(0, 3))
    if features.shape[1]:
        rows = rows + mlp.first(features, slice(3, None)).index_select(0, point)
    return maximum(mlp.after_first(rows, bias=True), centre, centres)
