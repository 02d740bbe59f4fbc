"""What all roads' builders share: streams of randomness, stretches of road and traffic, and materials."""

from dataclasses import dataclass, field

import numpy as np

from farfield.simulation.bodies.materials import Material
from farfield.simulation.world.land import Land
from farfield.simulation.world.layout import RoadLayout
from farfield.simulation.world.motion import STEP_S
from farfield.simulation.world.population import Lane, Population
from farfield.simulation.world.road import Bends, RoadLine
from farfield.simulation.world.roadside import Roadside

ASPHALT, CONCRETE, GRASS, SOIL, PAINT, BRICK, FOLIAGE = (
    int(m)
    for m in (
        Material.ASPHALT,
        Material.CONCRETE,
        Material.GRASS,
        Material.SOIL,
        Material.LANE_PAINT,
        Material.BRICK,
        Material.FOLIAGE,
    )
)
FIRST_M = -420.0  # surroundings begin so far behind the ego vehicle's start
_BEHIND_M, _AHEAD_M = 300.0, 450.0


@dataclass(eq=False)
class RoadBuild:
    """One sequence being built: its four streams, its duration and its prior of sizes.

    Args:
        seed: Spawns the streams of road, traffic, surroundings and paint.
        duration_s: For how long the traffic must last.
        sizes: Name of the size prior.
    """

    seed: np.random.SeedSequence
    duration_s: float
    sizes: str
    rng: np.random.Generator = field(init=False)
    around: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        road, traffic, around, self._paint_seed = self.seed.spawn(4)
        self.rng, self.around, self._traffic = (np.random.default_rng(each) for each in (road, around, traffic))

    def line(self, bends: Bends, ego_m_s: float) -> RoadLine:
        """A road long enough for everything that moves on it."""
        ahead = (2.0 * ego_m_s + 45.0) * self.duration_s + 1500.0
        return RoadLine.draw(self.rng, behind_m=45.0 * self.duration_s + 900.0, ahead_m=ahead, bends=bends)

    def population(self, road: RoadLine, *, long_haul: bool = False) -> Population:
        """Nobody yet."""
        steps = round(self.duration_s / STEP_S) + 2
        return Population(road, steps=steps, rng=self._traffic, sizes=self.sizes, long_haul=long_haul)

    def travel_m(self, ego_m_s: float) -> float:
        """How far the ego vehicle may come."""
        return 1.1 * ego_m_s * self.duration_s

    def layout(
        self, land: Land, population: Population, ego_m_s: float, breaks_m: tuple[float, ...] = ()
    ) -> tuple[RoadLayout, Roadside]:
        """An empty layout, and what fills it from ``FIRST_M`` to 420 m beyond the ego vehicle's end."""
        layout = RoadLayout(land, population, self._paint_seed, breaks_m=breaks_m)
        return layout, Roadside(layout, self.around, FIRST_M, self.travel_m(ego_m_s) + 420.0)

    def lane(
        self,
        offset_m: float,
        direction: int,
        gap_m: float,
        speed_m_s: float,
        width_m: float,
        ego_m_s: float,
        *,
        trucks: float = 0.0,
        trailers: float = 0.0,
        kind: str = "",
    ) -> Lane:
        """A lane filled so far that the ego vehicle's surroundings stay full for the whole duration."""
        if direction > 0:
            first = _BEHIND_M + max(0.0, 1.2 * speed_m_s - 0.6 * ego_m_s) * self.duration_s
            last = _AHEAD_M + max(0.0, 1.1 * ego_m_s - 0.6 * speed_m_s) * self.duration_s
        else:
            first, last = _BEHIND_M, _AHEAD_M + (1.1 * ego_m_s + 1.15 * speed_m_s) * self.duration_s
        return Lane(offset_m, direction, -first, last, gap_m, speed_m_s, width_m, trucks, trailers, kind)
