"""Every key of an experiment's YAML file as a table, from the types.

``python tools/experiment_keys.py docs/experiments.md`` writes it into the page.
"""

import enum
import json
import re
import sys
import types
from collections.abc import Iterator
from pathlib import Path, PurePath
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from farfield.detectors import DETECTORS
from farfield.detectors.config import DetectorConfig
from farfield.experiments.schema import DataConfig, Experiment
from farfield.files.atomic import write_text
from farfield.training.config import AugmentationConfig, TrainingConfig

_HEAD = "| key | type | default | what it is |\n|---|---|---|---|\n"
BEGIN, END = "<!-- keys: begin -->\n", "<!-- keys: end -->\n"
"""Between these lines of the page the tables stand."""


def tables() -> str:
    """The tables as Markdown: the groups that all experiments share, then each detector's own keys."""
    parts = [f"### The file\n\n{_HEAD}{''.join(_rows(Experiment, '', only=('name', 'method')))}"]
    groups: list[tuple[str, type[BaseModel]]] = [
        ("data", DataConfig),
        ("training", TrainingConfig),
        ("augmentation", AugmentationConfig),
        ("detector", DetectorConfig),
    ]
    for name, model in groups:
        title = f"### `{name}`" + (", of every detector" if name == "detector" else "")
        parts.append(f"{title}\n\n{_HEAD}{''.join(_rows(model, f'{name}.'))}")
    shared = tuple(DetectorConfig.model_fields)
    for name in DETECTORS.builtin:
        config = DETECTORS[name].config_class
        rows = "".join(_rows(config, "detector.", without=shared))
        parts.append(f"### `detector`, where `name` is `{name}`\n\n{_HEAD}{rows}")
    return "\n".join(parts)


def _rows(
    model: type[BaseModel],
    path: str,
    *,
    only: tuple[str, ...] = (),
    without: tuple[str, ...] = (),
    usual: BaseModel | None = None,
) -> Iterator[str]:
    """A row a key; those of groups within follow their group. ``usual`` is the group where none is given."""
    for name, info in model.model_fields.items():
        if name in without or (only and name not in only):
            continue
        inner = _model_in(info.annotation)
        kind = "group" if inner is not None else _type(info.annotation) + _limits(info)
        meaning = info.description or _first_line(inner)
        value = _value(info) if usual is None else getattr(usual, name)
        yield f"| `{path}{name}` | {kind} | {_default(value, inner)} | {meaning} |\n"
        if inner is not None:
            yield from _rows(inner, f"{path}{name}.", usual=value if isinstance(value, inner) else None)


def _model_in(annotation: Any) -> type[BaseModel] | None:
    """The group of settings that a field is, alone or as one of ``group | None``."""
    for kind in (annotation, *get_args(annotation)):
        if isinstance(kind, type) and issubclass(kind, BaseModel) and get_origin(annotation) not in (dict, tuple, list):
            return kind
    return None


def _first_line(model: type[BaseModel] | None) -> str:
    text = "" if model is None else (model.__doc__ or "").partition("\n")[0].rstrip(".")
    return (text[:1].lower() + text[1:]).replace("``", "`")


def _type(annotation: Any) -> str:
    """A type in words for the file: ``whole number``, ``list of ...``."""
    origin, args = get_origin(annotation), get_args(annotation)
    plain = {int: "whole number", float: "number", str: "text", bool: "true or false", type(None): "nothing"}
    if annotation in plain:
        return plain[annotation]
    if origin is Annotated:
        return _type(args[0])
    if origin is Literal:
        return ", ".join(f"`{value}`" for value in args)
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(_type(argument) for argument in args))
    if origin in (tuple, list):
        several = origin is list or args[-1:] == (Ellipsis,)
        return f"list of {_type(args[0])}" if several else f"list of {len(args)}: {_type(args[0])}"
    if origin is dict:
        return f"{_type(args[1])} by {_type(args[0])}"
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return "group of " + ", ".join(f"`{name}`" for name in annotation.model_fields)
    if isinstance(annotation, type) and issubclass(annotation, PurePath):
        return "path"
    if isinstance(annotation, type) and issubclass(annotation, enum.Enum):
        return ", ".join(f"`{member.value}`" for member in annotation)
    return "any value" if annotation is Any else str(annotation).replace("|", "or")


def _limits(info: FieldInfo) -> str:
    words = {"gt": "above", "ge": "from", "lt": "below", "le": "to"}
    limits = [
        f"{words[name]} {getattr(part, name):g}" for part in info.metadata for name in words if hasattr(part, name)
    ]
    return f", {' '.join(limits)}" if limits else ""


def _value(info: FieldInfo) -> Any:
    return PydanticUndefined if info.is_required() else info.get_default(call_default_factory=True)


def _default(value: Any, inner: type[BaseModel] | None) -> str:
    if value is PydanticUndefined:
        return "**needed**"
    if inner is not None:
        return "none" if value is None else "as below"
    if value is None:
        return "none"
    text = json.dumps(value, default=_plain)
    return f"`{re.sub(r'[|]', '/', text)}`"


def _plain(value: Any) -> Any:
    return value.model_dump(mode="json") if isinstance(value, BaseModel) else str(value)


def put_into(page: str) -> str:
    """A page with the tables of today between its two marks."""
    before, _, rest = page.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n{tables()}\n{END}{after}"


if __name__ == "__main__":
    for _name in sys.argv[1:]:
        _page = Path(_name)
        write_text(_page, put_into(_page.read_text(encoding="utf-8")))
