"""Weather laid over radar cells: what lies above the floor fades by the loss there and back, the floor may rise."""

import numpy as np
import pytest

from farfield.simulation.overlay import floor_power, overlay_cells
from farfield.simulation.radar.model import RadarModel
from farfield.simulation.radar.propagation import rain_coefficients
from farfield.simulation.weather.conditions import Weather

RADAR = RadarModel()


def cells_at(*range_m: float) -> np.ndarray:
    return np.column_stack([range_m, np.zeros(len(range_m)), np.zeros(len(range_m))]).astype(np.float32)


def test_rain_takes_from_echoes_twice_its_loss_a_kilometre_and_nothing_from_noise(rng):
    """ITU-R P.838-3: k R^alpha dB/km; over 50 m there and back a tenth of it."""
    points, floor = cells_at(50.0, 50.0, 100.0), 10**10.91 / 1e13
    power = np.array([floor, floor * 1001, floor * 101], dtype=np.float32)
    k, alpha = rain_coefficients(76.5)
    rainy = overlay_cells(points, power, RADAR, Weather("rain", rain_mm_h=20.0), rng)
    loss_db = k * 20.0**alpha * 2 * np.array([0.05, 0.1])
    np.testing.assert_allclose(rainy[0], floor, rtol=1e-6)
    np.testing.assert_allclose(rainy[1:] - floor, floor * np.array([1000, 100]) * 10 ** (-loss_db / 10), rtol=1e-4)
    assert loss_db[0] > 0.8


def test_rime_on_the_radome_weakens_all_ranges_alike(rng):
    points, floor = cells_at(20.0, 60.0), 10**10.91 / 1e13
    icy = Weather(icing=0.3, icing_age_s=float("inf"), temperature_c=-3.0)
    left = overlay_cells(points, np.full(2, 101 * floor, np.float32), RADAR, icy, rng) / floor - 1
    assert left[0] == pytest.approx(left[1], rel=1e-4)
    assert 80 < left[0] < 99.9


def test_clear_air_leaves_every_cell(rng):
    power = rng.uniform(0.001, 1, 50).astype(np.float32)
    points = cells_at(*np.linspace(2, 110, 50))
    np.testing.assert_array_equal(overlay_cells(points, power, RADAR, Weather(), rng), power)


def test_a_floor_that_rises_by_3_db_doubles_on_average(rng):
    points = cells_at(*np.full(20_000, 50.0))
    floor = floor_power(np.array([50.0]), RADAR)[0]
    risen = overlay_cells(points, np.full(20_000, floor, np.float32), RADAR, Weather(), rng, floor_rise_db=3.0103)
    assert risen.mean() / floor == pytest.approx(2, rel=0.02)
    assert risen.std() / floor == pytest.approx(1 / np.sqrt(3), rel=0.05)


def test_the_floor_follows_the_receivers_response():
    np.testing.assert_allclose(10 * np.log10(floor_power(np.array([8.0, 50.0]), RADAR) * 1e13), [107.1, 109.1])
