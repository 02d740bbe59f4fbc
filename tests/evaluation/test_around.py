"""Detection all around by a detector that looks ahead."""

import numpy as np

from farfield.datasets.open_sweeps import OpenSweeps
from farfield.evaluation.around import detect_around
from farfield.frame import Boxes, Frame


def ahead(frame: Frame) -> Boxes:
    """What is annotated ahead of the sensor."""
    assert frame.boxes is not None
    boxes = frame.boxes[frame.boxes.centre_m[:, 0] > 0]
    return boxes.replace(score=np.ones(len(boxes)))


def test_each_object_is_found_once_where_it_stands() -> None:
    frame = OpenSweeps()[0]
    boxes = detect_around(ahead, frame)
    assert frame.boxes is not None
    order, expected = (np.lexsort(one.centre_m.T) for one in (boxes, frame.boxes))
    np.testing.assert_allclose(boxes.centre_m[order], frame.boxes.centre_m[expected], atol=1e-9)
    np.testing.assert_allclose(np.cos(boxes.yaw_rad[order] - frame.boxes.yaw_rad[expected]), 1, atol=1e-9)


def test_one_object_on_the_seam_is_not_found_from_both_sides() -> None:
    """The same car found a little ahead of the sensor, and behind it with another score."""
    centre_m, size_m = np.array([[0.05, 8.0, 0.0], [0.1, -8.0, 0.0]]), np.array([[4.5, 1.8, 1.5]] * 2)
    both = Boxes(centre_m=centre_m, size_m=size_m, yaw_rad=np.zeros(2), label=["vehicle"] * 2)
    boxes = detect_around(lambda frame: both.replace(score=np.array([0.9, 0.4])), OpenSweeps()[0])
    np.testing.assert_allclose(boxes.centre_m[:, :2], [[0.05, 8.0], [-0.05, -8.0]], atol=1e-9)
    labels = iter(["vehicle", "pedestrian"])
    other = detect_around(
        lambda frame: both.replace(score=np.array([0.9, 0.4]), label=[next(labels)] * 2), OpenSweeps()[0]
    )
    assert len(other) == 4
