"""Tables of the nuScenes schema: JSON lists of records, read record by record into columns.

One table is one file, ``[{"token": ..., ...}, ...]`` (nuscenes-devkit, docs/schema_nuscenes.md,
https://github.com/nutonomy/nuscenes-devkit). Those of the whole set have millions of records, so that no more than a
block of text and the records of one batch are in memory beside the columns.
"""

import codecs
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int64, Shaped

from farfield.errors import FileFormatError, plain
from farfield.files.json_text import json_at
from farfield.files.limits import MAX_NAME, open_file

MAX_TABLE_BYTES = 8 << 30
"""Of a table: those of the whole of nuScenes have up to 2 GB."""
MAX_TOKEN = 64
"""Characters of a token; published ones have 32."""
LARGEST = 1e8
"""No coordinate of a map in metres is larger, nor a size or a focal length in pixels."""
_MAX_RECORD, _BLOCK, _BATCH = 1 << 20, 4 << 20, 20_000
_MAX_PATH, _MAX_TEXT, _MAX_TOKENS = 512, 1 << 16, 64
_GAP = re.compile(r"[ \t\n\r]*(,?)[ \t\n\r]*")
_ABSENT = object()


@dataclass(frozen=True)
class TableField:
    """What a column of a table holds.

    Args:
        kind: ``"token"``, ``"link"`` (a token, or empty), ``"tokens"`` (a list of them), ``"name"``, ``"text"``,
            ``"path"``, ``"whole"``, ``"flag"``, ``"numbers"`` or ``"any"``.
        count: How many numbers.
        optional: Whether records may lack it, or have null there: texts are empty then, numbers NaN or -1.
    """

    kind: str
    count: int = 0
    optional: bool = False


@dataclass(frozen=True, eq=False)
class TokenLists:
    """Lists of tokens, one a record: those of record i are ``tokens[starts[i]:starts[i + 1]]``."""

    tokens: Shaped[np.ndarray, " n"]
    starts: Int64[np.ndarray, " rows"]

    @property
    def counts(self) -> Int64[np.ndarray, " rows"]:
        """Length of each list."""
        return np.diff(self.starts)


TableColumns = dict[str, Any]
"""Columns by name: arrays of one length, objects for texts, :class:`TokenLists` for lists of tokens."""


def read_table(path: Path | str, fields: Mapping[str, TableField]) -> TableColumns:
    """Read some columns of a table; others are passed over.

    Args:
        path: The JSON file.
        fields: What is read, by column.

    Returns:
        Tokens as bytes (``S``), names and texts as objects, paths as bytes in UTF-8, whole numbers as int64, flags as
        bool, numbers as float64 of shape (n,) or (n, count).

    Raises:
        FileFormatError: If it is no list of such records; the message names the record and the column.
    """
    parts: dict[str, list[Any]] = {name: [] for name in fields}
    start = 0
    for batch in _batches(path):
        for name, field in fields.items():
            parts[name].append(_column(path, start, name, field, batch))
        start += len(batch)
    return {name: _joined(parts[name], field) for name, field in fields.items()}


def _joined(parts: list[Any], field: TableField) -> Any:
    if field.kind == "tokens":
        counts = np.concatenate([part.counts for part in parts] or [np.zeros(0, np.int64)])
        tokens = np.concatenate([part.tokens for part in parts] or [np.zeros(0, "S1")])
        return TokenLists(tokens, np.concatenate([[0], np.cumsum(counts)]).astype(np.int64))
    return np.concatenate(parts) if parts else _empty(field)


def _empty(field: TableField) -> np.ndarray:
    dtype: Any = {"whole": np.int64, "flag": bool, "numbers": np.float64}.get(field.kind, object)
    dtype = "S1" if field.kind in ("token", "link", "path") else dtype
    return np.zeros((0, field.count) if field.count > 1 else 0, dtype)


def _batches(path: Path | str) -> Iterator[list[dict[str, Any]]]:
    batch: list[dict[str, Any]] = []
    for record in _records(path):
        batch.append(record)
        if len(batch) == _BATCH:
            yield batch
            batch = []
    if batch:
        yield batch


def _records(path: Path | str) -> Iterator[dict[str, Any]]:
    """The records of a list, one after another, from blocks of the file's text."""
    number = -1
    decoder = codecs.getincrementaldecoder("utf-8-sig")()
    with open_file(path, max_bytes=MAX_TABLE_BYTES) as handle:
        text, at, whole = "", 0, False
        while True:
            if not whole and len(text) - at < _MAX_RECORD:
                block = handle.read(_BLOCK)
                whole = not block
                try:
                    text, at = text[at:] + decoder.decode(block, whole), 0
                except UnicodeDecodeError as error:
                    raise _fault(path, number + 1, "text in UTF-8", plain(error)) from error
                if not whole:
                    continue
            gap = _GAP.match(text, at)
            assert gap is not None
            begin, comma = gap.end(), bool(gap.group(1))
            if number < 0:
                if comma or not text.startswith("[", begin):
                    raise _fault(path, 0, "a list of records", repr(text[begin : begin + 40]))
                number, at = 0, begin + 1
                continue
            if not comma and text.startswith("]", begin):
                rest = text[begin + 1 :]
                if rest.strip() or handle.read(1 << 16).strip():
                    raise _fault(path, number, "nothing behind the list", repr(rest.strip()[:40]))
                return
            if comma != (number > 0):
                raise _fault(path, number, "records with a comma between", repr(text[at : at + 40]))
            record, at = _decoded(path, number, text, begin)
            number += 1
            yield record


def _decoded(path: Path | str, number: int, text: str, at: int) -> tuple[dict[str, Any], int]:
    try:
        record, end = json_at(text, at)
    except ValueError as error:
        actual = plain(error) if len(text) - at < _MAX_RECORD else f"{plain(error)}, or a record above 1 MB"
        raise _fault(path, number, "JSON", actual) from error
    if not isinstance(record, dict) or end - at > _MAX_RECORD:
        raise _fault(path, number, "an object of at most 1 MB", repr(text[at : at + 40]))
    return record, end


def _fault(path: Path | str, number: int, expected: str, got: str) -> FileFormatError:
    return FileFormatError(path, where=f"record {number}", expected=expected, got=got[:120])


def _column(path: Path | str, start: int, name: str, field: TableField, batch: list[dict[str, Any]]) -> Any:
    values = [record.get(name, _ABSENT) for record in batch]
    if field.optional:
        values = [_default(field) if value is _ABSENT or value is None else value for value in values]
    if _is_sound(field, values):
        return _array(field, values)
    for row, value in enumerate(values):
        if not _is_sound(field, [value]):
            got = "no such key" if value is _ABSENT else repr(value)
            raise _fault(path, start + row, f"{name} to be {_words(field)}", got)
    raise _fault(path, start, f"{name} to be {_words(field)}", "others")


def _default(field: TableField) -> Any:
    if field.kind == "numbers":
        return [float("nan")] * field.count if field.count > 1 else float("nan")
    return {"whole": -1, "flag": False, "tokens": [], "any": None}.get(field.kind, "")


def _words(field: TableField) -> str:
    if field.kind == "numbers":
        return f"{field.count} finite numbers below {LARGEST:g}" if field.count > 1 else "a finite number"
    return {
        "token": f"a token of 1 to {MAX_TOKEN} letters and digits",
        "link": f"a token of at most {MAX_TOKEN} letters and digits, or empty",
        "tokens": "a list of tokens",
        "name": f"a text of at most {MAX_NAME} characters on one line",
        "text": "a text",
        "path": f"a path of at most {_MAX_PATH} bytes",
        "whole": "a whole number of 64 bits",
        "flag": "true or false",
    }.get(field.kind, "anything")


def _is_sound(field: TableField, values: list[Any]) -> bool:
    """Whether all values are what the column holds; quick, for a whole batch."""
    kind = field.kind
    if kind == "any":
        return _ABSENT not in values
    if kind == "tokens":
        lists = all(type(value) is list and len(value) <= _MAX_TOKENS for value in values)
        return lists and _are_tokens(list(chain.from_iterable(values)), 1)
    if kind in ("token", "link"):
        return _are_tokens(values, 1 if kind == "token" else 0)
    if kind in ("name", "text", "path"):
        if not set(map(type, values)) <= {str}:
            return False
        longest = max(map(len, values), default=0)
        if kind == "text":
            return longest <= _MAX_TEXT and _encodes(values)
        return longest <= (MAX_NAME if kind == "name" else _MAX_PATH) and "".join(values).isprintable()
    if kind == "whole":
        whole = set(map(type, values)) <= {int}
        return whole and (not values or (min(values) > -(1 << 62) and max(values) < 1 << 62))
    if kind == "flag":
        return set(map(type, values)) <= {bool}
    return _are_numbers(field, values)


def _encodes(values: list[str]) -> bool:
    return not any("\ud800" <= letter <= "\udfff" for text in values for letter in text)


def _are_tokens(values: list[Any], shortest: int) -> bool:
    if not set(map(type, values)) <= {str}:
        return False
    together, lengths = "".join(values), set(map(len, values))
    shape = not values or (shortest <= min(lengths) and max(lengths) <= MAX_TOKEN)
    return shape and together.isascii() and together.isprintable() and " " not in together


def _are_numbers(field: TableField, values: list[Any]) -> bool:
    if field.count > 1:
        if not set(map(type, values)) <= {list} or not set(map(len, values)) <= {field.count}:
            return False
        values = list(chain.from_iterable(values))
    if not set(map(type, values)) <= {int, float}:
        return False
    try:
        numbers: Float[np.ndarray, " n"] = np.array(values, dtype=np.float64)
    except OverflowError:  # a whole number of hundreds of digits
        return False
    sound: Bool[np.ndarray, " n"] = np.abs(numbers) < LARGEST
    return bool((sound | np.isnan(numbers) if field.optional else sound).all())


def _array(field: TableField, values: list[Any]) -> Any:
    if field.kind == "tokens":
        flat = list(chain.from_iterable(values))
        counts = np.fromiter(map(len, values), np.int64, len(values))
        return TokenLists(_tokens(flat), np.concatenate([[0], np.cumsum(counts)]).astype(np.int64))
    if field.kind in ("token", "link"):
        return _tokens(values)
    if field.kind == "path":
        return np.array([value.encode("utf-8") for value in values])
    if field.kind in ("name", "text", "any"):
        column = np.empty(len(values), dtype=object)
        for row, value in enumerate(values):  # lists among them must not become axes
            column[row] = value
        return column
    if field.count > 1:
        return np.array(list(chain.from_iterable(values)), dtype=np.float64).reshape(-1, field.count)
    return np.array(values, dtype={"whole": np.int64, "flag": bool, "numbers": np.float64}[field.kind])


def _tokens(values: list[str]) -> Shaped[np.ndarray, " n"]:
    lengths = set(map(len, values))
    if len(lengths) == 1 and (length := lengths.pop()):
        return np.frombuffer("".join(values).encode("ascii"), dtype=f"S{length}")
    return np.array(values, dtype="S") if values else np.zeros(0, "S1")
