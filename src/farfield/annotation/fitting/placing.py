"""A box's stretch along an axis from three kinds of evidence: points, rays that passed beyond them, and usual size."""

import numpy as np
from jaxtyping import Float

from farfield.annotation.fitting.anchoring import axes, footprint
from farfield.annotation.fitting.contract import Prior
from farfield.annotation.fitting.freespace import Ends

_SPREAD = (0.08, 0.08)  # of lengths and widths within a class, as parts of the usual one
_FIXED_SPREAD_M = 0.03
_CERTAIN = 3.0  # spreads beyond which rays that pass contradict the size: then they are not believed
_PASSED_M = 0.2  # bodies are rounded, and mirrors stand out: a box reaches so far (one sigma) into what rays passed
_SEEN_M, _FACE_M = 0.5, 0.02  # an end of the length with a ray so near is seen: its points lie on its face
_NEAR_FACE_M = 0.3  # how far behind the face towards the sensor its first point lies where no ray tells
_STEPS = 61


def placed(ends: Ends, xy_m: Float[np.ndarray, "n 2"], yaw_rad: float, prior: Prior) -> Float[np.ndarray, " 5"]:
    """The rectangle of an object at a yaw (x, y, length, width, yaw) from its points and the rays past them.

    Along each axis the two ends lie beyond the outermost points and not beyond the nearest ray that passed. Within
    these bounds the usual size, with its spread in the class, decides: the mean of what remains possible is taken.
    Where no ray passed at either end, or the rays contradict the size, it is as :func:`footprint` has it.

    Args:
        ends: Points and passing rays along the two axes.
        xy_m: The object's points seen from above, at least one.
        yaw_rad: The heading.
        prior: Size, and where the sensor stands.
    """
    plain = footprint(xy_m, yaw_rad, prior)
    if not (prior.anchored and prior.grows):
        return plain
    turn, ego = axes(yaw_rad), np.array(prior.ego_m)
    centre, size = turn @ (plain[:2] - ego), plain[2:4].copy()
    for axis in (0, 1):
        found = _stretch(ends.hit_m[axis], ends.gap_m[axis], prior, axis)
        if found is not None:
            centre[axis] = (found[0] + found[1]) / 2
            if axis == 0 and not prior.fixed_size:
                size[axis] = found[1] - found[0]
    x, y = centre @ turn + ego
    return np.array([x, y, *size, yaw_rad])


def _stretch(
    hit_m: Float[np.ndarray, " 2"], gap_m: Float[np.ndarray, " 2"], prior: Prior, axis: int
) -> tuple[float, float] | None:
    """Where an object begins and ends along an axis; None where nothing is told that the points do not tell."""
    usual, seen = prior.size_m[axis], float(hit_m[1] - hit_m[0])
    spread = _FIXED_SPREAD_M if prior.fixed_size else _SPREAD[axis] * usual
    if not np.isfinite(gap_m).any() or seen + gap_m.sum() < usual - (_CERTAIN * spread if axis == 0 else np.inf):
        return None
    most = max(usual + _CERTAIN * spread - seen, 0.0)
    before, behind = (np.linspace(0, value, _STEPS) for value in np.minimum(gap_m + 3 * _PASSED_M, most))
    size = seen + before[:, None] + behind[None, :]
    beyond = np.maximum(before[:, None] - gap_m[0], 0) ** 2 + np.maximum(behind[None, :] - gap_m[1], 0) ** 2
    exponent = -0.5 * ((size - usual) / spread) ** 2 - 0.5 * beyond / _PASSED_M**2
    scales = np.where((gap_m < _SEEN_M) & (axis == 0), _FACE_M, np.inf)
    if hit_m[0] > 0:
        scales[0] = min(scales[0], _NEAR_FACE_M)
    elif hit_m[1] < 0:
        scales[1] = min(scales[1], _NEAR_FACE_M)
    exponent = exponent - before[:, None] / scales[0] - behind[None, :] / scales[1]
    weight = np.exp(exponent - exponent.max())
    weight /= weight.sum()
    return float(hit_m[0] - (weight.sum(axis=1) * before).sum()), float(hit_m[1] + (weight.sum(axis=0) * behind).sum())
