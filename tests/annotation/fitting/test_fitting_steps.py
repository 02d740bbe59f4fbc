"""The steps of a fit by themselves: ground, cluster, L-shape, anchoring, search."""

from dataclasses import replace

import numpy as np
import pytest
from fitting_scenes import CAR, road, scene, sides

from farfield.annotation.fitting import fit_radar_peak, prior_of
from farfield.annotation.fitting.boxes import cluster_at, link_radius_m
from farfield.annotation.fitting.ground import fit_ground, ground_ahead, points_above
from farfield.annotation.fitting.prior import Prior, along_length, footprint
from farfield.annotation.fitting.search import best_yaw, refine_yaw, scores, search
from farfield.vocabulary.classes import SMALL_KINDS, VEHICLE_KINDS


@pytest.mark.parametrize("slope", [0.0, 0.04])
def test_the_ground_under_a_car_is_the_road(rng: np.random.Generator, slope: float) -> None:
    points = scene(rng, (20.0, 5.0), 0.4, slope=slope)
    ground = fit_ground(points, (20.0, 5.0))
    assert ground.z_m(20.0, 5.0) == pytest.approx(-1.9 + 20 * slope, abs=0.05)
    assert ground.z_m(23.0, 5.0) - ground.z_m(20.0, 5.0) == pytest.approx(3 * slope, abs=0.03)
    standing = points_above(points[np.hypot(*(points[:, :2] - [20.0, 5.0]).T) < 6], ground)
    assert (np.abs(standing[:, :2] - [20.0, 5.0]) < 2.6).all()  # the car's points alone


def test_the_ground_is_looked_for_farther_away_where_it_is_thin(rng: np.random.Generator) -> None:
    far = road(rng, count=40)
    assert fit_ground(far, (60.0, 0.0)).z_m(60.0, 0.0) == pytest.approx(-1.9, abs=0.1)
    assert fit_ground(np.zeros((0, 3)), (60.0, 0.0)).cells == 0


def test_a_wall_of_lowest_points_does_not_lift_the_ground(rng: np.random.Generator) -> None:
    wall = np.column_stack([rng.uniform(-15, 15, 4000), np.full(4000, 6.0), rng.uniform(-1.0, 3.0, 4000)])
    ground = fit_ground(np.concatenate([road(rng), wall]), (0.0, 0.0))
    assert ground.z_m(0.0, 0.0) == pytest.approx(-1.9, abs=0.05)


def far_scene(rng: np.random.Generator, slope: float) -> np.ndarray:
    """A road seen up to 45 m, and beyond it only what stands on it, from 0.4 m up."""
    at = np.column_stack([rng.uniform(3, 45, 4000), rng.uniform(-15, 15, 4000)])
    beyond = np.column_stack([rng.uniform(40, 115, 600), rng.uniform(-15, 15, 600)])
    height = np.append(rng.normal(0, 0.02, len(at)), rng.uniform(0.4, 2.5, len(beyond)))
    points = np.concatenate([at, beyond])
    return np.column_stack([points, -1.8 + slope * points[:, 0] + height])


@pytest.mark.parametrize("slope", [-0.015, 0.0, 0.01])
def test_far_away_the_ground_lies_below_all_that_is_seen(rng: np.random.Generator, slope: float) -> None:
    points, place = far_scene(rng, slope), (80.0, 3.0)
    truth_m = -1.8 + 80 * slope
    assert ground_ahead(points, place).z_m(*place) == pytest.approx(truth_m, abs=0.3)
    assert fit_ground(points, place).z_m(*place) > truth_m + 0.4  # all that is near by stands above it
    box = fit_radar_peak(points, place, replace(prior_of("Sedan"), lane_rad=0.0)).box
    assert box[2] - box[5] / 2 == pytest.approx(truth_m, abs=0.3)
    aside = ground_ahead(points @ np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]) + [5.0, 0, 0], (2.0, 80.0), (5.0, 0.0))
    assert aside.z_m(2.0, 80.0) == pytest.approx(ground_ahead(points, place).z_m(*place), abs=1e-6)


def test_near_by_and_without_points_the_ground_is_the_one_beside(rng: np.random.Generator) -> None:
    points = scene(rng, (20.0, 5.0), 0.4)
    assert ground_ahead(points, (20.0, 5.0)) == fit_ground(points, (20.0, 5.0))
    assert ground_ahead(np.zeros((0, 3)), (80.0, 0.0)).cells == 0
    assert ground_ahead(np.full((5, 3), np.nan), (80.0, 0.0)).cells == 0


def test_only_what_hangs_together_is_taken(rng: np.random.Generator) -> None:
    near = rng.uniform(-0.5, 0.5, (200, 3))
    chosen = cluster_at(np.concatenate([near, np.add(near, [4.0, 0.0, 0.0])]), (0.1, 0.1), 0.5)
    assert chosen[:200].all()
    assert not chosen[200:].any()
    assert not cluster_at(np.zeros((0, 3)), (0.0, 0.0), 1.0).any()
    assert link_radius_m(0.0, small=False) == 0.45
    assert link_radius_m(1000.0, small=False) == 1.6
    assert link_radius_m(50.0, small=True) == pytest.approx(0.45)


@pytest.mark.parametrize("count", [12, 400])
@pytest.mark.parametrize("yaw_deg", [0.0, 20.0, 47.0, 88.0])
def test_the_l_shape_gives_the_yaw_of_two_sides(rng: np.random.Generator, count: int, yaw_deg: float) -> None:
    yaw = np.deg2rad(yaw_deg)
    u = np.column_stack([np.linspace(-2.3, 2.3, count), np.full(count, -0.95)])
    v = np.column_stack([np.full(count // 2, -2.3), np.linspace(-0.95, 0.95, count // 2)])
    turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    xy = np.concatenate([u, v]) @ turn + [30.0, 4.0]
    found, criterion = best_yaw(xy)
    assert criterion == ("closeness" if len(xy) < 30 else "variance")
    assert abs(np.mod(found - yaw + np.pi / 4, np.pi / 2) - np.pi / 4) < np.deg2rad(2)
    assert refine_yaw(xy, float(yaw + 0.05), np.deg2rad(np.arange(-4, 4.5, 0.5))) == pytest.approx(yaw, abs=0.018)


def test_closeness_is_the_papers_sum() -> None:
    xy = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 0.5]])
    # distances to the nearer side: 0, 0, 0 and min(1, 0.5): 1/0.05 thrice and 1/0.5
    assert scores(xy, np.array([0.0]), "closeness")[0] == pytest.approx(3 / 0.05 + 1 / 0.5)


def test_variance_is_that_of_the_points_of_either_side() -> None:
    xy = np.array([[0.0, 0.1], [0.2, 2.0], [0.1, 1.0], [3.0, 0.0], [2.0, 0.3]])
    to_x = np.array([0.0, 0.2, 0.1, 0.0, 1.0])
    to_y = np.array([0.1, 0.0, 1.0, 0.0, 0.3])
    nearer = to_x < to_y
    assert scores(xy, np.array([0.0]), "variance")[0] == pytest.approx(-to_x[nearer].var() - to_y[~nearer].var())


def test_a_box_grows_away_from_the_sensor() -> None:
    rear = np.column_stack([np.full(5, 10.0), np.linspace(-0.9, 0.9, 5)])
    prior = Prior(size_m=(4.0, 2.0, 1.5))
    assert footprint(rear, 0.0, prior) == pytest.approx([12.0, 0.0, 4.0, 2.0, 0.0])
    assert footprint(rear * [-1, 1], 0.0, prior)[0] == pytest.approx(-12.0)
    assert footprint(rear, 0.0, Prior(size_m=(4.0, 2.0, 1.5), anchored=False))[0] == pytest.approx(10.0)
    assert footprint(rear, 0.0, Prior(size_m=(4.0, 1.0, 1.5)))[3] == pytest.approx(1.8)  # what was measured
    assert footprint(rear, 0.0, Prior(size_m=(4.0, 1.0, 1.5), fixed_size=True))[3] == 1.0
    behind = Prior(size_m=(4.0, 2.0, 1.5), ego_m=(30.0, 0.0))  # the sensor looks from the other side
    assert footprint(rear, 0.0, behind)[0] == pytest.approx(8.0)


def test_the_length_lies_where_it_fits() -> None:
    side = np.column_stack([np.full(9, 10.0), np.linspace(-2.2, 2.2, 9)])
    prior = Prior(size_m=(4.5, 1.9, 1.5))
    assert along_length(side, 0.0, prior) == pytest.approx(np.pi / 2)
    assert along_length(side[:, ::-1], 0.0, prior) == 0.0
    short = side * [1, 0.3]  # fits both ways: the longer side
    assert along_length(short, 0.0, prior) == pytest.approx(np.pi / 2)


def test_the_search_puts_the_box_on_its_points_wherever_it_was_pressed() -> None:
    points = sides((20.0, 4.0), 0.3, CAR, step_m=0.2, base_m=0.0)
    beside = np.add(points, [0.0, 4.5, 0.0])  # a second car in the next lane
    xy = np.concatenate([points, beside])[:, :2]
    prior = Prior(size_m=CAR)
    for press in ((18.5, 3.2), (20.0, 4.0), (21.0, 3.7)):
        boxes, score = search(xy, press, np.array([0.3, 0.3 + np.pi / 2]), prior)
        assert np.hypot(*(boxes[0, :2] - [20.0, 4.0])) < 0.25
        assert score[0] > score[1]
    held = search(xy, (20.6, 4.0), np.array([0.3]), prior, reach_m=0.2)[0][0]
    assert np.hypot(*(held[:2] - [20.6, 4.0])) < 0.4


def test_presets_and_priors() -> None:
    assert not VEHICLE_KINDS.keys() & SMALL_KINDS.keys()
    assert prior_of("box truck").size_m == (7.5, 2.4, 3.2)
    assert prior_of("Bicycle").anchored is False
    assert prior_of("hovercraft").size_m == VEHICLE_KINDS["vehicle"]
    assert prior_of("Pedestrian", size_m=(1.0, 1.0, 1.0)).size_m == (1.0, 1.0, 1.0)
    with pytest.raises(ValueError, match="three positive lengths"):
        Prior(size_m=(1.0, 0.0, 1.0))
