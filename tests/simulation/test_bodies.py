"""Bodies: exact sizes, plausible shapes, and size statistics near published means."""

import numpy as np
import pytest

from farfield.simulation.bodies.actors import _SIZES, CLASSES, Actor, draw_car, draw_size_m, draw_truck
from farfield.simulation.bodies.materials import SURFACES, Material, draw_reflectance

KINDS = sorted(_SIZES)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_every_body_has_exactly_its_size_and_stands_on_the_ground(kind: str, seed: int) -> None:
    size = draw_size_m(kind, np.random.default_rng(seed))
    actor = Actor(1, kind, (size[0], size[1], size[2]), np.random.SeedSequence(seed))
    mesh = actor.build()
    low, high = mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)
    np.testing.assert_allclose(high - low, size, atol=1e-9)
    np.testing.assert_allclose([low[0] + high[0], low[1] + high[1], low[2]], 0, atol=1e-9)
    assert 100 < len(mesh.faces) < 1200
    assert mesh.faces.max() < len(mesh.vertices_m)
    assert np.isfinite(mesh.reflectance).all()
    assert actor.label in CLASSES


def test_the_same_seed_builds_the_same_body_and_another_one_another() -> None:
    first, again, other = (Actor(0, "suv", (4.7, 1.9, 1.7), np.random.SeedSequence(s)).build() for s in (5, 5, 6))
    np.testing.assert_array_equal(first.vertices_m, again.vertices_m)
    assert np.abs(first.vertices_m - other.vertices_m).max() > 0.01
    assert not np.array_equal(first.reflectance, other.reflectance)


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


def test_car_sizes_are_near_the_means_of_nuscenes_and_lyft(rng: np.random.Generator) -> None:
    """4.62 x 1.96 x 1.74 and 4.76 x 1.92 x 1.72 m."""
    sizes = np.array([draw_size_m(draw_car(rng), rng) for _ in range(4000)])
    np.testing.assert_allclose(sizes.mean(axis=0), [4.78, 1.92, 1.69], atol=0.12)
    trucks = np.array([draw_size_m(draw_truck(rng, long_haul=False), rng) for _ in range(2000)])
    assert 7 < trucks[:, 0].mean() < 12
    assert 2.4 < trucks[:, 1].mean() < 2.85


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
