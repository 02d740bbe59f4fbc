"""The tensor against a brute-force synthesis of the sampled signal, and against the published frame's statistics."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from _validation_scenes import doppler_spectrum, point_spread_db, sampled_tensor, scatterers_of_snr

from farfield.errors import ConfigError
from farfield.radar.axes import RadarAxes
from farfield.radar.products import moments
from farfield.simulation.radar.model import RadarModel, beams, virtual_array
from farfield.simulation.radar.points import Scatterers, cell_snr
from farfield.simulation.radar.synthesis import Channels, draw_noise, form_moments, form_tensor, synthesise

SMALL = RadarAxes(
    range_m=0.5 * np.arange(32),
    azimuth_deg=np.arange(-50.0, 51.0, 10.0),
    elevation_deg=np.arange(-10.0, 11.0, 5.0),
    doppler_m_s=0.06 * np.arange(-8, 8),
)
EXACT = RadarModel(
    axes=SMALL, azimuth_elements=6, azimuth_slots=12, elevation_elements=3, elevation_slots=4,
    truncation_db=-np.inf, range_migration=False, leakage_db=(-40.0,) * 8, response_db=(0.0,) * 8,
)  # fmt: skip
QUIET = RadarModel(leakage_db=(-40.0,) * 8)
UNFILTERED = replace(QUIET, high_pass_m=0.0)


def test_equals_a_brute_force_synthesis_of_the_beat_signal(rng):
    five = scatterers_of_snr(
        rng.uniform(2, 14, 5), rng.uniform(-45, 45, 5), rng.uniform(-8, 8, 5), rng.uniform(-3, 3, 5), 100.0, EXACT
    )
    phase = rng.uniform(0, 2 * np.pi, 5)
    found = form_tensor(synthesise(five, EXACT, phase), EXACT) / EXACT.noise_floor
    want = sampled_tensor(five, EXACT, phase)
    assert np.abs(found - want).max() < 1e-4 * want.max()


def test_fast_targets_walk_through_range_as_the_sampled_signal_does(rng):
    model = replace(EXACT, range_migration=True, loop_s=1e-3)  # 20 m/s: 0.32 m, two thirds of a bin, in 16 chirps
    one = scatterers_of_snr(np.array([8.13]), 10.0, 2.0, -20.0, 100.0, model)
    found = form_tensor(synthesise(one, model, np.zeros(1)), model) / model.noise_floor
    want = sampled_tensor(one, model, np.zeros(1), walk=True)
    still = sampled_tensor(one, model, np.zeros(1))
    error, ignoring = np.abs(found - want).max(), np.abs(still - want).max()
    assert error < 0.02 * want.max()
    assert error < 0.25 * ignoring


def test_the_side_lobes_left_out_are_below_the_noise():
    one = scatterers_of_snr(np.array([40.3]), 5.2, 1.0, 0.02, 1000.0, QUIET)
    exact = replace(QUIET, truncation_db=-np.inf)
    cut, whole = (synthesise(one, model, np.zeros(1)) for model in (QUIET, exact))
    left = np.hypot(cut.re - whole.re, cut.im - whole.im) * np.sqrt(QUIET.channels) * virtual_array(QUIET).gain
    assert left.max() < 10 ** (-2.5 / 20)
    assert np.abs(cut.re).max() == pytest.approx(np.abs(whole.re).max(), rel=1e-5)


@pytest.mark.parametrize("axis", ["range", "doppler"])
def test_unwindowed_point_spread(axis):
    """First side lobe -13.26 dB, scalloping 3.92 dB, main lobe 0.886 bin wide: those of an unwindowed transform."""
    offsets = np.array([0.0, 0.5, 0.443, 1.38, 1.43, 1.48])
    level = point_spread_db(offsets, axis, QUIET)
    assert level[0] == pytest.approx(0.0, abs=0.01)
    assert level[1] == pytest.approx(-3.92, abs=0.02)
    assert level[2] == pytest.approx(-3.01, abs=0.02)
    assert level[3:].max() == pytest.approx(-13.26, abs=0.1)


def test_a_hann_window_lowers_side_lobes_and_keeps_the_noise(rng):
    model = replace(QUIET, window="hann", truncation_db=-np.inf)
    one = scatterers_of_snr(np.array([model.axes.range_m[100]]), 0.0, 0.0, 0.0, 1e4, model)
    cell = synthesise(one, model, np.zeros(1))
    power = (cell.re**2 + cell.im**2).sum(axis=2)
    assert power[103, 32] < 1e-6 * power[100, 32]
    noise = synthesise(one.take(np.zeros(0, dtype=int)), model, np.zeros(0), draw_noise(model, rng))
    assert np.var(noise.re) == pytest.approx(0.5, rel=0.01)


def test_doppler_folds():
    span = QUIET.axes.velocity_span_m_s
    assert span == pytest.approx(3.8652, abs=1e-4)
    peaks = [doppler_spectrum(0.72 + folds * span, QUIET).argmax() for folds in (0, 1, -2)]
    assert peaks[0] == peaks[1] == peaks[2]
    world = doppler_spectrum(-100 / 3.6, QUIET).argmax()
    folded = QUIET.axes.doppler_m_s[world]
    assert abs((-100 / 3.6 - folded + span / 2) % span - span / 2) <= QUIET.axes.doppler_step_m_s / 2


def test_peak_power_falls_with_the_fourth_power_of_range():
    """-40 dB a decade from 10 to 100 m ahead of the high-pass filter; 30 dB over the noise for 10 m2 at 50 m."""
    bins = np.array([22, 43, 108, 216])
    range_m = QUIET.axes.range_m[bins]
    peaks = []
    for index, distance in zip(bins, range_m, strict=True):
        one = Scatterers.of(np.array([[distance, 0.0, 0.0]]), np.zeros(1), np.array([10.0]))
        seen = synthesise(one, UNFILTERED, np.zeros(1))
        power = form_moments(seen, UNFILTERED).mean_power / UNFILTERED.response()[:, None, None]
        peaks.append(10 * np.log10(power[index].max() * 64 / QUIET.noise_floor))
    slope = np.polyfit(np.log10(range_m), peaks, 1)[0]
    assert slope == pytest.approx(-40.0, abs=0.5)
    assert peaks[2] == pytest.approx(30.0, abs=0.7)


def test_a_high_pass_filter_halves_the_slope():
    """One pole far out: -20 dB a decade in the near, -3 dB where it says, nothing at the reference range."""
    model = RadarModel(high_pass_m=100.0)
    near = Scatterers.of(np.array([[1.0, 0.0, 0.0], [10.0, 0.0, 0.0], [50.0, 0.0, 0.0]]), np.zeros(3), np.ones(3))
    level = 10 * np.log10(cell_snr(near, model) / cell_snr(near, replace(model, high_pass_m=0.0)))
    assert level[1] - level[0] == pytest.approx(20.0, abs=0.05)
    assert level[2] == pytest.approx(0.0, abs=1e-9)
    far = model.echo_gain_db(np.array([100.0, 1e9]))
    assert far[1] - far[0] == pytest.approx(10 * np.log10(2), abs=1e-6)
    assert np.all(replace(model, high_pass_m=0.0).echo_gain_db(np.array([0.5, 100.0])) == 0)


STRONG_M = (25.0, 33.5, 42.1, 51.8, 60.2)


def strong_object(range_m: float, phase: np.ndarray, draw: np.random.Generator) -> Scatterers:
    """A car's worth of scatterers whose peak stands 8.6 dB over the floor of the map, as in the published frame."""
    count = len(phase)
    one = scatterers_of_snr(
        range_m + draw.uniform(-0.2, 0.3, count), 1 + draw.uniform(-1, 1, count), draw.uniform(-1.5, 0.5, count),
        1.23, 50.0, QUIET,
    )  # fmt: skip
    alone = form_moments(synthesise(one, QUIET, phase), QUIET).mean_power.mean(axis=1).max() / QUIET.noise_floor
    return replace(one, rcs_m2=one.rcs_m2 * (10**0.86 - 1) / alone)


@pytest.fixture(scope="module")
def frame():
    """Strong objects in noise, one at 51.8 m as in the published frame: tensor, range-azimuth map in dB, channels."""
    draw = np.random.default_rng(7)
    phase = draw.uniform(0, 2 * np.pi, (len(STRONG_M), 30))
    strong = Scatterers.join([strong_object(*pair, draw) for pair in zip(STRONG_M, phase, strict=True)])
    channels = synthesise(strong, RadarModel(), phase.ravel(), draw_noise(RadarModel(), draw))
    tensor = form_tensor(channels, RadarModel())
    return tensor, 10 * np.log10(tensor.mean(axis=(0, 2))), channels


def test_cells_of_noise_are_exponential_and_elevation_beams_alike(frame):
    noise = frame[0][:, 150:200]
    assert np.median(noise) / noise.mean() == pytest.approx(0.693, abs=0.005)
    assert 10 * np.log10(noise.mean()) == pytest.approx(109.1, abs=0.05)
    lag = [np.corrcoef(noise[:, :, 18, ::8].ravel(), noise[:, :, 18 + k, ::8].ravel())[0, 1] for k in (1, 18)]
    assert lag[0] > 0.9
    assert abs(lag[1]) < 0.35


def test_floor_of_the_map_scatters_as_in_the_real_frame(frame, rng):
    floor = frame[1][150:200]
    assert 0.25 < floor.std() < 0.35
    independent = rng.exponential(1.0, (64, 20, 37, 107)).mean(axis=(0, 2))  # the control: one draw a cell
    assert (10 * np.log10(independent)).std() < 0.12


def test_side_lobes_in_azimuth_are_those_of_the_real_frame(frame):
    """Peak +8.6 dB; quantiles 5, 25, 50, 75, 95 % of its row +0.5, 0.8, 1.2, 2.0, 4.2 dB over the floor."""
    level = frame[1] - np.median(frame[1][150:200])
    rows = [
        middle - 2 + level[middle - 2 : middle + 3].max(axis=1).argmax() for middle in np.int64(STRONG_M) * 256 // 118
    ]
    peaks = [level[row].max() for row in rows]
    quantiles = np.mean([np.percentile(level[row], [5, 25, 50, 75, 95]) for row in rows], axis=0)
    assert np.mean(peaks) == pytest.approx(8.6, abs=0.5)
    assert np.abs(quantiles - [0.5, 0.8, 1.2, 2.0, 4.2]).max() < 1.0
    beside = [level[row + step, level[row].argmax()] for row in rows for step in (-1, 1)]
    assert np.mean(beside) < 4.0  # 2.7 and 1.6 dB in the real frame: no window


def test_receiver_leaks_dips_and_rolls_off(frame):
    by_range = 10 * np.log10((10 ** (frame[1] / 10)).mean(axis=1)) - 109.1
    axis = RadarModel().axes.range_m
    inside = [by_range[(axis > low) & (axis < high)] for low, high in ((1, 5), (7, 11), (70, 90), (110, 113.5))]
    assert 42 < by_range[0] < 50
    assert 5 < inside[0].mean() < 9
    assert [part.mean() for part in inside[1:]] == pytest.approx([-2.0, 0.0, -5.0], abs=0.3)
    assert 1 < by_range[-3:].mean() < 7


def test_moments_are_those_of_the_tensor(frame):
    for found, want in zip(form_moments(frame[2], RadarModel()), moments(frame[0]), strict=True):
        assert np.abs(found - want).max() < 1e-5 * np.abs(want).max()


_BYTES = """
import numpy as np, numba
numba.set_num_threads({threads})
from farfield.simulation.radar.points import Scatterers
from farfield.simulation.radar.model import RadarModel
from farfield.simulation.radar.synthesis import draw_noise, form_moments, synthesise
import hashlib
rng = np.random.default_rng(3)
n = 300
position = np.stack([rng.uniform(5, 100, n), rng.uniform(-4, 4, n), rng.uniform(-1, 1, n)], 1)
seen = Scatterers.of(position, rng.uniform(-20, 0, n), rng.exponential(10.0, n))
cells = synthesise(seen, RadarModel(), rng.uniform(0, 6, n), draw_noise(RadarModel(), rng))
print(hashlib.sha256(np.stack(form_moments(cells, RadarModel())).tobytes()).hexdigest())
"""


def test_same_bytes_with_any_number_of_threads():
    runs = [
        subprocess.run(
            [sys.executable, "-c", _BYTES.format(threads=threads)],
            capture_output=True, text=True, check=True, env={**os.environ, "NUMBA_NUM_THREADS": "3"},
        ).stdout
        for threads in (1, 3)
    ]  # fmt: skip
    assert runs[0] == runs[1]
    assert len(runs[0]) == 65


def test_elevation_and_azimuth_rise_upwards_and_to_the_left():
    one = scatterers_of_snr(np.array([40.0]), 20.0, 6.0, 0.0, 1e4, QUIET)
    power = form_moments(synthesise(one, QUIET, np.zeros(1)), QUIET).mean_power
    _, elevation, azimuth = np.unravel_index(power.argmax(), power.shape)
    assert QUIET.axes.azimuth_deg[azimuth] == pytest.approx(20.0, abs=1.0)
    assert QUIET.axes.elevation_deg[elevation] == pytest.approx(6.0, abs=5.0)


def test_tdm_phase_acts_on_folded_targets_only():
    both = [replace(QUIET, tdm_phase=on) for on in (False, True)]
    where = np.array([40.0]), 0.0, 0.0
    slow, fast = (
        [synthesise(scatterers_of_snr(*where, v, 1e3, m), m, np.zeros(1)).re for m in both] for v in (1.0, 9.0)
    )
    assert np.array_equal(*slow)
    assert not np.allclose(*fast)


def test_says_what_is_wrong_with_a_model():
    with pytest.raises(ConfigError, match="expected one of none, hann, hamming"):
        RadarModel(window="blackman")
    with pytest.raises(ConfigError, match="divisor of 64"):
        RadarModel(migration_blocks=5)
    with pytest.raises(ConfigError, match="azimuth_elements"):
        RadarModel(azimuth_elements=90)


def test_beams_keep_the_noise():
    weights = beams(RadarModel())
    assert (weights.azimuth_re**2 + weights.azimuth_im**2).sum(axis=0) == pytest.approx(1.0, rel=1e-5)
    assert (weights.elevation_re**2 + weights.elevation_im**2).sum(axis=1) == pytest.approx(1.0, rel=1e-5)
    assert isinstance(Channels(np.zeros((1, 1, 1), np.float32), np.zeros((1, 1, 1), np.float32)), Channels)
