"""Where sensors stand: products of one radar are one sensor, and the page of ``farfield stats`` draws them."""

import json
from pathlib import Path

import numpy as np
from drive import OS2_T_OS1, frame

from farfield.cli import stats
from farfield.datasets import open_dataset
from farfield.datasets.kradar.writer import KRadarWriter
from farfield.figures.rig import placement_figure
from farfield.inspection.placement import RigPlacement, SensorPlacement, placement


def test_the_page_draws_the_sensors(tmp_path: Path) -> None:
    writer = KRadarWriter(tmp_path / "set", columns=512)
    writer.write(frame(1))
    writer.finish()
    found = placement(open_dataset(writer.root))
    assert found is not None
    by_name = {name: each for each in found.sensors for name in each.names}
    assert by_name["radar"] is by_name["sparse"]
    np.testing.assert_allclose(by_name["os1-128"].frame_T_sensor, OS2_T_OS1)
    np.testing.assert_allclose(by_name["radar"].frame_T_sensor[:3, 3], [2.54, -0.3, -0.7])
    assert by_name["cam-front"].kind == "camera"
    assert stats.run(writer.root, out=tmp_path / "out", sweeps=0) == 0
    assert (tmp_path / "out/figures/sensor_placement.png").stat().st_size > 5000
    content = json.loads((tmp_path / "out/statistics.json").read_text())
    assert content["placement"]["reference"] == "os2-64"
    assert "Sensor placement" in (tmp_path / "out/statistics.html").read_text()


def test_one_sensor_needs_no_figure() -> None:
    one = SensorPlacement(kind="lidar", frame_T_sensor=np.eye(4), names=("lidar",))
    assert placement_figure(None) is None
    assert placement_figure(RigPlacement(reference="lidar", sensors=(one,), unknown=())) is None
