"""Made-up drives with known calibrations, seconds to make: roads for a radar, boards for a camera, streets for LiDARs.

What errs, and by how much, is what the simulator's radar, rays and pictures err by (``docs/calibration.md``); here it
is drawn anew for every seed, so that errors over sigma can be counted over many of them.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from farfield.calibration.camera_edges import align_edges, camera_difference, edge_uncertainty, edge_views, move_camera
from farfield.calibration.camera_pairs import calibrate_pairs
from farfield.calibration.depth_edges import lidar_edges
from farfield.calibration.least_squares import motion_vector, rigid_motion
from farfield.calibration.lidar_lidar import register
from farfield.calibration.radar_features import SensorPair
from farfield.calibration.radar_lidar import refine_radar
from farfield.calibration.radar_matching import RadarEvidence, RadarPose
from farfield.geometry.cameras import Camera
from farfield.geometry.poses import invert, pose, transform_points

# A road for a radar


EGO_M_S, ONCOMING_M_S = 14.0, -12.0
POST_M, CAR_M = 0.2, 1.8
PERIOD_S = 0.1


@dataclass(frozen=True, eq=False, kw_only=True)
class RadarRoad:
    """What stands and drives on one road, and what its echoes err by in all frames.

    Args:
        place_m: Where the near faces are at the first frame, shape (n, 2).
        speed_m_s: How fast they drive along x over ground, shape (n,).
        width_m: Of the faces, shape (n,).
        range_m: What each object's echo is off in range, shape (n,).
        azimuth_rad: The same across, shape (n,).
        face_m: What its LiDAR face is off, shape (n, 2).
    """

    place_m: np.ndarray
    speed_m_s: np.ndarray
    width_m: np.ndarray
    range_m: np.ndarray
    azimuth_rad: np.ndarray
    face_m: np.ndarray

    @classmethod
    def drawn(cls, rng: np.random.Generator, seconds: float) -> "RadarRoad":
        """Posts beside the road, cars ahead, oncoming and parked: so many a metre of the way."""
        reach_m = 70.0 + EGO_M_S * seconds
        posts, parked, driving = (rng.poisson(share * reach_m) for share in (0.06, 0.04, 0.04))
        x = rng.uniform(0.0, reach_m, posts + parked + driving)
        side = rng.choice([-1.0, 1.0], len(x))
        beside = np.concatenate([rng.uniform(5.0, 20.0, posts), rng.uniform(5.0, 12.0, parked), np.full(driving, 3.5)])
        speed = np.zeros(len(x))
        speed[posts + parked :] = np.where(
            side[posts + parked :] > 0, ONCOMING_M_S, EGO_M_S + rng.normal(0, 3, driving)
        )
        width = np.concatenate([np.full(posts, POST_M), np.full(parked + driving, CAR_M)])
        return cls(
            place_m=np.column_stack([x, side * beside]),
            speed_m_s=speed,
            width_m=width,
            range_m=rng.normal(0.0, 0.08, len(x)),
            azimuth_rad=np.radians(rng.normal(0.0, 0.06, len(x))),
            face_m=rng.normal(0.0, 0.03, (len(x), 2)),
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class RadarErrors:
    """What the echoes of a whole drive have in common, each drawn once.

    Args:
        range_m: Of all ranges.
        turn_rad: Of all bearings.
        depth_m: How deep bodies on the left and on the right answer.
        tilt_rad: How far near vehicles are seen outward and far ones inward.
        beside_m: How far vehicles are seen to one side.
    """

    range_m: float
    turn_rad: float
    depth_m: np.ndarray
    tilt_rad: float
    beside_m: float

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "RadarErrors":
        """As ``farfield.calibration`` takes them to be spread."""
        range_m, turn, tilt, beside = rng.normal(0.0, [0.025, 0.04, 0.2, 0.04])
        return cls(
            range_m=range_m,
            turn_rad=np.radians(turn),
            depth_m=rng.normal(0.0, 0.15, 2),
            tilt_rad=np.radians(tilt),
            beside_m=beside,
        )


def radar_drive(seed: int, truth: RadarPose, frames: int) -> list[SensorPair]:
    """Sweeps and echoes of one drive.

    Args:
        seed: Of the road and of all errors.
        truth: The radar's pose and time.
        frames: How many, one after the other.
    """
    rng = np.random.default_rng((7, seed))
    road, errors = RadarRoad.drawn(rng, frames * PERIOD_S), RadarErrors.drawn(rng)
    pairs = []
    for number in range(frames):
        late_s = (number - truth.frames) * PERIOD_S + truth.time_offset_s
        points = _faces(road, number * PERIOD_S, rng)
        echoes = _echoes(road, errors, late_s, truth, rng)
        pairs.append(
            SensorPair(
                number=number + 20,
                points_m=points,
                lag_s=np.zeros(len(points)),
                echoes_m=np.column_stack([echoes, np.zeros(len(echoes))]),
                power_db=rng.uniform(15.0, 25.0, len(echoes)),
            )
        )
    return pairs


def _places(road: RadarRoad, time_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Which objects lie before the car at a time, and where, in the LiDAR's frame."""
    at = road.place_m + np.outer((road.speed_m_s - EGO_M_S) * time_s, [1.0, 0.0])
    seen = (at[:, 0] > 6.0) & (at[:, 0] < 65.0) & (np.abs(at[:, 1]) < 0.9 * at[:, 0])
    return np.flatnonzero(seen), at[seen]


def _faces(road: RadarRoad, time_s: float, rng: np.random.Generator) -> np.ndarray:
    """Points on the near faces."""
    which, at = _places(road, time_s)
    at = at + road.face_m[which] + rng.normal(0.0, 0.02, at.shape)
    across = np.linspace(-0.5, 0.5, 12)[None] * road.width_m[which][:, None]
    height = np.tile(np.linspace(-1.5, 0.5, 12), len(at))
    points = np.stack([np.repeat(at[:, :1], 12, 1), at[:, 1:] + rng.permuted(across, axis=1)], axis=-1).reshape(-1, 2)
    return np.column_stack([points + rng.normal(0.0, 0.02, points.shape), height])


def _echoes(
    road: RadarRoad, errors: RadarErrors, time_s: float, truth: RadarPose, rng: np.random.Generator
) -> np.ndarray:
    """Echoes in the radar's frame."""
    which, at = _places(road, time_s)
    cos, sin = np.cos(truth.yaw_rad), np.sin(truth.yaw_rad)
    at = at @ np.array([[cos, sin], [-sin, cos]]) + [truth.x_m, truth.y_m]
    range_m, bearing = np.hypot(*at.T), np.arctan2(at[:, 1], at[:, 0])
    wide = road.width_m[which] > 0.8
    side = np.sin(bearing)
    depth_m = np.where(side > 0, errors.depth_m[0], errors.depth_m[1]) * np.abs(side)
    range_off = errors.range_m + depth_m + road.range_m[which] + rng.normal(0.0, 0.18, len(at))
    common = errors.turn_rad + wide * (errors.tilt_rad * (1.0 - 40.0 / range_m) + errors.beside_m / range_m)
    glint = 0.15 * road.width_m[which] / range_m * rng.normal(size=len(at))
    bearing = bearing + common + road.azimuth_rad[which] + glint + np.radians(rng.normal(0.0, 0.13, len(at)))
    range_m = range_m + range_off
    return np.column_stack([range_m * np.cos(bearing), range_m * np.sin(bearing)])


# Boards before a wall for a camera and a LiDAR


CAMERA = Camera(matrix=np.array([[300.0, 0, 320], [0, 300.0, 180], [0, 0, 1]]), width_px=640, height_px=360)


def boards_scene(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Picture, sweep and rings of boards of different grey before a wall."""
    columns = [rng.uniform(low, high, 14) for low, high in ((6, 22), (-12, 10), (1, 2.5), (-2, 2), (0.8, 2), (0, 255))]
    boards = [(x, y, y + width, z, z + height, grey) for x, y, width, z, height, grey in zip(*columns, strict=True)]
    u, v = np.meshgrid(np.arange(640.0), np.arange(360.0))
    rays = CAMERA.rays(np.column_stack([u.ravel(), v.ravel()]))
    _, grey = _cast(rays, boards, transform_points(invert(CAMERA.camera_T_lidar), np.zeros((1, 3)))[0])
    azimuth, ring = np.meshgrid(np.radians(np.arange(-50, 50, 0.18)), np.arange(64))
    azimuth, elevation = azimuth + np.radians(rng.uniform(0, 0.18)), np.radians(-11.25 + 22.5 * ring / 63)
    flat = np.cos(elevation)
    shots = np.column_stack([a.ravel() for a in (flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation))])
    reach, _ = _cast(shots, boards, np.zeros(3))
    reach = reach + rng.normal(0.0, 0.02, reach.shape)
    noisy = np.clip(grey.reshape(360, 640, 1) + rng.normal(0, 3, (360, 640, 1)), 0, 255)
    return np.repeat(noisy, 3, 2).astype(np.uint8), shots * reach[:, None], ring.ravel()


def _cast(rays: np.ndarray, boards: list[tuple[float, ...]], origin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    reach, grey = (40 - origin[0]) / rays[:, 0], np.full(len(rays), 128.0)
    for x, left, right, low, high, shade in boards:
        along = (x - origin[0]) / rays[:, 0]
        at = origin + rays * along[:, None]
        hit = (at[:, 1] > left) & (at[:, 1] < right) & (at[:, 2] > low) & (at[:, 2] < high) & (along < reach)
        reach[hit], grey[hit] = along[hit], shade
    return reach, grey


def picked_pairs(rng: np.random.Generator, count: int, sigma_px: float) -> tuple[np.ndarray, np.ndarray]:
    """Points 5 to 40 m ahead, in all parts of the picture, and the pixels that a hand picks."""
    pixels = rng.uniform([20, 20], [620, 340], (count, 2))
    depth = np.exp(rng.uniform(np.log(5), np.log(40), count))
    origin = transform_points(invert(CAMERA.camera_T_lidar), np.zeros((1, 3)))
    points = origin + CAMERA.rays(pixels) * depth[:, None]
    seen, _, _ = CAMERA.project(points)
    return points, seen + rng.normal(0.0, sigma_px, seen.shape)


# A street for two LiDARs


LIDARS = pose(Rotation.from_euler("xyz", [1, -2, 3], degrees=True).as_matrix(), np.array([0.4, -0.1, 0.2]))
"""Where the second one stands in the first one's frame."""


def street_sweeps(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A sweep of each of two LiDARs of one frame: ground, house fronts of all directions, and 2 cm of noise."""
    walls = [
        (rng.uniform(-np.pi, np.pi), rng.uniform(6, 25), rng.uniform(4, 12), rng.uniform(-8, 8)) for _ in range(10)
    ]
    world_T_car = pose(Rotation.from_euler("z", rng.uniform(-np.pi, np.pi)).as_matrix(), np.zeros(3))
    sweeps = []
    for mount in (np.eye(4), LIDARS):
        ground = np.column_stack([rng.uniform(-25, 25, (5000, 2)), np.full(5000, -1.9)])
        parts = [ground]
        for bearing, away, length, beside in walls:
            along, height = beside + rng.uniform(-length, length, 700), rng.uniform(-1.9, 5, 700)
            cos, sin = np.cos(bearing), np.sin(bearing)
            parts.append(np.column_stack([cos * away - sin * along, sin * away + cos * along, height]))
        points = transform_points(invert(world_T_car @ mount), np.concatenate(parts))
        sweeps.append(points + rng.normal(0.0, 0.02, points.shape))
    return sweeps[0], sweeps[1]


# What the solvers make of them


@dataclass(frozen=True, eq=False, kw_only=True)
class SolvedValues:
    """One solved calibration: what it is off by, and its sigma, by parameter."""

    error: np.ndarray
    sigma: np.ndarray


def solved_radar(seed: int, *, frames: int) -> SolvedValues:
    """A radar on a made-up road, from a rough start."""
    rng = np.random.default_rng((8, seed))
    x, y, yaw, late = np.array([-2.5, 0.3, 0.0, 0.0]) + rng.uniform(-1, 1, 4) * [0.3, 0.2, np.radians(1), 0.02]
    truth = RadarPose(x_m=x, y_m=y, z_m=0.7, yaw_rad=yaw, time_offset_s=late)
    evidence = RadarEvidence.of(radar_drive(seed, truth, frames))
    result = refine_radar(evidence, RadarPose(x_m=-2.5, y_m=0.3, z_m=0.7))
    return SolvedValues(error=result.value - truth.vector, sigma=np.sqrt(np.diag(result.covariance)))


def solved_pairs(seed: int, *, count: int) -> SolvedValues:
    """A camera by picked pairs, 2 px of the hand's noise."""
    points_m, pixels = picked_pairs(np.random.default_rng((9, seed)), count, 2.0)
    result = calibrate_pairs(points_m, pixels, CAMERA, from_nothing=False)
    return SolvedValues(error=camera_difference(result.camera, CAMERA), sigma=result.solution.sigma)


def solved_edges(seed: int, *, frames: int) -> SolvedValues:
    """A camera by edges of made-up boards, from 0.7 degrees and 8 cm."""
    rng = np.random.default_rng((9, seed))
    scenes = [boards_scene(rng) for _ in range(frames)]
    start = move_camera(CAMERA, np.append(np.radians(rng.uniform(-0.7, 0.7, 3)), rng.uniform(-0.08, 0.08, 3)))
    edges = [lidar_edges(points_m, ring) for _, points_m, ring in scenes]
    views = edge_views([picture for picture, _, _ in scenes], edges, start)
    result = align_edges(start, views)
    return SolvedValues(error=camera_difference(result, CAMERA), sigma=edge_uncertainty(result, views)[0])


def solved_lidars(seed: int, *, frames: int) -> SolvedValues:
    """A second LiDAR on made-up streets, from a degree and 0.2 m."""
    rng = np.random.default_rng((9, seed))
    targets, sources = zip(*(street_sweeps(rng) for _ in range(frames)), strict=True)
    start = rigid_motion(np.append(np.radians(rng.uniform(-1, 1, 3)), rng.uniform(-0.2, 0.2, 3))) @ LIDARS
    result = register(targets, sources, start)
    return SolvedValues(error=motion_vector(result.target_T_source @ invert(LIDARS)), sigma=result.solution.sigma)
