"""Settings of protocols: checked, as JSON, as one line of text, and read from words."""

import math
from collections.abc import Collection, Mapping
from dataclasses import fields, is_dataclass
from itertools import pairwise
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from farfield.errors import ConfigError
from farfield.metrics.bootstrap import Bootstrap


def check_range_bins(edges_m: tuple[float, ...]) -> None:
    """Raise ConfigError unless these are edges of range bins."""
    rising = all(low < high for low, high in pairwise(edges_m))
    if len(edges_m) < 2 or not rising or edges_m[0] < 0:
        raise ConfigError(f"range_bins_m: expected two or more rising edges from 0 on, got {edges_m}")


def check_numbers(settings: Any) -> None:
    """Raise ConfigError if a setting holds NaN, or an infinity that is no edge of a range or window."""
    for field in fields(settings) if is_dataclass(settings) else ():
        value = getattr(settings, field.name)
        if is_dataclass(value):
            check_numbers(value)
        for number in value if isinstance(value, tuple) else (value,):
            is_open = field.name in _OPEN and number in (math.inf, -math.inf)
            if isinstance(number, float) and not math.isfinite(number) and not is_open:
                raise ConfigError(f"{field.name}: expected finite numbers, got {value}. Nothing compares with {number}")


_OPEN = ("range_bins_m", "window_m", "region")


def with_bootstrap(names: Collection[str], options: Mapping[str, Any]) -> dict[str, Any]:
    """Options in which ``replicates`` and ``seed``, as the flags are called, are the setting ``bootstrap``.

    A protocol without intervals has none to draw, so that both say nothing there.

    Args:
        names: The protocol's settings.
        options: What was given.

    Raises:
        ConfigError: If ``bootstrap`` is given too.
    """
    chosen = {name: options[name] for name in ("replicates", "seed") if name in options and name not in names}
    others = {name: value for name, value in options.items() if name not in chosen}
    if not chosen or "bootstrap" not in names:
        return others
    if others.get("bootstrap") is not None:
        raise ConfigError("bootstrap: expected it, or replicates and seed; got both")
    return {**others, "bootstrap": Bootstrap(**chosen)}


def merged_relabel(own: Mapping[str, str], chosen: Mapping[str, str]) -> dict[str, str]:
    """Names that count as others: those that were chosen, and the protocol's own, seen through them.

    A name that is chosen for itself stays apart; an empty mapping leaves nothing of the protocol's own.

    >>> merged_relabel({"large_vehicle": "vehicle"}, {"Lorry": "large_vehicle"})
    {'large_vehicle': 'vehicle', 'Lorry': 'vehicle'}
    >>> merged_relabel({"large_vehicle": "vehicle"}, {"vehicle": "Car"})
    {'large_vehicle': 'Car', 'vehicle': 'Car'}
    """
    if not chosen:
        return {}
    through = {old: chosen.get(new, new) for old, new in own.items()}
    return through | {old: new if new in chosen else through.get(new, new) for old, new in chosen.items()}


def json_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options as JSON values; JSON has no infinity, so an open edge becomes the word ``inf``."""
    return {
        name: [_plain(v) for v in value] if isinstance(value, tuple) else _plain(value)
        for name, value in options.items()
    }


def _plain(value: Any) -> Any:
    return str(value) if isinstance(value, float) and math.isinf(value) else value


def option_text(options: Mapping[str, Any]) -> str:
    """Options as one line of ``name=value`` pairs."""
    return "; ".join(f"{name}={_text(value)}" for name, value in options.items())


def _text(value: Any) -> str:
    if isinstance(value, dict):
        return ",".join(f"{a}->{b}" for a, b in value.items()) or "nothing"
    if isinstance(value, list):
        return ",".join(f"{v:g}" if isinstance(v, float) else str(v) for v in value) or "nothing"
    return f"{value:g}" if isinstance(value, float) else str(value)


def numbers(text: str, what: str) -> tuple[float, ...]:
    """Read comma-separated numbers; ``what`` names them in the error.

    >>> numbers("0,70,150", "--range-bins-m")
    (0.0, 70.0, 150.0)
    """
    try:
        return tuple(float(word) for word in text.split(","))
    except ValueError:
        raise ConfigError(f"{what}: expected comma-separated numbers, got {text!r}") from None


def read_option(settings: type[Any], name: str, text: str) -> Any:
    """Read one setting from its text, as the type of the field asks: a number, a list, pairs ``old:new``, or a word.

    Args:
        settings: The settings' dataclass.
        name: Name of the field; what is no field stays text, so that the protocol can refuse it by name.
        text: The text, such as ``"0.3"``, ``"a,b"``, ``"none"``.

    Raises:
        ConfigError: If the text is not of that type.
    """
    if name not in {field.name for field in fields(settings)}:
        return text
    hint = get_type_hints(settings)[name]
    kinds = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    origins = [get_origin(kind) or kind for kind in kinds]
    choices = {value for kind in kinds if get_origin(kind) is Literal for value in get_args(kind)}
    if Mapping in origins:
        return _renames(name, text)
    if tuple in origins:
        inner = get_args(kinds[origins.index(tuple)])
        return tuple(word for word in text.split(",") if word) if str in inner else numbers(text, f"--options {name}")
    if text in choices:
        return text
    if text == "none" and type(None) in kinds:
        return None
    if bool in kinds:
        return {"true": True, "false": False}.get(text, text)
    return _number(name, text, is_integer=float not in kinds) if float in kinds or int in kinds else text


def _renames(name: str, text: str) -> dict[str, str]:
    pairs = [word.split(":") for word in text.split(",") if word]
    if any(len(pair) != 2 for pair in pairs):
        raise ConfigError(f"--options {name}: expected old:new,old:new, got {text!r}")
    return dict(pairs)


def _number(name: str, text: str, *, is_integer: bool) -> float | int:
    values = numbers(text, f"--options {name}")
    if len(values) != 1 or (is_integer and not values[0].is_integer()):
        raise ConfigError(f"--options {name}: expected one number, got {text!r}")
    return int(values[0]) if is_integer else values[0]
