"""Messages as plans for the store: what each edit changes."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from farfield.annotation.edits import (
    add_box,
    delete_box,
    interpolate_track,
    merge_tracks,
    set_box,
    set_track,
    split_track,
)
from farfield.annotation.errors import RefusedError
from farfield.annotation.store import Store
from farfield.datasets.edits import CellEdit
from farfield.studio.annotating.presenting import TrackNumbers
from farfield.studio.messages import requests as asked
from farfield.studio.messages.rows import BoxValue

Plan = Callable[[Store], Sequence[CellEdit]]


def plan_of(request: Any, drive: str, numbers: TrackNumbers) -> Plan:
    """What an edit changes.

    Args:
        request: One of the messages of :data:`~farfield.studio.messages.requests.Edit`, but propagation, which fits.
        drive: The drive that the window shows, to which its tracks belong.
        numbers: Numbers of tracks.
    """
    return partial(_PLANS[type(request)], request=request, drive=drive, numbers=numbers)


def _key(store: Store, frame: int) -> tuple[str, str]:
    if not 0 <= frame < len(store.keys):
        raise RefusedError("frame", f"expected a frame from 0 to {len(store.keys) - 1}, got {frame}")
    return store.keys[frame]


def row_in_drive(store: Store, frame: int, drive: str) -> int:
    """A frame's row in a drive.

    Raises:
        RefusedError: If the frame is not in it.
    """
    place = store.drives.place(_key(store, frame))
    if place.drive != drive:
        raise RefusedError("frame", f"frame {frame} belongs to another drive than the track")
    return place.row


def value_of(value: BoxValue, numbers: TrackNumbers) -> dict[str, Any]:
    """A box's value as the store takes it."""
    return {
        "label": value.class_name,
        "box": list(value.box),
        "track": numbers.name(value.track),
        "state": value.state,
        "source": value.source,
        "attributes": dict(value.attributes),
    }


def _box_set(store: Store, request: asked.BoxSet, drive: str, numbers: TrackNumbers) -> Sequence[CellEdit]:
    del drive
    value = value_of(request.value, numbers)
    return set_box(store, _key(store, request.frame), request.box, request.base, value)


def _box_add(store: Store, request: asked.BoxAdd, drive: str, numbers: TrackNumbers) -> Sequence[CellEdit]:
    del drive
    return add_box(store, _key(store, request.frame), request.box, value_of(request.value, numbers))


def _box_delete(store: Store, request: asked.BoxDelete, drive: str, numbers: TrackNumbers) -> Sequence[CellEdit]:
    del drive, numbers
    return delete_box(store, _key(store, request.frame), request.box, request.base)


def _track_set(store: Store, request: asked.TrackSet, drive: str, numbers: TrackNumbers) -> Sequence[CellEdit]:
    ends = None if request.ends is None else "" if request.ends < 0 else _key(store, request.ends)[1]
    return set_track(
        store,
        drive,
        numbers.name(request.track),
        request.base,
        label=request.class_name,
        size=request.size,
        locked=request.size_locked,
        ends=ends,
    )


def _track_merge(store: Store, request: asked.TrackMerge, drive: str, numbers: TrackNumbers) -> Sequence[CellEdit]:
    track, into = numbers.name(request.track), numbers.name(request.into)
    return merge_tracks(store, drive, track, into, request.base, request.into_base)


def _track_split(store: Store, request: asked.TrackSplit, drive: str, numbers: TrackNumbers) -> Sequence[CellEdit]:
    track, new = numbers.name(request.track), numbers.name(request.new_track)
    return split_track(store, drive, track, _key(store, request.frame)[1], new, request.base)


def _interpolate(
    store: Store, request: asked.TrackInterpolate, drive: str, numbers: TrackNumbers
) -> Sequence[CellEdit]:
    first, last = (row_in_drive(store, frame, drive) for frame in (request.first, request.last))
    return interpolate_track(store, drive, numbers.name(request.track), first, last, request.id)


_PLANS: dict[type, Callable[..., Sequence[CellEdit]]] = {
    asked.BoxSet: _box_set,
    asked.BoxAdd: _box_add,
    asked.BoxDelete: _box_delete,
    asked.TrackSet: _track_set,
    asked.TrackMerge: _track_merge,
    asked.TrackSplit: _track_split,
    asked.TrackInterpolate: _interpolate,
}
