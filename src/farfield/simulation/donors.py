"""Simulated bodies in real sweeps: the sweep lends its rays and its background, the body its shape and paint.

A ray of the sweep that meets a body before it returned gives the body's echo, if the sensor would detect it, and never
what lies behind: the body is hidden by what stands before it and casts a shadow. Rays that did not return are rebuilt
from the sensor's rows, so that a body stands out against the sky and beyond the ground's last return (LiDARsim, 2020;
Real3D-Aug, 2022).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int, Int64
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks

from farfield.frame import Boxes, Cloud
from farfield.geometry.boxes import inside_box, points_in_boxes
from farfield.geometry.ground import ground_m
from farfield.simulation.bodies.actors import CLASS_OF, Actor, draw_car, draw_size_m
from farfield.simulation.bodies.materials import Material, reflectance_at
from farfield.simulation.bodies.mesh import Mesh
from farfield.simulation.lidar.model import LidarModel, detection_probability, range_spread_m, signal
from farfield.simulation.trace import Tracer

_FARTHEST_M = 1000.0  # no sensor measures so far
_BOX_MARGIN_M = 0.2  # about annotated objects, whose points are taken out
_ROW_BIN_RAD, _ROWS, _ROW_SHARE = np.deg2rad(0.02), (8, 300), 0.8
_FAR_M = 15.0  # rows show in points beyond: nearer ones are shifted by where each laser sits
_OPEN_RAD = np.deg2rad(20.0)  # a wider gap between points is where the sensor does not look
_BEHIND_M = 0.2  # a return so much behind a body's surface is hidden by it
_PANES, _BEYOND_GLASS_M = 2, 0.01
_GROUND_M, _LOW_M, _HIGH_M = 0.15, 0.3, 3.0
_FREE_M, _STAND_M, _LEAST_GROUND = 0.4, 1.5, 3  # free room about a body; ground points about its middle


@dataclass(frozen=True, eq=False)
class DonorSweep:
    """A real sweep that lends rays and background.

    Args:
        points_m: Its points without annotated objects, shape (n, 3), the sensor at the origin.
        intensity: Theirs, shape (n,).
        height_m: Their heights above the ground, shape (n,).
        open_rays: Unit directions in which nothing returned, as far as the rows show, and those of the annotated
            objects' points, shape (m, 3).
    """

    points_m: Float64[np.ndarray, "n 3"]
    intensity: Float32[np.ndarray, " n"]
    height_m: Float64[np.ndarray, " n"]
    open_rays: Float64[np.ndarray, "m 3"]

    @classmethod
    def of(cls, cloud: Cloud, boxes: Boxes | None = None) -> "DonorSweep":
        """Take annotated objects out of a sweep and rebuild the rays that did not return.

        Args:
            cloud: The sweep, in the sensor's axes; its ``ring`` column says the rows, else the elevations do.
            boxes: Annotated objects; what stands in them leaves a hole.
        """
        near = np.abs(cloud.points_m).max(axis=1, initial=0.0) < _FARTHEST_M
        cloud = cloud[near]
        points = cloud.points_m.astype(np.float64)
        rings = cloud.extra.get("ring")
        open_rays = missing_rays(points, None if rings is None else np.asarray(rings))
        stays = np.ones(len(points), dtype=bool)
        if boxes is not None and len(boxes):
            stays[np.concatenate(points_in_boxes(points, boxes, margin_m=_BOX_MARGIN_M))] = False
        taken = points[~stays] / np.linalg.norm(points[~stays], axis=1, keepdims=True)
        open_rays = np.concatenate([open_rays, taken])  # their rays are free for another body
        intensity = cloud.intensity if cloud.intensity is not None else np.zeros(len(points), dtype=np.float32)
        return cls(points[stays], intensity[stays], (points[:, 2] - ground_m(points))[stays], open_rays)

    def turned(self, yaw_rad: float | int) -> "DonorSweep":
        """The sweep turned about z, counter-clockwise."""
        cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
        turn = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
        return replace(self, points_m=self.points_m @ turn, open_rays=self.open_rays @ turn)

    @property
    def ground_points_m(self) -> Float64[np.ndarray, "n 3"]:
        """Its points on the ground."""
        return self.points_m[np.abs(self.height_m) < _GROUND_M]

    @property
    def standing_points_m(self) -> Float64[np.ndarray, "n 3"]:
        """Its points that stand where a road user would."""
        return self.points_m[(self.height_m > _LOW_M) & (self.height_m < _HIGH_M)]


def missing_rays(
    points_m: Float[np.ndarray, "n 3"], ring: Int[np.ndarray, " n"] | None = None
) -> Float64[np.ndarray, "m 3"]:
    """Unit directions in which a turning sensor looked and nothing returned, shape (m, 3).

    Args:
        points_m: The sweep, the sensor at the origin, shape (n, 3).
        ring: Row of each point; None tells rows by peaks of the elevations, and gives no ray where there are none, as
            in sweeps of several sensors.
    """
    azimuth = np.arctan2(points_m[:, 1], points_m[:, 0])
    level_m = np.hypot(points_m[:, 0], points_m[:, 1])
    elevation = np.arctan2(points_m[:, 2], level_m)
    rows = rows_of(elevation, level_m) if ring is None else ring
    if rows is None or not len(points_m):
        return np.zeros((0, 3))
    order = np.lexsort((azimuth, rows))
    azimuth, elevation, rows = azimuth[order], elevation[order], rows[order]
    steps = np.diff(azimuth)[np.diff(rows) == 0]
    step = float(np.median(steps[steps > 1e-5])) if (steps > 1e-5).any() else np.deg2rad(0.2)
    columns = round(2 * np.pi / step)
    looks = _sector(azimuth, columns)
    directions = []
    for own in np.split(np.arange(len(rows)), np.flatnonzero(np.diff(rows)) + 1):
        free = looks.copy()
        free[np.floor((azimuth[own] + np.pi) / (2 * np.pi) * columns).astype(np.int64) % columns] = False
        at = (np.flatnonzero(free) + 0.5) * 2 * np.pi / columns - np.pi
        up = np.interp(at, azimuth[own], elevation[own], period=2 * np.pi)
        directions.append(np.stack([np.cos(up) * np.cos(at), np.cos(up) * np.sin(at), np.sin(up)], axis=1))
    return np.concatenate(directions)


def rows_of(elevation: Float64[np.ndarray, " n"], level_m: Float64[np.ndarray, " n"]) -> Int64[np.ndarray, " n"] | None:
    """The sensor's row of each point, by peaks of the elevations of far points; None where they show no rows."""
    far = elevation[level_m > _FAR_M]
    if len(far) < 100:
        return None
    edges = np.arange(far.min() - 9.5 * _ROW_BIN_RAD, far.max() + 10 * _ROW_BIN_RAD, _ROW_BIN_RAD)
    count = gaussian_filter1d(np.histogram(far, edges)[0].astype(np.float64), 1.5)
    peaks, _ = find_peaks(count, prominence=0.3 * np.percentile(count, 90))
    if not _ROWS[0] <= len(peaks) <= _ROWS[1]:
        return None
    centres = edges[peaks] + _ROW_BIN_RAD / 2
    row = np.abs(np.searchsorted((centres[1:] + centres[:-1]) / 2, elevation))
    spacing = np.gradient(centres)
    near = np.abs(elevation - centres[row]) < 0.3 * spacing[row]
    return row if near[level_m > _FAR_M].mean() >= _ROW_SHARE else None


def _sector(azimuth: Float64[np.ndarray, " n"], columns: int) -> Bool[np.ndarray, " columns"]:
    """Columns that the sensor looks into: all but wide gaps without any point."""
    has_point = np.zeros(columns, dtype=bool)
    has_point[np.floor((azimuth + np.pi) / (2 * np.pi) * columns).astype(np.int64) % columns] = True
    at = np.flatnonzero(has_point)
    gap = np.diff(at, append=at[0] + columns)
    looks = np.ones(columns, dtype=bool)
    for start, width in zip(at, gap, strict=True):
        if width * 2 * np.pi / columns > _OPEN_RAD:
            looks[np.arange(start + 1, start + width) % columns] = False
    return looks


@dataclass(frozen=True, eq=False)
class StandingBody:
    """A body in a sweep.

    Args:
        mesh: Where it stands in the sweep's coordinates.
        boxes: Its box, one row.
    """

    mesh: Mesh
    boxes: Boxes

    @classmethod
    def of(cls, actor: Actor, x_m: float, y_m: float, z_m: float, yaw_rad: float) -> "StandingBody":
        """A body that stands on its bottom's middle."""
        size = np.asarray(actor.size_m)
        centre = np.array([[x_m, y_m, z_m + size[2] / 2]])
        box = Boxes(centre_m=centre, size_m=size[None], yaw_rad=np.array([yaw_rad]), label=[CLASS_OF[actor.kind]])
        return cls(actor.build().placed(x_m, y_m, z_m, yaw_rad=yaw_rad), box)


def draw_actor(rng: np.random.Generator, prior: str = "us", world: str = "v2") -> Actor:
    """A car or van by its share of the traffic, with the body that it has in a world."""
    kind = draw_car(rng, prior)
    length, width, height = draw_size_m(kind, rng, prior).tolist()
    return Actor(0, kind, (length, width, height), np.random.SeedSequence(int(rng.integers(1 << 62))), world)


def find_place(
    sweep: DonorSweep,
    actor: Actor,
    range_m: tuple[float | int, float | int],
    rng: np.random.Generator,
    *,
    azimuth_rad: tuple[float, float] = (-np.pi, np.pi),
    ahead_rad: float = 0.0,
    taken: Sequence[StandingBody] = (),
    tries: int = 60,
) -> StandingBody | None:
    """Stand a body somewhere on the sweep's ground where there is room; None where there is none.

    Args:
        sweep: The sweep.
        actor: The body.
        range_m: Ground distance of its middle, at least and at most.
        rng: Draws place and heading.
        azimuth_rad: The sector that it may stand in, from the direction that counts as ahead.
        ahead_rad: That direction, counter-clockwise from +x.
        taken: Bodies that stand there already.
        tries: Places to try.
    """
    away_m = np.hypot(sweep.points_m[:, 0], sweep.points_m[:, 1])
    (x, y), cos, sin = sweep.points_m[:, :2].T, np.cos(ahead_rad), np.sin(ahead_rad)
    azimuth = np.arctan2(cos * y - sin * x, cos * x + sin * y)
    in_sector = (azimuth >= azimuth_rad[0]) & (azimuth <= azimuth_rad[1])
    ground = (np.abs(sweep.height_m) < _GROUND_M) & (away_m >= range_m[0]) & (away_m <= range_m[1]) & in_sector
    standing = sweep.standing_points_m
    rows = np.flatnonzero(ground)
    for row in rows[rng.integers(len(rows), size=tries)] if len(rows) else ():
        x, y = sweep.points_m[row, :2]
        about = sweep.points_m[ground & (np.hypot(*(sweep.points_m[:, :2] - (x, y)).T) < _STAND_M), 2]
        if len(about) < min(_LEAST_GROUND, len(rows)):
            continue
        along = float(rng.choice([0.0, np.pi, np.pi / 2, -np.pi / 2], p=[0.35, 0.35, 0.15, 0.15]))
        body = StandingBody.of(actor, float(x), float(y), float(np.median(about)), along + float(rng.normal(0, 0.15)))
        if _has_room(body, standing, taken):
            return body
    return None


def _has_room(body: StandingBody, standing: Float64[np.ndarray, "n 3"], taken: Sequence[StandingBody]) -> bool:
    """Whether nothing stands in a body's box or close to it."""
    if inside_box(standing, body.boxes, 0, margin_m=_FREE_M).any():
        return False
    others = [other.mesh.vertices_m for other in taken]
    return not any(inside_box(vertices, body.boxes, 0, margin_m=_FREE_M).any() for vertices in others)


@dataclass(frozen=True, eq=False)
class PastedSweep:
    """A sweep with bodies in it.

    Args:
        points_m: Points, shape (n, 3): those of the sweep that are not hidden, then those of the bodies.
        intensity: Theirs, shape (n,).
        body: Which body each point is of, -1 for the sweep's, shape (n,).
        boxes: The bodies' boxes.
        points_in: Points of each body, shape (b,).
    """

    points_m: Float32[np.ndarray, "n 3"]
    intensity: Float32[np.ndarray, " n"]
    body: Int64[np.ndarray, " n"]
    boxes: Boxes
    points_in: Int64[np.ndarray, " b"]

    @property
    def cloud(self) -> Cloud:
        """The points as a cloud."""
        return Cloud(self.points_m, self.intensity)


def paste(
    sweep: DonorSweep, bodies: Sequence[StandingBody], model: LidarModel, rng: np.random.Generator
) -> PastedSweep:
    """Put bodies into a sweep.

    Args:
        sweep: The sweep.
        bodies: The bodies, where they stand.
        model: How the sensor detects and measures: wavelength, reference range, noise.
        rng: Draws glass, detection and noise.
    """
    measured_m = np.linalg.norm(sweep.points_m, axis=1)
    directions = np.concatenate([sweep.points_m / np.maximum(measured_m, 1e-9)[:, None], sweep.open_rays])
    limit_m = np.concatenate([measured_m, np.full(len(sweep.open_rays), np.inf)])
    echoes = _echoes(directions, bodies, model, rng)

    # A return behind a body's surface is hidden; a surface behind a return is.
    hides = echoes.range_m < limit_m - _BEHIND_M
    within = hides & (echoes.range_m > model.min_range_m) & (echoes.range_m < model.max_range_m)
    detected = rng.random(len(hides)) < detection_probability(model, echoes.strength) * (1 - model.dropout)
    rows = np.flatnonzero(within & detected)
    noisy_m = echoes.range_m[rows] + range_spread_m(model, echoes.strength[rows]) * rng.standard_normal(len(rows))
    stays = ~hides[: len(measured_m)]
    points = np.concatenate([sweep.points_m[stays], directions[rows] * noisy_m[:, None]])
    return PastedSweep(
        points_m=points.astype(np.float32),
        intensity=np.concatenate([sweep.intensity[stays], np.clip(echoes.reflected[rows], 0, 1).astype(np.float32)]),
        body=np.concatenate([np.full(int(stays.sum()), -1), echoes.body[rows]]),
        boxes=Boxes.concatenate([placed.boxes for placed in bodies]),
        points_in=np.bincount(echoes.body[rows], minlength=len(bodies)),
    )


@dataclass(frozen=True, eq=False)
class _Echoes:
    """What each ray meets: range, signal over the threshold, effective reflectance, body; inf, 0, 0 and -1 of none."""

    range_m: Float64[np.ndarray, " n"]
    strength: Float64[np.ndarray, " n"]
    reflected: Float64[np.ndarray, " n"]
    body: Int64[np.ndarray, " n"]


def _echoes(
    directions: Float64[np.ndarray, "n 3"], bodies: Sequence[StandingBody], model: LidarModel, rng: np.random.Generator
) -> _Echoes:
    """Cast the rays at the bodies; some shots pass through glass."""
    count = len(directions)
    echoes = _Echoes(np.full(count, np.inf), np.zeros(count), np.zeros(count), np.full(count, -1))
    if not bodies:
        return echoes
    mesh = Mesh.merge([placed.mesh for placed in bodies])
    tracer = Tracer(mesh)
    passes = rng.random(count) >= model.glass_return
    rays, begin_m = _towards(directions, bodies), np.zeros(count)
    cosine, face = np.zeros(count), np.full(count, -1)
    for _ in range(_PANES + 1):
        hits = tracer.cast_from(directions[rays] * begin_m[rays, None], directions[rays])
        echoes.range_m[rays], cosine[rays], face[rays] = begin_m[rays] + hits.range_m, hits.cosine, hits.face
        through = (hits.face >= 0) & (mesh.material[hits.face] == Material.GLASS) & passes[rays]
        rays = rays[through]
        begin_m[rays] = echoes.range_m[rays] + _BEYOND_GLASS_M
    met = np.flatnonzero(face >= 0)
    material = mesh.material[face[met]]
    reflectance = reflectance_at(material, mesh.reflectance[face[met]], model.wavelength_nm)
    strength, reflected = signal(model, echoes.range_m[met], cosine[met], reflectance, material)
    echoes.strength[met], echoes.reflected[met] = strength, reflected
    body_of_face = np.repeat(np.arange(len(bodies)), [len(placed.mesh.faces) for placed in bodies])
    echoes.body[met] = body_of_face[face[met]]
    return echoes


def _towards(directions: Float64[np.ndarray, "n 3"], bodies: Sequence[StandingBody]) -> Int64[np.ndarray, " m"]:
    """Rays within the cone about a body: the others meet none."""
    near = np.zeros(len(directions), dtype=bool)
    for placed in bodies:
        vertices = placed.mesh.vertices_m
        middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
        distance_m, radius_m = np.linalg.norm(middle), np.linalg.norm(np.ptp(vertices, axis=0)) / 2
        if radius_m >= distance_m:
            return np.arange(len(directions))
        near |= directions @ (middle / distance_m) > np.sqrt(1 - (radius_m / distance_m) ** 2)
    return np.flatnonzero(near)
