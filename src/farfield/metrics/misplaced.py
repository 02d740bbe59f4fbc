"""Predicted boxes that would fit the annotated ones if their numbers meant something else: axes, frames, sizes, yaw.

The same readings as the doctor tries on points, here with annotated boxes as the witnesses. Nothing is changed: what
fits far better is named.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from farfield.frame.drive import Key
from farfield.geometry.boxes import Boxes
from farfield.metrics.frames import BoxesByFrame, frame_order

_NEAR_M = 2.0
_MOST_FRAMES = 200
_LEAST = 10  # pairs that may decide
_LONG = 1.5  # times as long as wide: then a heading can be seen

Points = Float[np.ndarray, "n 3"]


class _PairedBoxes(NamedTuple):
    """Predicted and annotated boxes that lie at one place, row by row: centre, size, heading."""

    predicted: Float[np.ndarray, "n 7"]
    annotated: Float[np.ndarray, "n 7"]


def misplaced(predicted: BoxesByFrame, annotated: BoxesByFrame) -> list[str]:
    """One sentence for each reading under which far more predicted boxes fit.

    Args:
        predicted: Boxes by (sequence, frame).
        annotated: Boxes by the same.
    """
    keys = sorted((key for key in annotated if len(annotated[key])), key=frame_order)
    keys = keys[:: max(1, -(-len(keys) // _MOST_FRAMES))]
    ours = {key: _rows(annotated[key]) for key in keys}
    theirs = {key: _rows(predicted[key]) if key in predicted else np.zeros((0, 7)) for key in keys}
    total = sum(map(len, theirs.values()))
    pairs = _paired(theirs, ours)
    as_read = len(pairs.predicted)
    best, most = "", 0
    for words, change in _PLACES.items():
        count = _count({key: change(rows[:, :3]) for key, rows in theirs.items()}, ours)
        best, most = (words, count) if count > most else (best, most)
    for step, words in ((1, "the next frame's"), (-1, "the frame's before")):
        count = _count(_shifted(predicted, keys, step), ours)
        if count > most:
            best, most = f"each frame's boxes were {words}: frames numbered off by one", count
    if most >= _LEAST and most > 2 * as_read + 5 and most > 0.3 * min(total, sum(map(len, ours.values()))):
        return [f"{as_read} of {total} predicted boxes lie within 2 m of an annotated one; {most} would if {best}"]
    return [*_of_pairs(pairs)] if as_read >= _LEAST else []


def _rows(boxes: Boxes) -> Float[np.ndarray, "n 7"]:
    return np.column_stack([boxes.centre_m, boxes.size_m, boxes.yaw_rad]).astype(np.float64)


def _ordered(order: Sequence[int], signs: Sequence[float], points: Points) -> Points:
    return points[:, list(order)] * np.array(signs)


_PLACES: Mapping[str, Callable[[Points], Points]] = {
    "y pointed left: they are mirrored": partial(_ordered, (0, 1, 2), (1.0, -1.0, 1.0)),
    "they were turned by half a turn": partial(_ordered, (0, 1, 2), (-1.0, -1.0, 1.0)),
    "they were turned by 90 degrees counter-clockwise": partial(_ordered, (1, 0, 2), (-1.0, 1.0, 1.0)),
    "they were turned by 90 degrees clockwise": partial(_ordered, (1, 0, 2), (1.0, -1.0, 1.0)),
    "they were taken from a camera's axes (x right, y down, z ahead)": partial(_ordered, (2, 0, 1), (1.0, -1.0, -1.0)),
    "their positions were divided by 100: centimetres": partial(_ordered, (0, 1, 2), (0.01, 0.01, 0.01)),
    "their positions were divided by 1000: millimetres": partial(_ordered, (0, 1, 2), (0.001, 0.001, 0.001)),
}


def _shifted(predicted: BoxesByFrame, keys: Sequence[Key], step: int) -> dict[Key, Points]:
    """The centres of the frames before or after, in the order of their names; none across sequences."""
    every = sorted({*predicted, *keys}, key=frame_order)
    place = {key: number for number, key in enumerate(every)}
    found: dict[Key, Points] = {}
    for key in keys:
        number = place[key] + step
        other = every[number] if 0 <= number < len(every) else None
        near = other is not None and other[0] == key[0] and other in predicted
        found[key] = predicted[other].centre_m if near and other is not None else np.zeros((0, 3))
    return found


def _nearest(theirs: Points, ours: Float[np.ndarray, "m 7"]) -> tuple[np.ndarray, np.ndarray]:
    """Rows of predicted boxes near an annotated one, each of these taken once, and which it is."""
    if not len(theirs) or not len(ours):
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    gap = np.hypot(*(theirs[:, None, axis] - ours[None, :, axis] for axis in (0, 1)))
    best = gap.argmin(axis=0)  # for each annotated box the nearest prediction
    near = np.flatnonzero(gap[best, np.arange(len(ours))] < _NEAR_M)
    rows, first = np.unique(best[near], return_index=True)
    return rows, near[first]


def _count(theirs: Mapping[Key, Points], ours: Mapping[Key, np.ndarray]) -> int:
    return sum(len(_nearest(points, ours[key])[0]) for key, points in theirs.items())


def _paired(theirs: Mapping[Key, np.ndarray], ours: Mapping[Key, np.ndarray]) -> _PairedBoxes:
    found = [(rows, ours[key], *_nearest(rows[:, :3], ours[key])) for key, rows in theirs.items()]
    left = [rows[chosen] for rows, _, chosen, _ in found]
    right = [rows[chosen] for _, rows, _, chosen in found]
    empty = np.zeros((0, 7))
    return _PairedBoxes(np.concatenate([empty, *left]), np.concatenate([empty, *right]))


def _of_pairs(pairs: _PairedBoxes) -> Iterator[str]:
    theirs, ours = pairs
    share = (theirs[:, 2] - ours[:, 2]) / ours[:, 5]
    middle, spread = float(np.median(share)), float(np.subtract(*np.percentile(share, [75, 25])))
    if abs(abs(middle) - 0.5) < 0.15 and spread < 0.4:
        side = "bottom" if middle < 0 else "top"
        yield f"predicted boxes stand half their height off the annotated ones: z is a box's middle, not its {side}"
    ratio = np.median(theirs[:, 3:6] / ours[:, 3:6], axis=0)
    for factor, words in ((0.5, "half"), (2.0, "twice")):
        if (np.abs(ratio / factor - 1) < 0.2).all():
            yield f"predicted sizes are {words} the annotated ones on all three sides: l, w, h are full sizes"
    long = ours[:, 3] > _LONG * ours[:, 4]
    if np.count_nonzero(long) < _LEAST:
        return
    theirs, ours = theirs[long], ours[long]
    kept = np.abs(np.log(theirs[:, 3:5] / ours[:, 3:5])).sum(axis=1)
    swapped = np.abs(np.log(theirs[:, 4:2:-1] / ours[:, 3:5])).sum(axis=1)
    if np.median(swapped) < 0.4 < np.median(kept):
        yield "predicted boxes fit the annotated ones with length and width exchanged: l is the side along the heading"
        return
    yield from _headings(theirs[:, 6], ours[:, 6])


_YAWS: Mapping[str, Callable[[np.ndarray], np.ndarray]] = {
    "counted clockwise (it is counter-clockwise from +x)": np.negative,
    "given in degrees (it is in radians)": np.deg2rad,
    "multiplied by pi/180 once too often": np.rad2deg,
    "off by 90 degrees": partial(np.add, np.pi / 2),
    "counted clockwise from +y, like a compass or a camera's rotation_y": partial(np.subtract, np.pi / 2),
}


def _headings(theirs: Float[np.ndarray, " n"], ours: Float[np.ndarray, " n"]) -> Iterator[str]:
    """Median error of the headings modulo half a turn, as read and as they may be meant."""
    if _apart(theirs, ours) < 0.3:
        return
    fits = {words: _apart(change(theirs), ours) for words, change in _YAWS.items()}
    best = min(fits, key=lambda words: fits[words])
    if fits[best] < 0.15:
        yield (
            f"predicted headings differ from the annotated ones by {np.rad2deg(_apart(theirs, ours)):.0f} degrees "
            f"(median), by {np.rad2deg(fits[best]):.0f} if yaw is {best}"
        )


def _apart(a: Float[np.ndarray, " n"], b: Float[np.ndarray, " n"]) -> float:
    gap = np.mod(a - b, np.pi)
    return float(np.median(np.minimum(gap, np.pi - gap)))
