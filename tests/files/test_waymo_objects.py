"""Waymo's Objects: bytes made here by the published field numbers, damage, and what is written read back."""

import struct
from pathlib import Path

import numpy as np
import pytest

from farfield.errors import FileFormatError
from farfield.files import waymo_objects
from farfield.files.waymo_objects import WaymoObjects, read_waymo_objects, write_waymo_objects
from farfield.frame.annotation import Annotation
from farfield.geometry.boxes import Boxes
from farfield.metrics import Detections
from farfield.metrics.box_files import read, read_predictions
from farfield.metrics.submissions import waymo_part

BOX = {1: 10.5, 2: -3.25, 3: 1.0, 4: 2.0, 5: 4.5, 6: 1.5, 7: 0.25}  # 4 is the width, 5 the length


def varint(value: int) -> bytes:
    value &= (1 << 64) - 1
    return bytes([value & 0x7F | 0x80]) + varint(value >> 7) if value > 0x7F else bytes([value])


def whole(number: int, value: int) -> bytes:
    return varint(number * 8) + varint(value)


def message(number: int, data: bytes) -> bytes:
    return varint(number * 8 + 2) + varint(len(data)) + data


def box(values: dict[int, float]) -> bytes:
    return b"".join(varint(number * 8 + 1) + struct.pack("<d", value) for number, value in values.items())


def label(*more: bytes, numbers: dict[int, float] | None = None, kind: int = 1) -> bytes:
    return message(1, message(1, box(BOX if numbers is None else numbers)) + whole(3, kind) + b"".join(more))


def thing(*parts: bytes, context: bytes = b"segment", stamp: int = 1_557_000_000_000_000) -> bytes:
    return message(1, b"".join(parts) + message(4, context) + whole(5, stamp))


SCORE = varint(2 * 8 + 5) + struct.pack("<f", 0.75)


def test_fields_are_those_that_waymo_published(tmp_path: Path) -> None:
    seen = message(11, b"FRONT") + message(12, box({**BOX, 1: 11.0}))
    first = label(message(4, b"id-1"), whole(5, 2), whole(7, 40), seen, whole(13, 30), message(99, b"later"))
    data = thing(first, SCORE, whole(3, 1)) + thing(label(kind=4), stamp=1_557_000_000_100_000) + message(2, b"")
    (tmp_path / "a.bin").write_bytes(data)
    found = read_waymo_objects(tmp_path / "a.bin")
    assert (len(found), found.zones) == (2, 1)
    assert found.context == ("segment", "segment")
    assert found.time_us.tolist() == [1_557_000_000_000_000, 1_557_000_000_100_000]
    assert found.box[0].tolist() == [10.5, -3.25, 1.0, 4.5, 2.0, 1.5, 0.25]
    assert (found.type.tolist(), found.id) == ([1, 4], ("id-1", ""))
    assert found.score[0] == 0.75
    assert np.isnan(found.score[1])
    assert found.detection_level.tolist() == [2, 0]
    assert (found.points.tolist(), found.top_points.tolist()) == ([40, -1], [30, -1])
    assert found.no_label_zone.tolist() == [True, False]
    assert (found.camera, found.camera_box[0, 0]) == (("FRONT", ""), 11.0)
    assert np.isnan(found.camera_box[1]).all()
    wrapped = whole(1, 2) + message(13, b"me@example.org") + message(11, data)
    (tmp_path / "b.bin").write_bytes(wrapped)
    assert read_waymo_objects(tmp_path / "b.bin").id == found.id
    (tmp_path / "none.bin").write_bytes(b"")
    assert len(read_waymo_objects(tmp_path / "none.bin")) == 0


def test_what_is_written_is_read_back(tmp_path: Path, rng: np.random.Generator) -> None:
    boxes = Boxes(
        centre_m=rng.normal(0, 50, (20, 3)),
        size_m=rng.uniform(0.5, 5, (20, 3)),
        yaw_rad=rng.uniform(-3, 3, 20),
        label=rng.choice(["vehicle", "pedestrian", "sign", "cyclist"], 20),
        score=rng.random(20).astype(np.float32).astype(np.float64),
    )
    keys = [("segment", "1557000000000000"), ("other", "1557000000100000")]
    path = tmp_path / "boxes.bin"
    assert write_waymo_objects(path, [waymo_part(key, boxes) for key in keys]) == 40
    found = read_predictions(path, format="waymo")
    assert sorted(found.boxes) == sorted(keys)
    for key in keys:
        for name in ("centre_m", "size_m", "yaw_rad", "score"):
            np.testing.assert_array_equal(getattr(found.boxes[key], name), getattr(boxes, name))
        assert found.boxes[key].label.tolist() == boxes.label.tolist()
    again = read_waymo_objects(path)
    write_waymo_objects(tmp_path / "again.bin", [again])
    assert (tmp_path / "again.bin").read_bytes() == path.read_bytes()
    both = read(path, path, format="waymo")
    own = Detections(boxes=dict.fromkeys(keys, boxes), annotations=dict.fromkeys(keys, Annotation(boxes=boxes)))
    assert both.score("waymo").figures == own.score("waymo").figures


GOOD = thing(label(whole(7, 9)), SCORE)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (GOOD[:-1], "bytes where"),
        (GOOD + b"\x0a", "end within a number"),
        (GOOD + b"\x0a" + b"\xff" * 11, "more than 64 bits"),
        (GOOD + b"\x0a\xff\xff\xff\xff\x0f", "bytes where"),
        (GOOD + b"\x0b", "kind 3"),
        (GOOD + b"\x02\x00", "number 0"),
        (b"\x1f\x8b" + GOOD, "unpack the archive"),
        (whole(1, 2), "without inference_results"),
        (message(1, label()), "context_name"),
        (thing(SCORE), "no box"),
        (thing(label(numbers={**BOX, 5: 0.0})), "length, width, height"),
        (thing(label(numbers={**BOX, 1: float("nan")})), "not finite"),
        (thing(label(numbers={**BOX, 2: 1e30})), "not finite"),
        (thing(label(kind=9)), "type 9"),
        (thing(label(whole(5, 3))), "detection_difficulty_level 3"),
        (thing(label(whole(7, -4))), "num_lidar_points_in_box -4"),
        (thing(label(), whole(6, 1)), "camera's image"),
        (thing(label(), context=b"x" * 300), "name of 300 bytes"),
        (thing(label(), context=b"a\nb"), "control character"),
        (thing(label(), context=b"\xff"), "utf-8"),
        (thing(label(), varint(2 * 8 + 5) + struct.pack("<f", float("inf"))), "score inf"),
        (thing(label(), stamp=-5), "frame_timestamp_micros"),
        (thing(message(1, whole(1, 7))), "no message"),
        (b'{"results": {}}', "found"),
    ],
)
def test_damage_and_lies_are_refused_by_name(tmp_path: Path, data: bytes, words: str) -> None:
    path = tmp_path / "damaged.bin"
    path.write_bytes(data)
    with pytest.raises(FileFormatError, match=words) as caught:
        read_waymo_objects(path)
    assert "damaged.bin" in str(caught.value)


def test_every_cut_and_many_changed_bytes_are_refused_or_read(tmp_path: Path, rng: np.random.Generator) -> None:
    data = bytearray(GOOD * 3)
    path = tmp_path / "changed.bin"
    whole_ends = {len(GOOD) * count for count in range(4)}
    for end in range(len(data)):
        path.write_bytes(data[:end])
        if end in whole_ends:
            assert len(read_waymo_objects(path)) == end // len(GOOD)
            continue
        with pytest.raises(FileFormatError):
            read_waymo_objects(path)
    for _ in range(400):
        changed = bytearray(data)
        changed[rng.integers(len(data))] = rng.integers(256)
        path.write_bytes(changed)
        try:
            assert isinstance(read_waymo_objects(path), WaymoObjects)
        except FileFormatError:
            continue


def test_scores_of_some_alone_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "some.bin"
    path.write_bytes(GOOD + thing(label()))
    with pytest.raises(FileFormatError, match="1 of 2 without"):
        read_predictions(path, format="waymo")
    path.write_bytes(thing(label()))
    assert "no score" in " ".join(read_predictions(path, format="waymo").notes)


def test_waymos_own_files_give_waymos_own_figures(shared_real: Path) -> None:
    files = [shared_real / "waymo_metrics" / name for name in ("fake_predictions.bin", "fake_ground_truths.bin")]
    if not all(path.is_file() for path in files):
        pytest.skip("Waymo's own files are not there")
    import json

    expected = json.loads((files[0].parent / "expected.json").read_text())["detection_let"]
    result = read(*files, format="waymo").score("waymo-let")
    ranges = {"[0, 30)": "0-30", "[30, 50)": "30-50", "[50, +inf)": "50-inf"}
    for name, values in expected.items():
        words = name.removeprefix("OBJECT_TYPE_").removeprefix("RANGE_").removeprefix("TYPE_").split("_")
        figures = result.ranges[ranges[words[1]]] if name.startswith("RANGE") else result.figures
        for kind, value in values.items():
            figure = f"ap/{words[0].lower()}/level_2/{kind.removeprefix('LET-m').lower()}"
            assert (figures[figure] or 0.0) == pytest.approx(value, abs=1e-6)


def test_objects_of_many_batches_are_those_of_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.bin"
    objects = [thing(label(message(4, b"id-%d" % number)), context=b"segment %d" % (number % 2)) for number in range(7)]
    path.write_bytes(b"".join(objects) + message(2, b""))
    monkeypatch.setattr(waymo_objects, "_BATCH", 3)
    table = read_waymo_objects(path)
    assert table.id == tuple(f"id-{number}" for number in range(7))
    assert table.context[:3] == ("segment 0", "segment 1", "segment 0")
    assert (table.box.shape, table.zones) == ((7, 7), 1)
    assert table.context[0] is table.context[2]
    path.write_bytes(objects[0] * 3)
    assert len(read_waymo_objects(path)) == 3
    monkeypatch.setattr(waymo_objects, "MAX_OBJECTS", 6)
    path.write_bytes(b"".join(objects))
    with pytest.raises(FileFormatError, match="more than 6 objects"):
        read_waymo_objects(path)


@pytest.mark.parametrize(("data", "limit"), [(message(2, b""), "_MAX_ZONES"), (message(11, b""), "_MAX_RESULTS")])
def test_many_empty_fields_are_refused_as_they_come(tmp_path, monkeypatch, data: bytes, limit: str) -> None:
    monkeypatch.setattr(waymo_objects, limit, 10)
    (tmp_path / "a.bin").write_bytes(data * 11 + b"\xff")  # the damage behind them is not reached
    with pytest.raises(FileFormatError, match="zones or"):
        read_waymo_objects(tmp_path / "a.bin")


def test_files_above_a_quarter_of_a_gigabyte_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    monkeypatch.setattr(waymo_objects, "read_bytes", lambda path, *, max_bytes: asked.append(max_bytes) or b"")
    assert len(read_waymo_objects(tmp_path / "a.bin")) == 0
    assert asked == [1 << 31]
