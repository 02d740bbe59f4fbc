"""Drives of ROS 1: poses of transforms and of odometry, images beside the clouds, from bags that rosbags wrote."""

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("rosbags")

from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from farfield.datasets import open_dataset

STORE = get_typestore(Stores.ROS1_NOETIC)
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
for name in TRANSFORMS:
    STORE.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", name))
START, STEP = 1_700_000_000_000_000_000, 100_000_000


def make(kind: str, **fields: Any) -> Any:
    return STORE.types[kind](**fields)


def header(time_ns: int, frame: str) -> Any:
    stamp = make("builtin_interfaces/msg/Time", sec=time_ns // 10**9, nanosec=time_ns % 10**9)
    return make("std_msgs/msg/Header", seq=7, stamp=stamp, frame_id=frame)


def cloud(time_ns: int, frame: str) -> Any:
    points = np.random.default_rng(time_ns % 97).uniform(-30, 30, (50, 3)).astype("<f4")
    fields = [
        make("sensor_msgs/msg/PointField", name=name, offset=4 * row, datatype=7, count=1)
        for row, name in enumerate("xyz")
    ]
    layout = {"height": 1, "width": 50, "is_bigendian": False, "point_step": 12, "row_step": 600, "is_dense": True}
    data = np.frombuffer(points.tobytes(), np.uint8)
    return make("sensor_msgs/msg/PointCloud2", header=header(time_ns, frame), fields=fields, data=data, **layout)


def quaternion(w: float) -> Any:
    return make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=w)


def odometry(time_ns: int, x: float, w: float = 1.0, child: str = "base") -> Any:
    pose = make(
        "geometry_msgs/msg/Pose", position=make("geometry_msgs/msg/Point", x=x, y=1.0, z=0.0), orientation=quaternion(w)
    )
    still = make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
    twist = make("geometry_msgs/msg/Twist", linear=still, angular=still)
    return make(
        "nav_msgs/msg/Odometry",
        header=header(time_ns, "odom"),
        child_frame_id=child,
        pose=make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36)),
        twist=make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
    )


def transform(time_ns: int, parent: str, child: str, x: float) -> Any:
    move = make("geometry_msgs/msg/Vector3", x=x, y=0.0, z=0.0)
    motion = make("geometry_msgs/msg/Transform", translation=move, rotation=quaternion(1.0))
    stamped = {"header": header(time_ns, parent), "child_frame_id": child, "transform": motion}
    return make("geometry_msgs/msg/TransformStamped", **stamped)


def picture(time_ns: int) -> Any:
    content = io.BytesIO()
    Image.fromarray(np.full((4, 6, 3), time_ns % 200, np.uint8)).save(content, format="PNG")
    data = np.frombuffer(content.getvalue(), np.uint8)
    return make("sensor_msgs/msg/CompressedImage", header=header(time_ns, "camera"), format="png", data=data)


def write(folder: Path, rows: list[tuple[str, int, Any]]) -> Path:
    folder.mkdir()
    with Writer(folder / "drive.bag") as writer:
        connections: dict[str, Any] = {}
        for topic, time_ns, message in rows:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], time_ns + 1000, STORE.serialize_ros1(message, kind))
    return folder


def sweeps(frame: str = "base") -> list[tuple[str, int, Any]]:
    return [("/points", START + k * STEP, cloud(START + k * STEP, frame)) for k in range(4)]


def places_m(folder: Path) -> list[float] | None:
    drive = open_dataset(folder).drives()[0]
    assert drive.times_ns is not None
    return None if drive.world_T_frame is None else drive.world_T_frame[:, 0, 3].tolist()


def odometries(name: str, **rest: Any) -> list[tuple[str, int, Any]]:
    return [(name, START + k * STEP, odometry(START + k * STEP, 2.0 * k, **rest)) for k in range(4)]


def test_poses_are_those_of_the_one_odometry(tmp_path: Path) -> None:
    assert places_m(write(tmp_path / "one", sweeps() + odometries("/odom"))) == [0, 2, 4, 6]
    assert places_m(write(tmp_path / "two", sweeps() + odometries("/odom") + odometries("/wheels"))) is None
    assert places_m(write(tmp_path / "none", sweeps() + odometries("/odom", w=0.0))) is None
    assert places_m(write(tmp_path / "other", sweeps() + odometries("/odom", child="trailer"))) is None


@pytest.mark.parametrize("kind", TRANSFORMS)
def test_transforms_go_before_odometry(kind: str, tmp_path: Path) -> None:
    rows = sweeps("lidar") + odometries("/odom")
    fixed = make(kind, transforms=[transform(START, "/base", "/lidar", 0.5)])
    rows.append(("/tf_static", START, fixed))
    for k in range(4):
        moved = make(kind, transforms=[transform(START + k * STEP, "/map", "/base", 10.0 * k)])
        rows.append(("/tf", START + k * STEP, moved))
    assert places_m(write(tmp_path / "drive", rows)) == [0.5, 10.5, 20.5, 30.5]


def test_pictures_come_with_the_sweep_nearest_in_time(tmp_path: Path) -> None:
    rows = sweeps() + [("/cam/image", START + k * STEP + 3_000_000, picture(START + k)) for k in range(3)]
    data = open_dataset(write(tmp_path / "drive", rows), stamp="log")
    assert [list(frame.images) for frame in data] == [["cam_image"]] * 3 + [[]]
    assert data[1].images["cam_image"].shape == (4, 6, 3)
