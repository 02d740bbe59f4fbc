"""Views of a cube with one cell in it, against plain sums, and where nothing is in view."""

import numpy as np
import pytest

from farfield.radar.axes import KRADAR_AXES
from farfield.radar.views import bev_2d, bfs_2d, decibel, polar_views


def test_one_cell_stands_where_it_should_in_each_view():
    cube = np.zeros((5, 7, 9), dtype=np.float32)
    cube[1, 2, 3] = 4.0
    views = bfs_2d(cube)
    assert (views.bird.shape, views.front.shape, views.side.shape) == ((7, 9), (5, 7), (5, 9))
    assert views.bird[2, 3] == views.front[1, 2] == views.side[1, 3] == 4.0
    assert sum(np.count_nonzero(view) for view in views) == 3


def test_max_mean_and_sum_count_the_cells_in_view_alone(rng):
    cube = rng.exponential(1e12, (6, 5, 4)).astype(np.float32)
    cube[rng.random(cube.shape) < 0.4] = -1.0
    cube[:, 0, 0] = -1.0
    filled = np.ma.masked_less(cube.astype(np.float64), 0)
    for how, plain in (("max", filled.max(0)), ("mean", filled.mean(0)), ("sum", filled.sum(0))):
        np.testing.assert_allclose(bev_2d(cube, how), plain.filled(-1.0), rtol=1e-6)
        assert bev_2d(cube, how)[0, 0] == -1.0


def test_a_polar_map_of_k_radar_has_its_axes(rng):
    power = rng.exponential(1.0, (256, 107, 37)).astype(np.float32)
    views = polar_views(power)
    _, ranges, elevations, azimuths = KRADAR_AXES.shape
    assert views.bird.shape == (ranges, azimuths)
    assert views.front.shape == (elevations, azimuths)
    assert views.side.shape == (elevations, ranges)
    np.testing.assert_allclose(views.front[5, 7], power[:, 7, 5].mean(), rtol=1e-6)
    np.testing.assert_allclose(views.side[5, 9], power[9, :, 5].mean(), rtol=1e-6)


def test_decibel_of_known_powers():
    power = np.array([1e13, 1e12, 2e13, 0.0, -1.0])
    np.testing.assert_allclose(decibel(power)[:3], [0, -10, 3.0103], atol=1e-4)
    assert decibel(power, floor_db=-60)[3] == -60
    assert np.isnan(decibel(power)[4])


def test_an_unknown_projection_is_refused(without_shape_checks):
    with pytest.raises(ValueError, match="max, mean or sum"):
        bev_2d(np.zeros((2, 2, 2), dtype=np.float32), "median")
