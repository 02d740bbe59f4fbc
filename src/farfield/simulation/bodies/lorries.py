"""Lorries of world v3: cabs with curved skins, ribbed or curtained boxes with doors, guards, tanks and mudguards."""

import numpy as np
from jaxtyping import Float

from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import Mesh, box, grid, quads, tube
from farfield.simulation.bodies.outlines import cab
from farfield.simulation.bodies.shells import Shell, standing_wheel

_RIB_M, _MOST_RIBS = 0.035, 24
_LAMPS = np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]]) / 2


def _wall(
    rear_m: float, front_m: float, y_m: float, low_m: float, high_m: float, material: int, rng: np.random.Generator
) -> Mesh:
    """A box's side: ribs as of a container, or a curtain that bulges between its posts."""
    inward = -float(np.sign(y_m))
    if rng.random() < 0.5:
        count = int(np.clip((front_m - rear_m) / 0.28, 6, _MOST_RIBS))
        x = np.linspace(rear_m, front_m, 2 * count)
        depth = np.where(np.arange(2 * count) // 2 % 2 == 1, _RIB_M, 0.0)
        rows = np.array([[[at, y_m + inward * d, z] for z in (low_m, high_m)] for at, d in zip(x, depth, strict=True)])
        return grid(rows, material)
    posts = max(2, round((front_m - rear_m) / 2.5))
    across, up = np.linspace(0, 1, 4 * posts + 1), np.linspace(0, 1, 5)
    bulge = np.sin(np.pi * posts * across)[:, None] ** 2 * np.sin(np.pi * up)[None]
    y = y_m + inward * 0.04 * (1 - bulge)
    x = np.broadcast_to((rear_m + (front_m - rear_m) * across)[:, None], y.shape)
    z = np.broadcast_to((low_m + (high_m - low_m) * up)[None], y.shape)
    return grid(np.stack([x, y, z], axis=-1), material)


def _closed(
    rear_m: float, front_m: float, width_m: float, low_m: float, high_m: float, rng: np.random.Generator
) -> list[Mesh]:
    """A closed box: sides, flat ends and roof, two doors with bars that lock them."""
    half, cargo = width_m / 2, int(Material.CARGO)
    ends = [
        [[x, -half, low_m], [x, half, low_m], [x, half, high_m], [x, -half, high_m]] for x in (front_m, rear_m + 0.03)
    ]
    levels = [[[rear_m, -half, z], [rear_m, half, z], [front_m, half, z], [front_m, -half, z]] for z in (low_m, high_m)]
    seed = rng.integers(1 << 32)  # both sides alike
    parts = [_wall(rear_m, front_m, s * half, low_m, high_m, cargo, np.random.default_rng(seed)) for s in (1, -1)]
    parts.append(quads(np.array([*ends, *levels]), cargo))
    bar_m, bar_z = [0.03, 0.04, high_m - low_m - 0.2], (low_m + high_m) / 2
    bars = [box(bar_m, [rear_m + 0.015, share * width_m, bar_z], cargo) for share in (-0.3, -0.08, 0.08, 0.3)]
    return [*parts, *bars]


def _open(
    rear_m: float, front_m: float, width_m: float, low_m: float, high_m: float, rng: np.random.Generator
) -> list[Mesh]:
    """An open body with ribbed walls and a heap in it, or nothing."""
    half, paint, tall, z = width_m / 2, int(Material.CAR_PAINT), high_m - low_m, (high_m + low_m) / 2
    length, middle = front_m - rear_m, (front_m + rear_m) / 2
    posts = np.linspace(rear_m + 0.3, front_m - 0.3, max(2, round(length / 1.2)))
    parts = [box([length, width_m, 0.12], [middle, 0, low_m + 0.06], int(Material.METAL))]
    parts += [box([0.08, width_m, tall], [x, 0, z], paint) for x in (front_m - 0.04, rear_m + 0.04)]
    for side in (1, -1):
        parts.append(box([length, 0.05, tall], [middle, side * (half - 0.04), z], paint))
        parts += [box([0.09, 0.04, tall], [x, side * (half - 0.02), z], paint) for x in posts]
    if rng.random() < 0.6:
        along, across = np.linspace(0, 1, 7), np.linspace(0, 1, 5)
        heap = low_m + (high_m - low_m) * (0.45 + 0.5 * np.sin(np.pi * along)[:, None] * np.sin(np.pi * across)[None])
        heap += rng.normal(0, 0.05, heap.shape)
        x = np.broadcast_to((rear_m + 0.08 + (length - 0.16) * along)[:, None], heap.shape)
        y = np.broadcast_to(((across - 0.5) * (width_m - 0.14))[None], heap.shape)
        parts.append(grid(np.stack([x, y, np.minimum(heap, high_m - 0.05)], axis=-1), int(Material.SOIL)))
    return parts


def _load(
    kind: str, rear_m: float, front_m: float, width_m: float, high_m: float, rng: np.random.Generator
) -> list[Mesh]:
    """What a lorry carries between two positions along its length."""
    floor = rng.uniform(1.0, 1.25) if kind != "light_truck" else min(0.85, 0.4 * high_m)
    if kind in ("box", "semi") or (kind == "light_truck" and rng.random() < 0.45):
        return _closed(rear_m, front_m, width_m, floor, high_m, rng)
    if kind == "tanker":
        radius = min(width_m / 2, (high_m - floor) / 2) * 0.96
        axis, middle = high_m - radius, (rear_m + front_m) / 2
        walk = box([0.6 * (front_m - rear_m), 0.5, 0.04], [middle, 0, high_m - 0.02], int(Material.METAL))
        body = tube([rear_m, 0, axis], [front_m, 0, axis], radius, int(Material.METAL), sides=14, round_ends=True)
        return [body, walk]
    if kind == "tipper":
        return _open(rear_m, front_m, width_m, floor - 0.1, high_m - 0.1, rng)
    parts = _open(rear_m, front_m, width_m, floor - 0.1, floor + rng.uniform(0.25, 0.5), rng)
    parts.append(box([0.08, width_m, high_m - floor], [front_m, 0, (high_m + floor) / 2], int(Material.METAL)))
    for _ in range(int(rng.integers(0, 3))):
        size = np.array([rng.uniform(0.15, 0.4) * (front_m - rear_m), rng.uniform(0.4, 0.85) * width_m, 0.0])
        size[2] = min(rng.uniform(0.4, 1.2), high_m - floor - 0.1)
        x = rng.uniform(rear_m + size[0] / 2 + 0.1, front_m - size[0] / 2 - 0.1)
        parts.append(box(size.tolist(), [x, 0, floor + size[2] / 2], int(Material.CARGO)))
    return parts


def _chassis(
    rear_m: float, front_m: float, width_m: float, axles_m: list[float], radius_m: float, rng: np.random.Generator
) -> list[Mesh]:
    """Beam, wheels under mudguards, guards or a tank between the axles, bar and lamps behind."""
    metal, trim, half = int(Material.METAL), int(Material.TRIM), width_m / 2
    parts = [box([front_m - rear_m - 0.2, 0.9, 0.25], [(front_m + rear_m) / 2, 0, 0.85], metal)]
    parts += [standing_wheel(x, s * (half - 0.03), radius_m) for x in axles_m for s in (1, -1)]
    for x in axles_m:
        parts += [box([2.1 * radius_m, 0.35, 0.03], [x, s * (half - 0.2), 2.12 * radius_m], trim) for s in (1, -1)]
    gap_front, gap_rear = front_m - 0.1, max(axles_m) + 1.3 * radius_m
    if gap_front - gap_rear > 0.8:
        middle, span = (gap_front + gap_rear) / 2, gap_front - gap_rear
        if rng.random() < 0.5:
            ends = [[at, half - 0.35, 0.72] for at in (gap_rear, gap_rear + 0.6 * span)]
            tank = tube(ends[0], ends[1], 0.28, metal)
            parts += [tank, tank.mirrored()]
        else:
            guards = [box([span, 0.03, 0.12], [middle, half - 0.06, z], metal) for z in (0.5, 0.8)]
            parts += [*guards, *(guard.mirrored() for guard in guards)]
    parts.append(box([0.08, 0.9 * width_m, 0.15], [rear_m + 0.15, 0, 0.5], metal))
    lamps = [[rear_m + 0.02, s * 0.42 * width_m, 0.95] + _LAMPS * [0, 0.3, 0.14] for s in (1, -1)]
    plate = [rear_m + 0.02, 0.0, 0.95] + _LAMPS * [0, 0.5, 0.13]
    parts.append(quads(np.stack([*lamps, plate]), np.array([int(Material.LAMP)] * 2 + [int(Material.PLATE)])))
    return parts


def build_lorry(kind: str, size_m: Float[np.ndarray, " 3"], rng: np.random.Generator) -> Mesh:
    """Build a lorry: a cab over its engine or behind a bonnet, what it carries, and what is below.

    Args:
        kind: One of ``TRUCK_STYLES``.
        size_m: Length, width, height without the mirrors.
        rng: Draws proportions, load and paint.

    Returns:
        A painted mesh of about 1,200 triangles, x forward, standing on z = 0; exactly as large as ``size_m`` but for
        the mirrors.
    """
    length, width, height = (float(value) for value in size_m)
    light, bonnet = kind == "light_truck", kind != "light_truck" and rng.random() < 0.2
    cab_m = float(np.clip(rng.uniform(1.6, 2.3) + (1.4 if bonnet else 0.0), 1.4, 0.42 * length))
    cab_high = height * (rng.uniform(0.82, 0.98) if kind in ("box", "semi") else rng.uniform(0.94, 1.0))
    shell = Shell(cab(bonnet), np.array([cab_m, 0.97 * width, cab_high]), rng)
    shell.radius_m = float(rng.uniform(0.33, 0.38) if light else rng.uniform(0.46, 0.53))
    x, rear = (length - cab_m) / 2, -length / 2
    front = length / 2 - cab_m - (rng.uniform(0.6, 1.1) if kind == "semi" else rng.uniform(0.1, 0.35))
    axles = [rear + rng.uniform(0.16, 0.24) * min(length, 9.0)]
    step = 2.5 * shell.radius_m
    if length > 8:
        axles.append(axles[0] + step)
    if kind == "semi":
        axles += [front - 0.1, front - 0.1 - step] if rng.random() < 0.6 else [front - 0.3]
    parts = [shell.body().placed(x, 0.0), *_load(kind, rear, front, width, height, rng)]
    parts += _chassis(rear, front + 0.4, width, axles, shell.radius_m, rng)
    whole = Mesh.merge(parts)
    mirrors = [part.placed(x, 0.0) for part in shell.mirrors()]
    return Mesh.merge([whole, *mirrors]).fitted(size_m, like=whole).painted(rng)
