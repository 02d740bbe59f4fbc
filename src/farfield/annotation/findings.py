"""The checks of the annotation as it stands, frame by frame, with the usual sizes of the data set's own boxes."""

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from farfield.annotation.checking import (
    CheckedFrame,
    CheckSettings,
    DetectorBox,
    LabelIssue,
    NearbyTrack,
    SensorView,
    SizeRange,
    TrackStep,
    check,
)
from farfield.annotation.motion import TrackFrame, to_world
from farfield.annotation.notes import ignored_findings
from farfield.annotation.store import Store, StoredBox
from farfield.annotation.surroundings import Surroundings
from farfield.datasets.edits import track_cell
from farfield.datasets.labels import BoxLabel
from farfield.frame import Key

AROUND = 6
"""So many frames before and after are looked at: the longest gap that is said, and one more."""


def settings_of(
    store: Store, views: Sequence[SensorView] = (), sizes: Mapping[str, SizeRange] | None = None
) -> CheckSettings:
    """Limits from the schema: its classes' sizes and speeds, its extent.

    Args:
        store: The annotation.
        views: What the sensors see.
        sizes: Sizes by class from the data set's own statistics, where they are known.
    """
    classes = store.schema.classes
    presets = {name: SizeRange(usual=spec.size_m, types=tuple(spec.types.values())) for name, spec in classes.items()}
    return CheckSettings(
        sizes=presets | dict(sizes or {}),
        fastest_m_s={name: spec.fastest_m_s for name, spec in classes.items()},
        extent=store.extent or "full",
        views=tuple(views),
    )


def findings(
    store: Store,
    key: Key,
    settings: CheckSettings,
    *,
    around: Surroundings | None = None,
    detections: Sequence[DetectorBox] = (),
) -> list[LabelIssue]:
    """What a person should look at in a frame.

    Args:
        store: The annotation.
        key: The frame.
        settings: Limits, see :func:`settings_of`.
        around: The frame's LiDAR points; None: points are not looked at.
        detections: What a detector found.
    """
    with store.lock:
        located = store.drives.locate(key)
        boxes = [row.label for row in store.rows(key) if row.label.state != "rejected"]
        tracks = {label.track for label in boxes if label.track}
        courses = {track: nearby_track(store, located.drive, track, located.row) for track in tracks}
        reasons = ignored_findings(store)
    scene = CheckedFrame(key=key, row=located.row, around=around, detections=detections)
    return check(boxes, scene, courses, settings, ignored=reasons)


def nearby_track(store: Store, drive: str, track: str, row: int) -> NearbyTrack:
    """A track in the frames around one; of two boxes in one frame the first counts."""
    members = store.tracks.boxes(drive, track)
    near = {member.row: member for member in reversed(members) if abs(member.row - row) <= AROUND}
    frames: list[tuple[TrackFrame, StoredBox]] = []
    for member in (near[frame_row] for frame_row in sorted(near)):
        box = store.row(member.key, member.name)
        if box is not None and box.label.state != "rejected":
            moment = TrackFrame(member.key, store.drives.time_s(member.key), store.drives.pose(member.key))
            frames.append((moment, box))
    posed = all(moment.world_T_frame is not None for moment, _ in frames)
    rows = store.drives
    steps = [
        TrackStep(
            rows.locate(moment.key).row, moment.time_s, to_world(box.label.box, moment) if posed else box.label.box
        )
        for moment, box in frames
    ]
    locked = bool((store.value(track_cell(drive, track)) or {}).get("locked"))
    return NearbyTrack(steps, len({member.row for member in members}), posed=posed, locked=locked)


def all_findings(store: Store, settings: CheckSettings) -> Iterator[LabelIssue]:
    """Findings of every frame, without points: frame by frame, in the data set's order."""
    for key in store.keys:
        yield from findings(store, key, settings)


FEWEST = 200
"""Of fewer boxes, the 0.5 and 99.5 per cent points say nothing."""
PARTS = (0.5, 99.5)
ROOM = 0.1
"""Limits stand so much beyond those points: else one box in a hundred of a sound set is found, on each axis."""


def size_ranges(labels: Iterable[BoxLabel], presets: Mapping[str, SizeRange]) -> dict[str, SizeRange]:
    """Sizes by class: those of the presets, with the limits and medians of the boxes where there are enough.

    Args:
        labels: Boxes of the data set, or of a part of it.
        presets: What is taken for usual where nothing else is known.
    """
    by_class: dict[str, list[tuple[float, float, float]]] = {}
    for label in labels:
        if min(label.box[3:6]) > 0 and np.isfinite(label.box[3:6]).all():
            by_class.setdefault(label.label, []).append(label.box[3:6])
    ranges = dict(presets)
    for name, sizes in by_class.items():
        if len(sizes) >= FEWEST:
            low, high = np.percentile(sizes, PARTS, axis=0)
            types = ranges[name].types if name in ranges else ()
            ranges[name] = SizeRange(
                usual=_three(np.median(sizes, axis=0)),
                low=_three((1 - ROOM) * low),
                high=_three((1 + ROOM) * high),
                types=types,
            )
    return ranges


def _three(values: np.ndarray) -> tuple[float, float, float]:
    length, width, height = values.tolist()
    return length, width, height
