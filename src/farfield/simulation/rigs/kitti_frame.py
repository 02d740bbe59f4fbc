"""The KITTI car's measurements as a Frame."""

from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import UInt8

from farfield.errors import ConfigError
from farfield.frame import Annotation, CameraField, Frame, Lazy, Sensor, camera_sensor
from farfield.simulation import labels
from farfield.simulation.camera.rig import kitti_camera
from farfield.simulation.rigs.drive import PlannedFrame, SimulatedDrive

if TYPE_CHECKING:
    from farfield.simulation.rigs.kitti import KittiMoment

MOST_FRAMES = 1000
"""Frames of a sequence that have a number of their own among KITTI's six digits; there are as many sequences."""


class PlannedKitti(PlannedFrame):
    """A frame of the KITTI car before it is measured."""

    @cached_property
    def moment(self) -> "KittiMoment":
        """What measures it."""
        from farfield.simulation.rigs.kitti import KittiMoment

        return KittiMoment(self.drive, self.index)

    def image(self) -> UInt8[np.ndarray, "height width 3"]:
        """What the left colour camera sees."""
        return self.moment.image

    def annotation(self) -> Annotation:
        """Full boxes in the camera's field, with what KITTI knows of each in the image."""
        drawn = self.moment.annotation
        camera = kitti_camera(self.drive.mounted.ego_T_lidar)
        return Annotation(
            boxes=drawn.boxes,
            moving=labels.moving(drawn.boxes),
            details={"truncation": drawn.truncation, "occlusion": drawn.occlusion, "box_px": drawn.box_px},
            region=CameraField(camera=camera, name="the left colour camera"),
        )


def kitti_frame(drive: SimulatedDrive, index: int, sensors: tuple[str, ...], time_ns: int) -> Frame:
    """A frame without its pose; nothing is simulated before it is read.

    Raises:
        ConfigError: If KITTI's numbers do not reach to the frame.
    """
    if drive.sequence >= MOST_FRAMES or index >= MOST_FRAMES:
        raise ConfigError(
            f"{drive.preset.name}: expected at most {MOST_FRAMES} sequences of {MOST_FRAMES} frames, which KITTI's "
            f"six digits can number; got sequence {drive.sequence}, frame {index}"
        )
    planned = PlannedKitti(drive, index)
    camera = kitti_camera(drive.mounted.ego_T_lidar)
    shots = 64 * drive.preset.columns
    return Frame(
        sequence=drive.segment.name,
        frame_id=f"{drive.sequence * MOST_FRAMES + index:06d}",
        time_ns=time_ns,
        sensors={
            "lidar": Sensor(kind="lidar", frame_T_sensor=np.eye(4), time_ns=time_ns, shots=shots),
            "camera": camera_sensor(camera, time_ns),
        },
        clouds=Lazy({"lidar": partial(planned.cloud, "lidar")} if "lidar" in sensors else {}),
        images=Lazy({"camera": planned.image} if "camera" in sensors else {}),
        cameras={"camera": camera},
        load_annotation=planned.annotation,
        conditions=planned.conditions,
        simulated=True,
        metadata=planned.metadata(),
    )
