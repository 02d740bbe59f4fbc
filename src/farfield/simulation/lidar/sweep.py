"""One sweep over a scene: which shots hit what, and the cloud that comes back."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.frame import Cloud
from farfield.geometry.poses import invert, transform_points
from farfield.simulation.lidar.model import LidarModel, Scan, measure
from farfield.simulation.bodies.materials import Material
from farfield.simulation.trace import Tracer

_PANES = 2  # a shot passes through so many panes of glass at most


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid thing that rays can hit.

    Args:
        tracer: Its mesh in its own frame.
        world_T_body: Its pose.
        actor: Index of the road user, or -1 for what is fixed.
    """

    tracer: Tracer
    world_T_body: Float[np.ndarray, "4 4"]
    actor: int = -1


@dataclass(frozen=True, eq=False)
class Sweep:
    """The cloud of one sweep in the common frame, and which road user each point lies on (-1: none)."""

    cloud: Cloud
    actor: Int[np.ndarray, " n"]


class _Nearest:
    """The nearest hit of every shot so far."""

    def __init__(self, count: int) -> None:
        self.range_m = np.full(count, np.inf, dtype=np.float64)
        self.cosine = np.zeros(count)
        self.reflectance = np.zeros(count)
        self.material = np.zeros(count, dtype=np.int64)
        self.actor = np.full(count, -1, dtype=np.int64)

    def cast(
        self,
        body: Body,
        world_T_common: Float[np.ndarray, "4 4"],
        origin_m: Float[np.ndarray, " 3"],
        directions: Float[np.ndarray, "n 3"],
        shots: Int[np.ndarray, " k"],
        *,
        skip_m: Float[np.ndarray, " k"] | None = None,
    ) -> None:
        """Cast the named shots at one body; ``skip_m`` lets each ray begin so far out."""
        if shots.size == 0:
            return
        body_T_common = invert(body.world_T_body) @ world_T_common
        start = transform_points(body_T_common, origin_m[None])[0]
        turned = directions[shots] @ body_T_common[:3, :3].T.astype(np.float32)
        if skip_m is None:
            hits = body.tracer.cast(start, turned)
            distance = hits.range_m.astype(np.float64)
        else:
            hits = body.tracer.cast_from(start + turned * skip_m[:, None], turned)
            distance = hits.range_m + skip_m
        nearer = np.flatnonzero(distance < self.range_m[shots])
        chosen, face = shots[nearer], hits.face[nearer]
        self.range_m[chosen] = distance[nearer]
        self.cosine[chosen] = hits.cosine[nearer]
        self.reflectance[chosen] = body.tracer.mesh.reflectance[face]
        self.material[chosen] = body.tracer.mesh.material[face]
        self.actor[chosen] = body.actor


def shots_towards(
    scan: Scan, body: Body, world_T_common: Float[np.ndarray, "4 4"]
) -> tuple[Int[np.ndarray, " k"], float]:
    """Which shots may hit a body, and from what distance on.

    Returns:
        Indices of the shots within the angles of its bounding box, and a distance that no hit falls below.
    """
    columns, lines = len(scan.azimuth_rad), len(scan.elevation_rad)
    seen = transform_points(invert(world_T_common) @ body.world_T_body, body.tracer.corners_m) - scan.origin_m
    x, y, z = seen.T
    if x.max() < 0.5:
        return np.zeros(0, dtype=np.int64), np.inf
    if x.min() < 0.5:
        return np.arange(lines * columns), 0.0
    middle = seen.mean(axis=0)
    nearest = float(np.linalg.norm(middle) - np.linalg.norm(seen[0] - middle))
    flat = np.hypot(x, y)
    azimuth = np.arctan2(y, x)
    elevation = np.concatenate([np.arctan2(z, flat), np.arctan2(z, 0.5 * flat.min())])  # edges bow between corners
    margin = scan.margin_rad
    first, last = np.searchsorted(scan.azimuth_rad, [azimuth.min() - margin, azimuth.max() + margin])
    bottom, top = np.searchsorted(scan.elevation_rad, [elevation.min() - margin, elevation.max() + margin])
    rows = np.arange(bottom, top)[:, None] * columns
    return (rows + np.arange(first, last)[None]).reshape(-1), nearest


def sweep(
    scan: Scan,
    model: LidarModel,
    bodies: Sequence[Body],
    world_T_common: Float[np.ndarray, "4 4"],
    rng: np.random.Generator,
) -> Sweep:
    """Cast one sweep at all bodies and measure what comes back.

    Args:
        scan: The shots, in the common frame.
        model: The sensor.
        bodies: What can be hit; fixed ones are cast by every shot.
        world_T_common: Pose of the common frame in which the cloud is given.
        rng: Draws glass, detection and noise.

    Returns:
        Points ordered by line and column; ``ring`` counts the lines from the lowest.
    """
    columns = len(scan.azimuth_rad)
    directions = scan.directions.reshape(-1, 3)
    every = np.arange(len(directions))
    towards = [(every, 0.0) if body.actor < 0 else shots_towards(scan, body, world_T_common) for body in bodies]
    order = sorted(range(len(bodies)), key=lambda i: (bodies[i].actor >= 0, towards[i][1]))
    bodies, towards = [bodies[i] for i in order], [towards[i] for i in order]
    nearest = _Nearest(len(directions))
    for body, (shots, least_m) in zip(bodies, towards, strict=True):
        nearest.cast(body, world_T_common, scan.origin_m, directions, shots[nearest.range_m[shots] > least_m])
    passes = rng.random(len(directions), dtype=np.float32) >= model.glass_return
    for _ in range(_PANES):
        _see_through(nearest, passes, bodies, towards, world_T_common, scan, directions)
    back = measure(model, nearest.range_m, nearest.cosine, nearest.reflectance, nearest.material, rng)
    points = directions[back.shot] * back.range_m[:, None] + scan.origin_m
    ring = (back.shot // columns).astype(np.uint8)
    cloud = Cloud(points.astype(np.float32), back.intensity.astype(np.float32), {"ring": ring})
    return Sweep(cloud, nearest.actor[back.shot])


def _see_through(
    nearest: _Nearest,
    passes: Bool[np.ndarray, " n"],
    bodies: Sequence[Body],
    towards: Sequence[tuple[Int[np.ndarray, " _"], float]],
    world_T_common: Float[np.ndarray, "4 4"],
    scan: Scan,
    directions: Float[np.ndarray, "n 3"],
) -> None:
    """Let the shots that pass through glass go on to what lies behind it."""
    through = passes & (nearest.material == Material.GLASS) & np.isfinite(nearest.range_m)
    if not through.any():
        return
    begin = nearest.range_m + 0.01
    nearest.range_m[through] = np.inf
    nearest.material[through], nearest.actor[through] = 0, -1
    for body, (shots, least_m) in zip(bodies, towards, strict=True):
        going = shots[through[shots]]
        going = going[nearest.range_m[going] > least_m]
        if going.size:
            nearest.cast(body, world_T_common, scan.origin_m, directions, going, skip_m=begin[going])
