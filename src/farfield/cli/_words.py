"""Words of the command line into values."""

import sys

from farfield.errors import ConfigError


def numbers(flag: str, text: str) -> tuple[float, ...]:
    """Comma-separated numbers.

    Raises:
        ConfigError: If a word is none.
    """
    try:
        return tuple(float(word) for word in text.split(","))
    except ValueError:
        raise ConfigError(f"{flag}: expected comma-separated numbers, got {text!r}") from None


def names(text: str) -> list[str]:
    """Comma-separated names; none for an empty text."""
    return [word.strip() for word in text.split(",") if word.strip()]


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
