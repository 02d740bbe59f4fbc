"""Bookmarks of a data set, kept in the user's data folder: one JSON file a data set."""

import hashlib
import json
import os
from pathlib import Path

from farfield.errors import FileFormatError, plain
from farfield.files.atomic import read_bytes, write_text
from farfield.frame import Key
from farfield.studio.messages.rows import Bookmark

_MAX_BYTES = 16 << 20


def data_folder() -> Path:
    """The user's data folder of Farfield, ``XDG_DATA_HOME/farfield`` or ``~/.local/share/farfield``."""
    given = os.environ.get("XDG_DATA_HOME", "")
    return (Path(given) if given else Path.home() / ".local" / "share") / "farfield"


class BookmarkStore:
    """Frames to come back to.

    Args:
        root: Folder of the data set.
        keys: (sequence, frame) of its frames, by which bookmarks are kept: numbers change as frames are added.
        folder: Where they are kept; the user's data folder unless given.
    """

    def __init__(self, root: Path, keys: tuple[Key, ...], folder: Path | None = None) -> None:
        name = hashlib.blake2b(str(root.resolve()).encode(), digest_size=8).hexdigest()
        self.path = (folder or data_folder() / "bookmarks") / f"{name}.json"
        self._keys = keys
        self._index = {key: index for index, key in enumerate(keys)}
        self._rows: dict[Key, tuple[str, str]] = self._read()

    def _read(self) -> dict[Key, tuple[str, str]]:
        if not self.path.is_file():
            return {}
        try:
            rows = json.loads(read_bytes(self.path, max_bytes=_MAX_BYTES))["bookmarks"]
            return {(str(r["sequence"]), str(r["frame"])): (str(r["note"]), str(r["by"])) for r in rows}
        except (ValueError, KeyError, TypeError) as error:
            expected = "bookmarks"
            raise FileFormatError(self.path, where="the file", expected=expected, found=plain(error)) from error

    def set(self, frame: int, note: str | None, by: str) -> None:
        """Set the bookmark of a frame; None takes it away. Written at once."""
        key = self._keys[frame]
        if note is None:
            self._rows.pop(key, None)
        else:
            self._rows[key] = note, by
        rows = [{"sequence": key[0], "frame": key[1], "note": note, "by": by} for key, (note, by) in self._rows.items()]
        self.path.parent.mkdir(parents=True, exist_ok=True)
        write_text(self.path, json.dumps({"bookmarks": rows}, indent=1) + "\n")

    def rows(self) -> tuple[Bookmark, ...]:
        """The bookmarks of the frames that are there, in their order."""
        found = [(self._index[key], *rest) for key, rest in self._rows.items() if key in self._index]
        return tuple(Bookmark(frame=frame, note=note, by=by) for frame, note, by in sorted(found))
