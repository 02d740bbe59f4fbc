"""Poses as CSV: written, read back, and what is no table of poses refused."""

from pathlib import Path

import numpy as np
import pytest

from farfield.errors import FileFormatError
from farfield.files.poses_csv import COLUMNS, PoseTable, read_poses, write_poses
from farfield.geometry.poses import pose_from_yaw


def _table(times: tuple[int, ...] | None = (5, 10**18, 2 * 10**18)) -> PoseTable:
    poses = np.stack([pose_from_yaw(0.7 * number, (1.5 * number, -2.0, 0.25)) for number in range(3)])
    return PoseTable("a,b", ("0", "1", "x y"), "lidar", times, poses, ("begins", "placed", "lost"), ("", "turn x", ""))


@pytest.mark.parametrize("times", [(5, 10**18, 2 * 10**18), None])
def test_a_table_comes_back_to_the_micrometre(tmp_path: Path, times: tuple[int, ...] | None) -> None:
    table, path = _table(times), tmp_path / "poses.csv"
    write_poses(path, table)
    back = read_poses(path)
    np.testing.assert_allclose(back.world_T_frame, table.world_T_frame, atol=1e-6)
    for name in ("sequence", "frames", "reference", "times_ns", "state", "blind"):
        assert getattr(back, name) == getattr(table, name)
    before = path.read_bytes()
    write_poses(path, back)
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("sequence,", "drive,", "line 1"),
        (",placed,", ",perhaps,", "state"),
        ("1.500000", "nan", "line 3"),
        ("1.500000", "far", "line 3"),
        (",1,lidar", ",0,lidar", "each frame once"),
        (",1,lidar", ",1,radar", "one reference"),
        ("1000000000000000000", "9" * 30, "line 3"),
        ("turn x", "turn x,more", "columns"),
    ],
)
def test_what_is_no_table_of_poses_is_refused_by_line(tmp_path: Path, old: str, new: str, said: str) -> None:
    path = tmp_path / "poses.csv"
    write_poses(path, _table())
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(FileFormatError, match=said):
        read_poses(path)


def test_empty_or_binary_files_are_refused(tmp_path: Path) -> None:
    for content in (b"", b"\xff\xfe\x00", (",".join(COLUMNS) + "\n").encode()):
        path = tmp_path / "poses.csv"
        path.write_bytes(content)
        with pytest.raises(FileFormatError):
            read_poses(path)
