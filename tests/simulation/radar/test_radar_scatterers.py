"""What the radar sees of hand-made scenes, and what of it the labels say."""

from dataclasses import replace

import numpy as np
import pytest

from farfield.errors import ConfigError
from farfield.geometry.poses import pose, pose_from_yaw
from farfield.simulation.bodies.actors import Actor
from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import Mesh, box
from farfield.simulation.bodies.plants import VOXEL_M, Leaves
from farfield.simulation.foliage import Foliage, PlacedLeaves
from farfield.simulation.radar.casting import cast_rays
from farfield.simulation.radar.frame import measure
from farfield.simulation.radar.model import RadarModel, radar_mount
from farfield.simulation.radar.points import ScattererKind, Scatterers, availability, cell_snr, masked_db, object_snr_db
from farfield.simulation.radar.rcs import mean_rcs_dbsm, slow_db
from farfield.simulation.radar.scatterers import find_mirrors, plants, radar_velocity_m_s, scatterers
from farfield.simulation.trace import Body, Tracer
from farfield.simulation.weather.conditions import Weather
from farfield.simulation.world.scene import SceneWindow

MODEL = RadarModel()
HEIGHT_M = 0.9
EGO_M_S = np.array([20.0, 0.0, 0.0])
CAR = (4.6, 1.9, 1.5)


def road(*furniture: Mesh) -> Body:
    ground = box([300.0, 40.0, 0.1], [150.0, 0.0, -0.05], int(Material.ASPHALT))
    return Body(Tracer(Mesh.merge([ground, *furniture]).painted(np.random.default_rng(0))), np.eye(4)[None])


def body_at(x_m: float, y_m: float, size: tuple[float, float, float], row: int, *, clearance_m: float = 0.2) -> Body:
    shape = box(
        [size[0], size[1], size[2] - clearance_m], [0.0, 0.0, (size[2] + clearance_m) / 2], int(Material.CAR_PAINT)
    )
    return Body(Tracer(shape.painted(np.random.default_rng(0))), pose_from_yaw(0.0, (x_m, y_m, 0.0))[None], row)


def scene(places, *furniture, kinds=None, velocity=None) -> SceneWindow:
    """Boxes on a road, the radar 0.9 m above the origin, driving ahead at 20 m/s."""
    kinds = kinds or ["sedan"] * len(places)
    sizes = [(0.6, 0.6, 1.75) if kind == "pedestrian" else CAR for kind in kinds]
    bodies = [body_at(x, y, size, row) for row, ((x, y), size) in enumerate(zip(places, sizes, strict=True))]
    actors = [
        Actor(i, kind, size, np.random.SeedSequence(i)) for i, (kind, size) in enumerate(zip(kinds, sizes, strict=True))
    ]
    n = len(places)
    speeds = np.tile(EGO_M_S, (n, 1)) if velocity is None else np.asarray(velocity, dtype=float)
    return SceneWindow(
        0.0, np.zeros(1), np.eye(4)[None], [road(*furniture), *bodies], actors,
        np.array([[x, y, 0.0] for x, y in places]).reshape(n, 3), np.zeros(n), speeds, EGO_M_S,
    )  # fmt: skip


POSE = pose(np.eye(3), np.array([0.0, 0.0, HEIGHT_M]))


def see(window: SceneWindow, seed: int = 0, weather: Weather | None = None) -> Scatterers:
    return scatterers(window, MODEL, POSE, weather or Weather(), np.random.default_rng(seed))


def test_a_car_gives_its_cross_section_where_it_stands():
    """Averaged over frames: the rear lobe's 14.6 dBsm (two-ray mean 1) plus the individual's own level."""
    window = scene([(42.3, 0.0)])
    frames = [see(window, seed) for seed in range(30)]
    own = [seen.take(seen.actor == 0) for seen in frames]
    want = 14.6 + slow_db(window.actors[0])
    assert 10 * np.log10(np.mean([part.rcs_m2.sum() for part in own])) == pytest.approx(want, abs=2.5)
    assert np.concatenate([part.position_m[:, 0] for part in own]).min() == pytest.approx(40.0, abs=0.2)
    assert np.abs(np.concatenate([part.velocity_m_s for part in own])).max() < 0.05


@pytest.mark.parametrize(("kind", "yaw"), [("sedan", 0.0), ("hatch", np.pi), ("van", np.pi / 2)])
@pytest.mark.parametrize("world", ["v2", "v3"])
def test_bodies_of_both_worlds_give_the_cross_section_of_their_class(kind: str, yaw: float, world: str):
    """Over ranges, where the road's reflection averages out: a mesh shares its level among its parts."""
    actor = Actor(0, kind, CAR, np.random.SeedSequence(4), world)
    tracer, shares = Tracer(actor.build()), []
    for x in np.linspace(32.0, 75.0, 16):
        boxed = scene([(x, 0.0)])
        body = Body(tracer, pose_from_yaw(yaw, (x, 0.0, 0.0))[None], 0)
        seen = see(replace(boxed, bodies=[boxed.bodies[0], body], actors=[actor], yaw_rad=np.array([yaw])), int(x))
        level_db = mean_rcs_dbsm(actor, np.pi - yaw, float(x)) + slow_db(actor)
        shares.append(seen.rcs_m2[seen.actor == 0].sum() / 10 ** (level_db / 10))
    assert 10 * np.log10(np.mean(shares)) == pytest.approx(0.0, abs=1.0)


def test_a_car_behind_a_hedge_is_weaker_and_the_hedge_has_echoes_that_move():
    """A hedge 1.92 m thick takes 3 dB a metre each way and gives -12 dB of the area that is lit, by Rayleigh's law."""
    count = np.array([12, 100, 25])
    leaves = Leaves.of(np.full(count, 4.0), np.ones(count, dtype=bool), np.array([30.0, -8.0, -0.2]))
    axes_m = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    hedge = Body(
        Foliage([PlacedLeaves(leaves, 0, axes_m, 0.3, 0.5)], seed=1, anchor_m=np.zeros(3)), np.eye(4)[None], -1
    )
    bare = scene([(42.3, 0.0)])
    hedged = replace(bare, bodies=[bare.bodies[0], hedge, *bare.bodies[1:]])
    levels = []
    for window in (bare, hedged):
        frames = [see(window, seed) for seed in range(30)]
        own = [seen.take(seen.actor == 0) for seen in frames]
        levels.append(10 * np.log10(np.mean([part.rcs_m2.sum() for part in own])))
    assert levels[0] - levels[1] == pytest.approx(2 * 3.0 * 12 * VOXEL_M, abs=2.0)
    plant = frames[0].take(frames[0].kind == ScattererKind.PLANT)
    assert not (see(bare).kind == ScattererKind.PLANT).any()
    assert plant.range_m.min() > 29.9
    assert np.median(plant.position_m[:, 0]) < 31.0  # most from the first metre
    own_m_s = plant.velocity_m_s + EGO_M_S @ (plant.position_m / plant.range_m[:, None]).T
    assert 0.1 < own_m_s.std() < 0.3
    lit_m2 = 16.0 * 4.0 - 16.0 * 0.2
    total = [seen.rcs_m2[seen.kind == ScattererKind.PLANT].sum() for seen in frames]
    assert 10 * np.log10(np.mean(total) / lit_m2) == pytest.approx(-12.0, abs=1.5)


def test_a_hedge_behind_twigs_echoes_and_the_air_between_them_does_not():
    """0.16 m of twigs 10 m ahead, and 1.92 m of a hedge 40 m ahead."""
    axes_m = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    placed = []
    for number, (x, deep) in enumerate(((10.0, 1), (40.0, 12))):
        count = np.array([deep, 100, 25])
        leaves = Leaves.of(np.full(count, 4.0), np.ones(count, dtype=bool), np.array([x, -8.0, -0.2]))
        placed.append(PlacedLeaves(leaves, number, axes_m, 0.3, 0.5))
    foliage = Body(Foliage(placed, seed=1, anchor_m=np.zeros(3)), np.eye(4)[None], -1)
    bare = scene([])
    cast = cast_rays(replace(bare, bodies=[*bare.bodies, foliage]), POSE, 100.0, np.random.default_rng(2))
    points = plants(cast, np.random.default_rng(3))
    x = points.position_m[:, 0]
    in_twigs, in_hedge = (x > 9.98) & (x < 10.18), (x > 39.98) & (x < 41.94)
    assert (in_twigs | in_hedge).all()
    up = points.position_m[:, 2] / x
    through = (np.abs(points.position_m[:, 1] / x) < 0.18) & (up > -0.02) & (up < 0.065)
    level = points.rcs_m2[through & in_hedge].sum() / points.rcs_m2[through & in_twigs].sum()
    falls = 2 * 0.3 * np.log(10)  # 3 dB a metre, there and back
    first, whole = (1 - np.exp(-falls * deep_m) for deep_m in (VOXEL_M, 13 * VOXEL_M))
    assert in_hedge.sum() > 50
    assert np.mean(in_hedge[through]) == pytest.approx(1 - first / whole, abs=0.05)
    assert level > 1


def test_hidden_cars_show_under_their_leader_only():
    seen = see(scene([(25.0, 0.0), (40.0, 0.0)]))
    front, behind = (seen.take(seen.actor == row) for row in (0, 1))
    assert set(front.kind) == {int(ScattererKind.OBJECT)}
    assert set(behind.kind) == {int(ScattererKind.BOUNCE)}
    assert behind.position_m[:, 2].max() < -HEIGHT_M  # seen as an image under the road
    alone = see(scene([(25.0, 30.0), (40.0, 0.0)]))
    lost = 10 * np.log10(behind.rcs_m2.sum() / alone.take(alone.actor == 1).rcs_m2.sum())
    assert -18 < lost < -3


def test_a_vehicle_that_begins_beside_the_radar_is_seen():
    seen = see(scene([(1.5, 3.0)]))
    own = seen.take(seen.actor == 0)
    assert len(own) > 5
    assert np.all((own.position_m[:, 1] > 2.0) & (own.position_m[:, 0] < 3.9))


def test_walls_leave_no_way_under_them():
    wall = box([0.3, 8.0, 3.0], [25.0, 0.0, 1.5], int(Material.CONCRETE))
    seen = see(scene([(40.0, 0.0)], wall))
    assert not np.any((seen.actor == 0) & (seen.kind != ScattererKind.GHOST))


def test_the_static_world_approaches_by_the_cosine():
    seen = see(scene([]))
    static = seen.take(seen.kind == ScattererKind.SURFACE)
    want = -20.0 * static.position_m[:, 0] / static.range_m
    assert static.velocity_m_s == pytest.approx(want, abs=0.02)
    assert np.all(static.position_m[:, 2] == pytest.approx(-HEIGHT_M, abs=0.02))
    assert 200 < len(static) <= MODEL.max_scatterers


def test_turning_moves_the_mount():
    """The ego vehicle turns at 0.5 rad/s on the spot: a mount 2 m ahead moves at 1 m/s to the left."""
    knots = np.linspace(-0.05, 0.05, 3)
    poses = np.stack([pose_from_yaw(0.5 * knot) for knot in knots])
    window = replace(scene([]), knots_s=knots, world_T_ego=poses)
    moving = radar_velocity_m_s(window, pose(np.eye(3), np.array([2.0, 0.0, 0.5])))
    assert moving == pytest.approx([0.0, 1.0, 0.0], abs=1e-3)


def test_a_wall_beside_the_road_mirrors_cars():
    wall = box([80.0, 0.3, 3.0], [40.0, 8.15, 1.5], int(Material.CONCRETE))
    window = scene([(30.0, 3.0)], wall, velocity=[[10.0, 1.0, 0.0]])
    mirrors = find_mirrors(cast_rays(window, POSE, 118.0, np.random.default_rng(0)))
    flank = [mirror for mirror in mirrors if abs(mirror.normal[1]) > 0.99]
    assert flank[0].distance_m == pytest.approx(8.0, abs=0.05)
    ghosts = [seen.take(seen.kind == ScattererKind.GHOST) for seen in (see(window, seed) for seed in range(8))]
    place = np.concatenate([ghost.position_m for ghost in ghosts])
    assert len(place) > 10
    assert np.all((place[:, 1] > 11.5) & (place[:, 1] < 14.6))  # the car's 2.05 ... 3.95 m seen behind a wall at 8 m
    ratio = np.mean([ghost.rcs_m2.sum() for ghost in ghosts]) / np.mean(
        [seen.rcs_m2[seen.kind == ScattererKind.OBJECT].sum() for seen in (see(window, seed) for seed in range(8))]
    )
    assert 10 * np.log10(ratio) == pytest.approx(MODEL.ghost_db, abs=2.5)
    direction = place / np.linalg.norm(place, axis=1, keepdims=True)
    want = direction @ (np.array([10.0, -1.0, 0.0]) - EGO_M_S)
    assert np.concatenate([ghost.velocity_m_s for ghost in ghosts]) == pytest.approx(want, abs=0.3)


def test_rails_show_their_posts():
    rail = box([80.0, 0.06, 0.3], [45.0, -5.0, 0.6], int(Material.METAL))
    seen = see(scene([], rail))
    post = seen.take(seen.kind == ScattererKind.POST)
    assert len(post) >= 5
    assert post.position_m[:, 1] == pytest.approx(-4.97, abs=0.1)
    assert np.diff(np.sort(post.position_m[:, 0])) % 4.0 == pytest.approx(0.0, abs=0.05)


def test_walkers_limbs_swing_about_their_speed():
    window = scene([(20.0, 2.0)], kinds=["pedestrian"], velocity=[[1.4, 0.0, 0.0]])
    speeds = []
    for time_s in np.linspace(0.0, 1.0, 12):
        seen = see(replace(window, time_s=float(time_s)))
        limbs = seen.take(seen.actor == 0)
        assert set(limbs.kind) == {int(ScattererKind.LIMB)}
        speeds.append(limbs.velocity_m_s + 20.0)
    speeds = np.concatenate(speeds)
    assert np.median(speeds) == pytest.approx(1.4, abs=0.2)
    assert speeds.min() == pytest.approx(1.4 * (1 - np.pi / 2), abs=0.25)  # a sine through the foot that stands
    assert speeds.max() == pytest.approx(1.4 * (1 + np.pi / 2), abs=0.25)


def test_snr_follows_the_radar_equation_and_the_best_cell():
    """10 m2 at 50 m is 30 dB; two scatterers in one cell add up, two in different cells do not."""
    one = Scatterers.of(np.array([[50.0, 0.0, 0.0]]), np.zeros(1), np.array([10.0]), actor=0)
    assert object_snr_db(one, MODEL, 2) == pytest.approx([30.0, -np.inf])
    far = replace(one, position_m=one.position_m * 2)
    assert object_snr_db(far, MODEL, 1)[0] == pytest.approx(
        30.0 - 40 * np.log10(2.0) + MODEL.echo_gain_db(np.array(100.0))
    )
    assert object_snr_db(Scatterers.join([one, one]), MODEL, 1)[0] == pytest.approx(33.01, abs=0.01)
    assert object_snr_db(Scatterers.join([one, far]), MODEL, 1)[0] == pytest.approx(30.0)
    lossy = replace(one, loss_db=np.array([4.0]))
    assert 10 * np.log10(cell_snr(lossy, MODEL)[0]) == pytest.approx(26.0)
    edge = Scatterers.of(50.0 * np.array([[np.cos(0.925), np.sin(0.925), 0.0]]), np.zeros(1), np.array([10.0]))
    assert 10 * np.log10(cell_snr(edge, MODEL)[0]) == pytest.approx(18.0, abs=0.1)  # -6 dB each way at 53 degrees


def test_availability():
    rival = Scatterers.of(np.array([[40.0, 30.0, 0.0]]), np.zeros(1), np.array([1e4]))
    weak = Scatterers.of(np.array([[50.0, 0.0, 0.0]]), np.zeros(1), np.array([10.0]), actor=1)
    both = Scatterers.join([rival, weak])
    snr, masked = object_snr_db(both, MODEL, 3), masked_db(both, MODEL, 3)
    assert masked[1] > 15 and np.isinf(masked[0])  # noqa: PT018
    lidar = np.array([False, True, True])
    assert availability(snr, lidar) == ["L1", "R", "L"]
    assert availability(snr, lidar, masked_by_db=masked) == ["L1", "L", "L"]
    assert availability(snr, lidar, threshold_db=31.0) == ["L1", "L", "L"]


def test_a_frame_shows_its_car_and_repeats_itself():
    window = scene([(42.3, 3.0)])
    first = measure(window, MODEL, POSE, Weather(), np.random.SeedSequence(4))
    again = measure(window, MODEL, POSE, Weather(), np.random.SeedSequence(4))
    assert first.tensor is None
    assert first.power is not None
    assert first.doppler_m_s is not None
    assert again.power is not None
    assert first.power.tobytes() == again.power.tobytes()
    rows = slice(70, 130)
    index, _, azimuth = np.unravel_index(first.power[rows].argmax(), first.power[rows].shape)
    assert MODEL.axes.range_m[70 + index] == pytest.approx(40.2, abs=0.8)
    assert MODEL.axes.azimuth_deg[azimuth] == pytest.approx(4.2, abs=2.1)
    assert abs(first.doppler_m_s[70 + index, 18, azimuth]) < 0.7
    assert first.snr_db[0] > 20


def test_weather_changes_what_the_radar_sees_by_less_than_3_db():
    window = scene([(42.3, 3.0)])
    clear = measure(window, MODEL, POSE, Weather(), np.random.SeedSequence(4), outputs=()).snr_db
    wet = Weather("rain", rain_mm_h=10.0, film_mm=0.04, water_mm=1.0)
    assert 0.5 < (clear - measure(window, MODEL, POSE, wet, np.random.SeedSequence(4), outputs=()).snr_db)[0] < 3.0


def test_says_which_outputs_there_are():
    with pytest.raises(ConfigError, match="expected some of mean, tensor; got cube"):
        measure(scene([]), MODEL, POSE, Weather(), np.random.SeedSequence(0), outputs=("cube",))


def test_mount_of_the_data_set():
    lidar = pose(np.eye(3), np.array([-0.5, 0.0, 1.6]))
    assert radar_mount(lidar)[:3, 3] == pytest.approx([2.04, -0.3, 0.9])
