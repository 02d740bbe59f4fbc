"""Score JSON that somebody changed: a page or a table, or an error of ours in words; never another exception."""

import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from json_mutations import mutations
from whole import whole_or

from farfield import cli
from farfield.errors import FarfieldError, FileFormatError
from farfield.evaluation.record import Evaluation
from farfield.evaluation.report_data import annotated_objects
from farfield.metrics import PROTOCOLS, Bootstrap
from farfield.metrics.comparing import compare, read_results
from farfield.metrics.result_json import check_parts, check_result
from farfield.pages.evaluation_page import render_report
from farfield.testing.protocols import example

NAMES = ("dds", "nuscenes", "argoverse2", "waymo", "kitti", "kradar", "tracking", "nuscenes-tracking")


def result_of(name: str) -> Any:
    protocol = PROTOCOLS[name]
    drawn = {"bootstrap": Bootstrap(replicates=3)} if "bootstrap" in protocol.options() else {}
    return json.loads(json.dumps(example().score(protocol, **drawn).to_json()))


@pytest.fixture(scope="module")
def trees() -> list[Any]:
    """A result of each protocol, and an evaluation with parts and objects."""
    results = {name: result_of(name) for name in NAMES}
    detections = example()
    parts = {
        "conditions": {"weather": {"fog": {"dds": {"0": {"dds": 0.5}}}, "rain": None}},
        "counts": {"weather": {"fog": {"frames": 3, "annotated": 5}}},
        "intervals": {"weather/fog": {"dds": {"0": {"dds": [0.4, 0.6]}}}},
        "classes": {"vehicle": {"annotated": 5, "figures": {"dds/0/dds": 0.5}}},
        "mean_of_classes": {"annotated": 5, "figures": {"dds/0/dds": 0.5}, "of": ["vehicle"]},
    }
    objects = json.loads(json.dumps(annotated_objects(detections.boxes, detections.annotated)))
    evaluation = {
        "format": 1,
        "title": "A",
        "results": {"lidar": results["dds"]},
        "settings": {"range_m": 250.0},
        "provenance": {"simulated": True, "seed": 1},
        "parts": {"lidar": parts},
        "objects": {"lidar": objects},
        "frames": [],
    }
    return [*results.values(), evaluation, evaluation]


def test_what_we_write_is_read(trees: list[Any]) -> None:
    for tree in trees[: len(NAMES)]:
        check_result(tree, "scores.json")
    check_parts(trees[-1], "evaluation.json")


def foreign_exceptions(trees: list[Any], path: Path, count: int, seed: int, *, pages: bool) -> Counter[str]:
    """Everything but an outcome and our own errors that changed files raise."""
    foreign: Counter[str] = Counter()
    for data in mutations(trees, count, np.random.default_rng(seed)):
        path.write_bytes(data)
        try:
            render_report(Evaluation.load(path)) if pages else compare(read_results([path, path]), separate=True)
        except FarfieldError:
            foreign["ours"] += 1
        except Exception as error:
            foreign[f"{type(error).__name__}: {error}"[:100]] += 1
    assert foreign.pop("ours") < count  # some files are still read
    return foreign


def test_compared_results_raise_errors_of_ours_alone(trees: list[Any], tmp_path: Path) -> None:
    assert foreign_exceptions(trees, tmp_path / "x.json", 400, 1, pages=False) == Counter()


def test_pages_of_changed_results_raise_errors_of_ours_alone(trees: list[Any], tmp_path: Path) -> None:
    assert foreign_exceptions(trees, tmp_path / "x.json", 40, 2, pages=True) == Counter()


@pytest.mark.slow
def test_pages_of_changed_results(trees: list[Any], tmp_path: Path) -> None:
    assert foreign_exceptions(trees, tmp_path / "x.json", whole_or(600, 150), 3, pages=True) == Counter()


WRONG: list[tuple[tuple[str, ...], Any, str]] = [
    (("settings", "bootstrap"), [], "settings/bootstrap"),
    (("settings", "range_bins_m"), 70, "settings/range_bins_m"),
    (("ranges",), "0-70", "ranges"),
    (("ranges", "near"), {}, "ranges"),
    (("ap", "0.5"), "1.0", "ap/0.5"),
    (("ap", "0.5"), [], "ap/0.5"),
    (("counts", "ranges"), [1], "counts/ranges"),
    (("counts", "annotated"), "many", "counts/annotated"),
    (("intervals", "overall", "ap", "0.5"), [0.1], "intervals/overall/ap/0.5"),
    (("curves", "overall", "0", "0.5", "recall"), [0.1], "curves/overall/0/0.5"),
    (("notes",), "note", "notes"),
    (("dds",), 3, "dds"),
]


@pytest.mark.parametrize(("steps", "value", "named"), WRONG, ids=[row[2] for row in WRONG])
def test_the_place_is_named(trees: list[Any], tmp_path: Path, steps: tuple[str, ...], value: Any, named: str) -> None:
    tree = json.loads(json.dumps(trees[0]))
    node = tree
    for step in steps[:-1]:
        node = node[step]
    node[steps[-1]] = value
    path = tmp_path / "scores.json"
    path.write_text(json.dumps(tree))
    for read in (Evaluation.load, lambda location: read_results([location])):
        with pytest.raises(FileFormatError, match=f"key '{named}") as refused:
            read(path)
        assert "farfield score --json" in refused.value.fix


def test_the_verb_ends_in_words(trees: list[Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "scores.json"
    path.write_text(json.dumps({**trees[0], "curves": {"overall": {"near": {"0.5": None}}}}))
    assert cli.main(["report", str(path)]) == 1
    assert "expected numbers as names" in capsys.readouterr().err
