"""Recording from Python: silent, callbacks, data simulated where they are absent or begun."""

import pickle
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("embreex")

from farfield.errors import ConfigError, DatasetError
from farfield.frame.provenance import SIMULATION_FILE
from farfield.jobs import folders
from farfield.simulation import find_preset, simulate_frame
from farfield.simulation.recording import RecordingSummary, SimulationConfig, ensure, record
from farfield.simulation.recording.recorder import _has_other_data
from farfield.simulation.rig import RIGS, FrameWriter

WANTED = SimulationConfig(preset="cirrus-sim-mini", sequences=1, frames=2, seed=4)


def contents(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[RecordingSummary, list[str]]:
    lines: list[str] = []
    recorded = ensure(WANTED, tmp_path_factory.mktemp("ensure") / "deep" / "data", report=lines.append)
    assert recorded is not None
    return recorded, lines


def test_data_that_are_absent_are_simulated_and_said(written: tuple[RecordingSummary, list[str]]) -> None:
    recorded, lines = written
    assert recorded.verdicts == ("written", "written")
    assert recorded.recording.plan == (2,)
    assert len(list(recorded.out.rglob("*.ffcloud"))) == 4  # Cirrus' layout has a cache
    assert lines[0] == "preset cirrus-sim-mini, seed 4: 2 frames in 1 sequence, 2 still to write"
    assert lines[-1] == f"wrote 2 frames into {recorded.out}"
    assert pickle.loads(pickle.dumps(recorded)) == recorded


def test_data_that_were_begun_are_finished(
    written: tuple[RecordingSummary, list[str]], capsys: pytest.CaptureFixture
) -> None:
    out = written[0].out
    before = contents(out)
    next(out.rglob("*.xyz")).unlink()
    asked: list[int] = []
    again = ensure(WANTED, out, progress=lambda frames: asked.append(len(frames)) or frames)
    assert again is not None
    assert len(again.verdicts) == asked[0] == 1
    assert contents(out) == before
    assert capsys.readouterr() == ("", "")  # nothing is said that nobody asked for


def test_other_data_are_left_as_they_are(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    assert ensure(WANTED, tmp_path) is None
    assert ensure(None, tmp_path / "absent") is None
    assert contents(tmp_path) == {"mine.txt": b"mine"}


def test_begun_with_other_settings_is_an_error(written: tuple[RecordingSummary, list[str]]) -> None:
    with pytest.raises(DatasetError, match="differs in: seed"):
        ensure(WANTED.model_copy(update={"seed": 5}), written[0].out)


@pytest.mark.skipif(sys.platform == "win32", reason="other locks")
def test_several_that_need_the_same_data_at_once_wait_for_the_one_that_simulates_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(folders, "_PATIENCE_S", 0.05)  # far less than it takes
    out, lines = tmp_path / "deep" / "data", [list[str]() for _ in range(5)]
    with ThreadPoolExecutor(5) as pool:  # a lock is a thread's, as it is a process'
        summaries = [*pool.map(lambda words: ensure(WANTED, out, report=words.append), lines)]
    assert sorted(len(summary.verdicts) for summary in summaries if summary is not None) == [0, 0, 0, 0, 2]
    assert sum(f"another command simulates {out}" in " ".join(words) for words in lines) >= 1


def test_what_another_command_just_begins_is_no_other_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out, is_file = tmp_path / "data", Path.is_file
    out.mkdir()

    def begun_after_the_look(path: Path) -> bool:
        result = is_file(path)
        if path.name == SIMULATION_FILE and not result:
            path.write_text("{}")
            (out / "frames").mkdir(exist_ok=True)
        return result

    monkeypatch.setattr(Path, "is_file", begun_after_the_look)
    assert not _has_other_data(out)


@pytest.mark.skipif(sys.platform == "win32", reason="other locks")
def test_data_whose_command_was_killed_as_it_began_are_simulated(tmp_path: Path) -> None:
    out = tmp_path / "data"
    out.mkdir()
    (out / ".simulation.json.0123456789ab.part").touch()
    summary = ensure(WANTED, out)
    assert summary is not None
    assert summary.verdicts == ("written", "written")
    assert not [*out.glob(".*.part")]


def test_sensors_are_names_or_one_text(tmp_path: Path) -> None:
    for sensors in ("gaussian", ("gaussian",), " gaussian"):
        recorded = record("cirrus-sim-mini", tmp_path / "one", frames=1, sensors=sensors, workers=1)
        assert recorded.recording.sensors == ("gaussian",)
    with pytest.raises(ConfigError, match="radar"):
        record("cirrus-sim-mini", tmp_path / "two", frames=1, sensors=["radar"])


def test_every_rig_has_a_writer_and_an_unknown_one_is_named(tmp_path: Path) -> None:
    for rig in ("cirrus", "kradar", "kitti"):
        preset = find_preset(f"{rig}-sim-mini")
        assert preset.rig == rig
        assert isinstance(RIGS[rig].writer(tmp_path, preset), FrameWriter)
        assert RIGS[rig].writer(tmp_path, preset).root == tmp_path or rig == "cirrus"
    with pytest.raises(ConfigError, match="one of cirrus, kradar, kitti, radiate; got 'drone'"):
        simulate_frame(replace(preset, rig="drone"), sequence=0, index=0)
