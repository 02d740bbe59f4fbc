"""A detector over a data set, cloud by cloud: scores, found objects and a few frames to look at, ready for a report."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from farfield.datasets.base import Dataset
from farfield.evaluation import as_trained, detect, median_ms, suitable_clouds
from farfield.evaluation.record import Evaluation, FrameView
from farfield.evaluation.report_data import annotated_objects, kind_of, power_from_above, scored_labels
from farfield.frame import Boxes, Key
from farfield.frame.provenance import environment
from farfield.jobs import JobOptions
from farfield.metrics import PROTOCOLS, Bootstrap, Protocol
from farfield.metrics.detections import Detections
from farfield.metrics.parts import by_class, by_part, mean_of_classes, parts_json

if TYPE_CHECKING:
    from farfield.detectors.runtime import Detector


def evaluate_clouds(
    detector: "Detector",
    data: Dataset,
    *,
    clouds: Sequence[str] | None = None,
    shown_frames: int = 4,
    protocol: str = "dds",
    title: str = "Farfield evaluation",
    provenance: Mapping[str, Any] | None = None,
    bulk: JobOptions | None = None,
    kept: Path | None = None,
    overwrite: bool = False,
    tables: dict[str, str] | None = None,
    clocks: dict[str, dict[str, float]] | None = None,
    **options: Any,
) -> Evaluation:
    """Score a detector on each cloud of a data set; a cloud's result is that of :func:`farfield.evaluate`.

    Args:
        detector: The detector.
        data: Annotated frames.
        clouds: Which clouds; by default those of the first frame that suit the detector.
        shown_frames: Frames that the report shows, spread evenly over the data.
        protocol: The metric.
        title: Title of the report.
        provenance: What is known of the data beyond their fingerprint.
        bulk: Who detects; this process with all its threads unless given.
        kept: Folder that keeps what was found, so that an interrupted evaluation goes on and one with other settings
            of the protocol detects nothing anew; None keeps nothing.
        overwrite: Detect anew what is kept.
        tables: Is filled with the table of each result by cloud, as ``farfield score`` prints it.
        clocks: Is filled with what the clock measured, by cloud: ``frames`` that were searched now and their
            ``median_ms``. It stands apart from the evaluation, so that two equal ones are equal.
        **options: Settings of the protocol.

    Returns:
        Results, pictures' frames, settings and provenance by cloud.

    Raises:
        DatasetError: If no frame is annotated.
        ConfigError: If a cloud is missing or does not suit.
    """
    seen: Dataset = as_trained(data, detector)
    chosen = PROTOCOLS[protocol]
    results, objects, predicted, parts = {}, {}, {}, {}
    for name in clouds or suitable_clouds(detector, seen[0]):
        found = detect(
            detector,
            data,
            cloud=name,
            annotated_only=True,
            bulk=bulk,
            journal=None if kept is None else kept / f".found-{name}.jsonl",
            overwrite=overwrite,
        )
        found.check_label(chosen, options.get("label"), **{k: v for k, v in options.items() if k != "label"})
        result = found.score(protocol, **options)
        results[name] = result.to_json()
        if tables is not None:
            tables[name] = str(result)
        parts[name] = _parts(found, chosen, options, by_condition="conditions" not in results[name])
        objects[name] = annotated_objects(
            found.boxes,
            found.annotated,
            labels=scored_labels({name: results[name]}),
            finding=chosen.presentation(results[name]).finding,
            kind=kind_of(seen[0], name),
        )
        predicted[name] = found.boxes
        if clocks is not None and found.ms:
            clocks[name] = {"frames": len(found.ms), "median_ms": round(median_ms(found), 1)}
    return Evaluation(
        title=title,
        results=results,
        objects=objects,
        parts=parts,
        frames=[_view(seen, index, predicted) for index in _spread(len(seen), shown_frames)],
        settings={
            "detector": type(detector.network).__name__,
            "classes": ", ".join(detector.class_names),
            "range_m": detector.config.reach_m,
            "precision": detector.precision,
            "score_threshold": detector.config.score_threshold,
            "nms_iou": detector.config.nms_iou,
        },
        provenance={
            **environment(),
            "data": seen.name,
            "data_fingerprint": seen.fingerprint(),
            "frames": len(seen),
            "trained_on": trained_on(detector.provenance),
            **(provenance or {}),
        },
    )


def _parts(found: Detections, chosen: Protocol, options: Mapping[str, Any], *, by_condition: bool) -> dict[str, Any]:
    """Figures by condition and sector, over the whole range, a row for each class of the data, and their mean."""
    edges_m = options.get("range_bins_m") or chosen.default("range_bins_m") or ()
    whole = {**options, **({"range_bins_m": (edges_m[0], edges_m[-1])} if edges_m else {})}
    tree = parts_json(by_part(found, chosen, **whole)) if by_condition else {}
    still = {"bootstrap": Bootstrap(replicates=0)} if "bootstrap" in chosen.options() else {}
    rows = by_class(found, chosen, **{**whole, **still})
    return {**tree, "classes": {row.label: row.to_json() for row in rows}, "mean_of_classes": mean_of_classes(rows)}


def _spread(count: int, wanted: int) -> list[int]:
    return sorted(set(np.linspace(0, count - 1, max(0, min(wanted, count))).round().astype(int).tolist()))


def _view(data: Dataset, index: int, predicted: Mapping[str, Mapping[Key, Boxes]]) -> FrameView:
    frame = data[index]
    boxes = {name: found[frame.key] for name, found in predicted.items() if frame.key in found}
    title = f"{frame.sequence}, frame {frame.frame_id}"
    return FrameView(frame=frame, predictions=boxes, title=title, radar_db=power_from_above(frame))


def trained_on(provenance: Mapping[str, Any]) -> str:
    """One phrase on what a detector learnt from; empty where nothing is known."""
    experiment = provenance.get("experiment")
    if not experiment:
        return ""
    data = experiment["data"] if "path" in experiment["data"] else next(iter(experiment["data"].values()))
    made, clouds = data.get("simulate"), data["clouds"]
    names = [n for each in clouds.values() for n in each] if isinstance(clouds, Mapping) else clouds
    source = f"simulated frames (preset {made['preset']}, seed {made['seed']})" if made else f"frames of {data['path']}"
    commit = provenance.get("environment", {}).get("commit") or "unknown"
    return (
        f"{provenance.get('frames')} {source}, clouds {' and '.join(names)}, "
        f"{experiment['training']['steps']} steps of {experiment['training']['batch_size']}, "
        f"training seed {experiment['training']['seed']}, commit {commit}"
    )
