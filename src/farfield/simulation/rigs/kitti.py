"""The KITTI car: a Velodyne HDL-64E on the roof, and the left colour camera, in whose field objects are annotated.

Coordinates of a frame are the LiDAR's at its reference moment, when it looks straight ahead and the camera is triggered
(Geiger et al., "Vision meets Robotics: The KITTI Dataset", IJRR 2013).
"""

from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Int

from farfield.errors import ConfigError
from farfield.files.atomic import write_text
from farfield.frame import Annotation, Camera, CameraField, Cloud, Frame, Lazy, Sensor, camera_sensor
from farfield.geometry.cameras import image_boxes
from farfield.simulation import labels
from farfield.simulation.camera.mounts import kitti_camera
from farfield.simulation.lidar.model import HDL_64E, LidarModel
from farfield.simulation.lidar.rays import NearestHits, Scan
from farfield.simulation.lidar.sweep import SimulatedSweep, sweep
from farfield.simulation.presets import KITTI_SEGMENT_NAME, KITTI_SENSORS, Preset
from farfield.simulation.rig import Rig
from farfield.simulation.rigs.drive import HALF_SWEEP_S, SimulatedDrive, SimulatedFrame
from farfield.simulation.world.scene import SceneWindow

_VIEW_M = 120.0
_MIN_HITS = 5
_PARTLY, _LARGELY = 0.7, 0.3
"""Shares of an object's shots that reach it below which it counts as partly, and as largely occluded: a guess."""
MAX_FRAMES = 1000
"""Frames of a sequence that have a number of their own among KITTI's six digits; there are as many sequences."""
_FOLD = 5  # of so many sequences one is held out for validation


class KittiFrame(SimulatedFrame):
    """One frame of the KITTI car."""

    @cached_property
    def window(self) -> SceneWindow:
        """The scene while the LiDAR turns."""
        return self.drive.scene.window(
            self.time_s, half_span_s=HALF_SWEEP_S, reach_m=_VIEW_M, behind_m=HDL_64E.max_range_m
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
            drive.mounting.ego_T_lidar,
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
        return kitti_camera(self.drive.mounting.ego_T_lidar)

    @cached_property
    def annotation(self) -> Annotation:
        """Full boxes of the road users in the camera's field that the LiDAR hits at least five times.

        They stand where the turning LiDAR shows them. ``details`` hold what KITTI says of each in the image:
        ``truncation``, the share of its 2D box outside; ``occlusion``, 0 visible, 1 partly, 2 largely; and ``box_px``.
        """
        boxes = self.swept_boxes(self.sweep)
        actor = self.sweep.actor
        hits: Int[np.ndarray, " n"] = np.bincount(actor[actor >= 0], minlength=len(boxes))
        box_px, truncation = image_boxes(boxes, self.camera)
        annotated: Bool[np.ndarray, " n"] = (hits >= _MIN_HITS) & (box_px[:, 2] >= 0)
        rows = np.flatnonzero(annotated)
        boxes = boxes[rows].replace(point_count=hits[rows])
        return Annotation(
            boxes=boxes,
            moving=labels.moving(boxes),
            details={"truncation": truncation[rows], "occlusion": self._occlusion(rows), "box_px": box_px[rows]},
            region=CameraField(camera=self.camera, name="the left colour camera"),
        )

    def _occlusion(self, rows: Int[np.ndarray, " k"]) -> Int[np.ndarray, " k"]:
        """How far road users are hidden: by the share of the shots at each that nothing before it stops."""
        aimed = self.sweep.aimed
        assert aimed is not None
        alone = np.array([self._shots_alone(int(row)) for row in rows], dtype=np.float64)
        share = aimed[rows] / np.maximum(alone, 1.0)
        return np.select([share >= _PARTLY, share >= _LARGELY], [0, 1], default=2).astype(np.int64)

    def _shots_alone(self, row: int) -> int:
        """How many shots would meet a road user if nothing else were there."""
        window = self.window
        bodies = [body for body in window.bodies if body.actor == row]
        world_T_sensor = window.world_T_ego @ self.drive.mounting.ego_T_lidar
        casting = NearestHits(self.scan, bodies, world_T_sensor, window.knots_s)
        casting.see_through(np.ones(casting.range_m.shape[1], dtype=np.bool_))
        return int((casting.range_m[0] < self.model.max_range_m).sum())


def kitti_frame(drive: SimulatedDrive, index: int, sensors: tuple[str, ...], time_ns: int) -> Frame:
    """A frame without its pose; nothing is simulated before it is read.

    Raises:
        ConfigError: If KITTI's numbers do not reach to the frame.
    """
    if drive.sequence >= MAX_FRAMES or index >= MAX_FRAMES:
        raise ConfigError(
            f"{drive.preset.name}: expected at most {MAX_FRAMES} sequences of {MAX_FRAMES} frames, which KITTI's "
            f"six digits can number; got sequence {drive.sequence}, frame {index}"
        )
    simulated = KittiFrame(drive, index)
    camera = simulated.camera
    shots = 64 * drive.preset.columns
    return Frame(
        sequence=drive.segment.name,
        frame_id=f"{drive.sequence * MAX_FRAMES + index:06d}",
        time_ns=time_ns,
        sensors={
            "lidar": Sensor(kind="lidar", frame_T_sensor=np.eye(4), time_ns=time_ns, shots=shots),
            "camera": camera_sensor(camera, time_ns),
        },
        clouds=Lazy({"lidar": partial(simulated.cloud, "lidar")} if "lidar" in sensors else {}),
        images=Lazy({"camera": partial(simulated.camera_image, "camera", camera)} if "camera" in sensors else {}),
        cameras={"camera": camera},
        load_annotation=simulated.load_annotation,
        conditions=simulated.conditions,
        simulated=True,
        metadata=simulated.metadata(),
    )


class SimulatedKittiWriter:
    """Write frames of a KITTI preset under the numbers that they bear.

    Args:
        root: Folder in which ``training`` and ``ImageSets`` are made.
    """

    def __init__(self, root: Path) -> None:
        from farfield.datasets.kitti.object import KittiWriter

        self.root, self._writer = root, KittiWriter(root)

    def paths(self, frame: Frame) -> dict[str, Path]:
        """The file of each part of a frame.

        Raises:
            ConfigError: If the frame has no cloud.
        """
        if "lidar" not in frame.clouds:
            raise ConfigError("sensors: expected lidar among them, KITTI's layout has no frames without; got camera")
        kinds = ["velodyne", "calib", *(["image_2"] if "camera" in frame.images else []), "label_2"]
        return {kind: self._writer.path(kind, int(frame.frame_id)) for kind in kinds}

    def write(self, frame: Frame) -> dict[str, Path]:
        """Write a frame; returns what ``paths`` does, and raises the same."""
        paths, annotation = self.paths(frame), frame.annotation
        occlusion = None if annotation is None else annotation.details["occlusion"]
        self._writer.write(int(frame.frame_id), frame, cloud="lidar", occlusion=occlusion)
        return paths

    def finish(self) -> None:
        """Write ``ImageSets/train.txt`` and ``val.txt``: the second of every five sequences is held out."""
        names = sorted(path.stem for path in (self.root / "training" / "label_2").glob("*.txt"))
        held_out = [int(name) // MAX_FRAMES % _FOLD == 1 for name in names]
        (self.root / "ImageSets").mkdir(parents=True, exist_ok=True)
        for part, is_validation in (("train", False), ("val", True)):
            lines = [f"{name}\n" for name, held in zip(names, held_out, strict=True) if held == is_validation]
            write_text(self.root / "ImageSets" / f"{part}.txt", "".join(lines))


def _writer(root: Path, preset: Preset) -> SimulatedKittiWriter:  # noqa: ARG001
    return SimulatedKittiWriter(root)


RIG = Rig(sensors=KITTI_SENSORS, segment_name=KITTI_SEGMENT_NAME, frame=kitti_frame, writer=_writer, finishes=True)
