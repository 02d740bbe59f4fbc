"""Heights of the ground where its triangles lie, on which things stand.

:meth:`Land.rise_m` gives the ground as it was drawn; its triangles follow that at the strips' edges and at the nodes of
the land beyond only, and between them lie up to metres higher or lower on steep slopes.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from farfield.simulation.bodies.mesh import Mesh
from farfield.simulation.trace import Tracer
from farfield.simulation.world.land import Land

CHUNK_M = 100.0
"""The fixed surroundings are built in pieces of this length."""
_PIECES = 12  # so many are remembered


def chunk_rows(index: int, breaks_m: tuple[float, ...]) -> Float[np.ndarray, " k"]:
    """Stations of the ground's rows within one piece of ``CHUNK_M``."""
    first, last = index * CHUNK_M, (index + 1) * CHUNK_M
    inner = [s for s in breaks_m if first < s < last]
    return np.unique(np.concatenate([np.linspace(first, last, 26), inner]))


class GroundSurface:
    """The ground's triangles, piece by piece, seen from above.

    Args:
        land: The ground as it was drawn.
        breaks_m: Stations at which it needs a row of its own.

    Attributes:
        verges: Build uneven ground over given stations; it lies on the land.
    """

    def __init__(self, land: Land, breaks_m: tuple[float, ...]) -> None:
        self.land, self.breaks_m = land, breaks_m
        self.verges: list[Callable[[Float[np.ndarray, " k"]], Mesh]] = []
        self._land: dict[int, list[Mesh]] = {}
        self._tracers: dict[int, Tracer] = {}

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "_tracers": {}}  # Embree's scenes do not travel

    def pieces(self, index: int) -> list[Mesh]:
        """The strips of one piece and the land beyond them; of the latest ``_PIECES`` they are not built twice."""
        if index not in self._land:
            rows = chunk_rows(index, self.breaks_m)
            self._land[index] = [self.land.strips(rows), self.land.beyond(float(rows[0]), float(rows[-1]))]
            if len(self._land) > _PIECES:
                del self._land[next(iter(self._land))]
        return self._land[index]

    def _tracer(self, index: int) -> Tracer:
        if index not in self._tracers:
            rows = chunk_rows(index, self.breaks_m)
            parts = [*self.pieces(index), *(build(rows) for build in self.verges)]
            anchor_m = self.land.road.point_m(np.array((index + 0.5) * CHUNK_M), 0.0)
            self._tracers[index] = Tracer(Mesh.merge(parts), anchor_m=anchor_m)
            if len(self._tracers) > _PIECES:
                del self._tracers[next(iter(self._tracers))]
        return self._tracers[index]

    def height_m(self, xy_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """Height of the highest triangle of the ground at some places of the world; NaN where there is none."""
        out = np.full(len(xy_m), np.nan)
        if not len(xy_m):
            return out
        pieces = np.unique(np.floor(self.land.locate(xy_m)[0] / CHUNK_M).astype(int))
        down = np.tile(np.array([0.0, 0.0, -1.0]), (len(xy_m), 1))
        for index in sorted({int(piece) + beside for piece in pieces for beside in (-1, 0, 1)}):
            tracer = self._tracer(index)
            top_m = float(tracer.corners_m[-1, 2]) + 1.0
            hits = tracer.cast_from(np.column_stack([xy_m, np.full(len(xy_m), top_m)]), down)
            out = np.fmax(out, np.where(hits.face >= 0, top_m - hits.range_m, np.nan))
        return out
