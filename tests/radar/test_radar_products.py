"""The derived radar products against plain sums, scipy's interpolator, a hand-placed cell and published counts."""

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from farfield.radar.axes import KRADAR_AXES, POWER_UNIT, RadarAxes
from farfield.radar.products import (
    CUBE_X_M,
    CUBE_Y_M,
    CUBE_Z_M,
    moments,
    polar3d,
    polar3d_from_moments,
    polar_cloud,
    sparse_cloud,
    zyx_cube,
)

SMALL = RadarAxes(np.arange(40) * 0.5, np.arange(-4.0, 5.0), np.arange(-2.0, 4.0), np.arange(-4, 4) * 0.25)
TENTH_OF_THE_GRID = 101_351
SHARE_IN_VIEW = 0.515


@pytest.fixture(scope="module")
def power():
    rng = np.random.default_rng(7)
    return rng.exponential(1e11, KRADAR_AXES.shape[1:]).astype(np.float32)


@pytest.fixture(scope="module")
def cube(power):
    return zyx_cube(power)


def small_tensor(rng):
    return rng.exponential(1e11, SMALL.shape).astype(np.float32)


def test_polar_map_equals_plain_sums(rng):
    tensor = small_tensor(rng)
    kept, velocity = tensor[1:].astype(np.float64), SMALL.doppler_m_s[1:, None, None, None]
    got = polar3d(tensor, SMALL)
    assert got.shape == (2, 40, 9, 6)
    np.testing.assert_allclose(got[0], kept.mean(0).transpose(0, 2, 1) / 1e13, rtol=1e-5)
    np.testing.assert_allclose(got[1], ((kept * velocity).sum(0) / kept.sum(0)).transpose(0, 2, 1), atol=1e-6)


def test_the_first_doppler_bin_does_not_count_in_the_polar_map_but_does_in_the_mean(rng):
    tensor = small_tensor(rng)
    louder = tensor.copy()
    louder[0] *= 100
    np.testing.assert_array_equal(polar3d(louder, SMALL), polar3d(tensor, SMALL))
    assert (moments(louder, SMALL).mean_power > moments(tensor, SMALL).mean_power).all()
    np.testing.assert_allclose(moments(tensor, SMALL).mean_power, tensor.mean(0, dtype=np.float64), rtol=1e-5)


def test_a_turned_view_gives_the_same_map(rng):
    tensor = small_tensor(rng)
    turned = np.ascontiguousarray(tensor[:, :, ::-1, ::-1])[:, :, ::-1, ::-1]
    np.testing.assert_allclose(polar3d(turned, SMALL), polar3d(tensor, SMALL), rtol=1e-6)


def test_one_scatterer_keeps_its_cell_and_velocity():
    tensor = np.zeros(SMALL.shape, dtype=np.float32)
    tensor[6, 20, 4, 7] = 63e13  # alone among the 63 bins of the real grid; here among 7
    got = polar3d(tensor, SMALL)
    assert got[0, 20, 7, 4] == pytest.approx(9.0)
    assert got[1, 20, 7, 4] == pytest.approx(0.5)
    assert np.count_nonzero(got[0]) == np.count_nonzero(got[1]) == 1


def test_moments_reduced_on_the_fly_give_the_same_map(rng):
    tensor = small_tensor(rng)
    total, weighted = np.zeros((2, *SMALL.shape[1:]))
    for velocity, slab in zip(SMALL.doppler_m_s[1:], tensor[1:], strict=True):
        total += slab
        weighted += velocity * slab
    got = polar3d_from_moments((total / 7).astype(np.float32), (weighted / 7).astype(np.float32))
    np.testing.assert_allclose(got, polar3d(tensor, SMALL), rtol=1e-5, atol=1e-7)


def test_cube_equals_scipys_interpolator(power, cube, rng):
    grid = (KRADAR_AXES.range_m, KRADAR_AXES.elevation_deg, KRADAR_AXES.azimuth_deg)
    oracle = RegularGridInterpolator(grid, power.astype(np.float64), bounds_error=False, fill_value=-1.0)
    k, j, i = (rng.integers(0, size, 60_000) for size in cube.shape)
    apart = (j != 200) | (i != 0)  # at the radar itself there is no direction
    k, j, i = k[apart], j[apart], i[apart]
    x, y, z = CUBE_X_M[i], CUBE_Y_M[j], CUBE_Z_M[k]
    flat = np.hypot(x, y)
    at = np.stack([np.hypot(flat, z), np.degrees(np.arctan2(z, flat)), np.degrees(np.arctan2(y, x))], axis=1)
    np.testing.assert_allclose(cube[k, j, i], oracle(at), rtol=2e-5)


def test_share_of_the_cube_in_view_is_the_published_one(cube):
    assert cube.shape == (150, 400, 250)
    assert (cube >= 0).mean() == pytest.approx(SHARE_IN_VIEW, abs=0.001)
    assert set(np.unique(cube[cube < 0])) == {-1.0}


def test_a_hand_placed_cell_stands_left_and_up_where_the_angles_say():
    power = np.zeros(KRADAR_AXES.shape[1:], dtype=np.float32)
    power[108, 18 + 6, 53 + 30] = 1e12  # 49.992 m, 6 degrees up, 30 degrees left
    k, j, i = np.unravel_index(np.argmax(zyx_cube(power)), (150, 400, 250))
    flat = 108 * 0.462890625 * np.cos(np.radians(6))
    truth = (flat * np.cos(np.radians(30)), flat * np.sin(np.radians(30)), 108 * 0.462890625 * np.sin(np.radians(6)))
    np.testing.assert_allclose((CUBE_X_M[i], CUBE_Y_M[j], CUBE_Z_M[k]), truth, atol=0.25)
    x, y, z = polar_cloud(polar3d_from_moments(power, np.zeros_like(power)), 1e-7)[0, :3]
    np.testing.assert_allclose((x, y, z), truth, rtol=1e-6)


def test_sparse_cloud_keeps_the_rate_of_all_cells_half_a_cell_lower(cube):
    points = sparse_cloud(cube, 0.01)
    assert len(points) == 0.01 * cube.size
    strongest = np.unravel_index(np.argmax(cube), cube.shape)
    x, y, z, power = points[np.argmax(points[:, 3])]
    np.testing.assert_allclose(
        (x, y, z), (CUBE_X_M[strongest[2]] - 0.2, CUBE_Y_M[strongest[1]] - 0.2, CUBE_Z_M[strongest[0]] - 0.2), atol=1e-4
    )
    assert power == pytest.approx(cube.max() / POWER_UNIT)
    assert points[:, 3].min() * POWER_UNIT > np.sort(cube, axis=None)[-150_001] * (1 - 1e-6)


def test_a_nominal_tenth_keeps_the_published_share_of_valid_cells(cube):
    valid = (cube >= 0).sum()
    assert len(sparse_cloud(cube)) / valid == pytest.approx(0.194, abs=0.001)
    assert len(sparse_cloud(cube, over="valid")) / valid == pytest.approx(0.1, abs=1e-5)


def test_no_point_lies_outside_the_field_of_view(cube):
    points = sparse_cloud(cube, 0.9, subtract_half_cell=False)
    assert len(points) == (cube >= 0).sum()
    assert (points[:, 3] >= 0).all()


def test_a_tenth_of_the_polar_grid_is_the_published_count(power):
    polar = polar3d_from_moments(power, power)
    short, full = polar_cloud(polar), polar_cloud(polar, with_indices=True)
    assert short.shape == (TENTH_OF_THE_GRID, 5)
    assert full.shape == (TENTH_OF_THE_GRID, 11)
    np.testing.assert_array_equal(full[:, :5], short)
    r, a, e = full[:, 8:].astype(int).T
    np.testing.assert_array_equal(full[:, 3], polar[0][r, a, e])
    np.testing.assert_allclose(np.linalg.norm(full[:, :3], axis=1), full[:, 5], rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(full[:, 6], np.radians(KRADAR_AXES.azimuth_deg[a]), rtol=1e-6)


@pytest.mark.parametrize("rate", [0.0, 1.0, -0.1])
def test_a_rate_that_is_no_share_is_refused(rate, cube):
    with pytest.raises(ValueError, match="share between 0 and 1"):
        sparse_cloud(cube, rate)


def test_a_wrong_shape_is_named():
    with pytest.raises(ValueError, match=r"\(256, 37, 107\)"):
        zyx_cube(np.zeros((256, 107, 37), dtype=np.float32))
