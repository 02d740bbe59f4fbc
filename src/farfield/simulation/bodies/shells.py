"""Cars, vans and buses of world v3: curved skins over outlines, wheels in arches, glass with seats behind it."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import Mesh, box, fan, grid, quads, tube
from farfield.simulation.bodies.outlines import OUTLINES, Outline

# Across the upper skin, from the middle to the edge: where its points lie, and their shares of bow and drop.
_ACROSS = np.array([-1.0, -0.82, -0.5, 0.0, 0.5, 0.82, 1.0])
_BOW = np.abs(_ACROSS) ** 2.5
_DROP = np.abs(_ACROSS) ** 3
_WALL = (np.abs(_ACROSS) == 1).astype(np.float64)
# Corners of a wheel arch: along the axle's direction and above it, as shares of the arch's radius.
_ARCH = np.array([[-1.06, -1.0], [-0.97, 0.24], [-0.5, 0.9], [0.5, 0.9], [0.97, 0.24], [1.06, -1.0]])
# Half width along the length, from the front to the rear: the corners are round, the sides slightly bowed.
_PLAN = np.array(
    [
        [0.0, 0.05, 0.075, 0.10, 0.15, 0.25, 0.45, 0.75, 0.85, 0.90, 0.95, 1.0],
        [0.86, 0.86, 0.89, 0.92, 0.96, 0.985, 1.0, 0.995, 0.98, 0.96, 0.91, 0.89],
    ]
)
_SHOULDER = 0.50  # height of the widest line of the sides
_FRAME = 0.14  # of the way from the roof's edge to the belt is a frame over the side windows
_MIRROR_M = (0.11, 0.19, 0.14)
_TYRE_M = 0.21
_DRIVEN = 0.5  # share of bodies with somebody at the wheel: a body does not know whether it will be parked

_SKIN_OF = {
    "apron": (Material.TRIM,) * 3,
    "face": (Material.CAR_PAINT,) * 3,
    "grille": (Material.LAMP, Material.TRIM, Material.TRIM),
    "lamps": (Material.LAMP, Material.CAR_PAINT, Material.CAR_PAINT),
    "bonnet": (Material.CAR_PAINT,) * 3,
    "screen": (Material.CAR_PAINT, Material.GLASS, Material.GLASS),
    "roof": (Material.CAR_PAINT,) * 3,
    "boot": (Material.CAR_PAINT,) * 3,
    "rear": (Material.CAR_PAINT,) * 3,
    "bed": (Material.CAR_PAINT, Material.TRIM, Material.TRIM),
}
"""Materials of the upper skin's cells from the edge to the middle, by part."""


class Shell:
    """One body's measures: an outline, varied, in metres; x forward, the middle of the bottom at 0.

    Args:
        outline: The family.
        size_m: Length, width, height without mirrors.
        rng: Varies proportions.
    """

    def __init__(self, outline: Outline, size_m: Float[np.ndarray, " 3"], rng: np.random.Generator) -> None:
        self.outline = outline
        self.length_m, self.width_m, self.height_m = (float(value) for value in size_m)
        table = np.array([point[:5] for point in outline.points])
        self.parts = [point.part for point in outline.points[:-1]]
        bow, drop, lean, raised = (
            rng.uniform(0.75, 1.25),
            rng.uniform(0.8, 1.2),
            rng.normal(0, 0.012),
            rng.normal(0, 0.01),
        )
        u, v, half = table[:, 0], table[:, 1], table[:, 2]
        inner = (u > 0.1) & (u < 0.93)
        moved = np.maximum.accumulate(u + rng.normal(0, 0.010) + rng.normal(0, 0.004, len(u)))
        u = np.where(inner, moved, u)
        low = (v < 0.8) & (v > 0.3)
        v = np.where(low, v + raised, v)
        half = np.where(v > 0.8, half + lean, half)
        self.x_m = (0.5 - u) * self.length_m
        self.z_m = v * self.height_m
        self.half_m = half * self.width_m / 2
        self.drop_m = np.where(table[:, 3] > 0, drop, 1.0) * table[:, 3] * self.height_m
        self.bow_m = bow * table[:, 4] * self.length_m * -np.sign(self.x_m)
        self.radius_m = outline.wheel * rng.uniform(0.96, 1.05)
        self.axles_m = [(0.5 - axle + rng.normal(0, 0.005)) * self.length_m for axle in outline.axles]
        self.belt_v = np.array(outline.belt) + raised
        self.driver = bool(rng.random() < _DRIVEN)
        self.floor_m = outline.floor * self.height_m * rng.uniform(0.92, 1.08)

    def body(self) -> Mesh:
        """All but mirrors and rails."""
        side, outer = self.side(), 0.965 * self.width_m / 2
        wheels = [standing_wheel(x, sign * outer, self.radius_m) for x in self.axles_m for sign in (1, -1)]
        return Mesh.merge([self.skin(), side, side.mirrored(), self.below(), self.plates(), *wheels, *self.inside()])

    def skin(self) -> Mesh:
        """The upper skin: bumpers, bonnet, screens, roof, boot or bed."""
        lowered = np.where(self.drop_m[:, None] > 0, _DROP * self.drop_m[:, None], _WALL * self.drop_m[:, None])
        rows = np.stack(
            [
                self.x_m[:, None] + _BOW * self.bow_m[:, None],
                _ACROSS * self.half_m[:, None],
                self.z_m[:, None] - lowered,
            ],
            axis=-1,
        )
        cells = np.array([(*_SKIN_OF[part], *_SKIN_OF[part][::-1]) for part in self.parts])
        return grid(rows, cells)

    def stations(self) -> Float[np.ndarray, " k"]:
        """Where the sides have corners, as positions along the points of the outline."""
        edge_x = self.x_m + self.bow_m
        spans = (0.5 - np.array(self.outline.windows).ravel()) * self.length_m
        arches = [axle + 1.12 * self.radius_m * _ARCH[:, 0] for axle in self.axles_m]
        inner = np.concatenate([spans, *arches])
        backwards = np.maximum.accumulate(-edge_x)  # bumpers' lower edges lie a little behind what is above them
        inner = inner[(inner < edge_x.max() - 0.02) & (inner > edge_x.min() + 0.02)]
        at = np.interp(-inner, backwards, np.arange(len(edge_x)))
        return np.unique(np.concatenate([np.arange(len(edge_x)), at]))

    def side(self) -> Mesh:
        """The left side: windows between roof and belt, doors below, cut out around the wheels."""
        at, index = self.stations(), np.arange(len(self.x_m))
        x = np.interp(at, index, self.x_m + self.bow_m)
        edge = np.interp(at, index, self.z_m - self.drop_m)
        edge_y = np.interp(at, index, self.half_m)
        u = 0.5 - x / self.length_m
        end = (1 - self.outline.rounding * (1 - np.interp(u, *_PLAN))) * self.width_m / 2
        shoulder = np.full(len(x), min(_SHOULDER, float(self.belt_v.min()) - 0.03) * self.height_m)
        low = self._lower_edge(x, shoulder)
        belt = np.interp(u, [0.2, 0.85], self.belt_v) * self.height_m
        rows = [(edge_y, edge)]
        frame = edge - _FRAME * np.maximum(edge - belt, 0.0)
        rows.append((edge_y + _FRAME * np.where(edge > belt, 0.95 * end - edge_y, 0.0), frame))
        levels = [(0.95, belt), (1.0, shoulder), (0.99, (shoulder + low) / 2), (0.945, low)]
        for share, level in levels if self.outline.rounding == 1 else [*levels[:2], levels[3]]:
            above = level >= edge - 0.005
            rows.append((np.where(above, edge_y, share * end), np.minimum(level, edge)))
        lines = np.stack([np.stack([x, y, z], axis=-1) for y, z in rows], axis=1)
        cells = np.full((len(x) - 1, lines.shape[1] - 1), int(Material.CAR_PAINT))
        middle = (u[1:] + u[:-1]) / 2
        cells[self._is_window(middle), 1] = int(Material.GLASS)
        return grid(lines, cells)

    def _is_window(self, u: Float[np.ndarray, " k"]) -> Bool[np.ndarray, " k"]:
        return np.any([(u > first) & (u < last) for first, last in self.outline.windows], axis=0)

    def _lower_edge(self, x: Float[np.ndarray, " k"], shoulder: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """Height of the sides' lower edge: the sill, and the arches over the wheels."""
        low = np.full(len(x), self.floor_m)
        radius = 1.12 * self.radius_m
        for axle in self.axles_m:
            across = (x - axle) / radius
            arch = np.interp(across, _ARCH[:, 0], _ARCH[:, 1], left=-9.0, right=-9.0)
            low = np.maximum(low, self.radius_m + radius * arch)
        return np.minimum(low, shoulder - 0.02)

    def below(self) -> Mesh:
        """Floor, sills and the insides of the arches, dark."""
        front, rear = (float(self.x_m[row] + self.bow_m[row]) for row in (0, -1))
        wide, inner, z = 0.955 * self.width_m / 2, self.width_m / 2 - _TYRE_M - 0.08, self.floor_m
        radius = 1.12 * self.radius_m
        strips = [[[front, -inner, z], [front, inner, z], [rear, inner, z], [rear, -inner, z]]]
        cuts = [front, *(axle + sign * 1.06 * radius for axle in self.axles_m for sign in (1, -1)), rear]
        for first, last in zip(cuts[::2], cuts[1::2], strict=True):
            outer = 0.84 * wide if first == front or last == rear else wide
            for side in (1, -1):
                y = (side * inner, side * outer)
                strips.append([[first, y[0], z], [first, y[1], z], [last, y[1], z], [last, y[0], z]])
        corners = np.maximum(_ARCH[:, 1] * radius + self.radius_m, z)
        for axle in self.axles_m:
            x = axle + _ARCH[:, 0] * radius
            for side in (1, -1):
                y = (side * inner, side * wide)
                for i in range(len(x) - 1):
                    a, b, high_a, high_b = x[i], x[i + 1], corners[i], corners[i + 1]
                    strips.append([[a, y[0], high_a], [a, y[1], high_a], [b, y[1], high_b], [b, y[0], high_b]])
                    strips.append([[a, y[0], z], [a, y[0], high_a], [b, y[0], high_b], [b, y[0], z]])
        return quads(np.array(strips), int(Material.TRIM))

    def inside(self) -> list[Mesh]:
        """Dashboard, seats with head rests, and the shelf or cover behind the last of them."""
        length, half, height = self.length_m, self.width_m / 2, self.height_m
        belt = float(self.belt_v[0]) * height
        cowl = float(self.x_m[self.parts.index("screen")])
        wide = 0.80 * half
        parts = [box([0.35, 2 * wide, 0.22], [cowl - 0.28, 0, belt - 0.10], int(Material.TRIM))]
        over = 0.10 + 0.25 * float(
            np.clip(height - 2.3, 0.0, 1.0)
        )  # seats' backs over the belt; buses have high floors
        for row, seat in enumerate(self.outline.seats):
            x, low, top = (0.5 - seat) * length, self.floor_m + 0.22, min(belt + over, 0.74 * height)
            backs = [(side * 0.42 * half, 0.52) for side in (1, -1)] if row == 0 else [(0.0, 2 * wide)]
            seats = [box([0.14, w, top - low], [x, y, (top + low) / 2], int(Material.CLOTH)) for y, w in backs]
            heads = [0.42 * half, -0.42 * half]
            seats += [box([0.10, 0.28, 0.18], [x, y, top + 0.10], int(Material.CLOTH)) for y in heads]
            parts += [_reclined(seat, low) for seat in seats]
        at_wheel = [cowl - 0.62, 0.42 * half, belt - 0.02]
        parts.append(box([0.06, 0.36, 0.30], at_wheel, int(Material.TRIM)))
        if self.driver:
            x, y, z = (0.5 - self.outline.seats[0]) * length + 0.22, 0.42 * half, min(belt + 0.06, 0.72 * height)
            parts.append(box([0.24, 0.44, 0.50], [x, y, z - 0.17], int(Material.CLOTH)))
            parts.append(box([0.18, 0.16, 0.24], [x, y, z + 0.16], int(Material.SKIN)))
        if self.outline.cover:
            x, z = (0.5 - self.outline.seats[-1]) * length, float(self.belt_v[1]) * height - 0.04
            rear = float(self.x_m[-4]) + 0.12
            parts.append(
                quads(np.array([[[x, -wide, z], [x, wide, z], [rear, wide, z], [rear, -wide, z]]]), int(Material.TRIM))
            )
        return parts

    def plates(self) -> Mesh:
        """Number plates on both ends."""
        front, rear = float(self.x_m.max()) + 0.006, float(min(self.x_m.min() + 0.006, self.x_m[-3] - 0.012))
        rear_z = 0.5 * float(self.z_m[-3] + self.z_m[-2])
        patches = [_patch(front, 0.0, float(self.z_m[1]), 0.46, 0.11), _patch(rear, 0.0, rear_z, 0.46, 0.12)]
        return quads(np.stack(patches), int(Material.PLATE))

    def mirrors(self) -> list[Mesh]:
        """Both mirrors: they stand out beside the body's width."""
        belt = float(self.belt_v[0]) * self.height_m
        x = (0.5 - self.outline.windows[0][0]) * self.length_m - 0.06
        y = 0.93 * self.width_m / 2 + _MIRROR_M[1] / 2
        return [box(_MIRROR_M, [x, side * y, belt + 0.09], int(Material.CAR_PAINT)) for side in (1, -1)]

    def rails(self) -> list[Mesh]:
        """Rails along the roof."""
        roof = [row for row, part in enumerate(self.parts) if part == "roof"]
        first, last = float(self.x_m[roof[0]]) - 0.15, float(self.x_m[roof[-1] + 1]) + 0.1
        y, z = float(self.half_m[roof[0]]) - 0.06, self.height_m - 0.03
        return [tube([first, s * y, z], [last, s * y, z], 0.02, int(Material.METAL), sides=4) for s in (1, -1)]


def _reclined(part: Mesh, from_m: float) -> Mesh:
    """A seat's back that leans backwards by 15 degrees over a height."""
    lean = np.tan(np.radians(15.0)) * (part.vertices_m[:, 2:] - from_m)
    return replace(part, vertices_m=part.vertices_m - lean * [1.0, 0.0, 0.0])


def _patch(x_m: float, y_m: float, z_m: float, width_m: float, height_m: float) -> Float[np.ndarray, "4 3"]:
    half = np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]]) / 2
    return np.array([x_m, y_m, z_m]) + half * [0.0, width_m, height_m]


def standing_wheel(x_m: float, outer_y_m: float, radius_m: float) -> Mesh:
    """A wheel without its unseen inner face: tread, side wall, and a rim that lies a little deeper."""
    side = float(np.sign(outer_y_m))
    angle = 2 * np.pi * np.arange(10) / 10
    circle = np.stack([np.cos(angle), np.zeros(10), np.sin(angle)], axis=1)
    depths, radii = (_TYRE_M, 0.0, 0.015), (1.0, 1.0, 0.64)
    rings = [
        [x_m, outer_y_m - side * depth, radius_m] + share * radius_m * circle
        for depth, share in zip(depths, radii, strict=True)
    ]
    tyre = grid(np.stack(rings), int(Material.TYRE), closed=True)
    return Mesh.merge([tyre, fan(rings[2], int(Material.METAL))])


def build_shell(kind: str, size_m: Float[np.ndarray, " 3"], rng: np.random.Generator) -> Mesh:
    """Build one car, van or bus.

    Args:
        kind: A key of ``OUTLINES``.
        size_m: Length, width, height as they are published and annotated: without the mirrors.
        rng: Draws the family, its variation and the paint.

    Returns:
        A painted mesh of about 1,200 triangles, x forward, standing on z = 0; exactly as large as ``size_m`` but for
        the mirrors, which stand out by about 0.1 m to each side.
    """
    families = OUTLINES[kind]
    outline = families[int(rng.choice(len(families), p=[share for share, _ in families]))][1]
    shell = Shell(outline, size_m, rng)
    whole = shell.body()
    if rng.random() < outline.rails:
        whole = Mesh.merge([whole, *shell.rails()])
    return Mesh.merge([whole, *shell.mirrors()]).fitted(size_m, like=whole).painted(rng)
