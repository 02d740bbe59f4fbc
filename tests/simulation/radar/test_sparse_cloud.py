"""K-Radar's sparse cloud: the same points whether the cells with their velocities were made before or not."""

import numpy as np
import pytest

from farfield.radar.axes import KRADAR_AXES
from farfield.radar.cells import cells_of_cube
from farfield.radar.products import Moments, doppler_cube, zyx_cube
from farfield.simulation.presets import find_preset
from farfield.simulation.rigs import kradar
from farfield.simulation.rigs.drive import drive_of


def test_a_sparse_cloud_needs_no_velocities(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    power = rng.exponential(1e11, (3, *KRADAR_AXES.shape[1:])).astype(np.float32)
    drive = drive_of(find_preset("kradar-sim"), 0, 0)
    whole, spare = (kradar.KRadarFrame(drive, 0) for _ in range(2))
    cube = zyx_cube(power[0])
    for moment in (whole, spare):
        moment.__dict__["cube"] = cube
    whole.__dict__["moments"] = Moments(*power)
    whole.__dict__["cells"] = cells_of_cube(cube, "wide", doppler_m_s=doppler_cube(power[1], power[2]))
    expected = whole.product("sparse")
    monkeypatch.setattr(kradar, "doppler_cube", None)
    found = spare.product("sparse")
    assert isinstance(found, np.ndarray)
    assert found.shape[0] > 10_000
    assert np.array_equal(found, expected)
