"""Suffixes of files in either case: cameras and Windows write ``.JPG``, ``.PCD`` and ``.BIN``."""

from pathlib import Path


def any_case(suffix: str) -> str:
    """A suffix as a glob pattern that matches it in any case.

    >>> any_case(".bin")
    '.[bB][iI][nN]'
    """
    return "".join(f"[{letter.lower()}{letter.upper()}]" if letter.isalpha() else letter for letter in suffix)


def existing(path: Path) -> Path | None:
    """A file, its suffix as it is or in upper case; None where there is neither."""
    other = path.with_suffix(path.suffix.upper())
    return path if path.is_file() else other if other.is_file() else None


def pattern_in_any_case(pattern: str) -> str:
    """A glob pattern whose suffix, if it has a plain one, matches in any case.

    >>> pattern_in_any_case("dataset1_camera/*.jpg"), pattern_in_any_case("lidar/*")
    ('dataset1_camera/*.[jJ][pP][gG]', 'lidar/*')
    """
    stem, dot, suffix = pattern.rpartition(".")
    return stem + any_case(dot + suffix) if dot and suffix.isalnum() else pattern
