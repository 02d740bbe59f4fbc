"""Object stores and web servers by their URLs: what a folder holds, one file in, one file out.

``s3``, ``gs`` and ``az`` are spoken to through obstore, ``http``, ``https`` and ``memory`` through fsspec; both come
with the extra ``remote``. What a store says is taken for what it is: foreign names, sizes and contents.
"""

import errno
import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime, timedelta
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, Protocol, runtime_checkable
from urllib.parse import quote, unquote

from farfield.errors import FarfieldError, MissingExtraError, plain

SCHEMES = ("s3", "gs", "az", "http", "https", "memory")
"""How the URLs begin that name data elsewhere."""
UNFINISHED = ".farfield-upload"
"""The object that stands in a folder while it is being uploaded."""

_URL = re.compile(rf"({'|'.join(SCHEMES)}):/{{1,2}}([^/].*)?", re.DOTALL)
_RETRIES, _PATIENCE = 5, timedelta(seconds=60)
_CHUNK_BYTES = 4 << 20
_HELPS = {
    "s3": "Set AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY and AWS_REGION; AWS_SKIP_SIGNATURE=true reads public buckets; "
    "AWS_ENDPOINT_URL names another server than Amazon's, AWS_ALLOW_HTTP=true allows one without TLS.",
    "gs": "Set GOOGLE_APPLICATION_CREDENTIALS to a service account's file; GOOGLE_SKIP_SIGNATURE=true reads public "
    "buckets.",
    "az": "Set AZURE_STORAGE_ACCOUNT_NAME and AZURE_STORAGE_ACCOUNT_KEY (or AZURE_STORAGE_SAS_TOKEN).",
    "http": "See that the server is up and lists its folders as a page of links.",
    "https": "See that the server is up and lists its folders as a page of links.",
    "memory": "What lies in memory is seen by one process: --workers 1.",
}


class RemoteError(FarfieldError):
    """A store cannot be reached, refuses, or gives other bytes than it promised.

    No :class:`OSError`: code that takes one for "no such file" must not take a cut connection for it.
    """


class RemoteEntry(NamedTuple):
    """What a store says of a file or folder; the size in bytes, seconds since 1970, and a tag of the contents."""

    is_folder: bool
    size: int = 0
    time: float = 0.0
    tag: str = ""


@runtime_checkable
class RemoteStore(Protocol):
    """A bucket, a container or a server; keys are paths below it, without a slash at either end."""

    def entries(self, key: str) -> dict[str, RemoteEntry]:
        """Names in a folder, empty where there is none."""

    def entry(self, key: str) -> RemoteEntry | None:
        """A file, or None where there is none."""

    def fetch(self, key: str, tag: str, handle: BinaryIO) -> None:
        """Write the bytes of a file into an open one; where the store can, only if they have the tag."""

    def put(self, key: str, path: Path) -> None:
        """Store a file, all or nothing."""

    def remove(self, key: str) -> None:
        """Remove a file; nothing where there is none."""


def is_url(text: str) -> bool:
    """Whether a text names something in a store; a URL of which :class:`~pathlib.Path` took a slash does too."""
    return _URL.fullmatch(text) is not None


def parted(url: str) -> tuple[str, str, str]:
    """Scheme, bucket or host, and key of a URL.

    Raises:
        RemoteError: If it is none, names no bucket, holds a password or a query, or leads upwards.

    >>> parted("s3:/bucket/drives/7.bin")
    ('s3', 'bucket', 'drives/7.bin')
    """
    match = _URL.fullmatch(url)
    if match is None:
        raise RemoteError(f"{url}: expected a URL of {', '.join(SCHEMES)}")
    bucket, _, key = (match[2] or "").partition("/")
    key = key.strip("/")
    if not bucket or "@" in bucket:
        got = "none" if not bucket else "a name or password"
        raise RemoteError(f"{match[1]}://: expected a bucket or host alone after it, got {got}. {_HELPS[match[1]]}")
    if any(part in ("", ".", "..") for part in key.split("/")[: None if key else 0]) or set("?\0") & set(key):
        raise RemoteError(f"{url}: expected a plain path, without empty parts, '..' and '?'")
    return match[1], bucket, key


@lru_cache(maxsize=64)
def find_store(scheme: str, bucket: str) -> RemoteStore:
    """The store of a URL's first two parts.

    Raises:
        MissingExtraError: If the extra ``remote`` is not installed.
        RemoteError: If its settings are none.
    """
    try:
        with url_in_errors(f"{scheme}://{bucket}"):
            return _ObjectStore(scheme, bucket) if scheme in ("s3", "gs", "az") else _FileSystem(scheme, bucket)
    except ImportError as error:
        raise MissingExtraError("fsspec" if scheme in SCHEMES[3:] else "obstore", "remote", f"{scheme}://") from error


def may_be_copied() -> bool:
    """Whether a copy of this process (fork) could go on: none can that reads a store, whose threads a copy lacks."""
    return find_store.cache_info().currsize == 0


@contextmanager
def url_in_errors(url: str) -> Iterator[None]:
    """Turn what libraries raise in the block into an error that names the URL and what may help.

    Raises:
        FileNotFoundError: If there is no such thing.
        RemoteError: For everything else.
    """
    try:
        yield
    except (FarfieldError, ImportError):
        raise
    except Exception as error:
        cause = error.__cause__ if isinstance(error, FileNotFoundError) else error  # fsspec's, of cut connections too
        if cause is None or getattr(cause, "status", 0) == 404:
            raise
        error = cause if isinstance(cause, Exception) else error
        if type(error).__name__ == "NotFoundError":
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), url) from error
        scheme = url.partition(":")[0]
        raise RemoteError(f"{url}: expected an answer of the store, got: {_words(error)}. {_HELPS[scheme]}") from error


def _words(error: Exception) -> str:
    """The first lines of what a library says, without its programmer's part and without a body in XML."""
    text = str(error).partition("Debug source:")[0].partition("<?xml")[0]
    code = re.search(r"<Code>(\w+)</Code>", str(error))
    words = " ".join(text.split())[:300].rstrip(" .:") or plain(error)
    return f"{words} ({code[1]})" if code else words


def _checked(name: str, url: str) -> str:
    """A name of a store's list, if it is one that a folder can hold.

    Raises:
        RemoteError: If it is none.
    """
    if name in ("", ".", "..") or "/" in name or "\0" in name:
        raise RemoteError(f"{url}: expected names that a folder can hold, got {name[:80]!r}")
    return name


class _ObjectStore:
    """S3, Google Cloud Storage or Azure, through obstore; settings come from the environment."""

    def __init__(self, scheme: str, bucket: str) -> None:
        import obstore
        from obstore.store import from_url

        settings: Any = {"max_retries": _RETRIES, "retry_timeout": _PATIENCE}
        self.obstore: Any = obstore
        self.process = os.getpid()
        self.store: Any = from_url(f"{scheme}://{bucket}", retry_config=settings)
        self.url = f"{scheme}://{bucket}"

    @contextmanager
    def _request(self, key: str) -> Iterator[None]:
        """Of a request; in the copy of a process, which has none of obstore's threads, it would wait for ever."""
        url = f"{self.url}/{key}"
        if os.getpid() != self.process:
            raise RemoteError(
                f"{url}: expected a new process, got a copy of one that reads the store already. Start workers by "
                "spawn: DataLoader(..., multiprocessing_context='spawn')."
            )
        with url_in_errors(url):
            yield

    def entries(self, key: str) -> dict[str, RemoteEntry]:
        with self._request(key):
            listing = self.obstore.list_with_delimiter(self.store, f"{key}/" if key else None)
        entries = {prefix.rpartition("/")[2]: RemoteEntry(is_folder=True) for prefix in listing["common_prefixes"]}
        for item in listing["objects"]:
            if item["path"] != key:  # an empty object that stands for the folder
                entries[item["path"].rpartition("/")[2]] = _of_object(item)
        return {_checked(name, f"{self.url}/{key}"): entry for name, entry in entries.items()}

    def entry(self, key: str) -> RemoteEntry | None:
        try:
            with self._request(key):
                return _of_object(self.obstore.head(self.store, key))
        except FileNotFoundError:
            return None

    def fetch(self, key: str, tag: str, handle: BinaryIO) -> None:
        with self._request(key):
            answer = self.obstore.get(self.store, key, options={"if_match": tag} if tag else {})
            for chunk in answer.stream(min_chunk_size=_CHUNK_BYTES):
                handle.write(chunk)

    def put(self, key: str, path: Path) -> None:
        with self._request(key):
            self.obstore.put(self.store, key, path)

    def remove(self, key: str) -> None:
        with self._request(key):
            self.obstore.delete(self.store, key)


def _of_object(item: Any) -> RemoteEntry:
    return RemoteEntry(False, int(item["size"]), item["last_modified"].timestamp(), item["e_tag"] or "")


class _FileSystem:
    """A web server, or this process's memory, through fsspec."""

    def __init__(self, scheme: str, bucket: str) -> None:
        import fsspec

        self.system: Any = fsspec.filesystem(scheme)
        self.url = f"{scheme}://{bucket}"
        self.is_web = scheme != "memory"

    def _named(self, key: str) -> str:
        return f"{self.url}/{quote(key) if self.is_web else key}" if key else self.url

    def entries(self, key: str) -> dict[str, RemoteEntry]:
        url = self._named(key)
        try:
            with url_in_errors(url):
                if self.is_web and not str(self.system.info(f"{url}/").get("mimetype", "")).startswith("text/html"):
                    return {}  # no page of links: it is not read whole to see that
                listing = self.system.ls(f"{url}/" if self.is_web else url, detail=True)
        except (FileNotFoundError, NotADirectoryError):
            return {}
        entries = {}
        for item in listing:
            name = str(item["name"]).rstrip("/").rpartition("/")[2]
            name = unquote(name) if self.is_web else name
            if name and not (self.is_web and item["name"].rstrip("/") in (url, self.url)):
                entries[_checked(name, url)] = self._of_item(item)
        return {} if not self.is_web and list(entries) == [key.rpartition("/")[2]] and self.entry(key) else entries

    def _of_item(self, item: dict[str, Any]) -> RemoteEntry:
        is_folder = item["type"] == "directory" or (self.is_web and item["name"].endswith("/"))
        time = item.get("created")
        seconds = time.timestamp() if isinstance(time, datetime) else 0.0
        size = item.get("size")
        tag = str(item.get("ETag") or item.get("Last-Modified") or seconds or "")
        return RemoteEntry(is_folder, -1 if size is None else int(size), seconds, tag)

    def entry(self, key: str) -> RemoteEntry | None:
        url = self._named(key)
        try:
            with url_in_errors(url):
                item = self.system.info(url)
        except FileNotFoundError:
            return None
        entry = self._of_item(item)
        is_page = self.is_web and str(item.get("mimetype", "")).startswith("text/html")
        return None if entry.is_folder or is_page else entry

    def fetch(self, key: str, tag: str, handle: BinaryIO) -> None:  # noqa: ARG002 - a later look compares tags
        url = self._named(key)
        with url_in_errors(url), self.system.open(url, "rb", block_size=_CHUNK_BYTES) as source:
            while chunk := source.read(_CHUNK_BYTES):
                handle.write(chunk)

    def put(self, key: str, path: Path) -> None:
        self._refuse_web()
        with url_in_errors(self._named(key)):
            self.system.pipe_file(self._named(key), path.read_bytes())

    def remove(self, key: str) -> None:
        self._refuse_web()
        with url_in_errors(self._named(key)):
            if self.system.exists(self._named(key)):
                self.system.rm_file(self._named(key))

    def _refuse_web(self) -> None:
        if self.is_web:
            raise RemoteError(f"{self.url}: expected s3, gs or az to write to, got a web server")


def as_status(entry: RemoteEntry) -> os.stat_result:
    """What :meth:`pathlib.Path.stat` would say of it."""
    nanoseconds = round(entry.time * 1e9)
    mode = stat.S_IFDIR | 0o555 if entry.is_folder else stat.S_IFREG | 0o444
    seconds = (int(entry.time),) * 3
    times = {
        f"st_{kind}time{unit}": value for kind in "amc" for unit, value in (("", entry.time), ("_ns", nanoseconds))
    }
    return os.stat_result((mode, 0, 0, 1, 0, 0, max(entry.size, 0), *seconds), times)
