"""The K-Radar car: two Ousters and four stereo cameras on the roof, a 4D radar in the grill.

Coordinates of a frame are the os2-64's at its reference moment. The radar stands 2.54 m ahead of it, 0.3 m to the right
and 0.7 m below, without rotation (K-Radar, ``info_calib`` and the devkit's z offset). No extrinsic between the two
Ousters was ever published; where the os1-128 stands here is an assumption.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, Int, UInt8

from farfield.frame import Boxes, Camera, Cloud
from farfield.geometry.poses import invert, pose
from farfield.simulation import labels
from farfield.simulation.camera.render import render
from farfield.simulation.camera.rig import rig_cameras
from farfield.simulation.lidar.model import OS1_128, OS2_64
from farfield.simulation.lidar.scan import Scan
from farfield.simulation.lidar.sweep import Sweep, sweep
from farfield.simulation.radar.measure import RadarFrame, measure
from farfield.simulation.radar.model import RadarModel
from farfield.simulation.radar.visibility import VISIBLE_SNR_DB
from farfield.simulation.rigs.drive import HALF_SWEEP_S, Drive
from farfield.simulation.world.scene import Window

LIDAR_T_RADAR = pose(np.eye(3), np.array([2.54, -0.3, -0.7]))
OS2_T_OS1 = pose(np.eye(3), np.array([0.35, 0.0, -0.25]))
_BEHIND_M = 250.0
_SIDES = ("front", "left", "right", "rear")
_MIN_HITS = 5
_LABEL_RANGE_M = 120.0


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


class KRadarMoment:
    """One frame of the K-Radar car; everything is measured when it is first asked for.

    Args:
        drive: The sequence.
        index: Number of the frame.
    """

    def __init__(self, drive: Drive, index: int) -> None:
        self.drive, self.index = drive, index
        self.time_s = drive.time_s(index)

    @cached_property
    def window(self) -> Window:
        """The scene while the LiDARs turn."""
        return self.drive.scene.window(self.time_s, half_span_s=HALF_SWEEP_S, reach_m=_BEHIND_M, behind_m=_BEHIND_M)

    @cached_property
    def radar_window(self) -> Window:
        """The scene when the radar measures; it has no common clock with the LiDARs."""
        time_s = max(self.time_s + self.drive.mounted.radar_offset_s, 0.0)
        return self.drive.scene.window(time_s, reach_m=_BEHIND_M, behind_m=_BEHIND_M)

    @cached_property
    def world_T_lidar(self) -> Float[np.ndarray, "4 4"]:
        """Pose of the os2-64."""
        return self.window.world_T_ego_now @ self.drive.mounted.ego_T_lidar

    @cached_property
    def sweeps(self) -> dict[str, Sweep]:
        """Sweeps made so far, by sensor."""
        return {}

    def sweep(self, name: str) -> Sweep:
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
        eyes = rig_cameras("kradar", self.drive.mounted.ego_T_lidar)
        names = {"left": "", "right": "-right"}
        return {f"cam-{side}{names[eye]}": eyes[f"{side}_{eye}"] for side in _SIDES for eye in names}

    def image(self, name: str) -> UInt8[np.ndarray, "height width 3"]:
        """What one eye sees."""
        rng = self.drive.rng(name, self.index)
        glass = self.drive.window_seed(name)
        return render(self.window, self.cameras[name], self.world_T_lidar, self.drive.weather, rng, window_seed=glass)

    def _radar(self, outputs: tuple[str, ...]) -> RadarFrame:
        """What the radar measures: "tensor", the "mean" over Doppler, or nothing but each object's strength."""
        window = self.radar_window
        world_T_radar = window.world_T_ego_now @ self.drive.mounted.ego_T_lidar @ LIDAR_T_RADAR
        seed = self.drive.seeds("radar", self.index)
        return measure(window, RadarModel(), world_T_radar, self.drive.weather, seed, outputs=outputs)

    @cached_property
    def seen_by_radar(self) -> Float[np.ndarray, " n"]:
        """Signal-to-noise ratio of each of the LiDAR window's road users for the radar; it needs no tensor."""
        found = self._radar(())
        rows = {actor.track_id: float(snr) for actor, snr in zip(self.radar_window.actors, found.snr_db, strict=True)}
        return np.array([rows.get(actor.track_id, -np.inf) for actor in self.window.actors])

    @cached_property
    def annotation(self) -> KRadarAnnotation:
        """Full boxes of the road users ahead that the os2-64 hits at least five times or the radar sees."""
        window = self.window
        full = labels.full_boxes(window.actors, window.bottom_m, window.yaw_rad, invert(self.world_T_lidar))
        full = full.replace(size_m=full.size_m * self.drive.preset.box_scale)
        owner = self.sweep("os2-64").actor
        hits: Int[np.ndarray, " n"] = np.bincount(owner[owner >= 0], minlength=len(full))
        radar = self.seen_by_radar >= VISIBLE_SNR_DB
        near = (full.range_m < _LABEL_RANGE_M) & (full.centre_m[:, 0] > 0)
        kept = np.flatnonzero(near & ((hits >= _MIN_HITS) | radar))
        boxes = full[kept].replace(point_count=hits[kept])
        return KRadarAnnotation(boxes, ["R" if radar[i] else "L" for i in kept], self.seen_by_radar[kept])

    @cached_property
    def products(self) -> dict[str, Any]:
        """Radar products made so far, by name."""
        return {}

    def product(self, name: str, wanted: tuple[str, ...]) -> Float32[np.ndarray, "..."]:
        """One radar product; the tensor is made once for all the ``wanted`` ones."""
        if name not in self.products:
            self.products.update(radar_products(self._radar, {name, *wanted}))
        product: Float32[np.ndarray, "..."] = self.products[name]
        return product
