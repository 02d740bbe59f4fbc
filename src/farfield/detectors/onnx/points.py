"""What the exported PointRCNN reads, in numpy: points by budgets, farthest points, neighbourhoods, points of proposals.

Each function does what the one of its name in :mod:`farfield.detectors.pointrcnn.points` does in PyTorch, for one
frame. Needs no torch.
"""

from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal

import numpy as np
from jaxtyping import Float, Float32, Int
from pydantic import Field
from scipy.spatial import cKDTree

from farfield.detectors.onnx.cells import in_float32
from farfield.detectors.onnx.readings import DecodedBoxes, Reading, Run, Tensors, described
from farfield.detectors.suppression import rotated_nms
from farfield.files.yaml_text import PlainSettings
from farfield.geometry.boxes import Boxes

_SLACK = 1.0001  # a search in float64 is a little wider; float32 decides, as in PyTorch


def share_budget(available: Int[np.ndarray, " b"], shares: Sequence[float], budget: int) -> Int[np.ndarray, " b"]:
    """Split a budget among bands by their shares; none gets more than it has, and the rest goes to the others.

    Args:
        available: Items in each band.
        shares: Weight of each band, positive.
        budget: Items to choose altogether.

    Returns:
        Items to take from each band; they sum to the budget or to all that is available.
    """
    granted = np.zeros(len(available), dtype=np.int64)
    weight = np.asarray(shares, dtype=np.float64)
    left = min(int(budget), int(available.sum()))
    while left > 0:
        open_bands = np.flatnonzero(granted < available)
        part = np.floor(left * weight[open_bands] / weight[open_bands].sum()).astype(np.int64)
        if not part.any():
            part[np.argsort(-weight[open_bands], kind="stable")[:left]] = 1
        part = np.minimum(part, (available - granted)[open_bands])
        granted[open_bands] += part
        left -= int(part.sum())
    return granted


def farthest_of_one(xyz: Float32[np.ndarray, "n 3"], count: int) -> Int[np.ndarray, " k"]:
    """Farthest point sampling of one frame, exact, beginning with its first point.

    With the points sorted along an axis, a chosen point changes one stretch of them only: no distance is above the
    radius of the last choice, so points farther along the axis keep theirs.

    Args:
        xyz: Points, finite.
        count: Points to choose at most.
    """
    count = min(count, len(xyz))
    if not count:
        return np.zeros(0, dtype=np.int64)
    axis = int(np.ptp(xyz, axis=0).argmax())
    order = np.argsort(xyz[:, axis], kind="stable")
    columns = np.ascontiguousarray(xyz[order].T)
    along = columns[axis].astype(np.float64)
    gap2 = np.full(len(xyz), np.inf, dtype=np.float32)
    spare = np.empty((2, len(xyz)), dtype=np.float32)
    chosen = np.empty(count, dtype=np.int64)
    current, low, high = int(np.flatnonzero(order == 0)[0]), 0, len(xyz)
    for step in range(count):
        chosen[step] = current
        total, term = spare[0, low:high], spare[1, low:high]
        for column, out in zip(columns, (total, term, term), strict=True):
            np.subtract(column[low:high], column[current], out=out)
            np.multiply(out, out, out=out)
            if out is term:
                np.add(total, term, out=total)
        np.minimum(gap2[low:high], total, out=gap2[low:high])
        current = int(gap2.argmax())
        reach = float(gap2[current]) ** 0.5 * 1.0001 + 1e-6
        low, high = along.searchsorted((along[current] - reach, along[current] + reach))
    return order[chosen]


def content_rank(points: Float32[np.ndarray, "n c"]) -> Int[np.ndarray, " n"]:
    """A pseudo-random number in [0, 2^31) for each point that depends on its coordinates alone, shape (n,), int64."""
    bits = np.ascontiguousarray(points[:, :3], dtype=np.float32).view(np.uint32).astype(np.uint64)
    factors = np.array([73856093, 19349663, 83492791], dtype=np.uint64)
    mixed, low = np.bitwise_xor.reduce(bits * factors, axis=1), np.uint64(0xFFFFFFFF)
    for _ in range(2):
        mixed = ((mixed ^ (mixed >> np.uint64(16))) & low) * np.uint64(0x85EBCA6B) & low
    return ((mixed ^ (mixed >> np.uint64(13))) & np.uint64(0x7FFFFFFF)).astype(np.int64)


def first_of_bands(band: Int[np.ndarray, " n"], shares: Sequence[float], budget: int) -> Int[np.ndarray, " k"]:
    """Rows of the items that are among the first of their band and within its budget, ascending."""
    by_band = np.argsort(band, kind="stable")
    edges = np.searchsorted(band[by_band], np.arange(len(shares) + 1))
    granted = share_budget(np.diff(edges), shares, budget)
    return np.sort(np.concatenate([by_band[start : start + size] for start, size in zip(edges, granted, strict=False)]))


def spread_points(xyz: Float32[np.ndarray, "n 3"], count: int, finest_m: float = 0.1) -> Int[np.ndarray, " k"]:
    """One point a voxel, from coarse voxels to fine ones."""
    if not len(xyz):
        return np.zeros(0, dtype=np.int64)
    cell = np.floor((xyz - xyz.min(0)) / np.float32(finest_m)).astype(np.int64)
    levels = max(int(cell.max()).bit_length(), 1)
    rank = np.full(len(xyz), levels + 1)
    for level in range(levels + 1):
        _, first = np.unique(cell >> level, axis=0, return_index=True)
        rank[first] = levels - level
    return np.argsort(rank, kind="stable")[:count]


def ball_query(
    points: Float32[np.ndarray, "n 3"], centres: Float32[np.ndarray, "m 3"], radius_m: float, limit: int
) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
    """Pairs of a centre and one of the first ``limit`` points, by row, within a radius of it, sorted."""
    if not len(points) or not len(centres):
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    tree = cKDTree(centres)
    pairs = tree.sparse_distance_matrix(cKDTree(points), radius_m * _SLACK, output_type="ndarray")
    centre, point = pairs["i"].astype(np.int64), pairs["j"].astype(np.int64)
    gap2 = np.square(points[point] - centres[centre]).sum(1)
    near = gap2 <= np.float32(radius_m * radius_m)
    return _first_pairs(centre[near] * len(points) + point[near], len(points), limit)


def _first_pairs(keys: np.ndarray, points: int, limit: int) -> tuple[np.ndarray, np.ndarray]:
    keys = np.sort(keys)
    centre = keys // max(points, 1)
    early = np.ones(len(keys), dtype=np.bool_)
    early[limit:] = centre[limit:] != centre[:-limit]
    return centre[early], keys[early] - centre[early] * points


def three_nearest(
    queries: Float32[np.ndarray, "n 3"], sources: Float32[np.ndarray, "m 3"]
) -> tuple[Int[np.ndarray, "n 3"], Float32[np.ndarray, "n 3"]]:
    """The three nearest sources and their weights by inverse distance; a source that is missing weighs nothing."""
    if not len(queries) or not len(sources):
        return np.zeros((len(queries), 3), dtype=np.int64), np.zeros((len(queries), 3), dtype=np.float32)
    gap, row = cKDTree(sources).query(queries, k=[1, 2, 3])
    gap = np.asarray(gap)
    row = np.where(np.isfinite(gap), row, 0)
    weight = 1 / (gap.astype(np.float32) + np.float32(1e-8))
    return row, in_float32(weight / np.maximum(weight.sum(1, keepdims=True), np.float32(1e-30)))


def in_roi_frames(points: Float32[np.ndarray, "p 3"], rois: Float32[np.ndarray, "p 7"]) -> Float32[np.ndarray, "p 3"]:
    """Points as seen from RoIs, x along the heading."""
    dx, dy, dz = (points - rois[:, :3]).T
    cos, sin = np.cos(rois[:, 6]), np.sin(rois[:, 6])
    return np.stack([dx * cos + dy * sin, dy * cos - dx * sin, dz], 1)


def points_in_rois(
    points: Float32[np.ndarray, "n 3"], rois: Float32[np.ndarray, "m 7"], context_m: float, limit: int
) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
    """Pairs of a RoI, grown at every face, and one of its first ``limit`` points, by row."""
    half = rois[:, 3:6] / 2 + np.float32(context_m)
    radius_m = np.hypot(half[:, 0], half[:, 1]) * 1.0001 + 1e-3
    near = cKDTree(points[:, :2]).query_ball_point(rois[:, :2], radius_m)
    roi = np.repeat(np.arange(len(rois)), [len(rows) for rows in near])
    point = np.concatenate([np.zeros(0, dtype=np.int64), *[np.asarray(rows, dtype=np.int64) for rows in near]])
    inside = (np.abs(in_roi_frames(points[point], rois[roi])) <= half[roi]).all(1)
    return _first_pairs(roi[inside] * len(points) + point[inside], len(points), limit)


class Bands(PlainSettings):
    """Bands of range and the share of a budget that each gets first."""

    edges_m: tuple[float, ...] = Field(min_length=2, max_length=33)
    shares: tuple[Annotated[float, Field(gt=0)], ...] = Field(min_length=1, max_length=32)

    def of(self, xy: Float[np.ndarray, "n c"]) -> Int[np.ndarray, " n"]:
        """Band of each row x, y, ...; the outermost ones also take what lies beyond their edges."""
        inner = np.array(self.edges_m[1:-1], dtype=xy.dtype)
        return np.searchsorted(inner, np.hypot(xy[:, 0], xy[:, 1]), side="right")


class PointLevel(PlainSettings):
    """A set abstraction: its centres, and the neighbourhoods around each."""

    centres: int = Field(ge=1, le=65536)
    radii_m: tuple[Annotated[float, Field(gt=0)], ...] = Field(min_length=1, max_length=8)
    limits: tuple[Annotated[int, Field(ge=1, le=4096)], ...] = Field(min_length=1, max_length=8)


class PointReading(Reading):
    """Points by budgets of range; both stages' neighbourhoods, and the proposals between them."""

    kind: Literal["points"] = "points"
    range_m: float = Field(gt=0)
    half_width_m: float = Field(gt=0)
    z_min_m: float
    z_max_m: float
    read: tuple[Literal["intensity", "lag", "height", "range"], ...]
    points: int = Field(ge=1, le=1 << 20)
    bands: Bands
    sampling: Literal["fps", "voxel"]
    levels: tuple[PointLevel, ...] = Field(min_length=1, max_length=8)
    candidates: int = Field(ge=1, le=65536)
    threshold: float = Field(ge=0, le=1)
    proposal_iou: float = Field(ge=0, le=1)
    proposals: int = Field(ge=1, le=4096)
    proposal_bands: Bands
    context_m: float = Field(ge=0)
    roi_points: int = Field(ge=1, le=4096)
    roi_levels: tuple[PointLevel, ...] = Field(max_length=8)

    def chosen(self, points: Float32[np.ndarray, "n c"]) -> Float32[np.ndarray, "k c"]:
        """The points that the network reads, in pseudo-random order."""
        x, y, z = points[:, :3].T
        inside = (x >= 0) & (x < self.range_m) & (np.abs(y) < self.half_width_m)
        points = points[inside & (z >= self.z_min_m) & (z < self.z_max_m)]
        points = points[np.argsort(content_rank(points), kind="stable")]
        if len(points) > self.points:
            points = points[first_of_bands(self.bands.of(points), self.bands.shares, self.points)]
        return points

    def inputs(self, points: Float32[np.ndarray, "n c"]) -> dict[str, np.ndarray]:
        """``xyz`` and ``features`` of the chosen points; each level's centres, neighbourhoods and nearest ones."""
        points = self.chosen(points)
        columns = {"intensity": "intensity", "lag": "lag_s"}
        values = {name: points[:, self.columns.index(at)] for name, at in columns.items() if at in self.columns}
        values["height"] = points[:, 2] / np.float32(self.z_max_m)
        values["range"] = np.hypot(points[:, 0], points[:, 1]) / np.float32(100.0)
        features = [values[name] for name in self.read]
        xyz = np.ascontiguousarray(points[:, :3])
        tensors = {"xyz": xyz, "features": in_float32(np.stack(features, 1)) if features else xyz[:, :0]}
        sample = farthest_of_one if self.sampling == "fps" else spread_points
        levels = [xyz]
        for number, level in enumerate(self.levels, 1):
            rows = sample(xyz, level.centres) if number == 1 else np.arange(min(level.centres, len(levels[-1])))
            tensors |= self._groups(f"{number}", levels[-1], rows, level)
            levels.append(levels[-1][rows])
        for number in range(len(self.levels), 0, -1):
            near, weight = three_nearest(levels[number - 1], levels[number])
            tensors |= {f"near_{number}": near, f"weight_{number}": weight}
        return tensors

    def _groups(self, name: str, xyz: np.ndarray, rows: np.ndarray, level: PointLevel) -> dict[str, np.ndarray]:
        tensors = {f"chosen_{name}": rows}
        for scale, (radius_m, limit) in enumerate(zip(level.radii_m, level.limits, strict=True)):
            centre, point = ball_query(xyz, xyz[rows], radius_m, limit)
            tensors |= {f"centre_{name}_{scale}": centre, f"point_{name}_{scale}": point}
        return tensors

    results: ClassVar[tuple[str, ...]] = ("semantic_out", "foreground", "proposed", "confidence", "boxes")

    def blank(self) -> dict[str, tuple[str, tuple[int | None, ...]]]:
        """Number type and sides of the inputs of both stages."""
        point = np.zeros((1, len(self.columns)), dtype=np.float32)
        point[0, :3] = self.range_m / 2, 0.0, (self.z_min_m + self.z_max_m) / 2
        first = self.inputs(point)
        numbers = {"foreground": np.ones((1, 1)), "proposed": np.ones((1, 7)), "semantic_out": np.zeros((1, 1))}
        second = self.refined(first, {name: values.astype(np.float32) for name, values in numbers.items()})
        return described({**first, **second}, open_sides=("semantic", "extra"))

    def detect(self, points: Float32[np.ndarray, "n c"], run: Run, first: Tensors | None = None) -> DecodedBoxes:
        """Ask for proposals, choose among them, ask for boxes; none where there are no points or no proposals."""
        none = DecodedBoxes(np.zeros((0, 7)), np.zeros(0), np.zeros(0, dtype=np.int64))
        first = self.inputs(points) if first is None else first
        if not len(first["xyz"]):
            return none
        second = self.refined(first, run(first))
        if not len(second["proposals"]):
            return none
        return self.candidates_of(run(second))

    def candidates_of(self, outputs: Tensors) -> DecodedBoxes:
        """The refined boxes, each of its best class."""
        scores = outputs["confidence"].astype(np.float64)
        order = np.argsort(-scores.max(1), kind="stable")
        return DecodedBoxes(outputs["boxes"][order].astype(np.float64), scores.max(1)[order], scores.argmax(1)[order])

    def refined(self, first: Tensors, outputs: Tensors) -> dict[str, np.ndarray]:
        """What the second stage reads: the points of each proposal in its frame, and their neighbourhoods."""
        xyz, scores, proposed = first["xyz"], outputs["foreground"], outputs["proposed"]
        kind, score = scores.argmax(1), scores.max(1)
        order = np.argsort(-score, kind="stable")
        order = order[~(score[order] < np.float32(self.threshold))]
        rows = order[first_of_bands(self.proposal_bands.of(xyz[order]), self.proposal_bands.shares, self.candidates)]
        rows = rows[np.isfinite(proposed[rows]).all(1)]
        rows = rows[self._apart(proposed[rows])]
        rows = rows[first_of_bands(self.proposal_bands.of(proposed[rows]), self.proposal_bands.shares, self.proposals)]
        proposals = in_float32(proposed[rows])
        roi, point = points_in_rois(xyz, proposals, self.context_m, self.roi_points)
        local = in_float32(in_roi_frames(xyz[point], proposals[roi]))
        range_m = np.linalg.norm(xyz[point], axis=1)[:, None] / np.float32(100.0)
        extra = np.concatenate([proposals[roi][:, 3:6], range_m, scores[point]], 1)
        tensors = {"semantic": outputs["semantic_out"], "inside": point, "local": local, "extra": in_float32(extra)}
        tensors |= {"proposals": proposals, "kinds": kind[rows]}
        for number, level in enumerate(self.roi_levels, 1):
            chosen = farthest_of_groups(local, roi, level.centres)
            tensors |= {f"roi_chosen_{number}": chosen}
            for scale, (radius_m, limit) in enumerate(zip(level.radii_m, level.limits, strict=True)):
                centre, near = ball_query_of_groups(local, roi, chosen, radius_m, limit)
                tensors |= {f"roi_centre_{number}_{scale}": centre, f"roi_point_{number}_{scale}": near}
            local, roi = local[chosen], roi[chosen]
        return {**tensors, "owner": roi}

    def _apart(self, rows: np.ndarray) -> np.ndarray:
        """Which boxes, best first, no better one overlaps; ascending."""
        rows = rows.astype(np.float64)
        score = -np.arange(len(rows), dtype=np.float64)
        size = np.maximum(rows[:, 3:6], 1e-6)
        boxes = Boxes(centre_m=rows[:, :3], size_m=size, yaw_rad=rows[:, 6], label="", score=score)
        return rotated_nms(boxes, iou_threshold=self.proposal_iou, limit=len(rows))


def farthest_of_groups(
    points: Float32[np.ndarray, "n 3"], group: Int[np.ndarray, " n"], count: int
) -> Int[np.ndarray, " k"]:
    """Farthest points of each group, whose rows follow one another, group after group in the order of choice."""
    starts, lengths = np.unique(group, return_index=True, return_counts=True)[1:]
    if not len(starts):
        return np.zeros(0, dtype=np.int64)
    slot = np.arange(lengths.max())
    real = slot < lengths[:, None]
    padded = points[np.where(real, starts[:, None] + slot, 0)]
    gap2 = np.where(real, np.float32(np.inf), np.float32(-np.inf))
    current, lines = np.zeros(len(starts), dtype=np.int64), np.arange(len(starts))
    steps = min(count, int(lengths.max()))
    chosen = np.empty((len(starts), steps), dtype=np.int64)
    for step in range(steps):
        chosen[:, step] = current
        away = padded - padded[lines, current][:, None]
        gap2 = np.minimum(gap2, np.square(away[..., 0]) + np.square(away[..., 1]) + np.square(away[..., 2]))
        current = gap2.argmax(1)
    return (chosen + starts[:, None])[np.arange(steps) < lengths[:, None]]


def ball_query_of_groups(
    points: Float32[np.ndarray, "n 3"],
    group: Int[np.ndarray, " n"],
    chosen: Int[np.ndarray, " m"],
    radius_m: float,
    limit: int,
) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
    """:func:`ball_query` within each group: groups are laid far apart along x, in float64, for the search."""
    if not len(points):
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    apart = points.astype(np.float64)
    apart[:, 0] += group * (2 * float(np.ptp(points[:, 0])) + 4 * radius_m + 1)
    pairs = cKDTree(apart[chosen]).sparse_distance_matrix(cKDTree(apart), radius_m * _SLACK, output_type="ndarray")
    centre, point = pairs["i"].astype(np.int64), pairs["j"].astype(np.int64)
    near = np.square(points[point] - points[chosen[centre]]).sum(1) <= np.float32(radius_m * radius_m)
    return _first_pairs(centre[near] * len(points) + point[near], len(points), limit)
