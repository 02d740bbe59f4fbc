"""Detectors of several sensors on the same drives in several weathers: one evaluation, with figures by weather."""

import hashlib
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from farfield.datasets.base import Dataset
from farfield.errors import ConfigError, DatasetError
from farfield.evaluation import as_trained, detect, suitable_clouds
from farfield.evaluation.evaluating import trained_on
from farfield.evaluation.record import Evaluation, FrameView
from farfield.evaluation.report_data import annotated_objects, power_from_above
from farfield.figures.radar import weathers_picture
from farfield.figures.style import figure_bytes
from farfield.files.atomic import write_bytes
from farfield.frame import Annotation, Boxes, Key
from farfield.frame.provenance import environment, is_simulated
from farfield.jobs import JobOptions
from farfield.metrics import PROTOCOLS
from farfield.metrics.detections import Detections
from farfield.metrics.result import at, value_at
from farfield.metrics.subject import subject_of
from farfield.pages.evaluation_page import write_report
from farfield.vocabulary.kradar import REGIONS_M

if TYPE_CHECKING:
    from farfield.detectors.runtime import Detector

PROTOCOL, REGION, LABEL = "kradar", "narrow", "vehicle"
_DPI = 110
_FIGURE = f"ap/{LABEL}/3d/0.3"


def evaluate_weathers(
    detectors: Sequence["Detector"],
    data: Mapping[str, Dataset],
    *,
    title: str,
    name: str,
    kept: Path | None = None,
    bulk: JobOptions | None = None,
) -> Evaluation:
    """Score detectors on the same drives in several weathers: AP of vehicles in the driving corridor, by weather.

    Args:
        detectors: One a sensor, all of which learnt in the same coordinates.
        data: The drives by weather; equal keys are the same moment.
        title: Title of the report.
        name: What the drives are called together.
        kept: Folder that keeps what was found, so that an interrupted evaluation goes on; None keeps nothing.
        bulk: Who detects; this process with all its threads unless given.

    Returns:
        Results by cloud, and of each weather the frame with the most vehicles to find, the same moment in all.

    Raises:
        ConfigError: If two detectors read the same cloud.
        DatasetError: If the weathers have no moment in common.
    """
    results: dict[str, Any] = {}
    objects, found = {}, dict[str, Detections]()
    for detector in detectors:
        (cloud, *_) = suitable_clouds(detector, as_trained(next(iter(data.values())), detector)[0])
        if cloud in found:
            raise ConfigError(f"expected detectors of different clouds, got two of {cloud}")
        parts = {
            weather: detect(
                detector,
                drives,
                cloud=cloud,
                annotated_only=True,
                bulk=bulk,
                journal=None if kept is None else kept / f".found-{weather}-{cloud}.jsonl",
            )
            for weather, drives in data.items()
        }
        found[cloud] = merge_weathers(parts, name)
        results[cloud] = found[cloud].score(PROTOCOL, region=REGION, classes=(LABEL,)).to_json()
        objects[cloud] = annotated_objects(
            found[cloud].boxes,
            found[cloud].annotated,
            labels=(LABEL,),
            finding=PROTOCOLS[PROTOCOL].presentation(results[cloud]).finding,
            kind=detector.kind,
        )
    return Evaluation(
        title=title,
        results=results,
        objects=objects,
        frames=_views(detectors[0], data, found),
        settings={
            f"{each.name} {what}": value
            for each in detectors
            for what, value in (("precision", each.precision), ("score_threshold", each.config.score_threshold))
        },
        provenance={
            **environment(),
            "data": name,
            "data_fingerprint": next(iter(found.values())).fingerprint,
            "frames": sum(map(len, data.values())),
            "simulated": all(is_simulated(drives.root) for drives in data.values()),
            "trained_on": "; ".join(f"{trained_on(each.provenance)} ({each.name})" for each in detectors),
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
    seen = {weather: part.seen_in_training for weather, part in parts.items()}
    boxes: dict[Key, Boxes] = {}
    annotations: dict[Key, Annotation] = {}
    conditions: dict[Key, Mapping[str, str]] = {}
    for weather, part in parts.items():
        boxes |= {key_in(weather, key): each for key, each in part.boxes.items()}
        annotations |= {key_in(weather, key): each for key, each in part.annotations.items()}
        conditions |= {key_in(weather, key): each for key, each in part.conditions.items()}
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
        if len(set(seen.values())) == 1
        else "; ".join(f"{weather}: {words}" for weather, words in seen.items()),
    )


def _mixture_note(parts: Mapping[str, Detections]) -> tuple[str, ...]:
    """What the figures over all weathers are a mixture of."""
    if len(parts) < 2:
        return ()
    frames = (f"{len(part.annotations)} frames in {weather.replace('_', ' ')}" for weather, part in parts.items())
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
    about = [_folded(f"of: {subject}") for subject in map(subject_of, results.values()) if subject is not None]
    return "\n".join([*rows, "", "[low, high]: 95% bootstrap interval over drives", *about])


def _folded(text: str) -> str:
    return textwrap.fill(text, 120, subsequent_indent="  ", break_on_hyphens=False)


def _cell(result: Mapping[str, Any], weather: str) -> str:
    value = value_at((result.get("conditions") or {}).get("weather", {}).get(weather), _FIGURE)
    if value is None:
        return "-"
    bounds = at((result.get("intervals") or {}).get(f"weather/{weather}"), _FIGURE.split("/"))
    interval = f" [{100 * bounds[0]:.1f}, {100 * bounds[1]:.1f}]" if bounds else ""
    return f"{100 * value:.1f}{interval}"


def _annotated_text(result: Mapping[str, Any], weather: str) -> str:
    counts = ((result.get("counts") or {}).get("conditions") or {}).get("weather", {}).get(weather) or {}
    return f"{counts['annotated']} in {counts['frames']} frames" if {"annotated", "frames"} <= set(counts) else "-"


def _views(detector: "Detector", data: Mapping[str, Dataset], found: Mapping[str, Detections]) -> list[FrameView]:
    """The moment with the most vehicles to find, in each weather; not chosen by what was found."""
    moments = set.intersection(*(set(drives.keys) for drives in data.values()))
    first = next(iter(found.values()))
    rated = {
        key: [_vehicles_in_corridor(first.annotations.get(key_in(weather, key))) for weather in data] for key in moments
    }
    if not rated:
        raise DatasetError(f"expected the same drives in {', '.join(data)}, found no moment that all have")
    best = max(sorted(rated), key=lambda key: (min(rated[key]), sum(rated[key])))
    views = []
    for weather, drives in data.items():
        seen = as_trained(drives, detector)
        frame = replace(seen[drives.keys.index(best)], sequence=key_in(weather, best)[0])
        boxes = {cloud: part.boxes[frame.key] for cloud, part in found.items() if frame.key in part.boxes}
        title = f"{weather.replace('_', ' ').capitalize()}: drive {best[0]}, frame {best[1]}"
        views.append(FrameView(frame=frame, predictions=boxes, title=title, radar_db=power_from_above(frame)))
    return views


def _vehicles_in_corridor(annotation: Annotation | None) -> int:
    """Number of annotated vehicles in the corridor."""
    if annotation is None:
        return 0
    x_from, x_to, y_from, y_to, _, _ = REGIONS_M[REGION]
    x, y, _ = annotation.boxes.centre_m.T
    inside = (x >= x_from) & (x < x_to) & (y >= y_from) & (y < y_to)
    return int((inside & (np.asarray(annotation.boxes.label) == LABEL)).sum())


def write_weathers(evaluation: Evaluation, folder: Path, *, picture: str) -> tuple[Path, Path]:
    """Write the evaluation, its page and the picture of its moment into a folder.

    Args:
        evaluation: Of :func:`evaluate_weathers`, the radar's detector first.
        folder: Where; made if absent.
        picture: Name of the picture, ``.jpg`` or ``.png``.

    Returns:
        The paths of the page and of the picture.
    """
    radar, lidar = evaluation.results
    evaluation.save(folder)
    drawn = weathers_picture(evaluation.frames, radar=radar, lidar=lidar)
    write_bytes(folder / picture, figure_bytes(drawn, "png" if picture.endswith(".png") else "jpg", dpi=_DPI))
    return write_report(folder / "report.html", evaluation), folder / picture
