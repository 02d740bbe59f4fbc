"""Objects cut out of training frames, to be pasted into others (SECOND, section 3.3.1). numpy only, one generator."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Float32, Int

from farfield.geometry.boxes import Boxes, points_in_boxes
from farfield.geometry.iou import pairwise_iou

Points = Float32[np.ndarray, "_ _"]
Progress = Callable[[Iterable[int]], Iterable[int]]

LAG = 3
"""Place of the age of a point's sweep among its columns, after x, y and z."""

SAMPLES_PER_FRAME = 16
"""Samples after which one of the frames whose objects can be pasted makes way for another."""


def cut_out(points: Points, boxes: Boxes, *, min_points: int) -> "list[tuple[Points, Boxes]]":
    """Cut objects out of a frame: the points and the box of each that has ``min_points`` in the present sweep."""
    boxes = boxes.replace(score=None, track_id=None, point_count=None)
    inside = enumerate(points_in_boxes(points[:, :3], boxes))
    return [
        (points[rows].copy(), boxes[index])
        for index, rows in inside
        if np.count_nonzero(points[rows, LAG] == 0) >= min_points
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
        wanted: dict[str, int],
        rng: np.random.Generator,
        *,
        bands_m: Sequence[float | int] = (),
    ) -> tuple[Points, Boxes]:
        """Add up to the wanted number of objects of each class, where they stood in their own frame.

        An object keeps its place, so its density and visible side stay right for its range. It is left out where it
        would touch a box of the frame; points of the frame inside its box are removed.

        Args:
            points: The frame's points.
            boxes: The frame's boxes.
            wanted: How many of each class.
            rng: The only source of randomness.
            bands_m: Edges of range bands over which objects are drawn evenly; without them evenly over objects.
        """
        keep, added = np.ones(len(points), dtype=np.bool_), []
        for name, count in wanted.items():
            pool = self.objects.get(name, [])
            range_m = np.array([float(np.hypot(*box.centre_m[0, :2])) for _, box in pool], dtype=np.float64)
            for index in draw(range_m, count, rng, bands_m=bands_m):
                new_points, new_box = pool[index]
                if len(boxes) and pairwise_iou(new_box, boxes, kind="bev").any():
                    continue
                keep[points_in_boxes(points[:, :3], new_box, margin_m=0.1)[0]] = False
                added.append(new_points)
                boxes = Boxes.concatenate([boxes, new_box])
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
        order: The frame at a place of the endless stream.
        frames: Frames in the bank at a time.
    """

    def __init__(
        self, cut: "Callable[[int], list[tuple[Points, Boxes]]]", order: Callable[[int], int], frames: int
    ) -> None:
        self.cut, self.order, self.frames = cut, order, frames
        self._cut: dict[int, list[tuple[Points, Boxes]]] = {}
        self._bank, self._first = ObjectBank(), -1

    def at(self, position: int, progress: Progress = iter) -> ObjectBank:
        """The bank at a position; frames that it did not hold at the position asked for before are read now."""
        first = position // SAMPLES_PER_FRAME
        if first != self._first:
            numbers = [self.order(place) for place in range(first, first + self.frames)]
            new = [number for number in dict.fromkeys(numbers) if number not in self._cut]
            read = {number: self.cut(number) for number in (progress(new) if new else ())}
            self._cut = {number: self._cut[number] if number in self._cut else read[number] for number in numbers}
            self._bank, self._first = ObjectBank(), first
            for number in numbers:
                self._bank.add(self._cut[number])
        return self._bank
