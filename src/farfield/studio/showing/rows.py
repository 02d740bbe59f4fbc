"""Boxes as rows for the page, and rows as boxes for everything that computes."""

from collections.abc import Iterable, Sequence
from typing import Any, Literal

import numpy as np
from jaxtyping import Int

from farfield.annotation.annotator import box_numbers
from farfield.annotation.schema import ClassPreset, cirrus_class, class_preset
from farfield.annotation.surroundings import cloud_name
from farfield.frame import Annotation, Boxes, Frame
from farfield.geometry.boxes import BOX_MARGIN_M, count_points_in_boxes
from farfield.studio.messages.rows import BoxRow, ClassSpec, FrameInfo, PredictedRow, TypeSpec
from farfield.studio.showing.layers import matrix
from farfield.vocabulary.classes import CLASS_COLOURS

Group = Literal["vehicle", "person", "two_wheeler", "other"]
_SPARE_COLOURS = tuple(CLASS_COLOURS.values())
_GROUPS: dict[str, Group] = {
    "vehicle": "vehicle",
    "large_vehicle": "vehicle",
    "trailer": "vehicle",
    "pedestrian": "person",
    "wheeled_pedestrian": "person",
    "bicycle": "two_wheeler",
    "motorcycle": "two_wheeler",
}


def box_id(index: int, name: str) -> str:
    """Identity of a box among all of the data set: the number of its frame and its name within that."""
    return f"{index}:{name}"


def annotated_rows(annotation: Annotation, index: int, frame: Frame | None = None) -> tuple[BoxRow, ...]:
    """What was annotated, as rows whose names within the frame are their places.

    Args:
        annotation: The annotation.
        index: Number of the frame.
        frame: Where points are counted; without it those of the annotation stand.
    """
    boxes = annotation.boxes
    lidar, radar = (None, None) if frame is None else (counted(frame, boxes, "lidar"), counted(frame, boxes, "radar"))
    lidar = boxes.point_count if lidar is None else lidar
    visibility = annotation.visibility
    return tuple(
        BoxRow(
            id=box_id(index, str(row)),
            track=None if boxes.track_id is None or boxes.track_id[row] < 0 else int(boxes.track_id[row]),
            class_name=str(boxes.label[row]),
            box=box_numbers(boxes, row),
            version=0,
            state="accepted",
            source="lidar",
            attributes=_attributes(annotation, row),
            points=None if lidar is None or lidar[row] < 0 else int(lidar[row]),
            radar_points=None if radar is None else int(radar[row]),
            distance_m=float(boxes.range_m[row]),
            visibility=None if visibility is None else str(visibility[row]),
            moving=None if annotation.moving is None else bool(annotation.moving[row]),
        )
        for row in range(len(boxes))
    )


def _attributes(annotation: Annotation, row: int) -> dict[str, str | int | float | bool | None]:
    attributes: dict[str, Any] = {}
    if annotation.original_label is not None:
        attributes["original_label"] = str(annotation.original_label[row])
    for name, rows in annotation.details.items():
        value = np.asarray(rows)[row]
        if value.ndim == 0:
            plain = value.item()
            attributes[name] = plain if not isinstance(plain, float) or np.isfinite(plain) else None
    return attributes


def counted(frame: Frame, boxes: Boxes, kind: str) -> Int[np.ndarray, " n"] | None:
    """Points of the first cloud of a kind inside each box; None where the frame has no such cloud in its axes."""
    name = cloud_name(frame, kind)
    if name is None:
        return None
    return np.asarray(count_points_in_boxes(frame.cloud(name).points_m, boxes, margin_m=BOX_MARGIN_M))


def boxes_of(rows: Sequence[BoxRow]) -> Boxes:
    """Rows as boxes with classes in Cirrus's words, in their order; a size that is not positive becomes 1 mm."""
    if not rows:
        return Boxes.empty()
    values = np.array([row.box for row in rows], dtype=np.float64)
    return Boxes(
        centre_m=values[:, :3],
        size_m=np.maximum(values[:, 3:6], 1e-3),
        yaw_rad=values[:, 6],
        label=[cirrus_class(row.class_name) for row in rows],
        track_id=np.array([-1 if row.track is None else row.track for row in rows], dtype=np.int64),
    )


def predicted_rows(boxes: Boxes) -> list[PredictedRow]:
    """Predicted boxes as rows, not yet matched, the highest score first."""
    order = range(len(boxes)) if boxes.score is None else np.argsort(-boxes.score, kind="stable")
    return [
        PredictedRow(
            class_name=str(boxes.label[row]),
            box=box_numbers(boxes, row),
            score=None if boxes.score is None else float(boxes.score[row]),
            track=None if boxes.track_id is None or boxes.track_id[row] < 0 else int(boxes.track_id[row]),
            velocity=_velocity(boxes, row),
            distance_m=float(boxes.range_m[row]),
        )
        for row in map(int, order)
    ]


def _velocity(boxes: Boxes, row: int) -> tuple[float, float] | None:
    if boxes.velocity_m_s is None or not np.isfinite(boxes.velocity_m_s[row]).all():
        return None
    return float(boxes.velocity_m_s[row, 0]), float(boxes.velocity_m_s[row, 1])


def frame_info(
    frame: Frame, index: int, *, simulated: bool | None = None, extra: dict[str, str] | None = None
) -> FrameInfo:
    """What the page says about a frame."""
    return FrameInfo(
        index=index,
        sequence=frame.sequence,
        frame_id=frame.frame_id,
        time_ns=None if frame.time_ns is None else str(frame.time_ns),
        reference=frame.reference,
        conditions={str(name): str(value) for name, value in frame.conditions.items()},
        world_T_frame=None if frame.world_T_frame is None else matrix(frame.world_T_frame),
        annotated=frame.has_annotation,
        simulated=frame.simulated if frame.simulated is not None else simulated,
        metadata=extra or {},
    )


def class_specs(presets: Sequence[ClassPreset], first: int = 0) -> tuple[ClassSpec, ...]:
    """Classes as the page takes them, with colours that everybody can tell apart and digits that set them.

    Args:
        presets: The classes.
        first: Number of the first one among all that are offered.
    """
    specs = []
    for number, preset in enumerate(presets, first):
        cirrus = cirrus_class(preset.name)
        specs.append(
            ClassSpec(
                name=preset.name,
                title=preset.name.replace("_", " "),
                size=preset.size_m,
                colour=CLASS_COLOURS.get(cirrus, _SPARE_COLOURS[number % len(_SPARE_COLOURS)]),
                key=str(number + 1) if number < 9 else "",
                group=_GROUPS.get(cirrus, "other"),
                types=tuple(TypeSpec(name=kind, size=size_m) for kind, size_m in preset.types.items()),
                source=preset.source,
            )
        )
    return tuple(specs)


def with_others(classes: Sequence[ClassSpec], names: Iterable[str]) -> tuple[ClassSpec, ...]:
    """The classes, and further ones that boxes bear."""
    offered = {spec.name for spec in classes}
    others = [class_preset(name) for name in dict.fromkeys(names) if name not in offered]
    return (*classes, *class_specs(others, len(classes)))
