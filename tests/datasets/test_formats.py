"""The registry of formats: every entry loads, and asking what a folder is imports no extra."""

import subprocess
import sys
from pathlib import Path

import pytest

from farfield.datasets import DATASETS, Dataset, recognise
from farfield.datasets.formats import find_format
from farfield.errors import EXTRAS


@pytest.mark.parametrize("name", DATASETS.builtin)
def test_every_entry_loads_its_reader_and_its_recognition(name: str, tmp_path: Path) -> None:
    format = find_format(name)
    assert format.name == name
    assert issubclass(format.load(), Dataset)
    assert not format.matches(tmp_path)


def test_names_stand_once_and_loose_clouds_come_last() -> None:
    names = list(DATASETS.builtin)
    assert len(names) == len(set(names))
    assert names[-1] == "folder"


def test_recognising_imports_no_extra(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from farfield.datasets import recognise; "
        f"assert recognise(Path({str(tmp_path)!r})) is None; "
        "heavy = {'pyarrow', 'h5py', 'rosbags', 'laspy', 'ouster', 'torch', 'matplotlib'} & set(sys.modules); "
        "assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_folder_of_nothing_is_of_no_format(tmp_path: Path) -> None:
    assert recognise(tmp_path) is None


@pytest.mark.parametrize("name", DATASETS.builtin)
def test_every_entry_has_facts_and_says_what_was_seen(name: str) -> None:
    facts = find_format(name).facts
    assert facts is not None, f"datasets/entries/{name}.py: expected facts=FormatFacts(...)"
    assert all((facts.title, facts.read, facts.real_files, facts.opens, facts.source))
    assert facts.opens.startswith("farfield ")
    assert facts.extra in {"", "sensors", *(extra for extra, _ in EXTRAS.values())}  # zstandard is of two extras
