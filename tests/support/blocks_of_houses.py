"""A street of houses whose surfaces are sampled anew for each sweep: where the sensor is, is known."""

import numpy as np
from jaxtyping import Float

from farfield.geometry.deskewing import PoseTrack
from farfield.geometry.poses import invert, pose_from_yaw, transform_points
from farfield.odometry.odometry import OdometrySweep

STEP_S = 0.1


def surfaces(rng: np.random.Generator, count: int) -> Float[np.ndarray, "n 3"]:
    """Points on the ground and on the walls of houses along the x axis, from -60 to 120 m."""
    ground = np.column_stack([rng.uniform(-60, 120, count), rng.uniform(-25, 25, count), np.full(count, -1.7)])
    parts = [ground]
    for x in range(-60, 120, 15):
        for side in (-1, 1):
            depth = 8 + (x * 7 + side * 3) % 5
            up = rng.uniform(-1.7, 5, count // 12)
            along = rng.uniform(x, x + 9, count // 12)
            parts.append(np.column_stack([along, np.full(len(up), side * depth), up]))
            across = rng.uniform(depth, depth + 6, count // 12)
            parts.append(np.column_stack([np.full(len(up), x), side * across, up]))
    return np.concatenate(parts)


def path(times_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 4 4"]:
    """Poses of a car that drives at 12 m/s, brakes a little and turns."""
    x = 12 * times_s - 0.5 * times_s**2
    return np.stack(
        [pose_from_yaw(0.12 * t, (float(s), float(0.3 * t * t), 0.0)) for t, s in zip(times_s, x, strict=True)]
    )


def drive(
    count: int, *, seed: int = 0, skewed: bool = False, points: int = 4000
) -> tuple[list[OdometrySweep], np.ndarray]:
    """Sweeps and the true poses from the first; skewed: measured over a tenth of a second, each point with its time."""
    rng = np.random.default_rng(seed)
    times = STEP_S * np.arange(count)
    poses = path(times)
    fine = np.arange(-1, count + 1, 0.1) * STEP_S
    track = PoseTrack(np.rint(fine * 1e9).astype(np.int64), path(fine))
    sweeps = []
    for time, pose in zip(times, poses, strict=True):
        world = surfaces(rng, points)
        world = world[np.linalg.norm(world - pose[:3, 3], axis=1) < 50]
        if skewed:
            offset = np.round(rng.uniform(-0.05, 0.05, len(world)), 3)
            at = track.at(np.rint((time + offset) * 1e9).astype(np.int64))
            seen = np.einsum("nji,nj->ni", at[:, :3, :3], world - at[:, :3, 3])
        else:
            offset, seen = None, transform_points(invert(pose), world)
        sweeps.append(OdometrySweep(seen + rng.normal(0, 0.01, seen.shape), float(time), offset))
    return sweeps, np.linalg.inv(poses[0]) @ poses
