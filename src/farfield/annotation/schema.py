"""What may be annotated: classes with their sizes, attributes with their values, whole bodies or visible parts.

It stands as ``classes.yaml`` beside the journal and may be edited by hand::

    extent: full            # boxes are whole bodies; or: visible
    classes:
      Sedan: {size_m: [4.61, 2.18, 1.91], source: median of 57 boxes}
      Bus or Truck: {size_m: [10.11, 3.07, 3.68], types: {van: [5.0, 2.0, 2.2]}}

Attributes:
      availability: {values: [R, L, L1]}
      note: {kind: text}
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from farfield.datasets.labels import Value
from farfield.errors import ConfigError, fault_of, plain
from farfield.files.atomic import read_bytes, write_text
from farfield.files.yaml_text import MAX_BYTES, PlainSettings, plain_yaml
from farfield.vocabulary.classes import (
    CIRRUS_CLASSES,
    CIRRUS_FROM_ANY_KRADAR,
    CIRRUS_FROM_ARGOVERSE2,
    CIRRUS_FROM_KITTI,
    CIRRUS_FROM_KRADAR,
    CIRRUS_FROM_VIEW_OF_DELFT,
    CIRRUS_SIZES_M,
    FORMAT_SIZES,
    SMALL_KINDS,
    VEHICLE_KINDS,
)

SCHEMA = "classes.yaml"
Extent = Literal["full", "visible"]
_Length = Annotated[float, Field(gt=0, le=60, allow_inf_nan=False)]
Size = tuple[_Length, _Length, _Length]


class ClassSettings(PlainSettings):
    """One class.

    Attributes:
        size_m: Usual length, width and height.
        types: Kinds within it with sizes of their own, such as vans.
        fastest_m_s: Speed over ground beyond which something is wrong.
        source: Where the size is from; empty where nobody said.
    """

    size_m: Size
    types: dict[str, Size] = Field(default_factory=dict)
    fastest_m_s: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 60.0
    source: Annotated[str, Field(max_length=200)] = ""


class AttributeSettings(BaseModel):
    """One attribute: one of some values, or any of a kind."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    values: tuple[str | bool | float, ...] = ()
    kind: Literal["text", "number", "flag"] = "text"


class Schema(BaseModel):
    """What may be annotated; see the module."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    extent: Extent | None = None
    classes: dict[str, ClassSettings]
    attributes: dict[str, AttributeSettings] = {}

    def fault(self, name: str, value: Value | int) -> str:
        """What is wrong with an attribute's value; empty if nothing is."""
        settings = self.attributes.get(name)
        if settings is None:
            return f"attribute {name!r}: expected one of {', '.join(self.attributes) or 'none'}"
        if settings.values:
            values = ", ".join(map(str, settings.values))
            flag = isinstance(value, bool)  # Python takes 1 for True
            there = any(value == one and isinstance(one, bool) == flag for one in settings.values)
            return "" if there else f"{name}: expected one of {values}, got {value!r}"
        kinds: dict[str, type | tuple[type, ...]] = {"text": str, "number": (int, float), "flag": bool}
        right = isinstance(value, kinds[settings.kind]) and (settings.kind == "flag" or not isinstance(value, bool))
        return "" if right else f"{name}: expected a {settings.kind}, got {value!r}"


FASTEST_M_S = {"pedestrian": 4.0, "bicycle": 15.0}


def fastest(label: str) -> float:
    """Speed beyond which a road user of a class is not believed, m/s: people 4, bicycles 15, others 60."""
    name = label.lower()
    return next((speed for part, speed in FASTEST_M_S.items() if part in name), 60.0)


def schema_of(
    sizes_m: Mapping[str, Sequence[float]],
    attributes: Mapping[str, Sequence[Value]] | None = None,
    extent: Extent | None = None,
) -> Schema:
    """A schema from usual sizes by class and attributes with their values (none: any text)."""
    classes = {
        name: ClassSettings(size_m=tuple(map(float, size)), fastest_m_s=fastest(name)) for name, size in sizes_m.items()
    }
    settings = {name: AttributeSettings(values=tuple(values)) for name, values in (attributes or {}).items()}
    return Schema(extent=extent, classes=classes, attributes=settings)


def load_schema(folder: Path, default: Schema) -> Schema:
    """The schema beside a journal; the default is written there where there is none.

    Args:
        folder: The journal's folder.
        default: What holds where nothing else was said.

    Raises:
        ConfigError: If the file is no schema.
    """
    path = folder / SCHEMA
    if not path.is_file():
        save_schema(folder, default)
        return default
    try:
        return Schema.model_validate(plain_yaml(read_bytes(path, max_bytes=MAX_BYTES)))
    except yaml.YAMLError as error:
        raise ConfigError(f"{path}: expected YAML, got {plain(error)}") from error
    except ValidationError as error:
        lines = [f"{'.'.join(map(str, item['loc'])) or 'the file'}: {fault_of(item)}" for item in error.errors()[:5]]
        raise ConfigError(f"{path}: {'; '.join(lines)}. Delete it to begin with the defaults.") from error


def save_schema(folder: Path, schema: Schema) -> None:
    """Write the schema beside a journal."""
    settings = schema.model_dump(mode="json", exclude_defaults=True)
    write_text(folder / SCHEMA, yaml.safe_dump(settings, sort_keys=False, allow_unicode=True))


# The classes that a data set offers, with preset sizes.

_TYPES = ("van", "box truck", "bus")
_SPELLINGS = CIRRUS_FROM_ARGOVERSE2 | CIRRUS_FROM_VIEW_OF_DELFT | CIRRUS_FROM_KITTI | CIRRUS_FROM_ANY_KRADAR
_OWN_WORDS = {"kradar": CIRRUS_FROM_KRADAR, "kitti": CIRRUS_FROM_KITTI}


class ClassPreset(NamedTuple):
    """A class on offer.

    Args:
        name: Its name.
        size_m: Usual length, width, height.
        types: Sizes of kinds within the class.
        source: Where the size is from.
    """

    name: str
    size_m: tuple[float, float, float]
    types: Mapping[str, tuple[float, float, float]]
    source: str = ""


def cirrus_class(name: str) -> str:
    """A class in Cirrus's words, whichever data set spells it; a name that none has stays as it is.

    >>> cirrus_class("Sedan"), cirrus_class("Car"), cirrus_class("vehicle"), cirrus_class("tank")
    ('vehicle', 'vehicle', 'vehicle', 'tank')
    """
    return name if name in CIRRUS_CLASSES else _SPELLINGS.get(name, name)


OUR_SIZES = "Farfield's usual size"


def usual_size(name: str, format_name: str = "") -> tuple[tuple[float, float, float], str]:
    """Usual size of a class or of a type of vehicle, and where it is from; a car's for an unknown name.

    Args:
        name: The class.
        format_name: The data set's format, whose published sizes come first.
    """
    published = FORMAT_SIZES.get(format_name)
    size_m = published and (published.sizes_m.get(name) or published.sizes_m.get(cirrus_class(name)))
    if published and size_m:
        return size_m, published.source
    size_m = VEHICLE_KINDS.get(name) or SMALL_KINDS.get(name)
    return size_m or CIRRUS_SIZES_M.get(cirrus_class(name), CIRRUS_SIZES_M["vehicle"]), OUR_SIZES


def class_preset(name: str, format_name: str = "") -> ClassPreset:
    """A class by its name, with the types of large vehicles.

    Args:
        name: Its name.
        format_name: The data set's format, as of :func:`usual_size`.
    """
    types = {kind: VEHICLE_KINDS[kind] for kind in _TYPES} if cirrus_class(name) == "large_vehicle" else {}
    size_m, source = usual_size(name, format_name)
    return ClassPreset(name, size_m, types, source)


def shown_classes(format_name: str, classes: Sequence[str] = ()) -> tuple[ClassPreset, ...]:
    """The classes of a data set that is looked at, in Cirrus's words.

    Args:
        format_name: Its format, whose published sizes are taken.
        classes: ``name:length,width,height`` of classes to offer instead.

    Raises:
        ConfigError: If one of those classes is not of this form.
    """
    if classes:
        return tuple(_parse_class(text) for text in classes)
    return tuple(class_preset(name, format_name) for name in CIRRUS_SIZES_M)


def annotated_classes(format_name: str, classes: Sequence[str] = ()) -> tuple[ClassPreset, ...]:
    """The classes of a data set that is annotated, as its label files spell them; arguments as above."""
    names = _OWN_WORDS.get(format_name)
    if classes or names is None:
        return shown_classes(format_name, classes)
    return tuple(class_preset(name, format_name) for name in names)


def _parse_class(text: str) -> ClassPreset:
    name, _, lengths = text.partition(":")
    try:
        length, width, height = map(float, lengths.split(","))
    except ValueError:
        raise ConfigError(f"classes: expected name:length,width,height in metres, got {text!r}") from None
    if not name or not all(0 < value <= 60 for value in (length, width, height)):
        raise ConfigError(f"classes: expected a name and sizes up to 60 m, got {text!r}")
    return ClassPreset(name, (length, width, height), {}, "given with --classes")
