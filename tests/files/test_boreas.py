"""Boreas' files: boxes and poses, and what is not theirs."""

from pathlib import Path

import numpy as np
import pytest

from farfield.errors import FileFormatError
from farfield.files.boreas import read_boreas_objects, read_boreas_poses


def test_boxes_and_poses(tmp_path: Path) -> None:
    path = tmp_path / "1.txt"
    path.write_text("a-b Car 4.5 2.0 1.6 10 -2 -0.5 1.5 28\n\nc-d Pedestrian 0.5 0.5 1.7 1 2 3 -1.5 0\n")
    found = read_boreas_objects(path)
    assert (found.uuid, found.label) == (("a-b", "c-d"), ("Car", "Pedestrian"))
    np.testing.assert_allclose(found.centre_m[0], [10, -2, -0.5])
    np.testing.assert_array_equal(found.point_count, [28, 0])
    poses = tmp_path / "poses.csv"
    poses.write_text(f"GPSTime,...\n5,1,2,3,0,0,0,0,0,{np.pi / 2},0,0,0\n")
    times, world_T_lidar = read_boreas_poses(poses)
    assert times.tolist() == [5000]
    # A heading of 90 degrees points south: it counts clockwise from east.
    np.testing.assert_allclose(world_T_lidar[0] @ [1, 0, 0, 1], [1, 1, 3, 1], atol=1e-12)


@pytest.mark.parametrize("line", ["a Car 1 1 1 0 0 0 0", "a Car 0 1 1 0 0 0 0 1", "a Car x 1 1 0 0 0 0 1", "a"])
def test_a_wrong_line_is_named(tmp_path: Path, line: str) -> None:
    path = tmp_path / "1.txt"
    path.write_text(f"b Car 1 1 1 0 0 0 0 1\n{line}\n")
    with pytest.raises(FileFormatError, match="line 2"):
        read_boreas_objects(path)
    path.write_text(f"header\n{line}\n")
    with pytest.raises(FileFormatError, match="line 2"):
        read_boreas_poses(path)


def test_parked_cars_stand_still_in_the_real_log(shared_real: Path) -> None:
    folder = shared_real / "boreas_objects"
    times, poses = read_boreas_poses(folder / "applanix" / "lidar_poses.csv")
    places: dict[str, list[np.ndarray]] = {}
    for path in sorted((folder / "labels_detection").glob("*.txt")):
        found, row = read_boreas_objects(path), int(np.abs(times - int(path.stem) * 1000).argmin())
        assert times[row] == int(path.stem) * 1000
        world = found.centre_m @ poses[row, :3, :3].T + poses[row, :3, 3]
        for uuid, place in zip(found.uuid, world, strict=True):
            places.setdefault(uuid, []).append(place[:2])
    spread = [np.std(each, axis=0).max() for each in places.values() if len(each) > 10]
    assert len(places) == 151
    assert np.median(spread) < 0.7
