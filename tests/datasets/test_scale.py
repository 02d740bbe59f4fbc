"""Scale's LiDAR tasks: worlds and poses, which frame is whose answer, what no page says."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tool_trees import CAR, SCALE_NS, write_scale

from farfield.datasets import open_dataset
from farfield.datasets.labels import label_format
from farfield.datasets.scale import ScaleAi
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.files.scale import parse_frame, parse_points


def edit(path: Path, change: Callable[[Any], Any]) -> None:
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def put_task(root: Path, *names: str, **more: Any) -> None:
    content = {"task_id": "5", "params": {"attachments": [f"https://a.com/x/{name}?s=1" for name in names], **more}}
    (root / "task.json").write_text(json.dumps(content))


def test_the_yaw_counts_from_y_and_the_length_lies_along_it(tmp_path: Path) -> None:
    """Scale's words: 0 looks along (0, 1, 0), which is the length's side, and pi/2 along (-1, 0, 0)."""
    write_scale(tmp_path)
    pose = {"device_position": {"x": 0, "y": 0, "z": 0}, "device_heading": {"w": 1, "x": 0, "y": 0, "z": 0}}
    for path in tmp_path.glob("000*.json"):
        edit(path, lambda frame: frame.update(pose, points=[], images=[]))
    turn = {"yaw": math.pi / 2, "dimensions": {"x": 2, "y": 5, "z": 1.5}}
    edit(tmp_path / "answer.json", lambda frames: frames[0]["cuboids"][0].update(turn))
    boxes = open_dataset(tmp_path)[0].boxes
    assert boxes is not None
    assert boxes.size_m[0].tolist() == [5, 2, 1.5]
    assert math.cos(boxes.yaw_rad[0]) == pytest.approx(-1)


def test_frames_stand_round_the_device_and_their_poses_lead_back(tmp_path: Path) -> None:
    data = open_dataset(write_scale(tmp_path))
    assert label_format(data) is None
    for index, frame in enumerate(data):
        points = json.loads((tmp_path / f"{frame.frame_id}.json").read_text())["points"]
        world_m = np.array([[point[axis] for axis in "xyz"] for point in points])
        cloud = frame.cloud()
        assert frame.world_T_frame is not None
        back = cloud.points_m.astype(np.float64) @ frame.world_T_frame[:3, :3].T + frame.world_T_frame[:3, 3]
        np.testing.assert_allclose(back, world_m, atol=2e-6)
        assert cloud.intensity is not None
        np.testing.assert_allclose(cloud.intensity, [point["i"] for point in points], atol=1e-7)
        assert cloud.extra["device"].tolist() == [point["d"] for point in points]
        assert frame.time_ns == SCALE_NS + index * 10**8
        assert cloud.extra["offset_ns"].tolist() == [row * 1000 for row in range(60)]
        annotation = frame.annotation
        assert annotation is not None
        assert annotation.moving is not None
        assert annotation.moving.tolist() == [True, False][: index + 1]
        assert annotation.boxes.point_count is not None
        assert annotation.boxes.point_count.tolist() == [60, 60][: index + 1]
        assert annotation.details["color"].tolist() == ["red", "red"][: index + 1]
        assert "stationary" not in annotation.details
    (drive,) = data.drives()
    assert drive.times_ns is not None
    assert drive.times_ns.tolist() == [SCALE_NS, SCALE_NS + 10**8]
    assert drive.world_T_frame is not None
    assert drive.world_T_frame[1, :3, 3].tolist() == [501, 200, 1]


def test_a_point_of_the_world_falls_on_the_pixel_that_its_image_says(tmp_path: Path) -> None:
    """By hand: the camera stands a metre ahead and looks ahead; its lens bends by k1 = 0.01."""
    frame = open_dataset(write_scale(tmp_path))[1]
    assert frame.images["camera_0"].shape == (18, 32, 3)
    assert frame.sensors["camera_0"].time_ns == SCALE_NS + 10**8 + 5
    pixels, depth, _ = frame.cameras["camera_0"].project(np.array([[11.0, 2.0, -1.0]]))
    bent = 1 + 0.01 * (0.2**2 + 0.1**2)
    np.testing.assert_allclose(pixels[0], [16 - 20 * 0.2 * bent, 9 + 20 * 0.1 * bent], atol=1e-9)
    assert depth[0] == pytest.approx(10)


@pytest.mark.parametrize(
    "lens", [{"camera_model": "fisheye"}, {"skew": 0.1}, {"scale_factor": 2}, {"k5": 0.1}, {"xi": 1.1}]
)
def test_a_lens_that_has_no_place_is_named(tmp_path: Path, lens: dict[str, Any]) -> None:
    write_scale(tmp_path)
    edit(tmp_path / "0007.json", lambda frame: frame["images"][0].update(lens))
    data = open_dataset(tmp_path)
    assert f"camera_0 ({next(iter(lens))}" in data.notes[0]
    assert not data[0].cameras
    assert list(data[0].images) == ["camera_0"]
    assert next(iter(lens)) in data[0].metadata["lens"]["camera_0"]


def test_names_are_ordered_by_their_numbers_and_a_task_decides_otherwise(tmp_path: Path) -> None:
    write_scale(tmp_path)
    for old, new in (("0007", "frame-9"), ("0008", "frame-10")):
        (tmp_path / f"{old}.json").rename(tmp_path / f"{new}.json")
    data = open_dataset(tmp_path)
    assert data.frame_ids == ("frame-9", "frame-10")
    assert "order of the files' names" in data.assumptions[0]
    assert [len(data.annotation(index).boxes) for index in (0, 1)] == [1, 2]  # type: ignore[union-attr]
    put_task(tmp_path, "frame-10.json", "frame-9.json")
    turned = open_dataset(tmp_path)
    assert turned.frame_ids == ("frame-10", "frame-9")
    assert not turned.assumptions
    with pytest.raises(DatasetError, match=r"frame-9\.json: expected a timestamp.*frame-10\.json.*may not match"):
        turned.drives()


def test_a_callback_and_its_task_may_lie_beside_each_other(tmp_path: Path) -> None:
    put_task(write_scale(tmp_path), "0008.json", "0007.json")
    task = json.loads((tmp_path / "task.json").read_text())
    (tmp_path / "callback.json").write_text(json.dumps({"task_id": "5", "response": {}, "task": task}))
    assert open_dataset(tmp_path).frame_ids == ("0008", "0007")
    put_task(tmp_path, "0007.json", "0008.json")
    with pytest.raises(DatasetError, match=r"task\.json: expected the same frames"):
        open_dataset(tmp_path)


def test_an_answer_above_the_frames_is_theirs(tmp_path: Path) -> None:
    write_scale(tmp_path / "frames")
    (tmp_path / "frames" / "answer.json").rename(tmp_path / "answer.json")
    data = open_dataset(tmp_path)
    assert (data.name, data.sequences[0], data.has_annotation(1)) == ("scale", "frames", True)
    write_scale(tmp_path / "more")
    (tmp_path / "more" / "answer.json").rename(tmp_path / "more.json")
    both = open_dataset(tmp_path)
    assert both.sequences == ("frames", "frames", "more", "more")
    assert [both.has_annotation(index) for index in (0, 2)] == [False, True], "the first is called like no folder"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda frames: frames.pop(), r"answer\.json: expected cuboids of 2 frames.*1 frame: 0008\.json has no"),
        (lambda frames: frames.append({"cuboids": []}), r"answer\.json: .* 3 frames: frame 2 has no file"),
        (lambda frames: frames[1].pop("cuboids"), r"answer\.json.*frame 1.*cuboids"),
    ],
)
def test_an_answer_of_other_frames_is_refused(tmp_path: Path, change: Callable[[Any], Any], words: str) -> None:
    write_scale(tmp_path)
    edit(tmp_path / "answer.json", change)
    with pytest.raises((DatasetError, FileFormatError), match=words):
        open_dataset(tmp_path)


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (("0007.json", "0009.json"), r"task\.json: expected the file of frame 1, '0009\.json'"),
        (("0007.json",), r"0008\.json: expected an attachment of .*task\.json"),
        (("0007.json", "0007.json"), r"task\.json.*different names.*twice"),
    ],
)
def test_attachments_of_other_names_are_refused(tmp_path: Path, names: tuple[str, ...], words: str) -> None:
    put_task(write_scale(tmp_path), *names)
    with pytest.raises((DatasetError, FileFormatError), match=words):
        open_dataset(tmp_path)


def test_of_two_answers_one_is_named(tmp_path: Path) -> None:
    write_scale(tmp_path)
    (tmp_path / "other.json").write_text('[{"cuboids": []}, {"cuboids": []}]')
    with pytest.raises(DatasetError, match=r"one answer .* found answer\.json, other\.json; name .*answer=NAME"):
        open_dataset(tmp_path)
    assert [len(ScaleAi(tmp_path, answer=name)[0].boxes or ()) for name in ("answer.json", "other.json")] == [1, 0]
    with pytest.raises(DatasetError, match=r"answer 'none\.json'"):
        ScaleAi(tmp_path, answer="none.json")


def test_coordinates_in_other_units_become_metres(tmp_path: Path) -> None:
    write_scale(tmp_path)
    put_task(tmp_path, "0007.json", "0008.json", meters_per_unit=0.5)
    said, overruled = ScaleAi(tmp_path)[0], ScaleAi(tmp_path, metres_per_unit=2)[0]
    for frame, factor in ((said, 0.5), (overruled, 2)):
        assert frame.boxes is not None
        np.testing.assert_allclose(frame.boxes.centre_m[0], np.multiply(CAR[:3], factor))
        np.testing.assert_allclose(frame.boxes.size_m[0], np.multiply(CAR[3:6], factor))
        assert frame.world_T_frame is not None
        assert frame.world_T_frame[0, 3] == 500 * factor
    assert overruled.cloud().points_m[:, 0].min() > 20


def test_intensities_beyond_1_want_their_scale(tmp_path: Path) -> None:
    write_scale(tmp_path)
    edit(tmp_path / "0007.json", lambda frame: frame["points"][4].update(i=51))
    with pytest.raises(FileFormatError, match=r"0007\.json.*point 4.*i from 0 to 1.*intensity_scale=255"):
        open_dataset(tmp_path)[0].cloud()
    intensity = ScaleAi(tmp_path, intensity_scale=255)[0].cloud().intensity
    assert intensity is not None
    assert intensity[4] == np.float32(0.2)


def test_times_in_another_unit_are_said(tmp_path: Path) -> None:
    write_scale(tmp_path)
    edit(tmp_path / "0007.json", lambda frame: frame.update(timestamp=1541196976.5, images=[]))
    assert ScaleAi(tmp_path, time_unit="s")[0].time_ns == 1541196976500000000
    edit(tmp_path / "0007.json", lambda frame: frame.update(timestamp="then"))
    with pytest.raises(FileFormatError, match=r"0007\.json.*timestamp.*time_unit"):
        open_dataset(tmp_path)[0]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda frame: frame.pop("device_heading"), "device_heading"),
        (lambda frame: frame.update(device_position=None), "device_position"),
        (lambda frame: frame["device_heading"].update(w=9), "length 1"),
        (lambda frame: frame.update(device_heading={"w": 0, "x": 1, "y": 0, "z": 0}), "z points up"),
        (lambda frame: frame["device_position"].update(x=1e30), "x, y, z"),
        (lambda frame: frame["images"][0].update(image_url="s3://b/../x.png"), "image_url"),
        (lambda frame: frame["images"][0].update(fx=0), "focal lengths"),
        (lambda frame: frame["images"].append(frame["images"][0] | {"camera_index": 0}), "camera_index"),
        (lambda frame: frame["images"].append(frame["images"][0]), "a picture for each camera"),
        (lambda frame: frame["points"][3].pop("y"), "point 3"),
        (lambda frame: frame["points"][3].update(x="1"), "point 3"),
        (lambda frame: frame["points"][3].update(d=1.5), "point 3.* as d"),
        (lambda frame: frame["points"][3].pop("i"), "i of every point, or of none"),
        (lambda frame: frame["points"][3].update(t=5), "within a minute"),
        (lambda frame: frame["points"][3].update(is_ground=1), "is_ground"),
        (lambda frame: frame["points"].append([1, 2, 3]), "list points"),
        (lambda frame: frame["device_position"].update(x=9e5), "in one world"),
    ],
)
def test_a_frame_that_does_not_hold_together_is_refused(
    tmp_path: Path, change: Callable[[Any], Any], words: str
) -> None:
    write_scale(tmp_path)
    edit(tmp_path / "0007.json", change)
    with pytest.raises(FileFormatError, match=rf"(?s)0007\.json.*{words}"):
        open_dataset(tmp_path)[0].cloud()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"yaw": None}, "radians"),
        ({"yaw": 90}, "yaw in radians"),
        ({"pitch": 1.2}, "upright"),
        ({"roll": "x"}, "pitch and roll"),
        ({"dimensions": {"x": 0, "y": 1, "z": 1}}, "positive sizes"),
        ({"position": {"x": 9e6, "y": 1, "z": 1}}, "within 100 km"),
        ({"label": " "}, "label"),
        ({"uuid": ["a"]}, "uuid"),
        ({"uuid": "b2"}, "an object once"),
    ],
)
def test_a_cuboid_that_is_none_is_refused(tmp_path: Path, change: dict[str, Any], words: str) -> None:
    write_scale(tmp_path)
    edit(tmp_path / "answer.json", lambda frames: frames[1]["cuboids"][0].update(change))
    with pytest.raises(FileFormatError, match=rf"answer\.json.*frame 1 \(0008\.json\), cuboid.*{words}"):
        open_dataset(tmp_path).annotation(1)


def test_an_attribute_called_like_a_field_keeps_its_value(tmp_path: Path) -> None:
    write_scale(tmp_path)
    edit(tmp_path / "answer.json", lambda f: f[0]["cuboids"][0].update(attributes={"camera_used": "left"}))
    details = open_dataset(tmp_path).annotation(0).details  # type: ignore[union-attr]
    assert details["attributes.camera_used"].tolist() == ["left"]
    assert details["camera_used"].tolist() == [0]


def test_null_and_absent_columns_are_not_there(tmp_path: Path) -> None:
    write_scale(tmp_path)
    edit(tmp_path / "0007.json", lambda f: [p.update(i=None, t=None) or p.pop("d") for p in f["points"]])
    edit(tmp_path / "0007.json", lambda frame: frame["points"][1].update(is_ground=True))
    cloud = open_dataset(tmp_path)[0].cloud()
    assert (cloud.intensity, list(cloud.extra)) == (None, ["is_ground"])
    assert cloud.extra["is_ground"].sum() == 1


def test_what_stands_beside_points_is_read_without_them() -> None:
    """The points are passed over where they are flat; else the whole file is parsed, with the same outcome."""
    pose = '"device_position": {"x": 1, "y": 2, "z": 3}, "device_heading": {"w": 1, "x": 0, "y": 0, "z": 0}'
    for points in ('[{"x": 1, "y": 1, "z": 1}]', "[[1, 2], [3]]", "[]", '[{"x": [1], "y": 2}]'):
        frame = parse_frame(f'{{"points" : {points}, {pose}}}'.encode(), "f")
        assert frame.world_T_device[:3, 3].tolist() == [1, 2, 3]
    with pytest.raises(FileFormatError):
        parse_frame(b'{"points": [{"x": 1}, ' + pose.encode() + b"}", "f")
    assert len(parse_points(b'{"points": []}', "f").world_m) == 0


def test_options_are_checked(tmp_path: Path) -> None:
    write_scale(tmp_path)
    for options in ({"metres_per_unit": 0}, {"intensity_scale": -1}):
        with pytest.raises(ConfigError, match="scale: expected"):
            ScaleAi(tmp_path, **options)  # type: ignore[arg-type]


def test_a_damaged_first_frame_leaves_the_others(tmp_path: Path) -> None:
    write_scale(tmp_path)
    edit(tmp_path / "0007.json", lambda frame: frame.update(device_heading=7))
    data = open_dataset(tmp_path)
    assert len(data.remarks) == 1
    assert len(data[1].cloud()) == 60
    with pytest.raises(FileFormatError, match=r"0007\.json"):
        data[0]


def test_json_of_others_is_no_frame(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text('{"points": [[1, 2]], "name": "polygon"}')
    with pytest.raises(DatasetError):
        open_dataset(tmp_path)
    with pytest.raises(DatasetError, match="frames of Scale"):
        ScaleAi(tmp_path)
