"""JSON that strangers wrote: read within bounds, and edited value by value so that all else keeps its bytes."""

import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

from farfield.errors import FileFormatError, plain

MAX_BYTES = 1 << 28
_DEPTH = 64
_BLANK = re.compile(r"[ \t\n\r]*")
_DECODER = json.JSONDecoder()

Steps = Sequence[str | int]
"""The way to a value: keys of objects and places in lists."""


def parse_json(data: bytes, path: Path | str, *, max_bytes: int = MAX_BYTES) -> Any:
    """The content of a JSON file: UTF-8, no NaN or Infinity, no key twice in one object, nested 64 deep at most.

    Raises:
        FileFormatError: If it is anything else.
    """
    if len(data) > max_bytes:
        raise FileFormatError(path, where="the file", expected=f"at most {max_bytes} bytes", got=f"{len(data)} bytes")
    try:
        text = data.decode("utf-8-sig")
        _check_depth(text)
        return json.loads(text, parse_constant=_refuse, object_pairs_hook=_object)
    except (ValueError, RecursionError) as error:
        raise FileFormatError(path, where="the file", expected="JSON", got=plain(error)) from error


def _check_depth(text: str) -> None:
    depth = 0
    for mark in re.finditer(r'"(?:[^"\\]|\\.)*"|[\[{]|[\]}]', text):
        depth += mark[0] in "[{"
        depth -= mark[0] in "]}"
        if depth > _DEPTH:
            raise ValueError(f"values nested deeper than {_DEPTH}")


def _refuse(word: str) -> NoReturn:
    raise ValueError(f"{word}, which JSON does not have")


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    entries = dict(pairs)
    if len(entries) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"the key {twice[:40]!r} twice in one object")
    return entries


def finite(value: Any, *, limit: float = 1e9) -> float | None:
    """A JSON number as a float; None for anything else, and for numbers beyond the limit.

    >>> finite(2), finite(True), finite("2"), finite(1e300)
    (2.0, None, None, None)
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if abs(value) <= limit else None  # also false for NaN


def span(text: str, steps: Steps) -> tuple[int, int] | None:
    """Where a value stands in a text of JSON: its start and end; None where there is none."""
    at = _skip(text, 1 if text.startswith("\ufeff") else 0)
    for step in steps:
        start_at = next((start for name, start, _ in _children(text, at) if name == step), None)
        if start_at is None:
            return None
        at = start_at
    return at, _DECODER.raw_decode(text, at)[1]


def set_value(text: str, steps: Steps, value: Any) -> str:
    """The text with another value in a place. A value that is the same keeps its spelling; a new key is added.

    Raises:
        KeyError: If the object or list that is to hold it is not there.
    """
    bounds = span(text, steps)
    if bounds is None:
        return append(text, steps[:-1], value, key=str(steps[-1]))
    start, end = bounds
    old = _DECODER.raw_decode(text, start)[0]
    if old == value and type(old) is type(value):
        return text
    return text[:start] + json.dumps(value) + text[end:]


def remove(text: str, steps: Steps) -> str:
    """The text without a value, and without its key and one comma. Nothing happens where there is none."""
    bounds = span(text, steps)
    if bounds is None:
        return text
    outer = span(text, steps[:-1])
    assert outer is not None
    children = list(_children(text, outer[0]))
    number = next(number for number, child in enumerate(children) if child[0] == steps[-1])
    ends = [_DECODER.raw_decode(text, start)[1] for _, start, _ in children]
    if number + 1 < len(children):
        return text[: children[number][2]] + text[children[number + 1][2] :]
    begin = ends[number - 1] if number else children[number][2]
    return text[:begin] + text[ends[number] :]


def append(text: str, steps: Steps, value: Any, *, key: str | None = None) -> str:
    """The text with a value more at the end of a list, or under a key at the end of an object.

    It stands as the one before it does: on a line of its own, indented likewise, or behind a comma.

    Raises:
        KeyError: If there is no such list or object.
    """
    outer = span(text, steps)
    if outer is None:
        raise KeyError("/".join(map(str, steps)))
    entry = ("" if key is None else f"{json.dumps(key)}: ") + json.dumps(value)
    children = list(_children(text, outer[0]))
    if not children:
        return text[: outer[0] + 1] + entry + text[outer[1] - 1 :]
    before = text[outer[0] + 1 : children[0][2]]  # blanks between the bracket and the first
    end = _DECODER.raw_decode(text, children[-1][1])[1]
    gap = f",{before}" if before else ", "
    return text[:end] + gap + entry + text[end:]


def _children(text: str, at: int) -> Iterator[tuple[str | int, int, int]]:
    """Name, start of the value and start of the entry of each child of an object or a list."""
    opening, number = text[at : at + 1], 0
    if opening not in ("{", "["):
        return
    at = _skip(text, at + 1)
    while text[at] not in "]}":
        entry, name = at, number
        if opening == "{":
            name, at = _DECODER.raw_decode(text, at)
            at = _skip(text, _skip(text, at) + 1)  # the colon
        yield name, at, entry
        at = _skip(text, _DECODER.raw_decode(text, at)[1])
        at = _skip(text, at + 1) if text[at] == "," else at
        number += 1


def _skip(text: str, at: int) -> int:
    match = _BLANK.match(text, at)
    return at if match is None else match.end()
