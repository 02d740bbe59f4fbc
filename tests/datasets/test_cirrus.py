import json
import os
from pathlib import Path

import numpy as np
import pytest

from farfield.datasets import open_dataset
from farfield.datasets.cirrus import Cirrus, CirrusWriter, Mapping, read_mapping
from farfield.datasets.cirrus.layout import Pairing, pair, segment_numbers
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.files.clouds import read_cache, write_cache
from farfield.frame import Annotation, Boxes, Camera, Cloud, Constant, Frame, Sensor, merge_clouds
from farfield.frame.cloud import cache_path, write_rows_cache
from farfield.geometry.poses import pose_from_yaw, quaternion_from_yaw

START_NS = 1_558_131_117_608_556_768


def make_cloud(rng: np.random.Generator, count: int = 200) -> Cloud:
    points = rng.uniform([0, -50, -3], [250, 50, 1], (count, 3))
    return Cloud(np.round(points, 4).astype(np.float32), rng.uniform(0, 1, count).astype(np.float32))


def make_boxes(rng: np.random.Generator, count: int = 6) -> Boxes:
    names = ["vehicle", "large_vehicle", "pedestrian", "wheeled_pedestrian", "trailer", "unknown"]
    return Boxes(
        centre_m=rng.uniform([0, -50, -2], [250, 50, 1], (count, 3)),
        size_m=rng.uniform(0.3, 12, (count, 3)),
        yaw_rad=rng.uniform(-np.pi, np.pi, count),
        label=names[:count],
        track_id=np.arange(count),
        point_count=rng.integers(0, 99, count),
    )


def make_frame(rng: np.random.Generator, number: int = 0, *, sequence: str = "highway", gap_ns: int = 0) -> Frame:
    time_ns = START_NS + number * 100_000_000 + gap_ns
    boxes = make_boxes(rng)
    full = boxes.replace(size_m=boxes.size_m + 1.0, centre_m=boxes.centre_m + 0.5)
    return Frame(
        sequence=sequence,
        frame_id=str(time_ns),
        time_ns=time_ns,
        clouds={"gaussian": make_cloud(rng), "uniform": make_cloud(rng)},
        load_annotation=Constant(
            Annotation(boxes=boxes, extent="visible", full_boxes=full, details={"point_count_uniform": np.arange(6)})
        ),
        world_T_frame=pose_from_yaw(0.3, (10.0 * number, 2.0, 0.0)),
        sensors={
            "gaussian": Sensor(kind="lidar", time_ns=time_ns),
            "uniform": Sensor(kind="lidar", time_ns=time_ns + 30_000_000),
        },
        conditions={"weather": "clear"},
    )


@pytest.fixture
def written(tmp_path: Path, rng: np.random.Generator) -> tuple[Path, list[Frame]]:
    frames = [make_frame(rng, i, gap_ns=5_000_000_000 * (i >= 3)) for i in range(5)]
    writer = CirrusWriter(tmp_path)
    for frame in frames:
        writer.write(frame)
    return tmp_path / "Cirrus_dataset1", frames


def assert_same_boxes(a: Boxes | None, b: Boxes | None) -> None:
    assert a is not None
    assert b is not None
    np.testing.assert_allclose(a.centre_m, b.centre_m, atol=6e-7)
    np.testing.assert_allclose(a.size_m, b.size_m, atol=6e-7)
    np.testing.assert_allclose(a.yaw_rad, b.yaw_rad, atol=1e-9)
    assert a.label.tolist() == b.label.tolist()


def test_round_trip_keeps_clouds_boxes_and_the_rest(written):
    root, frames = written
    data = open_dataset(root)
    assert data.name == "cirrus"
    assert data.sequences == ("segment_00",) * 3 + ("segment_01",) * 2
    for got, want in zip(data, frames, strict=True):
        assert (got.frame_id, got.time_ns) == (want.frame_id, want.time_ns)
        for pattern in ("gaussian", "uniform"):
            np.testing.assert_array_equal(got.clouds[pattern].points_m, want.clouds[pattern].points_m)
            np.testing.assert_allclose(got.clouds[pattern].intensity, want.clouds[pattern].intensity, atol=6e-7)
        assert_same_boxes(got.boxes, want.boxes)
        assert_same_boxes(got.annotation.full_boxes, want.annotation.full_boxes)
        assert got.boxes.track_id.tolist() == want.boxes.track_id.tolist()
        assert got.boxes.point_count.tolist() == want.boxes.point_count.tolist()
        assert got.annotation.details["point_count_uniform"].tolist() == list(range(6))
        assert got.metadata["pair_dt_ms"] == pytest.approx(30.0)
        np.testing.assert_allclose(got.world_T_frame, want.world_T_frame)
        assert got.conditions == {"weather": "clear"}
        assert len(merge_clouds(got, ["gaussian", "uniform"])) == 400


def test_layout_on_disk_is_the_released_one(written):
    root, frames = written
    folders = sorted(path.name for path in root.iterdir())
    assert folders == ["dataset1_annotation", "dataset1_gaussian", "dataset1_uniform"]
    stem = frames[0].frame_id
    assert len((root / f"dataset1_gaussian/{stem}.xyz").read_text().splitlines()[0].split(",")) == 5
    assert len(next((root / "dataset1_uniform").glob("*.xyz")).read_text().splitlines()[0].split(",")) == 8
    label = json.loads((root / f"dataset1_annotation/{stem}.json").read_text())["labels"][0]
    box = frames[0].boxes[0]
    np.testing.assert_allclose(label["size"], box.size_m[0], atol=1e-6)  # l, w, h
    np.testing.assert_allclose(label["quaternion"], quaternion_from_yaw(box.yaw_rad)[0], atol=1e-9)  # x, y, z, w
    np.testing.assert_allclose(label["position"], box.centre_m[0], atol=1e-6)


def test_the_same_frame_gives_the_same_bytes(tmp_path):
    contents = []
    for name in ("a", "b"):
        paths = CirrusWriter(tmp_path / name).write(make_frame(np.random.default_rng(3)))
        contents.append([path.read_bytes() for path in paths.values()])
    assert contents[0] == contents[1]


def test_writer_can_label_full_boxes(tmp_path, rng):
    frame = make_frame(rng)
    CirrusWriter(tmp_path).write(frame, box_label_source="full_boxes")
    assert_same_boxes(open_dataset(tmp_path)[0].boxes, frame.annotation.full_boxes)


def test_writer_refuses_two_sequences_at_one_time(tmp_path, rng):
    writer = CirrusWriter(tmp_path)
    writer.write(make_frame(rng))
    with pytest.raises(DatasetError, match="written for sequence 'highway'"):
        writer.write(make_frame(rng, sequence="urban"))


def test_camera_and_calibration_round_trip(tmp_path, rng):
    camera = Camera(matrix=np.array([[900.0, 0, 320], [0, 900, 100], [0, 0, 1]]), width_px=640, height_px=200)
    base = make_frame(rng)
    frame = Frame(
        sequence="s",
        frame_id=base.frame_id,
        time_ns=base.time_ns,
        clouds=base.clouds,
        images={"camera": np.full((20, 64, 3), 90, np.uint8)},
        cameras={"camera": camera},
        sensors={"camera": Sensor(kind="camera", in_frame=False, time_ns=START_NS + 12_000_000)},
    )
    CirrusWriter(tmp_path).write(frame)
    got = open_dataset(tmp_path)[0]
    assert got.images["camera"].shape == (20, 64, 3)
    assert got.metadata["camera_dt_ms"] == pytest.approx(12.0)
    assert got.boxes is None
    np.testing.assert_allclose(got.cameras["camera"].matrix, camera.matrix)
    np.testing.assert_allclose(got.cameras["camera"].camera_T_lidar, camera.camera_T_lidar)


def test_several_datasets_in_one_folder(tmp_path, rng):
    for number in (2, 10):
        CirrusWriter(tmp_path, number=number).write(make_frame(rng))
    data = open_dataset(tmp_path)
    assert [part.number for part in data.parts] == [2, 10]
    assert data.sequences == ("segment_00", "segment_01")


def test_authors_layout_and_their_text_labels(tmp_path, rng):
    # Oracle: the mapping from box to text as reference derives it: h w l = s2 s0 s1, x y z = -y, -(z - h/2), x, -yaw.
    stem = str(START_NS)
    frame = make_frame(rng)
    made = CirrusWriter(tmp_path / "made").write(frame)
    for kind, folder in (("gaussian", "lidar"), ("uniform", "lidar_u")):
        target = tmp_path / "batch/dataset/raw_data" / folder / f"{stem}.xyz"
        target.parent.mkdir(parents=True)
        target.write_bytes(made[kind].read_bytes())
    boxes = frame.boxes
    lines = [
        f"{name} 0.0 0.0 0.0 0.0 0.0 0.0 0.0 {s[2]} {s[0]} {s[1]} {-c[1]} {-(c[2] - s[2] / 2)} {c[0]} {-yaw}"
        for name, s, c, yaw in zip(boxes.label, boxes.size_m, boxes.centre_m, boxes.yaw_rad, strict=True)
    ]
    labels = tmp_path / "batch/dataset/txt_files" / f"{stem}.txt"
    labels.parent.mkdir()
    labels.write_text("\n".join(lines) + "\n")
    for root in (tmp_path / "batch", tmp_path / "batch/dataset"):
        got = open_dataset(root)[0]
        assert set(got.clouds) == {"gaussian", "uniform"}
        assert_same_boxes(got.boxes, boxes)
    kitti = Mapping.model_validate({"labels": {"text_naming": "kitti"}})
    other = Cirrus(tmp_path / "batch", mapping=kitti)[0].boxes
    np.testing.assert_allclose(  # the same rectangle, the heading turned by a quarter
        np.sort(other.bev_corners_m(), axis=1), np.sort(boxes.bev_corners_m(), axis=1), atol=1e-6
    )


@pytest.mark.parametrize(
    ("change", "labels"),
    [
        (lambda o: o.update(size=[o["size"][1], o["size"][0], o["size"][2]]), {"size_order": "wlh"}),
        (lambda o: o.update(quaternion=[o["quaternion"][i] for i in (3, 0, 1, 2)]), {"quat_order": "wxyz"}),
        (lambda o: o["position"].__setitem__(2, o["position"][2] - o["size"][2] / 2), {"position_is": "bottom"}),
        (lambda o: o.update(label_class="Large Vehicle"), {"aliases": {}}),
    ],
)
def test_mapping_mends_each_known_deviation(written, change, labels):
    root, frames = written
    path = next((root / "dataset1_annotation").glob(f"{frames[0].frame_id}.json"))
    content = json.loads(path.read_text())
    for label in content["labels"]:
        change(label)
    path.write_text(json.dumps(content))
    got = open_dataset(root, mapping=Mapping.model_validate({"labels": labels}))[0].boxes
    want = frames[0].boxes if labels != {"aliases": {}} else frames[0].boxes.replace(label="large_vehicle")
    assert_same_boxes(got, want)


def test_mapping_file_rejects_unknown_keys_and_escapes(tmp_path):
    path = tmp_path / "mapping.yaml"
    path.write_text("labels: {size_ordr: wlh}\n")
    with pytest.raises(ConfigError, match="size_ordr"):
        read_mapping(path)
    path.write_text('layout: {gaussian: "../secret/*.xyz"}\n')
    with pytest.raises(ConfigError, match="below the data set's root"):
        read_mapping(path)
    path.write_text("xyz: {intensity_scale: 255}\npairing: {mode: order, max_dt_ms: 50}\n")
    assert read_mapping(path).xyz.intensity_scale == 255


def test_mapping_of_another_layout(written):
    root, _ = written
    (root / "dataset1_gaussian").rename(root / "sweeps")
    layout = {"gaussian": "sweeps/*.xyz", "uniform": "none/*.xyz", "labels": "dataset1_annotation/*.json"}
    data = open_dataset(root, mapping=Mapping.model_validate({"layout": layout}))
    assert len(data) == 5
    assert list(data[0].clouds) == ["gaussian"]
    assert data[0].boxes is not None


def test_nearest_and_order_pairing_limit_the_time_difference():
    keys = [Path(f"{START_NS + i * 100_000_000}.xyz") for i in range(3)]
    others = [Path(f"{START_NS + ms * 1_000_000}.xyz") for ms in (68, 168, 600)]
    partners, dt = pair(keys, others, Pairing(max_dt_ms=100))
    assert partners == [others[0], others[0], others[1]]
    assert dt == pytest.approx([68.0, -32.0, -32.0])
    partners, dt = pair(keys, others, Pairing(mode="order", max_dt_ms=100))
    assert partners == [others[0], others[1], None]
    assert dt[:2] == pytest.approx([68.0, 68.0])
    assert dt[2] is None
    assert pair(keys, [], Pairing()) == ([None] * 3, [None] * 3)
    assert pair(keys, [Path("a.jpg"), Path("b.jpg")], Pairing()) == ([Path("a.jpg"), Path("b.jpg"), None], [None] * 3)


def test_segments_begin_after_a_pause():
    times = [0, 100_000_000, 1_100_000_000, 2_200_000_000]
    assert segment_numbers(times, 1.0) == [0, 0, 0, 1]
    assert segment_numbers([None, None], 1.0) == [0, 0]
    assert segment_numbers([], 1.0) == []


def test_intensity_scale_is_decided_and_an_outlier_is_an_error(written):
    root, frames = written
    for frame in frames:
        path = root / f"dataset1_gaussian/{frame.frame_id}.xyz"
        rows = np.loadtxt(path, delimiter=",")
        rows[:, 3] = np.round(rows[:, 3] * 254)
        np.savetxt(path, rows, fmt="%.4f", delimiter=",")
    data = open_dataset(root)
    assert data[0].metadata["intensity_scale"] == {"gaussian": 255.0, "uniform": 1.0}
    np.testing.assert_allclose(data[1].cloud("gaussian").intensity, frames[1].cloud("gaussian").intensity, atol=0.01)
    wrong = open_dataset(root, mapping=Mapping.model_validate({"xyz": {"intensity_scale": 1.0}}))
    with pytest.raises(FileFormatError, match="intensity_scale"):
        wrong[0].cloud("gaussian")


def test_cache_is_used_while_it_is_fresh(written, monkeypatch):
    root, frames = written
    source = root / f"dataset1_gaussian/{frames[0].frame_id}.xyz"
    before = open_dataset(root)[0].cloud("gaussian")
    cached = write_rows_cache(source, root)
    assert cached == cache_path(source, root)
    os.utime(source, (2e9, 2e9))  # touched or copied: the bytes are the same
    from farfield.files import xyz

    parsed, parse = [], xyz.read_xyz
    monkeypatch.setattr(xyz, "read_xyz", lambda path, **options: parsed.append(path) or parse(path, **options))
    after = open_dataset(root)[0].cloud("gaussian")
    assert source not in parsed
    np.testing.assert_array_equal(before.points_m, after.points_m)
    np.testing.assert_array_equal(before.intensity, after.intensity)


@pytest.mark.parametrize("change", ["one digit", "fewer rows", "an older file", "a cache of old"])
def test_a_cache_of_other_bytes_is_stale_whatever_the_times(written, change):
    root, frames = written
    source = root / f"dataset1_gaussian/{frames[0].frame_id}.xyz"
    cached = write_rows_cache(source, root)
    times = (source.stat().st_atime_ns, source.stat().st_mtime_ns)
    text = source.read_text()
    if change == "one digit":
        at = next(at for at in range(len(text) // 2, len(text)) if text[at] == ".") - 1
        source.write_text(text[:at] + ("1" if text[at] != "1" else "2") + text[at + 1 :])
    elif change == "fewer rows":
        source.write_text("".join(text.splitlines(keepends=True)[:100]))
    elif change == "an older file":
        other = source.with_suffix(".old")
        other.write_text("".join(reversed(text.splitlines(keepends=True))))
        os.utime(other, ns=(times[0], times[1] - 10**12))
        other.replace(source)
    else:
        arrays = read_cache(cached)
        write_cache(cached, {name: column[:50] for name, column in arrays.items()})
    if change not in ("an older file", "a cache of old"):
        os.utime(source, ns=times)
    rows = np.loadtxt(source, delimiter=",")
    np.testing.assert_allclose(open_dataset(root)[0].cloud("gaussian").points_m, rows[:, :3], atol=1e-4)
    write_rows_cache(source, root)
    np.testing.assert_allclose(open_dataset(root)[0].cloud("gaussian").points_m, rows[:, :3], atol=1e-4)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("[1]", "a list 'labels'"),
        ("{", "JSON"),
        ('{"labels": [1]}', "label 0"),
        ('{"labels": [{"label_class": "vehicle", "position": [1, 2], "size": [], "quaternion": []}]}', "3 numbers"),
        (
            '{"labels": [{"label_class": "a", "position": [1, 2, NaN], "size": [1, 1, 1], "quaternion":[0, 0, 0, 1]}]}',
            "NaN",
        ),
        (
            '{"labels": [{"label_class": "a", "position": [1, 2, 3], "size": [1, 0, 1], "quaternion": [0, 0, 0, 1]}]}',
            "a positive size",
        ),
        (
            '{"labels": [{"label_class": "a", "position": [1, 2, 3], "size": [1, 1, 1], "quaternion": [0, 0, 0, 0]}]}',
            "of length 1",
        ),
    ],
)
def test_damaged_annotations_name_file_and_label(written, text, match):
    root, frames = written
    (root / f"dataset1_annotation/{frames[0].frame_id}.json").write_text(text)
    with pytest.raises(FileFormatError, match=match):
        _ = open_dataset(root)[0].boxes


def test_split_keeps_segments_whole_and_a_file_decides(tmp_path, rng):
    writer = CirrusWriter(tmp_path)
    for number in range(10):
        writer.write(make_frame(rng, number, gap_ns=number * 5_000_000_000))
    data = open_dataset(tmp_path)
    parts = {name: data.split(name) for name in ("train", "val", "test")}
    keys = [key for part in parts.values() for key in part.keys]
    assert sorted(keys) == sorted(data.keys)
    assert [len(parts[name]) for name in ("train", "val", "test")] in ([6, 2, 2], [7, 1, 2], [7, 2, 1], [8, 1, 1])
    assert data.split("val").keys == parts["val"].keys
    (tmp_path / "splits").mkdir()
    (tmp_path / "splits/cirrus_v1.json").write_text(json.dumps({"train": ["segment_01"], "val": ["segment_00"]}))
    assert set(open_dataset(tmp_path).split("val").sequences) == {"segment_00"}
    with pytest.raises(ConfigError, match="expected a split, one of train, val"):
        open_dataset(tmp_path).split("test")


def test_real_luminar_frames(shared_real):
    data = open_dataset(shared_real / "cirrus_layout" / "Cirrus_dataset1")
    assert len(data) == 3
    frame = data[0]
    assert len(frame.cloud()) == 40733
    assert len(frame.boxes) == 95
    assert list(frame.clouds) == ["gaussian"]
    assert frame.metadata["pair_dt_ms"] is None
    assert frame.metadata["intensity_scale"] == {"gaussian": 1.0}
    inside = [len(indices) for indices in frame.cloud().in_boxes(frame.boxes)]
    assert np.count_nonzero(inside) > 75
    back = data.turned(180)[0]
    assert [len(indices) for indices in back.cloud().in_boxes(back.boxes, margin_m=1e-4)] == pytest.approx(
        inside, abs=3
    )
