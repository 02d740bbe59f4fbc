"""What a command wrote among the data that it reads is its own, by verb and flag, until somebody else changes it."""

import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from farfield.errors import ConfigError
from farfield.files.atomic import write_bytes
from farfield.files.outputs import check_outputs, note_output, of_command


def test_what_a_command_did_not_write_is_no_output_of_its_own(tmp_path: Path) -> None:
    data = tmp_path / "data"
    data.mkdir()
    check_outputs([data], files={"--json": data / "new.json"})
    write_bytes(data / "new.json", b"{}")
    check_outputs([data], files={"--json": data / "new.json"})
    assert [path.name for path in tmp_path.iterdir()] == ["data"]  # no list beside outputs that stand elsewhere
    (data / "labels.csv").write_bytes(b"{}")
    (data / "other.json").write_bytes(b"{}")
    for name in ("labels.csv", "other.json", ".farfield_outputs"):
        with pytest.raises(ConfigError, match="which is read"):
            check_outputs([data], files={"--json": data / name})
    (data / ".farfield_outputs").write_text('["labels.csv", 1\n[3]\n{}\nnull\n')  # damaged, or of another program
    with pytest.raises(ConfigError, match="which is read"):
        check_outputs([data], files={"--json": data / "labels.csv"})
    write_bytes(data / "more.json", b"")  # no output of a command: it is not noted
    assert "more" not in (data / ".farfield_outputs").read_text()


def test_another_command_or_flag_does_not_replace_an_output_among_the_data(tmp_path: Path) -> None:
    path = own_output(tmp_path)
    check_outputs([tmp_path], files={"--json": path})
    with pytest.raises(ConfigError, match="which is read"):
        check_outputs([tmp_path], files={"--html": path})
    with of_command("view"), pytest.raises(ConfigError, match="which is read"):
        check_outputs([tmp_path], files={"--json": path})


def own_output(folder: Path) -> Path:
    """An output that stands among the data."""
    path = folder / "scores.json"
    check_outputs([folder], files={"--json": path})
    write_bytes(path, b"{}")
    return path


def test_a_list_of_outputs_is_written_anew_without_foreign_lines_or_links(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").write_text("mine")
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / ".farfield_outputs").write_text(
        "ssh-rsa AAAA someone\n1 2 a\n1 2 - --json a b\n1 2 - --json a\n"
    )
    (tmp_path / "data" / f".farfield_outputs-{os.getpid()}.part").symlink_to(tmp_path / "elsewhere")
    own_output(tmp_path / "data")
    lines = (tmp_path / "data" / ".farfield_outputs").read_text().splitlines()
    assert lines[0] == "1 2 - --json a"
    assert [line.split()[2:] for line in lines[1:]] == [["-", "--json", "scores.json"]]
    assert (tmp_path / "elsewhere").read_text() == "mine"


@pytest.mark.parametrize("kind", ["folder", "link", "unreadable"])
def test_a_list_that_cannot_be_kept_is_said_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    outputs = tmp_path / ".farfield_outputs"
    if kind == "folder":
        outputs.mkdir()
    elif kind == "link":
        outputs.symlink_to(tmp_path / "elsewhere")
    else:
        outputs.touch()
        monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != outputs)
    with pytest.raises(ConfigError, match=r"\.farfield_outputs: expected .* delete it|Delete it"):
        check_outputs([tmp_path], files={"--json": tmp_path / "scores.json"})


def test_a_command_killed_before_its_output_takes_its_name_may_write_it_again(tmp_path: Path) -> None:
    path = own_output(tmp_path)
    (tmp_path / "new").write_bytes(b"[]")
    note_output(path, tmp_path / "new")  # and killed
    check_outputs([tmp_path], files={"--json": path})
    write_bytes(path, b"[]")
    check_outputs([tmp_path], files={"--json": path})


def test_commands_that_note_their_outputs_at_once_lose_no_line(tmp_path: Path) -> None:
    paths = [tmp_path / f"{number}.json" for number in range(24)]
    check_outputs([tmp_path], files={f"--{path.stem}": path for path in paths})
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(write_bytes, paths, [b"{}"] * len(paths)))
    assert len((tmp_path / ".farfield_outputs").read_text().splitlines()) == len(paths)
