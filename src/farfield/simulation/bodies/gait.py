"""How bodies move with the distance they have covered: legs, arms, cranks, paws.

A gait cycle is two steps (a turn of the cranks). Feet swing as a sine of the cycle's phase about the hip, so far
that a step covers half a cycle's distance; a sine makes the feet's greatest speed 1 + pi / 2 times that of the body.
"""

import numpy as np
from jaxtyping import Float

from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import Mesh, Triple, box, tube

PHASES = 16
_CLOTH, _SKIN, _TRIM = int(Material.CLOTH), int(Material.SKIN), int(Material.TRIM)


def cycle_length_m(kind: str, size_m: tuple[float, float, float]) -> float:
    """Distance covered in one cycle: 0.83 of the stature for people (Winter, 1990), a geared crank's turn for cyclists.

    Returns:
        Metres, or 0.0 for bodies that do not change their shape as they move.
    """
    if kind in ("pedestrian", "child", "stroller"):
        return 0.83 * size_m[2]
    if kind == "cyclist":
        return 5.0
    return 1.1 * size_m[0] if kind in ("animal", "deer") else 0.0


def limb(start: Triple, end: Triple, radius: float, material: int = _CLOTH) -> Mesh:
    """A capsule between two joints."""
    return tube(start, end, radius, material, sides=6, round_ends=True)


def bent(
    start_m: Float[np.ndarray, " 3"], end_m: Float[np.ndarray, " 3"], upper_m: float, lower_m: float, forward: float
) -> Float[np.ndarray, " 3"]:
    """The joint between two bones in the x-z plane (knee: ``forward`` 1, elbow: -1); a stretched limb is straight.

    Args:
        start_m: Hip or shoulder.
        end_m: Ankle or hand.
        upper_m: Length of the upper bone.
        lower_m: Length of the lower bone.
        forward: To which side of the line the joint bends.
    """
    line = end_m - start_m
    reach = float(np.linalg.norm(line))
    along = float(np.clip((upper_m**2 - lower_m**2 + reach**2) / (2 * reach), 0.0, upper_m))
    aside = np.sqrt(max(upper_m**2 - along**2, 0.0)) * (reach < upper_m + lower_m)
    unit = line / reach
    joint: Float[np.ndarray, " 3"] = start_m + along * unit + forward * aside * np.array([-unit[2], 0.0, unit[0]])
    return joint


def ankle_m(phase: float, side: int, half_step_m: float) -> Float[np.ndarray, " 3"]:
    """Where an ankle is, for a person of 1.75 m, relative to the ground below the hips.

    Args:
        phase: Phase of the cycle; the left foot (``side`` 1) is furthest forward at 0.25, the right one at 0.75.
        side: 1 left, -1 right.
        half_step_m: Greatest distance of a foot before and behind the hip.
    """
    turn = 2 * np.pi * (phase + (0.0 if side > 0 else 0.5))
    lift = 0.28 * half_step_m * max(float(np.cos(turn)), 0.0)
    return np.array([half_step_m * np.sin(turn), 0.09 * side, 0.07 + lift])


def walking_legs(phase: float, half_step_m: float, x_m: float = 0.0) -> list[Mesh]:
    """Two legs with knees and shoes."""
    parts: list[Mesh] = []
    for side in (1, -1):
        hip, ankle = np.array([x_m, 0.09 * side, 0.88]), ankle_m(phase, side, half_step_m) + np.array([x_m, 0.0, 0.0])
        knee = bent(hip, ankle, 0.44, 0.44, 1.0)
        parts += [limb(hip.tolist(), knee.tolist(), 0.085), limb(knee.tolist(), ankle.tolist(), 0.06)]
        parts.append(box([0.25, 0.09, 0.07], [ankle[0] + 0.05, ankle[1], ankle[2] - 0.035], _TRIM))
    return parts


def swinging_arms(phase: float, half_swing_m: float) -> list[Mesh]:
    """Two arms, each swinging against the leg of its side."""
    parts: list[Mesh] = []
    for side in (1, -1):
        swing = -side * half_swing_m * float(np.sin(2 * np.pi * phase))
        elbow = [0.4 * swing - 0.02, 0.25 * side, 1.14]
        hand = [swing + 0.02, 0.26 * side, 0.88]
        parts += [limb([0.0, 0.20 * side, 1.41], elbow, 0.055), limb(elbow, hand, 0.042)]
        parts.append(box([0.08, 0.05, 0.10], [hand[0], hand[1], hand[2] - 0.03], _SKIN))
    return parts


def pedalling_legs(phase: float, hip_m: Triple, crank_m: Triple, crank_length_m: float) -> list[Mesh]:
    """Two legs on cranks half a turn apart."""
    parts: list[Mesh] = []
    for side in (1, -1):
        turn = -2 * np.pi * (phase + (0.0 if side > 0 else 0.5))
        hip = np.array([hip_m[0], 0.09 * side, hip_m[2]])
        pedal = np.array(crank_m) + crank_length_m * np.array([np.cos(turn), 0.0, np.sin(turn)])
        foot = pedal + np.array([-0.04, 0.12 * side, 0.06])
        knee = bent(hip, foot, 0.44, 0.46, 1.0) * [1, 0, 1] + [0, 0.12 * side, 0]
        parts += [limb(hip.tolist(), knee.tolist(), 0.08), limb(knee.tolist(), foot.tolist(), 0.055)]
        parts.append(box([0.22, 0.08, 0.06], [foot[0] + 0.05, foot[1], foot[2] - 0.03], _TRIM))
    return parts
