"""One sweep over a scene: which shots hit what, and the cloud that comes back."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.frame import Cloud
from farfield.geometry.poses import invert, transform_points
from farfield.simulation.lidar import LidarModel, Scan, measure
from farfield.simulation.materials import Material
from farfield.simulation.trace import Tracer


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
) -> Int[np.ndarray, " k"]:
    """Indices of the shots that may hit a body: those within the angles of its bounding box."""
    low, high = body.tracer.mesh.vertices_m.min(axis=0), body.tracer.mesh.vertices_m.max(axis=0)
    corners = np.stack(np.meshgrid(*zip(low, high, strict=True), indexing="ij"), axis=-1).reshape(-1, 3)
    seen = transform_points(invert(world_T_common) @ body.world_T_body, corners) - scan.origin_m
    columns = len(scan.azimuth_rad)
    if seen[:, 0].min() < 0.5:
        if seen[:, 0].max() < 0.5:
            return np.zeros(0, dtype=np.int64)
        return np.arange(len(scan.elevation_rad) * columns)
    azimuth = np.arctan2(seen[:, 1], seen[:, 0])
    elevation = np.arctan2(seen[:, 2], np.hypot(seen[:, 0], seen[:, 1]))
    nearest = np.hypot(seen[:, 0], seen[:, 1]).min()
    bulge = np.arctan2(seen[:, 2], nearest * 0.7)  # the box's edges bow outwards between its corners
    margin = scan.margin_rad
    first, last = np.searchsorted(scan.azimuth_rad, [azimuth.min() - margin, azimuth.max() + margin])
    reach = [min(elevation.min(), bulge.min()) - margin, max(elevation.max(), bulge.max()) + margin]
    bottom, top = np.searchsorted(scan.elevation_rad, reach)
    rows = np.arange(bottom, top)[:, None] * columns
    return (rows + np.arange(first, last)[None]).reshape(-1)


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
    towards = [every if body.actor < 0 else shots_towards(scan, body, world_T_common) for body in bodies]
    nearest = _Nearest(len(directions))
    for body, shots in zip(bodies, towards, strict=True):
        nearest.cast(body, world_T_common, scan.origin_m, directions, shots)
    passes = rng.random(len(directions), dtype=np.float32) >= model.glass_return
    for _ in range(3):
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
    towards: Sequence[Int[np.ndarray, " _"]],
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
    for body, shots in zip(bodies, towards, strict=True):
        going = shots[through[shots]]
        if going.size:
            nearest.cast(body, world_T_common, scan.origin_m, directions, going, skip_m=begin[going])
