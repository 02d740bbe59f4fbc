"""Maps that move frames rigidly: by a given motion, or into the coordinates of another sensor."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict

from farfield.datasets.frame_maps import Earlier
from farfield.errors import ConfigError
from farfield.frame import Cloud, Frame, Lazy, Pose, transform_frame
from farfield.geometry.poses import check_rigid, invert, pose_from_yaw

_Row = tuple[float, float, float, float]


class MoveSettings(BaseModel):
    """Settings of :class:`Move`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    target_T_frame: tuple[_Row, _Row, _Row, _Row]


@dataclass(frozen=True, eq=False)
class Move:
    """Every frame (clouds, boxes, poses, cameras) in other coordinates.

    Args:
        target_T_frame: Maps the frames' coordinates to the new ones, 4 x 4.

    Raises:
        ConfigError: If it is no rigid motion.
    """

    name: ClassVar[str] = "move"
    Settings: ClassVar[type[BaseModel]] = MoveSettings
    target_T_frame: Float[np.ndarray, "4 4"] | Sequence[Sequence[float]]

    def __post_init__(self) -> None:
        pose = np.asarray(self.target_T_frame, dtype=np.float64)
        check_rigid(pose, "move: target_T_frame")
        object.__setattr__(self, "target_T_frame", pose)

    @classmethod
    def turned(cls, yaw_deg: float | int) -> "Move":
        """A turn counter-clockwise about z."""
        return cls(pose_from_yaw(float(np.deg2rad(yaw_deg))))

    @property
    def pose(self) -> Float[np.ndarray, "4 4"]:
        """The motion as an array."""
        return np.asarray(self.target_T_frame)

    def settings(self) -> Mapping[str, Any]:
        """The motion as rows of numbers."""
        return {"target_T_frame": self.pose.tolist()}

    def moved_poses(self, world_T_frame: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 4 4"]:
        """Poses of the moved frames."""
        return world_T_frame @ invert(self.pose)

    def __call__(self, frame: Frame, earlier: Earlier) -> Frame:
        """The frame, moved."""
        del earlier
        return transform_frame(frame, self.pose)


# The coordinates of another sensor: K-Radar's or View-of-Delft's radar instead of the LiDAR.


class CoordinatesSettings(BaseModel):
    """Settings of :class:`Coordinates`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    reference: str


@dataclass(frozen=True)
class Coordinates:
    """Every frame (clouds, boxes, poses, cameras) in the coordinates of the sensor ``reference``.

    A cloud that is read in its own sensor's coordinates is not moved there and back; data that keep their sensor's own
    axes (``in_frame=False``) stay as they are.

    Args:
        reference: Name of a sensor whose pose the frames know, one of the data set's ``references``.

    Raises:
        ConfigError: If a frame does not know the sensor, when it is built.
    """

    name: ClassVar[str] = "coordinates"
    Settings: ClassVar[type[BaseModel]] = CoordinatesSettings
    overrules: ClassVar[bool] = True
    reference: str

    def settings(self) -> Mapping[str, Any]:
        """The sensor."""
        return {"reference": self.reference}

    def fits(self, dataset: Any) -> bool:
        """Whether the data set's frames know the sensor."""
        return self.reference in dataset.references

    def __call__(self, frame: Frame, earlier: Earlier) -> Frame:
        """The frame in the sensor's coordinates; itself where it is in them."""
        del earlier
        if frame.reference == self.reference:
            return frame
        target_T_frame = invert(_frame_T_sensor(frame, self.reference))
        transformed = transform_frame(frame, target_T_frame, reference=self.reference)
        placed = {name: frame.clouds.loader(name) for name in frame.clouds} if isinstance(frame.clouds, Lazy) else {}
        once = {
            name: loader.moved(target_T_frame)
            for name, loader in placed.items()
            if isinstance(loader, TransformedCloud)
        }
        rest: dict[str, Callable[[], Any]] = {
            name: partial(item, transformed.clouds, name) for name in transformed.clouds
        }
        return replace(transformed, clouds=Lazy(rest | once))


def item(clouds: Mapping[str, Cloud], name: str) -> Cloud:
    """One cloud, read when it is asked for."""
    return clouds[name]


def _frame_T_sensor(frame: Frame, name: str) -> Pose:
    sensor = frame.sensors.get(name)
    if sensor is None or sensor.frame_T_sensor is None:
        with_pose = (
            ", ".join(name for name, other in frame.sensors.items() if other.frame_T_sensor is not None) or "no sensor"
        )
        raise ConfigError(
            f"coordinates: expected frame {frame.key} to know where its sensor {name!r} stands; it knows {with_pose}."
        )
    return sensor.frame_T_sensor


# A cloud that is read in its sensor's own coordinates and moved into the frame's.

_SAME = 1e-9


@dataclass(frozen=True, eq=False)
class TransformedCloud:
    """Loads a cloud and moves it once, however often the frame's coordinates were changed.

    Args:
        read: Reads the cloud in its sensor's coordinates.
        frame_T_sensor: Pose of the sensor in the frame's coordinates.
    """

    read: Callable[[], Cloud]
    frame_T_sensor: Float[np.ndarray, "4 4"]

    def __call__(self) -> Cloud:
        """The cloud in the frame's coordinates; as it was read where these are the sensor's."""
        cloud = self.read()
        if np.allclose(self.frame_T_sensor, np.eye(4), rtol=0, atol=_SAME):
            return cloud
        return cloud.transform(self.frame_T_sensor)

    def moved(self, target_T_frame: Float[np.ndarray, "4 4"]) -> "TransformedCloud":
        """The same cloud in other coordinates."""
        return replace(self, frame_T_sensor=target_T_frame @ self.frame_T_sensor)
