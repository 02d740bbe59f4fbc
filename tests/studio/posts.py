"""Posts beside a road, seen by a LiDAR, a radar and a camera: data sets whose calibration is known, or off."""

from pathlib import Path

import numpy as np
from drive import frame as drive_frame
from PIL import Image, ImageDraw

from farfield.calibration.camera_edges import move_camera
from farfield.calibration.radar_matching import RadarPose
from farfield.datasets.kitti.object import calibration_text
from farfield.datasets.kradar.writer import KRadarWriter
from farfield.frame import Cloud
from farfield.geometry.cameras import Camera
from farfield.geometry.poses import transform_points

EGO_M_S = 12.0
GROUND_M = -1.6
RADIUS_M = 0.3
RADAR = RadarPose(x_m=-2.54, y_m=0.3, z_m=0.7)
"""As the writer's files have it."""
CAMERA = Camera(
    matrix=np.array([[707.0, 0, 604.0], [0, 707.0, 180.5], [0, 0, 1.0]]),
    width_px=1224,
    height_px=370,
)
PLANTED = np.array([*np.radians([0.6, -0.8, 0.4]), 0.05, -0.04, 0.03])
"""By how much KITTI's files are off: turns and shifts along the camera's axes."""


def posts(rng: np.random.Generator, count: int) -> np.ndarray:
    """Places and heights of posts, none before another: x, y, top, speed over ground."""
    rows: list[tuple[float, float, float, float]] = []
    while len(rows) < count:
        x, y = rng.uniform(8, 120), rng.uniform(-24, 24)
        if abs(y) > 2 and all(np.hypot(x - a, y - b) > 3 for a, b, _, _ in rows):
            rows.append((x, y, float(rng.uniform(0.4, 1.6)), -13.0 if rng.random() < 0.4 else 0.0))
    return np.array(rows)


def at(world: np.ndarray, seconds: float) -> np.ndarray:
    """Where posts stand relative to the car after some time; those ahead and near."""
    there = world.copy()
    there[:, 0] += (there[:, 3] - EGO_M_S) * seconds
    return there[(there[:, 0] > 6) & (there[:, 0] < 62)]


def cast(there: np.ndarray, *, step_deg: float = 0.2, lines: int = 48) -> tuple[np.ndarray, np.ndarray]:
    """Points and rings of a sweep ahead: posts before the ground and a far round wall."""
    azimuth = np.radians(np.arange(-50, 50, step_deg))
    elevation = np.radians(np.linspace(-14, 6, lines))
    reach = np.full((lines, len(azimuth)), 70.0)
    down = elevation < 0
    reach[down] = np.minimum(reach[down], (GROUND_M / np.tan(elevation[down]))[:, None])
    for x, y, top, _ in there:
        far, bearing = np.hypot(x, y), np.arctan2(y, x)
        half = np.arcsin(RADIUS_M / far)
        off = (azimuth - bearing) / half
        hit = far - RADIUS_M * np.sqrt(np.maximum(1 - off**2, 0))
        seen = (np.abs(off) < 1) & (hit * np.tan(elevation)[:, None] < top) & (hit < reach)
        reach = np.where(seen, hit, reach)
    across, up = np.meshgrid(azimuth, elevation)
    points = np.stack([reach * np.cos(across), reach * np.sin(across), reach * np.tan(up)], axis=-1)
    ring = np.repeat(np.arange(lines)[::-1], len(azimuth))
    return points.reshape(-1, 3), ring


def picture(there: np.ndarray, camera: Camera) -> np.ndarray:
    """Dark posts before a bright wall and ground, drawn with the camera's truth."""
    image = Image.new("RGB", (camera.width_px, camera.height_px), (196, 202, 210))
    draw = ImageDraw.Draw(image)
    draw.rectangle((0, camera.matrix[1, 2] + 16, camera.width_px, camera.height_px), fill=(176, 172, 164))
    for i, (x, y, top, _) in enumerate(there[np.argsort(-there[:, 0])]):
        side = RADIUS_M * np.array([-y, x]) / np.hypot(x, y)
        low, high = (x - side[0], y - side[1]), (x + side[0], y + side[1])
        corners = np.array([[*low, GROUND_M], [*low, top], [*high, top], [*high, GROUND_M]])
        pixels, depth, _ = camera.project(corners)
        if (depth > 1).all():
            draw.polygon([tuple(each) for each in pixels], fill=(40 + 7 * (i % 9), 44, 60))
    return np.asarray(image)


def write_kradar(folder: Path, *, count: int = 12, seed: int = 3) -> Path:
    """A K-Radar of one sequence whose radar stands as :data:`RADAR` says."""
    rng = np.random.default_rng(seed)
    world = posts(rng, 70)
    writer = KRadarWriter(folder, columns=1024)
    for number in range(1, count + 1):
        there = at(world, 0.1 * number)
        points, ring = cast(there, step_deg=0.4)
        kept = rng.permutation(len(points))[:9000]
        kept = np.union1d(kept, np.flatnonzero(np.hypot(points[:, 0], points[:, 1]) < 62))
        points, ring = points[kept].astype(np.float32), ring[kept]
        extra = _columns(points, ring)
        cloud = Cloud(points, rng.random(len(points), dtype=np.float32), extra)
        writer.write(drive_frame(number, clouds={"os2-64": cloud}, radar={"sparse": _echoes(rng, there)}))
    writer.finish()
    return writer.root


def _columns(points: np.ndarray, ring: np.ndarray) -> dict[str, np.ndarray]:
    column = ((np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) + 0.5) * 1024).astype(np.uint16)
    return {
        "ring": ring.astype(np.uint8),
        "column": column,
        "time_ns": np.zeros(len(points), np.int32),
        "reflectivity": np.full(len(points), 20, np.uint16),
        "ambient": np.full(len(points), 20, np.uint16),
        "range_mm": (1000 * np.linalg.norm(points, axis=1)).astype(np.uint32),
    }


def _echoes(rng: np.random.Generator, there: np.ndarray) -> np.ndarray:
    """x, y, z, power in the radar's own coordinates: posts over weak clutter, half a cell below the nodes."""
    near = there[:, :2] * (1 - RADIUS_M / np.hypot(there[:, 0], there[:, 1]))[:, None]
    own = transform_points(RADAR.matrix, np.column_stack([near, np.zeros(len(near))]))
    own[:, :2] += rng.normal(0, 0.06, (len(own), 2))
    weak = rng.uniform([3, -28, -1], [66, 28, 2], (1500, 3))
    places = np.concatenate([own, weak]) - 0.2
    power = np.concatenate([rng.uniform(200, 500, len(own)), rng.uniform(0.5, 2, len(weak))])
    return np.column_stack([places, power])


def plant_radar(root: Path, x_m: float, y_m: float) -> Path:
    """Put the radar elsewhere in K-Radar's file; returns it."""
    path = next(root.glob("*/info_calib/calib_radar_lidar.txt"))
    head, values = path.read_text().splitlines()[:2]
    frames, x, y = values.split(",")
    path.write_text(f"{head}\n{frames},{float(x) + x_m:.4f},{float(y) + y_m:.4f}\n")
    return path


def write_kitti(root: Path, *, count: int = 3, seed: int = 5) -> Path:
    """A KITTI of some streets whose calibration is off by :data:`PLANTED`."""
    rng = np.random.default_rng(seed)
    for kind in ("velodyne", "calib", "image_2"):
        (root / "training" / kind).mkdir(parents=True)
    for number in range(count):
        there = at(posts(rng, 60), 0.0)
        points, _ = cast(there)
        rows = np.column_stack([points, np.full(len(points), 0.3)]).astype(np.float32)
        rows.tofile(root / f"training/velodyne/{number:06d}.bin")
        Image.fromarray(picture(there, CAMERA)).save(root / f"training/image_2/{number:06d}.png")
        text = calibration_text(move_camera(CAMERA, PLANTED))
        (root / f"training/calib/{number:06d}.txt").write_text(text)
    return root
