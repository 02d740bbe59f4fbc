"""Class names: the vocabulary of Cirrus, which Farfield uses everywhere, and how other data sets map to it.

Cirrus, section III: vehicle, large vehicle, pedestrian, bicycle, animal, wheeled pedestrian, motorcycle, trailer;
``unknown`` stands for annotated objects without a class, and for classes that a data set's authors published and that
are none of ours. Names that neither we nor they know, such as one's own ``Cone``, stay as they are written.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
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

UNSURE = "unsure"
"""Class of boxes about what may be an object that nobody annotated: to a training neither object nor background."""

CLUTTER = "clutter"
"""Class of boxes about what a detector took for an object where none is: to a training background."""

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

KRADAR_SHORT = {long: short for long, short, _ in _KRADAR}
"""The development kit's short name of each class of the label files."""

KRADAR_FROM_CIRRUS = {  # K-Radar annotates neither animals nor what is unknown
    "vehicle": "Sedan",
    "large_vehicle": "Bus or Truck",
    "trailer": "Bus or Truck",
    "motorcycle": "Motorcycle",
    "bicycle": "Bicycle",
    "pedestrian": "Pedestrian",
    "wheeled_pedestrian": "Pedestrian",
}

CIRRUS_FROM_AIMOTIVE = {
    "CAR": "vehicle",
    "VAN": "vehicle",
    "PICKUP": "vehicle",
    "TRUCK": "large_vehicle",
    "BUS": "large_vehicle",
    "TRAILER": "trailer",
    "MOTORCYCLE": "motorcycle",
    "BICYCLE": "bicycle",
    "PEDESTRIAN": "pedestrian",
}

CIRRUS_FROM_ARGOVERSE1 = {
    "VEHICLE": "vehicle",
    "LARGE_VEHICLE": "large_vehicle",
    "BUS": "large_vehicle",
    "SCHOOL_BUS": "large_vehicle",
    "TRAILER": "trailer",
    "PEDESTRIAN": "pedestrian",
    "BICYCLE": "bicycle",
    "BICYCLIST": "bicycle",
    "MOTORCYCLE": "motorcycle",
    "MOTORCYCLIST": "motorcycle",
    "MOPED": "motorcycle",
    "STROLLER": "wheeled_pedestrian",
    "WHEELCHAIR": "wheeled_pedestrian",
    "ANIMAL": "animal",
    **dict.fromkeys(("EMERGENCY_VEHICLE", "ON_ROAD_OBSTACLE", "OTHER_MOVER"), "unknown"),
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

CIRRUS_FROM_PANDASET = {
    "Car": "vehicle",
    "Pickup Truck": "vehicle",
    "Emergency Vehicle": "vehicle",
    **dict.fromkeys(
        ("Medium-sized Truck", "Semi-truck", "Bus", "Other Vehicle - Construction Vehicle"), "large_vehicle"
    ),
    **dict.fromkeys(("Train", "Trolley", "Tram / Subway"), "large_vehicle"),
    "Towed Object": "trailer",
    "Motorcycle": "motorcycle",
    "Motorized Scooter": "motorcycle",
    "Bicycle": "bicycle",
    "Personal Mobility Device": "wheeled_pedestrian",
    "Pedestrian": "pedestrian",
    "Pedestrian with Object": "pedestrian",
    "Animals - Bird": "animal",
    "Animals - Other": "animal",
    **dict.fromkeys(("Other Vehicle - Uncommon", "Other Vehicle - Pedicab"), "unknown"),
    **dict.fromkeys(("Pylons", "Road Barriers", "Signs", "Cones", "Construction Signs"), "unknown"),
    **dict.fromkeys(("Temporary Construction Barriers", "Rolling Containers"), "unknown"),
}


CIRRUS_FROM_NUSCENES = {  # its 23 categories; those that are none of ours are unknown
    "animal": "animal",
    "human.pedestrian.adult": "pedestrian",
    "human.pedestrian.child": "pedestrian",
    "human.pedestrian.construction_worker": "pedestrian",
    "human.pedestrian.police_officer": "pedestrian",
    "human.pedestrian.personal_mobility": "wheeled_pedestrian",
    "human.pedestrian.stroller": "wheeled_pedestrian",
    "human.pedestrian.wheelchair": "wheeled_pedestrian",
    "vehicle.bicycle": "bicycle",
    "vehicle.bus.bendy": "large_vehicle",
    "vehicle.bus.rigid": "large_vehicle",
    "vehicle.car": "vehicle",
    "vehicle.construction": "large_vehicle",
    "vehicle.emergency.ambulance": "large_vehicle",
    "vehicle.emergency.police": "vehicle",
    "vehicle.motorcycle": "motorcycle",
    "vehicle.trailer": "trailer",
    "vehicle.truck": "large_vehicle",
    **dict.fromkeys(
        (
            "movable_object.barrier",
            "movable_object.debris",
            "movable_object.pushable_pullable",
            "movable_object.trafficcone",
            "static_object.bicycle_rack",
        ),
        "unknown",
    ),
}

CIRRUS_FROM_TRUCKSCENES = CIRRUS_FROM_NUSCENES | {
    "vehicle.ego_trailer": "trailer",
    "vehicle.train": "large_vehicle",
    "vehicle.other": "unknown",
    "static_object.traffic_sign": "unknown",
}

CIRRUS_FROM_T4 = CIRRUS_FROM_NUSCENES | {
    "construction_worker": "pedestrian",
    "police_officer": "pedestrian",
    "fire_truck": "large_vehicle",
    "ambulance": "large_vehicle",
    "police_car": "vehicle",
    "semi_trailer": "trailer",
    "tractor_unit": "large_vehicle",
    "construction_vehicle": "large_vehicle",
    "forklift": "large_vehicle",
    "personal_mobility": "wheeled_pedestrian",
    **dict.fromkeys(("barrier", "debris", "pushable_pullable", "traffic_cone"), "unknown"),
}

NUSCENES_DETECTION_CLASSES = {  # of its detection task, by category; other categories are not scored
    "movable_object.barrier": "barrier",
    "vehicle.bicycle": "bicycle",
    "vehicle.bus.bendy": "bus",
    "vehicle.bus.rigid": "bus",
    "vehicle.car": "car",
    "vehicle.construction": "construction_vehicle",
    "vehicle.motorcycle": "motorcycle",
    "human.pedestrian.adult": "pedestrian",
    "human.pedestrian.child": "pedestrian",
    "human.pedestrian.construction_worker": "pedestrian",
    "human.pedestrian.police_officer": "pedestrian",
    "movable_object.trafficcone": "traffic_cone",
    "vehicle.trailer": "trailer",
    "vehicle.truck": "truck",
}

NUSCENES_RANGES_M = {  # of its detection task, in its order of classes: within which boxes count
    "car": 50.0,
    "truck": 50.0,
    "bus": 50.0,
    "trailer": 50.0,
    "construction_vehicle": 50.0,
    "pedestrian": 40.0,
    "motorcycle": 40.0,
    "bicycle": 40.0,
    "traffic_cone": 30.0,
    "barrier": 30.0,
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


@dataclass(frozen=True)
class FormatSizes:
    """The sizes that are published of a data set.

    Args:
        source: Where they are from.
        sizes_m: Mean or median length, width, height by class, in the data set's words and in Cirrus's.
    """

    source: str
    sizes_m: Mapping[str, tuple[float, float, float]]


_KITTI_MEANS_M: dict[str, tuple[float, float, float]] = {
    "Car": (3.88, 1.63, 1.53),
    "Van": (5.07, 1.90, 2.21),
    "Truck": (10.14, 2.59, 3.25),
    "Pedestrian": (0.84, 0.66, 1.76),
    "Person_sitting": (0.80, 0.60, 1.27),
    "Cyclist": (1.76, 0.60, 1.74),
    "Tram": (16.17, 2.53, 3.53),
}
_KITTI_SIZES = FormatSizes(
    "means of KITTI's training labels (Frustum PointNets, CVPR 2018)",
    _KITTI_MEANS_M | {ours: _KITTI_MEANS_M[word] for ours, word in KITTI_FROM_CIRRUS.items() if word in _KITTI_MEANS_M},
)

FORMAT_SIZES: Mapping[str, FormatSizes] = {
    "kitti": _KITTI_SIZES,
    "kitti_raw": _KITTI_SIZES,
    "kradar": FormatSizes(
        "medians of K-Radar's labels v2.1",
        _KRADAR_MEDIANS_M
        | {name: _KRADAR_MEDIANS_M[ours] for name, ours in CIRRUS_FROM_KRADAR.items() if ours in _KRADAR_MEDIANS_M},
    ),
}
"""Sizes by format, where annotating starts from as long as a data set has no labels of its own."""


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
