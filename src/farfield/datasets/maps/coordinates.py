"""Frames in the coordinates of another of their sensors: K-Radar's or View-of-Delft's radar instead of the LiDAR."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

from pydantic import BaseModel, ConfigDict

from farfield.datasets.maps.contract import Earlier
from farfield.datasets.maps.placed import TransformedCloud
from farfield.errors import ConfigError
from farfield.frame import Cloud, Frame, Lazy, Pose, moved
from farfield.geometry.poses import invert


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
        seen = moved(frame, target_T_frame, reference=self.reference)
        placed = {name: frame.clouds.loader(name) for name in frame.clouds} if isinstance(frame.clouds, Lazy) else {}
        once = {name: one.moved(target_T_frame) for name, one in placed.items() if isinstance(one, TransformedCloud)}
        rest: dict[str, Callable[[], Any]] = {name: partial(item, seen.clouds, name) for name in seen.clouds}
        return replace(seen, clouds=Lazy(rest | once))


def item(clouds: Mapping[str, Cloud], name: str) -> Cloud:
    """One cloud, read when it is asked for."""
    return clouds[name]


def _frame_T_sensor(frame: Frame, name: str) -> Pose:
    sensor = frame.sensors.get(name)
    if sensor is None or sensor.frame_T_sensor is None:
        known = ", ".join(name for name, one in frame.sensors.items() if one.frame_T_sensor is not None) or "no sensor"
        raise ConfigError(
            f"coordinates: expected frame {frame.key} to know where its sensor {name!r} stands; it knows {known}."
        )
    return sensor.frame_T_sensor
