"""`farfield formats` says what the code registers, and a format without facts is no format."""

import json
from dataclasses import replace
from pathlib import Path
from typing import get_args, get_type_hints

import pytest

from farfield.annotation.saving import FORMATS as SAVED_FORMS
from farfield.cli import convert as convert_verb
from farfield.cli import main
from farfield.cli._completion import flags_of
from farfield.datasets import DATASETS, Format, InMemory
from farfield.datasets.convert import CAPACITIES, TARGETS
from farfield.datasets.formats import find_format
from farfield.datasets.labels import formats as label_formats
from farfield.datasets.result_files import RESULT_FORMATS
from farfield.errors import ConfigError
from farfield.frame import cloud
from farfield.inspection import formats
from farfield.inspection.formats import format_catalogue
from farfield.metrics import PROTOCOLS, box_files
from farfield.simulation.rig import RIGS


def of_kind(kind: str) -> set[str]:
    return {form.name for form in format_catalogue().forms if form.kind == kind}


def test_all_that_is_registered_is_listed() -> None:
    catalogue = format_catalogue()
    assert [entry.name for entry in catalogue.datasets] == list(DATASETS.names())
    assert set(CAPACITIES) == set(TARGETS)
    assert list(catalogue.targets.values()) == [capacity.title for capacity in CAPACITIES.values()]
    assert of_kind("labels") == set(label_formats.forms_in_a_folder()) == set(SAVED_FORMS)
    assert of_kind("results") == {*RESULT_FORMATS, *box_files.FORMATS} == {*RESULT_FORMATS, *box_files._READERS}
    assert of_kind("clouds") == set(cloud.CLOUD_SUFFIXES)


def test_writers_savers_and_scores_are_those_of_the_registries() -> None:
    by_name = {entry.name: entry for entry in format_catalogue().datasets}
    written = {name for name, entry in by_name.items() if any(how.startswith("convert") for how in entry.written)}
    assert written == {capacity.read_by for capacity in CAPACITIES.values()} - {""}
    assert {name for name, entry in by_name.items() if "simulate" in entry.written} == set(RIGS.names())
    assert {name for name, entry in by_name.items() if entry.saved} == set(label_formats.readers_saved_in_place())
    assert all(entry.scored in PROTOCOLS for entry in by_name.values() if not entry.broken)
    assert not any(entry.broken for entry in by_name.values() if entry.origin == "farfield")


def test_the_verb_takes_the_targets_that_there_are() -> None:
    words = [capacity.words or target for target, capacity in CAPACITIES.items()]
    assert {word.partition(" ")[0] for word in words} == set(get_args(get_type_hints(convert_verb.run)["to"]))
    assert all(flag in flags_of("convert") for word in words for flag in word.split()[1:] if flag.startswith("-"))


def test_a_format_without_facts_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(DATASETS._loaded, "kitti", replace(find_format("kitti"), facts=None))
    with pytest.raises(ConfigError, match="kitti"):
        format_catalogue()


def test_a_suffix_or_form_without_facts_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(formats, "CLOUD_SUFFIXES", (*cloud.CLOUD_SUFFIXES, ".e57"))
    with pytest.raises(ConfigError, match=r"\.e57"):
        format_catalogue()


def test_the_verb_lists_shows_and_writes_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["formats"]) == 0
    text = capsys.readouterr().out
    assert all(f"\n{name} " in text for name in DATASETS.builtin)
    assert main(["formats", "kitti", "--json", str(tmp_path / "a.json")]) == 0
    assert "no real file" not in capsys.readouterr().out
    entries = json.loads((tmp_path / "a.json").read_text())
    assert [entry["name"] for entry in entries] == ["kitti", "kitti"]  # a data set and a form of results
    assert entries[0]["written"] == ["convert --to kitti", "simulate"]
    assert main(["formats", "nothing"]) == 1
    assert "kitti" in capsys.readouterr().err


def test_formats_of_other_packages_stand_beside_with_what_they_say(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    silent = Format(name="mine", looked_for="*.mine", recognises=bool, reader=InMemory)
    broken = replace(silent, name="theirs", reader="farfield.nowhere:Nothing")
    monkeypatch.setitem(DATASETS._registered, "mine", silent)
    monkeypatch.setitem(DATASETS._registered, "theirs", broken)
    by_name = {entry.name: entry for entry in format_catalogue().datasets}
    assert by_name["mine"].facts is None
    assert by_name["mine"].origin == "registered here"
    assert "farfield.nowhere" in by_name["theirs"].broken
    assert main(["formats"]) == 0
    assert main(["formats", "theirs"]) == 0
    assert "cannot be used" in capsys.readouterr().out
