"""What a scene template hands over: the road, its fixed surroundings piece by piece, and its population."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from farfield.simulation.bodies.mesh import Mesh
from farfield.simulation.world.population import Population
from farfield.simulation.world.road import RoadLine

CHUNK_M = 100.0


@dataclass(frozen=True)
class Placement:
    """One fixed object: where along the road it belongs, and what builds it."""

    s_m: float
    build: Callable[[np.random.Generator], Mesh]


@dataclass(eq=False)
class Layout:
    """A road and what stands beside it, built in pieces of ``CHUNK_M``.

    Args:
        road: The reference line.
        surface: Builds ground, barriers and other continuous things over given stations along the road.
        population: Its road users.
        seed: Draws shapes and paint of the fixed objects.
        placements: The fixed objects.
        breaks_m: Stations at which the surface changes and needs a row of its own.
    """

    road: RoadLine
    surface: Callable[[Float[np.ndarray, " k"], np.random.Generator], Mesh]
    population: Population
    seed: np.random.SeedSequence
    placements: list[Placement] = field(default_factory=list)
    breaks_m: tuple[float, ...] = ()

    def chunk(self, index: int) -> Mesh:
        """The fixed surroundings between ``index`` and ``index + 1`` times ``CHUNK_M``; always the same ones."""
        key = index if index >= 0 else 100_000 - index
        rng = np.random.default_rng(np.random.SeedSequence(self.seed.entropy, spawn_key=(*self.seed.spawn_key, key)))
        first, last = index * CHUNK_M, (index + 1) * CHUNK_M
        inner = [s for s in self.breaks_m if first < s < last]
        rows = np.unique(np.concatenate([np.linspace(first, last, 26), inner]))
        parts = [self.surface(rows, rng)]
        parts += [place.build(rng).painted(rng) for place in self.placements if first <= place.s_m < last]
        return Mesh.merge(parts)
