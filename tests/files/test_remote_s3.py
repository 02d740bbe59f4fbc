"""A store of S3's kind that answers, fails and lies: read in pages, tried again, never half."""

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from small_s3 import PAGE, SmallS3

from farfield.files import remote_stores
from farfield.files.remote_paths import as_path, list_anew
from farfield.files.remote_stores import RemoteError, find_store
from farfield.jobs.uploads import uploaded

pytest.importorskip("obstore")


@pytest.fixture
def server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[SmallS3]:
    server = SmallS3()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    for name, value in server.environment.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(remote_stores, "_RETRIES", 2)
    find_store.cache_clear()
    list_anew()
    yield server
    server.shutdown()
    server.server_close()
    find_store.cache_clear()
    list_anew()


def test_a_folder_of_several_pages_is_listed_whole(server: SmallS3) -> None:
    server.objects = {f"b/data/{number:04d}.bin": b"x" * number for number in range(3 * PAGE)}
    server.objects |= {"b/data/deep/x.txt": b"1", "b/database/y": b"2"}
    names = [path.name for path in as_path("s3://b/data").iterdir()]
    assert sorted(names) == [*(f"{number:04d}.bin" for number in range(3 * PAGE)), "deep"]
    assert as_path("s3://b/data/0250.bin").stat().st_size == 250
    listings = [path for method, path in server.requests if method == "GET"]
    assert len(listings) <= 5  # no request a file


def test_no_more_is_fetched_than_is_opened(server: SmallS3) -> None:
    server.objects = {f"b/data/{number}.bin": bytes([number]) for number in range(9)}
    assert as_path("s3://b/data/7.bin").read_bytes() == b"\x07"
    assert [path for method, path in server.requests if method == "GET" and path.endswith(".bin")] == ["b/data/7.bin"]


def test_a_busy_server_is_asked_again(server: SmallS3) -> None:
    server.objects = {"b/x.bin": b"123"}
    answers = iter(["503", "503"])
    server.fault = lambda method, path: next(answers, None)
    assert as_path("s3://b/x.bin").read_bytes() == b"123"


@pytest.mark.parametrize("fault", ["503", "cut"])
def test_a_server_that_fails_is_said_with_what_to_set(server: SmallS3, fault: str) -> None:
    server.objects = {"b/x.bin": b"123" * 1000}
    server.fault = lambda method, path: fault if method == "GET" else None
    with pytest.raises(RemoteError, match=r"s3://b.*AWS_ENDPOINT_URL") as error:
        as_path("s3://b/x.bin").read_bytes()
    assert "Debug" not in str(error.value)
    assert "secret" not in str(error.value)


def test_a_file_that_is_gone_since_it_was_listed_is_no_missing_one(server: SmallS3) -> None:
    server.objects = {"b/x.bin": b"123"}
    assert as_path("s3://b/x.bin").is_file()
    server.objects.clear()
    with pytest.raises(RemoteError, match=r"s3://b/x\.bin: expected the file that was listed, got none"):
        as_path("s3://b/x.bin").read_bytes()


def test_a_bucket_that_is_not_there_is_said(server: SmallS3) -> None:
    server.fault = lambda method, path: "404"
    with pytest.raises(RemoteError, match=r"s3://b.*NoSuchBucket"):
        as_path("s3://b/x").is_dir()


def test_a_body_that_is_cut_leaves_nothing_and_the_next_reading_goes_on(server: SmallS3, tmp_path: Path) -> None:
    server.objects = {"b/x.bin": bytes(100_000)}
    server.fault = lambda method, path: "short" if method == "GET" and path.endswith(".bin") else None
    with pytest.raises(RemoteError, match=r"s3://b/x\.bin"):
        as_path("s3://b/x.bin").read_bytes()
    assert not [path for path in (tmp_path / "cache").rglob("*") if path.is_file()]
    server.fault = lambda method, path: None
    assert as_path("s3://b/x.bin").read_bytes() == bytes(100_000)


def test_names_that_no_folder_can_hold_are_refused(server: SmallS3) -> None:
    server.objects = {"b/data/../x": b"1"}
    with pytest.raises(RemoteError, match="invalid path"):
        list(as_path("s3://b/data").iterdir())


def test_an_upload_appears_whole_and_its_folder_is_marked_until_it_is(server: SmallS3) -> None:
    marked: list[bool] = []
    server.fault = lambda method, path: (
        marked.append("b/out/.farfield-upload" in server.objects) if method == "PUT" and path.endswith(".bin") else None
    )
    with uploaded("s3://b/out") as path:
        (path / "deep").mkdir(parents=True)
        for number in range(5):
            (path / f"deep/{number}.bin").write_bytes(bytes([number]))
        (path / ".x.0123456789ab.part").write_bytes(b"unfinished")
        assert not server.objects
    assert marked == [True] * 5
    assert server.objects == {f"b/out/deep/{number}.bin": bytes([number]) for number in range(5)}
    with uploaded("s3://b/out.csv") as path:
        path.write_bytes(b"x,y\n")
    assert server.objects["b/out.csv"] == b"x,y\n"


def test_what_fails_uploads_nothing(server: SmallS3) -> None:
    def work() -> None:
        with uploaded("s3://b/out") as path:
            path.mkdir()
            (path / "x").write_bytes(b"1")
            raise ValueError("work")

    with pytest.raises(ValueError, match="work"):
        work()
    assert not server.objects
    with uploaded("s3://b/out") as path:
        assert (path / "x").read_bytes() == b"1"  # what was made is still here


def test_a_large_file_is_whole_or_absent(server: SmallS3) -> None:
    data = bytes(range(256)) * 60_000  # 15 MB: several parts
    server.fault = lambda method, path: "503" if method == "PUT" and len(server.requests) % 3 == 0 else None
    with uploaded("s3://b/large.bin") as path:
        path.write_bytes(data)
    assert server.objects == {"b/large.bin": data}
    server.objects.clear()
    server.fault = lambda method, path: "cut" if method == "PUT" else None
    with pytest.raises(RemoteError), uploaded("s3://b/large.bin") as path:
        path.write_bytes(data)
    assert not server.objects
    assert not server.uploads  # nothing that is paid for is left


def test_a_cut_upload_goes_on_where_it_stopped(server: SmallS3, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("farfield.jobs.uploads._AT_A_TIME", 1)

    def put(path: str) -> bool:
        return path.startswith("b/out/") and path.endswith(".bin")

    server.fault = lambda method, path: (
        "503" if method == "PUT" and put(path) and sum(map(put, server.objects)) >= 7 else None
    )

    def work() -> None:
        with uploaded("s3://b/out") as folder:
            folder.mkdir()
            for number in range(20):
                (folder / f"{number:02d}.bin").write_bytes(bytes(100) + bytes([number]))

    with pytest.raises(RemoteError, match="503"):
        work()
    assert sum(map(put, server.objects)) == 7
    assert "b/out/.farfield-upload" in server.objects
    server.fault, server.requests = (lambda method, path: None), []
    with uploaded("s3://b/out") as folder:
        assert len(list(folder.glob("*.bin"))) == 20
    assert len([path for method, path in server.requests if method == "PUT" and put(path)]) == 13
    assert server.objects == {f"b/out/{number:02d}.bin": bytes(100) + bytes([number]) for number in range(20)}


def test_a_later_command_goes_on_with_what_the_store_has(server: SmallS3) -> None:
    server.objects = {"b/out/old.bin": b"old", "b/out/stale.bin": b"stale"}
    with uploaded("s3://b/out") as folder:
        assert (folder / "old.bin").read_bytes() == b"old"
        (folder / "new.bin").write_bytes(b"new")
        (folder / "stale.bin").unlink()
    assert server.objects == {"b/out/old.bin": b"old", "b/out/new.bin": b"new"}
    assert [path for method, path in server.requests if method == "PUT" and "old" in path] == []


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_a_copied_process_is_refused_instead_of_waiting_for_ever(server: SmallS3) -> None:
    server.objects = {"b/x.bin": b"1", "b/y.bin": b"2"}
    assert as_path("s3://b/x.bin").read_bytes() == b"1"
    reading, writing = os.pipe()
    child = os.fork()
    if not child:  # pragma: no cover - another process
        signal.alarm(30)
        try:
            as_path("s3://b/y.bin").read_bytes()
        except RemoteError as error:
            os.write(writing, str(error).encode())
        finally:
            os._exit(0)
    os.close(writing)
    os.waitpid(child, 0)
    with os.fdopen(reading, "rb") as words:
        assert b"multiprocessing_context='spawn'" in words.read()


def test_a_web_server_is_not_written_to() -> None:
    with pytest.raises(RemoteError, match="expected s3, gs or az to write to"):
        find_store("https", "example.org").put("x", Path("x"))
