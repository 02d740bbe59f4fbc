"""Hostile bags, feather tables and archives of weights, for _fuzz_hostile.py."""

import hashlib
import io
import sqlite3
import struct
import zipfile
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from _fuzz_hostile import Attack, _first

from farfield.datasets.bags.reader import Bags
from farfield.files.bags import Bag
from farfield.files.feather import read_feather
from farfield.files.sensor_messages import read_points

# Bags of ROS 2


def bags() -> dict[str, Attack]:
    """Bags whose chunks, indexes, definitions, clouds or tables become more than they are."""
    mcaps: dict[str, Callable[[], bytes]] = {
        "a cloud of 2^32 numbers a point": lambda: _mcap([_message(_cloud(count=(1 << 32) - 1))]),
        "a cloud of 2^32 fields": lambda: _mcap([_message(_cloud(fields=(1 << 32) - 1))]),
        "a cloud of 2^32 bytes": lambda: _mcap([_message(_cloud(data=(1 << 32) - 1))]),
        "a time of recording of 2^63": lambda: _mcap([_message(_cloud(), 1 << 63)]),
        "a time of recording of 2^63 - 1": lambda: _mcap([_message(_cloud(), (1 << 63) - 2)]),
        "a name of 2^32 characters": lambda: _mcap([_message(_cloud(name=(1 << 32) - 1))]),
        "a definition with an array of 4,000,000 texts": lambda: _defined("string[4000000] fields"),
        "a definition with lists of nothing": lambda: _defined(f"Empty[] fields\n{'=' * 80}\nMSG: sensor_msgs/Empty\n"),
        "a definition of a megabyte": lambda: _defined("uint8 a\n" * 130_000),
        "many chunks of one time": lambda: _chunked(60, 1),
        "one chunk that stands in the index often": lambda: _chunked(1, 1_000),
        "a chunk of very many messages": _many_messages,
        "a summary within a message": _hidden_summary,
    }
    tables: dict[str, Callable[[Path], None]] = {
        "a view without end": _endless_view,
        "a computed column": _computed_column,
        "a blob whose pages lead in a circle": _circle_of_pages,
        "a page that is its own child": _own_child,
        "a virtual table": _virtual_table,
    }
    attacks = {f"mcap, {name}": Attack(partial(_mcap_file, data), _bag) for name, data in mcaps.items()}
    return attacks | {f"db3, {name}": Attack(partial(_table_file, change), _bag) for name, change in tables.items()}


def _mcap_file(data: Callable[[], bytes], folder: Path) -> None:
    (folder / "a.mcap").write_bytes(data())


def _bag(folder: Path) -> Any:
    """A bag as the data set reads it: its stamps, then every cloud."""
    bag = Bag(next(folder.iterdir()))
    bag.stamps()
    clouds = [read_points(bag.decode(topic, raw), bag.path) for topic, _, raw in bag.messages()]
    frame = Bags(folder)[0]
    frame.cloud()
    return clouds


def _text(text: bytes) -> bytes:
    return struct.pack("<I", len(text)) + text


def _cloud(*, count: int = 1, fields: int = 1, data: int = 12, name: int = 2) -> bytes:
    """A PointCloud2 of one field in CDR, with numbers that it claims."""
    head = b"\x00\x01\x00\x00" + struct.pack("<iI", 1_700_000_000, 5) + _text(b"lidar\0") + b"\0\0"
    one = struct.pack("<I", name) + b"x\0\0\0" + struct.pack("<IB3xI", 0, 7 if count == 1 else 2, count)
    rest = struct.pack("<B3xIII", 0, (1 << 32) - 1, 12, data) + bytes(12) + b"\x01"
    return head + struct.pack("<III", 1, 0, fields) + one + rest


def _record(code: int, content: bytes) -> bytes:
    return bytes([code]) + struct.pack("<Q", len(content)) + content


def _message(content: bytes, log_ns: int = 1_700_000_000_000_000_000) -> bytes:
    return _record(5, struct.pack("<HIQQ", 1, 0, log_ns, log_ns) + content)


def _mcap(records: list[bytes], definition: str = "", index: list[bytes] | None = None, summary: int = 0) -> bytes:
    """A file of one topic; an index behind the data, if there is one, is its summary."""
    topic = _topic(definition)
    data = (
        b"\x89MCAP0\r\n" + _record(1, _text(b"ros2") + _text(b"")) + topic + b"".join(records) + _record(15, bytes(4))
    )
    begin = summary or (len(data) if index is not None else 0)
    data += b"" if index is None else topic + b"".join(index)
    return data + _record(2, struct.pack("<QQI", begin, 0, 0)) + b"\x89MCAP0\r\n"


def _topic(definition: str) -> bytes:
    kind = _text(b"sensor_msgs/msg/PointCloud2")
    schema = struct.pack("<H", 1) + kind + _text(b"ros2msg" if definition else b"") + _text(definition.encode())
    channel = struct.pack("<HH", 1, 1) + _text(b"/points") + _text(b"cdr") + _text(b"")
    return _record(3, schema) + _record(4, channel)


def _defined(definition: str) -> bytes:
    return _mcap([_message(_cloud())], definition)


def _packed_chunk(content: bytes) -> tuple[bytes, int]:
    from rosbags.rosbag2.storage_mcap import zstd

    packed = zstd.compress(content)
    time_ns = 1_700_000_000_000_000_000
    head = struct.pack("<QQQI", time_ns, time_ns, len(content), 0) + _text(b"zstd") + struct.pack("<Q", len(packed))
    return _record(6, head + packed), len(packed)


def _chunk_index(start: int, chunk: bytes, packed: int, unpacked: int) -> bytes:
    time_ns = 1_700_000_000_000_000_000
    head = struct.pack("<QQQQ", time_ns, time_ns, start, len(chunk))
    head += struct.pack("<IHQQ", 10, 1, start + len(chunk), 31)  # one message of the topic, as it seems
    return _record(8, head + _text(b"zstd") + struct.pack("<QQ", packed, unpacked))


def _chunked(chunks: int, indexes: int) -> bytes:
    """Chunks of 15 MB of zeros, and their indexes, all of one time."""
    content = _message(_cloud() + bytes(15_000_000))
    chunk, packed = _packed_chunk(content)
    begin = _mcap([]).index(_record(15, bytes(4)))
    starts = [begin + number * len(chunk) for number in range(chunks)] * indexes
    index = [_chunk_index(start, chunk, packed, len(content)) for start in starts]
    return _mcap([chunk] * chunks, index=[*index, _statistics(len(starts), chunks)])


def _statistics(messages: int, chunks: int) -> bytes:
    head = struct.pack("<QHIIIIQQ", messages, 1, 1, 0, 0, chunks, 0, 1 << 60)
    return _record(11, head + struct.pack("<IHQ", 10, 1, messages))


def _many_messages() -> bytes:
    content = _message(b"") * 500_000
    chunk, packed = _packed_chunk(content)
    begin = _mcap([]).index(_record(15, bytes(4)))
    return _mcap([chunk], index=[_chunk_index(begin, chunk, packed, len(content)), _statistics(500_000, 1)])


def _hidden_summary() -> bytes:
    """An index that stands in a message, to which the footer leads."""
    content = _message(_cloud() + bytes(15_000_000))
    chunk, packed = _packed_chunk(content)
    begin = _mcap([]).index(_record(15, bytes(4)))
    index = _topic("") + _chunk_index(begin, chunk, packed, len(content)) * 1_000 + _statistics(1_000, 1)
    index += _record(15, bytes(4)) + _record(2, bytes(20))
    message = _message(index)
    return _mcap([chunk, message], summary=begin + len(chunk) + len(message) - len(index))


def _table_file(change: Callable[[Path], Any], folder: Path) -> None:
    with closing(sqlite3.connect(folder / "a.db3")) as database:
        database.executescript(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT, "
            "offered_qos_profiles TEXT);"
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);"
            "INSERT INTO topics VALUES (1, '/points', 'sensor_msgs/msg/PointCloud2', 'cdr', '');"
        )
        row = (1, 1, 1_700_000_000_000_000_000, _cloud() + bytes(9_000))
        database.execute("INSERT INTO messages VALUES (?, ?, ?, ?)", row)
        database.commit()
    change(folder / "a.db3")


def _changed(path: Path, script: str) -> None:
    with closing(sqlite3.connect(path)) as database:
        database.executescript(script)


def _endless_view(path: Path) -> None:
    endless = "WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n) SELECT x AS schema_version FROM n"
    _changed(path, f"CREATE VIEW schema AS {endless} WHERE x < 0;")


def _computed_column(path: Path) -> None:
    columns = "id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB AS (zeroblob(900000000)) VIRTUAL"
    script = (
        f"CREATE TABLE messages({columns}); INSERT INTO messages(topic_id, timestamp) VALUES (1, 5), (1, 6), (1, 7);"
    )
    _changed(path, f"DROP TABLE messages; {script}")


def _circle_of_pages(path: Path) -> None:
    """The message claims 900 MB, and each of its pages names the same as the next."""
    data = bytearray(path.read_bytes())
    page = 4096
    leaf = next(
        at for at in range(0, len(data), page) if data[at : at + 1] == b"\r" and b"lidar" in data[at : at + page]
    )
    cell = leaf + int.from_bytes(data[leaf + 8 : leaf + 10], "big")
    header = cell + 3  # behind two bytes of the length and one of the key
    old = int.from_bytes(data[header + 4 : header + 6], "big")  # the blob's serial type is the last of the header
    inner = data[cell : leaf + page]
    overflow = int.from_bytes(data[leaf + page - 4 : leaf + page], "big")
    assert old
    size = 900_000_000
    kind = _varint(12 + 2 * size)
    columns = bytes([0, 1, 6]) + kind
    head = bytes([1 + len(columns)]) + columns
    body = head + bytes([1]) + struct.pack(">Q", 1_700_000_000_000_000_000)
    new = _varint(len(body) + size) + _varint(1) + body
    local = len(inner) - 4 - len(new)
    data[cell : leaf + page] = new + bytes(max(local, 0)) + struct.pack(">I", overflow)
    data[(overflow - 1) * page : (overflow - 1) * page + 4] = struct.pack(">I", overflow)
    path.write_bytes(bytes(data[: (len(data) // page) * page]))


def _varint(value: int) -> bytes:
    parts = [value & 0x7F]
    while value := value >> 7:
        parts.append(value & 0x7F | 0x80)
    return bytes(reversed(parts))


def _own_child(path: Path) -> None:
    """The root of the messages becomes a tree of 19 levels, each of which names the next 400 times."""
    data, page = bytearray(path.read_bytes()), 4096
    with closing(sqlite3.connect(path)) as database:
        (root,) = database.execute("SELECT rootpage FROM sqlite_master WHERE name = 'messages'").fetchone()
    leaf = bytes(data[(root - 1) * page : root * page])
    pages, levels = len(data) // page, 12
    for level in range(levels):
        child = pages + level + 1
        cells, place, pointers = 400, page, []
        node = bytearray(page)
        for number in range(cells):
            place -= 6
            node[place : place + 6] = struct.pack(">I", child) + _varint(1000 + number)[:2]
            pointers.append(place)
        node[:12] = struct.pack(">BHHHBI", 5, 0, cells, place, 0, child)
        node[12 : 12 + 2 * cells] = struct.pack(f">{cells}H", *pointers)
        at = (root - 1) * page if level == 0 else (pages + level - 1) * page
        data[at : at + page] = node
    data += leaf
    data[28:32] = struct.pack(">I", len(data) // page)
    path.write_bytes(bytes(data))


def _virtual_table(path: Path) -> None:
    _changed(path, "CREATE VIRTUAL TABLE more USING fts5(text);")


# Feather tables and archives of weights


def feathers() -> dict[str, Attack]:
    """Tables that unpack to much, or whose columns are other than they should be."""
    read = partial(_first, lambda path: read_feather(path, ["x", "name"]))
    return {
        f"feather, {name}": Attack(partial(_feather, make, options), read)
        for name, make, options in (
            ("numbers that unpack to 2 GB", _zero_table, {"compression": "zstd"}),
            ("numbers that unpack to 2 GB (lz4)", _zero_table, {"compression": "lz4"}),
            ("many small batches", _zero_table, {"compression": "zstd", "chunksize": 60_000}),
            ("a text for 200,000,000 rows", _dictionary_table, {"compression": "zstd"}),
            ("a column of nothing", _null_table, {}),
            ("a run of 2^31 numbers", _run_table, {}),
        )
    }


def _feather(make: Callable[[], Any], options: dict[str, Any], folder: Path) -> None:
    import pyarrow.feather
    import pyarrow.ipc

    if options:
        pyarrow.feather.write_feather(make(), folder / "a.feather", **options)
        return
    table = make()
    with pyarrow.ipc.new_file(folder / "a.feather", table.schema) as file:
        file.write_table(table)


def _zero_table() -> Any:
    import pyarrow

    zeros = pyarrow.array(np.broadcast_to(np.zeros(1, np.uint8), 240_000_000).copy())
    return pyarrow.table({"x": zeros, "name": zeros, **{f"c{number}": zeros for number in range(7)}})


def _dictionary_table() -> Any:
    import pyarrow

    index = pyarrow.array(np.zeros(200_000_000, np.int8))
    names = pyarrow.DictionaryArray.from_arrays(index, pyarrow.array(["vehicle"]))
    return pyarrow.table({"x": index, "name": names})


def _null_table() -> Any:
    import pyarrow

    return pyarrow.table({"x": pyarrow.nulls(1 << 27), "name": pyarrow.nulls(1 << 27)})


def _run_table() -> Any:
    import pyarrow

    run = pyarrow.RunEndEncodedArray.from_arrays(pyarrow.array([(1 << 31) - 1], "i4"), pyarrow.array([1.0]))
    return pyarrow.table({"x": run, "name": run})


def archives() -> dict[str, Attack]:
    """Checkpoints and imported weights that unpack to much, or hold the same bytes often."""
    from farfield.detectors.checkpoints import read_checkpoint
    from farfield.training.checkpoints import load_checkpoint

    return {
        f"{name}, {what}": Attack(partial(_archive, change, sealed), partial(_first, read))
        for name, read, sealed in (
            ("checkpoint", load_checkpoint, True),
            ("older checkpoint", load_checkpoint, False),
            ("imported weights", read_checkpoint, False),
        )
        for what, change in (("packed numbers", _packed_members), ("members that share their bytes", _shared_members))
    }


def _archive(change: Callable[[bytes], bytes], sealed: bool, folder: Path) -> None:
    import torch

    packed = io.BytesIO()
    torch.save({f"w{number}": torch.zeros(8_000_000) for number in range(8)}, packed)
    data = change(packed.getvalue())
    seal = b"farfield-sha256:" + hashlib.sha256(data).hexdigest().encode() if sealed else b""
    (folder / "a.pt").write_bytes(data + seal)


def _packed_members(data: bytes) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as before, zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as after:
        for member in before.infolist():
            after.writestr(member.filename, before.read(member))
    return packed.getvalue()


def _shared_members(data: bytes) -> bytes:
    """The members from the second to the eighth of the numbers lead to the first one's bytes."""
    packed, first = io.BytesIO(), None
    with zipfile.ZipFile(io.BytesIO(data)) as before, zipfile.ZipFile(packed, "w") as after:
        for member in before.infolist():
            if first is None or "/data/" not in member.filename:
                after.writestr(member.filename, before.read(member))
                first = after.infolist()[-1] if "/data/" in member.filename else first
                continue
            copy = zipfile.ZipInfo(member.filename)
            for name in ("header_offset", "CRC", "compress_size", "file_size", "compress_type"):
                setattr(copy, name, getattr(first, name))
            after.filelist.append(copy)
    return packed.getvalue()
