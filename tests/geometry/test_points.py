"""Points in boxes: the definition, the surface, and Argoverse 2's own counts."""

from pathlib import Path

import numpy as np
import pytest

from farfield.geometry.boxes import Boxes, box_coordinates_m, count_points_in_boxes, inside_box, points_in_boxes
from farfield.geometry.poses import invert, pose_from_yaw, transform_points, yaw_from_quaternion


def scene(rng: np.random.Generator) -> tuple[np.ndarray, Boxes]:
    boxes = Boxes(
        centre_m=rng.uniform(-30, 30, (40, 3)) * [1, 1, 0.05] + [220, 0, 0],
        size_m=rng.uniform(0.5, 12, (40, 3)),
        yaw_rad=rng.uniform(-4, 4, 40),
    )
    return rng.uniform(-40, 40, (20_000, 3)) * [1, 1, 0.1] + [220, 0, 0], boxes


@pytest.mark.parametrize("margin_m", [0.0, 0.4])
def test_equal_to_the_definition_in_the_box_s_own_frame(rng: np.random.Generator, margin_m: float) -> None:
    points_m, boxes = scene(rng)
    found = points_in_boxes(points_m, boxes, margin_m=margin_m)
    total = 0
    for index, box in enumerate(boxes):  # type: ignore[arg-type, var-annotated]
        own_T_lidar = invert(pose_from_yaw(float(box.yaw_rad[0]), box.centre_m[0]))
        local = transform_points(own_T_lidar, points_m)
        inside = (np.abs(local) <= box.size_m[0] / 2 + margin_m).all(axis=1)
        np.testing.assert_array_equal(found[index], np.flatnonzero(inside))
        total += int(inside.sum())
    assert total > 1000
    assert count_points_in_boxes(points_m, boxes, margin_m=margin_m).sum() == total


def test_faces_edges_and_corners_belong_to_the_box() -> None:
    box = Boxes(centre_m=np.array([[8.0, 0.0, 0.0]]), size_m=np.array([[4.0, 2.0, 1.0]]), yaw_rad=np.zeros(1))
    points_m = np.array(
        [[10, 0, 0], [10, 1, 0], [10, 1, 0.5], [6, -1, -0.5], [10.001, 0, 0], [8, 1.001, 0], [8, 0, 0.501]]
    )
    assert inside_box(points_m, box, 0).tolist() == [True, True, True, True, False, False, False]
    assert points_in_boxes(points_m, box)[0].tolist() == [0, 1, 2, 3]
    assert points_in_boxes(points_m, box, margin_m=0.01)[0].tolist() == [0, 1, 2, 3, 4, 5, 6]
    assert len(points_in_boxes(box.corners_m()[0], box)[0]) == 8


def test_box_coordinates_have_x_along_the_heading() -> None:
    box = Boxes(centre_m=np.array([[5.0, 5.0, 1.0]]), size_m=np.ones((1, 3)), yaw_rad=np.array([np.pi / 2]))
    np.testing.assert_allclose(box_coordinates_m(np.array([[5.0, 8.0, 3.0]]), box, 0), [[3.0, 0.0, 2.0]], atol=1e-12)


def test_a_point_may_be_in_several_boxes() -> None:
    boxes = Boxes(centre_m=np.zeros((2, 3)), size_m=np.array([[1.0, 1, 1], [3.0, 3, 3]]), yaw_rad=np.zeros(2))
    assert count_points_in_boxes(np.array([[0.0, 0, 0], [1.0, 1, 1]]), boxes).tolist() == [1, 2]


def test_float32_points_and_empty_inputs() -> None:
    box = Boxes(centre_m=np.zeros((1, 3)), size_m=np.ones((1, 3)), yaw_rad=np.zeros(1))
    assert count_points_in_boxes(np.zeros((3, 3), dtype=np.float32), box).tolist() == [3]
    assert count_points_in_boxes(np.zeros((0, 3)), box).tolist() == [0]
    assert points_in_boxes(np.zeros((3, 3)), Boxes.empty()) == []


def test_interior_counts_equal_argoverse_2_s_for_every_box(shared_real: Path) -> None:
    """Argoverse 2 gives each cuboid's number of interior points; its sweeps and cuboids are in the ego frame."""
    feather = pytest.importorskip("pyarrow.feather")
    [log] = (shared_real / "argoverse2" / "val").iterdir()
    table = feather.read_table(log / "annotations.feather").to_pydict()
    columns = {name: np.array(values) for name, values in table.items()}
    checked = 0
    for sweep in sorted((log / "sensors" / "lidar").glob("*.feather")):
        cloud = feather.read_table(sweep)
        points_m = np.stack([cloud[axis].to_numpy().astype(np.float64) for axis in "xyz"], axis=1)
        rows = columns["timestamp_ns"] == int(sweep.stem)
        quaternion = np.stack([columns[name][rows] for name in ("qx", "qy", "qz", "qw")], axis=1)
        boxes = Boxes(
            centre_m=np.stack([columns[name][rows] for name in ("tx_m", "ty_m", "tz_m")], axis=1),
            size_m=np.stack([columns[name][rows] for name in ("length_m", "width_m", "height_m")], axis=1),
            yaw_rad=yaw_from_quaternion(quaternion),
        )
        np.testing.assert_array_equal(count_points_in_boxes(points_m, boxes), columns["num_interior_pts"][rows])
        checked += len(boxes)
    assert checked > 100
