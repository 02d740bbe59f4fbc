"""Point-to-plane registration: a street corner seen from two places; a flat road that does not tell x, y and yaw."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from farfield.calibration.lidar_lidar import register
from farfield.errors import DatasetError
from farfield.geometry.poses import invert, pose, transform_points

TRUTH = pose(Rotation.from_euler("xyz", [1, -2, 3], degrees=True).as_matrix(), np.array([0.4, -0.1, 0.2]))


def corner(rng: np.random.Generator, count: int = 9000) -> np.ndarray:
    u, v = rng.uniform(-20, 20, count), rng.uniform(-20, 20, count)
    height = rng.uniform(0, 6, count)
    ground = np.column_stack([u, v, np.full(count, -2.0)])
    wall = np.column_stack([u, np.full(count, 9.0), height - 2])
    front = np.column_stack([np.full(count, 14.0), v, height - 2])
    return np.concatenate([ground, wall, front]) + rng.normal(0, 0.01, (3 * count, 3))


def test_a_start_beside_it_is_brought_back() -> None:
    rng = np.random.default_rng(0)
    source = transform_points(invert(TRUTH), corner(rng))
    start = pose(Rotation.from_rotvec(np.radians([1, -1, 0.8])).as_matrix(), np.array([0.1, -0.2, 0.1])) @ TRUTH
    found = register([corner(rng)], [source], start)
    step = found.target_T_source @ invert(TRUTH)
    assert np.degrees(Rotation.from_matrix(step[:3, :3]).magnitude()) < 0.05
    assert np.linalg.norm(step[:3, 3]) < 0.01
    assert found.rms_m < 0.03
    assert found.solution.unobserved == ()


def test_a_flat_road_does_not_tell_where_it_was() -> None:
    rng = np.random.default_rng(1)
    road = np.column_stack([rng.uniform(-20, 20, (20000, 2)), rng.normal(-2, 0.003, 20000)])
    found = register([road], [road[::2] + rng.normal(0, 0.003, (10000, 3))])
    assert found.solution.unobserved == () or any("x" in each or "y" in each for each in found.solution.unobserved)
    assert found.solution.information[0] < 0.05 * found.solution.information[-1]


def test_sweeps_far_apart_are_refused() -> None:
    rng = np.random.default_rng(2)
    with pytest.raises(DatasetError, match="nearer start"):
        register([corner(rng, 500)], [corner(rng, 500)], pose(np.eye(3), np.array([0.0, 0, 500])))
