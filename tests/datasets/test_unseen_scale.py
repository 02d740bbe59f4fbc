"""Scale's LiDAR tasks by a generator that has not seen the reader."""

import numpy as np
import pytest

from farfield.geometry.boxes import count_points_in_boxes

from .generators.scale_trees import DEVICE_T_CAMERA, FRAME_IDS, scale_truth, write_scale
from .generators.truth import apply, check_dataset, open_recognised

CLASSES = {"Car": "vehicle", "Pedestrian": "pedestrian", "Cyclist": "bicycle"}


@pytest.mark.parametrize("answer", ["callback", "task"])
def test_a_tree_is_read_as_it_was_written(answer, tmp_path):
    write_scale(tmp_path, answer=answer)
    data = open_recognised(tmp_path)
    assert data.name == "scale"
    assert data.frame_ids == tuple(f"frame-{number}" for number in FRAME_IDS)
    assert data.assumptions == ()
    check_dataset(data, scale_truth(CLASSES))


def test_points_within_the_boxes_are_as_many_as_the_answer_says(tmp_path):
    for frame in open_recognised(write_scale(tmp_path)):
        counts = count_points_in_boxes(frame.cloud().points_m, frame.boxes)
        assert counts.tolist() == frame.boxes.point_count.tolist()


def test_without_the_task_names_are_counted(tmp_path):
    folder = write_scale(tmp_path)
    (folder / "callback.json").unlink()
    data = open_recognised(folder)
    assert data.frame_ids == tuple(f"frame-{number}" for number in FRAME_IDS)
    check_dataset(data, scale_truth(CLASSES))


def test_cameras_stand_where_they_were_put(tmp_path):
    for frame in open_recognised(write_scale(tmp_path)):
        assert len(frame.images) == len(frame.cameras) == len(DEVICE_T_CAMERA)
        for name, pose in zip(frame.cameras, DEVICE_T_CAMERA.values(), strict=True):
            assert frame.sensors[name].frame_T_sensor == pytest.approx(pose, abs=1e-9)
            assert frame.sensors[name].time_ns == frame.time_ns + 50_000_000
            ahead = apply(pose, np.array([[0.0, 0.0, 10.0]]))
            pixels, depth, _ = frame.cameras[name].project(ahead)
            assert (pixels[0].tolist(), depth[0]) == (pytest.approx([8.0, 6.0]), pytest.approx(10.0))
