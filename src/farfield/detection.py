"""Detectors meet data sets: one way from a detector to what it found, ready to be scored."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from farfield.datasets.base import Dataset
from farfield.datasets.recipes import recipe_of_provenance, replay
from farfield.errors import ConfigError, DatasetError
from farfield.frame import Annotation, Boxes, Cloud, Frame, Key, Pose
from farfield.geometry.points import BOX_MARGIN_M, count_points_in_boxes
from farfield.geometry.poses import invert
from farfield.metrics.detections import Detections
from farfield.vocabulary.patterns import PATTERNS

if TYPE_CHECKING:
    from farfield.detectors.runtime import Detector

Frames = Sequence[Frame] | Dataset
Progress = Callable[[Iterable[int]], Iterable[int]]
AnyDetector = Callable[[Frame | Cloud], Boxes]


def detect(
    detector: "Detector | AnyDetector",
    data: Frames,
    *,
    cloud: str | None = None,
    annotated_only: bool = False,
    progress: Progress = iter,
) -> Detections:
    """Detect objects in every frame.

    The frames are seen as the detector learnt to see them (:func:`as_trained`); its boxes, the annotated ones and
    ``reference`` are in those coordinates. The annotated boxes carry the number of points that the cloud has inside
    them.

    Args:
        detector: A detector, or any function from a frame to scored boxes.
        data: A data set, or frames in memory.
        cloud: Which of the frames' clouds to read; by default the first of :func:`suitable_clouds`.
        annotated_only: Leave out frames without annotation, which no score counts.
        progress: Wraps the frame numbers, to show progress.

    Raises:
        ConfigError: If a frame has no cloud that suits the detector, or not the one asked for.
        DatasetError: If there is no frame, or none is annotated though only such count.
    """
    seen = as_trained(data, detector)
    if not len(seen):
        raise DatasetError("detect: expected at least one frame, found none.")
    first = seen[0]
    name = cloud or next(iter(suitable_clouds(detector, first)), None)
    reading = detector.with_cloud(name) if hasattr(detector, "with_cloud") else detector
    boxes: dict[Key, Boxes] = {}
    annotations: dict[Key, Annotation] = {}
    conditions: dict[Key, Mapping[str, str]] = {}
    ms: list[float] = []
    for index in progress(range(len(seen))):
        frame = seen[index]
        if annotated_only and not frame.has_annotation:
            continue
        points = None if name is None else frame.cloud(name)  # reading a file is not the detector's time
        began = time.perf_counter()
        boxes[frame.key] = reading(frame)
        ms.append(1e3 * (time.perf_counter() - began))
        conditions[frame.key] = frame.conditions
        if frame.annotation is not None:
            annotations[frame.key] = frame.annotation if points is None else _counted(frame.annotation, points)
    if annotated_only and not annotations:
        raise DatasetError(f"{_where(data)}: expected annotated frames, found none with boxes.")
    return Detections(
        reference=first.reference,
        cloud=name,
        classes=tuple(getattr(detector, "class_names", ())),
        drives=seen.drives() if isinstance(seen, Dataset) else (),
        boxes=boxes,
        annotations=annotations,
        conditions=conditions,
        facts=_facts(annotations),
        reach_m=getattr(getattr(detector, "config", None), "reach_m", None),
        ms=tuple(ms),
    )


def as_trained(data: Any, detector: Any) -> Any:
    """The data as the detector was trained to see them, by its provenance.

    That is with as many sweeps a frame, turned as far, in the same coordinates and with as dense a radar cloud. Frames
    that are not a data set's stay as they are, and what was done to the data already is not done again.

    Raises:
        DatasetError: If the detector wants several sweeps and the frames have no poses or times.
    """
    if not isinstance(data, Dataset):
        return data
    return replay(data, recipe_of_provenance(getattr(detector, "provenance", None) or {}))


def suitable_clouds(detector: Any, frame: Frame) -> tuple[str, ...]:
    """Clouds of a frame that a detector may read.

    They come from a sensor of its kind and stand in the frame's coordinates: those it learnt from, with the other scan
    pattern if it learnt from one, or, where the frame has none of them, all others of that kind.

    Args:
        detector: The detector; of a plain function nothing is known, and any cloud may do.
        frame: One of the frames.

    Raises:
        ConfigError: If no cloud of the frame suits.
    """
    kind = getattr(detector, "kind", None)
    if kind is None:
        return tuple(frame.clouds)
    fitting = [name for name in frame.clouds if _fits(frame, name, kind)]
    if not fitting:
        there = ", ".join(f"{name} ({_kind(frame, name)})" for name in frame.clouds) or "none"
        raise ConfigError(
            f"Expected a cloud of a {kind}, which the detector reads, in the frame's coordinates; frame {frame.key} "
            f"has {there}. Take a detector for these sensors, or data with a {kind}."
        )
    learnt = set(detector.learnt_clouds)
    learnt |= set(PATTERNS) if learnt & set(PATTERNS) else set()
    return tuple(name for name in fitting if name in learnt) or tuple(fitting)


def _fits(frame: Frame, name: str, kind: str) -> bool:
    sensor = frame.sensors.get(name)
    return sensor is None or (sensor.kind == kind and sensor.in_frame)


def _kind(frame: Frame, name: str) -> str:
    sensor = frame.sensors.get(name)
    if sensor is None:
        return "of an unknown sensor"
    return sensor.kind if sensor.in_frame else f"{sensor.kind}, in axes of its own"


def _counted(annotation: Annotation, cloud: Cloud) -> Annotation:
    """The annotation with the number of this cloud's points in each box: scan patterns share their boxes."""
    inside = count_points_in_boxes(cloud.points_m, annotation.boxes, margin_m=BOX_MARGIN_M)
    return annotation.replaced(annotation.boxes.replace(point_count=inside))


def given(
    boxes: Mapping[Key, Boxes], data: Frames, *, cloud: str | None = None, progress: Progress = iter
) -> Detections:
    """Predictions made elsewhere, with what was annotated in the frames of ``data``.

    Args:
        boxes: Scored boxes by (sequence, frame), in the coordinates of ``data``.
        data: Frames; those without annotation are left out.
        cloud: A cloud whose points in the annotated boxes are counted; without one their own counts stay.
        progress: Wraps the frame numbers, to show progress.
    """
    annotations: dict[Key, Annotation] = {}
    conditions: dict[Key, Mapping[str, str]] = {}
    reference = ""
    for index in progress(range(len(data))):
        frame = data[index]
        if frame.annotation is not None:
            annotation = frame.annotation
            annotations[frame.key] = annotation if cloud is None else _counted(annotation, frame.cloud(cloud))
            conditions[frame.key], reference = frame.conditions, frame.reference
    return Detections(
        reference=reference,
        cloud=cloud,
        drives=data.drives() if isinstance(data, Dataset) else (),
        boxes={key: each for key, each in boxes.items() if key in annotations},
        annotations=annotations,
        conditions=conditions,
        facts=_facts(annotations),
    )


def _facts(annotations: Mapping[Key, Annotation]) -> dict[str, str]:
    versions = sorted({annotation.version for annotation in annotations.values()} - {""})
    return {"label_version": " and ".join(versions)} if versions else {}


def _where(data: Any) -> str:
    return str(getattr(data, "root", "detect"))


def back_in_own(found: Detections, data: Frames, seen: Frames) -> Detections:
    """The detections with their boxes in the coordinates of ``data`` instead of those in which they were found.

    Args:
        found: What was found in ``seen``.
        data: The frames as they were opened.
        seen: The same frames as the detector saw them.

    Raises:
        ConfigError: If no sensor's place is known in both, so that the motion between them is not.
    """
    if not len(data) or data[0].reference == found.reference:
        return found
    boxes = {}
    for index in range(len(data)):
        own = data[index]
        if own.key in found.boxes:
            boxes[own.key] = found.boxes[own.key].transform(_motion(seen[index], own))
    return replace(found.replaced(boxes), reference=data[0].reference)


def _motion(source: Frame, target: Frame) -> Pose:
    """What maps a frame's coordinates to those of the same frame seen otherwise."""
    for name, sensor in source.sensors.items():
        there = target.sensors.get(name)
        if there is not None and sensor.frame_T_sensor is not None and there.frame_T_sensor is not None:
            return there.frame_T_sensor @ invert(sensor.frame_T_sensor)
    raise ConfigError(
        f"frame {target.key}: expected to know where a sensor stands in the coordinates of {source.reference} and of "
        f"{target.reference}, found none; boxes can be given in those of {source.reference} only"
    )


def median_ms(found: Detections) -> float:
    """Median time that a frame took from points to boxes, milliseconds; NaN without frames."""
    return float(np.median(found.ms)) if found.ms else float("nan")
