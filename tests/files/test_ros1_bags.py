"""ROS 1 bags: read as rosbags reads them, and refused where they grow, lie, or have no index."""

import random
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags")

from ros1_bytes import CLOUD, START, STRING_MD5, Bag, Chunk, Connection, messages, record, sweep, u32

from farfield.datasets import open_dataset
from farfield.errors import FarfieldError, FileFormatError
from farfield.files.bags import Bag as OpenBag

POINTS, OTHER = Connection(0), Connection(3, "/other/points")


def written(folder: Path, bag: Bag, name: str = "drive.bag") -> Path:
    folder.mkdir(exist_ok=True)
    path = folder / name
    path.write_bytes(bag.bytes())
    return path


def whole(pack: str = "none", *, at_connection: bool = True) -> Bag:
    """Two chunks whose times overlap, and two topics."""
    first = messages([0, 2, 1, 4], POINTS) + messages([0, 3], OTHER)
    return Bag([Chunk(first, pack, at_connection=at_connection), Chunk(messages([3, 5], POINTS), pack)])


def rows_of(path: Path) -> list[tuple[str, int, bytes]]:
    return [(topic.name, time_ns, raw) for topic, time_ns, raw in OpenBag(path).messages()]


@pytest.mark.parametrize("at_connection", [True, False])
@pytest.mark.parametrize("pack", ["none", "bz2", "lz4"])
def test_messages_are_those_that_rosbags_reads(pack: str, at_connection: bool, tmp_path: Path) -> None:
    from rosbags.rosbag1 import Reader

    path = written(tmp_path, whole(pack, at_connection=at_connection))
    with Reader(path) as reader:
        theirs = sorted((c.topic, time_ns, bytes(raw)) for c, time_ns, raw in reader.messages())
    ours = rows_of(path)
    assert sorted(ours) == theirs
    assert [row[1] for row in ours] == sorted(row[1] for row in ours)
    assert {topic.name: topic.size for topic in OpenBag(path).topics} == {"/points": 6, "/other/points": 2}


def test_frames_are_the_clouds_in_the_order_of_time(tmp_path: Path) -> None:
    written(tmp_path / "run", whole("lz4"))
    data = open_dataset(tmp_path / "run")
    assert (data.name, len(data), set(data.sequences)) == ("bags", 6, {"drive"})
    for number, frame in enumerate(data):
        assert frame.time_ns == START + number * 100_000_000
        np.testing.assert_array_equal(frame.cloud("points").points_m, sweep(number)[:, :3].astype(np.float32))
    assert "other_points" in data[3].clouds
    assert open_dataset(tmp_path / "run", cloud="/other/points").frame_ids == ("000000", "000001")


def refused(folder: Path, bag: Bag | bytes, words: str) -> FileFormatError:
    folder.mkdir(exist_ok=True)
    (folder / "drive.bag").write_bytes(bag if isinstance(bag, bytes) else bag.bytes())
    with pytest.raises(FileFormatError, match=words) as error:
        rows_of(folder / "drive.bag")
    return error.value


def test_a_bag_without_an_index_names_the_command(tmp_path: Path) -> None:
    error = refused(tmp_path, Bag([Chunk(messages([0], POINTS))], indexed=False), "stopped before it wrote one")
    assert "rosbag reindex" in error.fix
    assert "rosbag reindex" in refused(tmp_path, whole().bytes()[:9000], "within the file").fix
    assert "rosbag fix" in refused(tmp_path, b"#ROSRECORD V1.2\n" + bytes(90), "byte 0").fix
    refused(tmp_path, b"", "an empty file")


def test_a_chunk_that_grows_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    kind = Connection(0, "/zeros", "std_msgs/String", "string data", STRING_MD5)
    for pack in ("bz2", "lz4"):
        bomb = Bag([Chunk([(kind, START, bytes(18 << 20))], pack)])
        for size in ((18 << 20) + 200 if pack == "bz2" else 0xFFFFFFFF, 1000):
            bomb.chunks[0].size = size
            content = bomb.bytes()
            tracemalloc.start()
            refused(tmp_path, content, "unpacks to at most|when unpacked")
            assert tracemalloc.get_traced_memory()[1] < 4 << 20
            tracemalloc.stop()


@pytest.mark.parametrize(
    ("bag", "words"),
    [
        (Bag([Chunk(messages([0, 1], POINTS), offset=lambda _: 0)]), "the index"),
        (Bag([Chunk(messages([0, 1], POINTS), offset=lambda at: at + 1)]), "the index|messages and connections"),
        (Bag([Chunk(messages([0, 1], POINTS), offset=lambda at: at + (1 << 30))]), "offsets within a chunk"),
        (Bag([Chunk(messages([0], POINTS))], counts={"conn_count": 2}), "kind 7"),
        (Bag([Chunk(messages([0], POINTS))], counts={"conn_count": 0xFFFFFFFF}), "kind 7"),
        (Bag([Chunk(messages([0], POINTS))], counts={"chunk_count": 0}), "the end of the bag|behind the one before"),
        (Bag([Chunk(messages([0], POINTS))], counts={"chunk_count": 0xFFFFFFFF}), "ends before byte"),
        (
            Bag([Chunk(messages([0], POINTS)), Chunk(messages([1], POINTS))], chunk_at={1: 4109}),
            "behind the one before",
        ),
        (Bag([Chunk(messages([0], POINTS))], chunk_at={0: 1 << 60}), "before the index"),
        (Bag([Chunk(messages([0], POINTS), size=5)]), "not packed"),
        (Bag([Chunk(messages([0], POINTS), "zip")]), "packed by bz2, lz4 or none"),
        (
            Bag([Chunk(messages([0], Connection(0, "/a")) + messages([1], Connection(1, "/a", "a/B")))]),
            "one type of /a",
        ),
        (Bag([Chunk(messages([0], POINTS))], [Connection(0, "/lies")]), "connection 0 as it stands"),
        (Bag([Chunk(messages([0], POINTS))], [Connection(0, md5sum="0" * 32)]), "connection 0 as it stands"),
        (Bag([Chunk(messages([0], Connection(0, "")))]), "number, topic and type"),
    ],
)
def test_what_contradicts_itself_is_refused(bag: Bag, words: str, tmp_path: Path) -> None:
    refused(tmp_path, bag, words)


@pytest.mark.parametrize(
    ("connection", "words"),
    [
        (Connection(0, md5sum="0" * 32), "has the md5sum 1158d486"),
        (
            Connection(0, definition=CLOUD.replace("uint32 height\nuint32 width", "uint32 width\nuint32 height")),
            "md5sum",
        ),
        (Connection(0, definition=CLOUD + "#" * (1 << 16)), "a definition of"),
        (Connection(0, definition=CLOUD.replace("PointField[] fields", "string[99999] fields")), "99999 texts"),
        (Connection(0, definition="no definition at all"), "a whole bag"),
        (Connection(0, definition="PointCloud2 again", md5sum="*"), "a whole bag"),
    ],
)
def test_definitions_that_lie_or_attack_are_refused(connection: Connection, words: str, tmp_path: Path) -> None:
    written(tmp_path, Bag([Chunk(messages([0], connection))]))
    with pytest.raises(FileFormatError, match=words):
        open_dataset(tmp_path)[0].cloud()


def test_nested_messages_do_not_grow(tmp_path: Path) -> None:
    """An index may name places within a message that look like messages: they are none of the chunk's records."""
    inner = record(b"x" * 1000, op=b"\2", conn=u32(0), time=bytes(8))
    kind = Connection(0, "/text", "std_msgs/String", "string data", STRING_MD5)
    bag = Bag([Chunk([(kind, START, inner * 50), (kind, START + 1, b"")], offset=lambda at: at and at - len(inner))])
    refused(tmp_path, bag, "the index")


def test_changed_bytes_are_refused_or_read_alike(tmp_path: Path) -> None:
    path = written(tmp_path, Bag([Chunk(messages([0, 1], POINTS) + messages([0], OTHER), "bz2")]))
    data, sound = path.read_bytes(), rows_of(path)
    draw = random.Random(5)
    ends = [4109, len(data)]
    outcomes = {"refused": 0, "alike": 0}
    for _ in range(250):
        changed = bytearray(data)
        where = (
            draw.randrange(4109 if draw.random() < 0.2 else 0, ends[1]) if draw.random() < 0.8 else draw.randrange(120)
        )
        if draw.random() < 0.2:
            changed = changed[:where]
        else:
            changed[where] ^= 1 << draw.randrange(8)
        path.write_bytes(bytes(changed))
        try:
            rows = rows_of(path)
        except FarfieldError:
            outcomes["refused"] += 1
        else:
            outcomes["alike"] += 1
            assert rows == sound
    assert outcomes["refused"] > 60
