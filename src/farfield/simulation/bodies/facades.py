"""Fronts with relief: windows set back into the wall, sills, doors, plinths, pilasters, balconies, awnings.

Frames are those of ``furniture.building``: x along the street, the front at y = 0, the body at y > 0, out is negative.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float64

from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import Mesh, box, quads
from farfield.simulation.bodies.street import uprights

_GLASS, _TRIM, _CLOTH, _METAL, _CONCRETE = (
    int(m) for m in (Material.GLASS, Material.TRIM, Material.CLOTH, Material.METAL, Material.CONCRETE)
)
_FLOOR_M, _DOOR_M = 3.1, 2.15


@dataclass(frozen=True)
class _Openings:
    """Windows and one door as rectangles of the front.

    Args:
        x_m: Edges of the wall's columns in turn with the openings', shape (2 * columns + 2,).
        z_m: Edges of the rows likewise, shape (2 * rows + 2,); the first opening row begins at the ground.
        door: The column of the door in the lowest row.
    """

    x_m: Float64[np.ndarray, " a"]
    z_m: Float64[np.ndarray, " b"]
    door: int

    def rectangles(self) -> tuple[Float64[np.ndarray, "n 4"], Bool[np.ndarray, " n"]]:
        """Left, right, bottom and top of the openings, shape (n, 4), and which of them is the door."""
        column, row = (grid.reshape(-1) for grid in np.meshgrid(*map(np.arange, self.shape), indexing="ij"))
        door = (row == 0) & (column == self.door)
        low = np.where(door, 0.0, self.z_m[2 * row + 1])
        rectangle = [self.x_m[2 * column + 1], self.x_m[2 * column + 2], low, self.z_m[2 * row + 2]]
        return np.column_stack(rectangle), door

    @property
    def shape(self) -> tuple[int, int]:
        """Columns and rows of openings."""
        return len(self.x_m) // 2 - 1, len(self.z_m) // 2 - 1


def _draw_openings(length_m: float, height_m: float, rng: np.random.Generator) -> _Openings:
    columns, rows = max(1, int(length_m / rng.uniform(2.2, 3.5))), max(1, int(height_m / _FLOOR_M))
    share, tall, sill = float(rng.uniform(0.4, 0.62)), float(rng.uniform(1.2, 1.8)), float(rng.uniform(0.5, 0.95))
    bay = length_m / columns
    middle = (np.arange(columns) + 0.5) * bay - length_m / 2
    x = np.concatenate([[-length_m / 2], np.column_stack([middle - share * bay / 2, middle + share * bay / 2]).ravel()])
    low = sill + _FLOOR_M * np.arange(rows)
    high = np.minimum(low + tall, height_m - 0.15)
    high[0] = max(high[0], min(_DOOR_M, height_m - 0.15))
    z = np.concatenate([[-1.0], np.column_stack([low, high]).ravel(), [height_m]])
    return _Openings(np.append(x, length_m / 2), z, int(rng.integers(columns)))


def _across(
    rectangle_m: Float64[np.ndarray, "n 4"], y_m: Float[np.ndarray, " n"] | float
) -> Float64[np.ndarray, "n 4 3"]:
    """Corners of rectangles in planes along the front."""
    left, right, low, high = rectangle_m.T
    corners = np.empty((len(rectangle_m), 4, 3))
    corners[..., 0] = np.stack([left, right, right, left], axis=1)
    corners[..., 1] = np.broadcast_to(np.asarray(y_m, dtype=np.float64).reshape(-1, 1), (len(rectangle_m), 1))
    corners[..., 2] = np.stack([low, low, high, high], axis=1)
    return corners


def _wall_with_holes(openings: _Openings, skin: int) -> Mesh:
    """The front but for its openings: bands between the rows, and pieces beside the openings."""
    columns, rows = openings.shape
    x, z = openings.x_m, openings.z_m
    pieces = [[x[0], x[-1], z[2 * row], z[2 * row + 1]] for row in range(rows + 1)]
    pieces += [
        [x[2 * column], x[2 * column + 1], z[2 * row + 1], z[2 * row + 2]]
        for row in range(rows)
        for column in range(columns + 1)
    ]
    left, right = x[2 * openings.door + 1], x[2 * openings.door + 2]
    pieces[0] = [x[0], left, z[0], z[1]]  # the door reaches the ground
    pieces += [[right, x[-1], z[0], z[1]], [left, right, z[0], 0.0]]
    return quads(_across(np.array(pieces), 0.0), skin)


def _reveals(rectangle_m: Float64[np.ndarray, "n 4"], deep_m: float, skin: int) -> Mesh:
    """The four inner sides of each opening."""
    front, back = _across(rectangle_m, 0.0), _across(rectangle_m, deep_m)
    following = [1, 2, 3, 0]
    sides = np.stack([front, back, back[:, following], front[:, following]], axis=2)
    return quads(sides.reshape(-1, 4, 3), skin)


def _bars(rectangle_m: Float64[np.ndarray, "n 4"], reach_m: float, material: int) -> Mesh:
    """Boxes that stand out from the front, but for their backs: top, bottom, front and ends."""
    front, back = _across(rectangle_m, -reach_m), _across(rectangle_m, 0.0)
    following = [1, 2, 3, 0]
    sides = np.stack([back, front, front[:, following], back[:, following]], axis=2)
    return quads(np.concatenate([front, sides.reshape(-1, 4, 3)]), material)


def _balconies(openings: _Openings, overhang_m: float, rng: np.random.Generator) -> list[Mesh]:
    """Slabs with railings before windows of the upper floors, in some of the columns."""
    columns, rows = openings.shape
    reach, parts = float(rng.uniform(0.8, 1.3)), []
    reach = min(reach, overhang_m)
    for column in np.flatnonzero(rng.random(columns) < 0.4):
        left, right = openings.x_m[2 * column + 1] - 0.4, openings.x_m[2 * column + 2] + 0.4
        for row in range(1, rows):
            floor, middle, wide = float(openings.z_m[2 * row + 1]) - 0.75, float(left + right) / 2, float(right - left)
            parts.append(box([wide, reach, 0.16], [middle, -reach / 2, floor], _CONCRETE))
            bars = uprights(middle + np.linspace(-wide / 2, wide / 2, round(wide / 0.14)), 0.025, 0.0, 1.0, _METAL)
            parts.append(bars.placed(0.0, -reach + 0.04, floor + 0.08))
            parts.append(box([wide, 0.05, 0.05], [middle, -reach + 0.04, floor + 1.08], _METAL))
            parts += [box([0.03, reach, 1.0], [float(x), -reach / 2, floor + 0.58], _METAL) for x in (left, right)]
    return parts


def relief_building(
    length_m: float,
    depth_m: float,
    height_m: float,
    rng: np.random.Generator,
    *,
    overhang_m: float = 1.2,
    porch: bool = False,
) -> Mesh:
    """A block whose front has relief; what stands behind its windows stops rays that pass through the glass.

    Args:
        length_m: Along the street.
        depth_m: Away from it.
        height_m: To the eaves.
        rng: Draws openings and ornaments.
        overhang_m: How far balconies and awnings may reach over the ground before it; below 0.5 there are none.
        porch: Whether steps lead to the door.

    Returns:
        20 triangles a window, and some hundreds for ornaments.
    """
    skin = int(rng.choice([Material.BRICK, Material.CONCRETE]))
    openings, deep = _draw_openings(length_m, height_m, rng), float(rng.uniform(0.08, 0.28))
    rectangle, door = openings.rectangles()
    behind = deep + np.where(rng.random(len(rectangle)) < 0.5, 0.12, rng.uniform(0.6, 3.0, len(rectangle)))
    behind = np.minimum(behind, depth_m - 0.1)
    window = rectangle[~door]
    parts = [
        _shell(length_m, depth_m, height_m, skin),
        _wall_with_holes(openings, skin),
        _reveals(rectangle, deep, skin),
        quads(_across(rectangle, deep), np.where(door, _TRIM, _GLASS)),
        quads(_across(window + np.array([-0.5, 0.5, -0.5, 0.5]), behind[~door]), _CLOTH),
        _bars(np.column_stack([window[:, 0] - 0.06, window[:, 1] + 0.06, window[:, 2] - 0.07, window[:, 2]]),
              float(rng.uniform(0.04, 0.1)), _CONCRETE),
    ]  # fmt: skip
    if rng.random() < 0.6:  # frames and a transom, proud of the pane
        frame = np.column_stack([(window[:, 0] + window[:, 1]) / 2 - 0.03, (window[:, 0] + window[:, 1]) / 2 + 0.03])
        parts.append(quads(_across(np.column_stack([frame, window[:, 2:]]), deep - 0.04), _TRIM))
    ends = openings.x_m[[0, -1]]
    if rng.random() < 0.5:  # cornices between the floors
        levels = openings.z_m[2:-1:2] + 0.35
        levels = levels[levels < height_m - 0.1]
        bands = [[ends[0], ends[1], level - 0.12, level] for level in levels]
        parts += [_bars(np.array(bands), float(rng.uniform(0.06, 0.14)), _CONCRETE)] if bands else []
    if rng.random() < 0.45:  # pilasters between the columns, to the ground
        between = (openings.x_m[2:-2:2] + openings.x_m[3:-1:2]) / 2
        half = float(rng.uniform(0.12, 0.22))
        strips = [[x - half, x + half, -0.3, height_m - 0.1] for x in between]
        parts += [_bars(np.array(strips), float(rng.uniform(0.06, 0.12)), skin)] if strips else []
    parts += _porch(openings, rng) if porch else []
    if overhang_m > 0.5:
        parts += _balconies(openings, overhang_m, rng) if rng.random() < 0.4 else []
        parts += _awnings(rectangle, overhang_m, rng) if rng.random() < 0.25 else []
    return Mesh.merge([part for part in parts if len(part.faces)])


def _shell(length_m: float, depth_m: float, height_m: float, skin: int) -> Mesh:
    """Sides, back and roof of a block."""
    x, low = length_m / 2, -1.0
    sides = [
        [[-x, 0, low], [-x, depth_m, low], [-x, depth_m, height_m], [-x, 0, height_m]],
        [[x, 0, low], [x, depth_m, low], [x, depth_m, height_m], [x, 0, height_m]],
        [[-x, depth_m, low], [x, depth_m, low], [x, depth_m, height_m], [-x, depth_m, height_m]],
        [[-x, 0, height_m], [x, 0, height_m], [x, depth_m, height_m], [-x, depth_m, height_m]],
    ]
    return quads(np.array(sides), skin)


def _awnings(rectangle_m: Float64[np.ndarray, "n 4"], overhang_m: float, rng: np.random.Generator) -> list[Mesh]:
    """Cloth over the windows of the ground floor, sloping outwards."""
    ground = rectangle_m[rectangle_m[:, 3] < _FLOOR_M]
    reach, drop = min(float(rng.uniform(0.7, 1.2)), overhang_m), float(rng.uniform(0.15, 0.3))
    slopes = []
    for left, right, _, high in ground:
        top = max(float(high) + 0.1, 2.3 + drop)
        slopes.append([[left, 0, top], [right, 0, top], [right, -reach, top - drop], [left, -reach, top - drop]])
    return [quads(np.array(slopes), _CLOTH)] if slopes else []


def _porch(openings: _Openings, rng: np.random.Generator) -> list[Mesh]:
    """Steps before the door, often a small roof on posts over them."""
    middle = float(openings.x_m[2 * openings.door + 1] + openings.x_m[2 * openings.door + 2]) / 2
    steps = int(rng.integers(1, 3))
    parts = [
        box([1.5, 0.35 * (steps - row), 0.15], [middle, -0.175 * (steps - row), 0.075 + 0.15 * row], _CONCRETE)
        for row in range(steps)
    ]
    if rng.random() < 0.5:
        parts += [box([0.12, 0.12, 2.4], [middle + side * 0.9, -1.0, 1.2], _TRIM) for side in (-1, 1)]
        parts.append(box([2.2, 1.2, 0.15], [middle, -0.6, 2.45], int(Material.BRICK)))
    return parts


def relief_house(length_m: float, depth_m: float, rng: np.random.Generator) -> Mesh:
    """A house of one or two floors with a gabled roof, a chimney, and steps or a porch before its door."""
    eaves = float(rng.choice([2.9, 5.4])) + float(rng.uniform(0, 0.4))
    walls = relief_building(length_m, depth_m, eaves, rng, overhang_m=0.0, porch=True)
    brick, ridge, over = int(Material.BRICK), eaves + float(rng.uniform(0.25, 0.45)) * depth_m, 0.4
    x, low, middle = length_m / 2 + over, eaves - 0.15, depth_m / 2
    roof = [[[-x, y, low], [x, y, low], [x, middle, ridge], [-x, middle, ridge]] for y in (-over, depth_m + over)]
    gables = [
        [[end, 0, eaves], [end, depth_m, eaves], [end, middle, ridge], [end, middle, ridge]]
        for end in (over - x, x - over)
    ]
    faces = quads(np.array(roof + gables, dtype=np.float64), brick)
    return Mesh.merge([walls, faces, box([0.6, 0.6, 1.4], [0.3 * length_m, middle, ridge + 0.2], brick)])
