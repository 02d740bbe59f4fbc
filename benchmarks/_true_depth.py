"""The exact depth of every pixel, by ray casting: what depth maps are measured against."""

import numpy as np
from jaxtyping import Float, Float32

from farfield.geometry.cameras import Camera
from farfield.geometry.poses import invert
from farfield.simulation.camera.cast import cast_image, place_bodies, ray_grid
from farfield.simulation.world.scene import SceneWindow


def true_depth(
    window: SceneWindow, camera: Camera, world_T_lidar: Float[np.ndarray, "4 4"]
) -> Float32[np.ndarray, "height width"]:
    """Depth along the optical axis of what each pixel's ray hits first, at the window's reference moment.

    Args:
        window: The scene.
        camera: The camera; its ``camera_T_lidar`` places it relative to ``world_T_lidar``.
        world_T_lidar: Pose of the frame that the camera is given in.

    Returns:
        Metres, NaN for the sky and beyond the distortion's fold, shape (height, width).

    Raises:
        MissingExtraError: If embreex is not installed.
    """
    grid = ray_grid(camera)
    picture = cast_image(place_bodies(window), grid, world_T_lidar @ invert(camera.camera_T_lidar))
    depth = picture.range_m * grid.directions[:, 2]
    depth[~np.isfinite(picture.range_m) | (grid.directions[:, 2] <= 0)] = np.nan
    return depth.reshape(grid.height, grid.width)
