"""Left-hand traffic: the mirror image of a road and its traffic, in every layout."""

import json

import numpy as np
import pytest

pytest.importorskip("embreex")

from farfield.datasets import open_dataset
from farfield.errors import ConfigError
from farfield.simulation import find_preset
from farfield.simulation.recording import record
from farfield.simulation.world.scene import ROADS, WorldScene

WITHOUT_LANES = {"parking_lot"}


def scene(road: str, side: str) -> WorldScene:
    return WorldScene(road, np.random.SeedSequence(4), duration_s=6.0, traffic=side)


def oncoming_m(world: WorldScene) -> list[float]:
    """How far to the left of the ego vehicle's course those pass that come towards it."""
    window = world.window(3.0, reach_m=200.0)
    here = window.world_T_ego_now
    speed = window.velocity_m_s @ here[:3, 0]
    offset = (window.bottom_m - here[:3, 3]) @ here[:3, 1]
    ahead = (window.bottom_m - here[:3, 3]) @ here[:3, 0]
    vehicles = np.array([actor.label in ("vehicle", "large_vehicle") for actor in window.actors], dtype=bool)
    return [float(each) for each in offset[vehicles & (speed < -3.0) & (ahead < 80.0)]]


@pytest.mark.parametrize("road", ROADS)
def test_a_road_on_the_left_is_the_mirror_image(road: str) -> None:
    """Every road user and every ray's hit, at the float32 of the ray caster."""
    right, left = scene(road, "right"), scene(road, "left")
    one, other = right.window(3.0, half_span_s=0.05), left.window(3.0, half_span_s=0.05)
    np.testing.assert_allclose(other.bottom_m, one.bottom_m * [1, -1, 1], atol=1e-9)
    np.testing.assert_allclose(np.sin(other.yaw_rad), -np.sin(one.yaw_rad), atol=1e-9)
    np.testing.assert_allclose(other.velocity_m_s, one.velocity_m_s * [1, -1, 1], atol=1e-9)
    rng = np.random.default_rng(0)
    azimuth, elevation = rng.uniform(-1.5, 1.5, 500), rng.uniform(-0.3, 0.1, 500)
    rays = np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], 1)
    ranges = []
    for window, flip in ((one, 1.0), (other, -1.0)):
        origin = window.world_T_ego_now[:3, 3] + [0.0, 0.0, 1.8]
        ranges.append(window.bodies[0].tracer.cast(origin, rays * [1.0, flip, 1.0]).range_m)
    hit = np.isfinite(ranges[0]) & np.isfinite(ranges[1])
    assert hit.sum() > 100
    assert (np.isfinite(ranges[0]) == np.isfinite(ranges[1])).mean() > 0.99
    assert np.quantile(np.abs(ranges[0][hit] - ranges[1][hit]), 0.98) < 0.01


def test_those_who_come_towards_pass_on_the_other_side() -> None:
    roads = ("urban", "suburban", "mountain")
    found = {side: np.concatenate([oncoming_m(scene(road, side)) for road in roads]) for side in ("right", "left")}
    assert len(found["right"]) >= 3
    assert np.median(found["right"]) > 2.0
    assert np.median(found["left"]) < -2.0


@pytest.mark.parametrize(
    ("preset", "sensors", "cloud", "apart_m"),
    [
        ("cirrus-sim-mini", "gaussian", "gaussian", 0.6),
        ("kradar-sim-mini", "os2-64", "os2-64", 0.6),
        ("kitti-sim-mini", "lidar", "lidar", 0.6),
        ("radiate-sim-mini", "polar", "radar", 3.0),
    ],
)
def test_every_layout_takes_it(preset: str, sensors: str, cloud: str, apart_m: float, tmp_path) -> None:
    """The annotated road users of a written frame stand mirrored; a folder of the other side is refused.

    Noise is another, so that a box of visible points is not quite the same; a turning radar still turns clockwise, and
    sees what moves up to 0.19 s sooner or later on the other side.
    """
    said = {}
    for side in ("right", "left"):
        out = tmp_path / side
        record(preset, out, frames=1, sequences=1, sensors=sensors, traffic=side, workers=1)
        frame = open_dataset(out)[0]
        assert len(frame.cloud(cloud)) > 100
        said[side] = frame.annotation.boxes
        stored = json.loads((out / "simulation.json").read_text())["preset"]
        assert stored.get("traffic", "right") == side
    centres = {side: boxes.centre_m[:, :2] for side, boxes in said.items()}
    mirrored = centres["right"] * [1.0, -1.0]
    gaps = [np.hypot(*(centres["left"] - place).T).min(initial=np.inf) for place in mirrored]
    assert len(gaps) > 0
    assert np.median(gaps) < apart_m
    with pytest.raises(Exception, match=r"differs in: preset"):
        record(preset, tmp_path / "left", frames=1, sequences=1, sensors=sensors, traffic="right", workers=1)


def test_another_side_is_refused_and_the_right_says_nothing_new() -> None:
    with pytest.raises(ConfigError, match=r"right, left.*middle"):
        find_preset("cirrus-sim", traffic="middle")
    with pytest.raises(ConfigError, match="middle"):
        WorldScene("urban", np.random.SeedSequence(1), duration_s=5.0, traffic="middle")
    assert "traffic" not in find_preset("cirrus-sim").as_json()
    assert find_preset("cirrus-sim", traffic="left").as_json()["traffic"] == "left"


def test_drivers_sit_on_the_other_side_in_the_newer_world() -> None:
    """The older world's bodies stay as they were."""
    for world, flip in (("v2", 1.0), ("v3", -1.0)):
        right, left = (
            WorldScene("urban", np.random.SeedSequence(4), duration_s=6.0, traffic=side, world=world).window(3.0)
            for side in ("right", "left")
        )
        users = [(a.tracer.mesh, b.tracer.mesh) for a, b in zip(right.bodies, left.bodies, strict=True) if a.actor >= 0]
        assert len(users) > 5
        for one, other in users:
            np.testing.assert_array_equal(other.vertices_m, one.vertices_m * [1.0, flip, 1.0])
