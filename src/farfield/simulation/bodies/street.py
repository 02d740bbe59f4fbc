"""Street furniture: what stands where cars stand, and has a car's size, without being one.

Each model stands on z = 0 about its own origin, x along the street, y away from the carriageway; it is painted where it
stands. Sizes are those of common products (a wheeled bin of EN 840, a skip of 5 to 7 m3, a shelter of three bays).
"""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import Mesh, box, ellipsoid, grid, loft, quads, ring_tube, tube

_METAL, _TRIM, _CARGO, _WOOD = int(Material.METAL), int(Material.TRIM), int(Material.CARGO), int(Material.BARK)
_CONCRETE, _GLASS, _SIGN, _SOIL = (
    int(Material.CONCRETE),
    int(Material.GLASS),
    int(Material.SIGN),
    int(Material.SOIL),
)
_BRICK = int(Material.BRICK)

Build = Callable[[np.random.Generator], Mesh]


def uprights(
    x_m: Float[np.ndarray, " n"], width_m: float, low_m: float, high_m: float, material: int, *, y_m: float = 0.0
) -> Mesh:
    """Thin boards or bars standing side by side in the x-z plane, two triangles each."""
    signs = np.array([[-1, 0], [1, 0], [1, 1], [-1, 1]])
    corners = np.zeros((len(x_m), 4, 3))
    corners[..., 0] = x_m[:, None] + signs[:, 0] * width_m / 2
    corners[..., 1] = y_m
    corners[..., 2] = low_m + signs[:, 1] * (high_m - low_m)
    return quads(corners, material)


def _row(length_m: float, pitch_m: float) -> Float[np.ndarray, " n"]:
    """Places at even distances of about a pitch, from one end of a length to the other."""
    return np.linspace(-length_m / 2, length_m / 2, max(2, round(length_m / pitch_m) + 1))


def _posts(x_m: Float[np.ndarray, " n"], side_m: float, height_m: float, material: int) -> list[Mesh]:
    return [box([side_m, side_m, height_m + 0.3], [float(x), 0, height_m / 2 - 0.15], material) for x in x_m]


# Fences of one length, and gates: rays pass between their bars


def railing(length_m: float, rng: np.random.Generator) -> Mesh:
    """Metal bars between two rails on posts."""
    height, pitch = float(rng.uniform(0.9, 1.8)), float(rng.uniform(0.11, 0.16))
    bars = uprights(_row(length_m, pitch), float(rng.uniform(0.015, 0.03)), 0.08, height, _METAL)
    rails = [box([length_m, 0.04, 0.05], [0, 0, z], _METAL) for z in (0.15, 0.93 * height)]
    return Mesh.merge([bars, *rails, *_posts(_row(length_m, 2.5), 0.06, height, _METAL)])


def picket_fence(length_m: float, rng: np.random.Generator) -> Mesh:
    """Wooden boards with gaps of their own width, before two rails."""
    height, width = float(rng.uniform(0.8, 1.3)), float(rng.uniform(0.06, 0.10))
    boards = uprights(_row(length_m, width * float(rng.uniform(1.5, 2.2))), width, 0.08, height, _WOOD, y_m=-0.05)
    rails = [box([length_m, 0.04, 0.08], [0, 0, z], _WOOD) for z in (0.25 * height, 0.8 * height)]
    return Mesh.merge([boards, *rails, *_posts(_row(length_m, 2.2), 0.09, height, _WOOD)])


def rail_fence(length_m: float, rng: np.random.Generator) -> Mesh:
    """Two or three wooden rails on posts."""
    height, count = float(rng.uniform(0.9, 1.3)), int(rng.integers(2, 4))
    heights = np.linspace(0.35, 0.92, count) * height
    rails = [box([length_m, 0.05, 0.11], [0, 0, float(z)], _WOOD) for z in heights]
    return Mesh.merge([*rails, *_posts(_row(length_m, 2.5), 0.13, height, _WOOD)])


def board_fence(length_m: float, rng: np.random.Generator) -> Mesh:
    """Overlapping boards on both sides of the rails: closed to the eye, a few centimetres deep to a beam."""
    height, width = float(rng.uniform(1.4, 2.0)), float(rng.uniform(0.10, 0.18))
    x = _row(length_m, 0.8 * width)
    front = uprights(x[::2], width, 0.05, height, _WOOD, y_m=-0.05)
    back = uprights(x[1::2], width, 0.05, height, _WOOD, y_m=0.04)
    return Mesh.merge([front, back, *_posts(_row(length_m, 2.4), 0.10, height, _WOOD)])


def wire_fence(length_m: float, rng: np.random.Generator) -> Mesh:
    """Posts with wires between."""
    height = float(rng.uniform(1.0, 1.6))
    wires = [box([length_m, 0.006, 0.008], [0, 0, float(z)], _METAL) for z in np.arange(0.2, height, 0.22)]
    post = _WOOD if rng.random() < 0.6 else _METAL
    return Mesh.merge([*wires, *_posts(_row(length_m, 2.8), 0.09, height, post)])


def site_fence(length_m: float, rng: np.random.Generator) -> Mesh:
    """Panels of 2 m height and about 3.5 m length in concrete feet, as round building sites."""
    parts = []
    for end, start in zip(_row(length_m, 3.5)[1:], _row(length_m, 3.5)[:-1], strict=True):
        middle, wide = float(start + end) / 2, float(end - start) - 0.08
        parts.append(uprights(middle + _row(wide, 0.17), 0.012, 0.15, 1.95, _METAL))
        parts += [box([wide, 0.04, 0.04], [middle, 0, z], _METAL) for z in (0.15, 0.75, 1.95)]
        parts.append(uprights(middle + np.array([-wide, wide]) / 2, 0.05, 0.0, 2.0, _METAL))
        parts.append(box([0.25, 0.7, 0.14], [float(start), 0, 0.07], _CONCRETE))
        if rng.random() < 0.25:  # a banner
            parts.append(box([0.9 * wide, 0.01, 1.0], [middle, -0.03, 1.2], int(Material.CLOTH)))
    return Mesh.merge(parts)


FENCES: dict[str, Callable[[float, np.random.Generator], Mesh]] = {
    "railing": railing,
    "pickets": picket_fence,
    "rails": rail_fence,
    "boards": board_fence,
    "wires": wire_fence,
    "site": site_fence,
}
"""Fences by name; each is built for a length."""


def gate(rng: np.random.Generator) -> Mesh:
    """Two leaves of bars between pillars, each a little open."""
    wide, height = float(rng.uniform(2.6, 3.6)), float(rng.uniform(1.0, 1.7))
    pillar, parts = int(rng.choice([_BRICK, _CONCRETE])), []
    for side in (-1, 1):
        parts.append(box([0.4, 0.4, height + 0.5], [side * (wide / 2 + 0.2), 0, height / 2 + 0.05], pillar))
        leaf = [uprights(_row(wide / 2 - 0.1, 0.14), 0.025, 0.1, height, _METAL)]
        leaf += [box([wide / 2 - 0.1, 0.04, 0.05], [0, 0, z], _METAL) for z in (0.15, 0.5 * height, height)]
        closed = Mesh.merge(leaf).placed(-side * wide / 4, 0.0)
        parts.append(closed.placed(side * wide / 2, 0.0, yaw_rad=-side * float(rng.uniform(0.0, 0.5))))
    return Mesh.merge(parts)


# Boxes: cabinets, bins, containers


def cabinet(rng: np.random.Generator) -> Mesh:
    """A cabinet of the telephone or power company on a plinth, sometimes two side by side."""
    skin, parts, x = int(rng.choice([_CARGO, _METAL])), [], 0.0
    for _ in range(1 + int(rng.random() < 0.4)):
        size = [float(rng.uniform(0.7, 1.6)), float(rng.uniform(0.3, 0.5)), float(rng.uniform(1.0, 1.6))]
        parts.append(box(size, [x + size[0] / 2, 0, size[2] / 2 + 0.12], skin))
        parts.append(box([size[0] + 0.1, size[1] + 0.1, 0.62], [x + size[0] / 2, 0, -0.19], _CONCRETE))
        doors = np.arange(0.0, size[0] - 0.3, 0.6) + 0.3 + x
        parts.append(uprights(doors, 0.02, 0.25, size[2], _TRIM, y_m=-size[1] / 2 - 0.015))
        x += size[0] + 0.12
    return Mesh.merge(parts).placed(-x / 2, 0.0)


def _wheeled_bin(rng: np.random.Generator) -> Mesh:
    """A wheeled bin of 120 or 240 litres."""
    wide, deep, high = (0.58, 0.72, 1.06) if rng.random() < 0.6 else (0.48, 0.55, 0.93)
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2
    rings = [
        np.column_stack([square * [share * wide, share * deep] + [0, aside], np.full(4, z)])
        for share, aside, z in ((0.78, 0.02, 0.05), (0.97, 0.0, 0.93 * high), (1.0, 0.0, 0.94 * high))
    ]
    lid = np.column_stack([square * [0.9 * wide, 0.75 * deep] + [0, 0.05], np.full(4, high)])
    return loft(np.stack([*rings, lid]), _CARGO, _TRIM)


def wheeled_bins(rng: np.random.Generator) -> Mesh:
    """One to five wheeled bins, roughly in a row."""
    parts, x = [], 0.0
    for _ in range(int(rng.integers(1, 6))):
        turn = float(rng.normal(0.0, 0.15))
        parts.append(_wheeled_bin(rng).placed(x, float(rng.normal(0, 0.05)), yaw_rad=turn))
        x += float(rng.uniform(0.62, 0.85))
    return Mesh.merge(parts).placed(-(x - 0.7) / 2, 0.0)


def litter_bin(rng: np.random.Generator) -> Mesh:
    """A round litter bin on a foot."""
    radius, height = float(rng.uniform(0.18, 0.32)), float(rng.uniform(0.8, 1.15))
    skin = int(rng.choice([_CARGO, _METAL, _TRIM]))
    return Mesh.merge(
        [
            tube([0, 0, 0.1], [0, 0, height], radius, skin, sides=8),
            tube([0, 0, -0.2], [0, 0, 0.12], 0.06, _METAL, sides=5),
        ]
    )


def dumpster(rng: np.random.Generator) -> Mesh:
    """A container of 770 to 1100 litres with a rounded lid."""
    wide, deep, high = float(rng.uniform(1.2, 1.4)), float(rng.uniform(0.8, 1.1)), float(rng.uniform(1.25, 1.45))
    section = np.array([[-0.42, 0.2], [-0.5, 0.95], [-0.3, 1.15], [0.3, 1.15], [0.5, 0.95], [0.42, 0.2]])
    ring = section * [deep, high / 1.15]
    body = loft(np.stack([np.column_stack([np.full(6, x), ring]) for x in (-wide / 2, wide / 2)]), _CARGO, _CARGO)
    feet = [box([0.12, 0.12, 0.22], [x * wide, y * deep, 0.11], _TRIM) for x in (-0.4, 0.4) for y in (-0.35, 0.35)]
    return Mesh.merge([body, box([wide + 0.12, 0.06, 0.06], [0, -0.5 * deep, 0.8 * high], _TRIM), *feet])


def skip(rng: np.random.Generator) -> Mesh:
    """An open skip with a heap of rubble in it."""
    long, wide, high = float(rng.uniform(3.0, 4.2)), float(rng.uniform(1.6, 1.9)), float(rng.uniform(1.1, 1.5))
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2
    rings = [
        np.column_stack([square * [share * long, wide], np.full(4, z)])
        for share, z in ((0.55, 0.05), (0.75, 0.35 * high), (1.0, high))
    ]
    inner = np.column_stack([square * [0.9 * long, 0.92 * wide], np.full(4, 0.8 * high)])
    shell = loft(np.stack([*rings, inner]), _CARGO, _CARGO)
    ribs = [box([0.08, wide + 0.1, 0.8 * high], [x * long, 0, 0.55 * high], _METAL) for x in (-0.25, 0.0, 0.25)]
    return Mesh.merge(
        [shell, *ribs, mound(rng, long_m=0.85 * long, wide_m=0.85 * wide, high_m=0.35).placed(0.0, 0.0, 0.75 * high)]
    )


def cabin(rng: np.random.Generator) -> Mesh:
    """A store container or site cabin of 2.4 to 3 m length, ribbed, with a door and a window."""
    long, wide, high = float(rng.uniform(2.4, 3.2)), float(rng.uniform(2.0, 2.4)), float(rng.uniform(2.2, 2.6))
    parts = [box([long, wide, high], [0, 0, high / 2], _CARGO)]
    ribs = _row(long - 0.2, 0.3)
    parts += [box([0.12, wide + 0.08, high - 0.3], [float(x), 0, high / 2], _CARGO) for x in ribs]
    parts.append(box([0.9, 0.06, 2.0], [-0.2 * long, -wide / 2 - 0.03, 1.0], _TRIM))
    return Mesh.merge(parts)


def kiosk(rng: np.random.Generator) -> Mesh:
    """A transformer house: a low concrete block with louvred doors and a roof that stands out."""
    long, wide, high = float(rng.uniform(1.8, 3.2)), float(rng.uniform(1.4, 2.2)), float(rng.uniform(1.6, 2.4))
    louvres = [
        box([0.8, 0.05, 0.04], [0.2 * long, -wide / 2 - 0.02, float(z)], _METAL)
        for z in np.arange(0.4, high - 0.4, 0.16)
    ]
    return Mesh.merge(
        [
            box([long, wide, high + 0.3], [0, 0, high / 2 - 0.15], _CONCRETE),
            box([long + 0.3, wide + 0.3, 0.12], [0, 0, high + 0.06], _CONCRETE),
            box([0.8, 0.05, 1.7], [-0.2 * long, -wide / 2 - 0.02, 0.85], _METAL),
            *louvres,
        ]
    )


def toilet(rng: np.random.Generator) -> Mesh:
    """A mobile toilet with a domed roof."""
    high = float(rng.uniform(2.1, 2.35))
    roof = ellipsoid([0, 0, high], [0.55, 0.6, 0.15], _CARGO, sides=6, rows=2)
    return Mesh.merge(
        [box([1.1, 1.2, high], [0, 0, high / 2], _CARGO), roof, box([0.9, 0.04, 1.9], [0, -0.62, 1.0], _TRIM)]
    )


def planter(rng: np.random.Generator) -> Mesh:
    """A tub of concrete or wood with earth and a few stems."""
    long, wide, high = float(rng.uniform(0.8, 2.0)), float(rng.uniform(0.5, 0.9)), float(rng.uniform(0.45, 0.8))
    skin = int(rng.choice([_CONCRETE, _WOOD]))
    stems = []
    for _ in range(int(4 + 5 * long)):
        x, y = float(rng.uniform(-0.4, 0.4)) * long, float(rng.uniform(-0.4, 0.4)) * wide
        tip = [x + float(rng.normal(0, 0.12)), y + float(rng.normal(0, 0.12)), high + float(rng.uniform(0.15, 0.6))]
        stems.append(tube([x, y, high - 0.05], tip, 0.015, int(Material.FOLIAGE), sides=3))
    return Mesh.merge([box([long, wide, high], [0, 0, high / 2], skin), *stems])


# To sit, to wait, to read


def bench(rng: np.random.Generator) -> Mesh:
    """Slats on two frames, most with a back that stands towards the houses."""
    long, parts = float(rng.uniform(1.4, 2.0)), []
    parts += [box([long, 0.09, 0.04], [0, y, 0.45], _WOOD) for y in (-0.2, -0.08, 0.04, 0.16)]
    if rng.random() < 0.8:
        parts += [box([long, 0.04, 0.10], [0, 0.24 + 0.06 * row, 0.60 + 0.16 * row], _WOOD) for row in range(3)]
    for x in (-0.4 * long, 0.4 * long):
        parts += [box([0.06, 0.5, 0.05], [x, 0, 0.41], _METAL), box([0.06, 0.06, 0.9], [x, 0.25, 0.45], _METAL)]
        parts.append(box([0.06, 0.06, 0.45], [x, -0.2, 0.22], _METAL))
    return Mesh.merge(parts)


def shelter(rng: np.random.Generator) -> Mesh:
    """A bus shelter: posts, a roof, glass between frames at the back and one side, a bench, a poster case."""
    bays, bay, deep, high = int(rng.integers(2, 4)), float(rng.uniform(1.1, 1.5)), 1.1, float(rng.uniform(2.2, 2.5))
    long = bays * bay
    x = _row(long, bay)
    parts = [box([0.08, 0.08, high], [float(at), deep / 2, high / 2], _METAL) for at in x]
    parts += [box([0.08, 0.08, high], [side * long / 2, -deep / 2 + 0.1, high / 2], _METAL) for side in (-1, 1)]
    parts.append(box([long + 0.3, deep + 0.3, 0.12], [0, 0, high + 0.06], _METAL))
    parts += [box([long, 0.05, 0.08], [0, deep / 2, z], _METAL) for z in (0.25, 1.2, high - 0.15)]
    panes = [
        uprights(np.array([float(at)]), bay - 0.1, 0.28, high - 0.2, _GLASS, y_m=deep / 2)
        for at in (x[1:] + x[:-1]) / 2
    ]
    case = box([0.14, 0.9 * deep, 1.7], [float(rng.choice([-0.5, 0.5])) * long, 0, 1.15], _CARGO)
    seat = [box([0.7 * long, 0.35, 0.06], [0, 0.25, 0.47], _WOOD)]
    seat += [box([0.06, 0.3, 0.45], [side * 0.3 * long, 0.25, 0.22], _METAL) for side in (-1, 1)]
    return Mesh.merge([*parts, *panes, case, *seat])


def poster(rng: np.random.Generator) -> Mesh:
    """A lit poster case on a foot, along or across the street."""
    wide, high = float(rng.uniform(1.1, 1.4)), float(rng.uniform(1.9, 2.4))
    case = box([wide, 0.18, high - 0.5], [0, 0, high / 2 + 0.25], _CARGO)
    frame = [box([0.08, 0.22, high - 0.45], [side * wide / 2, 0, high / 2 + 0.22], _METAL) for side in (-1, 1)]
    return Mesh.merge([case, *frame, box([0.7 * wide, 0.2, 0.8], [0, 0, 0.2], _METAL)])


def picnic_table(rng: np.random.Generator) -> Mesh:
    """A table with a bench on either side."""
    long = float(rng.uniform(1.6, 2.0))
    tops = [(0.0, 0.72, 0.75), (-0.62, 0.28, 0.45), (0.62, 0.28, 0.45)]
    parts = [box([long, wide, 0.05], [0, y, z], _WOOD) for y, wide, z in tops]
    for x in (-0.36 * long, 0.36 * long):
        parts += [box([0.08, 1.4, 0.08], [x, 0, 0.4], _WOOD), box([0.08, 0.1, 0.75], [x, -0.2, 0.37], _WOOD)]
        parts.append(box([0.08, 0.1, 0.75], [x, 0.2, 0.37], _WOOD))
    return Mesh.merge(parts)


def cafe(rng: np.random.Generator) -> Mesh:
    """Two round tables with chairs."""
    parts = []
    for x in (-0.8, 0.8):
        parts.append(tube([x, 0, 0.70], [x, 0, 0.74], 0.35, _WOOD, sides=8))
        parts.append(tube([x, 0, 0], [x, 0, 0.7], 0.04, _METAL, sides=5))
        for side in (-1, 1):
            seat_x, y = x + float(rng.normal(0, 0.08)), side * float(rng.uniform(0.42, 0.55))
            parts.append(box([0.4, 0.4, 0.04], [seat_x, y, 0.45], _WOOD))
            parts.append(box([0.4, 0.04, 0.4], [seat_x, y + 0.2 * side, 0.68], _WOOD))
            parts += [box([0.03, 0.36, 0.44], [seat_x + 0.17 * end, y, 0.22], _METAL) for end in (-1, 1)]
    return Mesh.merge(parts)


# Small things in rows


def bollards(rng: np.random.Generator) -> Mesh:
    """Two to six posts in a row."""
    count, pitch = int(rng.integers(2, 7)), float(rng.uniform(1.0, 1.6))
    radius, height, skin = (
        float(rng.uniform(0.05, 0.11)),
        float(rng.uniform(0.8, 1.1)),
        int(rng.choice([_METAL, _TRIM, _CONCRETE])),
    )
    x = (np.arange(count) - (count - 1) / 2) * pitch
    return Mesh.merge([tube([float(at), 0, -0.2], [float(at), 0, height], radius, skin, sides=6) for at in x])


def _bicycle(rng: np.random.Generator) -> Mesh:
    """A bicycle that leans a little: two wheels, a frame, handlebar and saddle; x forward."""
    radius = float(rng.uniform(0.31, 0.35))
    wheels = [ring_tube([x, 0, radius], radius, 0.05, int(Material.TYRE), sides=8) for x in (-0.52, 0.52)]
    spokes = [box([1.6 * radius, 0.004, 0.012], [x, 0, radius], _METAL) for x in (-0.52, 0.52)]
    tubes = [([-0.52, radius], [-0.1, 0.3]), ([-0.1, 0.3], [0.36, 0.75]), ([-0.1, 0.3], [-0.2, 0.85])]
    tubes += [([-0.18, 0.75], [0.36, 0.78]), ([0.52, radius], [0.34, 0.98]), ([-0.52, radius], [-0.18, 0.72])]
    frame = [tube([a[0], 0, a[1]], [b[0], 0, b[1]], 0.018, _CARGO, sides=3) for a, b in tubes]
    bar = tube([0.34, -0.28, 1.0], [0.34, 0.28, 1.0], 0.016, _METAL, sides=3)
    saddle = box([0.26, 0.14, 0.06], [-0.22, 0, 0.90], _TRIM)
    extra = [box([0.3, 0.36, 0.25], [0.5, 0, 0.95], _WOOD)] if rng.random() < 0.3 else []
    return Mesh.merge([*wheels, *spokes, *frame, bar, saddle, *extra])


def bicycle_rack(rng: np.random.Generator) -> Mesh:
    """Hoops along the kerb, and bicycles locked to some of them, along the street."""
    hoops, parts, pitch = int(rng.integers(2, 5)), [], float(rng.uniform(1.7, 2.0))
    for x in (np.arange(hoops) - (hoops - 1) / 2) * pitch:
        hoop = [([-0.35, 0.0], [-0.35, 0.8]), ([-0.35, 0.8], [0.35, 0.8]), ([0.35, 0.8], [0.35, 0.0])]
        parts += [tube([a[0] + x, 0, a[1]], [b[0] + x, 0, b[1]], 0.024, _METAL, sides=5) for a, b in hoop]
        for side in (-1, 1):
            if rng.random() < 0.65:
                turn = float(rng.normal(0, 0.06)) + (np.pi if rng.random() < 0.5 else 0.0)
                parts.append(_bicycle(rng).placed(float(x) + float(rng.normal(0, 0.1)), 0.14 * side, yaw_rad=turn))
    return Mesh.merge(parts)


def bicycles(rng: np.random.Generator) -> Mesh:
    """A stand across the street's direction with bicycles side by side."""
    count, parts = int(rng.integers(3, 8)), []
    pitch = float(rng.uniform(0.45, 0.65))
    for x in (np.arange(count) - (count - 1) / 2) * pitch:
        turn = np.pi / 2 + float(rng.normal(0, 0.08)) + (np.pi if rng.random() < 0.2 else 0.0)
        if rng.random() < 0.75:
            parts.append(_bicycle(rng).placed(float(x), float(rng.normal(0, 0.05)), yaw_rad=turn))
    long = count * pitch
    parts += [box([long, 0.04, 0.04], [0, y, 0.35], _METAL) for y in (0.35, 0.75)]
    return Mesh.merge(parts)


def cones(rng: np.random.Generator) -> Mesh:
    """Traffic cones in a row, some with a barrier board between."""
    count, pitch = int(rng.integers(2, 6)), float(rng.uniform(0.9, 1.6))
    x = (np.arange(count) - (count - 1) / 2) * pitch
    parts = []
    for at in x:
        at, y = float(at), float(rng.normal(0, 0.06))
        parts.append(tube([at, y, 0.03], [at, y, 0.72], (0.14, 0.03), _CARGO, sides=7))
        parts.append(tube([at, y, 0.40], [at, y, 0.52], (0.095, 0.075), _SIGN, sides=7))
        parts.append(box([0.38, 0.38, 0.04], [at, y, 0.02], _TRIM))
    return Mesh.merge(parts)


def barrier_board(rng: np.random.Generator) -> Mesh:
    """Red and white boards on feet, as along an excavation."""
    long, parts = float(rng.uniform(1.6, 2.4)), []
    parts += [box([long, 0.03, 0.2], [0, 0, z], _SIGN if z > 0.8 else _CARGO) for z in (0.3, 0.95)]
    parts += [box([0.06, 0.06, 1.1], [side * 0.46 * long, 0, 0.55], _METAL) for side in (-1, 1)]
    parts += [box([0.25, 0.7, 0.1], [side * 0.46 * long, 0, 0.05], _TRIM) for side in (-1, 1)]
    return Mesh.merge(parts)


def excavation(rng: np.random.Generator) -> Mesh:
    """Boards around a hole, with a heap of earth and a stack inside."""
    long = float(rng.uniform(2.4, 4.2))
    boards = [barrier_board(rng) for _ in range(4)]
    parts = [boards[0].placed(-0.25 * long, -0.75), boards[1].placed(0.25 * long, -0.75)]
    parts += [boards[2].placed(-long / 2, 0.0, yaw_rad=np.pi / 2), boards[3].placed(long / 2, 0.0, yaw_rad=np.pi / 2)]
    parts.append(mound(rng, long_m=0.6 * long, wide_m=1.0, high_m=float(rng.uniform(0.5, 0.9))))
    return Mesh.merge(parts)


def meters(rng: np.random.Generator) -> Mesh:
    """A ticket machine or post box."""
    high, wide = float(rng.uniform(1.1, 1.7)), float(rng.uniform(0.3, 0.55))
    return Mesh.merge(
        [box([wide, 0.35, high - 0.5], [0, 0, high / 2 + 0.25], _CARGO), box([0.2, 0.2, 0.8], [0, 0, 0.2], _METAL)]
    )


def direction_sign(rng: np.random.Generator) -> Mesh:
    """A board across the street on two posts."""
    wide, low, high = float(rng.uniform(1.2, 2.4)), float(rng.uniform(0.5, 1.2)), float(rng.uniform(1.6, 2.5))
    posts = [
        tube([0, side * 0.4 * wide, -0.3], [0, side * 0.4 * wide, high], 0.04, _METAL, sides=5) for side in (-1, 1)
    ]
    return Mesh.merge([*posts, box([0.03, wide, high - low], [-0.06, 0, (low + high) / 2], _SIGN)])


# Heaps and stones


def mound(
    rng: np.random.Generator, *, long_m: float | None = None, wide_m: float | None = None, high_m: float | None = None
) -> Mesh:
    """A heap of earth or gravel."""
    long = float(rng.uniform(1.6, 4.5)) if long_m is None else long_m
    wide = float(rng.uniform(1.2, 2.4)) if wide_m is None else wide_m
    high = float(rng.uniform(0.7, 1.4)) if high_m is None else high_m
    angle = 2 * np.pi * np.arange(10) / 10
    rings = []
    for share, z in ((1.0, -0.1), (0.8, 0.3), (0.5, 0.75), (0.2, 1.0), (0.0, 1.02)):
        reach = share * (1 + 0.15 * rng.standard_normal(10))
        ring = np.column_stack(
            [reach * np.cos(angle) * long / 2, reach * np.sin(angle) * wide / 2, np.full(10, z * high)]
        )
        ring[:, 2] += 0.06 * high * rng.standard_normal(10)
        rings.append(ring)
    return grid(np.stack(rings), _SOIL, closed=True)


def stack(rng: np.random.Generator) -> Mesh:
    """Pallets with bricks, sacks or pipes."""
    parts, x = [], 0.0
    for _ in range(int(rng.integers(1, 4))):
        rows = int(rng.integers(1, 4))
        parts += [box([1.2, 0.8, 0.03], [x, 0, z], _WOOD) for z in (0.02, 0.13)]
        for row in range(rows):
            size = rng.uniform([0.95, 0.65, 0.28], [1.15, 0.8, 0.36])
            middle = [
                x + float(rng.normal(0, 0.03)),
                float(rng.normal(0, 0.03)),
                0.15 + 0.34 * row + float(size[2]) / 2,
            ]
            parts.append(box(size.tolist(), middle, int(rng.choice([_BRICK, _CARGO]))))
        x += float(rng.uniform(1.3, 1.8))
    return Mesh.merge(parts).placed(-(x - 1.4) / 2, 0.0)


def logs(rng: np.random.Generator) -> Mesh:
    """A pile of logs along the road."""
    long, radius = float(rng.uniform(2.0, 4.5)), float(rng.uniform(0.14, 0.22))
    parts, count = [], int(rng.integers(3, 6))
    for row in range(count - 1):
        for index in range(count - row):
            y, z = (index - (count - row - 1) / 2) * 2.05 * radius, radius * (1 + 1.75 * row)
            shift, size = float(rng.normal(0, 0.12)), radius * float(rng.uniform(0.8, 1.05))
            parts.append(tube([shift - long / 2, y, z], [shift + long / 2, y, z], size, _WOOD, sides=7))
    return Mesh.merge(parts)


def boulder(rng: np.random.Generator) -> Mesh:
    """One to three rough stones."""
    parts, x = [], 0.0
    for _ in range(int(rng.integers(1, 4))):
        radii = rng.uniform([0.35, 0.3, 0.3], [0.9, 0.7, 0.75])
        stone = ellipsoid([x, 0, 0.6 * float(radii[2])], radii.tolist(), _CONCRETE, sides=8, rows=4)
        rough = stone.vertices_m * (1 + 0.05 * rng.standard_normal((len(stone.vertices_m), 1)))
        parts.append(Mesh.of(rough, stone.faces, stone.material))
        x += float(radii[0]) * 2 + float(rng.uniform(0.0, 0.6))
    stones = Mesh.merge(parts)
    return stones.placed(-float(stones.vertices_m[:, 0].max() + stones.vertices_m[:, 0].min()) / 2, 0.0)


def carts(rng: np.random.Generator) -> Mesh:
    """A shelter of bent tubes with shopping carts pushed into one another."""
    long, parts = float(rng.uniform(3.2, 4.6)), []
    for x in _row(long, 1.5):
        hoop = [([-0.8, 0.0], [-0.8, 1.1]), ([-0.8, 1.1], [0.8, 1.1]), ([0.8, 1.1], [0.8, 0.0])]
        parts += [tube([float(x), a[0], a[1]], [float(x), b[0], b[1]], 0.03, _METAL, sides=5) for a, b in hoop]
    parts += [box([long, 0.04, 0.04], [0, y, z], _METAL) for y in (-0.8, 0.8) for z in (0.4, 1.1)]
    count = int(rng.integers(3, 12))
    for x in -long / 2 + 0.5 + 0.25 * np.arange(count):
        parts.append(
            uprights(np.linspace(-0.25, 0.25, 6), 0.02, 0.45, 1.0, _METAL).placed(float(x), 0.0, yaw_rad=np.pi / 2)
        )
    basket = 0.25 * count + 0.6
    parts += [
        box([basket, 0.02, 0.03], [-long / 2 + basket / 2, y, z], _METAL)
        for y in (-0.26, 0.26)
        for z in (0.45, 0.7, 1.0)
    ]
    return Mesh.merge(parts)


KINDS: dict[str, Build] = {
    "barrier_board": barrier_board,
    "bench": bench,
    "bicycle_rack": bicycle_rack,
    "bicycles": bicycles,
    "bollards": bollards,
    "boulder": boulder,
    "cabin": cabin,
    "cabinet": cabinet,
    "cafe": cafe,
    "carts": carts,
    "cones": cones,
    "direction_sign": direction_sign,
    "dumpster": dumpster,
    "excavation": excavation,
    "gate": gate,
    "kiosk": kiosk,
    "litter_bin": litter_bin,
    "logs": logs,
    "meters": meters,
    "mound": mound,
    "picnic_table": picnic_table,
    "planter": planter,
    "poster": poster,
    "shelter": shelter,
    "skip": skip,
    "stack": stack,
    "toilet": toilet,
    "wheeled_bins": wheeled_bins,
}
"""All furniture but fences, by name."""


# Poles and wires


def wire_pole(height_m: float, arm_m: float) -> Mesh:
    """A wooden pole with a cross-arm across the street."""
    pole = tube([0, 0, -0.5], [0, 0, height_m], (0.15, 0.09), _WOOD, sides=7)
    return Mesh.merge([pole, box([0.1, 2 * arm_m, 0.1], [0, 0, height_m - 0.5], _WOOD)])


def wires(ends_m: Sequence[tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]], sag_m: float) -> Mesh:
    """Wires that hang between points of the world, as pairs of crossed strips of 2 cm."""
    share = np.linspace(0.0, 1.0, 7)
    strips = []
    for first, last in ends_m:
        line = first + share[:, None] * (last - first)
        line[:, 2] -= 4 * sag_m * share * (1 - share)
        direction = (last - first)[:2] / np.hypot(*(last - first)[:2])
        for aside in (np.array([-direction[1], direction[0], 0.0]), np.array([0.0, 0.0, 1.0])):
            edges = np.stack([line - 0.01 * aside, line + 0.01 * aside], axis=1)
            strips.append(grid(edges, _TRIM))
    return Mesh.merge(strips)
