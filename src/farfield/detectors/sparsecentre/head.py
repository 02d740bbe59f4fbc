"""The centre head on a sparse map: a heat value a class and a box at each occupied cell, its losses and its boxes.

CenterPoint (arXiv 2006.11275, section 4) with the changes of VoxelNeXt (arXiv 2303.11301, section 3.2): the occupied
cell nearest to a box's centre is assigned to it, wherever it is, and boxes are read at local maxima over occupied
cells.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import NamedTuple, cast

import numpy as np
import torch
from jaxtyping import Float, Int
from pydantic import Field
from torch import Tensor, nn
from torch.nn import functional

from farfield.detectors.anchors.head import logit
from farfield.detectors.config import ALIKE, BoxWeights, DetectorConfig
from farfield.detectors.features import FeatureMap, in_type_of
from farfield.detectors.losses import normaliser
from farfield.detectors.network import ClassRows
from farfield.detectors.nms import boxes_after_nms, rotated_nms, wrap_angle
from farfield.detectors.sparse import FLAT, SparseTensor, SubmanifoldConv, decode_keys, neighbour_table, normalised
from farfield.detectors.sparse.tables import DeviceBook
from farfield.geometry.boxes import Boxes
from farfield.vocabulary.classes import CIRRUS_SIZES_M, UNSURE

_NUMBERS = 10  # offset 2, height, log size 3, sine and cosine of twice the yaw, sine and cosine of the yaw
_LOG_SIZE = (float(np.log(0.05)), float(np.log(40.0)))


@dataclass(frozen=True, eq=False)
class CentreTargets:
    """The boxes of one frame.

    Args:
        centre_m: Centres, shape (n, 3).
        size_m: Length, width, height, shape (n, 3).
        yaw_rad: Headings, shape (n,).
        kind: Numbers of the classes, shape (n,).
        weight: Weight of each box in the loss, shape (n,).
        unsure: Rectangles x, y, length, width, yaw in which nothing is background, shape (u, 5).
    """

    centre_m: Float[np.ndarray, "n 3"]
    size_m: Float[np.ndarray, "n 3"]
    yaw_rad: Float[np.ndarray, " n"]
    kind: Int[np.ndarray, " n"]
    weight: Float[np.ndarray, " n"]
    unsure: Float[np.ndarray, "u 5"] = field(default_factory=lambda: np.zeros((0, 5)))

    def ignoring(self, unsure: "CentreTargets") -> "CentreTargets":
        """These targets and, with no weight, those of unsure boxes: near them hardly anything is background.

        Args:
            unsure: The targets of the unsure boxes.
        """
        return CentreTargets(
            np.concatenate([self.centre_m, unsure.centre_m]),
            np.concatenate([self.size_m, unsure.size_m]),
            np.concatenate([self.yaw_rad, unsure.yaw_rad]),
            np.concatenate([self.kind, unsure.kind]),
            np.concatenate([self.weight, np.zeros_like(unsure.weight)]),
            np.concatenate([self.unsure, unsure.unsure]),
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class BoxesOfClasses:
    """The boxes of a frame that are of the detector's classes and have their centre on the map.

    Args:
        classes: Names by number.
        shape: Cells of the map along x and y.
        cell_m: Edge length of a cell.
        y_min_m: Right edge of the map.
        weights: Weight of a box in the loss.
    """

    classes: tuple[str, ...]
    shape: tuple[int, int]
    cell_m: float
    y_min_m: float
    weights: BoxWeights = ALIKE

    def __call__(self, boxes: Boxes, inputs: Mapping[str, np.ndarray]) -> CentreTargets:
        """Targets of one frame; in boxes of the class ``unsure`` nothing is background."""
        names, (nx, ny) = self.classes, self.shape
        kind = np.array([names.index(name) if name in names else -1 for name in boxes.label], dtype=np.int64)
        x, y = boxes.centre_m[:, 0], boxes.centre_m[:, 1] - self.y_min_m
        on_map = (kind >= 0) & (x >= 0) & (x < nx * self.cell_m) & (y >= 0) & (y < ny * self.cell_m)
        on_map_boxes, unsure = boxes[on_map], boxes[np.asarray(boxes.label) == UNSURE]
        return CentreTargets(
            on_map_boxes.centre_m,
            on_map_boxes.size_m,
            on_map_boxes.yaw_rad,
            kind[on_map],
            self.weights(on_map_boxes, inputs),
            np.column_stack([unsure.centre_m[:, :2], unsure.size_m[:, :2], unsure.yaw_rad]),
        )


class BoxTensors(NamedTuple):
    """The boxes of one frame as tensors, float32; see :class:`CentreTargets`."""

    centre_m: Tensor
    size_m: Tensor
    yaw_rad: Tensor
    kind: Tensor
    weight: Tensor

    @classmethod
    def of(cls, target: CentreTargets, device: torch.device) -> "BoxTensors":
        """Copy a frame's targets to the device."""
        floats = [target.centre_m, target.size_m, target.yaw_rad, target.weight]
        centre, size, yaw, weight = (
            torch.tensor(np.asarray(part), dtype=torch.float32, device=device) for part in floats
        )
        return cls(centre, size, yaw, torch.from_numpy(target.kind).to(device), weight)


class Assignment(NamedTuple):
    """Targets of the n occupied cells of a frame.

    Attributes:
        heat: Target heat, shape (n, classes): 1 at the cell nearest to a box's centre, a Gaussian around it.
        heat_weight: Weight of that one, zero elsewhere, shape (n, classes).
        cell: Rows of the cells that learn a box, shape (k,).
        box: Which box each of them learns, shape (k,).
        weight: Their weights; those of one box add up to the box's weight, shape (k,).
    """

    heat: Tensor
    heat_weight: Tensor
    cell: Tensor
    box: Tensor
    weight: Tensor


def assign(
    place_m: Tensor, truth: BoxTensors, classes: int, *, gaussian_m: float, assign_m: float, box_m: float
) -> Assignment:
    """Assign a frame's boxes to its occupied cells by distance on the ground.

    Args:
        place_m: Centres of the cells, shape (n, 2).
        truth: The boxes.
        classes: Number of classes.
        gaussian_m: Standard deviation of the heat around a centre.
        assign_m: A box with no occupied cell this near has no target.
        box_m: Cells this near to a centre learn its box, beside the nearest one.
    """
    heat, heat_weight = place_m.new_zeros(2, len(place_m), classes).unbind(0)
    if len(place_m) == 0 or len(truth.kind) == 0:
        none = truth.kind.new_zeros(0)
        return Assignment(heat, heat_weight, none, none, place_m.new_zeros(0))
    gap = (place_m[:, None] - truth.centre_m[None, :, :2]).norm(dim=2)
    bell = torch.exp(-0.5 * (gap / gaussian_m) ** 2)
    heat = heat.scatter_reduce(1, truth.kind.expand_as(bell), bell, "amax")
    least, nearest = gap.min(0)
    reached = least <= assign_m
    peak = nearest[reached] * classes + truth.kind[reached]
    heat_weight = heat_weight.view(-1).scatter_reduce(0, peak, truth.weight[reached], "amax").view_as(heat)
    heat = torch.where(heat_weight > 0, 1.0, heat)
    assigned = gap <= box_m
    assigned[nearest[reached], reached.nonzero().squeeze(1)] = True
    box = torch.where(assigned, gap, torch.inf).argmin(1)
    cell = assigned.any(1).nonzero().squeeze(1)
    box = box[cell]
    share = torch.bincount(box, minlength=len(truth.kind)).clamp(min=1)
    return Assignment(heat, heat_weight, cell, box, (truth.weight / share)[box])


def heat_loss(logits: Tensor, heat: Tensor, weight: Tensor) -> Tensor:
    """Penalty-reduced focal loss, summed (CornerNet, arXiv 1808.01244, equation 1, alpha 2 and beta 4).

    Args:
        logits: Shape (n, classes).
        heat: Target heat in [0, 1], shape (n, classes).
        weight: Weight of the positives, zero at all others, shape (n, classes).
    """
    logits = logits.float()
    score = torch.sigmoid(logits)
    as_positive = weight * (1 - score) ** 2 * functional.softplus(-logits)
    as_negative = (1 - heat) ** 4 * score**2 * functional.softplus(logits)
    return (as_positive + torch.where(weight > 0, 0.0, as_negative)).sum()


def in_rectangles(place_m: Tensor, rectangles: Tensor) -> Tensor:
    """Whether each place, shape (n, 2), lies in one of some rectangles x, y, length, width, yaw, shape (u, 5)."""
    away = place_m[:, None] - rectangles[None, :, :2]
    cos, sin = torch.cos(rectangles[:, 4]), torch.sin(rectangles[:, 4])
    local = torch.stack([away[..., 0] * cos + away[..., 1] * sin, away[..., 1] * cos - away[..., 0] * sin], 2)
    return (local.abs() <= rectangles[:, 2:4] / 2).all(2).any(1)


def vote_loss(
    votes: Tensor, place_m: Tensor, truth: BoxTensors, cell_m: float, unsure: Tensor | None = None
) -> tuple[Tensor, Tensor]:
    """Focal loss on the foreground and smooth L1 on the step to the centre, summed; each box counts the same.

    A cell is foreground where its centre lies in a box that is half a cell larger on every side.

    Args:
        votes: Foreground logit and step, shape (n, 3).
        place_m: Centres of the cells, shape (n, 2).
        truth: The boxes.
        cell_m: Edge length of a cell.
        unsure: Cells that are no background where they are no foreground, shape (n,).
    """
    votes, count = votes.float(), len(truth.kind)
    away = place_m[:, None] - truth.centre_m[None, :, :2]
    cos, sin = torch.cos(truth.yaw_rad), torch.sin(truth.yaw_rad)
    local = torch.stack([away[..., 0] * cos + away[..., 1] * sin, away[..., 1] * cos - away[..., 0] * sin], 2)
    inside = (local.abs() <= (truth.size_m[:, :2] + cell_m) / 2).all(2)
    cell = inside.any(1).nonzero().squeeze(1)
    gap = torch.where(inside, away.norm(dim=2), torch.inf)[cell]
    box = gap.argmin(1) if len(cell) else truth.kind.new_zeros(0)
    weight = (truth.weight / torch.bincount(box, minlength=count).clamp(min=1))[box]
    logits, right = votes[:, 0], votes[cell, 0]
    negative = torch.sigmoid(logits) ** 2 * functional.softplus(logits)
    negative = negative if unsure is None else torch.where(unsure, 0.0, negative)
    positive = weight * torch.sigmoid(-right) ** 2 * functional.softplus(-right)
    step = -away[cell, box] / cell_m
    error = functional.smooth_l1_loss(votes[cell, 1:], step, beta=1 / 9, reduction="none").sum(1)
    return positive.sum() + negative.sum() - negative[cell].sum(), (error * weight).sum()


def encode(truth: BoxTensors, box: Tensor, place_m: Tensor, height_m: Tensor, cell_m: float) -> Tensor:
    """Target codes of cells, shape (k, 10).

    Offset of the centre in cells, height of the centre above the cell's reference height (metres), logarithm of the
    size, sine and cosine of twice the yaw (the axis, which any view shows) and of the yaw (which end is the front).

    Args:
        truth: The boxes.
        box: Which box each cell is assigned to, shape (k,).
        place_m: Centres of the cells, shape (k, 2).
        height_m: Reference heights of the cells, shape (k,).
        cell_m: Edge length of a cell.
    """
    yaw = truth.yaw_rad[box]
    centre = truth.centre_m[box]
    turns = torch.stack([torch.sin(2 * yaw), torch.cos(2 * yaw), torch.sin(yaw), torch.cos(yaw)], 1)
    offset = (centre[:, :2] - place_m) / cell_m
    return torch.cat([offset, (centre[:, 2] - height_m)[:, None], torch.log(truth.size_m[box]), turns], 1)


def decode(codes: Tensor, place_m: Tensor, height_m: Tensor, cell_m: float) -> Tensor:
    """Invert :func:`encode`: rows x, y, z, l, w, h, yaw, shape (k, 7), float64."""
    codes = codes.double()
    size = torch.exp(codes[:, 3:6].clamp(*_LOG_SIZE))
    yaw = torch.atan2(codes[:, 6], codes[:, 7]) / 2
    backwards = torch.sin(yaw) * codes[:, 8] + torch.cos(yaw) * codes[:, 9] < 0
    yaw = wrap_angle(yaw + torch.pi * backwards)
    z = height_m.double() + codes[:, 2]
    return torch.cat([place_m.double() + codes[:, :2] * cell_m, z[:, None], size, yaw[:, None]], 1)


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
        around: Rows of the cells around each and its own, those of FLAT, where the layers left such a table behind.
    """

    logits: Tensor
    codes: Tensor
    height_m: Tensor
    keys: Tensor
    votes: Tensor
    vote_keys: Tensor
    frames: int
    around: Tensor | None = None


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
            classes=config.classes, shape=shape, cell_m=cell_m, y_min_m=y_min_m, weights=BoxWeights.of(config)
        )
        self.heat_stem = normalised(SubmanifoldConv(channels, channels, FLAT))
        self.box_stem = normalised(SubmanifoldConv(channels, channels, FLAT))
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
        votes, heights = (cast(SparseTensor, features.aux[name]) for name in ("votes", "height_m"))
        logits, codes = self.heat(self.heat_stem(sparse).features), self.box(self.box_stem(sparse).features)
        height_m, book = heights.features.squeeze(1), self.heat_stem.conv.rulebook(sparse)
        around = book.table if isinstance(book, DeviceBook) else None
        return CentreMaps(logits, codes, height_m, sparse.keys, votes.features, votes.keys, sparse.batch_size, around)

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
        rectangles = torch.from_numpy(target.unsure).to(place_m)
        unsure = in_rectangles(place_m[rows], rectangles)[:, None]  # full heat without a weight has no loss
        heat = heat_loss(maps.logits[rows], torch.where(unsure, 1.0, assigned.heat), assigned.heat_weight)
        expected = encode(
            truth, assigned.box, place_m[rows[assigned.cell]], maps.height_m[rows[assigned.cell]], self.cell_m
        )
        error = functional.smooth_l1_loss(
            maps.codes[rows[assigned.cell]].float(), expected, beta=1 / 9, reduction="none"
        )
        error = error[:, :8].sum(1) + config.direction_weight * error[:, 8:].sum(1)
        frame, place_m = self.places_m(maps.vote_keys)
        rows = (frame == index).nonzero().squeeze(1)
        unsure = in_rectangles(place_m[rows], rectangles)
        foreground, vote = vote_loss(maps.votes[rows], place_m[rows], truth, self.cell_m, unsure)
        return (
            heat,
            config.box_weight * (error * assigned.weight).sum(),
            config.vote_weight * foreground,
            config.vote_weight * vote,
        )

    def decode(self, maps: CentreMaps) -> list[Boxes]:
        """The boxes of each frame after suppression, best first."""
        candidates = self.peak_boxes(maps)
        if maps.logits.is_cuda:
            return self.boxes_on_device(*candidates, maps.frames)
        rows, score, kind, frame = (part.cpu().numpy() for part in candidates)
        return [self._frame(rows[frame == i], score[frame == i], kind[frame == i]) for i in range(maps.frames)]

    def peak_boxes(self, maps: CentreMaps) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """The boxes at all peaks, rows (n, 7) float64, their scores, classes and frames, each of shape (n,)."""
        logits = maps.logits.float()
        confident = logits >= logit(self.config.score_threshold)
        around = maps.around if self.config.peak_cells == 1 else None
        passed = peaks(logits, maps.keys, self.shape, self.config.peak_cells, around) & confident
        row, kind = passed.nonzero().unbind(1)
        frame, place_m = self.places_m(maps.keys[row])
        rows = decode(maps.codes[row], place_m, maps.height_m[row], self.cell_m)
        return rows, torch.sigmoid(logits[row, kind].double()), kind, frame

    def boxes_on_device(self, rows: Tensor, score: Tensor, kind: Tensor, frame: Tensor, frames: int) -> list[Boxes]:
        """The boxes of each frame after suppression on their device; arguments as :meth:`peak_boxes` returns them."""
        boxes = []
        for number in range(frames):
            of_frame = (frame == number).nonzero().squeeze(1)
            best = of_frame[torch.sort(score[of_frame], descending=True, stable=True).indices[: self.config.candidates]]
            boxes.append(
                boxes_after_nms(
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


def peaks(logits: Tensor, keys: Tensor, shape: tuple[int, int], radius: int, table: Tensor | None = None) -> Tensor:
    """Where no occupied cell within ``radius`` steps is hotter, a class each, shape (n, classes), bool.

    Args:
        logits: Heat of each class, shape (n, classes).
        keys: The cells, shape (n,).
        shape: Cells of the map along x and y.
        radius: Steps.
        table: Rows of the cells within them, ``n`` for none, shape (n, k), int32; found where none is at hand.
    """
    side = range(-radius, radius + 1)
    if table is None:
        around = [(0, dx, dy) for dx, dy in product(side, side) if (dx, dy) != (0, 0)]
        table = neighbour_table(keys, keys, (1, *shape), around)
    padded = torch.cat([logits, logits.new_full((1, logits.shape[1]), -torch.inf)])
    if logits.is_cuda:
        return logits >= padded.index_select(0, table.view(-1)).view(*table.shape, -1).amax(1)
    best = torch.full_like(logits, -torch.inf)  # on a CPU the gathered rows of all steps would leave the cache
    for column in table.unbind(1):
        best = torch.maximum(best, padded[column])
    return logits >= best
