"""nuScenes' scores of tracks: CLEAR MOT with carried-over matches at 40 recalls, AMOTA and AMOTP.

The quirks are the development kit's (``eval/tracking``, Apache-2.0, and motmetrics): pairs nearer than a distance; a
pair that was matched last goes on before others are assigned; a switch over a gap counts; MOTAR is of the measured
recall, without switches; MOTA is clipped at 0; the best threshold is the lowest one with the best MOTA.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.metrics.tracking.clear import Figures
from farfield.metrics.tracking.pairing import best_pairs

THRESHOLDS = 40
_LEAST_RECALL = 0.1
_COUNT_FIRST = 1000.0
WORST = {"MOTA": 0.0, "recall": 0.0, "MT": 0.0, "FAF": 500.0, "TP": 0.0, "TID": 20.0, "LGD": 20.0}
"""Figures where no recall is reached, beside AMOTA 0, and AMOTP and MOTP of the largest distance."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ClassBoxes:
    """The boxes of one class, by frame.

    Args:
        frame: Number of the frame, rising, shape (n,).
        track: Number of the track, shape (n,).
        place_m: x and y in the world, shape (n, 2).
        range_m: Distance from the sensor, shape (n,).
        score: Mean score of the track, shape (n,).
    """

    frame: Int[np.ndarray, " n"]
    track: Int[np.ndarray, " n"]
    place_m: Float[np.ndarray, "n 2"]
    range_m: Float[np.ndarray, " n"]
    score: Float[np.ndarray, " n"]

    def __len__(self) -> int:
        return len(self.frame)


@dataclass(frozen=True, eq=False, kw_only=True)
class ThresholdMatches:
    """Which predicted box each annotated one got at a threshold.

    Args:
        row: Row of the predicted box, -1 for none, shape (m,).
        switch: Whether the identity is another one than at the last match, shape (m,).
        distance_m: Between the two, 0 where there is none, shape (m,).
        kept: Predicted boxes that take part, shape (n,).
    """

    row: Int[np.ndarray, " m"]
    switch: Bool[np.ndarray, " m"]
    distance_m: Float[np.ndarray, " m"]
    kept: Bool[np.ndarray, " n"]


class PairFollower:
    """The pairs of a data set that may match, to be followed at any threshold.

    Args:
        annotated: Annotated boxes.
        predicted: Predicted boxes.
        pair: Rows of both of the same frame that are nearer than the distance, shape (p, 2), by the first.
        distance_m: Of each pair, shape (p,).
    """

    def __init__(
        self,
        annotated: ClassBoxes,
        predicted: ClassBoxes,
        pair: Int[np.ndarray, "p 2"],
        distance_m: Float[np.ndarray, " p"],
    ) -> None:
        self.annotated, self.predicted, self.pair, self.distance_m = annotated, predicted, pair, distance_m

    def follow(self, least: float) -> ThresholdMatches:
        """Match frame by frame with the tracks of at least a score."""
        kept = self.predicted.score >= least
        usable = np.flatnonzero(kept[self.pair[:, 1]])
        row = np.full(len(self.annotated), -1)
        switch, distance = np.zeros(len(row), dtype=bool), np.zeros(len(row))
        last: dict[int, int] = {}
        cuts = np.flatnonzero(np.diff(self.annotated.frame[self.pair[usable, 0]])) + 1
        for part in np.split(usable, cuts) if len(usable) else []:
            for place, switched in self._of_frame(part, last):
                a, b = self.pair[place]
                row[a], switch[a], distance[a] = b, switched, self.distance_m[place]
        return ThresholdMatches(row=row, switch=switch, distance_m=distance, kept=kept)

    def _of_frame(self, part: Int[np.ndarray, " q"], last: dict[int, int]) -> list[tuple[int, bool]]:
        """Places of a frame's matched pairs, and whether each is a switch; brings ``last`` up to date."""
        a, b = self.pair[part].T
        names, others = self.annotated.track[a].tolist(), self.predicted.track[b].tolist()
        rows, columns, places = a.tolist(), b.tolist(), part.tolist()
        found, taken, taken_b = [], set(), set()
        for place, i, j, name, other in zip(places, rows, columns, names, others, strict=True):
            if last.get(name) == other and j not in taken_b:
                found.append((place, False))
                taken.add(i)
                taken_b.add(j)
        rest = [n for n in range(len(places)) if rows[n] not in taken and columns[n] not in taken_b]
        if not rest:
            return found
        if len({rows[n] for n in rest}) == len(rest) == len({columns[n] for n in rest}):
            chosen = rest
        else:
            picked = part[rest]
            gain = _COUNT_FIRST - self.distance_m[picked]
            chosen = [rest[n] for n in best_pairs(a[rest], b[rest], gain, np.zeros(len(rest), dtype=np.int64))]
        for n in chosen:
            found.append((places[n], last.get(names[n], others[n]) != others[n]))
            last[names[n]] = others[n]
        return found


def thresholds(first: ThresholdMatches, predicted: ClassBoxes, annotated: int) -> list[float | None]:
    """Scores at which recalls 0.1 ... 1 are reached, the highest recall first; None where one is not reached."""
    hit = first.row[(first.row >= 0) & ~first.switch]
    scores = np.sort(predicted.score[hit])[::-1]
    if not len(scores):
        return [None] * THRESHOLDS
    recall = np.arange(1, len(scores) + 1) / annotated
    wanted = np.linspace(_LEAST_RECALL, 1, THRESHOLDS).round(12)
    at = np.interp(wanted, recall, scores, right=0)
    return [float(s) if r <= recall.max() else None for s, r in zip(at[::-1], wanted[::-1], strict=True)]


def figures_at(
    follower: PairFollower, found: ThresholdMatches, step_s: float, bin_m: tuple[float, float] | None = None
) -> dict[str, float]:
    """The rates and counts at one threshold, of all boxes or of a range bin; whole tracks for all boxes only."""
    annotated, predicted = follower.annotated, follower.predicted
    low, high = bin_m or (0.0, np.inf)
    here = (annotated.range_m >= low) & (annotated.range_m < high)
    there = (predicted.range_m >= low) & (predicted.range_m < high) & found.kept
    taken = np.zeros(len(predicted), dtype=bool)
    taken[found.row[found.row >= 0]] = True
    hit = (found.row >= 0) & here
    annotated_count, switches = int(here.sum()), int((found.switch & here).sum())
    matches, missed, false = int(hit.sum()) - switches, annotated_count - int(hit.sum()), int((there & ~taken).sum())
    frames = len(np.unique(np.concatenate([annotated.frame[here], predicted.frame[there]])))
    out = {
        "MOTA": max(0.0, 1 - (missed + switches + false) / annotated_count) if annotated_count else np.nan,
        "MOTP": float(found.distance_m[hit].sum()) / int(hit.sum()) if hit.any() else np.nan,
        "recall": int(hit.sum()) / annotated_count if annotated_count else np.nan,
        "TP": float(matches),
        "FP": float(false),
        "FN": float(missed),
        "IDS": float(switches),
    }
    if bin_m is not None:
        return out
    recall = matches / annotated_count
    error = missed + switches + false - (1 - recall) * annotated_count
    out["MOTAR"] = max(0.0, 1 - error / (recall * annotated_count)) if matches else np.nan
    return out | {"FAF": 100 * false / max(frames, 1)} | _of_tracks(annotated, found.row >= 0, step_s)


def _of_tracks(annotated: ClassBoxes, hit: Bool[np.ndarray, " m"], step_s: float) -> dict[str, float]:
    """What is counted by annotated track: found or lost as a whole, fragments, time to the first match, gaps."""
    order = np.lexsort([annotated.frame, annotated.track])
    track, frame, hit = annotated.track[order], annotated.frame[order], hit[order]
    track = np.unique(track, return_inverse=True)[1].reshape(-1)
    count, found = np.bincount(track), np.bincount(track, hit)
    seen = found > 0
    share = found / count
    start = np.cumsum(count) - count
    place = np.arange(len(track))
    # A gap ends a fragment if a match of the same track comes later.
    latest = np.full(len(count), -1)
    np.maximum.at(latest, track[hit], place[hit])
    first = np.full(len(count), len(track))
    np.minimum.at(first, track[hit], place[hit])
    broken = hit[:-1] & ~hit[1:] & (track[:-1] == track[1:]) & (place[1:] < latest[track[1:]])
    since = np.cumsum(hit) + track  # the same for each run of misses, and no other
    run = np.unique(since, return_inverse=True)[1].reshape(-1)
    length = np.bincount(run, ~hit)
    longest = np.zeros(len(count))
    np.maximum.at(longest, track, length[run])
    begins = frame[np.minimum(first, len(track) - 1)] - frame[start]
    return {
        "MT": float((share >= 0.8).sum()),
        "ML": float((share < 0.2).sum()),
        "tracks": float(len(count)),
        "FRAG": float(broken.sum()),
        "TID": step_s * float(begins[seen].mean()) if seen.any() else np.nan,
        "LGD": step_s * float(longest[seen].mean()) if seen.any() else np.nan,
    }


@dataclass(frozen=True, eq=False, kw_only=True)
class AmotaFigures:
    """AMOTA, AMOTP, and the figures at the threshold with the best MOTA.

    Args:
        figures: All of them; None where something is not known, or nothing is annotated.
        found: The matching at that threshold.
        threshold: That score; None where no recall is reached.
    """

    figures: Figures
    found: ThresholdMatches
    threshold: float | None


def average(follower: PairFollower, *, distance_m: float, step_s: float = 0.5) -> AmotaFigures:
    """Score at the recalls from 0.1 to 1; recalls that are not reached count as worst.

    Args:
        follower: The boxes, at least one of them annotated.
        distance_m: The distance that pairs are nearer than, the worst MOTP.
        step_s: Seconds between frames, for TID and LGD.
    """
    every = follower.follow(-np.inf)
    wanted = thresholds(every, follower.predicted, len(follower.annotated))
    by_score = {score: follower.follow(score) for score in dict.fromkeys(wanted) if score is not None}
    figures = {score: figures_at(follower, found, step_s) for score, found in by_score.items()}
    at = [None if score is None else figures[score] for score in wanted]
    motar = [0.0 if each is None or np.isnan(each["MOTAR"]) else each["MOTAR"] for each in at]
    motp = [distance_m if each is None or np.isnan(each["MOTP"]) else each["MOTP"] for each in at]
    averages: Figures = {"AMOTA": float(np.mean(motar)), "AMOTP": float(np.mean(motp))}
    if not figures:
        count, tracks = float(len(follower.annotated)), float(len(np.unique(follower.annotated.track)))
        rest: Figures = {"ML": tracks, "tracks": tracks, "FN": count, "MOTP": distance_m} | dict.fromkeys(_UNKNOWN)
        return AmotaFigures(figures=averages | WORST | rest, found=every, threshold=None)
    best = max(figures, key=lambda score: (figures[score]["MOTA"], -score))
    chosen: Figures = {name: None if np.isnan(value) else value for name, value in figures[best].items()}
    return AmotaFigures(figures=averages | chosen, found=by_score[best], threshold=best)


_UNKNOWN = ("FP", "IDS", "FRAG", "MOTAR")
