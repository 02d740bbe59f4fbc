"""Bin-based boxes (PointRCNN, sections 3.2 and 3.4): choose a bin, then refine within it.

A box is expressed relative to a reference: where it is, how it is turned and how large such boxes are. At the first
stage that is a point (not turned) with the mean size of its class, at the second stage a proposal.
"""

import math
from typing import NamedTuple

import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor
from torch.nn import functional


class BinConfig(BaseModel):
    """How finely a box is expressed."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    scope_m: float = Field(gt=0, le=100, description="centres are sought within this along x and y")
    bin_m: float = Field(gt=0, description="length of a bin")
    headings: int = Field(ge=1, le=360, description="bins of the heading")
    heading_span_rad: float = Field(2 * math.pi, gt=0, le=2 * math.pi, description="angle that the bins cover together")
    log_size: bool = Field(True, description="logarithm of the size ratio; false: the ratio less one, as published")

    beta: float = Field(1 / 9, gt=0, description="where smooth L1 turns linear, as in SECOND; published: 1")

    @property
    def per_axis(self) -> int:
        """Bins along x, and along y."""
        return max(1, math.ceil(round(2 * self.scope_m / self.bin_m, 6)))

    @property
    def numbers(self) -> int:
        """Outputs of the network for one box."""
        return 4 * self.per_axis + 2 * self.headings + 4


class BinTargets(NamedTuple):
    """Encoded boxes: bins (k, 3) of x, y and heading, residuals (k, 3) in half bins, z (k, 1) and size (k, 3)."""

    bins: Tensor
    residuals: Tensor
    z: Tensor
    size: Tensor


class BinParts(NamedTuple):
    """A network's output by meaning: logits and residuals of x, y and heading by bin, z (k, 1) and size (k, 3)."""

    logits: tuple[Tensor, Tensor, Tensor]
    residuals: tuple[Tensor, Tensor, Tensor]
    z: Tensor
    size: Tensor


class BinCoder:
    """Boxes as bins and residuals, and back.

    Args:
        config: Bins.
    """

    def __init__(self, config: BinConfig) -> None:
        self.config = config
        self.full_circle = config.heading_span_rad > 2 * math.pi - 1e-6
        self.heading_bin_rad = config.heading_span_rad / config.headings

    def split(self, codes: Tensor) -> BinParts:
        """Name the columns of a network's output, shape (k, numbers)."""
        n, h = self.config.per_axis, self.config.headings
        x, y, x_rest, y_rest, turn, turn_rest, z, size = codes.split([n, n, n, n, h, h, 1, 3], 1)
        return BinParts((x, y, turn), (x_rest, y_rest, turn_rest), z, size)

    def encode(self, boxes: Tensor, reference: Tensor) -> BinTargets:
        """Express boxes relative to references (equations 2 and 4).

        Centres beyond the scope are drawn to its edge. Where the headings do not span the circle, a box that looks the
        other way counts as its own reverse.

        Args:
            boxes: x, y, z, length, width, height, yaw, shape (k, 7).
            reference: The same of each box's reference, shape (k, 7).
        """
        config = self.config
        offset = boxes[:, :3] - reference[:, :3]
        cos, sin = torch.cos(reference[:, 6]), torch.sin(reference[:, 6])
        along = offset[:, 0] * cos + offset[:, 1] * sin
        across = offset[:, 1] * cos - offset[:, 0] * sin
        place = (torch.stack([along, across], 1) + config.scope_m).clamp(0, 2 * config.scope_m - 1e-3)
        bins = torch.floor(place / config.bin_m)
        rest = (place - (bins + 0.5) * config.bin_m) / (config.bin_m / 2)
        turn = self._wrapped(boxes[:, 6] - reference[:, 6]) + self._first_edge()
        turn_bin = torch.floor(turn / self.heading_bin_rad).clamp(0, config.headings - 1)
        turn_rest = (turn - (turn_bin + 0.5) * self.heading_bin_rad) / (self.heading_bin_rad / 2)
        ratio = boxes[:, 3:6] / reference[:, 3:6]
        return BinTargets(
            torch.cat([bins, turn_bin[:, None]], 1).long(),
            torch.cat([rest, turn_rest[:, None]], 1),
            offset[:, 2:],
            torch.log(ratio) if config.log_size else ratio - 1,
        )

    def decode(self, codes: Tensor, reference: Tensor) -> Tensor:
        """Boxes (k, 7) from a network's output (k, numbers); sizes are kept within 1/50 to 20 times the reference."""
        config, parts = self.config, self.split(codes.float())
        best = [logits.argmax(1, keepdim=True) for logits in parts.logits]
        rest = [residual.gather(1, index)[:, 0] for residual, index in zip(parts.residuals, best, strict=True)]
        along, across = (
            (index[:, 0] + 0.5 + part / 2) * config.bin_m - config.scope_m
            for index, part in zip(best[:2], rest[:2], strict=True)
        )
        cos, sin = torch.cos(reference[:, 6]), torch.sin(reference[:, 6])
        x, y = along * cos - across * sin, along * sin + across * cos
        turn = (best[2][:, 0] + 0.5 + rest[2] / 2) * self.heading_bin_rad - self._first_edge()
        ratio = parts.size.clamp(-4, 3).exp() if config.log_size else parts.size + 1
        yaw = torch.remainder(reference[:, 6] + turn + math.pi, 2 * math.pi) - math.pi
        centre = reference[:, :3] + torch.stack([x, y, parts.z[:, 0]], 1)
        return torch.cat([centre, reference[:, 3:6] * ratio.clamp(0.02, 20.0), yaw[:, None]], 1)

    def loss(self, codes: Tensor, targets: BinTargets) -> Tensor:
        """Loss of each box, shape (k,): cross-entropy of the bins and smooth L1 of the residuals (equation 3)."""
        parts = self.split(codes.float())
        total = self._smooth_l1(parts.z, targets.z) + self._smooth_l1(parts.size, targets.size)
        for axis, (logits, residuals) in enumerate(zip(parts.logits, parts.residuals, strict=True)):
            index = targets.bins[:, axis]
            total = total + functional.cross_entropy(logits, index, reduction="none")
            total = total + self._smooth_l1(residuals.gather(1, index[:, None]), targets.residuals[:, axis, None])
        return total

    def _smooth_l1(self, predicted: Tensor, target: Tensor) -> Tensor:
        error = functional.smooth_l1_loss(predicted, target.float(), beta=self.config.beta, reduction="none")
        return error.sum(1)

    def _first_edge(self) -> float:
        """How far the first bin's edge lies behind the reference's heading; on a circle the first bin surrounds it."""
        return self.heading_bin_rad / 2 if self.full_circle else self.config.heading_span_rad / 2

    def _wrapped(self, turn: Tensor) -> Tensor:
        """Turns from the first bin's edge onwards."""
        if self.full_circle:
            half = self.heading_bin_rad / 2
            return torch.remainder(turn + half, 2 * math.pi) - half
        half = self.config.heading_span_rad / 2
        turn = torch.remainder(turn + math.pi / 2, math.pi) - math.pi / 2
        return turn.clamp(-half, half)
