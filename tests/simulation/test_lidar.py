"""The scan patterns and the detection law, against the published and computed figures they must reproduce."""

import dataclasses

import numpy as np
import pytest

from farfield.errors import ConfigError
from farfield.geometry.poses import pose_from_yaw
from farfield.simulation.lidar.model import (
    PATTERNS,
    LidarModel,
    Scan,
    detection_probability,
    line_elevations_deg,
    measure,
    signal,
)
from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import Mesh, box
from farfield.simulation.lidar.sweep import Body, sweep
from farfield.simulation.trace import Tracer

MODEL = LidarModel()
QUIET = dataclasses.replace(MODEL, texture=0.0, dropout=0.0)


def plate(reflectance: float, *, width_m: float = 1.85, height_m: float = 1.5) -> Mesh:
    mesh = box([0.01, width_m, height_m], [0, 0, 0], Material.TRIM)
    return dataclasses.replace(mesh, reflectance=np.full(len(mesh.faces), reflectance))


def test_patterns_hold_the_shares_of_a_real_sister_sensor() -> None:
    """Real Luminar frames hold 0.31 / 0.68-0.70 / 0.955 of their points within 2 / 5 / 10 degrees."""
    elevation = line_elevations_deg("gaussian", MODEL)
    assert len(elevation) == 64
    assert (np.diff(elevation) > 0).all()
    for reach, share in ((2, 0.31), (5, 0.68), (10, 0.955)):
        assert np.mean(np.abs(elevation - MODEL.focus_deg) < reach) == pytest.approx(share, abs=0.02)


def test_line_density_at_the_focus_is_2_4_times_the_uniform_one() -> None:
    fine = dataclasses.replace(MODEL, lines=6400)
    gaussian, uniform = (line_elevations_deg(pattern, fine) for pattern in PATTERNS)

    def density(lines: np.ndarray, at_deg: float) -> int:
        return int((np.abs(lines - at_deg) < 0.25).sum())

    assert density(gaussian, -2.0) / density(uniform, -2.0) == pytest.approx(2.40, abs=0.05)
    assert density(gaussian, 4.6) / density(uniform, 4.6) == pytest.approx(1.0, abs=0.05)
    assert density(gaussian, -8.6) / density(uniform, -8.6) == pytest.approx(1.0, abs=0.05)


def test_uniform_lines_are_0_476_degrees_apart() -> None:
    elevation = line_elevations_deg("uniform", MODEL)
    np.testing.assert_allclose(np.diff(elevation), 30 / 63, rtol=1e-12)
    assert (elevation[0], elevation[-1]) == (-15.0, 15.0)


def test_unknown_pattern_is_refused() -> None:
    with pytest.raises(ConfigError, match="gaussian, uniform; got 'spiral'"):
        line_elevations_deg("spiral", MODEL)


def test_shots_are_unit_vectors_in_the_field_of_view(rng: np.random.Generator) -> None:
    scan = Scan.draw("gaussian", MODEL, rng, origin_m=(0, 0, 0))
    shots = scan.directions.reshape(-1, 3).astype(np.float64)
    assert shots.shape == (64 * 938, 3)
    np.testing.assert_allclose(np.linalg.norm(shots, axis=1), 1.0, atol=1e-6)
    azimuth = np.degrees(np.arctan2(shots[:, 1], shots[:, 0]))
    assert np.abs(azimuth).max() < 60.1
    assert np.bincount(np.digitize(azimuth, [-30, 0, 30])) / len(shots) == pytest.approx(0.25, abs=0.001)


def test_detection_law_at_its_anchor_points() -> None:
    """0.9 at 200 m and 0.5 at 245 m for a 10 % target; the range of an 80 % target is sqrt(8) times as far."""
    ranges, rho = np.array([200.0, 245.0, 245.0 * np.sqrt(8)]), np.array([0.1, 0.1, 0.8])
    strength, _ = signal(QUIET, ranges, np.ones(3), rho, np.full(3, int(Material.TRIM)))
    chance = detection_probability(QUIET, strength)
    assert chance[0] == pytest.approx(0.90, abs=0.005)
    assert chance[1:] == pytest.approx(0.5, abs=1e-9)


def test_signal_falls_by_twenty_decibel_a_decade() -> None:
    strength, _ = signal(QUIET, np.array([10.0, 100.0]), np.ones(2), np.full(2, 0.3), np.zeros(2, dtype=np.int64))
    assert 10 * np.log10(strength[0] / strength[1]) == pytest.approx(20.0, abs=1e-9)


@pytest.mark.parametrize("model", [QUIET, MODEL], ids=["law", "with dropout"])
def test_ten_per_cent_target_at_200_m_is_detected_nine_times_of_ten(
    model: LidarModel, rng: np.random.Generator
) -> None:
    """End to end: rays at a plate, counted; the sensor as it is, and without its dropout of 1 %."""
    body = Body(Tracer(plate(0.1, width_m=40, height_m=40)), pose_from_yaw(0.0, (200.0, 0.0, 0.0)), 0)
    scan = Scan.draw("gaussian", model, rng, origin_m=(0, 0, 0))
    seen = len(sweep(scan, model, [body], np.eye(4), rng).cloud)
    certain = dataclasses.replace(body, tracer=Tracer(plate(50.0, width_m=40, height_m=40)))
    every = len(sweep(scan, QUIET, [certain], np.eye(4), rng).cloud)
    assert every > 1500
    assert seen / every == pytest.approx(0.90, abs=0.02)


CAR_REAR = {"uniform": {50: 61, 100: 15, 200: 3.8}, "gaussian": {50: 145, 100: 35, 200: 8.6}}


@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("range_m", [50, 100, 200])
def test_points_on_a_car_rear(pattern: str, range_m: int, rng: np.random.Generator) -> None:
    """Within 10 % of the count by solid angle for 1.85 x 1.5 m at the focus."""
    tracer, counts = Tracer(plate(50.0)), []
    for _ in range(30 * range_m // 50):
        z = np.tan(np.radians(MODEL.focus_deg)) * range_m + rng.uniform(-0.75, 0.75)
        body = Body(tracer, pose_from_yaw(0.0, (float(range_m), float(rng.uniform(-1, 1)), float(z))), 0)
        counts.append(
            len(sweep(Scan.draw(pattern, QUIET, rng, origin_m=(0, 0, 0)), QUIET, [body], np.eye(4), rng).cloud)
        )
    assert np.mean(counts) == pytest.approx(CAR_REAR[pattern][range_m], rel=0.10)


def test_range_noise_follows_the_signal(rng: np.random.Generator) -> None:
    """sqrt(s0^2 + k^2 / S) with s0 = 1 cm, k = 5 cm, at S = 1.5 (10 % at 200 m) and at a strong signal."""
    n = 200_000
    for distance, spread in ((200.0, np.hypot(0.01, 0.05 / np.sqrt(1.5006))), (20.0, np.hypot(0.01, 0.05 / 12.25))):
        ranges = np.full(n, distance, dtype=np.float32)
        one = np.ones(n, dtype=np.float32)
        back = measure(QUIET, ranges, one, np.full(n, 0.1), np.full(n, int(Material.TRIM)), rng)
        assert np.std(back.range_m - distance) == pytest.approx(spread, rel=0.02)


def test_dropout_and_intensity_steps(rng: np.random.Generator) -> None:
    n = 100_000
    near, one = np.full(n, 10.0, dtype=np.float32), np.ones(n, dtype=np.float32)
    back = measure(MODEL, near, one, np.full(n, 0.3), np.full(n, int(Material.TRIM)), rng)
    assert len(back.shot) / n == pytest.approx(0.99, abs=0.002)
    steps = back.intensity * 255
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    assert np.median(back.intensity) == pytest.approx(0.3, abs=0.005)


def test_nothing_returns_from_beyond_or_too_near(rng: np.random.Generator) -> None:
    ranges = np.array([0.5, 349.0, 351.0, np.inf], dtype=np.float32)
    back = measure(QUIET, ranges, np.ones(4, dtype=np.float32), np.full(4, 50.0), np.full(4, int(Material.SIGN)), rng)
    assert back.shot.tolist() == [1]
