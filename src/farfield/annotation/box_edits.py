"""Edits of single boxes, each a plan for :meth:`~farfield.annotation.store.Store.edit`."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from farfield.annotation.angles import wrapped
from farfield.annotation.errors import ConflictError, RefusedError
from farfield.annotation.store import Store, StoredBox
from farfield.datasets.edits import CellEdit, box_cell, numbers, track_cell
from farfield.frame import Key

STATES = ("proposed", "edited", "accepted", "rejected")
SOURCES = ("", "lidar", "radar", "camera", "interpolated", "propagated", "detector")
FARTHEST_M, LARGEST_M = 1000.0, 60.0
MADE = ("interpolated", "propagated")
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
    row = _present(store, key, name)
    cell = box_cell(key, name)
    old = store.value(cell)
    new = sound(store, old | dict(value), old)
    if new.get("state") == "proposed" and new["box"] != old["box"] and "state" not in value:
        new["state"] = "edited"
    if new.get("source") in MADE and new["box"] != old["box"] and new.get("state", "accepted") != "proposed":
        new["source"] = "lidar"
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
    new = sound(store, {"state": "edited", **value}, None)
    return [store.change(cell, new)]


def delete_box(store: Store, key: Key, name: str, base: int) -> Sequence[CellEdit]:
    """Remove a box; a detector's proposal is kept as rejected, so that it is not proposed again.

    Raises:
        RefusedError: If there is no such box.
        ConflictError: If somebody changed the box since ``base``.
    """
    _present(store, key, name)
    cell = box_cell(key, name)
    old = store.value(cell)
    proposed = old.get("state", "accepted") == "proposed"
    return [store.change(cell, {**old, "state": "rejected"} if proposed else None, base=base)]


def _present(store: Store, key: Key, name: str) -> StoredBox:
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
    drive = store.drives.place(key).drive
    cell = track_cell(drive, new["track"])
    track = store.value(cell) or {}
    if not track.get("locked"):
        return []
    size = [float(length) for length in new["box"][3:6]]
    changes = [store.change(cell, {**track, "size": size})]
    for seen in store.tracks.seen(drive, new["track"]):
        if (seen.key, seen.name) != (key, name):
            other = box_cell(seen.key, seen.name)
            changes.append(store.change(other, resized(store.value(other), size)))
    return [change for change in changes if change.old != change.new]


def resized(value: Value, size: Sequence[float]) -> dict[str, Any]:
    """A box's value with another size, standing where it stood: its middle seen from above and its bottom stay."""
    x, y, z, _, _, height, yaw = value["box"]
    middle = z if size[2] == height else z - height / 2 + size[2] / 2
    return {**value, "box": [x, y, middle, *size, yaw]}


def sound(store: Store, value: Value, old: Value | None) -> dict[str, Any]:
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
    new = {name: given for name, given in value.items() if given not in (None, "", {}) or name in ("label", "box")}
    if old is None or list(value["box"]) != old["box"]:
        new["box"] = _box(value["box"])
    _words(store, new, old or {})
    _kinds(new)
    if new.get("state") == "accepted":
        del new["state"]
    for name, given in dict(new.get("attributes", {})).items():
        if given != (old or {}).get("attributes", {}).get(name):
            fault = store.schema.fault(name, given)
            if fault:
                raise RefusedError("attribute", fault, "classes.yaml beside the journal says what there is.")
    return new


def _box(box: Any) -> list[float]:
    try:
        x, y, z, length, width, height, yaw = numbers(box)
    except (ValueError, TypeError) as error:
        raise RefusedError("box", str(error)) from None
    if not all(map(math.isfinite, box)):
        raise RefusedError("box", "expected finite numbers as box")
    if not all(0 < size <= LARGEST_M for size in (length, width, height)):
        raise RefusedError("size", f"expected sizes above 0 and up to {LARGEST_M:g} m, got {length}, {width}, {height}")
    if not all(abs(place) <= FARTHEST_M for place in (x, y, z)):
        raise RefusedError("place", f"expected a centre within {FARTHEST_M:g} m, got {x}, {y}, {z}")
    return [x, y, z, length, width, height, wrapped(yaw)]


def _kinds(new: Value) -> None:
    """What is kept beside the box must be readable again: a damaged value would shut its frame."""
    score, attributes = new.get("score", 0.0), new.get("attributes", {})
    if isinstance(score, bool) or not isinstance(score, int | float) or not math.isfinite(score):
        raise RefusedError("score", f"expected a finite number as score, got {str(score)[:40]!r}")
    if not isinstance(attributes, Mapping) or not all(isinstance(name, str) for name in attributes):
        raise RefusedError("attribute", f"expected attributes by name, got {str(attributes)[:40]!r}")
    if "proposal" in new:
        _box(new["proposal"])


def _words(store: Store, new: Value, old: Value) -> None:
    label, track = new["label"], new.get("track", "")
    if label != old.get("label") and label not in store.schema.classes:
        known = ", ".join(store.schema.classes)
        mend = (
            f"Add it under classes in {store.folder.name}/classes.yaml and start anew, or delete that file and start "
            "with --classes NAME:LENGTH,WIDTH,HEIGHT."
        )
        raise RefusedError("class", f"expected one of the classes {known}, got {label!r}", mend)
    if not isinstance(track, str) or len(track) > 64:
        raise RefusedError("track", f"expected the name of a track, got {str(track)[:70]!r}")
    if new.get("state", "accepted") not in STATES:
        raise RefusedError("state", f"expected one of {', '.join(STATES)}, got {new['state']!r}")
    if new.get("source", "") not in SOURCES:
        raise RefusedError("source", f"expected one of {', '.join(SOURCES[1:])}, got {new['source']!r}")
