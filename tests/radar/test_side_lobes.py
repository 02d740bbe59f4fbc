"""Side lobes of arrays whose pattern is known in closed form, by hand-placed echoes, and of the simulated radar."""

import numpy as np
import pytest

from farfield.radar.axes import RadarAxes
from farfield.radar.cfar import Antenna, marks_of_points, side_lobes

AXES = RadarAxes(np.arange(3) * 0.5, np.arange(-53.0, 54.0), np.arange(-18.0, 19.0), np.arange(-32, 32) * 0.06)
ANTENNA = Antenna(azimuth_db=13.2, elevation_db=12.9, azimuth_lobe_deg=2.0, elevation_lobe_deg=12.0)


def filled_array(elements, angle_deg, towards_deg):
    """Power of a uniform array, |sin(N x) / (N sin x)|^2: the first side lobe 13.0 dB down for 10, 13.2 for 64."""
    x = np.pi / 2 * (np.sin(np.radians(angle_deg)) - np.sin(np.radians(towards_deg)))
    with np.errstate(invalid="ignore", divide="ignore"):
        value = np.sin(elements * x) / (elements * np.sin(x))
    return np.where(np.abs(x) < 1e-12, 1.0, value) ** 2


def echo(azimuth_deg, elevation_deg, power):
    azimuth = filled_array(64, AXES.azimuth_deg, azimuth_deg)
    return power * azimuth[:, None] * filled_array(10, AXES.elevation_deg, elevation_deg)[None, :]


def polar_of(power, velocity=None, floor=1e-9):
    polar = np.full((2, 3, 107, 37), floor, dtype=np.float32)
    polar[0, 1] = power + floor
    polar[1] = 0.0 if velocity is None else velocity
    return polar


def test_every_side_lobe_of_one_echo_is_marked_and_its_main_lobe_is_not():
    power = echo(10.0, 0.0, 1.0)
    marked = side_lobes(polar_of(power), ANTENNA, AXES)
    beside = np.abs(AXES.azimuth_deg - 10) > 2
    above = np.abs(AXES.elevation_deg) > 12
    assert np.array_equal(marked[1], beside[:, None] | above[None, :])
    assert power[marked[1]].max() < 10**-1.29
    assert not marked[[0, 2]].any()  # no echo at those ranges


def test_a_second_echo_is_kept_unless_side_lobes_reach_its_level():
    for level_db, kept in ((-6, True), (-20, False)):
        power = echo(-20.0, 0.0, 1.0) + echo(25.0, 0.0, 10 ** (level_db / 10))
        marked = side_lobes(polar_of(power), ANTENNA, AXES)
        assert bool(marked[1, 25 + 53, 18]) is not kept
        assert not marked[1, -20 + 53, 18]


def test_another_velocity_tells_a_weak_echo_from_a_side_lobe():
    power = echo(-20.0, 0.0, 1.0) + echo(25.0, 0.0, 0.01)
    velocity = np.full((3, 107, 37), 1.8, dtype=np.float32)
    velocity[:, 20 + 53 : 31 + 53] = -0.5
    polar = polar_of(power, velocity)
    assert side_lobes(polar, ANTENNA, AXES)[1, 25 + 53, 18]
    marked = side_lobes(polar, ANTENNA, AXES, doppler_tolerance_m_s=0.2)
    assert not marked[1, 25 + 53, 18]
    assert marked[1, 0, 18]
    polar[1, :, :40] = 1.8 - AXES.velocity_span_m_s + 0.1  # the same velocity beyond the fold
    assert side_lobes(polar, ANTENNA, AXES, doppler_tolerance_m_s=0.2)[1, 39, 18]


def test_a_marked_maximum_explains_no_other():
    """Of three echoes 12 dB apart the second is a side lobe of the first; the third, in its main lobe, is none's."""
    antenna = Antenna(azimuth_db=10, elevation_db=10, azimuth_lobe_deg=5.0, elevation_lobe_deg=40.0)
    power = np.zeros((107, 37))
    power[50, 18], power[60, 18] = 1.0, 10**-1.2
    power[53, 18] = 10**-2.4
    marked = side_lobes(polar_of(power), antenna, AXES)
    assert marked[1, 60, 18]
    assert not marked[1, 53, 18]


def test_points_take_the_mark_of_their_cell():
    marked = np.zeros((3, 107, 37), dtype=np.bool_)
    marked[2, 53 + 30, 18 + 5] = True
    flat, tilt, turn = 1.0 * np.cos(np.radians(5)), np.radians(5.3), np.radians(29.6)
    point = [flat * np.cos(turn), flat * np.sin(turn), np.sin(tilt)]
    points = np.array([point, [1.0, 0, 0], [0, -1.0, 0], [50.0, 0, 0]])
    assert marks_of_points(points, marked, AXES).tolist() == [True, False, False, False]


def test_the_simulated_radars_strong_echo_marks_its_row_and_no_noise_elsewhere():
    """One car-like scatterer through the simulator's sparse array, whose side lobes are 8.6 dB down."""
    simulation = pytest.importorskip("farfield.simulation.radar.synthesis")
    from farfield.radar.axes import KRADAR_AXES
    from farfield.radar.products import polar3d_from_moments
    from farfield.simulation.radar.model import RadarModel
    from farfield.simulation.radar.points import Scatterers

    model = RadarModel(leakage_db=(-40.0,) * 8, range_migration=False)
    place = 50 * np.array([[np.cos(np.radians(12)), np.sin(np.radians(12)), 0.0]])
    one = Scatterers.of(place, np.array([0.6]), np.array([1000.0]))
    noise = simulation.draw_noise(model, np.random.default_rng(0))
    found = simulation.form_moments(simulation.synthesise(one, model, np.zeros(1), noise), model)
    polar = polar3d_from_moments(found.mean_power_63, found.velocity_moment)
    row = round(50 / KRADAR_AXES.range_step_m)
    peak = np.unravel_index(polar[0, row].argmax(), polar.shape[2:])
    assert peak[0] == 53 + 12
    marked = side_lobes(polar, Antenna(azimuth_db=8.0, elevation_db=8.0))
    beside = np.abs(np.arange(107) - peak[0]) > 3
    assert marked[row][beside].mean() > 0.95
    assert not marked[row, peak[0], peak[1]]
    assert marked[150:200].mean() == 0.0  # ranges where only noise is
    same = side_lobes(polar, Antenna(azimuth_db=8.0, elevation_db=8.0), doppler_tolerance_m_s=0.3)
    strong = polar[0, row] > 3 * np.median(polar[0, 100:105])
    assert strong[beside].sum() > 300
    assert same[row][beside][strong[beside]].mean() > 0.9
