"""Bags with a transform that is none, and with topics whose clocks differ: the rest is read, and it is said."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")
import bag_messages as rosbag

from farfield.cli import main
from farfield.datasets import open_dataset
from farfield.errors import FileFormatError

START, MS = rosbag.START, 1_000_000
POINTS = np.ones(5, np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4")]))


def sweeps(topic: str, *, late_ns: int = 0) -> list[tuple[str, int, Any]]:
    """A second of clouds, in a frame of the topic's name, whose stamps are late."""
    times = [START + at * 100 * MS for at in range(10)]
    return [(topic, time + MS, rosbag.cloud(POINTS, time + late_ns, topic.strip("/"))) for time in times]


def moved(*edges: tuple[str, str], broken: str = "", w: float = 0.0) -> Any:
    """Transforms between frames, that of one child with another quaternion."""
    message = rosbag.transforms(START, *((parent, child, (1.0, 0.0, 0.0), 0.0) for parent, child in edges))
    for entry in message.transforms:
        if entry.child_frame_id == broken:
            object.__setattr__(entry.transform.rotation, "w", w)
    return message


@pytest.mark.parametrize("w", [0.0, float("nan")])
def test_a_transform_that_nothing_needs_stops_no_bag(tmp_path: Path, w: float) -> None:
    fixed = moved(("base", "lidar"), ("base", "radar"), ("base", "lamp"), broken="lamp", w=w)
    rows = [("/tf_static", START, fixed), *sweeps("/lidar"), *sweeps("/radar")]
    data = open_dataset(rosbag.write_bag(tmp_path / "drive", rows, mcap=True))
    frame = data[3]
    assert frame.sensors["radar"].in_frame
    assert len(frame.clouds["radar"]) == 5
    (note,) = data.notes
    assert "transform of lamp in base" in note
    assert "passed over" in note


def test_what_hangs_on_it_is_refused_by_name(tmp_path: Path) -> None:
    fixed = moved(("base", "lidar"), ("base", "radar"), broken="radar")
    rows = [("/tf_static", START, fixed), *sweeps("/lidar"), *sweeps("/radar")]
    data = open_dataset(rosbag.write_bag(tmp_path / "drive", rows, mcap=True))
    with pytest.raises(FileFormatError, match="transform of radar in base"):
        data[0]


def test_a_moment_without_a_transform_is_bridged_by_its_neighbours(tmp_path: Path) -> None:
    rows = sweeps("/lidar")
    for at in range(11):
        message = rosbag.transforms(START + at * 100 * MS, ("odom", "lidar", (float(at), 0.0, 0.0), 0.0))
        if at == 4:
            object.__setattr__(message.transforms[0].transform.rotation, "w", 0.0)
        rows.append(("/tf", START + at * 100 * MS, message))
    data = open_dataset(rosbag.write_bag(tmp_path / "drive", rows, mcap=True))
    assert data[4].world_T_frame[0, 3] == pytest.approx(4.0)
    assert "transform of lidar in odom" in data.notes[0]


def test_clocks_that_differ_between_topics_are_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = [*sweeps("/lidar"), *sweeps("/radar", late_ns=-3_200 * MS)]
    path = rosbag.write_bag(tmp_path / "drive", rows, mcap=True)
    (note,) = open_dataset(path).notes
    assert "the stamps of /radar are 3.2 s behind those of /lidar" in note
    assert open_dataset(path, stamp="log").notes == ()
    main(["doctor", str(path)])
    assert "3.2 s behind" in " ".join(capsys.readouterr().err.split())


def test_one_clock_leaves_nothing_to_say(tmp_path: Path) -> None:
    rows = [*sweeps("/lidar"), *sweeps("/radar", late_ns=40 * MS)]
    assert open_dataset(rosbag.write_bag(tmp_path / "drive", rows, mcap=True)).notes == ()
