"""Bodies: exact sizes, plausible shapes, paint, and feet that move with the way."""

import numpy as np
import pytest

from farfield.simulation.bodies.actors import CLASS_OF, CLASSES, Actor, draw_size_m
from farfield.simulation.bodies.materials import SURFACES, Material, draw_reflectance
from farfield.simulation.bodies.mesh import Mesh, box
from farfield.simulation.bodies.people import PHASES, ankle_m, bent

KINDS = sorted(CLASS_OF)
WALKERS = ["pedestrian", "child", "stroller", "animal", "deer", "cyclist"]


def _actor(kind: str, seed: int) -> Actor:
    size = draw_size_m(kind, np.random.default_rng(seed))
    return Actor(1, kind, (float(size[0]), float(size[1]), float(size[2])), np.random.SeedSequence(seed))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_every_body_has_exactly_its_size_and_stands_on_the_ground(kind: str, seed: int) -> None:
    actor = _actor(kind, seed)
    mesh = actor.build()
    low, high = mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)
    np.testing.assert_allclose(high - low, actor.size_m, atol=1e-9)
    np.testing.assert_allclose([low[0] + high[0], low[1] + high[1], low[2]], 0, atol=1e-9)
    assert 100 < len(mesh.faces) < 1200
    assert mesh.faces.max() < len(mesh.vertices_m)
    assert np.isfinite(mesh.reflectance).all()
    assert actor.label in CLASSES


@pytest.mark.parametrize("kind", ["sedan", "hatch", "estate", "suv", "mpv", "van", "pickup"])
def test_cars_are_moderate_and_carry_glass_lamps_and_plates(kind: str) -> None:
    for seed in range(8):
        mesh = _actor(kind, seed).build()
        assert len(mesh.faces) <= 900
        assert {Material.GLASS, Material.LAMP, Material.PLATE, Material.TYRE} <= set(mesh.material.tolist())


def test_the_same_seed_builds_the_same_body_and_another_one_another() -> None:
    first, again, other = (Actor(0, "suv", (4.7, 1.9, 1.7), np.random.SeedSequence(s)).build() for s in (5, 5, 6))
    np.testing.assert_array_equal(first.vertices_m, again.vertices_m)
    assert np.abs(first.vertices_m - other.vertices_m).max() > 0.01
    assert not np.array_equal(first.reflectance, other.reflectance)
    assert not np.array_equal(first.tint, other.tint)


@pytest.mark.parametrize("kind", ["sedan", "pickup"])
def test_a_car_has_a_bonnet_a_roof_and_a_lower_tail(kind: str) -> None:
    """The profile that tells front from rear: bonnet well below the roof, tail (boot or bed) below it as well."""
    mesh = Actor(0, kind, (4.8, 1.9, 1.6), np.random.SeedSequence(1)).build()
    x, z = mesh.vertices_m[:, 0], mesh.vertices_m[:, 2]

    def top(first: float, last: float) -> float:
        return float(z[(x > first * 4.8) & (x < last * 4.8)].max())

    assert top(-0.2, 0.1) == pytest.approx(1.6, abs=1e-6)
    assert 0.7 < top(0.25, 0.5) < 1.25
    assert 0.7 < top(-0.5, -0.42) < 1.3


@pytest.mark.parametrize("kind", WALKERS)
def test_the_size_of_a_walker_is_that_of_its_whole_gait(kind: str) -> None:
    actor = _actor(kind, 3)
    poses = [actor.build(index / PHASES) for index in range(PHASES)]
    every = np.concatenate([mesh.vertices_m for mesh in poses])
    np.testing.assert_allclose(np.ptp(every, axis=0), actor.size_m, atol=1e-3)
    assert every[:, 2].min() == pytest.approx(0.0, abs=1e-9)
    for mesh in poses:
        np.testing.assert_array_equal(mesh.reflectance, poses[0].reflectance)
        assert len(mesh.faces) == len(poses[0].faces)
    assert np.abs(poses[0].vertices_m - poses[4].vertices_m).max() > 0.05


def test_feet_stay_below_the_speed_of_a_sine_of_half_a_cycle_a_step() -> None:
    """Feet move at most 1 + pi / 2 times as fast as the body, as the docstring derives, and never below the ground."""
    stature, speed = 1.75, 1.4
    cycle = Actor(0, "pedestrian", (0.8, 0.6, stature), np.random.SeedSequence(0)).cycle_m
    phase = np.linspace(0, 1, 2001)
    ankle = np.array([ankle_m(p, 1, cycle / 4) for p in phase])
    time_s = phase * cycle / speed
    world_x = ankle[:, 0] + speed * time_s
    foot_m_s = np.gradient(world_x, time_s)
    assert np.abs(foot_m_s).max() == pytest.approx(speed * (1 + np.pi / 2), rel=0.01)
    assert np.ptp(world_x) == pytest.approx(cycle, rel=0.2)
    assert ankle[:, 2].min() >= 0.07 - 1e-12


def test_bones_keep_their_length() -> None:
    hip, ankle = np.array([0.0, 0.0, 0.88]), np.array([0.2, 0.0, 0.15])
    knee = bent(hip, ankle, 0.44, 0.44, 1.0)
    assert np.linalg.norm(knee - hip) == pytest.approx(0.44)
    assert np.linalg.norm(knee - ankle) == pytest.approx(0.44)
    assert knee[0] > 0.1  # the knee bends forward


def test_one_tint_for_each_material_of_an_object(rng: np.random.Generator) -> None:
    mesh = _actor("sedan", 1).build()
    assert mesh.tint.dtype == np.float32
    for material in np.unique(mesh.material):
        assert len(np.unique(mesh.tint[mesh.material == material])) == 1
    assert len(np.unique(mesh.tint)) == len(np.unique(mesh.material))
    assert ((mesh.tint >= 0) & (mesh.tint < 1)).all()
    bare = box([1, 1, 1], [0, 0, 0], int(Material.METAL))
    assert (bare.tint == 0).all()
    joined = Mesh.merge([bare, mesh.placed(3.0, 0.0)])
    np.testing.assert_array_equal(joined.tint[12:], mesh.tint)


def test_car_paint_is_log_normal_around_a_quarter(rng: np.random.Generator) -> None:
    paint = np.array([draw_reflectance(np.array([Material.CAR_PAINT]), rng)[0] for _ in range(4000)])
    assert np.median(paint) == pytest.approx(0.25, rel=0.05)
    inner = paint[(paint > 0.03) & (paint < 1)]
    assert np.std(np.log(inner)) == pytest.approx(0.68, abs=0.04)  # 0.7 but for the clipped tails
    assert paint.min() >= 0.03
    assert paint.max() <= 1.0


def test_tyres_are_dark_and_plates_throw_light_back() -> None:
    assert SURFACES[Material.TYRE].reflectance < 0.05
    assert SURFACES[Material.PLATE].reflectance > 1 < SURFACES[Material.SIGN].reflectance
