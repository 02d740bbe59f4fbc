"""What rays that went past an object say of its ends: its length where both are seen, its place where one is hidden."""

from dataclasses import replace

import numpy as np
import pytest
from fitting_scenes import CAR, road, seen_past, sides

from farfield.annotation.fitting import BoxFit, fit_drag, prior_of
from farfield.annotation.fitting.ends import ends_of
from farfield.annotation.fitting.ground import fit_ground, points_above

LONG = (5.6, 1.9, 1.5)
PRIOR = prior_of("Sedan", size_m=CAR)
KNOWN = replace(PRIOR, ego_z_m=0.0)  # where rays begin
BASE = -1.9


def looked(rng: np.random.Generator, *boxes: tuple[float, ...]) -> np.ndarray:
    """Objects on a road, each hiding what is behind it."""
    clouds = [road(rng, count=200_000)]
    clouds += [sides(box[:2], box[6], box[3:6], step_m=0.1, base_m=BASE) for box in boxes]
    for number, box in enumerate(boxes):
        clouds = [cloud if place == number + 1 else seen_past(cloud, box) for place, cloud in enumerate(clouds)]
    return np.concatenate(clouds).astype(np.float32)


def standing(x: float, y: float, size: tuple[float, float, float], yaw: float) -> tuple[float, ...]:
    return (x, y, BASE + size[2] / 2, *size, yaw)


def dragged(points: np.ndarray, box: tuple[float, ...], prior=KNOWN) -> BoxFit:
    yaw = box[6] + np.deg2rad(2.0)
    return fit_drag(points, box[:2], np.add(box[:2], 3 * np.array([np.cos(yaw), np.sin(yaw)])), prior)


@pytest.mark.parametrize("length", [3.7, 4.2, 5.6])
@pytest.mark.parametrize("yaw_deg", [-15.0, 20.0, 180.0])
def test_the_length_is_the_objects_where_both_ends_are_seen(
    rng: np.random.Generator, length: float, yaw_deg: float
) -> None:
    car = standing(3.0, 12.0, (length, 1.9, 1.5), np.deg2rad(yaw_deg))
    found = dragged(looked(rng, car), car).box
    assert found[3] == pytest.approx(length, abs=0.2)
    assert np.hypot(found[0] - car[0], found[1] - car[1]) < 0.2


def test_rays_are_not_followed_where_nobody_knows_where_they_begin(rng: np.random.Generator) -> None:
    car = standing(3.0, 12.0, (3.7, 1.9, 1.5), 0.3)
    found = dragged(looked(rng, car), car, PRIOR).box
    assert found[3] == pytest.approx(CAR[0])
    assert np.hypot(found[0] - car[0], found[1] - car[1]) > 0.3


def test_an_end_behind_another_object_is_not_taken_for_the_end(rng: np.random.Generator) -> None:
    """The car's front, which looks at the sensor, stands behind a thing: the box goes on behind it."""
    car, post = standing(8.0, 12.0, CAR, np.pi), standing(2.7, 5.5, (1.2, 0.5, 3.5), 0.0)
    points = looked(rng, car, post)
    own = points[(np.abs(points[:, 1] - car[1]) < 1.2) & (np.abs(points[:, 0] - car[0]) < 2.5) & (points[:, 2] > -1.7)]
    assert own[:, 0].min() > car[0] - CAR[0] / 2 + 0.6  # its front is hidden
    found = dragged(points, car).box
    assert np.hypot(found[0] - car[0], found[1] - car[1]) < 0.35
    assert abs(dragged(points, car, PRIOR).box[0] - car[0]) > 0.55


def test_a_car_seen_from_behind_keeps_its_rear_and_the_usual_length(rng: np.random.Generator) -> None:
    car = standing(20.0, 0.0, LONG, 0.0)
    found = dragged(looked(rng, car), car).box
    assert found[3] == pytest.approx(CAR[0], abs=0.1)
    assert found[0] - found[3] / 2 == pytest.approx(20.0 - LONG[0] / 2, abs=0.08)
    assert found[1] == pytest.approx(0.0, abs=0.1)  # half its length times what is left of the drag's error


def test_a_locked_size_stays_and_stands_between_its_ends(rng: np.random.Generator) -> None:
    car = standing(3.0, 12.0, CAR, 0.3)
    found = dragged(looked(rng, car), car, replace(KNOWN, size_m=CAR, fixed_size=True)).box
    assert found[3:5] == CAR[:2]
    assert np.hypot(found[0] - car[0], found[1] - car[1]) < 0.1


def test_a_press_beside_a_person_finds_it(rng: np.random.Generator) -> None:
    person = standing(15.0, 3.0, (0.6, 0.6, 1.7), 0.0)
    points = looked(rng, person)
    found = fit_drag(points, (14.1, 3.1), (15.6, 3.1), replace(prior_of("Pedestrian"), ego_z_m=0.0))
    assert found.points > 20
    assert np.hypot(found.box[0] - 14.8, found.box[1] - 3.0) < 0.25
    far = fit_drag(points, (12.0, 3.1), (13.5, 3.1), prior_of("Pedestrian"))
    assert far.points == 0  # a press that is farther off stays where it was made
    assert far.box[:2] == (12.0, 3.1)


def test_ends_that_were_hit_and_rays_past_them(rng: np.random.Generator) -> None:
    car = standing(3.0, 12.0, CAR, 0.0)
    points = looked(rng, car)
    ground = fit_ground(points, car[:2])
    high = points_above(points, ground)
    held = high[(np.abs(high[:, :2] - car[:2]) < [2.5, 1.2]).all(axis=1)]
    ends = ends_of(points, held, np.array([*car[:2], *CAR[:2], 0.0]), ground, KNOWN)
    assert ends.hit_m == pytest.approx(np.array([[0.7, 5.3], [11.05, 12.95]]), abs=0.1)
    assert (ends.gap_m[0] < 0.5).all()  # the rear, and the front by rays along the side
    turned = ends_of(-points * [1, 1, -1], -held * [1, 1, -1], np.array([-3.0, -12.0, *CAR[:2], 0.0]), ground, KNOWN)
    assert turned.hit_m == pytest.approx(-ends.hit_m[:, ::-1])
    through = np.concatenate(
        [points, rng.uniform([3.0, 13.4, -1.6], [4.0, 14.0, -1.4], (3000, 3))]
    )  # as of two sensors
    assert np.isinf(ends_of(through, held, np.array([*car[:2], *CAR[:2], 0.0]), ground, KNOWN).gap_m[0]).all()
