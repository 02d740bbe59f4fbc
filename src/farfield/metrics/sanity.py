"""What is odd about the boxes of a file: units, headings, scores, classes; said beside the score, never fixed.

:func:`diagnose_box_convention` looks for predicted boxes that would fit the annotated ones if their columns meant
something else: axes, frames, sizes, yaw. It tries the same readings as the doctor does on points, here against the
annotated boxes. Nothing is changed: a reading that fits far better is named.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from farfield.frame.drive import Key
from farfield.geometry.boxes import Boxes
from farfield.metrics.frames import BoxesByFrame, frame_order
from farfield.metrics.residuals import systematic_notes
from farfield.vocabulary.classes import closest_class, normalised_class, unit_of_sizes

_TURN = 2 * np.pi
_FEW = 0.05  # share of headings beyond a turn that a tracker's unwrapping may leave
_FASTEST_M_S = 40.0
_FARTHEST_M = 1_500.0


def sanity_warnings(predicted: BoxesByFrame, annotated: BoxesByFrame) -> list[str]:
    """One sentence for each thing that is odd, of both sides and of how they lie to each other.

    Args:
        predicted: Scored boxes by (sequence, frame).
        annotated: Annotated boxes by the same.
    """
    sides = {"predicted": _joined(predicted.values()), "annotated": _joined(annotated.values())}
    notes = [note for side, boxes in sides.items() for note in _of_one_side(side, boxes)]
    doubled = sum(_doubled(boxes) for boxes in predicted.values())
    if doubled > 0.3 * len(sides["predicted"]):
        notes.append(f"{doubled} of {len(sides['predicted'])} predicted boxes stand there twice: one file in another?")
    twice = sum(_doubled(boxes) for boxes in annotated.values())
    if twice > 0.02 * len(sides["annotated"]):
        notes.append(
            f"{twice} of {len(sides['annotated'])} annotated boxes stand there twice, and one of each two counts as "
            "missed: one file in another?"
        )
    notes += _without_entry(predicted, annotated)
    notes += [*_scores(sides["predicted"]), *fast(predicted, "predicted"), *fast(annotated, "annotated")]
    if _same(predicted, annotated):
        notes.append("predictions and labels are the same boxes: is one file given for both?")
        return notes
    return [*notes, *diagnose_box_convention(predicted, annotated)]


def _without_entry(predicted: BoxesByFrame, annotated: BoxesByFrame) -> Iterator[str]:
    """A note on the annotated frames that no line of predictions names, where some do."""
    filled = [key for key in annotated if len(annotated[key])]
    lacking = [key for key in filled if key not in predicted]
    if lacking and len(lacking) < len(filled):
        yield (
            f"{len(lacking)} of {len(filled)} frames with annotated boxes have no predictions at all, such as "
            f"{' '.join(filter(None, lacking[0]))}: their {sum(len(annotated[key]) for key in lacking)} boxes count as "
            "missed. Were they detected in?"
        )


def _joined(parts: Iterable[Boxes]) -> Boxes:
    filled = [part for part in parts if len(part.yaw_rad)]
    return Boxes.concatenate([part.plain().replace(score=part.score) for part in filled]) if filled else Boxes.empty()


def _of_one_side(side: str, boxes: Boxes) -> Iterator[str]:
    if not len(boxes):
        yield f"there is no {side} box"
        return
    longest = float(np.median(boxes.size_m.max(axis=1)))
    unit = unit_of_sizes(longest)
    if unit:
        yield f"the median {side} box is {longest:.3g} long: sizes are in metres, these seem to be in {unit}"
    far = float(np.median(boxes.range_m))
    if far > _FARTHEST_M:
        yield (
            f"the median {side} box lies {far:.3g} m away: positions are metres from the sensor, not of a map "
            "and not in another unit"
        )


def _scores(boxes: Boxes) -> Iterator[str]:
    if boxes.score is None or not len(boxes):
        return
    low, high = float(boxes.score.min()), float(boxes.score.max())
    if low < 0 or high > 1:
        yield f"scores go from {low:.3g} to {high:.3g}, not from 0 to 1: cuts by score (score_cut) do not fit them"
    if len(boxes) >= 10 and low == high:
        yield f"all {len(boxes)} predictions have one score, {low:g}: without an order a curve has a single point"


def wild_headings(side: str, beyond: int, total: int) -> list[str]:
    """A note where many headings lie beyond a turn.

    Args:
        side: Whose boxes.
        beyond: How many, see :func:`beyond_a_turn`; boxes themselves keep the angle modulo a turn.
        total: Of how many.
    """
    if not total or beyond <= _FEW * total:
        return []
    return [f"{beyond / total:.0%} of the {side} headings are beyond 2 pi: yaw is in radians, these look like degrees"]


def beyond_a_turn(yaw_rad: Float[np.ndarray, " n"]) -> int:
    """How many headings of a file are beyond 2 pi."""
    return int(np.count_nonzero(np.abs(yaw_rad) > _TURN + 1e-6))


def _doubled(boxes: Boxes) -> int:
    """Boxes that are equal to an earlier one of the frame."""
    rows = np.column_stack([boxes.centre_m, boxes.size_m, boxes.yaw_rad]) if len(boxes) else np.zeros((0, 7))
    labels = np.unique(np.asarray(boxes.label), return_inverse=True)[1]
    return len(boxes) - len(np.unique(np.column_stack([rows, labels.reshape(-1)]), axis=0))


def _same(predicted: BoxesByFrame, annotated: BoxesByFrame) -> bool:
    filled = [key for key, boxes in annotated.items() if len(boxes)]
    return bool(filled) and all(
        key in predicted and np.array_equal(_places(predicted[key]), _places(annotated[key])) for key in filled
    )


def _places(boxes: Boxes) -> Float[np.ndarray, "n 7"]:
    return np.column_stack([boxes.centre_m, boxes.size_m, boxes.yaw_rad])


def fast(boxes: BoxesByFrame, side: str) -> list[str]:
    """A note where most velocities are beyond those of cars."""
    parts = [
        frame_boxes.velocity_m_s
        for frame_boxes in boxes.values()
        if frame_boxes.velocity_m_s is not None and len(frame_boxes)
    ]
    speed = np.concatenate([np.linalg.norm(part[:, :2], axis=1) for part in parts]) if parts else np.zeros(0)
    speed = speed[np.isfinite(speed)]
    if not len(speed) or float(np.median(speed)) < _FASTEST_M_S:
        return []
    beyond = float((speed > _FASTEST_M_S).mean())
    return [
        f"{beyond:.0%} of the {side} boxes move at more than {_FASTEST_M_S:g} m/s (median {np.median(speed):.3g}): "
        "velocities are in m/s, not km/h"
    ]


def strange_classes(predicted: BoxesByFrame, annotated: BoxesByFrame, relabel: Mapping[str, str]) -> list[str]:
    """A note on predicted classes that no annotated box has, with what they may be meant for.

    Args:
        predicted: Predicted boxes.
        annotated: Annotated boxes.
        relabel: Names that count as others.
    """
    predicted_counts, annotated_counts = _named(predicted, relabel), _named(annotated, relabel)
    strange = {name: count for name, count in predicted_counts.items() if name not in annotated_counts}
    if not strange or not annotated_counts:
        return []
    shown = ", ".join(f"{name} ({count})" for name, count in list(strange.items())[:8])
    meant = {name: guess for name in strange if (guess := closest_class(name, annotated_counts))}
    pairs = [f"{name}:{guess}" for name, guess in meant.items()]
    advice = f"; meant is perhaps {', '.join(pairs)}: --options relabel={','.join(pairs)}"
    return [
        f"{sum(strange.values())} of {sum(predicted_counts.values())} predicted boxes are of classes that no label "
        f"has: {shown}; labels have {', '.join(annotated_counts)}{advice if meant else ''}"
    ]


def split_classes(predicted: BoxesByFrame, annotated: BoxesByFrame, relabel: Mapping[str, str]) -> list[str]:
    """A note on each side that has two names for what seems to be one class, such as Car and vehicle.

    Args:
        predicted: Predicted boxes.
        annotated: Annotated boxes.
        relabel: Names that count as others.
    """
    notes = []
    for side, counts in (("predicted", _named(predicted, relabel)), ("annotated", _named(annotated, relabel))):
        for ours in dict.fromkeys(normalised_class(name, {}) for name in counts):
            names = [name for name in counts if normalised_class(name, {}) == ours != "unknown"]
            plain = {name.lower() for name in names}
            if len(names) < 2 or not (ours in plain or len(plain) < len(names)):
                continue  # a truck and a bus are both large vehicles, and two classes
            main = next((name for name in names if name == ours), max(names, key=lambda name: counts[name]))
            pairs = ",".join(f"{name}:{main}" for name in names if name != main)
            shown = " and ".join(f"{name} ({counts[name]})" for name in names)
            notes.append(
                f"{side} boxes are {shown}, which may be one class by two names, scored apart: "
                f"--options relabel={pairs}"
            )
    return notes


def _named(boxes: BoxesByFrame, relabel: Mapping[str, str]) -> dict[str, int]:
    counts: dict[str, int] = {}
    for part in boxes.values():
        for name in np.asarray(part.label).tolist():
            name = relabel.get(str(name), str(name))
            counts[name] = counts.get(name, 0) + 1
    return counts


# Readings of the columns under which far more boxes would fit

_NEAR_M = 2.0
_MOST_FRAMES = 200
_LEAST = 10  # pairs that may decide
_MOST = 0.9  # share of pairs that a reading of all of them fits
_LONG = 1.5  # times as long as wide: then a heading can be seen

Points = Float[np.ndarray, "n 3"]


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
    pairs = _paired(predicted_rows, annotated_rows)
    as_read = len(pairs.predicted)
    best, most = "", 0
    for reading, change in _PLACES.items():
        count = _count({key: change(rows[:, :3]) for key, rows in predicted_rows.items()}, annotated_rows)
        best, most = (reading, count) if count > most else (best, most)
    for step, reading in ((1, "the next frame's"), (-1, "the frame's before")):
        count = _count(_shifted(predicted, keys, step), annotated_rows)
        if count > most:
            best, most = f"each frame's boxes were {reading}: frames numbered off by one", count
    if most >= _LEAST and most > 2 * as_read + 5 and most > 0.3 * min(total, sum(map(len, annotated_rows.values()))):
        return [f"{as_read} of {total} predicted boxes lie within 2 m of an annotated one; {most} would if {best}"]
    if as_read < _LEAST:
        return systematic_notes(predicted_rows, annotated_rows)
    explained = list(_of_pairs(pairs))
    return explained + systematic_notes(
        predicted_rows,
        annotated_rows,
        with_heights=not any("half their height" in note for note in explained),
        with_sizes=not any("sizes are" in note or "exchanged" in note for note in explained),
    )


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
    "their positions were multiplied by 0.3048: feet": partial(_ordered, (0, 1, 2), (0.3048, 0.3048, 0.3048)),
}


def _shifted(predicted: BoxesByFrame, keys: Sequence[Key], step: int) -> dict[Key, Points]:
    """The centres of the frames before or after, in the order of their names; none across sequences."""
    every = sorted({*predicted, *keys}, key=frame_order)
    index_of = {key: number for number, key in enumerate(every)}
    centres: dict[Key, Points] = {}
    for key in keys:
        number = index_of[key] + step
        other = every[number] if 0 <= number < len(every) else None
        near = other is not None and other[0] == key[0] and other in predicted
        centres[key] = predicted[other].centre_m if near and other is not None else np.zeros((0, 3))
    return centres


def _nearest(predicted: Points, annotated: Float[np.ndarray, "m 7"]) -> tuple[np.ndarray, np.ndarray]:
    """Rows of predicted boxes near an annotated one, each of these taken once, and which it is."""
    if not len(predicted) or not len(annotated):
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    gap = np.hypot(*(predicted[:, None, axis] - annotated[None, :, axis] for axis in (0, 1)))
    best = gap.argmin(axis=0)  # for each annotated box the nearest prediction
    near = np.flatnonzero(gap[best, np.arange(len(annotated))] < _NEAR_M)
    rows, first = np.unique(best[near], return_index=True)
    return rows, near[first]


def _count(predicted: Mapping[Key, Points], annotated: Mapping[Key, np.ndarray]) -> int:
    return sum(len(_nearest(points, annotated[key])[0]) for key, points in predicted.items())


def _paired(predicted: Mapping[Key, np.ndarray], annotated: Mapping[Key, np.ndarray]) -> _PairedBoxes:
    nearest = [(rows, annotated[key], *_nearest(rows[:, :3], annotated[key])) for key, rows in predicted.items()]
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
    "given in degrees (it is in radians)": np.deg2rad,
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
    if fits[best] < 0.15:
        yield (
            f"predicted headings differ from the annotated ones by {np.rad2deg(_apart(predicted, annotated)):.0f} "
            f"degrees (median), by {np.rad2deg(fits[best]):.0f} if yaw is {best}"
        )


def _apart(a: Float[np.ndarray, " n"], b: Float[np.ndarray, " n"]) -> float:
    gap = np.mod(a - b, np.pi)
    return float(np.median(np.minimum(gap, np.pi - gap)))
