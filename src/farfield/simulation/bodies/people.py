"""Pedestrians, cyclists, motorcyclists, people on wheels and animals, from capsules, rings and boxes, in motion.

``phase`` is the phase of the gait, or None for a body that stands. The
size of a walker is that of its whole cycle: every phase is scaled as the widest one, in which the feet are furthest
apart.

A gait cycle is two steps (a turn of the cranks). Feet swing as a sine of the cycle's phase about the hip, so far that a
step covers half a cycle's distance; a sine makes the feet's greatest speed 1 + pi / 2 times that of the body.
"""

import numpy as np
from jaxtyping import Float

from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import Mesh, Triple, box, ellipsoid, quads, ring_tube, tube

_CLOTH, _SKIN, _METAL, _TYRE = (int(m) for m in (Material.CLOTH, Material.SKIN, Material.METAL, Material.TYRE))
_PAINT, _TRIM, _CARGO = int(Material.CAR_PAINT), int(Material.TRIM), int(Material.CARGO)
_LAMP, _PLATE = int(Material.LAMP), int(Material.PLATE)
_WIDEST = 0.25
_SQUARE = np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]]) / 2


def _person(phase: float, half_step: float, load: int, stoop: float) -> Mesh:
    parts = [
        limb([0, 0, 0.80], [stoop, 0, 1.46], 0.15),
        limb([stoop * 0.9, -0.13, 1.36], [stoop * 0.9, 0.13, 1.36], 0.10),
        ellipsoid([stoop + 0.03, 0, 1.635], [0.10, 0.08, 0.125], _SKIN, sides=8, rows=3),
        *walking_legs(phase, half_step),
        *swinging_arms(phase, 0.7 * half_step),
    ]
    if load == 1:
        parts.append(box([0.16, 0.3, 0.42], [-0.2, 0, 1.2], _CARGO))
    if load == 2:
        parts.append(box([0.30, 0.10, 0.24], [0.0, -0.33, 0.72], _CARGO))
    if load == 3:
        parts.append(tube([0, 0, 1.0], [0, 0, 0.62], (0.17, 0.26), _CLOTH, sides=8))
    return Mesh.merge(parts)


def build_pedestrian(size_m: Float[np.ndarray, " 3"], rng: np.random.Generator, phase: float | None = None) -> Mesh:
    """Build a walking or standing person: rucksack, bag, coat or nothing (about 400 triangles)."""
    load = int(rng.choice([0, 1, 2, 3], p=[0.45, 0.2, 0.15, 0.2]))
    stoop = float(rng.uniform(0.0, 0.05))
    if phase is None:
        return _person(_WIDEST, 0.06, load, stoop).fitted(size_m).painted(rng)
    widest = _person(_WIDEST, 0.33, load, stoop)
    return _person(phase, 0.33, load, stoop).fitted(size_m, like=widest).painted(rng)


def _upper_body(hip: Triple, lean: float, grip: Triple) -> list[Mesh]:
    """Trunk, head with a helmet, and arms that reach for a handlebar."""
    shoulder = [hip[0] + lean, 0.0, hip[2] + 0.52]
    head = [shoulder[0] + 0.06, 0.0, shoulder[2] + 0.24]
    parts = [limb(hip, shoulder, 0.15), ellipsoid(head, [0.12, 0.10, 0.14], _TRIM, sides=8, rows=3)]
    for side in (1, -1):
        hand = [grip[0], side * grip[1], grip[2]]
        elbow = [(shoulder[0] + hand[0]) / 2 - 0.03, side * 0.28, (shoulder[2] + hand[2]) / 2 - 0.05]
        parts += [limb([shoulder[0], side * 0.19, shoulder[2]], elbow, 0.05), limb(elbow, hand, 0.04)]
    return parts


def _seated_legs(hip: Triple, foot_z: float) -> list[Mesh]:
    parts: list[Mesh] = []
    for side in (1, -1):
        knee = [hip[0] + 0.38, side * 0.14, hip[2] - 0.10]
        parts.append(limb([hip[0], side * 0.09, hip[2]], knee, 0.08))
        parts.append(limb(knee, [hip[0] + 0.30, side * 0.14, foot_z], 0.06))
    return parts


def build_cyclist(size_m: Float[np.ndarray, " 3"], rng: np.random.Generator, phase: float | None = None) -> Mesh:
    """Build a rider on a bicycle: two tyres, frame, handlebar, and a pedalling person (about 600 triangles)."""
    parts = [ring_tube([x, 0, 0.34], 0.34, 0.045, _TYRE) for x in (0.52, -0.52)]
    rear, front, crank = [-0.52, 0, 0.34], [0.52, 0, 0.34], [-0.08, 0, 0.3]
    seat, head = [-0.2, 0, 0.92], [0.35, 0, 0.9]
    frame = [(rear, crank), (crank, seat), (seat, head), (crank, head), (rear, seat), (front, head)]
    parts += [tube(a, b, 0.022, _METAL, sides=4) for a, b in frame]
    parts.append(tube([0.38, -0.28, 1.02], [0.38, 0.28, 1.02], 0.02, _METAL, sides=4))
    lean, basket = float(rng.uniform(0.12, 0.4)), bool(rng.random() < 0.3)
    if basket:
        parts.append(box([0.25, 0.3, 0.22], [-0.48, 0, 0.85], _CARGO))
    parts.append(quads((np.array([-0.62 if basket else -0.35, 0, 0.74]) + _SQUARE * 0.06)[None], _LAMP))
    hip = [-0.2, 0.0, 0.98]
    parts += [*_upper_body(hip, lean, [0.38, 0.25, 1.03]), *pedalling_legs(phase or 0.0, hip, crank, 0.17)]
    return Mesh.merge(parts).fitted(size_m).painted(rng)


def build_motorcycle(size_m: Float[np.ndarray, " 3"], rng: np.random.Generator) -> Mesh:
    """Build a rider on a motorcycle or a scooter: two wheels, tank, engine, seat, lamps, sometimes a top box."""
    parts = [tube([x, -0.07, 0.31], [x, 0.07, 0.31], 0.31, _TYRE, sides=12) for x in (0.7, -0.7)]
    scooter, top_box = bool(rng.random() < 0.35), bool(rng.random() < 0.4)
    if scooter:
        parts.append(box([0.08, 0.45, 0.6], [0.42, 0, 0.65], _PAINT))
        parts.append(box([0.9, 0.34, 0.14], [-0.05, 0, 0.35], _PAINT))
    else:
        parts.append(ellipsoid([0.2, 0, 0.82], [0.35, 0.16, 0.16], _PAINT))
        parts.append(box([0.6, 0.3, 0.4], [0.05, 0, 0.5], _METAL))
    parts.append(box([0.75, 0.25, 0.12], [-0.4, 0, 0.8], _PAINT))
    if top_box:
        parts.append(box([0.32, 0.42, 0.34], [-0.72, 0, 1.02], _TRIM))
    parts.append(tube([0.72, 0, 0.31], [0.5, 0, 1.0], 0.04, _METAL, sides=5))
    parts.append(tube([0.48, -0.36, 1.02], [0.48, 0.36, 1.02], 0.02, _METAL, sides=4))
    parts.append(box([0.02, 0.2, 0.12], [-0.8, 0, 0.6], _PLATE))
    marks = [np.array([-0.79, 0, 0.75]) + _SQUARE * [0, 0.2, 0.08], np.array([0.66, 0, 0.9]) + _SQUARE * 0.15]
    parts.append(quads(np.stack(marks), _LAMP))
    hip = [-0.3, 0, 0.92]
    parts += [*_upper_body(hip, float(rng.uniform(0.1, 0.35)), [0.48, 0.33, 1.02]), *_seated_legs(hip, 0.4)]
    return Mesh.merge(parts).fitted(size_m).painted(rng)


def build_wheeled_person(size_m: Float[np.ndarray, " 3"], rng: np.random.Generator) -> Mesh:
    """Build a seated person in a wheelchair."""
    parts = [ring_tube([0.0, side * 0.3, 0.32], 0.32, 0.05, _TYRE) for side in (1, -1)]
    parts += [ring_tube([0.42, side * 0.22, 0.1], 0.1, 0.04, _TYRE, sides=8) for side in (1, -1)]
    parts.append(box([0.45, 0.5, 0.06], [0.05, 0, 0.5], _METAL))
    parts.append(box([0.05, 0.5, 0.45], [-0.2, 0, 0.75], _METAL))
    hip = [-0.05, 0, 0.58]
    parts += [*_upper_body(hip, float(rng.uniform(-0.05, 0.05)), [0.12, 0.3, 0.62]), *_seated_legs(hip, 0.12)]
    return Mesh.merge(parts).fitted(size_m).painted(rng)


def _with_pram(phase: float, half_step: float) -> Mesh:
    body = [
        limb([0, 0, 0.80], [0.04, 0, 1.46], 0.15),
        ellipsoid([0.07, 0, 1.635], [0.10, 0.08, 0.125], _SKIN, sides=8, rows=3),
        *walking_legs(phase, half_step),
    ]
    for side in (1, -1):
        body += [limb([0.03, 0.2 * side, 1.41], [0.2, 0.25 * side, 1.15], 0.05)]
        body += [limb([0.2, 0.25 * side, 1.15], [0.5, 0.22 * side, 1.02], 0.042)]
    wheels = [ring_tube([x, 0.25 * side, 0.13], 0.13, 0.05, _TYRE, sides=8) for x in (0.65, 1.15) for side in (1, -1)]
    pram = [box([0.65, 0.44, 0.35], [0.9, 0, 0.68], _CLOTH), ellipsoid([1.02, 0, 0.9], [0.25, 0.22, 0.2], _CLOTH)]
    bars = [tube([0.5, 0.22 * side, 1.02], [1.1, 0.22 * side, 0.15], 0.015, _METAL, sides=4) for side in (1, -1)]
    return Mesh.merge([*body, *wheels, *pram, *bars])


def build_stroller(size_m: Float[np.ndarray, " 3"], rng: np.random.Generator, phase: float | None = None) -> Mesh:
    """Build a person who pushes a pram."""
    widest = _with_pram(_WIDEST, 0.06 if phase is None else 0.33)
    mesh = widest if phase is None else _with_pram(phase, 0.33)
    return mesh.fitted(size_m, like=widest).painted(rng)


def _four_legs(phase: float, half_step: float, thick: float, neck: float) -> Mesh:
    parts = [
        limb([-0.36, 0, 0.62], [0.34, 0, 0.64], 0.16 * thick),
        limb([0.33, 0, 0.66], [0.46, 0, 0.74 + neck], 0.08 * thick),
        limb([0.42, 0, 0.76 + neck], [0.66, 0, 0.72 + neck], 0.07 * thick),
        limb([-0.40, 0, 0.68], [-0.58, 0, 0.60], 0.03),
    ]
    for x, y, lead in ((-0.3, 0.1, 0.0), (-0.3, -0.1, 0.5), (0.3, 0.1, 0.5), (0.3, -0.1, 0.0)):
        turn = 2 * np.pi * (phase + lead)
        paw = [x + half_step * np.sin(turn), y, 0.03 + 0.3 * half_step * max(float(np.cos(turn)), 0.0)]
        parts.append(limb([x, y, 0.58], paw, 0.045 * thick))
    return Mesh.merge(parts)


def build_animal(size_m: Float[np.ndarray, " 3"], rng: np.random.Generator, phase: float | None = None) -> Mesh:
    """Build a four-legged animal the size of a dog or a deer, standing or trotting."""
    thick, neck = float(rng.uniform(0.8, 1.2)), float(rng.uniform(0.05, 0.3))
    widest = _four_legs(_WIDEST, 0.03 if phase is None else 0.2, thick, neck)
    mesh = widest if phase is None else _four_legs(phase, 0.2, thick, neck)
    return mesh.fitted(size_m, like=widest).painted(rng)


def build_object(size_m: Float[np.ndarray, " 3"], rng: np.random.Generator) -> Mesh:
    """Build an object of no other class: a loaded hand cart or a skip."""
    parts = [box([1.0, 0.7, 0.1], [0, 0, 0.25], _METAL)]
    parts += [
        tube([x, 0.3 * s - 0.04, 0.1], [x, 0.3 * s + 0.04, 0.1], 0.1, _TYRE) for x in (-0.4, 0.4) for s in (1, -1)
    ]
    for _ in range(4):
        size, centre = rng.uniform(0.25, 0.5, 3), rng.uniform(-0.2, 0.2, 2)
        parts.append(box(size.tolist(), [centre[0], centre[1], 0.3 + size[2] / 2], _CARGO))
    parts.append(tube([-0.5, 0, 0.3], [-0.62, 0, 0.95], 0.03, _METAL, sides=5))
    return Mesh.merge(parts).fitted(size_m).painted(rng)


# Gait: how legs, arms, cranks and paws move with the distance covered

PHASES = 16


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
    distance_m = float(np.linalg.norm(line))
    along = float(np.clip((upper_m**2 - lower_m**2 + distance_m**2) / (2 * distance_m), 0.0, upper_m))
    aside = np.sqrt(max(upper_m**2 - along**2, 0.0)) * (distance_m < upper_m + lower_m)
    unit = line / distance_m
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
