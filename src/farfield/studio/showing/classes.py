"""The classes that can be set, with preset sizes and colours that everybody can tell apart."""

from collections.abc import Iterable, Sequence
from typing import Literal

from farfield.errors import ConfigError
from farfield.studio.messages.rows import ClassSpec, TypeSpec
from farfield.vocabulary.classes import (
    CIRRUS_CLASSES,
    CIRRUS_FROM_ANY_KRADAR,
    CIRRUS_FROM_ARGOVERSE2,
    CIRRUS_FROM_KITTI,
    CIRRUS_FROM_KRADAR,
    CIRRUS_FROM_VIEW_OF_DELFT,
    CLASS_COLOURS,
    KRADAR_FROM_CIRRUS,
)
from farfield.vocabulary.sizes import CIRRUS_SIZES_M, SMALL_KINDS, VEHICLE_KINDS

Group = Literal["vehicle", "person", "two_wheeler", "other"]
Size = tuple[float, float, float]
_SPARE = tuple(CLASS_COLOURS.values())
_TYPES = ("van", "box truck", "bus")
_GROUPS: dict[str, Group] = {
    "vehicle": "vehicle",
    "large_vehicle": "vehicle",
    "trailer": "vehicle",
    "pedestrian": "person",
    "wheeled_pedestrian": "person",
    "bicycle": "two_wheeler",
    "motorcycle": "two_wheeler",
}
_SPELLINGS = CIRRUS_FROM_ARGOVERSE2 | CIRRUS_FROM_VIEW_OF_DELFT | CIRRUS_FROM_KITTI | CIRRUS_FROM_ANY_KRADAR
_OWN_WORDS = {"kradar": CIRRUS_FROM_KRADAR, "kitti": CIRRUS_FROM_KITTI}


def our_class(name: str) -> str:
    """A class in Cirrus's words, whichever data set spells it; a name that none has stays as it is.

    >>> our_class("Sedan"), our_class("Car"), our_class("vehicle"), our_class("tank")
    ('vehicle', 'vehicle', 'vehicle', 'tank')
    """
    return name if name in CIRRUS_CLASSES else _SPELLINGS.get(name, name)


def shown_classes(format_name: str, given: Sequence[str] = ()) -> tuple[ClassSpec, ...]:
    """The classes of a data set that is looked at, in Cirrus's words.

    Args:
        format_name: Its format; K-Radar's own sizes differ from Cirrus'.
        given: ``name:length,width,height`` of classes to offer instead.

    Raises:
        ConfigError: If one of those given is not of this form.
    """
    if given:
        return tuple(_given(text, place) for place, text in enumerate(given))
    names = enumerate(CIRRUS_SIZES_M)
    return tuple(_spec(name, _kradar_size(name) if format_name == "kradar" else None, place) for place, name in names)


def annotated_classes(format_name: str, given: Sequence[str] = ()) -> tuple[ClassSpec, ...]:
    """The classes of a data set that is annotated, as its label files spell them; arguments as above."""
    own = _OWN_WORDS.get(format_name)
    if given or own is None:
        return shown_classes(format_name, given)
    return tuple(_spec(name, None, place) for place, name in enumerate(own))


def with_others(classes: Sequence[ClassSpec], names: Iterable[str]) -> tuple[ClassSpec, ...]:
    """The classes, and further ones that boxes bear."""
    known = {spec.name for spec in classes}
    more = [name for name in dict.fromkeys(names) if name not in known]
    return (*classes, *(_spec(name, None, len(classes) + place) for place, name in enumerate(more)))


def spec_of(name: str, size: Size, types: dict[str, Size], place: int) -> ClassSpec:
    """A class as the page takes it."""
    return _spec(name, size, place, types)


def preset_size(name: str) -> Size:
    """Usual size of a class or of a type of vehicle; a car's for a name that nobody knows."""
    known = VEHICLE_KINDS.get(name) or SMALL_KINDS.get(name)
    return known or CIRRUS_SIZES_M.get(our_class(name), CIRRUS_SIZES_M["vehicle"])


def _kradar_size(name: str) -> Size:
    return preset_size(name if name == "trailer" else KRADAR_FROM_CIRRUS.get(name, name))


def _spec(name: str, size: Size | None, place: int, types: dict[str, Size] | None = None) -> ClassSpec:
    ours = our_class(name)
    if types is None:
        types = {kind: VEHICLE_KINDS[kind] for kind in _TYPES} if ours == "large_vehicle" else {}
    return ClassSpec(
        name=name,
        title=name.replace("_", " "),
        size=size or preset_size(name),
        colour=CLASS_COLOURS.get(ours, _SPARE[place % len(_SPARE)]),
        key=str(place + 1) if place < 9 else "",
        group=_GROUPS.get(ours, "other"),
        types=tuple(TypeSpec(name=kind, size=each) for kind, each in types.items()),
    )


def _given(text: str, place: int) -> ClassSpec:
    name, _, words = text.partition(":")
    try:
        length, width, height = (float(word) for word in words.split(","))
    except ValueError:
        raise ConfigError(f"classes: expected name:length,width,height in metres, got {text!r}") from None
    if not name or not all(0 < value <= 60 for value in (length, width, height)):
        raise ConfigError(f"classes: expected a name and sizes up to 60 m, got {text!r}")
    return _spec(name, (length, width, height), place, {})
