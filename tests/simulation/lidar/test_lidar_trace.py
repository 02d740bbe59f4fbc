"""Ray hits against analytic planes, spheres and boxes; what stands in front hides what is behind."""

import sys

import numpy as np
import pytest
from _validation_scenes import HERE, body, coloured, frozen, quiet

from farfield.errors import MissingExtraError
from farfield.geometry.poses import invert, pose_from_yaw
from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import box, ellipsoid, quads
from farfield.simulation.lidar.model import LUMINAR_H2, OS2_64, LidarModel
from farfield.simulation.lidar.rays import Scan, SensorPath, block_towards
from farfield.simulation.lidar.sweep import sweep
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
    """The whole chain of frames against the slab method in float64, one ray a beam."""
    size = np.array([4.6, 1.9, 1.5])
    target = body(coloured(box(size.tolist(), [0, 0, 0], Material.SIGN), 50.0), 60, 9, -0.4, yaw_rad=0.7)
    mount = pose_from_yaw(-0.2, (3.0, -2.0, 1.7))
    model = quiet(LUMINAR_H2, sub_rays=1)
    scan = Scan.draw(model, rng)
    result = sweep(scan, model, frozen(target), mount, rng)
    body_T_sensor = invert(target.world_T_body[0]) @ mount
    start = body_T_sensor[:3, 3]
    directions = scan.directions.reshape(-1, 3).astype(np.float64) @ body_T_sensor[:3, :3].T
    planes = np.stack([(sign * size / 2 - start) / directions for sign in (-1, 1)])
    enter, leave = planes.min(axis=0).max(axis=1), planes.max(axis=0).min(axis=1)
    exact = enter[enter < leave]
    got = np.linalg.norm(result.cloud.points_m.astype(np.float64), axis=1)
    assert len(got) == len(exact) > 50
    np.testing.assert_allclose(got, exact, atol=1e-4)


@pytest.mark.parametrize("model", [LUMINAR_H2, OS2_64], ids=lambda model: model.name)
def test_no_shot_at_a_body_is_left_out(model: LidarModel, rng: np.random.Generator) -> None:
    """The shots selected by a body's angles include every one of which a ray hits it: near, far, behind, tilted."""
    scan = Scan.draw(model, rng)
    tilt = np.eye(4)
    tilt[:3, :3] = [[np.cos(0.03), 0, np.sin(0.03)], [0, 1, 0], [-np.sin(0.03), 0, np.cos(0.03)]]
    for x, y, yaw, length in (
        (4, 3, 0.1, 16),
        (12, 0, 1.57, 12),
        (-30, 0.5, 0.4, 4.5),
        (200, 20, 0, 4.5),
        (1, 4, 0, 18),
    ):
        target = body(box([length, 2.5, 3.9], [0, 0, 1.95], 0), x, y, -2.0, yaw_rad=float(yaw))
        inverse = invert(target.world_T_body[0]) @ tilt
        rays = np.moveaxis(scan.rays, 0, -1).reshape(-1, 3) @ inverse[:3, :3].T.astype(np.float32)
        hits = target.tracer.cast(inverse[:3, 3], rays)
        block = block_towards(scan, target, SensorPath.towards(target, tilt[None], np.zeros(1)))
        struck = np.unique(np.flatnonzero(hits.face >= 0) % (scan.shape[0] * scan.shape[1]))
        assert set(struck) <= set(block.shots())
        assert struck.size == 0 or block.nearest_m <= hits.range_m.min() + 1e-3
        assert x < 30 or len(block.shots()) < 25 * struck.size


def test_the_nearer_body_hides_the_farther_one(rng: np.random.Generator) -> None:
    model = quiet(LUMINAR_H2)
    mesh = box([0.1, 8, 8], [0, 0, 0], Material.CONCRETE).painted(rng)
    far, near = body(mesh, 30, 0, 0, actor=0), body(coloured(box([0.1, 12, 12], [0, 0, 0], 1), 0.3), 20, 0, 0, actor=1)
    scan = Scan.draw(model, rng, pattern="uniform")
    for bodies in ([far, near], [near, far]):
        assert set(sweep(scan, model, frozen(*bodies), HERE, rng).actor) == {1}


def test_glass_lets_most_shots_through(rng: np.random.Generator) -> None:
    model = quiet(LUMINAR_H2)
    pane = quads(np.array([[[10.0, -9, -9], [10, 9, -9], [10, 9, 9], [10, -9, 9]]]), int(Material.GLASS)).painted(rng)
    wall = box([0.1, 30, 30], [15, 0, 0], Material.CONCRETE).painted(rng)
    window = frozen(body(pane, 0, 0, 0, actor=0), body(wall, 0, 0, 0, actor=1))
    result = sweep(Scan.draw(model, rng, pattern="uniform"), model, window, HERE, rng)
    behind_pane = np.abs(result.cloud.points_m[:, 1] / result.cloud.points_m[:, 0]) < 0.85
    assert np.mean(result.actor[behind_pane] == 0) == pytest.approx(0.25, abs=0.02)


def test_missing_embreex_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "embreex.rtcore_scene", None)
    with pytest.raises(MissingExtraError, match=r"\[simulate\]"):
        Tracer(box([1, 1, 1], [0, 0, 0], 0))
