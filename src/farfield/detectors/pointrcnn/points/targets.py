"""Which point belongs to which annotated box: what the first stage of a point-based detector learns."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float32, Int
from torch import Tensor

from farfield.detectors.contract import range_weights
from farfield.geometry.boxes import Boxes
from farfield.geometry.points import points_in_boxes

BACKGROUND, UNSURE = -1, -2


@dataclass(frozen=True, eq=False)
class PointTargets:
    """The targets of a frame.

    Args:
        rows: Annotated boxes x, y, z, length, width, height, yaw, shape (k, 7).
        kind: Class number of each, shape (k,).
        weight: Weight of each in the loss, shape (k,).
        owner: Box that each point of the cloud lies in, -1 for background, -2 just outside a box, shape (n,).
    """

    rows: Float32[np.ndarray, "k 7"]
    kind: Int[np.ndarray, " k"]
    weight: Float[np.ndarray, " k"]
    owner: Int[np.ndarray, " n"]


@dataclass(frozen=True, eq=False, kw_only=True)
class PointAssigner:
    """Assigns the points of a frame to its boxes.

    Args:
        class_names: Names by class number.
        margin_m: Boxes grow by this before they claim points.
        unsure_m: Points this far outside count neither as box nor as background.
        far_weight: Extra weight of a box per 100 m of range.
    """

    class_names: tuple[str, ...]
    margin_m: float
    unsure_m: float
    far_weight: float = 0.0

    def __call__(self, boxes: Boxes, inputs: Mapping[str, np.ndarray]) -> PointTargets:
        """Targets of one frame, from its points."""
        weight = range_weights(boxes, self.far_weight)
        margins = {"margin_m": self.margin_m, "unsure_m": self.unsure_m}
        return assign_points(boxes, inputs["points"], self.class_names, weight=weight, **margins)


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
        owner[inside] = UNSURE
    claimed = points_in_boxes(points[:, :3], boxes, margin_m=margin_m)
    for index in largest_first:
        owner[claimed[index]] = index
    kind = np.array([list(class_names).index(str(name)) for name in boxes.label], dtype=np.int64)
    rows = np.column_stack([boxes.centre_m, boxes.size_m, boxes.yaw_rad]).astype(np.float32)
    return PointTargets(rows, kind, weight, owner)


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
