"""The cameras of the two rigs, where they sit on the ego vehicle, and what they look like seen from a LiDAR.

K-Radar: four ZED 2i stereo cameras of 1280 x 720 pixels an eye. Matrix and distortion are those of its calibration
files (fx 567.72, fy 577.21, cx 628.72, cy 369.31; k1 -0.02887, k2 0.000602, p1 0.003957, p2 -0.005047, k3 0); the
baseline of 0.12 m is the maker's. Cirrus: one front camera of 1920 x 650 pixels; its focal length of 1428 pixels (68
degrees across) follows the calibration in its first author's code, its principal point, mild distortion and all mounts
are assumed. KITTI: the left colour camera after rectification, of 1242 x 375 pixels, with matrix and place of the
calibration of its drives of 2011_09_26 (Geiger et al., IJRR 2013).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from farfield.errors import ConfigError
from farfield.geometry.cameras import CAMERA_T_LIDAR_AXES, Camera
from farfield.geometry.poses import invert, pose, pose_from_yaw

STEREO_BASELINE_M = 0.12
_SIDES = ("front", "left", "right", "rear")
_RACK_M = 2.0  # height of the LiDAR at which the place of Cirrus' camera on the rack was chosen


@dataclass(frozen=True)
class Lens:
    """A camera's intrinsics.

    Args:
        matrix: fx, fy, cx, cy in pixels.
        distortion: k1, k2, p1, p2, k3 (OpenCV's order).
        width_px: Image width.
        height_px: Image height.
    """

    matrix: tuple[float, float, float, float]
    distortion: tuple[float, float, float, float, float]
    width_px: int
    height_px: int


ZED_2I = Lens((567.72, 577.21, 628.72, 369.31), (-0.02887, 0.000602, 0.003957, -0.005047, 0.0), 1280, 720)
CIRRUS_FRONT = Lens((1428.27, 1426.04, 943.34, 300.0), (-0.04, 0.008, 0.0004, -0.0003, 0.0), 1920, 650)
KITTI_LEFT = Lens((721.5377, 721.5377, 609.5593, 172.854), (0.0, 0.0, 0.0, 0.0, 0.0), 1242, 375)


@dataclass(frozen=True)
class Mount:
    """A camera and its place on the ego vehicle (x forward, y left, z up, from the middle of the vehicle's bottom).

    Args:
        lens: Its intrinsics.
        place_m: Its optical centre.
        yaw_deg: Where it looks, counter-clockwise from straight ahead.
    """

    lens: Lens
    place_m: tuple[float, float, float]
    yaw_deg: float = 0.0

    @property
    def ego_T_mount(self) -> Float[np.ndarray, "4 4"]:
        """Pose in the ego vehicle, with LiDAR-like axes: x where the camera looks, y left, z up."""
        return pose_from_yaw(float(np.radians(self.yaw_deg)), np.array(self.place_m))

    def camera(self, ego_T_lidar: Float[np.ndarray, "4 4"]) -> Camera:
        """The camera as seen from a LiDAR that is mounted at ``ego_T_lidar``."""
        fx, fy, cx, cy = self.lens.matrix
        return Camera(
            matrix=np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
            distortion=np.array(self.lens.distortion),
            camera_T_lidar=CAMERA_T_LIDAR_AXES @ invert(self.ego_T_mount) @ ego_T_lidar,
            width_px=self.lens.width_px,
            height_px=self.lens.height_px,
        )


def _stereo(side: str, x_m: float, y_m: float, z_m: float, yaw_deg: float) -> dict[str, Mount]:
    """Two eyes beside each other, STEREO_BASELINE_M apart across the direction of view."""
    left = np.array([-np.sin(np.radians(yaw_deg)), np.cos(np.radians(yaw_deg))]) * STEREO_BASELINE_M / 2
    return {
        f"{side}_left": Mount(ZED_2I, (x_m + float(left[0]), y_m + float(left[1]), z_m), yaw_deg),
        f"{side}_right": Mount(ZED_2I, (x_m - float(left[0]), y_m - float(left[1]), z_m), yaw_deg),
    }


KRADAR_MOUNTS: dict[str, Mount] = {
    **_stereo("front", 0.9, 0.0, 1.45, 0.0),
    **_stereo("left", 0.0, 0.55, 1.5, 90.0),
    **_stereo("rear", -1.1, 0.0, 1.5, 180.0),
    **_stereo("right", 0.0, -0.55, 1.5, -90.0),
}
CIRRUS_MOUNTS: dict[str, Mount] = {"front": Mount(CIRRUS_FRONT, (0.4, 0.0, 1.75))}
KITTI_MOUNTS: dict[str, Mount] = {"left": Mount(KITTI_LEFT, (0.30, 0.04, 1.65))}  # 0.3 m ahead of and below the LiDAR's
MOUNTS: dict[str, dict[str, Mount]] = {"kradar": KRADAR_MOUNTS, "cirrus": CIRRUS_MOUNTS, "kitti": KITTI_MOUNTS}


def rig_cameras(rig: str, ego_T_lidar: Float[np.ndarray, "4 4"]) -> dict[str, Camera]:
    """All cameras of a rig, as seen from a LiDAR.

    Args:
        rig: "kradar", "cirrus" or "kitti".
        ego_T_lidar: Pose of the LiDAR in the ego vehicle (middle of its bottom, x forward).

    Returns:
        Cameras by name, such as "front_left".

    Raises:
        ConfigError: If the rig is unknown.
    """
    if rig not in MOUNTS:
        raise ConfigError(f"camera rig: expected one of {', '.join(MOUNTS)}; got {rig!r}")
    return {name: mount.camera(ego_T_lidar) for name, mount in MOUNTS[rig].items()}


def kradar_cameras(ego_T_lidar: Float[np.ndarray, "4 4"]) -> dict[str, Camera]:
    """Left and right eyes of K-Radar's four stereo cameras, by its names: ``cam-front``, ``cam-front-right``..."""
    eyes = rig_cameras("kradar", ego_T_lidar)
    names = {"left": "", "right": "-right"}
    return {f"cam-{side}{names[eye]}": eyes[f"{side}_{eye}"] for side in _SIDES for eye in names}


def cirrus_camera() -> Camera:
    """The front camera; it stands on the LiDARs' rack, so that one calibration holds for all sequences."""
    (camera,) = rig_cameras("cirrus", pose(np.eye(3), np.array([0.0, 0.0, _RACK_M]))).values()
    return camera


def kitti_camera(ego_T_lidar: Float[np.ndarray, "4 4"]) -> Camera:
    """The left colour camera, rectified."""
    (camera,) = rig_cameras("kitti", ego_T_lidar).values()
    return camera
