"""The road users: kinds, their classes as in Cirrus, sizes and meshes."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from farfield.simulation.bodies.cars import BODY_STYLES, build_car
from farfield.simulation.bodies.gait import cycle_length_m
from farfield.simulation.bodies.mesh import Mesh
from farfield.simulation.bodies.people import (
    build_animal,
    build_cyclist,
    build_motorcycle,
    build_object,
    build_pedestrian,
    build_stroller,
    build_wheeled_person,
)
from farfield.simulation.bodies.sizes import CLASS_OF, draw_car, draw_size_m, draw_truck
from farfield.simulation.bodies.trucks import TRUCK_STYLES, build_bus, build_trailer, build_truck

__all__ = ["CLASSES", "CLASS_OF", "Actor", "draw_car", "draw_size_m", "draw_truck"]

CLASSES = (
    "vehicle",
    "large_vehicle",
    "pedestrian",
    "bicycle",
    "animal",
    "wheeled_pedestrian",
    "motorcycle",
    "trailer",
    "unknown",
)
_RIGID: dict[str, Callable[..., Mesh]] = {
    "bus": build_bus,
    "minibus": build_bus,
    "trailer": build_trailer,
    "motorcycle": build_motorcycle,
    "wheelchair": build_wheeled_person,
    "object": build_object,
}
_MOVING: dict[str, Callable[..., Mesh]] = {
    "cyclist": build_cyclist,
    "pedestrian": build_pedestrian,
    "child": build_pedestrian,
    "stroller": build_stroller,
    "animal": build_animal,
    "deer": build_animal,
}


@dataclass(frozen=True)
class Actor:
    """One road user.

    Args:
        track_id: Identity over the whole sequence.
        kind: Body, a key of the size table: "sedan", "semi", "pedestrian"...
        size_m: Length, width, height of the whole body, over its whole gait.
        seed: What draws its shape and paint.
    """

    track_id: int
    kind: str
    size_m: tuple[float, float, float]
    seed: np.random.SeedSequence

    @property
    def label(self) -> str:
        """The class as Cirrus names it."""
        return CLASS_OF[self.kind]

    @property
    def cycle_m(self) -> float:
        """Distance of one gait cycle, 0 for a body that keeps its shape."""
        return cycle_length_m(self.kind, self.size_m)

    def build(self, phase: float | None = None) -> Mesh:
        """Its mesh: x forward, the origin in the middle of the bottom.

        Args:
            phase: Phase of its gait in [0, 1), or None for one that stands; rigid bodies ignore it.
        """
        rng = np.random.default_rng(self.seed)
        size = np.asarray(self.size_m)
        if self.kind in BODY_STYLES:
            return build_car(self.kind, size, rng)
        if self.kind in TRUCK_STYLES:
            return build_truck(self.kind, size, rng)
        if self.kind in _MOVING:
            return _MOVING[self.kind](size, rng, phase)
        return _RIGID[self.kind](size, rng)
