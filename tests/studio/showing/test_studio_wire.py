import gzip
import json

import numpy as np
import pytest

from farfield.frame import Cloud
from farfield.studio.showing.opened import Payload, plain_error
from farfield.studio.showing.wire import encode_cloud, encode_map
from farfield.studio.threads import Cache

TYPES = {"int16": "<i2", "uint8": "u1"}


def decode(body: bytes) -> tuple[dict, dict[str, np.ndarray]]:
    assert body[:4] == b"FFP1"
    length = int.from_bytes(body[4:8], "little")
    assert length % 8 == 0
    header = json.loads(body[8 : 8 + length])
    arrays = {}
    for field in header["fields"]:
        assert field["offset"] % 8 == 0
        count = header["count"] * field["items"]
        rows = np.frombuffer(body, TYPES[field["type"]], count, field["offset"])
        if field.get("coding") == "differences":
            rows = np.array(summed(rows.view(np.uint8).tolist(), header["count"], field["items"]), dtype=np.int64).T
        arrays[field["name"]] = rows.reshape(header["count"], field["items"])
    return header, arrays


def summed(data: list[int], count: int, columns: int) -> list[list[int]]:
    """Column by column, low bytes first: undo zigzag, add up, wrap to 16 bits."""
    out = []
    for start in range(0, 2 * count * columns, max(1, 2 * count)):
        column, value = [], 0
        for low, high in zip(data[start : start + count], data[start + count : start + 2 * count], strict=True):
            step = low + 256 * high
            value += -(step + 1) // 2 if step % 2 else step // 2
            column.append((value + 32768) % 65536 - 32768)
        out.append(column)
    return out


def cloud(points: np.ndarray, **extra: np.ndarray) -> Cloud:
    rng = np.random.default_rng(1)
    return Cloud(points.astype(np.float32), rng.random(len(points)).astype(np.float32), extra)


def test_places_are_true_to_four_millimetres_and_intensities_to_a_step():
    rng = np.random.default_rng(0)
    given = cloud(rng.uniform(-255, 255, (5000, 3)), ring=rng.integers(0, 128, 5000).astype(np.uint16))
    header, arrays = decode(encode_cloud(given, {"frame": 3, "layer": "lidar", "time_ns": "1600000000000000001"}))
    assert (header["frame"], header["layer"], header["count"]) == (3, "lidar", 5000)
    assert header["time_ns"] == "1600000000000000001"
    places = arrays["place"][:, :3] * header["scale_m"]
    assert np.abs(places - given.points_m).max() <= 0.5 / 128 + 1e-4
    assert (arrays["place"][:, 3] == given.extra["ring"]).all()
    assert np.abs(arrays["intensity"][:, 0] / 255 - given.intensity).max() <= 0.5 / 255 + 1e-6
    assert (arrays["ring"][:, 0] == given.extra["ring"]).all()


@pytest.mark.parametrize(("reach", "scale"), [(255.0, 1 / 128), (300.0, 1 / 64), (1000.0, 1 / 32), (3000.0, 1 / 8)])
def test_farther_clouds_take_coarser_steps(reach, scale):
    header, arrays = decode(encode_cloud(cloud(np.array([[reach, 0.0, 1.0], [1.0, 2.0, 3.0]])), {}))
    assert header["scale_m"] == scale
    assert np.abs(arrays["place"][0, 0] * scale - reach) <= scale


def test_missing_returns_and_damaged_places_are_left_out():
    points = np.array([[0, 0, 0], [1, 2, 3], [np.nan, 0, 1], [0, 0, 1e-3]])
    header, arrays = decode(encode_cloud(cloud(points), {}))
    assert header["count"] == 2
    assert decode(encode_cloud(cloud(np.zeros((0, 3))), {}))[0]["count"] == 0
    assert arrays["place"][0, :3].tolist() == [128, 256, 384]


def test_columns_lie_between_their_limits():
    doppler = np.array([-2.0, 0.0, 6.0, np.nan], dtype=np.float32)
    times = np.array([10**18, 10**18 + 50_000_000, 10**18 + 100_000_000, 10**18], dtype=np.int64)
    given = cloud(np.ones((4, 3)), doppler_m_s=doppler, time_ns=times)
    header, arrays = decode(encode_cloud(given, {}))
    field = next(each for each in header["fields"] if each["name"] == "doppler_m_s")
    assert (field["low"], field["high"]) == (-2.0, 6.0)
    assert arrays["doppler_m_s"][:, 0].tolist() == [0, 64, 255, 0]
    age = next(each for each in header["fields"] if each["name"] == "age_s")
    assert (age["low"], age["high"]) == (0.0, 0.1)
    assert arrays["age_s"][:, 0].tolist() == [255, 128, 0, 255]


def test_a_map_says_where_there_is_no_number():
    level = np.array([[1.0, np.nan, 3.0], [2.0, 2.0, 2.0]])
    header, arrays = decode(encode_map(level, {"layer": "bev"}))
    assert header["count"] == 2
    field = header["fields"][0]
    assert (field["items"], field["low"], field["high"]) == (3, 1.0, 3.0)
    assert arrays["level"].tolist() == [[1, 0, 255], [128, 128, 128]]
    assert decode(encode_map(np.full((2, 2), np.nan), {}))[1]["level"].sum() == 0


def test_bytes_go_in_the_coding_that_is_accepted():
    zstandard = pytest.importorskip("zstandard")
    payload = Payload.of(b"abc" * 1000, "application/octet-stream")
    body, coding = payload.coded("gzip, deflate, br, zstd")
    assert coding == "zstd"
    assert zstandard.ZstdDecompressor().decompress(body, max_output_size=4000) == payload.body
    assert gzip.decompress(payload.coded("gzip")[0]) == payload.body
    assert payload.coded("br") == (payload.body, "")
    assert Payload.of(b"x" * 100, "image/jpeg").coded("zstd")[1] == ""
    assert payload.tag == Payload.of(b"abc" * 1000, "x").tag != Payload.of(b"abd", "x").tag


def test_the_cache_keeps_what_was_used_last_up_to_its_bytes():
    made = []
    cache = Cache[bytes](100, len)

    def get(key: str) -> bytes:
        return cache.get(key, lambda: made.append(key) or b"x" * 40)

    for key in ("a", "b", "a", "c", "a"):
        get(key)
    assert made == ["a", "b", "c"]
    get("b")
    assert made == ["a", "b", "c", "b"]
    assert cache.held <= 100


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("/data/set/a/b.pcd, line 3: expected", "a/b.pcd, line 3: expected"),
        ("/data/set: expected", "the data set: expected"),
        ("cannot open '/opt/me/x/y.txt' or /opt/z/q.", "cannot open '…/y.txt' or …/q."),
        ("3/4 of a/b", "3/4 of a/b"),
        ("", ""),
    ],
)
def test_errors_are_shown_without_absolute_paths(text, shown):
    from types import SimpleNamespace

    assert plain_error(text, SimpleNamespace(root="/data/set")) == shown
