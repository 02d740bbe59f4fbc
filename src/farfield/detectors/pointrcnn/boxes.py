"""Boxes of PointRCNN: their bins (sections 3.2 and 3.4), proposals between the stages, and targets of points.

Bins: choose one, then refine within it.
A box is expressed relative to a reference: where it is, how it is turned and how large such boxes are. At the first
stage that is a point (not turned) with the mean size of its class, at the second stage a proposal.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, Int
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor
from torch.nn import functional

from farfield.detectors.config import ALIKE, BoxWeights
from farfield.detectors.nms import surviving_boxes
from farfield.detectors.pointrcnn.points import BandConfig, first_of_bands
from farfield.geometry.boxes import Boxes, points_in_boxes
from farfield.geometry.iou import pairwise_iou
from farfield.vocabulary.classes import UNSURE


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
        shifted = (torch.stack([along, across], 1) + config.scope_m).clamp(0, 2 * config.scope_m - 1e-3)
        bins = torch.floor(shifted / config.bin_m)
        rest = (shifted - (bins + 0.5) * config.bin_m) / (config.bin_m / 2)
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
        config, codes = self.config, codes.float()
        parts, axes = self.split(codes), codes[:, : 4 * config.per_axis].reshape(codes.shape[0], 2, 2, config.per_axis)
        best = axes[:, 0].argmax(2, keepdim=True)  # of x and of y: logits of both come first, then the residuals
        along, across = (
            ((best + 0.5 + axes[:, 1].gather(2, best) / 2) * config.bin_m - config.scope_m).squeeze(2).unbind(1)
        )
        turn_bin = parts.logits[2].argmax(1, keepdim=True)
        turn_rest = parts.residuals[2].gather(1, turn_bin)
        cos, sin = torch.cos(reference[:, 6]), torch.sin(reference[:, 6])
        x, y = along * cos - across * sin, along * sin + across * cos
        turn = ((turn_bin + 0.5 + turn_rest / 2) * self.heading_bin_rad - self._first_edge()).squeeze(1)
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


# Proposals between the stages of PointRCNN: which to keep, which to train on, and which box each is assigned to.
#
# The reference implementation gives 70 % of the proposals to the first 40 m, the rest to 40 to 80 m, and drops
# whatever lies beyond. Here every band of range has a budget, and what it leaves unused goes to the others.


class ProposalConfig(BaseModel):
    """How many proposals a frame has, and where."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    candidates: int = Field(1024, ge=1, le=65536, description="points with the best scores that propose a box")
    threshold: float = Field(0.01, ge=0, le=1, description="points with a lower score propose none")
    nms_iou: float = Field(0.5, ge=0, le=1, description="proposals that overlap a better one by more are dropped")
    training_nms_iou: float = Field(0.7, ge=0, le=1, description="the same while it is trained")
    count: int = Field(128, ge=1, le=4096, description="proposals that reach the second stage")
    training_count: int = Field(256, ge=1, le=4096, description="proposals among which the trained ones are drawn")
    bands: BandConfig = BandConfig()


class MatchConfig(BaseModel):
    """Which proposals are right, and which are wrong.

    A box of the visible part, such as a car's rear of 0.3 x 1.9 m, hardly overlaps a proposal 0.3 m away from it. So
    closeness of the centres counts beside overlap: either makes a proposal right, and only one that is neither near
    nor overlapping is wrong. Distances of zero leave the published criterion alone.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    right_iou: float = Field(0.6, description="proposals that overlap a box by more are right")
    wrong_iou: float = Field(0.45, description="those that overlap all boxes by less are wrong")
    refined_iou: float = Field(0.55, description="those that overlap one by more learn its box")
    right_m: float = Field(0.6, ge=0, description="centres this near make a proposal right")
    wrong_m: float = Field(1.2, ge=0, description="centres farther away than this make it wrong, if overlap does too")
    refined_m: float = Field(1.2, ge=0, description="centres this near make it learn the box")
    drawn: int = Field(96, ge=1, le=4096, description="proposals of a frame that are trained on")
    right_share: float = Field(0.5, gt=0, le=1, description="at most this share of them are near a box")
    shaken: int = Field(4, ge=0, le=64, description="shaken copies of each annotated box among the proposals")


class Match(NamedTuple):
    """The annotated box of each of m proposals (-1 without any), their 3D IoU and distance, (m,) each."""

    box: Int[np.ndarray, " m"]
    iou: Float[np.ndarray, " m"]
    gap_m: Float[np.ndarray, " m"]

    def right(self, config: MatchConfig) -> np.ndarray:
        """Proposals that should be confident, bool."""
        return (self.iou >= config.right_iou) | (self.gap_m <= config.right_m)

    def wrong(self, config: MatchConfig) -> np.ndarray:
        """Proposals that should not be, bool. Those neither right nor wrong do not count."""
        return ~self.right(config) & (self.iou < config.wrong_iou) & (self.gap_m > config.wrong_m)

    def refined(self, config: MatchConfig) -> np.ndarray:
        """Proposals that learn the box, bool."""
        return (self.iou >= config.refined_iou) | (self.gap_m <= config.refined_m)


def as_boxes(rows: Float[np.ndarray, "n 7"]) -> Boxes:
    """Rows x, y, z, length, width, height, yaw as boxes."""
    rows = rows.astype(np.float64)
    return Boxes(centre_m=rows[:, :3], size_m=rows[:, 3:6], yaw_rad=rows[:, 6])


def first_candidates(points: Tensor, score: Tensor, config: ProposalConfig) -> Tensor:
    """Rows of one frame's points that propose a box: the best of each band, best first, shape (k,)."""
    order = torch.argsort(score, descending=True, stable=True)
    order = order[score[order] >= config.threshold]
    return order[first_of_bands(config.bands.of(points[order]), config.bands.shares, config.candidates)]


def keep_proposals(boxes: Tensor, config: ProposalConfig, *, training: bool) -> Tensor:
    """Rows of one frame's candidates that survive suppression and their band's budget, best first, shape (k,).

    Args:
        boxes: Proposed boxes, best first, shape (n, 7).
        config: Budgets.
        training: Take the numbers of the training.
    """
    iou, count = (config.training_nms_iou, config.training_count) if training else (config.nms_iou, config.count)
    rows = surviving_boxes(boxes.double(), iou)
    return rows[first_of_bands(config.bands.of(boxes[rows]), config.bands.shares, count)]


def match_proposals(proposals: Float[np.ndarray, "m 7"], boxes: Float[np.ndarray, "k 7"]) -> Match:
    """The box that each proposal overlaps most; where it overlaps none, the nearest."""
    if not len(boxes):
        none = np.zeros(len(proposals))
        return Match(np.full(len(proposals), -1, dtype=np.int64), none, np.full(len(proposals), np.inf))
    iou = pairwise_iou(as_boxes(proposals), as_boxes(boxes))
    gap_m = np.linalg.norm(proposals[:, None, :3].astype(np.float64) - boxes[None, :, :3], axis=2)
    best = np.argmax(iou - 1e-3 * gap_m, axis=1)
    row = np.arange(len(proposals))
    return Match(best, iou[row, best], gap_m[row, best])


def shaken_boxes(boxes: Float[np.ndarray, "k 7"], copies: int, rng: np.random.Generator) -> Float[np.ndarray, "_ 7"]:
    """Copies of annotated boxes, moved by up to half a metre, resized by up to 15 % and turned by up to 0.3 rad."""
    shaken = np.repeat(boxes, copies, axis=0)
    shaken[:, :3] += rng.uniform(-0.5, 0.5, (len(shaken), 3)) * [1.0, 1.0, 0.5]
    shaken[:, 3:6] *= rng.uniform(0.85, 1.15, (len(shaken), 3))
    shaken[:, 6] += rng.uniform(-0.3, 0.3, len(shaken))
    return shaken


def draw_proposals(match: Match, config: MatchConfig, rng: np.random.Generator) -> Int[np.ndarray, " _"]:
    """Rows of the proposals to train on: near ones up to their share, then wrong ones, mostly those that lie close."""
    near = rng.permutation(np.flatnonzero(match.right(config) | match.refined(config)))
    wrong = rng.permutation(np.flatnonzero(match.wrong(config)))
    near = near[: max(int(config.drawn * config.right_share), config.drawn - len(wrong))]
    room = config.drawn - len(near)
    hard, easy = wrong[match.gap_m[wrong] < 5.0], wrong[match.gap_m[wrong] >= 5.0]
    easy = easy[: max(room // 4, room - len(hard))]
    return np.sort(np.concatenate([near, hard[: room - len(easy)], easy]))


# Which point belongs to which annotated box: what the first stage of a point-based detector learns.

BACKGROUND, UNSURE_POINT = -1, -2


@dataclass(frozen=True, eq=False)
class PointTargets:
    """The targets of a frame.

    Args:
        rows: Annotated boxes x, y, z, length, width, height, yaw, shape (k, 7).
        kind: Class number of each, shape (k,).
        weight: Weight of each in the loss, shape (k,).
        owner: Box that each point of the cloud lies in, -1 for background, -2 just outside a box, shape (n,).
        unsure: Boxes in which nothing is background, rows as of the annotated ones, shape (u, 7).
    """

    rows: Float32[np.ndarray, "k 7"]
    kind: Int[np.ndarray, " k"]
    weight: Float[np.ndarray, " k"]
    owner: Int[np.ndarray, " n"]
    unsure: Float32[np.ndarray, "u 7"] = field(default_factory=lambda: np.zeros((0, 7), dtype=np.float32))


@dataclass(frozen=True, eq=False, kw_only=True)
class PointAssigner:
    """Assigns the points of a frame to its boxes.

    Args:
        class_names: Names by class number.
        margin_m: Boxes grow by this before they claim points.
        unsure_m: Points this far outside count neither as box nor as background.
        weights: Weight of a box in the loss.
    """

    class_names: tuple[str, ...]
    margin_m: float
    unsure_m: float
    weights: BoxWeights = ALIKE

    def __call__(self, boxes: Boxes, inputs: Mapping[str, np.ndarray]) -> PointTargets:
        """Targets of one frame, from its points: those in boxes of the class ``unsure`` are no background."""
        unsure = np.asarray(boxes.label) == UNSURE
        objects, points = boxes[~unsure], inputs["points"]
        margins = {"margin_m": self.margin_m, "unsure_m": self.unsure_m}
        targets = assign_points(objects, points, self.class_names, weight=self.weights(objects, inputs), **margins)
        for inside in points_in_boxes(points[:, :3], boxes[unsure]) if unsure.any() else ():
            targets.owner[inside[targets.owner[inside] == BACKGROUND]] = UNSURE_POINT
        return replace(targets, unsure=_rows(boxes[unsure]))


def assign_points(
    boxes: Boxes,
    points: Float32[np.ndarray, "n columns"],
    class_names: Sequence[str],
    *,
    weight: Float[np.ndarray, " k"],
    margin_m: float,
    unsure_m: float,
) -> PointTargets:
    """Assign each point to the box that it lies in, of several to the smallest.

    Args:
        boxes: Annotated boxes of the named classes.
        points: The cloud.
        class_names: Names by class number.
        weight: Weight of each box in the loss.
        margin_m: Boxes grow by this before they claim points: many of their points lie on their faces.
        unsure_m: Points this far outside count neither as box nor as background.
    """
    owner = np.full(len(points), BACKGROUND, dtype=np.int64)
    largest_first = np.argsort(-boxes.volume_m3, kind="stable")
    for inside in points_in_boxes(points[:, :3], boxes, margin_m=margin_m + unsure_m):
        owner[inside] = UNSURE_POINT
    claimed = points_in_boxes(points[:, :3], boxes, margin_m=margin_m)
    for index in largest_first:
        owner[claimed[index]] = index
    kind = np.array([list(class_names).index(str(name)) for name in boxes.label], dtype=np.int64)
    return PointTargets(_rows(boxes), kind, weight, owner)


def _rows(boxes: Boxes) -> Float32[np.ndarray, "n 7"]:
    return np.column_stack([boxes.centre_m, boxes.size_m, boxes.yaw_rad]).astype(np.float32)


def centres_in(rows: Float[np.ndarray, "n 7"], unsure: Float[np.ndarray, "u 7"]) -> Bool[np.ndarray, " n"]:
    """Which boxes have their centre in one of others, seen from above, shape (n,)."""
    away = rows[:, None, :2] - unsure[None, :, :2]
    cos, sin = np.cos(unsure[:, 6]), np.sin(unsure[:, 6])
    along, across = away[..., 0] * cos + away[..., 1] * sin, away[..., 1] * cos - away[..., 0] * sin
    inside = (np.abs(along) <= unsure[:, 3] / 2) & (np.abs(across) <= unsure[:, 4] / 2)
    return np.asarray(inside.any(axis=1))


def join_targets(targets: Sequence[PointTargets], device: torch.device) -> tuple[Tensor, Tensor, Tensor]:
    """Boxes (k, 7), classes and weights (k,) of all frames."""
    parts = [np.concatenate([getattr(target, name) for target in targets]) for name in ("rows", "kind", "weight")]
    boxes, kind, weight = (torch.from_numpy(part).to(device) for part in parts)
    return boxes, kind, weight.float()


def owners_of(targets: Sequence[PointTargets], rows: Tensor, lengths: Sequence[int]) -> Tensor:
    """The box, counted over all frames, that each chosen point lies in, or what it is instead; shape (n,).

    Args:
        targets: Of each frame.
        rows: Row of each chosen point in its cloud, frame after frame, shape (n,).
        lengths: Chosen points of each frame.
    """
    owners, first = [], 0
    for target, row in zip(targets, rows.split(list(lengths)), strict=True):
        owner = torch.from_numpy(target.owner).to(row.device)[row]
        owners.append(torch.where(owner >= 0, owner + first, owner))
        first += len(target.rows)
    return torch.cat(owners)
