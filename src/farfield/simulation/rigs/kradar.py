"""The K-Radar car: two Ousters and four stereo cameras on the roof, a 4D radar in the grill.

Coordinates of a frame are the os2-64's at its reference moment. The radar stands 2.54 m ahead of it, 0.3 m to the right
and 0.7 m below, without rotation (K-Radar, ``info_calib`` and the devkit's z offset). No extrinsic between the two
Ousters was ever published; where the os1-128 stands here is an assumption.
"""

from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Float32, Int, Shaped, UInt8

from farfield.frame import Annotation, Camera, Cloud, Frame, Lazy, Sensor, camera_sensor
from farfield.geometry.poses import pose
from farfield.radar.cells import RadarCells, cells_of_cube
from farfield.radar.products import doppler_cube, polar3d_from_moments, zyx_cube
from farfield.simulation import labels
from farfield.simulation.bodies.actors import inflated
from farfield.simulation.camera.mounts import kradar_cameras
from farfield.simulation.lidar.model import OS1_128, OS2_64
from farfield.simulation.lidar.rays import Scan
from farfield.simulation.lidar.sweep import SimulatedSweep, sweep
from farfield.simulation.presets import KRADAR_SEGMENT_NAME, KRADAR_SENSORS, Preset
from farfield.simulation.radar.model import RadarModel, radar_mount
from farfield.simulation.radar.points import availability
from farfield.simulation.rig import FrameWriter, Rig
from farfield.simulation.rigs.drive import HALF_SWEEP_S, SimulatedDrive, SimulatedFrame
from farfield.simulation.world.scene import SceneWindow
from farfield.vocabulary.kradar import OUSTER_LINES

if TYPE_CHECKING:
    from farfield.simulation.radar.frame import RadarFrame

LIDAR_T_RADAR = radar_mount(np.eye(4))
OS2_T_OS1 = pose(np.eye(3), np.array([0.35, 0.0, -0.25]))
_VIEW_M = 250.0
_MIN_HITS = 5
_LABEL_RANGE_M = 120.0
_RADAR_HALF_SPAN_S = 0.016  # a frame of 64 loops takes 32 ms
_RADAR_VIEW_M = 130.0
_CAMERAS = ("cam-front", "cam-left", "cam-right", "cam-rear")
_PRODUCTS = ("cells", "sparse", "polar3d", "cube", "tesseract")
_CAMERA_HZ = 30
_RADAR_LEAD = 5  # the radar's recording began half a second before the LiDARs'


class KRadarFrame(SimulatedFrame):
    """One frame of the K-Radar car."""

    @cached_property
    def window(self) -> SceneWindow:
        """The scene while the LiDARs turn."""
        return self.drive.scene.window(self.time_s, half_span_s=HALF_SWEEP_S, reach_m=_VIEW_M, behind_m=_VIEW_M)

    @cached_property
    def radar_window(self) -> SceneWindow:
        """The scene when the radar measures; it has no common clock with the LiDARs."""
        time_s = max(self.time_s + self.drive.mounting.radar_offset_s, 0.0)
        return self.drive.scene.window(time_s, half_span_s=_RADAR_HALF_SPAN_S, reach_m=_RADAR_VIEW_M, behind_m=_VIEW_M)

    @cached_property
    def sweeps(self) -> dict[str, SimulatedSweep]:
        """Sweeps made so far, by sensor."""
        return {}

    def sweep(self, name: str) -> SimulatedSweep:
        """The sweep of "os2-64" or "os1-128", in that sensor's own frame."""
        if name not in self.sweeps:
            drive = self.drive
            model = replace(OS2_64 if name == "os2-64" else OS1_128, columns=drive.preset.columns)
            mount = drive.mounting.ego_T_lidar if name == "os2-64" else drive.mounting.ego_T_lidar @ OS2_T_OS1
            rng = drive.rng(name, self.index)
            scan = Scan.draw(model, rng)
            self.sweeps[name] = sweep(
                scan, model, self.window, mount, rng, weather=drive.weather, window_seed=drive.window_seed(name)
            )
        return self.sweeps[name]

    def cloud(self, name: str) -> Cloud:
        """One Ouster's cloud, in its own frame."""
        return self.sweep(name).cloud

    @cached_property
    def cameras(self) -> dict[str, Camera]:
        """Left and right eyes of the four stereo cameras."""
        return kradar_cameras(self.drive.mounting.ego_T_lidar)

    def image(self, name: str) -> UInt8[np.ndarray, "height width 3"]:
        """What one eye sees."""
        return self.camera_image(name, self.cameras[name])

    def measured(self, outputs: tuple[str, ...], model: RadarModel | None = None) -> "RadarFrame":
        """What the radar measures: "tensor", its moments over Doppler ("mean"), or only how strong each object is.

        Args:
            outputs: Which of them.
            model: Another radar in the same place.
        """
        from farfield.simulation.radar.frame import measure

        window, drive = self.radar_window, self.drive
        world_T_radar = window.world_T_ego_now @ radar_mount(drive.mounting.ego_T_lidar)
        seeds = drive.seeds("radar", self.index)
        return measure(window, model or RadarModel(), world_T_radar, drive.weather, seeds, outputs=outputs)

    @cached_property
    def annotation(self) -> Annotation:
        """Full boxes of the road users ahead that the os2-64 hits at least five times or the radar sees.

        They stand where the turning LiDAR shows them, as loose as K-Radar's. ``visibility`` is "R" where the radar sees
        the object, "L" where only the LiDAR does (labels v2.1); ``details`` hold ``snr_db``, the radar's signal over
        noise, -inf where it gets no echo.
        """
        swept = self.sweep("os2-64")
        boxes = self.swept_boxes(swept)
        boxes = inflated(boxes) if self.drive.preset.loose_boxes else boxes
        hits: Int[np.ndarray, " n"] = np.bincount(swept.actor[swept.actor >= 0], minlength=len(boxes))
        snr_db, masked_db = self._radar_strengths()
        flags = np.array(availability(snr_db, hits >= _MIN_HITS, masked_by_db=masked_db), dtype=np.str_)
        ahead = (boxes.range_m < _LABEL_RANGE_M) & (boxes.centre_m[:, 0] > 0)
        rows = np.flatnonzero(ahead & (flags != "L1"))
        boxes = boxes[rows].replace(point_count=hits[rows])
        return Annotation(
            boxes=boxes,
            visibility=[str(flag) for flag in flags[rows]],
            moving=labels.moving(boxes),
            details={"snr_db": snr_db[rows]},
        )

    def _radar_strengths(self) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Signal over noise of the LiDAR window's road users, and by how much others outshine them."""
        measurement = self.__dict__.get("moments") or self.measured(())
        rows = {actor.track_id: row for row, actor in enumerate(self.radar_window.actors)}
        index = np.array([rows.get(actor.track_id, -1) for actor in self.window.actors], dtype=np.int64)
        none = np.array([-np.inf])
        return np.append(measurement.snr_db, none)[index], np.append(measurement.masked_db, none)[index]

    @cached_property
    def moments(self) -> "RadarFrame":
        """The radar's measurement reduced over Doppler."""
        return self.measured(("mean",))

    def product(self, name: str) -> Shaped[np.ndarray, "..."] | RadarCells:
        """One radar product; all but the tensor come from one measurement of the moments."""
        if name == "tesseract":
            tensor = self.measured(("tensor",)).tensor
            assert tensor is not None
            return tensor
        if name == "polar3d":
            moments = self.moments.moments
            assert moments is not None
            return polar3d_from_moments(moments.mean_power_63, moments.velocity_moment)
        if name == "cube":
            return self.cube
        if name == "cells":
            return self.cells
        with_velocity: RadarCells | None = self.__dict__.get("cells")
        cells = (
            cells_of_cube(self.cube, "wide") if with_velocity is None else with_velocity
        )  # the cloud has no velocity
        strongest = cells.select("wide", 0.1)
        return np.column_stack([strongest.points_m(), strongest.power])

    @cached_property
    def cells(self) -> RadarCells:
        """The cells of the wide region, with their mean velocity."""
        moments = self.moments.moments
        assert moments is not None
        doppler = doppler_cube(moments.mean_power_63, moments.velocity_moment)
        return cells_of_cube(self.cube, "wide", doppler_m_s=doppler)

    @cached_property
    def cube(self) -> Float32[np.ndarray, "150 400 250"]:
        """The Cartesian cube."""
        power = self.moments.power
        assert power is not None
        return zyx_cube(power)


def kradar_frame(drive: SimulatedDrive, index: int, sensors: tuple[str, ...], time_ns: int) -> Frame:
    """A frame without its pose; nothing is simulated before it is read."""
    simulated = KRadarFrame(drive, index)
    eyes = [name + side for name in _CAMERAS if name in sensors for side in ("", "-right")]
    products = [name for name in _PRODUCTS if name in sensors]
    cameras = kradar_cameras(drive.mounting.ego_T_lidar) if eyes else {}
    return Frame(
        sequence=drive.segment.name,
        frame_id="_".join(f"{number:05d}" for number in list(_indices(drive, index).values())[:2]),
        time_ns=time_ns,
        sensors=_sensors(drive, sensors, time_ns) | {name: camera_sensor(cameras[name], time_ns) for name in eyes},
        clouds=Lazy({name: partial(simulated.cloud, name) for name in OUSTER_LINES if name in sensors}),
        images=Lazy({name: partial(simulated.image, name) for name in eyes}),
        cameras={name: cameras[name] for name in eyes},
        radar=Lazy({name: partial(simulated.product, name) for name in products}),
        load_annotation=simulated.load_annotation,
        conditions=simulated.conditions,
        indices=_indices(drive, index),
        simulated=True,
        reference="os2-64",
        metadata=simulated.metadata(),
    )


def _indices(drive: SimulatedDrive, index: int) -> dict[str, int]:
    """Numbers of the sensors' files: the cameras count three times as fast, LiDARs count from 1."""
    lidar = round(index * drive.preset.stride_s * 10) + 1
    camera = (lidar - 1) * _CAMERA_HZ // 10 + 2
    numbers = {"radar": lidar + _RADAR_LEAD, "os2-64": lidar, "cam-front": camera, "os1-128": lidar}
    return numbers | {"cam-lrr": camera}


def _sensors(drive: SimulatedDrive, sensors: tuple[str, ...], time_ns: int) -> dict[str, Sensor]:
    """The os2-64, in whose coordinates the frame is; the os1-128 and the radar's products, which keep their own."""
    shots = {name: lines * drive.preset.columns for name, lines in OUSTER_LINES.items()}
    times_ns = {name: time_ns if name in sensors else None for name in OUSTER_LINES}
    product = Sensor(kind="radar", frame_T_sensor=LIDAR_T_RADAR, in_frame=False, time_ns=time_ns)
    return {
        "os2-64": Sensor(kind="lidar", frame_T_sensor=np.eye(4), time_ns=times_ns["os2-64"], shots=shots["os2-64"]),
        "os1-128": Sensor(
            kind="lidar",
            frame_T_sensor=OS2_T_OS1,
            in_frame=False,
            time_ns=times_ns["os1-128"],
            shots=shots["os1-128"],
        ),
        "radar": Sensor(kind="radar", frame_T_sensor=LIDAR_T_RADAR),
        **{name: product for name in _PRODUCTS if name in sensors},
    }


def _writer(root: Path, preset: Preset) -> FrameWriter:
    from farfield.datasets.kradar import KRadarWriter

    return KRadarWriter(root, columns=preset.columns)


RIG = Rig(sensors=KRADAR_SENSORS, segment_name=KRADAR_SEGMENT_NAME, frame=kradar_frame, writer=_writer, finishes=True)
