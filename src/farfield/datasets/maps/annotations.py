"""Maps of what is annotated: labels at another sweep's time, whole bodies, and clouds cut to where was annotated."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict

from farfield.datasets.frame_maps import Earlier
from farfield.errors import DatasetError
from farfield.frame import Annotation, Boxes, Cloud, Frame, Lazy
from farfield.geometry.poses import invert, transform_points

SPAN_S = 0.6
"""Velocities are taken over so long a time, or over one interval of frames that are farther apart."""
MOST_BEFORE = 6
LONGEST_GAP_S = 1.2
"""Of a box that was seen last before a longer time, the velocity is not known."""
FASTEST_M_S = 80.0
"""Two boxes of one identity that are farther apart than this speed allows are not one road user's."""


class LabelsAtSettings(BaseModel):
    """Settings of :class:`LabelsAt`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    cloud: str


@dataclass(frozen=True)
class LabelsAt:
    """Each box where its road user was when a cloud was measured, not when the annotated one was.

    Cirrus' boxes belong to the Gaussian sweep; the uniform one is taken up to 0.1 s later, in which fast traffic goes
    3 m. A box moves by its velocity over ground: its own where the data tell it, else that of its identity over the
    frames before (places in the world by the frames' poses, a straight line through those of the last 0.6 s: boxes of
    visible parts jump from frame to frame). Boxes whose velocity neither tells stay: those of a drive's first frame,
    and such as come into view. Headings and sizes stay. The cloud must stand in the frame's coordinates. With such
    labels train and score on that cloud alone.

    Args:
        cloud: Name of the cloud, such as "uniform"; frames without it, or without its time, keep their labels.

    Raises:
        DatasetError: If the boxes have neither velocities nor identities with poses, when the annotation is read.
    """

    name: ClassVar[str] = "labels_at"
    Settings: ClassVar[type[BaseModel]] = LabelsAtSettings
    frames_before: ClassVar[int] = MOST_BEFORE
    cloud: str

    def settings(self) -> Mapping[str, Any]:
        """The cloud."""
        return {"cloud": self.cloud}

    def fits(self, dataset: Any) -> bool:
        """Whether the data set's labels may belong to another of its clouds."""
        return "labels_at" in dataset.view_options

    def moved_poses(self, world_T_frame: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 4 4"]:
        """The poses as they are."""
        return world_T_frame

    def __call__(self, frame: Frame, earlier: Earlier) -> Frame:
        """The frame with its labels at the cloud's time."""
        if self.cloud not in frame.clouds or frame.time_ns is None or not frame.has_annotation:
            return frame
        later_ns = (frame.time_ns_of(self.cloud) or frame.time_ns) - frame.time_ns
        if later_ns == 0:
            return frame
        return replace(frame, load_annotation=ShiftedAnnotation(frame, _recent(frame.time_ns, earlier), later_ns / 1e9))


def _recent(time_ns: int, earlier: Earlier) -> tuple[Frame, ...]:
    """The frame before, where it is near enough, and those before it within the span."""
    frames: list[Frame] = []
    for k in range(1, MOST_BEFORE + 1):
        frame = earlier(k)
        longest_s = SPAN_S if frames else LONGEST_GAP_S
        if frame is None or frame.time_ns is None or not 0 < (time_ns - frame.time_ns) / 1e9 <= longest_s:
            break
        frames.append(frame)
    return tuple(frames)


@dataclass(frozen=True, eq=False)
class ShiftedAnnotation:
    """Loads the annotation of a frame some time later.

    Args:
        frame: The frame as it was annotated.
        before: Those before it in its drive, the youngest first.
        later_s: How much later.
    """

    frame: Frame
    before: Sequence[Frame]
    later_s: float

    def __call__(self) -> Annotation:
        """The annotation, boxes and whole bodies moved."""
        annotation = self.frame.annotation or Annotation(boxes=Boxes.empty())
        if not len(annotation.boxes):
            return annotation
        velocity = velocities(annotation.boxes, self.frame, self.before)
        step = np.nan_to_num(velocity) * self.later_s
        full = annotation.full_boxes
        return replace(
            annotation,
            boxes=_moved(annotation.boxes, step),
            full_boxes=None if full is None else _moved(full, step),
        )


def _moved(boxes: Boxes, step_m: Float[np.ndarray, "n 3"]) -> Boxes:
    return boxes.replace(centre_m=boxes.centre_m + step_m)


def velocities(boxes: Boxes, frame: Frame, before: Sequence[Frame]) -> Float[np.ndarray, "n 3"]:
    """Velocities over ground in the frame's coordinates, NaN where they are not known, shape (n, 3).

    Args:
        boxes: The frame's boxes.
        frame: The frame.
        before: Frames before it.

    Raises:
        DatasetError: If the boxes tell no velocity, and there are no identities or poses to find it by.
    """
    if boxes.velocity_m_s is not None and np.isfinite(boxes.velocity_m_s).any():
        zeros = np.zeros((len(boxes), 3 - boxes.velocity_m_s.shape[1]))
        return np.concatenate([boxes.velocity_m_s, zeros], axis=1)
    annotated = [other for other in before if other.has_annotation]
    for other in annotated:
        _check(boxes, frame, other)
    tracks = [-1] * len(boxes) if boxes.track_id is None else boxes.track_id.tolist()
    observations = [_seen(frame, other) for other in annotated]
    return np.array([_velocity(tracks[row], boxes.centre_m[row], observations) for row in range(len(boxes))]).reshape(
        -1, 3
    )


Seen = tuple[float, dict[int, Float[np.ndarray, " 3"]]]
"""How many seconds ago a frame was taken, and where each identity stood then, in the present coordinates."""


def _seen(frame: Frame, before: Frame) -> Seen:
    then = before.annotation
    if then is None or then.boxes.track_id is None:
        return 0.0, {}
    assert frame.time_ns is not None
    assert before.time_ns is not None
    assert frame.world_T_frame is not None
    assert before.world_T_frame is not None
    centres_m = transform_points(invert(frame.world_T_frame) @ before.world_T_frame, then.boxes.centre_m)
    rows = {int(track): centres_m[row] for row, track in enumerate(then.boxes.track_id) if track >= 0}
    return (frame.time_ns - before.time_ns) / 1e9, rows


def _velocity(track: int, centre_m: Float[np.ndarray, " 3"], observations: Sequence[Seen]) -> Float[np.ndarray, " 3"]:
    """Slope of the straight line through an identity's places; NaN where there is one place only, or it jumps."""
    pairs = [(0.0, centre_m), *((-ago_s, centres[track]) for ago_s, centres in observations if track in centres)]
    if len(pairs) < 2:
        return np.full(3, np.nan)
    time_s, centre = np.array([pair[0] for pair in pairs]), np.array([pair[1] for pair in pairs])
    time_s = time_s - time_s.mean()
    velocity = time_s @ (centre - centre.mean(axis=0)) / (time_s @ time_s)
    return np.asarray(velocity if np.linalg.norm(velocity) <= FASTEST_M_S else np.full(3, np.nan))


def _check(boxes: Boxes, frame: Frame, before: Frame) -> None:
    missing = "identities (track_id)" if boxes.track_id is None else ""
    missing = missing or ("poses" if frame.world_T_frame is None or before.world_T_frame is None else "")
    if missing:
        raise DatasetError(
            f"Labels at another sweep's time need the velocities of boxes, or identities and the frames' poses; frame "
            f"{frame.key} has boxes without velocities and no {missing}. Leave labels_at out, or track the boxes first "
            "(farfield track)."
        )


# Boxes of whole bodies where a data set's own boxes show the visible parts.


class WholeBodiesSettings(BaseModel):
    """Settings of :class:`WholeBodies`: none."""

    model_config = ConfigDict(extra="forbid", frozen=True)


@dataclass(frozen=True)
class WholeBodies:
    """Every box holds the whole body of its object, not the part that the sensor sees.

    Cirrus' annotators drew boxes round what the cloud shows; other data sets' boxes are whole bodies. Simulated frames
    know both. Annotations that are whole bodies already stay as they are.

    Raises:
        DatasetError: If boxes show visible parts and nothing tells the bodies, when the annotation is read.
    """

    name: ClassVar[str] = "whole_bodies"
    Settings: ClassVar[type[BaseModel]] = WholeBodiesSettings

    def settings(self) -> Mapping[str, Any]:
        """None."""
        return {}

    def fits(self, dataset: Any) -> bool:
        """Whether the data set's first annotated objects tell their bodies."""
        if "whole_bodies" not in dataset.view_options:
            return False
        annotated = (dataset.annotation(index) for index in range(len(dataset)) if dataset.has_annotation(index))
        first = next((annotation for annotation in annotated if annotation is not None and len(annotation)), None)
        return first is not None and first.full_boxes is not None

    def moved_poses(self, world_T_frame: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 4 4"]:
        """The poses as they are."""
        return world_T_frame

    def __call__(self, frame: Frame, earlier: Earlier) -> Frame:
        """The frame with its annotation's bodies in the place of the visible parts."""
        del earlier
        return replace(frame, load_annotation=WholeAnnotation(frame)) if frame.has_annotation else frame


@dataclass(frozen=True, eq=False)
class WholeAnnotation:
    """Loads the annotation of a frame as whole bodies.

    Args:
        frame: The frame as it was annotated.
    """

    frame: Frame

    def __call__(self) -> Annotation:
        """The annotation; counts of points stay."""
        annotation = self.frame.annotation or Annotation(boxes=Boxes.empty())
        if annotation.extent == "full":
            return annotation
        bodies = annotation.full_boxes if len(annotation) else annotation.boxes
        if bodies is None:
            raise DatasetError(
                f"whole_bodies: expected frame {self.frame.key} to tell the whole bodies of its objects, as simulated "
                "frames do; its boxes show the part that the sensor sees, and nothing more is known. Leave "
                "whole_bodies out."
            )
        return replace(annotation, boxes=bodies, extent="full", full_boxes=None)


# Clouds cut to the part of the frame that was annotated.


class AnnotatedFieldSettings(BaseModel):
    """Settings of :class:`AnnotatedField`: none."""

    model_config = ConfigDict(extra="forbid", frozen=True)


@dataclass(frozen=True)
class AnnotatedField:
    """Clouds hold only the points where was annotated: who learns from the labels must not take the rest for empty.

    KITTI's sweeps turn all around and its labels end where the camera's picture does. Frames that were annotated all
    around stay as they are.
    """

    name: ClassVar[str] = "annotated_field"
    Settings: ClassVar[type[BaseModel]] = AnnotatedFieldSettings
    keeps_annotation: ClassVar[bool] = True

    def settings(self) -> Mapping[str, Any]:
        """None."""
        return {}

    def moved_poses(self, world_T_frame: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 4 4"]:
        """The poses as they are."""
        return world_T_frame

    def __call__(self, frame: Frame, earlier: Earlier) -> Frame:
        """The frame with its clouds cut."""
        del earlier
        return replace(frame, clouds=Lazy({name: partial(_cut_to_field, frame, name) for name in frame.clouds}))


def _cut_to_field(frame: Frame, name: str) -> Cloud:
    cloud, annotation = frame.cloud(name), frame.annotation
    if annotation is None or annotation.region is None:
        return cloud
    return cloud[annotation.region.contains(cloud.points_m.astype(np.float64))]
