"""The Cirrus car's measurements as a Frame."""

from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import UInt8

from farfield.frame import Annotation, Frame, Lazy, Sensor, camera_sensor
from farfield.simulation import labels
from farfield.simulation.camera.rig import cirrus_camera
from farfield.simulation.rigs.drive import PlannedFrame, SimulatedDrive
from farfield.vocabulary.patterns import PATTERNS

if TYPE_CHECKING:
    from farfield.simulation.rigs.cirrus import CirrusMoment


class PlannedCirrus(PlannedFrame):
    """A frame of the Cirrus car before it is measured."""

    @cached_property
    def moment(self) -> "CirrusMoment":
        """What measures it."""
        from farfield.simulation.rigs.cirrus import CirrusMoment

        return CirrusMoment(self.drive, self.index)

    def image(self) -> UInt8[np.ndarray, "height width 3"]:
        """What the front camera sees."""
        return self.moment.image

    def annotation(self) -> Annotation:
        """Boxes of the visible parts, with the whole bodies and the points of each pattern."""
        drawn = self.moment.annotation
        return Annotation(
            boxes=drawn.visible,
            moving=labels.moving(drawn.visible),
            extent="visible",
            full_boxes=drawn.full,
            details={"point_count_gaussian": drawn.gaussian_points, "point_count_uniform": drawn.uniform_points},
        )


def cirrus_frame(drive: SimulatedDrive, index: int, sensors: tuple[str, ...], time_ns: int) -> Frame:
    """A frame without its pose; nothing is simulated before it is read."""
    planned = PlannedCirrus(drive, index)
    times = {"gaussian": time_ns, "uniform": time_ns + round(drive.mounted.uniform_offset_s * 1e9)}
    shots = drive.preset.lines * drive.preset.columns
    clouds = [name for name in PATTERNS if name in sensors]
    cameras = {"camera": cirrus_camera()} if "camera" in sensors else {}
    return Frame(
        sequence=drive.segment.name,
        frame_id=str(time_ns),
        time_ns=time_ns,
        sensors={
            **{name: Sensor(kind="lidar", time_ns=times[name], shots=shots) for name in clouds},
            **{name: camera_sensor(camera, time_ns) for name, camera in cameras.items()},
        },
        clouds=Lazy({name: partial(planned.cloud, name) for name in clouds}),
        images=Lazy(dict.fromkeys(cameras, planned.image)),
        cameras=cameras,
        load_annotation=planned.annotation,
        conditions=planned.conditions,
        simulated=True,
        metadata=planned.metadata(),
    )
