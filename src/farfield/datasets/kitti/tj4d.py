"""TJ4DRadSet (Zheng et al.: "TJ4DRadSet: A 4D Radar Dataset for Autonomous Driving", ITSC 2022), its 4D radar.

KITTI's folders, but ``velodyne/*.bin`` holds a radar's points: rows of eight float32, x, y, z, v_r, range, power,
azimuth and elevation. ``Tr_velo_to_cam`` goes from the radar to the camera.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from farfield.datasets.kitti.object import Kitti
from farfield.errors import FileFormatError
from farfield.files.bin_columns import bin_columns
from farfield.files.clouds import read_bin
from farfield.frame import Cloud, Frame, Lazy, Sensor

COLUMNS = ("x", "y", "z", "v_r_m_s", "range_m", "power_db", "azimuth_deg", "elevation_deg")
_RANGE = COLUMNS.index("range_m")


def is_tj4dradset(root: Path) -> bool:
    """Whether a folder in KITTI's layout holds points of eight numbers whose fifth is their range."""
    for base in (root / "training", root / "testing", root):
        first = next(iter(sorted(base.glob("velodyne/*.bin"))[:1]), None)
        if first is not None:
            try:
                found = bin_columns(first)
            except (FileFormatError, OSError):
                return False
            return found.count == len(COLUMNS) and found.names[_RANGE] == COLUMNS[_RANGE]
    return False


class Tj4dRadSet(Kitti):
    """TJ4DRadSet frames: cloud ``"radar"``, image ``"camera"`` (image_2), boxes of the full objects.

    The cloud keeps all columns in ``extra``: ``v_r_m_s``, radial velocity relative to the radar, positive away from it
    (once more as ``doppler_m_s``), ``range_m``, ``power_db``, ``azimuth_deg``, ``elevation_deg``. Everything is in the
    radar's coordinates. Options are those of :class:`~farfield.datasets.kitti.object.Kitti`.
    """

    name = "tj4dradset"

    def frame(self, index: int) -> Frame:
        """Build frame ``index``."""
        frame = super().frame(index)
        sensors = {name: sensor for name, sensor in frame.sensors.items() if name != "lidar"}
        radar = Sensor(kind="radar", frame_T_sensor=np.eye(4))
        clouds = Lazy({"radar": partial(read_radar, self.clouds[index])})
        return replace(frame, clouds=clouds, sensors={"radar": radar, **sensors})


def read_radar(path: Path) -> Cloud:
    """Read a cloud of the radar, in its own coordinates.

    Raises:
        FileFormatError: If the file is damaged.
    """
    rows = read_bin(path, columns=len(COLUMNS))
    extra = {name: np.ascontiguousarray(rows[:, number]) for number, name in enumerate(COLUMNS) if number > 2}
    return Cloud(rows[:, :3].copy(), None, {**extra, "doppler_m_s": extra["v_r_m_s"]})
