"""KITTI's average precision (Geiger et al., CVPR 2012): BEV and 3D overlap, R11 and R40, three difficulties.

Conventions. Boxes overlap by exact rotated IoU; Car needs more than 0.7, other classes 0.5. Annotated boxes of a
neighbouring class (Van for Car) or beyond the difficulty may be found or not. Detections whose 2D box is too low for
the difficulty do not count. ``DontCare`` regions excuse detections in KITTI's 2D measure only; ``dontcare="image"``
lets them do so here too. R11 averages the precision at recalls 0, 0.1 ... 1, R40 at 1/40 ... 1 (the official one since
2019). Without 2D facts there is one difficulty, ``all``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.frame.drive import Drive
from farfield.metrics.bootstrap import Statistics, Weighted, intervals
from farfield.metrics.counts import KittiCurve, ThresholdCounts, recall_mean, shifted
from farfield.metrics.frames import BoxesByFrame, in_range
from farfield.metrics.kitti.frames import Details, KittiFrames, candidates, gather_kitti
from farfield.metrics.kitti.matching import count_at_thresholds, recall_scores
from farfield.metrics.kitti.settings import DIFFICULTIES, KittiSettings
from farfield.metrics.recall import sample_thresholds
from farfield.metrics.result import Result, table

__all__ = ["Details", "KittiCurve", "KittiResult", "KittiSettings", "evaluate_kitti"]

_Counted = dict[tuple[str, str, str], ThresholdCounts]  # by part, measure and difficulty
_Averages = dict[tuple[str, str, str], Statistics]


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class KittiResult(Result):
    """KITTI AP by overlap, recall points and difficulty; figures lie in [0, 1], the table shows per cent."""

    def __str__(self) -> str:
        parts = [*self.ranges, "overall"]
        rows = [
            [name.removeprefix("ap/").replace("/", " "), *(self.cell(part, name, scale=100.0) for part in parts)]
            for name in self.figures
        ]
        for name in ("annotated", "predictions"):
            counts = self.counts["ranges"] | {"overall": self.counts}
            rows.append([name, *(str(counts[part][name]) for part in parts)])
        title = f"KITTI AP of {self.label!r} in per cent, by range in metres; '-': nothing annotated"
        return f"{title}\n\n{table(['', *parts], rows)}\n\n{self.footer()}"


def evaluate_kitti(
    predictions: BoxesByFrame,
    annotations: BoxesByFrame,
    settings: KittiSettings | None = None,
    *,
    prediction_details: Details | None = None,
    annotation_details: Details | None = None,
    drives: Sequence[Drive] = (),
) -> KittiResult:
    """Score predictions with KITTI's average precision.

    Args:
        predictions: Scored boxes by (sequence, frame). A frame without an entry has no detections.
        annotations: Annotated boxes by (sequence, frame): every frame that counts, those without boxes too.
        settings: The options; None takes the defaults.
        prediction_details: By frame, in the order of its boxes: ``box_px`` (n, 4) as left, top, right, bottom.
        annotation_details: Likewise ``truncation`` (n,), ``occlusion`` (n,), ``box_px`` (n, 4), and ``dontcare_px``
            (k, 4). None evaluates one difficulty, ``all``.
        drives: Drives of the data, which the bootstrap draws; without them sequences are drawn.

    Returns:
        Figures in [0, 1] named ``ap/bev_r11/easy``, ``ap/3d_r40/moderate``...

    Raises:
        ConfigError: If predictions lie in frames that are not annotated, lack scores, or details do not fit.
    """
    settings = settings or KittiSettings()
    data = gather_kitti(predictions, annotations, settings, prediction_details or {}, annotation_details, drives)
    parts = _parts(data, settings)
    counted = _count_all(data, settings, parts)
    figures: dict[str, Statistics] = {part: {} for part in parts}
    curves: dict[str, Any] = {part: {} for part in parts}
    for (part, measure, difficulty), found in counted.items():
        figures[part] |= {
            f"ap/{measure}_{name}/{difficulty}": value for name, value in _averages(found.sampled()).items()
        }
        curves[part].setdefault(measure, {})[difficulty] = found.curve()
    counts = {
        part: {"annotated": int((data.is_label & inside[1]).sum()), "predictions": int(inside[0].sum())}
        for part, inside in parts.items()
    }
    frames = np.union1d(data.predicted_frame, data.annotated_frame[data.is_label])
    overall = counts.pop("overall")
    return KittiResult(
        protocol="kitti",
        label=settings.label,
        settings=settings.to_json(),
        convention=settings.convention(),
        figures=figures.pop("overall"),
        ranges=figures,
        counts={"frames": len(frames), "frames_given": len(annotations), **overall, "ranges": counts},
        intervals=_intervals(counted, data, settings),
        grouped_by=data.grouped_by,
        curves=curves,
    )


def weighted_kitti(
    predictions: BoxesByFrame,
    annotations: BoxesByFrame,
    settings: KittiSettings,
    *,
    prediction_details: Details | None = None,
    annotation_details: Details | None = None,
    drives: Sequence[Drive] = (),
) -> Weighted:
    """The figures as functions of group weights; the arguments are those of :func:`evaluate_kitti`."""
    data = gather_kitti(predictions, annotations, settings, prediction_details or {}, annotation_details, drives)
    parts = _parts(data, settings)
    counted = _count_all(data, settings, parts)
    each = {part: {name: found for name, found in counted.items() if name[0] == part} for part in parts}
    weighted = {part: partial(_moved_part, f"{part}|", *_drawing(mine, data.groups)) for part, mine in each.items()}
    return Weighted(parts=weighted, groups=tuple(data.group.tolist()), grouped_by=data.grouped_by)


_Inside = dict[str, tuple[Bool[np.ndarray, " n"], Bool[np.ndarray, " m"]]]


def _parts(data: KittiFrames, settings: KittiSettings) -> _Inside:
    """Which predicted and annotated boxes lie in the whole and in each range bin."""
    return {"overall": (np.ones(len(data.predicted), dtype=bool), np.ones(len(data.annotated), dtype=bool))} | {
        f"{low_m:g}-{high_m:g}": (in_range(data.predicted, low_m, high_m), in_range(data.annotated, low_m, high_m))
        for low_m, high_m in settings.bins_m
    }


def _count_all(data: KittiFrames, settings: KittiSettings, parts: _Inside) -> _Counted:
    return {
        (part, measure, difficulty): _count(data, settings, measure, difficulty, *inside)
        for part, inside in parts.items()
        for measure in data.overlap
        for difficulty in data.hardness
    }


def _drawing(counted: _Counted, groups: int) -> tuple[_Counted, _Averages, _Averages]:
    """Counts, their averages, and the smooth averages from which draws depart."""
    point = {name: _averages(found.sampled()) for name, found in counted.items()}
    return counted, point, {name: _averages(found.smooth(np.ones(groups))) for name, found in counted.items()}


def _moved_part(
    prefix: str, counted: _Counted, point: _Averages, start: _Averages, weight: Float[np.ndarray, " groups"]
) -> Statistics:
    return {name.removeprefix(prefix): value for name, value in _moved(counted, point, start, weight).items()}


def _intervals(
    counted: _Counted, data: KittiFrames, settings: KittiSettings
) -> dict[str, dict[str, list[float] | None]]:
    """Interval of each figure: the figure plus what the smooth AP gains or loses under resampling."""
    moved = partial(_moved, *_drawing(counted, data.groups))
    drawn: dict[str, dict[str, list[float] | None]] = {}
    for key, interval in intervals(moved, data.groups, settings.bootstrap).items():
        part, _, name = key.partition("|")
        drawn.setdefault(part, {})[name] = interval
    return drawn


def _moved(counted: _Counted, point: _Averages, start: _Averages, weight: Float[np.ndarray, " groups"]) -> Statistics:
    values: Statistics = {}
    for (part, measure, difficulty), found in counted.items():
        name = part, measure, difficulty
        for points, drawn in _averages(found.smooth(weight)).items():
            values[f"{part}|ap/{measure}_{points}/{difficulty}"] = shifted(
                point[name][points], drawn, start[name][points]
            )
    return values


def _averages(sampled: Float[np.ndarray, "41"] | None) -> Statistics:
    return {f"r{points}": None if sampled is None else recall_mean(sampled, points) for points in (11, 40)}


def _count(
    data: KittiFrames,
    settings: KittiSettings,
    measure: str,
    difficulty: str,
    predicted_in: Bool[np.ndarray, " n"],
    annotated_in: Bool[np.ndarray, " m"],
) -> ThresholdCounts:
    must_find = data.is_label & ~data.hardness[difficulty] & annotated_in
    annotated = np.bincount(data.group[data.annotated_frame[must_find]], minlength=data.groups)
    small = data.height_px < (DIFFICULTIES[difficulty][0] if difficulty in DIFFICULTIES else 0.0)
    enough = data.overlap[measure] > settings.least_overlap
    found = candidates(data, enough, measure, must_find, small, predicted_in, annotated_in)
    total = int(annotated.sum())
    thresholds, recalls = sample_thresholds(recall_scores(found), total) if total else ([], [])
    true, false = count_at_thresholds(found, np.array(thresholds, dtype=np.float64))
    return ThresholdCounts(
        thresholds=thresholds,
        recalls=recalls,
        true=_by_group(true, data),
        false=_by_group(false, data),
        annotated=annotated,
    )


def _by_group(counts: Int[np.ndarray, "t f"], data: KittiFrames) -> Float[np.ndarray, "t g"]:
    sums = [np.bincount(data.group, weights=row, minlength=data.groups) for row in counts]
    return np.array(sums).reshape(len(counts), data.groups)
