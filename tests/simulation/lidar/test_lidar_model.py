"""The scan patterns and the detection law, against the published and computed figures they must reproduce."""

import dataclasses

import numpy as np
import pytest
from _validation_scenes import HERE, body, frozen, plate, quiet

from farfield.errors import ConfigError
from farfield.simulation.bodies.materials import Material, reflectance_at
from farfield.simulation.lidar.echoes import measure, reflectivity
from farfield.simulation.lidar.model import (
    LUMINAR_H2,
    OS1_128,
    OS1_128_BEAMS,
    OS2_64,
    OS2_64_BEAMS,
    OS2_128_BEAMS,
    LidarModel,
    detection_probability,
    line_elevations_deg,
    range_spread_m,
    signal,
)
from farfield.simulation.lidar.rays import Scan
from farfield.simulation.lidar.sweep import sweep
from farfield.vocabulary.patterns import PATTERNS

QUIET = dataclasses.replace(LUMINAR_H2, texture=0.0, dropout=0.0)
TRIMS = np.full(2, int(Material.TRIM))


def lines(pattern: str, count: int = 64) -> np.ndarray:
    return line_elevations_deg(pattern, lines=count, edge_deg=15.0, focus_deg=-2.0, sigma_deg=5.0)


def test_patterns_hold_the_shares_of_a_real_sister_sensor() -> None:
    """Real Luminar frames hold 0.31 / 0.68-0.70 / 0.955 of their points within 2 / 5 / 10 degrees."""
    elevation = lines("gaussian")
    assert len(elevation) == 64
    assert (np.diff(elevation) > 0).all()
    for reach, share in ((2, 0.31), (5, 0.68), (10, 0.955)):
        assert np.mean(np.abs(elevation + 2.0) < reach) == pytest.approx(share, abs=0.02)


def test_line_density_at_the_focus_is_2_4_times_the_uniform_one() -> None:
    gaussian, uniform = (lines(pattern, 6400) for pattern in PATTERNS)

    def density(elevation: np.ndarray, at_deg: float) -> int:
        return int((np.abs(elevation - at_deg) < 0.25).sum())

    assert density(gaussian, -2.0) / density(uniform, -2.0) == pytest.approx(2.40, abs=0.05)
    assert density(gaussian, 4.6) / density(uniform, 4.6) == pytest.approx(1.0, abs=0.05)
    assert density(gaussian, -8.6) / density(uniform, -8.6) == pytest.approx(1.0, abs=0.05)


def test_uniform_lines_are_0_476_degrees_apart() -> None:
    elevation = lines("uniform")
    np.testing.assert_allclose(np.diff(elevation), 30 / 63, rtol=1e-12)
    assert (elevation[0], elevation[-1]) == (-15.0, 15.0)


def test_ouster_beam_tables() -> None:
    """Published tables; below, rows of two units' calibrations (an OS2 and an OS1 with every second row)."""
    for beams, top, bottom, rows in ((OS1_128_BEAMS, 20.95, -21.82, 128), (OS2_128_BEAMS, 10.76, -11.09, 128)):
        assert (beams.elevation_deg[0], beams.elevation_deg[-1], len(beams.elevation_deg)) == (top, bottom, rows)
    assert (OS1_128_BEAMS.origin_m, OS2_128_BEAMS.origin_m) == (0.0158, 0.0138)
    unit_os2 = [10.16, 10.01, 9.82, 9.68, 9.51, 9.32, 9.17, 9.01, 8.84, 8.66, 8.5, 8.33, 8.15, 7.98, 7.81, 7.66]
    assert np.mean(np.diff(OS2_128_BEAMS.elevation_deg)) == pytest.approx(np.mean(np.diff(unit_os2)), abs=0.006)
    assert OS2_128_BEAMS.offset_deg[:4] == pytest.approx([2.05, 0.69, -0.69, -2.04], abs=0.04)
    unit_os2_every_second_row = [2.08, -0.69, 2.08, -0.69, 2.08, -0.68, 2.10, -0.67]
    assert OS2_64_BEAMS.offset_deg[:8] == pytest.approx(unit_os2_every_second_row, abs=0.03)
    unit_os1 = [-0.98, -1.67, -2.38, -3.07, -3.77, -4.49, -5.18, -5.89]  # every second row, near the horizon
    assert 2 * np.mean(np.diff(OS1_128_BEAMS.elevation_deg)) == pytest.approx(np.mean(np.diff(unit_os1)), abs=0.035)
    assert OS1_128_BEAMS.offset_deg[:4] == pytest.approx([4.23, 1.42, -1.40, -4.21], abs=0.03)


def test_an_ouster_looks_straight_ahead_at_the_reference_time(rng: np.random.Generator) -> None:
    for model, shots in ((OS2_64, 131_072), (OS1_128, 262_144)):
        scan = Scan.draw(model, rng)
        assert scan.shape[0] * scan.shape[1] == shots
        azimuth = np.degrees(np.arctan2(scan.directions[..., 1], scan.directions[..., 0]))
        ahead = np.abs(azimuth) < 0.1
        assert np.abs(scan.times_s[ahead]).max() < 0.1 * 4.4 / 360
        assert (scan.times_s.min(), scan.times_s.max()) == pytest.approx((-0.05, 0.05), abs=1e-4)
        left = np.abs(azimuth - 90) < 0.1
        assert scan.times_s[left].mean() == pytest.approx(-0.025, abs=2e-3)


def test_beam_rays_have_the_divergence(rng: np.random.Generator) -> None:
    """Weighted variance of the rays' angle in each direction is that of a Gaussian beam of 0.18 degrees (FWHM)."""
    scan = Scan.draw(OS1_128, rng)
    rays = np.moveaxis(scan.rays[:, :, ::16, ::64], 0, -1).astype(np.float64)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1.0, atol=2e-7)
    up = np.degrees(np.arcsin(rays[..., 2]) - np.arcsin(rays[:1, ..., 2]))
    variance = np.tensordot(scan.weights, up**2, axes=1)
    assert np.sqrt(variance.mean()) * 2.3548 == pytest.approx(0.18, rel=0.01)
    assert scan.weights.sum() == pytest.approx(1.0)


def test_luminar_lines_follow_one_another_from_the_top_down(rng: np.random.Generator) -> None:
    gaussian, uniform = (Scan.draw(LUMINAR_H2, rng, pattern=pattern) for pattern in PATTERNS)
    for scan in (gaussian, uniform):
        assert (np.diff(scan.times_s[:, 0]) < 0).all()
        assert len(np.unique(scan.times_s)) == 60_032
        assert np.abs(scan.times_s).max() < 0.05


def test_unknown_pattern_is_refused() -> None:
    with pytest.raises(ConfigError, match="gaussian, uniform; got 'spiral'"):
        Scan.draw(LUMINAR_H2, np.random.default_rng(0), pattern="spiral")


def test_shots_are_unit_vectors_in_the_field_of_view(rng: np.random.Generator) -> None:
    scan = Scan.draw(LUMINAR_H2, rng)
    shots = scan.directions.reshape(-1, 3).astype(np.float64)
    assert shots.shape == (64 * 938, 3)
    np.testing.assert_allclose(np.linalg.norm(shots, axis=1), 1.0, atol=1e-6)
    azimuth = np.degrees(np.arctan2(shots[:, 1], shots[:, 0]))
    assert np.abs(azimuth).max() < 60.25
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


def test_reference_ranges_of_all_sensors() -> None:
    """50 % at R_ref; at 1.2e-4 per m of extinction the Luminar's 245 m become 238 m; OS1 80 % over 10 % is sqrt(8)."""
    for model, range_m in ((LUMINAR_H2, 245.0), (OS2_64, 72.0), (OS1_128, 55.0)):
        strength, _ = signal(model, np.array([range_m, range_m * np.sqrt(8)]), np.ones(2), np.array([0.1, 0.8]), TRIMS)
        assert detection_probability(model, strength) == pytest.approx(0.5, abs=1e-9)
    strength, _ = signal(LUMINAR_H2, np.array([238.1]), np.ones(1), np.array([0.1]), TRIMS[:1], extinction_per_m=1.2e-4)
    assert detection_probability(LUMINAR_H2, strength)[0] == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize("model", [QUIET, LUMINAR_H2], ids=["law", "with dropout"])
def test_ten_per_cent_target_at_200_m_is_detected_nine_times_of_ten(
    model: LidarModel, rng: np.random.Generator
) -> None:
    """End to end: beams wholly on a plate, counted; the sensor as it is, and without its dropout of 1 %."""
    scan = Scan.draw(model, rng)
    target = frozen(body(plate(0.1, width_m=40, height_m=40), 200, 0, 0))
    result = sweep(scan, model, target, HERE, rng)
    inside = np.abs(np.moveaxis(scan.rays[1:] / scan.rays[0], 0, -1)).max(axis=(0, 3)) < 19.9 / 200
    every, ring, column = int(inside.sum()), result.cloud.extra["ring"], result.cloud.extra["column"]
    assert every > 1500
    assert inside[ring, column].sum() / every == pytest.approx(0.90, abs=0.02)


CAR_REAR = {"uniform": {50: 61, 100: 15, 200: 3.8}, "gaussian": {50: 145, 100: 35, 200: 8.6}}


@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("range_m", [50, 100, 200])
def test_points_on_a_car_rear(pattern: str, range_m: int, rng: np.random.Generator) -> None:
    """Shots whose middle meets 1.85 x 1.5 m at the focus: within 10 % of the count by solid angle."""
    counts = []
    mesh = plate(50.0)
    scans = [Scan.draw(QUIET, rng, pattern=pattern) for _ in range(3)]
    for index in range(12 * range_m // 50):
        z = np.tan(np.radians(-2.0)) * range_m + rng.uniform(-0.75, 0.75)
        window = frozen(body(mesh, range_m, rng.uniform(-3, 3), z))
        aimed = sweep(scans[index % 3], QUIET, window, HERE, rng).aimed
        assert aimed is not None
        counts.append(int(aimed[0]))
    assert np.mean(counts) == pytest.approx(CAR_REAR[pattern][range_m], rel=0.10)


def test_range_noise_follows_the_signal(rng: np.random.Generator) -> None:
    """sqrt(s0^2 + k^2 / S); the Ouster sheet's 3 cm at SNR 100 and 10 cm at 12, with the threshold at SNR 12."""
    n = 200_000
    for strength in (1.5, 144.0):
        back = measure(QUIET, np.full(n, 50.0, np.float32), np.full(n, strength, np.float32), rng)
        expected = np.sqrt(0.01**2 + 0.05**2 / strength)
        assert np.std(back.range_m - 50.0) == pytest.approx(expected, rel=0.02)
    for snr, spread in ((100, 0.03), (12, 0.10)):
        assert range_spread_m(OS1_128, np.array([snr / 12]))[0] == pytest.approx(spread, rel=0.2)


def test_dropout_and_intensity_steps(rng: np.random.Generator) -> None:
    window = frozen(body(plate(0.3, width_m=60, height_m=60), 10, 0, 0))
    result = sweep(Scan.draw(LUMINAR_H2, rng), LUMINAR_H2, window, HERE, rng)
    assert len(result.cloud) / 60_032 == pytest.approx(0.99, abs=0.002)
    steps = result.cloud.intensity.astype(np.float64) * 255
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-4)
    head_on = np.abs(result.cloud.points_m[:, 1:]).max(axis=1) < 0.6
    assert np.median(result.cloud.intensity[head_on]) == pytest.approx(0.3, abs=0.01)


def test_nothing_returns_from_beyond_or_too_near(rng: np.random.Generator) -> None:
    model = quiet(LUMINAR_H2)
    scan = Scan.draw(model, rng)
    for range_m, seen in ((0.5, False), (100.0, True), (349.0, True), (351.0, False)):
        window = frozen(body(plate(50.0, width_m=3, height_m=3), range_m, 0, 0))
        result = sweep(scan, model, window, HERE, rng)
        straight = np.abs(result.cloud.points_m[:, 1:]).max(axis=1, initial=0) < max(0.3, 0.004 * range_m)
        assert bool(len(result.cloud) and straight.any()) is seen


def test_reflectance_by_wavelength() -> None:
    """Snow is dark at 1550 nm and bright at 865 nm; asphalt and soil the other way round; paint alike."""
    material = np.array([Material.SNOW, Material.ASPHALT, Material.GRASS, Material.CAR_PAINT, Material.SIGN])
    drawn = np.array([0.12, 0.18, 0.30, 0.25, 20.0])
    np.testing.assert_allclose(reflectance_at(material, drawn, 1550), drawn)
    for wavelength_nm in (865, 905):
        np.testing.assert_allclose(reflectance_at(material, drawn, wavelength_nm), [0.85, 0.12, 0.55, 0.25, 20.0])
    with pytest.raises(ConfigError, match="got 1064 nm"):
        reflectance_at(material, drawn, 1064)


def test_reflectivity_scale() -> None:
    shown = reflectivity(np.array([0.0, 0.5, 1.0, 2.0, 1e6], dtype=np.float32))
    assert shown.tolist() == [0, 50, 100, 131, 255]
