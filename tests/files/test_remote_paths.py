"""Paths of object stores: read as pathlib reads, fetched when opened, never written."""

import functools
import hashlib
import http.server
import os
import pickle
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from farfield.errors import ConfigError, FarfieldError, FileFormatError, MissingExtraError
from farfield.files import remote_cache, remote_stores
from farfield.files.atomic import open_atomic, read_bytes
from farfield.files.remote_paths import RemotePath, as_path, checked_file, list_anew, local_folder
from farfield.files.remote_stores import RemoteError, is_url, parted

fsspec = pytest.importorskip("fsspec")


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    list_anew()
    return tmp_path / "cache/farfield/remote/files"


@pytest.fixture
def memory() -> Iterator[object]:
    system = fsspec.filesystem("memory")
    system.store.clear()
    system.pseudo_dirs.clear()
    system.pipe_file("/bucket/drives/1/a.bin", bytes(range(8)))
    system.pipe_file("/bucket/drives/1/b.txt", b"one\ntwo\n")
    system.pipe_file("/bucket/drives/2/deep/c.txt", b"three")
    yield system
    system.store.clear()


@pytest.mark.parametrize("text", ["s3://b/x", "s3:/b/x", "https://host/x", "memory://b", "gs://b/x", "az://b/x"])
def test_a_url_is_one_with_either_number_of_slashes(text: str) -> None:
    assert is_url(text)
    assert str(as_path(text)) == text.replace(":/", "://").replace(":///", "://")


@pytest.mark.parametrize("text", ["s3", "data/s3:/b", "C:/data", "/s3:/b/x", "ftp://b/x", "s3:b"])
def test_other_texts_are_paths_of_this_machine(text: str) -> None:
    assert not is_url(text)
    assert type(as_path(text)) is type(Path())


def test_a_file_url_is_a_path_of_this_machine() -> None:
    assert as_path("file:///data/with%20blank") == Path("/data/with blank")


@pytest.mark.parametrize(
    "text", ["s3://", "s3://user:word@b/x", "s3://b/a/../x", "s3://b/a//x", "s3://b/./x", "https://h/x?y", "s3://b/\0"]
)
def test_urls_that_lead_elsewhere_are_refused_without_telling_a_password(text: str) -> None:
    with pytest.raises(RemoteError) as error:
        parted(text)
    assert "word" not in str(error.value).replace("password", "")


def test_it_lists_and_reads_as_a_folder_does(memory: object, tmp_path: Path) -> None:
    local = tmp_path / "drives"
    for name, data in {"1/a.bin": bytes(range(8)), "1/b.txt": b"one\ntwo\n", "2/deep/c.txt": b"three"}.items():
        (local / name).parent.mkdir(parents=True, exist_ok=True)
        (local / name).write_bytes(data)
    remote = as_path("memory://bucket/drives")
    for pattern in ("*", "*/*.bin", "**/*.txt", "2/deep", "no", "1/*.[bt]*", "*/deep/*"):
        assert sorted(p.relative_to(remote).as_posix() for p in remote.glob(pattern)) == sorted(
            p.relative_to(local).as_posix() for p in local.glob(pattern)
        )
    assert sorted(p.name for p in remote.rglob("*.txt")) == ["b.txt", "c.txt"]
    for name in ("", "1", "1/a.bin", "2/deep", "1/no", "no/no", "1/a.bin/below"):
        theirs, ours = remote / name, local / name
        assert (theirs.exists(), theirs.is_dir(), theirs.is_file()) == (ours.exists(), ours.is_dir(), ours.is_file())
    assert (remote / "1/b.txt").read_text() == "one\ntwo\n"
    assert (remote / "1/a.bin").stat().st_size == 8
    assert np.fromfile(remote / "1/a.bin", np.uint8).tolist() == list(range(8))  # a library that opens by itself
    assert read_bytes(remote / "1/a.bin") == bytes(range(8))


def test_it_stays_one_through_pickles_and_joins(memory: object) -> None:
    path = as_path("memory://bucket/drives")
    again = pickle.loads(pickle.dumps(path / "1"))
    assert isinstance(again, RemotePath)
    assert again == as_path("memory:/bucket/drives/1")
    assert hash(again) == hash(path / "1")
    assert (again.parent, again.resolve(), again.expanduser()) == (path, again, again)
    assert str((again / "a.bin").relative_to(path)) == "1/a.bin"
    with pytest.raises(FileNotFoundError, match="memory://bucket/drives/no"):
        (path / "no").read_bytes()


def test_nothing_is_written(memory: object) -> None:
    path = as_path("memory://bucket/drives/1/a.bin")
    for write in (
        lambda: path.write_bytes(b"x"),
        lambda: path.unlink(),
        lambda: (path.parent / "new").mkdir(),
        lambda: path.open("r+b"),
        lambda: path.open("w"),
        lambda: np.save(path.parent / "new.npy", np.zeros(1)),
        lambda: open_atomic(path).__enter__(),
    ):
        with pytest.raises((OSError, FarfieldError)):
            write()
    list_anew()
    assert path.read_bytes() == bytes(range(8))
    assert [p.name for p in path.parent.iterdir()] == ["a.bin", "b.txt"]


def test_a_file_is_fetched_once_and_again_when_the_store_has_another(memory: object, own_cache: Path) -> None:
    path = as_path("memory://bucket/drives/1/b.txt")
    assert path.read_bytes() == b"one\ntwo\n"
    copies = list(own_cache.rglob("b.txt"))
    copies[0].write_bytes(b"mine\n...")  # of equal length: what is read is the copy
    assert path.read_bytes() == b"mine\n..."
    memory.pipe_file("/bucket/drives/1/b.txt", b"other")  # type: ignore[attr-defined]
    list_anew()
    assert path.read_bytes() == b"other"


def test_a_file_that_changed_since_it_was_listed_is_refused(memory: object, own_cache: Path) -> None:
    path = as_path("memory://bucket/drives/1/b.txt")
    assert path.stat().st_size == 8
    memory.pipe_file("/bucket/drives/1/b.txt", b"longer than before")  # type: ignore[attr-defined]
    with pytest.raises(RemoteError, match=r"1/b\.txt: expected the file that was listed, 8 bytes"):
        path.read_bytes()
    assert not [copy for copy in own_cache.rglob("*") if copy.is_file()]


def test_the_cache_stays_below_its_bound(memory: object, own_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(remote_cache.LIMIT, "0.000025")  # 25 kB
    for number in range(5):
        memory.pipe_file(f"/bucket/large/{number}.bin", bytes(10_000))  # type: ignore[attr-defined]
    paths = [as_path(f"memory://bucket/large/{number}.bin") for number in range(5)]
    for number, path in enumerate(paths[:2]):
        assert len(path.read_bytes()) == 10_000
        os.utime(next(own_cache.rglob(f"{number}.bin")), (number, number))
    assert len(paths[2].read_bytes()) == 10_000
    assert sorted(copy.name for copy in own_cache.rglob("*.bin")) == ["1.bin", "2.bin"]  # the oldest went
    for copy in own_cache.rglob("*.bin"):
        os.utime(copy)  # in use now
    with pytest.raises(RemoteError, match="in use now"):
        paths[3].read_bytes()
    memory.pipe_file("/bucket/large/9.bin", bytes(30_000))  # type: ignore[attr-defined]
    list_anew()
    with pytest.raises(RemoteError, match=remote_cache.LIMIT):
        as_path("memory://bucket/large/9.bin").read_bytes()
    monkeypatch.setenv(remote_cache.LIMIT, "none")
    with pytest.raises(ConfigError, match=remote_cache.LIMIT):
        paths[4].read_bytes()


def test_errors_of_readers_name_the_url(memory: object) -> None:
    with pytest.raises(FileFormatError, match=r"memory://bucket/drives/1/b\.txt"):
        read_bytes(as_path("memory://bucket/drives/1/b.txt"), max_bytes=4)


def test_a_folder_for_a_library_holds_its_files(memory: object) -> None:
    folder = local_folder(as_path("memory://bucket/drives/1"))
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == {
        "a.bin": bytes(range(8)),
        "b.txt": b"one\ntwo\n",
    }
    assert local_folder(Path("data")) == Path("data")


def test_weights_are_taken_with_the_sum_of_their_bytes_alone(memory: object) -> None:
    url = "memory://bucket/drives/1/a.bin"
    digest = hashlib.sha256(bytes(range(8))).hexdigest()
    assert checked_file(f"{url}#sha256={digest}").read_bytes() == bytes(range(8))
    for wrong in (url, f"{url}#sha256=12", f"{url}#sha256={digest[:-1]}{'0' if digest[-1] != '0' else '1'}"):
        with pytest.raises(ConfigError, match=r"memory://bucket/drives/1/a\.bin: expected"):
            checked_file(wrong)


def test_the_extra_is_named_where_it_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    def none(*words: object) -> None:
        raise ImportError("obstore")

    monkeypatch.setattr(remote_stores, "_ObjectStore", none)
    remote_stores.find_store.cache_clear()
    with pytest.raises(MissingExtraError, match=r"needs obstore.*\[remote\]"):
        as_path("s3://bucket-without/x").is_dir()


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *words: object) -> None:
        pass


@pytest.fixture
def web(tmp_path: Path) -> Iterator[str]:
    (tmp_path / "site/drive").mkdir(parents=True)
    (tmp_path / "site/drive/one two.bin").write_bytes(b"1234")
    (tmp_path / "site/drive/é.txt").write_bytes(b"12")
    handler = functools.partial(_Quiet, directory=str(tmp_path / "site"))
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()


def test_a_web_servers_folders_are_read(web: str) -> None:
    pytest.importorskip("aiohttp")
    folder = as_path(f"{web}/drive")
    assert folder.is_dir()
    assert {path.name: (path.stat().st_size, path.read_bytes()) for path in folder.iterdir()} == {
        "one two.bin": (4, b"1234"),
        "é.txt": (2, b"12"),
    }
    assert not as_path(f"{web}/none").exists()


def test_a_server_that_is_gone_is_no_missing_file() -> None:
    pytest.importorskip("aiohttp")
    with pytest.raises(RemoteError, match=r"http://127.0.0.1:9/x: expected an answer"):
        as_path("http://127.0.0.1:9/x").exists()
