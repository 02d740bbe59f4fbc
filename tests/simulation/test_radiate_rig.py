"""The turning radar of the RADIATE rig: beside the real pictures, alone with one echo, and written and read again."""

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("embreex")

from farfield.datasets import open_dataset
from farfield.datasets.radiate import CELL_M, Radiate
from farfield.errors import ConfigError
from farfield.simulation import simulate_frame
from farfield.simulation.radar.points import Scatterers
from farfield.simulation.radar.turning import TurningRadar, in_sector, polar_picture
from farfield.simulation.recording import record
from farfield.simulation.rigs.drive import drive_of
from farfield.simulation.rigs.radiate import RadiateFrame

RADAR = TurningRadar()
DB = RADAR.count_db


def picture(places_m: list[tuple[float, float]], snr_db: float, seed: int = 0) -> np.ndarray:
    points = np.array([(*place, 0.0) for place in places_m])
    seen = Scatterers.of(points, np.zeros(len(points)), np.ones(len(points)))
    return polar_picture(seen, np.full(len(points), 10 ** (snr_db / 10)), RADAR, np.random.default_rng(seed)).astype(
        float
    )


def test_an_echo_lies_where_it_is_and_as_wide_as_the_beam() -> None:
    """Half power of one way is a quarter of both: the lobe of 1.8 degrees is 6 dB down 0.9 degrees off."""
    found = picture([(30.0, -12.0)], 60.0)
    row, column = np.unravel_index(found.argmax(), found.shape)
    assert abs(row * CELL_M - np.hypot(30.0, 12.0)) <= CELL_M
    assert abs((column + 0.5) * 0.9 - np.degrees(np.arctan2(12.0, 30.0))) <= 0.5
    on_axis = picture([(50 * np.cos(np.radians(-0.45)), 50 * np.sin(np.radians(-0.45)))], 60.0)
    row = round(50 / CELL_M)
    peak = on_axis[row, 0]
    assert DB * (peak - on_axis[row, 1]) == pytest.approx(6.0, abs=0.5)
    assert DB * (peak - on_axis[row, 2]) == pytest.approx(24.0, abs=1.0)
    assert abs(on_axis[row, 1] - on_axis[row, -1]) <= 1


def test_sixty_decibels_over_the_floor_are_120_counts() -> None:
    place = (40 * CELL_M * 6, 0.0)
    levels = [picture([place], snr).max() for snr in (30.0, 50.0)]
    assert DB * (levels[1] - levels[0]) == pytest.approx(20.0, abs=1.0)
    floor = np.median(picture([(500.0, 0.0)], 0.0)[460:])
    assert floor == pytest.approx(RADAR.floor_count, abs=1)


def test_echoes_move_by_their_velocity_while_the_beam_turns() -> None:
    """A sector lasts 62.5 ms: what recedes at 16 m/s is half a metre nearer at its beginning, to its left."""
    azimuth = np.radians([44.9, 0.0, -44.9])
    points = 50.0 * np.column_stack([np.cos(azimuth), np.sin(azimuth), np.zeros(3)])
    moved = in_sector(Scatterers.of(points, np.full(3, 16.0), np.ones(3)), 0)
    np.testing.assert_allclose(moved.range_m - 50.0, [-0.499, 0.0, 0.499], atol=0.01)
    np.testing.assert_allclose(np.degrees(moved.azimuth_rad), [-0.1, -45.0, -89.9], atol=1e-6)


def correlation(pictures: np.ndarray, axis: int) -> float:
    """Of neighbouring cells along an axis."""
    count = pictures.shape[axis]
    one, other = (np.take(pictures, range(first, first + count - 1), axis) for first in (0, 1))
    return float(np.corrcoef(one.ravel(), other.ravel())[0, 1])


def test_the_pictures_resemble_the_real_ones(shared_real: Path) -> None:
    """Counts by range: floor, spread and strong echoes, in six bands; correlation along range and azimuth."""
    real = Radiate(shared_real / "radiate")
    theirs = np.stack([np.asarray(real[i].radar["polar"]) for i in range(len(real))]) * 255
    frames = [simulate_frame("radiate-sim", sequence=sequence, index=4, sensors=("polar",)) for sequence in range(4)]
    ours = np.stack([np.asarray(frame.radar["polar"]) for frame in frames]) * 255
    for near, far in ((0, 2), (5, 10), (10, 20), (20, 45), (45, 80), (80, 100)):
        rows = slice(int(near / CELL_M), int(far / CELL_M))
        one, other = (np.percentile(each[:, rows], [25, 50, 75, 99]) for each in (theirs, ours))
        assert np.abs(one - other)[:2].max() < 10, (near, far)
        assert np.abs(one - other)[3] < 30, (near, far)
    alike = [[correlation(each[:, 60:], axis) for axis in (1, 2)] for each in (theirs, ours)]
    np.testing.assert_allclose(alike[0], alike[1], atol=0.12)


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("radiate")
    record("radiate-sim-mini", root, workers=1)
    return root


def test_written_turns_are_read_as_they_were_simulated(written: Path) -> None:
    data = open_dataset(written)
    assert data.name == "radiate"
    assert data.keys == tuple((f"sim_{s}_0", f"{i:06d}") for s in (0, 1) for i in (1, 2))
    for place, (sequence, index) in enumerate(((0, 0), (0, 1), (1, 0), (1, 1))):
        made, read = simulate_frame("radiate-sim-mini", sequence=sequence, index=index), data[place]
        for name in ("polar", "cartesian"):
            np.testing.assert_array_equal(made.radar[name], read.radar[name])
        np.testing.assert_array_equal(made.cloud("radar").points_m, read.cloud("radar").points_m)
        assert read.time_ns == made.time_ns
        ours, theirs = made.annotation.boxes, read.annotation.boxes
        drawn = {int(track): row for row, track in enumerate(ours.track_id)}
        assert len(theirs) > 0
        for row, track in enumerate(theirs.track_id):
            box = ours[[drawn[int(track)]]]
            np.testing.assert_allclose(theirs.centre_m[row, :2], box.centre_m[0, :2], atol=1e-5)
            np.testing.assert_allclose(theirs.size_m[row, :2], box.size_m[0, :2], atol=1e-5)
            assert np.cos(theirs.yaw_rad[row] - box.yaw_rad[0]) > 1 - 1e-9
    assert data[1].time_ns - data[0].time_ns == 250_000_000
    assert json.loads((written / "sim_0_0" / "meta.json").read_text())["type"] == "city"


def test_boxes_hold_echoes() -> None:
    """Nine of ten drawn vehicles have a cell well over the floor in the picture."""
    moment = RadiateFrame(drive_of(simulate_preset(), 0, 0), 3)
    polar, boxes = moment.polar.astype(float), moment.boxes
    best = []
    for centre, size, yaw, label in zip(boxes.centre_m, boxes.size_m, boxes.yaw_rad, boxes.label, strict=True):
        if label != "vehicle":
            continue
        along, across = np.meshgrid(np.linspace(-0.5, 0.5, 15) * size[0], np.linspace(-0.5, 0.5, 9) * size[1])
        x = centre[0] + along * np.cos(yaw) - across * np.sin(yaw)
        y = centre[1] + along * np.sin(yaw) + across * np.cos(yaw)
        rows = np.clip(np.rint(np.hypot(x, y) / CELL_M).astype(int), 0, 575)
        columns = np.floor(-np.degrees(np.arctan2(y, x)) / 0.9).astype(int) % 400
        best.append(polar[rows, columns].max())
    assert len(best) >= 5
    assert np.mean(np.array(best) > RADAR.floor_count + 20) >= 0.9


def simulate_preset():
    from farfield.simulation import find_preset

    return find_preset("radiate-sim")


def test_the_cloud_needs_the_polar_picture(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="polar"):
        record("radiate-sim-mini", tmp_path, frames=1, sequences=1, sensors="cartesian", workers=1)
