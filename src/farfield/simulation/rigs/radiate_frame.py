"""A turn of the RADIATE car's radar as a Frame."""

from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float32

from farfield.frame import Annotation, Cloud, Frame, Lazy, Sensor
from farfield.radar.turning import strongest_cells
from farfield.simulation import labels
from farfield.simulation.rigs.drive import PlannedFrame, SimulatedDrive

if TYPE_CHECKING:
    from farfield.simulation.rigs.radiate import RadiateMoment

RADAR_SHARE = 0.02
"""Share of the picture's cells that the cloud gets, as RADIATE's reader gives it unless asked otherwise."""


class PlannedRadiate(PlannedFrame):
    """A turn before it is measured."""

    @cached_property
    def moment(self) -> "RadiateMoment":
        """What measures it."""
        from farfield.simulation.rigs.radiate import RadiateMoment

        return RadiateMoment(self.drive, self.index)

    def cloud(self, name: str) -> Cloud:
        """The strongest cells; the name is always "radar"."""
        del name
        points, strength = strongest_cells(self.moment.picture("polar"), RADAR_SHARE)
        return Cloud(points, None, {"strength": strength})

    def picture(self, name: str) -> Float32[np.ndarray, "height width"]:
        """One picture."""
        return self.moment.picture(name)

    def annotation(self) -> Annotation:
        """Boxes of what stands out of the noise, all around."""
        return Annotation(boxes=self.moment.boxes, moving=labels.moving(self.moment.boxes))


def radiate_frame(drive: SimulatedDrive, index: int, sensors: tuple[str, ...], time_ns: int) -> Frame:
    """A frame without its pose; nothing is simulated before it is read."""
    planned = PlannedRadiate(drive, index)
    kept = Sensor(kind="radar", frame_T_sensor=np.eye(4), in_frame=False, time_ns=time_ns)
    return Frame(
        sequence=drive.segment.name,
        frame_id=f"{index + 1:06d}",
        time_ns=time_ns,
        sensors={
            "radar": Sensor(kind="radar", frame_T_sensor=np.eye(4), time_ns=time_ns),
            **dict.fromkeys(sensors, kept),
        },
        clouds=Lazy({"radar": partial(planned.cloud, "radar")}),
        radar=Lazy({name: partial(planned.picture, name) for name in sensors}),
        load_annotation=planned.annotation,
        conditions=planned.conditions,
        simulated=True,
        reference="radar",
        metadata=planned.metadata(),
    )
