"""Bodies of world v3: exact sizes but for mirrors, curved skins, seats behind glass, a stream of their own."""

import numpy as np
import pytest

from farfield.simulation.bodies.actors import CLASS_OF, Actor, mean_size_m
from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import Mesh
from farfield.simulation.bodies.outlines import OUTLINES
from farfield.simulation.bodies.vehicles import TRUCK_STYLES, build_car
from farfield.simulation.trace import Tracer
from farfield.simulation.world.scene import WorldScene

KINDS = [*OUTLINES, *TRUCK_STYLES]
CARS = ["sedan", "hatch", "estate", "suv", "mpv"]


def body(kind: str, seed: int, world: str = "v3") -> Mesh:
    return Actor(0, kind, mean_size_m(kind), np.random.SeedSequence(seed), world).build()


def slice_of(mesh: Mesh, low: tuple[float, float, float], high: tuple[float, float, float]) -> np.ndarray:
    """Vertices within a box given as shares of the mesh's extent."""
    least, size = mesh.vertices_m.min(axis=0), np.ptp(mesh.vertices_m, axis=0)
    share = (mesh.vertices_m - least) / size
    return mesh.vertices_m[((share >= low) & (share <= high)).all(axis=1)]


def first_hits(
    mesh: Mesh, origins_m: np.ndarray, direction: tuple[float, float, float]
) -> tuple[np.ndarray, np.ndarray]:
    hits = Tracer(mesh).cast_from(origins_m, np.broadcast_to(direction, origins_m.shape).astype(float))
    return hits.range_m, np.where(hits.face < 0, -1, mesh.material[hits.face])


@pytest.mark.parametrize("kind", KINDS)
def test_bodies_have_their_size_but_for_mirrors_and_few_triangles(kind: str) -> None:
    for seed in range(6):
        mesh = body(kind, seed)
        low, high = mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)
        length, width, height = mean_size_m(kind)
        np.testing.assert_allclose([high[0], low[0], low[2], high[2]], [length / 2, -length / 2, 0, height], atol=1e-9)
        np.testing.assert_allclose(high[1], -low[1], atol=1e-9)
        assert 0.03 < high[1] - width / 2 < 0.2
        assert len(mesh.faces) <= (1700 if kind == "semi" else 1400)
        assert mesh.faces.max() < len(mesh.vertices_m)
        assert np.isfinite(mesh.reflectance).all()
        assert {Material.GLASS, Material.LAMP, Material.PLATE, Material.TYRE, Material.TRIM} <= set(
            mesh.material.tolist()
        )


def test_bodies_draw_from_a_stream_of_their_own() -> None:
    size, seed = np.array([4.7, 1.9, 1.7]), np.random.SeedSequence(5)
    old = Actor(0, "suv", (4.7, 1.9, 1.7), seed).build()
    expected = build_car("suv", size, np.random.default_rng(np.random.SeedSequence(5)))
    np.testing.assert_array_equal(old.vertices_m, expected.vertices_m)
    np.testing.assert_array_equal(old.reflectance, expected.reflectance)
    first, again, other = body("suv", 5), body("suv", 5), body("suv", 6)
    np.testing.assert_array_equal(first.vertices_m, again.vertices_m)
    assert not np.array_equal(first.reflectance, other.reflectance)
    walker = Actor(0, "pedestrian", (0.7, 0.6, 1.75), seed)
    same = Actor(0, "pedestrian", (0.7, 0.6, 1.75), seed, "v3")
    np.testing.assert_array_equal(walker.build(0.3).vertices_m, same.build(0.3).vertices_m)


@pytest.mark.parametrize("kind", CARS)
def test_sides_lean_in_and_corners_are_round(kind: str) -> None:
    length, width, height = mean_size_m(kind)
    for seed in range(4):
        mesh = body(kind, seed)
        z = np.linspace(0.45, 0.92, 40) * height
        sides = np.stack([np.full(40, 0.02 * length), np.full(40, 3.0), z], axis=1)
        reach, _ = first_hits(mesh, sides, (0.0, -1.0, 0.0))
        inset = width / 2 - (3.0 - reach)
        assert np.abs(inset[z < 0.55 * height]).max() < 0.04
        assert 0.18 < inset[-1] < 0.48  # the roof's edge stands within the doors
        y = np.array([0.0, 0.4, 0.8]) * width / 2
        ahead = np.stack([np.full(3, length), y, np.full(3, 0.30 * height)], axis=1)
        depth, _ = first_hits(mesh, ahead, (-1.0, 0.0, 0.0))
        bow = depth - depth[0]
        assert 0.0 <= bow[1] < 0.10
        assert 0.08 < bow[2] < 0.45


@pytest.mark.parametrize("kind", ["sedan", "pickup"])
def test_bonnet_and_tail_are_lower_than_the_roof(kind: str) -> None:
    for seed in range(4):
        mesh = body(kind, seed)
        top = {end: slice_of(mesh, low, high)[:, 2].max() / mean_size_m(kind)[2] for end, low, high in (
            ("bonnet", (0.85, 0.3, 0), (1.0, 0.7, 1)), ("tail", (0.0, 0.3, 0), (0.1, 0.7, 1)),
        )}  # fmt: skip
        assert 0.4 < top["bonnet"] < 0.72
        assert 0.4 < top["tail"] < 0.80


@pytest.mark.parametrize("kind", [*CARS, "van", "bus"])
def test_there_is_something_behind_the_glass_and_wheels_stand_in_arches(kind: str) -> None:
    length, _, height = mean_size_m(kind)
    mesh = body(kind, 2)
    clear = mesh.material != Material.GLASS
    inside = Mesh.of(mesh.vertices_m, mesh.faces[clear], mesh.material[clear])
    x, z = np.meshgrid(np.linspace(-0.35, 0.35, 60) * length, np.linspace(0.5, 0.85, 36) * height)
    rays = np.stack([x.ravel(), np.full(x.size, 4.0), z.ravel()], axis=1)
    glazed = first_hits(mesh, rays, (0.0, -1.0, 0.0))[1] == Material.GLASS
    behind = first_hits(inside, rays[glazed], (0.0, -1.0, 0.0))[1]
    assert glazed.mean() > 0.05
    assert {Material.CLOTH} <= set(behind.tolist())
    low = np.stack([np.linspace(-0.5, 0.5, 400) * length, np.full(400, 4.0), np.full(400, 0.3)], axis=1)
    assert (first_hits(mesh, low, (0.0, -1.0, 0.0))[1] == Material.TYRE).sum() > 20


def test_a_scene_hands_its_world_to_its_road_users() -> None:
    for world in ("v2", "v3"):
        scene = WorldScene("highway", np.random.SeedSequence(3), duration_s=1.0, world=world)
        assert {actor.world for actor in scene.actors} == {world}
    assert all(CLASS_OF[kind] in ("vehicle", "large_vehicle") for kind in KINDS)
