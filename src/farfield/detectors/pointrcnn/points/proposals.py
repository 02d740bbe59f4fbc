"""Proposals between the stages of PointRCNN: which to keep, which to train on, and which box each is assigned to.

The reference implementation gives 70 % of the proposals to the first 40 m, the rest to 40 to 80 m, and drops whatever
lies beyond. Here every band of range has a budget, and what it leaves unused goes to the others.
"""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor

from farfield.detectors.nms import rotated_nms
from farfield.detectors.pointrcnn.points.sampling import BandConfig, first_of_bands
from farfield.geometry.boxes import Boxes
from farfield.geometry.iou import pairwise_iou


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


def as_boxes(rows: Float[np.ndarray, "n 7"], score: Float[np.ndarray, " n"] | None = None) -> Boxes:
    """Rows x, y, z, length, width, height, yaw as boxes."""
    rows = rows.astype(np.float64)
    return Boxes(centre_m=rows[:, :3], size_m=rows[:, 3:6], yaw_rad=rows[:, 6], score=score)


def first_candidates(points: Tensor, score: Tensor, config: ProposalConfig) -> Tensor:
    """Rows of one frame's points that propose a box: the best of each band, best first, shape (k,)."""
    order = torch.argsort(score, descending=True, stable=True)
    order = order[score[order] >= config.threshold]
    return order[first_of_bands(config.bands.of(points[order]), config.bands.shares, config.candidates)]


def keep_proposals(boxes: Tensor, score: Tensor, config: ProposalConfig, *, training: bool) -> Tensor:
    """Rows of one frame's candidates that survive suppression and their band's budget, best first, shape (k,).

    Args:
        boxes: Proposed boxes, best first, shape (n, 7).
        score: Their scores, shape (n,).
        config: Budgets.
        training: Take the numbers of the training.
    """
    iou, count = (config.training_nms_iou, config.training_count) if training else (config.nms_iou, config.count)
    scored = as_boxes(boxes.cpu().numpy(), score.double().cpu().numpy())
    kept = torch.from_numpy(rotated_nms(scored, iou_threshold=iou, limit=max(len(scored), 1))).to(boxes.device)
    return kept[first_of_bands(config.bands.of(boxes[kept]), config.bands.shares, count)]


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
