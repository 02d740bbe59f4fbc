"""Trucks, buses, trailers: cabs, cargo bodies, chassis gaps and wheels."""

import numpy as np
from jaxtyping import Float

from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import Mesh, box, loft, quads, tube, wheel

TRUCK_STYLES = ("box", "semi", "flatbed", "tanker", "tipper", "light_truck")


def _section(width_m: float, low_m: float, high_m: float, *, shrink: float = 0.0) -> Float[np.ndarray, "8 2"]:
    """Ring (y, z) of a body with chamfered upper edges; the 8 sides start at the lower left."""
    half, edge, mid = width_m / 2 * (1 - shrink), 0.08, low_m + 0.45 * (high_m - low_m)
    left = [(half, low_m), (half, mid), (half, high_m - edge), (half - edge, high_m)]
    return np.array(left + [(-y, z) for y, z in reversed(left)])


def _cab(
    front_m: float, length_m: float, width_m: float, low_m: float, high_m: float, rng: np.random.Generator
) -> Mesh:
    """A cab-over or bonneted cab whose front is at ``front_m``, with screen and side windows."""
    rake = rng.uniform(0.05, 0.35)
    bonnet = rng.uniform(0.8, 1.3) if rng.random() < 0.35 and length_m > 2.6 else 0.0
    mid = low_m + 0.5 * (high_m - low_m)
    stations = [(0.0, mid - 0.1 if bonnet else mid, 0.06)]
    if bonnet:
        stations += [(bonnet, mid + 0.05, 0.02)]
    stations += [(bonnet + rake + 0.02, high_m - 0.08, 0.02), (bonnet + rake + 0.5, high_m, 0.0)]
    stations += [(length_m * 0.62 + 0.3 * bonnet, high_m, 0.0), (length_m, high_m, 0.0)]
    rings = np.stack(
        [
            np.concatenate([np.full((8, 1), front_m - x), _section(width_m, low_m, top, shrink=shrink)], axis=1)
            for x, top, shrink in stations
        ]
    )
    skin = np.full((len(stations) - 1, 8), int(Material.CAR_PAINT))
    screen = 1 if bonnet else 0
    skin[screen, 2:5] = Material.GLASS
    skin[screen + 1, [1, 5]] = Material.GLASS
    return loft(rings, skin, int(Material.CAR_PAINT))


def _axles(positions_m: list[float], width_m: float, radius_m: float) -> list[Mesh]:
    return [wheel(x, side * (width_m / 2 - 0.03), radius_m, 0.32) for x in positions_m for side in (1, -1)]


def _rear_marks(x_m: float, width_m: float, z_m: float) -> Mesh:
    """Tail lamps, plate and under-run bar as patches behind the body."""
    square = np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]]) / 2
    marks = [[x_m, side * 0.42 * width_m, z_m] + square * [0, 0.3, 0.14] for side in (1, -1)]
    marks.append([x_m, 0.0, z_m] + square * [0, 0.45, 0.16])
    return quads(np.stack(marks), np.array([int(Material.LAMP)] * 2 + [int(Material.PLATE)]))


def _cargo(
    style: str, rear_m: float, front_m: float, width_m: float, high_m: float, rng: np.random.Generator
) -> list[Mesh]:
    """What a truck carries between two positions along its length."""
    length, middle = front_m - rear_m, (front_m + rear_m) / 2
    floor = rng.uniform(1.0, 1.25) if style != "light_truck" else 0.8
    if style == "light_truck":
        style = "flatbed" if rng.random() < 0.6 else "box"
    if style == "tanker":
        radius = min(width_m / 2, (high_m - floor) / 2) * 0.96
        axis = high_m - radius
        return [tube([rear_m, 0, axis], [front_m, 0, axis], radius, int(Material.METAL), sides=14, round_ends=True)]
    if style == "flatbed":
        parts = [box([length, width_m, 0.2], [middle, 0, floor], int(Material.METAL))]
        parts.append(box([0.1, width_m, high_m - floor], [front_m, 0, (high_m + floor) / 2], int(Material.METAL)))
        for _ in range(int(rng.integers(1, 4))):
            size = np.array([rng.uniform(0.15, 0.4) * length, rng.uniform(0.4, 0.9) * width_m, rng.uniform(0.3, 1.2)])
            size[2] = min(size[2], high_m - floor - 0.1)
            x = rng.uniform(rear_m + size[0] / 2, front_m - size[0] / 2)
            parts.append(box(size.tolist(), [x, 0, floor + 0.1 + size[2] / 2], int(Material.CARGO)))
        return parts
    if style == "tipper":
        slope = rng.uniform(0.1, 0.4)
        rings = [(rear_m, -slope * 0.5), (rear_m + slope, 0.0), (front_m, 0.1)]
        ring = [
            np.concatenate([np.full((8, 1), x), _section(width_m, floor - 0.1, high_m - 0.25 + dz)], 1)
            for x, dz in rings
        ]
        return [loft(np.stack(ring), int(Material.CAR_PAINT), int(Material.CAR_PAINT))]
    return [box([length, width_m, high_m - floor], [middle, 0, (high_m + floor) / 2], int(Material.CARGO))]


def build_truck(style: str, size_m: Float[np.ndarray, " 3"], rng: np.random.Generator) -> Mesh:
    """Build a truck: cab, gap, cargo body on a chassis beam, axles.

    Args:
        style: One of ``TRUCK_STYLES``.
        size_m: Length, width, height.
        rng: Varies proportions and paint.

    Returns:
        A painted mesh of about 500 triangles, x forward, standing on z = 0.
    """
    length, width, height = (float(value) for value in size_m)
    front, rear = length / 2, -length / 2
    cab_length = float(np.clip(rng.uniform(1.7, 2.3) + (1.0 if length > 9 else 0.0) * rng.random(), 1.5, 0.4 * length))
    gap = rng.uniform(0.1, 0.35) if style != "semi" else rng.uniform(0.6, 1.1)
    cab_high = height * rng.uniform(0.80, 0.98) if style in ("box", "semi") else height
    parts = [_cab(front, cab_length, 0.97 * width, 0.45, cab_high, rng)]
    mirrors = [[front - 0.45, side * 0.475 * width, 0.45 + 0.62 * (cab_high - 0.45)] for side in (1, -1)]
    parts += [box([0.12, 0.05 * width, 0.45], centre, int(Material.TRIM)) for centre in mirrors]
    parts += _cargo("box" if style == "semi" else style, rear, front - cab_length - gap, width, height, rng)
    parts.append(box([length - 1.2, 0.9, 0.25], [-0.3, 0, 0.85], int(Material.METAL)))
    parts.append(box([0.1, 0.9 * width, 0.18], [rear + 0.2, 0, 0.55], int(Material.METAL)))
    radius = rng.uniform(0.44, 0.54) if style != "light_truck" else rng.uniform(0.33, 0.38)
    axles = [front - rng.uniform(1.0, 1.4), rear + rng.uniform(1.3, 2.2)]
    if length > 8:
        axles.append(axles[1] + 2.4 * radius)
    if style == "semi":
        axles += [front - cab_length - 1.0, front - cab_length - 1.0 - 2.4 * radius]
    parts += _axles(axles, width, radius)
    parts.append(_rear_marks(rear - 0.004, width, 0.95))
    return Mesh.merge(parts).fitted(size_m).painted(rng)


def build_bus(size_m: Float[np.ndarray, " 3"], rng: np.random.Generator) -> Mesh:
    """Build a bus: a rounded body with a window band along both sides, a large screen, and two or three axles."""
    length, width, height = (float(value) for value in size_m)
    low, count = rng.uniform(0.28, 0.40), 8
    inner = np.linspace(0.35, length - 0.2, count - 1)
    stations = np.concatenate([[0.0], inner, [length]])
    shrink = np.concatenate([[0.06], np.zeros(count - 1), [0.04]])
    rings = np.stack(
        [
            np.concatenate([np.full((8, 1), length / 2 - x), _section(width, low, height, shrink=s)], axis=1)
            for x, s in zip(stations, shrink, strict=True)
        ]
    )
    skin = np.full((count, 8), int(Material.CAR_PAINT))
    skin[1:-1:2, [1, 5]] = Material.GLASS
    skin[2:-1:2, [1, 5]] = Material.GLASS if rng.random() < 0.7 else Material.CAR_PAINT
    body = loft(rings, skin, int(Material.CAR_PAINT))
    square = np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]]) / 2
    screen = quads(
        ([length / 2 + 0.004, 0, 0.66 * height] + square * [0, 0.85 * width, 0.36 * height])[None], int(Material.GLASS)
    )
    seats = [
        box([0.5, 0.8 * width, 0.45], [x, 0, 1.25], int(Material.CLOTH))
        for x in np.arange(1 - length / 2, length / 2 - 2, 2.0)
    ]
    axles = [length / 2 - rng.uniform(2.2, 2.8), -length / 2 + rng.uniform(2.6, 3.4)]
    parts = [body, screen, *seats, *_axles(axles, width, 0.48), _rear_marks(-length / 2 - 0.004, width, 0.9)]
    return Mesh.merge(parts).fitted(size_m).painted(rng)


def build_trailer(size_m: Float[np.ndarray, " 3"], rng: np.random.Generator) -> Mesh:
    """Build a car's trailer: a caravan, a box, or a low open bed with a load, on one or two axles."""
    length, width, height = (float(value) for value in size_m)
    front, body_rear = length / 2, -length / 2
    body_front = front - min(1.1, 0.25 * length)
    floor, parts = 0.5, []
    if height > 1.7:
        rings = [(body_rear, -0.15), (body_rear + 0.15, 0.0), (body_front - 0.3, 0.0), (body_front, -0.35)]
        ring = [np.concatenate([np.full((8, 1), x), _section(width, floor, height + dz)], axis=1) for x, dz in rings]
        parts.append(loft(np.stack(ring), int(Material.CARGO), int(Material.CARGO)))
    else:
        span, middle = body_front - body_rear, (body_front + body_rear) / 2
        parts.append(box([span, width, 0.35], [middle, 0, floor + 0.15], int(Material.METAL)))
        parts.append(box([0.7 * span, 0.7 * width, height - 0.8], [middle, 0, (height + 0.8) / 2], int(Material.CARGO)))
    parts.append(box([front - body_front + 0.1, 0.1, 0.1], [(front + body_front) / 2, 0, 0.5], int(Material.METAL)))
    parts += [wheel((body_front + body_rear) / 2, side * width / 2, 0.32, 0.2) for side in (1, -1)]
    parts.append(_rear_marks(body_rear - 0.004, width, 0.7))
    return Mesh.merge(parts).fitted(size_m).painted(rng)
