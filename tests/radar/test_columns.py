"""A tensor reduced cell by cell equals plain sums of the whole, in the order of K-Radar's files."""

import numpy as np
import pytest

from farfield.radar.axes import RadarAxes
from farfield.radar.products import moments, moments_of_columns

AXES = RadarAxes(np.arange(20) * 0.5, np.arange(-4.0, 5.0), np.arange(-2.0, 4.0), np.arange(-4, 4) * 0.25)


def columns(tensor):
    """Doppler spectra as a file has them: range fastest, then elevation, then azimuth."""
    return np.asfortranarray(tensor).reshape(len(tensor), -1, order="F").T


@pytest.mark.parametrize("size", [1, 7, 120, 5000])
@pytest.mark.parametrize("dtype", ["f4", "f8"])
def test_blocks_of_any_size_give_the_plain_sums(rng, size, dtype):
    tensor = rng.exponential(1e11, AXES.shape).astype(dtype)
    rows = columns(tensor)
    got = moments_of_columns((rows[start : start + size] for start in range(0, len(rows), size)), AXES)
    wide, velocity = tensor.astype(np.float64), AXES.doppler_m_s[1:, None, None, None]
    np.testing.assert_allclose(got.mean_power, wide.mean(0), rtol=1e-7)
    np.testing.assert_allclose(got.mean_power_63, wide[1:].mean(0), rtol=1e-7)
    np.testing.assert_allclose(got.velocity_moment, (wide[1:] * velocity).mean(0), rtol=1e-6)
    for one, other in zip(got, moments(tensor, AXES), strict=True):
        np.testing.assert_allclose(one, other, rtol=2e-7)


def test_too_many_or_too_few_cells_are_refused(rng):
    rows = columns(rng.random(AXES.shape))
    with pytest.raises(ValueError, match="expected 1080 cells, got 1079"):
        moments_of_columns([rows[:-1]], AXES)
    with pytest.raises(ValueError, match="got more: 1081"):
        moments_of_columns([rows, rows[:1]], AXES)
    with pytest.raises(ValueError, match="cells of 8 bins"):
        moments_of_columns([rows[:, :5]], AXES)
