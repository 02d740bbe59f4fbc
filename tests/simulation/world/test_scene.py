"""All eight roads: nobody touches, everybody stands on the ground, walkers walk, lines stay within their bounds."""

from collections import Counter
from collections.abc import Iterator

import numpy as np
import pytest

from farfield.errors import ConfigError
from farfield.frame import Boxes
from farfield.geometry.iou import pairwise_iou
from farfield.simulation.bodies.people import PHASES
from farfield.simulation.world.roads.campus import CAMPUS_BENDS, PARKING_LOT_BENDS
from farfield.simulation.world.roads.country import GRADE, HIGHWAY_BENDS
from farfield.simulation.world.roads.town import ALLEY_BENDS, SUBURBAN_BENDS, URBAN_BENDS
from farfield.simulation.world.scene import ROADS, WorldScene

DURATION_S = 9.0
BOUNDS = {  # curvature, grade
    "urban": (1 / 150, 0.02),
    "highway": (1 / 600, 0.03),
    "shoulder": (1 / 600, 0.03),
    "suburban": (1 / 150, 0.04),
    "alleyway": (1 / 60, 0.04),
    "university": (1 / 60, 0.04),
    "mountain": (1 / 58, 0.06),
    "parking_lot": (1 / 600, 0.02),
}


_SCENES: dict[tuple[str, int], WorldScene] = {}


def _scene(road: str, seed: int) -> WorldScene:
    if (road, seed) not in _SCENES:
        _SCENES[road, seed] = WorldScene(road, np.random.SeedSequence(seed), duration_s=DURATION_S)
    return _SCENES[road, seed]


@pytest.fixture(autouse=True)
def _forget_tracers() -> Iterator[None]:
    yield
    for scene in _SCENES.values():
        scene._tracers.clear()


def test_the_roads_are_those_of_kradar() -> None:
    assert set(ROADS) == set(BOUNDS)
    with pytest.raises(ConfigError, match="road: expected one of urban"):
        WorldScene("moon", np.random.SeedSequence(0), duration_s=1.0)
    with pytest.raises(ConfigError, match="sizes: expected one of us"):
        WorldScene("urban", np.random.SeedSequence(0), duration_s=1.0, sizes="mars")


@pytest.mark.parametrize("road", ROADS)
@pytest.mark.parametrize("seed", [1, 2])
def test_no_two_bodies_overlap_at_any_time(road: str, seed: int) -> None:
    """By exact IoU over the whole scene, the ego vehicle included."""
    scene = _scene(road, seed)
    size = np.array([actor.size_m for actor in scene.actors])
    assert len(size) > 15
    for time_s in np.linspace(0, DURATION_S, 6):
        position, yaw = scene.motion.at(float(time_s))
        boxes = Boxes(centre_m=position, size_m=size, yaw_rad=yaw)
        iou = pairwise_iou(boxes, boxes, kind="bev")
        np.fill_diagonal(iou, 0.0)
        assert iou.max() < 1e-6


@pytest.mark.parametrize("road", ROADS)
def test_wheels_stand_on_the_ground_ahead_and_behind(road: str) -> None:
    """A ray cast straight down from 0.5 m above each wheel finds the ground within 0.1 m of the wheel's contact."""
    scene = _scene(road, 1)
    window = scene.window(4.0, behind_m=240.0)
    ground = window.bodies[0].tracer
    scene._tracers.clear()
    poses = [(window.world_T_ego_now, np.array([4.8, 1.9, 1.6]))]
    poses += [
        (body.world_T_body[0], np.array(window.actors[body.actor].size_m))
        for body in window.bodies[1:]
        if window.actors[body.actor].label in ("vehicle", "large_vehicle")
    ]
    feet = np.concatenate(
        [
            (np.array([[x, y, 0.0] for x in (-0.3, 0.3) for y in (-0.4, 0.4)]) * size) @ pose[:3, :3].T + pose[:3, 3]
            for pose, size in poses
        ]
    )
    hits = ground.cast_from(feet + np.array([0, 0, 0.5]), np.tile([0.0, 0.0, -1.0], (len(feet), 1)))
    assert np.isfinite(hits.range_m).all()
    off = np.abs(hits.range_m - 0.5)
    assert off[:4].max() < 0.1
    assert np.quantile(off, 0.99) < 0.2
    assert np.mean(off < 0.1) > 0.95


@pytest.mark.parametrize("road", ROADS)
def test_curvature_and_grade_stay_within_bounds(road: str) -> None:
    """Measured on the line itself: change of heading and of height over 4 m."""
    greatest = 0.0
    for seed in (1, 2):
        line = _scene(road, seed).layout.land.road
        s = np.arange(line.first_s_m + 4, line.last_s_m - 4, 4.0)
        points = line.point_m(s, 0.0)
        step = np.diff(points, axis=0)
        heading = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
        curvature, grade = np.abs(np.diff(heading)) / 4.0, np.abs(step[:, 2]) / 4.0
        greatest = max(greatest, float(curvature.max()))
        assert curvature.max() < BOUNDS[road][0] * 1.01
        assert grade.max() < BOUNDS[road][1]
        np.testing.assert_allclose(np.hypot(step[:, 0], step[:, 1]), 4.0, rtol=2e-3)
    if road not in ("parking_lot",):
        assert greatest > 0.3 * BOUNDS[road][0]  # there are bends


def test_the_bounds_of_the_report_hold_for_the_modules() -> None:
    assert HIGHWAY_BENDS.curvature_per_m < 1 / 600
    assert SUBURBAN_BENDS.curvature_per_m < 1 / 150
    assert max(bends.curvature_per_m for bends in (URBAN_BENDS, CAMPUS_BENDS, ALLEY_BENDS, PARKING_LOT_BENDS)) < 1 / 40
    assert GRADE == 0.06


@pytest.mark.parametrize("road", ROADS)
def test_the_world_reaches_around_the_ego_vehicle(road: str) -> None:
    """Rays a little below the horizon hit something in every direction, and traffic is behind as well."""
    scene = _scene(road, 2)
    window = scene.window(3.0, behind_m=250.0)
    here = window.world_T_ego_now
    angle = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    down = np.radians(2.5 if road != "mountain" else 8.0)
    flat = np.stack([np.cos(angle), np.sin(angle), np.full(360, -np.tan(down))], axis=1)
    rays = flat / np.linalg.norm(flat, axis=1, keepdims=True)
    hits = window.bodies[0].tracer.cast(here[:3, 3] + here[:3, 2] * 2.2, rays)
    assert np.mean(np.isfinite(hits.range_m)) > 0.97
    places = window.bottom_m - here[:3, 3]
    behind = (places @ here[:3, 0] < -10) & (np.linalg.norm(places, axis=1) < 260)
    assert behind.any()


@pytest.mark.parametrize("road", ["highway", "urban", "suburban", "mountain"])
def test_vehicles_in_lanes_stay_on_the_carriageway(road: str) -> None:
    scene = _scene(road, 2)
    population, line = scene.layout.population, scene.layout.land.road
    s = np.arange(line.first_s_m, line.last_s_m, 1.0)
    place = line.point_m(s, 0.0)[:, :2]
    land = scene.layout.land
    paved = land.d_m[:-1][land.material == 0].min(), land.d_m[1:][land.material == 0].max()
    driven = [row for row, actor in enumerate(scene.actors) if not population._loose[actor.track_id]]
    assert len(driven) > 4
    for row in driven[:60]:
        for step in (0, 45, 90):
            position, yaw = scene.motion.position_m[row, step, :2], scene.motion.yaw_rad[row, step]
            length, width, _ = scene.actors[row].size_m
            nearest = int(np.argmin(np.hypot(*(place - position).T)))
            heading = float(line.heading_rad(s[nearest : nearest + 1])[0])
            left = np.array([-np.sin(heading), np.cos(heading)])
            d = float((position - place[nearest]) @ left)
            half = abs(np.cos(yaw - heading)) * width / 2 + abs(np.sin(yaw - heading)) * length / 2
            assert paved[0] - 0.05 < d - half
            assert d + half < paved[1] + 0.05


def test_the_same_seed_gives_the_same_world_whoever_looks() -> None:
    first, second = (WorldScene("urban", np.random.SeedSequence(9), duration_s=8.0) for _ in range(2))
    for time_s in (0.0, 2.0, 5.0):
        first.window(time_s, half_span_s=0.06, behind_m=240.0)
    ones, others = first.window(6.0, behind_m=30.0), second.window(6.0, behind_m=30.0)
    assert [a.track_id for a in ones.actors] == [a.track_id for a in others.actors]
    np.testing.assert_array_equal(ones.bottom_m, others.bottom_m)
    np.testing.assert_array_equal(ones.bodies[0].tracer.mesh.vertices_m, others.bodies[0].tracer.mesh.vertices_m)
    other = WorldScene("urban", np.random.SeedSequence(10), duration_s=8.0)
    assert len(other.actors) != len(first.actors) or not np.array_equal(
        other.motion.position_m[1], first.motion.position_m[1]
    )


def test_tracks_persist_and_move_by_their_velocity() -> None:
    scene = _scene("highway", 2)
    first, second = scene.window(2.0, behind_m=240.0), scene.window(2.1, behind_m=240.0)
    before = {a.track_id: row for row, a in enumerate(first.actors)}
    shared = [(before[a.track_id], row) for row, a in enumerate(second.actors) if a.track_id in before]
    assert len(shared) > 0.9 * len(first.actors)
    rows, others = np.array(shared).T
    moved = (second.bottom_m[others] - first.bottom_m[rows]) / 0.1
    np.testing.assert_allclose(moved, first.velocity_m_s[rows], atol=0.5)
    assert np.linalg.norm(moved, axis=1).max() > 2
    assert len({actor.track_id for actor in scene.actors}) == len(scene.actors)
    assert scene.actors[0].track_id == 0


def test_every_class_occurs_somewhere() -> None:
    seen = Counter(actor.label for road in ROADS for seed in (1, 2) for actor in _scene(road, seed).actors)
    assert set(seen) == {
        "vehicle",
        "large_vehicle",
        "pedestrian",
        "bicycle",
        "animal",
        "wheeled_pedestrian",
        "motorcycle",
        "trailer",
        "unknown",
    }
    assert seen["vehicle"] == max(seen.values())


def test_a_prior_changes_the_sizes_of_the_traffic() -> None:
    mean = {
        name: np.mean(
            [
                actor.size_m[0]
                for actor in WorldScene("parking_lot", np.random.SeedSequence(3), duration_s=3.0, sizes=name).actors
                if actor.label == "vehicle"
            ]
        )
        for name in ("us", "kitti", "korea")
    }
    assert mean["us"] == pytest.approx(4.8, abs=0.15)
    assert mean["kitti"] == pytest.approx(3.95, abs=0.2)
    assert mean["korea"] == pytest.approx(4.62, abs=0.15)


def test_the_gait_follows_the_distance_walked() -> None:
    scene = _scene("university", 1)
    walking = standing = 0
    for row, actor in enumerate(scene.actors):
        phases = [scene.gait_phase(row, time_s) for time_s in (3.0, 3.2)]
        way = scene.motion.at(3.2, rows=np.array([row]))[0] - scene.motion.at(3.0, rows=np.array([row]))[0]
        distance = float(np.hypot(way[0, 0], way[0, 1]))
        if phases[0] is None or phases[1] is None:
            standing += actor.label == "pedestrian"
            continue
        walking += 1
        assert (phases[1] - phases[0]) % 1.0 == pytest.approx(distance / actor.cycle_m % 1.0, abs=0.01)
    assert walking > 10
    assert standing > 0


def test_a_walker_takes_sixteen_shapes_and_a_standing_one_a_single() -> None:
    scene = _scene("university", 1)
    walker = next(
        row
        for row, a in enumerate(scene.actors)
        if a.kind == "pedestrian" and scene.motion.travelled_m(row, DURATION_S) > 4.0
    )
    keep = [scene._tracer(walker, float(time_s)) for time_s in np.linspace(0, DURATION_S, 400)]
    assert len({id(tracer) for tracer in keep}) == PHASES
    car = next(row for row, actor in enumerate(scene.actors) if actor.label == "vehicle")
    assert scene._tracer(car, 0.0) is scene._tracer(car, 9.0)
    assert scene.row_of(scene.actors[walker].track_id) == walker
