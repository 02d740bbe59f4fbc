"""A detector over a data set, cloud by cloud: scores, found objects and a few frames to look at, ready for a report."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from farfield.datasets.base import Dataset
from farfield.errors import DatasetError
from farfield.frame import Annotation, Boxes
from farfield.frame.provenance import environment
from farfield.geometry.points import BOX_MARGIN_M, count_points_in_boxes
from farfield.metrics import Result, score
from farfield.reports.evaluation import Evaluation, FrameView
from farfield.reports.objects import annotated_objects
from farfield.vocabulary.patterns import PATTERNS

if TYPE_CHECKING:
    from farfield.detectors.runtime import Detector

Progress = Callable[[Iterable[int], str], Iterable[int]]
Key = tuple[str, str]
Predictions = dict[Key, Boxes]


def no_progress(items: Iterable[int], what: str) -> Iterable[int]:
    """Show nothing."""
    del what
    return items


class Detected(NamedTuple):
    """What a detector found in the annotated frames of a data set, all by (sequence, frame).

    Args:
        predictions: Its boxes.
        annotations: The annotated ones.
        conditions: Weather, road and time of the frames.
        visibility: Which sensor sees each annotated box (K-Radar's R, L, L1), of the frames where that is known.
    """

    predictions: Predictions
    annotations: Predictions
    conditions: dict[Key, Mapping[str, str]]
    visibility: dict[Key, Sequence[str]]

    def score(self, protocol: str, **options: Any) -> Result:
        """Score the predictions; K-Radar's protocols also by condition and visibility."""
        annotations = {
            key: Annotation(boxes=boxes, visibility=self.visibility.get(key)) for key, boxes in self.annotations.items()
        }
        return score(self.predictions, annotations, protocol=protocol, conditions=self.conditions, **options)


def detect_all(
    detector: "Detector", data: Dataset, *, cloud: str, progress: Progress = no_progress
) -> tuple[Detected, float]:
    """Run a detector over one cloud of every frame.

    Returns:
        Predictions, annotations, conditions and visibility by (sequence, frame) of the annotated frames, and the median
        time that a frame took from points to boxes, in milliseconds.
    """
    reading = detector.with_cloud(cloud)
    found, taken_ms = Detected({}, {}, {}, {}), []
    for index in progress(range(len(data)), cloud):
        frame = data[index]
        if frame.boxes is None:
            continue
        points = frame.cloud(cloud)
        began = time.perf_counter()
        found.predictions[frame.key] = reading(points)
        taken_ms.append(1e3 * (time.perf_counter() - began))
        inside = count_points_in_boxes(points.points_m, frame.boxes, margin_m=BOX_MARGIN_M)
        # of this cloud: patterns share their boxes
        found.annotations[frame.key] = frame.boxes.replace(point_count=inside)
        found.conditions[frame.key] = frame.conditions
        if frame.annotation is not None and frame.annotation.visibility is not None:
            found.visibility[frame.key] = frame.annotation.visibility
    return found, float(np.median(taken_ms)) if taken_ms else float("nan")


def evaluate_clouds(
    detector: "Detector",
    data: Dataset,
    *,
    clouds: Sequence[str] | None = None,
    shown_frames: int = 4,
    protocol: str = "dds",
    title: str = "Farfield evaluation",
    provenance: Mapping[str, Any] | None = None,
    progress: Progress = no_progress,
    **options: Any,
) -> Evaluation:
    """Score a detector on each cloud of a data set.

    Args:
        detector: The detector.
        data: Annotated frames.
        clouds: Which clouds; by default those of the first frame that are of the kind that it learnt from.
        shown_frames: Frames that the report shows, spread evenly over the data.
        protocol: The metric.
        title: Title of the report.
        provenance: What is known of the data beyond their fingerprint.
        progress: Wraps frame numbers and the cloud's name, to show progress.
        **options: Settings of the protocol.

    Returns:
        Results, pictures' frames, settings and provenance by cloud.

    Raises:
        DatasetError: If no frame is annotated or a cloud is missing.
    """
    names = tuple(clouds or suitable_clouds(detector.provenance, tuple(data[0].clouds)))
    results, objects, predicted, speed_ms = {}, {}, {}, {}
    for name in names:
        found, speed_ms[name] = detect_all(detector, data, cloud=name, progress=progress)
        if not found.annotations:
            raise DatasetError(f"{data.root}: expected annotated frames, found none with boxes.")
        results[name] = found.score(protocol, **options).to_json()
        objects[name] = annotated_objects(found.predictions, found.annotations)
        predicted[name] = found.predictions
    return Evaluation(
        title=title,
        results=results,
        objects=objects,
        frames=[_view(data, index, predicted) for index in _spread(len(data), shown_frames)],
        settings={
            "detector": type(detector.network).__name__,
            "classes": ", ".join(detector.class_names),
            "range_m": detector.config.reach_m,
            "precision": detector.precision,
            "score_threshold": detector.config.score_threshold,
            "nms_iou": detector.config.nms_iou,
            "median_frame_ms": {name: round(value, 1) for name, value in speed_ms.items()},
        },
        provenance={
            **environment(),
            "data": data.name,
            "data_fingerprint": data.fingerprint(),
            "frames": len(data),
            "trained_on": _trained_on(detector.provenance),
            **(provenance or {}),
        },
    )


def suitable_clouds(provenance: Mapping[str, Any], present: tuple[str, ...]) -> tuple[str, ...]:
    """Clouds that a detector may read: those it learnt from, and further scan patterns if it learnt from one.

    Args:
        provenance: What is known of its training.
        present: Clouds that there are; all of them are suitable if none is of the kind that it learnt from.

    >>> learnt = {"experiment": {"data": {"clouds": ["radar"]}}}
    >>> suitable_clouds(learnt, ("os2-64", "radar")), suitable_clouds({}, ("gaussian", "uniform"))
    (('radar',), ('gaussian', 'uniform'))
    """
    learnt = set(provenance.get("experiment", {}).get("data", {}).get("clouds", ()))
    learnt |= set(PATTERNS) if learnt & set(PATTERNS) else set()
    return tuple(name for name in present if name in learnt) or present


def _spread(count: int, wanted: int) -> list[int]:
    return sorted(set(np.linspace(0, count - 1, max(0, min(wanted, count))).round().astype(int).tolist()))


def _view(data: Dataset, index: int, predicted: Mapping[str, Predictions]) -> FrameView:
    frame = data[index]
    boxes = {name: found[frame.key] for name, found in predicted.items() if frame.key in found}
    return FrameView(frame=frame, predictions=boxes, title=f"{frame.sequence}, frame {frame.frame_id}")


def _trained_on(provenance: Mapping[str, Any]) -> str:
    """One phrase on what a detector learnt from; empty where nothing is known."""
    experiment = provenance.get("experiment")
    if not experiment:
        return ""
    data, made = experiment["data"], experiment["data"].get("simulate")
    source = f"simulated frames (preset {made['preset']}, seed {made['seed']})" if made else f"frames of {data['path']}"
    commit = provenance.get("environment", {}).get("commit") or "unknown"
    return (
        f"{provenance.get('frames')} {source}, clouds {' and '.join(data['clouds'])}, "
        f"{experiment['training']['steps']} steps of {experiment['training']['batch_size']}, "
        f"training seed {experiment['training']['seed']}, commit {commit}"
    )
