"""Files that do not belong together: one sweep under two names, two recordings in one folder, other images' cameras."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from farfield.datasets.folder import Folder
from farfield.errors import FarfieldError
from farfield.inspection.doctor.survey import Finding, Survey
from farfield.vocabulary.counts import count_of

_LEAST_FOCAL, _MOST_FOCAL = 0.1, 50.0  # focal length over the image's width: 157 degrees of view, and 1 degree


def check_companions(survey: Survey, facts: dict[str, Any]) -> Iterator[Finding]:
    """Hold sweeps against one another, names against times, cameras against images, a mapping against the labels."""
    del facts
    yield from _equal_sweeps(survey)
    yield from _times_of_some(survey)
    yield from _cameras(survey)
    yield from _poses(survey)
    yield from _unused_mapping(survey)


def _equal_sweeps(survey: Survey) -> Iterator[Finding]:
    groups = [list(dict.fromkeys(paths)) for paths in survey.clouds_by_digest.values()]
    groups = [paths for paths in groups if len(paths) > 1]
    if groups:
        count, names = sum(map(len, groups)), [Path(path).name for path in groups[0][:3]]
        yield Finding(
            severity="warn",
            topic="sweeps",
            what=f"{count_of(count, 'file')} of clouds hold the same as another: {', '.join(names)}",
            where=groups[0][0],
            fix="A sensor that froze, or a copy: remove all but one, with their labels.",
        )


def _times_of_some(survey: Survey) -> Iterator[Finding]:
    """Names that are times beside others that are not: two recordings in one folder."""
    reader = survey.dataset.unwrapped
    if not isinstance(reader, Folder):
        return
    times = survey.times_ns
    missing = [key[1] for key, time in zip(survey.dataset.keys, times, strict=True) if time is None]
    present = [key[1] for key, time in zip(survey.dataset.keys, times, strict=True) if time is not None]
    if missing and present:
        yield Finding(
            severity="warn",
            topic="times",
            what=f"{count_of(len(present), 'frame')} of {len(times)} have times as names, such as {present[0]}, and "
            f"others such as {missing[0]} have none: two recordings in one folder? The times are not used",
            fix="Put each recording into a folder of its own.",
        )


def _cameras(survey: Survey) -> Iterator[Finding]:
    try:
        cameras = survey.dataset[0].cameras if survey.cameras and len(survey.dataset) else {}
    except (FarfieldError, OSError, ValueError):
        return  # the survey has reported it
    for (name, width, height, *calibrated), frames in survey.image_sizes.items():
        if [width, height] != calibrated:
            turned = [height, width] == calibrated
            yield Finding(
                severity="warn",
                topic="calibration",
                what=f"{count_of(len(frames), 'image')} of {name} of {width} x {height} pixels, calibrated for "
                f"{calibrated[0]} x {calibrated[1]}" + (": turned by a quarter" if turned else ""),
                where=frames[0],
                fix="Boxes are drawn beside their objects: calibrate for these images, or give those it was made of.",
            )
    for name, camera in cameras.items():
        focal, width = camera.matrix[[0, 1], [0, 1]], camera.width_px
        if width and not ((focal >= _LEAST_FOCAL * width) & (focal <= _MOST_FOCAL * width)).all():
            yield Finding(
                severity="warn",
                topic="calibration",
                what=f"the focal length of {name}, {focal[0]:g} and {focal[1]:g}, is none in pixels for an image "
                f"{width} wide: is it in millimetres?",
                fix="Give it in pixels: millimetres times the image's width over the sensor's.",
            )


def _poses(survey: Survey) -> Iterator[Finding]:
    try:
        issues = {drive.name: drive.odd_poses() for drive in survey.dataset.drives()}
    except (FarfieldError, OSError, ValueError):
        return  # the survey has reported it
    for name, sentences in issues.items():
        for sentence in sentences:
            fix = "Sweeps, tracks and velocities in the world are wrong there: mend the poses, or give others (poses=)."
            yield Finding(severity="warn", topic="poses", what=sentence, where=name, fix=fix)


def _unused_mapping(survey: Survey) -> Iterator[Finding]:
    reader = survey.dataset.unwrapped
    classes = getattr(reader, "class_mapping", None) or getattr(reader, "classes", None)
    path = getattr(reader, "mapping_path", None)
    if not classes or path is None or not survey.boxes:
        return
    labels = set(survey.raw_labels) | {str(label) for boxes in survey.boxes for label in boxes.label}
    unused = [name for name in classes if name not in labels]
    if unused and len(unused) == len(classes):
        yield Finding(
            severity="warn",
            topic="class names",
            what=f"none of the labels has a name of {Path(path).name}, such as {unused[0]}: is it another data set's?",
            where=str(path),
            fix="Name the classes as the labels do, or remove the file.",
        )
