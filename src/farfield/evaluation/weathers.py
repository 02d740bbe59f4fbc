"""Detectors of several sensors on the same drives in several weathers: one evaluation, with figures by weather."""

import hashlib
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from farfield.datasets.base import Dataset
from farfield.detectors.info import DescribedDetector, DetectorFunction, DetectorInfo, as_detector
from farfield.errors import ConfigError, DatasetError
from farfield.evaluation.detecting import detect
from farfield.evaluation.evaluating import frame_view, training_text
from farfield.evaluation.record import Evaluation, FrameView
from farfield.evaluation.report_data import annotated_objects
from farfield.evaluation.views import as_trained, suitable_clouds
from farfield.frame import Annotation, Boxes, Key
from farfield.frame.provenance import environment, is_simulated
from farfield.jobs import JobOptions
from farfield.metrics.detections import Detections, presentation_of
from farfield.metrics.result import at, subject_of, value_at
from farfield.vocabulary.counts import count_of
from farfield.vocabulary.kradar import REGIONS_M

PROTOCOL, REGION, LABEL = "kradar", "narrow", "vehicle"
_FIGURE = f"ap/{LABEL}/3d/0.3"


def evaluate_weathers(
    detectors: Sequence[DescribedDetector | DetectorFunction],
    data: Mapping[str, Dataset],
    *,
    title: str,
    name: str,
    journals: Path | None = None,
    bulk: JobOptions | None = None,
) -> Evaluation:
    """Score detectors on the same drives in several weathers: AP of vehicles in the driving corridor, by weather.

    Args:
        detectors: One a sensor, all of which learnt in the same coordinates.
        data: The drives by weather; equal keys are the same moment.
        title: Title of the report.
        name: What the drives are called together.
        journals: Folder that keeps what was found, so that an interrupted evaluation goes on; None keeps nothing.
        bulk: Who detects (default: this process with all its threads).

    Returns:
        Results by cloud, and of each weather the frame with the most vehicles to find, the same moment in all.

    Raises:
        ConfigError: If two detectors read the same cloud.
        DatasetError: If the weathers have no moment in common.
    """
    chosen = [as_detector(detector) for detector in detectors]
    first_data = next(iter(data.values()))
    detections: dict[str, Detections] = {}
    results: dict[str, Any] = {}
    objects: dict[str, Any] = {}
    for detector in chosen:
        # Detect in each weather; a detector reads the cloud that suits it.
        cloud = suitable_clouds(detector.info, as_trained(first_data, detector.info)[0])[0]
        if cloud in detections:
            raise ConfigError(f"expected detectors of different clouds, got two of {cloud}")
        by_weather = {
            weather: detect(
                detector,
                drives,
                cloud=cloud,
                annotated_only=True,
                bulk=bulk,
                journal=None if journals is None else journals / f".found-{weather}-{cloud}.jsonl",
            )
            for weather, drives in data.items()
        }
        # Score all weathers as one data set, whose conditions tell them apart.
        merged = merge_weathers(by_weather, name)
        detections[cloud] = merged
        results[cloud] = merged.score(PROTOCOL, region=REGION, classes=(LABEL,)).to_json()
        objects[cloud] = annotated_objects(
            merged.boxes,
            merged.annotated,
            labels=(LABEL,),
            finding=presentation_of(results[cloud]).finding,
            kind=detector.info.sensor or "",
        )
    infos = [detector.info for detector in chosen]
    return Evaluation(
        title=title,
        results=results,
        objects=objects,
        frames=_views(infos[0], data, detections),
        settings={
            f"{info.name} {what}": value
            for info in infos
            for what, value in (("precision", info.precision), ("score_threshold", info.score_threshold))
        },
        provenance={
            **environment(),
            "data": name,
            "data_fingerprint": next(iter(detections.values())).fingerprint,
            "frames": sum(map(len, data.values())),
            "simulated": all(is_simulated(drives.root) for drives in data.values()),
            "trained_on": "; ".join(f"{training_text(info.provenance)} ({info.name})" for info in infos),
        },
    )


def merge_weathers(parts: Mapping[str, Detections], name: str) -> Detections:
    """One detector's detections in several weathers as those of one data set; drives are told apart by weather.

    Args:
        parts: The detections by weather.
        name: What the data are called together.
    """
    first = next(iter(parts.values()))
    prints = "".join(part.fingerprint for part in parts.values())
    leakage = {weather: part.seen_in_training for weather, part in parts.items()}
    boxes: dict[Key, Boxes] = {}
    annotations: dict[Key, Annotation] = {}
    conditions: dict[Key, Mapping[str, str]] = {}
    for weather, part in parts.items():
        boxes |= {key_in(weather, key): value for key, value in part.boxes.items()}
        annotations |= {key_in(weather, key): value for key, value in part.annotations.items()}
        conditions |= {key_in(weather, key): value for key, value in part.conditions.items()}
    return replace(
        first,
        boxes=boxes,
        annotations=annotations,
        conditions=conditions,
        drives=(),
        ms=tuple(ms for part in parts.values() for ms in part.ms),
        notes=(*_mixture_note(parts), *dict.fromkeys(note for part in parts.values() for note in part.notes)),
        data=name,
        fingerprint=hashlib.sha256(prints.encode()).hexdigest() if prints else "",
        labels_fingerprint="",
        seen_in_training=first.seen_in_training
        if len(set(leakage.values())) == 1
        else "; ".join(f"{weather}: {text}" for weather, text in leakage.items()),
    )


def _mixture_note(parts: Mapping[str, Detections]) -> tuple[str, ...]:
    """What the figures over all weathers are a mixture of."""
    if len(parts) < 2:
        return ()
    frames = (
        f"{count_of(len(part.annotations), 'frame')} in {weather.replace('_', ' ')}" for weather, part in parts.items()
    )
    return (f"figures not split by weather mix {' and '.join(frames)}: compare detectors by weather",)


def key_in(weather: str, key: Key) -> Key:
    """What a frame is called beside the same moment in other weathers."""
    return f"{key[0]} in {weather.replace('_', ' ')}", key[1]


def weather_table(results: Mapping[str, Mapping[str, Any]], weathers: Sequence[str]) -> str:
    """AP in per cent with its interval, a row a detector and a column a weather, and what the figures are of.

    Args:
        results: Result JSON by cloud, of :func:`evaluate_weathers`.
        weathers: Which weathers, in which order.
    """
    columns = ["AP_3d at IoU 0.3, per cent", *(weather.replace("_", " ") for weather in weathers)]
    lines = [columns]
    for cloud, result in results.items():
        subject = subject_of(result)
        who = cloud if subject is None else f"{subject.detector} ({cloud})"
        lines.append([who, *(_cell(result, weather) for weather in weathers)])
    first = next(iter(results.values()))
    lines.append([f"annotated {LABEL}s", *(_annotated_text(first, weather) for weather in weathers)])
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    rows = ["  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in lines]
    rows.insert(1, "  ".join("-" * width for width in widths))
    about = [
        textwrap.fill(f"of: {subject}", 120, subsequent_indent="  ", break_on_hyphens=False)
        for subject in map(subject_of, results.values())
        if subject is not None
    ]
    return "\n".join([*rows, "", "[low, high]: 95% bootstrap interval over drives", *about])


def _cell(result: Mapping[str, Any], weather: str) -> str:
    value = value_at((result.get("conditions") or {}).get("weather", {}).get(weather), _FIGURE)
    if value is None:
        return "-"
    bounds = at((result.get("intervals") or {}).get(f"weather/{weather}"), _FIGURE.split("/"))
    interval = f" [{100 * bounds[0]:.1f}, {100 * bounds[1]:.1f}]" if bounds else ""
    return f"{100 * value:.1f}{interval}"


def _annotated_text(result: Mapping[str, Any], weather: str) -> str:
    counts = ((result.get("counts") or {}).get("conditions") or {}).get("weather", {}).get(weather) or {}
    return (
        f"{counts['annotated']} in {count_of(counts['frames'], 'frame')}"
        if {"annotated", "frames"} <= set(counts)
        else "-"
    )


def _views(info: DetectorInfo, data: Mapping[str, Dataset], detections: Mapping[str, Detections]) -> list[FrameView]:
    """The moment with the most vehicles to find, in each weather; not chosen by what was found."""
    moments = set.intersection(*(set(drives.keys) for drives in data.values()))
    annotations = next(iter(detections.values())).annotations
    counts = {
        key: [_vehicles_in_corridor(annotations.get(key_in(weather, key))) for weather in data] for key in moments
    }
    if not counts:
        raise DatasetError(f"expected the same drives in {', '.join(data)}, found no moment that all have")
    best = max(sorted(counts), key=lambda key: (min(counts[key]), sum(counts[key])))
    predictions = {cloud: merged.boxes for cloud, merged in detections.items()}
    views = []
    for weather, drives in data.items():
        frames = as_trained(drives, info)
        frame = replace(frames[drives.keys.index(best)], sequence=key_in(weather, best)[0])
        title = f"{weather.replace('_', ' ').capitalize()}: drive {best[0]}, frame {best[1]}"
        views.append(frame_view(frame, predictions, title=title))
    return views


def _vehicles_in_corridor(annotation: Annotation | None) -> int:
    """Number of annotated vehicles in the corridor."""
    if annotation is None:
        return 0
    x_from, x_to, y_from, y_to, _, _ = REGIONS_M[REGION]
    x, y, _ = annotation.boxes.centre_m.T
    inside = (x >= x_from) & (x < x_to) & (y >= y_from) & (y < y_to)
    return int((inside & (np.asarray(annotation.boxes.label) == LABEL)).sum())
