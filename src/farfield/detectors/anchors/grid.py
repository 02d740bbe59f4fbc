"""Anchors on a bird's-eye grid: where they stand, how boxes are expressed in them, and which are assigned to a box.

One anchor stands for one class and one of two headings (0 and 90 degrees), as in VoxelNet and its successors. All of
it is numpy and per frame, so that the loader's workers do it beside the training.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from pydantic import BaseModel, ConfigDict, Field, model_validator

from farfield.detectors.config import ALIKE, BoxWeights
from farfield.geometry.boxes import Boxes, wrap_angle_rad
from farfield.vocabulary.classes import CIRRUS_SIZES_M, UNSURE

HEADINGS_RAD = np.array([0.0, np.pi / 2])
DIRECTION_OFFSET_RAD = 0.78539  # OpenPCDet's DIR_OFFSET
SIZE_RATIOS = (0.02, 20.0)  # of a decoded box to its anchor


class AnchorConfig(BaseModel):
    """The anchor of one class."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    size_m: tuple[float, float, float] = Field(description="length, width, height")
    z_m: float = Field(description="height of the centre in the sensor's frame")
    positive_iou: float = Field(0.6, gt=0, le=1, description="with matching: iou, overlap from which it is positive")
    negative_iou: float = Field(0.45, ge=0, le=1, description="with matching: iou, overlap below which it is negative")

    @model_validator(mode="after")
    def _thresholds_in_order(self) -> "AnchorConfig":
        if self.negative_iou > self.positive_iou:
            raise ValueError(f"expected negative_iou up to positive_iou ({self.positive_iou}), got {self.negative_iou}")
        return self


def cirrus_anchors() -> dict[str, AnchorConfig]:
    """Anchors for the eight classes of Cirrus, sensor on the roof (ground near z = -2 m)."""
    return {name: AnchorConfig(size_m=size, z_m=size[2] / 2 - 2.0) for name, size in CIRRUS_SIZES_M.items()}


@dataclass(frozen=True, eq=False)
class AnchorTargets:
    """The targets of a frame; indices count anchors of that frame.

    Args:
        positive: Anchors that are assigned to a box, shape (p,).
        code: Encoded box of each positive anchor, shape (p, 7).
        backwards: Which of two directions the box looks: 1 for against its anchor's heading, shape (p,).
        ignored: Anchors that count neither as positive nor as negative, shape (i,).
        weight: Weight of each positive anchor in the loss, shape (p,).
    """

    positive: Int[np.ndarray, " p"]
    code: Float[np.ndarray, "p 7"]
    backwards: Int[np.ndarray, " p"]
    ignored: Int[np.ndarray, " i"]
    weight: Float[np.ndarray, " p"]

    def ignoring(self, unsure: "AnchorTargets") -> "AnchorTargets":
        """These targets, where what is assigned to unsure boxes, or ignored for them, is neither object nor background.

        Args:
            unsure: The targets of the unsure boxes.
        """
        return self.ignoring_anchors(np.concatenate([unsure.positive, unsure.ignored]))

    def ignoring_anchors(self, anchors: Int[np.ndarray, " k"]) -> "AnchorTargets":
        """These targets, where some anchors are neither object nor background unless they are assigned to a box."""
        return replace(self, ignored=np.setdiff1d(np.concatenate([self.ignored, anchors]), self.positive))


class AnchorGrid:
    """Anchors of several classes at every cell of a grid; flat index ((ix * ny + iy) * classes + class) * 2 + heading.

    Args:
        classes: Class names with their anchors.
        nx: Cells along x.
        ny: Cells along y.
        cell_m: Edge length of a cell.
        y_min_m: Right edge of the grid.
        x_min_m: Near edge of the grid.
        style: ``"farfield"``: anchors at the centres of cells, and directions that count from the anchor's heading.
            ``"openpcdet"``: anchors spread from edge to edge, at 0 and 1.57 rad, and directions that count from a
            fixed heading of 0.78539 rad: what imported weights expect.
    """

    def __init__(
        self,
        classes: dict[str, AnchorConfig],
        *,
        nx: int,
        ny: int,
        cell_m: float,
        y_min_m: float,
        x_min_m: float = 0.0,
        style: Literal["farfield", "openpcdet"] = "farfield",
    ) -> None:
        self.classes, self.names, self.style = classes, tuple(classes), style
        self.sizes_m = np.array([anchor.size_m for anchor in classes.values()], dtype=np.float64)
        self.z_m = np.array([anchor.z_m for anchor in classes.values()], dtype=np.float64)
        self.nx, self.ny, self.cell_m, self.x_min_m, self.y_min_m = nx, ny, cell_m, x_min_m, y_min_m
        self.per_cell = 2 * len(self.names)
        if style == "farfield":
            self.headings_rad, self.step_m = HEADINGS_RAD, np.array([cell_m, cell_m])
            self.first_m = np.array([x_min_m + cell_m / 2, y_min_m + cell_m / 2])
        else:
            self.headings_rad, self.first_m = np.array([0.0, 1.57]), np.array([x_min_m, y_min_m])
            self.step_m = cell_m * np.array([nx / max(nx - 1, 1), ny / max(ny - 1, 1)])

    def __len__(self) -> int:
        return self.nx * self.ny * self.per_cell

    def styled(self, style: Literal["farfield", "openpcdet"]) -> "AnchorGrid":
        """The same grid with anchors in another style."""
        size, (x_m, y_m) = {"nx": self.nx, "ny": self.ny}, (self.x_min_m, self.y_min_m)
        return AnchorGrid(self.classes, **size, cell_m=self.cell_m, x_min_m=x_m, y_min_m=y_m, style=style)

    def rows(self, index: Int[np.ndarray, " k"]) -> Float[np.ndarray, "k 7"]:
        """The anchors with these flat indices as x, y, z, l, w, h, yaw, shape (k, 7)."""
        cell, slot = np.divmod(index, self.per_cell)
        kind, heading = np.divmod(slot, 2)
        ix, iy = np.divmod(cell, self.ny)
        x, y = ix * self.step_m[0] + self.first_m[0], iy * self.step_m[1] + self.first_m[1]
        return np.column_stack([x, y, self.z_m[kind], self.sizes_m[kind], self.headings_rad[heading]])

    def labels(self, index: Int[np.ndarray, " k"]) -> np.ndarray:
        """Class names of the anchors with these flat indices, shape (k,)."""
        return np.array(self.names, dtype=np.str_)[index % self.per_cell // 2]

    def kinds(self, boxes: Boxes) -> Int[np.ndarray, " n"]:
        """Number of each box's class, -1 for those that have no anchor, shape (n,)."""
        number = {name: index for index, name in enumerate(self.names)}
        return np.array([number.get(str(name), -1) for name in boxes.label], dtype=np.int64)

    def inside(self, boxes: Boxes) -> Int[np.ndarray, " k"]:
        """Flat indices of all anchors whose cell reaches into one of the boxes, seen from above, shape (k,)."""
        x = self.step_m[0] * np.arange(self.nx) + self.first_m[0]
        y = self.step_m[1] * np.arange(self.ny) + self.first_m[1]
        cells = [np.zeros(0, dtype=np.int64)]
        for centre, size, yaw in zip(boxes.centre_m, boxes.size_m, boxes.yaw_rad, strict=True):
            half = size[:2] / 2 + self.step_m.max() / 2
            reach = np.hypot(*half)
            ix, iy = np.flatnonzero(np.abs(x - centre[0]) <= reach), np.flatnonzero(np.abs(y - centre[1]) <= reach)
            away_x, away_y = x[ix, None] - centre[0], y[None, iy] - centre[1]
            along = np.abs(away_x * np.cos(yaw) + away_y * np.sin(yaw))
            across = np.abs(away_y * np.cos(yaw) - away_x * np.sin(yaw))
            row, column = np.nonzero((along <= half[0]) & (across <= half[1]))
            cells.append(ix[row] * self.ny + iy[column])
        return (np.unique(np.concatenate(cells))[:, None] * self.per_cell + np.arange(self.per_cell)).ravel()

    def targets(
        self,
        boxes: Boxes,
        winner: Int[np.ndarray, " p"],
        positive: Int[np.ndarray, " p"],
        ignored: Int[np.ndarray, " i"],
        weights: Float[np.ndarray, " n"] | None,
    ) -> AnchorTargets:
        """Targets of a frame whose anchors ``positive`` are assigned to the boxes ``winner``."""
        code, direction = encode(boxes[winner], self.rows(positive))
        if self.style == "openpcdet":
            direction = _fixed_direction(boxes.yaw_rad[winner])
        weight = np.ones(len(positive)) if weights is None else weights[winner]
        return AnchorTargets(positive, code, direction, ignored, weight)

    def decode(
        self, code: Float[np.ndarray, "k 7"], direction: Int[np.ndarray, " k"], index: Int[np.ndarray, " k"]
    ) -> Float[np.ndarray, "k 7"]:
        """Boxes of codes and directions at the anchors with these flat indices, rows x, y, z, l, w, h, yaw."""
        if self.style == "farfield":
            return decode(code, direction, self.rows(index))
        rows = decode(code, np.zeros_like(direction), self.rows(index))
        rows[:, 6] = wrap_angle_rad(rows[:, 6] + np.pi * (_fixed_direction(rows[:, 6]) != direction))
        return rows

    def assign(
        self, boxes: Boxes, *, positive_m: float, ignore_m: float, weights: Float[np.ndarray, " n"] | None = None
    ) -> AnchorTargets:
        """Assign anchors to each box, by the distance of their cell from the box's centre.

        The nearest cell and all within ``positive_m`` are positive; others within ``ignore_m`` are ignored. Overlap,
        the published criterion, fails on boxes of visible parts (Cirrus): a car's rear of 0.3 x 1.9 m overlaps no
        anchor. A cell near two boxes is assigned to the nearer one. Of an anchor's two headings the closer one is
        positive, and the other is ignored. Boxes of classes that have no anchor, or with centres off the grid, have no
        targets.

        Args:
            boxes: Annotated boxes in the sensor's frame.
            positive_m: Radius within which a cell is positive.
            ignore_m: Radius within which a cell is never negative.
            weights: Weight of each box in the loss, shape (n,); 1 if left out.
        """
        kind = self.kinds(boxes)
        column, row = np.floor((boxes.centre_m[:, :2] - self.first_m) / self.step_m + 0.5).astype(np.int64).T
        in_grid = np.flatnonzero((kind >= 0) & (column >= 0) & (column < self.nx) & (row >= 0) & (row < self.ny))
        radius_cells = int(np.ceil(ignore_m / self.step_m.min()))
        step_x, step_y = (
            s.ravel() for s in np.meshgrid(*[np.arange(-radius_cells, radius_cells + 1)] * 2, indexing="ij")
        )
        ix, iy = column[in_grid, None] + step_x, row[in_grid, None] + step_y
        centre_x, centre_y = ix * self.step_m[0] + self.first_m[0], iy * self.step_m[1] + self.first_m[1]
        gap = np.hypot(centre_x - boxes.centre_m[in_grid, 0, None], centre_y - boxes.centre_m[in_grid, 1, None])
        gap[(ix < 0) | (ix >= self.nx) | (iy < 0) | (iy >= self.ny)] = np.inf
        turned = (
            np.abs(wrap_angle_rad(2 * boxes.yaw_rad[in_grid])) > np.pi / 2
        )  # nearer to 90 than to 0 degrees, mod 180
        base = ((ix * self.ny + iy) * len(self.names) + kind[in_grid, None]) * 2
        assigned = (gap <= positive_m) | ((gap == gap.min(axis=1, initial=np.inf, keepdims=True)) & np.isfinite(gap))
        box_of, where = np.nonzero(assigned)
        positive = base[box_of, where] + turned[box_of]
        order = np.argsort(gap[box_of, where], kind="stable")
        positive, first = np.unique(positive[order], return_index=True)
        winner = in_grid[box_of[order][first]]
        near_box, near_where = np.nonzero(gap <= ignore_m)
        near = base[near_box, near_where]
        ignored = np.setdiff1d(np.concatenate([near, near + 1, positive ^ 1]), positive)
        return self.targets(boxes, winner, positive, ignored, weights)


def _fixed_direction(yaw_rad: Float[np.ndarray, " k"]) -> Int[np.ndarray, " k"]:
    """0 for headings within the half turn that begins at the fixed heading, else 1."""
    return (np.mod(yaw_rad - DIRECTION_OFFSET_RAD, 2 * np.pi) >= np.pi).astype(np.int64)


def encode(boxes: Boxes, anchors: Float[np.ndarray, "k 7"]) -> tuple[Float[np.ndarray, "k 7"], Int[np.ndarray, " k"]]:
    """Express boxes in anchors (VoxelNet, equation 1; SECOND, section 3.2).

    Returns:
        Codes, shape (k, 7): centre offsets over the anchor's diagonal (its height for z), logarithms of the size
        ratios, and the heading residual modulo pi in [-pi/2, pi/2); and 1 for boxes that look backwards, shape (k,).
    """
    diagonal = np.hypot(anchors[:, 3], anchors[:, 4])
    offset = (boxes.centre_m - anchors[:, :3]) / np.column_stack([diagonal, diagonal, anchors[:, 5]])
    turn = wrap_angle_rad(boxes.yaw_rad - anchors[:, 6])
    backwards = np.abs(turn) > np.pi / 2
    residual = np.where(backwards, wrap_angle_rad(turn + np.pi), turn)
    return np.column_stack([offset, np.log(boxes.size_m / anchors[:, 3:6]), residual]), backwards.astype(np.int64)


def decode(
    code: Float[np.ndarray, "k 7"], backwards: Int[np.ndarray, " k"], anchors: Float[np.ndarray, "k 7"]
) -> Float[np.ndarray, "k 7"]:
    """Invert :func:`encode`: rows x, y, z, l, w, h, yaw, shape (k, 7). Sizes are kept within 1/50 to 20 anchors."""
    diagonal = np.hypot(anchors[:, 3], anchors[:, 4])
    centre = code[:, :3] * np.column_stack([diagonal, diagonal, anchors[:, 5]]) + anchors[:, :3]
    size = np.exp(np.clip(code[:, 3:6], *np.log(SIZE_RATIOS))) * anchors[:, 3:6]
    half_turns = np.round(code[:, 6] / np.pi * (1 - 1e-9))  # an encoded residual of exactly pi/2 is not wrapped
    residual = code[:, 6] - np.pi * half_turns
    return np.column_stack([centre, size, wrap_angle_rad(anchors[:, 6] + residual + np.pi * backwards)])


# Which anchors are assigned to a box by overlap, the published criterion (VoxelNet, section 3.1; SECOND, section
# 3.2).
#
# For boxes of whole objects, as in KITTI. Overlap is that of rectangles along the axes in bird's-eye view: headings
# are taken as 0 or 90 degrees, whichever is nearer.


def match_by_overlap(
    grid: AnchorGrid, boxes: Boxes, *, weights: Float[np.ndarray, " n"] | None = None
) -> AnchorTargets:
    """Assign anchors to each box, by their overlap with it.

    Anchors of the box's class are positive from ``positive_iou`` on, and so are those that overlap it most; those below
    ``negative_iou`` are negative, those between are ignored. An anchor that two boxes claim is assigned to the one that
    it overlaps more. Boxes of classes that have no anchor, or beside the grid, have no targets.

    Args:
        grid: The anchors.
        boxes: Annotated boxes in the sensor's frame.
        weights: Weight of each box in the loss, shape (n,); 1 if left out.
    """
    kinds = grid.kinds(boxes)
    pairs = [_overlaps(grid, boxes, np.flatnonzero(kinds == kind), kind) for kind in range(len(grid.names))]
    box, anchor, iou = (np.concatenate(part) for part in zip(*pairs, strict=True))
    most = np.zeros(len(boxes))
    np.maximum.at(most, box, iou)
    order = np.lexsort((-iou, anchor))
    anchors, first = np.unique(anchor[order], return_index=True)
    winner, best = box[order][first], iou[order][first]
    limits = np.array([[anchor.positive_iou, anchor.negative_iou] for anchor in grid.classes.values()])
    positive_iou, negative_iou = limits[kinds[winner]].T
    forced = np.isin(anchors, anchor[iou == most[box]])
    positive = (best >= positive_iou) | forced
    ignored = ~positive & (best >= negative_iou)
    return grid.targets(boxes, winner[positive], anchors[positive], anchors[ignored], weights)


def _overlaps(
    grid: AnchorGrid, boxes: Boxes, chosen: Int[np.ndarray, " m"], kind: int
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """All pairs of the chosen boxes and the anchors of a class that overlap: box, flat anchor index, IoU."""
    across = np.abs(wrap_angle_rad(2 * boxes.yaw_rad[chosen])) > np.pi / 2  # nearer to 90 than to 0 degrees, either way
    half_box = _half_m(boxes.size_m[chosen, :2], across)
    half_anchor = _half_m(np.tile(grid.sizes_m[kind, :2], (2, 1)), np.array([False, True]))
    radius_cells = np.ceil((half_box.max(axis=0, initial=0.0) + half_anchor.max(axis=0)) / grid.step_m).astype(np.int64)
    radius_cells = np.minimum(radius_cells, [grid.nx, grid.ny])
    nearest = np.round((boxes.centre_m[chosen, :2] - grid.first_m) / grid.step_m).astype(np.int64)
    steps = np.stack(np.meshgrid(*(np.arange(-r, r + 1) for r in radius_cells), indexing="ij"), axis=-1).reshape(-1, 2)
    cell = nearest[:, None] + steps
    gap = np.abs(cell * grid.step_m + grid.first_m - boxes.centre_m[chosen, None, :2])[:, :, None]
    shared = np.minimum(
        half_box[:, None, None] + half_anchor - gap, 2 * np.minimum(half_box[:, None, None], half_anchor)
    )
    inter = np.clip(shared, 0.0, None).prod(axis=-1)
    areas = 4 * (half_box.prod(axis=-1)[:, None, None] + half_anchor.prod(axis=-1))
    iou = inter / (areas - inter)
    inside = ((cell >= 0) & (cell < [grid.nx, grid.ny])).all(axis=-1)
    row, step, heading = np.nonzero((iou > 0) & inside[:, :, None])
    ix, iy = cell[row, step].T
    anchor = ((ix * grid.ny + iy) * len(grid.names) + kind) * 2 + heading
    return chosen[row], anchor, iou[row, step, heading]


def _half_m(size_m: Float[np.ndarray, "n 2"], across: Bool[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
    """Half extents along x and y."""
    return np.where(across[:, None], size_m[:, ::-1], size_m) / 2


# Targets of anchors from a frame's annotation: numpy alone, so that it travels to the loader's workers.


@dataclass(frozen=True, eq=False, kw_only=True)
class AnchorAssigner:
    """Assigns anchors to a frame's boxes.

    Args:
        grid: The anchors.
        matching: By the distance of their cells from a box's centre, or by overlap with it.
        positive_m: With ``"distance"``, cells this near to a centre are positive.
        ignore_m: With ``"distance"``, cells this near are ignored where they are not positive.
        weights: Weight of a box in the loss.
    """

    grid: AnchorGrid
    matching: Literal["distance", "iou"] = "distance"
    positive_m: float = 1.0
    ignore_m: float = 2.0
    weights: BoxWeights = ALIKE

    def __call__(self, boxes: Boxes, inputs: Mapping[str, np.ndarray]) -> AnchorTargets:
        """Targets of one frame: anchors in boxes of the class ``unsure`` are ignored where no box has them."""
        unsure = np.asarray(boxes.label) == UNSURE
        objects = boxes[~unsure]
        weights = self.weights(objects, inputs)
        if self.matching == "iou":
            targets = match_by_overlap(self.grid, objects, weights=weights)
        else:
            targets = self.grid.assign(objects, positive_m=self.positive_m, ignore_m=self.ignore_m, weights=weights)
        return targets.ignoring_anchors(self.grid.inside(boxes[unsure])) if unsure.any() else targets
