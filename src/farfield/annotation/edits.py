"""Edits of boxes and of tracks, each a plan for :meth:`~farfield.annotation.store.Store.edit`."""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any

from farfield.annotation.errors import ConflictError, RefusedError
from farfield.annotation.motion import PropagatedTrack, Refit, TrackFrame, interpolate, propagate, wrap_yaw
from farfield.annotation.store import Plan, Store, StoredBox
from farfield.datasets.edits import CellEdit, box_cell, numbers, track_cell
from farfield.datasets.labels import Numbers
from farfield.frame import Key
from farfield.vocabulary.counts import count_of

STATES = ("proposed", "edited", "accepted", "rejected")
SOURCES = ("", "lidar", "radar", "camera", "interpolated", "propagated", "predicted", "detector")
FARTHEST_M, LARGEST_M = 1000.0, 60.0
TOOL_SOURCES = ("interpolated", "propagated", "predicted")
"""Sources of boxes that a person did not place: one that is moved by hand is no longer of these."""

Value = Mapping[str, Any]


def set_box(store: Store, key: Key, name: str, base: int, value: Value) -> Sequence[CellEdit]:
    """Change a box; on a track with a locked size its new size goes to all boxes of the track.

    Args:
        store: The annotation.
        key: The frame.
        name: The box.
        base: The version from which the edit starts.
        value: What changes: ``box``, ``label``, ``track``, ``state``, ``source``, ``attributes``; the rest stays.

    Raises:
        RefusedError: If there is no such box, or the value is not possible.
        ConflictError: If somebody changed the box since ``base``.
    """
    row = _require_box(store, key, name)
    cell = box_cell(key, name)
    old = store.value(cell)
    new = validate_box(store, old | dict(value), old)
    if new.get("state") == "proposed" and new["box"] != old["box"] and "state" not in value:
        new["state"] = "edited"
    if new.get("source") in TOOL_SOURCES and new["box"] != old["box"] and new.get("state", "accepted") != "proposed":
        new["source"] = "lidar"
    was_proposed = old.get("state") in ("proposed", "rejected")
    new = _with_track(store, key, new, always=was_proposed)
    changes = [store.change(cell, new, base=base)]
    if new["box"][3:6] != old["box"][3:6] and new.get("track") and row.label.track == new.get("track"):
        changes += locked_size(store, key, name, new)
    return changes


def add_box(store: Store, key: Key, name: str, value: Value) -> Sequence[CellEdit]:
    """Add a box under a name that the client makes up.

    Raises:
        RefusedError: If the name is taken or all digits (those are the files' objects), or the value is not possible.
    """
    cell = box_cell(key, name)
    if not name or name.isdigit() or len(name) > 64:
        raise RefusedError("name", f"{name!r} cannot be the name of a new box", "Use letters, such as w1-17.")
    standing = store.state.get(cell)
    if standing is not None and standing.value is not None:
        raise RefusedError("name", f"frame {'/'.join(key)} has a box {name!r} already", "Use a new name.")
    if key not in store.index_of:
        raise RefusedError("frame", f"there is no frame {'/'.join(key)}")
    new = _with_track(store, key, validate_box(store, {"state": "edited", **value}, None))
    return [store.change(cell, new)]


def _with_track(store: Store, key: Key, new: dict[str, Any], *, always: bool = False) -> dict[str, Any]:
    """A box with a track of its own where it has none, is to be written, and its label file gives each object one.

    Args:
        store: The annotation.
        key: The frame.
        new: The box's value.
        always: Whatever the label files hold, such as of a detection that a person accepts.
    """
    if new.get("track") or new.get("state") in ("proposed", "rejected"):
        return new
    if not always and not getattr(store.files.format, "needs_tracks", False):
        return new
    return {**new, "track": store.tracks.new(store.drives.locate(key).drive)}


def delete_box(store: Store, key: Key, name: str, base: int) -> Sequence[CellEdit]:
    """Remove a box; a detector's proposal is kept as rejected, so that it is not proposed again.

    Raises:
        RefusedError: If there is no such box.
        ConflictError: If somebody changed the box since ``base``.
    """
    _require_box(store, key, name)
    cell = box_cell(key, name)
    old = store.value(cell)
    proposed = old.get("state", "accepted") == "proposed"
    return [store.change(cell, {**old, "state": "rejected"} if proposed else None, base=base)]


def _require_box(store: Store, key: Key, name: str) -> StoredBox:
    if key not in store.index_of:
        raise RefusedError("frame", f"there is no frame {'/'.join(key)}")
    row = store.row(key, name)
    if row is None:
        standing = store.state.get(box_cell(key, name))
        if standing is not None:
            raise ConflictError(box_cell(key, name), None, standing.version, standing.by)
        raise RefusedError("box", f"frame {'/'.join(key)} has no box {name!r}")
    return row


def locked_size(store: Store, key: Key, name: str, new: Value) -> list[CellEdit]:
    """Changes of a track's other boxes to a new size, if the track's size is locked; their bottoms stay."""
    drive = store.drives.locate(key).drive
    cell = track_cell(drive, new["track"])
    track = store.value(cell) or {}
    if not track.get("locked"):
        return []
    size = [float(length) for length in new["box"][3:6]]
    changes = [store.change(cell, {**track, "size": size})]
    for member in store.tracks.boxes(drive, new["track"]):
        if (member.key, member.name) != (key, name):
            other = box_cell(member.key, member.name)
            changes.append(store.change(other, resize(store.value(other), size)))
    return [change for change in changes if change.old != change.new]


def resize(value: Value, size: Sequence[float]) -> dict[str, Any]:
    """A box's value with another size, standing where it stood: its middle seen from above and its bottom stay."""
    x, y, z, _, _, height, yaw = value["box"]
    middle = z if size[2] == height else z - height / 2 + size[2] / 2
    return {**value, "box": [x, y, middle, *size, yaw]}


def validate_box(store: Store, value: Value, old: Value | None) -> dict[str, Any]:
    """The value of a box, checked; what did not change is not looked at again.

    Raises:
        RefusedError: With the reason.
    """
    if store.extent is None:
        mend = "Declare it first: whole bodies (full) or visible parts (visible)."
        raise RefusedError("extent", "nobody has said yet what the boxes of this data set hold", mend)
    fields = {"label", "box", "track", "state", "source", "attributes", "score", "proposal"}
    unknown = sorted(set(value) - fields)
    if unknown or "box" not in value or "label" not in value:
        raise RefusedError("value", f"a box has {', '.join(sorted(fields))}; got {', '.join(sorted(value))}")
    new = {name: field for name, field in value.items() if field not in (None, "", {}) or name in ("label", "box")}
    if old is None or list(value["box"]) != old["box"]:
        new["box"] = _box(value["box"])
    _check_terms(store, new, old or {})
    _check_types(new)
    if new.get("state") == "accepted":
        del new["state"]
    old_attributes = (old or {}).get("attributes", {})
    for name, field in dict(new.get("attributes", {})).items():
        standing = old_attributes.get(name)
        if name in old_attributes and type(field) is type(standing) and field == standing:
            continue
        fault = store.schema.fault(name, field)
        if fault:
            raise RefusedError("attribute", fault, "classes.yaml beside the journal says what there is.")
    return new


def _box(box: Any) -> list[float]:
    try:
        x, y, z, length, width, height, yaw = numbers(box)
    except (ValueError, TypeError, OverflowError) as error:
        raise RefusedError("box", str(error)) from None
    if not all(map(math.isfinite, (x, y, z, length, width, height, yaw))):
        raise RefusedError("box", "expected finite numbers as box")
    if not all(0 < size <= LARGEST_M for size in (length, width, height)):
        raise RefusedError("size", f"expected sizes above 0 and up to {LARGEST_M:g} m, got {length}, {width}, {height}")
    if not all(abs(coordinate) <= FARTHEST_M for coordinate in (x, y, z)):
        raise RefusedError("place", f"expected a centre within {FARTHEST_M:g} m, got {x}, {y}, {z}")
    return [x, y, z, length, width, height, wrap_yaw(yaw)]


def _check_types(new: Value) -> None:
    """What is kept beside the box must be readable again: a damaged value would shut its frame."""
    score, attributes = new.get("score", 0.0), new.get("attributes", {})
    if isinstance(score, bool) or not isinstance(score, int | float) or not _storable(score):
        raise RefusedError("score", "expected a finite number as score, of 64 bits at most")
    if not isinstance(attributes, Mapping) or not all(isinstance(name, str) for name in attributes):
        raise RefusedError("attribute", f"expected attributes by name, got {str(attributes)[:40]!r}")
    for name, value in attributes.items():
        if not isinstance(value, str | int | float):
            raise RefusedError("attribute", f"{name}: expected text, a number or a flag, got {str(value)[:40]!r}")
        if not isinstance(value, str) and not _storable(value):
            raise RefusedError("attribute", f"{name}: expected a finite number of 64 bits")
    if "proposal" in new:
        _box(new["proposal"])


def _storable(number: int | float) -> bool:
    """Whether the journal can hold a number: finite, a whole one of 64 bits."""
    return -(2**63) <= number < 2**63 if isinstance(number, int) else math.isfinite(number)


def _check_terms(store: Store, new: Value, old: Value) -> None:
    label, track = new["label"], new.get("track", "")
    if label != old.get("label") and label not in store.schema.classes:
        classes = ", ".join(store.schema.classes)
        mend = (
            f"Add it under classes in {store.folder.name}/classes.yaml and start anew, or delete that file and start "
            "with --classes NAME:LENGTH,WIDTH,HEIGHT."
        )
        raise RefusedError("class", f"expected one of the classes {classes}, got {label!r}", mend)
    if not isinstance(track, str) or len(track) > 64:
        raise RefusedError("track", f"expected the name of a track, got {str(track)[:70]!r}")
    if new.get("state", "accepted") not in STATES:
        raise RefusedError("state", f"expected one of {', '.join(STATES)}, got {new['state']!r}")
    if new.get("source", "") not in SOURCES:
        raise RefusedError("source", f"expected one of {', '.join(SOURCES[1:])}, got {new['source']!r}")


# Edits of tracks: one edit, however many boxes


def track_frames(store: Store, keys: Iterable[Key]) -> list[TrackFrame]:
    """Time and pose of some frames."""
    return [TrackFrame(key, store.drives.time_s(key), store.drives.pose(key)) for key in keys]


def boxes_of(store: Store, drive: str, track: str) -> list[tuple[int, Key, StoredBox]]:
    """The boxes of a track that stand (rejected ones left out): row in the drive, frame, box; in the order of time."""
    rows = [(member.row, member.key, store.row(member.key, member.name)) for member in store.tracks.boxes(drive, track)]
    return [(row, key, box) for row, key, box in rows if box is not None and box.label.state != "rejected"]


def set_track(
    store: Store,
    drive: str,
    track: str,
    base: int,
    *,
    label: str | None = None,
    size: Sequence[float] | None = None,
    locked: bool | None = None,
    ends: str | None = None,
) -> Sequence[CellEdit]:
    """Set what holds for a track in all its frames.

    Args:
        store: The annotation.
        drive: The drive.
        track: The track.
        base: Version of the track from which the edit starts.
        label: Class of all its boxes.
        size: Length, width, height of all its boxes; given with ``locked``, or where the size is locked.
        locked: Whether all its boxes have one size. Locked without a size, they get that of the middle keyframe.
        ends: Name of the frame in which the object is last there: later boxes that no person placed go; empty: no end.

    Raises:
        RefusedError: If there is no such track, or a value is not possible.
        ConflictError: If somebody changed the track since ``base``.
    """
    boxes = _require_track(store, drive, track)
    cell = track_cell(drive, track)
    old = store.value(cell) or {}
    new = dict(old) | {
        name: value for name, value in (("locked", locked), ("ends", ends), ("label", label)) if value is not None
    }
    if size is not None:
        new["size"] = [float(length) for length in size]
    if new.get("locked") and "size" not in new:
        new["size"] = _middle_size(boxes)
    if locked is False:
        new.pop("size", None)
    last = _row_of(store, drive, new.get("ends", ""))
    changes = [store.change(cell, new, base=base)]
    for row, key, box in boxes:
        if last is not None and row > last and not box.label.keyframe:
            changes.append(store.change(box_cell(key, box.label.id), None))
        else:
            changes += _relabelled_or_resized(
                store, key, box, label, new.get("size") if size is not None or locked else None
            )
    return changes


def _relabelled_or_resized(
    store: Store, key: Key, box: StoredBox, label: str | None, size: Sequence[float] | None
) -> list[CellEdit]:
    cell = box_cell(key, box.label.id)
    old = store.value(cell)
    new = dict(old) if label is None else {**old, "label": label}
    if size is not None:
        new = resize(new, size)
    return [store.change(cell, validate_box(store, new, old))] if new != old else []


def _require_track(store: Store, drive: str, track: str) -> list[tuple[int, Key, StoredBox]]:
    boxes = boxes_of(store, drive, track)
    if not track or not boxes:
        raise RefusedError("track", f"drive {drive} has no track {track!r}")
    return boxes


def _middle_size(boxes: Sequence[tuple[int, Key, StoredBox]]) -> list[float]:
    keyframes = [box.label.box for _, _, box in boxes if box.label.keyframe] or [box.label.box for _, _, box in boxes]
    by_volume = sorted(keyframes, key=_volume)
    return list(by_volume[len(by_volume) // 2][3:6])


def _volume(box: Numbers) -> float:
    return box[3] * box[4] * box[5]


def _row_of(store: Store, drive: str, frame: str) -> int | None:
    if not frame:
        return None
    rows = [row for row, key in enumerate(store.drives.keys(drive)) if key[1] == frame]
    if not rows:
        raise RefusedError("frame", f"drive {drive} has no frame {frame!r}")
    return rows[0]


def merge_tracks(store: Store, drive: str, track: str, into: str, base: int, into_base: int) -> Sequence[CellEdit]:
    """Make one track a part of another, whose class, and size if it is locked, its boxes take.

    Raises:
        RefusedError: If there is no such track, or both have a box in one frame.
        ConflictError: If somebody changed either since.
    """
    boxes, into_boxes = _require_track(store, drive, track), _require_track(store, drive, into)
    if track == into:
        raise RefusedError("track", f"track {track} cannot be merged with itself")
    both = sorted({row for row, _, _ in boxes} & {row for row, _, _ in into_boxes})
    if both:
        frames = ", ".join(store.drives.keys(drive)[row][1] for row in both[:3])
        mend = "Delete one of the two boxes there first."
        raise RefusedError(
            "overlap", f"tracks {track} and {into} both have a box in {count_of(len(both), 'frame')} ({frames})", mend
        )
    other = store.value(track_cell(drive, into)) or {}
    label = into_boxes[-1][2].label.label
    size = other.get("size") if other.get("locked") else None
    changes = [
        store.change(track_cell(drive, track), None, base=base),
        store.change(track_cell(drive, into), other or None, base=into_base),
    ]
    for _, key, box in boxes:
        cell = box_cell(key, box.label.id)
        old = store.value(cell)
        new = {**old, "track": into, "label": label}
        changes.append(store.change(cell, validate_box(store, new if size is None else resize(new, size), old)))
    return changes


def split_track(store: Store, drive: str, track: str, frame: str, new_track: str, base: int) -> Sequence[CellEdit]:
    """Give the boxes of a track from a frame on a new number.

    Raises:
        RefusedError: If there is no such track, the number is in use, or nothing would stay or go.
        ConflictError: If somebody changed the track since ``base``.
    """
    boxes = _require_track(store, drive, track)
    if boxes_of(store, drive, new_track):
        raise RefusedError("track", f"drive {drive} has a track {new_track} already", "Take a number that is free.")
    first = _row_of(store, drive, frame) or 0
    later = [(key, box) for row, key, box in boxes if row >= first]
    if not later or len(later) == len(boxes):
        raise RefusedError("frame", f"track {track} has no boxes on both sides of frame {frame}")
    own = store.value(track_cell(drive, track))
    changes = [store.change(track_cell(drive, track), own, base=base)]
    if own is not None:
        changes.append(store.change(track_cell(drive, new_track), own))
    for key, box in later:
        cell = box_cell(key, box.label.id)
        old = store.value(cell)
        changes.append(store.change(cell, validate_box(store, {**old, "track": new_track}, old)))
    return changes


def interpolate_track(store: Store, drive: str, track: str, first: int, last: int, prefix: str) -> Sequence[CellEdit]:
    """Boxes in all frames between keyframes; keyframes stay as they are.

    Args:
        store: The annotation.
        drive: The drive.
        track: The track.
        first: First row of the drive that may get a box.
        last: Last one.
        prefix: How the names of new boxes begin, such as the edit's id.

    Raises:
        RefusedError: If there are not two keyframes, or two at one time.
    """
    boxes = _require_track(store, drive, track)
    keyframes = [(key, box) for _, key, box in boxes if box.label.keyframe]
    if len(keyframes) < 2:
        raise RefusedError(
            "keyframes", f"track {track} has {count_of(len(keyframes), 'keyframe')}", "Set two or more (key K)."
        )
    keys = store.drives.keys(drive)
    frames = track_frames(store, keys[max(first, 0) : last + 1])
    anchors = track_frames(store, (key for key, _ in keyframes))
    for before, after in pairwise(anchors):
        if before.time_s == after.time_s:
            sentence = f"track {track} has two keyframes at the time of frame {after.key[1]}"
            raise RefusedError("keyframes", sentence, "Delete one of the two boxes, or give it another track number.")
    keyframe_boxes = [(moment, box.label.box) for moment, (_, box) in zip(anchors, keyframes, strict=True)]
    size = (store.value(track_cell(drive, track)) or {}).get("size")
    return fill_track(store, drive, track, interpolate(keyframe_boxes, frames, size), "interpolated", prefix)


def propagate_track(
    store: Store,
    drive: str,
    track: str,
    first: int,
    last: int,
    refit: Refit | None = None,
    *,
    always: bool = False,
) -> PropagatedTrack:
    """Where a track goes on from a frame; :func:`fill_track` makes an edit of it.

    It reads the annotation and changes nothing, so that the fits, which take time, hold up nobody's edits.

    Args:
        store: The annotation.
        drive: The drive.
        track: The track.
        first: Row of the drive from which it goes on; the track has a box there.
        last: Row to which it goes; before ``first`` to go backwards. The track's end is respected.
        refit: Fits the object in a frame; None: it goes where its motion takes it.
        always: Place it in every frame, by its motion alone where the points do not decide.

    Raises:
        RefusedError: If the track has no box in the first frame.
    """
    with store.lock:
        boxes = {row: (key, box) for row, key, box in _require_track(store, drive, track)}
        ends = _row_of(store, drive, (store.value(track_cell(drive, track)) or {}).get("ends", ""))
    keys = store.drives.keys(drive)
    if first not in boxes:
        raise RefusedError("frame", f"track {track} has no box in the frame from which it is to go on")
    step = 1 if last >= first else -1
    if ends is not None and step > 0:
        last = min(last, ends)
    before = [row for row in sorted(boxes, reverse=step < 0) if (first - row) * step >= 0]
    anchors = [row for row in before if row == first or boxes[row][1].label.keyframe]
    trail = track_frames(store, (boxes[row][0] for row in anchors))
    keyframe_boxes = [(moment, boxes[row][1].label.box) for moment, row in zip(trail, anchors, strict=True)]
    ahead = [keys[row] for row in range(first + step, last + step, step) if 0 <= row < len(keys)]
    later_keyframes = {key: box.label.box for key, box in boxes.values() if box.label.keyframe and key in ahead}
    return propagate(keyframe_boxes, track_frames(store, ahead), refit, later_keyframes=later_keyframes, always=always)


def fill_track(
    store: Store,
    drive: str,
    track: str,
    boxes: Mapping[Key, Numbers],
    source: str,
    prefix: str,
    predicted: Collection[Key] = (),
) -> list[CellEdit]:
    """Put boxes of a track into frames, with class and attributes of the keyframe before; keyframes stay.

    Args:
        store: The annotation.
        drive: The drive.
        track: The track.
        boxes: A box for each frame.
        source: ``interpolated`` or ``propagated``.
        prefix: How the names of new boxes begin.
        predicted: Frames whose box is there by motion alone: its source is ``predicted``.

    Raises:
        RefusedError: If a box is not possible, such as one beyond a kilometre.
    """
    track_boxes = {key: box for _, key, box in boxes_of(store, drive, track)}
    rows = {key: row for row, key in enumerate(store.drives.keys(drive))}
    keyframes = [(rows[key], box) for key, box in track_boxes.items() if box.label.keyframe]
    if not keyframes:
        raise RefusedError("keyframes", f"track {track} has no keyframe", "Set one (key K).")
    changes = []
    for key, box in boxes.items():
        old = track_boxes.get(key)
        if old is not None and old.label.keyframe:
            continue
        before = [box for row, box in keyframes if row <= rows[key]] or [keyframes[0][1]]
        cell = box_cell(key, f"{prefix}.{rows[key]}"[-64:] if old is None else old.label.id)
        value: dict[str, Any] = {"label": before[-1].label.label, "box": list(box), "track": track}
        value |= {"state": "edited", "source": "predicted" if key in predicted else source}
        value |= {"attributes": dict(before[-1].label.attributes)}
        changes.append(store.change(cell, validate_box(store, value, None)))
    return [change for change in changes if change.old != change.new]


def combine(plans: Sequence[Plan], store: Store) -> Sequence[CellEdit]:
    """Several plans as one edit, such as one nudge of all boxes that are selected, or a row that is accepted.

    Raises:
        RefusedError: If two of them change the same thing.
    """
    changes = [change for plan in plans for change in plan(store)]
    cells = [change.cell for change in changes]
    twice = next((cell for cell in cells if cells.count(cell) > 1), None) if len(set(cells)) < len(cells) else None
    if twice is not None:
        raise RefusedError("twice", f"{'/'.join(twice)} would be changed twice by one edit")
    return changes
