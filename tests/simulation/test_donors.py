"""Bodies in real sweeps: rays that did not return, what hides and is hidden, places, and real sweeps."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from farfield.datasets import open_dataset
from farfield.frame import Boxes, Cloud
from farfield.geometry.boxes import count_points_in_boxes, inside_box
from farfield.simulation.bodies.actors import Actor
from farfield.simulation.donors import DonorSweep, StandingBody, draw_actor, find_place, missing_rays, paste, rows_of
from farfield.simulation.lidar.model import HDL_64E

pytest.importorskip("embreex")

ELEVATIONS = np.deg2rad(np.linspace(3, -22, 76))
COLUMNS = 1200
SURE = replace(HDL_64E, reference_range_m=1e4, dropout=0.0, range_noise_m=1e-4, weak_noise_m=0.0, glass_return=1.0)
CAR = Actor(0, "sedan", (4.6, 1.85, 1.5), np.random.SeedSequence(4))


def raster() -> tuple[np.ndarray, np.ndarray]:
    """Directions of a turning sensor and the row of each."""
    azimuth = (np.arange(COLUMNS) + 0.5) * 2 * np.pi / COLUMNS - np.pi
    up, around = np.meshgrid(ELEVATIONS, azimuth, indexing="ij")
    directions = np.stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)], axis=-1)
    return directions.reshape(-1, 3), np.repeat(np.arange(len(ELEVATIONS)), COLUMNS)


def street(wall_m: float = 60.0, ground_to_m: float = 45.0) -> tuple[Cloud, np.ndarray]:
    """A road 1.8 m below the sensor, seen to some range, a wall ahead, a high one on the left; and the open rays."""
    directions, row = raster()
    with np.errstate(divide="ignore"):
        to_ground = np.where(directions[:, 2] < 0, -1.8 / directions[:, 2], np.inf)
        to_wall = np.where(directions[:, 0] > 0, wall_m / directions[:, 0], np.inf)
        to_side = np.where(directions[:, 1] > 0, 30 / directions[:, 1], np.inf)
    to_ground[to_ground > ground_to_m] = np.inf
    to_side[to_side > 60] = np.inf
    to_wall[(to_wall > 1e5) | (np.abs(np.minimum(to_wall, 1e6) * directions[:, 2] + 0.3) > 1.5)] = np.inf  # 3 m high
    range_m = np.minimum(np.minimum(to_ground, to_wall), to_side)
    met = np.isfinite(range_m)
    points = directions[met] * range_m[met, None]
    return Cloud(points, np.full(len(points), 0.2), {"ring": row[met]}), directions[~met]


@pytest.mark.parametrize("with_rings", [True, False])
def test_rays_that_did_not_return_are_rebuilt(with_rings: bool) -> None:
    cloud, open_rays = street()
    rebuilt = missing_rays(cloud.points_m.astype(np.float64), cloud.extra["ring"] if with_rings else None)
    nearest = np.array([np.max(rebuilt @ ray) for ray in open_rays[::97]])
    assert np.rad2deg(np.arccos(np.clip(nearest, -1, 1))).max() < 0.2
    assert len(rebuilt) == pytest.approx(len(open_rays), rel=0.05)


def test_rows_show_only_where_there_are_rows(rng: np.random.Generator) -> None:
    cloud, _ = street()
    points = cloud.points_m.astype(np.float64)
    level_m = np.hypot(points[:, 0], points[:, 1])
    rows = rows_of(np.arctan2(points[:, 2], level_m), level_m)
    assert rows is not None
    far = level_m > 15
    assert len(np.unique(rows[far])) == len(np.unique(cloud.extra["ring"][far]))
    assert rows_of(rng.normal(0, 0.1, 5000), np.full(5000, 30.0)) is None


def placed(x_m: float, y_m: float = 0.0, yaw_rad: float = 0.0) -> StandingBody:
    return StandingBody.of(CAR, x_m, y_m, -1.8, yaw_rad)


def test_a_body_gets_the_rays_that_meet_it_and_casts_a_shadow(rng: np.random.Generator) -> None:
    cloud, _ = street()
    sweep, car = DonorSweep.of(cloud), placed(20.0)
    pasted = paste(sweep, [car], SURE, rng)
    own = pasted.points_m[pasted.body == 0]
    assert len(own) == pasted.points_in[0] > 150
    assert inside_box(own, pasted.boxes, 0, margin_m=0.01).all()
    rest = pasted.points_m[pasted.body < 0].astype(np.float64)
    # Behind the car's middle, below its shoulder, nothing of road or wall is left.
    azimuth = np.arctan2(rest[:, 1], rest[:, 0])
    slope = rest[:, 2] / np.hypot(rest[:, 0], rest[:, 1])
    shadow = (np.abs(azimuth) < 0.02) & (slope < -0.055) & (rest[:, 0] > 22.5) & (slope > -0.075)
    assert not shadow.any()
    before = cloud.points_m.astype(np.float64)
    was = (np.abs(np.arctan2(before[:, 1], before[:, 0])) < 0.02) & (before[:, 0] > 22.5)
    was &= (before[:, 2] / before[:, 0] < -0.055) & (before[:, 2] / before[:, 0] > -0.075)
    assert was.any()


def test_number_of_points_is_that_of_the_solid_angle(rng: np.random.Generator) -> None:
    """A car broadside at 20 m: its width over 0.3 degrees by its rows, less what its outline lacks."""
    cloud, _ = street()
    pasted = paste(DonorSweep.of(cloud), [placed(20.0, yaw_rad=np.pi / 2)], SURE, rng)
    front_m = 20 - 1.85 / 2
    wide = 2 * np.arctan(2.3 / front_m) / (2 * np.pi / COLUMNS)
    rows = ((np.arctan(-1.8 / front_m) < ELEVATIONS) & (np.arctan(-0.3 / front_m) > ELEVATIONS)).sum()
    assert 0.6 * wide * rows < pasted.points_in[0] < 1.05 * wide * rows


def test_what_stands_before_hides(rng: np.random.Generator) -> None:
    cloud, _ = street(wall_m=15.0)
    sweep = DonorSweep.of(cloud)
    hidden = paste(sweep, [placed(20.0)], SURE, rng)
    assert hidden.points_in[0] == 0
    np.testing.assert_allclose(hidden.points_m, sweep.points_m, atol=1e-5)
    both = paste(DonorSweep.of(street()[0]), [placed(12.0), placed(19.0)], SURE, rng)
    alone = paste(DonorSweep.of(street()[0]), [placed(19.0)], SURE, rng)
    assert both.points_in[1] < 0.2 * alone.points_in[0]


def test_bodies_stand_out_against_the_sky(rng: np.random.Generator) -> None:
    """Beyond the road's last return at 45 m nothing returned: a car there is seen by rebuilt rays."""
    cloud, _ = street(wall_m=1e6)
    pasted = paste(DonorSweep.of(cloud), [placed(50.0)], SURE, rng)
    assert pasted.points_in[0] > 10
    bare = DonorSweep.of(cloud)
    blind = replace(bare, open_rays=np.zeros((0, 3)))
    assert paste(blind, [placed(50.0)], SURE, rng).points_in[0] == 0


def test_weak_echoes_are_lost(rng: np.random.Generator) -> None:
    sweep = DonorSweep.of(street()[0])
    weak = replace(SURE, reference_range_m=4.0)
    assert (
        paste(sweep, [placed(30.0)], weak, rng).points_in[0]
        < 0.1 * paste(sweep, [placed(30.0)], SURE, rng).points_in[0]
    )


def test_annotated_objects_are_taken_out_and_places_are_free(rng: np.random.Generator) -> None:
    cloud, _ = street()
    car = placed(20.0, 3.0)
    with_car = paste(DonorSweep.of(cloud), [car], SURE, rng).cloud
    emptied = DonorSweep.of(with_car, car.boxes)
    assert count_points_in_boxes(emptied.points_m, car.boxes)[0] == 0
    sweep = DonorSweep.of(with_car)
    for _ in range(10):
        body = find_place(sweep, draw_actor(rng), (10, 30), rng, azimuth_rad=(-0.5, 0.5), taken=[placed(15.0, -4.0)])
        assert body is not None
        x, y, z = body.boxes.centre_m[0]
        assert 10 <= np.hypot(x, y) <= 30
        assert abs(np.arctan2(y, x)) <= 0.5
        assert z - body.boxes.size_m[0, 2] / 2 == pytest.approx(-1.8, abs=0.05)
        assert not inside_box(with_car.points_m, body.boxes, 0, margin_m=0.0)[with_car.points_m[:, 2] > -1.4].any()
    assert find_place(sweep, CAR, (300, 400), rng) is None


def test_no_body_changes_nothing(rng: np.random.Generator) -> None:
    sweep = DonorSweep.of(street()[0])
    pasted = paste(sweep, [], SURE, rng)
    np.testing.assert_allclose(pasted.points_m, sweep.points_m, atol=1e-5)
    assert len(pasted.boxes) == 0


def test_real_sweeps_lend_their_rays(shared_real: Path, rng: np.random.Generator) -> None:
    """A real car's own points against a simulated one's in its place: of the same order."""
    ratios = []
    for frame in open_dataset(shared_real / "kitti_more"):
        boxes = frame.boxes
        assert boxes is not None
        cloud = frame.cloud()
        near = (np.asarray(boxes.label) == "vehicle") & (boxes.range_m > 8) & (boxes.range_m < 35)
        counts = count_points_in_boxes(cloud.points_m, boxes)
        for index in np.flatnonzero(near & (counts > 100)).tolist():
            own = boxes[[index]]
            x, y, z = own.centre_m[0]
            size = (float(own.size_m[0, 0]), float(own.size_m[0, 1]), float(own.size_m[0, 2]))
            body = StandingBody.of(
                Actor(0, "hatch", size, np.random.SeedSequence(1)), x, y, z - size[2] / 2, own.yaw_rad[0]
            )
            pasted = paste(DonorSweep.of(cloud, own), [body], HDL_64E, rng)
            ratios.append(pasted.points_in[0] / counts[index])
    assert len(ratios) > 10
    assert 0.7 < np.median(ratios) < 1.4


def test_boxes_are_those_of_the_bodies() -> None:
    boxes = placed(20.0, 3.0, 0.4).boxes
    assert isinstance(boxes, Boxes)
    np.testing.assert_allclose(boxes.centre_m[0], [20, 3, -1.8 + 0.75])
    np.testing.assert_allclose(boxes.size_m[0], CAR.size_m)
