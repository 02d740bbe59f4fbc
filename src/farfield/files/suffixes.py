"""Suffixes of files in either case: cameras and Windows write ``.JPG``, ``.PCD`` and ``.BIN``."""

from collections.abc import Iterable


def any_case(suffix: str) -> str:
    """A suffix as a glob pattern that matches it in any case.

    >>> any_case(".bin")
    '.[bB][iI][nN]'
    """
    return "".join(f"[{letter.lower()}{letter.upper()}]" if letter.isalpha() else letter for letter in suffix)


def both_cases(suffixes: Iterable[str]) -> tuple[str, ...]:
    """Suffixes as they are, then in upper case.

    >>> both_cases([".png", ".jpg"])
    ('.png', '.jpg', '.PNG', '.JPG')
    """
    lower = tuple(suffixes)
    return (*lower, *(suffix.upper() for suffix in lower))
