"""The road users: kinds, their classes as in Cirrus, sizes and meshes.

Sizes follow named priors after the published means of data sets; annotators' boxes may be looser. A prior moves the
mean of all cars to its own and keeps the differences between body styles. Means: nuScenes and Lyft for "us" (their
devkits' statistics), the KITTI training labels for "kitti", the K-Radar v2.0 labels for "korea", whose boxes are wider
and taller than the bodies they hold.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float

from farfield.errors import ConfigError
from farfield.geometry.boxes import Boxes
from farfield.simulation.bodies.lorries import build_lorry
from farfield.simulation.bodies.mesh import Mesh
from farfield.simulation.bodies.outlines import OUTLINES
from farfield.simulation.bodies.people import (
    build_animal,
    build_cyclist,
    build_motorcycle,
    build_object,
    build_pedestrian,
    build_stroller,
    build_wheeled_person,
    cycle_length_m,
)
from farfield.simulation.bodies.shells import build_shell
from farfield.simulation.bodies.vehicles import (
    BODY_STYLES,
    TRUCK_STYLES,
    build_bus,
    build_car,
    build_trailer,
    build_truck,
)

# Sizes

_Triple = tuple[float, float, float]

CLASS_OF: dict[str, str] = {
    **dict.fromkeys(("sedan", "hatch", "estate", "suv", "pickup", "mpv", "van"), "vehicle"),
    **dict.fromkeys(("box", "semi", "flatbed", "tanker", "tipper", "bus", "minibus", "light_truck"), "large_vehicle"),
    "trailer": "trailer",
    "motorcycle": "motorcycle",
    "cyclist": "bicycle",
    **dict.fromkeys(("pedestrian", "child"), "pedestrian"),
    **dict.fromkeys(("wheelchair", "stroller"), "wheeled_pedestrian"),
    **dict.fromkeys(("animal", "deer"), "animal"),
    "object": "unknown",
}

# Mean and standard deviation of length, width and height of each kind under the prior "us".
_US: dict[str, tuple[_Triple, _Triple]] = {
    "sedan": ((4.75, 1.86, 1.47), (0.25, 0.06, 0.05)),
    "hatch": ((4.2, 1.79, 1.50), (0.25, 0.05, 0.06)),
    "estate": ((4.75, 1.85, 1.50), (0.2, 0.05, 0.06)),
    "suv": ((4.75, 1.94, 1.76), (0.25, 0.07, 0.08)),
    "pickup": ((5.6, 1.99, 1.86), (0.3, 0.06, 0.08)),
    "mpv": ((5.0, 1.97, 1.78), (0.2, 0.05, 0.06)),
    "van": ((5.6, 2.05, 2.25), (0.4, 0.08, 0.2)),
    "box": ((8.2, 2.5, 3.4), (1.2, 0.12, 0.3)),
    "semi": ((15.5, 2.6, 3.9), (1.5, 0.06, 0.15)),
    "flatbed": ((8.0, 2.45, 2.8), (1.3, 0.12, 0.25)),
    "tanker": ((9.5, 2.5, 3.4), (1.2, 0.08, 0.2)),
    "tipper": ((8.2, 2.5, 3.2), (0.8, 0.10, 0.2)),
    "light_truck": ((5.4, 1.95, 2.3), (0.35, 0.10, 0.2)),
    "bus": ((11.8, 2.6, 3.3), (1.0, 0.08, 0.2)),
    "minibus": ((7.0, 2.2, 2.7), (0.6, 0.08, 0.15)),
    "trailer": ((5.2, 2.1, 2.1), (1.1, 0.15, 0.5)),
    "motorcycle": ((2.2, 0.82, 1.55), (0.15, 0.08, 0.10)),
    "cyclist": ((1.74, 0.62, 1.72), (0.10, 0.05, 0.09)),
    "pedestrian": ((0.76, 0.66, 1.75), (0.14, 0.08, 0.09)),
    "child": ((0.60, 0.50, 1.27), (0.08, 0.05, 0.12)),
    "wheelchair": ((1.0, 0.70, 1.35), (0.08, 0.05, 0.06)),
    "stroller": ((1.55, 0.62, 1.70), (0.12, 0.05, 0.09)),
    "animal": ((0.95, 0.35, 0.75), (0.2, 0.05, 0.12)),
    "deer": ((1.5, 0.45, 1.25), (0.2, 0.06, 0.12)),
    "object": ((1.1, 0.8, 0.9), (0.35, 0.2, 0.25)),
}
_CARS = ("sedan", "hatch", "estate", "suv", "pickup", "mpv")
_LARGE = ("box", "semi", "flatbed", "tanker", "tipper", "light_truck", "bus", "minibus")


@dataclass(frozen=True)
class SizePrior:
    """One region's road users.

    Args:
        cars: Shares of the body styles among cars and vans.
        trucks: Shares of the large vehicles in towns.
        long_haul: The same on long-haul roads.
        car_m: Mean of all cars but vans, or None to keep the styles' own.
        changed_m: Means of single kinds that differ from the prior "us".
    """

    cars: dict[str, float]
    trucks: dict[str, float]
    long_haul: dict[str, float]
    car_m: _Triple | None = None
    changed_m: dict[str, _Triple] | None = None


def _shares(kinds: tuple[str, ...], *values: float) -> dict[str, float]:
    return dict(zip(kinds, values, strict=True))


_STYLES = (*_CARS, "van")
SIZE_PRIORS: dict[str, SizePrior] = {
    "us": SizePrior(
        _shares(_STYLES, 0.30, 0.08, 0.04, 0.31, 0.14, 0.07, 0.06),
        _shares(_LARGE, 0.38, 0.06, 0.08, 0.03, 0.10, 0.08, 0.20, 0.07),
        _shares(_LARGE, 0.27, 0.41, 0.10, 0.08, 0.06, 0.01, 0.06, 0.01),
    ),
    "kitti": SizePrior(
        _shares(_STYLES, 0.22, 0.40, 0.16, 0.06, 0.01, 0.07, 0.08),
        _shares(_LARGE, 0.42, 0.12, 0.10, 0.06, 0.10, 0.02, 0.14, 0.04),
        _shares(_LARGE, 0.25, 0.48, 0.08, 0.09, 0.04, 0.0, 0.06, 0.0),
        (3.88, 1.63, 1.53),
        {"van": (5.07, 1.90, 2.21), "pedestrian": (0.84, 0.66, 1.76), "child": (0.80, 0.60, 1.27)},
    ),
    "korea": SizePrior(
        _shares(_STYLES, 0.42, 0.10, 0.02, 0.33, 0.02, 0.06, 0.05),
        _shares(_LARGE, 0.25, 0.03, 0.08, 0.02, 0.06, 0.22, 0.27, 0.07),
        _shares(_LARGE, 0.32, 0.22, 0.10, 0.07, 0.08, 0.06, 0.13, 0.02),
        (4.6, 1.9, 1.65),
        {
            "van": (5.15, 1.92, 1.99),
            "bus": (10.8, 2.5, 3.25),
            "light_truck": (5.15, 1.74, 2.0),
            "motorcycle": (1.9, 0.75, 1.5),
        },
    ),
}

# Mean length, width and height of the boxes in K-Radar's v2.0 labels, by class.
KRADAR_LABEL_M: dict[str, _Triple] = {
    "vehicle": (4.58, 2.15, 1.97),
    "large_vehicle": (9.71, 3.23, 3.78),
    "pedestrian": (0.81, 0.73, 2.09),
    "bicycle": (1.91, 0.95, 1.54),
    "motorcycle": (1.77, 1.02, 1.62),
}
_OTHER_INFLATION = np.array([1.15, 1.15, 1.15])


def find_prior(name: str) -> SizePrior:
    """Look a prior up.

    Raises:
        ConfigError: If there is none of that name.
    """
    if name not in SIZE_PRIORS:
        raise ConfigError(f"sizes: expected one of {', '.join(SIZE_PRIORS)}; got {name!r}")
    return SIZE_PRIORS[name]


@cache
def mean_size_m(kind: str, prior: str = "us") -> _Triple:
    """Median length, width and height of a kind of body under a prior."""
    size_prior = find_prior(prior)
    if size_prior.changed_m and kind in size_prior.changed_m:
        return size_prior.changed_m[kind]
    mean = np.array(_US[kind][0])
    if size_prior.car_m is not None and kind in _CARS:
        share = np.array([size_prior.cars[name] for name in _CARS])
        styles = np.array([_US[name][0] for name in _CARS])
        mean = mean * np.array(size_prior.car_m) / (share @ styles / share.sum())
    return float(mean[0]), float(mean[1]), float(mean[2])


def draw_size_m(kind: str, rng: np.random.Generator, prior: str = "us") -> Float[np.ndarray, " 3"]:
    """Draw a body's length, width, height: log-normal, correlated (l-w 0.6, l-h 0.3), within two deviations."""
    mean, own = np.array(mean_size_m(kind, prior)), _US[kind]
    ratio = np.array(own[1]) / np.array(own[0])
    factor = np.array([[1.0, 0.0, 0.0], [0.6, 0.8, 0.0], [0.3, 0.0, np.sqrt(1 - 0.09)]])
    deviation = np.clip(factor @ np.clip(rng.standard_normal(3), -2, 2), -2, 2)
    size: Float[np.ndarray, " 3"] = mean * np.exp(ratio * deviation)
    return size


def draw_car(rng: np.random.Generator, prior: str = "us") -> str:
    """A passenger car's or van's body style by its share of the traffic."""
    shares = find_prior(prior).cars
    return str(rng.choice(list(shares), p=list(shares.values())))


def draw_truck(rng: np.random.Generator, *, long_haul: bool, prior: str = "us") -> str:
    """A large vehicle's kind; long-haul roads see more semi-trailers, towns more buses."""
    size_prior = find_prior(prior)
    shares = size_prior.long_haul if long_haul else size_prior.trucks
    return str(rng.choice(list(shares), p=list(shares.values())))


@cache
def _class_mean_m(label: str) -> _Triple:
    """Mean body of a class under the prior "korea": cars and large vehicles by their shares."""
    prior = SIZE_PRIORS["korea"]
    if label == "vehicle":
        shares = prior.cars
    elif label == "large_vehicle":
        shares = {kind: (prior.trucks[kind] + prior.long_haul[kind]) / 2 for kind in _LARGE}
    else:
        shares = {next(kind for kind, name in CLASS_OF.items() if name == label): 1.0}
    mean = np.array(list(shares.values())) @ np.array([mean_size_m(kind, "korea") for kind in shares])
    return float(mean[0]), float(mean[1]), float(mean[2])


def label_inflation(label: str) -> Float[np.ndarray, " 3"]:
    """How much longer, wider and taller K-Radar's boxes of a class are than the bodies under the prior "korea".

    Classes that K-Radar does not label grow by 15 %. No factor is below 1: a box holds its body.
    """
    if label not in KRADAR_LABEL_M:
        return _OTHER_INFLATION.copy()
    return np.maximum(np.array(KRADAR_LABEL_M[label]) / np.array(_class_mean_m(label)), 1.0)


def inflated(boxes: Boxes) -> Boxes:
    """Boxes grown about their centres as K-Radar's annotators draw them."""
    factors = np.array([label_inflation(str(label)) for label in boxes.label]).reshape(-1, 3)
    return boxes.replace(size_m=boxes.size_m * factors)


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
_SHELL_KEY = 0x5348  # of the stream that draws bodies of world v3
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
        world: Whose bodies: "v2", or "v3" with curved skins over measured outlines, drawn from a stream of their own.
    """

    track_id: int
    kind: str
    size_m: tuple[float, float, float]
    seed: np.random.SeedSequence
    world: str = "v2"

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
        size = np.asarray(self.size_m)
        if self.world == "v3" and self.kind in (*OUTLINES, *TRUCK_STYLES):
            own = np.random.SeedSequence(entropy=self.seed.entropy, spawn_key=(*self.seed.spawn_key, _SHELL_KEY))
            build = build_shell if self.kind in OUTLINES else build_lorry
            return build(self.kind, size, np.random.default_rng(own))
        rng = np.random.default_rng(self.seed)
        if self.kind in BODY_STYLES:
            return build_car(self.kind, size, rng)
        if self.kind in TRUCK_STYLES:
            return build_truck(self.kind, size, rng)
        if self.kind in _MOVING:
            return _MOVING[self.kind](size, rng, phase)
        return _RIGID[self.kind](size, rng)
