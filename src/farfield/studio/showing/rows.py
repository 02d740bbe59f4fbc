"""Boxes as rows for the page, and rows as boxes for everything that computes."""

from collections.abc import Iterable, Sequence
from typing import Any, Literal

import numpy as np
from jaxtyping import Int

from farfield.errors import ConfigError
from farfield.frame import Annotation, Boxes, Frame
from farfield.geometry.boxes import BOX_MARGIN_M
from farfield.geometry.boxes import count_points_in_boxes
from farfield.studio.messages.rows import BoxRow
from farfield.studio.messages.rows import ClassSpec
from farfield.studio.messages.rows import FrameInfo
from farfield.studio.messages.rows import PredictedRow
from farfield.studio.messages.rows import TypeSpec
from farfield.studio.showing.layers import matrix
from farfield.vocabulary.classes import (
    CIRRUS_CLASSES,
    CIRRUS_FROM_ANY_KRADAR,
    CIRRUS_FROM_ARGOVERSE2,
    CIRRUS_FROM_KITTI,
    CIRRUS_FROM_KRADAR,
    CIRRUS_FROM_VIEW_OF_DELFT,
    CLASS_COLOURS,
    KRADAR_FROM_CIRRUS,
)
from farfield.vocabulary.sizes import CIRRUS_SIZES_M, SMALL_KINDS, VEHICLE_KINDS


def numbers(boxes: Boxes, row: int) -> Any:
    """Centre, size and yaw of one box."""
    values = (*boxes.centre_m[row], *boxes.size_m[row], boxes.yaw_rad[row])
    return tuple(float(value) for value in values)


def annotated_rows(annotation: Annotation, frame: Frame | None = None) -> tuple[BoxRow, ...]:
    """What was annotated, as rows whose identity is their place in the frame.

    Args:
        annotation: The annotation.
        frame: Where points are counted; without it those of the annotation stand.
    """
    boxes = annotation.boxes
    lidar, radar = (None, None) if frame is None else (counted(frame, boxes, "lidar"), counted(frame, boxes, "radar"))
    lidar = boxes.point_count if lidar is None else lidar
    seen = annotation.visibility
    return tuple(
        BoxRow(
            id=str(row),
            track=None if boxes.track_id is None or boxes.track_id[row] < 0 else int(boxes.track_id[row]),
            class_name=str(boxes.label[row]),
            box=numbers(boxes, row),
            version=0,
            state="accepted",
            source="lidar",
            attributes=_attributes(annotation, row),
            points=None if lidar is None or lidar[row] < 0 else int(lidar[row]),
            radar_points=None if radar is None else int(radar[row]),
            distance_m=float(boxes.range_m[row]),
            visibility=None if seen is None else str(seen[row]),
            moving=None if annotation.moving is None else bool(annotation.moving[row]),
        )
        for row in range(len(boxes))
    )


def _attributes(annotation: Annotation, row: int) -> dict[str, str | int | float | bool | None]:
    known: dict[str, Any] = {}
    if annotation.original_label is not None:
        known["original_label"] = str(annotation.original_label[row])
    for name, rows in annotation.details.items():
        value = np.asarray(rows)[row]
        if value.ndim == 0:
            plain = value.item()
            known[name] = plain if not isinstance(plain, float) or np.isfinite(plain) else None
    return known


def counted(frame: Frame, boxes: Boxes, kind: str) -> Int[np.ndarray, " n"] | None:
    """Points of the first cloud of a kind inside each box; None where the frame has no such cloud in its axes."""
    for name in frame.clouds:
        sensor = frame.sensors.get(name)
        if (kind == "lidar") if sensor is None else (sensor.kind == kind and sensor.in_frame):
            return np.asarray(count_points_in_boxes(frame.cloud(name).points_m, boxes, margin_m=BOX_MARGIN_M))
    return None


def boxes_of(rows: Sequence[BoxRow]) -> Boxes:
    """Rows as boxes with classes in Cirrus's words, in their order; a size that is not positive becomes 1 mm."""
    if not rows:
        return Boxes.empty()
    values = np.array([row.box for row in rows], dtype=np.float64)
    return Boxes(
        centre_m=values[:, :3],
        size_m=np.maximum(values[:, 3:6], 1e-3),
        yaw_rad=values[:, 6],
        label=[our_class(row.class_name) for row in rows],
        track_id=np.array([-1 if row.track is None else row.track for row in rows], dtype=np.int64),
    )


def predicted_rows(boxes: Boxes) -> list[PredictedRow]:
    """Predicted boxes as rows, not yet matched, the highest score first."""
    order = range(len(boxes)) if boxes.score is None else np.argsort(-boxes.score, kind="stable")
    return [
        PredictedRow(
            class_name=str(boxes.label[row]),
            box=numbers(boxes, row),
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


# The classes that can be set, with preset sizes and colours that everybody can tell apart.

Group = Literal["vehicle", "person", "two_wheeler", "other"]
Size = tuple[float, float, float]
_SPARE = tuple(CLASS_COLOURS.values())
_TYPES = ("van", "box truck", "bus")
_GROUPS: dict[str, Group] = {
    "vehicle": "vehicle",
    "large_vehicle": "vehicle",
    "trailer": "vehicle",
    "pedestrian": "person",
    "wheeled_pedestrian": "person",
    "bicycle": "two_wheeler",
    "motorcycle": "two_wheeler",
}
_SPELLINGS = CIRRUS_FROM_ARGOVERSE2 | CIRRUS_FROM_VIEW_OF_DELFT | CIRRUS_FROM_KITTI | CIRRUS_FROM_ANY_KRADAR
_OWN_WORDS = {"kradar": CIRRUS_FROM_KRADAR, "kitti": CIRRUS_FROM_KITTI}


def our_class(name: str) -> str:
    """A class in Cirrus's words, whichever data set spells it; a name that none has stays as it is.

    >>> our_class("Sedan"), our_class("Car"), our_class("vehicle"), our_class("tank")
    ('vehicle', 'vehicle', 'vehicle', 'tank')
    """
    return name if name in CIRRUS_CLASSES else _SPELLINGS.get(name, name)


def shown_classes(format_name: str, given: Sequence[str] = ()) -> tuple[ClassSpec, ...]:
    """The classes of a data set that is looked at, in Cirrus's words.

    Args:
        format_name: Its format; K-Radar's own sizes differ from Cirrus'.
        given: ``name:length,width,height`` of classes to offer instead.

    Raises:
        ConfigError: If one of those given is not of this form.
    """
    if given:
        return tuple(_given(text, place) for place, text in enumerate(given))
    names = enumerate(CIRRUS_SIZES_M)
    return tuple(_spec(name, _kradar_size(name) if format_name == "kradar" else None, place) for place, name in names)


def annotated_classes(format_name: str, given: Sequence[str] = ()) -> tuple[ClassSpec, ...]:
    """The classes of a data set that is annotated, as its label files spell them; arguments as above."""
    own = _OWN_WORDS.get(format_name)
    if given or own is None:
        return shown_classes(format_name, given)
    return tuple(_spec(name, None, place) for place, name in enumerate(own))


def with_others(classes: Sequence[ClassSpec], names: Iterable[str]) -> tuple[ClassSpec, ...]:
    """The classes, and further ones that boxes bear."""
    known = {spec.name for spec in classes}
    more = [name for name in dict.fromkeys(names) if name not in known]
    return (*classes, *(_spec(name, None, len(classes) + place) for place, name in enumerate(more)))


def spec_of(name: str, size: Size, types: dict[str, Size], place: int) -> ClassSpec:
    """A class as the page takes it."""
    return _spec(name, size, place, types)


def preset_size(name: str) -> Size:
    """Usual size of a class or of a type of vehicle; a car's for a name that nobody knows."""
    known = VEHICLE_KINDS.get(name) or SMALL_KINDS.get(name)
    return known or CIRRUS_SIZES_M.get(our_class(name), CIRRUS_SIZES_M["vehicle"])


def _kradar_size(name: str) -> Size:
    return preset_size(name if name == "trailer" else KRADAR_FROM_CIRRUS.get(name, name))


def _spec(name: str, size: Size | None, place: int, types: dict[str, Size] | None = None) -> ClassSpec:
    ours = our_class(name)
    if types is None:
        types = {kind: VEHICLE_KINDS[kind] for kind in _TYPES} if ours == "large_vehicle" else {}
    return ClassSpec(
        name=name,
        title=name.replace("_", " "),
        size=size or preset_size(name),
        colour=CLASS_COLOURS.get(ours, _SPARE[place % len(_SPARE)]),
        key=str(place + 1) if place < 9 else "",
        group=_GROUPS.get(ours, "other"),
        types=tuple(TypeSpec(name=kind, size=each) for kind, each in types.items()),
    )


def _given(text: str, place: int) -> ClassSpec:
    name, _, words = text.partition(":")
    try:
        length, width, height = (float(word) for word in words.split(","))
    except ValueError:
        raise ConfigError(f"classes: expected name:length,width,height in metres, got {text!r}") from None
    if not name or not all(0 < value <= 60 for value in (length, width, height)):
        raise ConfigError(f"classes: expected a name and sizes up to 60 m, got {text!r}")
    return _spec(name, (length, width, height), place, {})
