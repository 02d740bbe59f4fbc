"""Rays from the radar: a fan over its field of view, and a few at every road user so that none is missed."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.geometry.poses import invert, transform_points
from farfield.simulation.trace import Body, Caster
from farfield.simulation.world.scene import SceneWindow, at_knots

FAN_STEP_DEG = (0.5, 0.75)
FAN_REACH_DEG = (55.0, 20.0)
_AIMED = (6, 40)  # least and most rays along each side of a road user's angles
_NEAREST_M = 0.5
_LEAF_STEP_M = 0.02


@dataclass(frozen=True, eq=False)
class CastRays:
    """What every ray hit first, in the radar's frame.

    Args:
        direction: Unit directions, shape (n, 3).
        solid_angle_sr: Solid angle that each ray stands for, shape (n,).
        owner: Road user that an aimed ray is meant for, -1 for the fan, shape (n,).
        range_m: First hit, inf for none, shape (n,).
        cosine: Cosine of its angle of incidence, shape (n,).
        material: Its material, shape (n,).
        normal: Its unit normal, turned to face the radar, shape (n, 3).
        body: Its body, row of the window's bodies, shape (n,).
        actor: Its road user or -1, shape (n,).
        own_range_m: For aimed rays, where they first hit their own road user, hidden or not; else inf.
        own_cosine: Cosine of the angle of incidence there.
        own_material: Material there.
        own_body: Body there.
        leafy_m: Path within plants, through which the radar sees, on the way to the first hit, shape (n,).
        leaves_at_m: Where that path begins, inf for none.
        own_leafy_m: Path within plants on the way to their own road user.
        leaves: What the radar sees through, each with the radar's pose in its frame.
    """

    direction: Float[np.ndarray, "n 3"]
    solid_angle_sr: Float[np.ndarray, " n"]
    owner: Int[np.ndarray, " n"]
    range_m: Float[np.ndarray, " n"]
    cosine: Float[np.ndarray, " n"]
    material: Int[np.ndarray, " n"]
    normal: Float[np.ndarray, "n 3"]
    body: Int[np.ndarray, " n"]
    actor: Int[np.ndarray, " n"]
    own_range_m: Float[np.ndarray, " n"]
    own_cosine: Float[np.ndarray, " n"]
    own_material: Int[np.ndarray, " n"]
    own_body: Int[np.ndarray, " n"]
    leafy_m: Float[np.ndarray, " n"]
    leaves_at_m: Float[np.ndarray, " n"]
    own_leafy_m: Float[np.ndarray, " n"]
    leaves: tuple[tuple[Caster, Float[np.ndarray, "4 4"]], ...]

    def add_paths(self) -> None:
        """Add the paths within plants, up to what is opaque."""
        for body, body_T_radar in self.leaves:
            origin_m, directions = body_T_radar[:3, 3], self.direction @ body_T_radar[:3, :3].T
            path_m, entry_m = body.paths_m(origin_m, directions, self.range_m)
            self.leafy_m[:] += path_m
            np.minimum(self.leaves_at_m, entry_m, out=self.leaves_at_m)
            aimed = np.flatnonzero(np.isfinite(self.own_range_m))
            self.own_leafy_m[aimed] += body.paths_m(origin_m, directions[aimed], self.own_range_m[aimed])[0]

    def range_in_leaves_m(
        self, rays: Int[np.ndarray, " k"], depth_m: Float[np.ndarray, " k"]
    ) -> Float[np.ndarray, " k"]:
        """Range at which some rays have run so far within plants, in one or several of them, to 2 cm; shape (k,).

        Args:
            rays: Rays that enter plants.
            depth_m: Paths within plants, below ``leafy_m``.
        """
        near_m = self.leaves_at_m[rays].copy()
        ends_m = [np.linalg.norm(body.corners_m - pose[:3, 3], axis=1).max() for body, pose in self.leaves]
        far_m = np.minimum(self.range_m[rays], max(ends_m, default=0.0))
        while (far_m - near_m).max(initial=0.0) > _LEAF_STEP_M:
            middle_m, path_m = (near_m + far_m) / 2, np.zeros(len(rays))
            for body, pose in self.leaves:
                path_m += body.paths_m(pose[:3, 3], self.direction[rays] @ pose[:3, :3].T, middle_m)[0]
            is_beyond = path_m >= depth_m
            far_m, near_m = np.where(is_beyond, middle_m, far_m), np.where(is_beyond, near_m, middle_m)
        return far_m


def cast_rays(
    window: SceneWindow, world_T_radar: Float[np.ndarray, "4 4"], reach_m: float, rng: np.random.Generator
) -> CastRays:
    """Cast the fan and the aimed rays at everything, at the window's reference moment.

    Args:
        window: The scene.
        world_T_radar: The radar's pose at that moment.
        reach_m: Road users whose nearest corner is farther get no rays of their own.
        rng: Moves each ray of the fan within its own cell of angles.
    """
    radar_T_body = [invert(world_T_radar) @ now(window, body) for body in window.bodies]
    corners = [
        transform_points(pose, body.tracer.corners_m) for pose, body in zip(radar_T_body, window.bodies, strict=True)
    ]
    azimuth, elevation, solid_angle_sr, owner = _rays(window, corners, reach_m, rng)
    direction = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=1
    )
    n = len(direction)
    cast = CastRays(
        direction, solid_angle_sr, owner, np.full(n, np.inf), np.ones(n), np.zeros(n, dtype=np.int64), -direction,
        np.full(n, -1), np.full(n, -1), np.full(n, np.inf), np.ones(n), np.zeros(n, dtype=np.int64), np.full(n, -1),
        np.zeros(n), np.full(n, np.inf), np.zeros(n),
        tuple(
            (body.tracer, invert(pose))
            for body, pose in zip(window.bodies, radar_T_body, strict=True) if body.tracer.is_turbid
        ),
    )  # fmt: skip
    for row, body in enumerate(window.bodies):
        if body.tracer.is_turbid:
            continue
        rays = np.flatnonzero(_towards(corners[row], azimuth, elevation, everything=body.actor < 0))
        if rays.size:
            _cast_body(cast, row, body, radar_T_body[row], rays)
    cast.add_paths()
    return cast


def now(window: SceneWindow, body: Body) -> Float[np.ndarray, "4 4"]:
    """Pose of a body in the world at the reference moment."""
    return np.asarray(at_knots(body.world_T_body, window.knots_s, np.zeros(1))[0])


def _ahead(corners_m: Float[np.ndarray, "8 3"]) -> Float[np.ndarray, "k 3"]:
    """Corners of a bounding box ahead of the radar, or a lattice of its points ahead where it reaches behind."""
    if corners_m[:, 0].min() >= _NEAREST_M:
        return corners_m
    share = np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, 9)] * 3), axis=-1).reshape(-1, 3)
    lattice = corners_m[0] + share @ (corners_m[[1, 2, 4]] - corners_m[0])
    return np.asarray(lattice[lattice[:, 0] >= _NEAREST_M])


def _spread(low: float, high: float, step: float) -> tuple[Float[np.ndarray, " k"], float]:
    """Middles and width of equal parts of a span, about ``step`` wide."""
    count = int(np.clip(np.ceil((high - low) / step), *_AIMED))
    return low + (high - low) * (np.arange(count) + 0.5) / count, (high - low) / count


def _angles(corners_m: Float[np.ndarray, "k 3"]) -> tuple[float, float, float, float]:
    """Least and greatest azimuth and elevation of points of a bounding box that lie ahead."""
    x, y, z = corners_m.T
    level_m = np.hypot(x, y)
    azimuth = np.arctan2(y, x)
    tilt = np.concatenate([np.arctan2(z, level_m), np.arctan2(z, np.maximum(0.5 * level_m.min(), _NEAREST_M))])
    elevation = tilt if level_m.min() < 5.0 else tilt[: len(z)]
    return float(azimuth.min()), float(azimuth.max()), float(elevation.min()), float(elevation.max())


def _rays(
    window: SceneWindow, corners: list[Float[np.ndarray, "8 3"]], reach_m: float, rng: np.random.Generator
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Azimuth, elevation, solid angle and owner of all rays; the fan's rays each within a cell of their own."""
    (step_az, step_el), (reach_az, reach_el) = np.radians(FAN_STEP_DEG), np.radians(FAN_REACH_DEG)
    grid = np.meshgrid(
        np.arange(-reach_az + step_az / 2, reach_az, step_az), np.arange(-reach_el + step_el / 2, reach_el, step_el)
    )
    azimuth, elevation = (axis.reshape(-1) for axis in grid)
    azimuth = azimuth + step_az * rng.uniform(-0.5, 0.5, azimuth.shape)
    elevation = elevation + step_el * rng.uniform(-0.5, 0.5, elevation.shape)
    parts = [(azimuth, elevation, step_az * step_el * np.cos(elevation), np.full(azimuth.shape, -1))]
    for corner, body in zip(corners, window.bodies, strict=True):
        ahead = _ahead(corner)
        if body.actor < 0 or not len(ahead) or np.linalg.norm(ahead, axis=1).min() > reach_m:
            continue
        left, right, bottom, top = _angles(ahead)
        if left > reach_az or right < -reach_az or bottom > reach_el or top < -reach_el:
            continue
        across, each_az = _spread(left, right, step_az)
        up, each_el = _spread(bottom, top, step_el)
        rays = [axis.reshape(-1) for axis in np.meshgrid(across, up)]
        parts.append((*rays, each_az * each_el * np.cos(rays[1]), np.full(rays[0].shape, body.actor)))
    azimuth, elevation, solid_angle_sr, owner = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return azimuth, elevation, solid_angle_sr, owner


def _towards(
    corners_m: Float[np.ndarray, "8 3"],
    azimuth: Float[np.ndarray, " n"],
    elevation: Float[np.ndarray, " n"],
    *,
    everything: bool,
) -> Bool[np.ndarray, " n"]:
    """Which rays may hit a body."""
    if everything or (corners_m[:, 0].min() < _NEAREST_M <= corners_m[:, 0].max()):
        return np.ones(azimuth.shape, dtype=bool)
    if corners_m[:, 0].max() < _NEAREST_M:
        return np.zeros(azimuth.shape, dtype=bool)
    left, right, bottom, top = _angles(corners_m)
    margin = 1e-3
    inside = (azimuth > left - margin) & (azimuth < right + margin)
    return np.asarray(inside & (elevation > bottom - margin) & (elevation < top + margin))


def _cast_body(
    cast: CastRays, row: int, body: Body, radar_T_body: Float[np.ndarray, "4 4"], rays: Int[np.ndarray, " k"]
) -> None:
    """Cast rays at one body and keep what is nearer than before, for all and for the road user's own rays."""
    body_T_radar = invert(radar_T_body)
    hits = body.tracer.cast(body_T_radar[:3, 3], cast.direction[rays] @ body_T_radar[:3, :3].T)
    range_m = hits.range_m.astype(np.float64)
    material = body.tracer.mesh.material[hits.face]
    nearer = range_m < cast.range_m[rays]
    hit_rays = rays[nearer]
    cast.range_m[hit_rays], cast.cosine[hit_rays] = range_m[nearer], hits.cosine[nearer]
    cast.material[hit_rays] = material[nearer]
    cast.body[hit_rays], cast.actor[hit_rays] = row, body.actor
    cast.normal[hit_rays] = _normals(body, hits.face[nearer], radar_T_body, cast.direction[hit_rays])
    if body.actor >= 0:
        own_nearer = (cast.owner[rays] == body.actor) & (range_m < cast.own_range_m[rays])
        own_rays = rays[own_nearer]
        cast.own_range_m[own_rays], cast.own_cosine[own_rays] = range_m[own_nearer], hits.cosine[own_nearer]
        cast.own_material[own_rays], cast.own_body[own_rays] = material[own_nearer], row


def _normals(
    body: Body, face: Int[np.ndarray, " k"], radar_T_body: Float[np.ndarray, "4 4"], towards: Float[np.ndarray, "k 3"]
) -> Float[np.ndarray, "k 3"]:
    corner = body.tracer.mesh.vertices_m[body.tracer.mesh.faces[face]]
    cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    cross /= np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-20)
    turned = cross @ radar_T_body[:3, :3].T
    return np.asarray(turned * -np.sign(np.einsum("ij,ij->i", turned, towards))[:, None])
