"""Matching of most weight at every score cut-off at once.

Waymo's tools match the boxes of a frame and class anew at each of 101 score cut-offs: of the pairs whose overlap is
enough those are taken, no box twice, whose weights (overlaps in millionths) have the largest sum; scores play no part.
Pairs that are enough are few, so the graph of a frame falls into small parts. In most of them one box meets all others,
and the pair of most weight that the cut-off leaves is the match; an assignment is solved for the rest alone, once for
each set of predictions that some cut-off leaves.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components


@dataclass(frozen=True, eq=False, kw_only=True)
class CutoffMatches:
    """Matches, each with the cut-offs at which it holds: those from ``first`` up to ``last``, without it.

    Args:
        pair: Row of the pair in what was given, shape (k,).
        first: Number of the first cut-off, shape (k,).
        last: Number of the cut-off after the last one, shape (k,).
    """

    pair: Int[np.ndarray, " k"]
    first: Int[np.ndarray, " k"]
    last: Int[np.ndarray, " k"]


def match_at_cutoffs(
    box: Int[np.ndarray, " p"],
    detection: Int[np.ndarray, " p"],
    weight: Int[np.ndarray, " p"],
    cutoffs: Int[np.ndarray, " p"],
) -> CutoffMatches:
    """Match annotated to predicted boxes with the largest sum of weights, at every cut-off.

    Args:
        box: The annotated box of each pair that may match.
        detection: Its predicted box.
        weight: What the pair is worth, above 0.
        cutoffs: How many cut-offs the prediction passes, from the lowest on.
    """
    if not len(box):
        none = np.zeros(0, dtype=np.int64)
        return CutoffMatches(pair=none, first=none, last=none)
    boxes, box_number = np.unique(box, return_inverse=True)
    detections, detection_number = np.unique(detection, return_inverse=True)
    size = len(boxes) + len(detections)
    edges = coo_matrix((np.ones(len(box)), (box_number, len(boxes) + detection_number)), shape=(size, size))
    _, part = connected_components(edges, directed=False)
    boxes_of = np.bincount(part[: len(boxes)], minlength=part.max() + 1)
    detections_of = np.bincount(part[len(boxes) :], minlength=part.max() + 1)
    of_pair = part[box_number]
    one_box, one_detection = boxes_of[of_pair] == 1, detections_of[of_pair] == 1
    rows = [
        _of_one_box(np.flatnonzero(one_box), box, weight, cutoffs),
        _of_one_detection(np.flatnonzero(one_detection & ~one_box), detection, weight, cutoffs),
    ]
    tangled = np.flatnonzero(~one_box & ~one_detection)
    tangled = tangled[np.argsort(of_pair[tangled], kind="stable")]
    starts = np.flatnonzero(np.diff(of_pair[tangled], prepend=-1))
    parts = np.split(tangled, starts[1:]) if len(tangled) else []
    rows += [_of_many(pairs, box, detection, weight, cutoffs) for pairs in parts]
    pair, first, last = (np.concatenate(column) for column in zip(*rows, strict=True))
    return CutoffMatches(pair=pair, first=first, last=last)


_Rows = tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"], Int[np.ndarray, " k"]]


def _of_one_box(
    pairs: Int[np.ndarray, " q"],
    box: Int[np.ndarray, " p"],
    weight: Int[np.ndarray, " p"],
    cutoffs: Int[np.ndarray, " p"],
) -> _Rows:
    """One annotated box that several predictions meet: the best holds as long as it passes, then the next best."""
    pairs = pairs[np.lexsort((pairs, -weight[pairs], box[pairs]))]
    if not len(pairs):
        return pairs, pairs, pairs
    new = _is_new(box[pairs])
    shift = np.cumsum(new) * (int(cutoffs.max()) + 1)  # so that a running maximum starts anew with each box
    most = np.maximum.accumulate(cutoffs[pairs] + shift) - shift
    before = np.where(new, 0, np.concatenate([[0], most[:-1]]))
    holds = cutoffs[pairs] > before
    return pairs[holds], before[holds], cutoffs[pairs][holds]


def _of_one_detection(
    pairs: Int[np.ndarray, " q"],
    detection: Int[np.ndarray, " p"],
    weight: Int[np.ndarray, " p"],
    cutoffs: Int[np.ndarray, " p"],
) -> _Rows:
    """One prediction that meets several annotated boxes: it takes the best."""
    pairs = pairs[np.lexsort((pairs, -weight[pairs], detection[pairs]))]
    pairs = pairs[_is_new(detection[pairs])]
    return pairs, np.zeros(len(pairs), dtype=np.int64), cutoffs[pairs]


def _is_new(values: Int[np.ndarray, " q"]) -> Bool[np.ndarray, " q"]:
    return np.concatenate([[True], values[1:] != values[:-1]]) if len(values) else np.zeros(0, dtype=bool)


def _of_many(
    pairs: Int[np.ndarray, " q"],
    box: Int[np.ndarray, " p"],
    detection: Int[np.ndarray, " p"],
    weight: Int[np.ndarray, " p"],
    cutoffs: Int[np.ndarray, " p"],
) -> _Rows:
    """Several of both: an assignment for each set of predictions that some cut-off leaves."""
    steps = np.unique(cutoffs[pairs])
    chosen, first, last = [], [], []
    for low, high in zip([0, *steps[:-1].tolist()], steps.tolist(), strict=True):
        left = pairs[cutoffs[pairs] >= high]
        boxes, row = np.unique(box[left], return_inverse=True)
        detections, column = np.unique(detection[left], return_inverse=True)
        value = np.zeros((len(boxes), len(detections)), dtype=np.int64)
        number = np.full(value.shape, -1)
        value[row, column], number[row, column] = weight[left], left
        assigned = number[linear_sum_assignment(value, maximize=True)]
        assigned = assigned[assigned >= 0]
        chosen.append(assigned)
        first.append(np.full(len(assigned), low))
        last.append(np.full(len(assigned), high))
    return np.concatenate(chosen), np.concatenate(first), np.concatenate(last)
