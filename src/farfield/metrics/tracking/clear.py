"""CLEAR MOT by KITTI's rules, and AB3DMOT's integrals over recall (Weng et al., IROS 2020, section 4).

Of P annotated boxes TP are matched and FN are not; FP predictions are false; IDS matches switch the identity; S is the
similarity of a match (Bernardin & Stiefelhagen, 2008):

    MOTA     = 1 - (FP + FN + IDS) / P                            MOTP = mean of S
    sMOTA(r) = 1 - (FP + FN + IDS - (1 - r) P) / (r P), kept in [0, 1]
    sAMOTA, AMOTA, AMOTP = means of sMOTA, MOTA, MOTP over the recalls r = 1/40, 2/40 ... 1

where tracks are cut at the score at which recall r is reached; recalls that are not reached count 0. Each frame is
matched afresh: first as many pairs as possible, then the largest sum of similarities. Matches with ignored boxes count
nowhere. An identity switch needs the frame before to be matched too; an ignored frame resets. A fragment is a change of
the matched track, back from nothing too, if the frame after it is matched.
"""

from dataclasses import asdict, dataclass

import numpy as np
from jaxtyping import Bool, Int

from farfield.metrics.recall_sampling import SAMPLES, sample_thresholds
from farfield.metrics.tracking.scene import TrackingScene, best_pairs

Figures = dict[str, float | None]
_FOUND_WHOLE, _FOUND_LOST = 0.8, 0.2
_COUNT_FIRST = 1000.0


@dataclass(frozen=True, kw_only=True)
class Clear:
    """Counts of a whole data set, or of a range bin.

    Args:
        TP: Matches; FP: false boxes; FN: annotated boxes that were not found; IDS: identity switches; FRAG: fragments.
        MT: Annotated tracks found in more than 80 % of their frames; ML: in less than 20 %; tracks: all of them.
        similarity: Sum over the matches.
    """

    TP: int
    FP: int
    FN: int
    IDS: int
    FRAG: int
    MT: int = 0
    ML: int = 0
    tracks: int = 0
    similarity: float = 0.0

    @property
    def annotated(self) -> int:
        """Annotated boxes that must be found."""
        return self.TP + self.FN

    @property
    def mota(self) -> float:
        """Multi-object tracking accuracy; 0 where nothing is annotated."""
        return 1 - (self.FP + self.FN + self.IDS) / self.annotated if self.annotated else 0.0

    @property
    def motp(self) -> float:
        """Mean similarity of the matches; 0 without any."""
        return self.similarity / self.TP if self.TP else 0.0

    def scaled_mota(self, recall: float) -> float:
        """SMOTA at a nominal recall, in [0, 1]."""
        errors = self.FP + self.FN + self.IDS - (1 - recall) * self.annotated
        return min(1.0, max(0.0, 1 - errors / (recall * self.annotated)))

    def figures(self) -> Figures:
        """MOTA, MOTP and the counts; None where nothing is annotated."""
        counts = {name: float(value) for name, value in asdict(self).items() if name != "similarity"}
        if not self.annotated:
            return dict.fromkeys(("MOTA", "MOTP", *counts))
        return {"MOTA": self.mota, "MOTP": self.motp, **counts}


@dataclass(frozen=True, eq=False, kw_only=True)
class FrameMatches:
    """Which predicted box each annotated one got.

    Args:
        row: Row of the predicted box, -1 for none, shape (m,).
        similarity: Of the two, shape (m,).
        false: Predicted boxes that nothing took and nothing excuses, shape (n,).
    """

    row: Int[np.ndarray, " m"]
    similarity: np.ndarray
    false: Bool[np.ndarray, " n"]


def match(scene: TrackingScene, least: float, taking_part: Bool[np.ndarray, " n"] | None = None) -> FrameMatches:
    """Match all frames.

    Args:
        scene: The boxes.
        least: Similarity that a match needs.
        taking_part: Predicted boxes that take part; None for all.
    """
    takes_part = np.ones(len(scene.predicted), dtype=bool) if taking_part is None else taking_part
    allowed = np.flatnonzero((scene.similarity >= least) & takes_part[scene.pair[:, 1]])
    a, b = scene.pair[allowed].T
    similarity = scene.similarity[allowed]
    chosen = best_pairs(a, b, similarity + _COUNT_FIRST, scene.annotated.frame[a])
    row, row_similarity = np.full(len(scene.annotated), -1), np.zeros(len(scene.annotated))
    row[a[chosen]], row_similarity[a[chosen]] = b[chosen], similarity[chosen]
    is_assigned = np.zeros(len(scene.predicted), dtype=bool)
    is_assigned[b[chosen]] = True
    return FrameMatches(row=row, similarity=row_similarity, false=takes_part & ~is_assigned & ~scene.predicted.aside)


def count(scene: TrackingScene, matched: FrameMatches, bin_m: tuple[float, float] | None = None) -> Clear:
    """Count what a matching got right and wrong, of a range bin or of all."""
    here, there = np.ones(len(scene.annotated), dtype=bool), np.ones(len(scene.predicted), dtype=bool)
    if bin_m is not None:
        here = (scene.annotated.range_m >= bin_m[0]) & (scene.annotated.range_m < bin_m[1])
        there = (scene.predicted.range_m >= bin_m[0]) & (scene.predicted.range_m < bin_m[1])
    valid, hit = ~scene.annotated.aside & here, matched.row >= 0
    switch, fragment = _changes(scene, matched.row)
    tracks = _whole_tracks(scene, hit) if bin_m is None else {}
    return Clear(
        TP=int((valid & hit).sum()),
        FP=int((matched.false & there).sum()),
        FN=int((valid & ~hit).sum()),
        IDS=int((switch & here).sum()),
        FRAG=int((fragment & here).sum()),
        similarity=float(matched.similarity[valid & hit].sum()),
        **tracks,
    )


def _changes(scene: TrackingScene, row: Int[np.ndarray, " m"]) -> tuple[Bool[np.ndarray, " m"], Bool[np.ndarray, " m"]]:
    """Annotated boxes at which the identity switches, and at which a fragment begins."""
    order = np.lexsort([scene.annotated.frame, scene.annotated.track])
    track, aside = scene.annotated.track[order], scene.annotated.aside[order]
    name = np.where(row[order] >= 0, scene.predicted.track[row[order]] if len(scene.predicted) else -1, -1)
    first = np.r_[True, track[1:] != track[:-1]] if len(track) else np.zeros(0, dtype=bool)
    last = np.r_[first[1:], True] if len(track) else first
    before = np.where(first, -1, np.r_[-1, name[:-1]]) if len(track) else name
    after = np.r_[name[1:], -1] if len(track) else name
    last_track = _last_known(name, aside, first)
    counted = ~first & ~aside & (last_track >= 0) & (name >= 0)
    switch, fragment = np.zeros(len(row), dtype=bool), np.zeros(len(row), dtype=bool)
    switch[order] = counted & (name != last_track) & (before >= 0)
    # At a track's last frame KITTI counts one that is found there for the first time, too.
    at_last = last & ~first & ~aside & (name >= 0)
    fragment[order] = (name != before) & (at_last | (counted & (after >= 0)))
    return switch, fragment


def _last_known(
    name: Int[np.ndarray, " m"], aside: Bool[np.ndarray, " m"], first: Bool[np.ndarray, " m"]
) -> Int[np.ndarray, " m"]:
    """The track that each annotated box last got before, -1 for none since it was last ignored; rows run by track."""
    index = np.arange(len(name))
    sets = first | aside | (name >= 0)
    value = np.where(aside & ~first, -1, name)
    latest = np.maximum.accumulate(np.where(sets, index, 0)) if len(name) else index
    last_track = np.r_[-1, value[latest][:-1]] if len(name) else value
    return np.where(first, -1, last_track)


def _whole_tracks(scene: TrackingScene, hit: Bool[np.ndarray, " m"]) -> dict[str, int]:
    """Tracks found as wholes; a match in a track's first frame counts even where it is ignored, as in KITTI."""
    track, valid = scene.annotated.track, ~scene.annotated.aside
    order = np.lexsort([scene.annotated.frame, track])
    is_first = np.zeros(len(track), dtype=bool)
    is_first[order[np.flatnonzero(np.diff(track[order], prepend=-1))]] = True
    frames = np.bincount(track[valid], minlength=int(track.max(initial=0)) + 1)
    matched = np.bincount(track[(valid | is_first) & hit], minlength=len(frames))
    share = matched / np.maximum(frames, 1)
    counts = {"MT": share > _FOUND_WHOLE, "ML": share < _FOUND_LOST, "tracks": share >= 0}
    return {name: int((mask & (frames > 0)).sum()) for name, mask in counts.items()}


@dataclass(frozen=True, eq=False, kw_only=True)
class Integrals:
    """AB3DMOT's integrals, and the threshold with the best MOTA.

    Args:
        figures: sAMOTA, AMOTA, AMOTP; None where nothing is annotated.
        thresholds: Track scores at which recall reaches 1/40, 2/40...
        best: Which of them has the best MOTA; -1 without any.
        matched: The matching there, that of all tracks without any.
    """

    figures: Figures
    thresholds: tuple[float, ...]
    best: int
    matched: FrameMatches


def integrate(scene: TrackingScene, least: float, *, count_ignored: bool = True) -> Integrals:
    """Cut the tracks at the scores of 40 recalls and average what is left.

    Recalls that are not reached count 0. The scores of matches place the thresholds, and, with ``count_ignored``, those
    of matches with ignored boxes too, which then also count as annotated, as AB3DMOT's code has it.
    """
    every = match(scene, least)
    valid, hit = ~scene.annotated.aside, every.row >= 0
    counted = hit if count_ignored else hit & valid
    annotated = int(counted.sum() + (valid & ~hit).sum())
    if not valid.any():
        return Integrals(figures=dict.fromkeys(("sAMOTA", "AMOTA", "AMOTP")), thresholds=(), best=-1, matched=every)
    scores = np.sort(scene.predicted.score[every.row[counted]])[::-1]
    thresholds = sample_thresholds(scores, annotated)[0][1:]
    sums, best, at_best, most = np.zeros(3), -1, every, -np.inf
    for number, threshold in enumerate(thresholds):
        matched = match(scene, least, scene.predicted.score >= threshold)
        counts = count(scene, matched)
        sums += [counts.scaled_mota((number + 1) / (SAMPLES - 1)), counts.mota, counts.motp]
        if counts.mota > most:
            best, at_best, most = number, matched, counts.mota
    named = zip(("sAMOTA", "AMOTA", "AMOTP"), (sums / (SAMPLES - 1)).tolist(), strict=True)
    return Integrals(figures=dict(named), thresholds=tuple(thresholds), best=best, matched=at_best)
