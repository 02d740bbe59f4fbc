"""LiDAR to camera without targets: depth edges of the LiDAR on grey-value edges of pictures, coarse to fine.

Levinson and Thrun, "Automatic online calibration of cameras and lasers" (RSS 2013), with gradients blurred by 8, 4, 2
and 1 pixels in turn in place of an inverse distance transform. Rings see upright edges and columns level ones; each is
compared with the picture's gradient across it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float, Float16, Int, Shaped
from scipy import ndimage
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from farfield.calibration.problems import Parameter, unobserved
from farfield.geometry.cameras import Camera

SIGMAS_PX = (8.0, 4.0, 2.0, 1.0)
_JUMP_M = 0.5
_LARGEST_JUMP_M = 5.0
_BIN_DEG = 0.42
_TURN = np.radians(0.1)
_SHIFT_M = 0.01
_REACH_M = 60.0
_SHARES = np.array([0.6, 0.4])  # of upright and of level edges in a frame's score
_PULL = 0.002  # what one sigma of the prior costs, in mean strength

PARAMETERS = (
    *(Parameter(name=n, unit="rad", scale=_TURN, prior_sigma=np.radians(1.0)) for n in ("pitch", "yaw", "roll")),
    *(Parameter(name=n, unit="m", scale=_SHIFT_M, prior_sigma=0.1) for n in ("x", "y", "z")),
)
"""Turns about, and shifts along, the camera's axes: x right (pitch), y down (yaw), z forward (roll)."""


@dataclass(frozen=True, eq=False, kw_only=True)
class LidarEdges:
    """Points at which the depth jumps, upright and level ones.

    Args:
        upright_m: Jumps along a ring, shape (n, 3).
        upright_weight: Their weights, shape (n,).
        level_m: Jumps from ring to ring, shape (m, 3).
        level_weight: Their weights, shape (m,).
    """

    upright_m: Float[np.ndarray, "n 3"]
    upright_weight: Float[np.ndarray, " n"]
    level_m: Float[np.ndarray, "m 3"]
    level_weight: Float[np.ndarray, " m"]


def moved(camera: Camera, delta: Float[np.ndarray, " 6"]) -> Camera:
    """A camera turned and shifted: ``camera_T_lidar = exp(delta) camera_T_lidar``, shifts in metres, turns in rad."""
    step = np.eye(4)
    step[:3, :3] = Rotation.from_rotvec(delta[:3]).as_matrix()
    step[:3, 3] = delta[3:]
    return replace(camera, camera_T_lidar=step @ camera.camera_T_lidar)


def difference(found: Camera, reference: Camera) -> Float[np.ndarray, " 6"]:
    """The delta with which ``moved(reference, delta)`` is ``found``: turns in rad, shifts in metres, shape (6,)."""
    step = found.camera_T_lidar @ np.linalg.inv(reference.camera_T_lidar)
    return np.concatenate([Rotation.from_matrix(step[:3, :3]).as_rotvec(), step[:3, 3]])


def lidar_edges(points_m: Float[np.ndarray, "n 3"], ring: Shaped[np.ndarray, " n"] | None = None) -> LidarEdges:
    """Find depth jumps in a sweep; rings are rebuilt from the elevation where the cloud has none.

    Args:
        points_m: Points in the LiDAR's own frame, shape (n, 3).
        ring: Ring of each point.
    """
    points = points_m.astype(np.float64)
    reach = np.linalg.norm(points, axis=1)
    kept = (reach > 2.0) & (reach < _REACH_M)
    points, reach = points[kept], reach[kept]
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    elevation = np.arcsin(points[:, 2] / reach)
    row = np.floor(np.degrees(elevation) / _BIN_DEG).astype(int) if ring is None else ring[kept].astype(int)
    upright = _jumps(points, reach, azimuth, row, np.radians(0.6), both=True)
    level = np.zeros((0, 3)), np.zeros(0)
    if ring is not None:  # rebuilt rings are too rough to go from one to the next
        column = np.floor(azimuth / np.radians(0.18)).astype(int)
        level = _jumps(points, reach, elevation, column, np.radians(1.2), both=False)
    return LidarEdges(upright_m=upright[0], upright_weight=upright[1], level_m=level[0], level_weight=level[1])


def _jumps(
    points_m: Float[np.ndarray, "n 3"],
    reach_m: Float[np.ndarray, " n"],
    along: Float[np.ndarray, " n"],
    line: Shaped[np.ndarray, " n"],
    gap_rad: float,
    *,
    both: bool,
) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, " m"]]:
    """Edges between neighbours on a line, at the nearer range half way between the two rays, and their weights.

    The near side must be no slope: the step before the jump is at most a third of it (the ground recedes from ring to
    ring). Without ``both``, only what ends upwards counts: below, objects stand on the ground.
    """
    order = np.lexsort((along, line))
    reach, step = reach_m[order], np.diff(reach_m[order])
    beside = (np.diff(line[order]) == 0) & (np.diff(along[order]) < gap_rad)
    far = np.abs(step) > np.maximum(_JUMP_M, 0.03 * np.minimum(reach[:-1], reach[1:]))
    size = np.where(beside, np.abs(step), np.inf)
    before, after = np.append(np.inf, size[:-1]), np.append(size[1:], np.inf)
    flat = np.where(step > 0, before, after) < np.abs(step) / 3
    at = np.flatnonzero(beside & far & flat & ((step > 0) | both))
    rays = points_m[order] / reach[:, None]
    middle = rays[at] + rays[at + 1]
    middle *= (np.minimum(reach[at], reach[at + 1]) / np.linalg.norm(middle, axis=1))[:, None]
    return middle, np.sqrt(np.minimum(np.abs(step[at]), _LARGEST_JUMP_M))


def image_edges(
    image: Shaped[np.ndarray, "height width ..."], sigma_px: float
) -> Float16[np.ndarray, "2 rows columns"]:
    """Gradient across and down, blurred, each in units of its mean; shape (2, height, width).

    At coarse scales every second pixel only.
    """
    grey = image.astype(np.float32).reshape(*image.shape[:2], -1).mean(axis=2)
    smooth = ndimage.gaussian_filter(grey, 1.0)
    found = [np.sqrt(np.abs(ndimage.sobel(smooth, axis=axis))) for axis in (1, 0)]
    blurred = [ndimage.gaussian_filter(each, sigma_px) for each in found]
    step = _step_px(sigma_px)
    thin = [each[::step, ::step] / max(float(each.mean()), 1e-6) for each in blurred]
    return np.stack(thin).astype(np.float16)


def _step_px(sigma_px: float) -> int:
    return 2 if sigma_px >= 2 else 1


@dataclass(frozen=True, eq=False, kw_only=True)
class Views:
    """Edges of all frames in one table, and the pictures' at each scale.

    Args:
        points_m: Depth edges, shape (n, 3).
        frame: Frame of each, shape (n,).
        axis: 0 for upright edges, 1 for level ones, shape (n,).
        weight: Weights that sum to 1 in each frame, shape (n,).
        levels: Gradients of all frames at each scale, shape (frames, 2, height, width).
    """

    points_m: Float[np.ndarray, "n 3"]
    frame: Int[np.ndarray, " n"]
    axis: Int[np.ndarray, " n"]
    weight: Float[np.ndarray, " n"]
    levels: tuple[Shaped[np.ndarray, "frames 2 height width"], ...]

    @property
    def count(self) -> int:
        """Number of frames."""
        return len(self.levels[0])


def views_of(
    pictures: Sequence[Shaped[np.ndarray, "height width ..."]],
    edges: Sequence[LidarEdges],
    camera: Camera,
    *,
    margin_px: float = 60.0,
    most: int = 1500,
) -> Views:
    """Put frames together.

    Args:
        pictures: One a frame, all of one size.
        edges: Edges of the sweeps.
        camera: A guess: edges that it sees nowhere near are left out.
        margin_px: How near.
        most: Edges kept of each frame, evenly.
    """
    rows = [_rows(each, replace(camera, width_px=0, height_px=0), pictures[0].shape, margin_px, most) for each in edges]
    points, axis, weight = (np.concatenate(column) for column in zip(*rows, strict=True))
    frame = np.repeat(np.arange(len(rows)), [len(row[0]) for row in rows])
    levels = tuple(np.stack([image_edges(each, sigma) for each in pictures]) for sigma in SIGMAS_PX)
    return Views(points_m=points, frame=frame, axis=axis, weight=weight, levels=levels)


def _rows(
    edges: LidarEdges, camera: Camera, shape: tuple[int, ...], margin_px: float, most: int
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    points = np.concatenate([edges.upright_m, edges.level_m])
    axis = np.repeat([0, 1], [len(edges.upright_m), len(edges.level_m)])
    weight = np.concatenate([edges.upright_weight, edges.level_weight])
    pixels, _, _ = camera.project(points)
    with np.errstate(invalid="ignore"):
        near = np.flatnonzero(((pixels > -margin_px) & (pixels < np.array(shape[1::-1]) + margin_px)).all(axis=1))
    near = near[np.linspace(0, len(near) - 1, min(most, len(near))).astype(int)] if len(near) else near
    kept, kind = weight[near], axis[near]
    total = np.bincount(kind, weights=kept, minlength=2)
    share = _SHARES * (total > 0) / max(float((_SHARES * (total > 0)).sum()), 1e-9)
    return points[near], kind, kept * (share / np.maximum(total, 1e-9))[kind]


def edge_score(camera: Camera, views: Views, level: int = -1) -> Float[np.ndarray, " frames"]:
    """Weighted mean strength of the picture's edges under the LiDAR's, 1 for edges that fall anywhere, each frame."""
    pixels, _, _ = replace(camera, width_px=0, height_px=0).project(views.points_m)
    found = _sampled(views, np.nan_to_num(pixels, nan=-1e6), level)
    return np.bincount(views.frame, weights=found * views.weight, minlength=views.count).astype(np.float64)


def _sampled(views: Views, pixels: Float[np.ndarray, "n 2"], level: int) -> Float[np.ndarray, " n"]:
    """Values between pixels; 0 outside."""
    grid = views.levels[level]
    at = pixels / _step_px(SIGMAS_PX[level])
    low = np.floor(at).astype(np.int64)
    inside = np.all((low >= 0) & (low < np.array(grid.shape[:1:-1]) - 1), axis=1)
    column, row = np.where(inside[:, None], low, 0).T
    right, down = np.where(inside[:, None], at - low, 0.0).T
    flat, width = grid.reshape(-1), grid.shape[3]
    first = ((views.frame * 2 + views.axis) * grid.shape[2] + row) * width + column
    upper = flat[first] * (1 - right) + flat[first + 1] * right
    lower = flat[first + width] * (1 - right) + flat[first + width + 1] * right
    return np.asarray(np.where(inside, upper * (1 - down) + lower * down, 0.0))


def align_edges(camera: Camera, views: Views, *, sigma: Sequence[float] | None = None) -> Camera:
    """Move the camera so that edges meet, from coarse to fine; a soft prior keeps what the edges do not tell.

    Args:
        camera: The start: +-1 degree, +-10 cm.
        views: Frames.
        sigma: How far the start may be off: turns in rad and shifts in m, of :data:`PARAMETERS` unless given.
    """
    scale = np.array([each.scale for each in PARAMETERS])
    prior = np.array([each.prior_sigma for each in PARAMETERS] if sigma is None else sigma) / scale
    x = np.zeros(6)
    for level, step in enumerate((2.0, 1.0, 0.5, 0.3)):
        lacking = partial(_lacking, camera=camera, views=views, level=level, scale=scale, prior=prior)
        x = minimize(lacking, x, method="L-BFGS-B", options={"eps": step, "maxiter": 30, "ftol": 1e-7}).x
    return moved(camera, x * scale)


def _lacking(
    x: Float[np.ndarray, " 6"],
    camera: Camera,
    views: Views,
    level: int,
    scale: Float[np.ndarray, " 6"],
    prior: Float[np.ndarray, " 6"],
) -> float:
    """What is to be minimised: minus the mean score, and the prior's little pull."""
    score = edge_score(moved(camera, x * scale), views, level).mean()
    return float(-score + _PULL * ((x / prior) ** 2).sum())


def edge_spread(camera: Camera, views: Views, *, level: int = 2) -> tuple[Float[np.ndarray, " 6"], tuple[str, ...]]:
    """Sigma of an aligned camera from how far single frames disagree, and what the edges cannot tell.

    The score's curvature H and the frames' gradients g give H^-1 cov(g) H^-1 / frames (an M-estimator's sandwich:
    Huber, 1967). A direction along which the score does not bend, or less well known than the prior, is not observed.

    Args:
        camera: The aligned camera.
        views: Frames; with fewer than seven the gradients' covariance has no full rank and the sigma is too small.
        level: Scale at which the score is taken to bend.

    Returns:
        Sigma of the six values of :data:`PARAMETERS`, shape (6,), infinite where H is not definite; sentences.
    """
    scale = np.array([each.scale for each in PARAMETERS])
    score = partial(_moved_score, camera=camera, views=views, level=level, scale=scale)
    eye = np.eye(6)
    gradient = np.stack([(score(step) - score(-step)) / 2 for step in eye], axis=1)
    bend = np.zeros((6, 6))
    for i in range(6):
        for j in range(i, 6):
            corners = [score(a * eye[i] + b * eye[j]).mean() * a * b for a in (-1, 1) for b in (-1, 1)]
            bend[i, j] = bend[j, i] = -sum(corners) / 4
    noise = np.atleast_2d(np.cov(gradient.T)) / max(len(gradient), 1) + 1e-12 * eye
    information = bend @ np.linalg.inv(noise) @ bend
    eigenvalues, vectors = np.linalg.eigh(bend)
    flat = vectors[:, eigenvalues <= 0]
    if flat.shape[1]:  # no maximum along these: nothing is known of them
        kept = eye - flat @ flat.T
        information = kept @ information @ kept
    sentences, _ = unobserved(information, PARAMETERS)
    if flat.shape[1]:
        return np.full(6, np.inf), sentences
    return np.sqrt(np.diag(np.linalg.inv(information))) * scale, sentences


def _moved_score(
    x: Float[np.ndarray, " 6"], camera: Camera, views: Views, level: int, scale: Float[np.ndarray, " 6"]
) -> Float[np.ndarray, " frames"]:
    return edge_score(moved(camera, x * scale), views, level)


def edge_residual_px(camera: Camera, views: Views, *, reach_px: int = 6) -> Float[np.ndarray, " n"]:
    """How far from each LiDAR edge the picture's strongest gradient across it lies, signed, shape (n,), in pixels.

    Only where that gradient is three times the usual one; within ``reach_px`` to each side.
    """
    pixels, _, _ = replace(camera, width_px=0, height_px=0).project(views.points_m)
    pixels = np.nan_to_num(pixels, nan=-1e6)
    steps = np.arange(-reach_px, reach_px + 0.5, 0.5)
    across = np.eye(2)[views.axis]
    found = np.stack([_sampled(views, pixels + step * across, len(SIGMAS_PX) - 1) for step in steps])
    clear = found.max(axis=0) > 3.0
    return steps[np.argmax(found, axis=0)][clear]
