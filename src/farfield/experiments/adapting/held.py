"""Scores before and after on labelled frames that were not learnt from: told at the end, and used for no choice."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from farfield.datasets import Dataset
from farfield.errors import ConfigError
from farfield.metrics import Bootstrap
from farfield.metrics.deciding import ScoreSample, difference_of, figure, samples
from farfield.metrics.detections import Detections
from farfield.pages.training_pages import HeldScores, ScoreRow

_FIGURES = {"DDS": figure("dds/0/dds"), "mAP": figure("dds/0/map")}
_LEVEL_PERCENT = (2.5, 97.5)


@dataclass(frozen=True, kw_only=True)
class HeldOutFrames:
    """Labelled frames that were not learnt from.

    Args:
        frames: The frames, all annotated.
        shared_drives: How many of their drives have other frames that were learnt from.
    """

    frames: Dataset
    shared_drives: int = 0


def held_frames(labels: Dataset, learnt: Dataset) -> HeldOutFrames:
    """The annotated frames of a data set, without those that are learnt from.

    Args:
        labels: The labelled data set; it may be the target itself.
        learnt: The frames of the target that are learnt from.

    Raises:
        ConfigError: If none is left.
    """
    same = labels.root.resolve() == learnt.root.resolve()
    seen = set(learnt.keys) if same else set()
    annotated = [index for index in range(len(labels)) if labels.has_annotation(index)]
    left = [index for index in annotated if labels.keys[index] not in seen]
    if not left:
        why = f"all {len(annotated)} are learnt from" if annotated else f"none of {len(labels)} is annotated"
        raise ConfigError(
            f"labels: expected annotated frames in {labels.root} that are not learnt from; {why}. Learn from fewer "
            "with --frames, or name labelled frames of other drives."
        )
    drives = {labels.sequences[index] for index in left}
    return HeldOutFrames(frames=labels.select(left), shared_drives=len(drives & {drive for drive, _ in seen}))


def held_scores(
    held: HeldOutFrames, before: Detections, after: Detections, classes: Sequence[str], aliases: Mapping[str, str]
) -> HeldScores:
    """DDS and its mAP of each annotated class before and after, their difference, and intervals over drives.

    Args:
        held: The frames.
        before: What was found in them before.
        after: What is found in them after.
        classes: The detector's classes.
        aliases: Classes of the labels that the detector learnt under another name.
    """
    sides = [_relabelled(found.counted(), aliases) for found in (before, after)]
    rows, grouped = [], ("sequences", 0)
    for label in classes:
        settings = _settings(label, classes, before.reach_m)
        annotated = _annotated(sides[0], label, settings)
        if not annotated:
            continue
        first, second = (samples(side, _FIGURES, protocol="dds", **settings) for side in sides)
        rows += [_row(label, annotated, name, first[name], second[name]) for name in _FIGURES]
        grouped = (first["DDS"].grouped_by, first["DDS"].groups)
    return HeldScores(
        rows=tuple(rows),
        frames=len(held.frames),
        drives=len(set(held.frames.sequences)),
        shared_drives=held.shared_drives,
        grouped_by=grouped[0],
        groups=grouped[1],
    )


def _annotated(found: Detections, label: str, settings: Mapping[str, Any]) -> int:
    """Number of annotated objects of a class that count."""
    named = {str(name) for each in found.annotated.values() for name in each.relabel(settings["relabel"]).label}
    if label not in named:
        return 0
    return int(found.score("dds", **settings, bootstrap=Bootstrap(replicates=0)).counts["annotated"])


def _relabelled(found: Detections, aliases: Mapping[str, str]) -> Detections:
    annotations = {
        key: replace(each, boxes=each.boxes.relabel(dict(aliases))) for key, each in found.annotations.items()
    }
    return replace(found, annotations=annotations)


def _settings(label: str, classes: Sequence[str], reach_m: float | None) -> dict[str, Any]:
    """Of DDS: one range up to the detector's reach, and no class under another's name that the detector tells apart."""
    stands_for = {name: other for name, other in _STANDS_FOR.items() if name not in classes}
    settings: dict[str, Any] = {"label": label, "epsilons": (0.0,), "relabel": stands_for}
    if reach_m:
        settings["range_bins_m"] = (0.0, float(reach_m))
    return settings


_STANDS_FOR = {"large_vehicle": "vehicle"}  # as DDS reads Cirrus' vehicle, where a detector has one class of them


def _row(label: str, annotated: int, name: str, before: ScoreSample, after: ScoreSample) -> ScoreRow:
    gain = difference_of([after], [before])
    return ScoreRow(
        label=label,
        annotated=annotated,
        figure=name,
        before=before.value,
        after=after.value,
        before_interval=_interval(before),
        after_interval=_interval(after),
        gain=gain.estimate,
        gain_interval=gain.interval(),
    )


def _interval(found: ScoreSample) -> tuple[float, float] | None:
    known = found.draws[np.isfinite(found.draws)]
    if found.value is None or len(known) < 2:
        return None
    low, high = np.percentile(known, _LEVEL_PERCENT)
    return float(low), float(high)
