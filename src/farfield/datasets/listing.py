"""Folders listed once for many questions: each format asks whether a folder holds files of its patterns."""

import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from fnmatch import translate
from functools import lru_cache
from os import DirEntry, scandir
from pathlib import Path
from typing import Any

_WILD = re.compile(r"[*?\[]")
_SUFFIX = re.compile(r"\.(?:[a-z0-9]|\[([a-z])[A-Z]\])+$")


class _Listing:
    """The entries of a folder by name, and their names by suffix."""

    def __init__(self, folder: str) -> None:
        self.entries: dict[str, DirEntry[str]] = {}
        try:
            with scandir(folder or ".") as entries:
                self.entries = {entry.name: entry for entry in entries}
        except OSError:  # no folder, or not to be read: nothing in it is recognised
            pass
        self.of_suffix: dict[str, list[str]] = {}
        for name in self.entries:
            self.of_suffix.setdefault(name[name.rfind(".") :].lower() if "." in name else "", []).append(name)
        self._matches: dict[str, list[str]] = {}

    def matches(self, pattern: str) -> list[str]:
        """Names of a pattern, in the folder's order."""
        if pattern not in self._matches:
            suffix = _suffix_of(pattern)
            names = self.entries if suffix is None else self.of_suffix.get(suffix, ())
            fits = _compiled(pattern)
            self._matches[pattern] = [name for name in names if fits(name)]
        return self._matches[pattern]


@lru_cache(maxsize=512)
def _compiled(pattern: str) -> Any:
    return re.compile(translate(pattern), re.IGNORECASE if sys.platform == "win32" else 0).match


@lru_cache(maxsize=512)
def _suffix_of(pattern: str) -> str | None:
    """The suffix that a pattern demands, in lower case; None where it demands none."""
    match = _SUFFIX.search(pattern)
    return None if match is None else re.sub(r"[\[\]A-Z]", "", match[0])


_LISTINGS: ContextVar[dict[str, _Listing] | None] = ContextVar("listings", default=None)


@contextmanager
def listed_once() -> Iterator[None]:
    """Within it :class:`ListedPath` lists no folder twice; what changes on the disk meanwhile is not noticed."""
    if _LISTINGS.get() is not None:
        yield
        return
    token = _LISTINGS.set({})
    try:
        yield
    finally:
        _LISTINGS.reset(token)


class ListedPath(type(Path())):  # type: ignore[misc]  # the class of this system's paths
    """A path that lists a folder once within :func:`listed_once`, and is a plain one outside."""

    def _listing(self, *, make: bool) -> _Listing | None:
        listings = _LISTINGS.get()
        if listings is None:
            return None
        folder = str(self)
        if make and folder not in listings:
            listings[folder] = _Listing(folder)
        return listings.get(folder)

    def glob(self, pattern: Any, **options: Any) -> Iterator[Any]:
        """Paths of a pattern, as :meth:`pathlib.Path.glob` gives them."""
        if options or "**" in str(pattern) or self._listing(make=True) is None:
            yield from super().glob(pattern, **options)
            return
        yield from _globbed(self, str(pattern).split("/"))

    def iterdir(self) -> Iterator[Any]:
        """The folder's entries."""
        listing = self._listing(make=True)
        if listing is None or not listing.entries:  # nothing is listed of what is no folder: that one's error
            yield from super().iterdir()
            return
        for name in listing.entries:
            yield self / name

    def _entry(self) -> DirEntry[str] | None:
        listing = None if _LISTINGS.get() is None else self.parent._listing(make=False)
        return None if listing is None else listing.entries.get(self.name)

    def is_dir(self, **options: Any) -> bool:
        """Whether it is a folder, or a link to one."""
        entry = None if options else self._entry()
        return super().is_dir(**options) if entry is None else _or_no(entry.is_dir)

    def is_file(self, **options: Any) -> bool:
        """Whether it is a file, or a link to one."""
        entry = None if options else self._entry()
        return super().is_file(**options) if entry is None else _or_no(entry.is_file)


def _or_no(question: Any) -> bool:
    try:
        return bool(question())
    except OSError:  # a link in a circle
        return False


def _globbed(folder: ListedPath, parts: list[str]) -> Iterator[ListedPath]:
    part, rest = parts[0], parts[1:]
    if not _WILD.search(part):
        child = folder / part
        if rest:
            if child.is_dir():
                yield from _globbed(child, rest)
        elif child.exists():
            yield child
        return
    listing = folder._listing(make=True)
    for name in () if listing is None else listing.matches(part):
        child = folder / name
        if not rest:
            yield child
        elif child.is_dir():
            yield from _globbed(child, rest)
