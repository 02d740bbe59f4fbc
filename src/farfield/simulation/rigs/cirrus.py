"""The Cirrus car: two Luminars with different patterns on the roof, and a front camera.

Coordinates of a frame are the Gaussian sensor's at its reference moment; that moment names the frame.
"""

from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from farfield.frame import Annotation, Cloud, Frame, Lazy, Sensor, camera_sensor
from farfield.geometry.poses import invert, pose
from farfield.simulation import labels
from farfield.simulation.camera.mounts import cirrus_camera
from farfield.simulation.lidar.model import LUMINAR_H2, LidarModel
from farfield.simulation.lidar.rays import Scan
from farfield.simulation.lidar.sweep import SimulatedSweep, sweep
from farfield.simulation.presets import CIRRUS_SEGMENT_NAME, CIRRUS_SENSORS, Preset
from farfield.simulation.rig import FrameWriter, Rig
from farfield.simulation.rigs.drive import HALF_SWEEP_S, SimulatedDrive, SimulatedFrame
from farfield.simulation.world.scene import SceneWindow
from farfield.vocabulary.patterns import PATTERNS


class CirrusFrame(SimulatedFrame):
    """One frame of the Cirrus car."""

    @cached_property
    def window(self) -> SceneWindow:
        """The scene while the Gaussian sensor sweeps."""
        return self.drive.scene.window(self.time_s, half_span_s=HALF_SWEEP_S, behind_m=self._behind_m)

    @cached_property
    def uniform_window(self) -> SceneWindow:
        """The scene while the uniform sensor sweeps."""
        offset_s = self.drive.mounting.uniform_offset_s
        if offset_s == 0:
            return self.window
        return self.drive.scene.window(self.time_s + offset_s, half_span_s=HALF_SWEEP_S, behind_m=self._behind_m)

    @property
    def _behind_m(self) -> float:
        """How far behind the car the LiDARs see: they may face backwards."""
        return 20.0 if self.drive.mounting.ego_T_lidar[0, 0] > 0 else 260.0

    @cached_property
    def model(self) -> LidarModel:
        """The Luminars' model in this sequence."""
        preset, mounting = self.drive.preset, self.drive.mounting
        return replace(
            LUMINAR_H2,
            lines=preset.lines,
            columns=preset.columns,
            focus_deg=mounting.focus_deg,
            sigma_deg=mounting.sigma_deg,
        )

    def sweep(
        self, pattern: str, window: SceneWindow, origin_m: tuple[float | int, float | int, float | int]
    ) -> SimulatedSweep:
        """One sensor's sweep in its own frame.

        Args:
            pattern: "gaussian" or "uniform".
            window: The scene while it sweeps.
            origin_m: Where it sits, in the Gaussian sensor's frame.
        """
        drive = self.drive
        ego_T_sensor = drive.mounting.ego_T_lidar @ pose(np.eye(3), np.asarray(origin_m, dtype=np.float64))
        rng = drive.rng(pattern, self.index)
        scan = Scan.draw(self.model, rng, pattern=pattern)
        window_seed = drive.window_seed(pattern)
        return sweep(scan, self.model, window, ego_T_sensor, rng, weather=drive.weather, window_seed=window_seed)

    @cached_property
    def gaussian(self) -> SimulatedSweep:
        """The Gaussian sensor's sweep."""
        return self.sweep("gaussian", self.window, (0.0, 0.0, 0.0))

    @cached_property
    def uniform(self) -> SimulatedSweep:
        """The uniform sensor's sweep, in the Gaussian sensor's frame of this moment."""
        origin_m = self.drive.mounting.uniform_origin_m
        swept = self.sweep("uniform", self.uniform_window, origin_m)
        offset = pose(np.eye(3), np.asarray(origin_m, dtype=np.float64))
        world_T_uniform = self.uniform_window.world_T_ego_now @ self.drive.mounting.ego_T_lidar @ offset
        return SimulatedSweep(
            swept.cloud.transform(invert(self.world_T_lidar) @ world_T_uniform), swept.actor, swept.kind
        )

    def cloud(self, name: str) -> Cloud:
        """One pattern's cloud."""
        return self.gaussian.cloud if name == "gaussian" else self.uniform.cloud

    @cached_property
    def visible_objects(self) -> labels.VisibleObjects:
        """Boxes of the road users that the two patterns hit, where the Gaussian pattern's points show them."""
        boxes = self.full_boxes()
        # annotated are those ahead with enough points of both patterns together, and of the Gaussian one
        actor = self._point_actors()
        counts = {name: np.bincount(rows[rows >= 0], minlength=len(boxes)) for name, rows in actor.items()}
        annotated = (counts["gaussian"] + counts["uniform"] >= labels.MIN_POINTS_BOTH) & (
            counts["gaussian"] >= labels.MIN_POINTS_GAUSSIAN
        )
        annotated &= boxes.centre_m[:, 0] > 0
        row = np.full(len(boxes) + 1, -1)
        row[np.flatnonzero(annotated)] = np.arange(annotated.sum())
        # bodies and points move to the mean time of each body's Gaussian points
        velocity_m_s = self.window.velocity_m_s @ self.world_T_lidar[:3, :3]
        mean_s = labels.mean_times_s(self._times_s("gaussian"), actor["gaussian"], len(boxes))
        boxes = boxes.replace(centre_m=boxes.centre_m + velocity_m_s * mean_s[:, None])
        points_m = [self._points_at(name, actor[name], velocity_m_s, mean_s) for name in PATTERNS]
        # full boxes shrink to their points
        rows = row[np.concatenate([actor[name] for name in PATTERNS])]
        full = boxes[annotated].replace(point_count=counts["gaussian"][annotated])
        on_bodies_m = np.concatenate(points_m)[rows >= 0]
        visible = labels.visible_boxes(full, on_bodies_m, rows[rows >= 0]) if len(full) else full
        return labels.VisibleObjects(visible, full, counts["gaussian"][annotated], counts["uniform"][annotated])

    def _point_actors(self) -> dict[str, Int[np.ndarray, " _"]]:
        """Row of this moment's road user that each point lies on; -1 for none."""
        rows = {actor.track_id: row for row, actor in enumerate(self.window.actors)}
        table = np.array([rows.get(actor.track_id, -1) for actor in self.uniform_window.actors] + [-1])
        return {"gaussian": self.gaussian.actor, "uniform": table[self.uniform.actor]}

    def _times_s(self, pattern: str) -> Float[np.ndarray, " _"]:
        """When each point was measured, relative to the Gaussian sensor's reference moment."""
        offset_s = 0.0 if pattern == "gaussian" else self.drive.mounting.uniform_offset_s
        return self.cloud(pattern).extra["time_ns"].astype(np.float64) * 1e-9 + offset_s

    def _points_at(
        self,
        pattern: str,
        actor: Int[np.ndarray, " n"],
        velocity_m_s: Float[np.ndarray, "m 3"],
        time_s: Float[np.ndarray, " m"],
    ) -> Float[np.ndarray, "n 3"]:
        """Points moved with their road users to a time for each road user."""
        lag_s = self._times_s(pattern) - np.append(time_s, 0.0)[actor]
        moving = np.concatenate([velocity_m_s, np.zeros((1, 3))])[actor]
        return self.cloud(pattern).points_m.astype(np.float64) - moving * lag_s[:, None]

    @cached_property
    def annotation(self) -> Annotation:
        """Boxes of the visible parts, with the whole bodies and the points of each pattern."""
        objects = self.visible_objects
        return Annotation(
            boxes=objects.visible,
            moving=labels.moving(objects.visible),
            extent="visible",
            full_boxes=objects.full,
            details={"point_count_gaussian": objects.gaussian_points, "point_count_uniform": objects.uniform_points},
        )


def cirrus_frame(drive: SimulatedDrive, index: int, sensors: tuple[str, ...], time_ns: int) -> Frame:
    """A frame without its pose; nothing is simulated before it is read."""
    simulated = CirrusFrame(drive, index)
    times = {"gaussian": time_ns, "uniform": time_ns + round(drive.mounting.uniform_offset_s * 1e9)}
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
        clouds=Lazy({name: partial(simulated.cloud, name) for name in clouds}),
        images=Lazy({name: partial(simulated.camera_image, name, camera) for name, camera in cameras.items()}),
        cameras=cameras,
        load_annotation=simulated.load_annotation,
        conditions=simulated.conditions,
        simulated=True,
        metadata=simulated.metadata(),
    )


def _writer(root: Path, preset: Preset) -> FrameWriter:  # noqa: ARG001
    from farfield.datasets.cirrus import CirrusWriter

    return CirrusWriter(root)


RIG = Rig(sensors=CIRRUS_SENSORS, segment_name=CIRRUS_SEGMENT_NAME, frame=cirrus_frame, writer=_writer, caches=True)
