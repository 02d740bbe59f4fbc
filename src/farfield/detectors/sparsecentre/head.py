"""The centre head on a sparse map: a heat value a class and a box at each occupied cell, its losses and its boxes.

CenterPoint (arXiv 2006.11275, section 4) with the changes of VoxelNeXt (arXiv 2303.11301, section 3.2): the occupied
cell nearest to a box's centre is assigned to it, wherever it is, and boxes are read at local maxima over occupied
cells.
"""

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
import torch
from pydantic import Field
from torch import Tensor, nn
from torch.nn import functional

from farfield.detectors.anchors.best import logit
from farfield.detectors.contract import ClassRows, DetectorConfig
from farfield.detectors.device_nms import kept_boxes
from farfield.detectors.features import FeatureMap, in_type_of
from farfield.detectors.nms import rotated_nms
from farfield.detectors.processes import normaliser
from farfield.detectors.sparse import SubmanifoldConv, decode_keys, neighbour_table
from farfield.detectors.sparsecentre.backbone import FLAT, normalised
from farfield.detectors.sparsecentre.targets import (
    BoxesOfClasses,
    BoxTensors,
    CentreTargets,
    assign,
    decode,
    encode,
    heat_loss,
    vote_loss,
)
from farfield.geometry.boxes import Boxes
from farfield.vocabulary.sizes import CIRRUS_SIZES_M

_NUMBERS = 10  # offset 2, height, log size 3, sine and cosine of twice the yaw, sine and cosine of the yaw


class CentreHeadConfig(DetectorConfig):
    """Settings of a detector with a centre head."""

    classes: tuple[str, ...] = Field(tuple(CIRRUS_SIZES_M), min_length=1, description="classes that it tells apart")
    gaussian_m: float = Field(0.7, gt=0, description="standard deviation of the heat around a centre")
    assign_m: float = Field(8.0, gt=0, description="an occupied cell this near to a centre may be assigned to it")
    box_m: float = Field(1.2, ge=0, description="cells this near to a centre learn its box, beside the nearest one")
    box_weight: float = Field(1.0, description="weight of the boxes' loss")
    direction_weight: float = Field(0.2, description="weight of the loss of front or back")
    vote_weight: float = Field(0.5, description="weight of the loss of the votes for centres")
    peak_cells: int = Field(1, ge=1, le=8, description="a peak exceeds all occupied cells within so many steps")
    candidates: int = Field(1000, ge=1, description="best peaks that go into the suppression")

    @property
    def class_names(self) -> tuple[str, ...]:
        """The classes that have a heat map."""
        return self.classes


class CentreMaps(NamedTuple):
    """The head's outputs for the occupied cells of a batch.

    Attributes:
        logits: Heat of each class, shape (n, classes).
        codes: Box, shape (n, 10).
        height_m: Reference height of each cell, shape (n,).
        keys: The cells, shape (n,).
        votes: Foreground logit and step to the centre in cells, before diffusion, shape (m, 3).
        vote_keys: The cells before diffusion, shape (m,).
        frames: Number of frames.
    """

    logits: Tensor
    codes: Tensor
    height_m: Tensor
    keys: Tensor
    votes: Tensor
    vote_keys: Tensor
    frames: int


_LOSSES = ("heat", "box", "foreground", "vote")


class CentreHead(nn.Module):
    """From a sparse map to heat and boxes.

    Args:
        config: Settings of the detector.
        channels: Channels of the map.
        shape: Cells of the map along x and y.
        cell_m: Edge length of a cell.
        y_min_m: Right edge of the map.
    """

    def __init__(
        self, config: CentreHeadConfig, channels: int, *, shape: tuple[int, int], cell_m: float, y_min_m: float
    ) -> None:
        super().__init__()
        self.config, self.shape, self.cell_m, self.y_min_m = config, shape, cell_m, y_min_m
        self.assigner = BoxesOfClasses(
            classes=config.classes, shape=shape, cell_m=cell_m, y_min_m=y_min_m, far_weight=config.far_weight
        )
        self.heat_stem = normalised(SubmanifoldConv(channels, channels, FLAT), channels)
        self.box_stem = normalised(SubmanifoldConv(channels, channels, FLAT), channels)
        self.heat = nn.Linear(channels, len(config.classes))
        self.box = nn.Linear(channels, _NUMBERS)
        with torch.no_grad():
            self.heat.weight.normal_(std=0.01)
            self.heat.bias.fill_(-2.2)  # every cell at a score of 0.1
            self.box.weight.normal_(std=0.01)

    def class_rows(self) -> ClassRows:
        """The class of each heat."""
        return {f"heat.{kind}": (0, self.config.classes) for kind in ("weight", "bias")}

    def forward(self, features: FeatureMap, targets: Sequence[CentreTargets] | None = None) -> CentreMaps:
        """Outputs for the occupied cells; targets are not looked at.

        Args:
            features: Sparse features; ``aux`` holds the sparse tensors ``votes``, of the cells before diffusion, and
                ``height_m``, the reference height of each cell.
            targets: Of each frame.
        """
        del targets
        sparse = features.sparse.replace(in_type_of(self, features.sparse.features))
        votes, height_m = features.aux["votes"], features.aux["height_m"]
        logits, codes = self.heat(self.heat_stem(sparse).features), self.box(self.box_stem(sparse).features)
        height_m = height_m.features.squeeze(1)
        return CentreMaps(logits, codes, height_m, sparse.keys, votes.features, votes.keys, sparse.batch_size)

    def places_m(self, keys: Tensor) -> tuple[Tensor, Tensor]:
        """Frame (n,) and centre x, y (n, 2) of cells."""
        frame, _, ix, iy = decode_keys(keys, (1, *self.shape)).unbind(1)
        return frame, torch.stack([(ix + 0.5) * self.cell_m, (iy + 0.5) * self.cell_m + self.y_min_m], 1)

    def losses(self, maps: CentreMaps, targets: Sequence[CentreTargets]) -> dict[str, Tensor]:
        """Penalty-reduced focal loss on the heat, smooth L1 on boxes and votes, focal loss on the foreground.

        Each is normalised by the weight of the boxes.
        """
        weight = sum(float(target.weight.sum()) for target in targets)
        total = normaliser(torch.tensor(weight, dtype=torch.float32, device=maps.logits.device))
        parts = [self._frame_loss(maps, index, target) for index, target in enumerate(targets)]
        sums = (torch.stack(part).sum() / total for part in zip(*parts, strict=True))
        return dict(zip(_LOSSES, sums, strict=True))

    def _frame_loss(self, maps: CentreMaps, index: int, target: CentreTargets) -> tuple[Tensor, ...]:
        config, truth = self.config, BoxTensors.of(target, maps.logits.device)
        frame, place_m = self.places_m(maps.keys)
        rows = (frame == index).nonzero().squeeze(1)
        assigned = assign(
            place_m[rows],
            truth,
            len(config.classes),
            gaussian_m=config.gaussian_m,
            assign_m=config.assign_m,
            box_m=config.box_m,
        )
        heat = heat_loss(maps.logits[rows], assigned.heat, assigned.heat_weight)
        expected = encode(
            truth, assigned.box, place_m[rows[assigned.cell]], maps.height_m[rows[assigned.cell]], self.cell_m
        )
        error = functional.smooth_l1_loss(
            maps.codes[rows[assigned.cell]].float(), expected, beta=1 / 9, reduction="none"
        )
        error = error[:, :8].sum(1) + config.direction_weight * error[:, 8:].sum(1)
        frame, place_m = self.places_m(maps.vote_keys)
        rows = (frame == index).nonzero().squeeze(1)
        foreground, vote = vote_loss(maps.votes[rows], place_m[rows], truth, self.cell_m)
        return (
            heat,
            config.box_weight * (error * assigned.weight).sum(),
            config.vote_weight * foreground,
            config.vote_weight * vote,
        )

    def decode(self, maps: CentreMaps) -> list[Boxes]:
        """The boxes of each frame after suppression, best first."""
        found = self.found(maps)
        if maps.logits.is_cuda:
            return self.boxes_there(*found, maps.frames)
        rows, score, kind, frame = (part.cpu().numpy() for part in found)
        return [self._frame(rows[frame == i], score[frame == i], kind[frame == i]) for i in range(maps.frames)]

    def found(self, maps: CentreMaps) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """The boxes at all peaks, rows (n, 7) float64, their scores, classes and frames, each of shape (n,)."""
        logits = maps.logits.float()
        high = logits >= logit(self.config.score_threshold)
        passed = peaks(logits, maps.keys, self.shape, self.config.peak_cells) & high
        row, kind = passed.nonzero().unbind(1)
        frame, place_m = self.places_m(maps.keys[row])
        rows = decode(maps.codes[row], place_m, maps.height_m[row], self.cell_m)
        return rows, torch.sigmoid(logits[row, kind].double()), kind, frame

    def boxes_there(self, rows: Tensor, score: Tensor, kind: Tensor, frame: Tensor, frames: int) -> list[Boxes]:
        """The boxes of each frame after suppression on the device that they are on; arguments as :meth:`found` has."""
        boxes = []
        for number in range(frames):
            mine = (frame == number).nonzero().squeeze(1)
            best = mine[torch.sort(score[mine], descending=True, stable=True).indices[: self.config.candidates]]
            boxes.append(
                kept_boxes(
                    rows[best],
                    score[best],
                    kind[best],
                    self.config.classes,
                    iou_threshold=self.config.nms_iou,
                    limit=self.config.max_boxes,
                )
            )
        return boxes

    def _frame(self, rows: np.ndarray, score: np.ndarray, kind: np.ndarray) -> Boxes:
        best = np.argsort(-score, kind="stable")[: self.config.candidates]
        rows, label = rows[best], np.array(self.config.classes, dtype=np.str_)[kind[best]]
        boxes = Boxes(
            centre_m=rows[:, :3], size_m=rows[:, 3:6], yaw_rad=rows[:, 6], label=label.tolist(), score=score[best]
        )
        return boxes[rotated_nms(boxes, iou_threshold=self.config.nms_iou, limit=self.config.max_boxes)]


def peaks(logits: Tensor, keys: Tensor, shape: tuple[int, int], reach: int) -> Tensor:
    """Where no occupied cell within ``reach`` steps is hotter, a class each, shape (n, classes), bool."""
    side = range(-reach, reach + 1)
    around = [(0, dx, dy) for dx, dy in product(side, side) if (dx, dy) != (0, 0)]
    table = neighbour_table(keys, keys, (1, *shape), around).long()
    padded = torch.cat([logits, logits.new_full((1, logits.shape[1]), -torch.inf)])
    if logits.is_cuda:
        return logits >= padded[table].amax(1)
    best = torch.full_like(logits, -torch.inf)  # on a CPU the gathered rows of all steps would leave the cache
    for column in table.unbind(1):
        best = torch.maximum(best, padded[column])
    return logits >= best
