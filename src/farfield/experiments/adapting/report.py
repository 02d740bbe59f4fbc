"""What the page of an adaptation shows, gathered from what was found before, between and after."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from farfield.datasets import Dataset
from farfield.datasets.joined import roots_of
from farfield.errors import ConfigError
from farfield.experiments.adapting.options import CalibratedThresholds
from farfield.experiments.adapting.rounds import ConfidentBoxes
from farfield.experiments.frames import without
from farfield.experiments.validation import relabel_annotations
from farfield.frame import Boxes, Key
from farfield.frame.provenance import environment, is_simulated
from farfield.metrics import Bootstrap
from farfield.metrics.centre.matching import found_by
from farfield.metrics.deciding import ScoreSample, difference_of, figure, samples
from farfield.metrics.detections import Detections
from farfield.pages.training_pages import AdaptedPage, HeldScores, PseudoLabelFrame, ScoreRow, write_adapted
from farfield.vocabulary.counts import count_of

if TYPE_CHECKING:
    from farfield.detectors.runtime import Detector

_EDGES_M = (0.0, 30.0, 70.0, 150.0, 250.0)
_SHOWN = 4
_NEAR_M = 2.0


def changes(before: Boxes, after: Boxes) -> int:
    """Boxes of a frame that only one of two detectors has, by centres within 2 m."""
    pairs = int((found_by(after, before, distance_m=_NEAR_M) >= 0).sum())
    return len(before) + len(after) - 2 * pairs


def most_changed(before: Mapping[Key, Boxes], after: Mapping[Key, Boxes], count: int) -> list[Key]:
    """The frames in which most boxes came or went, most first: one a drive, and more only where there are too few.

    Among equals the earlier comes first.
    """
    order = sorted(before, key=lambda key: (-changes(before[key], after[key]), key))
    first = {key[0]: key for key in reversed(order)}  # of each drive the one that changed most
    chosen = [key for key in order if first[key[0]] == key][:count]
    return chosen + [key for key in order if key not in chosen][: count - len(chosen)]


def edges_to(reach_m: float) -> list[float]:
    """Edges of the range bins up to a detector's reach."""
    return [*(edge for edge in _EDGES_M if edge < reach_m), reach_m]


def extents(data: Mapping[str, Dataset], *, scored: bool = False, taught: bool = False) -> str:
    """What the boxes of source and target show, where both are annotated; a sentence, or nothing.

    Args:
        data: Frames of ``source`` and ``target``.
        scored: Whether the target's are labels that were read for scores at the end.
        taught: Whether the source's labels taught whole bodies to a detector that knew visible parts.
    """
    used = "labels taught nothing" if scored else "labels were not used"
    shown: dict[str, str] = {}
    for name in ("source", "target"):
        index = next((n for n in range(len(data[name])) if data[name].has_annotation(n)), None)
        annotation = None if index is None else data[name].annotation(index)
        if annotation is None:
            return ""
        shown[name] = annotation.extent
    if shown["source"] == shown["target"]:
        if taught:
            return (
                f"The target is annotated; its {used}. Its boxes show the {_extent(shown['target'])}. So do those of "
                "the source from which this detector learnt here; before, it drew the part that the sensor sees, and "
                "part of what it gains in sizes and overlaps is this difference, which needs no sweep of the target."
            )
        return (
            f"The target is annotated; its {used}. Boxes show the {_extent(shown['target'])} in both "
            "source and target, so that scores on these labels compare like with like."
        )
    return (
        f"The target is annotated; its {used}. Its boxes show the {_extent(shown['target'])}, those that "
        f"this detector learnt from the {_extent(shown['source'])}: pseudo labels cannot teach the difference, so "
        "scores that look at sizes and overlaps stay below those of a detector trained on the target's labels."
    )


def taught_by(labelled: Dataset | None) -> str:
    """How many labelled sweeps taught, a sentence; nothing where there were none."""
    if labelled is None:
        return ""
    boxes = sum(len(labelled.annotation(index) or ()) for index in range(len(labelled)))
    return (
        f" Beside the sweeps without labels, {count_of(len(labelled), 'sweep')} of "
        f"{count_of(len(set(labelled.sequences)), 'drive')} with {count_of(boxes, 'labelled box', 'labelled boxes')} "
        "taught in every batch; none of them is scored or shown here."
    )


def _extent(extent: str) -> str:
    return {"full": "whole body of an object", "visible": "part of an object that the sensor sees"}[extent]


def page_of(
    path: Path,
    *,
    start: str,
    detector: "Detector",
    data: Mapping[str, Dataset],
    clouds: Mapping[str, str],
    calibration: CalibratedThresholds,
    detections_by_round: Sequence[Detections],
    rows: Sequence[Mapping[str, float | int]],
    signs: Sequence[str],
    held: Dataset | None = None,
    scores: HeldScores | None = None,
) -> Path:
    """Write the page.

    Args:
        path: Where to.
        start: The detector that was adapted.
        detector: The same, loaded.
        data: Frames of ``source`` and ``target``, and of ``labels`` where labelled sweeps taught.
        clouds: Which cloud was read in each.
        calibration: Thresholds and steps.
        detections_by_round: What was detections_by_round in the target before, and after each round.
        rows: The rounds' logs.
        signs: Failure modes.
        held: Labelled frames that were not learnt from, if any.
        scores: Scores on them.
    """
    target = data["target"]
    before, after = (
        ConfidentBoxes(detections.boxes, calibration.positive)
        for detections in (detections_by_round[0], detections_by_round[-1])
    )
    index_of = {key: index for index, key in enumerate(target.keys)}
    shown = [
        PseudoLabelFrame(target[index_of[key]], clouds["target"], before[key], after[key])
        for key in most_changed(before, after, _SHOWN)
    ]
    page = AdaptedPage(
        title=f"{start} adapted to {target.root.name}",
        classes=detector.class_names,
        edges_m=edges_to(detector.reach_m),
        before=detections_by_round[0].boxes,
        after=detections_by_round[-1].boxes,
        positive=calibration.positive,
        negative=calibration.negative,
        source_rate=calibration.source_rate,
        measured=calibration.measured,
        changes=shown,
        rows=rows,
        signs=signs,
        labels=extents(
            data if held is None else {**data, "target": held},
            scored=held is not None,
            taught=bool(calibration.settings.get("whole_bodies")),
        )
        + taught_by(data.get("labels")),
        scores=scores,
        simulated={name: any(map(is_simulated, roots_of(data[name]))) for name in ("source", "target")},
        settings={
            "detector": start,
            "target": f"{count_of(len(target), 'frame')}, cloud {clouds['target']}",
            "source": f"{count_of(len(data['source']), 'frame')}, clouds "
            f"{', '.join(calibration.settings['source_clouds'])}",
            **(
                {"labelled": f"{count_of(len(data['labels']), 'frame')}, {data['labels'].root}"}
                if "labels" in data
                else {}
            ),
            "rounds": calibration.settings["rounds"],
            "steps of a round": calibration.steps,
            "overrides": calibration.settings["overrides"],
            "seed": calibration.settings["seed"],
            "target's fingerprint": calibration.settings["target"],
            "source's fingerprint": calibration.settings["source"],
            **environment(),
        },
    )
    return write_adapted(path, page)


# Scores before and after on labelled frames that were not learnt from

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
    """The annotated frames of a data set, without those that are learnt from, by name or by contents.

    Args:
        labels: The labelled data set; it may be the target itself.
        learnt: The frames of the target that are learnt from.

    Raises:
        ConfigError: If none is left.
    """
    same = labels.root.resolve() == learnt.root.resolve()
    learnt_keys = set(learnt.keys) if same else set()
    annotated = [index for index in range(len(labels)) if labels.has_annotation(index)]
    left = without(labels.select(annotated), learnt)
    if not len(left):
        why = f"all {len(annotated)} are learnt from" if annotated else f"none of {len(labels)} is annotated"
        raise ConfigError(
            f"labels: expected annotated frames in {labels.root} that are not learnt from; {why}. Learn from fewer "
            "with --frames, or name labelled frames of other drives."
        )
    shared = set(left.sequences) & {drive for drive, _ in learnt_keys}
    return HeldOutFrames(frames=left, shared_drives=len(shared))


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
    sides = [relabel_annotations(detections.counted(), aliases) for detections in (before, after)]
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


def _annotated(detections: Detections, label: str, settings: Mapping[str, Any]) -> int:
    """Number of annotated objects of a class that count."""
    named = {str(name) for boxes in detections.annotated.values() for name in boxes.relabel(settings["relabel"]).label}
    if label not in named:
        return 0
    return int(detections.score("dds", **settings, bootstrap=Bootstrap(replicates=0)).counts["annotated"])


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


def _interval(sample: ScoreSample) -> tuple[float, float] | None:
    finite = sample.draws[np.isfinite(sample.draws)]
    if sample.value is None or len(finite) < 2:
        return None
    low, high = np.percentile(finite, _LEVEL_PERCENT)
    return float(low), float(high)
