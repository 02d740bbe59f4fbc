"""JSON that strangers wrote: read within bounds, and edited value by value so that all else keeps its bytes."""

import json
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from farfield.errors import FileFormatError, plain
from farfield.files.atomic import read_bytes
from farfield.files.limits import MAX_BYTES, fits_64_bits
from farfield.files.sizes import sized

MAX_MEMORY_BYTES, MEMORY_SHARE = 1 << 30, 8  # of the values that a text becomes: so many, and so many more a byte of it
_DEPTH = 64
_GROUP_BYTES, _VALUE_BYTES, _TEXT_BYTES = 200, 40, 60  # what a group or list, a value, and a text beside it take
_NO_MARKS = bytes(set(range(256)) - set(b'"[]{},:'))
_STEPS = np.zeros(256, dtype=np.int8)
_STEPS[list(b"[{")], _STEPS[list(b"]}")] = 1, -1
_ZEROS = bytes.maketrans(b"123456789E", b"000000000e")
_LARGE = (b"0" * 19, b"e000", b"e+000")  # digits as zeros that may be a number beyond 64 bits, or beyond floats
_HALF = re.compile(rb"\\u[dD][89a-fA-F]")  # half a character, unless its other half follows
_BLANK = re.compile(r"[ \t\n\r]*")
_DECODER = json.JSONDecoder()

Steps = Sequence[str | int]
"""The way to a value: keys of objects and places in lists."""


def read_json(path: Path | str, *, max_bytes: int = MAX_BYTES, nan: bool = False) -> Any:
    """The content of a JSON file, as :func:`parse_json`.

    Raises:
        FileFormatError: If it is none, or larger or deeper than the limits.
        OSError: If it cannot be opened.
    """
    return parse_json(read_bytes(path, max_bytes=max_bytes), path, max_bytes=max_bytes, nan=nan)


def parse_json(data: bytes, path: Path | str, *, max_bytes: int = MAX_BYTES, nan: bool = False) -> Any:
    """The content of a JSON file, as :func:`plain_json`.

    Raises:
        FileFormatError: If it is anything else.
    """
    if len(data) > max_bytes:
        raise FileFormatError(path, where="the file", expected=f"at most {max_bytes} bytes", got=f"{len(data)} bytes")
    try:
        return plain_json(data, nan=nan)
    except ValueError as error:
        raise FileFormatError(path, where="the file", expected="JSON", got=plain(error)) from error


def plain_json(data: bytes | str, *, nan: bool = False) -> Any:
    """The value of a JSON text: one loader for whole files, headers and lines.

    UTF-8; finite numbers, whole ones of 64 bits; no key twice in one object, nested 64 deep at most; by its brackets
    and commas not above :data:`MAX_MEMORY_BYTES` in memory, and :data:`MEMORY_SHARE` times its own size.

    Args:
        data: The text.
        nan: Take ``NaN``, which Python writes and JSON does not have, for a number that is not known.

    Raises:
        ValueError: If it is anything else.
    """
    data = data.encode("utf-8") if isinstance(data, str) else data
    _check_size(data)
    text = data.decode("utf-8-sig")
    zeros = data.translate(_ZEROS)
    large = any(form in zeros for form in _LARGE)
    parse_int, parse_float = (_whole_number, _number) if large else (None, None)
    del zeros
    try:
        value = json.loads(
            text,
            parse_int=parse_int,
            parse_float=parse_float,
            parse_constant=_nan_alone if nan else _refuse,
            object_pairs_hook=_object,
        )
    except RecursionError as error:
        raise ValueError(f"values nested deeper than {_DEPTH}") from error
    if _HALF.search(data):
        json.dumps(value, ensure_ascii=False).encode("utf-8")
    return value


def concatenated_json(text: str) -> Iterator[tuple[int, Any]]:
    """The values of a text that holds one behind the other, each with its first character's place.

    Raises:
        ValueError: As :func:`plain_json`; it begins with the character.
    """
    _check_size(text.encode("utf-8"))
    at = _skip(text, 0)
    while at < len(text):
        try:
            value, end = _STRICT_DECODER.raw_decode(text, at)
        except (ValueError, RecursionError) as error:
            raise ValueError(f"character {at}: {plain(error)}") from error
        yield at, value
        at = _skip(text, end)


def json_at(text: str, at: int) -> tuple[Any, int]:
    """A value that begins at a character of a text, and where it ends; its numbers are as Python reads them.

    Raises:
        ValueError: If it is none, its end is not there, or a key stands twice in an object.
    """
    try:
        return _RECORD_DECODER.raw_decode(text, at)
    except RecursionError as error:
        raise ValueError(f"values nested deeper than {_DEPTH}") from error


def _check_size(data: bytes) -> None:
    """Count brackets and commas outside of texts: nothing else makes values many or deep."""
    if len(data) < 1 << 16 and data.count(b"[") + data.count(b"{") <= _DEPTH:  # a line of a journal: neither
        return
    marks = np.frombuffer(data.replace(b"\\\\", b"").replace(b'\\"', b"").translate(None, _NO_MARKS), np.uint8)
    outside = marks[np.cumsum(marks == ord('"'), dtype=np.uint8) % 2 == 0]  # a text's end mark is among them
    texts, keys, commas, lists, objects = (int(np.count_nonzero(outside == ord(mark))) for mark in '":,[{')
    groups = lists + objects
    if groups > _DEPTH and np.cumsum(_STEPS[outside], dtype=np.int16).max() > _DEPTH:
        raise ValueError(f"values nested deeper than {_DEPTH}")
    widest = int(np.frombuffer(data, np.uint8).max())
    memory_bytes = _GROUP_BYTES * groups + _VALUE_BYTES * commas + _TEXT_BYTES * max(0, texts - keys)  # keys recur
    memory_bytes += 2 * len(data) * (4 if widest >= 0xF0 else 2 if widest >= 0xC4 else 1)  # as Python holds characters
    if memory_bytes > (limit_bytes := MAX_MEMORY_BYTES + MEMORY_SHARE * len(data)):
        raise ValueError(f"values that take {sized(memory_bytes)} in memory, beyond {sized(limit_bytes)}")


def _nan_alone(word: str) -> float:
    return float("nan") if word == "NaN" else _refuse(word)


def _refuse(word: str) -> NoReturn:
    raise ValueError(f"{word}, which JSON does not have")


def _whole_number(digits: str) -> int:
    number = int(digits) if len(digits) <= 20 else 1 << 64
    if not fits_64_bits(number):
        raise ValueError(f"the number {digits[:24]}..., beyond 64 bits")
    return number


def _number(digits: str) -> float:
    number = float(digits)
    if abs(number) == float("inf"):
        raise ValueError(f"the number {digits[:24]}, which is not finite")
    return number


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    entries = dict(pairs)
    if len(entries) < len(pairs):
        names = Counter(name for name, _ in pairs)
        raise ValueError(f"the key {names.most_common(1)[0][0][:40]!r} twice in one object")
    return entries


_STRICT_DECODER = json.JSONDecoder(
    parse_int=_whole_number, parse_float=_number, parse_constant=_refuse, object_pairs_hook=_object
)

_RECORD_DECODER = json.JSONDecoder(parse_constant=_refuse, object_pairs_hook=_object)


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
