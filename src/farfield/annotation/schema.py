"""What may be annotated: classes with their sizes, attributes with their values, whole bodies or visible parts.

It stands as ``classes.yaml`` beside the journal and may be edited by hand::

    extent: full            # boxes are whole bodies; or: visible
    classes:
      Sedan: {size_m: [4.61, 2.18, 1.91]}
      Bus or Truck: {size_m: [10.11, 3.07, 3.68], types: {van: [5.0, 2.0, 2.2]}}

Attributes:
      availability: {values: [R, L, L1]}
      note: {kind: text}
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from farfield.datasets.labels import Value
from farfield.errors import ConfigError, fault_of, plain
from farfield.files.atomic import read_bytes, write_text

SCHEMA = "classes.yaml"
MAX_BYTES = 1 << 20
Extent = Literal["full", "visible"]
_Length = Annotated[float, Field(gt=0, le=60, allow_inf_nan=False)]
Size = tuple[_Length, _Length, _Length]


class ClassSettings(BaseModel):
    """One class.

    Attributes:
        size_m: Usual length, width and height.
        types: Kinds within it with sizes of their own, such as vans.
        fastest_m_s: Speed over ground beyond which something is wrong.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    size_m: Size
    types: dict[str, Size] = {}
    fastest_m_s: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 60.0


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

    def fault(self, name: str, value: Value) -> str:
        """What is wrong with an attribute's value; empty if nothing is."""
        settings = self.attributes.get(name)
        if settings is None:
            return f"attribute {name!r}: expected one of {', '.join(self.attributes) or 'none'}"
        if settings.values:
            known = ", ".join(map(str, settings.values))
            return "" if value in settings.values else f"{name}: expected one of {known}, got {value!r}"
        kinds: dict[str, type | tuple[type, ...]] = {"text": str, "number": (int, float), "flag": bool}
        right = isinstance(value, kinds[settings.kind]) and (settings.kind == "flag" or not isinstance(value, bool))
        return "" if right else f"{name}: expected a {settings.kind}, got {value!r}"


FASTEST_M_S = {"pedestrian": 4.0, "bicycle": 15.0}


def fastest(label: str) -> float:
    """Speed beyond which a road user of a class is not believed, m/s: people 4, bicycles 15, others 60."""
    words = label.lower()
    return next((speed for word, speed in FASTEST_M_S.items() if word in words), 60.0)


def schema_of(
    sizes_m: Mapping[str, Sequence[float]],
    attributes: Mapping[str, Sequence[Value]] | None = None,
    extent: Extent | None = None,
) -> Schema:
    """A schema from usual sizes by class and attributes with their values (none: any text)."""
    classes = {
        name: ClassSettings(size_m=tuple(map(float, size)), fastest_m_s=fastest(name)) for name, size in sizes_m.items()
    }
    known = {name: AttributeSettings(values=tuple(values)) for name, values in (attributes or {}).items()}
    return Schema(extent=extent, classes=classes, attributes=known)


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
        return Schema.model_validate(yaml.safe_load(read_bytes(path, max_bytes=MAX_BYTES)))
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        raise ConfigError(f"{path}: expected YAML, got {plain(error)}") from error
    except ValidationError as error:
        lines = [f"{'.'.join(map(str, item['loc'])) or 'the file'}: {fault_of(item)}" for item in error.errors()[:5]]
        raise ConfigError(f"{path}: {'; '.join(lines)}. Delete it to begin with the defaults.") from error


def save_schema(folder: Path, schema: Schema) -> None:
    """Write the schema beside a journal."""
    kept = schema.model_dump(mode="json", exclude_defaults=True)
    write_text(folder / SCHEMA, yaml.safe_dump(kept, sort_keys=False, allow_unicode=True))
