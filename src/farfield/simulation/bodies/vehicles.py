"""Vehicles, from lofted bodies: cars with bonnet, screens, roof and boot; trucks, buses and trailers."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import Mesh, box, loft, quads, tube, wheel

_TRIM = int(Material.TRIM)
_PAINT, _SCREEN, _CABIN, _PILLAR = "paint", "screen", "cabin", "pillar"


@dataclass(frozen=True)
class BodyStyle:
    """A side profile from the front bumper (u = 0) to the rear bumper (u = 1).

    Args:
        stations: Position u, height of the top as a share of the car's height, and what follows the station.
        belt: Height of the windows' lower edge as a share of the car's height.
    """

    stations: tuple[tuple[float, float, str], ...]
    belt: float


_FRONT = ((0.0, 0.44, _PAINT), (0.02, 0.53, _PAINT))


BODY_STYLES: dict[str, BodyStyle] = {
    "sedan": BodyStyle(
        (
            *_FRONT,
            (0.14, 0.60, _PAINT),
            (0.28, 0.66, _SCREEN),
            (0.45, 0.965, _CABIN),
            (0.55, 1.0, _PILLAR),
            (0.58, 0.998, _CABIN),
            (0.71, 0.95, _SCREEN),
            (0.85, 0.71, _PAINT),
            (0.975, 0.68, _PAINT),
            (1.0, 0.50, _PAINT),
        ),
        0.64,
    ),
    "hatch": BodyStyle(
        (
            *_FRONT,
            (0.13, 0.58, _PAINT),
            (0.26, 0.64, _SCREEN),
            (0.45, 0.965, _CABIN),
            (0.57, 1.0, _PILLAR),
            (0.60, 1.0, _CABIN),
            (0.90, 0.94, _SCREEN),
            (0.975, 0.63, _PAINT),
            (1.0, 0.48, _PAINT),
        ),
        0.61,
    ),
    "estate": BodyStyle(
        (
            *_FRONT,
            (0.14, 0.59, _PAINT),
            (0.27, 0.65, _SCREEN),
            (0.44, 0.965, _CABIN),
            (0.54, 1.0, _PILLAR),
            (0.57, 1.0, _CABIN),
            (0.93, 0.95, _SCREEN),
            (0.98, 0.63, _PAINT),
            (1.0, 0.50, _PAINT),
        ),
        0.61,
    ),
    "suv": BodyStyle(
        (
            (0.0, 0.46, _PAINT),
            (0.02, 0.57, _PAINT),
            (0.12, 0.62, _PAINT),
            (0.25, 0.65, _SCREEN),
            (0.40, 0.965, _CABIN),
            (0.52, 1.0, _PILLAR),
            (0.55, 1.0, _CABIN),
            (0.92, 0.95, _SCREEN),
            (0.98, 0.63, _PAINT),
            (1.0, 0.48, _PAINT),
        ),
        0.62,
    ),
    "pickup": BodyStyle(
        (
            (0.0, 0.46, _PAINT),
            (0.015, 0.57, _PAINT),
            (0.10, 0.62, _PAINT),
            (0.24, 0.64, _SCREEN),
            (0.36, 0.965, _CABIN),
            (0.44, 1.0, _PILLAR),
            (0.46, 1.0, _CABIN),
            (0.57, 0.97, _SCREEN),
            (0.60, 0.60, _PAINT),
            (0.99, 0.60, _PAINT),
            (1.0, 0.42, _PAINT),
        ),
        0.60,
    ),
    "mpv": BodyStyle(
        (
            (0.0, 0.42, _PAINT),
            (0.02, 0.49, _PAINT),
            (0.09, 0.53, _PAINT),
            (0.19, 0.58, _SCREEN),
            (0.38, 0.955, _CABIN),
            (0.50, 1.0, _PILLAR),
            (0.53, 1.0, _CABIN),
            (0.94, 0.96, _SCREEN),
            (0.985, 0.60, _PAINT),
            (1.0, 0.44, _PAINT),
        ),
        0.58,
    ),
    "van": BodyStyle(
        (
            (0.0, 0.36, _PAINT),
            (0.015, 0.43, _PAINT),
            (0.07, 0.47, _PAINT),
            (0.15, 0.52, _SCREEN),
            (0.29, 0.95, _CABIN),
            (0.36, 0.99, _PILLAR),
            (0.45, 1.0, _PAINT),
            (0.97, 1.0, _PAINT),
            (0.99, 0.97, _PAINT),
            (1.0, 0.90, _PAINT),
        ),
        0.52,
    ),
}


def _profile(style: BodyStyle, rng: np.random.Generator) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """The style's stations, each gap and height varied by up to ten per cent."""
    u = np.array([station[0] for station in style.stations])
    top = np.array([station[1] for station in style.stations])
    gaps = np.diff(u) * rng.uniform(0.9, 1.1, len(u) - 1)
    u = np.concatenate([[0.0], np.cumsum(gaps) / gaps.sum()])
    low = top < 0.9
    top = np.where(low, top * (1 + 0.05 * rng.uniform(-1, 1)) + 0.015 * rng.uniform(-1, 1, len(top)), top)
    return u, np.minimum(top, 1.0)


def _rings(
    style: BodyStyle, u: Float[np.ndarray, " k"], top: Float[np.ndarray, " k"], rng: np.random.Generator
) -> Float[np.ndarray, "k 10 3"]:
    """Sections of a body of length, width and height 1 (y from -0.5 to 0.5, z from the sill up to 1)."""
    nose, tail = rng.uniform(0.80, 0.90), rng.uniform(0.84, 0.94)
    plan = np.interp(u, [0, 0.03, 0.14, 0.85, 0.96, 1.0], [nose, 0.5 + nose / 2, 1, 1, 0.5 + tail / 2, tail]) / 2
    glazed = top > style.belt + 0.06
    belt = np.where(glazed, style.belt, top - 0.04)
    roof = plan * np.where(glazed, rng.uniform(0.74, 0.84), 0.92)
    sill = rng.uniform(0.11, 0.15) + 0.05 * np.interp(u, [0, 0.06, 0.94, 1], [1, 0, 0, 1])
    shoulder = np.minimum(0.34, belt - 0.05)
    y = np.stack([0.88 * plan, plan, 0.985 * plan, roof, 0.72 * roof], axis=1)
    z = np.stack([sill, shoulder, belt, top - np.where(glazed, 0.05, 0.02), top], axis=1)
    ring_y, ring_z = np.concatenate([y, -y[:, ::-1]], axis=1), np.concatenate([z, z[:, ::-1]], axis=1)
    return np.stack([np.broadcast_to(0.5 - u[:, None], ring_y.shape), ring_y, ring_z], axis=-1)


def _skin(style: BodyStyle) -> Int[np.ndarray, "k1 10"]:
    """Material of each cell between sections: glass for screens and side windows, dark trim below the sill."""
    skin = np.full((len(style.stations) - 1, 10), int(Material.CAR_PAINT))
    skin[:, [0, 8]] = Material.CAR_PAINT
    skin[:, 9] = Material.TRIM
    for row, (_, _, follows) in enumerate(style.stations[:-1]):
        if follows == _SCREEN:
            skin[row, 2:7] = Material.GLASS
        elif follows == _CABIN:
            skin[row, [2, 6]] = Material.GLASS
    return skin


def _patch(x_m: float, y_m: float, z_m: float, width_m: float, height_m: float) -> Float[np.ndarray, "4 3"]:
    half = np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]]) / 2
    return np.array([x_m, y_m, z_m]) + half * [0.0, width_m, height_m]


def _arches(axles_m: tuple[float, float], width_m: float, radius_m: float) -> Mesh:
    """Dark half rings around the upper halves of the wheels."""
    angle = np.linspace(0.0, np.pi, 7)
    strips: list[Float[np.ndarray, "6 4 3"]] = []
    for x in axles_m:
        for side in (1, -1):
            inner, outer = (
                np.stack(
                    [x + r * np.cos(angle), np.full(7, side * (width_m / 2 - 0.004)), radius_m + r * np.sin(angle)], 1
                )
                for r in (radius_m, 1.17 * radius_m)
            )
            strips.append(np.stack([inner[:-1], inner[1:], outer[1:], outer[:-1]], axis=1))
    return quads(np.concatenate(strips), int(Material.TRIM))


def _marks(length_m: float, width_m: float, height_m: float, rng: np.random.Generator) -> list[Mesh]:
    """Lamps, number plates on both ends, and a grille, as patches just off the body."""
    face, lamp_z, plate_z = 0.004, rng.uniform(0.36, 0.41) * height_m, 0.34 * height_m
    lamp = np.array([rng.uniform(0.12, 0.19) * width_m, rng.uniform(0.05, 0.09) * height_m])
    patches = [
        _patch(sign * (length_m / 2 + face), side * 0.31 * width_m, lamp_z, *lamp)
        for sign in (1, -1)
        for side in (1, -1)
    ]
    patches.append(_patch(-length_m / 2 - face, 0.0, plate_z, 0.42, 0.13))
    patches.append(_patch(length_m / 2 + 2 * face, 0.0, 0.24 * height_m, 0.42, 0.12))
    lights = quads(np.stack(patches), np.array([int(Material.LAMP)] * 4 + [int(Material.PLATE)] * 2))
    grille = quads(_patch(length_m / 2 + face, 0.0, 0.30 * height_m, 0.5 * width_m, 0.14 * height_m)[None], _TRIM)
    return [lights, grille]


def _extras(style_name: str, length_m: float, width_m: float, height_m: float, rng: np.random.Generator) -> list[Mesh]:
    """Mirrors, and by chance roof rails or what a pickup carries."""
    belt, front = BODY_STYLES[style_name].belt * height_m, 0.18 * length_m
    parts = [
        box([0.10, 0.07 * width_m, 0.13], [front, side * 0.465 * width_m, belt + 0.08], int(Material.CAR_PAINT))
        for side in (1, -1)
    ]
    draw, load = rng.random(), rng.random(4)
    if style_name in ("estate", "suv") and draw < 0.5:
        y, z = 0.33 * width_m, height_m - 0.02
        parts += [
            tube([0.05 * length_m, side * y, z], [-0.4 * length_m, side * y, z], 0.025, int(Material.METAL), sides=4)
            for side in (1, -1)
        ]
    if style_name == "pickup" and draw < 0.45:
        size = np.array([0.12 + 0.2 * load[0], (0.4 + 0.3 * load[1]) * width_m / length_m, 0.15 + 0.2 * load[2]])
        size *= [length_m, length_m, height_m]
        x = -0.3 * length_m + (load[3] - 0.5) * 0.1 * length_m
        parts.append(box(size.tolist(), [x, 0.0, 0.58 * height_m + size[2] / 2], int(Material.CARGO)))
    return parts


def build_car(style_name: str, size_m: Float[np.ndarray, " 3"], rng: np.random.Generator) -> Mesh:
    """Build one car.

    Args:
        style_name: A key of ``BODY_STYLES``.
        size_m: Length, width, height; a roof box counts as part of the height.
        rng: Varies the shape by about ten per cent and draws the paint.

    Returns:
        A painted mesh of about 650 triangles, x forward, standing on z = 0, exactly as large as ``size_m``.
    """
    style = BODY_STYLES[style_name]
    length, width, total_height = (float(value) for value in size_m)
    box_m = 0.30 if style_name in ("estate", "suv", "mpv") and total_height > 1.78 and rng.random() < 0.15 else 0.0
    height = total_height - box_m
    u, top = _profile(style, rng)
    body = loft(_rings(style, u, top, rng) * [length, width, height], _skin(style), int(Material.CAR_PAINT))
    radius = float(np.clip(0.205 * height, 0.28, 0.40) * rng.uniform(0.96, 1.06))
    axles = ((0.5 - rng.uniform(0.165, 0.20)) * length, (0.5 - rng.uniform(0.78, 0.82)) * length)
    wheels = [wheel(x, side * width / 2, radius, 0.22) for x in axles for side in (1, -1)]
    rows = (0.02 * length,) if style_name == "pickup" else (0.0, -0.9)
    seats = [box([0.5, 0.7 * width, 0.5 * height], [x, 0.0, 0.50 * height], int(Material.CLOTH)) for x in rows]
    parts = [body, *wheels, _arches(axles, width, radius), *seats, *_marks(length, width, height, rng)]
    parts += _extras(style_name, length, width, height, rng)
    if box_m:
        size = [0.38 * length, 0.45 * width, box_m]
        parts.append(box(size, [-0.12 * length, 0.0, height + box_m / 2], _TRIM))
    return Mesh.merge(parts).fitted(size_m).painted(rng)


# Trucks, buses, trailers: cabs, cargo bodies, chassis gaps and wheels

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
