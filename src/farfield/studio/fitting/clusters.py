"""The points that hang together with the one under the pointer."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

_THIN_M = 0.12  # denser clouds are thinned to one point a cell before neighbours are sought


def link_radius_m(range_m: float, *, small: bool) -> float:
    """How far neighbours may lie apart: it grows with the range, as the beams part; less for people."""
    if small:
        return 0.3 + 0.003 * range_m
    return float(np.clip(0.45 + 0.006 * range_m, 0.45, 1.6))


def cluster_at(
    points_m: Float[np.ndarray, "n 3"], at_m: tuple[float, float], radius_m: float
) -> Bool[np.ndarray, " n"]:
    """Which points are linked, by steps of at most ``radius_m``, with the one nearest to a place, shape (n,).

    Args:
        points_m: Points without the ground, shape (n, 3).
        at_m: x and y of the place.
        radius_m: Largest step.
    """
    if len(points_m) == 0:
        return np.zeros(0, dtype=np.bool_)
    cell, member = np.unique(np.floor(points_m / _THIN_M).astype(np.int64), axis=0, return_inverse=True)
    pairs = cKDTree((cell + 0.5) * _THIN_M).query_pairs(radius_m, output_type="ndarray")
    links = coo_array((np.ones(len(pairs), dtype=np.int8), (pairs[:, 0], pairs[:, 1])), shape=(len(cell), len(cell)))
    _, component = connected_components(links, directed=False)
    nearest = int(np.argmin(np.hypot(points_m[:, 0] - at_m[0], points_m[:, 1] - at_m[1])))
    of_point = component[member.ravel()]
    return np.asarray(of_point == of_point[nearest])
