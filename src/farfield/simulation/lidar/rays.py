"""The shots of one frame, and their nearest hits.

Each ray starts where the sensor is, and meets every body where it is, at the ray's own time.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, Int32

from farfield.errors import ConfigError
from farfield.simulation.bodies.materials import Material
from farfield.simulation.lidar.model import LidarModel, line_elevations_deg
from farfield.simulation.trace import Body, RayHits

# The shots: direction, origin, time, ring and column of each

_FWHM_TO_SIGMA = 1 / (2 * np.sqrt(2 * np.log(2)))
# The middle and four points at two standard deviations integrate a normal distribution exactly to the third degree.
_FIVE = np.array([[0, 0], [1, 1], [-1, 1], [-1, -1], [1, -1]]) * np.sqrt(2.0)
_WEIGHTS = {1: np.ones(1), 5: np.array([0.5, 0.125, 0.125, 0.125, 0.125])}


@dataclass(frozen=True, eq=False)
class Scan:
    """All shots of one frame on a grid of rings (rows) and columns, in the sensor's frame.

    Args:
        rays: Unit directions of every beam's rays, its middle first, shape (3, rays, rings, columns).
        weights: Share of the beam's power in each ray, shape (rays,).
        origin_m: Where the beams start, shape (3, 1, columns) or (3, 1, 1).
        time_s: When each shot leaves, relative to the frame's reference time, shape (rings, columns) or (1, columns).
        azimuth_rad: Direction of each column, shape (columns,).
        elevation_rad: Elevation of each ring, shape (rings,).
        margin_rad: How far a ray may lie from its column and its ring.
    """

    rays: Float32[np.ndarray, "3 rays rings columns"]
    weights: Float32[np.ndarray, " rays"]
    origin_m: Float32[np.ndarray, "3 1 origins"]
    time_s: Float[np.ndarray, "lines columns"]
    azimuth_rad: Float[np.ndarray, " columns"]
    elevation_rad: Float[np.ndarray, " rings"]
    margin_rad: tuple[float, float]

    @classmethod
    def draw(cls, model: LidarModel, rng: np.random.Generator, *, pattern: str = "gaussian") -> "Scan":
        """Lay out one frame of a sensor.

        Args:
            model: The sensor.
            rng: Draws phase and jitter of a line-drawing sensor; a spinning one always shoots alike.
            pattern: Line pattern of a line-drawing sensor: "gaussian" or "uniform".

        Raises:
            ConfigError: If the pattern is unknown or a beam has neither 1 nor 5 rays.
        """
        if model.sub_rays not in _WEIGHTS:
            raise ConfigError(f"LidarModel.sub_rays: expected 1 or 5; got {model.sub_rays}")
        return _spinning(model) if model.spinning else _lines(model, pattern, rng)

    @property
    def shape(self) -> tuple[int, int]:
        """Rings, columns."""
        return self.rays.shape[2], self.rays.shape[3]

    @property
    def directions(self) -> Float32[np.ndarray, "rings columns 3"]:
        """Unit directions of the beams' middles."""
        return np.moveaxis(self.rays[:, 0], 0, -1)

    @property
    def times_s(self) -> Float[np.ndarray, "rings columns"]:
        """When each shot leaves, relative to the reference time."""
        return np.broadcast_to(self.time_s, self.shape)


def _fan(
    azimuth_rad: Float32[np.ndarray, "rings columns"],
    elevation_rad: Float32[np.ndarray, "rings columns"],
    model: LidarModel,
) -> Float32[np.ndarray, "3 rays rings columns"]:
    """Rays of every beam: its middle, and the others turned about the two axes across it."""
    cos_az, sin_az = np.cos(azimuth_rad), np.sin(azimuth_rad)
    cos_el, sin_el = np.cos(elevation_rad), np.sin(elevation_rad)
    sigma = np.radians(model.divergence_deg) * _FWHM_TO_SIGMA
    offsets = (_FIVE[: model.sub_rays] * sigma).astype(np.float32)
    rays = np.empty((3, model.sub_rays, *azimuth_rad.shape), dtype=np.float32)
    for index, (across, up) in enumerate(offsets):
        scale = np.float32(1 / np.sqrt(1 + across**2 + up**2))
        level = (cos_el - up * sin_el) * scale
        rays[0, index] = level * cos_az - (across * scale) * sin_az
        rays[1, index] = level * sin_az + (across * scale) * cos_az
        rays[2, index] = (sin_el + up * cos_el) * scale
    return rays


def _cone_rad(model: LidarModel) -> float:
    return float(2.4 * np.radians(model.divergence_deg) * _FWHM_TO_SIGMA)  # two deviations, wider off the horizon


def _lines(model: LidarModel, pattern: str, rng: np.random.Generator) -> Scan:
    """A Luminar's frame: one line after the other, from the top down (the real order is not published).

    Every line has a random phase of its columns, a smile (its ends lie higher) and a jitter of each shot.
    """
    rings, columns, half = model.lines, model.columns, model.azimuth_deg
    line_deg = line_elevations_deg(
        pattern, lines=rings, edge_deg=model.elevation_deg, focus_deg=model.focus_deg, sigma_deg=model.sigma_deg
    )
    step = 2 * half / columns
    phase = rng.uniform(0, 1, (rings, 1))
    jitter = model.jitter_deg * rng.standard_normal((2, rings, columns))
    azimuth = -half + step * (np.arange(columns) + phase)
    smile = model.smile_deg * ((azimuth / half) ** 2 - 1 / 3)
    az = np.radians(azimuth + jitter[0]).astype(np.float32)
    el = np.radians(line_deg[:, None] + smile + jitter[1]).astype(np.float32)
    order = np.arange(rings)[::-1]
    shot = order[:, None] * columns + np.arange(columns)
    loose = np.radians(6 * model.jitter_deg) + _cone_rad(model)
    return Scan(
        _fan(az, el, model),
        _WEIGHTS[model.sub_rays].astype(np.float32),
        np.zeros((3, 1, 1), dtype=np.float32),
        ((shot + 0.5) / (rings * columns) - 0.5) * model.period_s,
        np.radians(-half + step * (np.arange(columns) + 0.5)),
        np.radians(line_deg),
        (float(np.radians(step / 2) + loose), float(np.radians(model.smile_deg) + loose)),
    )


@lru_cache(maxsize=4)
def _spinning(model: LidarModel) -> Scan:
    """An Ouster's turn: from straight behind over the left side, clockwise; straight ahead at the reference time."""
    assert model.beams is not None
    column = np.arange(model.columns)
    encoder = np.pi - 2 * np.pi * column / model.columns
    offset = np.radians(np.array(model.beams.offset_deg))
    elevation = np.radians(np.array(model.beams.elevation_deg))
    az = (encoder[None] - offset[:, None]).astype(np.float32)
    el = np.broadcast_to(elevation[:, None], az.shape).astype(np.float32)
    origin = model.beams.origin_m * np.stack([np.cos(encoder), np.sin(encoder), np.zeros(model.columns)])
    parallax = model.beams.origin_m / max(model.min_range_m, 0.1)
    return Scan(
        _fan(az, el, model),
        _WEIGHTS[model.sub_rays].astype(np.float32),
        origin[:, None].astype(np.float32),
        ((column / model.columns - 0.5) * model.period_s)[None],
        encoder,
        elevation,
        (float(np.abs(offset).max()) + _cone_rad(model) + parallax, _cone_rad(model) + parallax),
    )


_PANES = 2  # a ray passes through so many panes of glass at most
_BEYOND_GLASS_M = np.float32(0.01)


@dataclass(frozen=True, eq=False)
class SensorPath:
    """A sensor's pose relative to a body, at each knot; linear in between.

    Args:
        poses: Upper three rows of ``anchored body_T_sensor``, shape (k, 3, 4).
        knots_s: Times of the knots, shape (k,).
    """

    poses: Float[np.ndarray, "k 3 4"]
    knots_s: Float[np.ndarray, " k"]

    @classmethod
    def towards(
        cls, body: Body, world_T_sensor: Float[np.ndarray, "k 4 4"], knots_s: Float[np.ndarray, " k"]
    ) -> "SensorPath":
        """The path of a sensor as seen from a body; coordinates count from the anchor of the body's tracer."""
        turn = np.swapaxes(body.world_T_body[:, :3, :3], 1, 2)
        poses = turn @ (world_T_sensor[:, :3] - np.pad(body.world_T_body[:, :3, 3:], ((0, 0), (0, 0), (3, 0))))
        poses[:, :, 3] -= body.tracer.anchor_m
        return cls(poses, knots_s)

    def at(self, time_s: Float[np.ndarray, "*shape"]) -> Float32[np.ndarray, "*moments 3 4"]:
        """Poses at any times; a single knot gives its pose for all of them."""
        if len(self.knots_s) == 1:
            return self.poses[0].astype(np.float32).reshape((1,) * time_s.ndim + (3, 4))
        before = np.clip(np.searchsorted(self.knots_s, time_s, side="right") - 1, 0, len(self.knots_s) - 2)
        share = ((time_s - self.knots_s[before]) / (self.knots_s[before + 1] - self.knots_s[before])).astype(np.float32)
        start, step = self.poses[:-1].astype(np.float32), np.diff(self.poses, axis=0).astype(np.float32)
        return np.asarray(start[before] + share[..., None, None] * step[before])


def turned(
    pose: Float32[np.ndarray, "*moments 3 4"], rays: Float32[np.ndarray, "3 *shape"]
) -> Float32[np.ndarray, "*shape 3"]:
    """Rotate directions into the body's frame."""
    out = np.empty((*rays.shape[1:], 3), dtype=np.float32)
    for axis in range(3):
        total = pose[..., axis, 0] * rays[0]
        total += pose[..., axis, 1] * rays[1]
        total += pose[..., axis, 2] * rays[2]
        out[..., axis] = total
    return out


def _starts(
    pose: Float32[np.ndarray, "*moments 3 4"], origin_m: Float32[np.ndarray, "3 *places"]
) -> Float32[np.ndarray, "*shape 3"]:
    """Move the beams' origins into the body's frame."""
    return np.stack(
        [
            pose[..., axis, 0] * origin_m[0]
            + pose[..., axis, 1] * origin_m[1]
            + pose[..., axis, 2] * origin_m[2]
            + pose[..., axis, 3]
            for axis in range(3)
        ],
        axis=-1,
    )


@dataclass(frozen=True, eq=False)
class ShotBlock:
    """Which shots may hit a body.

    Args:
        rings: Their rings, as a mask.
        columns: Their columns, as a mask.
        nearest_m: No hit is nearer.
    """

    rings: Bool[np.ndarray, " rings"]
    columns: Bool[np.ndarray, " columns"]
    nearest_m: float

    @property
    def is_full(self) -> bool:
        """Whether every shot may hit."""
        return bool(self.rings.all() and self.columns.all())

    def shots(self) -> Int[np.ndarray, " k"]:
        """Flat indices of the shots."""
        rows = np.flatnonzero(self.rings)[:, None] * len(self.columns)
        return (rows + np.flatnonzero(self.columns)[None]).reshape(-1)


def _wrap(angle_rad: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    return (angle_rad + np.pi) % (2 * np.pi) - np.pi


def block_towards(scan: Scan, body: Body, path: SensorPath) -> ShotBlock:
    """Bound the shots that may hit a body by the angles of its bounding box at all knots.

    Args:
        scan: The shots.
        body: What they may hit.
        path: The sensor's path relative to it.
    """
    rings, columns = scan.shape
    low, high = body.tracer.corners_m[0], body.tracer.corners_m[-1]
    sensor = path.poses[:, :, 3] + body.tracer.anchor_m
    gap = np.maximum(np.maximum(low - sensor, sensor - high), 0.0)
    nearest_m, level_gap_m = float(np.linalg.norm(gap, axis=1).min()) - 0.3, float(np.hypot(gap[:, 0], gap[:, 1]).min())
    all_shots = ShotBlock(np.ones(rings, dtype=bool), np.ones(columns, dtype=bool), max(nearest_m, 0.0))
    if level_gap_m < 0.5:
        return all_shots
    offset = body.tracer.corners_m[None] - sensor[:, None]
    x, y, z = (offset @ path.poses[:, :, :3]).reshape(-1, 3).T
    middle = float(np.arctan2(y.mean(), x.mean()))
    side = _wrap(np.arctan2(y, x) - middle)
    if np.ptp(side) > 3.0:
        return all_shots
    half, centre = float(np.ptp(side)) / 2, middle + float(side.max() + side.min()) / 2
    far, near = float(np.hypot(x, y).max()), 0.9 * level_gap_m
    top = np.arctan2(z.max(), near if z.max() > 0 else far)
    bottom = np.arctan2(z.min(), near if z.min() < 0 else far)
    across, up = scan.margin_rad
    columns_hit = np.abs(_wrap(scan.azimuth_rad - centre)) <= half + across
    return ShotBlock(
        (scan.elevation_rad >= bottom - up) & (scan.elevation_rad <= top + up), columns_hit, max(nearest_m, 0.0)
    )


class NearestHits:
    """The nearest hit of every ray.

    Args:
        scan: The shots.
        bodies: What can be hit.
        world_T_sensor: The sensor's pose at each knot, shape (k, 4, 4).
        knots_s: Times of the knots, shape (k,).

    Attributes:
        range_m: Distance of the hits, inf for none, shape (rays, shots); a shot's index is ``ring * columns + column``.
        cosine: Cosine of the angle of incidence.
        face: Triangle among those of all bodies, one after the other; -1 for none.
        bodies: The bodies in that order.
        first_face: Where each body's triangles begin.
    """

    def __init__(
        self,
        scan: Scan,
        bodies: list[Body],
        world_T_sensor: Float[np.ndarray, "k 4 4"],
        knots_s: Float[np.ndarray, " k"],
    ) -> None:
        rings, columns = scan.shape
        shape = (len(scan.weights), rings * columns)
        self.range_m: Float32[np.ndarray, "rays shots"] = np.full(shape, np.inf, dtype=np.float32)
        self.cosine: Float32[np.ndarray, "rays shots"] = np.zeros(shape, dtype=np.float32)
        self.face: Int32[np.ndarray, "rays shots"] = np.full(shape, -1, dtype=np.int32)
        paths = [SensorPath.towards(body, world_T_sensor, knots_s) for body in bodies]
        blocks = [block_towards(scan, body, path) for body, path in zip(bodies, paths, strict=True)]
        order = sorted(range(len(bodies)), key=lambda i: (bodies[i].actor >= 0, blocks[i].nearest_m))
        self.bodies = [bodies[i] for i in order]
        self.first_face = np.cumsum([0] + [len(body.tracer.mesh.faces) for body in self.bodies])
        self._scan, self._paths, self._blocks = scan, [paths[i] for i in order], [blocks[i] for i in order]
        surroundings = [index for index in range(len(self.bodies)) if self._is_around(index)]
        if surroundings:
            self._cast_all(surroundings)
        for index in range(len(self.bodies)):
            if index not in surroundings:
                self._cast_block(index)

    def _is_around(self, index: int) -> bool:
        """Whether every ray may hit a body, and whether the first body's rays are the same in its frame."""
        is_like_first = index == 0 or (
            self.bodies[index].actor < 0 and np.array_equal(self._paths[index].poses, self._paths[0].poses)
        )
        return is_like_first and self._blocks[index].is_full

    def _cast_all(self, surroundings: list[int]) -> None:
        """Cast every ray at the first body, and at others in the same frame: plants beside the ground and houses."""
        scan = self._scan
        rings, columns = scan.shape
        pose = self._paths[0].at(scan.time_s)
        starts = np.empty((rings, columns, 3), dtype=np.float32)
        starts[:] = _starts(pose, scan.origin_m)
        for ray in range(len(scan.weights)):
            directions = turned(pose, scan.rays[:, ray])
            for index in surroundings:
                tracer, within = self.bodies[index].tracer, self.range_m[ray]
                hits = tracer.cast_anchored(starts.reshape(-1, 3), directions.reshape(-1, 3), within)
                if index == 0:
                    self.range_m[ray], self.cosine[ray], self.face[ray] = hits.range_m, hits.cosine, hits.face
                    continue
                nearer = np.flatnonzero(hits.range_m < within)
                self.range_m[ray, nearer], self.cosine[ray, nearer] = hits.range_m[nearer], hits.cosine[nearer]
                self.face[ray, nearer] = hits.face[nearer] + np.int32(self.first_face[index])

    def _cast_block(self, index: int) -> None:
        """Cast the rays of the shots that may hit a body and have hit nothing nearer."""
        block, body = self._blocks[index], self.bodies[index]
        shots = block.shots()
        shots = shots[self.range_m[:, shots].max(axis=0) > block.nearest_m]
        if shots.size == 0:
            return
        pose, starts = self._leave(index, shots)
        rays = self._scan.rays.reshape(3, -1, self.range_m.shape[1])[:, :, shots]
        directions = turned(pose, rays).reshape(-1, 3)
        origins = np.ascontiguousarray(np.broadcast_to(starts, (*rays.shape[1:], 3))).reshape(-1, 3)
        hits = body.tracer.cast_anchored(origins, directions, self.range_m[:, shots].reshape(-1))
        ray = np.repeat(np.arange(len(rays[0])), len(shots))
        self._keep(index, ray, np.tile(shots, len(rays[0])), hits, np.float32(0))

    def _leave(
        self, index: int, shots: Int[np.ndarray, " k"]
    ) -> tuple[Float32[np.ndarray, "m 3 4"], Float32[np.ndarray, "p 3"]]:
        """The pose at each shot's time, and where the shots start, in a body's frame."""
        ring, column = np.divmod(shots, self._scan.shape[1])
        time, origin = self._scan.time_s, self._scan.origin_m
        path = self._paths[index]
        pose = path.at(time[0])[column if len(path.knots_s) > 1 else slice(None)] if len(time) == 1 else None
        pose = path.at(time[ring, column]) if pose is None else pose
        return pose, _starts(pose, origin[:, 0, column if origin.shape[2] > 1 else np.zeros(1, dtype=np.int64)])

    def _keep(
        self,
        index: int,
        ray: Int[np.ndarray, " m"],
        shots: Int[np.ndarray, " m"],
        hits: RayHits,
        beyond_m: Float32[np.ndarray, " m"] | np.float32,
    ) -> None:
        """Keep the hits that are nearer than what the rays have hit so far."""
        distance = hits.range_m + beyond_m
        nearer = np.flatnonzero(distance < self.range_m[ray, shots])
        cells = ray[nearer], shots[nearer]
        self.range_m[cells], self.cosine[cells] = distance[nearer], hits.cosine[nearer]
        self.face[cells] = hits.face[nearer] + np.int32(self.first_face[index])

    def see_through(self, passes: Bool[np.ndarray, " shots"]) -> None:
        """Let the rays of some shots go on through glass to what lies behind it.

        Args:
            passes: Shots that glass does not send back, shape (shots,).
        """
        glass = self.table(lambda body: body.tracer.mesh.material == Material.GLASS, False)
        for _ in range(_PANES):
            ray, shots = np.nonzero(glass[self.face] & passes)
            if shots.size == 0:
                return
            begin = self.range_m[ray, shots] + _BEYOND_GLASS_M
            self.range_m[ray, shots], self.face[ray, shots] = np.inf, -1
            ring, column = np.divmod(shots, self._scan.shape[1])
            for index, block in enumerate(self._blocks):
                passing = np.flatnonzero(block.rings[ring] & block.columns[column])
                passing = passing[self.range_m[ray[passing], shots[passing]] > block.nearest_m]
                if passing.size:
                    self._go_on(index, ray[passing], shots[passing], begin[passing])

    def _go_on(
        self, index: int, ray: Int[np.ndarray, " m"], shots: Int[np.ndarray, " m"], begin_m: Float32[np.ndarray, " m"]
    ) -> None:
        pose, starts = self._leave(index, shots)
        directions = turned(pose, self._scan.rays.reshape(3, -1, self.range_m.shape[1])[:, ray, shots])
        origins = np.ascontiguousarray(starts + directions * begin_m[:, None])
        within = self.range_m[ray, shots] - begin_m
        hits = self.bodies[index].tracer.cast_anchored(origins, directions, within)
        self._keep(index, ray, shots, hits, begin_m)

    def places_m(self, shots: Int[np.ndarray, " k"]) -> Float[np.ndarray, "k 3"]:
        """Where the middles of some beams hit, in the frame of the first body (the fixed surroundings: the world's).

        Args:
            shots: Shots whose middles hit something.
        """
        pose, starts = self._leave(0, shots)
        along = turned(pose, self._scan.rays.reshape(3, -1, self.range_m.shape[1])[:, 0, shots])
        return starts + along * self.range_m[0, shots, None] + self.bodies[0].tracer.anchor_m

    def table(self, values: Callable[[Body], np.ndarray], none: object) -> np.ndarray:
        """A value for every triangle of all bodies, and at the end (index -1) one for the rays that hit nothing.

        Args:
            values: Gives one body's values, one a triangle.
            none: The last value.
        """
        parts = [np.asarray(values(body)) for body in self.bodies]
        return np.concatenate([*parts, np.asarray([none], dtype=parts[0].dtype if parts else None)])
