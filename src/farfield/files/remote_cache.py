"""Files of stores on this machine: a cache of bounded size, whose entries are told apart by URL, size and tag.

It lies in ``farfield/remote`` below ``XDG_CACHE_HOME`` or ``~/.cache``. ``FARFIELD_REMOTE_GB`` bounds it (default: 20);
what was not used for longest goes first.
"""

import hashlib
import os
import shutil
import time
from contextlib import suppress
from pathlib import Path

from farfield.errors import ConfigError
from farfield.files.atomic import open_atomic
from farfield.files.remote_stores import RemoteEntry, RemoteError, find_store, parted
from farfield.files.sizes import room, sized
from farfield.vocabulary.counts import count_of

LIMIT = "FARFIELD_REMOTE_GB"
"""The variable that bounds the cache."""
_DEFAULT_GB = 20.0
_IN_USE_S = 60.0  # from when a file is named until it is open


def cache_folder() -> Path:
    """Where fetched files lie, and what waits to be uploaded."""
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")  # noqa: PTH111 - never raises
    return Path(home) / "farfield" / "remote"


def limit_bytes() -> float:
    """How much the cache may hold.

    Raises:
        ConfigError: If the variable is no positive number.
    """
    text = os.environ.get(LIMIT) or str(_DEFAULT_GB)
    try:
        limit = float(text) * 1e9
    except ValueError:
        limit = 0.0
    if not 0 < limit < 1e18:
        raise ConfigError(f"{LIMIT}: expected a number of gigabytes above 0, got {text!r}")
    return limit


def fetched(url: str, entry: RemoteEntry, *, beside: str = "") -> Path:
    """A file of a store on this machine, fetched unless it is in the cache.

    What was fetched counts only with the length and the tag that the store had promised.

    Args:
        url: Its URL.
        entry: What the store's list says of it.
        beside: Names a group of files that are to lie in one folder.

    Raises:
        RemoteError: If it cannot be fetched, changes meanwhile, or does not fit.
    """
    scheme, bucket, key = parted(url)
    identity = beside or "\n".join([url, str(entry.size), entry.tag])
    digest = hashlib.sha256(identity.encode("utf-8", "surrogateescape")).hexdigest()
    path = cache_folder() / "files" / digest[:2] / digest[2:34] / key.rpartition("/")[2]
    if path.is_file():
        os.utime(path)
        return path
    _make_room(max(entry.size, 0), url)
    path.parent.mkdir(parents=True, exist_ok=True)
    store = find_store(scheme, bucket)
    with open_atomic(path) as handle:
        try:
            store.fetch(key, entry.tag, handle)
        except FileNotFoundError as error:  # no OSError: it was there
            raise RemoteError(
                f"{url}: expected the file that was listed, got none: it was removed meanwhile"
            ) from error
        size, after = handle.tell(), store.entry(key)
        lengths = {length for length in (size, entry.size, after.size if after is not None else -2) if length != -1}
        if len(lengths) > 1 or after is None or (entry.tag and after.tag != entry.tag):
            other = "" if len(lengths) > 1 else " of another file by now"
            raise RemoteError(
                f"{url}: expected the file that was listed{f', {entry.size} bytes' if entry.size >= 0 else ''}, got "
                f"{count_of(size, 'byte')}{other}. It was cut off or written meanwhile: run the same command again."
            )
    return path


def _make_room(size: int, url: str) -> None:
    """Remove what was not used for longest until a file fits.

    Raises:
        RemoteError: If it does not.
    """
    folder, limit = cache_folder() / "files", limit_bytes()
    if size > limit:
        raise RemoteError(f"{url}: expected a file that fits into the cache, {room(size, limit)}. Set {LIMIT} higher.")
    folder.mkdir(parents=True, exist_ok=True)
    used = []
    for path in folder.glob("*/*/*"):
        with suppress(OSError):  # another command has just removed it
            status = path.stat()
            used.append((status.st_mtime, status.st_size, path))
    total, now = sum(used_bytes for _, used_bytes, _ in used), time.time()
    free = shutil.disk_usage(folder).free
    for used_at, used_bytes, path in sorted(used):
        if total + size <= limit and size <= free:
            return
        if now - used_at < _IN_USE_S:
            break
        with suppress(OSError):
            path.unlink()
            path.parent.rmdir()
            total, free = total - used_bytes, free + used_bytes
    if size > free:
        raise RemoteError(f"{url}: expected room on the disk of {folder}: {room(size, free)}")
    if total + size > limit:
        raise RemoteError(
            f"{url}: expected room in the cache of {sized(limit)}, got files of {sized(total)} that are in use now. "
            f"Set {LIMIT} higher, or take fewer --workers."
        )
