"""Sweeps and cameras for depth maps: what a spinning LiDAR sees of planes and boxes, without noise."""

import numpy as np

from farfield.geometry.cameras import CAMERA_T_LIDAR_AXES, Camera

BARREL = np.array([-0.25, 0.05, 0.001, -0.001, 0.0])


def camera(width: int = 300, height: int = 160, *, distortion: np.ndarray | None = None) -> Camera:
    """A camera 0.3 m before and 0.2 m below the LiDAR, and somewhat to its left."""
    pose = CAMERA_T_LIDAR_AXES.copy()
    pose[:3, 3] = [0.1, -0.2, -0.3]
    return Camera(
        matrix=np.array([[220.0, 0, width / 2 - 0.5], [0, 220.0, height / 2 - 0.5], [0, 0, 1.0]]),
        distortion=np.zeros(5) if distortion is None else distortion,
        camera_T_lidar=pose,
        width_px=width,
        height_px=height,
    )


def directions(lines: int = 32, *, columns: int = 1800) -> tuple[np.ndarray, np.ndarray]:
    """Unit rays ring by ring from the top, once round from ahead, and their rings."""
    elevation = np.radians(np.linspace(12, -24, lines))
    azimuth = np.linspace(1e-3, 2 * np.pi - 1e-3, columns)
    e, a = (part.reshape(-1) for part in np.meshgrid(elevation, azimuth, indexing="ij"))
    rays = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1)
    return rays, np.repeat(np.arange(lines), columns)


def onto_plane(rays: np.ndarray, normal: np.ndarray, offset: float) -> np.ndarray:
    """Ranges at which rays from the origin meet the plane normal . x = offset; inf where they do not."""
    along = rays @ normal
    with np.errstate(divide="ignore"):
        ranges = offset / along
    return np.where(ranges > 0, ranges, np.inf)


def true_plane(lens: Camera, normal: np.ndarray, offset: float) -> np.ndarray:
    """Depth of the plane at every pixel."""
    v, u = np.mgrid[: lens.height_px, : lens.width_px]
    rays = lens.rays(np.column_stack([u.reshape(-1), v.reshape(-1)]).astype(float))
    centre = -lens.camera_T_lidar[:3, :3].T @ lens.camera_T_lidar[:3, 3]
    ranges = (offset - centre @ normal) / (rays @ normal)
    depth = ranges * (rays @ lens.camera_T_lidar[2, :3])
    return np.where(ranges > 0, depth, np.nan).reshape(lens.height_px, lens.width_px)
