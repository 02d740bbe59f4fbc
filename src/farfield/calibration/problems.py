"""A calibration as whitened residuals: robust least squares, sigma from blocks of frames, and what is not observed."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import least_squares

from farfield.errors import ConfigError

_HUBER = 1.345
_ROUNDS, _STILL = 20, 1e-3  # of the reweighting; steps of ``scale``
_NAMED = 0.35  # share of a direction from which a parameter is named
_UNITS = {"rad": ("deg", 180 / np.pi), "m": ("cm", 100.0), "s": ("ms", 1000.0), "px": ("px", 1.0), "": ("", 1.0)}
Progress = Callable[[float], None]
"""Is told the share of a solver's work that is done, 0 to 1; it may raise to end the work."""


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
    """What was found.

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
    residuals: Callable[[Float[np.ndarray, " k"]], Float[np.ndarray, "n d"]],
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

    The sigma is the cluster-robust one (Liang and Zeger, Biometrika 1986, eq. 7: the analytic form of a bootstrap over
    blocks of frames), because residuals within a frame are not independent; the plain one where that is larger. A
    direction is not observed where one over the root of its information, the prior left out, exceeds the prior's sigma.

    Args:
        residuals: From values, shape (k,), to n residuals of d components, divided by their sigma.
        start: The priors' means, and values to begin with unless ``begin`` is given.
        parameters: What each value is.
        group: Block of frames of each residual, shape (n,); each its own unless given.
        share: For how many observations each residual counts, shape (n,): less than one where several err alike.
        begin: Values to begin with, shape (k,).
        huber: From how many sigma a residual counts linearly.
        steps: Most evaluations of the Jacobian in each of the rounds that a plain step does not serve.

    Raises:
        ConfigError: If there are no residuals, or they are not finite at the start.
    """
    start = np.asarray(start, dtype=np.float64)
    scale = np.array([each.scale for each in parameters])
    prior = np.array([each.prior_sigma for each in parameters]) / scale
    first = residuals(start)
    if not first.size or not np.isfinite(first).all():
        raise ConfigError("calibration: expected finite residuals at the start, got none; give a nearer start")
    own = np.ones(len(first)) if share is None else share
    total = _ScaledProblem(residuals, start, scale, prior)
    x = np.zeros(len(start)) if begin is None else (np.asarray(begin, dtype=np.float64) - start) / scale
    weight, converged = own * _weights(residuals(start + x * scale), huber), False
    for _ in range(_ROUNDS):
        found, done = total.stepped(x, weight, steps)
        moved, x = float(np.abs(found - x).max()), found
        weight = own * _weights(residuals(start + x * scale), huber)
        converged = done and moved < _STILL
        if converged:
            break
    value = start + x * scale
    solution = appraise(residuals, value, parameters, group=group, share=share, huber=huber, weight=weight)
    return replace(solution, before=np.linalg.norm(first, axis=1), converged=converged)


def appraise(
    residuals: Callable[[Float[np.ndarray, " k"]], Float[np.ndarray, "n d"]],
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
        weight: Of each residual, shape (n,); from its length and ``share`` unless given.

    Raises:
        ConfigError: If there are no residuals, or they are not finite.
    """
    last = residuals(value)
    if not last.size or not np.isfinite(last).all():
        raise ConfigError("calibration: expected finite residuals, got none")
    own = np.ones(len(last)) if share is None else share
    weight = own * _weights(last, huber) if weight is None else weight
    scale = np.array([each.scale for each in parameters])
    prior = np.array([each.prior_sigma for each in parameters]) / scale
    jacobian = _jacobian(residuals, value, scale)
    numbers = np.arange(len(last)) if group is None else group
    spare = max(float(own.sum()) * last.shape[1] - len(prior), 1.0)
    factor = max(float((weight[:, None] * last**2).sum()) / spare, 1e-12)
    covariance, unobserved, information = _spread(jacobian, last, weight, prior, numbers, parameters, factor)
    length = np.linalg.norm(last, axis=1)
    return Solution(
        parameters=tuple(parameters),
        value=value,
        covariance=covariance * np.outer(scale, scale),
        unobserved=unobserved,
        before=length,
        after=length,
        converged=False,
        information=information,
    )


def consider_covariance(
    residuals: Callable[[Float[np.ndarray, " k"]], Float[np.ndarray, "n d"]],
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
    last = residuals(value)
    own = np.ones(len(last)) if share is None else share
    scale = np.array([each.scale for each in parameters])
    prior = np.array([each.prior_sigma for each in parameters]) / scale
    jacobian, weight = _jacobian(residuals, value, scale), own * _weights(last, huber)
    fisher = np.einsum("n,ndi,ndj->ij", weight, jacobian, jacobian) + np.diag(1.0 / prior**2)
    moved = np.linalg.solve(fisher, np.einsum("n,ndi,end->ie", weight, jacobian, errors)) * scale[:, None]
    return np.asarray(moved @ moved.T)


@dataclass(frozen=True, eq=False)
class _ScaledProblem:
    """Residuals and prior in scaled steps from the start."""

    residuals: Callable[[Float[np.ndarray, " k"]], Float[np.ndarray, "n d"]]
    start: Float[np.ndarray, " k"]
    scale: Float[np.ndarray, " k"]
    prior: Float[np.ndarray, " k"]

    def weighted(self, x: Float[np.ndarray, " k"], weight: Float[np.ndarray, " n"]) -> Float[np.ndarray, " m"]:
        found = self.residuals(self.start + x * self.scale) * np.sqrt(weight)[:, None]
        return np.concatenate([found.ravel(), x / self.prior])

    def stepped(
        self, x: Float[np.ndarray, " k"], weight: Float[np.ndarray, " n"], steps: int
    ) -> tuple[Float[np.ndarray, " k"], bool]:
        """A Gauss-Newton step, for the weights change after it anyway; a whole descent where that leads uphill."""
        here = self.weighted(x, weight)
        eye = 0.1 * np.eye(len(x))
        slope = np.stack([(self.weighted(x + e, weight) - self.weighted(x - e, weight)) / 0.2 for e in eye], axis=1)
        step = -np.linalg.solve(slope.T @ slope, slope.T @ here) if np.isfinite(slope).all() else np.zeros(len(x))
        there = self.weighted(x + step, weight)
        if step.any() and float(there @ there) <= float(here @ here) * (1 + 1e-9):
            return x + step, True
        done = least_squares(self.weighted, x, args=(weight,), method="trf", max_nfev=steps, x_scale=1.0, xtol=1e-10)
        return done.x, bool(done.success)


def _weights(residuals: Float[np.ndarray, "n d"], huber: float) -> Float[np.ndarray, " n"]:
    length = np.linalg.norm(residuals, axis=1)
    return np.minimum(1.0, huber / np.maximum(length, 1e-12))


def _jacobian(
    residuals: Callable[[Float[np.ndarray, " k"]], Float[np.ndarray, "n d"]],
    value: Float[np.ndarray, " k"],
    scale: Float[np.ndarray, " k"],
) -> Float[np.ndarray, "n d k"]:
    steps = np.diag(scale) * 0.1
    return np.stack([(residuals(value + step) - residuals(value - step)) / 0.2 for step in steps], axis=-1)


def _spread(
    jacobian: Float[np.ndarray, "n d k"],
    last: Float[np.ndarray, "n d"],
    weight: Float[np.ndarray, " n"],
    prior: Float[np.ndarray, " k"],
    group: Int[np.ndarray, " n"],
    parameters: Sequence[Parameter],
    factor: float,
) -> tuple[Float[np.ndarray, "k k"], tuple[str, ...], Float[np.ndarray, " k"]]:
    """Covariance in scaled steps, what is not observed, and the information's roots; ``factor``: chi^2 a freedom."""
    fisher = np.einsum("n,ndi,ndj->ij", weight, jacobian, jacobian)
    inverse = np.linalg.inv(fisher + np.diag(factor / prior**2))
    plain = factor * inverse
    _, members = np.unique(group, return_inverse=True)
    count = int(members.max()) + 1
    pulls = np.zeros((count, len(prior)))
    np.add.at(pulls, members, np.einsum("n,ndi,nd->ni", weight, jacobian, last))
    pulls -= pulls.mean(axis=0)
    blocks = inverse @ (pulls.T @ pulls * (count / max(count - 1, 1))) @ inverse
    blocks += inverse @ np.diag(factor**2 / prior**2) @ inverse  # what the prior itself may be off
    diagonal = np.sqrt(np.maximum(np.diag(blocks), np.diag(plain)) / np.diag(plain))
    covariance = plain * np.outer(diagonal, diagonal)
    return covariance, *unobserved_directions(fisher / factor, parameters)


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
    prior = np.array([each.prior_sigma / each.scale for each in parameters])
    eigenvalues, vectors = np.linalg.eigh(information)
    roots = np.sqrt(np.maximum(eigenvalues, 0.0))
    named = [
        _sentence(vector, parameters)
        for root, vector in zip(roots, vectors.T, strict=True)
        if root**2 < float(vector @ (vector / prior**2))
    ]
    return tuple(named), roots


def _sentence(vector: Float[np.ndarray, " k"], parameters: Sequence[Parameter]) -> str:
    names = [each.name for each, share in zip(parameters, vector, strict=True) if abs(share) > _NAMED]
    if len(names) == 1:
        return f"{names[0]} is not observed"
    return f"{', '.join(names[:-1])} and {names[-1]} cannot be told apart here"
