"""Plants as a turbid medium: Beer and Lambert, the same leaves for every ray, and what a radar loses in them."""

import numpy as np
import pytest
from jaxtyping import Float, Float32

from farfield.inspection.statistics.background import background_samples
from farfield.simulation.bodies.plants import DENSITY_PER_M, VOXEL_M, Leaves, shrub, tall_grass
from farfield.simulation.foliage import CELL_M, Foliage, PlacedLeaves
from farfield.simulation.radar.propagation import leaf_factor
from farfield.simulation.trace import RayHits
from farfield.simulation.world.scene import WorldScene

AXES_M = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])


def slab(per_m: float, *, deep_m: float = 0.64, seed: int = 5, number: int = 0, anchor: float = 0.0) -> Foliage:
    """A medium of one density behind the plane x = 10, 8 m wide and high."""
    count = [round(deep_m / VOXEL_M), 50, 50]
    inside = np.ones(count, dtype=bool)
    leaves = Leaves.of(np.full(count, per_m), inside, np.array([10.0, -4.0, -4.0]))
    return Foliage([PlacedLeaves(leaves, number, AXES_M, 0.3, 0.5)], seed=seed, anchor_m=np.full(3, anchor))


def towards(points_m: Float[np.ndarray, "n 3"], origin_m: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "n 3"]:
    away = points_m - origin_m
    return away / np.linalg.norm(away, axis=1, keepdims=True)


@pytest.mark.parametrize(("per_m", "turn_deg"), [(0.5, 0.0), (3.0, 0.0), (3.0, 45.0), (8.0, 60.0)])
def test_the_share_of_rays_that_pass_obeys_beer_and_lambert(per_m: float, turn_deg: float) -> None:
    rng, turn = np.random.default_rng(1), np.deg2rad(turn_deg)
    n = 20_000
    origins = np.column_stack([np.zeros(n), rng.uniform(-3, 3, n) - 10.3 * np.tan(turn), rng.uniform(-3, 3, n)])
    rays = np.tile([np.cos(turn), np.sin(turn), 0.0], (n, 1))
    hits = slab(per_m).cast_from(origins, rays)
    path_m = 0.64 / np.cos(turn)
    expected = np.exp(-per_m * path_m)
    assert np.mean(hits.face < 0) == pytest.approx(expected, abs=4 * np.sqrt(expected * (1 - expected) / n) + 0.004)
    # the depths of the leaves are those of an exponential law cut off at the far side
    depth_m = hits.range_m[hits.face >= 0] - 10.0 / np.cos(turn)
    mean_m = 1 / per_m - path_m * expected / (1 - expected)
    assert depth_m.min() >= -1e-3
    assert depth_m.max() <= path_m + 1e-3
    assert depth_m.mean() == pytest.approx(mean_m, rel=0.03)


def thickness_m(points_m: Float[np.ndarray, "n 3"]) -> float:
    """T of `farfield compare` of points above a level ground."""
    rng = np.random.default_rng(0)
    ground = np.column_stack([rng.uniform(4, 20, 4000), rng.uniform(-6, 6, 4000), np.full(4000, -4.3)])
    (sample,) = background_samples(np.concatenate([points_m, ground]), None, "slab")
    return sample.thickness_m


# T in cm of a flat medium of 4,000 points at normal incidence and at 45 degrees, by a model of its own (it leaves open
# how large the patch was)
@pytest.mark.parametrize(
    ("per_m", "turn_deg", "table_cm"), [(3.0, 0, 17), (3.0, 45, 15), (5.0, 0, 14.6), (8.0, 45, 8.3), (12.0, 0, 7.6)]
)
def test_a_flat_medium_is_as_thick_as_its_density_says(per_m: float, turn_deg: int, table_cm: float) -> None:
    rng, n, turn = np.random.default_rng(2), 4000, np.deg2rad(turn_deg)
    origins = np.column_stack([np.zeros(n), rng.uniform(-3.9, 3.9, n) - 10 * np.tan(turn), rng.uniform(-3.9, 3.9, n)])
    ray = np.array([np.cos(turn), np.sin(turn), 0.0])
    hits = slab(per_m, deep_m=3.2).cast_from(origins, np.tile(ray, (n, 1)))
    hit = np.flatnonzero(hits.face >= 0)
    thick_m = thickness_m(origins[hit] + hits.range_m[hit, None] * ray)
    ideal_m = 10 / ray[0] + rng.exponential(1 / per_m, len(hit))
    assert thick_m == pytest.approx(thickness_m(origins[hit] + ideal_m[:, None] * ray), rel=0.05)
    assert 100 * thick_m == pytest.approx(table_cm, rel=0.15)


def test_every_beam_sweep_and_sensor_meets_the_same_leaf() -> None:
    foliage, rng = slab(4.0, deep_m=1.6), np.random.default_rng(3)
    lidar_m = np.array([0.0, 0.5, 0.2])
    rays = towards(np.column_stack([np.full(2000, 10.0), *rng.uniform(-3, 3, (2, 2000))]), lidar_m)
    hits = foliage.cast(lidar_m, rays)
    hit = np.flatnonzero(hits.face >= 0)
    # the same ray from nearer, as the next sweep may cast it
    nearer = foliage.cast_from(lidar_m + 4.0 * rays, rays)
    np.testing.assert_array_equal(nearer.face, hits.face)
    np.testing.assert_allclose(nearer.range_m[hit] + 4.0, hits.range_m[hit], atol=1e-4)
    # a ray a tenth of a millimetre beside it: the same leaf but at the cells' edges
    beside = foliage.cast(lidar_m + np.array([0.0, 1e-4, 0.0]), rays)
    assert np.mean(np.abs(beside.range_m[hit] - hits.range_m[hit]) < 1e-3) > 0.95
    # a camera 3 m aside that looks at those leaves along a path through the cell that is as long: it meets them or
    # one before, never one behind, in far more cases than chance gives (1 - exp(-4 * 0.04) = 0.15)
    camera_m = np.array([0.0, 3.5, 0.2])
    leaves_m = lidar_m + rays[hit] * hits.range_m[hit, None]
    middle_m = (np.floor(leaves_m / CELL_M) + 0.5) * CELL_M
    look = towards(middle_m, camera_m)
    own_m = np.linalg.norm(middle_m - camera_m, axis=1)
    seen = foliage.cast(camera_m, look)
    reaches = seen.range_m > own_m - 0.02
    assert np.mean(np.abs(seen.range_m[reaches] - own_m[reaches]) < 1.5 * CELL_M) > 0.7
    # the number of the plant and the world's seed decide, nothing else does
    again = slab(4.0, deep_m=1.6, anchor=100.0).cast(lidar_m, rays)
    assert np.mean(again.face == hits.face) > 0.99
    for other in (slab(4.0, deep_m=1.6, seed=6), slab(4.0, deep_m=1.6, number=1)):
        assert np.mean(np.isclose(other.cast(lidar_m, rays).range_m, hits.range_m)) < 0.3


def test_rays_end_where_they_shall_and_leave_the_leaf_that_they_start_on() -> None:
    foliage, n = slab(6.0, deep_m=1.6), 500
    origins = np.column_stack([np.zeros(n), np.linspace(-3, 3, n), np.zeros(n)]).astype(np.float32)
    rays = np.tile(np.array([1.0, 0, 0], dtype=np.float32), (n, 1))
    all_hits = foliage.cast_anchored(origins, rays)
    within: Float32[np.ndarray, " n"] = np.full(n, 10.2, dtype=np.float32)
    near_hits: RayHits = foliage.cast_anchored(origins, rays, within)
    np.testing.assert_array_equal(near_hits.face >= 0, all_hits.range_m < 10.2)
    at_leaf = origins + rays * np.where(np.isfinite(all_hits.range_m), all_hits.range_m, 10.0)[:, None]
    away = foliage.cast_from(at_leaf.astype(np.float64), rays.astype(np.float64))
    assert (away.range_m > 1e-3).all()


def test_plants_have_ragged_outlines_and_gaps() -> None:
    rng = np.random.default_rng(4)
    leaves = shrub(1.2, rng).leaves
    inside = leaves.value > 0
    assert 0.08 < np.mean(leaves.value[inside] == 1) < 0.32  # blobs left out
    assert leaves.per_m.max() < 10
    assert leaves.low_m[2] < 0.1  # it stands on the ground
    grass = tall_grass(3.0, 0.8, 0.4, rng).leaves
    assert grass.high_m[2] < 0.9
    assert DENSITY_PER_M * 254 > 12  # the densest hedge can be told


def test_a_radar_loses_three_decibel_a_metre_and_thirty_at_most() -> None:
    np.testing.assert_allclose(10 * np.log10(leaf_factor(np.array([0.0, 1.0, 5.0, 40.0]))), [0, -6, -30, -60])
    rays = np.tile([1.0, 0.0, 0.0], (3, 1))
    path_m, entry_m = slab(3.0).paths_m(np.zeros(3), rays, np.array([5.0, 10.32, 50.0]))
    np.testing.assert_allclose(path_m, [0.0, 0.32, 0.64], atol=1e-3)
    np.testing.assert_allclose(entry_m, [np.inf, 10.0, 10.0], atol=1e-3)


def scene(world: str, traffic: str = "right") -> WorldScene:
    return WorldScene("suburban", np.random.SeedSequence(7), duration_s=5.0, world=world, traffic=traffic)


def test_the_older_world_has_no_such_plants_and_the_newer_one_always_the_same() -> None:
    assert not scene("v2").layout.plants
    one, other = scene("v3").window(1.0), scene("v3").window(1.0)
    fixed, leaves = one.bodies[0].tracer, one.bodies[1].tracer
    assert [body.actor for body in one.bodies[:2]] == [-1, -1]
    origin = one.world_T_ego_now[:3, 3] + [0, 0, 1.9]
    angle = np.linspace(-np.pi, np.pi, 4000)
    rays = np.column_stack([np.cos(angle), np.sin(angle), 0.03 * np.sin(7 * angle)])
    hits, again = leaves.cast(origin, rays), other.bodies[1].tracer.cast(origin, rays)
    np.testing.assert_array_equal(hits.range_m, again.range_m)
    assert 0.02 < np.mean(hits.range_m < fixed.cast(origin, rays).range_m) < 0.9
    # the left-hand world is its mirror image
    mirrored = scene("v3", "left").window(1.0)
    flip = np.array([1.0, -1.0, 1.0])
    left = mirrored.bodies[1].tracer.cast(origin * flip, rays * flip)
    same = np.isclose(left.range_m, hits.range_m, atol=1e-3)
    assert np.mean(same) > 0.97
    hit = same & (hits.face >= 0)
    assert hit.sum() > 100
    np.testing.assert_allclose(left.cosine[hit], hits.cosine[hit], atol=1e-4)  # and so do its leaves face
