"""Usual sizes of objects by class, metres: where detectors start from."""

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
