"""Files that were made and wait to be fetched, in a folder that goes when the studio ends."""

import itertools
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

from farfield.errors import ConfigError

_PNG = b"\x89PNG\r\n\x1a\n"
_MOST_BYTES = 1 << 30
_KINDS = {
    ".png": "image/png",
    ".gif": "image/gif",
    ".webp": "image/webp",
    ".html": "text/html; charset=utf-8",
    ".csv": "text/csv; charset=utf-8",
    ".zip": "application/zip",
    ".json": "application/json",
}


@dataclass(frozen=True)
class ExportedFile:
    """A file to fetch.

    Args:
        path: Where it stands.
        name: What the browser calls it.
        kind: Media type.
    """

    path: Path
    name: str
    kind: str


class Exports:
    """Pictures that the page sent, and what was made."""

    def __init__(self) -> None:
        self._folder: Path | None = None
        self._made: dict[str, ExportedFile] = {}
        self._numbers = itertools.count(1)
        self._bytes = 0

    @property
    def folder(self) -> Path:
        """The folder, made when it is first needed."""
        if self._folder is None:
            self._folder = Path(tempfile.mkdtemp(prefix="farfield-studio-"))
        return self._folder

    def keep(self, png: bytes) -> str:
        """Keep a picture that the page sent; gives its name.

        Raises:
            ConfigError: If it is no PNG, or too much is kept already.
        """
        if not png.startswith(_PNG):
            raise ConfigError("shot: expected a PNG image")
        if self._bytes + len(png) > _MOST_BYTES:
            raise ConfigError(f"shot: {_MOST_BYTES >> 30} GiB of pictures are kept already; restart the studio")
        self._bytes += len(png)
        name = f"shot-{next(self._numbers)}"
        path = self.folder / f"{name}.png"
        path.write_bytes(png)
        self._made[name] = ExportedFile(path, path.name, _KINDS[".png"])
        return name

    def shots(self, names: tuple[str, ...]) -> list[Path]:
        """Files of pictures by name.

        Raises:
            ConfigError: If there is no such picture.
        """
        missing = [name for name in names if name not in self._made or self._made[name].kind != _KINDS[".png"]]
        if missing:
            raise ConfigError(f"export: expected pictures that were sent, got {missing[0]!r}")
        return [self._made[name].path for name in names]

    def new(self, name: str, ending: str) -> tuple[str, ExportedFile]:
        """A place for a file to be made, and its name in links.

        Args:
            name: What the browser is to call it.
            ending: Its ending, such as ``.gif``.
        """
        job = f"export-{next(self._numbers)}"
        called = name if name.lower().endswith(ending) else name + ending
        made = ExportedFile(self.folder / f"{job}{ending}", called, _KINDS[ending])
        self._made[job] = made
        return job, made

    def result(self, job: str) -> ExportedFile | None:
        """A file that was made."""
        found = self._made.get(job)
        return found if found is not None and found.path.is_file() else None

    def close(self) -> None:
        """Remove everything."""
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
