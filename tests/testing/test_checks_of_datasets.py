"""The checks of data sets find what is wrong, and say how to fix it."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from farfield.datasets.folder import Folder, write_boxes
from farfield.files.clouds import write_bin
from farfield.frame import Boxes, Cloud, Frame, Sensor
from farfield.testing import check_dataset


@pytest.fixture
def root(tmp_path: Path) -> Path:
    rows = np.random.default_rng(1).uniform(0, 1, (20, 4)).astype(np.float32)
    for stem in "ab":
        write_bin(tmp_path / f"{stem}.bin", rows)
    write_boxes(tmp_path / "a.json", Boxes(centre_m=np.ones((1, 3)), size_m=np.ones((1, 3)), yaw_rad=np.ones(1)))
    return tmp_path


class Missing(Folder):
    def files(self, index: int) -> Sequence[Path]:
        return [self.root / "elsewhere.bin"]


class Misnamed(Folder):
    def frame(self, index: int) -> Frame:
        return super().frame(0)


class Heavy(Folder):
    def frame(self, index: int) -> Frame:
        points = np.zeros((40_000, 3), np.float32)
        return replace(super().frame(index), clouds={"lidar": Cloud(points, points[:, 0])})


class Nowhere(Folder):
    def frame(self, index: int) -> Frame:
        return replace(super().frame(index), sensors={})


class Dull(Folder):
    def frame(self, index: int) -> Frame:
        points = np.zeros((4, 3), np.float32)
        return replace(super().frame(index), clouds={"lidar": Cloud(points)}, sensors={"lidar": Sensor(kind="lidar")})


class Forgetful(Folder):
    def has_annotation(self, index: int) -> bool:
        return False


@pytest.mark.parametrize(
    ("reader", "message"),
    [
        (Missing, r"names what is not there: .*elsewhere\.bin"),
        (Misnamed, "expected frame 1 to be"),
        (Heavy, "give Lazy functions that load"),
        (Nowhere, "expected a Sensor for each cloud"),
        (Dull, "intensity is a LiDAR's"),
        (Forgetful, r"has_annotation\(index\) and the frame's"),
    ],
)
def test_what_is_wrong_is_named(root: Path, reader: type[Folder], message: str) -> None:
    check_dataset(Folder(root))
    with pytest.raises(AssertionError, match=message):
        check_dataset(reader(root))
