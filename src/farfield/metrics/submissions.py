"""Submissions to Argoverse 2's and Waymo's leaderboards as boxes by frame, and boxes by frame as submissions."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Int

from farfield.errors import ConfigError, FileFormatError
from farfield.files.argoverse2_boxes import Argoverse2Boxes, read_argoverse2_boxes
from farfield.files.waymo_objects import TYPES, WaymoObjects, read_waymo_objects
from farfield.frame.drive import Key
from farfield.geometry.boxes import Boxes
from farfield.metrics.argoverse2.settings import CATEGORIES
from farfield.metrics.waymo.settings import WAYMO_CLASSES

WAYMO_LABELS = ("unknown", *WAYMO_CLASSES)
"""Our names of Waymo's types, in the order of their numbers."""
WAYMO_TYPES = {
    **dict(zip(WAYMO_LABELS, TYPES, strict=True)),
    "large_vehicle": "TYPE_VEHICLE",
    "bicycle": "TYPE_CYCLIST",
}
"""Waymo's type of each class of ours that is one."""
ARGOVERSE2_NAMES = {
    **{name: name for name in CATEGORIES},
    "vehicle": "REGULAR_VEHICLE",
    "large_vehicle": "LARGE_VEHICLE",
    "pedestrian": "PEDESTRIAN",
    "bicycle": "BICYCLE",
    "animal": "DOG",
    "wheeled_pedestrian": "WHEELED_RIDER",
    "motorcycle": "MOTORCYCLE",
    "trailer": "VEHICULAR_TRAILER",
}
"""Argoverse 2's category of each class: its own, and of those that are one class of ours the one that stands for it."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SubmittedFrame:
    """The boxes of one frame of a file.

    Args:
        key: (sequence, frame): the log or context, and the stamp.
        boxes: The boxes.
        details: Rows beside them.
    """

    key: Key
    boxes: Boxes
    details: Mapping[str, np.ndarray] = field(default_factory=dict)


def argoverse2_frames(path: Path, *, scored: bool) -> Iterator[SubmittedFrame]:
    """Read a table of Argoverse 2, frame after frame, under its own categories.

    Args:
        path: The feather file.
        scored: Whether it holds predictions, whose scores count.

    Raises:
        MissingExtraError: If pyarrow is not installed.
        FileFormatError: If it is no such table.
    """
    table = read_argoverse2_boxes(path)
    for key, rows in _by_frame(table.log, table.time_ns):
        yield SubmittedFrame(
            key=key,
            boxes=Boxes(
                centre_m=table.centre_m[rows],
                size_m=table.size_m[rows],
                yaw_rad=table.yaw_rad[rows],
                label=table.category[rows],
                score=None if table.score is None else table.score[rows],
                point_count=None if table.points is None or scored else table.points[rows],
            ),
        )


def waymo_frames(path: Path, *, scored: bool) -> Iterator[SubmittedFrame]:
    """Read ``Objects`` or a ``Submission`` of Waymo, frame after frame.

    Args:
        path: The file.
        scored: Whether it holds predictions. Details of these are ``no_label_zone``; of annotated boxes
            ``detection_level``, ``top_points`` and ``camera_box``, as protocol ``waymo-let`` takes them.

    Raises:
        FileFormatError: If it is no such file, or some of the predictions have scores and others none.
    """
    table = read_waymo_objects(path)
    unscored = np.isnan(table.score)
    if scored and unscored.any() and not unscored.all():
        actual = f"{int(unscored.sum())} of {len(table)} without"
        raise FileFormatError(path, where="the objects", expected="scores of all or of none", got=actual)
    has_camera = np.array([bool(name) for name in table.camera], dtype=bool)
    camera_box = np.where(has_camera[:, None], table.camera_box, np.nan)
    labels = np.array(WAYMO_LABELS)[table.type]
    for key, rows in _by_frame(np.array(table.context, dtype=np.str_), table.time_us):
        boxes = Boxes(
            centre_m=table.box[rows, :3],
            size_m=table.box[rows, 3:6],
            yaw_rad=table.box[rows, 6],
            label=labels[rows],
            score=None if unscored.any() else table.score[rows],
            point_count=None if scored else table.points[rows],
        )
        details = {"no_label_zone": table.no_label_zone[rows].astype(np.int64)}
        if not scored:
            details = {"detection_level": table.detection_level[rows], "top_points": table.top_points[rows]}
            details |= {"camera_box": camera_box[rows]} if has_camera.any() else {}
        yield SubmittedFrame(key=key, boxes=boxes, details=details)


def _by_frame(names: np.ndarray, stamps: Int[np.ndarray, " n"]) -> Iterator[tuple[Key, Int[np.ndarray, " k"]]]:
    """Rows of each log and stamp, in the order of the file within a frame."""
    _, number = np.unique(names, return_inverse=True)
    number = number.reshape(-1)
    order = np.lexsort((np.arange(len(names)), stamps, number))
    if not len(order):
        return
    new = (np.diff(number[order]) != 0) | (np.diff(stamps[order]) != 0)
    for rows in np.split(order, np.flatnonzero(new) + 1):
        yield (str(names[rows[0]]), str(int(stamps[rows[0]]))), rows


# The other way


_LEAST_STAMP = 1_000_000_000_000
"""Microseconds of 1970: no count of frames is so large."""


def stamp_of(key: Key) -> int:
    """The stamp by which a frame is named, as both data sets name theirs.

    Args:
        key: (sequence, frame).

    Raises:
        ConfigError: If the frame's name is no stamp.
    """
    frame = key[1]
    if frame.isascii() and frame.isdigit() and _LEAST_STAMP <= int(frame[:20]) < 1 << 63 and frame[0] != "0":
        return int(frame)
    raise ConfigError(
        f"frame {key}: expected a stamp as its name, by which the submission's frames are found; got {frame[:60]!r}. "
        "Write boxes-csv, kitti or nuscenes of data whose frames have other names"
    )


def argoverse2_part(key: Key, boxes: Boxes) -> Argoverse2Boxes:
    """One frame's boxes as rows of a submission; classes that are none of its categories are left out."""
    boxes = boxes[np.isin(boxes.label, [*ARGOVERSE2_NAMES])]
    return Argoverse2Boxes(
        log=np.full(len(boxes), key[0]),
        time_ns=np.full(len(boxes), stamp_of(key), dtype=np.int64),
        category=np.array([ARGOVERSE2_NAMES[str(name)] for name in boxes.label], dtype=np.str_),
        centre_m=boxes.centre_m,
        size_m=boxes.size_m,
        yaw_rad=boxes.yaw_rad,
        score=np.ones(len(boxes)) if boxes.score is None else boxes.score,
    )


def waymo_part(key: Key, boxes: Boxes) -> WaymoObjects:
    """One frame's boxes as objects of a submission; classes that are none of its types are left out."""
    boxes = boxes[np.isin(boxes.label, [*WAYMO_TYPES])]
    count = len(boxes)
    score = np.ones(count) if boxes.score is None else boxes.score
    if count and (score.min() < 0 or score.max() > 1):
        raise ConfigError(
            f"frame {key}: Waymo's objects have scores from 0 to 1, got {score.min():g} to {score.max():g}"
        )
    return WaymoObjects(
        context=(key[0],) * count,
        time_us=np.full(count, stamp_of(key), dtype=np.int64),
        type=np.array([TYPES.index(WAYMO_TYPES[str(name)]) for name in boxes.label], dtype=np.int64),
        id=("",) * count,
        score=score,
        box=np.column_stack([boxes.centre_m, boxes.size_m, boxes.yaw_rad]),
        detection_level=np.zeros(count, dtype=np.int64),
        points=np.full(count, -1),
        top_points=np.full(count, -1),
        no_label_zone=np.zeros(count, dtype=bool),
        camera=("",) * count,
        camera_box=np.full((count, 7), np.nan),
    )
