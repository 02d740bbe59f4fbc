"""The Cirrus car: two Luminars with different patterns on the roof, and a front camera.

Coordinates of a frame are the Gaussian sensor's at its reference moment; that moment names the frame.
"""

from dataclasses import replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int, UInt8

from farfield.frame import Camera, Cloud
from farfield.geometry.poses import invert, pose
from farfield.simulation import labels
from farfield.simulation.camera.render import render
from farfield.simulation.camera.rig import cirrus_camera
from farfield.simulation.lidar.model import LUMINAR_H2, LidarModel
from farfield.simulation.lidar.scan import Scan
from farfield.simulation.lidar.sweep import SimulatedSweep, sweep
from farfield.simulation.rigs.drive import HALF_SWEEP_S, SimulatedFrame
from farfield.simulation.world.scene import SceneWindow


class CirrusMoment(SimulatedFrame):
    """One frame of the Cirrus car."""

    @cached_property
    def window(self) -> SceneWindow:
        """The scene while the Gaussian sensor sweeps."""
        return self.drive.scene.window(self.time_s, half_span_s=HALF_SWEEP_S, behind_m=self._behind_m)

    @cached_property
    def later(self) -> SceneWindow:
        """The scene while the uniform sensor sweeps."""
        offset_s = self.drive.mounted.uniform_offset_s
        if offset_s == 0:
            return self.window
        return self.drive.scene.window(self.time_s + offset_s, half_span_s=HALF_SWEEP_S, behind_m=self._behind_m)

    @property
    def _behind_m(self) -> float:
        return 20.0 if self.drive.mounted.ego_T_lidar[0, 0] > 0 else 260.0

    def _sweep(
        self, pattern: str, window: SceneWindow, origin_m: tuple[float | int, float | int, float | int]
    ) -> SimulatedSweep:
        drive = self.drive
        ego_T_sensor = drive.mounted.ego_T_lidar @ pose(np.eye(3), np.asarray(origin_m, dtype=np.float64))
        model = self.model
        rng = drive.rng(pattern, self.index)
        scan = Scan.draw(model, rng, pattern=pattern)
        return sweep(
            scan, model, window, ego_T_sensor, rng, weather=drive.weather, window_seed=drive.window_seed(pattern)
        )

    @cached_property
    def model(self) -> LidarModel:
        """The Luminars' model in this sequence."""
        preset, mounted = self.drive.preset, self.drive.mounted
        return replace(
            LUMINAR_H2,
            lines=preset.lines,
            columns=preset.columns,
            focus_deg=mounted.focus_deg,
            sigma_deg=mounted.sigma_deg,
        )

    @cached_property
    def gaussian(self) -> SimulatedSweep:
        """The Gaussian sensor's sweep."""
        return self._sweep("gaussian", self.window, (0.0, 0.0, 0.0))

    @cached_property
    def uniform(self) -> SimulatedSweep:
        """The uniform sensor's sweep, in the Gaussian sensor's frame of this moment."""
        origin_m = self.drive.mounted.uniform_origin_m
        swept = self._sweep("uniform", self.later, origin_m)
        offset = pose(np.eye(3), np.asarray(origin_m, dtype=np.float64))
        world_T_uniform = self.later.world_T_ego_now @ self.drive.mounted.ego_T_lidar @ offset
        return SimulatedSweep(
            swept.cloud.transform(invert(self.world_T_lidar) @ world_T_uniform), swept.actor, swept.kind
        )

    def cloud(self, pattern: str) -> Cloud:
        """One pattern's cloud."""
        return self.gaussian.cloud if pattern == "gaussian" else self.uniform.cloud

    @cached_property
    def camera(self) -> Camera:
        """The front camera."""
        return cirrus_camera()

    @cached_property
    def image(self) -> UInt8[np.ndarray, "height width 3"]:
        """What it sees."""
        rng = self.drive.rng("camera", self.index)
        return render(
            self.window,
            self.camera,
            self.world_T_lidar,
            self.drive.weather,
            rng,
            window_seed=self.drive.window_seed("camera"),
        )

    @cached_property
    def annotation(self) -> labels.VisibleObjects:
        """Boxes of the road users that the two patterns see, where the Gaussian pattern's points show them."""
        window = self.window
        full = labels.full_boxes(
            window.actors, window.bottom_m, window.yaw_rad, window.velocity_m_s, invert(self.world_T_lidar)
        )
        owner = self._owners()
        counts = {name: np.bincount(rows[rows >= 0], minlength=len(full)) for name, rows in owner.items()}
        both = counts["gaussian"] + counts["uniform"]
        kept = (both >= labels.MIN_POINTS_BOTH) & (counts["gaussian"] >= labels.MIN_POINTS_GAUSSIAN)
        kept &= full.centre_m[:, 0] > 0
        row = np.full(len(full) + 1, -1)
        row[np.flatnonzero(kept)] = np.arange(kept.sum())
        velocity = window.velocity_m_s @ self.world_T_lidar[:3, :3]
        seen_s = labels.mean_times_s(self._times_s("gaussian"), owner["gaussian"], len(full))
        full = full.replace(centre_m=full.centre_m + velocity * seen_s[:, None])
        points = [self._as_seen(name, owner[name], velocity, seen_s) for name in ("gaussian", "uniform")]
        rows = row[np.concatenate([owner["gaussian"], owner["uniform"]])]
        chosen = full[kept].replace(point_count=counts["gaussian"][kept])
        joined = np.concatenate(points)[rows >= 0]
        visible = labels.visible_boxes(chosen, joined, rows[rows >= 0]) if len(chosen) else chosen
        return labels.VisibleObjects(visible, chosen, counts["gaussian"][kept], counts["uniform"][kept])

    def _owners(self) -> dict[str, Int[np.ndarray, " _"]]:
        """Row of this moment's road user that each point lies on; -1 for none."""
        rows = {actor.track_id: row for row, actor in enumerate(self.window.actors)}
        table = np.array([rows.get(actor.track_id, -1) for actor in self.later.actors] + [-1])
        return {"gaussian": self.gaussian.actor, "uniform": table[self.uniform.actor]}

    def _times_s(self, pattern: str) -> Float[np.ndarray, " _"]:
        """When each point was measured, relative to the Gaussian sensor's reference moment."""
        later_s = 0.0 if pattern == "gaussian" else self.drive.mounted.uniform_offset_s
        return self.cloud(pattern).extra["time_ns"].astype(np.float64) * 1e-9 + later_s

    def _as_seen(
        self,
        pattern: str,
        owner: Int[np.ndarray, " n"],
        velocity_m_s: Float[np.ndarray, "m 3"],
        seen_s: Float[np.ndarray, " m"],
    ) -> Float[np.ndarray, "n 3"]:
        """Points moved with their road users to the times at which the labels show these."""
        late_s = self._times_s(pattern) - np.append(seen_s, 0.0)[owner]
        moving = np.concatenate([velocity_m_s, np.zeros((1, 3))])[owner]
        return self.cloud(pattern).points_m.astype(np.float64) - moving * late_s[:, None]
