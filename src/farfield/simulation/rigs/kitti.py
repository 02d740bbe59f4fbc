"""The KITTI car: a Velodyne HDL-64E on the roof, and the left colour camera, in whose field objects are annotated.

Coordinates of a frame are the LiDAR's at its reference moment, when it looks straight ahead and the camera is triggered
(Geiger et al., "Vision meets Robotics: The KITTI Dataset", IJRR 2013).
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from farfield.frame import Boxes, Camera, Cloud
from farfield.geometry.image_boxes import image_boxes
from farfield.geometry.poses import invert
from farfield.simulation import labels
from farfield.simulation.camera.render import render
from farfield.simulation.camera.rig import kitti_camera
from farfield.simulation.lidar.model import HDL_64E, LidarModel
from farfield.simulation.lidar.rays import NearestHits
from farfield.simulation.lidar.scan import Scan
from farfield.simulation.lidar.sweep import SimulatedSweep, sweep
from farfield.simulation.rigs.drive import HALF_SWEEP_S, SimulatedFrame
from farfield.simulation.world.scene import SceneWindow

_REACH_M = 120.0
_MIN_HITS = 5
_PARTLY, _LARGELY = 0.7, 0.3
"""Shares of an object's shots that reach it below which it counts as partly, and as largely occluded: a guess."""


@dataclass(frozen=True, eq=False)
class KittiAnnotation:
    """What KITTI's annotators would draw.

    Args:
        boxes: Full boxes.
        occlusion: 0 visible, 1 partly, 2 largely occluded, shape (n,).
        box_px: 2D boxes in the image: left, top, right, bottom, shape (n, 4).
        truncation: Share of each 2D box outside the image, shape (n,).
    """

    boxes: Boxes
    occlusion: Int[np.ndarray, " n"]
    box_px: Float[np.ndarray, "n 4"]
    truncation: Float[np.ndarray, " n"]


class KittiMoment(SimulatedFrame):
    """One frame of the KITTI car."""

    @cached_property
    def window(self) -> SceneWindow:
        """The scene while the LiDAR turns."""
        return self.drive.scene.window(
            self.time_s, half_span_s=HALF_SWEEP_S, reach_m=_REACH_M, behind_m=HDL_64E.max_range_m
        )

    @cached_property
    def model(self) -> LidarModel:
        """The LiDAR's model in this preset."""
        return replace(HDL_64E, columns=self.drive.preset.columns)

    @cached_property
    def scan(self) -> Scan:
        """Its shots, the same in every frame."""
        return Scan.draw(self.model, np.random.default_rng(0))

    @cached_property
    def sweep(self) -> SimulatedSweep:
        """Its sweep."""
        drive = self.drive
        return sweep(
            self.scan,
            self.model,
            self.window,
            drive.mounted.ego_T_lidar,
            drive.rng("lidar", self.index),
            weather=drive.weather,
            window_seed=drive.window_seed("lidar"),
        )

    def cloud(self, name: str) -> Cloud:
        """Its cloud; the name is always "lidar"."""
        del name
        return self.sweep.cloud

    @cached_property
    def camera(self) -> Camera:
        """The left colour camera."""
        return kitti_camera(self.drive.mounted.ego_T_lidar)

    @cached_property
    def image(self) -> UInt8[np.ndarray, "height width 3"]:
        """What it sees."""
        drive = self.drive
        rng, glass = drive.rng("camera", self.index), drive.window_seed("camera")
        return render(self.window, self.camera, self.world_T_lidar, drive.weather, rng, window_seed=glass)

    @cached_property
    def annotation(self) -> KittiAnnotation:
        """Full boxes of the road users in the camera's field that the LiDAR hits at least five times.

        They stand where the turning LiDAR shows them: its cloud is not corrected for the car's own motion.
        """
        window = self.window
        full = labels.full_boxes(
            window.actors, window.bottom_m, window.yaw_rad, window.velocity_m_s, invert(self.world_T_lidar)
        )
        owner = self.sweep.actor
        time_s = self.sweep.cloud.extra["time_ns"].astype(np.float64) * 1e-9
        seen_s = labels.mean_times_s(time_s, owner, len(full))
        velocity = (window.velocity_m_s - window.ego_velocity_m_s) @ self.world_T_lidar[:3, :3]
        full = full.replace(centre_m=full.centre_m + velocity * seen_s[:, None])
        hits: Int[np.ndarray, " n"] = np.bincount(owner[owner >= 0], minlength=len(full))
        box_px, truncation = image_boxes(full, self.camera)
        kept: Bool[np.ndarray, " n"] = (hits >= _MIN_HITS) & (box_px[:, 2] >= 0)
        rows = np.flatnonzero(kept)
        return KittiAnnotation(
            full[rows].replace(point_count=hits[rows]), self._occlusion(rows), box_px[rows], truncation[rows]
        )

    def _occlusion(self, rows: Int[np.ndarray, " k"]) -> Int[np.ndarray, " k"]:
        """How far road users are hidden: by the share of the shots at each that nothing before it stops."""
        aimed = self.sweep.aimed
        assert aimed is not None
        alone = np.array([self._shots_alone(int(row)) for row in rows], dtype=np.float64)
        share = aimed[rows] / np.maximum(alone, 1.0)
        return np.select([share >= _PARTLY, share >= _LARGELY], [0, 1], default=2).astype(np.int64)

    def _shots_alone(self, row: int) -> int:
        """How many shots would meet a road user if nothing else stood there."""
        window = self.window
        bodies = [body for body in window.bodies if body.actor == row]
        world_T_sensor = window.world_T_ego @ self.drive.mounted.ego_T_lidar
        casting = NearestHits(self.scan, bodies, world_T_sensor, window.knots_s)
        casting.see_through(np.ones(casting.range_m.shape[1], dtype=np.bool_))
        return int((casting.range_m[0] < self.model.max_range_m).sum())
