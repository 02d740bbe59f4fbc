"""The road users: kinds, their classes as in Cirrus, sizes and meshes."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from farfield.simulation.bodies.cars import BODY_STYLES, CAR_SHARES, build_car
from farfield.simulation.bodies.mesh import Mesh
from farfield.simulation.bodies.people import (
    build_animal,
    build_cyclist,
    build_motorcycle,
    build_pedestrian,
    build_wheeled_person,
)
from farfield.simulation.bodies.trucks import TRUCK_STYLES, build_bus, build_trailer, build_truck

CLASSES = (
    "vehicle",
    "large_vehicle",
    "pedestrian",
    "bicycle",
    "animal",
    "wheeled_pedestrian",
    "motorcycle",
    "trailer",
)

# Mean and standard deviation of length, width, height: prior "us", after the means of nuScenes and Lyft.
_SIZES: dict[str, tuple[str, tuple[float, float, float], tuple[float, float, float]]] = {
    **{name: ("vehicle", style.size_m, style.sigma_m) for name, style in BODY_STYLES.items()},
    "box": ("large_vehicle", (8.2, 2.5, 3.4), (1.2, 0.12, 0.3)),
    "semi": ("large_vehicle", (15.5, 2.6, 3.9), (1.5, 0.06, 0.15)),
    "flatbed": ("large_vehicle", (8.0, 2.45, 2.8), (1.3, 0.12, 0.25)),
    "tanker": ("large_vehicle", (9.5, 2.5, 3.4), (1.2, 0.08, 0.2)),
    "tipper": ("large_vehicle", (8.2, 2.5, 3.2), (0.8, 0.10, 0.2)),
    "bus": ("large_vehicle", (11.8, 2.75, 3.3), (1.0, 0.12, 0.2)),
    "trailer": ("trailer", (5.2, 2.1, 2.1), (1.1, 0.15, 0.5)),
    "motorcycle": ("motorcycle", (2.2, 0.82, 1.55), (0.15, 0.08, 0.10)),
    "cyclist": ("bicycle", (1.74, 0.62, 1.72), (0.10, 0.05, 0.09)),
    "pedestrian": ("pedestrian", (0.76, 0.66, 1.75), (0.14, 0.08, 0.09)),
    "wheelchair": ("wheeled_pedestrian", (1.0, 0.70, 1.35), (0.08, 0.05, 0.06)),
    "animal": ("animal", (0.95, 0.35, 0.75), (0.2, 0.05, 0.15)),
}


@dataclass(frozen=True)
class Actor:
    """One road user.

    Args:
        track_id: Identity over the whole sequence.
        kind: Body, a key of the size table: "sedan", "semi", "pedestrian"...
        size_m: Length, width, height of the whole body.
        seed: What draws its shape and paint.
    """

    track_id: int
    kind: str
    size_m: tuple[float, float, float]
    seed: np.random.SeedSequence

    @property
    def label(self) -> str:
        """The class as Cirrus names it."""
        return _SIZES[self.kind][0]

    def build(self) -> Mesh:
        """Its mesh: x forward, the origin in the middle of the bottom."""
        rng = np.random.default_rng(self.seed)
        size = np.asarray(self.size_m)
        if self.kind in BODY_STYLES:
            return build_car(self.kind, size, rng)
        if self.kind in TRUCK_STYLES:
            return build_truck(self.kind, size, rng)
        builders = {
            "bus": build_bus,
            "trailer": build_trailer,
            "motorcycle": build_motorcycle,
            "cyclist": build_cyclist,
            "pedestrian": build_pedestrian,
            "wheelchair": build_wheeled_person,
            "animal": build_animal,
        }
        return builders[self.kind](size, rng)


def draw_car(rng: np.random.Generator) -> str:
    """A passenger car's body style by its share of the traffic."""
    return str(rng.choice(list(CAR_SHARES), p=list(CAR_SHARES.values())))


def draw_truck(rng: np.random.Generator, *, long_haul: bool) -> str:
    """A truck's body style; long-haul roads see more semi-trailers, towns more buses."""
    shares = {"box": 0.28, "semi": 0.42, "flatbed": 0.1, "tanker": 0.08, "tipper": 0.06, "bus": 0.06}
    if not long_haul:
        shares = {"box": 0.42, "semi": 0.06, "flatbed": 0.08, "tanker": 0.03, "tipper": 0.11, "bus": 0.3}
    return str(rng.choice(list(shares), p=list(shares.values())))


def draw_size_m(kind: str, rng: np.random.Generator) -> Float[np.ndarray, " 3"]:
    """Draw a body's length, width, height: log-normal, correlated (l-w 0.6, l-h 0.3), within two deviations."""
    _, mean, sigma = _SIZES[kind]
    factor = np.array([[1.0, 0.0, 0.0], [0.6, 0.8, 0.0], [0.3, 0.0, np.sqrt(1 - 0.09)]])
    drawn = np.clip(factor @ np.clip(rng.standard_normal(3), -2, 2), -2, 2)
    size: Float[np.ndarray, " 3"] = np.asarray(mean) * np.exp(np.asarray(sigma) / np.asarray(mean) * drawn)
    return size
