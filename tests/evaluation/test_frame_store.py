"""Frames that reports keep on disk."""

from pathlib import Path

import numpy as np
import pytest

from farfield.errors import ConfigError
from farfield.evaluation.record import load_frame, save_frame
from farfield.frame import Annotation, Boxes, Cloud, Constant, Frame, Sensor, merge_clouds


def test_a_stored_frame_knows_its_sensors_and_a_radar_has_no_intensity(tmp_path: Path) -> None:
    points = np.ones((3, 3), dtype=np.float32)
    mounted = np.eye(4)
    mounted[0, 3] = 2.5
    frame = Frame(
        sequence="s",
        frame_id="1",
        clouds={"lidar": Cloud(points, np.ones(3, np.float32)), "radar": Cloud(points, None, {"power": points[:, 0]})},
        sensors={
            "lidar": Sensor(kind="lidar", frame_T_sensor=np.eye(4), time_ns=5),
            "radar": Sensor(kind="radar", frame_T_sensor=mounted),
        },
    )
    save_frame(tmp_path, "0000", frame, None)
    back, _, _, _ = load_frame(tmp_path, "0000")
    assert back.clouds["radar"].intensity is None
    assert back.sensors["lidar"].time_ns == 5
    np.testing.assert_array_equal(back.sensors["radar"].frame_T_sensor, mounted)
    assert not back.has_annotation
    with pytest.raises(ConfigError, match="one kind of sensor"):
        merge_clouds(back, ["lidar", "radar"])


@pytest.mark.parametrize("velocity", [None, [[4.0, -2.0], [np.nan, np.nan]], [[4.0, -2.0, 0.1], [0.0, 0.0, 0.0]]])
def test_a_stored_frame_keeps_velocities(tmp_path: Path, velocity: list[list[float]] | None) -> None:
    boxes = Boxes(
        centre_m=np.zeros((2, 3)),
        size_m=np.ones((2, 3)),
        yaw_rad=np.zeros(2),
        velocity_m_s=None if velocity is None else np.array(velocity),
    )
    frame = Frame(sequence="s", frame_id="1", load_annotation=Constant(Annotation(boxes=boxes)))
    save_frame(tmp_path, "0000", frame, boxes)
    back, predicted, _, _ = load_frame(tmp_path, "0000")
    for got in (back.boxes, predicted):
        if velocity is None:
            assert got.velocity_m_s is None
        else:
            np.testing.assert_array_equal(got.velocity_m_s, velocity)
