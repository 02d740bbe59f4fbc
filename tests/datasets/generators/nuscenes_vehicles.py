"""The vehicles of the nuScenes family: which sensors they have and where, classes and scenes of each dialect."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .scene import Scene, pose_of, rotation_x, rotation_z


@dataclass(frozen=True)
class Mount:
    """A sensor on the vehicle: where, how late after the sample, and how much it measures beside the objects."""

    channel: str
    modality: str
    ego_T_sensor: np.ndarray
    late_us: int = 0
    clutter: int = 0


def forward_is_y(place_m: Sequence[float], yaw_rad: float = 0.0) -> np.ndarray:
    """A LiDAR whose y looks ahead, as nuScenes' does, a little tilted."""
    return pose_of(rotation_z(yaw_rad - np.pi / 2) @ rotation_x(0.013), place_m)


def camera(place_m: Sequence[float], yaw_rad: float) -> np.ndarray:
    """Axes x right, y down, z ahead."""
    axes = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    return pose_of(rotation_z(yaw_rad) @ axes, place_m)


NUSCENES = (
    Mount("LIDAR_TOP", "lidar", forward_is_y((0.94, 0.02, 1.84)), 0, 61),
    Mount("RADAR_FRONT", "radar", pose_of(rotation_z(0.02), (3.41, 0.0, 0.5)), 31_207, 5),
    Mount("RADAR_BACK_LEFT", "radar", pose_of(rotation_z(2.9), (-0.56, 0.62, 0.53)), -22_113, 11),
    Mount("CAM_FRONT", "camera", camera((1.7, 0.02, 1.5), 0.01), -35_489),
    Mount("CAM_BACK", "camera", camera((0.03, 0.0, 1.55), np.pi - 0.02), -10_414),
)
TRUCKSCENES = (
    Mount("LIDAR_LEFT", "lidar", pose_of(rotation_z(1.1) @ rotation_x(0.02), (4.9, 1.3, 2.0)), 21_004, 41),
    Mount("LIDAR_RIGHT", "lidar", pose_of(rotation_z(-1.2), (4.9, -1.3, 2.0)), -17_392, 43),
    Mount("LIDAR_TOP_FRONT", "lidar", pose_of(rotation_z(0.01), (5.2, 0.1, 3.4)), 0, 53),
    Mount("LIDAR_TOP_LEFT", "lidar", pose_of(rotation_z(0.6), (5.1, 1.2, 3.3)), 8_004, 57),
    Mount("LIDAR_TOP_RIGHT", "lidar", pose_of(rotation_z(-0.6), (5.1, -1.2, 3.3)), 12_870, 59),
    Mount("LIDAR_REAR", "lidar", pose_of(rotation_z(np.pi), (-0.9, 0.0, 1.1)), 33_100, 67),
    Mount("RADAR_LEFT_FRONT", "radar", pose_of(rotation_z(0.7), (5.3, 1.1, 0.7)), 14_600, 3),
    Mount("RADAR_RIGHT_FRONT", "radar", pose_of(rotation_z(-0.7), (5.3, -1.1, 0.7)), -9_500, 7),
    Mount("RADAR_LEFT_SIDE", "radar", pose_of(rotation_z(1.6), (3.0, 1.2, 0.8)), 5_200, 9),
    Mount("RADAR_RIGHT_SIDE", "radar", pose_of(rotation_z(-1.6), (3.0, -1.2, 0.8)), 27_300, 13),
    Mount("RADAR_LEFT_BACK", "radar", pose_of(rotation_z(2.6), (-0.8, 1.1, 0.9)), -3_100, 15),
    Mount("RADAR_RIGHT_BACK", "radar", pose_of(rotation_z(-2.6), (-0.8, -1.1, 0.9)), 19_900, 17),
    Mount("CAMERA_LEFT_FRONT", "camera", camera((5.1, 0.9, 2.2), 0.4), 4_200),
    Mount("CAMERA_RIGHT_BACK", "camera", camera((5.0, -0.9, 2.2), -2.6), 7_300),
)
T4 = (
    Mount("LIDAR_CONCAT", "lidar", np.eye(4), 0, 71),
    Mount("CAM_FRONT", "camera", camera((1.7, 0.02, 1.5), 0.01), 23_000),
    Mount("CAM_BACK", "camera", camera((0.0, 0.0, 1.5), 3.1), -11_000),
)
NAMES = {
    "nuscenes": {
        "car": ("vehicle.car", "vehicle"),
        "truck": ("vehicle.truck", "large_vehicle"),
        "bicycle": ("vehicle.bicycle", "bicycle"),
        "pedestrian": ("human.pedestrian.adult", "pedestrian"),
    },
    "t4": {
        "car": ("car", "vehicle"),
        "truck": ("truck", "large_vehicle"),
        "bicycle": ("bicycle", "bicycle"),
        "pedestrian": ("pedestrian", "pedestrian"),
    },
}


@dataclass(frozen=True)
class Dialect:
    """What a tree of the schema is like."""

    name: str
    mounts: Sequence[Mount]
    scenes: Mapping[str, Scene]
    names: Mapping[str, tuple[str, str | None]]
    visibility: Sequence[str | int]
    sweeps: int = 2


DIALECTS = {
    "nuscenes": Dialect(
        "nuscenes",
        NUSCENES,
        {
            "scene-0061": Scene(3, (411.3, 1180.9, 0.0), 0.9),
            "scene-0103": Scene(4, (600.1, 1647.5, 0.0), -2.2),
        },
        NAMES["nuscenes"],
        ("v0-40", "v40-60", "v60-80", "v80-100"),
    ),
    "truckscenes": Dialect(
        "truckscenes",
        TRUCKSCENES,
        {
            "scene-0044384af3d8494e913fb8b14915239e-10": Scene(5, (605_017.25, 5_345_921.5, 0.0), 1.3),
            "scene-3e90a0c5d5d4409b9a3ba4a8ff4f4e2c-2": Scene(6, (611_400.0, 5_361_009.75, 0.0), -0.4),
        },
        NAMES["nuscenes"],
        (1, 2, 3, 4),
    ),
    "t4": Dialect(
        "t4",
        T4,
        {"x2_dev_0001": Scene(8, (89_612.375, 42_519.75, 3.125), 2.6)},
        NAMES["t4"],
        ("full", "most", "partial", "none"),
    ),
}
