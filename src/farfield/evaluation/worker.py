"""Detecting in one frame as a unit of work, and what it gives."""

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Int

from farfield.datasets.base import Dataset
from farfield.evaluation.views import Frames, motion
from farfield.frame import Annotation, Boxes, Cloud, Frame
from farfield.frame.provenance import environment
from farfield.geometry.points import BOX_MARGIN_M, count_points_in_boxes
from farfield.jobs import Unit, UnitResult

if TYPE_CHECKING:
    from farfield.detectors.runtime import Detector

AnyDetector = Callable[[Frame | Cloud], Boxes]
_BYTES = 1_500_000_000  # that a process with torch and a detector's feature maps takes


@dataclass(frozen=True, eq=False)
class FrameDetections:
    """What was found in a frame.

    Args:
        boxes: Scored boxes.
        point_count: Points of the cloud in each annotated box; None without annotation or cloud.
    """

    boxes: Boxes
    point_count: Int[np.ndarray, " n"] | None = None

    def to_json(self) -> dict[str, Any]:
        """The same as JSON takes it, to the last digit."""
        boxes = {each.name: getattr(self.boxes, each.name) for each in fields(Boxes)}
        lists = {name: values.tolist() for name, values in boxes.items() if values is not None}
        return {"boxes": lists, "point_count": None if self.point_count is None else self.point_count.tolist()}

    @classmethod
    def from_json(cls, given: Mapping[str, Any]) -> "FrameDetections":
        """Read what :meth:`to_json` gave."""
        rows = {name: np.array(values) for name, values in given["boxes"].items()}
        if not len(rows["yaw_rad"]):
            return cls(Boxes.empty(scored="score" in rows), _counts(given))
        return cls(Boxes(**rows), _counts(given))


def _counts(given: Mapping[str, Any]) -> Int[np.ndarray, " n"] | None:
    count = given["point_count"]
    return None if count is None else np.array(count, dtype=np.int64)


@dataclass(frozen=True, kw_only=True)
class DetectTask:
    """Detects in one frame, whose index is the unit's parameters; gives ``FrameDetections`` (None: not annotated).

    Args:
        detector: What detects.
        seen: The frames, as the detector sees them.
        cloud: The cloud that it reads, whose points in the annotated boxes are counted.
        annotated_only: Leave out frames without annotation.
        own: The frames in whose coordinates the boxes are given; those of ``seen`` if None.
        packed: Give the value as JSON takes it.
    """

    detector: "Detector | AnyDetector"
    seen: Frames
    cloud: str | None
    annotated_only: bool = False
    own: Frames | None = None
    packed: bool = False
    memory_bytes = _BYTES

    def __call__(self, unit: Unit) -> UnitResult:
        """Detect in a frame; the clock says how many milliseconds it took from points to boxes."""
        frame = self.seen[unit.parameters]
        if self.annotated_only and not frame.has_annotation:
            return UnitResult()
        points = None if self.cloud is None else frame.cloud(self.cloud)  # reading a file is not the detector's time
        began = time.perf_counter()
        boxes = self.detector(frame)
        ms = 1e3 * (time.perf_counter() - began)
        if self.own is not None:
            boxes = boxes.transform(motion(frame, self.own[unit.parameters]))
        annotated = None if points is None else frame.annotation
        found = FrameDetections(boxes, None if annotated is None or points is None else points_in(annotated, points))
        return UnitResult(value=found.to_json() if self.packed else found, clock=ms)

    def units(self) -> list[Unit]:
        """One a frame."""
        files = getattr(self.seen, "files", None)
        if isinstance(self.seen, Dataset):
            return [Unit("/".join(key), tuple(self.seen.files(n)), n) for n, key in enumerate(self.seen.keys)]
        frames = range(len(self.seen))
        return [Unit(str(n), () if files is None else tuple(files(n)), n) for n in frames]

    @property
    def setting(self) -> str | None:
        """All that decides what is found besides the frames' files; None where that cannot be said."""
        digest = getattr(self.detector, "digest", None)
        if digest is None or not hasattr(self.seen, "files"):
            return None
        views = [getattr(frames, "recipe", None) for frames in (self.seen, self.own)]
        return json.dumps([environment(), digest(), views, self.cloud, self.annotated_only])


def points_in(annotation: Annotation, cloud: Cloud) -> Int[np.ndarray, " n"]:
    """How many points of a cloud lie in each annotated box: scan patterns share their boxes."""
    return count_points_in_boxes(cloud.points_m, annotation.boxes, margin_m=BOX_MARGIN_M)
