"""One sequence at work: its world, its weather, its mounting; drawn once, the same for every sensor."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from farfield.frame import Annotation, Boxes, Camera, Cloud, Constant, Lazy
from farfield.geometry.poses import invert, pose_from_yaw
from farfield.simulation import labels
from farfield.simulation.lidar.sweep import SimulatedSweep
from farfield.simulation.presets import Mounting, Number, Preset, Segment
from farfield.simulation.weather.conditions import Weather, draw_weather
from farfield.simulation.world.scene import SceneWindow, WorldScene

HALF_SWEEP_S = 0.05  # every LiDAR turns at 10 Hz, half before and half after a frame's moment

# Each sensor draws from a stream of its own: adding one changes no other, and no traffic.
_STREAMS = {
    name: number
    for number, name in enumerate(
        (
            "gaussian",
            "uniform",
            "camera",
            "os2-64",
            "os1-128",
            "radar",
            "cam-front",
            "cam-front-right",
            "cam-left",
            "cam-left-right",
            "cam-right",
            "cam-right-right",
            "cam-rear",
            "cam-rear-right",
            "lidar",
            "turning",
        )
    )
}


@dataclass(frozen=True, eq=False)
class DrawnMounting:
    """What was drawn from a preset's :class:`~farfield.simulation.presets.Mounting` for one sequence."""

    ego_T_lidar: Float[np.ndarray, "4 4"]
    focus_deg: float
    sigma_deg: float
    uniform_origin_m: tuple[Number, Number, Number]
    uniform_offset_s: float
    radar_offset_s: float


@dataclass(frozen=True, eq=False)
class SimulatedDrive:
    """One sequence.

    Args:
        preset: What is simulated.
        seed: Seed of the whole data set.
        sequence: Number of the sequence.
    """

    preset: Preset
    seed: int
    sequence: int

    def __reduce__(self) -> tuple[Any, ...]:
        return drive_of, (self.preset, self.seed, self.sequence)  # worlds do not travel: the receiver builds its own

    @cached_property
    def segment(self) -> Segment:
        """Its name, road, weather and length."""
        return self.preset.segment(self.sequence)

    @cached_property
    def scene(self) -> WorldScene:
        """Its world."""
        return WorldScene(
            self.segment.road,
            self._seeds[0],
            duration_s=self.segment.duration_s,
            sizes=self._choices[0],
            traffic=self.preset.traffic,
            world=self.preset.world,
        )

    @cached_property
    def weather(self) -> Weather:
        """Its weather."""
        return draw_weather(self.segment.condition, self.segment.time, np.random.default_rng(self._seeds[1]))

    @cached_property
    def mounting(self) -> DrawnMounting:
        """How its sensors are mounted."""
        return self._choices[1]

    @cached_property
    def _choices(self) -> tuple[str, DrawnMounting]:
        rng = np.random.default_rng(self._seeds[2])
        sizes = self.preset.sizes[int(rng.random() * len(self.preset.sizes))]
        mounting = self.preset.mountings[int(rng.random() * len(self.preset.mountings))]
        return sizes, _mount(mounting, rng)

    @cached_property
    def _seeds(self) -> list[np.random.SeedSequence]:
        return np.random.SeedSequence((self.seed, self.sequence)).spawn(3)

    def time_s(self, index: int) -> float:
        """The moment of a frame within the sequence; the first sweep begins at 0."""
        return HALF_SWEEP_S + float(index * self.preset.stride_s)

    def rng(self, sensor: str, index: int) -> np.random.Generator:
        """The stream of one sensor in one frame."""
        return np.random.default_rng(self.seeds(sensor, index))

    def seeds(self, sensor: str, index: int) -> np.random.SeedSequence:
        """The seed of one sensor in one frame."""
        return np.random.SeedSequence((self.seed, self.sequence, index), spawn_key=(7, _STREAMS[sensor]))

    def window_seed(self, sensor: str) -> np.random.SeedSequence:
        """The seed of what grows on one sensor's window over the whole sequence."""
        return np.random.SeedSequence((self.seed, self.sequence), spawn_key=(8, _STREAMS[sensor]))


def _draw(span: tuple[Number, Number], rng: np.random.Generator) -> float:
    return float(span[0] + (span[1] - span[0]) * rng.random())


def _mount(mounting: Mounting, rng: np.random.Generator) -> DrawnMounting:
    height_m, focus_deg, sigma_deg = (
        _draw(span, rng) for span in (mounting.height_m, mounting.focus_deg, mounting.sigma_deg)
    )
    facing = mounting.facing_deg[int(rng.random() * len(mounting.facing_deg))]
    uniform_s, radar_s = (_draw(span, rng) / 1000 for span in (mounting.uniform_offset_ms, mounting.radar_offset_ms))
    ego_T_lidar = pose_from_yaw(float(np.deg2rad(facing)), (0.0, 0.0, height_m))
    return DrawnMounting(ego_T_lidar, focus_deg, sigma_deg, mounting.uniform_origin_m, uniform_s, radar_s)


@lru_cache(maxsize=2)
def drive_of(preset: Preset, seed: int, sequence: int) -> SimulatedDrive:
    """The sequence of a preset; building its world takes a fraction of a second, so the last ones stay in memory."""
    return SimulatedDrive(preset, seed, sequence)


class SimulatedFrame(ABC):
    """One frame of a sequence: everything is measured when it is first read, and pickled without what was measured.

    Args:
        drive: The sequence.
        index: Number of the frame.
    """

    def __init__(self, drive: SimulatedDrive, index: int) -> None:
        self.drive = drive
        self.index = index
        self.time_s = drive.time_s(index)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.drive, self.index)

    @cached_property
    @abstractmethod
    def window(self) -> SceneWindow:
        """The scene while the reference sensor measures."""

    @cached_property
    def world_T_lidar(self) -> Float[np.ndarray, "4 4"]:
        """Pose of the reference LiDAR."""
        return self.window.world_T_ego_now @ self.drive.mounting.ego_T_lidar

    @abstractmethod
    def cloud(self, name: str) -> Cloud:
        """One cloud."""

    @cached_property
    @abstractmethod
    def annotation(self) -> Annotation:
        """What its annotators would draw."""

    def load_annotation(self) -> Annotation:
        """The annotation, as a function that pickles with the frame."""
        return self.annotation

    def camera_image(self, name: str, camera: Camera) -> UInt8[np.ndarray, "height width 3"]:
        """What a camera sees at the reference moment; its name draws the noise, and the dirt on its window."""
        from farfield.simulation.camera.render import render

        rng = self.drive.rng(name, self.index)
        window_seed = self.drive.window_seed(name)
        return render(self.window, camera, self.world_T_lidar, self.drive.weather, rng, window_seed=window_seed)

    def full_boxes(self) -> Boxes:
        """Boxes of all road users of the scene at the reference moment, in the reference LiDAR's frame."""
        window = self.window
        return labels.full_boxes(
            window.actors, window.bottom_m, window.yaw_rad, window.velocity_m_s, invert(self.world_T_lidar)
        )

    def swept_boxes(self, sweep: SimulatedSweep) -> Boxes:
        """Full boxes where the sweep of a turning LiDAR, not corrected for the car's own motion, shows the bodies."""
        boxes = self.full_boxes()
        time_s = sweep.cloud.extra["time_ns"].astype(np.float64) * 1e-9
        mean_s = labels.mean_times_s(time_s, sweep.actor, len(boxes))
        velocity_m_s = (self.window.velocity_m_s - self.window.ego_velocity_m_s) @ self.world_T_lidar[:3, :3]
        return boxes.replace(centre_m=boxes.centre_m + velocity_m_s * mean_s[:, None])

    def metadata(self) -> Lazy:
        """What was simulated, for people."""
        return Lazy(
            {
                "preset": Constant(self.drive.preset.name),
                "seed": Constant(self.drive.seed),
                "weather": partial(getattr, self.drive, "weather"),
            }
        )

    @property
    def conditions(self) -> dict[str, str]:
        """Road, weather and time of the day."""
        segment = self.drive.segment
        return {"road": segment.road, "weather": segment.condition, "time": segment.time}
