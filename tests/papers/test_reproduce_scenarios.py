"""What the patterns are for: figures by road and direction, and the rule that switches, from runs to the page."""

import json

import pytest

pytest.importorskip("torch")

from metrics.scenes import better_on

from farfield.papers.grid import Score
from farfield.papers.scenarios import scenario_tables, scenarios_of

SCORE = Score(protocol="dds", settings={"region": "none"}, bins_m={"I": {"near": (0.0, 60.0), "far": (60.0, 120.0)}})


@pytest.fixture(scope="module")
def tree() -> dict:
    runs = {
        "gaussian": [better_on("highway", s) for s in range(3)],
        "uniform": [better_on("urban", s) for s in range(3)],
    }
    return json.loads(json.dumps(scenarios_of(runs, SCORE, replicates=40)))


def test_each_pattern_is_better_where_it_was_made_to_be(tree: dict) -> None:
    by_road = {each["value"]: each for each in tree["parts"] if each["kind"] == "road"}
    assert by_road["highway"]["decision"]["verdict"] == "holds"
    assert by_road["urban"]["decision"]["verdict"] == "holds not"
    assert by_road["highway"]["means"]["gaussian"] > by_road["highway"]["means"]["uniform"]
    assert [each["value"] for each in tree["parts"] if each["kind"] == "azimuth"] == ["0-15", "15-30", "30-60"]


def test_switching_gains_over_both(tree: dict) -> None:
    rule = tree["switching"]
    assert rule["choices"] == [{"urban": "uniform", "highway": "gaussian"}] * 6
    assert {name: gain["verdict"] for name, gain in rule["gains"].items()} == {"gaussian": "holds", "uniform": "holds"}


def test_the_page_has_it_in_words(tree: dict) -> None:
    shown = scenario_tables(tree)
    assert shown is not None
    assert shown["claim"] == "gaussian above uniform"
    assert shown["choices"] == "highway gaussian (6 of 6), urban uniform (6 of 6)"
    assert [row["what"] for row in shown["rows"]] == [
        "urban",
        "highway",
        "0-15 degrees",
        "15-30 degrees",
        "30-60 degrees",
    ]
    assert shown["rows"][1]["difference"].startswith("+")
    assert [row["verdict"] for row in shown["rule"]] == ["holds", "holds"]


def test_nothing_is_said_without_both_patterns_or_of_other_protocols() -> None:
    one = {"gaussian": [better_on("highway", 0)], "uniform": []}
    assert scenarios_of(one, SCORE) == {}
    assert scenario_tables(scenarios_of(one, SCORE)) is None
    assert scenarios_of({"gaussian": [], "uniform": []}, Score(protocol="kradar")) == {}
