"""Which anchors are assigned to a box by overlap, the published criterion (VoxelNet, section 3.1; SECOND, section 3.2).

For boxes of whole objects, as in KITTI. Overlap is that of rectangles along the axes in bird's-eye view: headings are
taken as 0 or 90 degrees, whichever is nearer.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.detectors.anchors.grid import AnchorGrid, AnchorTargets
from farfield.geometry.boxes import Boxes, wrap_angle_rad


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
    half_box = _half_m(boxes.size_m[chosen, :2], _lies_across(boxes.yaw_rad[chosen]))
    half_anchor = _half_m(np.tile(grid.sizes_m[kind, :2], (2, 1)), np.array([False, True]))
    reach = np.ceil((half_box.max(axis=0, initial=0.0) + half_anchor.max(axis=0)) / grid.step_m).astype(np.int64)
    reach = np.minimum(reach, [grid.nx, grid.ny])
    nearest = np.round((boxes.centre_m[chosen, :2] - grid.first_m) / grid.step_m).astype(np.int64)
    steps = np.stack(np.meshgrid(*(np.arange(-r, r + 1) for r in reach), indexing="ij"), axis=-1).reshape(-1, 2)
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


def _lies_across(yaw_rad: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Whether a heading is nearer to 90 than to 0 degrees, either way."""
    return np.abs(wrap_angle_rad(2 * yaw_rad)) > np.pi / 2


def _half_m(size_m: Float[np.ndarray, "n 2"], across: Bool[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
    """Half extents along x and y."""
    return np.where(across[:, None], size_m[:, ::-1], size_m) / 2
