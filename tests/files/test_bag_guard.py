"""Bags that would fill the memory are refused before anything is unpacked."""

import os
import sqlite3
import struct
import tracemalloc
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags")

from bag_messages import START, imu
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import zstd

from farfield.errors import FileFormatError
from farfield.files.bag_guard import unpacked
from farfield.files.bag_writing import IMU, serialised, store, write_bag_part
from farfield.files.bags import Bag
from farfield.files.limits import FREE_BYTES, MAX_BYTES, MAX_EXPANSION, allowed_bytes

CHUNK = 6


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    messages = [("/imu", START + k, serialised(imu(START + k, 0.1))) for k in range(50)]
    write_bag_part(tmp_path / "whole.mcap", {"/imu": IMU}, messages, tmp_path / "staging")
    return tmp_path / "whole.mcap"


def chunk_of(data: bytes) -> tuple[int, int]:
    """Where the first chunk's content begins, and its length."""
    place = 8
    while data[place] != CHUNK:
        place += 9 + int.from_bytes(data[place + 1 : place + 9], "little")
    return place + 9, int.from_bytes(data[place + 1 : place + 9], "little")


def claiming(path: Path, size: int) -> Path:
    """The same file whose chunk, and the index of it, claim to unpack to another size."""
    data = bytearray(path.read_bytes())
    begin, _ = chunk_of(bytes(data))
    true = bytes(data[begin + 16 : begin + 24])
    data[begin + 16 : begin + 24] = struct.pack("<Q", size)
    data = data.replace(true + b"\x0d", struct.pack("<Q", size) + b"\x0d")
    path.with_name("claims.mcap").write_bytes(bytes(data))
    return path.with_name("claims.mcap")


def bomb(path: Path, unpacks_to: int, *, claims: int) -> Path:
    """A file of one chunk, without a summary, that unpacks to zeros."""
    packed = zstd.compress(bytes(unpacks_to))
    content = struct.pack("<QQQI", START, START, claims, 0) + struct.pack("<I", 4) + b"zstd"
    content += struct.pack("<Q", len(packed)) + packed
    head = struct.pack("<I", 4) + b"ros2" + struct.pack("<I", 0)
    records = [(1, head), (CHUNK, content), (2, struct.pack("<QQI", 0, 0, 0))]
    body = b"".join(bytes([code]) + struct.pack("<Q", len(part)) + part for code, part in records)
    path.write_bytes(b"\x89MCAP0\r\n" + body + b"\x89MCAP0\r\n")
    return path


def test_a_sound_file_reads(whole: Path) -> None:
    bag = Bag(whole)
    assert len(list(bag.messages())) == 50


@pytest.mark.parametrize("size", [1 << 62, MAX_BYTES + 1, FREE_BYTES * 2])
def test_an_absurd_size_is_refused(whole: Path, size: int) -> None:
    with pytest.raises(FileFormatError, match=f"one that claims {size}"):
        Bag(claiming(whole, size))


def test_a_record_beyond_the_file_is_refused(whole: Path) -> None:
    data = bytearray(whole.read_bytes())
    begin, _ = chunk_of(bytes(data))
    data[begin - 8 : begin] = struct.pack("<Q", 1 << 40)
    whole.write_bytes(bytes(data))
    with pytest.raises(FileFormatError, match="a record that ends within the file"):
        Bag(whole)


@pytest.mark.parametrize("claims", [1000, 1 << 20, FREE_BYTES])
def test_a_chunk_that_unpacks_to_more_than_it_claims_costs_no_memory(tmp_path: Path, claims: int) -> None:
    path = bomb(tmp_path / "bomb.mcap", 1 << 28, claims=claims)
    assert path.stat().st_size < 100_000
    tracemalloc.start()
    with pytest.raises(FileFormatError, match="unpacks to more than"):
        Bag(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2.2 * claims + (8 << 20)  # the unpacker's own buffers double


def test_lz4_is_bounded_too() -> None:
    lz4 = pytest.importorskip("lz4.frame")
    packed = lz4.compress(bytes(1 << 24))
    assert unpacked("lz4", packed, 1 << 24) == bytes(1 << 24)
    with pytest.raises(ValueError, match="more than the 1000 bytes"):
        unpacked("lz4", packed, 1000)
    with pytest.raises(ValueError, match="claims to unpack"):
        unpacked("lz4", b"x", 1 << 40)


def test_what_compresses_well_is_allowed() -> None:
    assert allowed_bytes(0) == FREE_BYTES
    assert allowed_bytes(1000) == FREE_BYTES + 1000 * MAX_EXPANSION
    assert allowed_bytes(1 << 40) == MAX_BYTES
    zeros = np.zeros(1 << 20, dtype=np.uint8).tobytes()
    assert unpacked("zstd", zstd.compress(zeros), len(zeros)) == zeros


@pytest.mark.parametrize("mode", ["MESSAGE", "FILE"])
def test_bags_packed_by_message_or_as_a_file_read_and_are_bounded(tmp_path: Path, mode: str) -> None:
    from rosbags.rosbag2 import CompressionFormat, CompressionMode

    path, raw = tmp_path / "packed", serialised(imu(START, 0.1))
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/imu", IMU, typestore=store())
        for step in range(3):
            writer.write(connection, START + step, raw)
        if mode == "MESSAGE":
            bomb_of_zeros = writer.add_connection("/zeros", IMU, typestore=store())
            writer.write(bomb_of_zeros, START + 9, bytes(FREE_BYTES + (32 << 20)))
    bag = Bag(path)
    assert [message for _, _, message in bag.messages(["/imu"])] == [raw] * 3
    if mode == "MESSAGE":
        with pytest.raises(FileFormatError, match="unpacks to more than"):
            list(bag.messages())
    else:
        (packed,) = path.glob("*.zstd")
        packed.write_bytes(zstd.compress(bytes(FREE_BYTES + (32 << 20))))
        with pytest.raises(FileFormatError, match="when unpacked"):
            Bag(path)
        packed.write_bytes(b"nothing of the kind")
        with pytest.raises(FileFormatError, match="packed with zstd"):
            Bag(path)


@pytest.fixture
def packed(tmp_path: Path) -> Path:
    """A bag whose one file was packed as a whole."""
    raw = serialised(imu(START, 0.1))
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/imu", IMU, typestore=store())
        writer.write(connection, START, raw)
    return tmp_path / "bag"


def pack(bag: Path, script: str) -> None:
    """Change the tables of a bag, and pack its file."""
    (database,) = bag.glob("*.db3")
    with closing(sqlite3.connect(database)) as connection:
        connection.executescript(script)
    database.with_name(f"{database.name}.zstd").write_bytes(zstd.compress(database.read_bytes()))
    database.unlink()
    text = (bag / "metadata.yaml").read_text().replace(database.name, f"{database.name}.zstd")
    text = text.replace("compression_format: ''", "compression_format: zstd")
    (bag / "metadata.yaml").write_text(text.replace("compression_mode: ''", "compression_mode: file"))


def test_tables_of_a_packed_file_are_checked_as_those_of_any(packed: Path) -> None:
    pack(packed, "CREATE VIEW more AS SELECT 1;")
    with pytest.raises(FileFormatError, match=r"db3\.zstd, unpacked, the schema: expected tables and indexes alone"):
        Bag(packed)


def test_files_that_the_metadata_name_are_of_a_kind_that_is_checked(packed: Path) -> None:
    (database,) = packed.glob("*.db3")
    database.with_name("other.bin").write_bytes(database.read_bytes())
    text = (packed / "metadata.yaml").read_text().replace(database.name, "other.bin")
    (packed / "metadata.yaml").write_text(text)
    with pytest.raises(FileFormatError, match=r"relative_file_paths: expected files of the kinds .*other\.bin"):
        Bag(packed)


def test_metadata_are_bounded(packed: Path) -> None:
    text = "a0: &a0 {x: 1}\n"
    text += "".join(f"a{n}: &a{n} {{<<: [{', '.join([f'*a{n - 1}'] * 9)}]}}\n" for n in range(1, 9))
    (packed / "metadata.yaml").write_text(text + (packed / "metadata.yaml").read_text())
    with pytest.raises(FileFormatError, match=r"a bag's metadata.*more than 100000 values"):
        Bag(packed)


def test_another_file_than_the_checked_one_is_not_opened(packed: Path) -> None:
    (database,) = packed.glob("*.db3")
    database.rename(database.with_name("%2e%2e%2fbag.db3"))
    with pytest.raises(FileFormatError, match="expected none with %"):
        Bag(packed)


@pytest.mark.parametrize("name", ["a.mcap", "a.db3", "a.mcap.zstd"])
def test_devices_and_pipes_are_refused_and_not_waited_for(tmp_path: Path, name: str) -> None:
    (tmp_path / name).symlink_to("/dev/zero")
    os.mkfifo(tmp_path / f"pipe.{name}")
    for path in (tmp_path / name, tmp_path / f"pipe.{name}"):
        with pytest.raises(FileFormatError, match="expected a regular file, found a device or a pipe"):
            Bag(path)


def test_a_folder_without_metadata_is_no_bag(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match=r"expected a bag's metadata\.yaml"):
        Bag(tmp_path)


def disguise(bag: Path, name: str, text: str) -> None:
    """Give an object of a bag's tables another definition, past what SQLite writes itself."""
    (database,) = bag.glob("*.db3")
    with closing(sqlite3.connect(database)) as connection:
        connection.execute("PRAGMA writable_schema = ON")
        connection.execute("UPDATE sqlite_master SET sql = ?, rootpage = 0 WHERE name = ?", (text, name))
        connection.commit()


def fill(bag: Path, script: str) -> None:
    (database,) = bag.glob("*.db3")
    with closing(sqlite3.connect(database)) as connection:
        connection.executescript(script)


NUMBERS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n LIMIT 10001)"
ROWS = f"CREATE TABLE Schema (schema_version, x, ros_distro); INSERT INTO Schema {NUMBERS} SELECT 4, i, '' FROM n;"


def test_tables_by_the_thousand_hide_no_view(packed: Path) -> None:
    tables = "".join(f"CREATE TABLE t{number} (x);" for number in range(1000))
    fill(packed, f"BEGIN; {tables} CREATE VIEW more AS SELECT 1; COMMIT;")
    with pytest.raises(FileFormatError, match="expected at most 1000 tables and indexes, found more"):
        Bag(packed)


def test_tables_are_checked_whatever_the_case_of_their_names(packed: Path) -> None:
    fill(packed, "DROP TABLE IF EXISTS schema;" + ROWS)
    with pytest.raises(FileFormatError, match="at most 10000 rows"):
        Bag(packed)


@pytest.mark.parametrize(
    "text",
    [
        "CREATE VIEW other AS SELECT 1",
        "CREATE/* a */VIRTUAL/* table */TABLE other USING rtree(id, low, high)",
        "CREATE /**/ VIEW other AS SELECT 1",
    ],
)
def test_what_is_no_table_is_refused_however_it_is_listed(packed: Path, text: str) -> None:
    fill(packed, "CREATE TABLE other (x);")
    disguise(packed, "other", text)
    with pytest.raises(
        FileFormatError, match=r"the schema: expected tables and indexes alone|malformed database schema"
    ):
        Bag(packed)


@pytest.mark.parametrize("name", ["evil.zstd", "evil.txt.zstd", "bag.mcap.zstd"])
def test_a_packed_file_is_named_as_what_it_is_opened_as(packed: Path, name: str) -> None:
    pack(packed, "CREATE VIEW more AS SELECT 1;")
    (file,) = packed.glob("*.zstd")
    (packed / "metadata.yaml").write_text((packed / "metadata.yaml").read_text().replace(file.name, name))
    file.rename(file.with_name(name))
    with pytest.raises(FileFormatError, match=r"relative_file_paths: expected files of the kind .*db3"):
        Bag(packed)


def test_rosbags_itself_still_reads_the_settings_of_transport(packed: Path) -> None:
    from rosbags.rosbag2 import Reader, metadata, reader

    Bag(packed).close()
    item = {"history": 1, "reliability": 1, "durability": 2, "depth": 3, "deadline": {"sec": 0, "nsec": 0}}
    item |= {"lifespan": item["deadline"], "liveliness": 1, "liveliness_lease_duration": item["deadline"]}
    item |= {"avoid_ros_namespace_conventions": False}
    assert vars(reader)["parse_qos"]([item]) == metadata.parse_qos([item]) != []
    with Reader(packed):
        pass
