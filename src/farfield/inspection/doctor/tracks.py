"""Identities over time: classes that change, boxes that jump, headings that flip, velocities in another unit."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from farfield.geometry.poses import transform_points
from farfield.inspection.doctor.survey import Finding, FrameFacts, Survey
from farfield.vocabulary.counts import count_of

_JUMP_M, _FASTEST_M_S, _JUMP_STEPS = 30.0, 100.0, 10.0
_FLIP_RAD, _FLIP_S, _LONG_M = 2.6, 1.0, 3.0
_UNITS = {"km/h": 3.6, "miles an hour": 2.237, "feet a second": 3.281}
_RATIO_SPREAD, _LEAST_RATIOS, _MOVING_M_S = 0.05, 3, 1.0


@dataclass(frozen=True, eq=False, kw_only=True)
class _TrackStep:
    """One identity in two annotated frames that follow each other."""

    track: int
    frames: tuple[FrameFacts, FrameFacts]
    labels: tuple[str, str]
    centres_m: Float[np.ndarray, "2 3"]  # in the world where both poses are known
    yaw_rad: tuple[float, float]
    length_m: float
    velocity_m_s: Float[np.ndarray, " axes"] | None

    @property
    def moved_m(self) -> float:
        return float(np.linalg.norm(self.centres_m[1, :2] - self.centres_m[0, :2]))

    @property
    def seconds(self) -> float | None:
        before, after = (frame.time_ns for frame in self.frames)
        return None if before is None or after is None or after <= before else (after - before) / 1e9


def check_motion(survey: Survey, facts: dict[str, Any]) -> Iterator[Finding]:
    """Hold what each identity does between frames against what road users can do."""
    steps = list(_steps(survey))
    if not steps:
        return
    facts["track_steps"] = len(steps)
    yield from _changed_classes(steps)
    yield from _jumps(steps)
    yield from _flips(steps)
    yield from _units_of_velocities(steps)


def _steps(survey: Survey) -> Iterator[_TrackStep]:
    """Each identity's pairs of frames, in the order of the data set."""
    last: dict[tuple[str, int], tuple[FrameFacts, Any, int]] = {}
    for frame, boxes in zip(survey.box_frames, survey.boxes, strict=True):
        for row, track in enumerate([] if boxes.track_id is None else boxes.track_id.tolist()):
            if track < 0:
                continue
            before = last.get((frame.key[0], track))
            last[frame.key[0], track] = (frame, boxes, row)
            if before is None or before[0] is frame:
                continue
            frames, both = (before[0], frame), ((before[1], before[2]), (boxes, row))
            centres_m = np.stack([part.centre_m[at] for part, at in both]).astype(np.float64)
            poses = [one.world_T_frame for one in frames if one.world_T_frame is not None]
            if len(poses) == 2:
                centres_m = np.concatenate(
                    [transform_points(pose, centre[None]) for pose, centre in zip(poses, centres_m, strict=True)]
                )
            yield _TrackStep(
                track=track,
                frames=frames,
                labels=(str(both[0][0].label[both[0][1]]), str(boxes.label[row])),
                centres_m=centres_m,
                yaw_rad=(float(both[0][0].yaw_rad[both[0][1]]), float(boxes.yaw_rad[row])),
                length_m=float(boxes.size_m[row, 0]),
                velocity_m_s=None if boxes.velocity_m_s is None else boxes.velocity_m_s[row],
            )


def _named(step: _TrackStep) -> str:
    """The identity and the two frames of a step."""
    return f"track {step.track} from frame {step.frames[0].key[1]} to {step.frames[1].key[1]}"


def _changed_classes(steps: Sequence[_TrackStep]) -> Iterator[Finding]:
    changed = [step for step in steps if step.labels[0] != step.labels[1]]
    if changed:
        tracks = {(step.frames[0].key[0], step.track) for step in changed}
        first = changed[0]
        yield Finding(
            severity="warn",
            topic="tracks",
            what=f"{count_of(len(tracks), 'track')} with several classes, such as {first.labels[0]} and "
            f"{first.labels[1]}: {_named(first)}",
            where=first.frames[0].key[0],
            fix="An identity is one object of one class: give one of the two another number, or mend its class.",
        )


def _jumps(steps: Sequence[_TrackStep]) -> Iterator[Finding]:
    usual_m = float(np.median([step.moved_m for step in steps]))
    jumps = [
        step
        for step in steps
        if step.moved_m > _JUMP_M
        and (
            step.moved_m > _JUMP_STEPS * usual_m if step.seconds is None else step.moved_m > _FASTEST_M_S * step.seconds
        )
    ]
    if jumps:
        worst = max(jumps, key=lambda step: step.moved_m)
        yield Finding(
            severity="warn",
            topic="tracks",
            what=f"{count_of(len(jumps), 'jump')} that no road user makes, the farthest of {worst.moved_m:.0f} m: "
            f"{_named(worst)}",
            where=worst.frames[0].key[0],
            fix="A number was used again for another object, a coordinate slipped, or frames are missing between.",
        )


def _flips(steps: Sequence[_TrackStep]) -> Iterator[Finding]:
    flips = [
        step
        for step in steps
        if step.length_m > _LONG_M
        and (step.seconds is None or step.seconds <= _FLIP_S)
        and abs((step.yaw_rad[1] - step.yaw_rad[0] + np.pi) % (2 * np.pi) - np.pi) > _FLIP_RAD
    ]
    if flips:
        yield Finding(
            severity="warn",
            topic="tracks",
            what=f"{count_of(len(flips), 'heading')} of {count_of(len(steps), 'step')} turns to its opposite: "
            f"{_named(flips[0])}",
            where=flips[0].frames[0].key[0],
            fix="Front and back were exchanged in some frames: headings, velocities and their errors are wrong there.",
        )


def _units_of_velocities(steps: Sequence[_TrackStep]) -> Iterator[Finding]:
    """A ratio of one size between the velocities that are given and those of the places is another unit's."""
    ratios = []
    for step in steps:
        if step.velocity_m_s is None or step.seconds is None or not np.isfinite(step.velocity_m_s).all():
            continue
        speed_m_s = step.moved_m / step.seconds
        if speed_m_s > _MOVING_M_S:
            ratios.append(float(np.linalg.norm(step.velocity_m_s[:2])) / speed_m_s)
    if len(ratios) < _LEAST_RATIOS:
        return
    low, middle, high = np.quantile(ratios, [0.1, 0.5, 0.9])
    unit = next((name for name, factor in _UNITS.items() if abs(middle / factor - 1) < _RATIO_SPREAD), "")
    if unit and high - low < 4 * _RATIO_SPREAD * middle:
        yield Finding(
            severity="warn",
            topic="velocities",
            what=f"the velocities are {middle:.2f} times what the tracks do: they seem to be in {unit}",
            fix=f"Velocities are in m/s: divide them by {_UNITS[unit]:g}.",
        )
