"""Random changes to training frames: pasting objects, mirroring, turning, scaling, thinning.

numpy only, one generator; :func:`augment` is the whole of it.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from farfield.geometry.boxes import BOX_MARGIN_M, Boxes, count_points_in_boxes, points_in_boxes
from farfield.geometry.iou import pairwise_iou
from farfield.training.config import AugmentationConfig, SparseNear
from farfield.vocabulary.classes import CLUTTER, UNSURE

Points = Float32[np.ndarray, "_ _"]
Progress = Callable[[Iterable[int]], Iterable[int]]

SWEEP = 4
"""Index of the number of a point's sweep, 0 for the present one, among its columns: after x, y, z and its age.

The age does not tell it: sensors that fire at other times than the frame's, and points with times of their own, have
ages in the present sweep too.
"""

SAMPLES_PER_FRAME = 16
"""Samples after which one of the frames whose objects can be pasted makes way for another."""


# Objects cut out of training frames, to be pasted into others (SECOND, section 3.3.1)


def cut_out(points: Points, boxes: Boxes, *, min_points: int) -> "list[tuple[Points, Boxes]]":
    """Cut objects out of a frame: the points and the box of each that has ``min_points`` in the present sweep."""
    boxes = boxes.replace(score=None, track_id=None, point_count=None)
    inside = enumerate(points_in_boxes(points[:, :3], boxes))
    return [
        (points[rows].copy(), boxes[index])
        for index, rows in inside
        if np.count_nonzero(points[rows, SWEEP] == 0) >= min_points
    ]


@dataclass
class ObjectBank:
    """Objects to paste: the points and the box of each, by class."""

    objects: dict[str, list[tuple[Points, Boxes]]] = field(default_factory=dict)

    def add(self, cut: "Iterable[tuple[Points, Boxes]]") -> None:
        """Add what :func:`cut_out` gave."""
        for points, box in cut:
            self.objects.setdefault(str(box.label[0]), []).append((points, box))

    def paste(
        self,
        points: Points,
        boxes: Boxes,
        counts: dict[str, int],
        rng: np.random.Generator,
        *,
        bands_m: Sequence[float | int] = (),
    ) -> tuple[Points, Boxes]:
        """Add up to so many objects of each class, where they stood in their own frame.

        An object keeps its place, so its density and visible side stay right for its range. It is left out where it
        would touch a box of the frame; points of the frame inside its box are removed.

        Args:
            points: The frame's points.
            boxes: The frame's boxes.
            counts: How many of each class.
            rng: The only source of randomness.
            bands_m: Edges of range bands over which objects are drawn evenly; without them evenly over objects.
        """
        keep, added = np.ones(len(points), dtype=np.bool_), []
        for name, count in counts.items():
            pool = self.objects.get(name, [])
            range_m = np.array([float(np.hypot(*box.centre_m[0, :2])) for _, box in pool], dtype=np.float64)
            for index in draw(range_m, count, rng, bands_m=bands_m):
                new_points, new_box = pool[index]
                if len(boxes) and pairwise_iou(new_box, boxes, kind="bev").any():
                    continue
                keep[points_in_boxes(points[:, :3], new_box, margin_m=0.1)[0]] = False
                added.append(new_points)
                boxes = Boxes.concatenate([boxes, new_box])  # of clutter too, so that nothing else is pasted there
        boxes = boxes[np.asarray(boxes.label) != CLUTTER] if counts.get(CLUTTER) else boxes
        return np.concatenate([points[keep], *added]), boxes


def draw(
    range_m: Float[np.ndarray, " n"], count: int, rng: np.random.Generator, *, bands_m: Sequence[float | int] = ()
) -> Int[np.ndarray, " k"]:
    """Draw objects, each at most once.

    Args:
        range_m: Range of each object, shape (n,).
        count: How many to draw.
        rng: The only source of randomness.
        bands_m: Edges of range bands. Each draw takes a band that still holds objects, all with the same chance, then
            an object in it; objects outside the edges are never drawn.

    Returns:
        Indices of the objects, shape (k,), k <= count.
    """
    order = rng.permutation(len(range_m))
    if not bands_m:
        return order[:count]
    band = np.digitize(range_m[order], np.asarray(bands_m, dtype=np.float64))
    left = [order[band == number].tolist() for number in range(1, len(bands_m))]
    drawn: list[int] = []
    while len(drawn) < count and (left := [objects for objects in left if objects]):
        drawn.append(left[int(rng.integers(len(left)))].pop())
    return np.array(drawn, dtype=np.int64)


class RollingBank:
    """The objects that can be pasted at each position of the stream of samples, cut out of few frames at a time.

    Frames pass through the bank in the order of an endless stream of random epochs, so that a run starts after reading
    a few of them and has used all of them in the end. What the bank holds depends on the position alone.

    Args:
        cut: Cuts objects out of the frame of a number.
        order: The frame at a position of the endless stream.
        frames: Frames in the bank at a time.
    """

    def __init__(
        self, cut: "Callable[[int], list[tuple[Points, Boxes]]]", order: Callable[[int], int], frames: int
    ) -> None:
        self.cut, self.order, self.frames = cut, order, frames
        self._cut: dict[int, list[tuple[Points, Boxes]]] = {}
        self._bank, self._first = ObjectBank(), -1

    def at(self, position: int, progress: Progress = iter) -> ObjectBank:
        """The bank at a position; frames that it did not hold at the position before are read now."""
        first = position // SAMPLES_PER_FRAME
        if first != self._first:
            numbers = [self.order(position) for position in range(first, first + self.frames)]
            new = [number for number in dict.fromkeys(numbers) if number not in self._cut]
            read = {number: self.cut(number) for number in (progress(new) if new else ())}
            self._cut = {number: self._cut[number] if number in self._cut else read[number] for number in numbers}
            self._bank, self._first = ObjectBank(), first
            for number in numbers:
                self._bank.add(self._cut[number])
        return self._bank


# The changes of a frame


@dataclass(frozen=True, eq=False, kw_only=True)
class Augmentation:
    """One draw of a frame's random motion, to be applied alike to all that the frame holds.

    Args:
        mirror: Whether left and right change places.
        turn_rad: Turn about z, counter-clockwise.
        factor: Scale of the scene.
        rise_m: Height that is added.
    """

    mirror: bool
    turn_rad: float
    factor: float
    rise_m: float

    @property
    def linear(self) -> Float[np.ndarray, "3 3"]:
        """The motion without its rise: what a place is multiplied with, shape (3, 3)."""
        side = -1.0 if self.mirror else 1.0
        cos, sin = np.cos(self.turn_rad), np.sin(self.turn_rad)
        return self.factor * np.array([[cos, -sin * side, 0], [sin, cos * side, 0], [0, 0, 1]])

    def points(self, points: Points) -> Points:
        """The points moved; x, y and z stand first, further columns stay."""
        moved = points.copy()
        rise = np.array([0.0, 0.0, self.rise_m]).astype(np.float32)
        moved[:, :3] = points[:, :3] @ self.linear.T.astype(np.float32) + rise
        return moved

    def boxes(self, boxes: Boxes) -> Boxes:
        """The boxes moved, with their sizes, headings and velocities."""
        linear, side, velocity = self.linear, -1.0 if self.mirror else 1.0, boxes.velocity_m_s
        if velocity is not None:
            velocity = velocity @ linear[: velocity.shape[1], : velocity.shape[1]].T
        return boxes.replace(
            centre_m=boxes.centre_m @ linear.T + np.array([0.0, 0.0, self.rise_m]),
            size_m=boxes.size_m * self.factor,
            yaw_rad=boxes.yaw_rad * side + self.turn_rad,
            velocity_m_s=velocity,
        )


def draw_change(config: AugmentationConfig, rng: np.random.Generator) -> Augmentation:
    """Draw the motion of one frame."""
    return Augmentation(
        mirror=bool(rng.random() < config.flip_probability),
        turn_rad=rng.uniform(-config.rotation_rad, config.rotation_rad),
        factor=rng.uniform(1 - config.scale, 1 + config.scale),
        rise_m=rng.uniform(-config.height_m, config.height_m),
    )


def augment(
    points: Points,
    boxes: Boxes,
    config: AugmentationConfig,
    rng: np.random.Generator,
    bank: ObjectBank | None = None,
    weather: Callable[[Points, Boxes], tuple[Points, Boxes]] | None = None,
    intensity: int | None = None,
) -> tuple[Points, Boxes]:
    """Apply all random changes to one frame.

    Args:
        points: x, y, z (metres), lag (s), the number of the sweep and further columns, shape (n, 5 + k).
        boxes: Annotated boxes; they carry no scores, ids or counts afterwards.
        config: How much of each change.
        rng: The only source of randomness.
        bank: Objects to paste.
        weather: Lays the frame's weather over points and boxes, where the sensor measured them.
        intensity: Column of the points' intensity; None where they have none.

    Returns:
        New points and boxes.
    """
    boxes = boxes.replace(score=None, track_id=None, point_count=None)
    if bank is not None and config.pasted:
        points, boxes = bank.paste(points, boxes, config.pasted, rng, bands_m=config.pasted_bands_m)
    if weather is not None:
        points, boxes = weather(points, boxes)
    if config.object_scale:
        points, boxes = scale_objects(points, boxes, config.object_scale, rng)
    points, boxes = _as_another_sensor(points, boxes, config, rng, intensity)
    change = draw_change(config, rng)
    points, boxes = change.points(points), change.boxes(boxes)
    if config.thinning:
        points, boxes = _thinned(points, boxes, rng.random(len(points)) >= rng.uniform(0, config.thinning))
    if config.sparse_near is not None:
        points, boxes = _thinned(points, boxes, sparse_near(points, boxes, config.sparse_near, rng))
    return points, boxes


def scale_objects(points: Points, boxes: Boxes, most: float | int, rng: np.random.Generator) -> tuple[Points, Boxes]:
    """Each object longer or shorter, wider or narrower, higher or lower, standing where it stood (ST3D, section 3.2).

    Args:
        points: x, y, z first.
        boxes: Full boxes.
        most: Largest share by which a side changes.
        rng: The only source of randomness.
    """
    unsure = np.asarray(boxes.label) == UNSURE
    factor = np.where(unsure[:, None], 1.0, rng.uniform(1 - most, 1 + most, (len(boxes), 3)))
    scaled = points.copy()
    low_m = boxes.centre_m - [0.0, 0.0, 0.5] * boxes.size_m
    for row, inside in enumerate(points_in_boxes(points[:, :3], boxes, margin_m=BOX_MARGIN_M)):
        cos, sin = np.cos(boxes.yaw_rad[row]), np.sin(boxes.yaw_rad[row])
        to_box = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
        local = (points[inside, :3] - low_m[row]) @ to_box.T * factor[row]
        scaled[inside, :3] = local @ to_box + low_m[row]
    size_m = boxes.size_m * factor
    centre_m = low_m + [0.0, 0.0, 0.5] * size_m
    return scaled, boxes.replace(size_m=size_m, centre_m=centre_m)


_LINE_DEG, _SECTOR_DEG = (0.1, 0.5), (5.0, 30.0)


def _as_another_sensor(
    points: Points, boxes: Boxes, config: AugmentationConfig, rng: np.random.Generator, intensity: int | None
) -> tuple[Points, Boxes]:
    """The frame as a sensor of fewer lines, a covered window, more noise or no intensity would have measured it."""
    if config.line_dropout:
        points, boxes = _thinned(points, boxes, drop_lines(points, config.line_dropout, rng))
    if config.missing_sectors and rng.random() < config.missing_sectors:
        width, middle = np.deg2rad(rng.uniform(*_SECTOR_DEG)), rng.uniform(-np.pi, np.pi)
        azimuth = np.arctan2(points[:, 1], points[:, 0])
        apart = np.abs((azimuth - middle + np.pi) % (2 * np.pi) - np.pi)
        points, boxes = _thinned(points, boxes, apart > width / 2)
    if config.range_noise_m:
        range_m = np.linalg.norm(points[:, :3], axis=1)
        noise_m = rng.uniform(0, config.range_noise_m) * rng.standard_normal(len(points))
        points = points.copy()
        points[:, :3] *= (1 + noise_m / np.maximum(range_m, 1.0)).astype(np.float32)[:, None]
    if config.intensity_off and rng.random() < config.intensity_off and intensity is not None:
        points = points.copy()
        points[:, intensity] = 0.0
    return points, boxes


def drop_lines(points: Points, most: float | int, rng: np.random.Generator) -> Bool[np.ndarray, " n"]:
    """Which points stay where whole scan lines are dropped, up to a share of them: lines are bands of the elevation.

    Args:
        points: x, y, z first, the sensor near the origin.
        most: Largest share of the lines that is dropped.
        rng: The only source of randomness.
    """
    elevation = np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))
    line = np.floor(elevation / np.deg2rad(rng.uniform(*_LINE_DEG)) + rng.random()).astype(np.int64)
    line -= line.min(initial=0)
    stays = rng.random(line.max(initial=0) + 1) >= rng.uniform(0, most)
    return np.asarray(stays[line])


def sparse_near(points: Points, boxes: Boxes, config: SparseNear, rng: np.random.Generator) -> Bool[np.ndarray, " n"]:
    """Which points stay where near ones are to be as sparse as a far object's.

    A scanner's points on a surface fall with the square of the range, so a point at r stays with probability
    c (r / R)^2, where R is the range of one of the frame's far objects, drawn at random. c is how much fewer points far
    objects have than that law gives from near ones, for they are hidden more: over many frames near objects get the
    numbers of points of far ones.

    Args:
        points: x, y, z first, shape (n, 3 + k).
        boxes: The frame's; those in ``config.far_m`` are far.
        config: Ranges and share of the frames.
        rng: The only source of randomness.
    """
    box_m = np.hypot(*boxes.centre_m[:, :2].T)
    far = (box_m >= config.far_m[0]) & (box_m < config.far_m[1])
    if not far.any() or rng.random() >= config.probability:
        return np.ones(len(points), dtype=bool)
    range_m, drawn_m = np.hypot(points[:, 0], points[:, 1]), rng.choice(box_m[far])
    counts = count_points_in_boxes(points[:, :3], boxes, margin_m=BOX_MARGIN_M)
    near, far = (part & (counts > 0) for part in (box_m < config.near_m, far))
    surface = np.log(np.maximum(counts, 1) * np.square(box_m))
    fewer = np.exp(min(surface[far].mean() - surface[near].mean(), 0.0)) if near.any() and far.any() else 1.0
    share = np.where(range_m < config.near_m, fewer * np.square(range_m / drawn_m), 1.0)
    return np.asarray(rng.random(len(points)) < share)


def _thinned(points: Points, boxes: Boxes, stays: Bool[np.ndarray, " n"]) -> tuple[Points, Boxes]:
    """The points that stay, without the boxes that had points and have none any more."""
    left = points[stays]
    before, after = (count_points_in_boxes(part[:, :3], boxes, margin_m=BOX_MARGIN_M) for part in (points, left))
    return left, boxes[(after > 0) | (before == 0)]
