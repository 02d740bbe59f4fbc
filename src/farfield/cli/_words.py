"""Words of the command line into values."""

import sys

from farfield.errors import ConfigError


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
