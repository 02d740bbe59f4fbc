"""Class names: the vocabulary of Cirrus, which Farfield uses everywhere, and how other data sets map to it.

Cirrus, section III: vehicle, large vehicle, pedestrian, bicycle, animal, wheeled pedestrian, motorcycle, trailer;
``unknown`` stands for annotated objects without a class, and for classes that a data set's authors published and that
are none of ours. Names that neither we nor they know, such as one's own ``Cone``, stay as they are written.
"""

from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from unicodedata import normalize

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
    **dict.fromkeys(
        ("rider", "bicycle_rack", "human_depiction", "ride_other", "ride_uncertain", "vehicle_other"), "unknown"
    ),
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
    **dict.fromkeys(
        (
            "BOLLARD",
            "CONSTRUCTION_BARREL",
            "CONSTRUCTION_CONE",
            "MOBILE_PEDESTRIAN_CROSSING_SIGN",
            "MOBILE_PEDESTRIAN_SIGN",
            "RAILED_VEHICLE",
            "SIGN",
            "STOP_SIGN",
            "TRAFFIC_LIGHT",
            "UNKNOWN",
        ),
        "unknown",
    ),
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

_EVERYDAY = {
    "vehicle": (
        "automobile",
        "car",
        "minivan",
        "passenger_car",
        "pickup",
        "pickup_truck",
        "suv",
        "taxi",
        "van",
    ),
    "large_vehicle": ("bus", "coach", "heavy_vehicle", "hgv", "lorry", "tram", "truck"),
    "pedestrian": ("human", "people", "person", "walker"),
    "bicycle": ("bicyclist", "bike", "cyclist"),
    "motorcycle": ("moped", "motorbike", "motorcyclist", "scooter"),
    "animal": ("cat", "dog"),
    "wheeled_pedestrian": ("stroller", "wheelchair"),
    "trailer": (),
}

CIRRUS_FROM_USUAL: Mapping[str, str] = {
    "_".join(name.strip().lower().replace("_", " ").split()): ours
    for names in (
        CIRRUS_FROM_ARGOVERSE2,
        CIRRUS_FROM_KRADAR,
        CIRRUS_FROM_VIEW_OF_DELFT,
        CIRRUS_FROM_ASTYX,
        CIRRUS_FROM_TOOLS,
        CIRRUS_FROM_KITTI,
        {word: ours for ours, words in _EVERYDAY.items() for word in words},
    )
    for name, ours in names.items()
    if ours != "unknown"
}
"""Usual names of classes, of other data sets and of every day, in small letters with underscores."""


def normalised_class(name: str, aliases: Mapping[str, str]) -> str:
    """Bring a class name into the vocabulary of Cirrus; what is not usual anywhere stays as it is written.

    Args:
        name: The name.
        aliases: What it is in its own data set, which counts before what is usual elsewhere.

    >>> normalised_class("Sedan", {}), normalised_class("LORRY", {}), normalised_class("Bus or Truck", {})
    ('vehicle', 'large_vehicle', 'large_vehicle')
    >>> normalised_class("Large Vehicle", {}), normalised_class("Wheeled-Pedestrian", {}), normalised_class("Tank", {})
    ('large_vehicle', 'wheeled_pedestrian', 'Tank')
    """
    if name in aliases:
        return aliases[name]
    plain = "_".join(name.strip().lower().replace("-", " ").replace("_", " ").split())
    plain = aliases.get(plain, CIRRUS_FROM_USUAL.get(plain, plain))
    return plain if plain in CIRRUS_CLASSES else normalize("NFC", name)


# Usual sizes of objects by class, metres: where detectors start from.

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


def closest_class(name: str, names: Iterable[str]) -> str:
    """The class that a name may be meant for; empty where none is like it.

    >>> closest_class("Car", ["vehicle", "pedestrian"]), closest_class("vehicel", ["vehicle"])
    ('vehicle', 'vehicle')
    >>> closest_class("LKW", ["vehicle"])
    ''
    """
    by_plain = {other.lower(): other for other in names}
    ours = normalised_class(name, {})
    usual = ours in CIRRUS_CLASSES and ours != "unknown"
    same = [other for other in by_plain.values() if usual and normalised_class(other, {}) == ours]
    close = get_close_matches(name.lower(), list(by_plain), n=1, cutoff=0.75)
    return by_plain.get(name.lower()) or (same[0] if same else by_plain[close[0]] if close else "")
