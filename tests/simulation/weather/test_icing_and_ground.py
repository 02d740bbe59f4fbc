"""Covered windows: the share asked for, in sectors, growing. Wet and snowy ground against Fresnel and its shares."""

import numpy as np
import pytest

from farfield.simulation.lidar.surfaces import (
    fresnel_reflectance,
    grade_factor,
    snow_grades,
    wet_factor,
    wet_reflectance,
)
from farfield.simulation.weather.conditions import Weather
from farfield.simulation.weather.icing import WindowField, transmission, window_cover_kind

OUSTER = {"azimuth_deg": 180.0, "elevation_deg": (-11.0, 10.8)}


def directions(half_deg: float) -> tuple[np.ndarray, np.ndarray]:
    return np.meshgrid(np.arange(-half_deg, half_deg, 0.17), np.linspace(-10.9, 10.7, 64))


@pytest.mark.parametrize("kind", ["ice", "drop"])
@pytest.mark.parametrize("share", [0.03, 0.4, 0.75])
def test_coverage_is_the_one_asked_for(kind: str, share: float) -> None:
    for seed in range(3):
        field = WindowField.draw(np.random.SeedSequence(seed), kind, **OUSTER)
        azimuth, elevation = directions(70.0)
        assert field.covered(share, azimuth, elevation).mean() == pytest.approx(share, abs=0.02)


def test_ice_covers_the_front_only_and_in_sectors() -> None:
    field = WindowField.draw(np.random.SeedSequence(2), "ice", **OUSTER)
    azimuth, elevation = directions(180.0)
    covered = field.covered(0.6, azimuth, elevation)
    assert not covered[np.abs(azimuth) > 70.01].any()
    front = covered[:, np.abs(azimuth[0]) < 69.5]
    changes = np.mean(front[:, 1:] != front[:, :-1], axis=1).mean()
    assert changes < 0.02  # one edge in 8 degrees or more; cells at random would change at every other step


def test_ice_only_grows() -> None:
    field = WindowField.draw(np.random.SeedSequence(4), "ice", **OUSTER)
    azimuth, elevation = directions(90.0)
    sleet = Weather("sleet", icing=0.75, icing_tau_s=120.0, snow_mm_h=2.0)
    before = np.zeros(azimuth.shape, dtype=bool)
    for time_s in (0.0, 30.0, 120.0, 600.0):
        through = transmission(field, sleet, time_s, 865.0, azimuth, elevation)
        now = through < 0.5
        assert set(np.unique(through.round(6))) <= {0.05, 1.0}
        assert (now | ~before).all()
        expected = 0.75 * (1 - np.exp(-time_s / 120.0))
        assert now[:, np.abs(azimuth[0]) < 70].mean() == pytest.approx(expected, abs=0.02)
        before = now


def test_windows_differ_and_repeat() -> None:
    first, again, other = (WindowField.draw(np.random.SeedSequence(s), "ice", **OUSTER).rank for s in (1, 1, 2))
    assert (first == again).all()
    assert (first != other).mean() > 0.9
    assert window_cover_kind(Weather("rain", rain_mm_h=3.0)) == "drop"
    assert window_cover_kind(Weather("sleet", snow_mm_h=3.0)) == "ice"


def test_fresnel_of_water() -> None:
    """2 % head-on; 0 for one polarisation at Brewster's angle, so half of the other's; all at grazing incidence."""
    assert fresnel_reflectance(np.array([1.0]), 1.33)[0] == pytest.approx((0.33 / 2.33) ** 2)
    brewster = np.cos(np.arctan(1.33))
    across = ((1 - 1.33**2) / (1 + 1.33**2)) ** 2
    assert fresnel_reflectance(np.array([brewster]), 1.33)[0] == pytest.approx(across / 2)
    assert fresnel_reflectance(np.array([0.0]), 1.33)[0] == pytest.approx(1.0)


def test_wet_asphalt() -> None:
    """Half as bright from above as Lekner and Dorf's and Twomey's wet surfaces are, dark at grazing incidence."""
    cosines = np.array([1.0, 0.3, 0.05])
    dry = np.full(3, 0.15)
    wet = wet_reflectance(dry, cosines, 1.2, 865.0)
    assert 0.4 < wet[0] / 0.15 < 0.7
    assert wet[0] > wet[1] > wet[2]
    assert wet[2] < 0.2 * 0.15
    np.testing.assert_allclose(wet_reflectance(dry, cosines, 0.0, 865.0), dry)
    assert wet_reflectance(dry, cosines, 0.5, 1550.0)[0] < wet_reflectance(dry, cosines, 0.5, 865.0)[0]
    np.testing.assert_allclose(wet_factor(1.2, 865.0)[-1], wet[0] / 0.15, rtol=1e-5)


@pytest.mark.parametrize("share", [0.2, 0.7])
def test_snow_covers_its_share_in_patches(share: float) -> None:
    x, y = (axis.reshape(-1) for axis in np.meshgrid(np.arange(0, 128, 0.25) + 5000.1, np.arange(0, 128, 0.25) - 900.1))
    grades = snow_grades(x, y, np.full(len(x), share))
    assert np.mean(grades >= 0) == pytest.approx(share, abs=0.001)
    covered = (grades >= 0).reshape(512, 512)
    assert np.mean(covered[:, 1:] != covered[:, :-1]) < 0.12
    assert set(np.unique(grades)) == {-1, 0, 1, 2, 3, 4}
    assert grade_factor().mean() == pytest.approx(1.0)
