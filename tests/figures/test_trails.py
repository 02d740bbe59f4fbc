"""Trails from above: where tracks are in the world, and what the picture holds."""

import numpy as np

from farfield.figures.trails import trails_of, trails_picture
from farfield.frame.drive import Drive
from farfield.geometry.boxes import Boxes
from farfield.geometry.poses import pose_from_yaw
from farfield.metrics.detections import Detections


def test_a_standing_car_is_a_point_in_the_world_and_a_line_without_poses() -> None:
    keys = tuple(("a", str(number)) for number in range(11))
    boxes = {
        key: Boxes(
            centre_m=np.array([[50.0 - number, 2.0, 0.0]]),
            size_m=np.ones((1, 3)),
            yaw_rad=np.zeros(1),
            label="car",
            track_id=np.array([4]),
        )
        for number, key in enumerate(keys)
    }
    poses = np.stack([pose_from_yaw(0.0)] * 11)
    poses[:, 0, 3] = np.arange(11)
    drive = Drive(name="a", indices=np.arange(11), keys=keys, world_T_frame=poses)
    plain = Detections(boxes=boxes, annotations={})
    world = Detections(boxes=boxes, annotations={}, drives=(drive,))
    np.testing.assert_allclose(trails_of(world)["a"][4], np.tile([50.0, 2.0], (11, 1)))
    np.testing.assert_allclose(trails_of(plain)["a"][4][:, 0], 50.0 - np.arange(11))
    axes = trails_picture(world).axes[0]
    path = next(line for line in axes.lines if line.get_label() == "sensor")
    np.testing.assert_allclose(path.get_xdata(), np.arange(11))
    assert axes.lines[0].get_marker() == "s"
    assert trails_picture(plain).axes[0].lines[0].get_marker() == "None"
    assert [text.get_text() for text in axes.get_legend().get_texts()][:2] == [
        "the sensor's path",
        "sensor at the start",
    ]
    assert trails_picture(plain).axes[0].get_title(loc="left") == "a: 1 track, 11 frames"
