"""Weather laid over sweeps and radar cells that were measured in other weather, and the bounds of its settings."""

from dataclasses import replace

import numpy as np
import pytest
from _validation_scenes import HERE, fleet

from farfield.errors import ConfigError
from farfield.simulation import find_preset
from farfield.simulation.lidar.air import SURFACE, beam_of
from farfield.simulation.lidar.model import HDL_64E, OS2_64, LidarModel, detection_probability
from farfield.simulation.lidar.rays import Scan
from farfield.simulation.lidar.sweep import sweep
from farfield.simulation.overlay import (
    LIDARS,
    OverlaidWeather,
    WindowEffect,
    empty_shots,
    floor_power,
    overlay,
    overlay_cells,
    preset_bounds,
)
from farfield.simulation.radar.model import RadarModel
from farfield.simulation.radar.propagation import rain_coefficients
from farfield.simulation.weather.backscatter import rain_drops, snow_flakes, strongest_particle
from farfield.simulation.weather.conditions import Weather

ICY = {"icing_age_s": float("inf"), "temperature_c": -3.0}


def laid_of(seed: int = 3, patches_deg=(15.0, 8.0), transmission=0.2, **weather) -> OverlaidWeather:
    return OverlaidWeather(Weather(**weather), np.random.SeedSequence(seed), "ice", patches_deg, transmission)


def wall_at(distance_m: float, count: int = 4000) -> np.ndarray:
    """Points ahead, all as far away."""
    azimuth = np.linspace(-0.6, 0.6, count)
    return (distance_m * np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=1)).astype(np.float32)


@pytest.mark.parametrize("distance_m", [10.0, 20.0])
def test_a_wall_behind_fog_fades_by_beer_and_lambert(rng, distance_m):
    """MOR 200 m: 2.996 / 200 per m at any wavelength (Kim's exponent is 0 there), less the clear air's 20 km."""
    points, intensity = wall_at(distance_m), np.full(4000, 0.9, dtype=np.float32)
    over = overlay(points, intensity, OS2_64, laid_of(condition="fog", mor_m=200.0), rng)
    clear = -np.log(0.05) / 20_000 * (865 / 550) ** -1.3
    assert over.survives.mean() > 0.999
    expected = np.exp(-2 * (-np.log(0.05) / 200 - clear) * distance_m)
    np.testing.assert_allclose(over.gain[over.survives], expected, rtol=1e-4)


def test_a_faint_wall_behind_fog_is_lost_and_fog_is_seen_in_its_place(rng):
    points = wall_at(150.0)
    over = overlay(points, np.full(4000, 0.5, dtype=np.float32), OS2_64, laid_of(condition="fog", mor_m=200.0), rng)
    assert not over.survives.any()
    assert len(over.points_m) > 0
    assert np.linalg.norm(over.points_m, axis=1).max() < 20


@pytest.mark.parametrize(("rain", "snow"), [(12.0, 0.0), (30.0, 0.0), (0.0, 4.0)])
def test_as_many_drops_and_flakes_come_back_as_their_law_says(rng, rain, snow):
    """Into the open every shot shows its strongest particle: the mean of the detection over that one's law."""
    laid = laid_of(condition="rain" if rain else "heavy_snow", rain_mm_h=rain, snow_mm_h=snow)
    over = overlay(np.zeros((0, 3), np.float32), np.zeros(0, np.float32), OS2_64, laid, rng)
    particles = rain_drops(rain, 865.0) if rain else snow_flakes(snow, 865.0)
    haze = -np.log(0.05) / 20_000 * (865 / 550) ** -1.3
    alpha = 3.64e-4 * rain**0.63 if rain else (5.42e-5 * 865 + 5.4958776) * snow**1.38 * np.log(10) / 1e4
    law = strongest_particle(particles, beam_of(OS2_64), alpha + haze)
    signal = np.geomspace(0.3, 1e4, 4000)
    stronger = 1 - np.exp(-np.array([law.count_above(value) for value in signal]))
    heard = detection_probability(OS2_64, signal) * (1 - OS2_64.dropout)
    middle = (heard[1:] + heard[:-1]) / 2
    expected = 64 * 2048 * float((middle * (stronger[:-1] - stronger[1:])).sum())
    assert len(over.points_m) == pytest.approx(expected, rel=0.03)
    assert expected > 1000
    reach = np.linalg.norm(over.points_m, axis=1)
    assert reach.min() > OS2_64.min_range_m - 1.0
    assert np.median(reach) < 20


def test_rain_in_the_way_of_a_wall_takes_points_and_leaves_drops(rng):
    counts = []
    for rate in (5.0, 30.0):
        laid = laid_of(condition="rain", rain_mm_h=rate)
        over = overlay(wall_at(60.0), np.full(4000, 0.1, dtype=np.float32), replace(OS2_64, columns=8), laid, rng)
        assert (np.linalg.norm(over.points_m, axis=1) < 60).all()
        counts.append((over.survives.mean(), len(over.points_m)))
    assert counts[1][0] < counts[0][0] < 1
    assert counts[1][1] > counts[0][1] > 0


@pytest.mark.parametrize("share", [0.1, 0.35])
def test_ice_blocks_that_share_of_the_windows_front(share):
    window = WindowEffect.draw(OS2_64, laid_of(icing=share, **ICY))
    azimuth, elevation = np.meshgrid(np.radians(np.arange(-179.75, 180, 0.5)), np.radians(np.arange(-10.8, 10.6, 0.25)))
    seen = np.column_stack([azimuth.ravel(), elevation.ravel()]).astype(np.float32)
    gain = window.gain(seen)
    np.testing.assert_allclose(np.unique(gain), [0.04, 1.0], rtol=1e-6)
    front = np.abs(seen[:, 0]) < np.radians(70.0)
    assert (gain[front] < 1).mean() == pytest.approx(share, abs=0.015)
    assert (gain[~front] == 1).all()
    ahead = (gain[front] < 1).reshape(azimuth.shape[0], -1).any(axis=0)
    assert ahead.mean() < 0.9  # whole sectors, not specks everywhere
    assert (gain == WindowEffect.draw(OS2_64, laid_of(icing=share, **ICY)).gain(seen)).all()
    assert (gain != WindowEffect.draw(OS2_64, laid_of(4, icing=share, **ICY)).gain(seen)).any()


def test_opaque_ice_takes_what_is_behind_it_and_nothing_else(rng):
    points = wall_at(30.0)
    laid = laid_of(transmission=1e-6, icing=0.3, **ICY)
    over = overlay(points, np.full(4000, 0.9, dtype=np.float32), OS2_64, laid, rng)
    offset = np.column_stack([np.arctan2(points[:, 1], points[:, 0]), np.zeros(4000)]).astype(np.float32)
    blocked = WindowEffect.draw(OS2_64, laid).gain(offset) < 1
    assert 0 < blocked.mean() < 1
    np.testing.assert_array_equal(over.survives, ~blocked)
    np.testing.assert_allclose(over.gain[~blocked], 1, rtol=1e-6)
    assert not len(over.points_m)


def test_the_sensors_place_is_where_directions_start(rng):
    laid, high = laid_of(transmission=1e-6, icing=0.3, **ICY), (-2.54, 0.3, 0.7)
    bright = np.full(4000, 0.9, dtype=np.float32)
    here = overlay(wall_at(30.0), bright, OS2_64, laid, np.random.default_rng(1))
    moved = overlay(
        wall_at(30.0) + np.array(high, np.float32), bright, OS2_64, laid, np.random.default_rng(1), origin_m=high
    )
    assert np.mean(here.survives == moved.survives) > 0.995  # but for rounding at the edges of patches
    wet = laid_of(condition="rain", rain_mm_h=20.0)
    drops = overlay(np.zeros((0, 3), np.float32), bright[:0], OS2_64, wet, rng, origin_m=(100.0, 0.0, 0.0)).points_m
    assert np.linalg.norm(drops - [100.0, 0, 0], axis=1).max() < 60


def test_clear_air_changes_nothing(rng):
    over = overlay(wall_at(80.0), np.full(4000, 0.02, dtype=np.float32), OS2_64, laid_of(), rng)
    assert over.survives.all()
    assert (over.gain == 1).all()
    assert not len(over.points_m)


@pytest.mark.parametrize("model", [OS2_64, HDL_64E], ids=lambda model: model.name)
def test_shots_without_a_point_are_those_that_the_points_leave(rng, model):
    scan = Scan.draw(model, rng)
    shots = scan.directions.reshape(-1, 3)
    met = rng.permutation(len(shots))[: len(shots) // 2]
    seen = np.column_stack([np.arctan2(shots[:, 1], shots[:, 0]), np.arcsin(shots[:, 2])]).astype(np.float32)
    empty = empty_shots(seen[met], model, rng)
    assert len(empty) == len(shots) - len(met)
    rest = np.delete(seen, met, axis=0)
    rows = [np.column_stack([np.rint(part[:, 1] * 1e4), np.rint(np.cos(part[:, 0]) * 1e3)]) for part in (empty, rest)]
    ordered = [part[np.lexsort(part.T)] for part in rows]
    assert np.abs(ordered[0] - ordered[1]).max() <= 1


def test_a_sensor_that_draws_lines_lacks_as_many_shots_as_are_missing(rng):
    seen = np.radians(rng.uniform([-60, -15], [60, 15], (20_000, 2))).astype(np.float32)
    empty = empty_shots(seen, LidarModel(), rng)
    assert len(empty) == 64 * 938 - 20_000
    assert np.abs(np.degrees(empty)).max() <= 60


def test_sensors_have_their_names():
    assert {name: model.name for name, model in LIDARS.items()} == {name: name for name in LIDARS}
    assert set(LIDARS) == {"luminar-h2", "os2-64", "os1-128", "hdl-64e"}


@pytest.mark.parametrize(
    "weather",
    [
        Weather("fog", mor_m=400.0),
        Weather("rain", rain_mm_h=20.0),
        Weather("heavy_snow", snow_mm_h=3.0, icing=0.4, icing_age_s=1e6),
        Weather("sleet", rain_mm_h=1.0, snow_mm_h=2.5, wet_snow=True, icing=0.7, icing_age_s=1e6),
    ],
    ids=lambda weather: weather.condition,
)
def test_a_clear_sweep_in_laid_weather_is_like_one_that_was_simulated_in_it(rng, weather):
    """The same cars, the same window: hits on them and returns of the air agree."""
    window, seed = fleet(rng), np.random.SeedSequence(9)
    scan = Scan.draw(OS2_64, rng)
    clear, there = (
        sweep(scan, OS2_64, window, HERE, np.random.default_rng(3), weather=each, window_seed=seed)
        for each in (Weather(), weather)
    )
    laid = OverlaidWeather(weather, seed, "ice" if weather.snow_mm_h else "drop", (8.0, 4.0), 0.05)
    over = overlay(clear.cloud.points_m, clear.cloud.intensity, OS2_64, laid, rng)
    assert (clear.actor[over.survives] >= 0).sum() == pytest.approx((there.actor >= 0).sum(), rel=0.03)
    assert len(over.points_m) == pytest.approx((there.kind != SURFACE).sum(), rel=0.03)
    assert over.survives.sum() == pytest.approx((there.kind == SURFACE).sum(), rel=0.03)
    own = there.cloud.intensity[there.kind == SURFACE].mean()
    assert (clear.cloud.intensity * over.gain)[over.survives].mean() == pytest.approx(own, rel=0.05)
    air = np.linalg.norm(there.cloud.points_m[there.kind != SURFACE], axis=1)
    assert np.median(np.linalg.norm(over.points_m, axis=1)) == pytest.approx(np.median(air), rel=0.05)


def test_leaving_out_weak_particles_changes_no_strong_one(rng):
    law = strongest_particle(snow_flakes(2.0, 865.0), beam_of(OS2_64), 0.005)
    uniform = np.append(rng.random(100_000), [0.0, 1 - 1e-16])
    everything, strong = law.strength(uniform), law.strength(uniform, least=0.1)
    np.testing.assert_array_equal(np.where(everything > 0.1, everything, 0), np.where(strong > 0.1, strong, 0))
    assert 0 < np.count_nonzero(strong) < np.count_nonzero(everything)


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


def test_bounds_hold_what_the_conditions_are_written_with():
    bounds = preset_bounds()
    assert bounds["coverage"]["sleet"][1] == pytest.approx(0.75)
    assert bounds["coverage"]["heavy_snow"][1] == pytest.approx(0.60)
    assert bounds["coverage"]["sleet"][0] == pytest.approx(0.75 * (1 - 1 / 2.71828), abs=0.02)
    assert [bounds["coverage"][name][1] for name in ("fog", "rain", "light_snow")] == pytest.approx([0.02, 0.03, 0.05])
    assert bounds["snow_mm_h"]["sleet"] == pytest.approx((1.5, 3.5), abs=0.02)
    assert bounds["rain_mm_h"]["rain"] == pytest.approx((2, 10), rel=0.02)
    assert bounds["fog_m"] == {"fog": pytest.approx((400, 1000), rel=0.02)}
    assert "normal" not in bounds["film_mm"]


def test_sequences_take_weathers_in_turn():
    conditions = [each.condition for each in find_preset("kradar-sim", weather="sleet,heavy_snow").segments]
    assert conditions == ["sleet", "heavy_snow"] * (len(conditions) // 2)
    assert {each.condition for each in find_preset("kradar-sim", weather="sleet").segments} == {"sleet"}
    plain = [each.condition for each in find_preset("kradar-sim").segments]
    assert len(set(plain)) == 7
    with pytest.raises(ConfigError, match="hail"):
        find_preset("kradar-sim", weather="sleet,hail")
