"""LiDAR to camera from picked pairs of points and pixels: robust PnP, then least squares with sigma.

Unknown are turns and shifts of the pose and, if it is free, the logarithm of a factor on the focal lengths; residuals
are distances of projections from the picks, over the hand's noise. A guessed focal length and twelve pairs are enough
to begin with. Needs OpenCV (extra ``privacy``) for the start from nothing; with a start it needs none.
"""

from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from farfield.calibration.camera_edges import PARAMETERS as POSE
from farfield.calibration.camera_edges import move_camera
from farfield.calibration.least_squares import Parameter, Solution, solve
from farfield.errors import ConfigError, FileFormatError, MissingExtraError
from farfield.files.ascii_table import parse_table
from farfield.files.atomic import read_bytes
from farfield.geometry.cameras import Camera
from farfield.geometry.poses import pose, transform_points
from farfield.vocabulary.counts import count_of

LEAST_PAIRS = 6
PAIRS_FOR_FOCAL = 12
_REPROJECTION_PX = 12.0
_HUBER = 3.0  # sigmas: a lower limit would hold back two of five good picks of two coordinates each
_FOCAL = Parameter(name="focal length", unit="", scale=0.002, prior_sigma=0.3)
_FOCAL_FACTORS = (0.6, 0.75, 0.9, 1.0, 1.15, 1.35, 1.7)
_WIDE = 30  # times the prior of a camera that is aligned by edges
_SPREAD = 0.2  # of the picture, and of the distance: picks nearer to one another tell little
_FARTHEST_M, _WIDEST_PX = 1e4, 1e6
_LINE = 1e-3  # share of their length that picks stand beside a line: less is no width
_MAX_BYTES = 1 << 20
_HEADER = "x_m,y_m,z_m,u_px,v_px"


@dataclass(frozen=True, eq=False, kw_only=True)
class PairCalibration:
    """A camera from picked pairs.

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
        points_m: Picked points in the LiDAR's frame, shape (n, 3).
        pixels: Their pixels, shape (n, 2).
        camera: Intrinsics, and with ``from_nothing=False`` the pose to begin with.
        sigma_px: Noise of the hand.
        focal: Free the focal length; takes twelve pairs.
        from_nothing: Begin with RANSAC over PnP (SQPnP), whatever the camera's pose.

    Raises:
        ConfigError: If there are too few pairs, they are no measurements of one scene, or no pose explains six of them.
        MissingExtraError: If OpenCV is not there.
    """
    least = PAIRS_FOR_FOCAL if focal else LEAST_PAIRS
    if len(points_m) < least or len(points_m) != len(pixels):
        raise ConfigError(f"pairs: expected {least} points with a pixel each, got {len(points_m)} and {len(pixels)}")

    _check_spread(points_m, pixels)

    # 1. The start: the pose of PnP with most inliers.
    start, inlier = camera, np.ones(len(points_m), dtype=bool)
    if from_nothing:
        start, inlier = _best_start(points_m, pixels, camera, focal=focal)

    # 2. Robust least squares of all picks from there, with a wide prior.
    wide = tuple(replace(parameter, prior_sigma=parameter.prior_sigma * _WIDE) for parameter in POSE)
    parameters = (*wide, _FOCAL) if focal else wide
    residuals = partial(_residuals, points_m=points_m, pixels=pixels, camera=start, sigma_px=sigma_px)
    solution = solve(residuals, np.zeros(len(parameters)), parameters, huber=_HUBER)
    solved = adjust_camera(start, solution.value)
    return PairCalibration(camera=solved, solution=solution, residual_px=solution.after * sigma_px, inlier=inlier)


def _check_spread(points_m: Float[np.ndarray, "n 3"], pixels: Float[np.ndarray, "n 2"]) -> None:
    """Refuse picks that no camera can be told from: not finite, beyond all sensors, too few, on one spot or line."""
    for values, most, what in ((points_m, _FARTHEST_M, "points in metres"), (pixels, _WIDEST_PX, "pixels")):
        off = np.flatnonzero(~(np.abs(values) < most).all(axis=1))
        if len(off):
            raise ConfigError(
                f"pairs: expected {what}, finite and below {most:g}; pair {off[0] + 1} has {values[off[0]].tolist()}"
            )
        number = len(np.unique(values, axis=0))
        if number < LEAST_PAIRS:
            raise ConfigError(
                f"pairs: expected {LEAST_PAIRS} different {what}, got {number} "
                f"in {count_of(len(values), 'pair')}. Pick others."
            )
        singular = np.linalg.svd(values - values.mean(axis=0), compute_uv=False)
        if singular[1] < _LINE * singular[0]:
            raise ConfigError(
                f"pairs: expected {what} that do not stand on one line; beside it they reach {singular[1]:.3g}, along "
                f"it {singular[0]:.3g}. Pick some beside it."
            )


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
    projected, _, _ = replace(there, width_px=0, height_px=0).project(points_m)
    return np.where((depth > 0.1)[:, None], (projected - pixels) / sigma_px, 100.0)


_Start = tuple[Camera, Bool[np.ndarray, " n"]]
"""A camera and the picks that it explains."""


def _best_start(
    points_m: Float[np.ndarray, "n 3"], pixels: Float[np.ndarray, "n 2"], camera: Camera, *, focal: bool
) -> _Start:
    """The pose with most inliers, over a few focal lengths if that is free."""
    if find_spec("cv2") is None:
        raise MissingExtraError("opencv-python-headless", "privacy", "calibrating from pairs without a start")
    factors = np.log(_FOCAL_FACTORS) if focal else np.zeros(1)
    tries = [_ransac(points_m, pixels, adjust_camera(camera, np.append(np.zeros(6), factor))) for factor in factors]
    starts = [start for start in tries if start is not None]
    if not starts:
        raise ConfigError("pairs: no pose explains six of them. Check the picks, their order and the focal length.")
    return starts[int(np.argmax([inlier.sum() for _, inlier in starts]))]


def _ransac(points_m: Float[np.ndarray, "n 3"], pixels: Float[np.ndarray, "n 2"], camera: Camera) -> _Start | None:
    import cv2

    try:
        solved, turn, shift, rows = cv2.solvePnPRansac(
            np.ascontiguousarray(points_m, float),
            np.ascontiguousarray(pixels, float),
            camera.matrix,
            camera.distortion,
            reprojectionError=_REPROJECTION_PX,
            iterationsCount=500,
            flags=cv2.SOLVEPNP_SQPNP,
        )
    except cv2.error:  # a draw without a unique pose, such as one of equal points, ends OpenCV's search
        return None
    if not solved or rows is None or len(rows) < LEAST_PAIRS:
        return None
    if not (np.isfinite(turn).all() and np.isfinite(shift).all()):
        return None
    rotation = cv2.Rodrigues(turn)[0]
    inlier = np.zeros(len(points_m), dtype=bool)
    inlier[rows.ravel()] = True
    return replace(camera, camera_T_lidar=pose(rotation, shift.ravel())), inlier


def spread_notes(
    points_m: Float[np.ndarray, "n 3"], pixels: Float[np.ndarray, "n 2"], camera: Camera
) -> tuple[str, ...]:
    """Which picks to add: where in the picture, and at which distance, there are none."""
    u, v = (pixels / [max(camera.width_px, 1), max(camera.height_px, 1)]).T
    depth = np.log(np.maximum(transform_points(camera.camera_T_lidar, points_m)[:, 2], 0.1))
    lacks = [
        (u.min() > 0.5 - _SPREAD, "far left in the picture"),
        (u.max() < 0.5 + _SPREAD, "far right in the picture"),
        (np.ptp(v) < _SPREAD, "higher or lower in the picture"),
        (np.ptp(depth) < np.log(2.0), "at twice or half the distance"),
    ]
    return tuple(f"add a point {where}" for lacking, where in lacks if lacking)


def read_pairs(path: Path) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 2"]]:
    """Read picked pairs: CSV with the header ``x_m,y_m,z_m,u_px,v_px``.

    Raises:
        FileFormatError: If the header is another or a line holds no five numbers.
    """
    head, _, rest = read_bytes(path, max_bytes=_MAX_BYTES).partition(b"\n")
    if head.decode("utf-8", errors="replace").strip() != _HEADER:
        raise FileFormatError(path, where="line 1", expected=_HEADER, got=repr(head[:80]))
    columns = parse_table(rest.rstrip(), dtypes=[np.dtype(np.float64)] * 5, separator=",", path=path, line=2)
    return np.column_stack(columns[:3]), np.column_stack(columns[3:])
