"""PointPillars (Lang et al., CVPR 2019, arXiv 1812.05784) at long range.

Points -> pillars -> bird's-eye image -> three blocks of convolutions -> one anchor head -> rotated NMS. Differences
from the paper, each for long range: every point counts (no limit of points or pillars), anchors answer for a box by the
distance of its centre (boxes of visible parts overlap no anchor), and intensity is left out by default.
"""

from collections.abc import Sequence
from typing import Annotated, Literal, NamedTuple

import numpy as np
import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor, nn

from farfield.detectors.blocks.anchors import AnchorConfig, AnchorGrid, Targets, decode
from farfield.detectors.blocks.bev import BevBackbone
from farfield.detectors.blocks.grid import GridConfig
from farfield.detectors.blocks.losses import box_loss, direction_loss, focal_loss
from farfield.detectors.blocks.nms import rotated_nms
from farfield.detectors.blocks.pillars import PillarEncoder
from farfield.geometry.boxes import Boxes

Count = Annotated[int, Field(ge=1, le=4096)]


def cirrus_anchors() -> dict[str, AnchorConfig]:
    """Anchors for the eight classes of Cirrus, sensor on the roof (ground near z = -2 m)."""
    sizes = {
        "vehicle": (4.6, 1.95, 1.7),
        "large_vehicle": (9.0, 2.7, 3.2),
        "pedestrian": (0.75, 0.7, 1.75),
        "bicycle": (1.75, 0.65, 1.6),
        "animal": (0.8, 0.4, 0.6),
        "wheeled_pedestrian": (1.0, 0.7, 1.4),
        "motorcycle": (2.2, 0.9, 1.5),
        "trailer": (11.0, 2.8, 3.6),
    }
    return {name: AnchorConfig(size_m=size, z_m=size[2] / 2 - 2.0) for name, size in sizes.items()}


class PointPillarsConfig(BaseModel):
    """Everything that decides the shape of the network and of its answers."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Literal["pointpillars"] = "pointpillars"
    grid: GridConfig = GridConfig()
    anchors: dict[str, AnchorConfig] = Field(default_factory=cirrus_anchors, min_length=1)
    pillar_channels: Count = 32
    use_intensity: bool = False
    widths: tuple[Count, ...] = (32, 64, 128)
    depths: tuple[Annotated[int, Field(ge=0, le=64)], ...] = (1, 4, 4)
    strides: tuple[Annotated[int, Field(ge=1, le=16)], ...] = (2, 2, 2)
    out_stride: int = Field(4, ge=1, description="stride of the anchors' grid, in pillars")
    neck_width: Count = 96
    positive_m: float = Field(1.0, description="anchor cells this near to a box's centre answer for it")
    ignore_m: float = Field(2.0, description="anchor cells this near are not blamed")
    box_weight: float = 2.0
    direction_weight: float = 0.2
    score_threshold: float = 0.05
    nms_iou: float = 0.1
    candidates: int = Field(1000, description="best anchors that go into the suppression")
    max_boxes: int = 500


class Losses(NamedTuple):
    """The parts of the training loss, each normalised by the number of positive anchors."""

    classification: Tensor
    box: Tensor
    direction: Tensor


class PointPillars(nn.Module):
    """The network. ``forward`` gives raw maps; ``loss`` and ``predict`` give them a meaning."""

    def __init__(self, config: PointPillarsConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or PointPillarsConfig()
        multiple = int(np.prod(config.strides))
        self.encoder = PillarEncoder(
            config.grid, multiple=multiple, channels=config.pillar_channels, use_intensity=config.use_intensity
        )
        self.backbone = BevBackbone(
            config.pillar_channels,
            widths=config.widths,
            depths=config.depths,
            strides=config.strides,
            out_stride=config.out_stride,
            neck_width=config.neck_width,
        )
        self.anchors = AnchorGrid(
            config.anchors,
            nx=self.encoder.nx // config.out_stride,
            ny=self.encoder.ny // config.out_stride,
            cell_m=config.grid.cell_m * config.out_stride,
            y_min_m=self.encoder.y_min_m,
        )
        self.head = nn.Conv2d(self.backbone.channels, self.anchors.per_cell * 10, 1)
        self._start_unsure()

    def _start_unsure(self) -> None:
        """Begin with every anchor at a score of 0.01, so that the many negatives do not drown the first steps."""
        bias = torch.zeros(10, self.anchors.per_cell)
        bias[0] = -float(np.log((1 - 0.01) / 0.01))
        with torch.no_grad():
            self.head.weight.normal_(std=0.01)
            self.head.bias.copy_(bias.reshape(-1))

    def forward(self, clouds: Sequence[Tensor]) -> tuple[Tensor, Tensor, Tensor]:
        """Run the network.

        Args:
            clouds: One tensor a frame: x, y, z (metres), intensity, shape (n, 4).

        Returns:
            For each frame and anchor a class logit, shape (b, anchors); a box code, shape (b, anchors, 7); and two
            direction logits, shape (b, anchors, 2).
        """
        batch = torch.cat([torch.full((len(c),), i, dtype=torch.long, device=c.device) for i, c in enumerate(clouds)])
        image = self.encoder(torch.cat(list(clouds)), batch, len(clouds))
        image = image.to(self.head.weight.dtype) if not torch.is_autocast_enabled(image.device.type) else image
        maps = self.head(self.backbone(image)).permute(0, 2, 3, 1)  # channels last: cells in the anchors' order
        maps = maps.reshape(len(clouds), -1, 10, self.anchors.per_cell)
        logits = maps[:, :, 0].reshape(len(clouds), -1)
        codes = maps[:, :, 1:8].transpose(2, 3).reshape(len(clouds), -1, 7)
        return logits, codes, maps[:, :, 8:].transpose(2, 3).reshape(len(clouds), -1, 2)

    def targets(self, boxes: Boxes) -> Targets:
        """What one frame's annotation asks of the anchors."""
        return self.anchors.assign(boxes, positive_m=self.config.positive_m, ignore_m=self.config.ignore_m)

    def loss(self, outputs: tuple[Tensor, Tensor, Tensor], targets: Sequence[Targets]) -> Losses:
        """Focal, smooth-L1 and direction losses over a batch (PointPillars, equations 1 to 3)."""
        logits, codes, directions = outputs
        device = logits.device

        def flat(name: Literal["positive", "ignored"]) -> Tensor:
            parts = [getattr(target, name) + i * len(self.anchors) for i, target in enumerate(targets)]
            return torch.from_numpy(np.concatenate(parts)).to(device)

        positive = flat("positive")
        code = torch.from_numpy(np.concatenate([t.code for t in targets])).float().to(device)
        backwards = torch.from_numpy(np.concatenate([t.backwards for t in targets])).to(device)
        count = max(len(positive), 1)
        config = self.config
        return Losses(
            focal_loss(logits, positive, flat("ignored")) / count,
            config.box_weight * box_loss(codes.reshape(-1, 7)[positive].float(), code) / count,
            config.direction_weight * direction_loss(directions.reshape(-1, 2)[positive].float(), backwards) / count,
        )

    @torch.no_grad()
    def predict(self, clouds: Sequence[Tensor]) -> list[Boxes]:
        """Detect: one set of scored boxes a frame, best first."""
        logits, codes, directions = self(clouds)
        return [self._boxes(*maps) for maps in zip(logits, codes, directions, strict=True)]

    def _boxes(self, logits: Tensor, codes: Tensor, directions: Tensor) -> Boxes:
        best, index = torch.topk(logits.float(), min(self.config.candidates, len(logits)))
        score = torch.sigmoid(best)
        keep = score >= self.config.score_threshold
        index, score = index[keep], score[keep]
        anchor = index.cpu().numpy()
        backwards = (directions[index, 1] > directions[index, 0]).long().cpu().numpy()
        rows = decode(codes[index].double().cpu().numpy(), backwards, self.anchors.rows(anchor))
        boxes = Boxes(
            centre_m=rows[:, :3],
            size_m=rows[:, 3:6],
            yaw_rad=rows[:, 6],
            label=self.anchors.labels(anchor),
            score=score.double().cpu().numpy(),
        )
        return boxes[rotated_nms(boxes, iou_threshold=self.config.nms_iou, limit=self.config.max_boxes)]
