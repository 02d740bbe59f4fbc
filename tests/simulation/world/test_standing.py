"""Where things of world v3 stand: nothing in anything else, feet on the ground, alleys between closed fronts."""

from functools import cache, partial

import numpy as np
import pytest
from whole import whole_or

from farfield.frame import Boxes
from farfield.geometry.iou import pairwise_iou
from farfield.simulation.bodies.mesh import Mesh
from farfield.simulation.trace import Tracer
from farfield.simulation.world.furnishing import _wires
from farfield.simulation.world.ground import CHUNK_M, chunk_rows
from farfield.simulation.world.layout import RoadLayout
from farfield.simulation.world.roads.street import StreetLand
from farfield.simulation.world.scene import WorldScene
from farfield.simulation.world.taken_ground import low_bounds_m

VEHICLES = ("vehicle", "large_vehicle", "trailer")
LARGE_M = 4.0


@cache
def _scene(road: str, seed: int) -> WorldScene:
    return WorldScene(road, np.random.SeedSequence(seed), duration_s=1.0, world="v3")


def _feet(layout: RoadLayout) -> Boxes:
    """Ground rectangles of the small things that stand beside a road: posts, trunks, furniture."""
    rows = []
    for fixed in layout.placements:
        if not isinstance(fixed.build, partial) or fixed.build.func != layout.land.stand:
            continue
        model, s_m, d_m = fixed.build.args
        low, high = low_bounds_m(model)
        if (high - low).max() < LARGE_M:
            yaw = float(layout.land.road.heading_rad(np.array(s_m))) + fixed.build.keywords["turn_rad"]
            (x, y), (cos, sin) = (low + high) / 2, (np.cos(yaw), np.sin(yaw))
            at = layout.land.road.point_m(np.array(s_m), d_m) + np.array([cos * x - sin * y, sin * x + cos * y, 0.0])
            rows.append([*at, *(high - low), 1.0, yaw])
    table = np.array(rows)
    return Boxes(centre_m=table[:, :3], size_m=table[:, 3:6], yaw_rad=table[:, 6])


def _no_vehicle_stands_in_a_thing(road: str, seed: int) -> None:
    scene = _scene(road, seed)
    rows = [row for row, actor in enumerate(scene.actors) if actor.label in VEHICLES]
    size = np.array([scene.actors[row].size_m for row in rows])
    position, yaw = scene.motion.at(0.0)
    vehicles = Boxes(centre_m=position[rows], size_m=size, yaw_rad=yaw[rows])
    things = _feet(scene.layout)
    assert len(things) > 50
    near = np.hypot(*(things.centre_m[:, None, :2] - position[rows, :2]).transpose(2, 0, 1)).min(axis=1) < 12.0
    assert pairwise_iou(vehicles, things[near], kind="bev").max() < 1e-12  # rounding leaves 4e-17; a post in a car 1e-3


@pytest.mark.parametrize("seed", range(4))
def test_no_vehicle_stands_in_a_post_of_an_alley(seed: int) -> None:
    _no_vehicle_stands_in_a_thing("alleyway", seed)


@pytest.mark.slow
@pytest.mark.parametrize("road", ["urban", "suburban", "university", "parking_lot", "alleyway", "highway"])
@pytest.mark.parametrize("seed", whole_or(range(20), range(0, 20, 4)))
def test_no_vehicle_stands_in_a_post(road: str, seed: int) -> None:
    _no_vehicle_stands_in_a_thing(road, seed)


def _ground_above_m(layout: RoadLayout, xy_m: np.ndarray, pieces: range) -> np.ndarray:
    """Height of the highest triangle of some pieces of the ground."""
    assert layout.ground is not None
    out = np.full(len(xy_m), np.nan)
    for index in pieces:
        rows = chunk_rows(index, layout.breaks_m)
        parts = [layout.land.strips(rows), layout.land.beyond(rows[0], rows[-1])]
        tracer = Tracer(Mesh.merge(parts + [build(rows) for build in layout.ground.verges]))
        starts = np.column_stack([xy_m, np.full(len(xy_m), 300.0)])
        hits = tracer.cast_from(starts, np.tile([0.0, 0.0, -1.0], (len(xy_m), 1)))
        out = np.fmax(out, np.where(hits.face >= 0, 300.0 - hits.range_m, np.nan))
    return out


@pytest.mark.parametrize("road", ["mountain", "highway"])
def test_the_feet_of_plants_stand_on_the_ground(road: str) -> None:
    layout = _scene(road, 3).layout
    rows = layout.plants_between(0.0, CHUNK_M)
    foot_m = layout.axes_m(rows)[:, 0]
    ground_m = _ground_above_m(layout, foot_m[:, :2], range(-3, 5))
    assert len(rows) > 10
    assert np.isfinite(ground_m).all()
    assert ((foot_m[:, 2] - ground_m) < 0.02).all()
    assert ((foot_m[:, 2] - ground_m) > -0.32).all()
    s, d = (np.array([getattr(layout.plants[row], name) for row in rows]) for name in ("s_m", "d_m"))
    drawn_m = layout.land.road.point_m(s, d)[:, 2] + layout.land.rise_m(s, d)
    assert road == "highway" or np.abs(drawn_m - ground_m).max() > 0.5  # where they stood before


def test_the_wood_of_a_tree_stands_where_its_leaves_do() -> None:
    layout = _scene("mountain", 3).layout
    trees = [
        plant for plant in layout.plants if any((plant.s_m, plant.d_m) == (f.s_m, f.d_m) for f in layout.placements)
    ]
    woods = [next(f for f in layout.placements if (f.s_m, f.d_m) == (plant.s_m, plant.d_m)) for plant in trees[:40]]
    np.testing.assert_allclose(layout.lifts_m(trees[:40]), layout.lifts_m(woods), atol=1e-9)


def test_no_plant_stands_nearer_to_the_road_than_it_was_put() -> None:
    """Within a bend a place far from its own station lies near another stretch, or on it."""
    for seed in range(3):
        layout = _scene("mountain", seed).layout
        s, d = np.array([(plant.s_m, plant.d_m) for plant in layout.plants]).T
        _, nearest_m = layout.land.locate(layout.land.road.point_m(s, d)[:, :2])
        assert (np.abs(nearest_m) > np.abs(d) - 2.5).all()


@pytest.mark.parametrize("seed", range(3))
def test_an_alley_is_closed_between_its_side_streets_and_free_to_drive(seed: int) -> None:
    scene = _scene("alleyway", seed)
    land = scene.layout.land
    assert isinstance(land, StreetLand)
    half_m = land.street.edge_m
    alley = Tracer(Mesh.merge([scene.layout.chunk(index) for index in range(-1, 3)]))
    s = np.arange(0.0, 2 * CHUNK_M, 0.7)
    s = s[[land.street.clear(float(station), 0.8) for station in s]]
    heading = land.road.heading_rad(s)
    left = np.column_stack([-np.sin(heading), np.cos(heading), np.zeros(len(s))])
    origin = land.road.point_m(s, 0.0) + np.array([0.0, 0.0, 1.4])
    for side in (1, -1):
        range_m = alley.cast_from(origin, side * left).range_m
        assert range_m.min() > half_m - 0.9  # furniture and posts stand nearer than fronts
        assert (range_m < half_m + 1.2).mean() > 0.98


def test_wires_begin_at_the_tops_of_their_poles() -> None:
    layout = _scene("mountain", 3).layout
    land, d_m = layout.land, 8.0
    d_m = d_m if land.rise_m(np.array([10.0]), np.array([d_m]))[0] > 0 else -d_m
    wires = _wires(land, (0.0, 40.0, d_m, 8.0, 1.0, 0.0), 0.5)
    rise_m = float(land.rise_m(np.array([40.0]), np.array([d_m]))[0])
    assert rise_m > 0.5
    top_m = float(land.road.point_m(np.array(40.0), d_m)[2]) + rise_m + 7.5
    assert np.abs(wires.vertices_m[:, 2] - top_m).min() < 0.1
    assert wires.vertices_m[:, 2].max() > top_m - 0.2


def test_the_surroundings_of_the_stage_before_are_not_built_again(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = WorldScene("parking_lot", np.random.SeedSequence(5), duration_s=1.0, world="v3")
    built: list[int] = []
    chunk = scene.layout.chunk
    monkeypatch.setattr(scene.layout, "chunk", lambda index: [built.append(index), chunk(index)][1])
    monkeypatch.setattr(scene, "_ego_s_m", lambda time_s: 250.0 * time_s)
    first = scene._fixed(0.0, 100.0, 20.0, 1)[0].tracer.mesh
    assert built == [-1, 0, 1, 2]
    scene._fixed(1.0, 100.0, 20.0, 1)
    assert built == [-1, 0, 1, 2, 3, 4]
    scene._fixed(0.0, 100.0, 20.0, 1)
    np.testing.assert_array_equal(scene._fixed(0.0, 100.0, 20.0, 1)[0].tracer.mesh.reflectance, first.reflectance)
