"""Words of the command line into values."""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from farfield.errors import ConfigError

if TYPE_CHECKING:
    from farfield.metrics import Protocol


OUTPUT = Path("-")
"""What ``--json -`` names: the output instead of a file."""


def write_json(path: Path, tree: Any) -> None:
    """Write JSON into a file, all or nothing, or onto the output for ``-``."""
    from farfield.files.atomic import write_text

    text = json.dumps(tree, indent=1) + "\n"
    if path == OUTPUT:
        sys.stdout.write(text)
    else:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, text)


def read_json(path: Path) -> Any:
    """What one of our own JSON files holds."""
    return json.loads(path.read_text(encoding="utf-8"))


def names(text: str) -> list[str]:
    """Comma-separated names; none for an empty text."""
    return [word.strip() for word in text.split(",") if word.strip()]


def pairs_of(text: str, flag: str) -> dict[str, str]:
    """Comma-separated pairs ``a:b``.

    Raises:
        ConfigError: If a word is no such pair, or a name stands twice on one side.
    """
    found: dict[str, str] = {}
    for word in names(text):
        first, colon, second = (part.strip() for part in word.partition(":"))
        if not (first and colon and second) or first in found or second in found.values():
            raise ConfigError(f"{flag}: expected pairs A:B, each name once, got {word!r}")
        found[first] = second
    return found


def deprecated(old: str, old_value: str, new: str, new_value: str) -> str:
    """The value of a flag that had another name, with a warning where the old one is used.

    Raises:
        ConfigError: If both are given.
    """
    if not old_value:
        return new_value
    if new_value:
        raise ConfigError(f"{old} is the old name of {new}: give one of them")
    print(f"warning: {old} is called {new} now; the old name goes with the next version", file=sys.stderr)
    return old_value


def parse_options(protocol: "Protocol", options: Sequence[str], flags: Sequence[str]) -> dict[str, Any]:
    """Turn ``name=value`` words into settings: numbers, comma lists and ``a:b`` pairs as the setting asks.

    Args:
        protocol: Whose settings.
        options: The words.
        flags: Settings that have a flag of their own.

    Raises:
        ConfigError: If a word is none of these, or a setting has a flag of its own.
    """
    from farfield.metrics.options import read_option

    parsed: dict[str, Any] = {}
    for option in options:
        name, equals, text = option.partition("=")
        if not equals or name in parsed:
            raise ConfigError(f"--options: expected each name=value once, got {option!r}")
        if name in flags:
            raise ConfigError(f"--options: {name} has a flag of its own")
        parsed[name] = read_option(protocol.Settings, name, text)
    return parsed
