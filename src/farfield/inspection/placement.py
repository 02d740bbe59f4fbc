"""Where the sensors of a data set stand, with their axes: what Cirrus' Figure 3 shows."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from farfield.datasets.base import Dataset
from farfield.errors import FarfieldError
from farfield.frame.record import Kind


@dataclass(frozen=True, eq=False, kw_only=True)
class SensorPlacement:
    """One sensor.

    Args:
        kind: What it is.
        frame_T_sensor: Its pose in the frame's coordinates, shape (4, 4).
        names: Names of the data that come from it: products of one radar are one sensor.
    """

    kind: Kind
    frame_T_sensor: Float[np.ndarray, "4 4"]
    names: tuple[str, ...]


@dataclass(frozen=True, eq=False, kw_only=True)
class RigPlacement:
    """The sensors of a data set.

    Args:
        reference: Whose coordinates they are in.
        sensors: Those whose place is known.
        unknown: Names of the others.
    """

    reference: str
    sensors: tuple[SensorPlacement, ...]
    unknown: tuple[str, ...]

    def to_json(self) -> Mapping[str, object]:
        """Positions in metres and poses by name."""
        rows = {" = ".join(sensor.names): sensor.frame_T_sensor.tolist() for sensor in self.sensors}
        return {"reference": self.reference, "frame_T_sensor": rows, "unknown": list(self.unknown)}


def placement(data: Dataset) -> RigPlacement | None:
    """Where the sensors stand of which the first, the middle or the last frame has data; None where none is known."""
    for index in dict.fromkeys((0, len(data) // 2, len(data) - 1)) if len(data) else ():
        try:
            frame = data[index]
        except (FarfieldError, OSError):
            continue
        present = {*frame.clouds, *frame.images, *frame.radar}
        sensors = {name: sensor for name, sensor in frame.sensors.items() if name in present}
        placed: list[SensorPlacement] = []
        for name, sensor in sensors.items():
            if sensor.frame_T_sensor is not None:
                _add_sensor(
                    placed, SensorPlacement(kind=sensor.kind, frame_T_sensor=sensor.frame_T_sensor, names=(name,))
                )
        lacks = tuple(name for name, sensor in sensors.items() if sensor.frame_T_sensor is None)
        if placed:
            return RigPlacement(reference=frame.reference, sensors=tuple(placed), unknown=lacks)
    return None


def _add_sensor(placed: list[SensorPlacement], one: SensorPlacement) -> None:
    """Put the data of one sensor together."""
    for index, other in enumerate(placed):
        if other.kind == one.kind and np.allclose(other.frame_T_sensor, one.frame_T_sensor, atol=1e-9):
            names = (*other.names, *one.names)
            placed[index] = SensorPlacement(kind=one.kind, frame_T_sensor=one.frame_T_sensor, names=names)
            return
    placed.append(one)
