"""The depth map of a frame: which cloud, which camera, and the way from one to the other."""

from dataclasses import replace

import numpy as np

from farfield.depth.maps import MAX_GAP_DEG, DepthMap, Method, depth_map
from farfield.errors import DatasetError
from farfield.frame import Cloud, Frame
from farfield.geometry.cameras import Camera
from farfield.geometry.poses import invert


def frame_depth(
    frame: Frame,
    *,
    cloud: str | None = None,
    camera: str | None = None,
    method: Method = "auto",
    max_gap_deg: float = MAX_GAP_DEG,
) -> DepthMap:
    """Make the depth map of one of a frame's cameras from one of its clouds.

    Args:
        frame: The frame.
        cloud: Name of the cloud; the first of a LiDAR unless given.
        camera: Name of the camera; the first calibrated one unless given.
        method: As of :func:`~farfield.depth.maps.depth_map`.
        max_gap_deg: As there.

    Raises:
        DatasetError: If there is no such cloud or camera, or nothing says how the cloud stands to the camera.
        ConfigError: As :func:`~farfield.depth.maps.depth_map`.
    """
    points, seen_by = cloud_and_camera(frame, cloud, camera)
    ring = points.extra.get("ring")
    return depth_map(
        points.points_m,
        seen_by,
        method=method,
        ring=None if ring is None else ring.astype(np.int64),
        max_gap_deg=max_gap_deg,
    )


def cloud_and_camera(frame: Frame, cloud: str | None = None, camera: str | None = None) -> tuple[Cloud, Camera]:
    """A cloud in its sensor's own axes, and a camera whose pose refers to them; see :func:`frame_depth`."""
    name = _cloud_name(frame, cloud)
    lens = _camera(frame, camera)
    points, sensor = frame.cloud(name), frame.sensors.get(name)
    pose = None if sensor is None else sensor.frame_T_sensor
    if sensor is not None and not sensor.in_frame:
        if pose is None:
            raise DatasetError(
                f"frame {frame.key}: cloud {name} keeps its sensor's own axes, and nothing says where that stands; "
                "take another with cloud=, or give the data set the sensor's pose"
            )
        return points, replace(lens, camera_T_lidar=lens.camera_T_lidar @ pose)
    if pose is None:
        return points, lens
    return points.transform(invert(pose)), replace(lens, camera_T_lidar=lens.camera_T_lidar @ pose)


def _cloud_name(frame: Frame, cloud: str | None) -> str:
    if cloud is not None:
        if cloud not in frame.clouds:
            raise DatasetError(
                f"frame {frame.key}: expected cloud {cloud!r}, found {', '.join(frame.clouds) or 'none'}"
            )
        return cloud
    lidars = [name for name in frame.clouds if name not in frame.sensors or frame.sensors[name].kind == "lidar"]
    if not lidars:
        raise DatasetError(f"frame {frame.key}: expected a LiDAR's cloud, found {', '.join(frame.clouds) or 'none'}")
    return lidars[0]


def _camera(frame: Frame, camera: str | None) -> Camera:
    known = ", ".join(frame.cameras) or "none (Cirrus: name your calibration in the mapping)"
    if camera is not None and camera not in frame.cameras:
        raise DatasetError(f"frame {frame.key}: expected calibrated camera {camera!r}, found {known}")
    name = camera or next(iter(frame.cameras), None)
    if name is None:
        raise DatasetError(f"frame {frame.key}: expected a calibrated camera, found {known}")
    lens = frame.cameras[name]
    if lens.width_px and lens.height_px:
        return lens
    if name not in frame.images:
        raise DatasetError(f"frame {frame.key}: expected the size of camera {name!r} or its image, found neither")
    height, width = frame.images[name].shape[:2]
    return replace(lens, width_px=width, height_px=height)
