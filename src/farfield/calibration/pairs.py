"""LiDAR to camera from picked pairs of points and pixels: robust PnP, then least squares with sigma.

A guessed focal length and twelve pairs are enough to begin with: the focal length is then solved for too. Needs OpenCV
(extra ``privacy``) for the start from nothing; with a start it needs none.
"""

from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec

import numpy as np
from jaxtyping import Bool, Float

from farfield.calibration.edges import PARAMETERS as POSE
from farfield.calibration.edges import move_camera
from farfield.calibration.problems import Parameter, Solution, solve
from farfield.errors import ConfigError, MissingExtraError
from farfield.geometry.cameras import Camera
from farfield.geometry.poses import pose, transform_points

LEAST_PAIRS = 6
PAIRS_FOR_FOCAL = 12
_REPROJECTION_PX = 12.0
_HUBER = 3.0  # sigmas: a lower limit would hold back two of five good picks of two coordinates each
_FOCAL = Parameter(name="focal length", unit="", scale=0.002, prior_sigma=0.3)


@dataclass(frozen=True, eq=False, kw_only=True)
class PairCalibration:
    """What was found.

    Args:
        camera: The camera.
        solution: Turns, shifts and, if it was free, the logarithm of the focal length's factor, from the PnP's start.
        residual_px: Distance of each pick from its projection, shape (n,).
        inlier: Picks within the PnP's threshold, shape (n,).
    """

    camera: Camera
    solution: Solution
    residual_px: Float[np.ndarray, " n"]
    inlier: Bool[np.ndarray, " n"]


def calibrate_pairs(
    points_m: Float[np.ndarray, "n 3"],
    pixels: Float[np.ndarray, "n 2"],
    camera: Camera,
    *,
    sigma_px: float = 2.0,
    focal: bool = False,
    from_nothing: bool = True,
) -> PairCalibration:
    """Solve a camera's pose, and its focal length if asked, from picked pairs.

    Args:
        points_m: Picked points in the LiDAR's frame.
        pixels: Their pixels.
        camera: Intrinsics, and with ``from_nothing=False`` the pose to begin with.
        sigma_px: Noise of the hand.
        focal: Free the focal length; takes twelve pairs.
        from_nothing: Begin with RANSAC over PnP (SQPnP), whatever the camera's pose.

    Raises:
        ConfigError: If there are too few pairs, or no pose explains six of them.
        MissingExtraError: If OpenCV is not there.
    """
    least = PAIRS_FOR_FOCAL if focal else LEAST_PAIRS
    if len(points_m) < least or len(points_m) != len(pixels):
        raise ConfigError(f"pairs: expected {least} points with a pixel each, got {len(points_m)} and {len(pixels)}")
    start, inlier = camera, np.ones(len(points_m), dtype=bool)
    if from_nothing:
        start, inlier = _best_start(points_m, pixels, camera, focal=focal)
    wide = tuple(replace(each, prior_sigma=each.prior_sigma * 30) for each in POSE)
    parameters = (*wide, _FOCAL) if focal else wide
    residuals = partial(_residuals, points_m=points_m, pixels=pixels, camera=start, sigma_px=sigma_px)
    solution = solve(residuals, np.zeros(len(parameters)), parameters, huber=_HUBER)
    found = adjust_camera(start, solution.value)
    return PairCalibration(camera=found, solution=solution, residual_px=solution.after * sigma_px, inlier=inlier)


def adjust_camera(camera: Camera, value: Float[np.ndarray, " k"]) -> Camera:
    """A camera moved by the first six values, its focal lengths times exp of the seventh."""
    there = move_camera(camera, value[:6])
    if len(value) == 6:
        return there
    matrix = there.matrix.copy()
    matrix[0, 0] *= np.exp(value[6])
    matrix[1, 1] *= np.exp(value[6])
    return replace(there, matrix=matrix)


def _residuals(
    value: Float[np.ndarray, " k"],
    points_m: Float[np.ndarray, "n 3"],
    pixels: Float[np.ndarray, "n 2"],
    camera: Camera,
    sigma_px: float,
) -> Float[np.ndarray, "n 2"]:
    there = adjust_camera(camera, value)
    depth = transform_points(there.camera_T_lidar, points_m)[:, 2]
    seen, _, _ = replace(there, width_px=0, height_px=0).project(points_m)
    return np.where((depth > 0.1)[:, None], (seen - pixels) / sigma_px, 100.0)


def _best_start(
    points_m: Float[np.ndarray, "n 3"], pixels: Float[np.ndarray, "n 2"], camera: Camera, *, focal: bool
) -> tuple[Camera, Bool[np.ndarray, " n"]]:
    """The pose with most inliers, over a few focal lengths if that is free."""
    if find_spec("cv2") is None:
        raise MissingExtraError("opencv-python-headless", "privacy", "calibrating from pairs without a start")
    factors = np.log([0.6, 0.75, 0.9, 1.0, 1.15, 1.35, 1.7]) if focal else np.zeros(1)
    tried = [_ransac(points_m, pixels, adjust_camera(camera, np.append(np.zeros(6), factor))) for factor in factors]
    good = [each for each in tried if each is not None]
    if not good:
        raise ConfigError("pairs: no pose explains six of them. Check the picks, their order and the focal length.")
    return max(good, key=_inliers)


def _inliers(start: tuple[Camera, Bool[np.ndarray, " n"]]) -> int:
    return int(start[1].sum())


def _ransac(
    points_m: Float[np.ndarray, "n 3"], pixels: Float[np.ndarray, "n 2"], camera: Camera
) -> tuple[Camera, Bool[np.ndarray, " n"]] | None:
    import cv2

    done, turn, shift, chosen = cv2.solvePnPRansac(
        np.ascontiguousarray(points_m, float),
        np.ascontiguousarray(pixels, float),
        camera.matrix,
        camera.distortion,
        reprojectionError=_REPROJECTION_PX,
        iterationsCount=500,
        flags=cv2.SOLVEPNP_SQPNP,
    )
    if not done or chosen is None or len(chosen) < LEAST_PAIRS:
        return None
    rotation = cv2.Rodrigues(turn)[0]
    inlier = np.zeros(len(points_m), dtype=bool)
    inlier[chosen.ravel()] = True
    return replace(camera, camera_T_lidar=pose(rotation, shift.ravel())), inlier
