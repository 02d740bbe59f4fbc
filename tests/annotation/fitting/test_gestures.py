"""Boxes from gestures on a road with one car, whose box is known."""

from dataclasses import replace

import numpy as np
import pytest
from fitting_scenes import CAR, road, scene, sides
from hypothesis import given
from hypothesis import strategies as st

from farfield.annotation.fitting import (
    BoxFit,
    Prior,
    drop_to_ground,
    fit_click,
    fit_drag,
    fit_rectangle,
    prior_of,
    refit,
)
from farfield.annotation.fitting.prior import boxes_of
from farfield.geometry.iou import paired_iou

PLACES = ((12.0, 3.0), (25.0, -8.0), (-18.0, 6.0), (45.0, 10.0))
PRIOR = prior_of("Sedan", size_m=CAR)


def overlap(
    found: BoxFit, centre: tuple[float, float], yaw_rad: float, size: tuple[float, float, float] = CAR
) -> float:
    truth = (*centre, -1.9 + size[2] / 2, *size, yaw_rad)
    return float(paired_iou(boxes_of(found.box), boxes_of(truth), kind="bev")[0])


def turned_by(yaw_rad: float, other_rad: float) -> float:
    return abs(float(np.mod(yaw_rad - other_rad + np.pi, 2 * np.pi) - np.pi))


@pytest.mark.parametrize("centre", PLACES)
@pytest.mark.parametrize("yaw_deg", [30.0, -100.0, 175.0])
def test_a_drag_finds_the_car_and_its_heading(
    rng: np.random.Generator, centre: tuple[float, float], yaw_deg: float
) -> None:
    yaw = np.deg2rad(yaw_deg)
    points = scene(rng, centre, yaw)
    drawn = yaw + np.deg2rad(4.0)
    start = np.array(centre) + rng.uniform(-0.4, 0.4, 2)
    found = fit_drag(points, start, start + 3 * np.array([np.cos(drawn), np.sin(drawn)]), PRIOR)
    assert overlap(found, centre, yaw) > 0.85
    assert turned_by(found.box[6], yaw) < np.deg2rad(2.0)
    assert found.heading == "drag"
    assert found.box[2] - found.box[5] / 2 == pytest.approx(-1.9, abs=0.05)
    assert found.box[5] == pytest.approx(CAR[2], abs=0.1)
    assert found.points > 100
    assert len(found.candidates) == 2


@pytest.mark.parametrize("centre", PLACES)
def test_a_click_finds_the_car_and_asks_for_the_sign(rng: np.random.Generator, centre: tuple[float, float]) -> None:
    yaw = np.deg2rad(30.0)
    points = scene(rng, centre, yaw)
    corner = points[-1, :2].tolist()
    found = fit_click(points, corner, PRIOR)
    assert overlap(found, centre, yaw) > 0.8
    assert found.heading == "ask"
    assert found.criterion == "faces"
    known = fit_click(points, corner, replace(PRIOR, lane_rad=float(yaw + np.pi + 0.3)))
    assert known.heading == "lane"
    assert turned_by(known.box[6], yaw + np.pi) < np.deg2rad(5.0)
    assert len(known.candidates) == 3
    tracked = fit_click(points, corner, replace(PRIOR, yaw_rad=float(yaw + 0.05)))
    assert (tracked.heading, tracked.criterion) == ("track", "track")
    assert turned_by(tracked.box[6], yaw) < np.deg2rad(2.0)


def test_few_points_far_away_follow_the_lane(rng: np.random.Generator) -> None:
    points = scene(rng, (55.0, 3.0), 0.05, step_m=0.8)
    found = fit_click(points, (52.7, 3.0), replace(PRIOR, lane_rad=0.05))
    assert (found.criterion, found.heading) == ("lane", "lane")
    assert overlap(found, (55.0, 3.0), 0.05) > 0.7
    assert len(found.candidates) == 3  # the one of another heading first, for a car that crosses


@pytest.mark.parametrize("off_deg", [-10.0, 10.0])
def test_a_box_that_stands_ten_degrees_off_is_turned(rng: np.random.Generator, off_deg: float) -> None:
    for centre in PLACES:
        points = scene(rng, centre, 0.5)
        fitted = refit(points, [*centre, -1.15, *CAR, 0.5 + np.deg2rad(off_deg)], PRIOR)
        assert turned_by(fitted.box[6], 0.5) < np.deg2rad(2.0), centre
        assert overlap(fitted, centre, 0.5) > 0.85


def test_a_click_in_a_row_of_parked_cars_takes_one_of_them(rng: np.random.Generator) -> None:
    """Side by side, their fronts in one line: a box across two of them would hold as many points."""
    centres = [(12.0, across) for across in (-4.8, -2.4, 0.0, 2.4, 4.8)]
    rows = [sides(centre, np.pi, CAR, step_m=0.15, base_m=-1.9) for centre in centres]
    points = np.concatenate([road(rng), *rows]).astype(np.float32)
    fitted = fit_click(points, (12.0 - CAR[0] / 2, 2.1), replace(PRIOR, lane_rad=np.pi / 2))
    assert overlap(fitted, centres[3], np.pi) > 0.8


def test_points_that_leave_the_heading_open_are_said_and_the_neighbours_asked(rng: np.random.Generator) -> None:
    points = scene(rng, (55.0, 3.0), 0.6, step_m=0.9)
    fitted = fit_click(points, (53.5, 2.2), replace(PRIOR, lane_rad=0.6, roads_rad=(0.0, 0.6, 0.6, 0.6)))
    assert fitted.criterion == "lane"
    assert "drag along the object" in fitted.note
    assert turned_by(fitted.box[6], 0.6) < np.deg2rad(10.0)


def test_whole_bodies_grow_away_from_the_sensor_and_visible_parts_do_not(rng: np.random.Generator) -> None:
    points = scene(rng, (20.0, 0.0), 0.0)  # only its rear is seen
    whole = fit_drag(points, (18.0, 0.0), (21.0, 0.0), PRIOR)
    assert whole.box[3] == pytest.approx(CAR[0])
    assert whole.box[0] - whole.box[3] / 2 == pytest.approx(20.0 - CAR[0] / 2, abs=0.05)
    part = fit_drag(points, (18.0, 0.0), (21.0, 0.0), replace(PRIOR, extent="visible part"))
    assert part.box[3] < 0.2
    assert part.box[4] == pytest.approx(CAR[1], abs=0.15)


def test_people_lie_about_their_points(rng: np.random.Generator) -> None:
    size = (0.6, 0.6, 1.7)
    points = scene(rng, (15.0, 0.0), 0.0, size, step_m=0.1)
    found = fit_drag(points, (14.7, 0.0), (16.0, 0.0), prior_of("Pedestrian"))
    assert found.box[0] == pytest.approx(14.7, abs=0.05)  # the middle of the side that is seen
    assert found.box[3] == pytest.approx(0.76)


def test_a_fixed_size_stays(rng: np.random.Generator) -> None:
    points = scene(rng, (20.0, 4.0), 0.4)
    size = (5.1, 2.0, 1.7)
    track = Prior(size_m=size, fixed_size=True, yaw_rad=0.4)
    assert fit_click(points, (18.5, 3.0), track).box[3:6] == size
    drawn = [20.3, 4.2, -1.0, *size, 0.45]
    kept = refit(points, drawn, PRIOR, keep_size=True)
    assert kept.box[3:6] == size
    assert turned_by(kept.box[6], 0.4) < np.deg2rad(2.0)


def test_a_drawn_box_is_snapped(rng: np.random.Generator) -> None:
    points = scene(rng, (30.0, -6.0), 0.5)
    drawn = [30.35, -5.8, -0.5, 4.0, 2.2, 1.4, 0.58]
    before = float(paired_iou(boxes_of(drawn), boxes_of((30.0, -6.0, -1.15, *CAR, 0.5)), kind="bev")[0])
    found = refit(points, drawn, PRIOR)
    assert overlap(found, (30.0, -6.0), 0.5) > max(before, 0.85)
    cos, sin = np.cos(0.58), np.sin(0.58)
    corners = [(30.35 + a * cos - b * sin, -5.8 + a * sin + b * cos) for a, b in ((2, 1), (-2, 1), (-2, -1), (2, -1))]
    rectangle = fit_rectangle(points, corners, PRIOR)
    assert overlap(rectangle, (30.0, -6.0), 0.5) > 0.85
    assert rectangle.heading == "ask"


def test_under_eight_points_only_size_and_height_are_set(rng: np.random.Generator) -> None:
    points = np.concatenate([road(rng), [[40.0, 2.0, -1.0], [40.0, 1.8, -0.9]]])
    found = refit(points, [41.0, 2.0, 3.0, 3.0, 1.0, 1.0, 0.3], PRIOR)
    assert found.box[:2] == (41.0, 2.0)
    assert found.box[6] == pytest.approx(0.3)
    assert found.box[3:6] == CAR
    assert found.box[2] - found.box[5] / 2 == pytest.approx(-1.9, abs=0.05)
    assert "2 points" in found.note


def test_dropped_boxes_stand_on_a_sloping_road(rng: np.random.Generator) -> None:
    points = scene(rng, (30.0, 5.0), 0.2, slope=0.03)
    found = drop_to_ground(points, [30.0, 5.0, 7.0, *CAR, 0.2])
    assert found.box[2] - CAR[2] / 2 == pytest.approx(-1.9 + 0.9, abs=0.05)
    assert found.box[:2] == (30.0, 5.0)
    assert found.points > 50


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.full((5, 3), np.nan), np.array([[300.0, 0.0, 0.0]])])
def test_without_points_the_box_stands_at_the_gesture(points: np.ndarray) -> None:
    found = fit_drag(points, (20.0, 1.0), (23.0, 1.0), PRIOR)
    assert found.box[:2] == (20.0, 1.0)
    assert found.box[3:6] == CAR
    assert found.points == 0
    assert found.note
    assert fit_click(points, (20.0, 1.0), PRIOR).box[3:6] == CAR
    assert refit(points, [20.0, 1.0, 0.0, *CAR, 0.0], PRIOR).box[:2] == (20.0, 1.0)
    assert drop_to_ground(points, [20.0, 1.0, 4.0, *CAR, 0.0]).box[2] == 4.0


def test_a_drag_of_no_length_is_a_click(rng: np.random.Generator) -> None:
    points = scene(rng, (20.0, 4.0), 0.4)
    dragged = fit_drag(points, (18.5, 3.0), (18.6, 3.0), PRIOR)
    clicked = fit_click(points, (18.5, 3.0), PRIOR)
    assert replace(dragged, ms=0.0) == replace(clicked, ms=0.0)


@given(
    x=st.floats(-60, 60),
    y=st.floats(-60, 60),
    turn=st.floats(-4, 4),
    shift=st.floats(-300, 300),
)
def test_moving_and_turning_the_world_moves_the_box(x: float, y: float, turn: float, shift: float) -> None:
    """Also where the sensor is elsewhere: only what the prior says of its place counts."""
    rng = np.random.default_rng(3)
    local = np.concatenate([rng.uniform(-20, 20, (400, 3)) * [1, 1, 0] + [0, 0, -2.0], _wall(rng)])
    ego = (-20.0, -5.0)
    plain = fit_drag(local, (0.0, 0.0), (3.0, 0.0), replace(PRIOR, ego_m=ego))
    moved = fit_drag(np.add(local, [x, y, shift]), (x, y), (x + 3.0, y), replace(PRIOR, ego_m=(ego[0] + x, ego[1] + y)))
    assert np.allclose(np.array(moved.box[:3]) - [x, y, shift], plain.box[:3], atol=0.3)
    assert moved.box[3:5] == pytest.approx(plain.box[3:5], abs=1e-6)
    assert -np.pi <= fit_drag(local, (0.0, 0.0), (3 * np.cos(turn), 3 * np.sin(turn)), PRIOR).box[6] < np.pi


def _wall(rng: np.random.Generator) -> np.ndarray:
    return np.column_stack([np.full(60, -2.3), rng.uniform(-0.95, 0.95, 60), rng.uniform(-1.6, -0.6, 60)])
