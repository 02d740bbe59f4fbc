"""The points that hang together with the one under the pointer."""

import numpy as np
from jaxtyping import Bool, Float

_CELLS = 4.0  # cells to a step: denser clouds are thinned to one point a cell before neighbours are sought


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
    from scipy.sparse import coo_array  # scipy takes a third of the studio's start
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    if len(points_m) == 0:
        return np.zeros(0, dtype=np.bool_)
    cell_m = radius_m / _CELLS
    whole = np.floor(points_m / cell_m).astype(np.int64)
    whole -= whole.min(axis=0)
    code = np.ravel_multi_index(tuple(whole.T), tuple(whole.max(axis=0) + 1))
    _, first, member = np.unique(code, return_index=True, return_inverse=True)
    cell = whole[first]
    pairs = cKDTree((cell + 0.5) * cell_m).query_pairs(radius_m, output_type="ndarray")
    links = coo_array((np.ones(len(pairs), dtype=np.int8), (pairs[:, 0], pairs[:, 1])), shape=(len(cell), len(cell)))
    _, component = connected_components(links, directed=False)
    nearest = int(np.argmin(np.hypot(points_m[:, 0] - at_m[0], points_m[:, 1] - at_m[1])))
    of_point = component[member.ravel()]
    return np.asarray(of_point == of_point[nearest])
