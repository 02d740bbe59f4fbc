"""One's own class names: a mapping file for every format, ``classes: {Auto: vehicle, LKW: large_vehicle}``."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar
from unicodedata import normalize

import numpy as np
import yaml
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from farfield.datasets.base import Dataset
from farfield.datasets.frame_maps import Earlier
from farfield.errors import ConfigError, plain
from farfield.files.atomic import read_bytes
from farfield.files.limits import MAX_NAME
from farfield.files.yaml_text import MAX_BYTES, plain_yaml
from farfield.frame import Annotation, Boxes, Frame
from farfield.vocabulary.classes import normalised_class

MAPPING_NAME = "mapping.yaml"


class _Classes(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    classes: dict[str, Annotated[str, Field(min_length=1, max_length=MAX_NAME)]] = {}


def read_class_mapping(path: Path | str) -> Mapping[str, str]:
    """The classes by the names that the labels have.

    Raises:
        ConfigError: If it cannot be read, is no YAML, or has another key.
    """
    try:
        classes = _Classes.model_validate(_content(path)).classes
    except ValidationError as error:
        fix = "A mapping of classes has one key, such as classes: {Auto: vehicle}."
        raise ConfigError(f"{path}: {plain(error)}. {fix}") from error
    return _in_one_form(path, classes)


def _in_one_form(path: Path | str, classes: Mapping[str, str]) -> dict[str, str]:
    """The classes with their names in composed Unicode, in which readers compare them."""
    for name in classes.values():
        if not name.isprintable() or len(name) > MAX_NAME:
            expected = f"names of classes on one line, of at most {MAX_NAME} characters"
            raise ConfigError(f"{path}: expected {expected}, got {name[:80]!r}")
    return {normalize("NFC", name): normalize("NFC", ours) for name, ours in classes.items()}


def maps_classes(path: Path | str) -> bool:
    """Whether a mapping file is one of classes, for any format, and not of a Cirrus layout.

    Raises:
        ConfigError: If it cannot be read, or is no YAML.
    """
    content = _content(path)
    return isinstance(content, dict) and set(content) == {"classes"}


def _content(path: Path | str) -> Any:
    try:
        content = plain_yaml(read_bytes(path, max_bytes=MAX_BYTES))
    except (OSError, yaml.YAMLError) as error:
        raise ConfigError(f"{path}: expected a mapping file in YAML, found: {plain(error)}") from error
    return {} if content is None else content


def renamed(annotation: Annotation, classes: Mapping[str, str]) -> Annotation:
    """An annotation under other class names; what the labels say stays as ``original_label``.

    Args:
        annotation: Its original labels, where there are any, are looked up first, then its classes.
        classes: Names by the names in the files; others stay.
    """
    names = tuple(map(str, annotation.boxes.label))
    written = names if annotation.original_label is None else tuple(map(str, annotation.original_label))
    new = [
        classes.get(normalize("NFC", own), classes.get(normalize("NFC", name), normalize("NFC", name)))
        for own, name in zip(written, names, strict=True)
    ]
    if tuple(new) == names:
        return annotation
    full = annotation.full_boxes
    return replace(
        annotation,
        boxes=annotation.boxes.replace(label=new),
        full_boxes=None if full is None else full.replace(label=new),
        original_label=written,
    )


def class_mapping_of(data: Dataset) -> dict[str, str]:
    """The classes by the names in the files, as a data set was opened with them; empty without a mapping."""
    own = getattr(data.unwrapped, "class_mapping", {})
    classes = dict(own)
    for function in data.maps:
        classes |= function.classes if isinstance(function, Classes) else {}
    return classes


def usual(annotation: Annotation) -> Annotation:
    """An annotation whose usual names of other data sets are ours: ``Car`` a ``vehicle``."""
    names = set(map(str, annotation.boxes.label))
    return renamed(annotation, {name: ours for name in names if (ours := normalised_class(name, {})) != name})


class ClassesSettings(BaseModel):
    """Settings of :class:`Classes`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    classes: dict[str, Annotated[str, Field(min_length=1, max_length=MAX_NAME)]]


@dataclass(frozen=True)
class Classes:
    """Every box under the class that a mapping gives the name in the label files.

    Args:
        classes: Classes by the names in the files; other names stay as the reader has them.
    """

    name: ClassVar[str] = "classes"
    Settings: ClassVar[type[BaseModel]] = ClassesSettings
    classes: Mapping[str, str]

    def settings(self) -> Mapping[str, Any]:
        """The classes."""
        return {"classes": dict(self.classes)}

    def fits(self, dataset: Any) -> bool:
        """Whether other data can be seen so: no, the names are those of one data set's files."""
        del dataset
        return False

    def moved_poses(self, world_T_frame: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 4 4"]:
        """The poses as they are."""
        return world_T_frame

    def annotated(self, annotation: Annotation) -> Annotation:
        """An annotation under the mapping's classes."""
        return renamed(annotation, self.classes)

    def __call__(self, frame: Frame, earlier: Earlier) -> Frame:
        """The frame with its annotation under the mapping's classes."""
        del earlier
        return replace(frame, load_annotation=_Renaming(frame, self)) if frame.has_annotation else frame


@dataclass(frozen=True, eq=False)
class _Renaming:
    """Loads the annotation of a frame under other class names."""

    frame: Frame
    classes: Classes

    def __call__(self) -> Annotation:
        return self.classes.annotated(self.frame.annotation or Annotation(boxes=Boxes.empty()))
