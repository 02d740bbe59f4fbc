"""Writing ROS 2 bags (MCAP) file by file: each appears whole, and ``metadata.yaml``, which makes them a bag, last."""

import io
import shutil
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from jaxtyping import Float, Shaped, UInt8

from farfield.errors import MissingExtraError
from farfield.files.atomic import move_into_place, write_text

_VERSION = 9


def write_bag_part(
    path: Path, kinds: Mapping[str, str], messages: Iterable[tuple[str, int, bytes]], staging: Path
) -> dict[str, Any]:
    """Write one file of a bag; chunks of about a megabyte, compressed with zstd.

    Args:
        path: The file, ``.mcap``; its folder is made.
        kinds: Type of the messages of each topic; every file of a bag names the same.
        messages: Topic, time of recording, and bytes (CDR), by time of recording.
        staging: Folder that is made, and removed when it is done or fails.

    Returns:
        What :func:`write_bag_metadata` needs to know of it, as JSON takes it.

    Raises:
        MissingExtraError: If rosbags is not installed.
    """
    try:
        from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    except ImportError as error:
        raise MissingExtraError("rosbags", "bags", "Writing ROS 2 bags") from error
    shutil.rmtree(staging, ignore_errors=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    counts, first_ns, last_ns = dict.fromkeys(kinds, 0), None, 0
    try:
        writer = Writer(staging / path.stem, version=_VERSION, storage_plugin=StoragePlugin.MCAP)
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with writer:
            connections = {
                topic: writer.add_connection(topic, kind, typestore=store()) for topic, kind in kinds.items()
            }
            for topic, log_ns, raw in messages:
                writer.write(connections[topic], log_ns, raw)
                counts[topic] += 1
                first_ns, last_ns = log_ns if first_ns is None else first_ns, log_ns
        move_into_place(staging / path.stem / path.name, path)
    finally:
        shutil.rmtree(staging, ignore_errors=True)
    return {"path": path.name, "start_ns": first_ns or 0, "end_ns": last_ns, "counts": counts}


def write_bag_metadata(folder: Path, kinds: Mapping[str, str], parts: Sequence[Mapping[str, Any]]) -> Path:
    """Write what makes a folder of files a bag.

    Args:
        folder: The bag.
        kinds: Type of the messages of each topic.
        parts: What :func:`write_bag_part` returned of each file, in order.
    """
    full = [part for part in parts if sum(part["counts"].values())]
    start_ns = min((part["start_ns"] for part in full), default=0)
    totals = {topic: sum(part["counts"][topic] for part in parts) for topic in kinds}
    files = [
        {
            "path": part["path"],
            "starting_time": {"nanoseconds_since_epoch": part["start_ns"]},
            "duration": {"nanoseconds": part["end_ns"] - part["start_ns"]},
            "message_count": sum(part["counts"].values()),
        }
        for part in parts
    ]
    topics = [
        {
            "topic_metadata": {
                "name": topic,
                "type": kind,
                "serialization_format": "cdr",
                "offered_qos_profiles": [],
                "type_description_hash": store().hash_rihs01(kind),
            },
            "message_count": totals[topic],
        }
        for topic, kind in kinds.items()
    ]
    content = {
        "version": _VERSION,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": max((part["end_ns"] for part in full), default=0) - start_ns},
        "starting_time": {"nanoseconds_since_epoch": start_ns},
        "message_count": sum(totals.values()),
        "topics_with_message_count": topics,
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [part["path"] for part in parts],
        "files": files,
        "custom_data": None,
        "ros_distro": "humble",
    }
    path = folder / "metadata.yaml"
    write_text(path, yaml.safe_dump({"rosbag2_bagfile_information": content}, sort_keys=False))
    return path


# ROS 2 messages of arrays: clouds, pictures, positions, IMU, transforms; for what writes bags.

CLOUD, COMPRESSED = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/CompressedImage"
IMU, FIX, TRANSFORMS = "sensor_msgs/msg/Imu", "sensor_msgs/msg/NavSatFix", "tf2_msgs/msg/TFMessage"
_CODES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}


@cache
def store() -> Any:
    """What knows the types of ROS 2.

    Raises:
        MissingExtraError: If rosbags is not installed.
    """
    try:
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise MissingExtraError("rosbags", "bags", "Writing ROS 2 bags") from error
    return get_typestore(Stores.ROS2_HUMBLE)


def serialised(message: Any) -> bytes:
    """A message's bytes (CDR, little endian)."""
    return bytes(store().serialize_cdr(message, message.__msgtype__))


def _make(kind: str, **fields: Any) -> Any:
    return store().types[kind](**fields)


def _header(stamp_ns: int, frame: str) -> Any:
    seconds, rest = divmod(int(stamp_ns), 1_000_000_000)
    time = _make("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)
    return _make("std_msgs/msg/Header", stamp=time, frame_id=frame)


def _vector(values: Sequence[float] | Float[np.ndarray, " 3"]) -> Any:
    x, y, z = (float(value) for value in values)
    return _make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def cloud_message(columns: Mapping[str, Shaped[np.ndarray, " n"]], stamp_ns: int, frame: str) -> Any:
    """A cloud of named columns of equal length, packed one point after the other.

    Args:
        columns: Such as x, y, z, intensity, t; of 8 to 32 bits, or floating point of 64.
        stamp_ns: Its stamp.
        frame: Name of its coordinates.
    """
    dtype = np.dtype([(name, values.dtype.newbyteorder("<")) for name, values in columns.items()])
    rows = np.empty(len(next(iter(columns.values()))), dtype=dtype)
    for name, values in columns.items():
        rows[name] = values
    assert dtype.fields is not None
    fields = [
        _make("sensor_msgs/msg/PointField", name=name, offset=at, datatype=_CODES[kind.str[1:]], count=1)
        for name, (kind, at, *_) in dtype.fields.items()
    ]
    return _make(
        CLOUD,
        header=_header(stamp_ns, frame),
        height=1,
        width=len(rows),
        fields=fields,
        is_bigendian=False,
        point_step=dtype.itemsize,
        row_step=dtype.itemsize * len(rows),
        data=np.frombuffer(rows.tobytes(), dtype=np.uint8),
        is_dense=True,
    )


def jpeg_message(pixels: UInt8[np.ndarray, "height width 3"], stamp_ns: int, frame: str, *, quality: int = 85) -> Any:
    """A picture as JPEG."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="JPEG", quality=quality)
    data = np.frombuffer(buffer.getvalue(), dtype=np.uint8)
    return _make(COMPRESSED, header=_header(stamp_ns, frame), format="jpeg", data=data)


def imu_message(
    angular_rad_s: Float[np.ndarray, " 3"], acceleration_m_s2: Float[np.ndarray, " 3"], stamp_ns: int, frame: str
) -> Any:
    """What an IMU measured; it tells no orientation, by the convention of a covariance of -1."""
    unknown = np.array([-1.0, *[0.0] * 8])
    return _make(
        IMU,
        header=_header(stamp_ns, frame),
        orientation=_make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=unknown,
        angular_velocity=_vector(angular_rad_s),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=_vector(acceleration_m_s2),
        linear_acceleration_covariance=np.zeros(9),
    )


def fix_message(latitude_deg: float, longitude_deg: float, height_m: float, stamp_ns: int, frame: str) -> Any:
    """A position of a GPS with corrections from the ground."""
    return _make(
        FIX,
        header=_header(stamp_ns, frame),
        status=_make("sensor_msgs/msg/NavSatStatus", status=2, service=1),
        latitude=float(latitude_deg),
        longitude=float(longitude_deg),
        altitude=float(height_m),
        position_covariance=np.zeros(9),
        position_covariance_type=0,
    )


def transforms_message(stamp_ns: int, parent: str, poses: Mapping[str, Float[np.ndarray, "4 4"]]) -> Any:
    """Where frames stand in their parent, by name, ``parent_T_child``."""
    from scipy.spatial.transform import Rotation

    transforms = []
    for child, matrix in poses.items():
        x, y, z, w = (float(value) for value in Rotation.from_matrix(matrix[:3, :3]).as_quat())
        turn = _make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
        motion = _make("geometry_msgs/msg/Transform", translation=_vector(matrix[:3, 3]), rotation=turn)
        stamped = "geometry_msgs/msg/TransformStamped"
        transforms.append(_make(stamped, header=_header(stamp_ns, parent), child_frame_id=child, transform=motion))
    return _make(TRANSFORMS, transforms=transforms)
