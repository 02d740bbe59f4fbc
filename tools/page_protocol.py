"""The types of the messages as TypeScript: ``python tools/page_protocol.py > web/src/protocol.ts``."""

import sys
from collections.abc import Iterator
from dataclasses import MISSING, Field, fields, is_dataclass
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from farfield.studio.messages.replies import Reply
from farfield.studio.messages.requests import Request
from farfield.studio.messages.rows import VERSION, BoxValue

_PLAIN = {str: "string", bool: "boolean", int: "number", float: "number", NoneType: "null", Any: "unknown"}
_HEAD = """\
// Made by `python tools/page_protocol.py`; do not edit. Metres, radians; int64 nanoseconds are strings.

/** Of these messages; the server sends pages of another version away. */
export const VERSION = {version};
"""


def typescript() -> str:
    """All messages and what they hold, as one TypeScript module."""
    asked, told = get_args(get_args(Request)[0]), get_args(Reply)
    given = {BoxValue, *asked}  # what the page writes may leave out what has a default
    parts = [_HEAD.format(version=VERSION)]
    parts += [_interface(each, optional=each in given) for each in _reached((*asked, *told))]
    parts += [_union("Request", asked), _union("Reply", told)]
    return "\n".join(parts)


def _reached(roots: tuple[type, ...]) -> list[type]:
    """The dataclasses that the roots hold, each after what it holds, and the roots."""
    found: list[type] = []
    waiting: list[tuple[type, bool]] = [(root, False) for root in reversed(roots)]
    while waiting:
        cls, ready = waiting.pop()
        if ready:
            found.append(cls)
        elif cls not in found:
            waiting.append((cls, True))
            held = [each for hint in get_type_hints(cls).values() for each in _held(hint)]
            waiting += [(each, False) for each in reversed(held) if each not in found]
    return list(dict.fromkeys(found))


def _held(hint: Any) -> Iterator[type]:
    if is_dataclass(hint) and isinstance(hint, type):
        yield hint
    for each in get_args(hint):
        yield from _held(each)


def _interface(cls: type, *, optional: bool) -> str:
    hints = get_type_hints(cls, include_extras=True)
    words = " ".join((cls.__doc__ or "").split())
    rows = [f"  {_name(each, optional)}: {_type(hints[each.name])};" for each in fields(cls)]
    return "\n".join([f"/** {words} */", f"export interface {cls.__name__} {{", *rows, "}", ""])


def _name(each: Field[Any], optional: bool) -> str:
    has_default = each.default is not MISSING or each.default_factory is not MISSING
    return f"{each.name}?" if optional and has_default and each.name != "op" else each.name


def _type(hint: Any) -> str:
    origin, inner = get_origin(hint), get_args(hint)
    if hint in _PLAIN:
        return _PLAIN[hint]
    if origin is Annotated:
        return _type(inner[0])
    if origin is Literal:
        return " | ".join(f'"{value}"' for value in inner)
    if origin in (Union, UnionType):
        return " | ".join(dict.fromkeys(_type(each) for each in inner))
    if origin is tuple:
        each = " | ".join(dict.fromkeys(_type(one) for one in inner if one is not Ellipsis))
        return f"({each})[]" if " " in each else f"{each}[]"
    if origin is dict:
        return f"Record<string, {_type(inner[1])}>"
    if is_dataclass(hint) and isinstance(hint, type):
        return hint.__name__
    raise TypeError(f"protocol: expected a type that TypeScript knows, got {hint!r}")


def _union(name: str, members: tuple[type, ...]) -> str:
    return "\n".join([f"export type {name} =", *(f"  | {each.__name__}" for each in members)]) + ";\n"


if __name__ == "__main__":
    sys.stdout.write(typescript())
