"""Errors in the words of whoever owns the file: what, where, expected, got; no library's own text."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from sources import sources

from farfield.errors import FarfieldError, FileFormatError
from farfield.experiments.schema import load_experiment
from farfield.papers.claims import load
from farfield.papers.grid import load_grid

LIBRARY = re.compile(
    r"Input should|Expecting|Extra data|pydantic|while (parsing|scanning)|unicode string|Traceback|Value error|"
    r"Field required|Extra inputs|validation error|Errno|line \d+ column \d+ \(char|mapping values|type=",
)


def _grid(path: Path) -> Any:
    return load_grid(path)


def _claims(path: Path) -> Any:
    return load(path)


def _mapping(path: Path) -> Any:
    from farfield.datasets.cirrus.layout import read_mapping

    return read_mapping(path)


def _calibration(path: Path) -> Any:
    from farfield.datasets.calibration import read_calibration

    return read_calibration(path)


def _boxes(path: Path) -> Any:
    from farfield.datasets.folder import read_boxes

    return read_boxes(path)


def _evaluation(path: Path) -> Any:
    from farfield.evaluation.record import Evaluation

    return Evaluation.load(path)


def _results(path: Path) -> Any:
    from farfield.metrics.comparing import read_results

    return read_results([path])


BROKEN: dict[str, str] = {
    "cut": '{"boxes": [1, 2',
    "words": "this is: not: what is\n\tasked for",
    "kinds": '{"boxes": "many", "results": [], "cameras": 3, "labels": 7, "training": {"steps": "many"}}',
    "nothing": "",
    "keys": '{"boxes": [{"label": 3}], "colour": 1, "cameras": {"a": {"matrix": 1}}, "name": 4}',
}


@pytest.mark.parametrize("fault", BROKEN)
@pytest.mark.parametrize(
    "read", [load_experiment, _grid, _claims, _mapping, _calibration, _boxes, _evaluation, _results]
)
def test_damaged_files_are_told_in_plain_words(tmp_path: Path, read: Callable[[Path], Any], fault: str) -> None:
    path = tmp_path / "given.json"
    path.write_text(BROKEN[fault])
    if read is _mapping and fault == "nothing":
        return  # an empty mapping changes nothing
    with pytest.raises(FarfieldError) as caught:
        read(path)
    assert "given.json" in str(caught.value)
    assert not LIBRARY.search(str(caught.value)), str(caught.value)


def test_a_fault_names_its_place(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("name: a\n  data: {\n")
    with pytest.raises(FarfieldError, match=r"line 2, column 7"):
        load_experiment(path)
    path = tmp_path / "a.json"
    path.write_text('{"results": {},\n "settings" {}}')
    with pytest.raises(FarfieldError, match=r"line 2, column 13: a colon is missing"):
        _evaluation(path)


def test_no_module_prints_pydantic_s_texts() -> None:
    """``errors.plain`` and ``errors.fault_of`` do it once for all."""
    theirs = [path for path, text in sources().items() if re.search(r"(item|first)\[['\"]msg", text)]
    assert theirs == ["errors/wording.py"]


def test_old_keywords_of_a_fault_in_a_file_work_and_warn() -> None:
    with pytest.warns(DeprecationWarning, match="got="):
        error = FileFormatError("a.pcd", where="line 7", expected="three numbers", found="two", mend="Write three.")
    assert str(error) == "a.pcd, line 7: expected three numbers, found two. Write three."
    assert (error.got, error.fix) == ("two", "Write three.")
    with pytest.raises(TypeError, match="nothing_known"):
        FileFormatError("a.pcd", where="line 7", expected="three numbers", nothing_known="")
