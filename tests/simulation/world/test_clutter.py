"""World v3's street furniture and rows of parked vehicles: on the ground, off the lanes, touching nobody."""

import numpy as np
import pytest

from farfield.frame import Boxes
from farfield.geometry.iou import pairwise_iou
from farfield.simulation.bodies import facades, furniture
from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import box
from farfield.simulation.bodies.street import FENCES, KINDS, wires
from farfield.simulation.trace import Tracer
from farfield.simulation.world.land import Land
from farfield.simulation.world.roads.campus import AISLE_M, DEPTH_M
from farfield.simulation.world.roads.street import StreetLand
from farfield.simulation.world.scene import ROADS, WorldScene
from farfield.simulation.world.taken_ground import TakenGround, rectangle_of

DURATION_S = 8.0
VEHICLES = ("vehicle", "large_vehicle", "trailer")


@pytest.mark.parametrize("name", sorted(KINDS))
def test_furniture_stands_on_the_ground_and_is_low_in_triangles(name: str) -> None:
    for seed in range(5):
        mesh = KINDS[name](np.random.default_rng(seed))
        low, high = mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)
        assert -0.6 < low[2] <= 0.06
        assert 0.4 < high[2] < 2.7
        assert (high - low)[:2].max() < 9.0
        assert len(mesh.faces) < 2500
        np.testing.assert_allclose((high + low)[0], 0.0, atol=1.2)


@pytest.mark.parametrize("name", sorted(FENCES))
def test_rays_pass_through_an_open_fence_and_are_stopped_by_boards(name: str) -> None:
    fence = Tracer(FENCES[name](3.0, np.random.default_rng(1)))
    x, z = (grid.ravel() for grid in np.meshgrid(np.linspace(-1.4, 1.4, 200), np.linspace(0.2, 0.8, 40)))
    hits = fence.cast_from(np.stack([x, np.full_like(x, -5.0), z], axis=1), np.tile([0.0, 1.0, 0.0], (len(x), 1)))
    share = float(np.isfinite(hits.range_m).mean())
    assert share == 1.0 if name == "boards" else 0.005 < share < 0.8


def _depths_m(model: Tracer, rays: int = 60) -> np.ndarray:
    x, z = (grid.ravel() for grid in np.meshgrid(np.linspace(-9.5, 9.5, rays), np.linspace(0.3, 8.5, rays)))
    hits = model.cast_from(np.stack([x, np.full_like(x, -20.0), z], axis=1), np.tile([0.0, 1.0, 0.0], (len(x), 1)))
    return hits.range_m.astype(np.float64) - 20.0


@pytest.mark.parametrize("seed", range(6))
def test_a_front_is_closed_and_has_relief(seed: int) -> None:
    """The flat front of v2 is 3 cm deep, its panes; in v3 windows lie 8 to 28 cm behind the wall."""
    depth_m = _depths_m(Tracer(facades.relief_building(20.0, 10.0, 9.0, np.random.default_rng(seed))))
    assert np.isfinite(depth_m).all()
    assert -1.5 < depth_m.min() < 0.0
    assert 0.05 < np.quantile(depth_m, 0.95) < 0.3
    flat_m = _depths_m(Tracer(furniture.building(20.0, 10.0, 9.0, np.random.default_rng(seed))))
    assert flat_m.std() < 0.02 < depth_m.std()


def test_rays_through_the_glass_of_a_front_end_behind_it() -> None:
    house = facades.relief_building(20.0, 10.0, 9.0, np.random.default_rng(3))
    faces = house.material != Material.GLASS
    bare = Tracer(type(house).of(house.vertices_m, house.faces[faces], house.material[faces]))
    depth_m = _depths_m(bare)
    assert np.isfinite(depth_m).all()
    assert 0.3 < depth_m.max() < 4.0


def test_taken_ground_is_not_free_beyond_the_borders_of_cells() -> None:
    ground = TakenGround()
    ground.take(8.0, 23.0, -1.0, 1.0)
    ground.take(*rectangle_of(box([2.0, 1.0, 3.0], [0, 0, 1.5], Material.METAL), 50.0, 5.0, np.pi / 2))
    assert not any(ground.free(s, s + 0.5, 0.0, 0.5) for s in (7.8, 9.9, 15.0, 22.8))
    assert ground.free(7.0, 7.9, 0.0, 0.5)
    assert ground.free(8.0, 23.0, 1.1, 2.0)
    assert not ground.free(50.0, 50.4, 5.9, 6.0)
    assert ground.free(50.6, 51.0, 5.0, 5.1)


def test_a_wire_hangs_lowest_in_the_middle() -> None:
    mesh = wires([(np.array([0.0, 0.0, 8.0]), np.array([40.0, 0.0, 8.0]))], 0.6)
    assert mesh.vertices_m[:, 2].min() == pytest.approx(7.4, abs=0.02)
    assert abs(mesh.vertices_m[np.argmin(mesh.vertices_m[:, 2]), 0] - 20.0) < 0.1


_SCENES: dict[str, WorldScene] = {}


def _scene(road: str) -> WorldScene:
    if road not in _SCENES:
        _SCENES[road] = WorldScene(road, np.random.SeedSequence(1), duration_s=DURATION_S, world="v3")
    return _SCENES[road]


def _boxes(position_m: np.ndarray, size_m: np.ndarray, yaw_rad: np.ndarray) -> Boxes:
    return Boxes(centre_m=position_m, size_m=size_m, yaw_rad=yaw_rad)


@pytest.mark.parametrize("road", ROADS)
def test_no_road_user_touches_furniture_or_another(road: str) -> None:
    scene = _scene(road)
    obstacles = scene.layout.population.obstacles
    fixed = _boxes(
        *(np.array([getattr(item, name) for item in obstacles]) for name in ("position_m", "size_m", "yaw_rad"))
    )
    size = np.array([actor.size_m for actor in scene.actors])
    assert len(fixed) > 20
    for time_s in (0.0, 3.0, DURATION_S):
        position, yaw = scene.motion.at(time_s)
        users = _boxes(position, size, yaw)
        assert pairwise_iou(users, fixed, kind="bev").max() < 1e-6
        overlap = pairwise_iou(users, users, kind="bev")
        np.fill_diagonal(overlap, 0.0)
        assert overlap.max() < 1e-6


def _on_carriageway(land: Land, road: str, d_m: np.ndarray) -> np.ndarray:
    asphalt = land.material == Material.ASPHALT
    paved = (d_m > land.d_m[:-1][asphalt].min()) & (d_m < land.d_m[1:][asphalt].max())
    if road == "parking_lot":  # the aisles
        module = 2 * DEPTH_M + AISLE_M
        return paved & (np.abs((d_m + module / 2) % module - module / 2) < AISLE_M / 2 - 0.05)
    if road == "alleyway":  # the one lane
        return np.abs(d_m + land.street.edge_m - 2.0) < 1.2  # type: ignore[attr-defined]
    return np.abs(d_m) < land.street.edge_m + land.street.cycle_m if isinstance(land, StreetLand) else paved


@pytest.mark.parametrize("road", ROADS)
def test_no_furniture_stands_on_a_carriageway(road: str) -> None:
    scene = _scene(road)
    land = scene.layout.land
    s = np.arange(land.road.first_s_m, land.road.last_s_m, 0.5)
    line, heading = land.road.point_m(s, 0.0)[:, :2], land.road.heading_rad(s)
    for item in scene.layout.population.obstacles:
        cos, sin = np.cos(item.yaw_rad), np.sin(item.yaw_rad)
        corners = np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]]) / 2 * item.size_m[:2] @ [[cos, sin], [-sin, cos]]
        offset = (corners + item.position_m[:2])[:, None] - line
        nearest = np.argmin(np.hypot(*np.moveaxis(offset, -1, 0)), axis=1)
        x, y = offset[np.arange(4), nearest].T
        d_m = y * np.cos(heading[nearest]) - x * np.sin(heading[nearest])
        assert not _on_carriageway(land, road, d_m).any()


@pytest.mark.parametrize("road", ["urban", "suburban", "alleyway", "parking_lot"])
def test_more_vehicles_stand_than_move_and_some_are_turned_a_few_degrees(road: str) -> None:
    scene = _scene(road)
    rows = [row for row, actor in enumerate(scene.actors) if actor.label in VEHICLES]
    standing = np.array([scene.motion.travelled_m(row, DURATION_S) < 0.5 for row in rows])
    assert standing.sum() > 2.0 * (~standing).sum()
    road_line = scene.layout.land.road
    s = np.arange(road_line.first_s_m, road_line.last_s_m, 1.0)
    line = road_line.point_m(s, 0.0)[:, :2]
    position, yaw = scene.motion.at(0.0)
    parked = np.array(rows)[standing]
    nearest = np.argmin(np.linalg.norm(position[parked, None, :2] - line, axis=2), axis=1)
    turned = np.degrees(yaw[parked] - road_line.heading_rad(s[nearest]))
    tilt = np.abs((turned + 45.0) % 90.0 - 45.0)
    assert 0.5 < np.median(tilt[tilt < 6.0]) < 3.0


def test_furniture_bears_no_label_and_the_same_seed_gives_the_same_world() -> None:
    first = _scene("suburban")
    second = WorldScene("suburban", np.random.SeedSequence(1), duration_s=DURATION_S, world="v3")
    assert len(first.actors) == len(second.actors)
    one, other = first.layout.chunk(0), second.layout.chunk(0)
    np.testing.assert_array_equal(one.vertices_m, other.vertices_m)
    plain = WorldScene("suburban", np.random.SeedSequence(1), duration_s=DURATION_S)
    assert not plain.layout.population.obstacles
    assert len(one.faces) > 1.5 * len(plain.layout.chunk(0).faces)
