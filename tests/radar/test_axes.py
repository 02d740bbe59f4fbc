"""The axes against K-Radar's own files, and folding."""

import numpy as np
import pytest
from scipy.io import loadmat

from farfield.radar.axes import KRADAR_AXES, RadarAxes


def test_axes_equal_kradars_files(shared_real):
    polar = loadmat(shared_real / "kradar" / "info_arr.mat")
    doppler = loadmat(shared_real / "kradar" / "arr_doppler.mat")
    np.testing.assert_array_equal(KRADAR_AXES.range_m, polar["arrRange"].ravel())
    np.testing.assert_array_equal(KRADAR_AXES.azimuth_deg, polar["arrAzimuth"].ravel())
    np.testing.assert_array_equal(KRADAR_AXES.elevation_deg, polar["arrElevation"].ravel())
    np.testing.assert_allclose(KRADAR_AXES.doppler_m_s, doppler["arr_doppler"].ravel(), rtol=0, atol=1e-12)


def test_published_figures():
    assert KRADAR_AXES.shape == (64, 256, 37, 107)
    assert KRADAR_AXES.velocity_span_m_s == pytest.approx(3.8652, abs=1e-4)
    assert KRADAR_AXES.range_step_m == 118.5 / 256
    assert KRADAR_AXES.doppler_m_s[[0, -1]] == pytest.approx([-1.93259122, 1.87219774], abs=1e-8)


def test_a_whole_span_changes_neither_fold_nor_bin(rng):
    velocity = rng.uniform(-30.0, 30.0, 500)
    for spans in (-3, 1, 7):
        moved = velocity + spans * KRADAR_AXES.velocity_span_m_s
        turn = (KRADAR_AXES.doppler_bin(moved) - KRADAR_AXES.doppler_bin(velocity)) % 64
        np.testing.assert_allclose(np.minimum(turn, 64 - turn), 0.0, atol=1e-9)
    folded = KRADAR_AXES.fold(velocity)
    assert folded.min() >= -1.93259123
    assert folded.max() < 1.93259123
    turns = (velocity - folded) / KRADAR_AXES.velocity_span_m_s
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-9)


def test_a_standing_world_at_100_km_h_folds_by_hand():
    # -27.778 m/s + 7 spans of 3.865182 m/s = -0.72150 m/s, the bin (-0.72150 + 1.93259) / 0.0603935 = 20.053
    velocity = np.array([-100.0 / 3.6])
    assert KRADAR_AXES.fold(velocity) == pytest.approx([-0.72150], abs=1e-4)
    assert KRADAR_AXES.doppler_bin(velocity) == pytest.approx([20.053], abs=2e-3)


def test_every_bin_is_its_own():
    np.testing.assert_allclose(KRADAR_AXES.doppler_bin(KRADAR_AXES.doppler_m_s), np.arange(64), atol=1e-9)


def test_uneven_axes_are_refused():
    even = np.arange(3.0)
    with pytest.raises(ValueError, match="azimuth_deg to rise in equal steps"):
        RadarAxes(even, np.array([0.0, 1.0, 3.0]), even, even)
