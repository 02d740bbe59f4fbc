"""Boxes of one object from frame to frame, in the world where its frames' poses are known.

Pure functions of numbers: what they are called with and what becomes of their boxes is the caller's.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from farfield.datasets.labels import Numbers
from farfield.frame import Key
from farfield.geometry.poses import invert
from farfield.vocabulary.counts import count_of

Pose = Float[np.ndarray, "4 4"]
WINDOW_M, WINDOW_S = 1.0, 0.5
"""An object is looked for within 1 m of where its motion takes it, and half of the way that it goes meanwhile."""
START_M_S = 20.0
"""An object of which one place is known, and so no speed, is looked for along its heading as far as this takes it."""
FEWEST_POINTS, LONGEST_BLIND = 3, 5
"""With fewer points over so many frames, an object is lost."""
BEND = 0.7
"""How much of the bend that the neighbouring keyframes suggest is believed: chosen on K-Radar's sequences 1, 21 and 54,
where it takes 0 to 20 % off the error (p95) with keyframes 1 to 3 s apart."""
KEYFRAMES = 3
"""So many places give the velocity."""


class TrackFrame(NamedTuple):
    """A frame of a drive.

    Args:
        key: The frame.
        time_s: When, seconds.
        world_T_frame: From where it was seen; None where that is not known: the sensor is taken to stand still.
    """

    key: Key
    time_s: float
    world_T_frame: Pose | None


def transform_box(box: Numbers, target_T_source: Pose) -> Numbers:
    """A box in other coordinates; its heading is that of its moved length axis, seen from above."""
    rotation = target_T_source[:3, :3]
    heading = rotation @ np.array([np.cos(box[6]), np.sin(box[6]), 0.0])
    x, y, z = (rotation @ np.array(box[:3]) + target_T_source[:3, 3]).tolist()
    return x, y, z, box[3], box[4], box[5], wrap_yaw(float(np.arctan2(heading[1], heading[0])))


def to_world(box: Numbers, moment: TrackFrame) -> Numbers:
    """A frame's box in the world."""
    return box if moment.world_T_frame is None else transform_box(box, moment.world_T_frame)


def from_world(box: Numbers, moment: TrackFrame) -> Numbers:
    """A box of the world in a frame's coordinates."""
    return box if moment.world_T_frame is None else transform_box(box, invert(moment.world_T_frame))


def carry_box(box: Numbers, source: TrackFrame, target: TrackFrame) -> Numbers:
    """A box that stands still in the world, in the coordinates of another frame."""
    if source.world_T_frame is None or target.world_T_frame is None:
        return box
    return from_world(to_world(box, source), target)


def interpolate(
    keyframes: Sequence[tuple[TrackFrame, Numbers]],
    moments: Sequence[TrackFrame],
    size_m: Sequence[float] | None = None,
) -> dict[Key, Numbers]:
    """Boxes in the frames between keyframes: places along a smooth curve, headings the shorter way.

    Interpolated in the world where every pose is known: with keyframes a second apart, real K-Radar tracks are off by
    0.35 m (p95, sequence 21) instead of 0.41 m in the sensor's coordinates, which turn with the vehicle; with keyframes
    three seconds apart by 0.6 instead of 2.5 m. The curve is a cubic through the keyframes; its speed at each is drawn
    from that of the straight lines towards that of its neighbours (see :data:`BEND`).

    Args:
        keyframes: Two or more frames with their boxes, in the order of time.
        moments: The frames wanted; those outside the keyframes, and keyframes themselves, get no box.
        size_m: Length, width and height; None: going over from one keyframe's to the next's.
    """
    posed = all(moment.world_T_frame is not None for moment in (*moments, *(moment for moment, _ in keyframes)))
    times_s = np.array([moment.time_s for moment, _ in keyframes])
    world_boxes = [to_world(box, moment) if posed else box for moment, box in keyframes]
    centres = np.array([box[:3] for box in world_boxes])
    speeds = np.gradient(centres, times_s, axis=0)
    boxes: dict[Key, Numbers] = {}
    for moment in moments:
        after = int(np.searchsorted(times_s, moment.time_s))
        if 0 < after < len(times_s) and moment.time_s != times_s[after]:
            part = slice(after - 1, after + 1)
            x, y, z = _curve(times_s[part], centres[part], speeds[part], moment.time_s)
            share = float((moment.time_s - times_s[after - 1]) / (times_s[after] - times_s[after - 1]))
            box = (x, y, z, *_size_and_yaw(world_boxes[after - 1], world_boxes[after], share, size_m))
            boxes[moment.key] = from_world(box, moment) if posed else box
    return boxes


def _curve(
    times_s: Float[np.ndarray, " 2"], centres_m: Float[np.ndarray, "2 3"], speeds: Float[np.ndarray, "2 3"], at_s: float
) -> tuple[float, float, float]:
    """A place on the cubic (Hermite) between two places with their speeds."""
    length_s = float(times_s[1] - times_s[0])
    s = (at_s - float(times_s[0])) / length_s
    straight = (centres_m[1] - centres_m[0]) / length_s
    first, last = straight + BEND * (speeds - straight)
    x, y, z = (
        centres_m[0]
        + s * s * (3 - 2 * s) * (centres_m[1] - centres_m[0])
        + s * (1 - s) * length_s * ((1 - s) * first - s * last)
    ).tolist()
    return x, y, z


def _size_and_yaw(
    first: Numbers, second: Numbers, share: float, size_m: Sequence[float] | None
) -> tuple[float, float, float, float]:
    """Size and heading a share of the way between two boxes."""
    between_m = (before + share * (after - before) for before, after in zip(first[3:6], second[3:6], strict=True))
    length, width, height = between_m if size_m is None else (float(size) for size in size_m)
    return length, width, height, wrap_yaw(first[6] + share * turn_angle(first[6], second[6]))


class RefitBox(NamedTuple):
    """What a refit gave.

    Args:
        box: The box, or None where nothing was found.
        points: Points in it.
    """

    box: Numbers | None
    points: int


Refit = Callable[[Key, Numbers, float], RefitBox]
"""Fits an object again: the frame, where it is expected (size and yaw included), how far from there at most."""


class PropagatedTrack(NamedTuple):
    """Where an object went.

    Args:
        boxes: Its boxes, in the frames' order.
        message: Why it ended before the last frame, or where its motion alone placed it; empty if neither happened.
        predicted: Frames in which its motion alone placed it.
    """

    boxes: Mapping[Key, Numbers]
    message: str = ""
    predicted: frozenset[Key] = frozenset()


def propagate(
    keyframes: Sequence[tuple[TrackFrame, Numbers]],
    moments: Sequence[TrackFrame],
    refit: Refit | None = None,
    *,
    later_keyframes: Mapping[Key, Numbers] | None = None,
    always: bool = False,
) -> PropagatedTrack:
    """Carry an object on by constant velocity, fitted again in every frame.

    It stops where the object has fewer than 3 points over 5 frames (those are left out), or is found farther from
    where its motion takes it than three times what is usual (the window). Of one place alone no speed is known: the
    object may then have gone as far along its heading as at 20 m/s.

    Args:
        keyframes: Frames with boxes that a person stands for; the velocity is that of the last 3, nearest last.
        moments: Frames to go on to, the nearest first; backwards in time too.
        refit: Fits the object; None: it goes where its motion takes it.
        later_keyframes: Keyframes among ``moments``: they are kept, and it goes on from them.
        always: Place it in every frame, by its motion alone where the points do not decide.
    """
    trail = [(moment.time_s, to_world(box, moment)) for moment, box in keyframes][-KEYFRAMES:]
    boxes: dict[Key, Numbers] = {}
    blind: list[Key] = []
    predicted: set[Key] = set()
    message = ""
    for moment in moments:
        if later_keyframes and moment.key in later_keyframes:
            trail, blind = [*trail[1 - KEYFRAMES :], (moment.time_s, to_world(later_keyframes[moment.key], moment))], []
            continue
        # Predict by constant velocity, and fit within the window about the prediction.
        expected, speed = _expected(trail, moment.time_s)
        window_m = WINDOW_M + WINDOW_S * speed * abs(moment.time_s - trail[-1][0])
        guess = from_world(expected, moment)
        start_m = START_M_S * abs(moment.time_s - trail[-1][0])
        reach_m = window_m + (start_m if len(trail) == 1 else 0.0)
        fit = RefitBox(guess, FEWEST_POINTS) if refit is None else refit(moment.key, guess, reach_m)
        # Too few points: coast on the prediction, for 5 frames at most.
        if fit.box is None or fit.points < FEWEST_POINTS:
            boxes[moment.key] = guess
            predicted.add(moment.key)
            if always:
                message = _predicted_message(
                    moment.key, f"{count_of(fit.points, 'point is', 'points are')} too few to place the object"
                )
                trail = [*trail[1 - KEYFRAMES :], (moment.time_s, expected)]
                continue
            blind.append(moment.key)
            if len(blind) == LONGEST_BLIND:
                return PropagatedTrack(_without(boxes, blind), _lost_message(blind[0]), frozenset(predicted))
            continue
        # Farther off than its motion allows: it is another object.
        off_m = _off_m(fit.box, guess, start_m if len(trail) == 1 else 0.0)
        if off_m > window_m and always:
            boxes[moment.key] = guess
            predicted.add(moment.key)
            message = _predicted_message(moment.key, f"the points lie {off_m:.1f} m from there")
            trail = [*trail[1 - KEYFRAMES :], (moment.time_s, expected)]
            continue
        if off_m > window_m:
            return PropagatedTrack(
                _without(boxes, blind), _off_track_message(moment.key, off_m, window_m), frozenset(predicted)
            )
        # Update the trail, from which the next velocity is estimated.
        blind = []
        boxes[moment.key] = fit.box
        trail = [*trail[1 - KEYFRAMES :], (moment.time_s, to_world(fit.box, moment))]
    if blind and refit is not None:
        message = _lost_message(blind[0])
    return PropagatedTrack(_without(boxes, blind), message, frozenset(predicted))


def _off_m(box: Numbers, guess: Numbers, free_m: float) -> float:
    """How far a box lies from where it is expected, seen from above; along its heading so much is free."""
    away_m = np.array([box[0] - guess[0], box[1] - guess[1]])
    ahead = np.array([np.cos(guess[6]), np.sin(guess[6])])
    along_m = float(away_m @ ahead)
    return float(np.hypot(max(0.0, abs(along_m) - free_m), np.linalg.norm(away_m - along_m * ahead)))


def _expected(trail: Sequence[tuple[float, Numbers]], time_s: float) -> tuple[Numbers, float]:
    """Where an object is at a time, in the world, and its speed: the last place and the mean velocity."""
    last_s, last = trail[-1]
    times = np.array([when for when, _ in trail]) - last_s
    places = np.array([box[:3] for _, box in trail])
    velocity = np.zeros(3)
    if len(trail) > 1 and np.ptp(times) > 0:
        centred = times - times.mean()
        velocity = centred @ (places - places.mean(axis=0)) / (centred @ centred)
    x, y, z = (np.array(last[:3]) + velocity * (time_s - last_s)).tolist()
    return (x, y, z, *last[3:]), float(np.hypot(velocity[0], velocity[1]))


def _without(boxes: Mapping[Key, Numbers], blind: Sequence[Key]) -> dict[Key, Numbers]:
    return {key: box for key, box in boxes.items() if key not in blind}


def _lost_message(key: Key) -> str:
    return f"The object is lost from frame {key[1]} on: fewer than {FEWEST_POINTS} points in each."


def _predicted_message(key: Key, reason: str) -> str:
    return f"In frame {key[1]} {reason}: the box stands where the motion takes it. Look at it."


def _off_track_message(key: Key, off_m: float, window_m: float) -> str:
    return (
        f"In frame {key[1]} the points lie {off_m:.1f} m from where the motion takes the object, more than "
        f"{window_m:.1f} m: set a keyframe there, or end the track."
    )


def wrap_yaw(yaw_rad: float) -> float:
    """A yaw in [-pi, pi); one that lies there keeps every bit.

    >>> wrapped(3 * math.pi / 2) == -math.pi / 2
    True
    """
    if -math.pi <= yaw_rad < math.pi:
        return yaw_rad
    turned = (yaw_rad + math.pi) % (2 * math.pi) - math.pi
    return turned if turned < math.pi else -math.pi


def turn_angle(before_rad: float, after_rad: float) -> float:
    """How far a heading turns from one to another, the shorter way, in [-pi, pi).

    >>> round(turn(3.0, -3.0), 3)
    0.283
    """
    return wrap_yaw(after_rad - before_rad)
