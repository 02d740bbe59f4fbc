"""Losses and cross sections against the recommendations and the published figures."""

import numpy as np
import pytest

from farfield.simulation.bodies.actors import Actor
from farfield.simulation.bodies.materials import Material
from farfield.simulation.radar.model import RadarModel
from farfield.simulation.radar.propagation import (
    film_loss_db,
    fog_coefficient,
    fog_loss_db_km,
    rain_clutter,
    rain_coefficients,
    rain_loss_db_km,
    rain_reflectivity_m2_m3,
    two_way_loss_db,
    water_permittivity,
)
from farfield.simulation.radar.rcs import (
    corner_reflector_m2,
    mean_rcs_dbsm,
    near_range_dbsm,
    slow_db,
    surface_rcs_m2_m2,
    vehicle_pattern_dbsm,
)
from farfield.simulation.weather.conditions import Weather, draw_weather
from farfield.vocabulary.conditions import WEATHERS

MODEL = RadarModel()
RAIN = Weather("rain", rain_mm_h=10.0)


@pytest.mark.parametrize(
    ("ghz", "polarisation", "k", "alpha"),
    [(77.0, "h", 1.1320, 0.7177), (77.0, "v", 1.1276, 0.7073), (76.5, "h", 1.1253, 0.7188), (76.5, "v", 1.1208, 0.7082),
     (10.0, "h", 0.01217, 1.2571), (100.0, "h", 1.3671, 0.6815)],
)  # fmt: skip
def test_rain_coefficients_of_p838(ghz, polarisation, k, alpha):
    assert rain_coefficients(ghz, polarisation) == pytest.approx((k, alpha), rel=1e-3)


def test_a_target_at_100_m_in_25_mm_h_loses_2_28_db():
    assert 2 * rain_loss_db_km(25.0, 77.0) * 0.1 == pytest.approx(2.28, abs=0.01)
    assert rain_loss_db_km(0.0, 77.0) == 0.0


@pytest.mark.parametrize(("temperature_c", "coefficient"), [(0.0, 3.54), (10.0, 3.15), (20.0, 2.71)])
def test_fog_coefficient_of_p840_at_77_ghz(temperature_c, coefficient):
    assert fog_coefficient(77.0, temperature_c) == pytest.approx(coefficient, abs=0.01)


def test_fog_of_the_data_set_costs_next_to_nothing():
    assert fog_loss_db_km(300.0, 77.0, 10.0) == pytest.approx(0.05 * 3.15, rel=0.01)
    assert fog_loss_db_km(50.0, 77.0, 10.0) == pytest.approx(0.5 * 3.15, rel=0.01)
    assert fog_loss_db_km(20_000.0, 77.0, 10.0) == 0.0


@pytest.mark.parametrize(("thickness_mm", "cold", "cool"), [(0.05, 2.8, 3.7), (0.1, 5.0, 6.2), (0.2, 7.9, 9.5)])
def test_water_films_on_a_radome(thickness_mm, cold, cool):
    """Published one-way losses at 0 and 10 degrees; the models of water differ by 0.3 dB near freezing."""
    losses = [film_loss_db(thickness_mm, water_permittivity(76.5, t), 76.5e9) for t in (0.0, 10.0)]
    assert losses[0] == pytest.approx(cold, abs=0.3)
    assert losses[1] == pytest.approx(cool, abs=0.1)


def test_ice_passes_and_wet_snow_does_less():
    ice = complex(3.17, -0.005)
    assert film_loss_db(1.0, ice, 76.5e9) == pytest.approx(0.2, abs=0.1)
    assert film_loss_db(3.0, ice, 76.5e9) == pytest.approx(0.9, abs=0.1)
    dry, water = 1.6 ** (1 / 3), water_permittivity(76.5, 0.0) ** (1 / 3)
    slush = complex((0.9 * dry + 0.1 * water) ** 3)  # Looyenga's mixture
    assert film_loss_db(1.0, slush, 76.5e9) == pytest.approx(1.9, abs=0.2)
    assert film_loss_db(3.0, slush, 76.5e9) == pytest.approx(5.4, abs=0.3)


def test_a_quarter_wave_film_without_loss_reflects_as_fresnel_says():
    index = 2.0
    thickness_mm = 1e3 * MODEL.wavelength_m / (4 * index)
    reflected = ((1 - index**2) / (1 + index**2)) ** 2
    assert film_loss_db(thickness_mm, complex(index**2), 76.5e9) == pytest.approx(
        -10 * np.log10(1 - reflected), abs=1e-6
    )


@pytest.mark.parametrize("condition", WEATHERS)
def test_no_weather_costs_the_radar_3_db(condition, rng):
    range_m = np.array([20.0, 50.0, 70.0])
    clear = two_way_loss_db(range_m, Weather(), MODEL)
    for _ in range(40):
        weather = draw_weather(condition, "day", rng)
        change = two_way_loss_db(range_m, weather, MODEL, time_s=60.0) - clear
        assert -0.01 <= change.min() <= change.max() < 3.0


def test_melting_flakes_cost_twice_their_water():
    sleet = Weather("sleet", snow_mm_h=4.0, rain_mm_h=1.0, wet_snow=True)
    rain = Weather("rain", rain_mm_h=5.0)
    far = np.array([1000.0])
    clear, wet, melting = (float(two_way_loss_db(far, w, MODEL)[0]) for w in (Weather(), rain, sleet))
    assert melting - clear == pytest.approx(2 * (wet - clear), rel=1e-6)


def test_rain_clutter_adds_up_to_its_reflectivity(rng):
    """The volume's mean cross section is eta V; no rain, no clutter."""
    draws = [rain_clutter(RAIN, MODEL, np.array([10.0, 0.0, 0.0]), rng) for _ in range(40)]
    low, high = np.radians([18.0, 53.0])
    near, far = 2 * MODEL.axes.range_step_m, MODEL.clutter_reach_m
    volume = (far**3 - near**3) / 3 * 2 * high * 2 * np.sin(low)
    total = np.mean([drawn.rcs_m2.sum() for drawn in draws])
    assert rain_reflectivity_m2_m3(RAIN) == pytest.approx(6.4e-4)
    assert total == pytest.approx(6.4e-4 * volume, rel=0.1)
    ahead = np.concatenate([drawn.velocity_m_s[np.abs(drawn.azimuth_rad) < 0.2] for drawn in draws])
    assert ahead.mean() == pytest.approx(-9.8, abs=0.3)
    assert 1.2 < ahead.std() < 2.2
    assert len(rain_clutter(Weather(), MODEL, np.zeros(3), rng)) == 0


def test_corner_reflector():
    assert corner_reflector_m2(0.1, 0.0039) == pytest.approx(4 * np.pi * 1e-4 / (3 * 0.0039**2))
    assert 10 * np.log10(corner_reflector_m2(0.1, MODEL.wavelength_m)) == pytest.approx(14.4, abs=0.1)


def test_car_pattern_of_3gpp():
    """Front 15.5, rear 14.6, sides 20.75 dBsm; 3 dB less half a lobe off; 7 dBsm between lobes."""
    found = vehicle_pattern_dbsm(np.radians([0.0, 180.0, 90.0, -90.0, 20.25, 90.0 + 13.45, 55.0]))
    assert found == pytest.approx([15.5, 14.6, 20.75, 20.75, 12.5, 17.75, 7.1], abs=0.06)


def test_near_cars_are_lit_in_part():
    assert near_range_dbsm(np.array([1.0, 10.0, 31.7, 100.0])) == pytest.approx([5.0, 15.0, 20.0, 20.0], abs=0.02)


def actor(kind: str, size: tuple[float, float, float], key: int = 1) -> Actor:
    return Actor(1, kind, size, np.random.SeedSequence(key))


def test_classes_differ_as_published():
    car, truck = actor("sedan", (4.8, 1.9, 1.5)), actor("semi", (15.5, 2.6, 3.9))
    assert mean_rcs_dbsm(car, 0.0, 60.0) == pytest.approx(15.5)
    assert mean_rcs_dbsm(car, np.pi / 2, 10.0) == pytest.approx(15.0)
    assert 6.0 <= mean_rcs_dbsm(truck, 0.0, 60.0) - 15.5 <= 10.0
    assert mean_rcs_dbsm(actor("pedestrian", (0.7, 0.6, 1.75)), 0.3, 30.0) == -6.0
    rider = actor("cyclist", (1.7, 0.6, 1.7))
    assert [mean_rcs_dbsm(rider, a, 30.0) for a in (0.0, np.pi / 2, np.pi)] == pytest.approx([-1.6, 1.9, -1.6])


def test_individuals_keep_their_level_and_spread_as_3gpp_says():
    levels = [slow_db(actor("sedan", (4.8, 1.9, 1.5), key)) for key in range(400)]
    assert levels[7] == slow_db(actor("sedan", (4.8, 1.9, 1.5), 7))
    assert np.mean(levels) == pytest.approx(0.0, abs=0.5)
    assert np.std(levels) == pytest.approx(3.41, rel=0.1)


def grazing_db(material: int, degrees: float, weather: Weather) -> float:
    cosine = np.sin(np.radians([degrees]))
    return float(10 * np.log10(surface_rcs_m2_m2(np.array([material]), cosine, weather))[0])


def test_roads_by_grazing_angle_and_weather():
    dry = [grazing_db(Material.ASPHALT, angle, Weather()) for angle in (2.0, 10.0)]
    assert dry == pytest.approx([-30.0, -20.0], abs=0.1)
    assert grazing_db(Material.ASPHALT, 10.0, Weather("rain", water_mm=0.8)) == pytest.approx(-25.0, abs=0.1)
    assert -20 < grazing_db(Material.ASPHALT, 10.0, Weather("heavy_snow", snow_cover=1.0)) < -15
    assert grazing_db(Material.GRASS, 10.0, Weather()) == pytest.approx(-12.0, abs=0.1)


def test_a_wall_gives_its_specular_glint():
    """A wall of a building seen square on: 20 to 30 dBsm from 20 m (the glint's area times sigma_0)."""
    offset = np.linspace(0.0, 10.0, 4000)
    cosine = 20.0 / np.hypot(20.0, offset)
    brick = surface_rcs_m2_m2(np.full(len(offset), int(Material.BRICK)), cosine, Weather())
    total = np.sum(brick * 2 * np.pi * offset) * (offset[1] - offset[0])
    assert 18 < 10 * np.log10(total) < 30


def test_unknown_materials_get_a_default():
    assert np.isfinite(surface_rcs_m2_m2(np.array([99]), np.array([0.5]), Weather())).all()
