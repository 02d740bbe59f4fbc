"""Vehicles' boxes in the picture, and which hits they let through."""

import numpy as np
import pytest

from farfield.geometry.boxes import Boxes
from farfield.geometry.cameras import Camera
from farfield.privacy.frames import drop_plates_off_vehicles, project_vehicles
from farfield.privacy.image_boxes import ImageBoxes

CAMERA = Camera(matrix=np.array([[100.0, 0, 100], [0, 100, 50], [0, 0, 1]]), width_px=200, height_px=100)


def boxes(*rows: tuple[float, float, str]) -> Boxes:
    """Cubes of 2 m at (x, y)."""
    return Boxes(
        centre_m=np.array([[x, y, 0.0] for x, y, _ in rows]),
        size_m=np.full((len(rows), 3), 2.0),
        yaw_rad=np.zeros(len(rows)),
        label=[label for *_, label in rows],
    )


def test_a_vehicle_ahead_is_projected_and_grown() -> None:
    """The near face lies 10 m ahead: 2 m are 20 pixels, and 24 with a fifth more."""
    found = project_vehicles(boxes((11, 0, "vehicle"), (11, 3, "pedestrian"), (-11, 0, "vehicle")), CAMERA)
    np.testing.assert_allclose(found, [[88, 38, 112, 62]])


def test_a_vehicle_beside_the_camera_reaches_to_the_edge() -> None:
    (left,) = project_vehicles(boxes((0.9, 1.2, "Car")), CAMERA)
    (right,) = project_vehicles(boxes((0.9, -1.2, "Car")), CAMERA)
    assert (left[0], left[1], left[3]) == (0, 0, 100)
    assert (right[2], right[1], right[3]) == (200, 0, 100)
    assert left[2] < 100 < right[0]


def test_nothing_there() -> None:
    assert project_vehicles(Boxes.empty(), CAMERA).shape == (0, 4)


@pytest.mark.parametrize(
    ("kind", "score", "left", "stays"),
    [
        ("plate", 0.2, 95, True),
        ("plate", 0.2, 150, False),
        ("plate", 0.4, 150, True),
        ("face", 0.2, 150, True),
    ],
)
def test_weak_plates_stay_within_vehicles_only(kind, score, left, stays) -> None:
    hits = ImageBoxes.of_kind(kind, np.array([[left, 45.0, left + 8, 49]]), np.array([score]))
    kept = drop_plates_off_vehicles(hits, project_vehicles(boxes((11, 0, "vehicle")), CAMERA), 0.3)
    assert len(kept) == stays
