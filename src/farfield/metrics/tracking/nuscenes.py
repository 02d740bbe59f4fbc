"""nuScenes' scores of tracks: CLEAR MOT with carried-over matches at 40 recalls, AMOTA and AMOTP.

Of one class of any data set. Pairs are boxes of a frame whose centres are nearer than d metres seen from above. Tracks
are cut at the scores at which recalls r = 0.1 ... 1 (40 of them) of P annotated boxes are reached. With TP matches, FP
false and FN missed boxes, IDS identity switches and the matches' distances D at such a score (Bernardin & Stiefelhagen,
2008; Weng et al., IROS 2020; ``eval/tracking`` of the nuScenes development kit):

    MOTA  = max(0, 1 - (FP + FN + IDS) / P)                       MOTP  = mean of D
    MOTAR = max(0, 1 - (FP + FN + IDS - (1 - r) P) / (r P))       AMOTA = mean of MOTAR, AMOTP = mean of MOTP over r

A recall that is not reached counts as MOTAR 0 and MOTP d. The other figures are those at the threshold with the best
MOTA. The quirks are the development kit's (Apache-2.0, and motmetrics): a pair that was matched last goes on before
others are assigned; a switch over a gap counts; MOTAR is of the measured recall, without switches; MOTA is clipped at
0; the best threshold is the lowest one with the best MOTA.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.errors import ConfigError
from farfield.frame.drive import Key
from farfield.geometry.boxes import Boxes
from farfield.metrics.detections import Detections, Protocol
from farfield.metrics.frames import check_frames, flatten, frame_order, has_label, near_pairs
from farfield.metrics.options import check_range_bins, json_options
from farfield.metrics.presenting import Presenter
from farfield.metrics.result import Result, table, value_at
from farfield.metrics.tracking.clear import Figures
from farfield.metrics.tracking.scene import best_pairs, collect_rows

_HEADLINE = ("AMOTA", "AMOTP", "MOTA", "MOTP", "recall", "IDS")
_SHARES = ("AMOTA", "MOTA", "MOTAR", "recall")
_METRES_AND_SECONDS = ("AMOTP", "MOTP", "FAF", "TID", "LGD", "threshold")


@dataclass(frozen=True, kw_only=True)
class NuScenesTrackingSettings:
    """Options of nuScenes' scores of tracks.

    Args:
        label: The class that is scored.
        relabel: Class names that stand for another.
        distance_m: Distance of the centres, seen from above, that pairs are nearer than.
        most_range_m: Boxes at this distance from the sensor or further count nowhere, tracks are filled afterwards:
            nuScenes takes 50 m, 40 m for pedestrians and two-wheelers. None keeps all.
        need_points: Whether annotated boxes that are known to hold no point are left out.
        step_s: Seconds between frames for TID and LGD; nuScenes' annotated frames are 0.5 s apart.
        range_bins_m: Edges of the half-open range bins: annotated boxes and matches count where the annotated box is,
            false ones where they are themselves, at the threshold that is best for the whole.
    """

    label: str = "car"
    relabel: Mapping[str, str] = field(default_factory=dict)
    distance_m: float = 2.0
    most_range_m: float | None = None
    need_points: bool = True
    step_s: float = 0.5
    range_bins_m: tuple[float, ...] = (0.0, 70.0, 150.0, 250.0)

    def __post_init__(self) -> None:
        for name in ("distance_m", "most_range_m", "step_s"):
            if getattr(self, name) is not None and not getattr(self, name) > 0:
                raise ConfigError(f"{name}: expected a positive number, got {getattr(self, name)}")
        check_range_bins(self.range_bins_m)

    @property
    def bins_m(self) -> dict[str, tuple[float, float]]:
        """The half-open range bins as (low, high) by name."""
        return {f"{low:g}-{high:g}": (low, high) for low, high in pairwise(self.range_bins_m)}


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class NuScenesTrackingResult(Result):
    """nuScenes' scores of tracks."""

    def __str__(self) -> str:
        parts = [*self.ranges, "overall"]
        rows = [[name.split("/")[1], *(self._cell(part, name) for part in parts)] for name in self.figures]
        title = f"nuScenes' scores of tracks of {self.label!r}, by range in metres; shares in per cent; '-': not there"
        return f"{title}\n\n{table(['', *parts], rows)}\n\n{self.footer()}"

    def _cell(self, part: str, name: str) -> str:
        value = (self.figures if part == "overall" else self.ranges[part]).get(name)
        if value is None:
            return "-"
        short = name.split("/")[1]
        if short in _SHARES:
            return self.cell(part, name)
        return f"{value:.3f}" if short in _METRES_AND_SECONDS else f"{value:.0f}"


class NuScenesTrackingPresenter(Presenter):
    """How NuScenesTracking is shown."""

    def title(self, figure: str) -> str:
        """The rate's own name."""
        return figure.removeprefix("tracking/")


class NuScenesTracking(Protocol):
    """AMOTA, AMOTP and what stands beside them, as nuScenes' development kit has them."""

    name = "nuscenes-tracking"
    Settings = NuScenesTrackingSettings
    presenter = NuScenesTrackingPresenter()

    def evaluate(self, detections: Detections, settings: NuScenesTrackingSettings) -> NuScenesTrackingResult:
        """Score the tracks of one class.

        Raises:
            ConfigError: If boxes have no track, or a track has two boxes in a frame.
        """
        check_frames(detections.boxes, detections.annotated)
        # 1. Gather the boxes, in the world where there are poses, and the pairs that may match.
        pairs = gather_pairs(detections, settings)
        figures: dict[str, float | None] = {}
        ranges: dict[str, dict[str, float | None]] = {name: {} for name in settings.bins_m}
        if len(pairs.annotated):
            # 2. Match at the scores of 40 recalls, and average.
            averaged = average(pairs, distance_m=settings.distance_m, step_s=settings.step_s)
            figures = {f"tracking/{name}": value for name, value in averaged.figures.items()}
            figures["tracking/threshold"] = averaged.threshold
            for name, bin_m in settings.bins_m.items():
                in_bin = figures_at(pairs, averaged.matches, settings.step_s, bin_m)
                ranges[name] = {f"tracking/{n}": None if np.isnan(value) else value for n, value in in_bin.items()}
        return NuScenesTrackingResult(
            protocol=str(self),
            label=settings.label,
            settings=json_options(asdict(settings)),
            convention="",
            figures=figures or dict.fromkeys(f"tracking/{name}" for name in _HEADLINE),
            ranges=ranges,
            counts={
                "annotated": len(pairs.annotated),
                "predictions": len(pairs.predicted),
                "frames": len(detections.annotations),
            },
        )

    def headline(self, result: Mapping[str, Any]) -> Mapping[str, float | None]:
        """The rates of the whole."""
        return {f"tracking/{name}": value_at(result, f"tracking/{name}") for name in _HEADLINE}

    def inert(self, settings: Mapping[str, Any]) -> tuple[str, ...]:
        """Range bins and the label."""
        del settings
        return ("label", "range_bins_m")


def gather_pairs(detections: Detections, settings: NuScenesTrackingSettings) -> "MatchablePairs":
    """Collect one class of all frames: in the world where there are poses, tracks filled over missing frames."""
    keys = sorted(detections.annotations, key=frame_order)
    annotations = [detections.annotations[key].boxes for key in keys]
    predictions = [detections.boxes.get(key, Boxes.empty(scored=True)) for key in keys]
    if settings.need_points:
        annotations = [boxes if boxes.point_count is None else boxes[boxes.point_count != 0] for boxes in annotations]
    times = _times(detections, keys)
    annotated = _class_boxes(detections, keys, annotations, times, settings, what="annotations")
    predicted = _class_boxes(detections, keys, predictions, times, settings, what="predictions")
    measure = partial(_nearness, annotated, predicted, settings.distance_m)
    pair, _ = near_pairs(annotated.frame, predicted.frame, len(keys), measure, keys.__getitem__)
    return MatchablePairs(annotated, predicted, pair, _gap_m(annotated, predicted, pair))


def _gap_m(annotated: "ClassBoxes", predicted: "ClassBoxes", pair: Int[np.ndarray, "p 2"]) -> Float[np.ndarray, " p"]:
    return np.hypot(*(annotated.centre_m[pair[:, 0]] - predicted.centre_m[pair[:, 1]]).T)


def _nearness(
    annotated: "ClassBoxes", predicted: "ClassBoxes", distance_m: float, pair: Int[np.ndarray, "p 2"]
) -> Float[np.ndarray, " p"]:
    """By how much the centres of each pair are nearer than a distance, metres."""
    return distance_m - _gap_m(annotated, predicted, pair)


def _times(detections: Detections, keys: list[Key]) -> Int[np.ndarray, " frames"]:
    """Stamps of the frames, or their places where there are none."""
    stamps = {key: number for number, key in enumerate(keys)}
    for drive in detections.drives:
        if drive.times_ns is not None:
            stamps |= dict(zip(drive.keys, drive.times_ns.tolist(), strict=True))
    return np.array([stamps[key] for key in keys], dtype=np.int64)


def _class_boxes(
    detections: Detections,
    keys: list[Key],
    parts: list[Boxes],
    times: Int[np.ndarray, " frames"],
    settings: NuScenesTrackingSettings,
    *,
    what: str,
) -> "ClassBoxes":
    limit_m = np.inf if settings.most_range_m is None else settings.most_range_m
    parts = [boxes[boxes.range_m < limit_m] for boxes in parts]
    boxes = flatten(parts, scored=what == "predictions")
    used = has_label(boxes, settings.label, settings.relabel)
    rows = collect_rows(keys, parts, boxes, used, np.zeros(len(boxes), dtype=bool), what=what)
    poses = {
        key: drive.world_T_frame[number]
        for drive in detections.drives
        if drive.world_T_frame is not None
        for number, key in enumerate(drive.keys)
    }
    moved = [part.transform(poses[key]) if key in poses else part for key, part in zip(keys, parts, strict=True)]
    centre_m = np.concatenate([np.zeros((0, 2)), *(part.centre_m[:, :2] for part in moved)])[used]
    return _interpolate_gaps(
        ClassBoxes(frame=rows.frame, track=rows.track, centre_m=centre_m, range_m=rows.range_m, score=rows.score), times
    )


def _interpolate_gaps(boxes: "ClassBoxes", times: Int[np.ndarray, " frames"]) -> "ClassBoxes":
    """Tracks with boxes in the frames between, linear in time; the kit gives the later box the earlier one's weight."""
    order = np.lexsort([boxes.frame, boxes.track])
    left, right = order[:-1], order[1:]
    gap = np.flatnonzero((boxes.track[left] == boxes.track[right]) & (boxes.frame[right] - boxes.frame[left] > 1))
    left, right = left[gap], right[gap]
    missing = boxes.frame[right] - boxes.frame[left] - 1
    a, b = np.repeat(left, missing), np.repeat(right, missing)
    frame = boxes.frame[a] + 1 + np.arange(len(a)) - np.repeat(np.cumsum(missing) - missing, missing)
    share = (times[boxes.frame[b]] - times[frame]) / (times[boxes.frame[b]] - times[boxes.frame[a]])
    first_row = np.full(int(boxes.track.max(initial=0)) + 1, len(boxes))
    np.minimum.at(first_row, boxes.track, np.arange(len(boxes)))
    # In a frame the filled boxes follow the others, in the order in which their tracks begin.
    order_key = np.r_[np.arange(len(boxes)), len(boxes) + first_row[boxes.track[a]]]
    order = np.lexsort([order_key, np.r_[boxes.frame, frame]])
    centre_m = _between(boxes.centre_m[a], boxes.centre_m[b], share[:, None])
    return ClassBoxes(
        frame=np.r_[boxes.frame, frame][order],
        track=np.r_[boxes.track, boxes.track[a]][order],
        centre_m=np.concatenate([boxes.centre_m, centre_m])[order],
        range_m=np.r_[boxes.range_m, _between(boxes.range_m[a], boxes.range_m[b], share)][order],
        score=np.r_[boxes.score, _between(boxes.score[a], boxes.score[b], share)][order],
    )


def _between(
    a: Float[np.ndarray, "n ..."], b: Float[np.ndarray, "n ..."], share: Float[np.ndarray, "n ..."]
) -> Float[np.ndarray, "n ..."]:
    return np.asarray((1.0 - share) * a + share * b)


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
        centre_m: x and y in the world, shape (n, 2).
        range_m: Distance from the sensor, shape (n,).
        score: Mean score of the track, shape (n,).
    """

    frame: Int[np.ndarray, " n"]
    track: Int[np.ndarray, " n"]
    centre_m: Float[np.ndarray, "n 2"]
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
        allowed: Predicted boxes whose track reaches the threshold, shape (n,).
    """

    row: Int[np.ndarray, " m"]
    switch: Bool[np.ndarray, " m"]
    distance_m: Float[np.ndarray, " m"]
    allowed: Bool[np.ndarray, " n"]


class MatchablePairs:
    """The pairs of a data set that may match, to be matched at any threshold.

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

    def match(self, least: float) -> ThresholdMatches:
        """Match frame by frame with the tracks of at least a score."""
        allowed = self.predicted.score >= least
        usable = np.flatnonzero(allowed[self.pair[:, 1]])
        row = np.full(len(self.annotated), -1)
        switch, distance = np.zeros(len(row), dtype=bool), np.zeros(len(row))
        last: dict[int, int] = {}
        cuts = np.flatnonzero(np.diff(self.annotated.frame[self.pair[usable, 0]])) + 1
        for part in np.split(usable, cuts) if len(usable) else []:
            for pair, is_switch in self._match_frame(part, last):
                a, b = self.pair[pair]
                row[a] = b
                switch[a] = is_switch
                distance[a] = self.distance_m[pair]
        return ThresholdMatches(row=row, switch=switch, distance_m=distance, allowed=allowed)

    def _match_frame(self, part: Int[np.ndarray, " q"], last: dict[int, int]) -> list[tuple[int, bool]]:
        """Indices of a frame's matched pairs, and whether each is a switch; brings ``last`` up to date."""
        a, b = self.pair[part].T
        rows, columns = a.tolist(), b.tolist()
        tracks, predicted_tracks = self.annotated.track[a].tolist(), self.predicted.track[b].tolist()
        matches: list[tuple[int, bool]] = []
        matched_rows, matched_columns = set[int](), set[int]()
        # Pairs that were matched last go on.
        for pair, row, column, track, other in zip(part.tolist(), rows, columns, tracks, predicted_tracks, strict=True):
            if last.get(track) == other and column not in matched_columns:
                matches.append((pair, False))
                matched_rows.add(row)
                matched_columns.add(column)
        # The others are assigned: as many as possible, then the least sum of distances.
        free = [n for n in range(len(part)) if rows[n] not in matched_rows and columns[n] not in matched_columns]
        if not free:
            return matches
        if len({rows[n] for n in free}) == len(free) == len({columns[n] for n in free}):
            chosen = free
        else:
            gain = _COUNT_FIRST - self.distance_m[part[free]]
            chosen = [free[n] for n in best_pairs(a[free], b[free], gain, np.zeros(len(free), dtype=np.int64))]
        for n in chosen:
            matches.append((int(part[n]), last.get(tracks[n], predicted_tracks[n]) != predicted_tracks[n]))
            last[tracks[n]] = predicted_tracks[n]
        return matches


def thresholds(first: ThresholdMatches, predicted: ClassBoxes, annotated: int) -> list[float | None]:
    """Scores at which recalls 0.1 ... 1 are reached, the highest recall first; None where one is not reached."""
    hit = first.row[(first.row >= 0) & ~first.switch]
    scores = np.sort(predicted.score[hit])[::-1]
    if not len(scores):
        return [None] * THRESHOLDS
    recall = np.arange(1, len(scores) + 1) / annotated
    targets = np.linspace(_LEAST_RECALL, 1, THRESHOLDS).round(12)
    at = np.interp(targets, recall, scores, right=0)
    return [float(s) if r <= recall.max() else None for s, r in zip(at[::-1], targets[::-1], strict=True)]


def figures_at(
    pairs: MatchablePairs, matches: ThresholdMatches, step_s: float, bin_m: tuple[float, float] | None = None
) -> dict[str, float]:
    """The rates and counts at one threshold, of all boxes or of a range bin; whole tracks for all boxes only."""
    annotated, predicted = pairs.annotated, pairs.predicted
    low, high = bin_m or (0.0, np.inf)
    annotated_in = (annotated.range_m >= low) & (annotated.range_m < high)
    predicted_in = (predicted.range_m >= low) & (predicted.range_m < high) & matches.allowed
    is_matched = np.zeros(len(predicted), dtype=bool)
    is_matched[matches.row[matches.row >= 0]] = True
    hit = (matches.row >= 0) & annotated_in
    count, hits, switches = int(annotated_in.sum()), int(hit.sum()), int((matches.switch & annotated_in).sum())
    true, missed, false = hits - switches, count - hits, int((predicted_in & ~is_matched).sum())
    frames = len(np.unique(np.concatenate([annotated.frame[annotated_in], predicted.frame[predicted_in]])))
    out = {
        "MOTA": max(0.0, 1 - (missed + switches + false) / count) if count else np.nan,
        "MOTP": float(matches.distance_m[hit].sum()) / hits if hits else np.nan,
        "recall": hits / count if count else np.nan,
        "TP": float(true),
        "FP": float(false),
        "FN": float(missed),
        "IDS": float(switches),
    }
    if bin_m is not None:
        return out
    recall = true / count
    error = missed + switches + false - (1 - recall) * count
    out["MOTAR"] = max(0.0, 1 - error / (recall * count)) if true else np.nan
    return out | {"FAF": 100 * false / max(frames, 1)} | _whole_track_figures(annotated, matches.row >= 0, step_s)


def _whole_track_figures(annotated: ClassBoxes, hit: Bool[np.ndarray, " m"], step_s: float) -> dict[str, float]:
    """What is counted by annotated track: mostly tracked or lost, fragments, time to the first match, longest gap."""
    order = np.lexsort([annotated.frame, annotated.track])
    track, frame, hit = annotated.track[order], annotated.frame[order], hit[order]
    track = np.unique(track, return_inverse=True)[1].reshape(-1)
    length, matched = np.bincount(track), np.bincount(track, hit)
    is_matched = matched > 0
    share = matched / length
    start = np.cumsum(length) - length
    index = np.arange(len(track))
    # A gap ends a fragment if a match of the same track comes later.
    latest = np.full(len(length), -1)
    np.maximum.at(latest, track[hit], index[hit])
    first = np.full(len(length), len(track))
    np.minimum.at(first, track[hit], index[hit])
    is_broken = hit[:-1] & ~hit[1:] & (track[:-1] == track[1:]) & (index[1:] < latest[track[1:]])
    # The sum of matches and tracks so far is the same for each run of misses, and for no other.
    run = np.unique(np.cumsum(hit) + track, return_inverse=True)[1].reshape(-1)
    run_length = np.bincount(run, ~hit)
    longest = np.zeros(len(length))
    np.maximum.at(longest, track, run_length[run])
    delay = frame[np.minimum(first, len(track) - 1)] - frame[start]
    return {
        "MT": float((share >= 0.8).sum()),
        "ML": float((share < 0.2).sum()),
        "tracks": float(len(length)),
        "FRAG": float(is_broken.sum()),
        "TID": step_s * float(delay[is_matched].mean()) if is_matched.any() else np.nan,
        "LGD": step_s * float(longest[is_matched].mean()) if is_matched.any() else np.nan,
    }


@dataclass(frozen=True, eq=False, kw_only=True)
class AmotaFigures:
    """AMOTA, AMOTP, and the figures at the threshold with the best MOTA.

    Args:
        figures: All of them; None where something is not known, or nothing is annotated.
        matches: The matching at that threshold.
        threshold: That score; None where no recall is reached.
    """

    figures: Figures
    matches: ThresholdMatches
    threshold: float | None


def average(pairs: MatchablePairs, *, distance_m: float, step_s: float = 0.5) -> AmotaFigures:
    """Score at the recalls from 0.1 to 1; recalls that are not reached count as worst.

    Args:
        pairs: The boxes, at least one of them annotated.
        distance_m: The distance that pairs are nearer than, the worst MOTP.
        step_s: Seconds between frames, for TID and LGD.
    """
    all_matches = pairs.match(-np.inf)
    scores = thresholds(all_matches, pairs.predicted, len(pairs.annotated))
    by_score = {score: pairs.match(score) for score in dict.fromkeys(scores) if score is not None}
    figures = {score: figures_at(pairs, matches, step_s) for score, matches in by_score.items()}
    at_recall = [None if score is None else figures[score] for score in scores]
    motar = [0.0 if at is None or np.isnan(at["MOTAR"]) else at["MOTAR"] for at in at_recall]
    motp = [distance_m if at is None or np.isnan(at["MOTP"]) else at["MOTP"] for at in at_recall]
    averages: Figures = {"AMOTA": float(np.mean(motar)), "AMOTP": float(np.mean(motp))}
    if not figures:
        count, tracks = float(len(pairs.annotated)), float(len(np.unique(pairs.annotated.track)))
        rest: Figures = {"ML": tracks, "tracks": tracks, "FN": count, "MOTP": distance_m} | dict.fromkeys(_UNKNOWN)
        return AmotaFigures(figures=averages | WORST | rest, matches=all_matches, threshold=None)
    best = max(figures, key=lambda score: (figures[score]["MOTA"], -score))
    at_best: Figures = {name: None if np.isnan(value) else value for name, value in figures[best].items()}
    return AmotaFigures(figures=averages | at_best, matches=by_score[best], threshold=best)


_UNKNOWN = ("FP", "IDS", "FRAG", "MOTAR")
