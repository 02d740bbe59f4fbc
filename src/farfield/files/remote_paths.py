"""URLs of object stores and web servers as paths: readers open what they name, and nothing else is fetched.

A :class:`RemotePath` is a :class:`pathlib.Path` that only reads. It lists folders as the store does; the file behind it
comes into the cache of this machine (:mod:`farfield.files.remote_cache`) when it is opened, by Python or by a library.
"""

import errno
import fnmatch
import hashlib
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import unquote, urlsplit

from farfield.errors import ConfigError
from farfield.files.remote_cache import fetched
from farfield.files.remote_stores import RemoteEntry, as_status, find_store, is_url, parted

_LISTED = 4096  # folders that are remembered
_FOLDER = RemoteEntry(is_folder=True)


def as_path(path: Path | str) -> Path:
    """A path as it is, or a text as a path: of this machine, or of a store where it is a URL.

    >>> as_path("s3://bucket/drives/7.bin").name, as_path("file:///data/7.bin")
    ('7.bin', PosixPath('/data/7.bin'))
    """
    if isinstance(path, RemotePath):
        return path
    text = str(path)
    if text.startswith("file:/"):
        return Path(unquote(urlsplit(text).path))
    if is_url(text):
        parted(text)
        return RemotePath(text)
    return Path(path)


_listings: dict[str, dict[str, RemoteEntry]] = {}
"""Folders that were listed, by their URLs."""
_alone: dict[str, RemoteEntry | None] = {}
"""What was asked for by itself, since no folder above it was listed."""


def list_anew() -> None:
    """Forget what stores were listed to hold: a data set that is opened is listed as it is now."""
    _listings.clear()
    _alone.clear()


def _entries(url: str) -> dict[str, RemoteEntry]:
    if url not in _listings:
        scheme, bucket, key = parted(url)
        if len(_listings) >= _LISTED:
            _listings.pop(next(iter(_listings)))
        _listings[url] = find_store(scheme, bucket).entries(key)
    return _listings[url]


def _entry_alone(url: str) -> RemoteEntry | None:
    if url not in _alone:
        scheme, bucket, key = parted(url)
        entry = find_store(scheme, bucket).entry(key) if key else None
        _alone[url] = _FOLDER if entry is None and _entries(url) else entry
    return _alone[url]


class RemotePath(type(Path())):  # type: ignore[misc]  # the class of this system's paths
    """A file or folder of a store, named by its URL; it is read, never written."""

    def __str__(self) -> str:
        text: str = super().__str__()
        scheme, colon, rest = text.partition(":")
        return f"{scheme}://{rest.lstrip('/')}" if colon and is_url(text) else text

    def __fspath__(self) -> str:
        """The file's name in the cache of this machine, into which it is fetched.

        Raises:
            FileNotFoundError: If the store has no such file.
        """
        if not is_url(str(self)):  # a part of a path, such as relative_to gives
            return str(self)
        entry = self._entry()
        if entry is None or entry.is_folder:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(self))
        return os.fspath(fetched(str(self), entry))

    def __bytes__(self) -> bytes:
        return os.fsencode(str(self))

    def as_posix(self) -> str:
        """The URL."""
        return str(self)

    def as_uri(self) -> str:
        """The URL."""
        return str(self)

    def is_absolute(self) -> bool:
        """Always: no folder of this machine is above it."""
        return True

    def _entry(self) -> RemoteEntry | None:
        """What the store says of it; a folder that is listed already is asked rather than the store."""
        url, folder = str(self), self.parent
        if str(folder) not in _listings:
            if not any(str(above) in _listings for above in folder.parents):
                return _entry_alone(url)
            above = folder._entry()
            if above is None or not above.is_folder:
                return None
        entry = _entries(str(folder)).get(self.name)
        if entry is not None and not entry.is_folder and entry.size < 0:  # a page of links says no sizes
            return _entry_alone(url)
        return entry

    def stat(self, **_options: Any) -> os.stat_result:
        """Size, time and kind as the store says.

        Raises:
            FileNotFoundError: If it has no such thing.
        """
        entry = self._entry()
        if entry is None:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(self))
        return as_status(entry)

    def lstat(self) -> os.stat_result:
        """As :meth:`stat`: stores have no links."""
        return self.stat()

    def exists(self, **_options: Any) -> bool:
        """Whether the store has it."""
        return self._entry() is not None

    def is_file(self, **_options: Any) -> bool:
        """Whether it is a file."""
        entry = self._entry()
        return entry is not None and not entry.is_folder

    def is_dir(self, **_options: Any) -> bool:
        """Whether it is a folder: one that holds something."""
        entry = self._entry()
        return entry is not None and entry.is_folder

    def is_symlink(self) -> bool:
        """Never."""
        return False

    def iterdir(self) -> Iterator[Any]:
        """What the folder holds.

        Raises:
            FileNotFoundError: If there is no such folder.
        """
        entries = _entries(str(self))
        if not entries:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(self))
        for name in entries:
            yield self / name

    def glob(self, pattern: Any, **_options: Any) -> Iterator[Any]:
        """Paths of a pattern, as :meth:`pathlib.Path.glob` gives them."""
        yield from _globbed(self, str(pattern).rstrip("/").split("/"))

    def rglob(self, pattern: Any, **_options: Any) -> Iterator[Any]:
        """Paths of a pattern anywhere below."""
        yield from _globbed(self, ["**", *str(pattern).rstrip("/").split("/")])

    def walk(self, *_options: Any, **_named: Any) -> Iterator[tuple[Any, list[str], list[str]]]:
        """Folders from here downwards, with the names of their folders and files."""
        entries = _entries(str(self))
        folders = [name for name, entry in entries.items() if entry.is_folder]
        yield self, folders, [name for name, entry in entries.items() if not entry.is_folder]
        for name in folders:
            yield from (self / name).walk()

    def resolve(self, **_options: Any) -> "RemotePath":
        """Itself."""
        return self

    def absolute(self) -> "RemotePath":
        """Itself."""
        return self

    def expanduser(self) -> "RemotePath":
        """Itself."""
        return self

    def open(self, mode: str = "r", *options: Any, **named: Any) -> Any:
        """Open the file for reading; see :func:`open`.

        Raises:
            OSError: If it is to be written.
        """
        if set(mode) & set("wax+"):
            self._refuse()
        return Path(os.fspath(self)).open(mode, *options, **named)

    def samefile(self, other: Any) -> bool:
        """Whether another path has the same URL."""
        return str(self) == str(other)

    def _refuse(self, *_arguments: Any, **_named: Any) -> NoReturn:
        raise OSError(errno.EROFS, "expected a folder of this machine to write into", str(self))

    mkdir = unlink = rmdir = touch = rename = replace = chmod = symlink_to = hardlink_to = _refuse
    write_bytes = write_text = _refuse


def local_folder(path: Path) -> Path:
    """A folder, or a file, for a library that opens it by itself: a remote one's files are fetched, all, into one.

    Folders within it are left out.
    """
    if not isinstance(path, RemotePath):
        return path
    if path.is_file():
        return Path(os.fspath(path))
    files = {name: entry for name, entry in _entries(str(path)).items() if not entry.is_folder}
    beside = "\n".join([str(path), *(f"{name} {entry.size} {entry.tag}" for name, entry in sorted(files.items()))])
    folders = {fetched(str(path / name), entry, beside=beside).parent for name, entry in files.items()}
    return folders.pop() if folders else Path(str(path))


def checked_file(url: str) -> Path:
    """A file of weights from a store on this machine, if it is the one whose sum of bytes stands behind its URL.

    Args:
        url: ``https://host/x.safetensors#sha256=...``, with 64 hexadecimal digits.

    Raises:
        ConfigError: If the sum is missing or another one.
        FileNotFoundError: If the store has no such file.
    """
    address, mark, digest = url.partition("#sha256=")
    if not mark or not re.fullmatch("[0-9a-f]{64}", digest.lower()):
        raise ConfigError(
            f"{address}: expected the sum of its bytes behind it, #sha256= and 64 digits (sha256sum FILE)"
        )
    path = Path(os.fspath(as_path(address)))
    with path.open("rb") as handle:
        actual = hashlib.file_digest(handle, "sha256").hexdigest()
    if actual != digest.lower():
        raise ConfigError(f"{address}: expected a file of sha256 {digest.lower()}, got {actual}")
    return path


def _globbed(folder: Path, parts: list[str]) -> Iterator[Path]:
    part, rest = parts[0], parts[1:]
    if part == "**":
        folders = [path for path, _, _ in folder.walk()]  # type: ignore[attr-defined]
        for one in folders:
            if rest:
                yield from _globbed(one, rest)
            else:
                yield one
        return
    if not set(part) & set("*?["):
        child = folder / part
        if child.is_dir() if rest else child.exists():
            if rest:
                yield from _globbed(child, rest)
            else:
                yield child
        return
    for name, entry in _entries(str(folder)).items():
        if fnmatch.fnmatchcase(name, part):
            if not rest:
                yield folder / name
            elif entry.is_folder:
                yield from _globbed(folder / name, rest)
