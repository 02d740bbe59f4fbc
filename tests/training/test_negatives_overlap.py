"""Mined negatives hold no part of an annotated object."""

import numpy as np

from farfield.frame import Annotation, Boxes
from farfield.training.negatives import false_boxes
from farfield.vocabulary.classes import UNSURE


def test_a_box_that_reaches_into_an_annotated_one_is_no_false_one() -> None:
    size = np.array([[4.5, 1.8, 1.5]])
    for label in ("car", UNSURE):
        annotated = Boxes(centre_m=np.array([[50.0, 0.0, 0.8]]), size_m=size, yaw_rad=np.zeros(1), label=[label])
        centre = np.array([[53.5, 0.0, 0.8], [60.0, 0.0, 0.8]])
        detected = Boxes(
            centre_m=centre,
            size_m=np.repeat(size, 2, axis=0),
            yaw_rad=np.zeros(2),
            label=["car"] * 2,
            score=np.array([0.9, 0.8]),
        )
        mined = false_boxes(detected, Annotation(boxes=annotated), 0.2)
        np.testing.assert_allclose(mined.centre_m[:, 0], [60.0])
