"""What a conversion is said to lose is what a second reading lacks: a source with everything, to every target."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from farfield.cli import main
from farfield.datasets import Dataset, Frame, InMemory, Sensor, open_dataset
from farfield.datasets.convert import CAPACITIES, LOSSES_NAME, TARGETS, convert, losses
from farfield.datasets.labels.formats import label_files_in
from farfield.datasets.losses import ITEMS
from farfield.errors import DatasetError
from farfield.files.boxes_csv import read_boxes_csv
from farfield.frame import Annotation, Boxes, Camera, Cloud, Constant, camera_sensor
from farfield.frame.annotation import Footprints
from farfield.geometry.cameras import CAMERA_T_LIDAR_AXES

START_NS = 1_558_131_117_600_000_000
LABELS = ("vehicle", "pedestrian", "traffic cone")


def camera(bent: float) -> Camera:
    pose = CAMERA_T_LIDAR_AXES.copy()
    pose[:3, 3] = [0.1, 0.2, 0.3]
    return Camera(
        matrix=np.array([[50.0, 0, 32], [0, 50, 24], [0, 0, 1]]),
        distortion=np.array([bent, 0, 0, 0, 0]),
        camera_T_lidar=pose,
        width_px=64,
        height_px=48,
    )


def frame(number: int, *, empty: bool = False) -> Frame:
    rng = np.random.default_rng(number)
    points = rng.uniform(-30, 30, (200, 3))
    time_ns = START_NS + number * 100_000_000
    count = 0 if empty else len(LABELS)
    boxes = Boxes(
        centre_m=rng.uniform(5, 20, (count, 3)),
        size_m=rng.uniform(1, 4, (count, 3)),
        yaw_rad=rng.uniform(-3, 3, count),
        label=LABELS[:count],
        score=np.linspace(0.5, 0.9, count),
        track_id=np.arange(count),
        point_count=np.arange(count) + 5,
        velocity_m_s=rng.uniform(1, 2, (count, 2)),
    )
    above = Footprints(label=["car"], centre_m=np.ones((1, 2)), size_m=np.ones((1, 2)), yaw_rad=np.zeros(1))
    annotation = Annotation(
        boxes=boxes,
        visibility=["L"] * count,
        moving=np.ones(count, bool),
        original_label=["Sedan", "Person", "Pylon"][:count],
        extent="visible",
        full_boxes=boxes.replace(size_m=boxes.size_m + 1),
        details={"occlusion": np.arange(count), "colour": np.arange(count)},
        unboxed={"from_above": above},
    )
    place = np.eye(4)
    place[0, 3] = 1.5
    image = np.full((48, 64, 3), 40 * (number % 5), np.uint8)
    image[::2, ::3] = 255
    cameras = {"front": camera(0.1), "left": camera(0.0)}
    return Frame(
        sequence="drive 1",
        frame_id=f"frame {number}",
        time_ns=time_ns,
        clouds={
            "top": Cloud(points, rng.uniform(0, 1, 200), {"ring": np.arange(200.0)}),
            "side": Cloud(points + 1, np.ones(200)),
        },
        images={"front": image, "left": image, "rear": image},
        radar={"polar": np.ones((2, 3))},
        cameras=cameras,
        sensors={
            "top": Sensor(kind="lidar", frame_T_sensor=np.eye(4)),
            "side": Sensor(kind="lidar", frame_T_sensor=place, time_ns=time_ns + 7000),
            **{name: camera_sensor(value) for name, value in cameras.items()},
        },
        load_annotation=Constant(annotation),
        world_T_frame=place,
        conditions={"weather": "fog"},
    )


@pytest.fixture
def everything() -> Dataset:
    return InMemory([frame(0), frame(1), frame(2, empty=True)])


def same(one: Any, other: Any, tolerance: float = 1e-9) -> bool:
    if one is None or other is None or np.shape(one) != np.shape(other):
        return False
    return bool(np.allclose(np.asarray(one, float), np.asarray(other, float), atol=tolerance))


def lacking(source: Frame, got: Frame) -> set[str]:
    """Items of one frame with boxes that a second reading lacks or has otherwise."""
    want, have = source.annotation, got.annotation
    assert want is not None
    assert have is not None
    boxes, others = want.boxes, have.boxes
    columns = {name for cloud in list(got.clouds.values())[:1] for name in cloud.extra}
    held: dict[str, Callable[[], bool]] = {
        "clouds": lambda: len(got.clouds) == len(source.clouds),
        "columns": lambda: not got.clouds or "ring" in columns,
        "radar": lambda: bool(got.radar),
        "images": lambda: len(got.images) == len(source.images),
        "cameras": lambda: len(got.cameras) == len(source.cameras),
        "distortion": lambda: not got.cameras or any(np.any(c.distortion) for c in got.cameras.values()),
        "times": lambda: got.time_ns == source.time_ns,
        "sensor times": lambda: any(s.time_ns == source.sensors["side"].time_ns for s in got.sensors.values()),
        "poses": lambda: same(got.world_T_frame, source.world_T_frame),
        "conditions": lambda: got.conditions == source.conditions,
        "mounting": lambda: any(same(s.frame_T_sensor, source.world_T_frame) for s in got.sensors.values()),
        "names": lambda: got.key == source.key,
        "tracks": lambda: same(others.track_id, boxes.track_id),
        "velocities": lambda: others.velocity_m_s is not None and same(others.velocity_m_s[:, :2], boxes.velocity_m_s),
        "scores": lambda: same(others.score, boxes.score),
        "point counts": lambda: same(others.point_count, boxes.point_count),
        "classes": lambda: list(others.label) == list(boxes.label),
        "original classes": lambda: have.original_label == want.original_label,
        "attributes": lambda: {"occlusion", "colour"} <= have.details.keys(),
        "visibility": lambda: have.visibility is not None,
        "moving": lambda: have.moving is not None,
        "extent": lambda: have.extent == want.extent,
        "other boxes": lambda: have.full_boxes is not None and same(have.full_boxes.size_m, boxes.size_m + 1, 1e-6),
        "unboxed": lambda: "from_above" in have.unboxed,
        "region": lambda: have.region is None,
        "rounding": lambda: not got.clouds or same(got.cloud().points_m, source.cloud().points_m, 1e-7),
        "pixels": lambda: all(np.array_equal(image, source.images["front"]) for image in got.images.values()),
    }
    assert same(others.centre_m, boxes.centre_m, 1e-5), "boxes themselves are always held"
    return {item for item, holds in held.items() if not holds()}


@pytest.mark.parametrize(
    "to",
    ["kitti", "openpcdet", "cirrus", "sustechpoints", "cvat", "supervisely", "xtreme1", "labelcloud", "nuscenes", "t4"],
)
def test_named_losses_are_what_a_second_reading_lacks(to: str, everything: Dataset, tmp_path: Path) -> None:
    announced: list[str] = []
    everything = InMemory(list(everything), in_order=to in ("nuscenes", "t4"))  # whose scenes are drives
    convert(everything, tmp_path / "out", to=to, announce=lambda loss: announced.append(loss.item))  # type: ignore[arg-type]
    got = open_dataset(tmp_path / "out")
    assert got.name == CAPACITIES[to].read_by
    assert len(got) == len(everything)
    assert set(announced) == lacking(everything[1], got[1])


def test_the_losses_of_boxes_as_csv(everything: Dataset, tmp_path: Path) -> None:
    convert(everything, tmp_path / "out.csv", to="boxes-csv")
    rows = read_boxes_csv(tmp_path / "out.csv")
    mine = rows.frame == "frame 1"
    boxes = Boxes(
        centre_m=rows.centre_m[mine],
        size_m=rows.size_m[mine],
        yaw_rad=rows.yaw_rad[mine],
        label=rows.label[mine],
        score=None if rows.score is None else rows.score[mine],
        track_id=None if rows.track_id is None else rows.track_id[mine],
        point_count=None if rows.point_count is None else rows.point_count[mine],
        velocity_m_s=None if rows.velocity_m_s is None else rows.velocity_m_s[mine],
    )
    got = Frame(sequence="drive 1", frame_id="frame 1", load_annotation=Constant(Annotation(boxes=boxes)))
    expected = lacking(everything[1], got) - {"columns"} | {"empty frames"}
    assert "frame 2" not in rows.frame
    assert {loss.item for loss in losses(everything, "boxes-csv")} == expected


def test_the_losses_of_openlabel(everything: Dataset, tmp_path: Path) -> None:
    convert(everything, tmp_path / "out", to="openlabel")
    files = label_files_in(tmp_path / "out", "openlabel")
    path = files.path(everything.keys[1])
    labels = files.parse(path.read_bytes(), path, [everything.keys[1]])[everything.keys[1]]
    rows = np.array([label.box for label in labels])
    boxes = Boxes(
        centre_m=rows[:, :3],
        size_m=rows[:, 3:6],
        yaw_rad=rows[:, 6],
        label=[label.label for label in labels],
        track_id=np.array([int(label.track) for label in labels]),
    )
    assert not any(label.score for label in labels)
    details = {name: np.array([label.attributes[name] for label in labels]) for name in labels[0].attributes}
    frames = json.loads(path.read_text())["openlabel"]["frames"]
    times = [int(row["frame_properties"]["timestamp"].replace(".", "")) for row in frames.values()]
    got = Frame(
        sequence="drive 1",
        frame_id=frames["1"]["frame_properties"]["frame_id"],
        time_ns=times[1],
        load_annotation=Constant(Annotation(boxes=boxes, details=details)),
    )
    named = {loss.item: loss for loss in losses(everything, "openlabel")}
    assert len(frames) == 3, "empty frames are held"
    assert path.stem == "drive_1"  # the drive's name is the file's
    assert named.keys() - {"names"} == lacking(everything[1], got)
    assert named["names"].names == ("drive 1",)


@pytest.mark.parametrize(
    ("to", "item", "names"),
    [
        ("labelcloud", "tracks", ()),
        ("supervisely", "attributes", ("occlusion", "colour")),
        ("xtreme1", "images", ("rear",)),
        ("kitti", "clouds", ("side",)),
        ("kitti", "images", ("left", "rear")),
        ("kitti", "attributes", ("colour",)),
        ("kitti", "classes", ("traffic cone",)),
        ("kitti", "distortion", ("front",)),
        ("cirrus", "attributes", ("occlusion", "colour")),
        ("sustechpoints", "images", ("rear",)),
        ("cvat", "cameras", ("front", "left")),
        ("boxes-csv", "clouds", ("top", "side")),
        ("openlabel", "radar", ("polar",)),
    ],
)
def test_losses_are_named(to: str, item: str, names: tuple[str, ...], everything: Dataset) -> None:
    named = {loss.item: loss.names for loss in losses(everything, to)}  # type: ignore[arg-type]
    assert named[item] == names


def test_whole_bodies_take_the_place_of_visible_parts(everything: Dataset) -> None:
    items = {loss.item for loss in losses(everything, "cirrus", boxes="full_boxes")}
    assert "visible boxes" in items
    assert "other boxes" not in items
    assert "extent" in items, "Cirrus' reader takes them for visible parts"
    assert "extent" not in {loss.item for loss in losses(everything, "kitti", boxes="full_boxes")}


def test_times_are_written_where_all_are_known_and_drives_lie_apart(everything: Dataset, tmp_path: Path) -> None:
    drive = InMemory([frame(0), frame(1)], in_order=True)
    assert "times" not in {loss.item for loss in losses(drive, "cirrus")}
    convert(drive, tmp_path / "out", to="cirrus")
    got = open_dataset(tmp_path / "out")
    assert [made.time_ns for made in got] == [START_NS, START_NS + 100_000_000]
    assert "times" in {loss.item for loss in losses(everything, "cirrus")}, "frames in no order have no drives"
    near = InMemory([frame(0), replace(frame(5), sequence="drive 2")], in_order=True)
    assert "times" in {loss.item for loss in losses(near, "cirrus")}, "half a second apart"
    far = InMemory([frame(0), replace(frame(50), sequence="drive 2")], in_order=True)
    assert "times" not in {loss.item for loss in losses(far, "cirrus")}


@pytest.mark.parametrize("to", ["kitti", "openpcdet", "cirrus", "sustechpoints", "cvat"])
def test_labels_alone_are_refused_where_clouds_belong(to: str, tmp_path: Path) -> None:
    bare = InMemory([replace(frame(0), clouds={}, sensors={})])
    with pytest.raises(DatasetError, match="--to boxes-csv"):
        convert(bare, tmp_path / "out", to=to)  # type: ignore[arg-type]
    assert not (tmp_path / "out").exists()


def test_what_is_not_there_is_not_lost() -> None:
    bare = InMemory([Frame.of(np.ones((4, 3)), sequence="a", frame_id="b")])
    assert [loss.item for loss in losses(bare, "cvat")] == []
    assert losses(bare, "cache") == ()


def test_every_target_declares_what_it_holds() -> None:
    assert set(CAPACITIES) == set(TARGETS)
    assert all(capacity.holds <= set(ITEMS) for capacity in CAPACITIES.values())


def test_losses_are_said_before_and_kept(street_root: Path, tmp_path: Path, capsys: Any) -> None:
    assert main(["convert", str(street_root), str(tmp_path / "a"), "--to", "kitti", "--dry-run"]) == 0
    before = capsys.readouterr().out.splitlines()
    assert not (tmp_path / "a").exists()
    assert main(["convert", str(street_root), str(tmp_path / "a"), "--to", "kitti", "--workers", "1"]) == 0
    lines = capsys.readouterr().out.splitlines()
    said = [line for line in lines if line.startswith("not in ")]
    assert said
    assert said == lines[: len(said)] == [line for line in before if line.startswith("not in ")]
    record = [json.loads(line) for line in (tmp_path / "a" / LOSSES_NAME).read_text().splitlines()]
    assert [row["text"] for row in record] == said
