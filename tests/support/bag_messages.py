"""Bags for tests, written by rosbags itself: a lidar, a radar, two cameras, an IMU, transforms."""

from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
START = 1_700_000_000_123_456_789
CODES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}


def make(kind: str, **fields: Any) -> Any:
    return STORE.types[kind](**fields)


def header(stamp_ns: int, frame: str) -> Any:
    time = make("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return make("std_msgs/msg/Header", stamp=time, frame_id=frame)


def cloud(
    points: np.ndarray, stamp_ns: int, frame: str, *, height: int = 1, padding: int = 0, big: bool = False
) -> Any:
    """A structured array as a message; ``padding`` bytes stand behind each row."""
    order = ">" if big else "<"
    dtype = points.dtype.newbyteorder(order)
    rows = points.astype(dtype).reshape(height, -1)
    data = b"".join(row.tobytes() + b"\xaa" * padding for row in rows)
    fields = [
        make(
            "sensor_msgs/msg/PointField",
            name=name,
            offset=dtype.fields[name][1],
            datatype=CODES[dtype.fields[name][0].str[1:]],
            count=1,
        )
        for name in dtype.names
    ]
    return make(
        "sensor_msgs/msg/PointCloud2",
        header=header(stamp_ns, frame),
        height=height,
        width=rows.shape[1],
        fields=fields,
        is_bigendian=big,
        point_step=dtype.itemsize,
        row_step=rows.shape[1] * dtype.itemsize + padding,
        data=np.frombuffer(data, dtype=np.uint8),
        is_dense=False,
    )


def image(pixels: np.ndarray, stamp_ns: int, *, encoding: str = "rgb8", padding: int = 0) -> Any:
    rows = [row.tobytes() + b"\0" * padding for row in pixels]
    return make(
        "sensor_msgs/msg/Image",
        header=header(stamp_ns, "camera"),
        height=len(pixels),
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=len(rows[0]),
        data=np.frombuffer(b"".join(rows), dtype=np.uint8),
    )


def compressed(content: bytes, stamp_ns: int, *, kind: str = "png") -> Any:
    data = np.frombuffer(content, dtype=np.uint8)
    return make("sensor_msgs/msg/CompressedImage", header=header(stamp_ns, "camera"), format=kind, data=data)


def transforms(stamp_ns: int, *edges: tuple[str, str, tuple[float, float, float], float]) -> Any:
    """Edges of parent, child, place and yaw."""
    found = []
    for parent, child, place, yaw in edges:
        turn = make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=float(np.sin(yaw / 2)), w=float(np.cos(yaw / 2)))
        at = make("geometry_msgs/msg/Vector3", x=float(place[0]), y=float(place[1]), z=float(place[2]))
        motion = make("geometry_msgs/msg/Transform", translation=at, rotation=turn)
        stamped = "geometry_msgs/msg/TransformStamped"
        found.append(make(stamped, header=header(stamp_ns, parent), child_frame_id=child, transform=motion))
    return make("tf2_msgs/msg/TFMessage", transforms=found)


def imu(stamp_ns: int, turn: float) -> Any:
    zero = {"x": 0.0, "y": 0.0}
    none = np.zeros(9)
    return make(
        "sensor_msgs/msg/Imu",
        header=header(stamp_ns, "imu"),
        orientation=make("geometry_msgs/msg/Quaternion", **zero, z=0.0, w=1.0),
        orientation_covariance=none,
        angular_velocity=make("geometry_msgs/msg/Vector3", **zero, z=turn),
        angular_velocity_covariance=none,
        linear_acceleration=make("geometry_msgs/msg/Vector3", **zero, z=9.81),
        linear_acceleration_covariance=none,
    )


def write_bag(path: Path, messages: list[tuple[str, int, Any]], *, mcap: bool) -> Path:
    """A bag of (topic, time of recording, message)."""
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connections = {}
        for topic, log_ns, message in sorted(messages, key=lambda row: row[1]):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, message.__msgtype__, typestore=STORE)
            writer.write(connections[topic], log_ns, STORE.serialize_cdr(message, message.__msgtype__))
    return path
