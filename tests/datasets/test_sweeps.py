from pathlib import Path

import numpy as np
import pytest

from farfield.datasets.base import Dataset
from farfield.datasets.maps import Sweeps, make
from farfield.errors import ConfigError, DatasetError
from farfield.frame import Annotation, Boxes, Cloud, Constant, Frame, Sensor
from farfield.geometry.poses import invert, pose_from_yaw

WORLD_POINTS_M = np.array([[20.0, 1.0, 0.0], [60.0, -4.0, 2.0], [90.0, 7.0, 1.0], [35.0, 0.0, 0.5]])


class Drive(Dataset):
    """Two drives past standing points, 0.1 s between frames; the uniform sweep comes 0.02 s after the Gaussian one."""

    name = "drive"

    def __init__(self, *, with_poses: bool = True, frames: int = 4) -> None:
        self.root, self.with_poses = Path("drive"), with_poses
        self.sequences = ("a",) * frames + ("b",) * frames
        self.frame_ids = tuple(str(index) for index in range(2 * frames))

    def pose(self, index: int) -> np.ndarray:
        pose = pose_from_yaw(0.05 * index)
        pose[:3, 3] = [3.0 * index, 0.4 * index, 0.1]
        return pose

    def frame(self, index: int) -> Frame:
        seen = WORLD_POINTS_M @ invert(self.pose(index))[:3, :3].T + invert(self.pose(index))[:3, 3]
        cloud = Cloud(seen.astype(np.float32), np.full(4, index / 10, np.float32), {"ring": np.arange(4)})
        boxes = Boxes(
            centre_m=seen[:1], size_m=np.ones((1, 3)), yaw_rad=np.array([-0.05 * index]), label=np.array(["vehicle"])
        )
        time_ns = index * 100_000_000
        clouds = {"gaussian": cloud, "uniform": cloud} if index != 1 else {"gaussian": cloud}
        return Frame(
            sequence=self.sequences[index],
            frame_id=self.frame_ids[index],
            time_ns=time_ns,
            sensors={
                "gaussian": Sensor(kind="lidar", time_ns=time_ns),
                "uniform": Sensor(kind="lidar", time_ns=time_ns + (20_000_000 if index == 0 else 0)),
            },
            clouds=clouds,
            load_annotation=Constant(Annotation(boxes=boxes)),
            world_T_frame=self.pose(index) if self.with_poses else None,
        )

    def files(self, index: int) -> list[Path]:
        return [Path(f"{index}.xyz")]


def test_standing_points_stay_in_place_whatever_the_sensor_does():
    stacked = Drive().mapped(Sweeps(3))
    cloud = stacked[3].cloud("gaussian")
    assert len(cloud) == 12
    for part in range(3):
        np.testing.assert_allclose(cloud.points_m[4 * part :][:4], cloud.points_m[:4], atol=1e-4)
    np.testing.assert_allclose(cloud.extra["lag_s"], np.repeat([0.0, 0.1, 0.2], 4), atol=1e-7)
    np.testing.assert_allclose(cloud.intensity, np.repeat([0.3, 0.2, 0.1], 4), atol=1e-7)
    np.testing.assert_array_equal(cloud.extra["ring"], np.tile(np.arange(4), 3))
    np.testing.assert_array_equal(stacked[3].boxes.centre_m, Drive()[3].boxes.centre_m)


def test_sweeps_stay_within_their_sequence_and_sensor():
    stacked = Drive().mapped(Sweeps(3))
    assert [len(stacked[index].cloud("gaussian")) for index in range(8)] == [4, 8, 12, 12] * 2
    uniform = stacked[2].cloud("uniform").extra["lag_s"]  # frame 1 has no uniform sweep; frame 0's came 20 ms late
    np.testing.assert_allclose(uniform, np.repeat([0.0, 0.18], 4), atol=1e-7)
    assert stacked.files(2) == [Path("2.xyz"), Path("1.xyz"), Path("0.xyz")]
    assert stacked.files(4) == [Path("4.xyz")]


def test_selected_and_moved_frames_have_the_sweeps_of_the_whole():
    whole = Drive().mapped(Sweeps(2))
    for made in (Drive().select([3, 6]).mapped(Sweeps(2)), whole.select([3, 6])):
        assert len(made) == 2
        assert made.recipe["maps"] == [{"name": "sweeps", "settings": {"count": 2}}]
        np.testing.assert_array_equal(made[0].cloud("gaussian").points_m, whole[3].cloud("gaussian").points_m)
    behind = np.array([-1, -1, 1])
    for turned in (Drive().select([3]).turned(180).mapped(Sweeps(2)), whole.select([3]).turned(180)):
        points_m = turned[0].cloud("gaussian").points_m
        np.testing.assert_allclose(points_m, whole[3].cloud("gaussian").points_m * behind, atol=1e-4)
        assert turned[0].cloud("gaussian").extra["lag_s"].max() == pytest.approx(0.1)


def test_one_sweep_changes_nothing_and_none_is_refused():
    one = Drive().mapped(Sweeps(1))[3].cloud("gaussian")
    np.testing.assert_array_equal(one.points_m, Drive()[3].cloud("gaussian").points_m)
    assert set(one.extra) == {"ring"}
    with pytest.raises(ConfigError, match="at least 1 sweep"):
        make("sweeps", {"count": 0})


def test_frames_without_poses_are_refused():
    with pytest.raises(DatasetError, match=r"has no pose.*data\.sweeps=1"):
        Drive(with_poses=False).mapped(Sweeps(2))[0]


def test_sweeps_of_sweeps_name_all_files():
    twice = Drive().mapped(Sweeps(2)).mapped(Sweeps(2))
    assert twice.files(3) == [Path(f"{number}.xyz") for number in (3, 2, 1)]
    lag_s = twice[3].cloud("gaussian").extra["lag_s"]
    np.testing.assert_allclose(lag_s, np.repeat([0.0, 0.1, 0.1, 0.2], 4), atol=1e-7)


def test_simulated_sweeps_line_up(simulated_cirrus):
    """Cirrus' layout keeps the poses: what an earlier sweep saw of a parked car lies in that car's present box."""
    from farfield.datasets import open_dataset

    data = open_dataset(simulated_cirrus)
    first, second, _ = data
    cloud = data.mapped(Sweeps(2))[1].cloud("gaussian")
    earlier = cloud[cloud.extra["lag_s"] > 0]
    then, now = first.annotation.full_boxes, second.annotation.full_boxes
    second_T_first = invert(second.world_T_frame) @ first.world_T_frame
    shared = np.intersect1d(then.track_id, now.track_id)
    then, now = (boxes[[boxes.track_id.tolist().index(name) for name in shared]] for boxes in (then, now))
    parked = np.linalg.norm(then.transform(second_T_first).centre_m - now.centre_m, axis=1) < 0.01
    before = [len(rows) for rows in first.cloud("gaussian").in_boxes(then[parked], margin_m=0.05)]
    after = [len(rows) for rows in earlier.in_boxes(now[parked], margin_m=0.05)]
    assert sum(before) > 50
    np.testing.assert_allclose(after, before, atol=1)
