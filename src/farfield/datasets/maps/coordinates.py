"""Frames in the coordinates of another of their sensors: K-Radar's or View-of-Delft's radar instead of the LiDAR."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict

from farfield.datasets.maps.contract import Earlier
from farfield.datasets.maps.placed import Placed
from farfield.datasets.moving import move_frame
from farfield.errors import ConfigError
from farfield.frame import Cloud, Frame, Lazy
from farfield.geometry.poses import invert

_OWN_FRAME = ("os1-128",)  # no calibration between it and the others was ever published


class CoordinatesSettings(BaseModel):
    """Settings of :class:`Coordinates`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    reference: str


@dataclass(frozen=True)
class Coordinates:
    """Every frame (clouds, boxes, poses, cameras) in the coordinates of the sensor ``reference``.

    A cloud that is read in its own sensor's coordinates is not moved there and back.

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
        moved = move_frame(frame, target_T_frame)
        clouds: dict[str, Callable[[], Cloud]] = {name: partial(_item, moved.clouds, name) for name in moved.clouds}
        for name in frame.clouds:
            loader = frame.clouds.loader(name) if isinstance(frame.clouds, Lazy) else None
            if name in _OWN_FRAME:
                clouds[name] = partial(_item, frame.clouds, name)
            elif isinstance(loader, Placed):
                clouds[name] = loader.moved(target_T_frame)
        return replace(moved, clouds=Lazy(clouds), reference=self.reference)


def _item(clouds: Mapping[str, Cloud], name: str) -> Cloud:
    return clouds[name]


def _frame_T_sensor(frame: Frame, name: str) -> Float[np.ndarray, "4 4"]:
    """Pose of a sensor in the frame's coordinates."""
    known = [key for key in ("os2_T_radar", "lidar_T_radar", "reference_T_radar") if key in frame.metadata]
    if known and name == "radar":
        return np.asarray(frame.metadata[known[0]])
    if known and frame.reference == "radar" and known[0] != "reference_T_radar":
        return invert(np.asarray(frame.metadata[known[0]]))
    raise ConfigError(
        f"Coordinates: expected frame {frame.key} to know where its sensor {name!r} stands; it does not. It is in the "
        f"coordinates of {frame.reference!r}."
    )
