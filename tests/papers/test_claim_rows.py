"""Every claim in a row: which size decides it, its figures and words, and what would decide it."""

import json
from pathlib import Path
from typing import Any

import pytest

from farfield.errors import FileFormatError
from farfield.papers.claim_rows import (
    ClaimRow,
    RecordedGrid,
    claim_rows,
    comparisons_of,
    counts_of,
    labels_of,
    paper_of,
    read_grid,
)
from farfield.papers.claims import Claims, load
from farfield.papers.grid import load_grid

CLAIMS, GRID = load("cirrus"), load_grid("cirrus")


def decision(estimate: float, verdict: str, n: int = 3) -> dict[str, Any]:
    difference = {"estimate": estimate, "interval": [estimate - 0.01, estimate + 0.01], "n": n, "trained": n > 0}
    return {"verdict": verdict, "words": verdict, "difference": difference}


def summary(claims: Claims = CLAIMS, *, verdicts: dict[str, str], budget: str = "desk", n: int = 3) -> dict[str, Any]:
    """What ``reproduction.json`` holds: all comparisons of a claim decided alike, those of other claims not run."""
    trees = []
    for claim in claims:
        verdict, rows = verdicts.get(claim.id, "not run"), []
        for role, metric, _ in comparisons_of(claim):
            made = None if verdict == "not run" else decision(0.05, verdict, n if claim.runs else 0)
            rows.append({"role": role, "metric": metric, "decision": made, "power": 0.5, "a": {}, "b": {}})
        trees.append({"id": claim.id, "words": "", "verdict": verdict, "decided": rows})
    runs = {"planned": 57, "done": 57 if n == 3 else 20}
    declared = {"paper": claims.paper, "budget": budget, "simulated": True, "seeds": 3, "steps": {"grid": 1500}}
    return {**declared, "runs": runs, "claims_sha256": claims.sha256, "claims": trees, "tables": []}


def folder(path: Path, tree: dict[str, Any], timing: dict[str, Any] | None = None) -> Path:
    path.mkdir(parents=True)
    (path / "reproduction.json").write_text(json.dumps(tree))
    if timing is not None:
        (path / "timing.json").write_text(json.dumps(timing))
    return path


def by_id(*decided: dict[str, Any]) -> dict[str, ClaimRow]:
    rows = claim_rows(CLAIMS, GRID, [RecordedGrid.model_validate(tree) for tree in decided])
    assert [row.claim.id for row in rows] == [claim.id for claim in CLAIMS], "every claim, in the paper's order"
    return {row.claim.id: row for row in rows}


def test_the_largest_finished_size_decides_and_others_speak_where_they_differ() -> None:
    laptop = summary(verdicts={"C1": "undecided", "C4": "holds not", "C7": "holds not"}, budget="laptop")
    desk = summary(verdicts={"C1": "holds", "C7": "holds not"}, budget="desk")
    rows = by_id(laptop, desk)
    assert (rows["C1"].verdict, rows["C1"].size) == ("holds", "desk: 1,500 steps, 3 seeds")
    assert rows["C1"].elsewhere == [("laptop", "undecided")]
    assert (rows["C4"].verdict, rows["C4"].grid and rows["C4"].grid.budget) == ("holds not", "laptop"), "desk has no II"
    assert rows["C7"].elsewhere == [], "both say the same"
    assert rows["C2"].verdict == "not run"
    assert (rows["C2"].size, rows["C2"].again, rows["C2"].ours()) == ("-", "-", [])
    assert counts_of(list(rows.values())) == "Of 16 claims 1 hold, 2 hold not, 0 are undecided and 13 were not run."


def test_a_larger_size_counts_when_it_is_finished_and_real_data_above_all() -> None:
    laptop = summary(verdicts={"C1": "undecided"}, budget="laptop")
    begun = summary(verdicts={"C1": "holds"}, budget="desk", n=2)
    row = by_id(laptop, begun)["C1"]
    assert (row.verdict, row.elsewhere) == ("undecided", [("desk", "holds")])
    assert by_id(begun)["C1"].size == "desk: 1,500 steps, 2 of 3 seeds"
    real = {**summary(verdicts={"C1": "holds not"}, budget="laptop"), "simulated": False}
    row = by_id(summary(verdicts={"C1": "holds"}, budget="gpu"), real)["C1"]
    assert (row.verdict, row.size) == ("holds not", "laptop, real data: 1,500 steps, 3 seeds")


def test_cells_say_what_was_published_found_and_controlled() -> None:
    tree = summary(verdicts={"C1": "holds", "C7": "undecided", "C0": "holds"})
    rows = {claim["id"]: claim["decided"] for claim in tree["claims"]}
    rows["C1"][1]["decision"] = decision(-0.02, "holds not")
    rows["C7"][1]["decision"] = decision(0.03, "holds")
    rows["C7"][4]["decision"] = decision(0.02, "holds")
    cells = by_id(tree)
    assert cells["C1"].published == "0.077, 0.066, 0.071, 0.040"
    assert cells["C1"].ours()[:2] == ["overall 0.050 [0.040, 0.060]", "near -0.020 [-0.030, -0.010] holds not"]
    assert cells["C7"].decision == "undecided; holds in wDDS; power 50 %"
    assert cells["C7"].controls[:2] == [
        "the losses act as regularisers: holds 0.030 [0.020, 0.040]",
        "the second head and its batches: undecided 0.050 [0.040, 0.060]",
    ]
    assert (cells["C0"].published, cells["C0"].size) == ("-", "desk: no training")


def test_what_would_decide_is_the_smallest_larger_budget() -> None:
    rows = by_id(summary(verdicts={"C9": "undecided", "C10": "undecided", "C8": "undecided", "C1": "holds"}))
    assert rows["C9"].would_decide({"workstation": 36728.0}) == "perhaps budget workstation (612 core hours)"
    assert rows["C9"].would_decide() == "perhaps budget workstation (--plan says what it costs)"
    assert rows["C10"].would_decide() == "no larger budget: too small a difference for its seeds"
    assert rows["C8"].would_decide() == "the paper prints no difference to plan by"
    assert rows["C1"].would_decide() == ""
    assert rows["C13"].would_decide().startswith("perhaps budget laptop"), "it was not run at all"


def test_comparisons_of_a_claim_are_told_apart() -> None:
    labels = {claim.id: labels_of(claim.comparisons) for claim in (*CLAIMS, *load("kradar"))}
    assert labels["C1"] == ["overall", "near", "mid", "far"]
    assert labels["C2"][0] == "gaussian near over mid"
    assert labels["C6"] == ["pointrcnn over second", "second wdds over pointrcnn"]
    assert labels["C7"] == [""]
    assert labels["C13"] == labels["C14"][::-1] == ["on uniform", "on gaussian"]
    assert labels["K2"] == ["overall", "fog", "sleet", "light snow", "heavy snow"]
    assert labels["K6"][::2] == ["rtnh overcast over normal", "rtnh overcast minus normal over matched"]
    assert labels["K7"][0] == "rain not below normal"
    for texts in labels.values():
        assert len(set(texts)) == len(texts)


def test_a_folder_tells_what_its_trainings_took(tmp_path: Path) -> None:
    tree = summary(verdicts={"C1": "holds", "C7": "holds"})
    clocks = {"gaussian": [600.0, 60.0], "uniform": [300.0], "second": [1200.0]}
    runs: dict[str, Any] = {
        f"s0-{run}": {"runs": [run], "clock": [{"processor_s": seconds} for seconds in times]}
        for run, times in clocks.items()
    }
    timing = {"planned": {"core_minutes": 90.0}, "runs": runs}
    found = read_grid(folder(tmp_path / "here", tree, timing), CLAIMS)
    (row, *_) = [row for row in claim_rows(CLAIMS, GRID, [found]) if row.claim.id == "C1"]
    assert row.again == "16 of 36 core min, 2 trainings"
    runs["s0-gaussian"]["clock"][1]["brought"] = True  # trained here, scored anew
    assert read_grid(folder(tmp_path / "again", tree, timing), CLAIMS).core_minutes == 36
    runs["s0-uniform"]["clock"][0]["brought"] = True
    (row, *_) = [
        row
        for row in claim_rows(CLAIMS, GRID, [read_grid(folder(tmp_path / "brought", tree, timing), CLAIMS)])
        if row.claim.id == "C1"
    ]
    assert row.again == "6 of 57 trainings; all 90 core min planned"
    assert read_grid(folder(tmp_path / "none", tree), CLAIMS).core_minutes is None


def test_other_files_and_other_claims_are_refused_by_name(tmp_path: Path) -> None:
    tree = summary(verdicts={"C1": "holds"})
    for name, changes, words in (
        ("paper", {"paper": "kitti"}, "what farfield reproduce writes"),
        ("seeds", {"seeds": 0}, "what farfield reproduce writes"),
        ("hash", {"claims_sha256": "0" * 64}, "claims as they are declared now"),
        ("no-hash", {"claims_sha256": ""}, "claims as they are declared now"),
        ("fewer", {"claims": tree["claims"][:3]}, "comparison"),
    ):
        path = folder(tmp_path / name, {**tree, **changes})
        with pytest.raises(FileFormatError, match=words):
            read_grid(path, CLAIMS)
    path = folder(tmp_path / "list", tree)
    (path / "reproduction.json").write_text("[1]")
    with pytest.raises(FileFormatError, match=r"reproduction\.json"):
        paper_of(path)
    (path / "reproduction.json").write_text("{")
    with pytest.raises(FileFormatError, match="JSON"):
        paper_of(path)
