"""The checks of a frame of the annotation as it stands, and of all frames."""

from collections.abc import Iterator, Mapping, Sequence

from farfield.annotation.checking import (
    CheckedFrame,
    CheckSettings,
    DetectorBox,
    LabelIssue,
    NearbyTrack,
    SensorView,
    SizeRange,
    Surroundings,
    TrackStep,
    check,
)
from farfield.annotation.motion import TrackFrame, to_world
from farfield.annotation.notes import ignored
from farfield.annotation.store import Store, StoredBox
from farfield.datasets.edits import track_cell
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
        place = store.drives.place(key)
        boxes = [row.label for row in store.rows(key) if row.label.state != "rejected"]
        tracks = {label.track for label in boxes if label.track}
        courses = {track: course(store, place.drive, track, place.row) for track in tracks}
        reasons = ignored(store)
    scene = CheckedFrame(key=key, row=place.row, around=around, detections=detections)
    return check(boxes, scene, courses, settings, ignored=reasons)


def course(store: Store, drive: str, track: str, row: int) -> NearbyTrack:
    """A track in the frames around one; of two boxes in one frame the first counts."""
    seen = store.tracks.seen(drive, track)
    near = {each.row: each for each in reversed(seen) if abs(each.row - row) <= AROUND}
    found: list[tuple[TrackFrame, StoredBox]] = []
    for each in (near[place] for place in sorted(near)):
        box = store.row(each.key, each.name)
        if box is not None and box.label.state != "rejected":
            moment = TrackFrame(each.key, store.drives.time_s(each.key), store.drives.pose(each.key))
            found.append((moment, box))
    posed = all(moment.world_T_frame is not None for moment, _ in found)
    rows = store.drives
    steps = [
        TrackStep(
            rows.place(moment.key).row, moment.time_s, to_world(box.label.box, moment) if posed else box.label.box
        )
        for moment, box in found
    ]
    locked = bool((store.value(track_cell(drive, track)) or {}).get("locked"))
    return NearbyTrack(steps, len({each.row for each in seen}), posed=posed, locked=locked)


def all_findings(store: Store, settings: CheckSettings) -> Iterator[LabelIssue]:
    """Findings of every frame, without points: frame by frame, in the data set's order."""
    for key in store.keys:
        yield from findings(store, key, settings)
