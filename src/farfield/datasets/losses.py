"""What a conversion loses: what the files of its target hold, compared with what the frames of the source say.

A writer's :class:`Capacity` stands beside it; tests read what it wrote again and compare.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from farfield.frame import Annotation, Boxes, Frame
from farfield.vocabulary.classes import normalised_class

ITEMS: Mapping[str, str] = {
    "clouds": "clouds",
    "columns": "further columns of points",
    "radar": "radar products",
    "images": "camera images",
    "cameras": "calibrations of cameras",
    "distortion": "lens distortion",
    "times": "times of frames",
    "sensor times": "times of single sensors",
    "poses": "poses of the car",
    "conditions": "weather and other conditions",
    "mounting": "places of sensors",
    "names": "names of drives and frames",
    "tracks": "tracks",
    "velocities": "velocities of boxes",
    "scores": "scores of boxes",
    "point counts": "counts of points in boxes",
    "classes": "classes",
    "original classes": "classes as the source spells them",
    "attributes": "attributes of boxes",
    "visibility": "which sensor sees a box",
    "moving": "which boxes move",
    "extent": "what a box encloses",
    "other boxes": "boxes of the whole bodies beside those of the visible parts",
    "visible boxes": "boxes of the visible parts",
    "unboxed": "what was annotated without a box",
    "region": "where was annotated",
    "empty frames": "frames that were annotated and have no box",
    "rounding": "digits of coordinates",
    "pixels": "exact pixels",
}
"""What a frame may say that a target may not hold, in words; the order in which losses are said."""

Pictures = Literal["none", "first", "front", "calibrated"]
"""Which images and calibrations are written: those of the front camera, else the first image; those of the front camera
alone, see :attr:`farfield.frame.Frame.front_camera`; every image of a calibrated camera with it."""


@dataclass(frozen=True, kw_only=True)
class Capacity:
    """What the files of a target hold.

    Args:
        title: What they are, in the middle of a sentence: ``"KITTI's folders"``.
        words: What `farfield convert --to` takes for it; empty: the target's own name.
        read_by: Name of the format that reads what is written; empty: files of labels, or a store.
        holds: Those of :data:`ITEMS` that are held whole.
        one_cloud: Whether the chosen cloud is written; else none is.
        together: Clouds that are written together where none is chosen and the first of them is there.
        chosen: Names the clouds of a frame that are written, whatever the choice; None: as the other two say.
        columns: Further columns of points that are held.
        columns_if: Whether a frame's cloud of a name has a column so that it is held, by column: where all its points
            must be alike, for example.
        pictures: Which images and calibrations are written.
        attributes: Names of the annotation's details that are held.
        any_attributes: Whether all details are held that are a text, a number or a flag of each box.
        spelled: How a class is spelled in the files.
        originals: Classes as sources spell them that are kept so.
        aliases: What a spelled class is when it is read again; None: as it is spelled.
        extent: What boxes are taken to enclose when they are read again.
        field_of_camera: Whether labels are taken for those of the camera's field.
        file_names: What a drive's or frame's name becomes; None: they are numbered anew.
        frame_names: Whether frames keep their names, and only drives become files.
        annotated_only: Items that stand in the label file, so that a frame without one loses them.
        rounding: To what points are rounded, in words; empty: nothing is.
        jpeg: Whether pictures are written as JPEG.
        reasons: Why an item is lost, or what stands for it, by item; without one "none there".
    """

    title: str
    words: str = ""
    read_by: str = ""
    holds: frozenset[str] = frozenset()
    one_cloud: bool = True
    together: tuple[str, ...] = ()
    chosen: Callable[[Frame], tuple[str, ...]] | None = None
    columns: frozenset[str] = frozenset()
    columns_if: Mapping[str, Callable[[Frame, str], bool]] | None = None
    pictures: Pictures = "none"
    attributes: frozenset[str] = frozenset()
    any_attributes: bool = False
    spelled: Callable[[str], str] = str
    originals: frozenset[str] = frozenset()
    aliases: Mapping[str, str] | None = None
    extent: Literal["full", "visible"] = "full"
    field_of_camera: bool = False
    file_names: Callable[[str], str] | None = str
    frame_names: bool = False
    annotated_only: frozenset[str] = frozenset()
    rounding: str = ""
    jpeg: bool = False
    reasons: Mapping[str, str] | None = None

    def has_column(self, frame: Frame, cloud: str, column: str) -> bool:
        """Whether a column of a frame's cloud is held."""
        condition = (self.columns_if or {}).get(column)
        return column in self.columns if condition is None else condition(frame, cloud)

    def reread(self, label: str) -> str:
        """What a class is when the files are read again."""
        spelled = self.spelled(label)
        return spelled if self.aliases is None else normalised_class(spelled, self.aliases)


@dataclass(frozen=True, kw_only=True)
class Loss:
    """What a conversion loses; as text one line.

    Args:
        item: One of :data:`ITEMS`.
        title: What does not hold it.
        names: Which: names of clouds, columns, cameras...; empty where the item has no names.
        reason: Why, or what stands for it.
    """

    item: str
    title: str
    names: tuple[str, ...] = ()
    reason: str = ""

    def __str__(self) -> str:
        names = f" ({', '.join(self.names[:_SHOWN])}{', ...' if len(self.names) > _SHOWN else ''})"
        what = f"{ITEMS.get(self.item, self.item)}{names if self.names else ''}"
        return f"not in {self.title}: {what}{'; ' if self.reason else ''}{self.reason}"


_SHOWN = 8
Named = dict[str, tuple[str, ...]]


def frame_losses(
    frame: Frame,
    capacity: Capacity,
    *,
    cloud: str | None = None,
    boxes: str = "boxes",
    time_ns: int | None = None,
) -> Named:
    """What of a frame is lost, by item, with names.

    Args:
        frame: The frame; its clouds' columns are looked at, so that the clouds that are written are read.
        capacity: What the target holds.
        cloud: Which cloud is written; None takes the first.
        boxes: ``"boxes"``, or ``"full_boxes"`` of its annotation.
        time_ns: The time that is written; None: the frame's own.
    """
    written = _written_clouds(frame, capacity, cloud)
    lost: dict[str, Any] = {
        "clouds": [name for name in frame.clouds if name not in written],
        "columns": [
            column
            for name in written
            for column in frame.clouds[name].extra
            if not capacity.has_column(frame, name, column)
        ],
        "radar": list(frame.radar),
        "times": _some(frame.time_ns is not None),
        "sensor times": _sensor_times(frame, capacity),
        "poses": _some(frame.world_T_frame is not None),
        "conditions": list(frame.conditions),
        "mounting": _mounting(frame),
        "names": _names(frame, capacity),
        **_pictures(frame, capacity),
    }
    if frame.annotation is not None:
        lost |= _of_annotation(frame.annotation, frame.annotation.full_boxes, capacity, boxes)
    held = capacity.holds if frame.has_annotation else capacity.holds - capacity.annotated_only
    held = held - {"times"} if time_ns not in (None, frame.time_ns) else held
    unique = {item: tuple(dict.fromkeys(lost[item])) for item in ITEMS if lost.get(item) and item not in held}
    if capacity.rounding and written:
        unique["rounding"] = ("",)
    if capacity.jpeg and len(frame.images) > len(unique.get("images", ())):
        unique["pixels"] = ("",)
    return unique


def _written_clouds(frame: Frame, capacity: Capacity, cloud: str | None) -> tuple[str, ...]:
    if not capacity.one_cloud:
        return ()
    if capacity.chosen is not None:
        return capacity.chosen(frame)
    if cloud is None and capacity.together and capacity.together[0] in frame.clouds:
        return tuple(name for name in capacity.together if name in frame.clouds)
    chosen = cloud if cloud is not None else next(iter(frame.clouds), None)
    return (chosen,) if chosen is not None and chosen in frame.clouds else ()


def _names(frame: Frame, capacity: Capacity) -> list[str]:
    if capacity.file_names is None:
        return [""]
    names = frame.key[:1] if capacity.frame_names else frame.key
    return [name for name in names if capacity.file_names(name) != name]


def _sensor_times(frame: Frame, capacity: Capacity) -> list[str]:
    own_times = (*capacity.together, "camera") if "times" in capacity.holds else ()
    return [
        name
        for name, sensor in frame.sensors.items()
        if sensor.time_ns is not None and sensor.time_ns != frame.time_ns and name not in own_times
    ]


def _mounting(frame: Frame) -> list[str]:
    """Sensors whose place is known and is not the origin; those of calibrated cameras stand in their calibration."""
    return [
        name
        for name, sensor in frame.sensors.items()
        if sensor.frame_T_sensor is not None
        and name not in frame.cameras
        and not np.array_equal(sensor.frame_T_sensor, np.eye(4))
    ]


def _pictures(frame: Frame, capacity: Capacity) -> dict[str, list[str]]:
    both = [name for name in frame.cameras if name in frame.images]
    if capacity.pictures == "first":
        images = [frame.front_camera] if frame.front_camera in both else list(frame.images)[:1]
        cameras = [name for name in images if name in frame.cameras]
    elif capacity.pictures == "front":
        cameras = [] if frame.front_camera is None else [frame.front_camera]
        images = [name for name in cameras if name in frame.images]
    else:
        images = cameras = both if capacity.pictures == "calibrated" else []
    return {
        "images": [name for name in frame.images if name not in images],
        "cameras": [name for name in frame.cameras if name not in cameras],
        "distortion": [name for name in cameras if np.any(frame.cameras[name].distortion)],
    }


def _of_annotation(
    annotation: Annotation, full_boxes: Boxes | None, capacity: Capacity, source: str
) -> dict[str, list[str]]:
    whole = source == "full_boxes" and full_boxes is not None
    boxes = full_boxes if whole and full_boxes is not None else annotation.boxes
    labels = np.asarray(boxes.label).tolist()
    original = labels if annotation.original_label is None else list(map(str, annotation.original_label))
    extent = "full" if whole else annotation.extent
    field = "all around" if annotation.region is None else str(annotation.region)
    return {
        "tracks": _some(boxes.track_id is not None and (boxes.track_id >= 0).any()),
        "velocities": _some(boxes.velocity_m_s is not None and np.isfinite(boxes.velocity_m_s).all(axis=1).any()),
        "scores": _some(boxes.score is not None and len(boxes)),
        "point counts": _some(boxes.point_count is not None and (boxes.point_count >= 0).any()),
        "classes": [label for label in dict.fromkeys(labels) if capacity.reread(label) != label],
        "original classes": [
            spelled
            for label, spelled in zip(labels, original, strict=True)
            if spelled not in (label, capacity.spelled(label), *capacity.originals)
        ],
        "attributes": [name for name in annotation.details if name not in _attributes(annotation, capacity)],
        "visibility": _some(annotation.visibility is not None and len(boxes)),
        "moving": _some(annotation.moving is not None and len(boxes)),
        "extent": [f"{extent}, read again as {capacity.extent}"] if extent != capacity.extent and len(boxes) else [],
        "other boxes": _some(len(boxes) and full_boxes is not None and not whole),
        "visible boxes": _some(len(boxes) and whole),
        "unboxed": [name for name, rows in annotation.unboxed.items() if len(rows)],
        "region": [field] if (annotation.region is not None) != capacity.field_of_camera else [],
        "empty frames": _some(not len(boxes)),
    }


def _attributes(annotation: Annotation, capacity: Capacity) -> frozenset[str]:
    """Names of the details that are held."""
    return capacity.attributes | (frozenset(plain_details(annotation)) if capacity.any_attributes else frozenset())


def plain_details(annotation: Annotation) -> dict[str, list[Any]]:
    """The details of an annotation that are a text, a number or a flag of each box."""
    columns = {name: np.asarray(values) for name, values in annotation.details.items()}
    return {
        name: column.tolist() for name, column in columns.items() if column.ndim == 1 and column.dtype.kind in "biufU"
    }


def _some(there: Any) -> list[str]:
    """One nameless entry where something is there."""
    return [""] if there else []


def named_losses(lost: list[Named], capacity: Capacity) -> tuple[Loss, ...]:
    """The losses of some frames together, in the order of :data:`ITEMS`.

    Args:
        lost: What :func:`frame_losses` gave for each.
        capacity: What the target holds.
    """
    reasons = {"rounding": capacity.rounding, "pixels": "pictures are written as JPEG", **(capacity.reasons or {})}
    names = {item: dict.fromkeys(name for frame in lost for name in frame.get(item, ()) if name) for item in ITEMS}
    return tuple(
        Loss(item=item, title=capacity.title, names=tuple(names[item]), reason=reasons.get(item, ""))
        for item in ITEMS
        if any(item in frame for frame in lost)
    )
