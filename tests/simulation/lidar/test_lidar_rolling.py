"""The rolling scan against analytic shifts, mixed pixels at a known edge, and the columns of the clouds."""

import numpy as np
import pytest
from _validation_scenes import HERE, body, frozen, moving, plate, quiet

from farfield.geometry.poses import pose_from_yaw
from farfield.simulation.lidar.echoes import strongest
from farfield.simulation.lidar.model import LUMINAR_H2, OS2_64
from farfield.simulation.lidar.rays import Scan
from farfield.simulation.lidar.sweep import SimulatedSweep, sweep
from farfield.simulation.trace import Body, Tracer

KNOTS_S = np.linspace(-0.06, 0.06, 9)
SPEED_M_S = 20.0


def wall_seen(*, compensated: bool) -> SimulatedSweep:
    """A wall 30 m ahead, seen by an OS2 that drives at it."""
    model = quiet(OS2_64, compensated=compensated, sub_rays=1)
    wall = body(plate(0.8, width_m=60, height_m=30), 30, 0, 0, knots=9)
    window = moving([wall], np.array([SPEED_M_S, 0, 0]), KNOTS_S)
    rng = np.random.default_rng(1)
    return sweep(Scan.draw(model, rng), model, window, HERE, rng)


def test_uncompensated_wall_is_skewed_by_the_way_driven() -> None:
    result = wall_seen(compensated=False)
    time_s = result.cloud.extra["time_ns"] * 1e-9
    assert len(result.cloud) > 20_000
    assert np.ptp(time_s) > 0.02
    np.testing.assert_allclose(result.cloud.points_m[:, 0], 29.995 - SPEED_M_S * time_s, atol=1e-4)


def test_compensated_wall_is_flat() -> None:
    result = wall_seen(compensated=True)
    np.testing.assert_allclose(result.cloud.points_m[:, 0], 29.995, atol=1e-4)


def test_turning_sensor_sees_a_straight_wall_after_compensation() -> None:
    model = quiet(LUMINAR_H2, sub_rays=1)
    wall = body(plate(0.8, width_m=80, height_m=30), 30, 0, 0, knots=9)
    window = moving([wall], np.array([15.0, 0, 0]), KNOTS_S, yaw_rate=0.4)
    rng = np.random.default_rng(1)
    result = sweep(Scan.draw(model, rng, pattern="uniform"), model, window, HERE, rng)
    assert len(result.cloud) > 30_000
    np.testing.assert_allclose(result.cloud.points_m[:, 0], 29.995, atol=1e-3)


def test_a_crossing_car_is_sheared() -> None:
    """Lines are drawn one after the other: a plate that crosses at 15 m/s leans by 15 m/s times the lines' time."""
    model = quiet(LUMINAR_H2, sub_rays=1, smile_deg=0.0)
    poses = np.stack([pose_from_yaw(0.0, (20.0, 15.0 * float(knot), 0.0)) for knot in KNOTS_S])
    crossing = Body(Tracer(plate(0.8, width_m=4, height_m=6)), poses, 0)
    rng = np.random.default_rng(1)
    window = moving([crossing], np.zeros(3), KNOTS_S)
    result = sweep(Scan.draw(model, rng, pattern="gaussian"), model, window, HERE, rng)
    ring, time_s = result.cloud.extra["ring"], result.cloud.extra["time_ns"] * 1e-9
    rings = np.unique(ring)
    middle = np.array(
        [(result.cloud.points_m[ring == r, 1].max() + result.cloud.points_m[ring == r, 1].min()) / 2 for r in rings]
    )
    when = np.array([time_s[ring == r].mean() for r in rings])
    assert len(rings) > 20
    assert np.polyfit(when, middle, 1)[0] == pytest.approx(15.0, rel=0.05)
    assert np.abs(middle - 15.0 * when).max() < 0.05


def test_frozen_and_moving_windows_agree_when_nothing_moves() -> None:
    clouds = []
    for knots_s in (np.zeros(1), KNOTS_S):
        wall = body(plate(0.5, width_m=60, height_m=30), 40, 3, 1, yaw_rad=0.3, knots=len(knots_s))
        rng = np.random.default_rng(4)
        clouds.append(sweep(Scan.draw(OS2_64, rng), OS2_64, moving([wall], np.zeros(3), knots_s), HERE, rng).cloud)
    assert len(clouds[0]) == len(clouds[1]) > 10_000
    np.testing.assert_allclose(clouds[0].points_m, clouds[1].points_m, atol=1e-4)


def test_mixed_pixels_stand_between_two_near_surfaces_and_not_between_far_ones(rng: np.random.Generator) -> None:
    """At an edge, two plates 0.5 m apart give ranges in between; 3 m apart they give one of the two."""
    for gap_m, mixed in ((0.5, True), (3.0, False)):
        model = quiet(OS2_64)
        near, far = plate(0.5, width_m=10, height_m=30), plate(0.5, width_m=30, height_m=30)
        window = frozen(body(near, 30, -5, 0), body(far, 30 + gap_m, 0, 0, actor=1))
        x = sweep(Scan.draw(model, rng), model, window, HERE, rng).cloud.points_m[:, 0] - 29.995
        between = (x > 0.05) & (x < gap_m - 0.05)
        assert between.any() == mixed
        assert (x > -0.02).all()
        assert (x < gap_m + 0.02).all()


def test_echo_range_is_weighted_by_power() -> None:
    model = quiet(OS2_64)
    range_m = np.array([[10.0, 10.0, 10.0, 10.0], [10.4, 14.0, 14.0, np.inf]], dtype=np.float32)
    power = np.array([[3.0, 3.0, 1.0, 2.0], [1.0, 1.0, 3.0, 0.0]], dtype=np.float32)
    echoes = strongest(model, range_m, power)
    np.testing.assert_allclose(echoes.range_m, [10.1, 10.0, 14.0, 10.0], rtol=1e-6)
    np.testing.assert_allclose(echoes.strength, [4.0, 3.0, 3.0, 2.0])
    assert echoes.ray.tolist() == [0, 0, 1, 0]


def test_an_edge_costs_the_power_of_the_rays_that_miss(rng: np.random.Generator) -> None:
    """A beam of which the lower two rays pass under a plate keeps 0.75 of its power: its intensity is 0.75 as high."""
    model = quiet(OS2_64)
    scan = Scan.draw(model, rng)
    ring = 20
    height = 100 * np.tan(scan.elevation_rad[ring] - 1e-4)
    target = plate(0.8, width_m=20, height_m=10)
    window = frozen(body(target, 100, 0, 5 + float(height)))
    result = sweep(scan, model, window, HERE, rng)
    edge, full = result.cloud.extra["ring"] == ring, result.cloud.extra["ring"] == ring - 5
    assert edge.any()
    ratio = np.median(result.cloud.intensity[edge]) / np.median(result.cloud.intensity[full])
    assert ratio == pytest.approx(0.75, abs=0.02)


def test_columns_of_an_ouster_cloud(rng: np.random.Generator) -> None:
    model = quiet(OS2_64)
    window = frozen(body(plate(0.5, width_m=30, height_m=30), 25, 0, 0))
    cloud = sweep(Scan.draw(model, rng), model, window, HERE, rng).cloud
    kinds = {name: column.dtype.name for name, column in cloud.extra.items()}
    assert kinds == {
        "ring": "uint8",
        "column": "uint16",
        "time_ns": "int32",
        "range_mm": "uint32",
        "reflectivity": "uint16",
        "signal": "float32",
        "ambient": "uint16",
    }
    order = cloud.extra["ring"].astype(np.int64) * 2048 + cloud.extra["column"]
    assert (np.diff(order) > 0).all()
    x, y, z = cloud.points_m.T.astype(np.float64)
    ahead = np.abs(y) < 1  # where the beam's origin lies 13.8 mm before the axis
    distance = np.hypot(x - 0.0138, np.hypot(y, z)) + 0.0138
    np.testing.assert_allclose(cloud.extra["range_mm"][ahead], 1000 * distance[ahead], atol=1.0)


def test_the_same_seed_gives_the_same_bytes() -> None:
    window = frozen(body(plate(0.2, width_m=30, height_m=30), 40, 0, 0))
    clouds = []
    for _ in range(2):
        rng = np.random.default_rng(8)
        clouds.append(sweep(Scan.draw(LUMINAR_H2, rng), LUMINAR_H2, window, HERE, rng).cloud)
    assert clouds[0].points_m.tobytes() == clouds[1].points_m.tobytes()
    assert clouds[0].intensity.tobytes() == clouds[1].intensity.tobytes()
