"""What the sensors of the Cirrus car measure at any moment, raw: no sweep is corrected for the car's motion."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Int64, UInt8

from farfield.frame import Cloud
from farfield.geometry.cameras import Camera
from farfield.geometry.poses import invert, pose
from farfield.simulation.camera.mounts import cirrus_camera
from farfield.simulation.lidar.model import LidarModel
from farfield.simulation.rigs.cirrus import CirrusFrame
from farfield.simulation.rigs.drive import HALF_SWEEP_S, SimulatedDrive

IMAGE_WIDTH_PX = 320
IMU_POSITION_M = {"imu_front": (1.2, 0.1, 0.5), "imu_rear": (-1.1, -0.2, 0.6)}
"""Where the IMUs sit, from the middle of the car's bottom, axes as the car's."""
GPS_POSITION_M = (-0.6, 0.0, 1.7)
ORIGIN_DEG = (37.0, -122.0)
"""Latitude and longitude of the world's origin; x points east, y north."""
GRAVITY_M_S2 = 9.80665
_NOISE = {"angular_rad_s": 0.001, "acceleration_m_s2": 0.02}
_BIAS = {"angular_rad_s": 0.0005, "acceleration_m_s2": 0.03}
_GPS_M = (0.01, 0.01, 0.02)
_STEP_S = 0.01
_EARTH_M, _FLATTENED = 6_378_137.0, 0.00669437999014  # semi-major axis and squared eccentricity of WGS 84


class RawFrame(CirrusFrame):
    """The Cirrus car at any moment of a drive.

    Args:
        drive: The drive.
        number: The sweep's or picture's own number, which draws its noise.
        time_s: The moment: a sweep's middle.
    """

    def __init__(self, drive: SimulatedDrive, number: int, time_s: float) -> None:
        super().__init__(drive, number)
        self.time_s = time_s

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.drive, self.index, self.time_s)

    @cached_property
    def model(self) -> LidarModel:
        """The Luminars' model, each point in the sensor's frame of its own time."""
        return replace(super().model, compensated=False)

    def swept(self, pattern: str) -> Cloud:
        """One sensor's sweep in its own coordinates; ``time_ns`` is relative to the middle of the sweep."""
        origin = self.drive.mounting.uniform_origin_m if pattern == "uniform" else (0.0, 0.0, 0.0)
        return self.sweep(pattern, self.window, origin).cloud

    def picture(self) -> UInt8[np.ndarray, "height width 3"]:
        """A small picture of the front camera."""
        from farfield.simulation.camera.render import render

        window, seed = self.drive.scene.window(self.time_s), self.drive.window_seed("camera")
        world_T_lidar = window.world_T_ego_now @ self.drive.mounting.ego_T_lidar
        rng = self.drive.rng("camera", self.index)
        return render(window, small_camera(), world_T_lidar, self.drive.weather, rng, window_seed=seed)


def small_camera() -> Camera:
    """The front camera with fewer pixels."""
    camera = cirrus_camera()
    scale = IMAGE_WIDTH_PX / camera.width_px
    height = round(camera.height_px * scale)
    return replace(
        camera, matrix=np.diag([scale, scale, 1.0]) @ camera.matrix, width_px=IMAGE_WIDTH_PX, height_px=height
    )


def cloud_of_sweep(drive: SimulatedDrive, pattern: str, number: int, start_s: float) -> Cloud:
    """One raw sweep: its points with ``t``, nanoseconds since it began."""
    cloud = RawFrame(drive, number, start_s + HALF_SWEEP_S).swept(pattern)
    since = cloud.extra["time_ns"].astype(np.int64) + round(HALF_SWEEP_S * 1e9)
    return Cloud(cloud.points_m, cloud.intensity, {"t": since.astype(np.uint32), "ring": cloud.extra["ring"]})


def mounts(drive: SimulatedDrive) -> dict[str, Float[np.ndarray, "4 4"]]:
    """Pose of each sensor in the car (x forward, y left, z up, from its bottom's middle); the camera looks along z."""
    mounting = drive.mounting
    origin = np.array(mounting.uniform_origin_m, dtype=np.float64)
    positions_m = {**IMU_POSITION_M, "gps": GPS_POSITION_M}
    return {
        "gaussian": mounting.ego_T_lidar,
        "uniform": mounting.ego_T_lidar @ pose(np.eye(3), origin),
        "camera": mounting.ego_T_lidar @ invert(small_camera().camera_T_lidar),
        **{name: pose(np.eye(3), np.array(position_m)) for name, position_m in positions_m.items()},
    }


def ego_poses(drive: SimulatedDrive, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 4 4"]:
    """Poses of the car in the world."""
    return np.stack([drive.scene.ego_pose(float(moment)) for moment in np.maximum(time_s, 0.0)])


@dataclass(frozen=True, eq=False)
class ImuTable:
    """What an IMU measured.

    Args:
        angular_rad_s: Angular velocities in its own axes, shape (n, 3).
        acceleration_m_s2: Specific forces: at rest gravity's reaction upwards, shape (n, 3).
    """

    angular_rad_s: Float[np.ndarray, "n 3"]
    acceleration_m_s2: Float[np.ndarray, "n 3"]


def imu_truth(drive: SimulatedDrive, name: str, time_s: Float[np.ndarray, " n"]) -> ImuTable:
    """Angular velocity and specific force at moments, by central differences of the car's poses over 10 ms."""
    from scipy.spatial.transform import Rotation

    middle = np.maximum(time_s, _STEP_S)
    before, now, after = (ego_poses(drive, middle + step) @ mounts(drive)[name] for step in (-_STEP_S, 0.0, _STEP_S))
    step = before[:, :3, :3].transpose(0, 2, 1) @ after[:, :3, :3]
    turn = Rotation.from_matrix(step).as_rotvec() / (2 * _STEP_S)
    push = (after[:, :3, 3] - 2 * now[:, :3, 3] + before[:, :3, 3]) / _STEP_S**2 + (0.0, 0.0, GRAVITY_M_S2)
    return ImuTable(turn, np.einsum("nji,nj->ni", now[:, :3, :3], push))


def imu_biases(rng: np.random.Generator) -> dict[str, Float[np.ndarray, " 3"]]:
    """The constant errors of an IMU: the first numbers of its stream."""
    return {name: spread * rng.standard_normal(3) for name, spread in _BIAS.items()}


def imu_measured(
    drive: SimulatedDrive, name: str, number: Int64[np.ndarray, " n"], time_s: Float[np.ndarray, " n"]
) -> ImuTable:
    """What an IMU says, with its constant errors and noise; ``number`` draws the noise."""
    true, (bias_rng, noise_rng) = imu_truth(drive, name, time_s), _streams(drive, name)
    bias, last = imu_biases(bias_rng), int(number.max(initial=-1)) + 1
    noise = noise_rng.standard_normal((last, 6))[number]
    return ImuTable(
        true.angular_rad_s + bias["angular_rad_s"] + _NOISE["angular_rad_s"] * noise[:, :3],
        true.acceleration_m_s2 + bias["acceleration_m_s2"] + _NOISE["acceleration_m_s2"] * noise[:, 3:],
    )


def biases_of(drive: SimulatedDrive, name: str) -> dict[str, list[float]]:
    """The constant errors of one IMU of a drive."""
    return {what: values.tolist() for what, values in imu_biases(_streams(drive, name)[0]).items()}


def _streams(drive: SimulatedDrive, name: str) -> tuple[np.random.Generator, np.random.Generator]:
    number = ("imu_front", "imu_rear", "gps").index(name)
    key = np.random.SeedSequence((drive.seed, drive.sequence), spawn_key=(10, number))
    bias, noise = np.random.default_rng(key).spawn(2)
    return bias, noise


def fixes(
    drive: SimulatedDrive, number: Int64[np.ndarray, " n"], time_s: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 3"]:
    """What the GPS says, with noise of 1 cm: latitude and longitude in degrees, height in metres, shape (n, 3)."""
    position_m = (ego_poses(drive, time_s) @ mounts(drive)["gps"])[:, :3, 3]
    noise = _streams(drive, "gps")[1].standard_normal((int(number.max(initial=-1)) + 1, 3))[number]
    east, north, up = (position_m + noise * _GPS_M).T
    return np.stack([*_degrees(east, north), up], axis=1)


def _degrees(east_m: Float[np.ndarray, " n"], north_m: Float[np.ndarray, " n"]) -> list[Float[np.ndarray, " n"]]:
    """Latitude and longitude of positions near the origin, by the radii of curvature there."""
    latitude = np.radians(ORIGIN_DEG[0])
    across = _EARTH_M / np.sqrt(1 - _FLATTENED * np.sin(latitude) ** 2)
    along = across * (1 - _FLATTENED) / (1 - _FLATTENED * np.sin(latitude) ** 2)
    around = across * np.cos(latitude)
    return [
        ORIGIN_DEG[0] + np.degrees(north_m / along),
        ORIGIN_DEG[1] + np.degrees(east_m / around),
    ]
