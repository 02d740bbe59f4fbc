"""Where a radar's peaks are placed: side lobes, tall beams, weak echoes of posts."""

import numpy as np
import pytest

from farfield.calibration.radar_features import STRONG_DB, SensorPair, _strongest_of_columns, find_peaks
from farfield.calibration.radar_matching import RadarEvidence, match_frame
from farfield.simulation.radar.model import RadarModel, virtual_array

BEAM_RAD = np.radians(1.07)


def seen(echoes: np.ndarray, power_db: np.ndarray, points: np.ndarray | None = None) -> SensorPair:
    points = np.zeros((0, 3)) if points is None else points
    return SensorPair(number=0, points_m=points, lag_s=np.zeros(len(points)), echoes_m=echoes, power_db=power_db)


def post(x: float, y: float, width: float) -> np.ndarray:
    across, up = np.meshgrid(np.linspace(-width / 2, width / 2, 8), np.linspace(-1.0, 1.0, 8))
    return np.column_stack([np.full(64, x), y + across.ravel(), up.ravel()])


def test_a_side_lobe_does_not_draw_an_echo() -> None:
    """An uncorrected array's lobe 7.5 dB down, 1.5 degrees beside the beam: outside a post's window, and too weak."""
    truth = np.radians(3.2)
    azimuth = np.radians(np.arange(-4.0, 9.0, 0.5))
    beam = np.exp(-4 * np.log(2) * ((azimuth - truth) / BEAM_RAD) ** 2)
    lobe = 10**-0.75 * np.exp(-4 * np.log(2) * ((azimuth - truth - np.radians(1.6)) / BEAM_RAD) ** 2)
    echoes = 40.0 * np.column_stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth])
    found = find_peaks(seen(echoes, 20 + 10 * np.log10(beam + lobe + 1e-3)))
    strongest = int(np.argmax(found.power_db))
    thin, wide = (np.arctan2(each[strongest, 1], each[strongest, 0]) for each in (found.thin_m, found.place_m))
    assert abs(thin - truth) < np.radians(0.1)
    assert abs(wide - truth) < np.radians(0.1)


def test_side_lobes_of_an_array_do_not_draw_wide_echoes_to_one_side() -> None:
    array, azimuth = virtual_array(RadarModel()), np.radians(np.arange(-45.0, 46.0))
    steered = np.exp(1j * np.pi * np.outer(np.sin(azimuth), array.azimuth_slot))
    echoes = 70.0 * np.column_stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth])
    errors = []
    for truth in np.radians(np.arange(-40.0, 40.0, 0.37)):
        echo = np.exp(1j * (np.pi * array.azimuth_slot * np.sin(truth) + array.azimuth_error_rad))
        power_db = 20 * np.log10(np.abs(steered.conj() @ echo))
        found = find_peaks(seen(echoes, 30 + power_db - power_db.max()))
        x, y, _ = found.place_m[np.argmax(found.power_db)]
        errors.append(np.arctan2(y, x) - truth)
    assert abs(np.median(errors)) < np.radians(0.05)  # 0.17 degree where side lobes count


@pytest.mark.parametrize("range_m", [15.0, 30.0, 45.0])
def test_a_tall_beam_does_not_draw_an_echo_nearer(range_m: float) -> None:
    """The strongest cell of a column near the radar is one above or below what answered, at the same slant range."""
    x, z = (each.ravel() for each in np.meshgrid(np.arange(0.0, 60, 0.4), np.arange(-6, 6.1, 0.4), indexing="ij"))
    slant, tilt = np.hypot(x, z), np.arctan2(z, np.maximum(x, 0.1))
    power_db = 25 - 12 * ((slant - range_m) / 0.41) ** 2 - 12 * (tilt / np.radians(9)) ** 2
    echoes = np.column_stack([x, 0 * x, z])
    kept = _strongest_of_columns(echoes, power_db)
    assert len(kept) == len(np.unique(x))
    found = find_peaks(seen(echoes[kept], power_db[kept]))
    strongest = int(np.argmax(found.power_db))
    assert found.thin_m[strongest, 0] == pytest.approx(range_m, abs=0.05)


def test_weak_echoes_serve_where_something_thin_stands() -> None:
    points = np.concatenate([post(20.0, 4.0, 0.2), post(20.0, -4.0, 1.8)])
    echoes = np.array([[20.0, 4.0, 0.0], [20.0, -4.0, 0.0]])
    weak, strong = np.full(2, STRONG_DB - 3), np.full(2, STRONG_DB + 3)
    nowhere = np.zeros(4)
    for power_db, gate_m, count in ((weak, 0.8, 1), (weak, 1.6, 0), (strong, 1.6, 2)):
        columns = match_frame(RadarEvidence.of([seen(echoes, power_db, points)]), nowhere, 0, 0, gate_m)
        assert len(columns[0]) == count
        assert (columns[0][:, 1] > 0).sum() == min(count, 1)


def test_of_equal_echoes_the_first_is_a_peak() -> None:
    echoes = np.array([[20.0, 0.0, 0.0], [20.4, 0.0, 0.0], [30.0, 0.0, 0.0]])
    assert len(find_peaks(seen(echoes, np.full(3, 12.0))).power_db) == 2
    assert len(find_peaks(seen(echoes, np.full(3, 1.0))).power_db) == 0
