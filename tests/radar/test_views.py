"""Views of a radar frame: a planted echo is where it was put, from every product, and noise alone gives nothing."""

import numpy as np
import pytest

from farfield.radar.axes import CUBE_X_M, CUBE_Y_M, CUBE_Z_M, KRADAR_AXES, POWER_UNIT
from farfield.radar.cells import cells_of_cube
from farfield.radar.products import moments, polar3d, zyx_cube
from farfield.radar.views import PolarPeaks, echoes_of, radar_views

RANGE, AZIMUTH, ELEVATION = 108, 60, 18  # 50 m, 7 degrees to the left, level
PLACE_M = 50 * np.array([np.cos(np.radians(7)), np.sin(np.radians(7)), 0.0])


@pytest.fixture(scope="module")
def tensor() -> np.ndarray:
    rng = np.random.default_rng(5)
    whole = np.empty(KRADAR_AXES.shape, dtype=np.float32)
    whole[:] = rng.exponential(8e10, (64, 256, 1, 1))
    whole *= rng.exponential(1.0, (1, 1, 37, 107)).astype(np.float32)
    whole = rng.permuted(whole.reshape(64, -1), axis=1).reshape(KRADAR_AXES.shape)
    whole[48, RANGE, ELEVATION, AZIMUTH] += np.float32(64 * 8e11)  # 10 times the floor in the mean
    whole[40, 4, ELEVATION, AZIMUTH] += np.float32(64 * 8e11)  # within the transmitter's leakage
    return whole


@pytest.fixture(scope="module")
def polar(tensor: np.ndarray) -> np.ndarray:
    return polar3d(tensor)


def brightest(view: np.ndarray, *axes: np.ndarray) -> list[float]:
    place = np.unravel_index(np.nanargmax(view), view.shape)
    return [float(axis[index]) for axis, index in zip(axes, place, strict=True)]


def test_a_planted_echo_is_where_it_was_put(polar: np.ndarray) -> None:
    views = radar_views({"polar3d": polar})
    assert views is not None
    assert views.products == ("polar3d",)
    np.testing.assert_allclose(brightest(views.bird_db, CUBE_Y_M, CUBE_X_M), PLACE_M[1::-1], atol=0.5)
    np.testing.assert_allclose(brightest(views.front_db, CUBE_Z_M, CUBE_Y_M), [0.0, PLACE_M[1]], atol=0.5)
    np.testing.assert_allclose(brightest(views.side_db, CUBE_Z_M, CUBE_X_M), [0.0, PLACE_M[0]], atol=0.5)
    assert views.polar_db is not None
    far = np.where(KRADAR_AXES.range_m[:, None] > 5, views.polar_db, np.nan)
    assert brightest(far, KRADAR_AXES.range_m, KRADAR_AXES.azimuth_deg) == [KRADAR_AXES.range_m[RANGE], 7.0]
    echoes = views.echoes
    assert isinstance(echoes, PolarPeaks)
    nearest = np.linalg.norm(echoes.points_m - PLACE_M, axis=1).argmin()
    np.testing.assert_allclose(echoes.points_m[nearest], PLACE_M, atol=0.1)
    assert echoes.peak[nearest]
    assert not echoes.side_lobe[nearest]
    assert np.linalg.norm(echoes.points_m, axis=1).min() > 5.0  # nothing of the leakage
    level = 10 * np.log10(polar[0, RANGE, AZIMUTH, ELEVATION])
    assert echoes.power_db[nearest] == pytest.approx(level, abs=1e-4)
    assert views.wrapped_m_s is not None
    assert views.wrapped_m_s[RANGE, AZIMUTH] == echoes.wrapped_m_s[nearest]


def test_every_product_shows_it(tensor: np.ndarray, polar: np.ndarray) -> None:
    whole, cube = radar_views({"tesseract": tensor}), zyx_cube(moments(tensor).mean_power)
    from_map, alone = radar_views({"polar3d": polar}), radar_views({"cube": cube})
    cells = radar_views({"cells": cells_of_cube(cube, "wide")})
    assert whole is not None
    assert from_map is not None
    np.testing.assert_allclose(whole.polar_db, from_map.polar_db, atol=1e-4)
    np.testing.assert_array_equal(whole.echoes.points_m, from_map.echoes.points_m)
    for views in (alone, cells):
        assert views is not None
        assert (views.polar_db, views.wrapped_m_s, views.echoes) == (None, None, None)
        np.testing.assert_allclose(brightest(views.side_db, CUBE_Z_M, CUBE_X_M), [0.0, PLACE_M[0]], atol=0.5)
    assert np.isnan(cells.bird_db[:100]).all()  # beside the wide region the store has nothing
    assert radar_views({"sparse": np.zeros((3, 4))}) is None


def test_the_strongest_bin_tells_the_velocity_of_the_echo(tensor: np.ndarray, polar: np.ndarray) -> None:
    views = radar_views({"tesseract": tensor, "polar3d": polar}, doppler="peak")
    assert views is not None
    assert views.wrapped_m_s[RANGE, AZIMUTH] == pytest.approx(KRADAR_AXES.doppler_m_s[48], rel=1e-6)
    with pytest.raises(ValueError, match="expected a tesseract, got polar3d"):
        radar_views({"polar3d": polar}, doppler="peak")


def test_one_cell_a_direction_and_few_false_alarms(polar: np.ndarray) -> None:
    found = echoes_of(polar, false_alarm=1e-4)
    columns = np.column_stack([np.linalg.norm(found.points_m, axis=1), *found.points_m[:, :2].T])
    bins = np.rint([columns[:, 0] / KRADAR_AXES.range_step_m, np.degrees(np.arctan2(columns[:, 2], columns[:, 1]))])
    assert len(np.unique(bins, axis=1).T) == len(found)
    assert len(echoes_of(polar, false_alarm=1e-8)) < len(found)
    assert found.peak.sum() <= len(found)


def test_velocities_of_a_standing_world_unwrap_to_nothing() -> None:
    points = np.array([[50.0, 0.0, 0.0], [30.0, 30.0, 0.0]], dtype=np.float32)
    ego = np.array([20.0, 0.0, 0.0])
    wrapped = KRADAR_AXES.fold(-points[:, 0] / np.linalg.norm(points, axis=1) * 20.0).astype(np.float32)
    both = np.ones(2, dtype=np.bool_)
    echoes = PolarPeaks(
        points_m=points, power_db=np.zeros(2, np.float32), wrapped_m_s=wrapped, side_lobe=~both, peak=both
    )
    np.testing.assert_allclose(echoes.unwrapped(ego).compensated_m_s, 0.0, atol=1e-5)
    assert POWER_UNIT == 1e13
