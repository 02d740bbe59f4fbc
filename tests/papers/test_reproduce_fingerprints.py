"""Fingerprints that travel with runs: frames that another machine simulates anew are taken for those learnt from."""

from pathlib import Path

import pytest

pytest.importorskip("torch")

from tinygrid import tiny

from farfield.errors import FileFormatError
from farfield.papers import fingerprints as module
from farfield.papers.fingerprints import LEARNT, learnt_fingerprints, note_fingerprints

NAMES = ("train", "device")


def test_what_runs_learnt_from_is_what_was_noted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    locations = tiny(tmp_path).locations
    assert learnt_fingerprints(tmp_path, locations, NAMES) == {}
    note_fingerprints(tmp_path, locations, {"train": "x"})
    note_fingerprints(tmp_path, locations, {"device": "y"})
    assert learnt_fingerprints(tmp_path, locations, NAMES) == {"train": "x", "device": "y"}
    monkeypatch.setattr(module, "code_digest", lambda rooms: "another simulator")
    assert learnt_fingerprints(tmp_path, locations, NAMES) == {}


def test_what_was_noted_is_the_same_file_in_whatever_order(tmp_path: Path) -> None:
    """Runs that were killed note their sets in another order than one that nothing disturbed."""
    locations, notes = tiny(tmp_path).locations, []
    for order in (("train", "device"), ("device", "train")):
        folder = tmp_path / order[0]
        folder.mkdir()
        for name in order:
            note_fingerprints(folder, locations, {name: name})
        notes.append((folder / LEARNT).read_bytes())
    assert notes[0] == notes[1]


def test_damaged_notes_are_refused(tmp_path: Path) -> None:
    (tmp_path / LEARNT).write_text("{", encoding="utf-8")
    with pytest.raises(FileFormatError, match="fingerprints by set"):
        learnt_fingerprints(tmp_path, tiny(tmp_path).locations, NAMES)


def test_keys_and_checkpoints_have_the_fingerprint_of_the_first_frames(tmp_path: Path) -> None:
    made = tiny(tmp_path)
    job = made.jobs(made.locations, {"train": "x", "val": "", "device": "y"})[1]
    assert job.fingerprints == {"labelled": "x"}


def test_a_folder_without_frames_of_a_simulation_that_was_killed_has_none(tmp_path: Path) -> None:
    """It ended every later run: 'recognised no data set. It holds: simulation.json'."""
    locations = tiny(tmp_path).locations
    locations["device"].path.mkdir(parents=True)
    (locations["device"].path / "simulation.json").write_text("{}", encoding="utf-8")
    assert learnt_fingerprints(tmp_path, locations, NAMES) == {}
