"""Pickles of pandas are read as pandas reads them, and never run."""

import gzip
import struct
import tracemalloc

import numpy as np
import pytest
from pandas_streams import pandas_stream
from pickle_assembler import Raw, array, call, data_frame, name, stream, value

from farfield.errors import FileFormatError
from farfield.files import data_frames, pickles
from farfield.files.data_frames import read_data_frame

VERSIONS = [("lidar", "1.0.3", 3), ("lidar", "1.5.3", 4), ("lidar", "2.2.3", 5)]
CUBOIDS = [("cuboids", "1.2.5", 4), ("cuboids", "2.2.3", 5)]


def read(tmp_path, data: bytes):
    path = tmp_path / "00.pkl.gz"
    path.write_bytes(data)
    return read_data_frame(path)


@pytest.mark.parametrize(("kind", "version", "protocol"), VERSIONS)
def test_points_of_each_layout_have_the_values_that_pandas_wrote(tmp_path, kind, version, protocol):
    table = read(tmp_path, pandas_stream(kind, version, protocol))
    draws = np.random.RandomState(0)
    expected = {"x": draws.randn(5) * 30, "y": draws.randn(5), "z": draws.randn(5)}
    expected |= {"i": np.arange(5) * 40.0, "t": 1557539956.5 + np.arange(5) * 0.01, "d": np.array([0, 0, 0, 1, 1])}
    assert set(table) == set(expected)
    for column, values in expected.items():
        np.testing.assert_array_equal(table[column], values)


@pytest.mark.parametrize(("kind", "version", "protocol"), CUBOIDS)
def test_texts_flags_and_numbers_keep_their_columns(tmp_path, kind, version, protocol):
    table = read(tmp_path, pandas_stream(kind, version, protocol))
    assert list(table["uuid"]) == ["a", "b", "c"]
    assert list(table["label"]) == ["Car", "Pedestrian", "Bus"]
    assert list(table["attributes.object_motion"]) == ["Parked", None, "Moving"]
    assert list(table["stationary"]) == [True, False, True]
    assert list(table["cuboids.sensor_id"]) == [-1, 0, 1]
    assert list(table["yaw"]) == [0.1, -0.2, 0.3]


@pytest.mark.parametrize(
    ("kind", "version", "protocol", "named"),
    [("lidar", "1.3.5", 4, "functools.partial"), ("cuboids", "3.0.0", 5, "pandas._libs.arrays")],
)
def test_other_layouts_are_refused_by_name_with_the_line_that_converts(tmp_path, kind, version, protocol, named):
    with pytest.raises(FileFormatError, match="to_pickle") as refused:
        read(tmp_path, pandas_stream(kind, version, protocol))
    assert named in str(refused.value)


def test_a_payload_is_refused_before_anything_runs(tmp_path):
    target = tmp_path / "ran"
    for module in ("os", "posix", "nt", "builtins", "subprocess"):
        payload = stream(call(name(module, "system"), f"touch {target}"))
        with pytest.raises(FileFormatError, match="a name that this reader knows"):
            read(tmp_path, payload)
    hidden = data_frame({"x": np.zeros(2)}).replace(b"BlockManager", b"eval(input())")
    with pytest.raises(FileFormatError):
        read(tmp_path, hidden)
    assert not target.exists()


def test_names_that_are_known_are_not_called_either(tmp_path):
    """A slice of a huge range, an array of a huge shape: recorded, compared with the bytes, refused."""
    huge = array(np.zeros(2)).code.replace(value((2,)), value((1 << 29,)))
    for item in (Raw(huge), call(name("numpy", "ndarray"), (1 << 40,)), call(name("builtins", "slice"), 0, 1 << 40, 1)):
        with pytest.raises(FileFormatError):
            read(tmp_path, stream(item))
    with pytest.raises(FileFormatError, match="bytes"):
        read(tmp_path, data_frame({"x": np.zeros(2)}).replace(value((1, 2)), value((1, 1 << 29))))


def block_of(shape: tuple[int, int], kind: str, data: bytes | list[object], rows: int) -> bytes:
    """A frame of one column and so many rows, whose block says that it has another shape."""
    dtype = call(name("numpy", "dtype"), kind, False, True, state=(3, "|", None, None, None, -1, -1, 0))
    made = call(name("numpy.core.multiarray", "_reconstruct"), name("numpy", "ndarray"), (0,), b"b")
    block = Raw(made.code + value((1, shape, dtype, False, data)) + b"b")
    index = name("pandas.core.indexes.base", "_new_Index")
    columns = call(index, name("pandas.core.indexes.base", "Index"), {"data": array(["a"]), "name": None})
    bounds = {"name": None, "start": 0, "stop": rows, "step": 1}
    axes = [columns, call(index, name("pandas.core.indexes.range", "RangeIndex"), bounds)]
    blocks = [{"values": block, "mgr_locs": call(name("builtins", "slice"), 0, 1, 1)}]
    manager = name("pandas.core.internals.managers", "BlockManager")
    state = (axes, [], [], {"0.14.1": {"axes": axes, "blocks": blocks}})
    return stream(call(name("pandas.core.frame", "DataFrame"), state={"_data": call(manager, state=state)}))


@pytest.mark.parametrize(
    ("shape", "kind", "data", "rows"),
    [((1 << 39, 0), "O8", [], 0), ((1 << 39, 0), "u1", b"", 0), ((1 << 20, 1), "u1", bytes(1 << 20), 1)],
)
def test_a_block_of_more_lines_than_columns_costs_nothing(tmp_path, shape, kind, data, rows):
    """Each hung, ended in MemoryError or took 140 bytes a line before the number of lines was looked at."""
    content = gzip.compress(block_of(shape, kind, data, rows))
    tracemalloc.start()
    try:
        with pytest.raises(FileFormatError):
            read(tmp_path, content)
        assert tracemalloc.get_traced_memory()[1] < 8e6
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    "body",
    [
        b"]\x94" + b"h\x00a" * 10_000,  # a list of itself
        b"]\x94(" + b"h\x00" * 10_000 + b"e",
        b"N" + b"2" * 1000,  # DUP
        b"(" * 100,
        b")" + b"\x85" * 10_000,  # a tuple in a tuple in ...
        b"}\x94" + b"X\x01\x00\x00\x00ah\x00s" * 10_000,
        b"N" * 30_000,
        b"N" + b"r\xff\xff\xff\xff" * 10_000,
        b"\x8d" + struct.pack("<Q", 1 << 62),
        b"B\xff\xff\xff\xff",
        b"\x95" + struct.pack("<Q", 1 << 60),
        b"\x8b\xff\xff\xff\x7f",
        b"c" + b"a" * 1000 + b"\n",
        b"\x82\x01",
        b"P1\n",
        b"i1\n",
    ],
)
def test_streams_that_grow_stay_small_and_are_refused(tmp_path, body, monkeypatch):
    monkeypatch.setattr(pickles, "MAX_OPCODES", 25_000)
    data = b"\x80\x04" + body + b"."
    tracemalloc.start()
    try:
        with pytest.raises(FileFormatError):
            read(tmp_path, data)
        assert tracemalloc.get_traced_memory()[1] < 300 * len(data) + 1e6
    finally:
        tracemalloc.stop()


def test_a_gzip_file_that_unpacks_to_too_much_is_refused_before_it_does(tmp_path):
    bomb = gzip.compress(bytes(data_frames.MAX_FRAME_BYTES + 10), mtime=0)
    with pytest.raises(FileFormatError, match="when unpacked"):
        read(tmp_path, bomb)
    whole = pandas_stream("lidar", "1.0.3", 3)
    for damaged in (whole[:-9], whole + whole, whole[:200] + b"\0" + whole[201:]):
        with pytest.raises(FileFormatError):
            read(tmp_path, damaged)


def test_damaged_frames_are_refused_or_read_but_nothing_else(tmp_path):
    """400 changes of one byte, and cuts: a FileFormatError or a table of equal columns."""
    rng = np.random.default_rng(0)
    wholes = [gzip.decompress(pandas_stream(*key)) for key in (*VERSIONS, *CUBOIDS)]
    outcomes = {"read": 0, "refused": 0}
    for number in range(400):
        data = bytearray(wholes[number % len(wholes)])
        for _ in range(rng.integers(1, 4)):
            data[rng.integers(len(data))] = rng.integers(256)
        if number % 10 == 0:
            data = data[: rng.integers(len(data))]
        try:
            table = read(tmp_path, bytes(data))
        except FileFormatError:
            outcomes["refused"] += 1
        else:
            assert len({len(column) for column in table.values()}) <= 1
            outcomes["read"] += 1
    assert min(outcomes.values()) > 20


def test_the_walker_reads_plain_values():
    item = {"a": [1, -2, 1 << 40, 2.5, None, True, "ä"], "b": (b"xy", ())}
    read_back = pickles.walk_pickle(stream(item), "made", frozenset())
    assert read_back["a"] == item["a"]
    assert bytes(read_back["b"][0]) == b"xy"
