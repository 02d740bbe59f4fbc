"""What every frame keeps, for the frames of all eight readers and of the simulator's two cars."""

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trees
from drive import frame as kradar_frame

from farfield.datasets import open_dataset
from farfield.datasets.cirrus import CirrusWriter
from farfield.datasets.folder import write_boxes
from farfield.datasets.kradar.writer import KRadarWriter
from farfield.errors import ConfigError
from farfield.files.clouds import write_bin
from farfield.frame import Annotation, Boxes, Cloud, Constant, Frame, merge_clouds
from farfield.simulation import simulate_frame
from farfield.testing import check_dataset
from farfield.testing.datasets import check_frame


@cache
def mini(index: int) -> Frame:
    return simulate_frame("cirrus-sim-mini", sequence=0, index=index)


def cirrus(root: Path) -> Any:
    writer = CirrusWriter(root)
    for index in (0, 1):
        writer.write(mini(index))
    return open_dataset(root / "Cirrus_dataset1")


def kradar(root: Path, **options: Any) -> Any:
    writer = KRadarWriter(root, columns=512)
    for number in (1, 2):
        writer.write(kradar_frame(number))
    writer.finish()
    return open_dataset(root, **options)


def folder(root: Path) -> Any:
    root.mkdir(exist_ok=True)
    rows = np.random.default_rng(1).uniform(0, 1, (20, 4)).astype(np.float32)
    boxes = Boxes(
        centre_m=np.ones((2, 3)),
        size_m=np.ones((2, 3)),
        yaw_rad=np.ones(2),
        velocity_m_s=np.array([[9.0, 1.0, 0.1], [np.nan] * 3]),
    )
    for stem in "ab":
        write_bin(root / f"{stem}.bin", rows)
    write_boxes(root / "a.json", boxes)
    return open_dataset(root)


def delft(root: Path, **options: Any) -> Any:
    trees.write_delft(root)
    for name in ("radar_3frames", "radar_5frames"):
        tree = root / name / "training"
        trees.write_tree(tree, np.tile(trees.RADAR_ROWS, (int(name[6]), 1)), trees.LIDAR_T_RADAR_M, None)
    return open_dataset(root, **options)


def argoverse2(root: Path) -> Any:
    pytest.importorskip("pyarrow")
    return open_dataset(trees.write_argoverse2(root))


READERS: dict[str, Callable[[Path], Any]] = {
    "cirrus": cirrus,
    "kradar": kradar,
    "kradar-in-the-radars-frame": lambda root: kradar(root, reference="radar"),
    "kitti": lambda root: open_dataset(trees.write_kitti(root)),
    "kitti_tracking": lambda root: open_dataset(trees.write_kitti_tracking(root)),
    "argoverse2": argoverse2,
    "view_of_delft": delft,
    "view_of_delft-in-the-radars-frame": lambda root: delft(root, reference="radar"),
    "radiate": lambda root: open_dataset(trees.write_sequence(root / "fog_6_0")),
    "folder": folder,
}


@pytest.mark.parametrize("name", READERS)
def test_frames_of_every_reader_keep_their_word(tmp_path: Path, name: str) -> None:
    data = READERS[name](tmp_path)
    assert data.name == name.partition("-")[0]
    check_dataset(data)


@pytest.mark.parametrize(
    ("preset", "sensors"),
    [("cirrus-sim-mini", None), ("kradar-sim-mini", ("os2-64", "os1-128", "cells"))],
    ids=["cirrus", "kradar"],
)
def test_simulated_frames_keep_their_word(preset: str, sensors: tuple[str, ...] | None) -> None:
    frame = simulate_frame(preset, sequence=0, index=0, sensors=sensors) if sensors else mini(0)
    assert frame.simulated
    check_frame(frame)


def test_what_two_patterns_join_to_and_what_is_refused(tmp_path: Path) -> None:
    frame = cirrus(tmp_path / "cirrus")[0]
    both = Cloud.concatenate([frame.clouds["gaussian"], frame.clouds["uniform"]])
    np.testing.assert_array_equal(merge_clouds(frame, ["gaussian", "uniform"]).points_m, both.points_m)
    spinning = kradar(tmp_path / "kradar")[0]
    scans = delft(tmp_path / "delft")[0]
    refused: list[tuple[Frame, list[str], str]] = [
        (spinning, ["os2-64", "os1-128"], "os1-128 keeps its sensor's own"),
        (spinning, ["os2-64", "radar"], "os2-64 is of a lidar, radar is of a radar"),
        (scans, ["lidar", "radar"], "one kind of sensor"),
        (scans, ["radar", "radar_5frames"], "radar_5frames holds the points of radar already"),
        (scans, ["radar_5frames", "radar_3frames"], "holds the points of radar_3frames"),
        (scans, ["radar", "radar"], "each once"),
        (scans, [], "got none"),
    ]
    for of, names, message in refused:
        with pytest.raises(ConfigError, match=message):
            merge_clouds(of, names)


def test_where_nobody_annotated_is_told(tmp_path: Path) -> None:
    """KITTI and View-of-Delft label what the camera sees; its size is known without an image."""
    for name, size in (("kitti", (1201, 361)), ("kitti_tracking", (1201, 361)), ("view_of_delft", (1936, 1216))):
        frame = READERS[name](tmp_path / name)[0]
        region = frame.annotation.region
        assert (region.camera.width_px, region.camera.height_px) == size
        assert (frame.cameras["camera"].width_px, frame.cameras["camera"].height_px) == size
        assert region.contains(frame.boxes.centre_m).all()
        assert not region.contains(-frame.boxes.centre_m).any()
    for name in ("cirrus", "kradar", "folder", "radiate"):
        assert READERS[name](tmp_path / name)[0].annotation.region is None


@pytest.mark.parametrize("axes", [2, 3])
def test_velocities_that_do_not_turn_with_the_frame_are_found(monkeypatch: pytest.MonkeyPatch, axes: int) -> None:
    velocity_m_s = np.ones((2, axes))
    velocity_m_s[1] = np.nan
    boxes = Boxes(centre_m=np.ones((2, 3)), size_m=np.ones((2, 3)), yaw_rad=np.ones(2), velocity_m_s=velocity_m_s)
    frame = Frame(sequence="s", frame_id="1", load_annotation=Constant(Annotation(boxes=boxes)))
    check_frame(frame)
    turn = Boxes.transform
    monkeypatch.setattr(Boxes, "transform", lambda old, pose: turn(old, pose).replace(velocity_m_s=old.velocity_m_s))
    with pytest.raises(AssertionError, match="velocities of boxes, moved"):
        check_frame(frame)


@pytest.mark.parametrize("name", READERS)
def test_drives_have_the_poses_of_their_frames(name: str, tmp_path: Path) -> None:
    """Tracks of simulated drives were kept in the sensor's coordinates, since only the frames had poses."""
    data = READERS[name](tmp_path)
    for drive in data.posed_drives() if data.maps else data.drives():
        poses = [data[int(index)].world_T_frame for index in drive.indices]
        if any(pose is None for pose in poses):
            assert drive.world_T_frame is None
        else:
            np.testing.assert_allclose(drive.world_T_frame, poses, atol=1e-9)
