"""What grows before and between the houses of a town: hedges, shrubs, small trees, strips of tall grass."""

from collections.abc import Callable

import numpy as np

from farfield.simulation.bodies.plants import shrub, tall_grass
from farfield.simulation.world.layout import Roadside

_HEDGED, _GRASSY = 0.35, 0.2  # shares of the fronts
_SHRUBS_PER_M, _TREES_PER_M = 0.35, 0.06
_SHRUBS_TO_M, _TREES_TO_M = 9.0, 14.0  # how deep into the plots


def plant_fronts(side: Roadside, sign: int, front_m: float, clear: Callable[[float, float], bool]) -> None:
    """Plant the fronts of one side of a street; nothing where plants are opaque facets.

    Args:
        side: Takes the plants, and says by what stream they are drawn.
        sign: 1 left, -1 right.
        front_m: Where plots begin, from the reference line; nothing grows where something stands.
        clear: Whether a station with so much to both sides lies off the side streets.
    """
    rng = side.leaf_rng
    if rng is None:
        return
    shrubs = [shrub(rng.uniform(0.4, 1.6), rng) for _ in range(8)]
    grasses = [tall_grass(3.0, rng.uniform(0.5, 1.2), rng.uniform(0.15, 0.5), rng) for _ in range(3)]
    # along the fronts: hedges, tall grass, nothing
    s_m = side.first_m
    while s_m < side.last_m:
        length_m, draw = float(rng.uniform(4, 20)), rng.random()
        d_m = sign * (front_m + float(rng.uniform(0.4, 1.0)))
        if clear(s_m + length_m / 2, length_m / 2 + 1.0) and draw < _HEDGED:
            rows = np.linspace(s_m, s_m + length_m, max(2, int(length_m / 4) + 1))
            side.hedge(rows, d_m, float(rng.uniform(0.6, 2.0)), float(rng.uniform(0.5, 1.1)))
        elif clear(s_m + length_m / 2, length_m / 2 + 1.0) and draw < _HEDGED + _GRASSY:
            for s in np.arange(s_m + 1.5, s_m + length_m, 2.9):
                grass, turn = grasses[int(rng.integers(3))], np.pi * int(rng.integers(2))
                side.put(grass, float(s), d_m, turn_rad=turn)
        s_m += length_m + float(rng.uniform(0, 6))
    # scattered behind them: shrubs and trees
    for models, per_m, deep_m in ((shrubs, _SHRUBS_PER_M, _SHRUBS_TO_M), (side.trees, _TREES_PER_M, _TREES_TO_M)):
        for _ in range(int(rng.poisson(per_m * (side.last_m - side.first_m)))):
            s, d = float(rng.uniform(side.first_m, side.last_m)), front_m + 0.6 + deep_m * float(rng.random()) ** 1.5
            if clear(s, 2.0):
                model, turn = models[int(rng.integers(len(models)))], float(rng.uniform(0, 6.28))
                side.put(model, s, sign * d, turn_rad=turn)
