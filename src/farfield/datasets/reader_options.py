"""Options of readers as text, as a command line has them: typed by what the reader's signature says."""

import math
from collections.abc import Callable, Mapping, Sequence
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from farfield.errors import ConfigError

_BOOLS = {"true": True, "false": False}


class OptionText(str):
    """The text of an option's value, which the reader's signature turns into a number, a word or a list."""

    __slots__ = ()


def parsed_options(words: Sequence[str]) -> dict[str, OptionText]:
    """Options of ``name=value`` words.

    Args:
        words: Such as ``whole_scenes=true``; ``-`` in a name is taken for ``_``.

    Raises:
        ConfigError: If a word is none, or a name comes twice.

    >>> parsed_options(["whole-scenes=true"])
    {'whole_scenes': 'true'}
    """
    options: dict[str, OptionText] = {}
    for word in words:
        name, equals, text = word.partition("=")
        name = name.strip().replace("-", "_")
        if not equals or not name or name in options:
            raise ConfigError(f"--reader: expected each NAME=VALUE once, got {word!r}")
        options[name] = OptionText(text)
    return options


def typed_options(reader: Callable[..., Any], options: Mapping[str, Any]) -> dict[str, Any]:
    """Options, with texts converted to the types of the reader's signature.

    Args:
        reader: The reader's class.
        options: By name; one that the signature does not know becomes a number, true or false where it is one.

    Raises:
        ConfigError: If a text is not of its option's type.
    """
    hints = get_type_hints(reader.__init__ if isinstance(reader, type) else reader)  # type: ignore[misc]
    return {
        name: _typed(name, str(value), hints.get(name, float | bool | str)) if isinstance(value, OptionText) else value
        for name, value in options.items()
    }


def _typed(name: str, text: str, hint: Any) -> Any:
    kinds = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    if text.lower() == "none" and NoneType in kinds:
        return None
    expected = []
    for kind in sorted(kinds, key=_looseness):
        origin = get_origin(kind) or kind
        if origin is bool:
            if text.lower() in _BOOLS:
                return _BOOLS[text.lower()]
            expected.append("true or false")
        elif origin in (int, float):
            number = _number(text)
            if number is not None and (origin is float or number.is_integer()):
                return int(number) if origin is int else number
            expected.append("a whole number" if origin is int else "a number")
        elif origin is Literal:
            if text in get_args(kind):
                return text
            expected += [str(value) for value in get_args(kind)]
        elif origin is str or not isinstance(origin, type):
            return text
        elif issubclass(origin, Sequence):
            return tuple(word for word in text.split(",") if word)
    raise ConfigError(
        f"--reader {name}: expected {' or '.join(expected) or 'an option that a text can say'}, got {text!r}"
    )


def _looseness(kind: Any) -> int:
    """Texts come last, which take anything."""
    origin = get_origin(kind) or kind
    return {bool: 0, int: 1, float: 2, Literal: 0, str: 4}.get(origin, 3)


def _number(text: str) -> float | None:
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None
