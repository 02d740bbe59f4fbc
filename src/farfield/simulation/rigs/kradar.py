"""The K-Radar car: two Ousters and four stereo cameras on the roof, a 4D radar in the grill.

Coordinates of a frame are the os2-64's at its reference moment. The radar stands 2.54 m ahead of it, 0.3 m to the right
and 0.7 m below, without rotation (K-Radar, ``info_calib`` and the devkit's z offset). No extrinsic between the two
Ousters was ever published; where the os1-128 stands here is an assumption.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Float32, Int, Shaped, UInt8

from farfield.frame import Boxes, Camera, Cloud
from farfield.geometry.poses import invert, pose
from farfield.radar.cells import RadarCells, cells_of_cube
from farfield.radar.products import doppler_cube, polar3d_from_moments, zyx_cube
from farfield.simulation import labels
from farfield.simulation.bodies.sizes import inflated
from farfield.simulation.camera.render import render
from farfield.simulation.camera.rig import kradar_cameras
from farfield.simulation.lidar.model import OS1_128, OS2_64
from farfield.simulation.lidar.scan import Scan
from farfield.simulation.lidar.sweep import SimulatedSweep, sweep
from farfield.simulation.radar.frame import RadarFrame, measure
from farfield.simulation.radar.model import RadarModel, radar_mount
from farfield.simulation.radar.visibility import availability
from farfield.simulation.rigs.drive import HALF_SWEEP_S, SimulatedFrame
from farfield.simulation.world.scene import SceneWindow

LIDAR_T_RADAR = radar_mount(np.eye(4))
OS2_T_OS1 = pose(np.eye(3), np.array([0.35, 0.0, -0.25]))
_BEHIND_M = 250.0
_MIN_HITS = 5
_LABEL_RANGE_M = 120.0
_RADAR_HALF_SPAN_S = 0.016  # a frame of 64 loops takes 32 ms
_RADAR_REACH_M = 130.0


@dataclass(frozen=True, eq=False)
class KRadarAnnotation:
    """Boxes of a K-Radar frame, and by which sensor each was seen.

    Args:
        boxes: Full boxes, as loose as K-Radar's.
        availability: "R" where the radar sees the object, "L" where only the LiDAR does (labels v2.1).
        snr_db: The radar's signal-to-noise ratio of each, -inf where it gets no echo.
    """

    boxes: Boxes
    availability: list[str]
    snr_db: Float[np.ndarray, " n"]


class KRadarMoment(SimulatedFrame):
    """One frame of the K-Radar car."""

    @cached_property
    def window(self) -> SceneWindow:
        """The scene while the LiDARs turn."""
        return self.drive.scene.window(self.time_s, half_span_s=HALF_SWEEP_S, reach_m=_BEHIND_M, behind_m=_BEHIND_M)

    @cached_property
    def radar_window(self) -> SceneWindow:
        """The scene when the radar measures; it has no common clock with the LiDARs."""
        time_s = max(self.time_s + self.drive.mounted.radar_offset_s, 0.0)
        return self.drive.scene.window(
            time_s, half_span_s=_RADAR_HALF_SPAN_S, reach_m=_RADAR_REACH_M, behind_m=_BEHIND_M
        )

    @cached_property
    def sweeps(self) -> dict[str, SimulatedSweep]:
        """Sweeps made so far, by sensor."""
        return {}

    def sweep(self, name: str) -> SimulatedSweep:
        """The sweep of "os2-64" or "os1-128", in that sensor's own frame."""
        if name not in self.sweeps:
            drive = self.drive
            model = replace(OS2_64 if name == "os2-64" else OS1_128, columns=drive.preset.columns)
            mount = drive.mounted.ego_T_lidar if name == "os2-64" else drive.mounted.ego_T_lidar @ OS2_T_OS1
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
        return kradar_cameras(self.drive.mounted.ego_T_lidar)

    def image(self, name: str) -> UInt8[np.ndarray, "height width 3"]:
        """What one eye sees."""
        rng = self.drive.rng(name, self.index)
        glass = self.drive.window_seed(name)
        return render(self.window, self.cameras[name], self.world_T_lidar, self.drive.weather, rng, window_seed=glass)

    def measured(self, outputs: tuple[str, ...], model: RadarModel | None = None) -> RadarFrame:
        """What the radar measures: "tensor", its moments over Doppler ("mean"), or only how strong each object is.

        Args:
            outputs: Which of them.
            model: Another radar in the same place.
        """
        window, drive = self.radar_window, self.drive
        world_T_radar = window.world_T_ego_now @ radar_mount(drive.mounted.ego_T_lidar)
        seeds = drive.seeds("radar", self.index)
        return measure(window, model or RadarModel(), world_T_radar, drive.weather, seeds, outputs=outputs)

    @cached_property
    def annotation(self) -> KRadarAnnotation:
        """Full boxes of the road users ahead that the os2-64 hits at least five times or the radar sees.

        They stand where the spinning LiDAR shows them.
        """
        window = self.window
        full = labels.full_boxes(
            window.actors, window.bottom_m, window.yaw_rad, window.velocity_m_s, invert(self.world_T_lidar)
        )
        swept = self.sweep("os2-64")
        owner = swept.actor
        seen_s = labels.mean_times_s(swept.cloud.extra["time_ns"].astype(np.float64) * 1e-9, owner, len(full))
        velocity = (window.velocity_m_s - window.ego_velocity_m_s) @ self.world_T_lidar[:3, :3]  # not compensated
        full = full.replace(centre_m=full.centre_m + velocity * seen_s[:, None])
        full = inflated(full) if self.drive.preset.loose_boxes else full
        hits: Int[np.ndarray, " n"] = np.bincount(owner[owner >= 0], minlength=len(full))
        snr_db, masked_db = self._radar_strengths()
        flags = np.array(availability(snr_db, hits >= _MIN_HITS, masked_by_db=masked_db), dtype=np.str_)
        near = (full.range_m < _LABEL_RANGE_M) & (full.centre_m[:, 0] > 0)
        kept = np.flatnonzero(near & (flags != "L1"))
        boxes = full[kept].replace(point_count=hits[kept])
        return KRadarAnnotation(boxes, [str(flag) for flag in flags[kept]], snr_db[kept])

    def _radar_strengths(self) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Signal over noise of the LiDAR window's road users, and by how much others outshine them."""
        found = self.__dict__.get("moments") or self.measured(())
        rows = {actor.track_id: row for row, actor in enumerate(self.radar_window.actors)}
        where = np.array([rows.get(actor.track_id, -1) for actor in self.window.actors], dtype=np.int64)
        none = np.array([-np.inf])
        return np.append(found.snr_db, none)[where], np.append(found.masked_db, none)[where]

    @cached_property
    def moments(self) -> RadarFrame:
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
        known: RadarCells | None = self.__dict__.get("cells")
        cells = cells_of_cube(self.cube, "wide") if known is None else known  # the cloud tells no velocity
        chosen = cells.select("wide", 0.1)
        return np.column_stack([chosen.points_m(), chosen.power])

    @cached_property
    def cells(self) -> RadarCells:
        """The cells of the wide region, with their mean velocity."""
        found = self.moments.moments
        assert found is not None
        doppler = doppler_cube(found.mean_power_63, found.velocity_moment)
        return cells_of_cube(self.cube, "wide", doppler_m_s=doppler)

    @cached_property
    def cube(self) -> Float32[np.ndarray, "150 400 250"]:
        """The Cartesian cube."""
        power = self.moments.power
        assert power is not None
        return zyx_cube(power)
