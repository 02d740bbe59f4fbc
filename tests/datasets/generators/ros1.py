"""ROS 1 bags, version 2.0, record by record: two LiDARs, a radar, transforms.

Source: the bag format 2.0 of the ROS wiki (http://wiki.ros.org/Bags/Format/2.0) and the message definitions of
common_msgs and geometry2 (BSD-3-Clause).
"""

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from .scene import Scene, pose_of, quaternion, rotation_x, rotation_z, seen, strengths
from .truth import CloudTruth, FrameTruth, Truth

START_NS = 1_677_000_111_123_456_789
HEADER = "uint32 seq\ntime stamp\nstring frame_id\n"
RULE = "=" * 80
CLOUD_TEXT = (
    "Header header\nuint32 height\nuint32 width\nPointField[] fields\nbool is_bigendian\nuint32 point_step\n"
    f"uint32 row_step\nuint8[] data\nbool is_dense\n{RULE}\nMSG: std_msgs/Header\n{HEADER}{RULE}\n"
    "MSG: sensor_msgs/PointField\nuint8 INT8=1\nuint8 UINT8=2\nuint8 INT16=3\nuint8 UINT16=4\nuint8 INT32=5\n"
    "uint8 UINT32=6\nuint8 FLOAT32=7\nuint8 FLOAT64=8\nstring name\nuint32 offset\nuint8 datatype\nuint32 count\n"
)
TRANSFORM_TEXT = (
    f"geometry_msgs/TransformStamped[] transforms\n{RULE}\nMSG: geometry_msgs/TransformStamped\nHeader header\n"
    f"string child_frame_id\nTransform transform\n{RULE}\nMSG: std_msgs/Header\n{HEADER}{RULE}\n"
    f"MSG: geometry_msgs/Transform\nVector3 translation\nQuaternion rotation\n{RULE}\nMSG: geometry_msgs/Vector3\n"
    f"float64 x\nfloat64 y\nfloat64 z\n{RULE}\nMSG: geometry_msgs/Quaternion\n"
    "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
)
KINDS = {
    "cloud": ("sensor_msgs/PointCloud2", "1158d486dd51d683ce2f1be655c3c181", CLOUD_TEXT),
    "tf": ("tf2_msgs/TFMessage", "94810edda583a504dfda3829e70d7eec", TRANSFORM_TEXT),
}
CODES = {"f4": 7, "u2": 4, "u1": 2}
MOUNTS = {
    "velodyne": pose_of(rotation_z(0.03) @ rotation_x(0.01), (1.2, 0.1, 1.9)),
    "rear": pose_of(rotation_z(3.0), (-0.9, -0.2, 1.1)),
}


def write_ros1(path: Path, *, frames: int = 3) -> Truth:
    """A bag of a drive."""
    scene, messages, truths = Scene(101, (310.5, -77.25, 4.0), 1.1), [], []
    edges = [("base_link", child, mount) for child, mount in MOUNTS.items()]
    messages.append(("/tf_static", "tf", START_NS - 10**7, transforms(START_NS - 10**7, edges)))
    for number in range(frames):
        time_ns = START_NS + number * 100_000_000
        pose = scene.world_T_ego(number * 0.1)
        messages.append(("/tf", "tf", time_ns + 100, transforms(time_ns, [("map", "base_link", pose)])))
        clouds = {}
        for salt, (frame_id, mount) in enumerate(MOUNTS.items()):
            if frame_id == "rear" and number == frames - 1:
                continue  # so that the other one has the most messages and names the coordinates
            world = scene.points(number, number * 0.1, 110 + salt, clutter=33 + 6 * salt)
            held, exact = seen(world, pose @ mount)
            count = len(held)
            table = np.zeros(
                count,
                [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2"), ("time", "<f4")],
            )
            table["x"], table["y"], table["z"] = held.T
            table["intensity"], table["ring"] = strengths(count, salt), np.arange(count) % 16
            table["time"] = np.linspace(0, 0.0987, count)
            topic = f"/{frame_id}_points"
            messages.append((topic, "cloud", time_ns + 2000 + salt, cloud(table, time_ns, frame_id, number)))
            clouds[f"{frame_id}_points"] = CloudTruth(
                world_m=exact,
                intensity=table["intensity"] / 255,
                columns={"ring": table["ring"].astype(float)},
                offsets_s=table["time"].astype(float),
                time_ns=time_ns,
            )
        truths.append(
            FrameTruth(sequence=path.stem, frame_id=None, time_ns=time_ns, clouds=clouds, boxes=None, world_T_ego=pose)
        )
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(bag(messages))
    return Truth(frames=truths)


def text(value: str) -> bytes:
    """A string of a message."""
    return struct.pack("<I", len(value)) + value.encode()


def header(time_ns: int, frame_id: str, number: int = 0) -> bytes:
    """The header of a message."""
    return struct.pack("<III", number, time_ns // 10**9, time_ns % 10**9) + text(frame_id)


def cloud(table: np.ndarray, time_ns: int, frame_id: str, number: int) -> bytes:
    """A PointCloud2."""
    fields = struct.pack("<I", len(table.dtype.names or ()))
    for name in table.dtype.names or ():
        kind, offset = (table.dtype.fields or {})[name][:2]
        fields += text(name) + struct.pack("<IBI", offset, CODES[kind.str[1:]], 1)
    data = table.tobytes()
    shape = struct.pack("<BIII", 0, table.dtype.itemsize, len(data), len(data))
    return header(time_ns, frame_id, number) + struct.pack("<II", 1, len(table)) + fields + shape + data + b"\1"


def transforms(time_ns: int, edges: Sequence[tuple[str, str, np.ndarray]]) -> bytes:
    """A TFMessage."""
    data = struct.pack("<I", len(edges))
    for parent, child, pose in edges:
        w, x, y, z = quaternion(pose[:3, :3])
        data += header(time_ns, parent) + text(child) + struct.pack("<7d", *pose[:3, 3], x, y, z, w)
    return data


def record(fields: Mapping[str, bytes], data: bytes) -> bytes:
    """A record: its header's fields, then its data."""
    parts = b"".join(
        struct.pack("<I", len(name) + 1 + len(value)) + name.encode() + b"=" + value for name, value in fields.items()
    )
    return struct.pack("<I", len(parts)) + parts + struct.pack("<I", len(data)) + data


def stamp(time_ns: int) -> bytes:
    """A time of a record."""
    return struct.pack("<II", time_ns // 10**9, time_ns % 10**9)


def bag(messages: Sequence[tuple[str, str, int, bytes]]) -> bytes:
    """A bag of (topic, kind, time, message) in two chunks."""
    topics = {topic: (number, kind) for number, (topic, kind) in enumerate({m[0]: m[1] for m in messages}.items())}
    connections = {
        topic: record(
            {"op": b"\x07", "conn": struct.pack("<I", number), "topic": topic.encode()},
            b"".join(
                struct.pack("<I", len(entry)) + entry
                for entry in (
                    b"topic=" + topic.encode(),
                    b"type=" + KINDS[kind][0].encode(),
                    b"md5sum=" + KINDS[kind][1].encode(),
                    b"message_definition=" + KINDS[kind][2].encode(),
                )
            ),
        )
        for topic, (number, kind) in topics.items()
    }
    magic = b"#ROSBAG V2.0\n"
    body, infos, start, written = b"", [], len(magic) + 4096, set()
    half = len(messages) // 2
    for part in (messages[:half], messages[half:]):
        chunk, index = b"", {}
        for topic, _, time_ns, data in part:
            if topic not in written:
                chunk += connections[topic]
                written.add(topic)
            index.setdefault(topic, []).append((time_ns, len(chunk)))
            fields = {"op": b"\x02", "conn": struct.pack("<I", topics[topic][0]), "time": stamp(time_ns)}
            chunk += record(fields, data)
        position = start + len(body)
        body += record({"op": b"\x05", "compression": b"none", "size": struct.pack("<I", len(chunk))}, chunk)
        for topic, entries in index.items():
            fields = {
                "op": b"\x04",
                "ver": struct.pack("<I", 1),
                "conn": struct.pack("<I", topics[topic][0]),
                "count": struct.pack("<I", len(entries)),
            }
            body += record(fields, b"".join(stamp(time_ns) + struct.pack("<I", offset) for time_ns, offset in entries))
        times = [time_ns for _, _, time_ns, _ in part]
        fields = {
            "op": b"\x06",
            "ver": struct.pack("<I", 1),
            "chunk_pos": struct.pack("<Q", position),
            "start_time": stamp(min(times)),
            "end_time": stamp(max(times)),
            "count": struct.pack("<I", len(index)),
        }
        counted = b"".join(struct.pack("<II", topics[topic][0], len(entries)) for topic, entries in index.items())
        infos.append(record(fields, counted))
    fields = {
        "op": b"\x03",
        "index_pos": struct.pack("<Q", start + len(body)),
        "conn_count": struct.pack("<I", len(topics)),
        "chunk_count": struct.pack("<I", 2),
    }
    head = record(fields, b"")
    padded = head[:-4] + struct.pack("<I", 4096 - len(head)) + b" " * (4096 - len(head))
    return magic + padded + body + b"".join(connections.values()) + b"".join(infos)
