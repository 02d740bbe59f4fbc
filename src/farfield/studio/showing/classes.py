"""The classes that can be set, with preset sizes and colours that everybody can tell apart."""

from collections.abc import Iterable, Sequence

from farfield.errors import ConfigError
from farfield.studio.messages.rows import ClassSpec, TypeSpec
from farfield.vocabulary.classes import KRADAR_FROM_CIRRUS
from farfield.vocabulary.sizes import CIRRUS_SIZES_M, SMALL_KINDS, VEHICLE_KINDS

_COLOURS = {
    "vehicle": "#56b4e9",
    "large_vehicle": "#0072b2",
    "pedestrian": "#e69f00",
    "bicycle": "#009e73",
    "animal": "#999999",
    "wheeled_pedestrian": "#f0e442",
    "motorcycle": "#cc79a7",
    "trailer": "#d55e00",
}
_TYPES = {"large_vehicle": ("van", "box truck", "bus")}
_SPARE = ("#56b4e9", "#0072b2", "#e69f00", "#009e73", "#f0e442", "#cc79a7", "#d55e00", "#999999")
_GROUPS = {
    "vehicle": "vehicle",
    "large_vehicle": "vehicle",
    "trailer": "vehicle",
    "pedestrian": "person",
    "wheeled_pedestrian": "person",
    "animal": "other",
    "bicycle": "two_wheeler",
    "motorcycle": "two_wheeler",
}


def classes_of(format_name: str, given: Sequence[str] = ()) -> tuple[ClassSpec, ...]:
    """The classes of a data set.

    Args:
        format_name: Its format; K-Radar's own sizes differ from Cirrus'.
        given: ``name:length,width,height`` of classes to offer instead.

    Raises:
        ConfigError: If one of those given is not of this form.
    """
    if given:
        return tuple(_given(text, place) for place, text in enumerate(given))
    sizes = {name: _kradar_size(name) for name in CIRRUS_SIZES_M} if format_name == "kradar" else CIRRUS_SIZES_M
    return tuple(_spec(name, size, place) for place, (name, size) in enumerate(sizes.items()))


def _kradar_size(name: str) -> tuple[float, float, float]:
    theirs = KRADAR_FROM_CIRRUS.get(name, name) if name != "trailer" else name
    return VEHICLE_KINDS.get(theirs) or SMALL_KINDS.get(theirs) or CIRRUS_SIZES_M[name]


def with_others(classes: Sequence[ClassSpec], names: Iterable[str]) -> tuple[ClassSpec, ...]:
    """The classes, and further ones that boxes bear, of a car's size."""
    known = {spec.name for spec in classes}
    more = [name for name in dict.fromkeys(names) if name not in known]
    start = len(classes)
    return (*classes, *(_spec(name, CIRRUS_SIZES_M["vehicle"], start + place) for place, name in enumerate(more)))


def _spec(name: str, size: tuple[float, float, float], place: int) -> ClassSpec:
    return ClassSpec(
        name=name,
        title=name.replace("_", " "),
        size=size,
        colour=_COLOURS.get(name, _SPARE[place % len(_SPARE)]),
        key=str(place + 1) if place < 9 else "",
        group=_GROUPS.get(name, "other"),  # type: ignore[arg-type]
        types=tuple(TypeSpec(name=kind, size=VEHICLE_KINDS[kind]) for kind in _TYPES.get(name, ())),
    )


def _given(text: str, place: int) -> ClassSpec:
    name, _, numbers = text.partition(":")
    try:
        length, width, height = (float(word) for word in numbers.split(","))
    except ValueError:
        raise ConfigError(f"class: expected name:length,width,height in metres, got {text!r}") from None
    if not name or not all(0 < value <= 60 for value in (length, width, height)):
        raise ConfigError(f"class: expected a name and sizes up to 60 m, got {text!r}")
    return _spec(name, (length, width, height), place)
