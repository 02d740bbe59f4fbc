"""No verb writes over what it reads, nor over anything but a regular file, and each looks at its outputs first."""

import os
import shutil
import socket
from pathlib import Path

import pytest
from wrong_inputs import detections, own_folder, run

from farfield.cli import VERBS, main
from farfield.cli._output import check_outputs as check_verb
from farfield.errors import ConfigError
from farfield.files.atomic import open_atomic, write_bytes
from farfield.files.outputs import check_outputs, check_replaceable
from farfield.jobs import JobJournal, Unit

DETECTOR = "pointpillars-cirrus-sim"

FILES = {
    "doctor": "doctor DATA --json FILE",
    "stats": "stats DATA --out OUT --json FILE",
    "compare": "compare DATA COPY --out OUT --json FILE",
    "show": "show DATA --out FILE",
    "view": "view DATA --html FILE",
    "convert": "convert DATA FILE.csv --to boxes-csv",
    "formats": "formats --json FILE",
    "detectors": "detectors --json FILE",
    "bench": "bench --json FILE",
    "import-weights": "import-weights WEIGHTS FILE.safetensors",
    "export": "export WEIGHTS FILE.onnx",
    "predict": f"predict {DETECTOR} DATA --out FILE.csv",
    "predict, a picture": f"predict {DETECTOR} DATA --picture FILE",
    "evaluate": f"evaluate {DETECTOR} DATA --out OUT --json FILE",
    "track": "track PREDICTIONS --out FILE",
    "track, a picture": "track PREDICTIONS --out OUT/t.csv --picture FILE.png",
    "calibrate": "calibrate radar-lidar DATA --out OUT --json FILE",
    "calibrate, a board": "calibrate board DATA --draw FILE.png",
    "calibrate, saved": "calibrate radar-lidar DATA --out OUT --save FILE",
    "odometry": "odometry DATA --out OUT --picture FILE.png",
    "depth": "depth DATA --out OUT --picture FILE.png",
    "score": "score PREDICTIONS DATA/labels.csv --json FILE",
    "worst": "worst EVALUATION --out FILE",
    "worst, its rows": "worst EVALUATION --json FILE",
    "report": "report SCORES --out FILE",
    "report, a film": "report DATA --film FILE.gif",
}
"""Verbs that write a file whose name is chosen."""

FOLDERS = {
    "demo": "demo --out OUT --dry-run",
    "stats": "stats DATA --out OUT",
    "compare": "compare DATA COPY --out OUT",
    "radar": "radar DATA --out OUT",
    "annotate": "annotate DATA --out OUT",
    "annotate, edits": "annotate DATA --edits OUT",
    "new-dataset": "new-dataset OUT",
    "simulate": "simulate cirrus-sim-mini OUT",
    "convert": "convert DATA OUT --to kitti",
    "convert, a tool": "convert DATA OUT --to cvat",
    "train": f"train {DETECTOR} --out OUT",
    "adapt": f"adapt {DETECTOR} DATA --out OUT",
    "reproduce": "reproduce cirrus --out OUT",
    "predict": f"predict {DETECTOR} DATA --out OUT --format kitti",
    "evaluate": f"evaluate {DETECTOR} DATA --out OUT",
    "track": "track PREDICTIONS --out OUT --to kitti-tracking",
    "sync": "sync DATA --out OUT",
    "calibrate": "calibrate radar-lidar DATA --out OUT",
    "odometry": "odometry DATA --out OUT",
    "anonymize": "anonymize DATA OUT",
    "depth": "depth DATA --out OUT",
}
"""Verbs that write a folder."""

WRITE_NOTHING = {"experiments", "compare-results"}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("farfield.studio.serving.run.serve", lambda *args, **keywords: pytest.fail("served"))
    own_folder(tmp_path / "data")
    shutil.copytree(tmp_path / "data", tmp_path / "copy")
    detections(tmp_path / "predictions.csv")
    (tmp_path / "weights.safetensors").write_bytes(b"weights")
    (tmp_path / "scores.json").write_text("{}")
    (tmp_path / "evaluation").mkdir()
    (tmp_path / "evaluation" / "lost.json").write_text("{}")
    return tmp_path


def words(command: str, folder: Path, target: Path) -> list[str]:
    names = {
        "PREDICTIONS": folder / "predictions.csv",
        "WEIGHTS": folder / "weights.safetensors",
        "SCORES": folder / "scores.json",
        "EVALUATION": folder / "evaluation",
        "DATA": folder / "data",
        "COPY": folder / "copy",
    }
    for name, path in names.items():
        command = command.replace(name, str(path))
    output = "FILE" if "FILE" in command else "OUT"
    command = command.replace(output, str(target))
    return command.replace("OUT", str(folder / "out")).split()


def content(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def name_of(command: str, target: Path) -> Path:
    """The name that the verb is given: with a suffix where it needs one."""
    word = next(word for word in command.split() if word.startswith("FILE"))
    return target.with_name(target.name + word.removeprefix("FILE"))


def test_every_verb_that_writes_is_among_these() -> None:
    assert {name.partition(",")[0] for name in {*FILES, *FOLDERS}} | WRITE_NOTHING == set(VERBS)


@pytest.mark.parametrize("kind", ["itself", "hard link"])
@pytest.mark.parametrize("name", sorted(set(FILES) - {"formats", "detectors", "bench", "calibrate, saved"}))
def test_a_file_that_is_read_is_no_output(
    folder: Path, capsys: pytest.CaptureFixture[str], name: str, kind: str
) -> None:
    command = FILES[name]
    source = next(
        path
        for word, path in (
            ("PREDICTIONS", folder / "predictions.csv"),
            ("DATA", folder / "data" / "0000.npy"),
            ("WEIGHTS", folder / "weights.safetensors"),
            ("SCORES", folder / "scores.json"),
            ("EVALUATION", folder / "evaluation" / "lost.json"),
        )
        if word in command
    )
    suffix = name_of(command, Path("x")).suffix
    if kind == "hard link":
        target = folder / "other"
        os.link(source, name_of(command, target))
    elif suffix in ("", source.suffix):
        target = source.with_suffix("") if suffix else source
    else:
        pytest.skip("an input of this verb has another suffix")
    before = content(folder)
    status, text = run(capsys, *words(command, folder, target))
    assert status == 1, text
    assert "which is read" in text, text
    assert content(folder) == before


@pytest.mark.parametrize("kind", ["link", "pipe", "socket", "link to nothing"])
@pytest.mark.parametrize("name", FILES)
def test_only_regular_files_and_new_names_are_written(
    folder: Path, capsys: pytest.CaptureFixture[str], name: str, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "aim").write_text("of the link")
    target = name_of(FILES[name], folder / "target")
    monkeypatch.chdir(folder)
    if kind == "pipe":
        os.mkfifo(target)
    elif kind == "socket":
        with socket.socket(socket.AF_UNIX) as listening:
            listening.bind(target.name)
    else:
        target.symlink_to(folder / ("aim" if kind == "link" else "nothing"))
    before, mode = content(folder / "data"), target.lstat().st_mode
    status, text = run(capsys, *words(FILES[name], folder, folder / "target"))
    assert status == 1, text
    assert "expected a regular file or a new name, got a" in text, text
    assert target.lstat().st_mode == mode
    assert (folder / "aim").read_text() == "of the link"
    assert not (folder / "nothing").exists()
    assert content(folder / "data") == before


@pytest.mark.parametrize("name", FOLDERS)
def test_a_folder_is_needed_and_is_looked_at_first(folder: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    (folder / "file").write_text("a file")
    for target in (folder / "file", folder / "file" / "below"):
        status, text = run(capsys, *words(FOLDERS[name], folder, target))
        assert status == 1, text
        assert "expected a folder" in text, text
    assert (folder / "file").read_text() == "a file"


@pytest.mark.parametrize("name", sorted(set(FOLDERS) - {"demo", "new-dataset", "simulate", "train", "reproduce"}))
def test_the_folder_that_is_read_is_no_output(folder: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    if name == "track":
        pytest.skip("reads a file")
    before = content(folder)
    (folder / "link").symlink_to(folder / "data")
    for target in (folder / "data", folder / "link"):
        status, text = run(capsys, *words(FOLDERS[name], folder, target))
        assert status == 1, text
        assert "which is read" in text, text
        assert {path: data for path, data in content(folder).items() if "link" not in path} == before


@pytest.mark.parametrize("to", ["kitti", "cirrus", "cvat", "openlabel", "sustechpoints", "boxes-csv"])
@pytest.mark.parametrize("target", ["data/new", "link/new", ".", "data/new.csv", "copy/../data/a/b"])
def test_a_conversion_stands_beside_its_source(
    folder: Path, capsys: pytest.CaptureFixture[str], to: str, target: str
) -> None:
    (folder / "link").symlink_to(folder / "data")
    before = content(folder)
    status, text = run(capsys, "convert", folder / "data", folder / target, "--to", to)
    assert status == 1, text
    assert "which is read" in text, text
    assert content(folder) == before


def test_two_outputs_are_not_one(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    name = str(folder / "a.csv")
    status, text = run(capsys, "predict", DETECTOR, folder / "data", "--out", name, "--picture", name)
    assert status == 1
    assert "one would replace the other" in text


def test_a_device_is_never_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A regular file that says that it is a device: nothing here may touch a real one."""
    path = tmp_path / "null"
    path.write_bytes(b"a device")
    own_lstat = Path.lstat

    class Device:
        st_mode = 0o020666

    monkeypatch.setattr(Path, "lstat", lambda self: Device() if self == path else own_lstat(self))
    with pytest.raises(ConfigError, match="null: expected a regular file or a new name, got a device"):
        write_bytes(path, b"new")
    assert path.read_bytes() == b"a device"
    assert [file.name for file in tmp_path.iterdir()] == ["null"]


def test_what_takes_the_name_during_the_work_stays(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="got a pipe"), open_atomic(tmp_path / "a") as handle:  # noqa: PT012
        handle.write(b"new")
        os.mkfifo(tmp_path / "a")
    assert [file.name for file in tmp_path.iterdir()] == ["a"]
    assert (tmp_path / "a").is_fifo()


def test_a_journal_is_a_regular_file(tmp_path: Path) -> None:
    (tmp_path / "aim").write_text("")
    (tmp_path / "journal").symlink_to(tmp_path / "aim")
    linked = JobJournal(tmp_path / "journal")  # as of a data set that is checked out as links: it can be read
    assert len(linked) == 0
    linked.add(Unit("a"), "", {})
    with pytest.raises(ConfigError, match="got a symbolic link"):
        linked.commit()
    with pytest.raises(ConfigError, match="got a symbolic link"):
        JobJournal(tmp_path / "journal", overwrite=True)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ConfigError, match="got a pipe"):
        JobJournal(tmp_path / "pipe")


def test_a_run_s_own_files_are_no_outputs_of_its_page(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "run").mkdir()
    (folder / "run" / "log.jsonl").write_text("{}\n")
    (folder / "run" / "experiment.yaml").write_text("name: a\n")
    for name in ("log.jsonl", "experiment.yaml"):
        status, text = run(capsys, "report", str(folder / "run"), "--out", str(folder / "run" / name))
        assert status == 1, text
        assert "which is read" in text, text
    assert (folder / "run" / "log.jsonl").read_text() == "{}\n"
    (folder / "run" / "mine.html").write_text("<!doctype html>")  # an earlier page of the same command
    _, text = run(capsys, "report", str(folder / "run"), "--out", str(folder / "run" / "mine.html"))
    assert "which is read" not in text, text


def test_the_scores_do_not_replace_the_evaluation(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("torch")
    out = folder / "out"
    for name in ("evaluation.json", "report.html"):
        command = f"evaluate {DETECTOR} {folder / 'data'} --out {out} --json {out / name}"
        status, text = run(capsys, *command.split())
        assert status == 1, text
        assert "one would replace the other" in text, text


def test_of_a_detector_s_folder_the_weights_alone_are_read(tmp_path: Path) -> None:
    (tmp_path / "weights.safetensors").write_bytes(b"weights")
    (tmp_path / "scores.json").write_text("{}")
    check_verb((tmp_path,), files={"--json": tmp_path / "scores.json"})
    with pytest.raises(ConfigError, match="which is read"):
        check_verb((tmp_path,), files={"--json": tmp_path / "weights.safetensors"})


def test_links_within_what_is_read_are_followed_and_loops_end(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "disk" / "a.bin").write_bytes(b"points")
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "clouds").symlink_to(tmp_path / "disk")
    (tmp_path / "data" / "loop").symlink_to(tmp_path / "data")
    (tmp_path / "data" / "one.bin").symlink_to(tmp_path / "disk" / "a.bin")
    with pytest.raises(ConfigError, match="which is read"):
        check_outputs([tmp_path / "data"], files={"--json": tmp_path / "disk" / "a.bin"})
    (tmp_path / "new").write_text("")
    check_outputs([tmp_path / "data"], files={"--json": tmp_path / "new"})
    check_outputs([tmp_path / "data"], files={"--json": tmp_path / "absent" / "new"}, folders={"--out": tmp_path})
    check_replaceable(tmp_path / "absent")
    assert not (tmp_path / "absent").exists()


def test_a_place_that_cannot_be_written_is_said_before_the_work(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*args: object, **keywords: object) -> None:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr("tempfile.TemporaryFile", full)
    monkeypatch.setattr("farfield.api.load_detector", lambda *args, **keywords: pytest.fail("worked first"))
    status, text = run(capsys, "predict", DETECTOR, folder / "data", "--out", folder / "deep" / "a.csv")
    assert status == 1
    assert f"{folder}: Read-only file system. Name a place that can be written." in text


def test_the_output_itself_is_written(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["detectors", "--json", "-"]) == 0
    assert '"detectors"' in capsys.readouterr().out


AGAIN = {
    "doctor": "doctor DATA --json DATA/report.json",
    "stats": "stats DATA --out DATA/figures --sweeps 2 --json DATA/stats.json",
    "compare": "compare DATA COPY --out OUT --frames 2 --json DATA/compared.json",
    "show": "show DATA --out DATA/a.png",
    "view": "view DATA --html DATA/page.html",
    "score": "score PREDICTIONS DATA --json DATA/scores.json",
    "odometry": "odometry DATA --out OUT --picture DATA/drive.png",
    "film": "report DATA --film DATA/film.gif --frames 2",
}
"""Verbs whose output may stand in the folder that they read."""


LONG = ("stats", "compare", "odometry")


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name in LONG)) for name in AGAIN])
def test_a_verb_goes_on_with_its_own_output_among_its_data(
    folder: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    out = next(word for word in AGAIN[name].split() if word.startswith("DATA/") and "." in word)
    path = folder / "data" / out.removeprefix("DATA/")
    command = words(AGAIN[name], folder, folder / "out")
    data = {file: file.read_bytes() for file in (folder / "data").glob("*.npy")}
    for _ in range(2):
        status, text = run(capsys, *command)
        assert status == 0, text
        assert path.is_file()
    assert data == {file: file.read_bytes() for file in (folder / "data").glob("*.npy")}
    path.write_bytes(path.read_bytes() + b"\n")  # it is somebody else's now
    status, text = run(capsys, *command)
    assert status == 1, text
    assert "which is read" in text, text


def test_a_link_to_itself_hides_no_file_behind_it(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    for number in range(20):
        (tmp_path / "data" / f"loop{number}").symlink_to(f"loop{number}")
    (tmp_path / "data" / "a.bin").write_bytes(b"points")
    for number in range(20, 40):
        (tmp_path / "data" / f"loop{number}").symlink_to(f"loop{number}")
    os.link(tmp_path / "data" / "a.bin", tmp_path / "b.bin")
    with pytest.raises(ConfigError, match="which is read"):
        check_outputs([tmp_path / "data"], files={"--json": tmp_path / "b.bin"})


def test_a_folder_is_walked_once_for_a_command_and_anew_for_another_link(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "data" / "below").mkdir(parents=True)
    (tmp_path / "out.json").write_text("{}")
    listed = []
    own = os.scandir
    monkeypatch.setattr("os.scandir", lambda path: (listed.append(path), own(path))[1])
    for _ in range(3):
        check_outputs([tmp_path / "data"], files={"--json": tmp_path / "out.json"})
    assert len(listed) == 2
    os.link(tmp_path / "out.json", tmp_path / "data" / "a.json")
    with pytest.raises(ConfigError, match="which is read"):
        check_outputs([tmp_path / "data"], files={"--json": tmp_path / "out.json"})
