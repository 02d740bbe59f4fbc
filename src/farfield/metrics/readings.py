"""Readings of a file's columns and frames under which far more predicted boxes would lie on annotated ones.

Three kinds are tried, each counted in boxes within 2 m of an annotated one: readings that occur (axes exchanged, a
camera's axes, units), a motion or scale that the data themselves give by votes, and the frames in another order. What
pairs share once most boxes lie near is looked at in :mod:`farfield.metrics.residuals`.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from farfield.frame.drive import Key
from farfield.geometry.boxes import Boxes, wrap_angle_rad
from farfield.metrics.frames import BoxesByFrame, frame_order
from farfield.metrics.residuals import systematic_notes
from farfield.vocabulary.counts import count_of

_NEAR_M = 2.0
_MOST_FRAMES = 200
_LEAST = 10  # pairs that may decide
_MOST = 0.9  # share of pairs that a reading of all of them fits
_LONG = 1.5  # times as long as wide: then a heading can be seen

_CLOSE_M = 0.5
_FARTHEST_OFFSET_M = 60.0
_OWN_OFFSET_BOXES = 6
_NUMBERS = ("no", "one", "two", "three")

Points = Float[np.ndarray, "n 3"]
Rows = Float[np.ndarray, "_ 7"]  # centre, size, heading


class _PairedBoxes(NamedTuple):
    """Predicted and annotated boxes that lie at one place, row by row: centre, size, heading."""

    predicted: Float[np.ndarray, "n 7"]
    annotated: Float[np.ndarray, "n 7"]


def diagnose_box_convention(predicted: BoxesByFrame, annotated: BoxesByFrame) -> list[str]:
    """One sentence for each reading under which far more predicted boxes fit.

    Args:
        predicted: Boxes by (sequence, frame).
        annotated: Boxes by the same.
    """
    keys = sorted((key for key in annotated if len(annotated[key])), key=frame_order)
    keys = keys[:: max(1, -(-len(keys) // _MOST_FRAMES))]
    annotated_rows = {key: _rows(annotated[key]) for key in keys}
    predicted_rows = {key: _rows(predicted[key]) if key in predicted else np.zeros((0, 7)) for key in keys}
    total = sum(map(len, predicted_rows.values()))
    possible = min(total, sum(map(len, annotated_rows.values())))
    pairs = _paired(predicted_rows, annotated_rows)
    as_read = len(pairs.predicted)
    orders = _frame_orders(predicted, keys)
    if possible > 2 * as_read + 5:
        counts = {name: _count(_changed(predicted_rows, change), annotated_rows) for name, change in _PLACES.items()}
        counts |= {name: _count(_taken(predicted, order), annotated_rows) for name, order in orders.items()}
        for name, change in _measured(predicted_rows, annotated_rows).items():
            count = _count(_changed(predicted_rows, change), annotated_rows)
            counts |= {name: count} if count > 1.05 * max(counts.values()) else {}
        best = max(counts, key=lambda name: counts[name])
        if counts[best] >= _LEAST and counts[best] > max(2 * as_read + 5, 0.3 * possible):
            return [
                f"{as_read} of {total} predicted boxes lie within 2 m of an annotated one; "
                f"{counts[best]} would if {best}"
            ]
        notes = list(_own_offsets(predicted_rows, annotated_rows))
        if notes:
            return notes
    if as_read < _LEAST:
        return systematic_notes(predicted_rows, annotated_rows)
    explained = [*_other_order(predicted, orders, predicted_rows, annotated_rows), *_of_pairs(pairs)]
    return explained + systematic_notes(
        predicted_rows,
        annotated_rows,
        with_headings=not any("headings" in note for note in explained),
        with_heights=not any("half their height" in note for note in explained),
        with_sizes=not any("sizes are" in note or "exchanged" in note for note in explained),
    )


def _rows(boxes: Boxes) -> Float[np.ndarray, "n 7"]:
    return np.column_stack([boxes.centre_m, boxes.size_m, boxes.yaw_rad]).astype(np.float64)


def _ordered(order: Sequence[int], signs: Sequence[float], points: Points) -> Points:
    return points[:, list(order)] * np.array(signs)


_PLACES: Mapping[str, Callable[[Points], Points]] = {
    "y pointed left: they are mirrored": partial(_ordered, (0, 1, 2), (1.0, -1.0, 1.0)),
    "x pointed backward: they are mirrored": partial(_ordered, (0, 1, 2), (-1.0, 1.0, 1.0)),
    "x and y were exchanged": partial(_ordered, (1, 0, 2), (1.0, 1.0, 1.0)),
    "they were turned by half a turn": partial(_ordered, (0, 1, 2), (-1.0, -1.0, 1.0)),
    "they were turned by 90 degrees counter-clockwise": partial(_ordered, (1, 0, 2), (-1.0, 1.0, 1.0)),
    "they were turned by 90 degrees clockwise": partial(_ordered, (1, 0, 2), (1.0, -1.0, 1.0)),
    "they were taken from a camera's axes (x right, y down, z ahead)": partial(_ordered, (2, 0, 1), (1.0, -1.0, -1.0)),
    "their positions were divided by 100: centimetres": partial(_ordered, (0, 1, 2), (0.01, 0.01, 0.01)),
    "their positions were divided by 1000: millimetres": partial(_ordered, (0, 1, 2), (0.001, 0.001, 0.001)),
    "their positions were multiplied by 0.3048: feet": partial(_ordered, (0, 1, 2), (0.3048, 0.3048, 0.3048)),
}


def _changed(rows: Mapping[Key, np.ndarray], change: Callable[[Points], Points]) -> dict[Key, Points]:
    return {key: change(part[:, :3]) for key, part in rows.items()}


def _moved(x_m: float, y_m: float, points: Points) -> Points:
    return points + np.array([x_m, y_m, 0.0])


def _turned(turn_rad: float, points: Points) -> Points:
    cos, sin = np.cos(turn_rad), np.sin(turn_rad)
    return points @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])


def _measured(predicted: Mapping[Key, Rows], annotated: Mapping[Key, Rows]) -> dict[str, Callable[[Points], Points]]:
    """Readings whose size the boxes vote for: the offset, turn and factor that most pairs of a frame have in common."""
    offset_m, turn_rad, factor = [np.zeros((0, 2))], [np.zeros((0, 1))], [np.zeros((0, 1))]
    for key, rows in predicted.items():
        p, a = rows[:, None, :2], annotated[key][None, :, :2]
        range_p, range_a = np.hypot(p[..., 0], p[..., 1]), np.hypot(a[..., 0], a[..., 1])
        turn = wrap_angle_rad(np.arctan2(p[..., 1], p[..., 0]) - np.arctan2(a[..., 1], a[..., 0]))
        offset_m.append((p - a)[np.abs(p - a).max(axis=2) < _FARTHEST_OFFSET_M])
        turn_rad.append(turn[(np.abs(range_p - range_a) < 1.0) & (range_a > _NEAR_M)][:, None])
        ahead = (np.abs(turn) < 0.02) & (range_a > _NEAR_M) & (range_p > 0)
        factor.append(np.log(np.where(ahead, range_p, 1.0) / np.where(ahead, range_a, 1.0))[ahead][:, None])
    readings: dict[str, Callable[[Points], Points]] = {}
    x_m, y_m = _mode(np.concatenate(offset_m), 1.0)
    readings[f"they were moved by {-x_m:+.1f} m in x and {-y_m:+.1f} m in y"] = partial(_moved, -x_m, -y_m)
    (turn_of_all,) = _mode(np.concatenate(turn_rad), 0.02)
    readings[f"they were turned by {-np.rad2deg(turn_of_all):+.1f} degrees about the sensor"] = partial(
        _turned, -turn_of_all
    )
    ratio = float(np.exp(-_mode(np.concatenate(factor), 0.02)[0]))
    scaled = partial(_ordered, (0, 1, 2), (ratio, ratio, ratio))
    readings[f"their positions were multiplied by {ratio:.3g}"] = scaled
    return readings


def _mode(values: Float[np.ndarray, "n axes"], width: float) -> Float[np.ndarray, " axes"]:
    """The middle of the fullest cell and what lies beside it; zeros of nothing."""
    if not len(values):
        return np.zeros(values.shape[1])
    cells = np.rint(values / width).astype(np.int64)
    _, first, count = np.unique(cells @ (1 << 20) ** np.arange(cells.shape[1]), return_index=True, return_counts=True)
    near = np.abs(values - cells[first[count.argmax()]] * width).max(axis=1) < width
    return np.asarray(np.median(values[near], axis=0))


def _own_offsets(predicted: Mapping[Key, Rows], annotated: Mapping[Key, Rows]) -> Iterator[str]:
    """A note where most boxes would fit after an offset that each frame has for itself."""
    sizes, pairs, offsets_m = 0, 0, []
    for key, rows in predicted.items():
        others = annotated[key]
        if min(len(rows), len(others)) < _OWN_OFFSET_BOXES:
            continue
        x_m, y_m = _mode((rows[:, None, :2] - others[None, :, :2]).reshape(-1, 2), 1.0)
        sizes += min(len(rows), len(others))
        pairs += len(nearest_rows(_moved(-x_m, -y_m, rows[:, :3]), others)[0])
        offsets_m.append(np.hypot(x_m, y_m))
    if len(offsets_m) > 1 and pairs > 0.7 * sizes and np.median(offsets_m) > _NEAR_M:
        yield (
            "predicted boxes would lie within 2 m of annotated ones if each frame's were moved by an offset of its "
            f"own (median {np.median(offsets_m):.1f} m, {pairs} of "
            f"{count_of(sizes, 'box', 'boxes')}): do they stand in the world, or had "
            "they the car's motion added or taken off?"
        )


# The frames in another order


def _frame_orders(predicted: BoxesByFrame, keys: Sequence[Key]) -> dict[str, dict[Key, Key]]:
    """By name of an order: the frame whose boxes each key would take; none across sequences."""
    frames_of: dict[str, list[Key]] = {}
    for key in sorted({*predicted, *keys}, key=frame_order):
        frames_of.setdefault(key[0], []).append(key)
    orders: dict[str, dict[Key, Key]] = {}
    for step in (1, -1, 2, -2, 3, -3):
        beside = (
            "the next frame's"
            if step == 1
            else "the frame's before"
            if step == -1
            else f"of {count_of(abs(step), 'frame')} "
        )
        words = beside + ("" if abs(step) == 1 else "later" if step > 0 else "before")
        orders[f"each frame's boxes were {words}: frames numbered off by {_NUMBERS[abs(step)]}"] = {
            key: frames[number + step]
            for frames in frames_of.values()
            for number, key in enumerate(frames)
            if 0 <= number + step < len(frames)
        }
    backwards, forth, back = (
        "the frames came in the opposite order",
        *(
            f"frames were numbered in the order of their names as text (1, 10, 2){side}"
            for side in ("", ", or read so")
        ),
    )
    for frames in frames_of.values():
        orders.setdefault(backwards, {}).update(zip(frames, frames[::-1], strict=True))
        by_name = sorted(frames, key=lambda key: key[1])
        if by_name != frames:
            orders.setdefault(forth, {}).update(zip(by_name, frames, strict=True))
            orders.setdefault(back, {}).update(zip(frames, by_name, strict=True))
    sampled = set(keys)
    return {name: {key: other for key, other in order.items() if key in sampled} for name, order in orders.items()}


def _taken(predicted: BoxesByFrame, order: Mapping[Key, Key]) -> dict[Key, Points]:
    return {key: predicted[other].centre_m for key, other in order.items() if other in predicted}


def _other_order(
    predicted: BoxesByFrame,
    orders: Mapping[str, Mapping[Key, Key]],
    predicted_rows: Mapping[Key, Rows],
    annotated_rows: Mapping[Key, Rows],
) -> Iterator[str]:
    """A note where far more boxes would lie within half a metre in another order: objects move a metre a frame."""
    total = sum(map(len, predicted_rows.values()))
    possible = min(total, sum(map(len, annotated_rows.values())))
    as_read = _count({key: rows[:, :3] for key, rows in predicted_rows.items()}, annotated_rows, _CLOSE_M)
    if 1.5 * as_read + 5 > possible:
        return
    counts = {name: _count(_taken(predicted, order), annotated_rows, _CLOSE_M) for name, order in orders.items()}
    best = max(counts, key=lambda name: counts[name])
    if counts[best] >= _LEAST and counts[best] > max(1.5 * as_read + 5, 0.3 * possible):
        yield (
            f"{as_read} of {total} predicted boxes lie within {_CLOSE_M:g} m of an annotated one; {counts[best]} would "
            f"if {best}"
        )


def nearest_rows(
    predicted: Points, annotated: Float[np.ndarray, "m 7"], limit_m: float = _NEAR_M
) -> tuple[np.ndarray, np.ndarray]:
    """Rows of predicted boxes near an annotated one, each of these taken once, and which it is."""
    if not len(predicted) or not len(annotated):
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    gap = np.hypot(*(predicted[:, None, axis] - annotated[None, :, axis] for axis in (0, 1)))
    best = gap.argmin(axis=0)  # for each annotated box the nearest prediction
    near = np.flatnonzero(gap[best, np.arange(len(annotated))] < limit_m)
    rows, first = np.unique(best[near], return_index=True)
    return rows, near[first]


def _count(predicted: Mapping[Key, Points], annotated: Mapping[Key, np.ndarray], limit_m: float = _NEAR_M) -> int:
    return sum(len(nearest_rows(points, annotated[key], limit_m)[0]) for key, points in predicted.items())


def _paired(predicted: Mapping[Key, np.ndarray], annotated: Mapping[Key, np.ndarray]) -> _PairedBoxes:
    nearest = [(rows, annotated[key], *nearest_rows(rows[:, :3], annotated[key])) for key, rows in predicted.items()]
    left = [rows[chosen] for rows, _, chosen, _ in nearest]
    right = [rows[chosen] for _, rows, _, chosen in nearest]
    empty = np.zeros((0, 7))
    return _PairedBoxes(np.concatenate([empty, *left]), np.concatenate([empty, *right]))


def _of_pairs(pairs: _PairedBoxes) -> Iterator[str]:
    predicted, annotated = pairs
    share = (predicted[:, 2] - annotated[:, 2]) / annotated[:, 5]
    middle, spread = float(np.median(share)), float(np.subtract(*np.percentile(share, [75, 25])))
    if abs(abs(middle) - 0.5) < 0.15 and spread < 0.4:
        side = "bottom" if middle < 0 else "top"
        yield f"predicted boxes stand half their height off the annotated ones: z is a box's middle, not its {side}"
    ratio = np.median(predicted[:, 3:6] / annotated[:, 3:6], axis=0)
    for factor, amount in ((0.5, "half"), (2.0, "twice")):
        if (np.abs(ratio / factor - 1) < 0.2).all():
            yield f"predicted sizes are {amount} the annotated ones on all three sides: l, w, h are full sizes"
    long = annotated[:, 3] > _LONG * annotated[:, 4]
    if np.count_nonzero(long) < _LEAST:
        return
    predicted, annotated = predicted[long], annotated[long]
    as_read = np.abs(np.log(predicted[:, 3:5] / annotated[:, 3:5])).sum(axis=1)
    swapped = np.abs(np.log(predicted[:, 4:2:-1] / annotated[:, 3:5])).sum(axis=1)
    if np.median(swapped) < 0.4 < np.median(as_read) and (swapped < as_read).mean() > _MOST:
        yield "predicted boxes fit the annotated ones with length and width exchanged: l is the side along the heading"
        return
    yield from _headings(predicted[:, 6], annotated[:, 6])


_YAWS: Mapping[str, Callable[[np.ndarray], np.ndarray]] = {
    "counted clockwise (it is counter-clockwise from +x)": np.negative,
    "multiplied by pi/180 once too often": np.rad2deg,
    "off by 90 degrees": partial(np.add, np.pi / 2),
    "counted clockwise from +y, like a compass or a camera's rotation_y": partial(np.subtract, np.pi / 2),
}


def _headings(predicted: Float[np.ndarray, " n"], annotated: Float[np.ndarray, " n"]) -> Iterator[str]:
    """Median error of the headings modulo half a turn, as read and as they may be meant."""
    if _apart(predicted, annotated) < 0.3:
        return
    fits = {words: _apart(change(predicted), annotated) for words, change in _YAWS.items()}
    best = min(fits, key=lambda words: fits[words])
    # A detector that is unsure of a heading takes one across: the fewer the pairs, the more of them have to fit.
    share = float((_gaps(_YAWS[best](predicted), annotated) < 0.3).mean())
    if fits[best] < 0.15 and share > min(0.6 + 1 / np.sqrt(len(predicted)), _MOST):
        yield (
            f"predicted headings differ from the annotated ones by {np.rad2deg(_apart(predicted, annotated)):.0f} "
            f"degrees (median), by {np.rad2deg(fits[best]):.0f} if yaw is {best}"
        )


def _apart(a: Float[np.ndarray, " n"], b: Float[np.ndarray, " n"]) -> float:
    return float(np.median(_gaps(a, b)))


def _gaps(a: Float[np.ndarray, " n"], b: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    gap = np.mod(a - b, np.pi)
    return np.minimum(gap, np.pi - gap)
