"""The anchor head that VoxelNet, SECOND, PointPillars and RTNH share: one 1 x 1 convolution, its losses and its boxes.

Every anchor gives one logit for its class, a box code of seven numbers and two direction logits. In the style of
OpenPCDet it gives a logit for each class, whichever its own.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple, cast

import numpy as np
import torch
from pydantic import Field
from torch import Tensor, nn

from farfield.detectors.anchors.grid import (
    DIRECTION_OFFSET_RAD,
    SIZE_RATIOS,
    AnchorAssigner,
    AnchorConfig,
    AnchorGrid,
    AnchorTargets,
    cirrus_anchors,
)
from farfield.detectors.config import BoxWeights, DetectorConfig
from farfield.detectors.devices import constant, kernels_for
from farfield.detectors.features import FeatureMap, in_type_of
from farfield.detectors.losses import box_loss, direction_loss, focal_loss, normaliser
from farfield.detectors.network import AnchorRow, ClassRows
from farfield.detectors.nms import boxes_after_nms, rotated_nms, wrap_angle
from farfield.geometry.boxes import Boxes

_BOX_NUMBERS = 9  # seven of the box, two of the direction


class AnchorHeadConfig(DetectorConfig):
    """Settings of a detector with anchors."""

    anchors: dict[str, AnchorConfig] = Field(
        default_factory=cirrus_anchors, min_length=1, description="size, height and matching of each class"
    )
    head: Literal["farfield", "openpcdet"] = Field("farfield", description="openpcdet: as its checkpoints expect it")
    matching: Literal["distance", "iou"] = Field("distance", description="iou: by overlap, as published")
    positive_m: float = Field(1.0, description="anchor cells this near to a box's centre are positive")
    ignore_m: float = Field(2.0, description="anchor cells this near are never negative")
    box_weight: float = Field(2.0, description="weight of the boxes' loss")
    direction_weight: float = Field(0.2, description="weight of the loss of front or back")
    candidates: int = Field(1000, ge=1, description="best anchors that go into the suppression")

    @property
    def class_names(self) -> tuple[str, ...]:
        """The classes that have an anchor."""
        return tuple(self.anchors)

    @property
    def anchor_sizes_m(self) -> Mapping[str, tuple[float, float, float]]:
        """Length, width and height of each class' anchor, metres."""
        return {name: anchor.size_m for name, anchor in self.anchors.items()}


class AnchorMaps(NamedTuple):
    """The head's outputs for each anchor: logit (b, a), box code (b, a, 7), direction logits (b, a, 2).

    In the style of OpenPCDet there is a logit for each of k classes, shape (b, a, k).
    """

    logits: Tensor
    codes: Tensor
    directions: Tensor


class AnchorHead(nn.Conv2d):
    """From a dense feature map (b, c, nx, ny) to anchors, their losses and their boxes.

    Args:
        config: Settings of the detector.
        c_in: Channels of the map.
        grid: The anchors, one set at each cell of the map.
    """

    def __init__(self, config: AnchorHeadConfig, c_in: int, grid: AnchorGrid) -> None:
        self.logits = len(grid.names) if config.head == "openpcdet" else 1
        super().__init__(c_in, grid.per_cell * (self.logits + _BOX_NUMBERS), 1)
        self.config, self.anchors = config, grid.styled(config.head)
        self.assigner = AnchorAssigner(
            grid=self.anchors,
            matching=config.matching,
            positive_m=config.positive_m,
            ignore_m=config.ignore_m,
            weights=BoxWeights.of(config),
        )
        self._start_unsure()

    def _start_unsure(self) -> None:
        """Begin with every anchor at a score of 0.01, so that the many negatives do not drown the first steps."""
        if self.weight.is_meta:  # nothing to set; normal_ there would import torch._dynamo, which takes seconds
            return
        bias = torch.zeros(self.logits + _BOX_NUMBERS, self.anchors.per_cell)
        bias[: self.logits] = -float(np.log((1 - 0.01) / 0.01))
        with torch.no_grad():
            self.weight.normal_(std=0.01)
            if self.bias is not None:
                self.bias.copy_(bias.reshape(-1))

    def class_rows(self) -> ClassRows:
        """What each output channel is: of an anchor a logit, or one of the numbers of its box and direction."""
        headings = range(self.anchors.per_cell // len(self.anchors.names))
        slots = [(name, heading) for name in self.anchors.names for heading in headings]
        logit_names = (
            [f"logit of {name}" for name in self.anchors.names] if self.config.head == "openpcdet" else ["logit"]
        )
        logits = [(*slot, what) for what in logit_names for slot in slots]
        channels = [*logits, *(AnchorRow(*slot, number) for number in range(_BOX_NUMBERS) for slot in slots)]
        return {"weight": (0, channels), "bias": (0, channels)}

    def forward(  # type: ignore[override]  # a convolution for the names of its weights alone
        self, features: FeatureMap, targets: Sequence[AnchorTargets] | None = None
    ) -> AnchorMaps:
        """Outputs for each anchor, in the order of the anchor grid; targets are not looked at."""
        del targets
        image = in_type_of(self, features.dense)
        maps = super().forward(image).permute(0, 2, 3, 1)  # the anchors' order is channels last
        maps = maps.reshape(len(image), -1, self.logits + _BOX_NUMBERS, self.anchors.per_cell)
        logits, codes, directions = (
            part.transpose(2, 3).reshape(len(image), -1, part.shape[2])
            for part in maps.split((self.logits, 7, 2), dim=2)
        )
        return AnchorMaps(logits if self.config.head == "openpcdet" else logits.squeeze(2), codes, directions)

    def losses(self, maps: AnchorMaps, targets: Sequence[AnchorTargets]) -> dict[str, Tensor]:
        """Focal, smooth-L1 and direction losses over a batch (PointPillars, equations 1 to 3).

        Each is normalised by the weight of the positive anchors.
        """
        device, config = maps.logits.device, self.config
        anchors = len(self.anchors)
        positive = _joined([target.positive + i * anchors for i, target in enumerate(targets)], device)
        ignored = _joined([target.ignored + i * anchors for i, target in enumerate(targets)], device)
        weight = _joined([target.weight for target in targets], device).float()
        total = normaliser(weight.sum())
        code, direction = maps.codes.reshape(-1, 7)[positive].float(), maps.directions.reshape(-1, 2)[positive].float()
        target_code = _joined([target.code for target in targets], device).float()
        backwards = _joined([target.backwards for target in targets], device)
        return {
            "classification": focal_loss(maps.logits, *self._classes(positive, ignored), weight=weight) / total,
            "box": config.box_weight * box_loss(code, target_code, weight=weight) / total,
            "direction": config.direction_weight * direction_loss(direction, backwards, weight=weight) / total,
        }

    def _classes(self, positive: Tensor, ignored: Tensor) -> tuple[Tensor, Tensor]:
        """Flat indices of anchors to those of logits: the logit of its class at a positive, all at an ignored one."""
        if self.config.head == "farfield":
            return positive, ignored
        kind = positive % self.anchors.per_cell // 2
        class_index = torch.arange(self.logits, device=ignored.device)
        return positive * self.logits + kind, (ignored[:, None] * self.logits + class_index).reshape(-1)

    def decode(self, maps: AnchorMaps) -> list[Boxes]:
        """The boxes of each frame after suppression, best first."""
        if maps.logits.is_cuda:
            return boxes_on_device(maps, self.anchors, self.config)
        return [self._frame(*frame) for frame in zip(*maps, strict=True)]

    def _frame(self, logits: Tensor, codes: Tensor, directions: Tensor) -> Boxes:
        config = self.config
        index, score = best_anchors(logits, limit=config.candidates, score_threshold=config.score_threshold)
        anchor = index.cpu().numpy()
        direction = (directions[index, 1] > directions[index, 0]).long().cpu().numpy()
        rows = self.anchors.decode(codes[index].double().cpu().numpy(), direction, anchor)
        names = np.array(self.anchors.names, dtype=np.str_)
        boxes = Boxes(
            centre_m=rows[:, :3],
            size_m=rows[:, 3:6],
            yaw_rad=rows[:, 6],
            label=self.anchors.labels(anchor) if logits.ndim == 1 else names[logits[index].argmax(1).cpu().numpy()],
            score=score.cpu().numpy(),
        )
        return boxes[rotated_nms(boxes, iou_threshold=config.nms_iou, limit=config.max_boxes)]


def _joined(parts: Sequence[np.ndarray], device: torch.device) -> Tensor:
    return torch.from_numpy(np.concatenate(parts)).to(device)


# Boxes of anchors on the device that the maps are on: what :mod:`farfield.detectors.anchors.grid` does, in PyTorch.

_NEARLY_ONE = 1 - 1e-9  # an encoded residual of exactly pi/2 is not wrapped


def anchor_rows(grid: AnchorGrid, index: Tensor) -> Tensor:
    """The anchors with these flat indices, shape (k,), as x, y, z, l, w, h, yaw, shape (k, 7), float64."""
    cell, slot = index // grid.per_cell, index % grid.per_cell
    kind, heading = slot // 2, slot % 2
    ix, iy = cell // grid.ny, cell % grid.ny
    constants = [
        i.double() * float(step) + float(first)
        for i, step, first in zip((ix, iy), grid.step_m, grid.first_m, strict=True)
    ]
    kinds = [(float(z), *map(float, size)) for z, size in zip(grid.z_m, grid.sizes_m, strict=True)]
    headings = constant(tuple(map(float, grid.headings_rad)), index.device)
    return torch.cat(
        [torch.stack(constants, 1), constant(tuple(kinds), index.device)[kind], headings[heading, None]], 1
    )


def decode(code: Tensor, backwards: Tensor, anchors: Tensor) -> Tensor:
    """Boxes of codes, as :func:`farfield.detectors.anchors.grid.decode`: rows x, y, z, l, w, h, yaw, shape (k, 7)."""
    diagonal = torch.hypot(anchors[:, 3], anchors[:, 4])
    centre = code[:, :3] * torch.stack([diagonal, diagonal, anchors[:, 5]], 1) + anchors[:, :3]
    least, most = map(math.log, SIZE_RATIOS)
    size = torch.exp(code[:, 3:6].clamp(least, most)) * anchors[:, 3:6]
    half_turns = torch.round(code[:, 6] / math.pi * _NEARLY_ONE)
    yaw = wrap_angle(anchors[:, 6] + (code[:, 6] - math.pi * half_turns) + math.pi * backwards.double())
    return torch.cat([centre, size, yaw[:, None]], 1)


def decoded(grid: AnchorGrid, codes: Tensor, directions: Tensor, index: Tensor) -> Tensor:
    """Boxes of the anchors with these numbers, as :meth:`AnchorGrid.decode`.

    Args:
        grid: The anchors.
        codes: Codes of all of them, shape (n, 7).
        directions: Both directions' logits of all of them, shape (n, 2).
        index: Which to decode, shape (k,), int64.

    Returns:
        Rows x, y, z, l, w, h, yaw, shape (k, 7), float64.
    """
    kernels = kernels_for(codes.device, "anchors.triton_decode")
    if kernels is not None:
        return cast(Tensor, kernels.decoded(codes, directions, index, **constants(grid, codes.device)))
    code, direction = codes[index].double(), (directions[index, 1] > directions[index, 0]).long()
    anchors = anchor_rows(grid, index)
    if grid.style == "farfield":
        return decode(code, direction, anchors)
    rows = decode(code, torch.zeros_like(direction), anchors)
    fixed = torch.remainder(rows[:, 6] - DIRECTION_OFFSET_RAD, 2 * math.pi) >= math.pi
    turned = wrap_angle(rows[:, 6] + math.pi * (fixed.long() != direction).double())
    return torch.cat([rows[:, :6], turned[:, None]], 1)


def constants(grid: AnchorGrid, device: torch.device) -> dict[str, Any]:
    """The anchors' numbers as the kernel takes them."""
    kinds = [(float(z), *map(float, size)) for z, size in zip(grid.z_m, grid.sizes_m, strict=True)]
    place_m = (*map(float, grid.step_m), *map(float, grid.first_m))
    return {
        "grid": constant((*place_m, math.pi, *map(math.log, SIZE_RATIOS), DIRECTION_OFFSET_RAD, _NEARLY_ONE), device),
        "kinds": constant(tuple(kinds), device),
        "headings": constant(tuple(map(float, grid.headings_rad)), device),
        "per_cell": grid.per_cell,
        "ny": grid.ny,
        "fixed": grid.style != "farfield",
    }


def boxes_on_device(maps: Sequence[Tensor], grid: AnchorGrid, config: Any) -> list[Boxes]:
    """The boxes of each frame after suppression, best first, without a copy of anything else to the host.

    Args:
        maps: Logits, codes and directions of :class:`~farfield.detectors.anchors.head.AnchorMaps`.
        grid: The anchors.
        config: The head's settings.
    """
    return [_frame(one, grid, config) for one in zip(*maps, strict=True)]


def _frame(maps: tuple[Tensor, ...], grid: AnchorGrid, config: Any) -> Boxes:
    logits, codes, directions = maps
    index, score = best_anchors(logits, limit=config.candidates, score_threshold=config.score_threshold)
    number = index % grid.per_cell // 2 if logits.ndim == 1 else logits[index].argmax(1)
    rows = decoded(grid, codes, directions, index)
    return boxes_after_nms(rows, score, number, grid.names, iou_threshold=config.nms_iou, limit=config.max_boxes)


# Which anchors are decoded: the same ones on every device, in the same order, however many scores are equal.

_MANY = 8  # times the limit: from there on the least score that can be among the best is found first


def logit(score: float) -> float:
    """The logit of a score; infinite for 0 and 1."""
    if not 0 < score < 1:
        return -math.inf if score <= 0 else math.inf
    return math.log(score / (1 - score))


def best_anchors(logits: Tensor, *, limit: int, score_threshold: float) -> tuple[Tensor, Tensor]:
    """The anchors of the highest scores, best first, of equal ones the first.

    Args:
        logits: Logit of each anchor, shape (n,), or of each of its classes, of which the highest counts, (n, classes).
        limit: So many at most.
        score_threshold: Of a lower score none.

    Returns:
        Their numbers, shape (k,), int64, and their scores, shape (k,), float64.
    """
    strength, least = logits.float() if logits.ndim == 1 else logits.float().amax(1), logit(score_threshold)
    index = (strength >= least).nonzero().squeeze(1)
    if len(index) > _MANY * limit:
        index = (strength >= torch.topk(strength, limit).values[-1]).nonzero().squeeze(1)
    order = torch.sort(strength[index], descending=True, stable=True).indices[:limit]
    index = index[order]
    return index, torch.sigmoid(strength[index].double())
