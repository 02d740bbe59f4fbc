"""A ROS 1 bag (version 2.0), written record by record from https://wiki.ros.org/Bags/Format/2.0, and its lies."""

import bz2
import hashlib
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

START = 1_700_000_000_123_456_789
HEADER = "uint32 seq\ntime stamp\nstring frame_id\n"
FIELD = (
    "uint8 INT8=1\nuint8 UINT8=2\nuint8 INT16=3\nuint8 UINT16=4\nuint8 INT32=5\nuint8 UINT32=6\nuint8 FLOAT32=7\n"
    "uint8 FLOAT64=8\nstring name\nuint32 offset\nuint8 datatype\nuint32 count\n"
)
RULE = "=" * 80
CLOUD = (
    "Header header\nuint32 height\nuint32 width\nPointField[] fields\nbool is_bigendian\nuint32 point_step\n"
    f"uint32 row_step\nuint8[] data\nbool is_dense\n{RULE}\nMSG: std_msgs/Header\n{HEADER}{RULE}\n"
    f"MSG: sensor_msgs/PointField\n{FIELD}"
)
CLOUD_MD5 = "1158d486dd51d683ce2f1be655c3c181"  # as `rosmsg md5 sensor_msgs/PointCloud2` prints it
STRING_MD5 = hashlib.md5(b"string data").hexdigest()


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def record(data: bytes, **fields: bytes) -> bytes:
    parts = b"".join(
        struct.pack("<I", len(name) + 1 + len(value)) + name.encode() + b"=" + value for name, value in fields.items()
    )
    return struct.pack("<I", len(parts)) + parts + struct.pack("<I", len(data)) + data


def u32(number: int) -> bytes:
    return struct.pack("<I", number)


def stamp(time_ns: int) -> bytes:
    return struct.pack("<II", *divmod(time_ns, 10**9))


def cloud(points: np.ndarray, time_ns: int, frame: str = "lidar") -> bytes:
    """``sensor_msgs/PointCloud2`` in ROS 1's serialisation: x, y, z, intensity as float32."""
    names = ("x", "y", "z", "intensity")
    fields = b"".join(text(name) + struct.pack("<IBI", 4 * row, 7, 1) for row, name in enumerate(names))
    data = points.astype("<f4").tobytes()
    head = u32(0) + stamp(time_ns) + text(frame) + struct.pack("<II", 1, len(points))
    return head + u32(4) + fields + struct.pack("<BIII", 0, 16, len(data), len(data)) + data + b"\1"


@dataclass
class Connection:
    """One publisher of a topic."""

    number: int
    topic: str = "/points"
    kind: str = "sensor_msgs/PointCloud2"
    definition: str = CLOUD
    md5sum: str = CLOUD_MD5

    def record(self) -> bytes:
        values = {"topic": self.topic, "type": self.kind, "md5sum": self.md5sum, "message_definition": self.definition}
        parts = b"".join(u32(len(k) + 1 + len(v.encode())) + f"{k}={v}".encode() for k, v in values.items())
        return record(parts, op=b"\7", topic=self.topic.encode(), conn=u32(self.number))


@dataclass
class Chunk:
    """Messages (connection, time, bytes) of one chunk."""

    messages: Sequence[tuple[Connection, int, bytes]]
    pack: str = "none"
    size: int | None = None
    offset: Callable[[int], int] = int
    at_connection: bool = True


@dataclass
class Bag:
    """A bag of chunks, and what its header and index say in place of the truth."""

    chunks: Sequence[Chunk]
    connections: Sequence[Connection] = field(default_factory=list)
    indexed: bool = True
    counts: dict[str, int] = field(default_factory=dict)
    chunk_at: dict[int, int] = field(default_factory=dict)

    def bytes(self) -> bytes:
        head_bytes = 13 + 4096
        body, infos, known = b"", [], {c.number: c for c in self.connections}
        for row, chunk in enumerate(self.chunks):
            inner, entries, seen = b"", {}, set()
            for connection, time_ns, message in chunk.messages:
                known.setdefault(connection.number, connection)
                start = len(inner)
                if connection.number not in seen:
                    inner += connection.record()
                    seen.add(connection.number)
                start = start if chunk.at_connection else len(inner)
                inner += record(message, op=b"\2", conn=u32(connection.number), time=stamp(time_ns))
                entries.setdefault(connection.number, []).append(stamp(time_ns) + u32(chunk.offset(start)))
            packed = packed_bytes(inner, chunk.pack)
            place = self.chunk_at.get(row, head_bytes + len(body))
            size = len(inner) if chunk.size is None else chunk.size
            body += record(packed, op=b"\5", compression=chunk.pack.encode(), size=u32(size))
            for number, rows in entries.items():
                body += record(b"".join(rows), op=b"\4", ver=u32(1), conn=u32(number), count=u32(len(rows)))
            times = [message[1] for message in chunk.messages]
            pairs = b"".join(u32(number) + u32(len(rows)) for number, rows in entries.items())
            info = {"ver": u32(1), "chunk_pos": struct.pack("<Q", place), "count": u32(len(entries))}
            infos.append(record(pairs, op=b"\6", **info, start_time=stamp(min(times)), end_time=stamp(max(times))))
        index = head_bytes + len(body) if self.indexed else 0
        counts = {"conn_count": len(known), "chunk_count": len(infos), **self.counts}
        fields = {name: u32(value) for name, value in counts.items()} | {"index_pos": struct.pack("<Q", index)}
        bare = len(record(b"", op=b"\3", **fields))
        head = record(b" " * (4096 - bare), op=b"\3", **fields)
        tail = b"".join(c.record() for c in known.values()) + b"".join(infos) if self.indexed else b""
        return b"#ROSBAG V2.0\n" + head + body + tail


def packed_bytes(data: bytes, pack: str) -> bytes:
    if pack == "bz2":
        return bz2.compress(data)
    if pack == "lz4":
        from lz4.frame import compress

        packed: bytes = compress(data)
        return packed
    return data


def sweep(number: int, count: int = 300) -> np.ndarray:
    rng = np.random.default_rng(number)
    return np.column_stack([rng.uniform(-40, 40, (count, 3)), rng.uniform(0, 1, count)])


def messages(numbers: Sequence[int], connection: Connection) -> list[tuple[Connection, int, bytes]]:
    times = [(number, START + number * 100_000_000) for number in numbers]
    return [(connection, time_ns + 5_000_000, cloud(sweep(number), time_ns)) for number, time_ns in times]


def write_ros1_bag(root: Path) -> Path:
    """A folder with one bag of three sweeps."""
    root.mkdir(parents=True, exist_ok=True)
    (root / "drive.bag").write_bytes(Bag([Chunk(messages(range(3), Connection(0)), "bz2")]).bytes())
    return root
