"""What a triangle looks like: its colour by material and tint, its normal, and what it emits at night.

Colours are linear RGB albedos. Car colours follow the shares of new cars in industry surveys (roughly white 0.34, black
0.20, grey 0.18, silver 0.09, blue 0.09, red 0.06, the rest 0.04); the other colours are chosen by eye.
"""

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Float, Float32, UInt8

from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import Mesh
from farfield.simulation.trace import Tracer

_Colour = tuple[float, float, float]
CAR_COLOURS: tuple[tuple[float, _Colour], ...] = (
    (0.34, (0.78, 0.78, 0.76)),
    (0.20, (0.016, 0.016, 0.018)),
    (0.18, (0.11, 0.115, 0.12)),
    (0.09, (0.42, 0.43, 0.44)),
    (0.09, (0.02, 0.06, 0.20)),
    (0.06, (0.36, 0.018, 0.02)),
    (0.02, (0.03, 0.12, 0.06)),
    (0.02, (0.30, 0.22, 0.13)),
)
_RANGES: dict[str, tuple[tuple[float, _Colour], ...]] = {
    "CAR_PAINT": CAR_COLOURS,
    "CARGO": (
        (0.5, (0.72, 0.72, 0.70)),
        (0.14, (0.10, 0.17, 0.36)),
        (0.1, (0.42, 0.10, 0.06)),
        (0.1, (0.45, 0.33, 0.14)),
        (0.08, (0.10, 0.24, 0.14)),
        (0.08, (0.32, 0.33, 0.34)),
    ),
    "CLOTH": (
        (0.25, (0.03, 0.03, 0.04)),
        (0.2, (0.06, 0.09, 0.18)),
        (0.15, (0.30, 0.30, 0.29)),
        (0.12, (0.40, 0.06, 0.05)),
        (0.1, (0.12, 0.20, 0.12)),
        (0.1, (0.42, 0.30, 0.16)),
        (0.08, (0.62, 0.60, 0.55)),
    ),
    "SIGN": (
        (0.45, (0.015, 0.19, 0.10)),
        (0.2, (0.02, 0.10, 0.42)),
        (0.2, (0.80, 0.80, 0.78)),
        (0.1, (0.62, 0.42, 0.02)),
        (0.05, (0.55, 0.03, 0.03)),
    ),
    "BRICK": (
        (0.4, (0.30, 0.13, 0.09)),
        (0.25, (0.38, 0.24, 0.16)),
        (0.2, (0.48, 0.40, 0.30)),
        (0.15, (0.24, 0.17, 0.14)),
    ),
    "CONCRETE": ((0.4, (0.33, 0.32, 0.30)), (0.3, (0.40, 0.38, 0.34)), (0.3, (0.27, 0.27, 0.27))),
    "SKIN": ((0.5, (0.50, 0.31, 0.22)), (0.3, (0.34, 0.20, 0.13)), (0.2, (0.14, 0.08, 0.05))),
    "FOLIAGE": ((0.5, (0.055, 0.110, 0.030)), (0.3, (0.080, 0.130, 0.035)), (0.2, (0.035, 0.080, 0.030))),
}
_SINGLE: dict[str, _Colour] = {
    "ASPHALT": (0.095, 0.095, 0.098),
    "LANE_PAINT": (0.62, 0.62, 0.58),
    "GRASS": (0.095, 0.150, 0.045),
    "SOIL": (0.20, 0.145, 0.09),
    "TYRE": (0.018, 0.018, 0.019),
    "GLASS": (0.012, 0.014, 0.015),
    "LAMP": (0.60, 0.60, 0.60),
    "PLATE": (0.72, 0.72, 0.68),
    "METAL": (0.29, 0.30, 0.31),
    "TRIM": (0.025, 0.025, 0.027),
    "SNOW": (0.80, 0.82, 0.86),
    "BARK": (0.11, 0.08, 0.055),
}
_OTHER: _Colour = (0.3, 0.3, 0.3)
_HEAD_LAMP, _TAIL_LAMP, _STREET_LAMP = (1.0, 0.93, 0.82), (0.85, 0.02, 0.015), (1.0, 0.72, 0.38)
_LIT_WINDOW = (1.0, 0.74, 0.42)
_LIT_SHARE = 0.28


@dataclass(frozen=True, eq=False)
class Appearance:
    """Triangles as a camera sees them.

    Args:
        normal: Unit normals in the mesh's frame, shape (f, 3).
        albedo: Linear RGB, shape (f, 3).
        glow: Radiance by which each shines at night, shape (f, 3).
        material: Material, shape (f,).
    """

    normal: Float32[np.ndarray, "f 3"]
    albedo: Float32[np.ndarray, "f 3"]
    glow: Float32[np.ndarray, "f 3"]
    material: UInt8[np.ndarray, " f"]


_KNOWN: WeakKeyDictionary[Tracer, Appearance] = WeakKeyDictionary()


def looks_of(tracer: Tracer, *, moving: bool) -> Appearance:
    """Looks of a tracer's triangles; worked out once a tracer.

    Args:
        tracer: What is seen.
        moving: Whether it is a road user (x forward, so that lamps in front are white and behind red) or fixed.
    """
    if tracer not in _KNOWN:
        mesh = tracer.mesh
        _KNOWN[tracer] = Appearance(
            face_normals(mesh), albedo_of(mesh, moving=moving), _glow(mesh, moving), mesh.material.astype(np.uint8)
        )
    return _KNOWN[tracer]


def face_normals(mesh: Mesh) -> Float32[np.ndarray, "f 3"]:
    """Unit normals of a mesh's triangles; their sign follows the order of the corners."""
    a, b, c = (mesh.vertices_m[mesh.faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    return (normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)).astype(np.float32)


def albedo_of(mesh: Mesh, *, moving: bool = False) -> Float32[np.ndarray, "f 3"]:
    """Linear RGB of each triangle by its material and tint."""
    colours = np.empty((len(mesh.faces), 3), dtype=np.float32)
    for value in np.unique(mesh.material):
        name, chosen = Material(int(value)).name, mesh.material == value
        if name in _RANGES:
            colours[chosen] = _pick(_RANGES[name], mesh.tint[chosen])
        else:
            shade = 0.85 + 0.3 * mesh.tint[chosen, None] if name != "LAMP" else 1.0
            colours[chosen] = np.array(_SINGLE.get(name, _OTHER)) * shade
    if moving:
        tail = (mesh.material == Material.LAMP) & (_middle_x(mesh) < 0)
        colours[tail] = (0.28, 0.012, 0.012)
    return colours


def _pick(shares: tuple[tuple[float, _Colour], ...], tint: Float32[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
    """The colour whose share of [0, 1) holds the tint, a little lighter or darker by where in the share it lies."""
    edges = np.cumsum([share for share, _ in shares])
    index = np.minimum(np.searchsorted(edges, tint, side="right"), len(shares) - 1)
    within = (edges[index] - tint) / np.array([share for share, _ in shares])[index]
    return np.array([colour for _, colour in shares])[index] * (0.85 + 0.3 * within[:, None])


def _middle_x(mesh: Mesh) -> Float[np.ndarray, " f"]:
    return mesh.vertices_m[mesh.faces, 0].mean(axis=1)


def _glow(mesh: Mesh, moving: bool) -> Float32[np.ndarray, "f 3"]:
    glow = np.zeros((len(mesh.faces), 3), dtype=np.float32)
    lamp = mesh.material == Material.LAMP
    if moving:
        ahead = _middle_x(mesh) > 0
        glow[lamp & ahead] = 40.0 * np.array(_HEAD_LAMP)
        glow[lamp & ~ahead] = 3.0 * np.array(_TAIL_LAMP)
    else:
        glow[lamp] = 30.0 * np.array(_STREET_LAMP)
        window = np.flatnonzero(mesh.material == Material.GLASS)  # panes are pairs of triangles
        corner = mesh.vertices_m[mesh.faces[window, 0]]
        chance = np.modf(np.abs(np.sin(corner @ np.array([12.9898, 78.233, 37.719])) * 43758.5453))[0]
        glow[window[chance < _LIT_SHARE]] = 0.5 * np.array(_LIT_WINDOW)
    return glow
