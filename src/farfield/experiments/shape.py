"""The shape of an experiment's settings: which keys stand where, and how one file extends another."""

from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel

Tree = dict[str, Any]
_FURTHER = {"TrainingConfig": ("start_from",), "Experiment": ("extends",)}
"""Keys that a group takes besides its fields."""


def keys_of(kind: Any, path: Sequence[str | int]) -> list[str]:
    """The keys that a group of settings takes.

    Args:
        kind: A model, or an annotation of one.
        path: Keys that lead to the group.
    """
    return list(dict.fromkeys(name for model in _models(kind, path) for name in _names(model)))


def is_group(kind: Any, path: Sequence[str | int]) -> bool:
    """Whether settings stand there, and not a value or a mapping of names such as of classes."""
    return any(True for _ in _models(kind, path))


def hint(key: str, keys: Sequence[str]) -> str:
    """What an unknown key's error says of those that there are."""
    close = get_close_matches(key, keys, n=1)
    meant = f" did you mean {close[0]}?" if close else ""
    return f"there is no such key;{meant} the keys here are {', '.join(keys)}"


def merged(base: Tree, over: Tree, kind: Any, path: tuple[str, ...] = ()) -> Tree:
    """Settings laid over others: groups are merged key by key; values, lists and mappings of names are replaced.

    Args:
        base: The settings below.
        over: Those above.
        kind: The model of the whole tree.
        path: Where in the whole tree the two stand.
    """
    found = dict(base)
    for key, value in over.items():
        below, place = base.get(key), (*path, key)
        if isinstance(value, Mapping) and isinstance(below, Mapping) and _merges(kind, place):
            value = merged(dict(below), dict(value), kind, place)
        found[key] = value
    return found


def _merges(kind: Any, place: tuple[str, ...]) -> bool:
    return is_group(kind, place) or place == ("data",)  # data of several streams are groups by name


def _names(model: type[BaseModel]) -> list[str]:
    return [*model.model_fields, *_FURTHER.get(model.__name__, ())]


def _models(kind: Any, path: Sequence[str | int]) -> Iterator[type[BaseModel]]:
    origin, arguments = get_origin(kind), get_args(kind)
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        if not path:
            yield kind
        elif path[0] in kind.model_fields:
            yield from _models(kind.model_fields[str(path[0])].annotation, path[1:])
    elif origin is Annotated:
        yield from _models(arguments[0], path)
    elif origin in (Union, UnionType):
        for each in arguments:
            yield from _models(each, path)
    elif isinstance(origin, type) and issubclass(origin, Mapping) and path:
        yield from _models(arguments[1], path[1:])
    elif origin in (list, tuple) and path:
        yield from _models(arguments[0], path[1:])
