"""What is odd about the boxes of a file: units, headings, scores, classes; said beside the score, never mended."""

from collections.abc import Iterable, Iterator, Mapping
from difflib import get_close_matches

import numpy as np
from jaxtyping import Float

from farfield.geometry.boxes import Boxes
from farfield.metrics.frames import BoxesByFrame
from farfield.metrics.misplaced import misplaced
from farfield.vocabulary.classes import normalised_class
from farfield.vocabulary.sizes import unit_of_sizes

_TURN = 2 * np.pi
_FEW = 0.05  # share of headings beyond a turn that a tracker's unwrapping may leave
_FASTEST_M_S = 40.0
_FARTHEST_M = 1_500.0


def oddities(predicted: BoxesByFrame, annotated: BoxesByFrame) -> list[str]:
    """One sentence for each thing that is odd, of both sides and of how they lie to each other.

    Args:
        predicted: Scored boxes by (sequence, frame).
        annotated: Annotated boxes by the same.
    """
    sides = {"predicted": _joined(predicted.values()), "annotated": _joined(annotated.values())}
    notes = [note for word, boxes in sides.items() for note in _of_one_side(word, boxes)]
    doubled = sum(_doubled(boxes) for boxes in predicted.values())
    if doubled > 0.3 * len(sides["predicted"]):
        notes.append(f"{doubled} of {len(sides['predicted'])} predicted boxes stand there twice: one file in another?")
    notes += [*_scores(sides["predicted"]), *fast(predicted, "predicted"), *fast(annotated, "annotated")]
    if _same(predicted, annotated):
        notes.append("predictions and labels are the same boxes: is one file given for both?")
        return notes
    return [*notes, *misplaced(predicted, annotated)]


def _joined(parts: Iterable[Boxes]) -> Boxes:
    filled = [part for part in parts if len(part.yaw_rad)]
    return Boxes.concatenate([part.plain().replace(score=part.score) for part in filled]) if filled else Boxes.empty()


def _of_one_side(word: str, boxes: Boxes) -> Iterator[str]:
    if not len(boxes):
        yield f"there is no {word} box"
        return
    longest = float(np.median(boxes.size_m.max(axis=1)))
    unit = unit_of_sizes(longest)
    if unit:
        yield f"the median {word} box is {longest:.3g} long: sizes are in metres, these seem to be in {unit}"
    far = float(np.median(boxes.range_m))
    if far > _FARTHEST_M:
        yield (
            f"the median {word} box lies {far:.3g} m away: positions are metres from the sensor, not of a map "
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


def wild_headings(word: str, beyond: int, total: int) -> list[str]:
    """A note where many headings lie beyond a turn.

    Args:
        word: Whose boxes.
        beyond: How many, see :func:`beyond_a_turn`; boxes themselves keep the angle modulo a turn.
        total: Of how many.
    """
    if not total or beyond <= _FEW * total:
        return []
    return [f"{beyond / total:.0%} of the {word} headings are beyond 2 pi: yaw is in radians, these look like degrees"]


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


def fast(boxes: BoxesByFrame, word: str) -> list[str]:
    """A note where most velocities are beyond those of cars."""
    parts = [each.velocity_m_s for each in boxes.values() if each.velocity_m_s is not None and len(each)]
    speed = np.concatenate([np.linalg.norm(part[:, :2], axis=1) for part in parts]) if parts else np.zeros(0)
    speed = speed[np.isfinite(speed)]
    if not len(speed) or float(np.median(speed)) < _FASTEST_M_S:
        return []
    beyond = float((speed > _FASTEST_M_S).mean())
    return [
        f"{beyond:.0%} of the {word} boxes move at more than {_FASTEST_M_S:g} m/s (median {np.median(speed):.3g}): "
        "velocities are in m/s, not km/h"
    ]


def strange_classes(predicted: BoxesByFrame, annotated: BoxesByFrame, relabel: Mapping[str, str]) -> list[str]:
    """A note on predicted classes that no annotated box has, with what they may be meant for.

    Args:
        predicted: Predicted boxes.
        annotated: Annotated boxes.
        relabel: Names that count as others.
    """
    theirs, ours = _named(predicted, relabel), _named(annotated, relabel)
    strange = {name: count for name, count in theirs.items() if name not in ours}
    if not strange or not ours:
        return []
    shown = ", ".join(f"{name} ({count})" for name, count in list(strange.items())[:8])
    meant = {name: guess for name in strange if (guess := meant_by(name, ours))}
    mend = f"; meant is perhaps {', '.join(f'{a}:{b}' for a, b in meant.items())}: --options relabel={_pairs(meant)}"
    return [
        f"{sum(strange.values())} of {sum(theirs.values())} predicted boxes are of classes that no label has: {shown}; "
        f"labels have {', '.join(ours)}{mend if meant else ''}"
    ]


def _pairs(meant: Mapping[str, str]) -> str:
    return ",".join(f"{name}:{guess}" for name, guess in meant.items())


def meant_by(name: str, known: Iterable[str]) -> str:
    """The known class that a name may be meant for; empty where none is like it.

    >>> meant_by("Car", ["vehicle", "pedestrian"]), meant_by("vehicel", ["vehicle"]), meant_by("LKW", ["vehicle"])
    ('vehicle', 'vehicle', '')
    """
    by_plain = {other.lower(): other for other in known}
    ours = normalised_class(name, {})
    same = [other for other in by_plain.values() if normalised_class(other, {}) == ours != "unknown"]
    close = get_close_matches(name.lower(), list(by_plain), n=1, cutoff=0.75)
    return by_plain.get(name.lower()) or (same[0] if same else by_plain[close[0]] if close else "")


def _named(boxes: BoxesByFrame, relabel: Mapping[str, str]) -> dict[str, int]:
    counts: dict[str, int] = {}
    for part in boxes.values():
        for name in np.asarray(part.label).tolist():
            name = relabel.get(str(name), str(name))
            counts[name] = counts.get(name, 0) + 1
    return counts
