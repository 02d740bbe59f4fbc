"""Errors of Python, json, yaml and pydantic in plain words."""

from collections.abc import Mapping
from typing import Any


def plain(error: BaseException) -> str:
    """An error of Python, json, yaml or pydantic in words that name the place and the fault, on one line.

    The texts of those libraries are for programmers; a file's owner needs the place and what is missing there.
    """
    if callable(getattr(error, "errors", None)):  # pydantic's; not imported here, since all import this module
        faults = error.errors()  # type: ignore[attr-defined]
        return "; ".join(_placed(item) for item in faults[:5]) + (" ..." if len(faults) > 5 else "")
    mark = getattr(error, "problem_mark", None)  # yaml's
    if mark is not None:
        tab = " (a tab: indent with blanks)" if "\\t" in str(getattr(error, "problem", "")) else ""
        return f"what is no YAML in line {mark.line + 1}, column {mark.column + 1}{tab}"
    if hasattr(error, "lineno") and hasattr(error, "doc"):  # json's
        return _json_fault(error)
    if isinstance(error, UnicodeDecodeError):
        return f"bytes that are no UTF-8 text, from byte {error.start} on"
    if isinstance(error, RecursionError):
        return "too many groups within one another"
    if type(error) is KeyError:
        return f"no key {error.args[0]!r}" if error.args else "a missing key"
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return " ".join(str(error).split())[:200] or type(error).__name__


def fault_of(item: Mapping[str, Any]) -> str:
    """One entry of a pydantic error in plain words, without its place: ``expected a number, got 'abc'``."""
    kind, limits = str(item["type"]), item.get("ctx") or {}
    if kind in ("missing", "extra_forbidden"):
        return "missing" if kind == "missing" else "no such key"
    if kind in ("value_error", "assertion_error"):
        return str(limits.get("error", item["msg"]))
    expected = _expected(kind, limits)
    if not expected:
        return str(item["msg"]).replace("Input should be", "expected").replace("Value error, ", "")
    return f"expected {expected}, got {_short(item.get('input'))}"


def _placed(item: Mapping[str, Any]) -> str:
    place = ".".join(map(str, item["loc"]))
    return f"{place}: {fault_of(item)}" if place else fault_of(item)


def _expected(kind: str, limits: Mapping[str, Any]) -> str:
    for name, words in _BOUNDS.items():
        if kind == name:
            return words.format(next(iter(limits.values()), ""))
    if kind in ("too_short", "too_long"):
        bound = limits.get("min_length", limits.get("max_length"))
        return f"at {'least' if kind == 'too_short' else 'most'} {bound} entries"
    return _KINDS.get(kind) or _KINDS.get(kind.rpartition("_")[0]) or _KINDS.get(kind.partition("_")[0], "")


_BOUNDS = {
    "greater_than": "more than {}",
    "greater_than_equal": "{} or more",
    "less_than": "less than {}",
    "less_than_equal": "{} or less",
    "literal_error": "{}",
    "enum": "{}",
}
_KINDS = {
    "int": "a whole number",
    "float": "a number",
    "finite_number": "a finite number",
    "bool": "true or false",
    "string": "text",
    "list": "a list",
    "tuple": "a list",
    "dict": "a group of keys",
    "model": "a group of keys",
    "model_attributes": "a group of keys",
    "path": "a path",
    "json": "JSON",
    "is_instance_of": "another kind of value",
    "none_required": "nothing",
}
_JSON_WORDS = {
    "Expecting value": "a value is missing",
    "Expecting property name": "a key in double quotes is missing",
    "Illegal trailing comma": "a comma stands before the end",
    "Expecting ','": "a comma is missing",
    "Expecting ':'": "a colon is missing",
    "Extra data": "text follows after the end",
    "Unterminated string": "a text has no end quote",
    "Invalid control": "a text holds a control character",
    "Invalid \\": "a text holds a wrong escape",
}


def _json_fault(error: Any) -> str:
    if not str(error.doc).strip():
        return "an empty file"
    words = next((words for begin, words in _JSON_WORDS.items() if str(error.msg).startswith(begin)), "no JSON there")
    return f"a fault in line {error.lineno}, column {error.colno}: {words}"


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."
