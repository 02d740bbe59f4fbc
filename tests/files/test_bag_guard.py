"""Bags that would fill the memory are refused before anything is unpacked."""

import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags")

from bag_messages import START, imu
from rosbags.rosbag2.storage_mcap import zstd

from farfield.errors import FileFormatError
from farfield.files.bag_writing import IMU, serialised, store, write_bag_part
from farfield.files.bags import FREE_BYTES, MOST_BYTES, MOST_TIMES, Bag, allowed_bytes, unpacked

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


@pytest.mark.parametrize("size", [1 << 62, MOST_BYTES + 1, FREE_BYTES * 2])
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
    assert allowed_bytes(1000) == FREE_BYTES + 1000 * MOST_TIMES
    assert allowed_bytes(1 << 40) == MOST_BYTES
    zeros = np.zeros(1 << 20, dtype=np.uint8).tobytes()
    assert unpacked("zstd", zstd.compress(zeros), len(zeros)) == zeros


@pytest.mark.parametrize("mode", ["MESSAGE", "FILE"])
def test_bags_packed_by_message_or_as_a_file_read_and_are_bounded(tmp_path: Path, mode: str) -> None:
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

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
