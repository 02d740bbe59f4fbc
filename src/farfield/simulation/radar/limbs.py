"""Micro-Doppler of people: points of a walker's and a cyclist's body, swinging as sines.

A walker's foot stands still while it bears weight, so relative to the body it swings by a quarter of the stride to each
side; knees, hands and elbows follow at 0.5, 0.6 and 0.35 of that, arms against legs. A cyclist's feet turn at 170 mm
cranks, 5 m for each turn; the wheels' rims run at the riding speed.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from farfield.simulation.bodies.actors import Actor
from farfield.simulation.radar.echoes import ScattererKind
from farfield.simulation.radar.points import ScatterPoints

_DEVELOPMENT_M, _CRANK_M, _WHEEL_M = 5.0, 0.17, 0.34


class _LimbPart(NamedTuple):
    height: float  # share of the body's height
    side: float  # share of the body's width, from the middle to the left
    swing: float  # of the foot's
    phase: float  # turns
    share: float  # of the cross section


_WALKER = (
    _LimbPart(0.93, 0.0, 0.0, 0.0, 0.08),
    _LimbPart(0.78, 0.0, 0.0, 0.0, 0.25),
    _LimbPart(0.60, 0.0, 0.0, 0.0, 0.22),
    *(_LimbPart(0.62, side, 0.35, phase, 0.04) for side, phase in ((0.35, 0.5), (-0.35, 0.0))),
    *(_LimbPart(0.46, side, 0.60, phase, 0.03) for side, phase in ((0.38, 0.5), (-0.38, 0.0))),
    *(_LimbPart(0.28, side, 0.50, phase, 0.10) for side, phase in ((0.15, 0.0), (-0.15, 0.5))),
    *(_LimbPart(0.05, side, 1.00, phase, 0.055) for side, phase in ((0.15, 0.0), (-0.15, 0.5))),
)


def limb_points(
    actor: Actor,
    base_m: Float[np.ndarray, " 3"],
    heading: Float[np.ndarray, " 3"],
    velocity_m_s: Float[np.ndarray, " 3"],
    time_s: float,
) -> ScatterPoints:
    """Eleven points of a walker or a cyclist, whose cross sections add up to 1.

    Args:
        actor: Whose body.
        base_m: Middle of its bottom, shape (3,).
        heading: Unit vector ahead, shape (3,), same axes.
        velocity_m_s: Its velocity, shape (3,), same axes.
        time_s: The moment; the phase of an individual's gait comes from its seed.
    """
    seed = actor.seed
    own = np.random.SeedSequence(entropy=seed.entropy, spawn_key=(*seed.spawn_key, 0x6A17))
    start = float(np.random.default_rng(own).random())
    speed = float(np.linalg.norm(velocity_m_s))
    offset, swing, share = (_riding if actor.label == "bicycle" else _walking)(actor, speed, time_s, start)
    up = np.array([0.0, 0.0, 1.0])
    left = np.cross(up, heading)
    axes = np.stack([heading, left / max(float(np.linalg.norm(left)), 1e-9), up])
    still = ScatterPoints.fixed(base_m + offset @ axes, share, ScattererKind.LIMB)
    return ScatterPoints(still.position_m, velocity_m_s + swing @ axes, share, still.actor, still.kind)


_Swing = tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]


def _walking(actor: Actor, speed: float, time_s: float, start: float) -> _Swing:
    parts = np.array(_WALKER)
    height, side, swing, phase, share = parts.T
    stride_m = max(actor.cycle_m, 0.7 * actor.size_m[2])
    turn = 2 * np.pi * (speed * time_s / stride_m + start + phase)
    reach = stride_m / 4 * swing if speed > 0.1 else np.zeros(len(parts))
    offset = np.stack([reach * np.sin(turn), side * actor.size_m[1], height * actor.size_m[2]], axis=1)
    ahead = reach * np.cos(turn) * 2 * np.pi * speed / stride_m
    return offset, np.stack([ahead, 0 * ahead, 0 * ahead], axis=1), share


def _riding(actor: Actor, speed: float, time_s: float, start: float) -> _Swing:
    length, width, height = actor.size_m
    body = np.array([[0.0, 0.0, 0.95], [-0.05, 0.0, 0.75], [-0.1, 0.0, 0.6], [0.1, 0.0, 0.45], [-0.1, 0.0, 0.4]])
    crank = 2 * np.pi * (speed * time_s / _DEVELOPMENT_M + start + np.array([0.0, 0.5]))
    feet = np.stack(
        [_CRANK_M * np.sin(crank) - 0.08, 0.2 * width * np.array([1, -1]), 0.3 + _CRANK_M * np.cos(crank)], 1
    )
    pedal = 2 * np.pi * speed / _DEVELOPMENT_M * _CRANK_M
    feet_speed = np.stack([pedal * np.cos(crank), 0 * crank, -pedal * np.sin(crank)], 1)
    rim = speed * time_s / _WHEEL_M + 2 * np.pi * (start + np.array([0.0, 0.5, 0.25, 0.75]))
    hub = length / 2 - _WHEEL_M
    wheels = np.stack(
        [np.array([hub, hub, -hub, -hub]) + _WHEEL_M * np.sin(rim), 0 * rim, _WHEEL_M * (1 + np.cos(rim))], 1
    )
    wheel_speed = np.stack([speed * np.cos(rim), 0 * rim, -speed * np.sin(rim)], 1)
    offset = np.concatenate([body * [1.0, 1.0, height], feet, wheels])
    swing = np.concatenate([np.zeros((5, 3)), feet_speed, wheel_speed])
    share = np.array([0.08, 0.2, 0.2, 0.11, 0.11, 0.07, 0.07, 0.04, 0.04, 0.04, 0.04])
    return offset, swing, share
