"""Structural edits of ROS 2 bags: point clouds whose bytes are laid out here, in bags that rosbags writes."""

import importlib.util
import struct
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from _structures import Case, Family, Oracle, Reading, apart
from _structures_clouds import (
    GROUPS,
    STRENGTHS,
    Sweeps,
    chosen_edits,
    differences,
    infinite_place,
    make_sweeps,
    no_place,
    other_places,
)

import farfield as ff

CODES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
KIND = "sensor_msgs/msg/PointCloud2"
BAG_GROUPS = {name: tuple(edit for edit in edits if edit is not infinite_place) for name, edits in GROUPS.items()}


class Cdr:
    """Bytes of a message in CDR, aligned as OMG's standard has it."""

    def __init__(self, order: str = "<") -> None:
        self.order, self.body = order, bytearray()

    def put(self, kind: str, value: float) -> None:
        """One number."""
        size = struct.calcsize(kind)
        self.body += b"\0" * (-len(self.body) % size) + struct.pack(self.order + kind, value)

    def text(self, value: str) -> None:
        """A text behind its length, with a zero."""
        self.put("I", len(value) + 1)
        self.body += value.encode() + b"\0"

    def data(self) -> bytes:
        """The message, its order of bytes ahead."""
        return bytes([0, self.order == "<", 0, 0]) + bytes(self.body)


def lay_out(columns: Mapping[str, np.ndarray], *, gap: int = 0, behind: int = 0) -> tuple[np.dtype, list[Any]]:
    """Where each column stands in a point: with gaps between them and bytes behind."""
    offset, rows = 0, []
    for name, values in columns.items():
        count = values.shape[1] if values.ndim == 2 else 1
        rows.append((name, values.dtype, offset, count))
        offset += values.dtype.itemsize * count + gap
    names = [f"c{number}" for number in range(len(rows))]
    formats = [(kind, (count,)) if count > 1 else kind for _, kind, _, count in rows]
    whole: Any = {"names": names, "formats": formats, "offsets": [row[2] for row in rows], "itemsize": offset + behind}
    return np.dtype(whole), rows


def point_cloud(
    columns: Mapping[str, np.ndarray],
    stamp_ns: int,
    *,
    gap: int = 0,
    behind: int = 0,
    height: int = 1,
    row_padding: int = 0,
    big: bool = False,
    dense: bool = False,
    big_message: bool = False,
    wide: int = 0,
    step: int = 0,
    row_step: int | None = None,
    cut: int = 0,
    longer: int = 0,
    code: int = 0,
    far: int = 0,
    double: bool = False,
    zero_count: bool = False,
) -> bytes:
    """A ``PointCloud2``: the last ones contradict what it holds."""
    kind, rows = lay_out(columns, gap=gap, behind=behind)
    count = len(next(iter(columns.values())))
    table = np.zeros(count, kind.newbyteorder(">") if big else kind)
    for number, values in enumerate(columns.values()):
        table[f"c{number}"] = values
    lines = table.reshape(height, -1)
    data = b"".join(line.tobytes() + b"\xaa" * row_padding for line in lines)
    data = data[: len(data) - cut] + b"\x11" * longer
    message = Cdr(">" if big_message else "<")
    message.put("i", stamp_ns // 10**9)
    message.put("I", stamp_ns % 10**9)
    message.text("lidar")
    message.put("I", height)
    message.put("I", lines.shape[1] + wide)
    message.put("I", len(rows))
    for number, (name, number_type, offset, elements) in enumerate(rows):
        last = number == len(rows) - 1
        message.text(rows[0][0] if double and last else name)
        message.put("I", offset + (far if last else 0))
        message.put("B", code if code and last else CODES[number_type.str[1:]])
        message.put("I", 0 if zero_count and elements == 1 else elements)
    message.put("B", big)
    message.put("I", kind.itemsize + step)
    message.put("I", lines.shape[1] * kind.itemsize + row_padding if row_step is None else row_step)
    message.put("I", len(data))
    message.body += data
    message.put("B", dense)
    return message.data()


def write_bag(path: Path, topics: Mapping[str, Sequence[tuple[int, bytes]]], *, mcap: bool) -> None:
    """A bag of point clouds: time of recording and bytes of each message, by topic."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connections = {name: writer.add_connection(name, KIND, typestore=store) for name in topics}
        for name, messages in topics.items():
            for log_ns, data in messages:
                writer.write(connections[name], log_ns, data)


LAYOUTS: tuple[tuple[str, dict[str, Any], Oracle], ...] = (
    ("big-endian points", {"big": True}, "same"),
    ("big-endian message", {"big_message": True}, "same"),
    ("gaps between fields", {"gap": 3}, "same"),
    ("bytes behind each point", {"behind": 11}, "same"),
    ("is_dense", {"dense": True}, "same"),
    ("organised", {"height": 2}, "same"),
    ("organised, rows padded", {"height": 2, "row_padding": 24}, "same"),
    ("COUNT 0 for one", {"zero_count": True}, "same"),
    ("width too large", {"wide": 3}, "refused"),
    ("width too small", {"wide": -3}, "refused"),
    ("point_step too small", {"step": -2}, "refused"),
    ("point_step too large", {"step": 2}, "refused"),
    ("row_step 0", {"row_step": 0}, "either"),
    ("bytes missing", {"cut": 5}, "refused"),
    ("bytes more", {"longer": 64}, "refused"),
    ("a type that is none", {"code": 9}, "refused"),
    ("a field beyond the point", {"far": 4000}, "refused"),
    ("a name twice", {"double": True}, "refused"),
)


def bag(mcap: bool, random: np.random.Generator, folder: Path) -> Case:
    """Sweeps of one LiDAR in a bag."""
    sweeps = make_sweeps(random)
    for row, columns in enumerate(sweeps.columns):  # an even number, so that rows can be organised
        for name in columns:
            columns[name] = columns[name][: len(columns[name]) // 2 * 2]
        sweeps.points[row] = sweeps.points[row][: len(columns["x"])]
        sweeps.valid[row] = sweeps.valid[row][: len(columns["x"])]
    sweeps.strength = [columns["intensity"] for columns in sweeps.columns]
    edits = chosen_edits(random, BAG_GROUPS)
    for edit in edits[:1] if random.random() < 0.5 else edits:
        edit(random, sweeps)
    sweeps.time_ns = 300.0  # nanoseconds since 1970 in double precision
    for columns in sweeps.columns:  # PointField has no integers of 8 bytes
        for name, values in columns.items():
            columns[name] = _fitting(name, values)
    layout: dict[str, Any] = {}
    if len(sweeps.edits) < 2:
        words, layout, oracle = LAYOUTS[random.integers(len(LAYOUTS))]
        even = all(len(points) % 2 == 0 and len(points) > 3 for points in sweeps.points)
        if even:
            sweeps.edit(words, oracle)
        else:
            layout = {}
    late_ns = int(random.integers(0, 40)) * 10**6
    stamps = sweeps.stamps_ns or []
    messages = [
        (stamp + late_ns, point_cloud(columns, stamp, **layout))
        for stamp, columns in zip(stamps, sweeps.columns, strict=True)
    ]
    if random.random() < 0.1:
        messages.reverse()
        sweeps.edits.append("written backwards")
    write_bag(folder / "drive", {"/points": messages}, mcap=mcap)
    names = [f"{row:06d}" for row in range(3)]
    difference = partial(_differences, sweeps, names)
    return Case(tuple(sweeps.edits), sweeps.oracle, partial(_read, folder, sweeps.options), difference, sweeps.words)


def _fitting(name: str, values: np.ndarray) -> np.ndarray:
    """Numbers of a type that fields can have."""
    if values.dtype.str[1:] in CODES:
        return values
    return values.astype("f8" if abs(values.astype("f8")).max(initial=0) > 2**31 or name in "xyz" else "i4")


def _read(folder: Path, options: Mapping[str, Any]) -> Reading:
    frames = [*ff.open_dataset(folder, **options)]
    return Reading({frame.frame_id: (frame.time_ns, frame.cloud()) for frame in frames})


def _differences(sweeps: Sweeps, names: Sequence[str], frames: Mapping[str, Any]) -> str:
    times = np.array([time_ns for time_ns, _ in frames.values()])
    clouds = {name: cloud for name, (_, cloud) in frames.items()}
    return apart("stamps", times, np.array(sweeps.stamps_ns), tolerance=0, relative=0) or differences(
        sweeps, clouds, names
    )


# A radar's clouds: no intensity in [0, 1], speeds and cross-sections as the driver has them.

SPEEDS, SECTIONS = ("doppler", "velocity", "range_rate", "v_r"), ("rcs", "power", "snr", "rcs_dbsm")


def radar(random: np.random.Generator, folder: Path) -> Case:
    """A radar's clouds: strengths in decibels, positive and negative, come out as they are."""
    sweeps = make_sweeps(random, points=int(random.integers(20, 90)))
    names = [str(random.choice(SPEEDS)), str(random.choice(SECTIONS))]
    named = str(random.choice(["", "", *STRENGTHS]))
    topic = str(random.choice(["/radar", "/front_radar/points", "/points"]))
    for row, columns in enumerate(sweeps.columns):
        columns.pop("intensity")
        extra = {name: random.normal(0, 20, len(sweeps.points[row])).astype("f4") for name in names}
        sweeps.columns[row] |= extra
        sweeps.extra[row] |= extra
        if named:
            sweeps.columns[row][named] = random.normal(-5, 20, len(sweeps.points[row])).astype("f4")
            sweeps.extra[row]["intensity"] = sweeps.columns[row][named]
    sweeps.strength = None
    sweeps.edit(f"{topic} with {names[0]}, {names[1]}{f' and {named} in dB' if named else ''}")
    groups = {name: BAG_GROUPS[name] for name in ("places", "missing", "order")}
    groups["columns"] = (no_place, other_places)
    for edit in chosen_edits(random, groups)[:1]:
        edit(random, sweeps)
    for columns in sweeps.columns:
        for name, values in columns.items():
            columns[name] = _fitting(name, values)
    messages = [
        (stamp, point_cloud(columns, stamp))
        for stamp, columns in zip(sweeps.stamps_ns or [], sweeps.columns, strict=True)
    ]
    write_bag(folder / "drive", {topic: messages}, mcap=bool(random.integers(2)))
    frames = [f"{row:06d}" for row in range(3)]
    difference = partial(_differences, sweeps, frames)
    return Case(tuple(sweeps.edits), sweeps.oracle, partial(_read, folder, sweeps.options), difference, sweeps.words)


FAMILIES = (
    (
        Family("bag mcap", partial(bag, True), 4),
        Family("bag sqlite", partial(bag, False), 2),
        Family("bag radar", radar, 3),
    )
    if importlib.util.find_spec("rosbags")
    else ()
)
