"""The frames of a tracked drive: their order, time steps and poses, from a data set's drives or from names alone."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from farfield.errors import ConfigError
from farfield.frame.drive import Drive, Key
from farfield.metrics.detections import Detections
from farfield.metrics.frames import frame_order
from farfield.vocabulary.counts import count_of


@dataclass(frozen=True, eq=False, kw_only=True)
class Timeline:
    """The frames of a drive in the order of time.

    Args:
        keys: (sequence, frame) of each.
        step_s: Seconds since the frame before, shape (n,).
        stamped: Whether these come from stamps.
        world_T_frame: Poses, shape (n, 4, 4), or None.
    """

    keys: tuple[Key, ...]
    step_s: Float[np.ndarray, " n"]
    stamped: bool
    world_T_frame: Float[np.ndarray, "n 4 4"] | None

    @cached_property
    def sensor_velocity_m_s(self) -> Float[np.ndarray, "n 3"]:
        """The sensor's own velocity in the world since the frame before; 0 where tracks are kept relative to it."""
        velocity = np.zeros((len(self.keys), 3))
        if self.world_T_frame is not None and len(self.keys) > 1:
            velocity[1:] = np.diff(self.world_T_frame[:, :3, 3], axis=0) / np.maximum(self.step_s[1:, None], 1e-9)
            velocity[0] = velocity[1]
        return velocity


def timelines(detections: Detections, *, step_s: float, ego_motion: bool = True) -> list[Timeline]:
    """The drives of detections, those of ``detections.drives`` or the sequences.

    Args:
        detections: The detections.
        step_s: Seconds between frames where there are no stamps.
        ego_motion: Whether poses are taken, where there are any.
    """
    if detections.drives:
        return [_drive_timeline(drive, step_s, ego_motion) for drive in detections.drives]
    by_sequence: dict[str, list[Key]] = {}
    for key in sorted({*detections.boxes, *detections.annotations}, key=frame_order):
        by_sequence.setdefault(key[0], []).append(key)
    sequences = [_with_missing_numbers(keys) for keys in by_sequence.values()]
    return [
        Timeline(keys=keys, step_s=np.full(len(keys), step_s), stamped=False, world_T_frame=None) for keys in sequences
    ]


def _drive_timeline(drive: Drive, step_s: float, ego_motion: bool) -> Timeline:
    steps = np.full(len(drive.keys), step_s)
    if drive.times_ns is not None:
        steps = np.diff(drive.times_ns, prepend=drive.times_ns[:1]) / 1e9
    pose = drive.world_T_frame if ego_motion else None
    return Timeline(keys=drive.keys, step_s=steps, stamped=drive.times_ns is not None, world_T_frame=pose)


def assumption_notes(drives: Sequence[Timeline], *, seconds: bool, ego_motion: bool, step_s: float) -> list[str]:
    """What tracking assumes where stamps or poses are missing, a sentence each."""
    notes = []
    if seconds and not all(drive.stamped for drive in drives):
        notes.append(f"tracked with steps of {step_s:g} s, as the data have no stamps")
    if ego_motion and any(drive.world_T_frame is None for drive in drives):
        notes.append("tracked in the sensor's own coordinates, as the data have no poses (see the preset unposed)")
    return notes


def input_notes(detections: Detections, *, ego_motion: bool, least_score: float | None) -> list[str]:
    """What in the detections and their drives' poses makes tracks wrong, a sentence each.

    Args:
        detections: The detections.
        ego_motion: Whether poses are taken.
        least_score: As of :class:`farfield.tracking.presets.TrackerSettings`.
    """
    drives = (detections.drives or ()) if ego_motion else ()
    notes = [f"{drive.name}: {issue}" for drive in drives for issue in drive.odd_poses()]
    highest = max(
        (float(boxes.score.max(initial=-np.inf)) for boxes in detections.boxes.values() if boxes.score is not None),
        default=-np.inf,
    )
    if least_score is not None and np.isfinite(highest) and highest < least_score:
        notes.append(
            f"no detection has a score of {least_score:g} or more (least_score, --least-score): the highest is "
            f"{highest:g}, and nothing is tracked"
        )
    return notes


def unreported_note(
    drives: Sequence[Timeline], *, boxes: int, reported: int, min_hits: int, unsure_hits: int, sure_score: float | None
) -> list[str]:
    """That a track needs matches before it is reported, where many detections are in none or drives are short.

    Args:
        drives: The drives.
        boxes: Number of detections.
        reported: Number of boxes of reported tracks.
        min_hits: As of :class:`farfield.tracking.presets.TrackerSettings`.
        unsure_hits: Likewise.
        sure_score: Likewise.
    """
    needed = max(min_hits, unsure_hits if sure_score is not None else 1)
    shortest = min((len(drive.keys) for drive in drives), default=0)
    missing = boxes - reported
    if needed <= 1 or missing <= 0 or (shortest >= 2 * needed and 2 * missing <= boxes):
        return []
    hits = f"{min_hits} hits (min_hits)"
    options = ["-o min_hits=1"] if min_hits > 1 else []
    if sure_score is not None and unsure_hits > 1:
        hits += f", with scores below {sure_score:g} {unsure_hits} hits (unsure_hits)"
        options.append("-o unsure_hits=1")
    short = f", and the shortest drive has {count_of(shortest, 'frame')}" if shortest < 2 * needed else ""
    return [
        f"{missing} of {count_of(boxes, 'detection')} are in no reported track: a track needs {hits}{short}; "
        f"{' '.join(options)} reports every one"
    ]


def _with_missing_numbers(keys: list[Key]) -> tuple[Key, ...]:
    """Keys of a sequence with those of the whole numbers that are missing between 0 and the last."""
    names = [frame for _, frame in keys]
    if not all(map(is_number, names)):
        return tuple(keys)
    width = len(names[0]) if len({len(name) for name in names}) == 1 else 0
    present = {int(frame): (sequence, frame) for sequence, frame in keys}
    return tuple(present.get(n, (keys[0][0], f"{n:0{width}d}")) for n in range(max(present) + 1))


def is_number(name: str) -> bool:
    """Whether a frame is named by a whole number."""
    return name.isascii() and name.isdigit() and len(name) <= 9


def with_drives(detections: Detections, drives: Sequence[Drive]) -> Detections:
    """Detections with the drives that hold their frames.

    Args:
        detections: Detections by (sequence, frame).
        drives: The drives of a data set. Those without any of these frames are left out.

    Raises:
        ConfigError: If there are no drives, or others than drives, or a frame of the detections is in none.
    """
    if not all(isinstance(drive, Drive) for drive in drives):
        raise ConfigError("drives: expected a data set's drives, data.drives(); got something else")
    if not drives:
        raise ConfigError(
            "data: expected drives, frames in the order of time; this data set has none. Leave --data out"
        )
    keys = {key for drive in drives for key in drive.keys}
    absent = sorted(set(detections.boxes) - keys)
    if absent:
        first = next(iter(drives[0].keys), ("", ""))
        examples = ", ".join(f"{sequence}/{frame}" for sequence, frame in absent[:3])
        raise ConfigError(
            f"data: expected the detections' frames among the data set's, whose first is {first[0]}/{first[1]}; "
            f"{len(absent)} of {len(detections.boxes)} are not there: {examples}. "
            "Detect on this data set, or name sequences and frames as it does"
        )
    return replace(
        detections, drives=tuple(drive for drive in drives if not set(drive.keys).isdisjoint(detections.boxes))
    )
