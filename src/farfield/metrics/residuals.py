"""What the residuals of matched pairs tell: an offset, a turn or a ratio that all of them share, named with its size.

A detector's errors scatter about zero. Where they scatter about something else, the two sides differ in what they mean:
the origin of the coordinates, a calibration, a unit, the order of the sizes, the names of the frames. Such errors cost
a score 0.1 to 0.5 and go by in silence, so they are said beside it; nothing is changed.

    1. pair        predicted and annotated boxes of a frame that are each other's nearest, whatever their class
    2. places      which one motion leaves the least: an offset in the coordinates, one along the boxes' own axes, or a
                   turn about the sensor; heights for themselves
    3. headings    the median difference modulo half a turn
    4. sizes       the median ratios, and sides that are exchanged in all of the pairs or in a part of them
    5. frames      predicted boxes that lie on the annotated ones of another frame
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import permutations
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from farfield.frame.drive import Key
from farfield.geometry.boxes import wrap_angle_rad
from farfield.vocabulary.counts import count_of

LEAST_PAIRS = 10
_GATE_M, _GATE_RAD = 3.0, 0.06  # pairs lie nearer than the one and the other times the range: turns of 3 degrees
_LEAST_OFFSET_M, _LEAST_TURN_RAD = 0.3, np.deg2rad(1.0)
_LEAST_RATIO = np.log(1.08)
_LEAST_OF_FRAME, _FRAME_OFFSET_M = 6, 0.5
_LEAST_OF_PLANE = 30
_LEAST_OF_CHANCE, _NO_RELATION = 40, 0.2  # mean of unit vectors: 1 where all agree
_LONG = 1.5
_SIDES = ("length", "width", "height")
_UNITS = {3.2808: "feet", 1.0936: "yards", 39.37: "inches", 100.0: "centimetres", 1000.0: "millimetres"}
_ANOTHER_FRAME_M = 0.5
_MOST_SUSPECTS, _MOST_CANDIDATES = 20, 400

Rows = Float[np.ndarray, "_ 7"]  # centre, size, heading


class PairedRows(NamedTuple):
    """Predicted and annotated boxes row by row."""

    predicted: Rows
    annotated: Rows
    frame: Int[np.ndarray, " n"]


def mutual_pairs(predicted: Mapping[Key, Rows], annotated: Mapping[Key, Rows]) -> PairedRows:
    """Boxes of a frame that are each other's nearest in the x-y plane, within the gate."""
    left, right, counts = [np.zeros((0, 7))], [np.zeros((0, 7))], np.zeros(len(annotated), dtype=np.int64)
    for number, (key, boxes) in enumerate(annotated.items()):
        others = predicted.get(key, np.zeros((0, 7)))
        if not len(boxes) or not len(others):
            continue
        gap_m = np.hypot(*(others[:, None, axis] - boxes[None, :, axis] for axis in (0, 1)))
        row, column = gap_m.argmin(axis=0), np.arange(len(boxes))
        is_mutual = gap_m.argmin(axis=1)[row] == column
        gate_m = _GATE_M + _GATE_RAD * np.hypot(boxes[:, 0], boxes[:, 1])
        is_pair = is_mutual & (gap_m[row, column] < gate_m)
        left.append(others[row[is_pair]])
        right.append(boxes[is_pair])
        counts[number] = np.count_nonzero(is_pair)
    return PairedRows(np.concatenate(left), np.concatenate(right), np.repeat(np.arange(len(annotated)), counts))


def systematic_notes(
    predicted: Mapping[Key, Rows],
    annotated: Mapping[Key, Rows],
    *,
    with_heights: bool = True,
    with_headings: bool = True,
    with_sizes: bool = True,
) -> list[str]:
    """One sentence for each error that all pairs share.

    Args:
        predicted: Boxes by (sequence, frame).
        annotated: Boxes by the same.
        with_heights: Whether to look at z; not where that was explained otherwise.
        with_headings: Whether to look at headings; likewise.
        with_sizes: Whether to look at sizes; likewise.
    """
    pairs = mutual_pairs(predicted, annotated)
    notes = list(_other_frames(predicted, annotated))
    if len(pairs.predicted) < LEAST_PAIRS:
        return notes
    places, turned_rad = _places(pairs)
    notes += places or _frames_apart(pairs, list(annotated))
    if with_heights:
        notes += _heights(pairs)
    if with_headings:
        notes += _headings(pairs, turned_rad)
    if with_sizes:
        exchanged = list(_exchanged(pairs))
        notes += exchanged or _ratios(pairs)
    return notes


# 2. Places


def _places(pairs: PairedRows) -> tuple[list[str], float]:
    """A note on the motion that explains most of the residuals, and the turn about the sensor, 0 if it is none."""
    predicted, annotated = pairs.predicted[:, :2], pairs.annotated[:, :2]
    residual_m = predicted - annotated
    as_read = float(np.median(np.hypot(*residual_m.T)))
    # An offset in the coordinates.
    offset_m = np.median(residual_m, axis=0)
    # One along the boxes' own axes: forward and to the left.
    cos, sin = np.cos(pairs.annotated[:, 6]), np.sin(pairs.annotated[:, 6])
    own_m = np.column_stack(
        [residual_m[:, 0] * cos + residual_m[:, 1] * sin, residual_m[:, 1] * cos - residual_m[:, 0] * sin]
    )
    own_offset_m = np.median(own_m, axis=0)
    # A turn about the sensor.
    bearing_rad = [np.arctan2(side[:, 1], side[:, 0]) for side in (predicted, annotated)]
    turn_rad = float(np.median(wrap_angle_rad(bearing_rad[0] - bearing_rad[1])))
    # A factor, as of a range that is measured too long.
    range_m = np.maximum(np.hypot(*annotated.T), 1.0)
    factor = float(np.median(np.hypot(*predicted.T) / range_m))
    turned = _turned(annotated, turn_rad)
    left_m = {
        "offset": float(np.median(np.hypot(*(residual_m - offset_m).T))),
        "own": float(np.median(np.hypot(*(own_m - own_offset_m).T))),
        "turn": float(np.median(np.hypot(*(predicted - turned).T))),
        "factor": float(np.median(np.hypot(*(predicted - factor * annotated).T))),
    }
    best = min(left_m, key=lambda name: left_m[name])
    if left_m[best] > 0.5 * as_read:
        return [], 0.0
    count = (
        f"median of {count_of(len(predicted), 'pair')}; {as_read:.2g} m apart as read, {left_m[best]:.2g} m without it"
    )
    if best == "turn" and abs(turn_rad) > _LEAST_TURN_RAD / 2:
        note = f"predicted boxes are turned by {np.rad2deg(turn_rad):+.1f} degrees about the sensor against the "
        return [note + f"annotated ones ({count}): a calibration, or another sensor's coordinates?"], turn_rad
    if best == "factor" and abs(factor - 1) * float(np.median(range_m)) > _LEAST_OFFSET_M / 2:
        note = (
            f"predicted boxes lie {factor:.4g} times as far from the sensor as the annotated ones ({count}): a unit, a "
        )
        return [note + "cell's size, or another sensor's range?"], 0.0
    if best == "offset" and np.hypot(*offset_m) > _LEAST_OFFSET_M:
        note = f"predicted boxes stand {offset_m[0]:+.2f} m in x and {offset_m[1]:+.2f} m in y off the annotated ones "
        return [note + f"({count}): another sensor's coordinates, or a calibration?"], 0.0
    if best == "own" and np.hypot(*own_offset_m) > _LEAST_OFFSET_M:
        note = f"predicted boxes stand {own_offset_m[0]:+.2f} m ahead and {own_offset_m[1]:+.2f} m to the left of the "
        return [note + f"annotated ones, along their headings ({count}): x, y are a box's middle"], 0.0
    return [], 0.0


def _frames_apart(pairs: PairedRows, keys: Sequence[Key]) -> Iterator[str]:
    """A note where an offset or a turn of its own explains a part of the frames."""
    motions: dict[int, tuple[float, str]] = {}
    numbers, counts = np.unique(pairs.frame, return_counts=True)
    numbers = numbers[counts >= _LEAST_OF_FRAME]
    for number in numbers.tolist():
        predicted, annotated = (side[pairs.frame == number, :2] for side in pairs[:2])
        offset_m = _median(predicted - annotated)
        bearing_rad = [np.arctan2(side[:, 1], side[:, 0]) for side in (predicted, annotated)]
        turn_rad = float(_median(wrap_angle_rad(bearing_rad[0] - bearing_rad[1])))
        left_m = {
            f"{offset_m[0]:+.2f} m in x and {offset_m[1]:+.2f} m in y": predicted - annotated - offset_m,
            f"a turn of {np.rad2deg(turn_rad):+.1f} degrees": predicted - _turned(annotated, turn_rad),
        }
        off_m = {words: float(_median(np.hypot(*rest.T))) for words, rest in left_m.items()}
        best = min(off_m, key=lambda words: off_m[words])
        as_read = float(_median(np.hypot(*(predicted - annotated).T)))
        if as_read > _FRAME_OFFSET_M and off_m[best] < 0.4 * as_read:
            motions[number] = (as_read, best)
    if len(motions) < max(3, 0.1 * len(numbers)):
        return
    worst = max(motions, key=lambda number: motions[number][0])
    yield (
        f"in {len(motions)} of {count_of(len(numbers), 'frame')} the predicted "
        "boxes are off by a motion of the frame's own, such "
        f"as {motions[worst][1]} in frame {' '.join(filter(None, keys[worst]))}: another time, the car's motion, or "
        "another calibration there?"
    )


def _turned(points_m: Float[np.ndarray, "n 2"], turn_rad: float) -> Float[np.ndarray, "n 2"]:
    cos, sin = np.cos(turn_rad), np.sin(turn_rad)
    return points_m @ np.array([[cos, sin], [-sin, cos]])


def _heights(pairs: PairedRows) -> Iterator[str]:
    residual_m = pairs.predicted[:, 2] - pairs.annotated[:, 2]
    middle_m, spread_m = _middle_and_spread(residual_m)
    # A tilt: the plane through the residuals, without what lies far off it.
    terms = np.column_stack([np.ones(len(residual_m)), pairs.annotated[:, :2]])
    plane = np.linalg.lstsq(terms, residual_m, rcond=None)[0]
    off_m = np.abs(residual_m - terms @ plane)
    near = off_m <= 3 * np.median(off_m)
    plane = np.linalg.lstsq(terms[near], residual_m[near], rcond=None)[0]
    rise_m = terms[:, 1:] @ plane[1:]
    left_m = float(np.median(np.abs(residual_m - terms @ plane)))
    is_tilted = (
        len(residual_m) >= _LEAST_OF_PLANE
        and np.hypot(*plane[1:]) > _LEAST_TURN_RAD / 2
        and float(np.ptp(rise_m)) > 2 * _LEAST_OFFSET_M
    )
    if is_tilted and left_m < 0.5 * float(np.median(np.abs(residual_m - middle_m))):
        along, across = np.rad2deg(np.arctan(plane[1:]))
        yield (
            f"predicted boxes are tilted against the annotated ones: they rise by {along:+.1f} degrees along x and by "
            f"{across:+.1f} along y, and stand {plane[0]:+.2f} m off at the "
            f"sensor ({count_of(len(residual_m), 'pair')}): a "
            "calibration's pitch and roll, or a ground that is taken for flat?"
        )
        return
    if abs(middle_m) > max(_LEAST_OFFSET_M, spread_m * max(2.0, 8 / np.sqrt(len(residual_m)))):
        yield (
            f"predicted boxes stand {middle_m:+.2f} m in z off the annotated "
            f"ones (median of {count_of(len(residual_m), 'pair')}): "
            "z is measured from another sensor, or from the ground?"
        )


# 3. Headings


def _headings(pairs: PairedRows, turned_rad: float) -> Iterator[str]:
    long = pairs.annotated[:, 3] > _LONG * pairs.annotated[:, 4]
    if np.count_nonzero(long) < LEAST_PAIRS:
        return
    gap_rad = pairs.predicted[long, 6] - pairs.annotated[long, 6]
    mean = np.exp(2j * gap_rad).mean()  # of twice the angle: a box looks the same after half a turn
    around_rad = float(np.angle(mean)) / 2
    middle_rad, spread_rad = _middle_and_spread(np.mod(gap_rad - around_rad + np.pi / 2, np.pi) - np.pi / 2)
    middle_rad += around_rad
    if len(gap_rad) >= _LEAST_OF_CHANCE and abs(mean) < _NO_RELATION:
        yield (
            "predicted headings bear no relation to the annotated ones "
            f"({count_of(len(gap_rad), 'pair')}): is yaw in radians, and "
            "of these boxes?"
        )
        return
    same_turn = abs(turned_rad) > 0 and abs(middle_rad - turned_rad) < 0.3 * abs(turned_rad)
    few = 10 / np.sqrt(len(gap_rad))  # the fewer the pairs, the clearer they have to be
    if abs(middle_rad) > max(_LEAST_TURN_RAD, spread_rad * max(1.0, few)) and not same_turn:
        yield (
            f"median heading error of the predicted boxes: {np.rad2deg(middle_rad):+.1f} degrees "
            f"({count_of(np.count_nonzero(long), 'pair')})"
        )


# 4. Sizes


def _ratios(pairs: PairedRows) -> Iterator[str]:
    ratio = np.log(pairs.predicted[:, 3:6] / pairs.annotated[:, 3:6])
    middle, spread = (np.array(column) for column in zip(*map(_middle_and_spread, ratio.T), strict=True))
    is_off = (np.abs(middle) > _LEAST_RATIO) & (spread < 0.5 * np.abs(middle))
    if not is_off.any():
        return
    factors = np.exp(middle)
    if is_off.all() and np.ptp(middle) < 0.1:
        factor = float(np.exp(middle.mean()))
        unit = next(
            (
                f": {side} sizes are in {name}, not in metres?"
                for scale, name in _UNITS.items()
                for side, value in (("predicted", scale), ("annotated", 1 / scale))
                if abs(np.log(factor / value)) < 0.04
            ),
            "",
        )
        yield (
            f"predicted sizes are {factor:.3g} times the annotated ones on all three sides (median of {len(ratio)} "
            f"pairs){unit}"
        )
        return
    sides = " and ".join(f"{side} {factors[axis]:.2f}" for axis, side in enumerate(_SIDES) if is_off[axis])
    yield (
        "predicted sizes differ from the annotated ones by one factor in most of "
        f"{count_of(len(ratio), 'pair')}: {sides} times"
    )


def _exchanged(pairs: PairedRows) -> Iterator[str]:
    """Sides that are exchanged in most of the pairs, or in a part of them."""
    predicted, annotated = np.log(pairs.predicted[:, 3:6]), np.log(pairs.annotated[:, 3:6])
    as_read = np.abs(predicted - annotated).sum(axis=1)
    best, most = "", 0
    for order in list(permutations(range(3)))[1:]:
        apart = np.abs(annotated[:, list(order)] - annotated).sum(axis=1) > 0.3  # the exchange can be seen
        changed = np.abs(predicted[:, list(order)] - annotated).sum(axis=1)
        count = int(np.count_nonzero(apart & (as_read > 0.25) & (changed < 0.35 * as_read)))
        total = int(np.count_nonzero(apart))
        if count > most and total >= LEAST_PAIRS and count >= max(LEAST_PAIRS / 2, 0.1 * total):
            moved = [_SIDES[axis] for axis in range(3) if order[axis] != axis]
            best, most = f"in {count} of {count_of(total, 'pair')} the predicted {' and '.join(moved)}", count
    if best:
        yield f"{best} fit the annotated ones once they are exchanged: sizes are l (along the heading), w, h"


# 5. Frames


def _other_frames(predicted: Mapping[Key, Rows], annotated: Mapping[Key, Rows]) -> Iterator[str]:
    """Frames whose predicted boxes lie on the annotated ones of another frame of their sequence."""
    keys = [key for key, rows in annotated.items() if len(rows) > 1 and len(predicted.get(key, ())) > 1]
    own_m = {key: _apart(predicted[key], annotated[key]) for key in keys}
    usual_m = float(np.median(list(own_m.values()))) if own_m else 0.0
    suspects = [key for key, gap_m in own_m.items() if gap_m > max(_ANOTHER_FRAME_M, 3 * usual_m)]
    notes = list(_exchanged_frames(predicted, annotated, suspects, own_m, min(max(2 * usual_m, _ANOTHER_FRAME_M), 1.0)))
    if len(suspects) <= max(2, 0.5 * len(keys)) and notes:
        yield from notes
        return
    # All frames in an order that nothing tells: then the usual distance is that of frames that do not belong together.
    suspects = [key for key, gap_m in own_m.items() if gap_m > _ANOTHER_FRAME_M][:_MOST_SUSPECTS]
    notes = list(_exchanged_frames(predicted, annotated, suspects, own_m, _ANOTHER_FRAME_M))
    if len(suspects) > 2 and len(notes) > 0.6 * len(suspects):
        yield f"{len(notes)} of {count_of(len(suspects), 'frame')} that were looked at are another's; {notes[0]}"


def _exchanged_frames(
    predicted: Mapping[Key, Rows],
    annotated: Mapping[Key, Rows],
    suspects: Sequence[Key],
    own_m: Mapping[Key, float],
    least_m: float,
) -> Iterator[str]:
    for key in suspects[:_MOST_SUSPECTS]:
        others = [other for other in own_m if other != key and other[0] == key[0]][:_MOST_CANDIDATES]
        gaps_m = {other: _apart(predicted[key], annotated[other]) for other in others}
        best = min(gaps_m, key=lambda other: gaps_m[other], default=key)
        if gaps_m.get(best, np.inf) < min(0.3 * own_m[key], least_m):
            yield (
                f"the predicted boxes of frame {' '.join(filter(None, key))} lie on the annotated ones of frame "
                f"{' '.join(filter(None, best))} (median {gaps_m[best]:.2g} m, against {own_m[key]:.2g} m in their "
                "own): were frames exchanged?"
            )


def _apart(predicted: Rows, annotated: Rows) -> float:
    """Median distance from each box of either side to the nearest of the other, metres."""
    gap_m = np.hypot(*(predicted[:, None, axis] - annotated[None, :, axis] for axis in (0, 1)))
    return float(max(_median(gap_m.min(axis=0)), _median(gap_m.min(axis=1))))


def _middle_and_spread(values: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """The median, and half the distance between the quartiles."""
    low, middle, high = np.percentile(values, [25, 50, 75])
    return float(middle), float(high - low) / 2


def _median(values: Float[np.ndarray, " n *columns"]) -> Any:
    """The median along the first axis, of a frame's few rows a tenth of numpy's time."""
    ordered = np.sort(values, axis=0)
    return (ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2
