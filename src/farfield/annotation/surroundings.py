"""The points of a frame, sorted once so that those near a box are found quickly, and the ground beside it."""

from collections.abc import Callable, Sequence
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Float, Int64, Shaped

from farfield.annotation.fitting.ground import fit_ground
from farfield.datasets.labels import Numbers
from farfield.frame import Frame
from farfield.geometry.boxes import BOX_MARGIN_M

CELL_M = 4.0
GROUND_CELL_M = 1.0
GROUND_LOOK_M, BESIDE_M = 15.0, 0.5
SUPPORT_M, OFF_PLANE_M, FEWEST_CELLS, SHARE = 8.0, 0.2, 8, 0.6
"""The ground beside a box is known where so many square metres within 8 m, and so large a share of those with points,
lie within 0.2 m of the plane."""
MOST_GROUNDS = 2000
Points = Float[np.ndarray, "n 3"]


class _Cells:
    """Points sorted by cells, so that those near a place lie together.

    Args:
        points_m: Finite points, shape (n, 3).
        cell_m: Length of a cell.
    """

    def __init__(self, points_m: Float[np.ndarray, "n 3"], cell_m: float) -> None:
        self._cell_m = cell_m
        x, y = (np.floor(points_m[:, axis] / cell_m).astype(np.int32) for axis in (0, 1))
        self._low = np.array([x.min(), y.min()]) if len(x) else np.zeros(2, np.int32)
        self._counts = np.array([x.max(), y.max()]) - self._low + 1 if len(x) else np.zeros(2, np.int32)
        cell_numbers = _short((x - self._low[0]).astype(np.int64) * int(self._counts[1]) + (y - self._low[1]))
        order = np.argsort(cell_numbers, kind="stable")
        self._points, self._flat = points_m[order], cell_numbers[order].astype(np.int64)

    def near(self, x: float, y: float, reach_m: float) -> Points:
        """Points of the cells that a square around a place touches, shape (k, 3)."""
        low = np.floor((np.array([x, y]) - reach_m) / self._cell_m).astype(np.int64) - self._low
        high = np.floor((np.array([x, y]) + reach_m) / self._cell_m).astype(np.int64) - self._low
        low, high = np.maximum(low, 0), np.minimum(high, self._counts - 1)
        if (low > high).any():
            return self._points[:0]
        columns = np.arange(low[0], high[0] + 1) * int(self._counts[1])
        starts = np.searchsorted(self._flat, columns + low[1], side="left")
        stops = np.searchsorted(self._flat, columns + high[1], side="right")
        return np.concatenate([self._points[start:stop] for start, stop in zip(starts, stops, strict=True)])


class Surroundings:
    """LiDAR points of a frame, to be looked up by place; made once a frame.

    Args:
        points_m: Points in the frame's coordinates, shape (n, 3); what is not finite is left out.
    """

    def __init__(self, points_m: Float[np.ndarray, "n 3"]) -> None:
        finite = np.isfinite(points_m)  # asking for all at once is much quicker than row by row
        self._finite = points_m if finite.all() else points_m[finite.all(axis=1)]
        self._points = _Cells(self._finite, CELL_M)
        self._grounds: dict[Numbers, float | None] = {}

    @cached_property
    def _lowest(self) -> _Cells:
        """Made where ground is asked for: counting points needs none."""
        return _Cells(_lowest(self._finite), GROUND_LOOK_M)

    def near(self, x: float, y: float, reach_m: float) -> Points:
        """Points within a square around a place, and some more, shape (k, 3)."""
        return self._points.near(x, y, reach_m)

    def ground_m(self, box: Numbers) -> float | None:
        """Height of the ground under a box, in the frame's z; None where too little is seen of it.

        A plane through the lowest points of square metres within 15 m: beside a box alone, walls and parked cars may
        hide the ground wholly. Heights are kept: of a frame's boxes an edit moves one.
        """
        if box not in self._grounds:
            if len(self._grounds) >= MOST_GROUNDS:
                self._grounds.clear()
            self._grounds[box] = self._ground_m(box)
        return self._grounds[box]

    def _ground_m(self, box: Numbers) -> float | None:
        lowest = self._lowest.near(box[0], box[1], GROUND_LOOK_M)
        ground = fit_ground(lowest, (box[0], box[1]))
        close = lowest[np.abs(lowest[:, :2] - np.array(box[:2])).max(axis=1) <= SUPPORT_M]
        beside = beyond_m(in_box_axes(close, box), box) > BESIDE_M
        heights = ground.heights_m(close[beside].astype(np.float64))
        on_plane = int((np.abs(heights) <= OFF_PLANE_M).sum())
        return ground.z_m(box[0], box[1]) if on_plane >= max(FEWEST_CELLS, SHARE * len(heights)) else None


def _short(cells: Int64[np.ndarray, " n"]) -> Shaped[np.ndarray, " n"]:
    """Numbers of cells as 16 bits where they fit: numpy sorts those by radix, ten times as fast."""
    return cells.astype(np.uint16) if not len(cells) or cells.max() < 2**16 else cells


def _lowest(points: Points) -> Float[np.ndarray, "m 3"]:
    """The lowest point of each square metre."""
    if not len(points):
        return points
    cells = np.floor(points[:, :2] / GROUND_CELL_M).astype(np.int32)
    cells -= cells.min(axis=0)
    cell_numbers = cells[:, 0].astype(np.int64) * (int(cells[:, 1].max()) + 1) + cells[:, 1]
    order = np.lexsort((points[:, 2], cell_numbers))
    return points[order[np.flatnonzero(np.diff(cell_numbers[order], prepend=-1))]]


def in_box_axes(points_m: Points, box: Numbers) -> Points:
    """Points with the box's centre as origin and its length along x, shape (n, 3)."""
    cos, sin = np.cos(box[6]), np.sin(box[6])
    offset = points_m.astype(np.float64) - np.array(box[:3])
    return np.column_stack(
        [offset[:, 0] * cos + offset[:, 1] * sin, offset[:, 1] * cos - offset[:, 0] * sin, offset[:, 2]]
    )


def beyond_m(local_m: Points, box: Numbers) -> Float[np.ndarray, " n"]:
    """How far points, in the box's axes, stand outside its outline seen from above; negative inside."""
    return np.maximum(np.abs(local_m[:, 0]) - box[3] / 2, np.abs(local_m[:, 1]) - box[4] / 2)


_SORTED_CLOUDS = 12
"""Clouds that stay sorted in memory: those of two sensors in six frames."""


class SortedPoints:
    """LiDAR's and radar's points of frames, sorted by place: quick enough to count points at every edit.

    Args:
        frame: Gives a frame by its number.
    """

    def __init__(self, frame: Callable[[int], Frame]) -> None:
        self.frame = frame
        self._sorted = lru_cache(maxsize=_SORTED_CLOUDS)(self._sort)

    def around(self, index: int, kind: str) -> Surroundings | None:
        """The points of the first cloud of a kind that stands in the frame's axes; None where there is none."""
        return self._sorted(index, kind)

    def _sort(self, index: int, kind: str) -> Surroundings | None:
        frame = self.frame(index)
        name = cloud_name(frame, kind)
        return None if name is None else Surroundings(frame.cloud(name).points_m)

    def count(self, index: int, kind: str, box: Sequence[float]) -> int | None:
        """How many points of a kind a box holds; None where there is no such cloud."""
        around = self.around(index, kind)
        if around is None:
            return None
        x, y, z, length, width, height, yaw = map(float, box)
        near_m = around.near(x, y, float(np.hypot(length, width)) / 2 + BOX_MARGIN_M)
        local_m = in_box_axes(near_m, (x, y, z, length, width, height, yaw))
        half_m = np.array([length, width, height]) / 2 + BOX_MARGIN_M
        return int((np.abs(local_m) <= half_m).all(axis=1).sum())


def cloud_name(frame: Frame, kind: str) -> str | None:
    """The first cloud of a kind in the frame's axes."""
    for name in frame.clouds:
        sensor = frame.sensors.get(name)
        if (kind == "lidar") if sensor is None else (sensor.kind == kind and sensor.in_frame):
            return name
    return None
