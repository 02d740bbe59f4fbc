"""Robust least squares with covariance, as every calibration here is stated, and what the data leave unobserved.

Residuals r_i(x), whitened (divided by their sigma) and of d components each, and a prior N(x_0k, s_k^2) of each of the
k unknowns give::

    minimise  sum_i share_i rho(|r_i(x)|)  +  sum_k ((x_k - x_0k) / s_k)^2

with Huber's rho (linear from 1.345 sigma on), by iteratively reweighted least squares: Gauss-Newton steps under the
weights ``share_i min(1, 1.345 / |r_i|)``, in steps of each unknown's ``scale``. The covariance is cluster-robust (Liang
and Zeger, Biometrika 1986, eq. 7), by the cost's own curvature (Huber, 1967) and with each group's own pull taken out
of it (the jackknife; Bell and McCaffrey, Survey Methodology 2002), for with few groups the plain sandwich is too small.
:func:`solve` is the algorithm; :func:`appraise` its last step alone.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from farfield.errors import ConfigError
from farfield.geometry.poses import pose

_HUBER = 1.345
_ROUNDS, _CONVERGED = 20, 1e-3  # of the reweighting; steps of ``scale``
_NAMED = 0.35  # share of a direction from which a parameter is named
_UNITS = {"rad": ("deg", 180 / np.pi), "m": ("cm", 100.0), "s": ("ms", 1000.0), "px": ("px", 1.0), "": ("", 1.0)}

T = TypeVar("T")
ResidualFunction = Callable[[Float[np.ndarray, " k"]], Float[np.ndarray, "n d"]]
"""From values, shape (k,), to n residuals of d components, divided by their sigma."""
Progress = Callable[[float], None]
"""Is called with the share of a solver's work that is finished, 0 to 1; it may raise to end the work."""


def no_progress(share: float) -> None:
    """Where nobody waits for progress."""


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One unknown.

    Args:
        name: Its name, for messages.
        unit: ``"rad"``, ``"m"``, ``"s"``, ``"px"`` or nothing.
        scale: A step that matters as much as the others' steps: 0.1 degree, 1 cm, 5 ms.
        prior_sigma: How far it may lie from the start before any measurement.
    """

    name: str
    unit: str
    scale: float
    prior_sigma: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Solution:
    """Values with their covariance, and what the data leave unobserved.

    Args:
        parameters: The k unknowns.
        value: Their values, shape (k,).
        covariance: Their covariance, shape (k, k), the prior included.
        unobserved: Sentences, one a direction that the data cannot tell; the prior stands there.
        before: Whitened lengths of the residuals at the start, shape (n,).
        after: The same at the solution, shape (n,).
        converged: Whether the solver stopped by itself.
        information: Singular values of the scaled problem, weakest first, shape (k,): 1 / sigma in steps of ``scale``.
    """

    parameters: tuple[Parameter, ...]
    value: Float[np.ndarray, " k"]
    covariance: Float[np.ndarray, "k k"]
    unobserved: tuple[str, ...]
    before: Float[np.ndarray, " n"]
    after: Float[np.ndarray, " n"]
    converged: bool
    information: Float[np.ndarray, " k"]

    @property
    def sigma(self) -> Float[np.ndarray, " k"]:
        """Standard deviations, shape (k,)."""
        return np.sqrt(np.diag(self.covariance))

    def to_json(self) -> dict[str, Any]:
        """Values, sigmas and findings by name, in degrees, centimetres and milliseconds."""
        rows = {}
        for parameter, value, sigma in zip(self.parameters, self.value, self.sigma, strict=True):
            unit, factor = _UNITS[parameter.unit]
            key = f"{parameter.name}_{unit}" if unit else parameter.name
            rows[key] = {"value": float(value * factor), "sigma": float(sigma * factor)}
        return {"parameters": rows, "unobserved": list(self.unobserved), "converged": self.converged}


def solve(
    residuals: ResidualFunction,
    start: Float[np.ndarray, " k"],
    parameters: Sequence[Parameter],
    *,
    group: Int[np.ndarray, " n"] | None = None,
    share: Float[np.ndarray, " n"] | None = None,
    begin: Float[np.ndarray, " k"] | None = None,
    huber: float = _HUBER,
    steps: int = 50,
) -> Solution:
    """Minimise robustly; iteratively reweighted so that a residual of several components is one observation.

    The sigma is the analytic form of a bootstrap over blocks of frames, because residuals within a frame are not
    independent; the plain one where that is larger. A direction is not observed where one over the root of its
    information, the prior left out, exceeds the prior's sigma.

    Args:
        residuals: From values, shape (k,), to n residuals of d components, divided by their sigma.
        start: The priors' means, and values to begin with unless ``begin`` is given, shape (k,).
        parameters: What each value is.
        group: Block of frames of each residual, shape (n,) (default: each its own).
        share: For how many observations each residual counts, shape (n,): less than one where several err alike.
        begin: Values to begin with, shape (k,).
        huber: From how many sigma a residual counts linearly.
        steps: Most evaluations of the Jacobian in each of the rounds that a plain step does not serve.

    Raises:
        ConfigError: If there are no residuals, or they are not finite at the start.
    """
    # 1. Residuals at the start, and unknowns x counted from there in steps of their scale.
    start = np.asarray(start, dtype=np.float64)
    scale, prior = _scales(parameters)
    before = residuals(start)
    if not before.size or not np.isfinite(before).all():
        raise ConfigError("calibration: expected finite residuals at the start, got none; give a nearer start")
    counts = np.ones(len(before)) if share is None else share
    problem = _ScaledProblem(residuals, start, scale, prior)
    x = np.zeros(len(start)) if begin is None else (np.asarray(begin, dtype=np.float64) - start) / scale

    # 2. Huber's weights of the residuals.
    weight, converged = counts * _huber_weights(residuals(start + x * scale), huber), False
    for _ in range(_ROUNDS):
        # 3. A step under these weights.
        stepped, finished = _solved(problem.step, x, weight, steps)
        change, x = float(np.abs(stepped - x).max()), stepped

        # 4. New weights, until the steps are small.
        weight = counts * _huber_weights(residuals(start + x * scale), huber)
        converged = finished and change < _CONVERGED
        if converged:
            break

    # 5. Covariance, and directions that are not observed.
    value = start + x * scale
    solution = appraise(residuals, value, parameters, group=group, share=share, huber=huber, weight=weight)
    return replace(solution, before=np.linalg.norm(before, axis=1), converged=converged)


def appraise(
    residuals: ResidualFunction,
    value: Float[np.ndarray, " k"],
    parameters: Sequence[Parameter],
    *,
    group: Int[np.ndarray, " n"] | None = None,
    share: Float[np.ndarray, " n"] | None = None,
    huber: float = _HUBER,
    weight: Float[np.ndarray, " n"] | None = None,
) -> Solution:
    """What the data tell at some values, without a step: sigma, information and what is not observed.

    Args:
        residuals: As of :func:`solve`.
        value: Where, shape (k,).
        parameters: What each value is.
        group: As of :func:`solve`.
        share: As of :func:`solve`.
        huber: As of :func:`solve`.
        weight: Of each residual, shape (n,) (default: from its length and ``share``).

    Raises:
        ConfigError: If there are no residuals, or they are not finite.
    """
    rows = residuals(value)
    if not rows.size or not np.isfinite(rows).all():
        raise ConfigError("calibration: expected finite residuals, got none")
    counts = np.ones(len(rows)) if share is None else share
    weight = counts * _huber_weights(rows, huber) if weight is None else weight
    scale, prior = _scales(parameters)
    jacobian = _jacobian(residuals, value, scale)
    block = np.arange(len(rows)) if group is None else group
    freedom = max(float(counts.sum()) * rows.shape[1] - len(prior), 1.0)
    chi2 = max(float((weight[:, None] * rows**2).sum()) / freedom, 1e-12)  # a degree of freedom
    covariance, fisher = _solved(_robust_covariance, jacobian, rows, weight, prior, block, chi2, huber)
    sentences, information = _solved(unobserved_directions, fisher / chi2, parameters)
    if not (np.isfinite(value).all() and np.isfinite(covariance).all() and (np.diag(covariance) >= 0).all()):
        raise ConfigError(_UNDETERMINED)
    length = np.linalg.norm(rows, axis=1)
    return Solution(
        parameters=tuple(parameters),
        value=value,
        covariance=covariance * np.outer(scale, scale),
        unobserved=sentences,
        before=length,
        after=length,
        converged=False,
        information=information,
    )


_UNDETERMINED = (
    "calibration: expected measurements that determine the solution, got residuals without finite, independent slopes. "
    "Check the picks, their order and their units, or give a nearer start."
)


def _solved(step: Callable[..., T], *arguments: Any) -> T:
    """What a step of linear algebra gives.

    Raises:
        ConfigError: If its matrix is singular or holds what is not finite.
    """
    try:
        return step(*arguments)
    except (np.linalg.LinAlgError, ValueError) as error:  # scipy refuses what is not finite with a ValueError
        raise ConfigError(_UNDETERMINED) from error


def consider_covariance(
    residuals: ResidualFunction,
    value: Float[np.ndarray, " k"],
    parameters: Sequence[Parameter],
    errors: Float[np.ndarray, "e n d"],
    *,
    share: Float[np.ndarray, " n"] | None = None,
    huber: float = _HUBER,
) -> Float[np.ndarray, "k k"]:
    """What errors that residuals have in common, so that none of them averages out, add to a solution's covariance.

    They are not solved for, only considered (Schmidt 1966; Tapley, Schutz and Born, Statistical Orbit Determination,
    2004, section 6.2).

    Args:
        residuals: As of :func:`solve`.
        value: The solution, shape (k,).
        parameters: As of :func:`solve`.
        errors: What one sigma of each of e independent errors does to the residuals, shape (e, n, d).
        share: As of :func:`solve`.
        huber: As of :func:`solve`.
    """
    rows = residuals(value)
    counts = np.ones(len(rows)) if share is None else share
    scale, prior = _scales(parameters)
    jacobian = _jacobian(residuals, value, scale)
    weight = counts * _huber_weights(rows, huber)
    fisher = np.einsum("n,ndi,ndj->ij", weight, jacobian, jacobian) + np.diag(1.0 / prior**2)
    sensitivity = np.linalg.solve(fisher, np.einsum("n,ndi,end->ie", weight, jacobian, errors)) * scale[:, None]
    return np.asarray(sensitivity @ sensitivity.T)


def unobserved_directions(
    information: Float[np.ndarray, "k k"], parameters: Sequence[Parameter]
) -> tuple[tuple[str, ...], Float[np.ndarray, " k"]]:
    """Name the directions that the data tell less well than the prior does.

    Args:
        information: Inverse covariance of the data alone, in steps of the parameters' scales; need not be definite.
        parameters: What its rows are.

    Returns:
        A sentence a direction, and the roots of the eigenvalues, weakest first.
    """
    prior = np.array([parameter.prior_sigma / parameter.scale for parameter in parameters])
    eigenvalues, vectors = np.linalg.eigh(information)
    roots = np.sqrt(np.maximum(eigenvalues, 0.0))
    sentences = []
    for root, vector in zip(roots, vectors.T, strict=True):
        if root**2 < float(vector @ (vector / prior**2)):
            *others, last = [
                parameter.name for parameter, share in zip(parameters, vector, strict=True) if abs(share) > _NAMED
            ]
            sentences.append(
                f"{', '.join(others)} and {last} cannot be told apart here" if others else f"{last} is not observed"
            )
    return tuple(sentences), roots


def rigid_motion(value: Float[np.ndarray, " 6"]) -> Float[np.ndarray, "4 4"]:
    """The six unknowns of a pose as a motion: a rotation vector in rad, then a shift in metres; shape (4, 4)."""
    return pose(Rotation.from_rotvec(value[:3]).as_matrix(), value[3:])


def motion_vector(motion: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, " 6"]:
    """The inverse of :func:`rigid_motion`: turns in rad, shifts in metres, shape (6,)."""
    return np.concatenate([Rotation.from_matrix(motion[:3, :3]).as_rotvec(), motion[:3, 3]])


@dataclass(frozen=True, eq=False)
class _ScaledProblem:
    """Residuals and prior in scaled steps from the start."""

    residuals: ResidualFunction
    start: Float[np.ndarray, " k"]
    scale: Float[np.ndarray, " k"]
    prior: Float[np.ndarray, " k"]

    def weighted(self, x: Float[np.ndarray, " k"], weight: Float[np.ndarray, " n"]) -> Float[np.ndarray, " m"]:
        """Residuals times the roots of their weights, and the prior's."""
        rows = self.residuals(self.start + x * self.scale) * np.sqrt(weight)[:, None]
        return np.concatenate([rows.ravel(), x / self.prior])

    def step(
        self, x: Float[np.ndarray, " k"], weight: Float[np.ndarray, " n"], steps: int
    ) -> tuple[Float[np.ndarray, " k"], bool]:
        """A Gauss-Newton step, for the weights change after it anyway; a full descent where that leads uphill."""
        here = self.weighted(x, weight)
        eye = 0.1 * np.eye(len(x))
        slope = np.stack([(self.weighted(x + e, weight) - self.weighted(x - e, weight)) / 0.2 for e in eye], axis=1)
        step = -np.linalg.solve(slope.T @ slope, slope.T @ here) if np.isfinite(slope).all() else np.zeros(len(x))
        there = self.weighted(x + step, weight)
        if step.any() and float(there @ there) <= float(here @ here) * (1 + 1e-9):
            return x + step, True
        descent = least_squares(self.weighted, x, args=(weight,), method="trf", max_nfev=steps, x_scale=1.0, xtol=1e-10)
        return descent.x, bool(descent.success)


def _scales(parameters: Sequence[Parameter]) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Scales, and the priors' sigmas in their steps."""
    scale = np.array([parameter.scale for parameter in parameters])
    return scale, np.array([parameter.prior_sigma for parameter in parameters]) / scale


def _huber_weights(residuals: Float[np.ndarray, "n d"], huber: float) -> Float[np.ndarray, " n"]:
    length = np.linalg.norm(residuals, axis=1)
    return np.minimum(1.0, huber / np.maximum(length, 1e-12))


def _jacobian(
    residuals: ResidualFunction, value: Float[np.ndarray, " k"], scale: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "n d k"]:
    """Central differences, a step of ``scale``."""
    steps = np.diag(scale) * 0.1
    return np.stack([(residuals(value + step) - residuals(value - step)) / 0.2 for step in steps], axis=-1)


def _robust_covariance(
    jacobian: Float[np.ndarray, "n d k"],
    residuals: Float[np.ndarray, "n d"],
    weight: Float[np.ndarray, " n"],
    prior: Float[np.ndarray, " k"],
    group: Int[np.ndarray, " n"],
    chi2: float,
    huber: float,
) -> tuple[Float[np.ndarray, "k k"], Float[np.ndarray, "k k"]]:
    """Covariance in scaled steps, and the data's information matrix; ``chi2``: of a degree of freedom."""
    fisher = np.einsum("n,ndi,ndj->ij", weight, jacobian, jacobian)

    # 1. The cost's curvature: a residual beyond Huber's limit does not bend it along itself.
    length = np.maximum(np.linalg.norm(residuals, axis=1), 1e-12)
    along = np.einsum("ndi,nd->ni", jacobian, residuals / length[:, None])
    beyond = weight * (length > huber)
    inverse = np.linalg.inv(fisher - np.einsum("n,ni,nj->ij", beyond, along, along) + np.diag(chi2 / prior**2))
    plain = chi2 * inverse

    # 2. The jackknife over groups: how far the solution moves without each of them.
    _, members = np.unique(group, return_inverse=True)
    count = int(members.max()) + 1
    k = len(prior)
    gradients, bends = np.zeros((count, k)), np.zeros((count, k, k))
    np.add.at(gradients, members, np.einsum("n,ndi,nd->ni", weight, jacobian, residuals))
    np.add.at(bends, members, np.einsum("n,ndi,ndj->nij", weight, jacobian, jacobian))
    np.add.at(bends, members, -np.einsum("n,ni,nj->nij", beyond, along, along))
    steps = np.linalg.solve(np.linalg.inv(inverse) - bends, gradients[..., None])[..., 0]
    steps -= steps.mean(axis=0)
    clustered = steps.T @ steps * ((count - 1) / count)
    clustered += inverse @ np.diag(chi2**2 / prior**2) @ inverse  # what the prior itself may be off
    factor = np.sqrt(np.maximum(np.diag(clustered), np.diag(plain)) / np.diag(plain))
    return plain * np.outer(factor, factor), fisher
