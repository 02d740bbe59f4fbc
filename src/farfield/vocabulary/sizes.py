"""Usual sizes of objects by class, metres: where detectors start from."""

from farfield.vocabulary.classes import CIRRUS_FROM_KRADAR

CIRRUS_SIZES_M: dict[str, tuple[float, float, float]] = {
    "vehicle": (4.6, 1.95, 1.7),
    "large_vehicle": (9.0, 2.7, 3.2),
    "pedestrian": (0.75, 0.7, 1.75),
    "bicycle": (1.75, 0.65, 1.6),
    "animal": (0.8, 0.4, 0.6),
    "wheeled_pedestrian": (1.0, 0.7, 1.4),
    "motorcycle": (2.2, 0.9, 1.5),
    "trailer": (11.0, 2.8, 3.6),
}
"""Length, width and height of the eight classes of Cirrus."""

_KRADAR_MEDIANS_M: dict[str, tuple[float, float, float]] = {
    "vehicle": (4.61, 2.18, 1.91),
    "large_vehicle": (10.11, 3.07, 3.68),
    "pedestrian": (0.76, 0.71, 2.0),
    "bicycle": (1.96, 0.95, 1.6),
    "motorcycle": (1.89, 0.88, 1.6),
}
_SMALL = ("pedestrian", "bicycle", "animal", "wheeled_pedestrian", "motorcycle")

VEHICLE_KINDS: dict[str, tuple[float, float, float]] = {
    **{name: _KRADAR_MEDIANS_M[ours] for name, ours in CIRRUS_FROM_KRADAR.items() if ours not in _SMALL},
    **{"van": (5.0, 2.0, 2.2), "box truck": (7.5, 2.4, 3.2), "bus": (11.5, 2.5, 3.3)},
    **{name: size for name, size in CIRRUS_SIZES_M.items() if name not in _SMALL},
}
"""Where annotating starts from: vehicles by class, and by the types below K-Radar's ``Bus or Truck``, whose lengths run
from 4.1 to 19.5 m. Classes of K-Radar: medians of its labels v2.1; types: usual sizes; the rest: Cirrus."""

SMALL_KINDS: dict[str, tuple[float, float, float]] = {
    **{name: _KRADAR_MEDIANS_M[ours] for name, ours in CIRRUS_FROM_KRADAR.items() if ours in _SMALL},
    **{name: size for name, size in CIRRUS_SIZES_M.items() if name in _SMALL},
}
"""The same for people, two-wheelers and animals, whose boxes lie about their points and do not grow away from the
sensor."""


def unit_of_sizes(longest: float) -> str:
    """The unit that the median longest side of road users' boxes shows where it is not metres; empty where it is.

    >>> unit_of_sizes(4.5), unit_of_sizes(450.0), unit_of_sizes(4500.0)
    ('', 'centimetres', 'millimetres')
    """
    unit = "millimetres" if longest > 1500 else "centimetres" if longest > 35 else ""
    return "kilometres or another large unit" if longest < 0.05 else unit
