"""What the clouds and boxes hold: columns, units, intensity, which way is up, classes by range, suspicious boxes."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from farfield.datasets.cirrus import Cirrus
from farfield.datasets.class_mapping import MAPPING_NAME
from farfield.datasets.maps.coordinates import Move
from farfield.errors import FarfieldError
from farfield.files.limits import MAX_RINGS
from farfield.frame import Boxes, Cloud
from farfield.inspection.axes_and_units import forward_doubt, unit_of_boxes, unit_of_points, upright_doubt
from farfield.inspection.doctor.conventions import count_points, ground_height_m
from farfield.inspection.doctor.survey import Finding, Survey
from farfield.vocabulary.classes import CIRRUS_CLASSES, closest_class, normalised_class
from farfield.vocabulary.counts import count_of

_LARGEST_VALUE, _RING_NAMES = 1e20, ("ring", "laser", "line", "channel")
RANGE_BINS_M = (0.0, 70.0, 150.0, 250.0, np.inf)
_LARGEST_M = {  # length, width, height of the largest plausible objects, sorted; smaller ones may be partly seen
    "vehicle": (9.0, 3.5, 3.8),
    "large_vehicle": (32.0, 5.0, 5.5),
    "trailer": (32.0, 5.0, 5.5),
    "pedestrian": (2.6, 2.2, 2.0),
    "wheeled_pedestrian": (3.0, 2.2, 2.0),
    "bicycle": (3.5, 2.5, 1.8),
    "motorcycle": (3.8, 2.5, 1.8),
    "animal": (4.0, 3.0, 2.0),
}


def check_clouds(survey: Survey, facts: dict[str, Any]) -> Iterator[Finding]:
    """Tell columns, points a sweep, reach and intensity of each pattern."""
    for name in survey.sensors:
        loaded = [sample.clouds[name] for sample in survey.samples if name in sample.clouds]
        if not loaded:
            continue
        points = np.concatenate([cloud.points_m for cloud in loaded])
        reach_m = float(np.hypot(points[:, 0], points[:, 1]).max(initial=0.0))
        per_sweep = sorted(len(cloud) for cloud in loaded)
        intensities = [cloud.intensity for cloud in loaded if cloud.intensity is not None]
        strength = np.concatenate(intensities) if intensities else None
        columns = ["x", "y", "z", *["intensity"] * bool(intensities), *loaded[0].extra]
        facts.setdefault("clouds", {})[name] = {
            "points": per_sweep[len(per_sweep) // 2],
            "reach_m": round(reach_m, 1),
            "columns": columns,
            "intensity": None
            if strength is None
            else [float(strength.min(initial=1.0)), float(strength.max(initial=0.0))],
        }
        what = (
            f"{len(columns)} columns ({', '.join(columns)}), "
            f"{per_sweep[0]}..{count_of(per_sweep[-1], 'point')} a sweep, reach "
            f"{reach_m:.0f} m"
        )
        if strength is not None:
            low, high = strength.min(initial=1.0), strength.max(initial=0.0)
            what += f", intensity {low:.3f}..{high:.3f}{_scale_text(survey, name)}"
        gone = sum(cloud.missing for cloud in loaded)
        if gone:
            what += f", {gone} invalid points (no return) left out"
        yield Finding(severity="ok", topic=f"cloud {name}", what=what)
        if strength is not None and not strength.any():
            mapped = isinstance(survey.dataset.unwrapped, Cirrus)
            fix = "A detector trained with intensity will not work here" + (
                ": name the right column in the mapping."
                if mapped
                else "; files of three columns have none, in others see whether another column holds it."
            )
            yield Finding(severity="warn", topic=f"cloud {name}", what="intensity is 0 everywhere", fix=fix)
        yield from _doubtful_columns(name, loaded)
        doubt = unit_of_points(points.astype(np.float64))
        if doubt is not None:
            yield Finding(severity="fail", topic=doubt.topic, what=doubt.what, where=name, fix=doubt.fix)


def _doubtful_columns(name: str, read: Sequence[Cloud]) -> Iterator[Finding]:
    """Columns whose numbers cannot be what they are called: a header with wrong offsets mixes their bytes."""
    doubtful = {}
    for column in read[0].extra:
        values = np.concatenate(
            [np.asarray(cloud.extra[column]).reshape(-1) for cloud in read if column in cloud.extra]
        )
        values = values.astype(np.float64)
        wild = ~np.isfinite(values) | (np.abs(values) > _LARGEST_VALUE)
        rings = column in _RING_NAMES and len(values) and values[~wild].max(initial=0) >= MAX_RINGS
        if wild.any() or rings:
            doubtful[column] = f"{column} (to {np.abs(values[np.isfinite(values)]).max(initial=0):.3g})"
    if doubtful:
        what = f"impossible numbers in {', '.join(doubtful.values())}: the header may give wrong places for them"
        fix = "Positions and intensity are not touched; do not use these columns, or write the header anew."
        yield Finding(severity="warn", topic=f"cloud {name}", what=what, fix=fix)


def _scale_text(survey: Survey, name: str) -> str:
    """The value of full reflectance, where it was given or decided from the clouds."""
    reader = survey.dataset.unwrapped
    if isinstance(reader, Cirrus) and name in reader.intensity_scale:
        source = "decided from the data" if reader.mapping.xyz.intensity_scale == "auto" else "given"
        return f" of full scale {reader.intensity_scale[name]:g} ({source})"
    if reader.reading is not None:
        return f" of full scale {reader.reading.scale:g} ({reader.reading.scale_source})"
    return ""


def check_classes(survey: Survey, facts: dict[str, Any]) -> Iterator[Finding]:
    """Count classes by range, and tell names that the vocabulary lacks."""
    boxes = survey.all_boxes()
    table: dict[str, dict[str, int]] = {}
    names = [f"{low:g}-{high:g} m" if high < np.inf else f"{low:g}+ m" for low, high in _bins()]
    for label in sorted(set(np.asarray(boxes.label).tolist())):
        ranges = boxes.range_m[np.asarray(boxes.label) == label]
        counts = [int(((ranges >= low) & (ranges < high)).sum()) for low, high in _bins()]
        table[label] = dict(zip(names, counts, strict=True))
    facts["classes_by_range"] = table
    for label, row in table.items():
        shown = ", ".join(f"{count} at {name}" for name, count in row.items() if count)
        yield Finding(severity="ok", topic=f"class {label}", what=f"{count_of(sum(row.values()), 'box')}: {shown}")
    reader = survey.dataset.unwrapped
    if not isinstance(reader, Cirrus):
        yield from _own_names(table)
        return
    aliases = reader.mapping.labels.aliases
    strange = {
        name: count
        for name, count in survey.raw_labels.items()
        if normalised_class(name, aliases) not in CIRRUS_CLASSES
    }
    if strange:
        most = sum(strange.values()) > 0.5 * max(len(boxes), 1)
        shown = ", ".join(f"{name!r} ({count})" for name, count in list(strange.items())[:8])
        yield Finding(
            severity="fail" if most else "warn",
            topic="class names",
            what=f"not in the vocabulary: {shown}",
            fix="Give aliases in the mapping, such as labels: {aliases: {car: vehicle}}, or classes: {Auto: vehicle} "
            f"in {MAPPING_NAME}.",
        )


def _own_names(table: Mapping[str, Mapping[str, int]]) -> Iterator[Finding]:
    """Names that neither the detectors nor the experiments know, with what they may mean."""
    counts = {label: sum(row.values()) for label, row in table.items()}
    strange = {label: count for label, count in counts.items() if label not in CIRRUS_CLASSES}
    if not strange:
        return
    vocabulary = [name for name in CIRRUS_CLASSES if name != "unknown"]
    meant = {label: guess for label in strange if (guess := closest_class(label, vocabulary))}
    shown = ", ".join(f"{label!r} ({count})" for label, count in list(strange.items())[:8])
    example = meant or {next(iter(strange)): vocabulary[0]}
    pairs = ", ".join(f"{label}: {guess}" for label, guess in example.items())
    yield Finding(
        severity="fail" if len(strange) == len(counts) else "warn",
        topic="class names",
        what=f"not in the vocabulary ({', '.join(vocabulary)}): {shown}"
        + (f"; did you mean {pairs}?" if meant else ""),
        fix=f"Rename them, or write {{classes: {{{pairs}}}}} into {MAPPING_NAME} beside the data, or into a file for "
        f"--mapping; or -o 'data.aliases={{{pairs}}}' in train, "
        f"--options relabel={pairs.replace(': ', ':').replace(', ', ',')} in score and evaluate; or train your own: "
        "detector.class_names.",
    )


def _bins() -> list[tuple[float, float]]:
    return list(pairwise(RANGE_BINS_M))


def check_sizes(survey: Survey, facts: dict[str, Any]) -> Iterator[Finding]:
    """Check the unit of the sizes and find implausible ones."""
    boxes = survey.all_boxes()
    if not len(boxes):
        return
    longest = float(np.median(boxes.size_m.max(axis=1)))
    facts["median_longest_side_m"] = round(longest, 3)
    doubt = unit_of_boxes(boxes)
    if doubt is not None:
        yield Finding(severity="fail", topic=doubt.topic, what=doubt.what, fix=doubt.fix)
        return
    yield from _order_of_sizes(boxes)
    limits = np.array([_LARGEST_M.get(label, (60.0, 20.0, 20.0)) for label in np.asarray(boxes.label).tolist()])
    large = (-np.sort(-boxes.size_m, axis=1) > limits).any(axis=1)
    small = boxes.size_m.max(axis=1) < 0.1
    share = float((large | small).mean())
    what = f"{int(large.sum())} too large for their class, {int(small.sum())} below 0.1 m, of {len(boxes)}"
    fix = "Look at them: a wrong class or a slip of the hand." if share else ""
    severity = "fail" if share > 0.5 and len(boxes) >= 10 else "warn" if share else "ok"
    yield Finding(severity=severity, topic="box sizes", what=what, fix=fix)  # type: ignore[arg-type]


def _order_of_sizes(boxes: Boxes) -> Iterator[Finding]:
    """Vehicles that are higher or wider than long: their sizes stand in another order."""
    long = np.isin(np.asarray(boxes.label), ("vehicle", "large_vehicle", "trailer"))
    for axis, word in ((2, "higher"), (1, "wider")):
        wrong = long & (boxes.size_m[:, axis] > 1.2 * boxes.size_m[:, 0])
        if wrong.sum() > 0.5 * long.sum():
            what = f"{int(wrong.sum())} of {int(long.sum())} vehicles are {word} than long"
            fix = "Sizes are length (along the heading), width, height: exchange them, or turn the yaw by pi/2."
            yield Finding(severity="warn", topic="order of sizes", what=what, fix=fix)
            return


def check_tracks(survey: Survey, facts: dict[str, Any]) -> Iterator[Finding]:
    """Find identities that stand twice in a frame."""
    tracks = [boxes.track_id[boxes.track_id >= 0] for boxes in survey.boxes if boxes.track_id is not None]
    doubled = sum(len(np.unique(numbers)) < len(numbers) for numbers in tracks)
    if doubled:
        facts["frames_with_doubled_tracks"] = doubled
        what = f"{doubled} of {count_of(len(tracks), 'frame')} have two boxes of one track"
        fix = "An identity is one object: number them anew, or leave the numbers out."
        yield Finding(severity="warn", topic="tracks", what=what, fix=fix)


def check_suspicious_boxes(survey: Survey, facts: dict[str, Any]) -> Iterator[Finding]:
    """Find empty, doubled and underground boxes in the frames whose clouds were read."""
    total = near = empty = near_empty = doubled = buried = 0
    for sample, boxes in survey.annotated_samples():
        points = sample.points_m
        count = count_points(points, boxes, ())[:, 0]
        close = boxes.range_m < 70.0
        total, near = total + len(boxes), near + int(close.sum())
        empty, near_empty = empty + int((count == 0).sum()), near_empty + int((count[close] == 0).sum())
        doubled += _count_doubled(boxes)
        ground = ground_height_m(points, boxes.centre_m[:, :2])
        buried += int((boxes.centre_m[:, 2] + boxes.size_m[:, 2] / 2 < ground).sum())
    if total == 0:
        return
    facts["points_in_boxes"] = {"boxes": total, "empty": empty, "near": near, "near_empty": near_empty}
    yield _overlap(total, empty, near, near_empty)
    if doubled:
        fix = "Two boxes of one class share a place: remove one, or every detection of it counts once as missed."
        what = f"{doubled} of {count_of(total, 'box', 'boxes')} stand in another of their class"
        yield Finding(severity="warn", topic="doubled boxes", what=what, fix=fix)
    if buried:
        what = f"{buried} of {count_of(total, 'box', 'boxes')} end below the ground round them"
        severity = "fail" if buried > 0.5 * total and total >= 10 else "warn"
        named = " (position_is in the mapping)" if isinstance(survey.dataset.unwrapped, Cirrus) else ""
        fix = f"Check the height of the boxes{named} and the pose of the sensor."
        yield Finding(severity=severity, topic="underground", what=what, fix=fix)  # type: ignore[arg-type]


def _overlap(total: int, empty: int, near: int, near_empty: int) -> Finding:
    what = (
        f"{total - empty} of {count_of(total, 'box', 'boxes')} hold points above "
        f"the ground; nearer than 70 m {near - near_empty} of {near}"
    )
    if total >= 3 and (empty > 0.9 * total or (near >= 10 and near_empty > 0.75 * near)):
        fix = "Boxes and points do not belong together: check pairing, axes, units and the order of the sizes."
        return Finding(severity="fail", topic="points in boxes", what=what, fix=fix)
    many = empty > 0.3 * total
    fix = "Train and score with min_points 1 to leave empty boxes out." if many else ""
    return Finding(severity="warn" if many else "ok", topic="points in boxes", what=what, fix=fix)


def _count_doubled(boxes: Boxes) -> int:
    label, is_doubled = np.asarray(boxes.label), np.zeros(len(boxes), dtype=bool)
    rows = max(1, _PAIRS_AT_ONCE // max(len(boxes), 1))
    for start in range(0, len(boxes), rows):
        part = slice(start, start + rows)
        gap = np.linalg.norm(boxes.centre_m[part, None] - boxes.centre_m[None], axis=2)
        same = (label[part, None] == label[None]) & (gap < 0.25 * boxes.size_m[part, :2].min(axis=1)[:, None])
        is_doubled |= np.triu(same, 1 + start).any(axis=0)
    return int(is_doubled.sum())


_PAIRS_AT_ONCE = 1_000_000


# Which way is up, and ahead: axes of clouds; cameras that lie on their side or whose pose is the inverse.

_STANDING = 0.7  # cosine between the image's down and the ground's: 45 degrees


def check_clouds_upright(survey: Survey, facts: dict[str, Any]) -> Iterator[Finding]:
    """Look which way is up, and which way the road leads; in a wrong unit neither can be told."""
    del facts
    samples = [sample for sample in survey.samples if len(sample.points_m)]
    points = np.concatenate([sample.points_m for sample in samples]) if samples else np.zeros((0, 3))
    points = points[np.isfinite(points).all(axis=1)]
    annotated = survey.all_boxes()
    if unit_of_points(points) is not None or unit_of_boxes(annotated) is not None:
        return
    turned = any(isinstance(function, Move) for function in survey.dataset.maps)  # then ahead is where was asked for
    for doubt in (upright_doubt(points), None if turned else forward_doubt(points, annotated)):
        if doubt is not None:
            severity = "fail" if doubt.certain else "warn"
            yield Finding(severity=severity, topic=doubt.topic, what=doubt.what, fix=doubt.fix)  # type: ignore[arg-type]


def check_cameras_upright(survey: Survey, facts: dict[str, Any]) -> Iterator[Finding]:
    """Hold the cameras' poses against the ground: an image's lower edge points down."""
    del facts
    try:
        cameras = survey.dataset[0].cameras if survey.cameras and len(survey.dataset) else {}
    except (FarfieldError, OSError, ValueError):
        return  # the survey has reported it
    for name, camera in cameras.items():
        # Cosine between the image's downward axis and the lidar's, of the pose and of its inverse.
        rotation = camera.camera_T_lidar[:3, :3]
        down = float(-rotation[1, 2])
        inverse = float(-rotation[2, 1])
        if down > _STANDING:
            continue
        what = f"camera {name} lies on its side or its head (cosine between its down and the ground's: {down:.2f})"
        if inverse > _STANDING:
            what += "; it is upright if camera_T_lidar is inverted: the file holds lidar_T_camera"
        fix = "Give camera_T_lidar, which takes the lidar's points (z up) to the camera (x right, y down, z ahead)."
        yield Finding(severity="fail", topic="calibration", what=what, fix=fix)
