"""A hand's gestures at annotated objects, seeded, and what fitting makes of them; shared by benchmark and tests."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from farfield.annotation.annotator import sensor_place
from farfield.annotation.fitting import BoxFit, Prior, fit_click, fit_drag, prior_of, refit
from farfield.frame import Boxes, Frame
from farfield.geometry.boxes import box_coordinates_m, points_in_boxes
from farfield.geometry.iou import paired_iou
from farfield.vocabulary.classes import VEHICLE_KINDS

LEAST_POINTS, LEAST_FOR_MEDIAN = 3, 5
LIFT_M = 0.15  # points this little over a box's bottom may be the road's: nobody presses there


@dataclass(frozen=True, eq=False, kw_only=True)
class Subject:
    """An annotated object: the cloud it stands in, its box, its own points, and what is known beforehand."""

    source: str
    points_m: np.ndarray
    box: Boxes
    own_m: np.ndarray
    prior: Prior

    @property
    def vehicle(self) -> bool:
        return str(self.box.label[0]) in VEHICLE_KINDS

    @property
    def range_m(self) -> float:
        return float(self.box.range_m[0])


def subjects(frames: Iterable[tuple[str, Frame]]) -> Iterator[Subject]:
    """Objects of frames that hold three points or more; their prior is the median size of their class in the set."""
    frames = list(frames)
    sizes: dict[tuple[str, str], list[np.ndarray]] = {}
    for source, frame in frames:
        for label, size in zip(frame.boxes.label, frame.boxes.size_m, strict=True):
            sizes.setdefault((source, str(label)), []).append(size)
    for source, frame in frames:
        points, (place, height) = frame.cloud().points_m, sensor_place(frame, "lidar")
        for index, own in enumerate(points_in_boxes(points, frame.boxes)):
            label = str(frame.boxes.label[index])
            if len(own) < LEAST_POINTS or label == "unknown":
                continue
            seen = sizes[source, label]
            median = tuple(np.median(seen, axis=0).tolist()) if len(seen) >= LEAST_FOR_MEDIAN else None
            yield Subject(
                source=source,
                points_m=points,
                box=frame.boxes[index],
                own_m=points[own],
                prior=replace(prior_of(label, size_m=median), ego_m=place, ego_z_m=height),
            )


def seen_whole(subject: Subject, within_m: float = 0.15) -> bool:
    """Whether points of an object lie within so much of both of its ends, so that they tell its length."""
    along = box_coordinates_m(subject.own_m, subject.box, 0)[:, 0]
    return bool(subject.box.size_m[0, 0] - np.ptp(along) <= 2 * within_m and len(along) > 1)


def pressed(subject: Subject, rng: np.random.Generator, error_m: float = 0.0) -> np.ndarray:
    """Where a hand presses: at one of the object's points, or beside it by its error."""
    local = box_coordinates_m(subject.own_m, subject.box, 0)
    lifted = subject.own_m[local[:, 2] > LIFT_M - subject.box.size_m[0, 2] / 2]
    chosen = lifted if len(lifted) else subject.own_m
    return chosen[rng.integers(len(chosen)), :2] + rng.normal(0, error_m, 2)


def click(subject: Subject, rng: np.random.Generator) -> BoxFit:
    return fit_click(subject.points_m, pressed(subject, rng), subject.prior)


def click_lane(subject: Subject, rng: np.random.Generator) -> BoxFit:
    return fit_click(subject.points_m, pressed(subject, rng), replace(subject.prior, lane_rad=0.0))


def drag(subject: Subject, rng: np.random.Generator, *, error_m: float = 0.0, error_deg: float = 4.0) -> BoxFit:
    start = pressed(subject, rng, error_m)
    yaw = float(subject.box.yaw_rad[0]) + np.deg2rad(rng.normal(0, error_deg))
    return fit_drag(subject.points_m, start, start + 3 * np.array([np.cos(yaw), np.sin(yaw)]), subject.prior)


def drawn(subject: Subject, rng: np.random.Generator) -> Boxes:
    """A rectangle drawn by hand: 0.4 m beside the middle, 5 degrees and 15 % off, of the right height."""
    box = subject.box
    return box.replace(
        centre_m=box.centre_m + np.append(rng.normal(0, 0.4, 2), 0.0),
        size_m=box.size_m * np.append(np.exp(rng.normal(0, 0.15, 2)), 1.0),
        yaw_rad=box.yaw_rad + np.deg2rad(rng.normal(0, 5)),
    )


def snapped(subject: Subject, rng: np.random.Generator) -> BoxFit:
    box = drawn(subject, rng)
    return refit(subject.points_m, [*box.centre_m[0], *box.size_m[0], box.yaw_rad[0]], subject.prior)


def shrunk(subject: Subject, rng: np.random.Generator) -> Boxes:
    """The drawn rectangle, each side moved inwards to the nearest point."""
    box = drawn(subject, rng)
    inside = points_in_boxes(subject.points_m, box)[0]
    local = box_coordinates_m(subject.points_m[inside], box, 0)
    local = local[local[:, 2] > LIFT_M - box.size_m[0, 2] / 2]
    if len(local) < 2:
        return box
    low, high = local[:, :2].min(axis=0), local[:, :2].max(axis=0)
    cos, sin = np.cos(box.yaw_rad[0]), np.sin(box.yaw_rad[0])
    x, y = (low + high) / 2
    moved = box.centre_m + np.array([x * cos - y * sin, x * sin + y * cos, 0.0])
    return box.replace(centre_m=moved, size_m=np.append(np.maximum(high - low, 0.1), box.size_m[0, 2])[None])


@dataclass(frozen=True, eq=False, kw_only=True)
class Errors:
    """One row an object: overlap from above, distance of centres, that along the heading and across, turn, ms."""

    iou: np.ndarray
    centre_m: np.ndarray
    along_m: np.ndarray
    across_m: np.ndarray
    yaw_deg: np.ndarray
    ms: np.ndarray


def measured(
    chosen: Sequence[Subject], gesture: Callable[[Subject, np.random.Generator], BoxFit | Boxes], *, seed: int
) -> Errors:
    """What a gesture gives at each object. Each object has random numbers of its own."""
    made, ms = [], []
    for number, subject in enumerate(chosen):
        found = gesture(subject, np.random.default_rng([seed, number]))
        if isinstance(found, BoxFit):
            row = np.array([found.box])
            ms.append(found.ms)
            found = Boxes(centre_m=row[:, :3], size_m=row[:, 3:6], yaw_rad=row[:, 6])
        made.append(found.plain().replace(label="unknown"))
    return compared(
        Boxes.concatenate(made), Boxes.concatenate([subject.box.plain() for subject in chosen]), np.array(ms)
    )


def compared(boxes: Boxes, truth: Boxes, ms: np.ndarray) -> Errors:
    """Errors of boxes, each beside its true one."""
    turn = np.rad2deg(np.abs(np.mod(boxes.yaw_rad - truth.yaw_rad + np.pi / 2, np.pi) - np.pi / 2))
    x, y = (boxes.centre_m - truth.centre_m)[:, :2].T
    cos, sin = np.cos(truth.yaw_rad), np.sin(truth.yaw_rad)
    return Errors(
        iou=paired_iou(boxes, truth, kind="bev"),
        centre_m=np.hypot(x, y),
        along_m=np.abs(x * cos + y * sin),
        across_m=np.abs(y * cos - x * sin),
        yaw_deg=turn,
        ms=ms,
    )
