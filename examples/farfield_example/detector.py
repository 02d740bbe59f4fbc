"""A detector of one's own: pillars described by their points' offsets, three convolutions, Farfield's anchor head."""

from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor, nn

from farfield.detectors.anchors.grid import AnchorGrid
from farfield.detectors.anchors.head import AnchorHead, AnchorHeadConfig
from farfield.detectors.config import Channels, GridConfig
from farfield.detectors.features import FeatureMap, in_type_of
from farfield.detectors.inputs import POSITION, CloudInput, stacked
from farfield.detectors.network import MapDetector

STRIDE = 2


class MeanPillarsConfig(AnchorHeadConfig):
    """What an experiment's ``detector`` may set, beside the settings of the anchor head."""

    name: str = "mean-pillars"
    grid: GridConfig = GridConfig(range_m=100.0, half_width_m=40.0, cell_m=0.5)
    width: Channels = 32

    @property
    def reach_m(self) -> float:
        """How far ahead the detector looks, metres."""
        return self.grid.range_m


class MeanPillars(MapDetector):
    """Points to pillars, pillars to a map, the map to anchors; losses and boxes are the head's."""

    low_precision: ClassVar[tuple[str, ...]] = ("trunk", "head")

    def __init__(self, config: MeanPillarsConfig) -> None:
        super().__init__(config)
        self.inputs = {"points": CloudInput(columns=POSITION)}
        self.nx, self.ny = config.grid.shape(STRIDE)
        self.y_min_m, self.cell_m = config.grid.y_min_m(STRIDE), config.grid.cell_m
        self.encoder = nn.Linear(5, config.width)
        strides = (STRIDE, 1, 1)
        layers = [nn.Conv2d(config.width, config.width, 3, s, padding=1, bias=False) for s in strides]
        norms = [nn.BatchNorm2d(config.width) for _ in strides]
        pairs = zip(layers, norms, strict=True)
        self.trunk = nn.Sequential(*(part for layer, norm in pairs for part in (layer, norm, nn.ReLU())))
        nx, ny, cell_m = self.nx // STRIDE, self.ny // STRIDE, self.cell_m * STRIDE
        anchors = AnchorGrid(config.anchors, nx=nx, ny=ny, cell_m=cell_m, y_min_m=self.y_min_m)
        self.head = AnchorHead(config, config.width, anchors)
        self.assigner, self.channels = self.head.assigner, config.width

    def encode(self, batch: Mapping[str, list[Tensor]]) -> FeatureMap:
        """The map of a batch's clouds."""
        image = self.pillars(*stacked(batch["points"]), len(batch["points"]))
        values = self.trunk(in_type_of(self.trunk, image))
        return FeatureMap(values=values, cell_m=self.cell_m * STRIDE, origin_m=(0.0, self.y_min_m))

    def pillars(self, points: Tensor, frame: Tensor, frames: int) -> Tensor:
        """Points (n, 3) of several frames to the largest of their features in each cell, (frames, width, nx, ny)."""
        place = (points[:, :2] - points.new_tensor([0.0, self.y_min_m])) / self.cell_m
        ix, iy = place.floor().long().unbind(1)
        inside = (ix >= 0) & (ix < self.nx) & (iy >= 0) & (iy < self.ny)
        inside &= (points[:, 2] > self.config.grid.z_min_m) & (points[:, 2] < self.config.grid.z_max_m)
        points, place, cell = points[inside], place[inside], ((frame * self.nx + ix) * self.ny + iy)[inside]
        near = torch.stack([points[:, 0] / self.config.grid.range_m, points[:, 2]], 1)
        rows = torch.relu(self.encoder(torch.cat([place % 1, near, torch.ones_like(near[:, :1])], 1)))
        flat = rows.new_zeros(frames * self.nx * self.ny, rows.shape[1])
        flat = flat.scatter_reduce(0, cell[:, None].expand_as(rows), rows, "amax")
        return flat.view(frames, self.nx, self.ny, -1).permute(0, 3, 1, 2)
