"""Annotation, the region that was annotated, and footprints."""

from dataclasses import replace

import numpy as np
import pytest

from farfield.frame import Annotation, Boxes, Camera, CameraField, Footprints
from farfield.geometry.poses import invert, pose_from_yaw, transform_points


def boxes(count: int = 3) -> Boxes:
    centre_m = np.column_stack([np.arange(10.0, 10.0 + count), np.zeros(count), np.zeros(count)])
    return Boxes(centre_m=centre_m, size_m=np.ones((count, 3)), yaw_rad=np.zeros(count), label=list("abc")[:count])


def annotation() -> Annotation:
    return Annotation(
        boxes=boxes(),
        visibility=["R", "L", "L1"],
        moving=np.array([True, False, True]),
        original_label=("Sedan", "Bus", "Sedan"),
        full_boxes=boxes(),
        details={"occlusion": np.array([0, 1, 2])},
    )


@pytest.mark.parametrize(
    "rows",
    [slice(1, None), np.array([False, True, True]), np.array([1, 2]), [1, 2]],
    ids=["slice", "mask", "array", "list"],
)
def test_all_that_is_known_of_boxes_is_cut_together(rows: object) -> None:
    part = annotation()[rows]
    assert part.boxes.label.tolist() == ["b", "c"]
    assert part.visibility == ("L", "L1")
    assert part.moving.tolist() == [False, True]
    assert part.original_label == ("Bus", "Sedan")
    assert part.full_boxes.label.tolist() == ["b", "c"]
    assert part.details["occlusion"].tolist() == [1, 2]
    assert len(annotation()[[]]) == 0


@pytest.mark.usefixtures("without_shape_checks")
@pytest.mark.parametrize(
    "change",
    [
        {"visibility": ["R"]},
        {"moving": np.array([True])},
        {"original_label": ("Sedan",)},
        {"full_boxes": boxes(2)},
        {"details": {"occlusion": np.zeros(4)}},
    ],
)
def test_rows_of_another_length_are_refused(change: dict) -> None:
    with pytest.raises(ValueError, match=rf"Annotation\.{next(iter(change.get('details', change)))}: expected 3 rows"):
        replace(annotation(), **change)


def test_the_region_moves_with_the_frame() -> None:
    camera = Camera(matrix=np.array([[100.0, 0, 50], [0, 100.0, 30], [0, 0, 1]]), width_px=100, height_px=60)
    seen = np.array([[10.0, 0, 0], [10.0, 4.9, 0], [10.0, 5.6, 0], [-10.0, 0, 0]])
    region = CameraField(camera=camera, name="the camera")
    assert region.contains(seen).tolist() == [True, True, False, False]
    motion = pose_from_yaw(1.0, (3.0, 2.0, 1.0))
    given = replace(annotation(), region=region)
    there = given.moved(motion)
    assert there.region.contains(transform_points(motion, seen)).tolist() == [True, True, False, False]
    np.testing.assert_allclose(
        there.moved(invert(motion)).region.camera.camera_T_lidar, camera.camera_T_lidar, atol=1e-9
    )
    with pytest.raises(ValueError, match="expected the size of cam's image"):
        CameraField(camera=replace(camera, width_px=0), name="cam")


def test_footprints_turn_and_move_seen_from_above() -> None:
    above = Footprints(
        label=("Bus",), centre_m=np.array([[10.0, 1.0]]), size_m=np.array([[10.0, 2.5]]), yaw_rad=np.array([0.5])
    )
    given = replace(annotation(), unboxed={"from_above": above, "dontcare_px": np.zeros((1, 4))})
    turned = given.moved(pose_from_yaw(np.pi / 2, (1.0, 0.0, 0.0))).unboxed
    np.testing.assert_allclose(turned["from_above"].centre_m, [[0.0, 10.0]], atol=1e-9)
    np.testing.assert_allclose(turned["from_above"].yaw_rad, [0.5 + np.pi / 2])
    np.testing.assert_array_equal(turned["dontcare_px"], given.unboxed["dontcare_px"])
