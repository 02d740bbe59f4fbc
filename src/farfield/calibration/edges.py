"""LiDAR to camera without targets: depth edges of the LiDAR on grey-value edges of pictures, coarse to fine.

Levinson and Thrun, "Automatic online calibration of cameras and lasers" (RSS 2013), with gradients blurred by 8, 4, 2
and 1 pixels in turn in place of an inverse distance transform. Rings see upright edges and columns level ones; each is
compared with the picture's gradient across it.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float, Float16, Int, Shaped
from scipy import ndimage
from scipy.optimize import Bounds, minimize
from scipy.spatial.transform import Rotation

from farfield.calibration.depth_jumps import LidarEdges
from farfield.calibration.problems import Parameter, Progress, no_progress, unobserved_directions
from farfield.geometry.cameras import Camera

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
_KEPT = 3
_ROUGH, _ROUGH_ENDS = 6000, 1e-7  # edges with which the search is done, and where it ends
_FARTHEST_PX = 1e4
_MOST = np.array([15.0] * 3 + [30.0] * 3)
"""How many steps one scale may move."""


def move_camera(camera: Camera, delta: Float[np.ndarray, " 6"]) -> Camera:
    """A camera turned and shifted: ``camera_T_lidar = exp(delta) camera_T_lidar``, shifts in metres, turns in rad."""
    step = np.eye(4)
    step[:3, :3] = Rotation.from_rotvec(delta[:3]).as_matrix()
    step[:3, 3] = delta[3:]
    return replace(camera, camera_T_lidar=step @ camera.camera_T_lidar)


def camera_difference(found: Camera, reference: Camera) -> Float[np.ndarray, " 6"]:
    """The delta with which ``move_camera(reference, delta)`` is ``found``: turns in rad, shifts in metres, shape (6,)."""
    step = found.camera_T_lidar @ np.linalg.inv(reference.camera_T_lidar)
    return np.concatenate([Rotation.from_matrix(step[:3, :3]).as_rotvec(), step[:3, 3]])


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
        most: Edges kept of each frame, evenly.
    """
    levels = tuple(np.stack([image_edges(each, sigma) for each in pictures]) for sigma in SIGMAS_PX)
    nothing = np.zeros((0, 3)), np.zeros(0, dtype=int), np.zeros(0, dtype=int), np.zeros(0)
    empty = EdgeViews(points_m=nothing[0], frame=nothing[1], axis=nothing[2], weight=nothing[3], levels=levels)
    return select_edges(empty, edges, camera, margin_px=margin_px, most=most)


def select_edges(
    views: EdgeViews, edges: Sequence[LidarEdges], camera: Camera, *, margin_px: float = 60.0, most: int = 1500
) -> EdgeViews:
    """The same pictures with the edges that another guess of the camera sees; arguments as of :func:`edge_views`."""
    shape = views.levels[-1].shape[2:]
    rows = [_rows(each, replace(camera, width_px=0, height_px=0), shape, margin_px, most) for each in edges]
    points, axis, weight = (np.concatenate(column) for column in zip(*rows, strict=True))
    frame = np.repeat(np.arange(len(rows)), [len(row[0]) for row in rows])
    return replace(views, points_m=points, frame=frame, axis=axis, weight=weight)


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


def edge_score(camera: Camera, views: EdgeViews, level: int = -1) -> Float[np.ndarray, " frames"]:
    """Weighted mean strength of the picture's edges under the LiDAR's, 1 for edges that fall anywhere, each frame."""
    pixels, _, _ = replace(camera, width_px=0, height_px=0).project(views.points_m)
    found = sample_gradient(views, np.nan_to_num(pixels, nan=-1e6), level)
    return np.bincount(views.frame, weights=found * views.weight, minlength=views.count).astype(np.float64)


def sample_gradient(views: EdgeViews, pixels: Float[np.ndarray, "n 2"], level: int) -> Float[np.ndarray, " n"]:
    """Values of the gradient across each edge between pixels, at one scale; 0 outside."""
    return _sloped(views, pixels, level)[0]


def _sloped(
    views: EdgeViews, pixels: Float[np.ndarray, "n 2"], level: int
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 2"]]:
    """Values between pixels and their slopes a pixel across and down; 0 outside."""
    grid, step = views.levels[level], _step_px(SIGMAS_PX[level])
    height, width = grid.shape[2:]
    u, v = pixels[:, 0] / step, pixels[:, 1] / step
    column, row = np.floor(u), np.floor(v)
    inside = (column >= 0) & (column < width - 1) & (row >= 0) & (row < height - 1)
    right, down = np.where(inside, u - column, 0.0), np.where(inside, v - row, 0.0)
    place = np.where(inside, row * width + column, 0.0).astype(np.int64)
    first = (views.frame * 2 + views.axis) * (height * width) + place
    flat = grid.reshape(-1)
    one, two, three, four = (flat.take(first + each).astype(np.float64) for each in (0, 1, width, width + 1))
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
    told: Progress = no_progress,
) -> Camera:
    """Move the camera so that edges meet, from coarse to fine; a soft prior keeps what the edges do not tell.

    Args:
        camera: The start: +-1 degree, +-10 cm.
        views: Frames.
        sigma: How far the start may be off: turns in rad and shifts in m, of :data:`PARAMETERS` unless given.
        most: About how many edges wrong maxima are searched with; all of them if None. The end is found with all.
        told: Is told the share that is done; may raise to end it.
    """
    scale = np.array([each.scale for each in PARAMETERS])
    prior = np.array([each.prior_sigma for each in PARAMETERS] if sigma is None else sigma) / scale
    whole = _Problem(camera=camera, views=views, scale=scale, prior=prior)
    every = len(views.points_m) // most if most else 1
    rough = replace(whole, views=_thinned(views, every), ends=_ROUGH_ENDS) if every > 1 else whole
    x, _ = rough.descended(np.zeros(6), range(len(SIGMAS_PX)))
    best = whole.descended(x, _FINE)
    for number in range(_ROUNDS):
        told((1 + number) / (1 + _ROUNDS))
        around = [rough.descended(best[0] + sign * valley, _FINE[:1]) for valley in _VALLEYS for sign in (-1, 1)]
        ends = [rough.descended(each[0], _FINE[1:]) for each in sorted(around, key=_lacking)[:_KEPT]]
        nearest = min(ends, key=_lacking)
        if rough is not whole:
            nearest = whole.descended(nearest[0], _FINE[1:])
        if nearest[1] >= best[1]:
            break
        best = nearest
    return move_camera(camera, best[0] * scale)


def _thinned(views: EdgeViews, every: int) -> EdgeViews:
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
    scale = np.array([each.scale for each in PARAMETERS])
    whole = _Problem(camera=camera, views=views, scale=scale, prior=np.array(sigma) / scale)
    ends = [whole.descended(np.zeros(6), levels) for levels in (_FINE, range(len(SIGMAS_PX)))]
    return move_camera(camera, min(ends, key=_lacking)[0] * scale)


_Found = tuple[Float[np.ndarray, " 6"], float]


def _lacking(found: _Found) -> float:
    return found[1]


@dataclass(frozen=True, eq=False, kw_only=True)
class _Problem:
    """What is moved in steps of ``scale``, and how far it may be off."""

    camera: Camera
    views: EdgeViews
    scale: Float[np.ndarray, " 6"]
    prior: Float[np.ndarray, " 6"]
    ends: float = 1e-9  # where the score gains less, a scale is done

    def descended(self, x: Float[np.ndarray, " 6"], levels: Iterable[int]) -> _Found:
        """Where scale after scale leads to, and what is lacking there."""
        lacking = np.inf
        for level in levels:
            problem = _ScaleObjective(whole=self, level=level, at=x, base_px=self.pixels(x), turns=self.jacobian(x))
            done = minimize(
                problem.lacking,
                x,
                jac=True,
                method="L-BFGS-B",
                bounds=Bounds(x - _MOST, x + _MOST),
                options={"maxiter": 40, "ftol": self.ends},
            )
            there = replace(problem, at=done.x, base_px=self.pixels(done.x))
            before, lacking = problem.lacking(x)[0], there.lacking(done.x)[0]
            x, lacking = (done.x, lacking) if lacking < before else (x, before)  # or the pixels bent too far
        return x, lacking

    def pixels(self, x: Float[np.ndarray, " 6"]) -> Float[np.ndarray, "n 2"]:
        there = replace(move_camera(self.camera, x * self.scale), width_px=0, height_px=0)
        return np.nan_to_num(there.project(self.views.points_m)[0], nan=-1e6)

    def jacobian(self, x: Float[np.ndarray, " 6"]) -> Float[np.ndarray, "n 2 6"]:
        steps = np.eye(6)
        turns = np.stack([(self.pixels(x + step) - self.pixels(x - step)) / 2 for step in steps], axis=-1)
        return np.where(np.abs(turns) < _FARTHEST_PX, turns, 0.0)  # beside the image plane


@dataclass(frozen=True, eq=False, kw_only=True)
class _ScaleObjective:
    """What is to be minimised at one scale: minus the mean score, and the prior's little pull.

    Pixels move along ``turns``, shape (n, 2, 6), taken at ``at``, where each scale begins: within a degree they bend by
    a tenth of a pixel.
    """

    whole: _Problem
    level: int
    at: Float[np.ndarray, " 6"]
    base_px: Float[np.ndarray, "n 2"]
    turns: Float[np.ndarray, "n 2 6"]

    def lacking(self, x: Float[np.ndarray, " 6"]) -> tuple[float, Float[np.ndarray, " 6"]]:
        """The value and its derivatives."""
        views = self.whole.views
        step = self.turns.reshape(-1, len(x)) @ (x - self.at)
        found, slope = _sloped(views, self.base_px + step.reshape(-1, 2), self.level)
        weight = views.weight / views.count
        pull = _PULL * x / self.whole.prior**2
        uphill = (weight[:, None] * slope).ravel() @ self.turns.reshape(-1, len(x))
        return float(-(weight @ found) + pull @ x), 2 * pull - uphill


def edge_uncertainty(
    camera: Camera, views: EdgeViews, *, level: int = 2
) -> tuple[Float[np.ndarray, " 6"], tuple[str, ...]]:
    """Sigma of an aligned camera from how far single frames disagree, and what the edges cannot tell.

    The score's curvature H and the frames' gradients g give H^-1 cov(g) H^-1 / frames (an M-estimator's sandwich:
    Huber, 1967), and a systematic part is added. A direction along which the score does not bend, or less well known
    than the prior, is not observed.

    Args:
        camera: The aligned camera.
        views: Frames; seven or more, or nothing is told.
        level: Scale at which the score is taken to bend.

    Returns:
        Sigma of the six values of :data:`PARAMETERS`, shape (6,), infinite where H is not definite; sentences.
    """
    scale = np.array([each.scale for each in PARAMETERS])
    score = partial(_moved_score, camera=camera, views=views, level=level, scale=scale)
    eye = np.eye(6)
    gradient = np.stack([(score(step) - score(-step)) / 2 for step in eye], axis=1)
    if len(gradient) < _LEAST_FRAMES:  # their gradients' covariance has no full rank
        words = f"{len(gradient)} frames do not tell how well the six are known: take {_LEAST_FRAMES} or more"
        return np.full(6, np.inf), (words,)
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
    sentences, _ = unobserved_directions(information, PARAMETERS)
    if flat.shape[1]:
        return np.full(6, np.inf), sentences
    return np.hypot(np.sqrt(np.diag(np.linalg.inv(information))) * scale, _SYSTEMATIC), sentences


def _moved_score(
    x: Float[np.ndarray, " 6"], camera: Camera, views: EdgeViews, level: int, scale: Float[np.ndarray, " 6"]
) -> Float[np.ndarray, " frames"]:
    return edge_score(move_camera(camera, x * scale), views, level)
