"""Points in boxes, quick enough to follow every edit: clouds sorted by place once a frame."""

from collections.abc import Callable, Sequence

import numpy as np

from farfield.annotation.surroundings import Surroundings, in_box_axes
from farfield.frame import Frame
from farfield.geometry.boxes import BOX_MARGIN_M
from farfield.studio.threads import Cache

_FRAMES = 6


class SortedPoints:
    """LiDAR's and radar's points of frames, sorted by place.

    Args:
        frame: Gives a frame by its number.
    """

    def __init__(self, frame: Callable[[int], Frame]) -> None:
        self.frame = frame
        self._sorted: Cache[Surroundings | None] = Cache(2 * _FRAMES, lambda _: 1)

    def around(self, index: int, kind: str) -> Surroundings | None:
        """The points of the first cloud of a kind that stands in the frame's axes; None where there is none."""
        return self._sorted.get((index, kind), lambda: self._made(index, kind))

    def _made(self, index: int, kind: str) -> Surroundings | None:
        frame = self.frame(index)
        name = cloud_name(frame, kind)
        return None if name is None else Surroundings(frame.cloud(name).points_m)

    def inside(self, index: int, kind: str, box: Sequence[float]) -> int | None:
        """How many points of a kind a box holds; None where there is no such cloud."""
        around = self.around(index, kind)
        if around is None:
            return None
        x, y, z, length, width, height, yaw = map(float, box)
        numbers = (x, y, z, length, width, height, yaw)
        local = in_box_axes(around.near(x, y, float(np.hypot(length, width)) / 2 + BOX_MARGIN_M), numbers)
        reach = np.array([length, width, height]) / 2 + BOX_MARGIN_M
        return int((np.abs(local) <= reach).all(axis=1).sum())


def cloud_name(frame: Frame, kind: str) -> str | None:
    """The first cloud of a kind in the frame's axes."""
    for name in frame.clouds:
        sensor = frame.sensors.get(name)
        if (kind == "lidar") if sensor is None else (sensor.kind == kind and sensor.in_frame):
            return name
    return None
