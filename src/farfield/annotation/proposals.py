"""A detector's proposals of several frames, counted and accepted as one edit, and joined to objects by the tracker."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from farfield.annotation.edits import validate_box
from farfield.annotation.errors import ConflictError, RefusedError
from farfield.annotation.store import Store, StoredBox
from farfield.datasets.edits import CellEdit, box_cell
from farfield.frame import Boxes, Key
from farfield.frame.drive import Drive
from farfield.metrics.detections import Detections
from farfield.tracking.tracker import track

_BEFORE = 5
"""Frames before the first one whose objects the proposals may go on with."""
_FARTHEST_M = 2.0
"""Between a proposal and where the tracker's filter sees the same object."""


@dataclass(frozen=True, kw_only=True)
class ProposalRange:
    """Which proposals are meant.

    Args:
        drive: The drive.
        first: Row of the first frame in the drive.
        last: Row of the last one.
        score: The least score; a proposal without one counts as 1.
    """

    drive: str
    first: int
    last: int
    score: float


class ProposedBox(NamedTuple):
    """A proposal and the frame in which it stands."""

    key: Key
    box: StoredBox


def proposals_of(store: Store, meant: ProposalRange) -> list[ProposedBox]:
    """The proposals of a range that nobody has judged, frame by frame."""
    keys = store.drives.keys(meant.drive)[meant.first : meant.last + 1]
    rows = (ProposedBox(key, box) for key in keys for box in store.rows(key))
    return [row for row in rows if row.box.label.state == "proposed" and _score(row.box) >= meant.score]


def _score(box: StoredBox) -> float:
    return 1.0 if box.label.score is None else box.label.score


def accept_proposals(store: Store, meant: ProposalRange, *, count: int, base: int) -> Sequence[CellEdit]:
    """Accept all proposals of a range: one edit, taken back as one.

    Boxes of one object bear one track: that of an accepted or edited box which the tracker joins them to, else a new
    one. Nobody looked at every one of them, so what was counted has to be what is there.

    Args:
        store: The annotation.
        meant: Which ones.
        count: How many the person was told of.
        base: Number of the last edit when they were counted.

    Raises:
        RefusedError: If they are another number by now, or none.
        ConflictError: If one of them was changed since.
    """
    proposals = proposals_of(store, meant)
    changed = next((row for row in proposals if row.box.version > base), None)
    if changed is not None:
        cell = box_cell(changed.key, changed.box.label.id)
        raise ConflictError(cell, store.value(cell), changed.box.version, changed.box.by)
    if len(proposals) != count or not count:
        reason = f"{count} proposals were counted, {len(proposals)} are there now"
        raise RefusedError("proposals", reason, "Count them again (Shift+Y).")
    tracks = _tracks_of(store, meant, proposals)
    changes = []
    for row, name in zip(proposals, tracks, strict=True):
        cell = box_cell(row.key, row.box.label.id)
        old = store.value(cell)
        new = {**old, "state": "accepted", "track": name}
        changes.append(store.change(cell, validate_box(store, new, old), base=row.box.version))
    return changes


def _tracks_of(store: Store, meant: ProposalRange, proposals: Sequence[ProposedBox]) -> list[str]:
    """The track of each proposal: its own, that of the boxes which the tracker joins it to, or a new one."""
    # 1. The tracker over the proposals and over the boxes that stand, of a few frames before too.
    keys = store.drives.keys(meant.drive)[max(meant.first - _BEFORE, 0) : meant.last + 1]
    chosen: dict[Key, list[StoredBox]] = {key: [] for key in keys}
    for row in proposals:
        chosen[row.key].append(row.box)
    standing = {
        key: [box for box in store.rows(key) if box.label.track and box.label.state in ("edited", "accepted")]
        for key in keys
    }
    rows = {key: [*standing[key], *chosen[key]] for key in keys}
    numbers = _tracker_numbers(store, meant.drive, rows)

    # 2. The name of each of its tracks: the one that most of the standing boxes bear.
    names: dict[int, Counter[str]] = {}
    for key in keys:
        for box, number in zip(standing[key], numbers[key], strict=False):
            names.setdefault(number, Counter())[box.label.track] += 1
    spent = {(key, box.label.track) for key in keys for box in standing[key]}
    new = int(store.tracks.new(meant.drive))
    result: dict[tuple[Key, str], str] = {}
    for key in keys:
        for box, number in zip(chosen[key], numbers[key][len(standing[key]) :], strict=True):
            name = box.label.track or next((name for name, _ in names.get(number, Counter()).most_common(1)), "")
            if not name or (key, name) in spent:  # one object has one box in a frame
                name, new = str(new), new + 1
                names.setdefault(number, Counter())[name] += 1
            spent.add((key, name))
            result[key, box.label.id] = name
    return [result[row.key, row.box.label.id] for row in proposals]


def _tracker_numbers(store: Store, drive: str, rows: Mapping[Key, Sequence[StoredBox]]) -> dict[Key, list[int]]:
    """The tracker's number of each box; negative ones, each its own, where it has none."""
    keys = tuple(rows)
    boxes = {key: _scored_boxes(rows[key]) for key in keys}
    times_s = np.array([store.drives.time_s(key) for key in keys])
    poses = [store.drives.pose(key) for key in keys]
    world = [pose for pose in poses if pose is not None]
    timeline = Drive(
        name=drive,
        indices=np.array([store.index_of[key] for key in keys]),
        keys=keys,
        times_ns=np.round(times_s * 1e9).astype(np.int64),
        world_T_frame=np.stack(world) if len(world) == len(keys) else None,
    )
    tracked = track(
        Detections(boxes=boxes, annotations={}, drives=(timeline,)), min_hits=1, far_min_hits=1, sure_score=None
    )
    alone, numbers = -1, {}
    for key in keys:
        own = np.arange(alone, alone - len(boxes[key]), -1)
        alone -= len(own)
        moving = tracked.boxes.get(key)
        if moving is not None and moving.track_id is not None and len(moving) and len(own):
            away = np.linalg.norm(boxes[key].centre_m[:, None, :2] - moving.centre_m[None, :, :2], axis=2)
            labels, moving_labels = np.array(boxes[key].label), np.array(moving.label)
            away[labels[:, None] != moving_labels[None]] = 10 * _FARTHEST_M
            for row, column in zip(*linear_sum_assignment(away), strict=True):
                if away[row, column] < _FARTHEST_M:
                    own[row] = moving.track_id[column]
        numbers[key] = own.tolist()
    return numbers


def _scored_boxes(rows: Sequence[StoredBox]) -> Boxes:
    table = np.array([row.label.box for row in rows], dtype=np.float64).reshape(-1, 7)
    return Boxes(
        centre_m=table[:, :3],
        size_m=np.maximum(table[:, 3:6], 1e-3),
        yaw_rad=table[:, 6],
        label=[row.label.label for row in rows],
        score=np.array([1.0 if row.label.state in ("edited", "accepted") else _score(row) for row in rows]),
    )
