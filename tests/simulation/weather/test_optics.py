"""Extinction and backscatter against Koschmieder, Mie sums, ITU-R P.1817 and the lidar ratio of clouds."""

import numpy as np
import pytest

from farfield.simulation.weather.backscatter import (
    Beam,
    Particles,
    rain_drops,
    snow_flakes,
    soft_echo,
    strongest_particle,
)
from farfield.simulation.weather.conditions import draw_weather
from farfield.simulation.weather.optics import (
    extinction_per_m,
    film_transmission,
    haze_extinction_per_m,
    kim_exponent,
    rain_backscatter_per_extinction,
    rain_extinction_per_m,
    snow_extinction_per_m,
)
from farfield.vocabulary.conditions import WEATHERS

OS2 = Beam(865.0, 72.0, float(np.radians(0.1)))
REFERENCE = Beam(865.0, 72.0, float(np.radians(0.1)), overlap_m=(1.0, 3.0), overlap_power=1.0)


def test_contrast_is_5_per_cent_at_the_optical_range() -> None:
    for mor_m in (50.0, 300.0, 20_000.0):
        assert np.exp(-haze_extinction_per_m(mor_m, 550.0) * mor_m) == pytest.approx(0.05)


def test_kim_exponent() -> None:
    assert [kim_exponent(v) for v in (300, 700, 3000, 20_000, 60_000)] == pytest.approx([0, 0.2, 0.82, 1.3, 1.6])
    assert haze_extinction_per_m(200.0, 865.0) == haze_extinction_per_m(200.0, 1550.0)
    assert haze_extinction_per_m(15_300.0, 865.0) == pytest.approx(1.1e-4, rel=0.05)


def test_rain_extinction() -> None:
    """Mie sums over Marshall and Palmer's drops."""
    for rate, alpha in ((1, 3.64e-4), (2.5, 6.50e-4), (10, 1.56e-3), (25, 2.78e-3), (50, 4.29e-3)):
        assert rain_extinction_per_m(rate) == pytest.approx(alpha, rel=0.05)
        assert rain_drops(float(rate), 865.0).extinction_per_m == pytest.approx(alpha, rel=0.05)


def test_snow_extinction() -> None:
    """ITU-R P.1817 at 1, 2, 3 mm/h, and Marshall and Gunn's flakes as spheres."""
    dry = [snow_extinction_per_m(rate, 865.0, wet=False) for rate in (1, 2, 3)]
    wet = [snow_extinction_per_m(rate, 865.0, wet=True) for rate in (1, 2, 3)]
    assert dry == pytest.approx([1.3e-3, 3.3e-3, 5.9e-3], rel=0.03)
    assert wet == pytest.approx([0.9e-3, 1.5e-3, 2.0e-3], rel=0.04)
    for rate, alpha in ((0.5, 9.8e-4), (1, 1.45e-3), (2, 2.15e-3), (3, 2.7e-3)):
        assert snow_flakes(float(rate), 865.0).extinction_per_m == pytest.approx(alpha, rel=0.03)


def test_water_film() -> None:
    """0.1 mm costs 15 % both ways at 1550 nm and 0.2 % at 905 nm; 0.5 mm costs 55 %."""
    assert 1 - film_transmission(0.1, 1550.0) ** 2 == pytest.approx(0.15, abs=0.005)
    assert 1 - film_transmission(0.1, 905.0) ** 2 == pytest.approx(0.0016, abs=0.0005)
    assert 1 - film_transmission(0.5, 1550.0) ** 2 == pytest.approx(0.55, abs=0.005)


def test_conditions_lie_within_their_table() -> None:
    """Extinction at 865 nm of each condition, per m."""
    bounds = {
        "normal": (0.5e-4, 2e-4),
        "overcast": (0.5e-4, 2e-4),
        "fog": (2.3e-3, 7.5e-3),
        "rain": (0.55e-3, 2e-3),
        "sleet": (1.0e-3, 3.8e-3),
        "light_snow": (0.2e-3, 1.7e-3),
        "heavy_snow": (1.3e-3, 6.5e-3),
    }
    for condition in WEATHERS:
        for seed in range(10):
            alpha = extinction_per_m(draw_weather(condition, "day", np.random.default_rng(seed)), 865.0)
            assert bounds[condition][0] <= alpha <= bounds[condition][1], condition


def test_lidar_ratio_of_fog() -> None:
    """In a fog that nothing gets through, the echo times r^2, summed up, is 1 / (2 S), S = 18.8 +- 0.8 sr."""
    open_wide = Beam(905.0, 100.0, 1e-3, overlap_m=(0.0, 0.0001))
    for alpha in (0.1, 0.3):
        echo = soft_echo(open_wide, alpha)
        pulse_m = open_wide.pulse_m  # integral of the sin^2 pulse
        far = echo.range_m > 9.99
        heard = (echo.strength * echo.range_m**2)[far].sum() * 0.02 / pulse_m
        heard /= np.pi / 0.1 * open_wide.reference_range_m**2 * np.exp(-2 * alpha * 10.0)
        assert 18.0 < 1 / (2 * heard) < 19.6


def test_soft_echo_of_fog_equals_a_dark_target_at_11_m() -> None:
    """Computed for the reference: MOR 100 m, overlap from 1 to 3 m: the peak near 1.9 m, a 10 % target at 11 m."""
    echo = soft_echo(REFERENCE, 0.030)
    best = int(echo.strength.argmax())
    assert echo.range_m[best] == pytest.approx(1.9, abs=0.15)
    ranges = np.linspace(5, 30, 5000)
    target = (72.0 / ranges) ** 2 * np.exp(-0.06 * ranges)
    assert ranges[np.argmin(np.abs(target - echo.strength[best]))] == pytest.approx(11.0, abs=0.4)


def test_blanking_finds_the_strongest_echo_beyond() -> None:
    echo = soft_echo(OS2, 0.03)
    for blank_m in (0.0, 2.0, 9.0, 20.0):
        range_m, strength = echo.beyond(np.array([blank_m]))
        beyond = echo.range_m >= blank_m - 0.001
        assert strength[0] == pytest.approx(echo.strength[beyond].max())
        assert range_m[0] == pytest.approx(echo.range_m[beyond][echo.strength[beyond].argmax()], abs=0.021)


def test_strongest_particle_follows_brute_force() -> None:
    """Against drops thrown one by one into the beam: how strong the strongest of a shot is, and how far away."""
    particles, rng = rain_drops(10.0, 865.0), np.random.default_rng(5)
    law = strongest_particle(particles, OS2, 1.6e-3)
    edges = np.linspace(0.5, 20.0, 391)
    middle = (edges[1:] + edges[:-1]) / 2
    volume = np.pi / 4 * OS2.width_m(middle) ** 2 * np.diff(edges)
    least_m = 0.3e-3  # smaller ones are too weak to count here
    mean = volume * float(particles.above(np.array([least_m]))[0])
    trials = 20_000
    counts = rng.poisson(mean, (trials, len(mean)))
    shot, cell = np.nonzero(counts)
    many = counts[shot, cell]
    shot, r = np.repeat(shot, many), np.repeat(middle[cell], many)
    diameter = least_m + rng.exponential(1 / particles.slope_per_m, len(r))
    fill = np.minimum((diameter / OS2.width_m(r)) ** 2, 1.0)
    power = particles.reflectance / 0.1 * fill * (72.0 / r) ** 2 * OS2.overlap(r) * np.exp(-3.2e-3 * r)
    best = np.zeros(trials)
    np.maximum.at(best, shot, power)
    drawn = law.strength(rng.random(200_000))
    for level in (0.5, 1.0, 2.0):
        assert np.mean(drawn > level) == pytest.approx(np.mean(best > level), rel=0.12, abs=0.003)
    strong = drawn[drawn > 1.0]
    range_m, filled = law.locate(strong, rng.random(len(strong)))
    loudest = (power == best[shot]) & (power > 1.0)
    assert np.median(range_m) == pytest.approx(np.median(r[loudest]), abs=0.7)
    assert (filled <= 1).all()


def test_drops_scatter_less_at_1550_nm() -> None:
    """20 to 100 times less by Mie theory's spheres; 17 times with the glory taken out."""
    ratio = rain_backscatter_per_extinction(865.0) / rain_backscatter_per_extinction(1550.0)
    assert 10 < ratio < 100
    near, far = rain_drops(5.0, 865.0), rain_drops(5.0, 1550.0)
    assert near.reflectance / far.reflectance == pytest.approx(ratio)
    assert isinstance(near, Particles)
