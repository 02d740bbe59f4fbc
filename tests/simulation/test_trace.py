"""Ray hits against analytic planes, spheres and boxes; what stands in front hides what is behind."""

import sys

import numpy as np
import pytest

from farfield.errors import MissingExtraError
from farfield.geometry.poses import invert, pose_from_yaw, transform_points
from farfield.simulation.lidar.model import LidarModel, Scan
from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import Mesh, box, ellipsoid, quads
from farfield.simulation.lidar.sweep import Body, shots_towards, sweep
from farfield.simulation.trace import Tracer


def rays(rng: np.random.Generator, count: int) -> np.ndarray:
    directions = rng.standard_normal((count, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def test_plane_at_250_m_to_a_tenth_of_a_millimetre(rng: np.random.Generator) -> None:
    wall = quads(np.array([[[250.0, -99, -99], [250, 99, -99], [250, 99, 99], [250, -99, 99]]]), 0)
    directions = np.column_stack([np.ones(500), rng.uniform(-0.3, 0.3, (500, 2))])
    directions = (directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(np.float32)
    hits = Tracer(wall).cast(np.zeros(3), directions)
    x = hits.range_m.astype(np.float64) * directions[:, 0]
    np.testing.assert_allclose(x, 250.0, atol=1e-4)
    np.testing.assert_allclose(hits.cosine, directions[:, 0], atol=1e-5)


def test_far_from_the_world_origin_an_anchor_keeps_the_precision(rng: np.random.Generator) -> None:
    anchor = np.array([51_234.5, -20_000.25, 0.0])
    wall = box([1, 400, 400], (anchor + np.array([100.5, 0, 0])).tolist(), 0)
    directions = np.column_stack([np.ones(200), rng.uniform(-0.5, 0.5, (200, 2))]).astype(np.float32)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    hits = Tracer(wall, anchor_m=anchor).cast(anchor, directions)
    np.testing.assert_allclose(hits.range_m.astype(np.float64) * directions[:, 0], 100.0, atol=1e-4)


def test_sphere(rng: np.random.Generator) -> None:
    """Against the quadratic formula, away from the rim where the facets' sagitta counts."""
    centre, radius = np.array([8.0, 1.0, -0.5]), 0.5
    mesh = ellipsoid(centre.tolist(), [radius] * 3, 0, sides=300, rows=220)
    target = centre + 0.35 * rays(rng, 2000) * radius
    directions = (target / np.linalg.norm(target, axis=1, keepdims=True)).astype(np.float32)
    along = directions.astype(np.float64) @ centre
    exact = along - np.sqrt(radius**2 - (centre @ centre - along**2))
    hits = Tracer(mesh).cast(np.zeros(3), directions)
    np.testing.assert_allclose(hits.range_m, exact, atol=1e-4)


def test_turned_box_in_a_moved_frame(rng: np.random.Generator) -> None:
    """The whole chain of frames against the slab method in float64."""
    size, world_T_body = np.array([4.6, 1.9, 1.5]), pose_from_yaw(0.7, (60.0, 9.0, -0.4))
    world_T_common = pose_from_yaw(-0.2, (3.0, -2.0, 1.7))
    mesh = box(size.tolist(), [0, 0, 0], Material.SIGN)
    mesh = Mesh(mesh.vertices_m, mesh.faces, mesh.material, np.full(12, 50.0))
    body = Body(Tracer(mesh), world_T_body, 0)
    model = LidarModel(range_noise_m=0.0, weak_noise_m=0.0, dropout=0.0)
    scan = Scan.draw("gaussian", model, rng, origin_m=(0.1, -0.5, 0.0))
    result = sweep(scan, model, [body], world_T_common, rng)
    body_T_common = invert(world_T_body) @ world_T_common
    start = transform_points(body_T_common, scan.origin_m[None])[0]
    directions = scan.directions.reshape(-1, 3).astype(np.float64) @ body_T_common[:3, :3].T
    planes = np.stack([(sign * size / 2 - start) / directions for sign in (-1, 1)])
    enter, leave = planes.min(axis=0).max(axis=1), planes.max(axis=0).min(axis=1)
    exact = enter[enter < leave]
    got = np.linalg.norm(result.cloud.points_m.astype(np.float64) - scan.origin_m, axis=1)
    assert len(got) == len(exact) > 50
    np.testing.assert_allclose(got, exact, atol=1e-4)


def test_no_shot_at_a_body_is_left_out(rng: np.random.Generator) -> None:
    """The shots selected by a body's angles include every one that hits it, near or far."""
    scan = Scan.draw("gaussian", LidarModel(), rng, origin_m=(0, 0, 0))
    directions = scan.directions.reshape(-1, 3)
    for x, y, yaw, length in (
        (4, 3, 0.1, 16),
        (12, 0, 1.57, 12),
        (30, -8, 0.4, 4.5),
        (200, 20, 0.0, 4.5),
        (1, 4, 0.0, 18),
    ):
        tracer = Tracer(box([length, 2.5, 3.9], [0, 0, 1.95], 0))
        pose = pose_from_yaw(yaw, (float(x), float(y), -2.0))
        body = Body(tracer, pose, 0)
        inverse = invert(pose)
        start = transform_points(inverse, np.zeros((1, 3)))[0]
        hits = tracer.cast(start, directions @ inverse[:3, :3].T.astype(np.float32))
        shots, nearest = shots_towards(scan, body, np.eye(4))
        assert set(np.flatnonzero(hits.face >= 0)) <= set(shots)
        assert nearest <= hits.range_m.min() + 1e-3


def test_the_nearer_body_hides_the_farther_one(rng: np.random.Generator) -> None:
    model = LidarModel(dropout=0.0)

    def wall(x: int, actor: int) -> Body:
        mesh = box([0.1, 8, 8], [0, 0, 0], Material.CONCRETE)
        return Body(Tracer(mesh.painted(rng)), pose_from_yaw(0.0, (float(x), 0.0, 0.0)), actor)

    scan = Scan.draw("uniform", model, rng, origin_m=(0, 0, 0))
    for bodies in ([wall(30, 0), wall(20, 1)], [wall(20, 1), wall(30, 0)]):
        assert set(sweep(scan, model, bodies, np.eye(4), rng).actor) == {1}


def test_glass_lets_most_shots_through(rng: np.random.Generator) -> None:
    model = LidarModel(dropout=0.0, texture=0.0)
    pane = quads(np.array([[[10.0, -9, -9], [10, 9, -9], [10, 9, 9], [10, -9, 9]]]), int(Material.GLASS)).painted(rng)
    wall = box([0.1, 30, 30], [15, 0, 0], Material.CONCRETE).painted(rng)
    bodies = [Body(Tracer(pane), np.eye(4), 0), Body(Tracer(wall), np.eye(4), 1)]
    scan = Scan.draw("uniform", model, rng, origin_m=(0, 0, 0))
    result = sweep(scan, model, bodies, np.eye(4), rng)
    behind_pane = np.abs(result.cloud.points_m[:, 1] / result.cloud.points_m[:, 0]) < 0.85
    assert np.mean(result.actor[behind_pane] == 0) == pytest.approx(0.25, abs=0.02)


def test_missing_embreex_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "embreex.rtcore_scene", None)
    with pytest.raises(MissingExtraError, match=r"farfield\[simulate\]"):
        Tracer(box([1, 1, 1], [0, 0, 0], 0))
