"""KITTI's odometry benchmark and SemanticKITTI: sweeps with poses and times, and nothing annotated."""

from pathlib import Path

import numpy as np
import pytest

from farfield.datasets import open_dataset
from farfield.errors import DatasetError, FileFormatError

CAMERA_T_LIDAR = np.array([[0.0, -1, 0, 0.1], [0, 0, -1, -0.2], [1, 0, 0, -0.3]])
P2 = np.array([[700.0, 0, 600, 45], [0, 700, 180, -0.3], [0, 0, 1, 0.005]])


def row(values: np.ndarray) -> str:
    """Numbers of a line."""
    return " ".join(f"{value:.6e}" for value in np.asarray(values).ravel())


def write(
    root: Path, *, poses: str = "poses/{}.txt", labels: bool = False, names: tuple[str, ...] = ("00", "01")
) -> Path:
    """Two sequences of three sweeps; the car goes one metre ahead each 0.1 s, and turns left a little."""
    for name in names:
        folder = root / "sequences" / name
        (folder / "velodyne").mkdir(parents=True)
        lines = []
        for number in range(3):
            rows = np.random.default_rng(number).uniform(-20, 20, (30, 4)).astype("<f4")
            rows[:, 3] = np.linspace(0, 0.99, 30)
            rows.tofile(folder / "velodyne" / f"{number:06d}.bin")
            turn = 0.1 * number
            # the camera's axes are x right, y down, z ahead: a turn to the left is one about -y
            rotation = np.array([[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0], [np.sin(turn), 0, np.cos(turn)]])
            lines.append(row(np.column_stack([rotation, [0.0, 0.0, float(number)]])))
            if labels:
                (folder / "labels").mkdir(exist_ok=True)
                np.full(30, 10, "<u4").tofile(folder / "labels" / f"{number:06d}.label")
        path = root / poses.format(name)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("\n".join(lines) + "\n")
        matrices = {**{f"P{number}": P2 for number in range(4)}, "Tr": CAMERA_T_LIDAR}
        (folder / "calib.txt").write_text("".join(f"{key}: {row(matrix)}\n" for key, matrix in matrices.items()))
        (folder / "times.txt").write_text("".join(f"{0.1 * number:.6e}\n" for number in range(3)))
    return root


@pytest.mark.parametrize("poses", ["poses/{}.txt", "sequences/{}/poses.txt"])
@pytest.mark.parametrize("inner", ["", "dataset"])
def test_sweeps_poses_and_times_are_read(tmp_path, poses, inner):
    write(tmp_path / inner, poses=poses)
    data = open_dataset(tmp_path)
    assert (data.name, len(data), data.notes) == ("kitti_odometry", 6, ())
    first, last = data[0], data[2]
    assert (last.sequence, last.frame_id, last.time_ns) == ("00", "000002", 200_000_000)
    assert len(last.cloud()) == 30
    assert last.boxes is None
    np.testing.assert_allclose(first.world_T_frame, np.eye(4), atol=1e-5)
    assert last.world_T_frame[0, 3] == pytest.approx(2.0, abs=0.15)
    ahead = last.world_T_frame[:3, 0]
    assert np.arctan2(ahead[1], ahead[0]) == pytest.approx(0.2, abs=1e-5)
    _, depth, visible = last.cameras["camera"].project(np.array([[10.0, 0.0, 0.0]]))
    assert visible[0]
    assert depth[0] == pytest.approx(10 - 0.3, abs=0.02)
    assert [len(drive.indices) for drive in data.drives()] == [3, 3]
    assert data.drives()[0].times_ns is not None


def test_one_sequence_and_the_folder_of_sequences_open(tmp_path):
    write(tmp_path)
    assert (open_dataset(tmp_path / "sequences").name, len(open_dataset(tmp_path / "sequences"))) == (
        "kitti_odometry",
        6,
    )
    alone = open_dataset(tmp_path / "sequences" / "01")
    assert (alone.name, len(alone), alone[1].sequence) == ("kitti_odometry", 3, "01")
    assert alone[1].world_T_frame is not None


def test_classes_of_points_are_said_to_be_no_boxes(tmp_path):
    write(tmp_path, labels=True, names=("00",))
    (note,) = open_dataset(tmp_path).notes
    assert "labels/*.label of 00 are not read" in note
    assert "no boxes" in note


def test_without_poses_it_is_said(tmp_path):
    write(tmp_path, names=("00",))
    (tmp_path / "poses/00.txt").unlink()
    data = open_dataset(tmp_path)
    assert data[0].world_T_frame is None
    assert "no poses of 00" in data.notes[0]


def test_damage_is_refused_by_name(tmp_path):
    write(tmp_path, names=("00",))
    path = tmp_path / "poses/00.txt"
    path.write_text("1 0 0 0 0 1 0 0 0 0 1\n")
    with pytest.raises(FileFormatError, match="12 numbers"):
        _ = open_dataset(tmp_path)[0]
    path.write_text("2 0 0 0 0 2 0 0 0 0 2 0\n")
    with pytest.raises(FileFormatError, match="pose 0"):
        _ = open_dataset(tmp_path)[0]
    (tmp_path / "sequences/00/calib.txt").write_text(f"P2: {row(P2)}\nTr: {row(2 * CAMERA_T_LIDAR)}\n")
    with pytest.raises((FileFormatError, DatasetError), match="Tr"):
        _ = open_dataset(tmp_path)[0]
