"""Rails and walls as mirrors: their planes found among the rays' hits, the images in them, and the posts of rails."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from farfield.simulation.bodies.materials import Material
from farfield.simulation.radar.casting import CastRays
from farfield.simulation.radar.echoes import ScattererKind
from farfield.simulation.radar.points import ScatterPoints

_FLAT = (Material.METAL, Material.CONCRETE, Material.BRICK, Material.GLASS)
_MAX_MIRRORS, _LEAST_RAYS = 8, 10
_ANGLE_DEG, _OFFSET_M = 6.0, 0.75
_MARGIN_M = 1.0
_POST_STEP_M, _POST_GAP_M = 4.0, 3.0
_POST_DB = (0.0, 5.0)
_RAIL_TALL_M, _RAIL_LONG_M = 1.2, 8.0


@dataclass(frozen=True, eq=False)
class Mirror:
    """A standing plane n x + d = 0 in the radar's frame, the radar on its positive side.

    Args:
        normal: Unit normal, shape (3,).
        distance_m: d, the radar's distance from it.
        hits_m: Points that were hit on it, shape (k, 3).
        metal: Whether most of them are metal.
    """

    normal: Float[np.ndarray, " 3"]
    distance_m: float
    hits_m: Float[np.ndarray, "k 3"]
    metal: bool

    @property
    def along(self) -> Float[np.ndarray, " 3"]:
        """Unit vector along the plane, level."""
        along = np.cross([0.0, 0.0, 1.0], self.normal)
        return np.asarray(along / np.linalg.norm(along))


def find_mirrors(cast: CastRays) -> list[Mirror]:
    """Planes that many rays of the fan hit: same direction within 6 degrees, same distance within 0.75 m."""
    rows = np.flatnonzero(
        (cast.owner < 0) & (cast.actor < 0) & np.isfinite(cast.range_m)
        & np.isin(cast.material, _FLAT) & (np.abs(cast.normal[:, 2]) < 0.35)
    )  # fmt: skip
    if rows.size < _LEAST_RAYS:
        return []
    level = cast.normal[rows] * [1.0, 1.0, 0.0]
    level /= np.linalg.norm(level, axis=1, keepdims=True)
    hits = cast.direction[rows] * cast.range_m[rows, None]
    distance = -np.einsum("ij,ij->i", level, hits)
    angle = np.floor(np.degrees(np.arctan2(level[:, 1], level[:, 0])) / _ANGLE_DEG)
    keys = np.stack([angle, np.floor(distance / _OFFSET_M)]).astype(np.int64)
    _, which, count = np.unique(keys, axis=1, return_inverse=True, return_counts=True)
    which = which.reshape(-1)
    mirrors = []
    for plane in np.argsort(-count, kind="stable")[:_MAX_MIRRORS]:
        if count[plane] < _LEAST_RAYS:
            break
        mine = which == plane
        normal = level[mine].mean(axis=0)
        normal /= np.linalg.norm(normal)
        offset = -float(np.mean(hits[mine] @ normal))
        metal = float(np.mean(cast.material[rows[mine]] == Material.METAL)) > 0.5
        if offset > 0:
            mirrors.append(Mirror(normal, offset, hits[mine], metal))
    return mirrors


def _gap_m(mirror: Mirror, along_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Distance along a mirror from places on it to the nearest hit."""
    hit = np.sort(mirror.hits_m @ mirror.along)
    right = np.clip(np.searchsorted(hit, along_m), 1, len(hit) - 1)
    return np.asarray(np.minimum(np.abs(hit[right] - along_m), np.abs(hit[right - 1] - along_m)))


def ghosts(points: ScatterPoints, mirrors: list[Mirror], level_db: float) -> ScatterPoints:
    """Images of road users in mirrors, where the straight way to the image crosses what was hit of the mirror.

    Both ways go by the mirror: the image stands in the mirror's direction at the whole way's length and moves as the
    mirror image of its original.

    Args:
        points: Road users' scattering points.
        mirrors: From :func:`find_mirrors`.
        level_db: Power relative to the original.
    """
    parts = []
    solid = points.take(np.flatnonzero((points.kind == ScattererKind.OBJECT) | (points.kind == ScattererKind.LIMB)))
    for mirror in mirrors:
        side = solid.position_m @ mirror.normal + mirror.distance_m
        image = solid.position_m - 2 * side[:, None] * mirror.normal
        towards = image @ mirror.normal
        step = np.divide(-mirror.distance_m, towards, out=np.full(len(side), np.inf), where=towards < -1e-6)
        crossing = image * np.where(np.isfinite(step), step, 0.0)[:, None]
        up, height = mirror.hits_m[:, 2], crossing[:, 2]
        inside = _gap_m(mirror, crossing @ mirror.along) < _MARGIN_M
        inside &= (height > up.min() - _MARGIN_M) & (height < up.max() + _MARGIN_M)
        rows = np.flatnonzero(inside & (side > 0.3) & (step > 0) & (step < 1))
        velocity = solid.velocity_m_s - 2 * (solid.velocity_m_s @ mirror.normal)[:, None] * mirror.normal
        level = solid.rcs_m2[rows] * 10 ** (level_db / 10)
        kind = np.full(len(rows), int(ScattererKind.GHOST))
        parts.append(ScatterPoints(image[rows], velocity[rows], level, solid.actor[rows], kind))
    return ScatterPoints.join(parts)


def posts(mirrors: list[Mirror], world_T_radar: Float[np.ndarray, "4 4"], rng: np.random.Generator) -> ScatterPoints:
    """Posts of guard rails every 4 m, 0 to 5 dBsm, where rays hit the rail nearby; counted in the world's frame."""
    parts = []
    for mirror in mirrors:
        hits = mirror.hits_m
        along = hits @ mirror.along
        if not mirror.metal or np.ptp(hits[:, 2]) > _RAIL_TALL_M or np.ptp(along) < _RAIL_LONG_M:
            continue
        shift = float((world_T_radar[:3, :3] @ mirror.along) @ world_T_radar[:3, 3])
        first, last = np.ceil((along.min() + shift) / _POST_STEP_M), np.floor((along.max() + shift) / _POST_STEP_M)
        at = np.arange(first, last + 1) * _POST_STEP_M - shift
        near = _gap_m(mirror, at) < _POST_GAP_M
        place = -mirror.distance_m * mirror.normal + at[near, None] * mirror.along
        place[:, 2] = float(np.median(hits[:, 2]))
        parts.append(ScatterPoints.fixed(place, 10 ** (rng.uniform(*_POST_DB, len(place)) / 10), ScattererKind.POST))
    return ScatterPoints.join(parts)
