"""LiDAR to camera without targets: depth edges of the LiDAR on grey-value edges of pictures, coarse to fine.

Levinson and Thrun, "Automatic online calibration of cameras and lasers" (RSS 2013), with gradients blurred by 8, 4, 2
and 1 pixels in turn in place of an inverse distance transform. Rings see upright edges and columns level ones; each is
compared with the picture's gradient across it. Sought is the motion delta, ``camera_T_lidar = exp(delta) start``::

    maximise  mean over frames of  sum_j w_j g(u_j(delta))  -  0.002 sum_k (delta_k / s_k)^2

with the gradient g across edge j at its pixel u_j, in units of its mean, weights w_j that sum to 1 in a frame, and the
prior's sigmas s_k. :func:`align_edges` is the algorithm, :func:`edge_uncertainty` its covariance, and
:func:`edge_residuals` a figure to look at, which is never minimised.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float, Float16, Int, Shaped
from scipy import ndimage
from scipy.optimize import Bounds, minimize

from farfield.calibration.depth_edges import LidarEdges
from farfield.calibration.least_squares import (
    Parameter,
    Progress,
    motion_vector,
    no_progress,
    rigid_motion,
    unobserved_directions,
)
from farfield.geometry.cameras import Camera
from farfield.vocabulary.counts import count_of

SIGMAS_PX = (8.0, 4.0, 2.0, 1.0)
_TURN = np.radians(0.1)
_SHIFT_M = 0.01
_SHARES = np.array([0.6, 0.4])  # of upright and of level edges in a frame's score
_LEAST_FRAMES = 7
_PULL = 0.002  # what one sigma of the prior costs, in mean strength

PARAMETERS = (
    *(Parameter(name=n, unit="rad", scale=_TURN, prior_sigma=np.radians(1.0)) for n in ("pitch", "yaw", "roll")),
    *(Parameter(name=n, unit="m", scale=_SHIFT_M, prior_sigma=0.1) for n in ("x", "y", "z")),
)
"""Turns about, and shifts along, the camera's axes: x right (pitch), y down (yaw), z forward (roll)."""
_SYSTEMATIC = np.array([*np.radians([0.05, 0.05, 0.05]), 0.015, 0.015, 0.015])
"""What more frames do not average away, one sigma: rays are 0.2 to 0.4 degrees apart; from simulated drives."""
_VALLEYS = np.array([[2.5, 0.0, 0.0, 0.0, 8.7, 0.0], [0.0, 2.5, 0.0, -8.7, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.0, 20.0]])
"""Steps of :data:`PARAMETERS` that cancel at 20 m: pitch against y, yaw against x; and the shift along the view, which
moves far edges little. Wrong maxima lie along them."""
_ROUNDS = 2
_FINE = (-2, -1)
_BEST_STARTS = 3
_ROUGH, _ROUGH_ENDS = 6000, 1e-7  # edges with which the search is done, and where it ends
_FARTHEST_PX = 1e4
_MOST = np.array([15.0] * 3 + [30.0] * 3)
"""How many steps one scale may move."""
_CLEAR = 3.0  # times the usual gradient: an edge near which residuals are measured


def move_camera(camera: Camera, delta: Float[np.ndarray, " 6"]) -> Camera:
    """A camera turned and shifted: ``camera_T_lidar = exp(delta) camera_T_lidar``, shifts in metres, turns in rad."""
    return replace(camera, camera_T_lidar=rigid_motion(delta) @ camera.camera_T_lidar)


def camera_difference(camera: Camera, reference: Camera) -> Float[np.ndarray, " 6"]:
    """The delta with which ``move_camera(reference, delta)`` is ``camera``: turns in rad, shifts in metres, (6,)."""
    return motion_vector(camera.camera_T_lidar @ np.linalg.inv(reference.camera_T_lidar))


# Edges of pictures and sweeps


def image_edges(
    image: Shaped[np.ndarray, "height width ..."], sigma_px: float
) -> Float16[np.ndarray, "2 rows columns"]:
    """Gradient across and down, blurred, each in units of its mean; shape (2, height, width).

    At coarse scales every second pixel only.
    """
    grey = image.astype(np.float32).reshape(*image.shape[:2], -1).mean(axis=2)
    smooth = ndimage.gaussian_filter(grey, 1.0)
    gradients = [np.sqrt(np.abs(ndimage.sobel(smooth, axis=axis))) for axis in (1, 0)]
    blurred = [ndimage.gaussian_filter(gradient, sigma_px) for gradient in gradients]
    step = _step_px(sigma_px)
    thin = [gradient[::step, ::step] / max(float(gradient.mean()), 1e-6) for gradient in blurred]
    return np.stack(thin).astype(np.float16)


def _step_px(sigma_px: float) -> int:
    return 2 if sigma_px >= 2 else 1


@dataclass(frozen=True, eq=False, kw_only=True)
class EdgeViews:
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


def edge_views(
    pictures: Sequence[Shaped[np.ndarray, "height width ..."]],
    edges: Sequence[LidarEdges],
    camera: Camera,
    *,
    margin_px: float = 60.0,
    most: int = 1500,
) -> EdgeViews:
    """Put frames together.

    Args:
        pictures: One a frame, all of one size.
        edges: Edges of the sweeps.
        camera: A guess: edges that it sees nowhere near are left out.
        margin_px: How near.
        most: Edges used of each frame, evenly.
    """
    levels = tuple(np.stack([image_edges(picture, sigma) for picture in pictures]) for sigma in SIGMAS_PX)
    numbers = np.zeros(0, dtype=int)
    empty = EdgeViews(points_m=np.zeros((0, 3)), frame=numbers, axis=numbers, weight=np.zeros(0), levels=levels)
    return select_edges(empty, edges, camera, margin_px=margin_px, most=most)


def select_edges(
    views: EdgeViews, edges: Sequence[LidarEdges], camera: Camera, *, margin_px: float = 60.0, most: int = 1500
) -> EdgeViews:
    """The same pictures with the edges that another guess of the camera sees; arguments as of :func:`edge_views`."""
    shape = views.levels[-1].shape[2:]
    rows = [_rows(sweep, replace(camera, width_px=0, height_px=0), shape, margin_px, most) for sweep in edges]
    points, axis, weight = (np.concatenate(column) for column in zip(*rows, strict=True))
    frame = np.repeat(np.arange(len(rows)), [len(row[0]) for row in rows])
    return replace(views, points_m=points, frame=frame, axis=axis, weight=weight)


def _rows(
    edges: LidarEdges, camera: Camera, shape: tuple[int, ...], margin_px: float, most: int
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Points, axes and weights of one frame's edges that lie in the picture or near it."""
    points = np.concatenate([edges.upright_m, edges.level_m])
    axis = np.repeat([0, 1], [len(edges.upright_m), len(edges.level_m)])
    weight = np.concatenate([edges.upright_weight, edges.level_weight])
    pixels, _, _ = camera.project(points)
    with np.errstate(invalid="ignore"):
        near = np.flatnonzero(((pixels > -margin_px) & (pixels < np.array(shape[1::-1]) + margin_px)).all(axis=1))
    near = near[np.linspace(0, len(near) - 1, min(most, len(near))).astype(int)] if len(near) else near
    strength, kind = weight[near], axis[near]
    total = np.bincount(kind, weights=strength, minlength=2)
    share = _SHARES * (total > 0) / max(float((_SHARES * (total > 0)).sum()), 1e-9)
    return points[near], kind, strength * (share / np.maximum(total, 1e-9))[kind]


# The score, and its maximum


def edge_score(camera: Camera, views: EdgeViews, level: int = -1) -> Float[np.ndarray, " frames"]:
    """Weighted mean strength of the picture's edges under the LiDAR's, 1 for edges that fall anywhere, each frame."""
    pixels, _, _ = replace(camera, width_px=0, height_px=0).project(views.points_m)
    strength, _ = _interpolate_gradient(views, np.nan_to_num(pixels, nan=-1e6), level)
    return np.bincount(views.frame, weights=strength * views.weight, minlength=views.count).astype(np.float64)


def _interpolate_gradient(
    views: EdgeViews, pixels: Float[np.ndarray, "n 2"], level: int
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 2"]]:
    """The gradient across each edge between pixels, at one scale, and its slopes a pixel across and down; 0 outside."""
    grid, step = views.levels[level], _step_px(SIGMAS_PX[level])
    height, width = grid.shape[2:]
    u, v = pixels[:, 0] / step, pixels[:, 1] / step
    column, row = np.floor(u), np.floor(v)
    inside = (column >= 0) & (column < width - 1) & (row >= 0) & (row < height - 1)
    right, down = np.where(inside, u - column, 0.0), np.where(inside, v - row, 0.0)
    pixel = np.where(inside, row * width + column, 0.0).astype(np.int64)
    first = (views.frame * 2 + views.axis) * (height * width) + pixel
    values = grid.reshape(-1)
    one, two, three, four = (values.take(first + offset).astype(np.float64) for offset in (0, 1, width, width + 1))
    upper, lower = one + (two - one) * right, three + (four - three) * right
    across = (two - one) * (1 - down) + (four - three) * down
    slope = np.column_stack([across, lower - upper]) / step
    return inside * (upper + (lower - upper) * down), inside[:, None] * slope


def align_edges(
    camera: Camera,
    views: EdgeViews,
    *,
    sigma: Sequence[float] | None = None,
    most: int | None = _ROUGH,
    progress: Progress = no_progress,
) -> Camera:
    """Move the camera so that edges meet, from coarse to fine; a soft prior holds what the edges do not tell.

    Args:
        camera: The start: +-1 degree, +-10 cm.
        views: Frames.
        sigma: How far the start may be off: turns in rad and shifts in m, of :data:`PARAMETERS` unless given.
        most: About how many edges wrong maxima are searched with; all of them if None. The end is found with all.
        progress: Is called with the share that is finished; may raise to end it.
    """
    # 1. Two problems: with all edges, and with a part of them for the search.
    scale = np.array([parameter.scale for parameter in PARAMETERS])
    prior = np.array([parameter.prior_sigma for parameter in PARAMETERS] if sigma is None else sigma) / scale
    problem = _AlignmentProblem(camera=camera, views=views, scale=scale, prior=prior)
    every = len(views.points_m) // most if most else 1
    rough = replace(problem, views=_thin_out(views, every), ends=_ROUGH_ENDS) if every > 1 else problem

    # 2. Descend from the coarsest scale to the finest, then with all edges.
    x, _ = rough.descend(np.zeros(6), range(len(SIGMAS_PX)))
    best = problem.descend(x, _FINE)
    for number in range(_ROUNDS):
        progress((1 + number) / (1 + _ROUNDS))

        # 3. Start again on both sides of each valley, along which wrong maxima lie; the best go on to the finest scale.
        starts = [rough.descend(best[0] + sign * valley, _FINE[:1]) for valley in _VALLEYS for sign in (-1, 1)]
        ends = [rough.descend(x, _FINE[1:]) for x, _ in sorted(starts, key=_cost)[:_BEST_STARTS]]
        candidate = min(ends, key=_cost)
        if rough is not problem:
            candidate = problem.descend(candidate[0], _FINE[1:])

        # 4. Until no other maximum is higher.
        if candidate[1] >= best[1]:
            break
        best = candidate
    return move_camera(camera, best[0] * scale)


def _thin_out(views: EdgeViews, every: int) -> EdgeViews:
    """The same pictures with every so many-th edge, weights as large in all."""
    return replace(
        views,
        points_m=views.points_m[::every],
        frame=views.frame[::every],
        axis=views.axis[::every],
        weight=views.weight[::every] * every,
    )


def refine_edges(camera: Camera, views: EdgeViews, *, sigma: Sequence[float]) -> Camera:
    """Move a camera that fits most frames to those given, at all scales or at the fine ones alone: the better one.

    Arguments as for :func:`align_edges`.
    """
    scale = np.array([parameter.scale for parameter in PARAMETERS])
    problem = _AlignmentProblem(camera=camera, views=views, scale=scale, prior=np.array(sigma) / scale)
    ends = [problem.descend(np.zeros(6), levels) for levels in (_FINE, range(len(SIGMAS_PX)))]
    return move_camera(camera, min(ends, key=_cost)[0] * scale)


_Minimum = tuple[Float[np.ndarray, " 6"], float]


def _cost(minimum: _Minimum) -> float:
    return minimum[1]


@dataclass(frozen=True, eq=False, kw_only=True)
class _AlignmentProblem:
    """What is moved in steps of ``scale``, and how far it may be off."""

    camera: Camera
    views: EdgeViews
    scale: Float[np.ndarray, " 6"]
    prior: Float[np.ndarray, " 6"]
    ends: float = 1e-9  # where the score gains less, a scale is finished

    def descend(self, x: Float[np.ndarray, " 6"], levels: Iterable[int]) -> _Minimum:
        """Where scale after scale leads to, and the cost there."""
        cost = np.inf
        for level in levels:
            objective = _ScaleObjective(
                problem=self, level=level, origin=x, base_px=self.pixels(x), jacobian=self.jacobian(x)
            )
            fit = minimize(
                objective.cost,
                x,
                jac=True,
                method="L-BFGS-B",
                bounds=Bounds(x - _MOST, x + _MOST),
                options={"maxiter": 40, "ftol": self.ends},
            )
            there = replace(objective, origin=fit.x, base_px=self.pixels(fit.x))
            before, cost = objective.cost(x)[0], there.cost(fit.x)[0]
            x, cost = (fit.x, cost) if cost < before else (x, before)  # or the pixels bent too far
        return x, cost

    def pixels(self, x: Float[np.ndarray, " 6"]) -> Float[np.ndarray, "n 2"]:
        """Where the edges fall, shape (n, 2)."""
        there = replace(move_camera(self.camera, x * self.scale), width_px=0, height_px=0)
        return np.nan_to_num(there.project(self.views.points_m)[0], nan=-1e6)

    def jacobian(self, x: Float[np.ndarray, " 6"]) -> Float[np.ndarray, "n 2 6"]:
        """How the pixels move, a step."""
        differences = [(self.pixels(x + step) - self.pixels(x - step)) / 2 for step in np.eye(6)]
        jacobian = np.stack(differences, axis=-1)
        return np.where(np.abs(jacobian) < _FARTHEST_PX, jacobian, 0.0)  # beside the image plane


@dataclass(frozen=True, eq=False, kw_only=True)
class _ScaleObjective:
    """What is to be minimised at one scale: minus the mean score, and the prior's little pull.

    Pixels move along ``jacobian``, shape (n, 2, 6), taken at ``origin``, where each scale begins: within a degree they
    bend by a tenth of a pixel.
    """

    problem: _AlignmentProblem
    level: int
    origin: Float[np.ndarray, " 6"]
    base_px: Float[np.ndarray, "n 2"]
    jacobian: Float[np.ndarray, "n 2 6"]

    def cost(self, x: Float[np.ndarray, " 6"]) -> tuple[float, Float[np.ndarray, " 6"]]:
        """The value and its derivatives."""
        views = self.problem.views
        step = self.jacobian.reshape(-1, len(x)) @ (x - self.origin)
        strength, slope = _interpolate_gradient(views, self.base_px + step.reshape(-1, 2), self.level)
        weight = views.weight / views.count
        pull = _PULL * x / self.problem.prior**2
        uphill = (weight[:, None] * slope).ravel() @ self.jacobian.reshape(-1, len(x))
        return float(-(weight @ strength) + pull @ x), 2 * pull - uphill


# Its covariance


def edge_uncertainty(
    camera: Camera, views: EdgeViews, *, level: int = 2
) -> tuple[Float[np.ndarray, " 6"], tuple[str, ...]]:
    """Sigma of an aligned camera from how far single frames disagree, and what the edges cannot tell.

    The score's curvature H and the frames' gradients g give H^-1 cov(g) H^-1 / frames (an M-estimator's sandwich:
    Huber, 1967), and a systematic part is added. A direction along which the score does not bend, or less well known
    than the prior, is not observed.

    Args:
        camera: The aligned camera.
        views: Frames; seven or more, or nothing is known.
        level: Scale at which the score is taken to bend.

    Returns:
        Sigma of the six values of :data:`PARAMETERS`, shape (6,), infinite where H is not definite; sentences.
    """
    # 1. Gradients of the frames' scores.
    scale = np.array([parameter.scale for parameter in PARAMETERS])
    score = partial(_moved_score, camera=camera, views=views, level=level, scale=scale)
    eye = np.eye(6)
    gradient = np.stack([(score(step) - score(-step)) / 2 for step in eye], axis=1)
    if len(gradient) < _LEAST_FRAMES:  # their gradients' covariance has no full rank
        sentence = (
            f"{count_of(len(gradient), 'frame does', 'frames do')} not tell how "
            f"well the six are known: take {_LEAST_FRAMES} or more"
        )
        return np.full(6, np.inf), (sentence,)

    # 2. Curvature of the mean score.
    hessian = np.zeros((6, 6))
    for i in range(6):
        for j in range(i, 6):
            corners = [score(a * eye[i] + b * eye[j]).mean() * a * b for a in (-1, 1) for b in (-1, 1)]
            hessian[i, j] = hessian[j, i] = -sum(corners) / 4

    # 3. Information, the sandwich's inverse; none along what has no maximum.
    noise = np.atleast_2d(np.cov(gradient.T)) / max(len(gradient), 1) + 1e-12 * eye
    information = hessian @ np.linalg.inv(noise) @ hessian
    eigenvalues, vectors = np.linalg.eigh(hessian)
    unbent = vectors[:, eigenvalues <= 0]
    if unbent.shape[1]:
        projection = eye - unbent @ unbent.T
        information = projection @ information @ projection
    sentences, _ = unobserved_directions(information, PARAMETERS)
    if unbent.shape[1]:
        return np.full(6, np.inf), sentences

    # 4. Sigma, with the systematic part.
    return np.hypot(np.sqrt(np.diag(np.linalg.inv(information))) * scale, _SYSTEMATIC), sentences


def _moved_score(
    x: Float[np.ndarray, " 6"], camera: Camera, views: EdgeViews, level: int, scale: Float[np.ndarray, " 6"]
) -> Float[np.ndarray, " frames"]:
    return edge_score(move_camera(camera, x * scale), views, level)


# Residuals: what is reported of a camera's calibration, never what is minimised


@dataclass(frozen=True, eq=False, kw_only=True)
class EdgeResiduals:
    """Residuals of the LiDAR's edges near which the picture has a clear one.

    Args:
        across_px: How far across the edge the picture's lies, signed, shape (n,), pixels.
        weight: What each counts in the score, shape (n,).
    """

    across_px: Float[np.ndarray, " n"]
    weight: Float[np.ndarray, " n"]

    @property
    def median_px(self) -> float | None:
        """Median distance in pixels, each edge counting as it does in the score; None without edges.

        So counted it tells a wrong pose best: large jumps are outlines, while the many small ones lie in clutter, where
        some edge of the picture is always near.
        """
        if not len(self.across_px):
            return None
        away = np.abs(self.across_px)
        return float(np.quantile(away, 0.5, weights=self.weight, method="inverted_cdf"))


def edge_residuals(camera: Camera, views: EdgeViews, *, reach_px: int = 6) -> EdgeResiduals:
    """How far across each LiDAR edge the nearest clear edge of the picture lies.

    Clear are the gradient's local maxima that are three times the usual one; within ``reach_px`` to each side. They are
    placed by parabolas through the pixels beside them.
    """
    pixels, _, _ = replace(camera, width_px=0, height_px=0).project(views.points_m)
    pixels = np.nan_to_num(pixels, nan=-1e6)
    steps = np.arange(-reach_px - 1.0, reach_px + 1.5, 0.5)
    across = np.eye(2)[views.axis]
    finest = len(SIGMAS_PX) - 1
    profile = np.stack([_interpolate_gradient(views, pixels + step * across, finest)[0] for step in steps])
    inner = profile[2:-2]
    is_peak = (inner > _CLEAR) & (inner >= profile[1:-3]) & (inner >= profile[3:-1])
    nearest = np.where(is_peak, np.abs(steps[2:-2])[:, None], np.inf).argmin(axis=0)
    low, mid, high = (np.take_along_axis(profile, nearest[None] + row, axis=0)[0] for row in (0, 2, 4))
    bend = np.minimum(low - 2 * mid + high, -1e-9)
    within = np.clip(0.5 * (low - high) / bend, -0.5, 0.5)
    has_edge = is_peak.any(axis=0)
    return EdgeResiduals(across_px=(steps[2:-2][nearest] + within)[has_edge], weight=views.weight[has_edge])
