from pathlib import Path

import numpy as np
import pytest
from trees import write_kitti, write_kitti_tracking

from farfield.datasets import open_dataset, recognise
from farfield.datasets.kitti.boxes import boxes_from_objects, camera_from_calib, objects_from_boxes
from farfield.datasets.kitti.object import VIRTUAL_CAMERA, Kitti, KittiWriter
from farfield.errors import DatasetError, FileFormatError
from farfield.files.kitti import read_calib, read_labels
from farfield.frame import Boxes, Camera, Cloud, Frame
from farfield.geometry.cameras import CAMERA_T_LIDAR_AXES, image_boxes
from farfield.geometry.kitti import camera_from_lidar, lidar_from_camera
from farfield.geometry.poses import pose, rotation_from_quaternion


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return write_kitti(tmp_path)


def test_objects_come_into_the_lidar_frame_with_their_centre(root):
    # By hand: bottom (2, 1.7, 20), h 1.5 -> centre (2, 0.95, 20) -> lidar (z + .33, -(x - .02), -(y + .06)).
    frame = open_dataset(root)[0]
    boxes = frame.boxes
    np.testing.assert_allclose(boxes.centre_m[0], [20.33, -1.98, -1.01], atol=1e-12)
    np.testing.assert_allclose(boxes.size_m[0], [4.0, 1.8, 1.5])
    # rotation_y -pi/2 looks ahead, so yaw 0; rotation_y 0 looks right, so yaw -pi/2
    np.testing.assert_allclose(boxes.yaw_rad, [0.0, -np.pi / 2], atol=1e-12)
    assert boxes.label.tolist() == ["vehicle", "bicycle"]
    assert len(frame.cloud().in_boxes(boxes)[0]) == 1


def test_dont_care_and_image_facts_stay_in_the_annotation(root):
    annotation = Kitti(root, classes="kitti")[0].annotation
    assert annotation.details["truncation"].tolist() == [0.1, 0.0]
    assert annotation.details["occlusion"].tolist() == [1, 0]
    assert annotation.details["box_px"].shape == (2, 4)
    assert annotation.unboxed["dontcare_px"].tolist() == [[503, 169, 590, 190]]
    assert annotation.original_label == ("Car", "Cyclist")
    assert annotation[1:].details["occlusion"].tolist() == [0]


def test_the_camera_projects_as_p2_does(root):
    frame = open_dataset(root)[0]
    point = np.array([[20.0, 1.5, -0.5]])
    rect = np.array([-1.5 + 0.02, 0.5 - 0.06, 20.0 - 0.33, 1.0])
    u, v, w = np.array([[700, 0, 600, 45.0], [0, 700, 180, -0.3], [0, 0, 1, 0.005]]) @ rect
    np.testing.assert_allclose(frame.cameras["camera"].project(point)[0][0], [u / w, v / w], atol=1e-9)


def test_camera_and_lidar_conventions_are_inverse(rng):
    n = 50
    tilt = pose(rotation_from_quaternion(np.array([0.01, -0.02, 0.005, 1.0])), np.array([0.1, -0.2, 0.3]))
    for camera_T_lidar, tolerance in ((CAMERA_T_LIDAR_AXES, 1e-12), (CAMERA_T_LIDAR_AXES @ tilt, 3e-3)):
        centre, size = rng.uniform(-50, 50, (n, 3)), rng.uniform(0.5, 10, (n, 3))
        yaw = rng.uniform(-np.pi, np.pi, n)
        back = lidar_from_camera(*camera_from_lidar(centre, size, yaw, camera_T_lidar), camera_T_lidar)
        np.testing.assert_allclose(back[0], centre, atol=1e-9)
        np.testing.assert_allclose(back[1], size)
        np.testing.assert_allclose(np.angle(np.exp(1j * (back[2] - yaw))), 0, atol=tolerance)


def test_labels_without_calibration_are_an_error(root):
    (root / "training/calib/000007.txt").unlink()
    with pytest.raises(DatasetError, match=r"calib/000007\.txt"):
        open_dataset(root)[0]


def test_image_sets_decide_the_split(root):
    (root / "ImageSets").mkdir()
    (root / "ImageSets/val.txt").write_text("000007\n000999\n")
    assert open_dataset(root).split("val").frame_ids == ("000007",)


def test_writer_round_trip(tmp_path, rng):
    boxes = Boxes(
        centre_m=rng.uniform([5, -40, -2], [200, 40, 1], (9, 3)),
        size_m=rng.uniform(0.3, 9, (9, 3)),
        yaw_rad=rng.uniform(-np.pi, np.pi, 9),
        label=[
            "vehicle", "large_vehicle", "pedestrian", "bicycle", "animal", "wheeled_pedestrian", "motorcycle",
            "trailer", "unknown",
        ],
    )  # fmt: skip
    cloud = Cloud(rng.uniform(-50, 50, (30, 3)).astype(np.float32), rng.uniform(0, 1, 30).astype(np.float32))
    camera = Camera(matrix=VIRTUAL_CAMERA.matrix, width_px=64, height_px=32)
    image = rng.integers(0, 255, (32, 64, 3)).astype(np.uint8)
    frame = Frame.of(cloud, boxes, images={"camera": image}, cameras={"camera": camera})
    KittiWriter(tmp_path).write(3, frame)
    got = open_dataset(tmp_path)[0]
    assert got.frame_id == "000003"
    np.testing.assert_array_equal(got.cloud().points_m, cloud.points_m)
    np.testing.assert_array_equal(got.cloud().intensity, cloud.intensity)
    np.testing.assert_array_equal(got.images["camera"], image)
    np.testing.assert_allclose(got.boxes.centre_m, boxes.centre_m, atol=1e-9)
    np.testing.assert_allclose(got.boxes.size_m, boxes.size_m)
    np.testing.assert_allclose(got.boxes.yaw_rad, boxes.yaw_rad, atol=1e-12)
    assert got.boxes.label.tolist() == boxes.label.tolist()
    np.testing.assert_allclose(got.cameras["camera"].matrix, camera.matrix)


def test_a_box_behind_the_camera_has_no_2d_box():
    boxes = Boxes(
        centre_m=np.array([[30.0, 0, 0], [-30.0, 0, 0]]), size_m=np.array([[4.0, 2, 2]] * 2), yaw_rad=np.zeros(2)
    )
    box_px, truncation = image_boxes(boxes, VIRTUAL_CAMERA)
    half = 1173.0 * 1.0 / 28.0  # half the width over the depth of the near face
    np.testing.assert_allclose(box_px[0, [0, 2]], [959.5 - half, 959.5 + half])
    assert box_px[1].tolist() == [-1.0] * 4
    assert truncation.tolist() == [0.0, 1.0]


@pytest.mark.parametrize(
    "line", ["Car 0 0 1.5 0 0 9 9 1.5 1.8 4 1 2 20 0.1", "0 0.5 0.5 0.1 0.1", "1 2 3 4 2 1.5 0.1 Car"]
)
def test_folders_of_other_labels_are_no_tracks(tmp_path, line):
    (tmp_path / "label").mkdir()
    (tmp_path / "label" / "000000.txt").write_text("")
    (tmp_path / "label" / "000001.txt").write_text(f"{line}\n")
    assert recognise(tmp_path) != "kitti_tracking"


def test_tracking_layout(tmp_path):
    write_kitti_tracking(tmp_path)
    data = open_dataset(tmp_path)
    assert data.name == "kitti_tracking"
    assert data.keys == (("0003", "000000"), ("0003", "000001"))
    assert data[1].boxes.track_id.tolist() == [5, 6]
    np.testing.assert_allclose(data[0].boxes.centre_m[0], [20.33, -1.98, -1.01], atol=1e-12)


class TestReal:
    def test_object_frames(self, shared_real):
        data = open_dataset(shared_real / "kitti")
        assert data.frame_ids == ("000000", "000001", "000134")
        counts = [len(frame.boxes) for frame in data]
        assert counts == [1, 3, 15]
        for frame in data:  # every annotated object carries points: the chain of calibrations is right
            assert min(len(inside) for inside in frame.cloud().in_boxes(frame.boxes)) > 0
        assert data[0].cameras["camera"].width_px == data[0].images["camera"].shape[1]

    def test_projected_boxes_equal_the_annotated_2d_boxes(self, shared_real):
        # Oracle: KITTI's own 2D boxes, drawn by people; objects that are whole and not occluded.
        errors = []
        for frame in open_dataset(shared_real / "kitti"):
            whole = (frame.annotation.details["truncation"] == 0) & (frame.annotation.details["occlusion"] == 0)
            px, _ = image_boxes(frame.boxes, frame.cameras["camera"])
            errors.append(np.abs(px - frame.annotation.details["box_px"])[whole])
        assert np.median(np.concatenate(errors)) < 4.0

    def test_labels_come_back(self, shared_real):
        path = shared_real / "kitti/training/label_2/000134.txt"
        objects = read_labels(path)
        calib = camera_from_calib(read_calib(shared_real / "kitti/training/calib/000134.txt"))
        boxes = boxes_from_objects(objects, calib)
        back = objects_from_boxes(boxes, Camera(matrix=np.eye(3), camera_T_lidar=calib), classes={})
        kept = objects[objects.has_box]
        np.testing.assert_allclose(
            back.bottom_m, kept.bottom_m, atol=0.02
        )  # the calibrated axes are tilted by 1 degree
        turn = np.angle(np.exp(1j * (back.rotation_y_rad - kept.rotation_y_rad)))
        np.testing.assert_allclose(turn, 0, atol=1e-3)

    def test_tracking_labels_alone(self, shared_real):
        data = open_dataset(shared_real / "kitti_tracking")
        assert data.name == "kitti_tracking"
        assert len(set(data.sequences)) == 10
        assert data[0].boxes.track_id is not None
        assert data[0].metadata["calibrated"] is False


def test_a_cloud_without_intensity_is_refused_and_says_which_has_one(tmp_path):
    points = np.ones((2, 3), np.float32)
    clouds = {"radar": Cloud(points, None, {"power": points[:, 0]}), "lidar": Cloud(points, points[:, 0])}
    frame = Frame(sequence="s", frame_id="1", clouds=clouds)
    with pytest.raises(DatasetError, match="LiDAR clouds with intensity, got a cloud of x_m, y_m, z_m, power"):
        KittiWriter(tmp_path).write(0, frame)
    KittiWriter(tmp_path).write(0, frame, cloud="lidar")


def test_reflectance_beyond_kittis_scale_is_refused(root):
    rows = np.array([[20.3, -2.0, -0.9, 255.0]], dtype="<f4")
    (root / "training/velodyne/000007.bin").write_bytes(rows.tobytes())
    with pytest.raises(FileFormatError, match="values from 0 to 1") as failed:
        open_dataset(root)[0].cloud()
    assert "intensity_scale=255" in str(failed.value)
