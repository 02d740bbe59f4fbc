"""What is odd about the boxes of a file: units, headings, scores, classes; said beside the score, never fixed.

What lies in how predicted and annotated boxes stand to each other is looked at in :mod:`farfield.metrics.readings` and
:mod:`farfield.metrics.residuals`.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from farfield.frame.drive import Key
from farfield.geometry.boxes import Boxes
from farfield.metrics.frames import BoxesByFrame, count_labels
from farfield.metrics.readings import diagnose_box_convention, nearest_rows
from farfield.vocabulary.classes import closest_class, normalised_class, unit_of_sizes
from farfield.vocabulary.counts import count_of
from farfield.vocabulary.kradar import REGIONS_M

_TURN = 2 * np.pi
_FEW = 0.05  # share of headings beyond a turn that a tracker's unwrapping may leave
_FASTEST_M_S = 40.0
_FARTHEST_M = 1_500.0
_MANY = 30  # boxes of a side from which on a share says something


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
    else:
        notes += _overlapping(predicted, annotated)
    twice = sum(_doubled(boxes) for boxes in annotated.values())
    if twice > 0.02 * len(sides["annotated"]):
        notes.append(
            f"{twice} of {count_of(len(sides['annotated']), 'annotated box', 'annotated boxes')} "
            "stand there twice, and one of each two counts as "
            "missed: one file in another?"
        )
    notes += _without_entry(predicted, annotated)
    notes += [*_scores(sides["predicted"]), *fast(predicted, "predicted"), *fast(annotated, "annotated")]
    if _same(predicted, annotated):
        notes.append("predictions and labels are the same boxes: is one file given for both?")
        return notes
    notes += [*_repeated(predicted, annotated), *_without_boxes(predicted, annotated)]
    if len(sides["predicted"]) >= _MANY <= len(sides["annotated"]):
        notes += [*_written(**sides), *_order_of_scores(predicted, annotated)]
    return [*notes, *diagnose_box_convention(predicted, annotated)]


def _without_entry(predicted: BoxesByFrame, annotated: BoxesByFrame) -> Iterator[str]:
    """A note on the annotated frames that no line of predictions names, where some do."""
    filled = [key for key in annotated if len(annotated[key])]
    lacking = [key for key in filled if key not in predicted]
    if lacking and len(lacking) < len(filled):
        yield (
            f"{len(lacking)} of {count_of(len(filled), 'frame')} with "
            "annotated boxes have no predictions at all, such as "
            f"{' '.join(filter(None, lacking[0]))}: their "
            f"{count_of(sum(len(annotated[key]) for key in lacking), 'box', 'boxes')} count as "
            "missed. Were they detected in?"
        )


def _without_boxes(predicted: BoxesByFrame, annotated: BoxesByFrame) -> Iterator[str]:
    """A note where frames have no predicted box although others as full have many."""
    filled = [key for key in annotated if len(annotated[key]) and key in predicted]
    bare = [key for key in filled if not len(predicted[key])]
    others = [key for key in filled if len(predicted[key])]
    if not others or len(bare) < max(2, 0.05 * len(filled)):
        return
    usual = float(np.median([len(predicted[key]) for key in others]))
    as_full = np.median([len(annotated[key]) for key in bare]) >= 0.5 * np.median(
        [len(annotated[key]) for key in others]
    )
    if usual >= _USUAL and as_full:
        yield (
            f"{len(bare)} of {count_of(len(filled), 'frame')} with annotated boxes have no predicted box, such as "
            f"{' '.join(filter(None, bare[0]))}, and the others {usual:g} (median): were all of them detected in?"
        )


_USUAL = 5


def _repeated(predicted: BoxesByFrame, annotated: BoxesByFrame) -> Iterator[str]:
    """A note on frames whose predicted boxes are another frame's to the digit, where the annotated ones differ."""
    first_of: dict[tuple[str, bytes], Key] = {}
    pairs = []
    filled = [key for key, boxes in predicted.items() if len(boxes) > 1 and len(annotated.get(key, ()))]
    for key in filled:
        first = first_of.setdefault((key[0], _places(predicted[key]).tobytes()), key)
        if first != key and not np.array_equal(_places(annotated[first]), _places(annotated[key])):
            pairs.append((first, key))
    if len(pairs) >= max(2, 0.05 * len(filled)):
        original, copy = (" ".join(filter(None, name)) for name in pairs[0])
        yield (
            f"{len(pairs)} of {count_of(len(filled), 'frame')} have the predicted "
            "boxes of another frame to the digit, such as "
            f"{copy} those of {original}, where the annotated boxes differ: was one frame's result written for several?"
        )


def _overlapping(predicted: BoxesByFrame, annotated: BoxesByFrame) -> Iterator[str]:
    """A note where many predicted boxes stand within a better one of their class, and annotated ones do not."""
    counts = {}
    for name, side in (("predicted", predicted), ("annotated", annotated)):
        inside, total = 0, 0
        for boxes in list(side.values())[:_MOST_FRAMES]:
            rows = np.arange(len(boxes)) if boxes.score is None else np.argsort(-boxes.score, kind="stable")
            rows = rows[:_MOST_BOXES]
            x, y = boxes.centre_m[rows, :2].T
            width_m = boxes.size_m[rows, :2].min(axis=1)
            near = (x[:, None] - x) ** 2 + (y[:, None] - y) ** 2 < width_m[:, None] ** 2
            worse, better = np.nonzero(np.tril(near, -1))
            label = np.asarray(boxes.label)[rows]
            inside += len(set(worse[label[worse] == label[better]].tolist()))
            total += len(rows)
        counts[name] = (inside, total)
    inside, total = counts["predicted"]
    share_of_annotated = counts["annotated"][0] / max(counts["annotated"][1], 1)
    if total >= _MANY and inside > (0.2 + share_of_annotated) * total:
        yield (
            f"{inside} of {total} predicted boxes stand within a better one of their class, less than a width from its "
            "middle: without suppression (NMS), or several sweeps' boxes in one frame?"
        )


_MOST_FRAMES, _MOST_BOXES = 200, 300


def _written(*, predicted: Boxes, annotated: Boxes) -> Iterator[str]:
    """Notes on columns that hold one number or whole numbers, where the annotated ones do not."""
    columns = {
        name: (one, other)
        for name, one, other in zip(_COLUMNS, _places(predicted).T, _places(annotated).T, strict=True)
    }
    whole = [
        name
        for name, (one, other) in columns.items()
        if np.ptp(one) > 0 and np.mean(one == np.rint(one)) > 0.95 and np.mean(other == np.rint(other)) < 0.5
    ]
    if whole:
        yield f"the predicted {', '.join(whole)} are whole numbers, and the annotated ones are not: were they rounded?"
    single = [name for name, (one, other) in columns.items() if np.ptp(one) == 0 and np.ptp(other) > 0.1]
    if single:
        yield f"all predicted boxes have one {', one '.join(single)}, and the annotated ones do not: was it predicted?"


_COLUMNS = ("x", "y", "z", "length", "width", "height", "heading")


def one_sided(predicted: BoxesByFrame, annotated: BoxesByFrame, settings: Mapping[str, Any]) -> Iterator[str]:
    """A note where a half of the region that counts has annotated boxes and no predicted one.

    Args:
        predicted: Scored boxes by (sequence, frame).
        annotated: Annotated boxes by the same.
        settings: Those of the result, with the region that counts.
    """
    centres_m = _places(_joined(predicted.values()))
    annotated_m = _places(_joined(annotated.values()))
    annotated_m = annotated_m[_in_scored_region(annotated_m, settings)]
    if min(len(centres_m), len(annotated_m)) < _MANY:
        return
    for words, axis, sign in (
        ("ahead of", 0, 1),
        ("behind", 0, -1),
        ("to the left of", 1, 1),
        ("to the right of", 1, -1),
    ):
        share = float((sign * annotated_m[:, axis] > 1).mean())
        if share > 0.1 and not (sign * centres_m[:, axis] > 1).any():
            yield (
                f"no predicted box lies {words} the sensor, where {share:.0%} of the annotated ones in the region that "
                "is scored do: was the detector given that side?"
            )


def _in_scored_region(boxes_m: Float[np.ndarray, "n 7"], settings: Mapping[str, Any]) -> Bool[np.ndarray, " n"]:
    """Which boxes lie in the region that a result's settings name, seen from above; all where they name none."""
    region, edges = settings.get("region"), settings.get("range_bins_m") or ()
    inside = np.ones(len(boxes_m), dtype=bool)
    if region in ("window", "range") and edges:
        range_m = np.hypot(boxes_m[:, 0], boxes_m[:, 1])
        inside &= (range_m >= float(edges[0])) & (range_m <= float(edges[-1]))
    named = REGIONS_M.get(region, ()) if isinstance(region, str) else region
    bounds = (settings.get("window_m") or ()) if region == "window" else named
    if isinstance(bounds, Sequence) and len(bounds) >= 4:  # x and y; K-Radar's regions have z besides
        for column in range(2):
            low, high = map(float, bounds[2 * column : 2 * column + 2])
            inside &= (boxes_m[:, column] >= low) & (boxes_m[:, column] <= high)
    return inside


def _order_of_scores(predicted: BoxesByFrame, annotated: BoxesByFrame) -> Iterator[str]:
    """A note where boxes near an annotated one have no higher scores than the others."""
    near_scores, other_scores = [np.zeros(0)], [np.zeros(0)]
    for key, boxes in list(predicted.items())[:_MOST_FRAMES]:
        if boxes.score is None or key not in annotated:
            continue
        is_near = np.zeros(len(boxes), dtype=bool)
        is_near[nearest_rows(boxes.centre_m, _places(annotated[key]))[0]] = True
        near_scores.append(boxes.score[is_near])
        other_scores.append(boxes.score[~is_near])
    near, other = np.concatenate(near_scores), np.sort(np.concatenate(other_scores))
    if min(len(near), len(other)) < _MANY or np.ptp(near) == np.ptp(other) == 0:
        return
    below = (np.searchsorted(other, near, "left") + np.searchsorted(other, near, "right")) / 2
    share = float(below.mean()) / len(other)
    deviation = np.sqrt((len(near) + len(other) + 1) / (12 * len(near) * len(other)))
    if share < 0.5 - 2 * deviation or (share < 0.53 and deviation < 0.025):
        yield (
            f"of a predicted box that lies on an annotated one and another that does not, the first has the higher "
            f"score in {share:.0%} of the pairs, where chance gives 50%: are scores confidences, and not a distance, a "
            "variance or a class's number?"
        )


def _joined(parts: Iterable[Boxes]) -> Boxes:
    """All boxes with their scores, where all have any, and nothing else."""
    filled = [part for part in parts if len(part)]
    if not filled:
        return Boxes.empty()
    centre_m, size_m, yaw_rad, label = (
        np.concatenate([getattr(part, name) for part in filled]) for name in ("centre_m", "size_m", "yaw_rad", "label")
    )
    scores = [part.score for part in filled if part.score is not None]
    score = np.concatenate(scores) if len(scores) == len(filled) else None
    return Boxes(centre_m=centre_m, size_m=size_m, yaw_rad=yaw_rad, label=label, score=score)


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
    values = np.unique(boxes.score)
    if len(boxes) >= _MANY and len(values) in (2, 3):
        shown = ", ".join(f"{value:g}" for value in values)
        yield (
            f"the {count_of(len(boxes), 'prediction has', 'predictions have')} {len(values)} "
            f"scores ({shown}): the curve has only that many points; are the scores rounded?"
        )
    if len(boxes) >= 10 and low == high:
        yield (
            f"all {count_of(len(boxes), 'prediction has', 'predictions have')} one "
            f"score, {low:g}: they cannot be ranked, and the curve has a single point"
        )


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
    if len(set(boxes.centre_m[:, 0].tolist())) == len(boxes):
        return 0
    labels = np.asarray(boxes.label).tolist()
    return len(boxes) - len({(label, row.tobytes()) for label, row in zip(labels, _places(boxes), strict=True)})


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


def class_notes(
    predicted: BoxesByFrame, annotated: BoxesByFrame, relabel: Mapping[str, str], *, with_strange: bool
) -> list[str]:
    """Notes on the classes of both sides.

    Args:
        predicted: Predicted boxes.
        annotated: Annotated boxes.
        relabel: Names that count as others.
        with_strange: Whether to name predicted classes that no label has: not where a detector says what it knows.
    """
    notes = strange_classes(predicted, annotated, relabel) if with_strange else []
    return [*notes, *split_classes(predicted, annotated, relabel), *confused_classes(predicted, annotated, relabel)]


def confused_classes(predicted: BoxesByFrame, annotated: BoxesByFrame, relabel: Mapping[str, str]) -> list[str]:
    """A note on each class whose boxes lie on those of another: on another's number, exchanged, or taken for one."""
    counts: dict[tuple[str, str], int] = {}
    for key in list(annotated)[:_MOST_FRAMES]:
        if key not in predicted:
            continue
        rows, columns = nearest_rows(predicted[key].centre_m, _places(annotated[key]), _SAME_PLACE_M)
        names = [np.asarray(predicted[key].label)[rows].tolist(), np.asarray(annotated[key].label)[columns].tolist()]
        for ours, theirs in zip(*names, strict=True):
            pair = (relabel.get(ours, ours), relabel.get(theirs, theirs))
            counts[pair] = counts.get(pair, 0) + 1
    notes = []
    for (ours, theirs), count in counts.items():
        of_ours = sum(number for pair, number in counts.items() if pair[0] == ours)
        of_theirs = sum(number for pair, number in counts.items() if pair[1] == theirs)
        if ours == theirs or count < _LEAST_PAIRS:
            continue
        if count > 0.8 * of_ours:
            notes.append(
                f"{count} of {of_ours} predicted {ours} near an annotated box lie on {theirs}: are classes exchanged, "
                f"or numbered otherwise? --options relabel={ours}:{theirs} counts them as it"
            )
        elif count > 0.8 * of_theirs and count > 0.2 * of_ours:
            notes.append(f"{count} of {of_theirs} annotated {theirs} near a predicted box are predicted as {ours}")
    return notes


_LEAST_PAIRS = 10
_SAME_PLACE_M = 1.0


def strange_classes(predicted: BoxesByFrame, annotated: BoxesByFrame, relabel: Mapping[str, str]) -> list[str]:
    """A note on predicted classes that no annotated box has, with what they may be meant for.

    Args:
        predicted: Predicted boxes.
        annotated: Annotated boxes.
        relabel: Names that count as others.
    """
    predicted_counts, annotated_counts = count_labels(predicted, relabel), count_labels(annotated, relabel)
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
    for side, boxes in (("predicted", predicted), ("annotated", annotated)):
        counts = count_labels(boxes, relabel)
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
