"""The anchor head that VoxelNet, SECOND, PointPillars and RTNH share: one 1 x 1 convolution, its losses and its boxes.

Every anchor gives one logit for its class, a box code of seven numbers and two direction logits. In the style of
OpenPCDet it gives a logit for each class, whichever its own.
"""

from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np
import torch
from pydantic import Field
from torch import Tensor, nn

from farfield.detectors.anchors.assigning import AnchorAssigner
from farfield.detectors.anchors.best import best_anchors
from farfield.detectors.anchors.device import boxes_there
from farfield.detectors.anchors.grid import AnchorConfig, AnchorGrid, AnchorTargets, cirrus_anchors
from farfield.detectors.contract import AnchorRow, ClassRows, DetectorConfig
from farfield.detectors.features import FeatureMap, in_type_of
from farfield.detectors.losses import box_loss, direction_loss, focal_loss
from farfield.detectors.nms import rotated_nms
from farfield.detectors.processes import normaliser
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
            far_weight=config.far_weight,
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
        said = [f"logit of {name}" for name in self.anchors.names] if self.config.head == "openpcdet" else ["logit"]
        logits = [(*slot, what) for what in said for slot in slots]
        channels = [*logits, *(AnchorRow(*slot, number) for number in range(_BOX_NUMBERS) for slot in slots)]
        return {"weight": (0, channels), "bias": (0, channels)}

    def forward(self, features: FeatureMap, targets: Sequence[AnchorTargets] | None = None) -> AnchorMaps:
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
        every = torch.arange(self.logits, device=ignored.device)
        return positive * self.logits + kind, (ignored[:, None] * self.logits + every).reshape(-1)

    def decode(self, maps: AnchorMaps) -> list[Boxes]:
        """The boxes of each frame after suppression, best first."""
        if maps.logits.is_cuda:
            return boxes_there(maps, self.anchors, self.config)
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
