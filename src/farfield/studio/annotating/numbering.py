"""Names of tracks as numbers, which is how the page knows them."""

import threading

_SPELT = 2**30
"""Tracks whose name is no number get numbers from here on, in the order in which they are met."""


class TrackNumbers:
    """Both ways between a track's name in the label files and its number on the page."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}
        self._names: dict[int, str] = {}
        self._lock = threading.Lock()

    def number(self, name: str) -> int | None:
        """Number of a track; None for none.

        >>> tracks = TrackNumbers()
        >>> tracks.number("17"), tracks.number(""), tracks.name(tracks.number("a9")), tracks.number("007") == 7
        (17, None, 'a9', False)
        """
        if not name:
            return None
        if name.isascii() and name.isdigit() and len(name) < 10 and str(int(name)) == name and int(name) < _SPELT:
            return int(name)
        with self._lock:
            if name not in self._numbers:
                self._numbers[name] = _SPELT + len(self._numbers)
                self._names[self._numbers[name]] = name
            return self._numbers[name]

    def name(self, number: int | None) -> str:
        """Name of a track; empty for none."""
        if number is None:
            return ""
        return self._names.get(number, str(number))
