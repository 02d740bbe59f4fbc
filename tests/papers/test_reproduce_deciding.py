"""Decisions over made-up scores whose answer is known, statistics of made-up objects, tables."""

import json
import math
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch")

from farfield.frame import Annotation, Boxes
from farfield.metrics import Detections
from farfield.papers.claims import load as load_claims
from farfield.papers.claims.schema import ClaimSide, Comparison
from farfield.papers.deciding import DecidedComparison, DecisionRule, Scores, verdict_of
from farfield.papers.grid import load_grid
from farfield.papers.scoring import matched_frames, merge_sets, needs_of, sample_of
from farfield.papers.statistics import AnnotatedObjects, statistic_difference
from farfield.papers.summary import ReproductionSummary, classes_of, spread_of, summary_of, tables_of

CLAIMS, GRID = load_claims("cirrus"), load_grid("cirrus")
SETTINGS = GRID.budgets["laptop"]
SEEDS, DRAWS = 3, 200


def made_up(values: dict[str, float], noise: float = 0.003) -> Scores:
    """Scores in which each run has one value for all numbers, +-noise by seed and +-0.001 by draw of the roads."""
    rng, needs = np.random.default_rng(0), needs_of(CLAIMS, GRID, SETTINGS.score)
    found = []
    for run, value in values.items():
        for seed in range(SEEDS):
            clouds: dict[str, Any] = {}
            for need in needs:
                if need.run == run:
                    here = value + noise * rng.standard_normal()
                    draws = (here + 0.001 * rng.standard_normal(DRAWS)).tolist()
                    kept = {"value": here, "draws": draws, "drawn": "x", "grouped_by": "sequences", "groups": 24}
                    clouds.setdefault(need.cloud, {"samples": {}, "results": {}})["samples"][need.name] = kept
            found.append({"runs": [run], "seed": seed, "key": run, "clouds": clouds})
    return Scores.of(found)


def decided(scores: Scores, claim: str) -> list[DecidedComparison]:
    rule = DecisionRule(claims=CLAIMS, grid=GRID, settings=SETTINGS, scores=scores)
    own = [each for each in rule.decide() if each.claim.id == claim]
    return [each for each in own if each.first and each.role == "comparison"]


def test_a_difference_that_is_there_holds_and_its_reverse_holds_not() -> None:
    scores = made_up({"gaussian": 0.5, "uniform": 0.4, "pattern_paired": 0.55, "pattern_reversal": 0.45})
    assert verdict_of(CLAIMS["C1"], decided(scores, "C1")) == "holds"
    assert verdict_of(CLAIMS["C15"], decided(scores, "C15")) == "holds not"
    again = made_up({"gaussian": 0.5, "uniform": 0.499}, noise=0.02)
    assert verdict_of(CLAIMS["C1"], decided(again, "C1")) == "undecided"


def test_runs_that_are_missing_are_said_to_be() -> None:
    scores = made_up({"gaussian": 0.5, "uniform": 0.4})
    assert verdict_of(CLAIMS["C4"], decided(scores, "C4")) == "not run"
    assert all(each.decision is None for each in decided(scores, "C4"))
    assert verdict_of(CLAIMS["C0"], decided(scores, "C0")) == "not run"  # its objects were not counted


def test_margins_and_construction_are_the_claims() -> None:
    scores = made_up({"gaussian": 0.5, "range": 0.499, "device_25": 0.52, "device_pretrained": 0.5}, noise=0.0005)
    assert verdict_of(CLAIMS["C8"], decided(scores, "C8")) == "holds"  # lost 0.001, margin 0.01
    assert verdict_of(CLAIMS["C11"], decided(scores, "C11")) == "holds not"  # 0.02 better, margin 0.01
    assert verdict_of(CLAIMS["C3"], decided(made_up({"gaussian": 0.5}), "C3")) == "undecided"


def test_rows_that_found_nothing_agree_on_nothing() -> None:
    scores = made_up({"gaussian": 0.0, "range": 0.0, "uniform": 0.4}, noise=0.0)
    nothing = decided(scores, "C8")
    assert [each.decision.words for each in nothing] == ["nothing found: no decision"]
    assert verdict_of(CLAIMS["C8"], nothing) == "no decision"
    assert verdict_of(CLAIMS["C1"], decided(scores, "C1")) == "holds not"  # one of both found something


def test_a_run_without_such_a_figure_is_no_run_that_is_missing() -> None:
    scores = made_up({"gaussian": 0.5, "uniform": 0.4})
    for seed in range(SEEDS):
        scores.by_run["uniform"][seed]["clouds"]["uniform"]["samples"] = {}
    found = decided(scores, "C1")
    assert {each.decision.words for each in found} == {"no figure: no decision"}
    assert verdict_of(CLAIMS["C1"], found) == "no decision"


def test_spreads_are_pooled_by_metric_and_network() -> None:
    scores = made_up(dict.fromkeys(GRID.runs_of("laptop"), 0.5))
    found = DecisionRule(claims=CLAIMS, grid=GRID, settings=SETTINGS, scores=scores).decide()
    trained = [each for each in found if each.decision is not None]
    assert {each.pool for each in trained} >= {"dds, grid", "wdds, grid", "dds, second and voxelnet"}
    grid = [each for each in trained if each.pool == "dds, grid"]
    spreads = {each.decision.difference.pooled.s for each in grid}
    assert len(spreads) == 1
    assert grid[0].decision.difference.pooled.df == len(grid) * (SEEDS - 1)
    assert all(0 <= each.power <= 1 for each in trained if each.power is not None)
    adjusted = [each for each in trained if each.adjusted is not None]
    assert all(each.first and each.role == "comparison" for each in adjusted)


def test_a_seed_that_one_row_lacks_is_left_out() -> None:
    scores = made_up({"gaussian": 0.5, "uniform": 0.4})
    fewer = Scores(
        by_run={**scores.by_run, "uniform": {0: scores.by_run["uniform"][0], 2: scores.by_run["uniform"][2]}}
    )
    found = decided(fewer, "C1")
    assert {each.seeds for each in found} == {(0, 2)}


def objects(
    points: dict[str, list[int]], range_m: list[float], road: list[int], weather: list[str]
) -> AnnotatedObjects:
    return AnnotatedObjects(
        points={name: np.array(values, dtype=np.int64) for name, values in points.items()},
        range_m=np.array(range_m, dtype=np.float64),
        road=np.array(road, dtype=np.int64),
        weather=np.array(weather),
        label=np.array(["vehicle"] * len(range_m)),
        roads=max(road) + 1,
    )


def test_points_in_boxes_are_compared_as_logarithms_of_means() -> None:
    data = objects({"gaussian": [40, 20, 9, 7], "uniform": [20, 10, 2, 2]}, [10, 20, 210, 220], [0, 1, 0, 1], [""] * 4)
    whole, far, more = (
        statistic_difference(pair, "log_points_in_boxes", data, replicates=50) for pair in CLAIMS["C0"].comparisons
    )
    assert whole.estimate == pytest.approx(math.log(76 / 34))
    assert far.estimate == pytest.approx(math.log(16 / 4))
    assert more.estimate == pytest.approx(math.log(4) - math.log(2))
    assert (whole.groups, whole.trained) == (2, False)


def test_returns_are_shares_of_objects_by_weather() -> None:
    weather = ["normal", "normal", "sleet", "sleet"]
    data = objects({"os2-64": [5, 4, 1, 9], "other": [-1] * 4}, [10.0] * 4, [0, 0, 0, 0], weather)
    pair = Comparison(
        a=ClaimSide(cloud="os2-64", part="weather/normal"), b=ClaimSide(cloud="os2-64", part="weather/sleet")
    )
    found = statistic_difference(pair, "share_of_objects_with_returns", data, replicates=10)
    assert found.estimate == pytest.approx(0.0)
    absent = Comparison(
        a=ClaimSide(cloud="other", part="weather/normal"), b=ClaimSide(cloud="none", part="weather/sleet")
    )
    assert statistic_difference(absent, "share_of_objects_with_returns", data, replicates=10).estimate is None


def frame_with(count: int) -> Annotation:
    rows = np.zeros((count, 3))
    boxes = Boxes(
        centre_m=rows, size_m=rows + 1, yaw_rad=np.zeros(count), label=np.array(["vehicle"] * count, dtype=str)
    )
    return Annotation(boxes=boxes)


def test_matched_frames_have_as_many_of_each_number_of_objects() -> None:
    counts = {"a": [1, 1, 1, 2], "b": [1, 3, 2, 2]}
    annotations = {(part, str(n)): frame_with(count) for part, each in counts.items() for n, count in enumerate(each)}
    names = {"a": "normal", "b": "overcast"}
    found = Detections(
        boxes={},
        annotations=annotations,
        conditions={key: {"weather": names[key[0]]} for key in annotations},
    )
    kept = matched_frames(found, ("weather/overcast", "weather/normal"))
    numbers = {part: sorted(len(annotations[key].boxes) for key in kept if key[0] == part) for part in counts}
    assert numbers == {"a": [1, 2], "b": [1, 2]}


def test_sets_are_scored_together_under_names_of_their_own() -> None:
    one = Detections(boxes={("1", "0"): Boxes.empty(scored=True)}, annotations={("1", "0"): frame_with(1)})
    both = merge_sets({"val": one, "sleet": one})
    assert set(both.annotations) == {("val: 1", "0"), ("sleet: 1", "0")}
    assert set(both.boxes) == set(both.annotations)


def test_samples_are_read_as_they_were_kept() -> None:
    kept = {"value": 0.5, "draws": [0.4, None], "drawn": "x", "grouped_by": "sequences", "groups": 2}
    found = sample_of(json.loads(json.dumps(kept)))
    assert np.isnan(found.draws[1])
    assert found.value == 0.5


def test_tables_have_the_papers_rows_first_and_its_controls() -> None:
    scores = made_up(dict.fromkeys(GRID.runs_of("laptop"), 0.5))
    found = {table["number"]: table for table in tables_of(CLAIMS, GRID, SETTINGS, scores)}
    assert list(found) == ["I", "II", "III", "IV", "V", "VI"]
    assert [row["published"] for row in found["IV"]["rows"]][:4] == [
        "pretrained",
        "adapted_25",
        "adapted_50",
        "adapted_100",
    ]
    assert {"target_25", "device_both", "device_a"} <= {row["run"] for row in found["IV"]["rows"]}
    assert {"both_paired", "both_shuffled"} <= {row["run"] for row in found["VI"]["rows"]}
    assert found["I"]["rows"][0]["cells"]["far"]["dds"]["published"] == 0.3412
    assert found["III"]["bins"] == {"near": "0-64", "far": "64-160"}


def test_spread_is_that_over_seeds() -> None:
    assert spread_of({0: 1.0, 1: 3.0}) == {
        "mean": 2.0,
        "s": pytest.approx(math.sqrt(2)),
        "by_seed": {"0": 1.0, "1": 3.0},
    }
    assert spread_of({0: 1.0, 1: None})["mean"] is None
    assert spread_of({})["mean"] is None


def test_every_class_has_a_row() -> None:
    rows = {row["label"]: row for row in classes_of(GRID, SETTINGS, {"pedestrian": 4, "vehicle": 9})}
    assert len(rows) >= 8
    assert rows["vehicle"]["learnt"]
    assert not rows["pedestrian"]["learnt"]
    assert rows["trailer"] == {"label": "trailer", "annotated": 0, "learnt": False}


def trained(device: str) -> dict[str, object]:
    known = {"versions": {"torch": "2.6"}, "commit": "abc"}
    return {"device": device, "precision": "fp32", "environment": known}


def test_the_summary_and_its_page(tmp_path) -> None:
    pytest.importorskip("matplotlib")
    from farfield.papers.page import write_page

    scores = made_up({"gaussian": 0.5, "uniform": 0.4})
    data = objects({"gaussian": [40, 20, 9], "uniform": [20, 10, 2]}, [10, 20, 210], [0, 1, 1], [""] * 3)
    found = DecisionRule(claims=CLAIMS, grid=GRID, settings=SETTINGS, scores=scores, objects=data).decide()
    made = ReproductionSummary(
        paper="cirrus",
        budget="laptop",
        simulated=True,
        steps={"grid": 300},
        planned=57,
        done=6,
        sets={"train": ("f" * 64, SETTINGS.sets["train"])},
        trained_on=[trained("NVIDIA H200"), trained("NVIDIA H200"), trained("EPYC"), {}],
    )
    summary = json.loads(json.dumps(summary_of(made, GRID, CLAIMS, scores, data, found)))
    clock = {"training_s": 60.0, "scoring_s": 6.0, "processor_s": 66.0, "peak_memory_mb": 512.0}
    timing = {
        "planned": {"core_minutes": 90.0, "workers": 2},
        "runs": {"a": {"runs": ["gaussian"], "clock": [clock]}},
    }
    text = write_page(tmp_path / "report.html", summary, timing, objects=data.columns).read_text()
    assert "simulated, scaled" in text.lower()
    assert "Of 16 claims" in text
    assert "C1: holds" in text
    assert "2 runs: NVIDIA H200, fp32, torch 2.6, commit abc; 1 run: EPYC, fp32, torch 2.6, commit abc" in text
    assert "Table I: VoxelNet by scan pattern and range" in text
    assert CLAIMS.sha256 in text
    assert "http" not in text.replace("http://www.w3.org", "")
    assert all(each.to_json()["claim"] == each.claim.id for each in found)
