"""A detector's boxes as the results of K-Radar's kit, OpenPCDet and mmdetection3d: a folder, a file a frame."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from farfield.datasets.base import Dataset
from farfield.datasets.kitti.boxes import objects_from_boxes
from farfield.errors import ConfigError
from farfield.files.atomic import write_text
from farfield.files.coordinates import write_coordinates
from farfield.files.kitti import write_labels
from farfield.files.mmdetection3d import InstanceBoxes, write_instances
from farfield.frame import Boxes, Camera, Frame, Key
from farfield.metrics.kit_axes import columns_of_boxes
from farfield.metrics.kit_folders import (
    ALL,
    ANNOTATED,
    DESCRIBED,
    NOTHING,
    PREDICTED,
    text_row,
    write_frames,
)
from farfield.vocabulary.classes import KITTI_FROM_CIRRUS, KRADAR_FROM_CIRRUS, KRADAR_SHORT
from farfield.vocabulary.conditions import CONDITIONS
from farfield.vocabulary.counts import count_of
from farfield.vocabulary.kradar import DESC_ORDER, spelled

KIT_NAMES = {ours: KRADAR_SHORT[long] for ours, long in KRADAR_FROM_CIRRUS.items()} | {
    name: short for long, short in KRADAR_SHORT.items() for name in (long, short)
}
"""The kit's word for each class that it has, of ours and of its own."""


def write_kit(
    out: Path, frame_boxes: Iterable[tuple[Key, Boxes]], frames: Sequence[Frame] | Dataset, *, annotated: bool
) -> list[str]:
    """Write the folder of one score cut of K-Radar's kit: ``all`` and a folder for each condition.

    Args:
        out: The folder.
        frame_boxes: The boxes of each frame, in its coordinates.
        frames: The frames, in the same order.
        annotated: Whether the frames are annotated: then those without an annotated box are left out, as the kit does.

    Returns:
        What was left out, a sentence each.
    """
    reference = frames[0].reference
    listed: dict[Path, list[str]] = {}
    names: dict[str, Key] = {}
    skipped = bare = left_out = 0
    for number, (key, boxes) in enumerate(frame_boxes):
        frame = frames[number]
        truth = frame.boxes if annotated else None
        truth = truth if truth is None else truth[np.isin(truth.label, [*KIT_NAMES])]
        if annotated and not (truth is not None and len(truth)):
            skipped += 1
            continue
        stem = f"{number:06d}"
        names[stem] = key
        words = {
            kind: spelled(kind, frame.conditions[kind])
            for kind, usual in CONDITIONS.items()
            if frame.conditions.get(kind) in usual
        }
        bare += len(words) < len(DESC_ORDER)
        left_out += int((~np.isin(boxes.label, [*KIT_NAMES])).sum())
        texts = {PREDICTED[0]: _rows(boxes, scored=True) or [NOTHING]}
        if truth is not None:
            texts[ANNOTATED[0]] = _rows(truth, scored=False)
        if len(words) == len(DESC_ORDER):
            texts[DESCRIBED] = [words[kind] for kind in DESC_ORDER]
        for condition in (ALL, *words.values()):
            folder = out / condition
            for side, rows in texts.items():
                (folder / side).mkdir(parents=True, exist_ok=True)
                write_text(folder / side / f"{stem}.txt", "\n".join(rows) + "\n")
            listed.setdefault(folder, []).append(stem)
    for folder, stems in listed.items():
        chosen = {stem: names[stem] for stem in stems}
        for side in (PREDICTED[0], ANNOTATED[0]):
            if (folder / side).is_dir():
                write_coordinates(folder / side, reference)
                write_frames(folder / side, chosen)
        if annotated:
            write_text(folder / "val.txt", "".join(f"{stem}\n" for stem in stems))
    notes = []
    if skipped:
        notes.append(f"{count_of(skipped, 'frame')} without an annotated box are left out, as the kit does")
    if bare:
        notes.append(f"conditions of {count_of(bare, 'frame')} are not all known: these have no description")
    if left_out:
        notes.append(f"{count_of(left_out, 'box', 'boxes')} of classes that the kit does not have are left out")
    return notes


def _rows(boxes: Boxes, *, scored: bool) -> list[str]:
    boxes = boxes[np.isin(boxes.label, [*KIT_NAMES])]
    sizes, places = columns_of_boxes(boxes)
    scores = np.ones(len(boxes)) if boxes.score is None else boxes.score
    return [
        text_row(KIT_NAMES[str(name)], sizes[row], places[row], yaw, scores[row] if scored else None)
        for row, (name, yaw) in enumerate(zip(boxes.label, boxes.yaw_rad.tolist(), strict=True))
    ]


def write_pcdet_text(path: Path, boxes: Boxes, camera: Camera) -> None:
    """Write a frame as OpenPCDet and mmdetection3d print KITTI's text: truncation and occlusion -1.

    Args:
        path: The text.
        boxes: Boxes in the coordinates of the LiDAR.
        camera: The left colour camera.
    """
    objects = objects_from_boxes(boxes, camera, classes=KITTI_FROM_CIRRUS)
    unknown = np.full(len(boxes), -1)
    score = np.ones(len(boxes)) if boxes.score is None else boxes.score
    write_labels(path, replace(objects, truncation=unknown.astype(np.float64), occlusion=unknown, score=score))


def write_instances_of(path: Path, boxes: Boxes, classes: Sequence[str], reference: str) -> None:
    """Write a frame as mmdetection3d's inferencer does, boxes of the LiDAR.

    Args:
        path: The JSON file.
        boxes: Boxes in the coordinates of the frame.
        classes: Classes in the order of their numbers.
        reference: Name of the coordinates.

    Raises:
        ConfigError: If a box is of another class.
    """
    numbers: Mapping[str, int] = {name: number for number, name in enumerate(classes)}
    strangers = sorted({str(name) for name in boxes.label} - set(numbers))
    if strangers:
        raise ConfigError(f"{path}: expected classes of {', '.join(classes)}, got {', '.join(strangers)}")
    bottom_m = boxes.centre_m - boxes.size_m * [0.0, 0.0, 0.5]
    has_velocity = boxes.velocity_m_s is not None and bool(np.isfinite(boxes.velocity_m_s[:, :2]).all())
    instances = InstanceBoxes(
        box=np.column_stack([bottom_m, boxes.size_m, boxes.yaw_rad]),
        box_type="LiDAR",
        class_number=np.array([numbers[str(name)] for name in boxes.label], dtype=np.int64),
        score=np.ones(len(boxes)) if boxes.score is None else boxes.score,
        velocity_m_s=boxes.velocity_m_s[:, :2] if has_velocity and boxes.velocity_m_s is not None else None,
        classes=tuple(classes),
        reference=reference,
    )
    write_instances(path, instances)
