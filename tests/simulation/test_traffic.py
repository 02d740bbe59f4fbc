"""Motion: the car-following model against its equilibrium, and bodies that never touch."""

import numpy as np
import pytest

from farfield.frame import Boxes
from farfield.geometry.iou import pairwise_iou
from farfield.simulation.world.scene import Scene
from farfield.simulation.world.traffic import STEP_S, Motion, follow, in_conflict


def test_free_vehicle_keeps_its_desired_speed() -> None:
    path = follow(np.array([0.0]), np.array([30.0]), np.array([4.5]), np.array([-1]), steps=200)
    np.testing.assert_allclose(np.diff(path[0]), 3.0, rtol=1e-9)


def test_follower_settles_at_the_equilibrium_gap() -> None:
    """s = (s0 + v T) / sqrt(1 - (v / v0)^4), with s0 = 2 m and T = 1.3 s (Treiber et al., 2000, equation 5)."""
    path = follow(np.array([100.0, 0.0]), np.array([20.0, 30.0]), np.array([4.0, 6.0]), np.array([-1, 0]), steps=4000)
    gap = path[0, -1] - path[1, -1] - 5.0
    assert gap == pytest.approx((2 + 20 * 1.3) / np.sqrt(1 - (20 / 30) ** 4), rel=1e-3)
    assert (path[1, -1] - path[1, -2]) / STEP_S == pytest.approx(20.0, rel=1e-4)


def test_no_rear_end_collision_even_behind_a_standing_vehicle() -> None:
    path = follow(
        np.array([60.0, 20.0, 5.0]), np.array([0.01, 30.0, 33.0]), np.full(3, 4.5), np.array([-1, 0, 1]), steps=600
    )
    assert (path[:2] - path[1:] > 4.5 + 0.99).all()
    assert (np.diff(path, axis=1) >= -1e-9).all()


def test_motion_interpolates_between_steps_and_across_the_turn_of_the_angle() -> None:
    position = np.zeros((1, 3, 3))
    position[0, :, 0] = [0, 1, 3]
    motion = Motion(position, np.array([[3.1, -3.1, -3.0]]))
    where, yaw = motion.at(0.05)
    assert where[0, 0] == pytest.approx(0.5)
    assert abs(yaw[0]) == pytest.approx(np.pi, abs=1e-9)
    assert motion.at(0.2)[0][0, 0] == pytest.approx(3.0)


def test_the_later_of_two_that_would_touch_goes() -> None:
    steps = 50
    x = np.linspace(-20, 20, steps)
    position = np.zeros((4, steps, 3))
    position[0, :, 0], position[1, :, 1] = x, x  # these two meet at the origin
    position[2, :, 1], position[3, :, 0] = 40, -60  # these meet nobody
    yaw = np.zeros((4, steps))
    yaw[1] = np.pi / 2
    size = np.full((4, 3), [4.5, 1.9, 1.5])
    gone = in_conflict(position, yaw, size, np.array([False, True, True, True]), margin_m=0.3)
    assert gone.tolist() == [False, True, False, False]


@pytest.mark.parametrize("template", ["highway", "urban"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_no_two_bodies_overlap_at_any_time(template: str, seed: int) -> None:
    """By exact IoU over the whole scene, the ego vehicle included."""
    scene = Scene(template, np.random.SeedSequence(seed), duration_s=15.0, sensor_height_m=2.0)
    size = np.array([actor.size_m for actor in scene.actors])
    assert len(size) > 20
    for time_s in np.linspace(0, 15, 7):
        position, yaw = scene.motion.at(float(time_s))
        boxes = Boxes(centre_m=position, size_m=size, yaw_rad=yaw)
        iou = pairwise_iou(boxes, boxes, kind="bev")
        np.fill_diagonal(iou, 0.0)
        assert iou.max() < 1e-6


def test_vehicles_move_by_their_speed_and_keep_their_identity() -> None:
    scene = Scene("highway", np.random.SeedSequence(4), duration_s=10.0, sensor_height_m=2.0)
    first, second = scene.motion.at(2.0)[0], scene.motion.at(2.5)[0]
    speed = np.linalg.norm(second - first, axis=1) / 0.5
    assert speed.max() < 60
    assert speed.max() > 2
    assert len({actor.track_id for actor in scene.actors}) == len(scene.actors)
    assert scene.actors[0].track_id == 0
