"""Trees of labelCloud, Supervisely, Xtreme1 and OpenLABEL, by their published descriptions: read and edited."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tool_trees import (
    CAR,
    LATER,
    PERSON,
    TRUTH,
    write_ann,
    write_labelcloud,
    write_openlabel,
    write_scale,
    write_segments_ai,
    write_supervisely,
)
from tool_trees import write_xtreme1 as write_scenes

from farfield.datasets import open_dataset
from farfield.datasets.base import Dataset
from farfield.datasets.convert import convert
from farfield.datasets.labels import label_format
from farfield.datasets.supervisely import Supervisely
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.testing import check_dataset

TREES: dict[str, tuple[str, Callable[[Path], Path]]] = {
    "labelcloud rel": ("labelcloud", write_labelcloud),
    "labelcloud abs": ("labelcloud", partial(write_labelcloud, form="centroid_abs")),
    "labelcloud vertices": ("labelcloud", partial(write_labelcloud, form="vertices")),
    "episode": ("supervisely", write_supervisely),
    "ann of Supervisely": ("supervisely", partial(write_ann, axes="supervisely")),
    "ann of CVAT": ("supervisely", partial(write_ann, axes="cvat")),
    "xtreme1": ("xtreme1", write_scenes),
    "openlabel": ("openlabel", write_openlabel),
    "segments_ai": ("segments_ai", write_segments_ai),
    "scale": ("scale", write_scale),
}


def rows_of(data: Dataset, name: str) -> np.ndarray:
    boxes = data[data.frame_ids.index(name)].boxes
    assert boxes is not None
    return np.column_stack([boxes.centre_m, boxes.size_m, boxes.yaw_rad])


@pytest.mark.parametrize("tree", TREES)
def test_boxes_classes_and_tracks_are_read(tree: str, tmp_path: Path) -> None:
    format, write = TREES[tree]
    data = open_dataset(write(tmp_path))
    assert data.name == format
    assert sorted(data.frame_ids) == ["0007", "0008"]
    for name, rows in TRUTH.items():
        turns = rows_of(data, name) - [box for _, box, _ in rows]
        turns[:, 6] = np.remainder(turns[:, 6] + 1, 2 * math.pi) - 1
        np.testing.assert_allclose(turns, 0, atol=1e-12)
        annotation = data.annotation(data.frame_ids.index(name))
        assert annotation is not None
        assert annotation.original_label == tuple(label for label, _, _ in rows)
        if format == "segments_ai":
            assert annotation.boxes.track_id is not None
            assert annotation.boxes.track_id.tolist() == [int(track, 16) for _, _, track in rows]
        elif format != "labelcloud":
            assert annotation.details["track_name"].tolist() == [track for _, _, track in rows]
    tracks = [data[data.frame_ids.index(name)].boxes.track_id[0] for name in TRUTH]  # type: ignore[union-attr,index]
    assert tracks[0] == tracks[1]


@pytest.mark.parametrize("tree", ["labelcloud vertices", "episode", "xtreme1", "openlabel", "segments_ai", "scale"])
def test_they_fulfil_the_contract(tree: str, tmp_path: Path) -> None:
    check_dataset(open_dataset(TREES[tree][1](tmp_path)))


@pytest.mark.parametrize("tree", [tree for tree in TREES if tree not in ("segments_ai", "scale")])
def test_one_box_is_edited_in_place(tree: str, tmp_path: Path) -> None:
    data = open_dataset(TREES[tree][1](tmp_path))
    labels = label_format(data)
    assert labels is not None
    key = next(key for key in data.keys if key[1] == "0008")
    path = labels.path(key)
    before = path.read_bytes()
    car, person = labels.parse(before, path, [key])[key]
    assert labels.render(before, path, {key: [car, person]}) == before
    moved = replace(person, box=(21.5, -4.25, *person.box[2:6], 0.5))
    added = replace(car, id="new", label="Truck", track="" if "labelcloud" in tree else "c3", box=(*car.box[:6], 2.0))
    after = labels.render(before, path, {key: [car, moved, added]})
    again = labels.parse(after, path, list(data.keys))
    rows = sorted(again[key], key=lambda label: label.label)
    assert [label.label for label in rows] == ["Car", "Pedestrian", "Truck"]
    assert rows[0].box == car.box
    for label, box in ((rows[1], moved.box), (rows[2], added.box)):
        assert label.box == pytest.approx(box, abs=1e-12)
    other = next(one for one in data.keys if one != key)
    if labels.path(other) == path:
        assert again[other] == labels.parse(before, path, [other])[other]
    path.write_bytes(after)
    np.testing.assert_allclose(rows_of(open_dataset(tmp_path), "0007")[0], CAR, atol=1e-12)
    gone = labels.parse(labels.render(after, path, {key: []}), path, [key])
    assert gone[key] == ()


def test_another_track_of_an_episode_is_another_object(tmp_path: Path) -> None:
    data = open_dataset(write_supervisely(tmp_path, listed=False))
    labels = label_format(data)
    assert labels is not None
    assert [key[1] for key in data.keys] == ["0008", "0007"], "in the order of the map"
    key = data.keys[0]
    path = labels.path(key)
    car, person = labels.parse(path.read_bytes(), path, [key])[key]
    made = labels.render(path.read_bytes(), path, {key: [replace(car, track="z9", label="Bus"), person]})
    again = labels.parse(made, path, list(data.keys))
    assert {(label.track, label.label) for label in again[key]} == {("z9", "Bus"), ("b2", "Pedestrian")}
    assert [(label.track, label.label) for label in again[data.keys[1]]] == [("a1", "Car")]


# labelCloud: what a file's angles count.


def set_turns(root: Path, name: str, turns: list[float]) -> None:
    path = root / "labels" / f"{name}.json"
    content = json.loads(path.read_text())
    for entry, turn in zip(content["objects"], turns, strict=True):
        entry["rotations"]["z"] = turn
    path.write_text(json.dumps(content))


def test_angles_that_may_be_either_follow_the_other_files_or_the_flag(tmp_path: Path) -> None:
    write_labelcloud(tmp_path)
    set_turns(tmp_path, "0007", [2.0])
    assert rows_of(open_dataset(tmp_path), "0007")[0, 6] == 2.0, "the other file has negative ones"
    set_turns(tmp_path, "0008", [350.0, 5.0])
    assert rows_of(open_dataset(tmp_path), "0007")[0, 6] == math.radians(2)
    set_turns(tmp_path, "0008", [1.0, 2.5])
    with pytest.raises(FileFormatError, match="may be either") as refused:
        open_dataset(tmp_path).annotation(0)
    assert "--label-angles" in refused.value.fix
    assert rows_of(open_dataset(tmp_path, label_angles="radians"), "0007")[0, 6] == 2.0
    assert rows_of(open_dataset(tmp_path, label_angles="degrees"), "0007")[0, 6] == math.radians(2)
    set_turns(tmp_path, "0008", [-1.0, 90.0])
    with pytest.raises(FileFormatError, match=r"0008\.json"):
        open_dataset(tmp_path, label_angles="degrees").annotation(1)
    with pytest.raises(ConfigError, match="label_angles"):
        open_dataset(tmp_path, label_angles="turns")


def test_corners_in_the_other_direction_are_the_same_box(tmp_path: Path) -> None:
    data = open_dataset(write_labelcloud(tmp_path, form="vertices", mirrored=True))
    np.testing.assert_allclose(rows_of(data, "0008"), [LATER, PERSON], atol=1e-12)
    path = tmp_path / "labels" / "0007.json"
    content = json.loads(path.read_text())
    content["objects"][0]["vertices"][3][0] += 1
    path.write_text(json.dumps(content))
    with pytest.raises(FileFormatError, match="corners of a box"):
        data.annotation(0)


def test_label_files_beside_clouds(tmp_path: Path) -> None:
    write_labelcloud(tmp_path / "a")
    for path in [*(tmp_path / "a" / "pointclouds").iterdir(), *(tmp_path / "a" / "labels").glob("0*.json")]:
        path.rename(tmp_path / path.name)
    (tmp_path / "a" / "labels" / "_classes.json").unlink()
    data = open_dataset(tmp_path, format="labelcloud")
    assert open_dataset(tmp_path).name == "labelcloud"
    np.testing.assert_allclose(rows_of(data, "0007"), [CAR], atol=1e-12)
    assert "counter-clockwise" in data.assumptions[0]


# Supervisely: whose axes.


def test_whose_axes_is_told_and_can_be_said(tmp_path: Path) -> None:
    own = Supervisely(write_ann(tmp_path / "own", axes="supervisely"))
    foreign = Supervisely(write_ann(tmp_path / "cvat", axes="cvat"))
    assert "Supervisely's boxes" in own.assumptions[0]
    assert "CVAT's boxes" in foreign.assumptions[0]
    said = Supervisely(tmp_path / "cvat", label_axes="supervisely")
    assert said.assumptions == ()
    assert rows_of(said, "0007")[0] == pytest.approx([*CAR[:3], CAR[4], CAR[3], CAR[5], CAR[6] + math.pi / 2])
    with pytest.raises(ConfigError, match="label_axes"):
        Supervisely(tmp_path / "cvat", label_axes="lidar")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"0": "0007.pcd", "1": "0009.pcd"}, "0009.pcd"),
        ({"0": "../0007.pcd"}, "one file"),
        ({"0": "0007.pcd", "1": "0007.pcd"}, "each once"),
        ({"first": "0007.pcd"}, "a frame's number"),
        ({}, "object of frames"),
        ([1], "object of frames"),
        ({"0": 7.5}, "the cloud's file"),
    ],
)
def test_a_damaged_map_of_frames_is_refused(tmp_path: Path, content: Any, words: str) -> None:
    write_supervisely(tmp_path)
    (tmp_path / "episode_1" / "frame_pointcloud_map.json").write_text(json.dumps(content))
    with pytest.raises((FileFormatError, DatasetError), match=r"frame_pointcloud_map\.json") as refused:
        open_dataset(tmp_path)
    assert words in str(refused.value)


@pytest.mark.parametrize("index", [-1, 1.5, True, "0", None, 1])
def test_a_frame_of_an_episode_has_a_number_of_its_own(tmp_path: Path, index: Any) -> None:
    write_supervisely(tmp_path)
    path = tmp_path / "episode_1" / "annotation.json"
    content = json.loads(path.read_text())
    content[0]["frames"][0]["index"] = index
    path.write_text(json.dumps(content))
    with pytest.raises(FileFormatError, match=r"annotation.json.*frame entry"):
        open_dataset(tmp_path).annotation(0)


# Xtreme1: cameras, sources.


@pytest.mark.parametrize("row_major", [True, False])
def test_cameras_of_xtreme1(tmp_path: Path, row_major: bool) -> None:
    frame = open_dataset(write_scenes(tmp_path, row_major=row_major))[0]
    camera = frame.cameras["camera_image_0"]
    assert camera.camera_T_lidar[:3, 3].tolist() == [0.1, 0.2, 0.3]
    assert (camera.width_px, camera.height_px) == frame.images["camera_image_0"].shape[1::-1] == (64, 48)
    assert camera.matrix[1, 1] == 51.0
    annotation = frame.annotation
    assert annotation is not None
    assert annotation.details["type"].tolist() == ["suv"]
    assert annotation.details["trackName"].tolist() == ["2"]


def test_boxes_of_people_count_beside_those_of_models(tmp_path: Path) -> None:
    write_scenes(tmp_path)
    path = tmp_path / "scene_1" / "result" / "0007.json"
    (people,) = json.loads(path.read_text())
    model = people | {"sourceName": "pointpillars", "objects": people["objects"] * 2}
    path.write_text(json.dumps([model, people]))
    data = open_dataset(tmp_path)
    np.testing.assert_allclose(rows_of(data, "0007"), [CAR])
    labels = label_format(data)
    assert labels is not None
    (car,) = labels.parse(path.read_bytes(), path, [data.keys[0]])[data.keys[0]]
    made = json.loads(labels.render(path.read_bytes(), path, {data.keys[0]: [car, replace(car, id="n")]}))
    assert [len(source["objects"]) for source in made] == [4, 3]
    path.write_text(json.dumps([model, people | {"sourceName": "other"}]))
    with pytest.raises(FileFormatError, match=r"0007\.json.*sourceName"):
        data.annotation(0)


# OpenLABEL: clouds of frames.


def test_clouds_by_stream_name_and_number(tmp_path: Path) -> None:
    data = open_dataset(write_openlabel(tmp_path))
    assert [frame.time_ns for frame in data] == [1_600_000_000_050_000_000, 1_600_000_000_150_000_000]
    assert data[0].annotation.details["parked"].tolist() == [True]  # type: ignore[union-attr]
    path = tmp_path / "drive.json"
    content = json.loads(path.read_text())
    frames = content["openlabel"]["frames"]
    for number, frame in zip(("7", "8"), list(frames.values()), strict=True):
        frames[number] = frame | {"frame_properties": {}}
    del frames["0"], frames["1"]
    path.write_text(json.dumps(content))
    np.testing.assert_allclose(rows_of(open_dataset(tmp_path), "0008"), [LATER, PERSON], atol=1e-12)
    frames["9"] = frames.pop("8")
    path.write_text(json.dumps(content))
    with pytest.raises(DatasetError, match=r"drive.json.*frame 9"):
        open_dataset(tmp_path)


@pytest.mark.parametrize("write", [write_openlabel, write_segments_ai])
def test_a_pointer_in_the_place_of_the_only_label_file_is_named(write: Callable[[Path], Path], tmp_path: Path) -> None:
    (path,) = write(tmp_path).glob("*.json")
    path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0123456789abcdef\nsize 12345\n")
    with pytest.raises(FileFormatError, match="git lfs pull"):
        open_dataset(tmp_path)


@pytest.mark.parametrize("track", [-7, 1.5, True, ["a"]])
def test_a_track_that_is_none_is_refused(tmp_path: Path, track: Any) -> None:
    path = write_scenes(tmp_path) / "scene_1" / "result" / "0007.json"
    content = json.loads(path.read_text())
    content[0]["objects"][1]["trackId"] = track
    path.write_text(json.dumps(content))
    with pytest.raises(FileFormatError, match=r"0007\.json.*trackId"):
        open_dataset(tmp_path).annotation(0)


def test_attributes_and_names_of_tracks_go_from_tool_to_tool(tmp_path: Path) -> None:
    source = open_dataset(write_scenes(tmp_path / "source"))
    convert(source, tmp_path / "cvat", to="cvat")
    convert(open_dataset(tmp_path / "cvat"), tmp_path / "back", to="xtreme1")
    back = open_dataset(tmp_path / "back")
    for index, frame in enumerate(source):
        want, have = frame.annotation, back.annotation(index)
        assert want is not None
        assert have is not None
        np.testing.assert_array_equal(rows_of(back, frame.frame_id), rows_of(source, frame.frame_id))
        for name, column in want.details.items():
            assert have.details[name].tolist() == column.tolist()


# Segments.ai: worlds, sets of labels, addresses.


def edit_release(root: Path, change: Callable[[Any], Any]) -> None:
    path = root / "v1.json"
    content = json.loads(path.read_text())
    change(content["dataset"])
    path.write_text(json.dumps(content))


def test_a_release_stands_in_the_world_and_poses_bring_it_back(tmp_path: Path) -> None:
    data = open_dataset(write_segments_ai(tmp_path))
    poses = [frame.world_T_frame for frame in data]
    assert poses[0] is not None
    assert poses[1] is not None
    assert poses[1][:3, 3].tolist() == [501.0, 200.0, 1.0]
    assert data.annotation(0).details["color"].tolist() == ["red"]  # type: ignore[union-attr]
    assert label_format(data) is None
    edit_release(tmp_path, lambda d: [f.pop("ego_pose") for f in d["samples"][0]["attributes"]["frames"]])
    flat = open_dataset(tmp_path)[0]
    assert flat.world_T_frame is None
    assert flat.boxes is not None
    assert flat.boxes.centre_m[0, 0] > 400, "without a pose the boxes stay where the file has them"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d["task_attributes"]["categories"].pop(), "category_id"),
        (lambda d: d["samples"][0]["labels"]["ground-truth"]["attributes"]["frames"].pop(), "labels of 2 frames"),
        (lambda d: d["samples"][0]["attributes"]["frames"][0]["pcd"].update(url="https://x/none.pcd"), "none.pcd"),
        (lambda d: d["samples"][0]["attributes"]["frames"][0]["ego_pose"]["heading"].update(qw=9), "length 1"),
        (lambda d: d["samples"][0].update(labels={"a": {"attributes": {}}, "b": {"attributes": {}}}), "ground-truth"),
        (lambda d: d["samples"].append(d["samples"][0]), "different names"),
    ],
)
def test_a_release_that_does_not_hold_together_is_refused(
    tmp_path: Path, change: Callable[[Any], Any], words: str
) -> None:
    write_segments_ai(tmp_path)
    edit_release(tmp_path, change)
    with pytest.raises((FileFormatError, DatasetError), match=words):
        open_dataset(tmp_path)


def test_a_sample_that_nobody_labelled_has_no_annotation(tmp_path: Path) -> None:
    write_segments_ai(tmp_path)
    edit_release(tmp_path, lambda d: d["samples"][0].update(labels={"ground-truth": None}))
    assert [frame.annotation for frame in open_dataset(tmp_path)] == [None, None]
