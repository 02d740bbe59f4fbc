"""The K-Radar car's measurements as a Frame."""

from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Shaped, UInt8

from farfield.frame import Annotation, Frame, Lazy, Sensor, camera_sensor
from farfield.radar.cells import RadarCells
from farfield.simulation import labels
from farfield.simulation.camera.rig import kradar_cameras
from farfield.simulation.rigs.drive import PlannedFrame, SimulatedDrive
from farfield.vocabulary.kradar import OUSTER_LINES

if TYPE_CHECKING:
    from farfield.simulation.rigs.kradar import KRadarMoment

_CAMERAS = ("cam-front", "cam-left", "cam-right", "cam-rear")
_PRODUCTS = ("cells", "sparse", "polar3d", "cube", "tesseract")
_CAMERA_HZ = 30
_RADAR_LEAD = 5  # the radar's recording began half a second before the LiDARs'


class PlannedKRadar(PlannedFrame):
    """A frame of the K-Radar car before it is measured."""

    @cached_property
    def moment(self) -> "KRadarMoment":
        """What measures it."""
        from farfield.simulation.rigs.kradar import KRadarMoment

        return KRadarMoment(self.drive, self.index)

    def image(self, name: str) -> UInt8[np.ndarray, "height width 3"]:
        """What one eye sees."""
        return self.moment.image(name)

    def product(self, name: str) -> Shaped[np.ndarray, "..."] | RadarCells:
        """One radar product."""
        return self.moment.product(name)

    def annotation(self) -> Annotation:
        """Full boxes, which sensor sees each, and how strongly the radar does."""
        drawn = self.moment.annotation
        return Annotation(
            boxes=drawn.boxes,
            visibility=drawn.availability,
            moving=labels.moving(drawn.boxes),
            details={"snr_db": drawn.snr_db},
        )


def kradar_frame(drive: SimulatedDrive, index: int, sensors: tuple[str, ...], time_ns: int) -> Frame:
    """A frame without its pose; nothing is simulated before it is read."""
    planned = PlannedKRadar(drive, index)
    eyes = [name + side for name in _CAMERAS if name in sensors for side in ("", "-right")]
    products = [name for name in _PRODUCTS if name in sensors]
    cameras = kradar_cameras(drive.mounted.ego_T_lidar) if eyes else {}
    known = _mounted(drive, sensors, time_ns)
    return Frame(
        sequence=drive.segment.name,
        frame_id="_".join(f"{number:05d}" for number in list(_indices(drive, index).values())[:2]),
        time_ns=time_ns,
        sensors=known | {name: camera_sensor(cameras[name], time_ns) for name in eyes},
        clouds=Lazy({name: partial(planned.cloud, name) for name in OUSTER_LINES if name in sensors}),
        images=Lazy({name: partial(planned.image, name) for name in eyes}),
        cameras={name: cameras[name] for name in eyes},
        radar=Lazy({name: partial(planned.product, name) for name in products}),
        load_annotation=planned.annotation,
        conditions=planned.conditions,
        indices=_indices(drive, index),
        simulated=True,
        reference="os2-64",
        metadata=planned.metadata(),
    )


def _indices(drive: SimulatedDrive, index: int) -> dict[str, int]:
    """Numbers of the sensors' files: the cameras count three times as fast, LiDARs count from 1."""
    lidar = round(index * drive.preset.stride_s * 10) + 1
    camera = (lidar - 1) * _CAMERA_HZ // 10 + 2
    numbers = {"radar": lidar + _RADAR_LEAD, "os2-64": lidar, "cam-front": camera, "os1-128": lidar}
    return numbers | {"cam-lrr": camera}


def _mounted(drive: SimulatedDrive, sensors: tuple[str, ...], time_ns: int) -> dict[str, Sensor]:
    """The os2-64, in whose coordinates the frame is; the os1-128 and the radar's products, which keep their own."""
    from farfield.simulation.rigs.kradar import LIDAR_T_RADAR, OS2_T_OS1

    shots = {name: lines * drive.preset.columns for name, lines in OUSTER_LINES.items()}
    taken = {name: time_ns if name in sensors else None for name in OUSTER_LINES}
    known = {"os2-64": Sensor(kind="lidar", frame_T_sensor=np.eye(4), time_ns=taken["os2-64"], shots=shots["os2-64"])}
    known["os1-128"] = Sensor(
        kind="lidar",
        frame_T_sensor=OS2_T_OS1,
        in_frame=False,
        time_ns=taken["os1-128"],
        shots=shots["os1-128"],
    )
    known["radar"] = Sensor(kind="radar", frame_T_sensor=LIDAR_T_RADAR)
    kept = Sensor(kind="radar", frame_T_sensor=LIDAR_T_RADAR, in_frame=False, time_ns=time_ns)
    return known | {name: kept for name in _PRODUCTS if name in sensors}
