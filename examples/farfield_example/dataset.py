"""A data set of one's own: clouds as comma-separated text, all boxes in one file.

survey.txt            marks the folder
clouds/NAME.csv       a header, then x, y, z in metres and intensity in [0, 1]: one file a frame, in order of time
boxes.csv             annotated boxes as `farfield score` reads them, the column frame names the cloud
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from farfield.datasets import Dataset
from farfield.errors import DatasetError, FileFormatError
from farfield.files.boxes_csv import read_boxes_csv
from farfield.frame import Annotation, Boxes, Cloud, Frame, Lazy, Sensor


class Survey(Dataset):
    """Frames with one LiDAR cloud, ``"lidar"``; where boxes.csv is absent nothing is annotated.

    Args:
        root: The folder.

    Raises:
        DatasetError: If there is no cloud.
    """

    name = "survey"
    looked_for = "survey.txt beside clouds/*.csv"

    def __init__(self, root: Path | str) -> None:
        self.root = Path(root)
        self.clouds = sorted(self.root.glob("clouds/*.csv"))
        if not self.clouds:
            raise DatasetError(f"{self.root}: expected clouds/*.csv, found none")
        self.frame_ids = tuple(path.stem for path in self.clouds)
        self.sequences = (self.root.resolve().name,) * len(self.clouds)
        self.boxes = self.root / "boxes.csv"

    @staticmethod
    def recognises(root: Path) -> bool:
        """Whether a folder is such a data set: quick, and true of no other format."""
        return (root / "survey.txt").is_file()

    def files(self, index: int) -> Sequence[Path]:
        """The files that frame ``index`` is read from."""
        return [self.clouds[index], *([self.boxes] if self.boxes.is_file() else [])]

    def frame(self, index: int) -> Frame:
        """Frame ``index``; clouds and boxes are read when they are asked for."""
        annotated = partial(read_annotation, self.boxes, self.frame_ids[index])
        return Frame(
            sequence=self.sequences[index],
            frame_id=self.frame_ids[index],
            clouds=Lazy({"lidar": partial(read_cloud, self.clouds[index])}),
            sensors={"lidar": Sensor(kind="lidar", frame_T_sensor=np.eye(4))},
            load_annotation=annotated if self.boxes.is_file() else None,
        )


def read_cloud(path: Path) -> Cloud:
    """One cloud."""
    try:
        rows = np.loadtxt(path, np.float32, delimiter=",", skiprows=1, usecols=(0, 1, 2, 3), ndmin=2)
    except ValueError as error:
        expected = "a header, then x,y,z,intensity"
        raise FileFormatError(path, where="the rows", expected=expected, got=str(error)) from error
    return Cloud(rows[:, :3], rows[:, 3])


def read_annotation(path: Path, frame: str) -> Annotation:
    """The boxes of one frame; none where boxes.csv has no line for it."""
    rows = read_boxes_csv(path)
    kept = rows.frame == frame
    place = {"centre_m": rows.centre_m[kept], "size_m": rows.size_m[kept], "yaw_rad": rows.yaw_rad[kept]}
    return Annotation(boxes=Boxes(**place, label=rows.label[kept]))
