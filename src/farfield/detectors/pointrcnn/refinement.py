"""The second stage of PointRCNN (section 3.3 and 3.4): the points of a proposal to its confidence and a refined box."""

import numpy as np
import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor, nn

from farfield.detectors.contract import Channels
from farfield.detectors.pointrcnn.bins import BinConfig
from farfield.detectors.pointrcnn.pointnet import SetAbstraction, SetAbstractionConfig, SharedMlp, Widths, pool_group
from farfield.detectors.pointrcnn.points import Groups, farthest_points, frame_rows
from farfield.detectors.pointrcnn.points.proposals import MatchConfig


class RefinementConfig(BaseModel):
    """The second stage."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    context_m: float = Field(1.0, ge=0, description="proposals grow by this at every face before they take points")
    points: int = Field(128, ge=1, le=4096, description="points of a proposal")
    local_widths: Widths = Field(
        (64, 64), description="channels of the layers that see a proposal's points in its own axes"
    )
    merged_width: Channels = Field(64, description="channels of both kinds of features joined")
    levels: tuple[SetAbstractionConfig, ...] = Field(
        (SetAbstractionConfig(centres=32, radii_m=(0.6,), limits=(16,), widths=((64, 96),)),),
        description="set abstractions within a proposal",
    )
    pooled_widths: Widths = Field((128, 192), description="channels of the layers that pool a proposal")
    head_widths: Widths = Field((128, 128), description="channels of the layers that give score and box")
    norm: bool = Field(True, description="batch normalisation; published without")
    bins: BinConfig = BinConfig(scope_m=1.5, bin_m=0.5, headings=9, heading_span_rad=float(np.pi / 2))
    match: MatchConfig = MatchConfig()


class Refinement(nn.Module):
    """Stage 2: from the points of each proposal to logits by class and a box in bins (section 3.4, figure 2 b).

    Args:
        c_in: Semantic features a point.
        classes: Number of classes.
        config: The stage.
    """

    def __init__(self, c_in: int, classes: int, config: RefinementConfig) -> None:
        super().__init__()
        self.config = config
        norm = config.norm
        # local x, y, z, the proposal's size, range, and the foreground score of each class
        self.local = SharedMlp((7 + classes, *config.local_widths), norm=norm)
        self.merge = SharedMlp((c_in + config.local_widths[-1], config.merged_width), norm=norm)
        channels, levels = config.merged_width, []
        for level in config.levels:
            levels.append(SetAbstraction(channels, level, norm=norm))
            channels = levels[-1].channels
        self.levels = nn.ModuleList(levels)
        self.pool = SharedMlp((3 + channels, *config.pooled_widths), norm=norm)
        widths = (config.pooled_widths[-1], *config.head_widths)
        self.confidence = nn.Sequential(SharedMlp(widths, norm=norm), nn.Linear(widths[-1], classes))
        self.box = nn.Sequential(SharedMlp(widths, norm=norm), nn.Linear(widths[-1], config.bins.numbers))

    def forward(self, local: Tensor, extra: Tensor, semantic: Tensor, lengths: list[int]) -> tuple[Tensor, Tensor]:
        """Logits (m, classes) and codes (m, numbers) of m proposals.

        Args:
            local: Points in the frames of their proposals, metres, shape (p, 3), proposal after proposal.
            extra: What else is known of each point, shape (p, 4 + classes).
            semantic: Its features of the first stage, shape (p, c_in).
            lengths: Points of each proposal; may be 0.
        """
        rows = self.local(torch.cat([local, extra], 1))
        rows = self.merge(torch.cat([semantic.to(rows.dtype), rows], 1))
        for level in self.levels:
            chosen, taken = farthest_points(local, lengths, level.config.centres)
            centres = local[chosen]
            rows, local, lengths = level(local, rows, lengths, centres, taken), centres, taken
        owner = frame_rows(lengths, local.device)
        everything = Groups(owner, torch.arange(len(owner), device=local.device), len(lengths))
        pooled = pool_group(self.pool, everything, local, rows)
        return self.confidence(pooled), self.box(pooled)
