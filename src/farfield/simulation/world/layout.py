"""What a road's builder hands over: the road, its ground and fixed surroundings piece by piece, and its population."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from farfield.simulation.bodies.mesh import Mesh
from farfield.simulation.world.land import Land
from farfield.simulation.world.population import Population

CHUNK_M = 100.0


@dataclass(frozen=True)
class FixedObject:
    """One fixed object: where along the road it belongs, and what builds it."""

    s_m: float
    build: Callable[[np.random.Generator], Mesh]


@dataclass(eq=False)
class RoadLayout:
    """A road and what stands beside it, built in pieces of ``CHUNK_M``.

    Args:
        land: The ground, and with it the reference line.
        population: Its road users.
        seed: Draws paint of the fixed objects.
        running: Build what runs along the road (markings, rails, walls) over given stations.
        placements: The fixed objects.
        breaks_m: Stations at which the ground changes and needs a row of its own.
    """

    land: Land
    population: Population
    seed: np.random.SeedSequence
    running: list[Callable[[Float[np.ndarray, " k"]], Mesh]] = field(default_factory=list)
    placements: list[FixedObject] = field(default_factory=list)
    breaks_m: tuple[float, ...] = ()

    def chunk(self, index: int) -> Mesh:
        """The fixed surroundings between ``index`` and ``index + 1`` times ``CHUNK_M``; always the same ones."""
        key = index if index >= 0 else 100_000 - index
        rng = np.random.default_rng(np.random.SeedSequence(self.seed.entropy, spawn_key=(*self.seed.spawn_key, key)))
        first, last = index * CHUNK_M, (index + 1) * CHUNK_M
        inner = [s for s in self.breaks_m if first < s < last]
        rows = np.unique(np.concatenate([np.linspace(first, last, 26), inner]))
        parts = [self.land.strips(rows), self.land.beyond(first, last), *(build(rows) for build in self.running)]
        parts += [place.build(rng) for place in self.placements if first <= place.s_m < last]
        return Mesh.merge([part.painted(rng) for part in parts if len(part.faces)])
