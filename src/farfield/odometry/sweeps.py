"""The sweeps of a drive as odometry takes them: read one by one, with the time of each point where it is known."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from farfield.datasets import Dataset
from farfield.errors import ConfigError
from farfield.frame import Cloud, Drive, Frame
from farfield.geometry.poses import transform_points
from farfield.odometry.odometry import OdometrySweep

Turning = Literal["no", "clockwise", "counterclockwise"]
_OFFSETS = ("offset_ns", "time_ns")  # columns of clouds: since the frame's time
_MOVED = ("argoverse2",)  # formats whose points have times, and were moved to the sweep's moment
_TICK_S = 1e-4  # a car at 40 m/s moves 4 mm


@dataclass(frozen=True)
class SweepSettings:
    """Which points of a frame, and when they were measured.

    Args:
        cloud: Name of the cloud; the one in whose coordinates the frame stands, else the first, unless given.
        deskew: Move points to the sweep's moment, where their times are known.
        turning: How the scanner turns, seen from above, where points have no times: the beam looks along x at the
            sweep's moment.
        step_s: Seconds between sweeps where frames have no times.
    """

    cloud: str | None = None
    deskew: bool = True
    turning: Turning = "no"
    step_s: float = 0.1

    def __post_init__(self) -> None:
        if not 0 < self.step_s < 1e4:
            raise ConfigError(f"step_s: expected seconds between sweeps, got {self.step_s:g}")


class DriveSweeps:
    """The sweeps of one drive, in the order of time or backwards.

    Args:
        data: The data set.
        drive: The drive.
        settings: Which points.
        backward: The last one first.
    """

    def __init__(self, data: Dataset, drive: Drive, settings: SweepSettings, *, backward: bool = False) -> None:
        self.data, self.drive, self.settings = data, drive, settings
        self.order = list(range(len(drive.keys)))[:: -1 if backward else 1]
        self.times_s = times_of(drive, settings.step_s)
        steps = np.abs(np.diff(self.times_s))
        self.period_s = float(np.median(steps)) if len(steps) else settings.step_s

    def __len__(self) -> int:
        return len(self.order)

    def __getitem__(self, index: int, /) -> OdometrySweep:
        return self._sweep(self.order[index])

    def _sweep(self, row: int) -> OdometrySweep:
        frame = self.data[int(self.drive.indices[row])]
        name = cloud_of(frame, self.settings.cloud)
        cloud, sensor = frame.cloud(name), frame.sensors.get(name)
        points = cloud.points_m.astype(np.float64)
        finite = np.isfinite(points).all(1)
        offset = self._offsets_s(cloud, points)
        if sensor is not None and not sensor.in_frame:
            if sensor.frame_T_sensor is None:
                raise ConfigError(
                    f"odometry: where {name} stands on the car is not known (frame {frame.key}); take another --cloud"
                )
            points = transform_points(sensor.frame_T_sensor, points)
        return OdometrySweep(points[finite], float(self.times_s[row]), None if offset is None else offset[finite])

    def _offsets_s(self, cloud: Cloud, points_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"] | None:
        if not self.settings.deskew:
            return None
        column = next((name for name in _OFFSETS if name in cloud.extra), None)
        if self.settings.turning != "no":
            sign = -1 if self.settings.turning == "clockwise" else 1
            offset = sign * np.arctan2(points_m[:, 1], points_m[:, 0]) / (2 * np.pi) * self.period_s
        elif column is None or self.data.unwrapped.name in _MOVED:
            return None
        else:
            offset = cloud.extra[column].astype(np.float64) * 1e-9
        if len(offset) and np.abs(offset).max() > 1:
            raise ConfigError(
                f"odometry: expected points measured within a second of their sweep, got {np.abs(offset).max():g} s; "
                "pass --no-deskew to take them as they are"
            )
        return np.round(offset / _TICK_S) * _TICK_S


def cloud_of(frame: Frame, name: str | None) -> str:
    """Name of the cloud that odometry reads.

    Raises:
        ConfigError: If the frame has none of that name, or none.
    """
    own = frame.reference.removesuffix("'")
    chosen = name or (own if own in frame.clouds else next(iter(frame.clouds), None))
    if chosen is None or chosen not in frame.clouds:
        raise ConfigError(f"odometry: frame {frame.key} has no cloud {name or ''}; it has {', '.join(frame.clouds)}")
    return chosen


def times_of(drive: Drive, step_s: float) -> Float[np.ndarray, " n"]:
    """Seconds since a drive's first sweep; at constant steps where times are not known.

    Raises:
        ConfigError: If times do not increase.
    """
    if drive.times_ns is None:
        return np.arange(len(drive.keys)) * step_s
    times: Int[np.ndarray, " n"] = drive.times_ns
    late = np.flatnonzero(np.diff(times) <= 0)
    if len(late):
        raise ConfigError(
            f"odometry: expected times that increase, but in drive {drive.name} frame {drive.keys[late[0] + 1][1]} is "
            f"not later than {drive.keys[late[0]][1]}; `farfield doctor` tells more"
        )
    return (times - times[0]) * 1e-9
