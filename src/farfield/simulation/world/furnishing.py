"""Street furniture on its places: along kerbs, before fronts, on open lots and verges; fences, and poles with wires.

Furniture stands only where nothing else stands, never on a carriageway, and road users keep clear of it.
"""

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
from jaxtyping import Float

from farfield.simulation.bodies import street as models
from farfield.simulation.bodies.mesh import Mesh
from farfield.simulation.world.land import Land
from farfield.simulation.world.layout import Roadside
from farfield.simulation.world.taken_ground import low_bounds_m, rectangle_of

_VARIANTS = 3  # of each kind in one world
_SECTION_M = 3.0  # fences follow bends in straight sections

KERB = {
    "litter_bin": 2.0, "cabinet": 4.0, "bicycle_rack": 4.0, "bollards": 2.0, "bench": 2.0, "poster": 2.0,
    "shelter": 1.5, "meters": 2.0, "planter": 2.5, "wheeled_bins": 5.0, "cones": 1.0, "barrier_board": 1.5,
    "dumpster": 2.0, "stack": 0.5,
}  # fmt: skip
"""What stands between a kerb and those who walk, with weights (ours: there is no census of street furniture)."""
FRONT = {
    "wheeled_bins": 5.0, "bicycles": 4.0, "cabinet": 2.0, "bench": 2.0, "planter": 3.0, "cafe": 2.0,
    "dumpster": 3.0, "stack": 1.0, "poster": 1.0, "kiosk": 1.0, "picnic_table": 1.0, "bollards": 1.0,
    "skip": 1.0,
}  # fmt: skip
"""What stands between a pavement and the fronts behind it."""
YARD = {
    "skip": 3.0, "cabin": 2.0, "mound": 2.0, "stack": 4.0, "toilet": 1.0, "dumpster": 4.0, "kiosk": 2.0,
    "boulder": 1.0, "wheeled_bins": 2.0, "excavation": 1.0, "logs": 0.5, "bicycles": 1.0,
}  # fmt: skip
"""What stands on an open lot between buildings."""
GARDEN = {
    "wheeled_bins": 5.0, "picnic_table": 2.0, "stack": 2.0, "cabin": 0.5, "logs": 1.5, "skip": 0.7,
    "planter": 2.0, "mound": 0.7, "boulder": 0.5, "bench": 1.0,
}  # fmt: skip
CAMPUS = {
    "bench": 4.0, "bicycles": 6.0, "bicycle_rack": 3.0, "planter": 3.0, "poster": 2.0, "picnic_table": 3.0,
    "cabinet": 2.0, "litter_bin": 2.0, "boulder": 1.0, "kiosk": 1.0, "dumpster": 1.5, "bollards": 2.0,
}  # fmt: skip
CAR_PARK = {
    "cabinet": 2.0, "dumpster": 3.0, "meters": 2.0, "bicycles": 2.0, "kiosk": 1.5, "stack": 1.0,
    "litter_bin": 1.0, "bench": 1.0, "planter": 1.5, "poster": 1.0, "skip": 1.0,
}  # fmt: skip
ALLEY = {
    "wheeled_bins": 6.0, "stack": 2.0, "planter": 3.0, "cabinet": 3.0, "bicycle_rack": 2.0, "litter_bin": 1.0,
    "bench": 1.0,
}  # fmt: skip
ROADSIDE = {
    "cabinet": 3.0, "boulder": 2.0, "direction_sign": 4.0, "mound": 2.0, "stack": 1.0, "barrier_board": 2.0,
    "cones": 2.0, "logs": 1.0, "kiosk": 0.5,
}  # fmt: skip
"""What stands on the verge of a highway."""
COUNTRY = {
    "boulder": 4.0, "logs": 4.0, "mound": 2.0, "direction_sign": 2.0, "cabinet": 1.0, "stack": 1.0,
    "bench": 1.0, "barrier_board": 1.0,
}  # fmt: skip


def always_clear(s_m: float, reach_m: float) -> bool:  # noqa: ARG001
    """Whether a station is away from side streets, where there are none."""
    return True


class Furnishing:
    """Puts furniture beside one road.

    Args:
        side: The roadside, with what already stands there.
        rng: Draws kinds and places.
        clear: Whether a station is further than so many metres from every side street.
    """

    def __init__(
        self,
        side: Roadside,
        rng: np.random.Generator,
        clear: Callable[[float, float], bool],
    ) -> None:
        self.side, self.rng, self.clear = side, rng, clear
        self._models: dict[str, list[Mesh]] = {}

    def model(self, kind: str) -> Mesh:
        """One of the few variants of a kind in this world."""
        variants = self._models.setdefault(kind, [])
        if len(variants) < _VARIANTS:
            variants.append(models.KINDS[kind](self.rng))
            return variants[-1]
        return variants[int(self.rng.integers(_VARIANTS))]

    def draw(self, weights: Mapping[str, float]) -> Mesh:
        """A model of a kind by its weight."""
        shares = np.array(list(weights.values()))
        return self.model(str(self.rng.choice(list(weights), p=shares / shares.sum())))

    def stand(
        self, model: Mesh, s_m: float, side: int, d_m: float, *, turn_rad: float = 0.0, spare_m: float = 0.3
    ) -> bool:
        """Stand a model at a distance from the reference line, if the ground is free there.

        Args:
            model: It faces the road.
            s_m: Its station.
            side: 1 left of the line, -1 right.
            d_m: Distance of its origin from the line.
            turn_rad: How far it is turned from facing the road.
            spare_m: Room around it that must be free as well.

        Returns:
            Whether it stands there now.
        """
        turn = turn_rad + (0.0 if side > 0 else np.pi)
        first, last, right, left = rectangle_of(model, s_m, side * d_m, turn)
        if not self.clear((first + last) / 2, (last - first) / 2 + 1.0):
            return False
        if not self.side.ground.free(first - spare_m, last + spare_m, right - spare_m, left + spare_m):
            return False
        self.side.put(model, s_m, side * d_m, turn_rad=turn, only_free=False)
        return True

    def strip(
        self,
        side: int,
        near_m: float,
        far_m: float,
        pitch_m: float,
        weights: Mapping[str, float],
        *,
        spare_m: float = 0.3,
    ) -> None:
        """Furniture between two distances from the reference line, every ``pitch_m`` on average."""
        s = self.side.first_m + float(self.rng.exponential(pitch_m))
        while s < self.side.last_m:
            model = self.draw(weights)
            low, high = low_bounds_m(model)
            deep = float(high[1] - low[1])
            if deep <= far_m - near_m:
                d = near_m - float(low[1]) + float(self.rng.uniform(0.0, far_m - near_m - deep))
                self.stand(model, s, side, d, turn_rad=float(self.rng.normal(0.0, 0.03)), spare_m=spare_m)
            s += 0.5 * pitch_m + float(self.rng.exponential(0.5 * pitch_m))

    def fence(self, side: int, d_m: float, first_m: float, last_m: float, name: str, *, gates: float = 0.0) -> None:
        """A fence at a distance from the reference line, in sections, with gates in place of some of them."""
        section = models.FENCES[name](_SECTION_M, self.rng)
        for s in np.arange(first_m + _SECTION_M / 2, last_m - _SECTION_M / 2 + 0.01, _SECTION_M):
            gate = self.rng.random() < gates
            turn = np.pi if self.rng.random() < 0.5 and name == "boards" else 0.0
            self.stand(self.model("gate") if gate else section, float(s), side, d_m, turn_rad=turn, spare_m=-0.2)

    def wire_poles(self, side: int, d_m: float, pitch_m: float) -> None:
        """Wooden poles with wires from one to the next, and now and then one over the road to a house."""
        height, arm = float(self.rng.uniform(7.5, 9.5)), float(self.rng.uniform(0.8, 1.2))
        pole, land, before = models.wire_pole(height, arm), self.side.layout.land, np.nan
        for s in self.side.stations(pitch_m):
            for shift in (0.0, 1.0, 2.0, -1.0, -2.0):
                if self.stand(pole, float(s) + shift, side, d_m, spare_m=0.1):
                    here = float(s) + shift
                    across = -side * (d_m + 6.0) if self.rng.random() < 0.3 else 0.0
                    ends = (before, here, side * d_m, height, arm, across)
                    self.side.add(partial(_wires, land, ends, float(self.rng.uniform(0.4, 0.8))), here)
                    before = here
                    break

    def open_stretches(self, side: int, near_m: float, far_m: float, least_m: float) -> list[tuple[float, float]]:
        """Stretches without buildings and side streets between two distances from the line, as first and last s."""
        step, out, first = 2.0, [], np.nan
        right, left = sorted((side * near_m, side * far_m))
        for s in np.arange(self.side.first_m, self.side.last_m, step):
            if self.clear(float(s) + step / 2, step) and self.side.ground.free(float(s), float(s) + step, right, left):
                first = float(s) if np.isnan(first) else first
            elif not np.isnan(first):
                out.append((first, float(s)))
                first = np.nan
        return [(a, b) for a, b in out if b - a >= least_m]


def _wires(land: Land, ends: tuple[float, float, float, float, float, float], sag_m: float) -> Mesh:
    """Three wires from the pole before to this one, and one across the road."""
    before, here, d, height, arm, across = ends
    pairs: list[tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]] = []
    top, eaves = np.array([0.0, 0.0, height - 0.5]), np.array([0.0, 0.0, 5.0])
    if np.isfinite(before):
        for shift in (-arm, 0.0, arm):
            low, high = (_on_ground_m(land, s, d + shift) for s in (before, here))
            pairs.append((low + top, high + top))
    if across:
        low, high = _on_ground_m(land, here, d), _on_ground_m(land, here + 4.0, across)
        pairs.append((low + top, high + eaves))
    return models.wires(pairs, sag_m) if pairs else Mesh.merge([])


def _on_ground_m(land: Land, s_m: float, d_m: float) -> Float[np.ndarray, " 3"]:
    s, d = np.array([s_m]), np.array([d_m])
    return np.asarray(land.road.point_m(s, d)[0] + np.array([0.0, 0.0, float(land.rise_m(s, d)[0])]))
