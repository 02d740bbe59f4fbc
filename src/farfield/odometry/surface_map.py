"""A map of surfaces: a mean point a voxel, with the plane through its neighbours where there is one.

Voxels stand in arrays sorted by a key of their three numbers, so that a map is the same whatever made it, and can be
saved and restored. Planes are fitted when they are first needed: most voxels are never matched.
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float, Int, Int64
from scipy.spatial import cKDTree

_BITS = 21
_MIDDLE = 1 << (_BITS - 1)
_TABLE_BITS = 20
_GOLDEN = np.uint64(0x9E37_79B9_7F4A_7C15)
_NEIGHBOURS = 8
_LEAST_NEIGHBOURS = 5
_OBSERVATIONS = 8  # of which a mean is taken; what comes later no longer moves it
_NEIGHBOUR_VOXELS = 4.0  # voxels: farther points are no neighbours
_PLANE_RATIO = 0.5  # thickness of a plane's points, as a share of its shorter extent
_LINE_RATIO = 0.1  # shorter extent as a share of the longer one, below which they lie on a line


def voxel_rows(points_m: Float[np.ndarray, "n 3"], voxel_m: float) -> Int64[np.ndarray, " k"]:
    """Rows of one point a voxel, the first; a few voxels that share a slot in the table of hashes lose theirs."""
    cell = np.floor(points_m / voxel_m).astype(np.int64)
    key = (cell[:, 0] + (cell[:, 1] << _BITS) + (cell[:, 2] << 2 * _BITS)).view(np.uint64)
    slot = ((key * _GOLDEN) >> np.uint64(64 - _TABLE_BITS)).view(np.int64)  # Fibonacci hashing
    rows = np.arange(len(points_m), dtype=np.int32)
    first = np.full(1 << _TABLE_BITS, len(points_m), dtype=np.int32)
    first[slot[::-1]] = rows[::-1]
    return np.flatnonzero(first[slot] == rows)


class SurfaceMap:
    """Surfaces around the sensor.

    Args:
        voxel_m: Edge of a voxel.

    Attributes:
        mean_m: Mean point of each voxel, shape (n, 3).
        normal: Normal of its plane, once it was needed, shape (n, 3).
        has_plane: Whether it has a plane, shape (n,).
        normal_variance: Variance of the normal along the plane that scattered points alone make, in radians squared,
            shape (n,).
    """

    def __init__(self, voxel_m: float) -> None:
        self.voxel_m = voxel_m
        self._keys: Int64[np.ndarray, " n"] = np.zeros(0, dtype=np.int64)
        self._sum: Float[np.ndarray, "n 3"] = np.zeros((0, 3))
        self._count: Float[np.ndarray, " n"] = np.zeros(0)
        self._stale: Bool[np.ndarray, " n"] = np.zeros(0, dtype=bool)
        self.mean_m: Float[np.ndarray, "n 3"] = np.zeros((0, 3))
        self.normal: Float[np.ndarray, "n 3"] = np.zeros((0, 3))
        self.has_plane: Bool[np.ndarray, " n"] = np.zeros(0, dtype=bool)
        self.normal_variance: Float[np.ndarray, " n"] = np.zeros(0)
        self._tree: cKDTree | None = None

    def __len__(self) -> int:
        return len(self._keys)

    def insert(self, points_m: Float[np.ndarray, "n 3"], centre_m: Float[np.ndarray, " 3"], radius_m: float) -> None:
        """Add points, and forget voxels farther than ``radius_m`` from ``centre_m``."""
        cell = np.clip(np.floor(points_m / self.voxel_m).astype(np.int64) + _MIDDLE, 0, (1 << _BITS) - 1)
        keys, inverse = np.unique((cell[:, 0] << 2 * _BITS) | (cell[:, 1] << _BITS) | cell[:, 2], return_inverse=True)
        count = np.bincount(inverse, minlength=len(keys)).astype(np.float64)
        total = np.stack([np.bincount(inverse, points_m[:, axis], len(keys)) for axis in range(3)], axis=1)
        # Voxels of the map take further points, until they have observations enough.
        index: Int[np.ndarray, " k"] = np.asarray(np.searchsorted(self._keys, keys))
        in_map = index < len(self._keys)
        in_map[in_map] = self._keys[index[in_map]] == keys[in_map]
        grows = in_map.copy()
        grows[in_map] = self._count[index[in_map]] < _OBSERVATIONS
        self._sum[index[grows]] += total[grows]
        self._count[index[grows]] += count[grows]
        self._stale[index[grows]] = True
        # New voxels.
        new = index[~in_map]
        self._keys = np.insert(self._keys, new, keys[~in_map])
        self._sum = np.insert(self._sum, new, total[~in_map], axis=0)
        self._count = np.insert(self._count, new, count[~in_map])
        self._stale = np.insert(self._stale, new, True)
        self.normal = np.insert(self.normal, new, 0.0, axis=0)
        self.has_plane = np.insert(self.has_plane, new, False)
        self.normal_variance = np.insert(self.normal_variance, new, 0.0)
        # Voxels that are too far away.
        self.mean_m = self._sum / self._count[:, None]
        near = ((self.mean_m - centre_m) ** 2).sum(1) < radius_m**2
        if not near.all():
            self._keys, self._sum, self._count = self._keys[near], self._sum[near], self._count[near]
            self._stale, self.normal, self.has_plane = self._stale[near], self.normal[near], self.has_plane[near]
            self.mean_m, self.normal_variance = self.mean_m[near], self.normal_variance[near]
        self._tree = None

    def nearest(
        self, points_m: Float[np.ndarray, "n 3"], within_m: float
    ) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"]]:
        """Pairs of points and voxels that have a plane: rows of ``points_m``, rows of this map's arrays."""
        if not len(self):
            return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
        distance, row = self.tree.query(points_m, distance_upper_bound=within_m)
        near = np.flatnonzero(np.isfinite(distance))
        row = np.asarray(row)[near]
        stale = np.unique(row[self._stale[row]])
        if len(stale):
            self._fit_planes(stale)
        is_plane = self.has_plane[row]
        return near[is_plane], row[is_plane]

    @property
    def tree(self) -> cKDTree:
        """Search tree of the voxels' means."""
        if self._tree is None:
            self._tree = cKDTree(self.mean_m, leafsize=16, balanced_tree=False, compact_nodes=False)
        return self._tree

    def _fit_planes(self, rows: Int[np.ndarray, " k"]) -> None:
        """Fit planes to voxels and their neighbours."""
        centre_m = self.mean_m[rows]
        max_distance_m = _NEIGHBOUR_VOXELS * self.voxel_m
        distance, index = self.tree.query(centre_m, k=_NEIGHBOURS, distance_upper_bound=max_distance_m)
        near = np.isfinite(distance)
        weight = near.astype(np.float64)[:, :, None]
        offset = (self.mean_m[np.where(near, index, 0)] - centre_m[:, None]) * weight
        number = weight.sum(1)
        offset = (offset - (offset.sum(1) / number)[:, None]) * weight
        scatter = offset.transpose(0, 2, 1) @ offset / number[:, :, None]
        least, middle, most, self.normal[rows] = smallest_axis(scatter)
        is_plane = (least < _PLANE_RATIO**2 * middle) & (middle > _LINE_RATIO**2 * most)
        self.has_plane[rows] = is_plane & (near.sum(1) >= _LEAST_NEIGHBOURS)
        self.normal_variance[rows] = least / np.maximum(middle, 1e-12) / number[:, 0]
        self._stale[rows] = False

    def state(self) -> dict[str, np.ndarray]:
        """Its arrays, to be saved."""
        return {
            "keys": self._keys,
            "sum": self._sum,
            "count": self._count,
            "stale": self._stale,
            "normal": self.normal,
            "flat": self.has_plane,
            "wobble": self.normal_variance,
        }

    @classmethod
    def restored(cls, voxel_m: float, state: Mapping[str, np.ndarray]) -> "SurfaceMap":
        """The map whose arrays were saved."""
        surfaces = cls(voxel_m)
        surfaces._keys, surfaces._sum, surfaces._count = state["keys"], state["sum"], state["count"]
        surfaces._stale, surfaces.normal, surfaces.has_plane = state["stale"], state["normal"], state["flat"]
        surfaces.normal_variance = state["wobble"]
        surfaces.mean_m = surfaces._sum / surfaces._count[:, None]
        return surfaces


def smallest_axis(
    matrix: Float[np.ndarray, "n 3 3"],
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """Eigenvalues of symmetric matrices in rising order, and the unit eigenvector of the least.

    In closed form (Smith 1961): many times as fast as iterating over small matrices. The vector is the longest of the
    cross products of the rows of ``A - lambda I``.
    """
    scale = np.maximum(np.abs(matrix).max((1, 2)), 1e-30)
    a = matrix / scale[:, None, None]
    mean = np.trace(a, axis1=1, axis2=2) / 3
    b = a - mean[:, None, None] * np.eye(3)
    size = np.sqrt(np.maximum((b * b).sum((1, 2)) / 6, 1e-30))
    b = b / size[:, None, None]
    half = (b[:, 0] * np.cross(b[:, 1], b[:, 2])).sum(1) / 2
    angle = np.arccos(np.clip(half, -1, 1)) / 3
    most = mean + 2 * size * np.cos(angle)
    least = mean + 2 * size * np.cos(angle + 2 * np.pi / 3)
    middle = 3 * mean - most - least
    rows = a - least[:, None, None] * np.eye(3)
    crossed = np.cross(rows, rows[:, (1, 2, 0)])
    length = (crossed**2).sum(2)
    which = length.argmax(1)
    index = np.arange(len(a))
    vector, length2 = crossed[index, which], length[index, which]
    is_vector = length2 > 0
    vector = np.where(is_vector[:, None], vector / np.sqrt(np.where(is_vector, length2, 1))[:, None], (0.0, 0.0, 1.0))
    return np.maximum(least, 0) * scale, np.maximum(middle, 0) * scale, np.maximum(most, 0) * scale, vector
