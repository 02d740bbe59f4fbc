"""What was annotated in a frame: boxes and all that is known of each of them, cut together."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from farfield.errors import DatasetError
from farfield.geometry.arrays import Locked
from farfield.geometry.boxes import Boxes
from farfield.geometry.cameras import Camera
from farfield.geometry.poses import check_rigid, invert, transform_points


@dataclass(frozen=True, eq=False, kw_only=True)
class CameraField:
    """The part of a frame that was annotated, where it is what a camera sees.

    Args:
        camera: The camera with the size of its image; its pose refers to the frame's coordinates.
        name: The camera's name, for messages.

    Raises:
        ValueError: If the size of the image is not known.
    """

    camera: Camera
    name: str

    def __post_init__(self) -> None:
        if self.camera.width_px < 1 or self.camera.height_px < 1:
            raise ValueError(f"CameraField: expected the size of {self.name}'s image, got none")

    def __str__(self) -> str:
        return f"the field of {self.name}"

    def contains(self, points_m: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Whether each point, in the frame's coordinates, lies in the field, shape (n,)."""
        return self.camera.project(points_m)[2]

    def moved(self, target_T_frame: Float[np.ndarray, "4 4"]) -> "CameraField":
        """The field in other coordinates."""
        pose = self.camera.camera_T_lidar @ invert(target_T_frame)
        return replace(self, camera=replace(self.camera, camera_T_lidar=pose))


@dataclass(frozen=True, eq=False, kw_only=True)
class Footprints(Locked):
    """Objects that were annotated from above only: they have no height and are no boxes.

    Args:
        label: Class of each as the data set spells it, length n.
        centre_m: x, y of their centres, shape (n, 2).
        size_m: Length and width, shape (n, 2).
        yaw_rad: Headings, counter-clockwise from +x, shape (n,).
    """

    label: Sequence[str]
    centre_m: Float[np.ndarray, "n 2"]
    size_m: Float[np.ndarray, "n 2"]
    yaw_rad: Float[np.ndarray, " n"]

    def __post_init__(self) -> None:
        self.lock()

    def __len__(self) -> int:
        return len(self.label)

    def transform(self, target_T_source: Float[np.ndarray, "4 4"]) -> "Footprints":
        """Move them rigidly into other coordinates, seen from above: their height is taken as 0."""
        centres = np.column_stack([self.centre_m, np.zeros((len(self), 1))])
        heading = np.column_stack([np.cos(self.yaw_rad), np.sin(self.yaw_rad)]) @ target_T_source[:2, :2].T
        centre_m = transform_points(target_T_source, centres)[:, :2]
        return replace(self, centre_m=centre_m, yaw_rad=np.arctan2(heading[:, 1], heading[:, 0]))


_FARTHEST_M, _LARGEST_M = 1e7, 1e6  # beyond any map; sizes in millimetres stay for the doctor to name


class ImpossibleBoxError(DatasetError):
    """A box of an annotation cannot be: too far away, too large, or without a class."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Annotation(Locked):
    """The annotated boxes of a frame, and what is known of each.

    Args:
        boxes: n boxes in the frame's coordinates.
        visibility: Which sensor sees each box (K-Radar's ``R``, ``L``, ``L1``), length n.
        moving: Whether each moves, shape (n,).
        original_label: Class of each as the data set spells it, length n.
        extent: Whether a box is the whole body (``"full"``) or the part that the sensor sees (``"visible"``).
        full_boxes: The whole bodies of boxes of visible parts, where they are known, n boxes.
        details: Further rows by name, each of length n: ``truncation``, ``occlusion``, ``box_px``...
        unboxed: What was annotated without a box: ``dontcare_px`` (image regions), ``from_above``
            (:class:`Footprints`).
        region: Where was annotated; None for all around.
        version: The annotation's release, where there are several.

    Raises:
        ValueError: If something has another length than the boxes.
        ImpossibleBoxError: If a centre lies beyond 10,000 km, a side is longer than 1,000 km, or a class is empty.
    """

    boxes: Boxes
    visibility: Sequence[str] | None = None
    moving: Bool[np.ndarray, " n"] | None = None
    original_label: Sequence[str] | None = None
    extent: Literal["full", "visible"] = "full"
    full_boxes: Boxes | None = None
    details: Mapping[str, Shaped[np.ndarray, "n ..."]] = field(default_factory=dict)
    unboxed: Mapping[str, Any] = field(default_factory=dict)
    region: CameraField | None = None
    version: str = ""

    def __repr__(self) -> str:
        return f"Annotation{str(self.boxes).removeprefix('Boxes')}"

    def __post_init__(self) -> None:
        for name, rows in self._rows().items():
            if rows is not None and len(rows) != len(self.boxes):
                raise ValueError(f"Annotation.{name}: expected {len(self.boxes)} rows, one a box, got {len(rows)}")
        self._check_possible()
        self.lock()

    def _check_possible(self) -> None:
        limits = {"centres": (self.boxes.centre_m, _FARTHEST_M), "sizes": (self.boxes.size_m, _LARGEST_M)}
        for name, (values, most) in limits.items():
            beyond = (np.abs(values) > most).any(axis=1)
            if beyond.any():
                row = int(np.argmax(beyond))
                raise ImpossibleBoxError(
                    f"annotation, box {row}: expected {name} within {most:g} metres, got {values[row].tolist()}. Mend "
                    "or remove the box in the label file."
                )
        for labels in (self.boxes.label, self.original_label):
            row = next((row for row, word in enumerate(() if labels is None else labels) if not str(word).strip()), -1)
            if row >= 0:
                raise ImpossibleBoxError(
                    f"annotation, box {row}: expected a class, got none. Name it in the label file."
                )

    def _rows(self) -> dict[str, Any]:
        named = ("visibility", "moving", "original_label", "full_boxes")
        return {name: getattr(self, name) for name in named} | dict(self.details)

    def __len__(self) -> int:
        return len(self.boxes)

    def __getitem__(self, rows: slice | Bool[np.ndarray, " n"] | Int[np.ndarray, " k"] | Sequence[int]) -> "Annotation":
        """Some of the boxes with all that is known of them: by slice, mask or indices."""
        if not isinstance(rows, slice):
            rows = np.asarray(rows)
            rows = rows.astype(np.intp) if rows.size == 0 and rows.dtype != bool else rows
        index = np.arange(len(self))[rows]
        return replace(
            self,
            boxes=self.boxes[index],
            visibility=None if self.visibility is None else tuple(self.visibility[i] for i in index),
            moving=None if self.moving is None else self.moving[index],
            original_label=None if self.original_label is None else tuple(self.original_label[i] for i in index),
            full_boxes=None if self.full_boxes is None else self.full_boxes[index],
            details={name: values[index] for name, values in self.details.items()},
        )

    def replaced(self, boxes: Boxes) -> "Annotation":
        """The same with other values of the same boxes, such as another count of points."""
        return replace(self, boxes=boxes)

    def moved(self, target_T_frame: Float[np.ndarray, "4 4"]) -> "Annotation":
        """The annotation in other coordinates: boxes, full boxes, footprints and the annotated region.

        Raises:
            ConfigError: If it is no rigid motion.
        """
        check_rigid(target_T_frame, "Annotation.moved")
        unboxed = {
            name: value.transform(target_T_frame) if isinstance(value, Boxes | Footprints) else value
            for name, value in self.unboxed.items()
        }
        return replace(
            self,
            boxes=self.boxes.transform(target_T_frame),
            full_boxes=None if self.full_boxes is None else self.full_boxes.transform(target_T_frame),
            unboxed=unboxed,
            region=None if self.region is None else self.region.moved(target_T_frame),
        )
