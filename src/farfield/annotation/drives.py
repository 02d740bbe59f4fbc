"""Where a frame stands in its drive, when, and from where it was seen."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from farfield.datasets.base import Dataset
from farfield.frame import Drive, Key

RATE_HZ = 10.0
"""Frames a second where no times are known, as most rotating LiDARs have."""


class DriveRowIndex(NamedTuple):
    """A frame's drive and its row in it."""

    drive: str
    row: int


class DriveTable:
    """The drives of a data set; frames of none (KITTI's object set) are a drive each.

    Args:
        data: The data set.
    """

    def __init__(self, data: Dataset) -> None:
        self.data = data
        self._drives: dict[str, Drive] = {drive.name: drive for drive in data.drives()}
        self.names = tuple(self._drives)
        self._place: dict[Key, DriveRowIndex] = {
            key: DriveRowIndex(name, row) for name, drive in self._drives.items() for row, key in enumerate(drive.keys)
        }
        self._index = {key: index for index, key in enumerate(data.keys)}
        self._poses: dict[Key, Float[np.ndarray, "4 4"] | None] = {}

    def place(self, key: Key) -> DriveRowIndex:
        """A frame's drive and row."""
        return self._place.get(key) or DriveRowIndex("/".join(key), 0)

    def keys(self, drive: str) -> tuple[Key, ...]:
        """Frames of a drive in the order of time."""
        found = self._drives.get(drive)
        if found is not None:
            return found.keys
        return tuple(key for key in self._index if "/".join(key) == drive and key not in self._place)

    def time_s(self, key: Key) -> float:
        """Seconds since the first frame of the drive; by 10 Hz where no times are known."""
        place = self.place(key)
        drive = self._drives.get(place.drive)
        if drive is None or drive.times_ns is None:
            return place.row / RATE_HZ
        return float(drive.times_ns[place.row] - drive.times_ns[0]) / 1e9

    def pose(self, key: Key) -> Float[np.ndarray, "4 4"] | None:
        """Pose of a frame in the world, or None; asked of the frame itself where the drive does not tell."""
        place = self.place(key)
        drive = self._drives.get(place.drive)
        if drive is not None and drive.world_T_frame is not None:
            return drive.world_T_frame[place.row]
        if key not in self._poses:
            self._poses[key] = self.data[self._index[key]].world_T_frame
        return self._poses[key]
