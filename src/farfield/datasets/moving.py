"""Move a whole frame rigidly: clouds, boxes, poses and cameras."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from farfield.frame import Boxes, Frame, Lazy
from farfield.geometry.poses import invert


def move_frame(frame: Frame, target_T_lidar: Float[np.ndarray, "4 4"]) -> Frame:
    """Express a frame in other coordinates.

    Args:
        frame: The frame; its clouds stay unread until they are asked for. Radar products are not moved.
        target_T_lidar: Maps the frame's coordinates to the new ones.

    Returns:
        The moved frame. Boxes within ``metadata`` (such as ``full_boxes``) move too.
    """
    lidar_T_target = invert(target_T_lidar)

    def moved_cloud(name: str) -> Callable[[], Any]:
        return lambda: frame.clouds[name].transform(target_T_lidar)

    def moved_value(key: str) -> Callable[[], Any]:
        def load() -> Any:
            value = frame.metadata[key]
            return value.transform(target_T_lidar) if isinstance(value, Boxes) else value

        return load

    def moved_boxes() -> Boxes:
        boxes = frame.boxes
        return Boxes.empty() if boxes is None else boxes.transform(target_T_lidar)

    return replace(
        frame,
        clouds=Lazy({name: moved_cloud(name) for name in frame.clouds}),
        cameras={
            name: replace(camera, camera_T_lidar=camera.camera_T_lidar @ lidar_T_target)
            for name, camera in frame.cameras.items()
        },
        annotation=None if frame.annotation is None else moved_boxes,
        world_T_lidar=None if frame.world_T_lidar is None else frame.world_T_lidar @ lidar_T_target,
        metadata=Lazy({key: moved_value(key) for key in frame.metadata} | {"target_T_lidar": lambda: target_T_lidar}),
    )
