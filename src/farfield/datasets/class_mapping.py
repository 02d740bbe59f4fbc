"""What a mapping file of an own folder may say: ``classes: {Auto: vehicle, LKW: large_vehicle}``."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from farfield.errors import ConfigError, plain
from farfield.files.atomic import read_bytes
from farfield.frame import Annotation

MAPPING_NAME = "mapping.yaml"
_MAX_BYTES = 1 << 20


class _Classes(BaseModel):
    model_config = ConfigDict(extra="forbid")

    classes: dict[str, Annotated[str, Field(min_length=1)]] = {}


def read_class_mapping(path: Path | str) -> Mapping[str, str]:
    """The classes by the names that the labels have.

    Raises:
        ConfigError: If it cannot be read, is no YAML, or has another key.
    """
    try:
        content = yaml.safe_load(read_bytes(path, max_bytes=_MAX_BYTES).decode("utf-8"))
        return _Classes.model_validate({} if content is None else content).classes
    except ValidationError as error:
        mend = "An own folder's mapping has one key, such as classes: {Auto: vehicle}."
        raise ConfigError(f"{path}: {plain(error)}. {mend}") from error
    except (OSError, ValueError, RecursionError, yaml.YAMLError) as error:
        raise ConfigError(f"{path}: expected a mapping file in YAML, found: {plain(error)}") from error


def renamed(annotation: Annotation, classes: Mapping[str, str]) -> Annotation:
    """An annotation under other class names; what the labels say stays as ``original_label``."""
    names = tuple(map(str, annotation.boxes.label))
    if not set(names) & set(classes):
        return annotation
    boxes = annotation.boxes.replace(label=[classes.get(name, name) for name in names])
    return Annotation(boxes=boxes, original_label=names)
