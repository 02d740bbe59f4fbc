"""URLs in the place of paths: a data set read from a store, outputs uploaded into it, and what is refused."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from format_fixtures import fixture_of
from small_s3 import SmallS3

from farfield.cli import main
from farfield.cli._remote import OUTPUTS
from farfield.files import remote_stores
from farfield.files.remote_paths import list_anew
from farfield.files.remote_stores import find_store

pytest.importorskip("obstore")


@pytest.fixture
def server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[SmallS3]:
    server = SmallS3()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    for name, value in server.environment.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(remote_stores, "_RETRIES", 1)
    find_store.cache_clear()
    list_anew()
    fixture_of("view_of_delft")(tmp_path / "delft")  # type: ignore[misc]
    for path in (tmp_path / "delft").rglob("*"):
        if path.is_file():
            server.objects[f"b/delft/{path.relative_to(tmp_path / 'delft').as_posix()}"] = path.read_bytes()
    yield server
    server.shutdown()
    server.server_close()
    find_store.cache_clear()
    list_anew()


def _tree(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def _without_cards(tree: dict[str, bytes]) -> dict[str, bytes]:
    return {
        name: data for name, data in tree.items() if not name.startswith(".farfield") and "CARD" not in name.upper()
    }


def test_a_conversion_between_stores_is_that_between_folders(
    server: SmallS3, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["convert", "delft", "kitti", "--to", "kitti"]) == 0
    capsys.readouterr()
    assert main(["convert", "s3://b/delft", "s3://b/kitti", "--to", "kitti"]) == 0
    printed = capsys.readouterr()
    assert "s3://b/kitti: uploaded" in printed.err
    stored = {path.removeprefix("b/kitti/"): data for path, data in server.objects.items() if "b/kitti/" in path}
    assert _without_cards(stored) == _without_cards(_tree(tmp_path / "kitti"))
    assert len(stored) > 3
    assert not any("made" in path for path in server.objects)
    assert not list((tmp_path / "cache/farfield/remote/outputs").glob("*/made"))


def test_a_cut_connection_is_said_and_the_same_command_goes_on(
    server: SmallS3, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    server.fault = lambda method, path: "cut" if method == "PUT" and path.endswith(".txt") else None
    assert main(["convert", "s3://b/delft", "s3://b/kitti", "--to", "kitti"]) == 1
    printed = capsys.readouterr()
    assert "farfield convert: s3://b/kitti/" in printed.err
    assert "AWS_ENDPOINT_URL" in printed.err
    assert not server.uploads
    assert main(["doctor", "s3://b/kitti"]) == 1
    assert "expected a finished upload" in capsys.readouterr().err
    server.fault = lambda method, path: None
    assert main(["convert", "s3://b/delft", "s3://b/kitti", "--to", "kitti"]) == 0
    assert "had been written before" in capsys.readouterr().out
    assert main(["doctor", "s3://b/kitti"]) == 0
    assert "kitti" in capsys.readouterr().out


def test_what_is_printed_names_the_store_and_a_file_goes_there_whole(
    server: SmallS3, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["stats", "s3://b/delft", "--out", "s3://b/figures", "--json", "s3://b/all/counts.json"]) == 0
    printed = capsys.readouterr()
    assert "s3://b/figures" in printed.out
    assert "cache/farfield" not in printed.out
    assert server.objects["b/all/counts.json"].startswith(b"{")
    assert any(path.startswith("b/figures/") for path in server.objects)


def test_what_fails_leaves_the_store_as_it_was(server: SmallS3, capsys: pytest.CaptureFixture[str]) -> None:
    before = dict(server.objects)
    assert main(["stats", "s3://b/none", "--out", "s3://b/figures"]) == 1
    assert "s3://b/none: expected a data set's folder, found nothing" in capsys.readouterr().err
    assert server.objects == before


def test_every_argument_that_is_written_is_known_as_such() -> None:
    """A verb's flag that names an output is in the list, else a URL there would be read instead of uploaded."""
    from importlib import import_module
    from inspect import signature

    from farfield.cli import VERBS

    read = {"a", "b", "checkpoint", "data", "detections", "evaluation", "files", "floor", "labels", "learn_from"}
    read |= {
        "mapping_a",
        "mapping_b",
        "path",
        "poses",
        "predictions",
        "rates",
        "results",
        "settings",
        "source",
        "truth",
    }
    for verb in VERBS:
        run = import_module(f"farfield.cli.{verb.replace('-', '_')}").run
        for name, parameter in signature(run).parameters.items():
            if "Path" in str(parameter.annotation):
                assert (name in OUTPUTS) != (name in read), f"{verb} {name}"
