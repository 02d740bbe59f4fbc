"""KITTI's matching at every score threshold at once.

KITTI matches anew at each threshold: the annotated boxes choose in their order, each the free prediction above the
threshold that overlaps it most. Most pairs stand alone: there the prediction is a true positive wherever it is allowed.
In the few frames with contested boxes the matching is done for every prefix of the frame's contested predictions,
ranked by score. What a prediction adds when it joins the prefix is its gain: the true positives above any threshold, in
any set of frames, are then the sum of the gains above it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int

_ROWS_AT_ONCE = 1 << 20  # of the expanded table: some 60 MB of temporaries


@dataclass(frozen=True, eq=False, kw_only=True)
class OverlapGains:
    """What the predictions of one class add at one overlap.

    Args:
        true: Change in true positives as the prediction is allowed, shape (n,).
        excused: Change in predictions taken by boxes that need not be found, shape (n,).
        is_true: Predictions that are true if all are allowed and boxes choose by score, shape (n,).
    """

    true: Int[np.ndarray, " n"]
    excused: Int[np.ndarray, " n"]
    is_true: Bool[np.ndarray, " n"]


def gains(
    box: Int[np.ndarray, " p"],
    detection: Int[np.ndarray, " p"],
    overlap: Float[np.ndarray, " p"],
    *,
    frame: Int[np.ndarray, " m"],
    optional: Bool[np.ndarray, " m"],
    score: Float[np.ndarray, " n"],
    order: Int[np.ndarray, " n"],
) -> OverlapGains:
    """Match one class at one overlap.

    Args:
        box: Annotated box of each pair that overlaps enough; a frame's boxes choose in this order, optional ones last.
        detection: Prediction of each pair.
        overlap: Overlap of each pair.
        frame: Frame of each annotated box.
        optional: Annotated boxes that may be found or not.
        score: Score of each prediction.
        order: Place of each prediction in its file: of equal scores or overlaps the first is chosen.
    """
    true, excused = np.zeros(len(score), dtype=np.int64), np.zeros(len(score), dtype=np.int64)
    is_true = np.zeros(len(score), dtype=bool)
    alone = (np.bincount(box, minlength=len(frame))[box] == 1) & (np.bincount(detection)[detection] == 1)
    true[detection[alone]] = ~optional[box[alone]]
    excused[detection[alone]] = optional[box[alone]]
    is_true[detection[alone]] = ~optional[box[alone]]
    if alone.all():
        return OverlapGains(true=true, excused=excused, is_true=is_true)
    rest = ~alone
    crowd = _ContestedPairs.of(
        box[rest], detection[rest], overlap[rest], frame=frame, optional=optional, score=score, order=order
    )
    is_assigned, chosen = crowd.allowing_all()
    is_true[chosen] = is_assigned
    for first, last in crowd.chunks():
        unit = int(crowd.unit[first])
        taken_true, taken_excused = (
            crowd.joining_one_by_one(unit) if crowd.is_large[unit] else crowd.allowing_prefixes(first, last)
        )
        crowd.true[first:last], crowd.excused[first:last] = taken_true, taken_excused
    leads = np.zeros(len(crowd.detection), dtype=bool)
    leads[crowd.start] = True
    for total, gain in ((crowd.true, true), (crowd.excused, excused)):
        gain[crowd.detection] = total - np.where(leads, 0, np.roll(total, 1))
    return OverlapGains(true=true, excused=excused, is_true=is_true)


@dataclass(frozen=True, eq=False, kw_only=True)
class _ContestedPairs:
    """Contested pairs, ranked for choosing, and the frames' contested predictions, the best score first.

    A prefix is named by its last prediction: prefix i holds the predictions start[unit] ... i, and "unit" is a frame.
    """

    pair_unit: Int[np.ndarray, " p"]
    pair_box: Int[np.ndarray, " p"]  # place of the box in the order of choosing, from 0 on in each unit
    pair_place: Int[np.ndarray, " p"]  # prediction's place among all contested ones
    pair_overlap: Float[np.ndarray, " p"]
    pair_optional: Bool[np.ndarray, " p"]
    start: Int[np.ndarray, " u"]
    size: Int[np.ndarray, " u"]
    detection: Int[np.ndarray, " k"]
    file_order: Int[np.ndarray, " k"]
    unit: Int[np.ndarray, " k"]
    true: Int[np.ndarray, " k"]
    excused: Int[np.ndarray, " k"]

    @classmethod
    def of(
        cls,
        box: Int[np.ndarray, " p"],
        detection: Int[np.ndarray, " p"],
        overlap: Float[np.ndarray, " p"],
        *,
        frame: Int[np.ndarray, " m"],
        optional: Bool[np.ndarray, " m"],
        score: Float[np.ndarray, " n"],
        order: Int[np.ndarray, " n"],
    ) -> "_ContestedPairs":
        members, first = np.unique(detection, return_index=True)
        unit_of = frame[box[first]]
        ranking = np.lexsort((order[members], -score[members], unit_of))
        ranked = members[ranking]
        rank_of = np.empty(len(score), dtype=np.int64)
        rank_of[ranked] = np.arange(len(ranked))
        _, unit, size = np.unique(unit_of[ranking], return_inverse=True, return_counts=True)
        chosen = np.unique(box)
        turn = np.lexsort((chosen, optional[chosen], frame[chosen]))
        _, box_unit, boxes = np.unique(frame[chosen[turn]], return_inverse=True, return_counts=True)
        rank = np.empty(len(frame), dtype=np.int64)
        rank[chosen[turn]] = np.arange(len(chosen)) - (np.cumsum(boxes) - boxes)[box_unit]
        return cls(
            pair_unit=unit[rank_of[detection]],
            pair_box=rank[box],
            pair_place=rank_of[detection],
            pair_overlap=overlap,
            pair_optional=optional[box],
            start=np.cumsum(size) - size,
            size=size,
            detection=ranked,
            file_order=order[ranked],
            unit=unit,
            true=np.zeros(len(ranked), dtype=np.int64),
            excused=np.zeros(len(ranked), dtype=np.int64),
        )

    @cached_property
    def pairs(self) -> Int[np.ndarray, " u"]:
        """Pairs of each frame."""
        return np.bincount(self.pair_unit, minlength=len(self.size))

    @cached_property
    def is_large(self) -> Bool[np.ndarray, " u"]:
        """Frames whose prefixes are so many, of so many pairs, that one after the other is quicker."""
        return self.size * (self.size + self.pairs) > _ROWS_AT_ONCE

    def chunks(self) -> Iterator[tuple[int, int]]:
        """Ranges of prefixes whose tables stay small; a large frame is one of them."""
        rows = np.cumsum((self.size + self.pairs)[self.unit])
        first = 0
        while first < len(rows):
            unit = int(self.unit[first])
            before = rows[first - 1] if first else 0
            last = max(int(np.searchsorted(rows, before + _ROWS_AT_ONCE, side="right")), first + 1)
            large = np.flatnonzero(self.is_large[self.unit[first:last]])
            if self.is_large[unit]:
                last = int(self.start[unit] + self.size[unit])
            elif len(large):
                last = first + int(large[0])
            yield first, last
            first = last

    def allowing_all(self) -> tuple[Bool[np.ndarray, " k"], Int[np.ndarray, " k"]]:
        """Which contested predictions are true if boxes choose by score among all; they, and the predictions."""
        order = np.lexsort((self.pair_place, self.pair_box))
        last = (self.start + self.size - 1)[self.pair_unit[order]]
        pair, _ = self._choose(order, last, self.pair_place[order], np.zeros(len(self.detection), dtype=bool))
        is_true = np.zeros(len(self.detection), dtype=bool)
        is_true[self.pair_place[pair]] = ~self.pair_optional[pair]
        return is_true, self.detection

    def allowing_prefixes(self, first: int, last: int) -> tuple[Int[np.ndarray, " i"], Int[np.ndarray, " i"]]:
        """Boxes that find a prediction in each prefix from ``first`` to before ``last``: required and optional ones."""
        order = np.lexsort((self.file_order[self.pair_place], -self.pair_overlap, self.pair_box))
        end = (self.start + self.size)[self.pair_unit[order]]
        low = np.maximum(self.pair_place[order], first)
        copies = np.maximum(np.minimum(end, last) - low, 0)
        pair = np.repeat(order, copies)
        prefix = np.arange(len(pair)) - np.repeat(np.cumsum(copies) - copies, copies) + np.repeat(low, copies)
        width = self.size[self.unit[first:last]]
        seat = np.cumsum(width) - width - self.start[self.unit[first:last]]
        slot = seat[prefix - first] + self.pair_place[pair]
        chosen, where = self._choose(pair, prefix, slot, np.zeros(int(width.sum()), dtype=bool))
        optional = self.pair_optional[chosen]
        counted = [np.bincount(where[mask] - first, minlength=last - first) for mask in (~optional, optional)]
        return counted[0], counted[1]

    def joining_one_by_one(self, unit: int) -> tuple[Int[np.ndarray, " i"], Int[np.ndarray, " i"]]:
        """What :meth:`allowing_prefixes` gives for all prefixes of one frame, one prediction after the other.

        A prediction that joins is offered to the boxes in their order. The first that prefers it to its own takes it,
        and what it held is offered to the boxes after it; where a box held none, one more is found.
        """
        rows = np.flatnonzero(self.pair_unit == unit)
        rank, box = self.pair_place[rows] - self.start[unit], self.pair_box[rows]
        liking = np.empty(len(rows), dtype=np.int64)  # of the pairs, the least is preferred
        liking[np.lexsort((self.file_order[self.pair_place[rows]], -self.pair_overlap[rows]))] = np.arange(len(rows))
        optional = np.zeros(int(box.max()) + 1, dtype=bool)
        optional[box] = self.pair_optional[rows]
        order = np.lexsort((box, rank))
        edges = np.searchsorted(rank[order], np.arange(int(self.size[unit]) + 1))
        box, liking = box[order], liking[order]
        held, held_liking = np.full(len(optional), -1), np.full(len(optional), len(rows))
        counts = np.zeros((2, int(self.size[unit])), dtype=np.int64)
        for joining in range(int(self.size[unit])):
            offered, first = joining, int(edges[joining])
            while True:
                part = slice(first, int(edges[offered + 1]))
                prefers = liking[part] < held_liking[box[part]]
                if not prefers.any():
                    break
                row = first + int(prefers.argmax())
                taker, released = int(box[row]), int(held[box[row]])
                held[taker], held_liking[taker] = offered, liking[row]
                if released < 0:
                    counts[int(optional[taker]), joining] += 1
                    break
                offered = released
                start, stop = int(edges[offered]), int(edges[offered + 1])
                first = start + int(np.searchsorted(box[start:stop], taker, side="right"))
        return counts.cumsum(axis=1)[0], counts.cumsum(axis=1)[1]

    def _choose(
        self,
        pair: Int[np.ndarray, " r"],
        prefix: Int[np.ndarray, " r"],
        slot: Int[np.ndarray, " r"],
        assigned: Bool[np.ndarray, " s"],
    ) -> tuple[Int[np.ndarray, " t"], Int[np.ndarray, " t"]]:
        """Let the boxes choose, in all prefixes at once.

        Args:
            pair: Pairs in the order of the boxes' turns and, within a turn, of preference.
            prefix: Prefix in which each pair stands.
            slot: Place of its prediction among those of all prefixes.
            assigned: Predictions that are taken, by slot; filled here.

        Returns:
            Pairs that were taken and their prefixes.
        """
        turns = self.pair_box[pair]
        edges = np.searchsorted(turns, np.arange(int(turns.max(initial=-1)) + 2))
        best = np.full(len(self.detection), -1)
        chosen: list[np.ndarray] = []
        for low, high in pairwise(edges.tolist()):
            rows = low + np.flatnonzero(~assigned[slot[low:high]])
            best[prefix[rows[::-1]]] = rows[::-1]  # of equal indices the last one stays: the most preferred
            winners = rows[best[prefix[rows]] == rows]
            assigned[slot[winners]] = True
            chosen.append(winners)
        assignment = np.concatenate([np.zeros(0, dtype=np.int64), *chosen])
        return pair[assignment], prefix[assignment]
