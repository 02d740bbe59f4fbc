"""Pedestrians, cyclists, motorcyclists, people on wheels and animals, from capsules and rings."""

import numpy as np
from jaxtyping import Float

from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import Mesh, Triple, box, ellipsoid, ring_tube, tube

_CLOTH, _SKIN, _METAL, _TYRE = (int(m) for m in (Material.CLOTH, Material.SKIN, Material.METAL, Material.TYRE))


def _limb(start: Triple, end: Triple, radius: float, material: int = _CLOTH) -> Mesh:
    return tube(start, end, radius, material, sides=6, round_ends=True)


def build_pedestrian(size_m: Float[np.ndarray, " 3"], rng: np.random.Generator) -> Mesh:
    """Build a walking person at a random moment of the gait (about 300 triangles)."""
    swing = rng.uniform(0.05, 0.32) * rng.choice([-1.0, 1.0])
    parts = [
        _limb([0, 0.0, 0.85], [0.02, 0, 1.48], 0.17),
        ellipsoid([0.03, 0, 1.64], [0.10, 0.08, 0.13], _SKIN, sides=8, rows=3),
        _limb([0, 0.09, 0.92], [swing, 0.10, 0.0], 0.075),
        _limb([0, -0.09, 0.92], [-swing, -0.10, 0.0], 0.075),
        _limb([0, 0.21, 1.42], [-0.8 * swing, 0.27, 0.85], 0.05),
        _limb([0, -0.21, 1.42], [0.8 * swing, -0.27, 0.85], 0.05),
    ]
    if rng.random() < 0.3:
        parts.append(box([0.18, 0.3, 0.42], [-0.22, 0, 1.2], _CLOTH))
    return Mesh.merge(parts).fitted(size_m).painted(rng)


def _rider(hip: Triple, lean: float, reach: Triple, foot: float) -> list[Mesh]:
    shoulder = [hip[0] + lean, 0.0, hip[2] + 0.55]
    head = [shoulder[0] + 0.08, 0.0, shoulder[2] + 0.22]
    parts = [_limb(hip, shoulder, 0.16), ellipsoid(head, [0.11, 0.09, 0.14], _SKIN, sides=8, rows=3)]
    for side in (1, -1):
        knee = [hip[0] + 0.35, side * 0.13, hip[2] - 0.18]
        parts.append(_limb([hip[0], side * 0.09, hip[2]], knee, 0.08))
        parts.append(_limb(knee, [hip[0] + 0.2, side * 0.12, foot + (0.12 if side > 0 else 0.0)], 0.06))
        parts.append(_limb([shoulder[0], side * 0.2, shoulder[2]], [reach[0], side * reach[1], reach[2]], 0.045))
    return parts


def build_cyclist(size_m: Float[np.ndarray, " 3"], rng: np.random.Generator) -> Mesh:
    """Build a rider on a bicycle: two tyres, frame, handlebar, and a person (about 600 triangles)."""
    parts = [ring_tube([x, 0, 0.34], 0.34, 0.045, _TYRE) for x in (0.52, -0.52)]
    hub_rear, hub_front, pedal, seat, head = (
        [-0.52, 0, 0.34],
        [0.52, 0, 0.34],
        [-0.08, 0, 0.3],
        [-0.2, 0, 0.92],
        [0.35, 0, 0.9],
    )
    frame = [(hub_rear, pedal), (pedal, seat), (seat, head), (pedal, head), (hub_rear, seat), (hub_front, head)]
    parts += [tube(a, b, 0.022, _METAL, sides=4) for a, b in frame]
    parts.append(tube([0.38, -0.28, 1.02], [0.38, 0.28, 1.02], 0.02, _METAL, sides=4))
    parts += _rider([-0.2, 0, 0.98], rng.uniform(0.12, 0.4), [0.38, 0.25, 1.03], 0.22)
    return Mesh.merge(parts).fitted(size_m).painted(rng)


def build_motorcycle(size_m: Float[np.ndarray, " 3"], rng: np.random.Generator) -> Mesh:
    """Build a rider on a motorcycle: two wheels, tank, engine, seat and a person."""
    paint = int(Material.CAR_PAINT)
    parts = [tube([x, -0.07, 0.31], [x, 0.07, 0.31], 0.31, _TYRE, sides=12) for x in (0.7, -0.7)]
    parts.append(ellipsoid([0.2, 0, 0.82], [0.35, 0.16, 0.16], paint))
    parts.append(box([0.6, 0.3, 0.4], [0.05, 0, 0.5], _METAL))
    parts.append(box([0.75, 0.25, 0.12], [-0.4, 0, 0.8], paint))
    parts.append(tube([0.72, 0, 0.31], [0.5, 0, 1.0], 0.04, _METAL, sides=5))
    parts.append(tube([0.48, -0.36, 1.02], [0.48, 0.36, 1.02], 0.02, _METAL, sides=4))
    parts.append(box([0.02, 0.2, 0.12], [-0.8, 0, 0.6], int(Material.PLATE)))
    parts += _rider([-0.3, 0, 0.92], rng.uniform(0.1, 0.35), [0.48, 0.33, 1.02], 0.35)
    return Mesh.merge(parts).fitted(size_m).painted(rng)


def build_wheeled_person(size_m: Float[np.ndarray, " 3"], rng: np.random.Generator) -> Mesh:
    """Build a seated person in a wheelchair."""
    parts = [ring_tube([0.0, side * 0.3, 0.32], 0.32, 0.05, _TYRE) for side in (1, -1)]
    parts.append(box([0.45, 0.5, 0.06], [0.05, 0, 0.5], _METAL))
    parts.append(box([0.05, 0.5, 0.45], [-0.2, 0, 0.75], _METAL))
    parts += _rider([-0.05, 0, 0.58], rng.uniform(-0.05, 0.05), [0.25, 0.3, 0.6], 0.1)
    return Mesh.merge(parts).fitted(size_m).painted(rng)


def build_animal(size_m: Float[np.ndarray, " 3"], rng: np.random.Generator) -> Mesh:
    """Build a standing four-legged animal the size of a dog or a deer."""
    parts = [_limb([-0.35, 0, 0.6], [0.35, 0, 0.62], 0.16), _limb([0.33, 0, 0.65], [0.55, 0, 0.9], 0.09)]
    parts += [_limb([x, y, 0.55], [x + rng.uniform(-0.1, 0.1), y, 0.0], 0.04) for x in (-0.3, 0.3) for y in (-0.1, 0.1)]
    return Mesh.merge(parts).fitted(size_m).painted(rng)
