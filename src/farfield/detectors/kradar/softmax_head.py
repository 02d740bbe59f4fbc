"""The head of RTN and RTNH (K-Radar, NeurIPS 2022, appendix E.1, figure 20).

Two 1 x 1 convolutions: the class of each cell, which is one of its anchors or the background (softmax), and eight
numbers an anchor: the differences of x, y, z, length, width, height, cos(yaw) and sin(yaw) from the anchor's.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn import functional

from farfield.detectors.anchors.grid import AnchorGrid
from farfield.detectors.config import ALIKE, BoxWeights
from farfield.detectors.features import FeatureMap, in_type_of
from farfield.detectors.losses import at_least_single, normaliser
from farfield.detectors.network import AnchorRow, ClassRows
from farfield.detectors.nms import rotated_nms
from farfield.geometry.boxes import Boxes
from farfield.geometry.iou import paired_iou

_NUMBERS = 8
_SMALLEST_M = 0.1
_GAMMA = 2.0
_IGNORED = -1


class SoftmaxMaps(NamedTuple):
    """The head's outputs: class logits (b, cells, 1 + anchors), background first, and codes (b, cells, anchors, 8)."""

    logits: Tensor
    codes: Tensor


@dataclass(frozen=True, eq=False)
class BoxTargets:
    """A frame's boxes; cells are assigned to them beside the loss, where the predictions are known.

    Args:
        rows: x, y, z, l, w, h, yaw, shape (n, 7).
        kind: Number of each box's class, shape (n,).
        weight: Weight of each box in the loss, shape (n,).
    """

    rows: Float[np.ndarray, "n 7"]
    kind: Int[np.ndarray, " n"]
    weight: Float[np.ndarray, " n"]

    def ignoring(self, unsure: "BoxTargets") -> "BoxTargets":
        """These targets and those of unsure boxes with no weight: cells near them are neither object nor background.

        Args:
            unsure: The targets of the unsure boxes.
        """
        weight = np.concatenate([self.weight, np.zeros_like(unsure.weight)])
        rows, kind = np.concatenate([self.rows, unsure.rows]), np.concatenate([self.kind, unsure.kind])
        return BoxTargets(rows, kind, weight)


@dataclass(frozen=True, eq=False, kw_only=True)
class BoxesOnGrid:
    """The boxes of a frame that have an anchor and stand on the grid: the targets of a softmax head.

    Args:
        grid: The anchors.
        weights: Weight of a box in the loss.
    """

    grid: AnchorGrid
    weights: BoxWeights = ALIKE

    def __call__(self, boxes: Boxes, inputs: Mapping[str, np.ndarray]) -> BoxTargets:
        """Targets of one frame."""
        grid = self.grid
        kind = grid.kinds(boxes)
        column, row = np.floor((boxes.centre_m[:, :2] - grid.first_m) / grid.step_m + 0.5).T
        in_grid = (kind >= 0) & (column >= 0) & (column < grid.nx) & (row >= 0) & (row < grid.ny)
        rows = np.column_stack([boxes.centre_m, boxes.size_m, boxes.yaw_rad])
        return BoxTargets(rows[in_grid], kind[in_grid], self.weights(boxes[in_grid], inputs))


class ProposalMatches(NamedTuple):
    """Positive proposals of a frame as flat indices cell * anchors + anchor, the box of each, and ignored cells.

    ``best`` are the rows, one a cell, that a cell's class is taken from.
    """

    proposal: Int[np.ndarray, " p"]
    box: Int[np.ndarray, " p"]
    best: Int[np.ndarray, " q"]
    ignored: Int[np.ndarray, " i"]


def match_proposals(proposals: Float[np.ndarray, "m 7"], targets: BoxTargets, grid: AnchorGrid) -> ProposalMatches:
    """Assign proposals to a frame's boxes, by their rotated overlap in bird's-eye view.

    A proposal of the box's class is positive from its ``positive_iou`` on, and so is the one that overlaps the box most
    (the nearest one where none does). A cell none of whose proposals reaches ``negative_iou`` is background; the
    others are ignored. The released code lets each box of a frame overwrite the cells of the boxes before it; here
    all count.

    Args:
        proposals: Predicted boxes, or the anchors, in the anchors' order, sizes above 0.
        targets: The frame's boxes.
        grid: The anchors.
    """
    slots = np.arange(len(proposals)) % grid.per_cell // 2
    box, proposal, forced = _near(proposals, slots, targets)
    iou = paired_iou(_boxes(targets.rows[box]), _boxes(proposals[proposal]), kind="bev")
    limits = np.array([[anchor.positive_iou, anchor.negative_iou] for anchor in grid.classes.values()])
    positive_iou, negative_iou = limits[targets.kind[box]].T
    most = np.zeros(len(targets.rows))
    np.maximum.at(most, box, iou)
    positive = (iou > positive_iou) | (iou == most[box]) & (most[box] > 0) | forced & (most[box] == 0)
    order = np.lexsort((-iou, proposal))
    order = order[positive[order]]
    chosen, first = np.unique(proposal[order], return_index=True)
    owner, overlap = box[order][first], iou[order][first]
    by_cell = np.lexsort((-overlap, chosen // grid.per_cell))
    cells, first = np.unique(chosen[by_cell] // grid.per_cell, return_index=True)
    ignored = np.setdiff1d(proposal[iou >= negative_iou] // grid.per_cell, cells)
    return ProposalMatches(chosen, owner, by_cell[first], ignored)


def _near(proposals: np.ndarray, slots: np.ndarray, targets: BoxTargets) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of boxes and proposals of their class that may overlap, and whether it is the box's nearest proposal."""
    radius_cells = np.hypot(proposals[:, 3], proposals[:, 4]) / 2
    by_kind = {kind: np.flatnonzero(slots == kind) for kind in np.unique(targets.kind)}
    x, y = np.ascontiguousarray(proposals[:, :2].T)
    parts = []
    for number, row in enumerate(targets.rows):
        own = by_kind[targets.kind[number]]
        square = (x[own] - row[0]) ** 2 + (y[own] - row[1]) ** 2
        close = square < (radius_cells[own] + np.hypot(row[3], row[4]) / 2) ** 2
        nearest = np.arange(len(own)) == square.argmin()
        rows = np.flatnonzero(close | nearest)
        parts.append((np.full(len(rows), number), own[rows], nearest[rows]))
    if not parts:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.bool_)
    box, proposal, forced = (np.concatenate(part) for part in zip(*parts, strict=True))
    return box, proposal, forced


def _boxes(rows: np.ndarray) -> Boxes:
    return Boxes(centre_m=rows[:, :3], size_m=rows[:, 3:6], yaw_rad=rows[:, 6], label="")


class SoftmaxHead(nn.Module):
    """From a dense feature map to anchors' classes and boxes, their losses and their boxes.

    Args:
        config: Settings of the detector: an AnchorHeadConfig.
        c_in: Channels of the map.
        grid: The anchors, one set at each cell of the map.
        proposals: What must overlap a box to be assigned to it: the predicted boxes, as published, or the anchors.
    """

    def __init__(self, config: Any, c_in: int, grid: AnchorGrid, *, proposals: Literal["predicted", "anchors"]) -> None:
        super().__init__()
        self.config, self.anchors, self.proposals = config, grid, proposals
        self.assigner = BoxesOnGrid(grid=grid, weights=BoxWeights.of(config))
        self.classes = nn.Conv2d(c_in, 1 + grid.per_cell, 1)
        self.boxes_of_anchors = nn.Conv2d(c_in, _NUMBERS * grid.per_cell, 1)
        if not self.classes.weight.is_meta:
            nn.init.normal_(self.boxes_of_anchors.weight, std=0.01)
            for layer in (self.classes, self.boxes_of_anchors):
                if layer.bias is not None:
                    nn.init.zeros_(layer.bias)

    def class_rows(self) -> ClassRows:
        """What each output channel is: the background or an anchor, and of an anchor one of the numbers of its box."""
        headings = range(self.anchors.per_cell // len(self.anchors.names))
        slots = [(name, heading) for name in self.anchors.names for heading in headings]
        logits, codes = ["background", *slots], [AnchorRow(*slot, n) for slot in slots for n in range(_NUMBERS)]
        parts: dict[str, Sequence[Any]] = {"classes": logits, "boxes_of_anchors": codes}
        return {f"{part}.{kind}": (0, rows) for part, rows in parts.items() for kind in ("weight", "bias")}

    def forward(self, features: FeatureMap, targets: Sequence[BoxTargets] | None = None) -> SoftmaxMaps:
        """Outputs for each cell, in the order of the anchor grid; targets are not looked at."""
        del targets
        image = in_type_of(self, features.dense)
        logits = self.classes(image).permute(0, 2, 3, 1).flatten(1, 2)
        codes = self.boxes_of_anchors(image).permute(0, 2, 3, 1)
        return SoftmaxMaps(logits, codes.reshape(len(image), logits.shape[1], self.anchors.per_cell, _NUMBERS))

    def losses(self, maps: SoftmaxMaps, targets: Sequence[BoxTargets]) -> dict[str, Tensor]:
        """Focal loss over cells, every class with the same weight, and smooth L1 over the boxes of positive proposals.

        As in the released code each class (background, each anchor) counts by the mean over its own cells.
        """
        logits, codes = at_least_single(maps.logits), at_least_single(maps.codes)
        labels = torch.zeros(logits.shape[:2], dtype=torch.long)
        weights = torch.ones(logits.shape[:2])
        predicted, expected, weight = [], [], []
        fixed = self._rows(None) if self.proposals == "anchors" else None
        for frame, target in enumerate(targets):
            rows = self._rows(codes[frame]) if fixed is None else fixed
            assignments = match_proposals(rows, target, self.anchors)
            cell, slot = np.divmod(assignments.proposal, self.anchors.per_cell)
            box_weight = torch.from_numpy(target.weight[assignments.box]).float()
            best = torch.from_numpy(assignments.best)
            labels[frame, torch.from_numpy(assignments.ignored)] = _IGNORED
            labels[frame, torch.from_numpy(cell)[best]] = 1 + torch.from_numpy(slot)[best]
            weights[frame, torch.from_numpy(cell)[best]] = box_weight[best]
            predicted.append(codes[frame].flatten(0, 1)[torch.from_numpy(assignments.proposal).to(codes.device)])
            expected.append(self._code(target.rows[assignments.box], assignments.proposal))
            weight.append(box_weight)
        device = codes.device
        expected_codes, box_weights = torch.cat(expected).to(device), torch.cat(weight).to(device)
        error = functional.smooth_l1_loss(torch.cat(predicted), expected_codes, reduction="none").mean(1)
        box = (error * box_weights).sum() / normaliser(box_weights.sum())
        classification = _balanced_focal(logits, labels.to(device), weights.to(device))
        return {"classification": classification, "box": self.config.box_weight * box}

    def decode(self, maps: SoftmaxMaps) -> list[Boxes]:
        """The boxes of each frame after suppression, best first."""
        return [self._frame(*frame) for frame in zip(*maps, strict=True)]

    def _frame(self, logits: Tensor, codes: Tensor) -> Boxes:
        probability = torch.softmax(logits.float(), 1)
        best, label = probability.max(1)
        cells = ((label > 0) & (best >= self.config.score_threshold)).nonzero().squeeze(1)
        score, order = torch.topk(best[cells], min(self.config.candidates, len(cells)))
        cells = cells[order]
        slot = label[cells] - 1
        index = (cells * self.anchors.per_cell + slot).cpu().numpy()
        rows = self._decoded(codes[cells, slot].double().cpu().numpy(), index)
        boxes = _boxes(rows).replace(label=self.anchors.labels(index), score=score.double().cpu().numpy())
        return boxes[rotated_nms(boxes, iou_threshold=self.config.nms_iou, limit=self.config.max_boxes)]

    def _rows(self, codes: Tensor | None) -> np.ndarray:
        """Proposals of a frame, all anchors in their order: predicted boxes, or without codes the anchors."""
        index = np.arange(len(self.anchors))
        if codes is None:
            return self.anchors.rows(index)
        return self._decoded(codes.detach().flatten(0, 1).double().cpu().numpy(), index)

    def _decoded(self, code: np.ndarray, index: np.ndarray) -> np.ndarray:
        numbers = _with_direction(self.anchors.rows(index)) + code
        size_m = np.maximum(numbers[:, 3:6], _SMALLEST_M)
        return np.column_stack([numbers[:, :3], size_m, np.arctan2(numbers[:, 7], numbers[:, 6])])

    def _code(self, rows: np.ndarray, index: np.ndarray) -> Tensor:
        return torch.from_numpy(_with_direction(rows) - _with_direction(self.anchors.rows(index))).float()


def _with_direction(rows: np.ndarray) -> np.ndarray:
    """x, y, z, l, w, h, yaw to x, y, z, l, w, h, cos(yaw), sin(yaw)."""
    return np.column_stack([rows[:, :6], np.cos(rows[:, 6]), np.sin(rows[:, 6])])


def _balanced_focal(logits: Tensor, labels: Tensor, weights: Tensor) -> Tensor:
    """Focal loss of softmax, the mean over the classes that occur of each one's weighted mean.

    With several processes the means, and which classes occur, are those of the whole batch.
    """
    counted = labels != _IGNORED
    label, weight = labels[counted], weights[counted]
    log_probability = functional.log_softmax(logits[counted], 1).gather(1, label[:, None]).squeeze(1)
    loss = (1 - log_probability.exp()) ** _GAMMA * -log_probability
    sums = loss.new_zeros(2, logits.shape[2]).index_add(1, label, torch.stack([loss * weight, weight]))
    total = normaliser(sums[1], least=0.0)
    present = total > 0
    return (sums[0][present] / total[present]).mean()
