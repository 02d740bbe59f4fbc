"""Maps over time: several sweeps a frame, each moved by the poses and with its age; and poses from files."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict

from farfield.datasets.frame_maps import Earlier
from farfield.errors import ConfigError, DatasetError
from farfield.files.poses_csv import PoseTable, read_poses
from farfield.frame import Cloud, Frame, Lazy, Pose
from farfield.frame.drive import Key
from farfield.geometry.poses import invert

LAG_COLUMN, SWEEP_COLUMN = "lag_s", "sweep"


class SweepsSettings(BaseModel):
    """Settings of :class:`Sweeps`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    count: int


@dataclass(frozen=True)
class Sweeps:
    """Each cloud followed by those of the ``count - 1`` frames before it in its drive.

    Earlier points are moved by the frames' poses, so that what stands still stays in place; what moves leaves a trail.
    Each point tells its sweep's age in the column ``lag_s`` and its number in ``sweep``, 0 for the present one. The
    first frames of a drive have fewer sweeps. Boxes and images are those of the present frame. Of a selection of
    frames, the frames before are those before in the whole data set.

    Args:
        count: Sweeps a frame; 1 changes nothing.

    Raises:
        ConfigError: If ``count`` is below 1.
        DatasetError: If a frame has no pose or no time, when it is built.
    """

    name: ClassVar[str] = "sweeps"
    Settings: ClassVar[type[BaseModel]] = SweepsSettings
    keeps_annotation: ClassVar[bool] = True
    count: int

    def __post_init__(self) -> None:
        if self.count < 1:
            raise ConfigError(f"sweeps: expected at least 1 sweep a frame, got {self.count}")

    @property
    def frames_before(self) -> int:
        """How many frames before the present one are read."""
        return self.count - 1

    def settings(self) -> Mapping[str, Any]:
        """The number of sweeps."""
        return {"count": self.count}

    def moved_poses(self, world_T_frame: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 4 4"]:
        """The poses as they are."""
        return world_T_frame

    def __call__(self, frame: Frame, earlier: Earlier) -> Frame:
        """The frame with the sweeps before it."""
        if self.count == 1:
            return frame
        present = _checked(frame)
        frames = (earlier(k) for k in range(1, self.count))
        before = tuple(_checked(other) for other in frames if other is not None)
        return replace(present, clouds=Lazy({name: StackedCloud(present, before, name) for name in present.clouds}))


@dataclass(frozen=True, eq=False)
class StackedCloud:
    """Loads the present cloud, then the earlier ones that have this sensor, the youngest first."""

    present: Frame
    before: Sequence[Frame]
    cloud: str

    def __call__(self) -> Cloud:
        """The clouds, one after another."""
        present, name = self.present, self.cloud
        present_T_world = invert(_world_T_cloud(present, name))
        parts = [_aged(present.clouds[name], 0.0, 0)]
        for number, frame in enumerate(self.before, 1):
            if name in frame.clouds:
                cloud = frame.clouds[name]
                sensor = None if LAG_COLUMN in cloud.extra else name  # ages of points are since the frame's own time
                lag_s = (_time_ns(present, sensor) - _time_ns(frame, sensor)) / 1e9
                motion = present_T_world @ _world_T_cloud(frame, name)
                parts.append(_aged(cloud.transform(motion), lag_s, number))
        return Cloud.concatenate(parts)


def _world_T_cloud(frame: Frame, name: str) -> Pose:
    """Pose of the coordinates in which a cloud stands: the frame's, or its sensor's own."""
    assert frame.world_T_frame is not None
    sensor = frame.sensors.get(name)
    if sensor is None or sensor.in_frame:
        return frame.world_T_frame
    if sensor.frame_T_sensor is None:
        raise DatasetError(
            f"Several sweeps need to know where {name} stands, since it keeps its own axes; frame {frame.key} does not "
            "say. Take one sweep (data.sweeps=1), or another cloud."
        )
    return frame.world_T_frame @ sensor.frame_T_sensor


def _checked(frame: Frame) -> Frame:
    missing = [name for name, value in (("pose", frame.world_T_frame), ("time", frame.time_ns)) if value is None]
    if missing:
        raise DatasetError(
            f"Several sweeps a frame need each frame's pose and time; frame {frame.key} has no "
            f"{' and no '.join(missing)}. Take one sweep (data.sweeps=1)."
        )
    return frame


def _aged(cloud: Cloud, lag_s: float, number: int) -> Cloud:
    sweep = number + cloud.column(SWEEP_COLUMN).astype(np.int16)
    column = np.full(len(cloud), lag_s, dtype=np.float32)
    if LAG_COLUMN in cloud.extra:  # of scans that the cloud holds already
        column += cloud.extra[LAG_COLUMN].astype(np.float32)
    return Cloud(cloud.points_m, cloud.intensity, {**cloud.extra, LAG_COLUMN: column, SWEEP_COLUMN: sweep})


def _time_ns(frame: Frame, name: str | None) -> int:
    time_ns = frame.time_ns if name is None else frame.time_ns_of(name)
    assert time_ns is not None
    return time_ns


# Poses from files beside the data, such as ``farfield odometry`` writes.


class PosedSettings(BaseModel):
    """Settings of :class:`Posed`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    poses: Path


@dataclass(frozen=True)
class Posed:
    """Each frame with the pose that the files give it, in the place of its own; one that they do not have has none.

    A drive has poses if the files have all of its frames. Where no motion is known (after a pause in the recording),
    the poses after it are not to be compared with those before.

    Args:
        poses: A file of poses, or a folder of such (``*.csv``, or ``poses/*.csv``).

    Raises:
        ConfigError: When poses are first asked for, if there are none; or if a frame stands in other coordinates than
            those that its pose is of.
        FileFormatError: If a file is damaged.
    """

    name: ClassVar[str] = "posed"
    Settings: ClassVar[type[BaseModel]] = PosedSettings
    keeps_annotation: ClassVar[bool] = True
    poses: Path

    def settings(self) -> Mapping[str, Any]:
        """Where the poses stand."""
        return {"poses": str(self.poses)}

    def fits(self, dataset: Any) -> bool:
        """Whether the files have a frame of the data set."""
        try:
            return any(key in self._by_key for key in dataset.keys)
        except ConfigError:  # data of another machine
            return False

    def poses_of(self, keys: Sequence[Key]) -> Float[np.ndarray, "n 4 4"] | None:
        """Poses of the frames of a drive; None where one is not known."""
        rows = [self._by_key.get(key) for key in keys]
        poses = [table.world_T_frame[row] for entry in rows if entry is not None for table, row in (entry,)]
        return np.stack(poses) if poses and len(poses) == len(keys) else None

    def moved_poses(self, world_T_frame: Float[np.ndarray, "n 4 4"]) -> None:
        """The drives' own poses are not those of the files."""
        del world_T_frame

    def __call__(self, frame: Frame, earlier: Earlier) -> Frame:
        """The frame with its pose."""
        del earlier
        entry = self._by_key.get(frame.key)
        if entry is None:
            return replace(frame, world_T_frame=None)
        table, row = entry
        if table.reference != frame.reference:
            raise ConfigError(
                f"{self.poses}: expected poses of {frame.reference}, in whose coordinates frame {frame.key} stands; "
                f"they are of {table.reference}. Open the data with the reference that the odometry saw."
            )
        return replace(frame, world_T_frame=table.world_T_frame[row])

    @cached_property
    def tables(self) -> tuple[PoseTable, ...]:
        """The tables, one a drive."""
        if self.poses.is_dir():
            folder = self.poses / "poses" if (self.poses / "poses").is_dir() else self.poses
            paths = sorted(folder.glob("*.csv"))
        else:
            paths = [self.poses] if self.poses.is_file() else []
        if not paths:
            raise ConfigError(f"{self.poses}: expected poses, a .csv a drive; `farfield odometry DATA` writes them")
        return tuple(map(read_poses, paths))

    @cached_property
    def _by_key(self) -> Mapping[Key, tuple[PoseTable, int]]:
        return {
            (table.sequence, frame): (table, row) for table in self.tables for row, frame in enumerate(table.frames)
        }

    def __getstate__(self) -> dict[str, Any]:
        return {"poses": self.poses}
