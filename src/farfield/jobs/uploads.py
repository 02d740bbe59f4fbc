"""What a command writes for a store: made in a folder of this machine, and uploaded when it is whole."""

import hashlib
import json
import re
import shutil
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from farfield.files.atomic import readable, write_text
from farfield.files.json_text import plain_json
from farfield.files.remote_cache import cache_folder
from farfield.files.remote_paths import RemotePath, as_path, list_anew
from farfield.files.remote_stores import UNFINISHED, RemoteError, RemoteStore, find_store, parted
from farfield.jobs.folders import held

_PARTIAL = re.compile(r"\..*\.(part|lock)")
_AT_A_TIME, _WRITTEN_EVERY_S = 8, 2.0
Bar = Callable[[Iterable[Any], str], Iterable[Any]]


@contextmanager
def uploaded(url: str, *, bar: Bar | None = None) -> Iterator[Path]:
    """A path of this machine for an output; when the block ends without an error, what stands there is uploaded.

    A folder's files become visible one by one, each whole; until the last is there, an object says that the folder is
    unfinished, and :func:`farfield.open_dataset` refuses it. What was made stays on this machine until all is uploaded,
    so that the same command goes on after an error; what the store has already, is fetched first where this machine has
    nothing.

    Args:
        url: File or folder of a store that can be written.
        bar: Wraps the files, to show how far it is.

    Yields:
        The path: a folder or a file may be written there.

    Raises:
        RemoteError: If the store cannot be reached or refuses.
    """
    scheme, bucket, key = parted(url)
    store = find_store(scheme, bucket)
    folder = cache_folder() / "outputs" / hashlib.sha256(url.encode("utf-8", "surrogateescape")).hexdigest()[:32]
    path = folder / "made" / (key.rpartition("/")[2] or bucket)
    with held(folder):
        journal = _Journal(folder / "uploads.json")
        if not path.parent.exists():
            path.parent.mkdir(parents=True)
            _fetch_existing(url, path, journal, bar)
        yield path
        _upload(store, key, path, journal, bar)
        shutil.rmtree(path.parent)
        journal.path.unlink(missing_ok=True)
    list_anew()


class _Journal:
    """Which files the store has as they are here: their marks, by their names."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.marks: dict[str, str] = {}
        self.written_at = 0.0
        if path.is_file():
            tree = plain_json(path.read_bytes())
            self.marks = {str(name): str(mark) for name, mark in tree.items()} if isinstance(tree, dict) else {}

    def write(self) -> None:
        write_text(self.path, json.dumps(self.marks))
        self.written_at = time.monotonic()

    def write_now_and_then(self) -> None:
        if time.monotonic() - self.written_at > _WRITTEN_EVERY_S:
            self.write()

    @contextmanager
    def kept_up(self) -> Iterator[None]:
        """Write it at the end of the block, however that ends."""
        try:
            yield
        finally:
            self.write()


def _mark(path: Path) -> str:
    """Size and time of a file: it is not uploaded again while they stay."""
    status = path.stat()
    return f"{status.st_size} {status.st_mtime_ns}"


def _files(path: Path) -> dict[str, Path]:
    """What is uploaded, by its names below the output: files, but no locks and no unfinished ones."""
    if path.is_file():
        return {"": path}
    files = sorted(file for file in path.rglob("*") if file.is_file() and not _PARTIAL.fullmatch(file.name))
    return {file.relative_to(path).as_posix(): file for file in files if not file.is_symlink()}


def _fetch_existing(url: str, path: Path, journal: _Journal, bar: Bar | None) -> None:
    """Bring here what an earlier command uploaded, with its own journals: it is gone on with."""
    list_anew()
    root = as_path(url)
    if not isinstance(root, RemotePath) or not root.exists():
        return
    files = [root] if root.is_file() else [file for file in root.rglob("*") if file.is_file()]
    for file in bar(files, "fetching what is there") if bar else files:
        name = "" if file == root else file.relative_to(root).as_posix()
        if name == UNFINISHED:
            continue
        target = path / name if name else path
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file.__fspath__(), target)
        journal.marks[name] = _mark(target)
    journal.write()


def _upload(store: RemoteStore, key: str, path: Path, journal: _Journal, bar: Bar | None) -> None:
    files = _files(path)
    gone = [name for name in journal.marks if name not in files]
    new = [name for name, file in files.items() if journal.marks.get(name) != _mark(file)]
    marker, unfinished = path.parent / UNFINISHED, "" not in files and bool(new or gone)
    if unfinished:
        write_text(marker, "This folder is being uploaded. It is whole when this object is gone.\n")
        store.put(_key(key, UNFINISHED), marker)
    with journal.kept_up(), ThreadPoolExecutor(_AT_A_TIME) as pool:
        tasks = {name: pool.submit(_put, store, _key(key, name), files[name]) for name in new}
        try:
            for name in bar(new, "uploading") if bar else new:
                journal.marks[name] = tasks[name].result()
                journal.write_now_and_then()
        finally:
            pool.shutdown(cancel_futures=True)
    for name in gone:
        store.remove(_key(key, name))
        del journal.marks[name]
    if unfinished:
        store.remove(_key(key, UNFINISHED))
        marker.unlink()


def _key(key: str, name: str) -> str:
    return f"{key}/{name}".strip("/")


def _put(store: RemoteStore, key: str, file: Path) -> str:
    """Upload a file and see that the store has its length; its mark, as it was before.

    Raises:
        RemoteError: If it has not, or its name is none for a URL.
    """
    if readable(key) != key:
        raise RemoteError(f"{readable(key)}: expected a name in UTF-8 to upload")
    mark, size = _mark(file), file.stat().st_size
    store.put(key, file)
    entry = store.entry(key)
    if entry is None or entry.size != size:
        got = "none" if entry is None else f"{entry.size} bytes"
        raise RemoteError(f"{key}: expected {size} bytes after the upload, got {got}")
    return mark
