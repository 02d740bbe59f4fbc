"""Class names: the vocabulary of Cirrus, which Farfield uses everywhere, and how other data sets map to it.

Cirrus, section III: vehicle, large vehicle, pedestrian, bicycle, animal, wheeled pedestrian, motorcycle, trailer;
``unknown`` stands for annotated objects without a class.
"""

from collections.abc import Mapping

CIRRUS_CLASSES = (
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

CLASS_COLOURS = {
    "vehicle": "#56b4e9",
    "large_vehicle": "#0072b2",
    "pedestrian": "#e69f00",
    "bicycle": "#009e73",
    "animal": "#999999",
    "wheeled_pedestrian": "#f0e442",
    "motorcycle": "#cc79a7",
    "trailer": "#d55e00",
}
"""A colour a class, of those of Okabe and Ito, which everybody can tell apart."""

CIRRUS_ALIASES = {"car": "vehicle", "truck": "large_vehicle", "bus": "large_vehicle", "cyclist": "bicycle"}

CIRRUS_FROM_KITTI = {
    "Car": "vehicle",
    "Van": "vehicle",
    "Truck": "large_vehicle",
    "Tram": "large_vehicle",
    "Pedestrian": "pedestrian",
    "Person_sitting": "pedestrian",
    "Person": "pedestrian",
    "Cyclist": "bicycle",
    "Misc": "unknown",
}

CIRRUS_FROM_VIEW_OF_DELFT = {
    "Car": "vehicle",
    "truck": "large_vehicle",
    "Pedestrian": "pedestrian",
    "Cyclist": "bicycle",
    "bicycle": "bicycle",
    "moped_scooter": "motorcycle",
    "motor": "motorcycle",
}

CIRRUS_FROM_ASTYX = {
    "Car": "vehicle",
    "Truck": "large_vehicle",
    "Bus": "large_vehicle",
    "Trailer": "trailer",
    "Towed Object": "trailer",
    "Person": "pedestrian",
    "Cyclist": "bicycle",
    "Motorcyclist": "motorcycle",
    "Other Vehicle": "unknown",
}

KITTI_FROM_CIRRUS = {
    "vehicle": "Car",
    "large_vehicle": "Truck",
    "pedestrian": "Pedestrian",
    "bicycle": "Cyclist",
    "motorcycle": "Motorcycle",
    "trailer": "Trailer",
    "animal": "Animal",
    "wheeled_pedestrian": "Wheeled_pedestrian",
    "unknown": "Misc",
}

NUSCENES_FROM_CIRRUS = {  # the ten classes of its detection results that have one of ours
    "vehicle": "car",
    "large_vehicle": "truck",
    "pedestrian": "pedestrian",
    "wheeled_pedestrian": "pedestrian",
    "bicycle": "bicycle",
    "motorcycle": "motorcycle",
    "trailer": "trailer",
}

_KRADAR = (  # long, short, ours
    ("Sedan", "sed", "vehicle"),
    ("Bus or Truck", "bus", "large_vehicle"),
    ("Motorcycle", "mot", "motorcycle"),
    ("Bicycle", "bic", "bicycle"),
    ("Bicycle Group", "big", "bicycle"),
    ("Pedestrian", "ped", "pedestrian"),
    ("Pedestrian Group", "peg", "pedestrian"),
)

CIRRUS_FROM_KRADAR = {long: ours for long, _, ours in _KRADAR}
"""Class names of the label files."""

CIRRUS_FROM_ANY_KRADAR = {name: ours for long, short, ours in _KRADAR for name in (long, short)}
"""The same and the development kit's short names, each beside its long one."""

KRADAR_FROM_CIRRUS = {  # K-Radar annotates neither animals nor what is unknown
    "vehicle": "Sedan",
    "large_vehicle": "Bus or Truck",
    "trailer": "Bus or Truck",
    "motorcycle": "Motorcycle",
    "bicycle": "Bicycle",
    "pedestrian": "Pedestrian",
    "wheeled_pedestrian": "Pedestrian",
}

CIRRUS_FROM_ARGOVERSE2 = {
    "REGULAR_VEHICLE": "vehicle",
    "LARGE_VEHICLE": "large_vehicle",
    "BUS": "large_vehicle",
    "SCHOOL_BUS": "large_vehicle",
    "ARTICULATED_BUS": "large_vehicle",
    "BOX_TRUCK": "large_vehicle",
    "TRUCK": "large_vehicle",
    "TRUCK_CAB": "large_vehicle",
    "VEHICULAR_TRAILER": "trailer",
    "TRAFFIC_LIGHT_TRAILER": "trailer",
    "MESSAGE_BOARD_TRAILER": "trailer",
    "PEDESTRIAN": "pedestrian",
    "OFFICIAL_SIGNALER": "pedestrian",
    "BICYCLE": "bicycle",
    "BICYCLIST": "bicycle",
    "MOTORCYCLE": "motorcycle",
    "MOTORCYCLIST": "motorcycle",
    "WHEELED_RIDER": "wheeled_pedestrian",
    "WHEELED_DEVICE": "wheeled_pedestrian",
    "WHEELCHAIR": "wheeled_pedestrian",
    "STROLLER": "wheeled_pedestrian",
    "DOG": "animal",
    "ANIMAL": "animal",
}


CIRRUS_FROM_TOOLS = {
    "Van": "vehicle",
    "Scooter": "motorcycle",
    "ScooterRider": "motorcycle",
    "Motorcyclist": "motorcycle",
    "MotorcycleRider": "motorcycle",
    "BicycleRider": "bicycle",
    "Rider": "bicycle",
    "Motor": "motorcycle",
    "Tram": "large_vehicle",
    "LongVehicle": "large_vehicle",
    "Person": "pedestrian",
}
"""Classes as annotation tools offer them, beside those whose names are ours."""


def normalised_class(name: str, aliases: Mapping[str, str]) -> str:
    """Bring a class name into the vocabulary of Cirrus; what is not in it becomes ``unknown``.

    >>> normalised_class("Large Vehicle", {}), normalised_class("Wheeled-Pedestrian", {}), normalised_class("tank", {})
    ('large_vehicle', 'wheeled_pedestrian', 'unknown')
    """
    if name in aliases:
        return aliases[name]
    plain = "_".join(name.strip().lower().replace("-", " ").replace("_", " ").split())
    plain = aliases.get(plain, CIRRUS_ALIASES.get(plain, plain))
    return plain if plain in CIRRUS_CLASSES else "unknown"
