"""A detector over a data set, cloud by cloud: scores, found objects and a few frames to look at, ready for a report."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from farfield.datasets.base import Dataset
from farfield.datasets.memory import in_memory
from farfield.detectors.info import DescribedDetector, DetectorFunction, as_detector
from farfield.evaluation.detecting import detect, median_ms
from farfield.evaluation.lost import lost_of
from farfield.evaluation.record import Evaluation, FrameView
from farfield.evaluation.report_data import annotated_objects, kind_of, power_from_above, scored_labels
from farfield.evaluation.views import as_trained, suitable_clouds
from farfield.frame import Boxes, Frame, Key
from farfield.frame.provenance import environment
from farfield.frame.where import Where
from farfield.jobs import JobOptions
from farfield.metrics import PROTOCOLS, Bootstrap, Protocol
from farfield.metrics.breakdown import by_class, by_part, mean_of_classes, of_slice, parts_json
from farfield.metrics.detections import Detections, presentation_of
from farfield.metrics.frames import BoxesByFrame
from farfield.vocabulary.counts import count_of


@dataclass(frozen=True, kw_only=True)
class EvaluationOptions:
    """How a detector is evaluated.

    Args:
        clouds: Which clouds; by default those of the first frame that suit the detector.
        shown_frames: Frames that the report shows, spread evenly over the data.
        protocol: The metric.
        settings: Settings of the protocol.
        title: Title of the report.
        provenance: What is known of the data beyond their fingerprint.
        bulk: Who detects (default: this process with all its threads).
        journals: Folder that keeps the detections, so that an interrupted evaluation goes on and one with other
            settings of the protocol detects nothing anew; None keeps nothing.
        overwrite: Detect anew what is kept.
        where: Only frames and boxes count that fulfil this condition, see :mod:`farfield.frame.where`; all if empty.
    """

    clouds: Sequence[str] | None = None
    shown_frames: int = 4
    protocol: str = "dds"
    settings: Mapping[str, Any] = field(default_factory=dict)
    title: str = "Farfield evaluation"
    provenance: Mapping[str, Any] = field(default_factory=dict)
    bulk: JobOptions | None = None
    journals: Path | None = None
    overwrite: bool = False
    where: str = ""


def evaluate_clouds(
    detector: DescribedDetector | DetectorFunction,
    data: Dataset | Sequence[Frame],
    options: EvaluationOptions = EvaluationOptions(),
) -> Evaluation:
    """Score a detector on each cloud of a data set; a cloud's result is that of :func:`farfield.evaluate`.

    Args:
        detector: The detector.
        data: Annotated frames.
        options: How.

    Returns:
        Results and their tables, pictures' frames, settings, provenance and what the clock measured, by cloud.

    Raises:
        DatasetError: If no frame is annotated.
        ConfigError: If a cloud is missing or does not suit.
    """
    where = Where(options.where) if options.where else None  # or says at once what is wrong with it
    described, dataset = as_detector(detector), in_memory(data)
    info = described.info
    frames = as_trained(dataset, info)
    first = frames[0]
    protocol = PROTOCOLS[options.protocol]
    clouds = options.clouds or suitable_clouds(info, first)
    # Detect in each cloud and score its detections.
    predictions: dict[str, BoxesByFrame] = {}
    clouds_results: dict[str, CloudResult] = {}
    for name in clouds:
        detections = detect(
            described,
            dataset,
            cloud=name,
            annotated_only=True,
            bulk=options.bulk,
            journal=None if options.journals is None else options.journals / f".found-{name}.jsonl",
            overwrite=options.overwrite,
        )
        predictions[name] = detections.boxes
        detections = detections if where is None else of_slice(detections, where)
        clouds_results[name] = score_cloud(detections, protocol, options, kind=kind_of(first, name))
    # Choose the frames that the report shows, and say what was evaluated.
    shown = np.linspace(0, len(frames) - 1, max(0, min(options.shown_frames, len(frames)))).round().astype(int)
    return Evaluation(
        title=options.title,
        results={name: cloud.result for name, cloud in clouds_results.items()},
        tables={name: cloud.table for name, cloud in clouds_results.items()},
        objects={name: cloud.objects for name, cloud in clouds_results.items()},
        parts={name: cloud.parts for name, cloud in clouds_results.items()},
        lost={name: cloud.lost for name, cloud in clouds_results.items()},
        timing={name: cloud.timing for name, cloud in clouds_results.items() if cloud.timing},
        frames=[frame_view(frames[index], predictions) for index in sorted(set(shown.tolist()))],
        settings={
            "detector": info.network,
            "classes": ", ".join(info.classes),
            "range_m": info.reach_m,
            "precision": info.precision,
            "score_threshold": info.score_threshold,
            "nms_iou": info.nms_iou,
        },
        provenance={
            **environment(),
            "data": frames.name,
            "data_fingerprint": frames.fingerprint(),
            "frames": len(frames),
            "trained_on": training_text(info.provenance),
            **options.provenance,
        },
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class CloudResult:
    """A detector's score on one cloud.

    Args:
        result: Result JSON.
        table: Its table, as ``farfield score`` prints it.
        objects: Which annotated objects were found, see :func:`farfield.evaluation.report_data.annotated_objects`.
        parts: Figures by condition and sector, a row for each class, and their mean.
        lost: Missed objects and false boxes, see :func:`farfield.evaluation.lost.lost_of`.
        timing: ``frames`` that were detected in now, and their ``median_ms``; empty if all came from a journal.
    """

    result: Mapping[str, Any]
    table: str
    objects: Mapping[str, Any]
    parts: Mapping[str, Any]
    lost: Mapping[str, Any]
    timing: Mapping[str, float | int]


def score_cloud(detections: Detections, protocol: Protocol, options: EvaluationOptions, *, kind: str) -> CloudResult:
    """Score the detections of one cloud.

    Args:
        detections: The detections.
        protocol: The protocol that ``options`` names.
        options: How the detector is evaluated.
        kind: Kind of the cloud's sensor.
    """
    settings = options.settings
    others = {name: value for name, value in settings.items() if name != "label"}
    detections.check_label(protocol, settings.get("label"), **others)
    result = detections.score(options.protocol, **settings)
    if options.where:  # a condition is a setting: figures under others are not comparable
        chosen = {**result.settings, "where": options.where}
        result = replace(result, settings=chosen, convention=f"{result.convention}; where={options.where}")
    tree = result.to_json()
    finding, labels = presentation_of(tree, protocol).finding, scored_labels({detections.cloud or "": tree})
    objects = annotated_objects(
        detections.boxes,
        detections.annotated,
        labels=labels,
        finding=finding,
        kind=kind,
    )
    timing = {"frames": len(detections.ms), "median_ms": round(median_ms(detections), 1)} if detections.ms else {}
    return CloudResult(
        result=tree,
        table=str(result),
        objects=objects,
        parts=part_figures(detections, protocol, settings, by_condition="conditions" not in tree),
        lost=lost_of(detections, finding=finding, labels=labels, settings=result.settings),
        timing=timing,
    )


def part_figures(
    detections: Detections, protocol: Protocol, settings: Mapping[str, Any], *, by_condition: bool
) -> dict[str, Any]:
    """Figures by condition and sector, over the whole range, a row for each class of the data, and their mean."""
    edges_m = settings.get("range_bins_m") or protocol.default("range_bins_m") or ()
    all_ranges = {**settings, **({"range_bins_m": (edges_m[0], edges_m[-1])} if edges_m else {})}
    tree = parts_json(by_part(detections, protocol, **all_ranges)) if by_condition else {}
    no_intervals = {"bootstrap": Bootstrap(replicates=0)} if "bootstrap" in protocol.options() else {}
    rows = by_class(detections, protocol, **{**all_ranges, **no_intervals})
    return {**tree, "classes": {row.label: row.to_json() for row in rows}, "mean_of_classes": mean_of_classes(rows)}


def frame_view(frame: Frame, predictions: Mapping[str, Mapping[Key, Boxes]], *, title: str = "") -> FrameView:
    """A frame as a report shows it, with the predictions by cloud."""
    boxes = {cloud: by_frame[frame.key] for cloud, by_frame in predictions.items() if frame.key in by_frame}
    title = title or f"{frame.sequence}, frame {frame.frame_id}"
    return FrameView(frame=frame, predictions=boxes, title=title, radar_db=power_from_above(frame))


def training_text(provenance: Mapping[str, Any]) -> str:
    """One phrase on what a detector learnt from, each stream by its own data; empty where nothing is known."""
    experiment = provenance.get("experiment")
    if not experiment or not experiment.get("data") or not experiment.get("training"):
        return ""
    data, training = experiment["data"], experiment["training"]
    by_stream = all(isinstance(group, Mapping) for group in data.values())
    groups, streams = data if by_stream else {"": data}, provenance.get("streams") or {}
    frames = {name: (streams.get(name) or provenance).get("frames") for name in groups}
    sources = [f"{frames[name]} {_source_text(group)}" for name, group in groups.items()]
    method, start = experiment.get("method", {}).get("name", "supervised"), provenance.get("start")
    commit = provenance.get("environment", {}).get("commit") or "unknown"
    return (
        f"{', and '.join(sources)}, "
        + (f"by the method {method}, " if method != "supervised" else "")
        + (f"from the weights {start.get('weights') or 'not named'}, " if start else "")
        + f"{count_of(training.get('steps') or 0, 'step')} of {training.get('batch_size')}, "
        f"training seed {training.get('seed')}, "
        f"commit {commit}"
    )


def _source_text(data: Mapping[str, Any]) -> str:
    """What the frames of a stream are, and which clouds of them were read."""
    simulation, clouds = data.get("simulate"), data.get("clouds") or ("not named",)
    names = [name for group in clouds.values() for name in group] if isinstance(clouds, Mapping) else clouds
    if simulation:
        source = f"simulated frames (preset {simulation.get('preset')}, seed {simulation.get('seed')})"
    else:
        source = f"frames of {data.get('path') or 'a folder not named'}"
    return f"{source}, clouds {' and '.join(names)}"
